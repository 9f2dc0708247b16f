"""Exported controllers on a Cortex-M4F in QEMU, against the kernel and against the same C on this machine."""

import math

import numpy as np
import pytest

from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.control.exports.unit_kernels import COUNTERS
from masking.lab.runs.experiment import Experiment
from tests.control.exports.test_controller_units import EXACT, by_kernel, by_unit, sampled
from tests.support import cortex_m4
from tests.support.cortex_m4 import CortexM4, order
from tests.support.cortex_m4_cycles import cycles, instruction, of_longest_step

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
    assert memory == 8 * math.ceil((8 * words + 4 * COUNTERS) / 8)
    with CortexM4(tmp_path, unit, "float") as exported:
        single, _, _ = by_unit(experiment, exported, 300)
        assert exported.measured()[1] < 20_000
    assert np.max(np.abs(single - ours)[:, :3]) <= 1e-5 * np.max(np.abs(ours[:, :3]))


def test_instructions_are_counted(tmp_path, monkeypatch):
    unit = sampled_unit(sampled("kalman, without homing").sampled, "controller", 0.02)
    monkeypatch.setattr("masking.control.exports.c_unit.CUnit.source", lambda _: COUNTED.format(count=ITERATIONS))
    orders = [order(b"s", np.zeros(3), "float")] * 3
    with CortexM4(tmp_path, unit, "float") as exported:
        ticks = exported.replay(orders)
        last, longest, *_ = exported.measured()
    assert 2 * ITERATIONS <= last <= 2 * ITERATIONS + 40
    assert 0 <= longest - last <= 2  # a tick of the clock
    low, high, logged = of_longest_step(tmp_path, unit, "float", orders, ticks)
    assert abs(logged - last) <= 4  # both ends of a step are read to a tick
    # SUBS takes a cycle, and BNE, which is taken, 1 + P with P from 1 to 3.
    assert 3 * ITERATIONS <= low <= 3 * ITERATIONS + 40
    assert 5 * ITERATIONS <= high <= 5 * ITERATIONS + 80


@pytest.mark.parametrize(
    ("mnemonic", "operands", "is_conditional", "low", "high"),
    [  # Tables 3-1 and 7-1 of Arm's manual: 1 + N registers, 1 + 2 N of 64 bits, and what may be pipelined or folded
        ("stmdb", "sp!, {r4, r5, r6-r9, sl, lr}", False, 9, 9),
        ("ldmia.w", "r5!, {r0, r1, r2, r3}", False, 5, 5),
        ("vpush", "{d8-d9}", False, 5, 5),
        ("vldmia", "r3!, {s15}", False, 2, 2),
        ("vldr", "s15, [sp, #4]", False, 1, 2),
        ("vldr", "d7, [sp, #4]", False, 2, 3),
        ("vmov", "r0, r1, d7", False, 2, 2),
        ("vmovmi.f32", "s15, s13", True, 1, 1),
        ("vsubeq.f32", "s15, s13, s1", True, 1, 2),
        ("ldrge.w", "r3, [r2, #4]", True, 1, 2),
        ("sdiv", "r3, r2, r1", False, 2, 12),
        ("vdiv.f32", "s15, s13, s1", False, 1, 15),
        ("itett", "eq", False, 0, 1),
    ],
)
def test_instructions_have_their_times(mnemonic, operands, is_conditional, low, high):
    found = instruction(4, mnemonic, operands, is_conditional)
    assert (found.low, found.high) == (low, high)


def test_what_takes_a_division_waits_for_it():
    program = {
        0: (4, "vdiv.f32", "s0, s1, s2", False),
        4: (4, "add.w", "r0, r0, r1", False),
        8: (4, "vadd.f32", "s0, s0, s1", False),
        12: (2, "bx", "lr", False),
    }
    assert cycles(program, [0, 4, 8, 12]) == (14 + 1 + 2, 15 + 1 + 2 + 4)
