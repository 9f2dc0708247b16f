"""Crashes: loops, servers and recorders that are killed, streams cut and changed, and what a recorder costs the loop.

    python -m tests.benchmarks.crashes --kills 100 --bytes 1000 --cuts 1000

A loop in a process of its own puts a row each millisecond into its ring, and counts them in a file; it is killed at a
random instant, every other time its recorder just before it. What the stream then lacks of the count is lost. A server
that records its plant is killed while a controller runs on it; what its record then lacks of the samples is lost.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from masking.app.workflows.recover import recover
from masking.compile.numerics.arrays import Array
from masking.errors import PlantLostError, RecordError
from masking.lab.plants.interface import Settings
from masking.lab.plants.udp import UdpPlant
from masking.lab.records import stream, stream_reader
from masking.lab.records.recorder import Recorder
from masking.lab.records.recording import Recording
from masking.lab.records.ring import Ring, RingReader

RATE = 1000.0
WIDTH = 30
COLUMNS = {f"c{i}": {"unit": "V", "meaning": ""} for i in range(WIDTH)}
LOOP = """
import mmap, struct, sys, time
import numpy as np
from tests.benchmarks.crashes import COLUMNS, RATE, WIDTH
from masking.lab.records.recorder import Recorder
with open(sys.argv[2], "r+b") as file:
    count = mmap.mmap(file.fileno(), 8)
made, row = Recorder(sys.argv[1], COLUMNS, RATE, sys.argv[1]), np.zeros(WIDTH)
print(made.process, flush=True)
begin = time.monotonic()
for n in range(1_000_000):
    row[:] = n
    made.ring.put(row)
    struct.pack_into("<q", count, 0, n + 1)
    time.sleep(max(0.0, begin + (n + 1) / RATE - time.monotonic()))
"""


def lost_rows(seconds: float, folder: Path, *, both: bool) -> int:
    """Kill a loop after some time, with `both` its recorder just before; return the rows that were lost.

    Args:
        seconds: from its first row.
        folder: empty.
        both: kill the recorder too, just before, so that no other takes its place.

    Raises:
        ValueError: what is there is not what was put, to the last bit.
    """
    counter, run = folder / "count", folder / "run"
    counter.write_bytes(bytes(8))
    command = [sys.executable, "-c", LOOP, str(run), str(counter)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as started:
        assert started.stdout is not None
        recorder = int(started.stdout.readline())
        time.sleep(seconds)
        if both:
            os.kill(recorder, signal.SIGKILL)
        started.kill()
    (count,) = struct.unpack("<q", counter.read_bytes())
    found = _ended(run, wait=not both)
    table = found.table
    if found.end is None:  # what memory still holds, as `masking recover` takes it
        reader = RingReader(found.manifest["ring"])
        reader.next = len(table)
        table = np.concatenate([table, reader.take().table])
        reader.path.unlink()
    if found.damages or not np.array_equal(table, np.repeat(np.arange(len(table))[:, None], WIDTH, axis=1)):
        raise ValueError(f"after {seconds:.3f} s: wrong rows, {found.damages}")
    return max(0, count - len(table))


SERVER = """
import sys
from masking.lab.plants.serve import Serving, serve
from tests.lab.plants.test_wire import MassSpring
def say(address):
    print(address, flush=True)
serve(MassSpring(), "udp://127.0.0.1:0", Serving(record=sys.argv[1]), ready=say, tell=lambda text: None)
"""


def lost_ticks(seconds: float, folder: Path) -> int:
    """Kill a server some seconds after the first sample; return the samples that are not in the plant's own record."""
    with subprocess.Popen([sys.executable, "-c", SERVER, str(folder)], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        plant, last, until = UdpPlant(server.stdout.readline().strip(), patience=20.0), -1, 0.0
        plant.configure(Settings(RATE, 1.0))
        plant.activate()
        with contextlib.suppress(PlantLostError):
            while True:
                sample = plant.read()
                last, until = sample.index, until or time.monotonic() + seconds
                if time.monotonic() > until:
                    server.kill()
                plant.write(last, np.zeros(2))
        plant.deactivate()
    (session,) = folder.glob("session-*")
    _ended(session, wait=True)
    recover(session)
    return last + 1 - len(Recording.load(session))


def _ended(folder: Path, *, wait: bool) -> stream_reader.Stream:
    """Return a stream once nothing is added any more."""
    until = time.monotonic() + 10.0
    while True:
        with contextlib.suppress(RecordError):
            found = stream_reader.read(folder)
            if found.end is not None or not wait or time.monotonic() > until:
                return found
        time.sleep(0.02)


def written(folder: Path, rows: int) -> tuple[Array, bytes]:
    """Write a stream; return its rows and its bytes."""
    table = np.random.default_rng(0).standard_normal((rows, WIDTH))
    stream.begin(folder, {"columns": COLUMNS, "rate": RATE, "spare": str(folder), "number": "0"})
    writer = stream.StreamWriter(folder)
    for first in range(0, rows, 20):
        writer.append(first, table[first : first + 20])
    writer.end({"why": "closed", "rows": rows})
    return table, (folder / stream.ROWS).read_bytes()


def changed(folder: Path, number: int) -> tuple[int, int]:
    """Change single bytes; return how many were found, and how often a wrong row was given."""
    table, data = written(folder, 2000)
    where, found, wrong = np.random.default_rng(1), 0, 0
    for at, by in zip(where.integers(0, len(data), number), where.integers(1, 256, number), strict=True):
        (folder / stream.ROWS).write_bytes(data[:at] + bytes([data[at] ^ int(by)]) + data[at + 1 :])
        read = stream_reader.read(folder)
        found += bool(read.damages)
        wrong += not np.array_equal(read.table, table[read.numbers])
    return found, wrong


def cut(folder: Path, number: int) -> int:
    """Cut a stream at random bytes; return how often what is left is an exact prefix."""
    table, data = written(folder, 2000)
    exact = 0
    for at in np.random.default_rng(2).integers(0, len(data), number):
        (folder / stream.ROWS).write_bytes(data[:at])
        read = stream_reader.read(folder)
        exact += not read.damages and np.array_equal(read.table, table[: len(read.table)])
    return exact


def block(ring: Ring, ticks: int) -> tuple[Array, Array]:
    """Run a loop at the rate; return how long each row took and how late each tick began, s."""
    row, puts, late = np.zeros(WIDTH), np.empty(ticks), np.empty(ticks)
    begin = time.perf_counter()
    for n in range(ticks):
        time.sleep(max(0.0, begin + n / RATE - time.perf_counter()))
        now = time.perf_counter()
        late[n] = now - begin - n / RATE
        row[:] = n
        ring.put(row)
        puts[n] = time.perf_counter() - now
    return puts, late


def ratios(folder: Path, seconds: float) -> dict[str, tuple[float, float]]:
    """Compare loops with and without a recorder, second by second in turn: medians and 99 % quantiles, s."""
    made, plain = Recorder(folder, COLUMNS, RATE, folder), Ring([*COLUMNS], RATE)
    found: dict[str, list[tuple[Array, Array]]] = {"with": [], "without": []}
    recorder = made.process or 0
    try:
        for _ in range(max(1, round(seconds / 2.0))):
            found["with"].append(block(made.ring, round(RATE)))
            os.kill(recorder, signal.SIGSTOP)
            found["without"].append(block(plain, round(RATE)))
            os.kill(recorder, signal.SIGCONT)
    finally:
        plain.close()
        made.close()
    result = {}
    for i, what in enumerate(("row", "late")):
        for name, parts in found.items():
            values = np.concatenate([part[i] for part in parts])
            result[f"{what} {name}"] = (float(np.median(values)), float(np.quantile(values, 0.99)))
    return result


def main() -> int:
    """Print what was found; return 1 where anything was lost that may not be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("kills", 20), ("bytes", 1000), ("cuts", 1000), ("seconds", 20)):
        parser.add_argument(f"--{name}", type=int, default=default)
    chosen = parser.parse_args()
    instants = np.random.default_rng(int(time.time())).uniform(0.0, 1.0, chosen.kills)
    lost = []
    for n, seconds in enumerate(instants):
        with tempfile.TemporaryDirectory() as folder:
            lost.append(lost_rows(float(seconds), Path(folder), both=n % 2 == 1))
    ticks = []
    for seconds in instants:
        with tempfile.TemporaryDirectory() as folder:
            ticks.append(lost_ticks(float(seconds), Path(folder)))
    with tempfile.TemporaryDirectory() as folder:
        found, wrong = changed(Path(folder) / "a", chosen.bytes)
        exact = cut(Path(folder) / "b", chosen.cuts)
        times = ratios(Path(folder) / "c", chosen.seconds)
    print(f"{chosen.kills} kills of a loop: at most {max(lost, default=0)} rows of {RATE:g} Hz lost")
    print(f"{chosen.kills} kills of a server: at most {max(ticks, default=0)} ticks lost")
    print(f"{chosen.bytes} changed bytes: {found} found, {wrong} times a wrong row; {chosen.cuts} cuts: {exact} exact")
    for what in ("row", "late"):
        (a, b), (c, d) = times[f"{what} with"], times[f"{what} without"]
        print(f"{what}: {1e6 * a:.2f} us, p99 {1e6 * b:.1f} us; without a recorder {1e6 * c:.2f}, p99 {1e6 * d:.1f}")
    is_sound = max([0, *lost, *ticks]) <= 0.1 * RATE and found == chosen.bytes and not wrong and exact == chosen.cuts
    return int(not is_sound)


if __name__ == "__main__":
    sys.exit(main())
