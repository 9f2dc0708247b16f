"""How long a user waits: for the first compile, and for every later start from the cache."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.benchmarks.table import Row, limited, told

ROUNDS = 11
TOP = Path(__file__).resolve().parents[2]
# The parts of a first start, each measured where it happens.
COLD = """
import json, sys, time
clock = [time.perf_counter()]
from masking.compile.codegen.machine_code import NativeFunction
from masking.lab.runs.experiment import Experiment
def lap(): clock.append(time.perf_counter()); return clock[-1] - clock[-2]
parts = {"import": lap()}
timers, compiles = {}, NativeFunction._compile
def compile(function):
    begin = time.perf_counter()
    code = compiles(function)
    timers[f"{len(timers) + 1}. {function.name}"] = time.perf_counter() - begin
    return code
NativeFunction._compile = compile
experiment = Experiment.load("examples/oscillators/duffing.yaml")
experiment.plant.kernels, experiment.virtual.kernels, experiment.loop.kernels
parts["equations to source"] = lap()
experiment.run()
first = lap()
experiment.run()
parts["machine code"] = first - lap()
print(json.dumps({"parts": parts, "functions": timers}))
"""


def rows() -> Iterator[Row]:
    """Measure a first start, then later ones, in a cache folder of their own."""
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as out:
        yield cold(cache)
        yield listing(cache)
        yield from warm(cache, Path(out))


def cold(cache: str) -> Row:
    """Measure the first run of the Duffing experiment on an empty cache."""
    begin = time.perf_counter()
    printed = json.loads(process([sys.executable, "-c", COLD], cache))
    wall = time.perf_counter() - begin
    parts = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in printed["parts"].items())
    slowest = sorted(printed["functions"].items(), key=lambda item: -item[1])[:6]
    functions = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in slowest)
    return told("first start: duffing and its closed loop", f"{wall:.3g} s", note=f"{parts}; compiled: {functions}")


def listing(cache: str) -> Row:
    """Measure `masking list`, the whole process."""
    seconds = timed([*script(), "list"], cache)
    return limited(
        "start: masking list", f"{min(seconds):.3g} s", "", min(seconds), at_most=0.3, unit="s", note=spread(seconds)
    )


def warm(cache: str, out: Path) -> Iterator[Row]:
    """Measure `masking run` from the cache: the whole, and what is neither simulation nor report."""
    arguments = ["run", "examples/oscillators/duffing.yaml", "--overwrite", "--out", str(out)]
    walls = timed([*script(), *arguments], cache)
    overheads, reports = [], []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        process([sys.executable, "-m", "tests.benchmarks.timed_run", *arguments], cache)
        wall = time.perf_counter() - begin
        timing = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["timing"]
        reports.append(float(json.loads((out / "seconds.json").read_text(encoding="utf-8"))))
        overheads.append(wall - timing["run"] - timing["ideal"] - reports[-1])
    yield told("start: masking run, all of it", f"{min(walls):.3g} s", note=spread(walls))
    yield limited(
        "start: masking run, overhead",
        f"{min(overheads):.3g} s",
        "",
        min(overheads),
        at_most=0.8,
        unit="s",
        note=f"without simulation and report ({min(reports):.3g} s); {spread(overheads)}",
    )


def spread(seconds: Sequence[float]) -> str:
    """Say how much a time varied."""
    return f"shortest of {len(seconds)}, median {statistics.median(seconds):.3g} s"


def script() -> list[str]:
    """Give the installed command, else the module that it calls."""
    found = Path(sys.executable).with_name("masking")
    return [str(found)] if found.exists() else [sys.executable, "-m", "masking"]


def timed(command: Sequence[str], cache: str) -> list[float]:
    """Time a process many times."""
    process(command, cache)
    seconds = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        process(command, cache)
        seconds.append(time.perf_counter() - begin)
    return seconds


def process(command: Sequence[str], cache: str) -> str:
    """Run a process in the repository and give what it prints."""
    environment = {**os.environ, "MASKING_CACHE": cache, "PYTHONDONTWRITEBYTECODE": ""}  # as most users have it
    done = subprocess.run(command, cwd=TOP, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr[-2000:]}")
    return done.stdout
