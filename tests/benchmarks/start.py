"""What a start takes of the processor: the first one, which compiles, and every later one from the cache."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.benchmarks.table import Row, few, limited

ROUNDS = 11
TOP = Path(__file__).resolve().parents[2]
# Processor time of a first start from an empty cache, with all that it loads and compiles.
FIRST = {
    "duffing in its closed loop": ("Experiment.load('duffing').run()", 1.6),
    "huygens_rig": ("Experiment.load('huygens_rig').run()", 3.5),
    "100 pendula on a beam": (
        "Experiment.load('examples/many/beam.yaml', counts={'N': 100}).changed(duration=1.0).run()",
        4.0,
    ),
}


def rows() -> Iterator[Row]:
    """Measure first starts, each in a cache of its own, then later ones."""
    for what, (call, most) in FIRST.items():
        yield first(what, call, most)
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as out:
        yield listing(cache)
        yield from warm(cache, Path(out))


def first(what: str, call: str, most: float) -> Row:
    """Measure a first start."""
    with tempfile.TemporaryDirectory() as cache:
        code = f"from masking.lab.runs.experiment import Experiment\n{call}"
        seconds = processor_time([sys.executable, "-c", code], cache)
    return limited(f"first start: {what}", f"{seconds:.3g} s", "", seconds, at_most=most, unit="s")


def listing(cache: str) -> Row:
    """Measure `masking list`, the whole process."""
    seconds = repeated([*script(), "list"], cache)
    return limited(
        "start: masking list", f"{min(seconds):.3g} s", "", min(seconds), at_most=0.3, unit="s", note=spread(seconds)
    )


def warm(cache: str, out: Path) -> Iterator[Row]:
    """Measure a run that is saved, from Python, and `masking run`, which writes its report, too."""
    call = f"Experiment.load('duffing').run().save({str(out)!r}, overwrite=True)"
    code = f"from masking.lab.runs.experiment import Experiment\n{call}"
    saved, reported = [sys.executable, "-c", code], [*script(), "run", "duffing", "--overwrite", "--out", str(out)]
    for what, command, most in (("run and save duffing", saved, 0.4), ("masking run duffing", reported, 1.5)):
        seconds = repeated(command, cache)
        value = min(seconds)
        yield limited(f"start: {what}", f"{value:.3g} s", "", value, at_most=most, unit="s", note=spread(seconds))


def spread(seconds: Sequence[float]) -> str:
    """Say how much a time varied."""
    return f"shortest of {len(seconds)}, median {statistics.median(seconds):.3g} s"


def script() -> list[str]:
    """Give the installed command, else the module that it calls."""
    found = Path(sys.executable).with_name("masking")
    return [str(found)] if found.exists() else [sys.executable, "-m", "masking"]


def repeated(command: Sequence[str], cache: str) -> list[float]:
    """Return the processor times of a process that is run many times, after a first one."""
    processor_time(command, cache)
    return [processor_time(command, cache) for _ in range(few(ROUNDS))]


def processor_time(command: Sequence[str], cache: str) -> float:
    """Run a process in the repository; return its processor time, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "MASKING_CACHE": cache, "PYTHONDONTWRITEBYTECODE": ""}  # as most users have it
    done = subprocess.run(command, cwd=TOP, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
