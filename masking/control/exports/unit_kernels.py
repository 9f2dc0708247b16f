"""Kernels of an exported unit: what stands around a controller, a rig or a model so that it can be called by itself.

They are written as those of `numerics` are, and translated with them. All memory of a unit is in arrays that it
is given: `counters` holds the sample, the periods since the last step, and why the unit has stopped.
"""
# ruff: noqa: ANN001, ANN202, ANN401, PLR0917
# The types are those of the unit that a kernel is written for.

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from masking.compile.numerics.arrays import IntVector, Kernel, Matrix, Vector
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, TIME, Sizes
from masking.compile.numerics.kernel_arguments import UnderWay, Unit
from masking.compile.numerics.runge_kutta import copy
from masking.compile.numerics.single_step import status_of
from masking.compile.numerics.stop_codes import REACHED

INDEX, WAITED, STATUS = range(3)
COUNTERS = 3
UNANSWERED = 7  # beside the stop codes: no step for longer than the watchdog allows
LAST = 2**31 - 2
NEWTON_STEPS = 20


class Memory(NamedTuple):
    """What a controller holds from step to step: its memory, parameters, first health, counters, and last commands."""

    x: Vector
    p: Vector
    first: Vector
    counters: IntVector
    applied: Vector


@dataclass(frozen=True)
class Start:
    """How a controller begins."""

    memory: int  # length of its memory
    parameters: int  # their number
    homing: int  # index of the parameters of the coordinates where homing begins; -1 where there are none
    period: float  # seconds between samples
    is_held: bool  # whether the rig is held by commands from the beginning


def clear(start: int) -> Kernel:
    """Make `clear(counters)`, which begins at a sample."""

    def clear(counters):
        counters[INDEX] = start
        counters[WAITED] = 0
        counters[STATUS] = REACHED

    return clear


def instant(period: float) -> Kernel:
    """Make `instant(index)`, the time of a sample, as the loops of this package compute it."""

    def instant(index):
        return index * period

    return instant


def nearest_instant(rate: float) -> Kernel:
    """Make `instant(index)`, the number nearest to the time of a sample.

    In float, the product with the period passes the end of the rest and the release by a rounding: a sample late.
    measured: chi of `huygens_rig` with a controller in float is 0.017 with this, 0.022 with the product.
    """

    def instant(index):
        return index / rate

    return instant


def count(counters: IntVector) -> None:
    """Go on to the next sample; where counting ends, the time stands still."""
    if counters[INDEX] < LAST:
        counters[INDEX] += 1


def resting(clear: Kernel, memory: int, parameters: int, actuators: int) -> Kernel:
    """Make the beginning of a controller of which nothing depends on the first readings.

    It is `init(readings, unit, memory0, values, holding)`.
    """

    def init(readings: Vector, unit: Memory, memory0: Vector, values: Vector, holding: Vector) -> None:
        copy(memory0, unit.x, memory)
        copy(values, unit.p, parameters)
        copy(holding, unit.applied, actuators)
        unit.first[0] = 0.0
        clear(unit.counters)

    return init


def beginning(
    clear: Kernel, measure: Kernel, still: Kernel, allocate: Kernel, wire: Kernel, sizes: Sizes, start: Start
) -> Kernel:
    """Make the beginning of a controller on a rig that rests where the first readings say.

    It is `init(readings, unit, work, memory0, values, inverse, limits)`. The coordinates that give these readings are
    found by Newton's method, with the inverse of the sensors at rest. `measure` is what the sensors would read, `still`
    the inputs that hold the rig where it is, `allocate` commands of inputs, and `wire` inputs of commands.
    """
    memory, parameters, homing = start.memory, start.parameters, start.homing
    period, is_held = start.period, start.is_held
    n, m, size, fixed, following = sizes.coordinates, sizes.inputs, sizes.states, sizes.fixed, sizes.next.start
    channels, powers = sizes.actuators, sizes.power.start

    def init(
        readings: Vector, unit: Memory, work: Matrix, memory0: Vector, values: Vector, inverse: Matrix, limits: Matrix
    ) -> None:
        x, p, first, counters, applied = unit
        y, expected, u = work[0], work[1], work[2]
        copy(memory0, x, memory)
        copy(values, p, parameters)
        first[0] = 0.0
        clear(counters)
        copy(x, y, size)
        for _ in range(NEWTON_STEPS):
            measure(0.0, y, p, expected)
            for i in range(n):
                for j in range(readings.size):
                    y[i] += inverse[i, j] * (readings[j] - expected[j])
        for i in range(channels):
            applied[i] = 0.0
        copy(y, x, n)
        for i in range(n):
            x[following + i] = y[i]
        if homing >= 0:
            copy(y, p[homing:parameters], n)
        if is_held:
            still(0.0, y, p, u)
            allocate(0.0, y, u, p, applied)
            for i in range(channels):
                applied[i] = min(max(applied[i], -limits[i, LARGEST]), limits[i, LARGEST])
            wire(0.0, y, applied, p, u)
            delay = (memory - fixed) // m
            for j in range(delay):
                copy(u, x[fixed + j * m : memory], m)
            for i in range(channels):
                warmed = -math.expm1(-(delay * period) / limits[i, TIME])
                x[powers + i] = warmed * limits[i, HEATING] * applied[i] * applied[i]

    return init


def controller_step(control: Kernel, instant: Kernel, actuators: int, period: float) -> Kernel:
    """Make the step of a sampled controller; where it cannot go on, commands are zero until `init`.

    It is `step(readings, commands, unit, demanded, applied, work, first, counters) -> status`.
    """

    def step(
        readings: Vector, commands: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix,
        first: Vector, counters: IntVector,
    ) -> Any:  # fmt: skip
        counters[WAITED] = 0
        for i in range(actuators):
            commands[i] = 0.0
        if counters[STATUS] != REACHED:
            return counters[STATUS]
        health = control(instant(counters[INDEX]), period, readings, unit, demanded, applied, work)
        status = status_of(health, first, applied[:actuators])
        if status == REACHED:
            copy(applied, commands, actuators)
        counters[STATUS] = status
        count(counters)
        return status

    return step


def miss_with_model(control: Kernel, instant: Kernel, sizes: Sizes, period: float) -> Kernel:
    """Make the step over a sample that was missed, as `masking.control.stepwise_controller.SampledStep` takes it.

    It is `miss(readings, unit, applied, unsent, before, work, counters)`, for the readings of the next sample and a
    gain of zero.
    """
    channels, powers = sizes.actuators, sizes.power.start

    def miss(
        readings: Vector, unit: Unit, applied: Vector, unsent: Vector, before: Vector, work: Matrix,
        counters: IntVector,
    ) -> None:  # fmt: skip
        x, limits = unit.x, unit.limits
        copy(x[powers : powers + channels], before, channels)
        control(instant(counters[INDEX]), period, readings, unit, unsent, unsent, work)
        for i in range(channels):
            part = -math.expm1(-period / limits[i, TIME])
            x[powers + i] = before[i] + part * (limits[i, HEATING] * applied[i] * applied[i] - before[i])
        count(counters)

    return miss


def miss_with_differences(skip: Kernel, instant: Kernel, period: float) -> Kernel:
    """Make `miss(x, p, applied, work, counters, limits)`, over a missed sample of a controller without a model."""

    def miss(x, p, applied, work, counters, limits):
        skip(instant(counters[INDEX]), period, x, p, limits, applied, work)
        count(counters)

    return miss


def watchdog(actuators: int, patience: int) -> Kernel:
    """Make the watchdog `watch(commands, counters) -> status`, which is called once a period.

    It sets the commands to zero where no step was made for `patience` periods, until `init`.
    """

    def watch(commands, counters):
        counters[WAITED] += 1
        if counters[WAITED] > patience:
            counters[WAITED] = patience
            counters[STATUS] = UNANSWERED
            for i in range(actuators):
                commands[i] = 0.0
        return counters[STATUS]

    return watch


def law_beginning(clear: Kernel, parameters: int) -> Kernel:
    """Make `init(p, first, counters, values)` of a control law that is given the states."""

    def init(p, first, counters, values):
        copy(values, p, parameters)
        first[0] = 0.0
        clear(counters)

    return init


def law_step(law: Kernel, size: int, coordinates: int, inputs: int) -> Kernel:
    """Make `step(time, readings, commands, p, first, counters) -> status` of a control law that is given the states."""

    def step(time, readings, commands, p, first, counters):
        for i in range(inputs):
            commands[i] = 0.0
        if counters[STATUS] != REACHED:
            return counters[STATUS]
        health = law(time, readings[:coordinates], readings[coordinates:size], commands, p)
        status = status_of(health, first, commands[:inputs])
        if status != REACHED:
            for i in range(inputs):
                commands[i] = 0.0
        counters[STATUS] = status
        return status

    return step


def rig_beginning(clear: Kernel, states: int, parameters: int, rows: int, actuators: int) -> Kernel:
    """Make `init(y, p, queue, acting, counters, state0, values)` of a rig at rest and unpowered."""
    begin = model_beginning(clear, states, parameters)

    def init(y, p, queue, acting, counters, state0, values):
        begin(y, p, counters, state0, values)
        for i in range(rows):
            for j in range(actuators):
                queue[i, j] = 0.0
        for j in range(actuators):
            acting[j] = 0.0

    return init


def rig_reading(sense: Kernel, instant: Kernel) -> Kernel:
    """Make `read(noise, readings, y, p, acting, counters)`: what the sensors read now, with samples of unit noise."""

    def read(noise, readings, y, p, acting, counters):
        sense(instant(counters[INDEX]), y, acting, p, noise, readings)

    return read


def rig_step(move: Kernel, instant: Kernel, actuators: int, substeps: int, period: float) -> Kernel:
    """Make `step(commands, y, p, queue, acting, work, counters, late)`: the rig moves by one period under commands."""

    def step(commands, y, p, queue, acting, work, counters, late):
        copy(commands, queue[queue.shape[0] - 1], actuators)
        move(instant(counters[INDEX]), y, UnderWay(queue, late), p, period, substeps, acting, work)
        count(counters)

    return step


def model_beginning(clear: Kernel, states: int, parameters: int) -> Kernel:
    """Make `init(y, p, counters, state0, values)` of a model in its initial state."""

    def init(y, p, counters, state0, values):
        copy(state0, y, states)
        copy(values, p, parameters)
        clear(counters)

    return init


def model_outputs(outputs: Kernel, instant: Kernel, coordinates: int, states: int) -> Kernel:
    """Make `read(inputs, readings, y, p, counters)`: the declared outputs now."""

    def read(inputs, readings, y, p, counters):
        outputs(instant(counters[INDEX]), y[:coordinates], y[coordinates:states], inputs, p, readings)

    return read


def model_states(states: int) -> Kernel:
    """Make `read(readings, y)`: the states now, of a model without declared outputs."""

    def read(readings, y):
        copy(y, readings, states)

    return read


def model_step(advance: Kernel, instant: Kernel, substeps: int, period: float) -> Kernel:
    """Make `step(inputs, y, p, work, counters)`: the model moves by one period under inputs that are held."""

    def step(inputs, y, p, work, counters):
        advance(instant(counters[INDEX]), y, inputs, p, period, substeps, work)
        count(counters)

    return step
