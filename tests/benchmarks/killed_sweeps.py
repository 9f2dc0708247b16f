"""Sweeps that are killed at random, and gone on with: all rows once, equal to those of an undisturbed sweep.

    python -m tests.benchmarks.killed_sweeps FOLDER

kills a sweep of 2000 runs 20 times and compares its rows.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from masking import load_sweep, sweep

RUNS = {"over": {"z": "0.1:0.3:50", "th2": "-0.7:0.7:40"}, "duration": 100.0, "virtual": True, "measure": ["alpha"]}


def killed(out, given, workers):
    """Start a sweep once for each number of processes, kill each once a chunk more is on disk, and end it.

    Returns: how many were killed, the others having ended before.
    """
    command = [sys.executable, "-m", "masking", "sweep", "huygens", "--virtual", "--out", str(out)]
    for name, values in given["over"].items():
        command += ["--over", f"{name}={values}"]
    command += ["--measure", ",".join(given["measure"]), "--duration", str(given["duration"])]
    generator, kills = np.random.default_rng(1), 0
    for count in workers:
        before = len([*out.glob("rows/rows-*")])
        started = [*command, "--workers", str(count)]
        with subprocess.Popen(started, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            until = time.monotonic() + 300.0
            while process.poll() is None and len([*out.glob("rows/rows-*")]) == before and time.monotonic() < until:
                time.sleep(0.01)
            time.sleep(generator.uniform(0.0, 0.3))
            if process.poll() is None:
                kills += 1
                os.kill(process.pid, signal.SIGKILL)
    subprocess.run([*command, "--workers", "1"], check=True, capture_output=True)
    return kills


def compared(out, given, undisturbed):
    """Return the number of rows of all files, after all columns were found equal to those of an undisturbed sweep."""
    found, other = load_sweep(out), sweep("huygens", **given, workers=1, out=undisturbed)
    assert found["run"].tolist() == [*range(found.rows)]
    for name, column in found.columns.items():
        assert np.array_equal(column, other[name], equal_nan=isinstance(column, np.ndarray)), name
    return sum(pq.ParquetFile(file).metadata.num_rows for file in out.glob("rows/rows-*"))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    kills = killed(folder / "killed", RUNS, [1 + i % 2 for i in range(20)])
    rows = compared(folder / "killed", RUNS, folder / "undisturbed")
    assert rows == 2000
    print(f"killed {kills} times: each of 2000 runs is on disk once, equal to that of an undisturbed sweep")
