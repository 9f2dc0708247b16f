"""Exported controllers on a Cortex-M4F in QEMU, against the kernel and against the same C on this machine."""

import math

import numpy as np
import pytest

from masking.exports.controllers import law_unit, sampled_unit
from masking.runs.experiment import Experiment
from tests import cortex_m4
from tests.cortex_m4 import CortexM4
from tests.test_export import EXACT, by_kernel, by_unit, sampled

pytestmark = pytest.mark.skipif(not (cortex_m4.COMPILER and cortex_m4.EMULATOR), reason=cortex_m4.MISSING)
ITERATIONS = 10_000
# A step of a known number of instructions: two in each iteration, and a few around them.
COUNTED = """
#include "controller.h"

void controller_init(controller_state *unit, const float *readings)
{{
    (void)unit, (void)readings;
}}

int controller_step(controller_state *unit, const float *readings, float *commands)
{{
    int count = {count};
    (void)unit, (void)readings;
    __asm volatile("1: subs %0, %0, #1\\n\\tbne 1b" : "+r"(count) : : "cc");
    commands[0] = 0.0f;
    return count;
}}
"""


def test_a_law_on_a_cortex_m4_gives_the_inputs_of_the_kernel(tmp_path):
    loop = Experiment.load("duffing").loop
    n, p, u = 3, loop.values(), np.empty(3)
    sizes = np.concatenate([loop.controller.lengths, loop.controller.lengths * 18.0])
    generator = np.random.default_rng(6)
    with CortexM4(tmp_path, law_unit(loop, "duffing", None), "double") as exported:
        exported.init(np.zeros(2 * n + 1))
        for t in range(20):
            states = sizes * generator.uniform(-0.5, 0.5, 2 * n)
            loop.kernels.step(float(t), states[:n], states[n:], u, p)
            assert np.max(np.abs(exported.step([float(t), *states]) - u)) <= EXACT * np.max(np.abs(u))
            assert exported.status == 0


def test_the_loop_of_a_controller_on_a_cortex_m4_is_that_of_the_kernel(tmp_path):
    experiment = sampled("kalman, without homing")
    unit = sampled_unit(experiment.sampled, "controller", 0.02)
    ours, commands, _ = by_kernel(experiment, 300)
    with CortexM4(tmp_path, unit, "double") as exported:
        states, found, _ = by_unit(experiment, exported, 300)
        _, _, stack, memory = exported.measured()
    assert np.max(np.abs(found - commands)) <= 1e-11 * np.max(np.abs(commands))  # another library of mathematics
    assert np.max(np.abs(states - ours)[:, :3]) <= 1e-12 * np.max(np.abs(ours[:, :3]))
    assert 100 < stack < 4096
    words = sum(math.prod(shape) for shape in unit.memory.values())
    assert memory == 8 * math.ceil((8 * words + 4 * unit.counters) / 8)
    with CortexM4(tmp_path, unit, "float") as exported:
        single, _, _ = by_unit(experiment, exported, 300)
        assert exported.measured()[1] < 20_000
    assert np.max(np.abs(single - ours)[:, :3]) <= 1e-5 * np.max(np.abs(ours[:, :3]))


def test_instructions_are_counted(tmp_path, monkeypatch):
    unit = sampled_unit(sampled("kalman, without homing").sampled, "controller", 0.02)
    monkeypatch.setattr("masking.exports.c.CUnit.source", lambda _: COUNTED.format(count=ITERATIONS))
    with CortexM4(tmp_path, unit, "float") as exported:
        exported.step(np.zeros(3))
        last, longest, *_ = exported.measured()
    assert 2 * ITERATIONS <= last <= 2 * ITERATIONS + 40
    assert longest == last
