"""A step of a sampled controller in a compiled loop, beside its own exported C with -O3, and the loop around its twin.

Both answer the readings of a run of `huygens_rig`, called by the same loop in C.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from masking.control.exports.c_unit import CUnit
from masking.control.exports.controller_units import sampled_unit
from masking.control.stepwise_controller import SampledStep
from masking.lab.runs.experiment import Experiment
from tests.benchmarks.table import Row, few, interleaved, limited, missing, ratio, told
from tests.control.exports.test_controller_units import around_a_twin
from tests.support.compiled_unit import GCC

SAMPLES, ROUNDS = 5_000, 100
NAME = "huygens_rig"
WHAT = f"a step of the controller of {NAME}: masking / its own C with -O3"
LOOP = """
#include <string.h>
#include "{name}.h"

static {name}_state unit;

void theirs(long samples, const double *readings, double *commands)
{{
    {name}_init(&unit, readings);
    for (long i = 0; i < samples; i++) {name}_step(&unit, readings + {sensors} * i, commands);
}}

void ours(long samples, const double *readings, void (*step)(void), double *bound, long long *index, long long first)
{{
    for (long i = 0; i < samples; i++) {{
        memcpy(bound, readings + {sensors} * i, {sensors} * sizeof *bound);
        *index = first + i;
        step();
    }}
}}
"""


def rows() -> Iterator[Row]:
    """Measure the controller, and then the whole loop around the twin."""
    experiment = Experiment.load(NAME)
    yield against_c(experiment)
    loop = experiment.changed(duration=SAMPLES / experiment.sampled.rate / experiment.time_scale)
    loop.run()  # compiles
    seconds = interleaved({"run": loop.run}, few(5))
    samples = SAMPLES + experiment.sampled.before
    yield told(f"a sample of a run of {NAME}, with its recording", f"{min(seconds['run']) / samples * 1e9:.4g} ns")


def against_c(experiment: Experiment) -> Row:
    """Compare the compiled step with the exported one."""
    if GCC is None:
        return missing(WHAT, "there is no gcc")
    step, read = SampledStep(experiment.sampled), list[np.ndarray]()

    def noting(index: int, readings: np.ndarray) -> np.ndarray:
        read.append(readings.copy())
        return step(readings, index)

    around_a_twin(experiment, noting, step.reset, experiment.sampled.before + few(SAMPLES))
    readings = np.array(read)
    step.reset(readings[0])
    start = step.state.copy()
    with tempfile.TemporaryDirectory() as folder:
        library = built(experiment, Path(folder), readings.shape[1])
        data, commands = readings.ctypes.data_as(ctypes.c_void_p), np.zeros(len(step.actuators))
        given = (ctypes.c_long(len(readings)), data)
        address = ctypes.cast(step._bound[0].call, ctypes.c_void_p)  # type: ignore[arg-type]
        bound = [array.ctypes.data_as(ctypes.c_void_p) for array in (step._readings, step._index)]

        def ours() -> None:
            step.state[:] = start
            library.ours(*given, address, *bound, ctypes.c_longlong(-experiment.sampled.before))

        def theirs() -> None:
            library.theirs(*given, commands.ctypes.data_as(ctypes.c_void_p))

        seconds = interleaved({"ours": ours, "theirs": theirs}, few(ROUNDS))
    times = [f"{min(seconds[name]) / len(readings) * 1e9:.4g} ns" for name in ("ours", "theirs")]
    difference = float(np.abs(step.applied - commands).max() / np.abs(commands).max())
    return limited(WHAT, *times, ratio(seconds, "ours", "theirs"), at_most=1.0, note=f"last commands: {difference:.1e}")


def built(experiment: Experiment, folder: Path, sensors: int) -> Any:
    """Compile the loop and the exported controller."""
    unit = CUnit(sampled_unit(experiment.sampled, NAME, 0.02), "double")
    texts = {f"{NAME}.h": unit.header(), f"{NAME}.c": unit.source(), "loop.c": LOOP.format(name=NAME, sensors=sensors)}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    sources = [str(folder / name) for name in texts if name.endswith(".c")]
    command = [str(GCC), "-std=c99", "-O3", "-shared", "-fPIC", *sources, "-o", str(folder / "loop.so"), "-lm"]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(folder / "loop.so"))
