"""Kernels of one step of a controller by itself, for loops that are not compiled with it: a rig's, or a user's own."""
# ruff: noqa: ANN001, ANN201, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.kernel_arguments import Unit
from masking.compile.numerics.runge_kutta import fault
from masking.compile.numerics.sampled_loop import OF_READINGS
from masking.compile.numerics.stop_codes import NOT_FINITE, REACHED


@compiled
def status_of(health, first, commands):
    """Reason to stop after a step, or REACHED; `first` keeps the health of the first step."""
    if first[0] == 0.0:
        first[0] = health
    status = fault(health, first[0])
    for i in range(commands.size):
        if status == REACHED and not math.isfinite(commands[i]):
            status = NOT_FINITE
    return status


def sampled_step(control: Kernel, sizes: Sizes) -> Kernel:
    """Make the step of a sampled controller, as `masking.compile.numerics.sampled_loop` makes it.

    Returns `answer(index, h, s, unit, demanded, applied, first, work) -> status` for the readings s of a sample, as
    `control` has them; `first` (1,) is 0 at the beginning.
    """
    channels = sizes.actuators

    @compiled
    @requires(*OF_READINGS)
    def answer(
        index: int, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, first: Vector, work: Matrix
    ) -> int:
        health = control(index * h, h, s, unit, demanded, applied, work)
        return status_of(health, first, applied[:channels])

    return answer


def law_step(step: Kernel, coordinates: int, inputs: int) -> Kernel:
    """Make the step of a control law that is given the rig's state; `step(t, q, v, u, p) -> health` writes m inputs.

    Returns `answer(t, y, p, inverse, u, commands, first) -> status`, which writes the inputs u (m,) for a state y and,
    by the inverse of the allocation (actuators, m), the commands (actuators,); `first` (1,) is 0 at the beginning.
    """

    @compiled
    @requires("len(inverse) >= len(commands)")
    def answer(t: float, y: Vector, p: Vector, inverse: Matrix, u: Vector, commands: Vector, first: Vector) -> int:
        health = step(t, y[:coordinates], y[coordinates:], u, p)
        for i in range(commands.size):
            commands[i] = 0.0
            for j in range(inputs):
                commands[i] += inverse[i, j] * u[j]
        return status_of(health, first, u)

    return answer
