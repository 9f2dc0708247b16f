"""Kernels of a controller that runs at a fixed rate: it observes, predicts, holds its output, and stays in its limits.

Each function here takes compiled functions of a rig and a control law and returns a kernel, which numba compiles
together with them. Their arguments, with y = [q, v, s] the rig's state (coordinates, velocities, internal states):

* `law(t, since, y, d, p, u, r, g) -> health` writes the inputs u, the accelerations r (n,) that they give, and the part
  g (n,) of r that is due to the inputs; `since` is the time since the release at which the inputs begin to act, and d
  (n,) the accelerations that the model lacks, with their rates behind them (2 n,) where inputs have disturbances, too;
* `rate(t, y, u, p, dy)` writes dy/dt of the controller's model;
* `measure(t, y, p, s)` writes what the sensors would read;
* `allocate(t, y, u, p, out)` writes the actuators' commands that give inputs u, and `wire(t, y, out, p, u)` the
  reverse;
* `virtual` and `momentum` are those of `masking.compile.numerics.energy_balance`, `remember`, `lagged` and
  `conditions` of `virtual_memory`.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0917
# The types are numba's to infer, and what a kernel calls stands before it.

from __future__ import annotations

import math
from typing import NamedTuple

from masking.compile.numerics import controller_rows as rows
from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER, TIME, Sizes
from masking.compile.numerics.energy_balance import energy_balance
from masking.compile.numerics.kernel_arguments import Parts, Recorded, Rig, Samples, UnderWay, Unit
from masking.compile.numerics.output_hold import hold, orders
from masking.compile.numerics.runge_kutta import classical_step, copy, fault
from masking.compile.numerics.stop_codes import NOT_FINITE, REACHED
from masking.compile.numerics.virtual_memory import follow_memory, notice_past, recall_past

LOUDER = 1.5  # times the noise for which an observer is designed: beyond, one for twice as much is taken
# Of readings s, which a gain (estimate, sensors) takes into the estimate.
OF_READINGS = ("unit.gain.shape[1] >= len(s)", "work.shape[1] >= len(s)")


class Disturbed(NamedTuple):
    """Parameters of a model, the estimate z with its disturbance, and the length of a step."""

    p: Vector
    z: Vector
    h: float


def predict(rate: Kernel, sizes: Sizes) -> Kernel:
    """Make the step of the controller's model, with the disturbance that was estimated.

    Returns `predict(t, z, u, p, h, k, y, w)`, which moves the estimate z over h under held inputs by the classical
    Runge-Kutta method; the disturbance is taken where it will be in the middle of the step. `k` (4, .), `y` and `w` are
    work space.
    """
    n, size, m, many = sizes.coordinates, sizes.states, sizes.inputs, sizes.disturbed
    order, added = orders(sizes)
    fed, lasting = size + n * sizes.at_masses, sizes.order  # where what adds to the inputs is

    @compiled
    def slope(t, stage, y, u, known, dy):
        z = known.z
        rate(t, y, u, known.p, dy)
        if order > 0:
            for i in range(n):
                dy[n + i] += z[size + i]
        if order > 1:
            for i in range(n):
                dy[n + i] += 0.5 * known.h * z[size + many + i]

    advance = classical_step(slope, size)

    @compiled
    def step(t, z, u, p, h, k, y, w):
        if added > 0:
            for i in range(m):
                w[i] = u[i] + z[fed + i]
            if added > 1:
                for i in range(m):
                    w[i] += 0.5 * h * z[fed + many + i]
            advance(t, z, w, Disturbed(p, z, h), h, k, y)
        else:
            advance(t, z, u, Disturbed(p, z, h), h, k, y)
        if lasting > 1:
            for i in range(many):
                z[size + i] += h * z[size + many + i]

    return step


def limiter(sizes: Sizes) -> Kernel:
    """Make the last step before the actuators: largest command, then largest mean power.

    The mean power P of an actuator whose power is `heating` times its squared command c follows
    P' = (heating c^2 - P) / time, solved exactly over a sample in which c is held; a command is made so small that P
    stays within its limit at the next sample.

    Returns `limit(demanded, table, power, h, applied)`, with `table` (actuators, 4) and the mean powers `power`, which
    are brought to the next sample.
    """
    count, warm = sizes.actuators, heat(sizes)

    @compiled
    def limit(demanded, table, power, h, applied):
        for i in range(count):
            most = table[i, LARGEST]
            heating, part = table[i, HEATING], -math.expm1(-h / table[i, TIME])
            if heating > 0.0:
                free = max(0.0, (table[i, POWER] - (1.0 - part) * power[i]) / (part * heating))
                most = min(most, math.sqrt(free))
            applied[i] = min(max(demanded[i], -most), most)
        warm(applied, table, h, power)

    return limit


def heat(sizes: Sizes) -> Kernel:
    """Make the step of the mean powers: `heat(command, table, h, power)`, for a command (actuators,) held over h."""
    count = sizes.actuators

    @compiled
    def warm(command, table, h, power):
        for i in range(count):
            part = -math.expm1(-h / table[i, TIME])
            power[i] += part * (table[i, HEATING] * command[i] * command[i] - power[i])

    return warm


@compiled
def advance_queue(queue, u, m):
    """Take the oldest inputs (m,) from those under way, and add the newest."""
    last = queue.size - m
    for j in range(last):
        queue[j] = queue[j + m]
    if last >= 0:
        copy(u, queue[last:], m)


def observe_past(follow: Kernel, notice: Kernel, recall: Kernel, sizes: Sizes) -> Kernel:
    """Make `observe(t, h, x, z, p, work)`, which brings the memory of a virtual system to an estimate z at a sample."""
    remembers, length, then = sizes.remembered + sizes.lags > 0, sizes.estimate, sizes.past

    @compiled
    def observe(t, h, x, z, p, work):
        if remembers:
            past = x[then.start : then.stop]
            follow(t - h, h, x[:length], z, past, p, work[rows.MEMORY :])
            notice(t, z, past, p, work[rows.MEMORY])
            recall(t, z, past)

    return observe


def stand_still(sizes: Sizes) -> Kernel:
    """Make `stand(t, s, standing, expected, first, levels) -> level`, what is measured of the sensors at rest.

    Before homing, their offsets follow what they read beyond the model's rest position, their noise the differences of
    readings. Where the same place would have given `first` at the first reading, a known drift is no offset. The level
    says how many times the noise is that for which the observer is designed, as a power of 2 below `levels`. `standing`
    holds the time at which the rest ends, the part of a difference that a sample corrects, the time of the first
    reading, and of each sensor the reading at rest without offset, the inverse of its variance, the offset, the last
    reading, and the variance in parts of the one that was expected, which is negative before the first reading.
    """
    count, louder = sizes.offsets, LOUDER**2

    @compiled
    def stand(t, s, standing, expected, first, levels):
        level, loudest = 0, 0.0
        for j in range(count):
            k = 3 + 5 * j
            if t < standing[0]:
                step = s[j] - standing[k + 3]
                still = standing[k] + expected[j] - first[j]
                standing[k + 2] += standing[1] * (s[j] - still - standing[k + 2])
                if standing[k + 4] < 0.0:
                    standing[k + 4] = 0.0
                else:
                    standing[k + 4] += standing[1] * (0.5 * step * step * standing[k + 1] - standing[k + 4])
                standing[k + 3] = s[j]
            expected[j] += standing[k + 2]
            loudest = max(loudest, standing[k + 4])
        for _ in range(levels - 1):
            if loudest > louder:
                level += 1
                loudest /= 4.0
        return level

    return stand


def control_with_model(parts: Parts, sizes: Sizes) -> Kernel:
    """Make the step of a controller that follows the rig with a model: observe, predict, T, D, L, G, hold, limit.

    What was applied, not what was demanded, moves the model: in saturation nothing winds up. At rest before homing, the
    sensors are measured as `stand_still` says; the gain has rows (estimate,) for each level of noise.

    Returns `control(t, h, s, unit, demanded, applied, work) -> health` for the readings `s` at time t.
    """
    m, length, fixed, last = sizes.inputs, sizes.estimate, sizes.fixed, sizes.states - 1
    powers, following, remembered, rest, changed = sizes.power, sizes.next, sizes.balance, sizes.rest, sizes.change
    is_balanced, offsets, channels = sizes.balanced > 0, sizes.offsets, sizes.actuators
    rate, measure, allocate, wire = parts.rate, parts.measure, parts.allocate, parts.wire
    remembers, recall, notice = sizes.remembered + sizes.lags > 0, recall_past(sizes), notice_past(parts.lagged, sizes)
    (follow, glide, mean_jump), then = follow_memory(parts.remember, recall, parts.conditions, sizes), sizes.past
    observe = observe_past(follow, notice, recall, sizes)
    stand = stand_still(sizes)
    step, held, limit = predict(rate, sizes), hold(parts.law, rate, (glide, mean_jump, recall), sizes), limiter(sizes)
    balance = energy_balance(parts.virtual, parts.momentum, sizes)

    @compiled
    def move(t, z, u, past, p, h, work):
        if remembers:
            copy(z, work[rows.BEFORE], length)
        step(t, z, u, p, h, work[rows.SLOPES : rows.STAGE], work[rows.STAGE], work[rows.DISTURBANCE])
        if remembers:
            follow(t, h, work[rows.BEFORE], z, past, p, work[rows.MEMORY :])
            notice(t + h, z, past, p, work[rows.MEMORY])

    @compiled
    @requires(*OF_READINGS, f"unit.gain.shape[0] >= {length}")
    def control(t: float, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix) -> float:
        x, p, gain, table = unit
        now, power, z, queue = x[:length], x[powers.start : powers.stop], x[following.start : following.stop], x[fixed:]
        delay = queue.size // m
        ahead, u, expected = work[rows.AHEAD], work[rows.INPUTS][:m], work[rows.EXPECTED]
        acts, standing, past = t + delay * h, x[rest.start : rest.stop], x[then.start : then.stop]
        measure(t, z, p, expected)
        if offsets > 0 and t < standing[0]:
            measure(standing[2], z, p, work[rows.AT_FIRST])
        first = length * stand(t, s, standing, expected, work[rows.AT_FIRST], gain.shape[0] // length)
        for i in range(length):
            for j in range(s.size):
                z[i] += gain[first + i, j] * (s[j] - expected[j])
        observe(t, h, x, z, p, work)
        if is_balanced:
            balanced, momentum = work[rows.BALANCED], work[rows.MOMENTUM]
            z[last] = balance(t, h, z, x[remembered.start : remembered.stop], p, balanced, momentum)
        copy(z, now, length)
        copy(z, ahead, length)
        for j in range(delay):
            move(t + j * h, ahead, queue[j * m : (j + 1) * m], past, p, h, work)
            if j == 0:
                copy(ahead, z, length)
        health = held(acts, acts, ahead, past, x[changed.start : changed.stop], p, h, u, work)
        allocate(acts, ahead, u, p, demanded)
        if offsets > 0 and acts < standing[0]:
            for i in range(channels):
                demanded[i] = 0.0
        limit(demanded, table, power, h, applied)
        wire(acts, ahead, applied, p, u)
        if delay == 0:
            move(t, z, u, past, p, h, work)
        advance_queue(queue, u, m)
        return health

    return control


def skip_with_differences(remember: Kernel, lagged: Kernel, conditions: Kernel, sizes: Sizes) -> Kernel:
    """Make the step of a sample that was missed: the rig is taken to move on at its last velocity.

    Returns `skip(t, h, x, p, table, command, work)` for a missed sample at time t; `command` (actuators,) is the last.
    """
    n, length = sizes.coordinates, sizes.estimate
    next_one, warm = length + sizes.actuators, heat(sizes)
    recall, notice = recall_past(sizes), notice_past(lagged, sizes)
    follow, _, _ = follow_memory(remember, recall, conditions, sizes)
    observe = observe_past(follow, notice, recall, sizes)

    @compiled
    def skip(t: float, h: float, x: Vector, p: Vector, table: Matrix, command: Vector, work: Matrix) -> None:
        now, power, z = x[:length], x[length:next_one], x[next_one : next_one + length]
        for i in range(n):
            z[i] += h * z[n + i]
        observe(t, h, x, z, p, work)
        copy(z, now, length)
        warm(command, table, h, power)

    return skip


def control_with_differences(
    law: Kernel, allocate: Kernel, remember: Kernel, lagged: Kernel, conditions: Kernel, sizes: Sizes
) -> Kernel:
    """Make the step of a controller that differences the positions and applies the law at once.

    Source: Rijlaarsdam (2008), chapter 6; its velocities are late by half a sample, its output by half a sample more.

    Returns:
        `control` as that of `control_with_model`, whose memory holds the last coordinates where that has its estimate.
    """
    n, m, length, fixed = sizes.coordinates, sizes.inputs, sizes.estimate, sizes.fixed
    next_one = length + sizes.actuators
    limit, recall, notice = limiter(sizes), recall_past(sizes), notice_past(lagged, sizes)
    follow, _, _ = follow_memory(remember, recall, conditions, sizes)
    observe = observe_past(follow, notice, recall, sizes)

    @compiled
    @requires(*OF_READINGS)
    def control(t: float, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix) -> float:
        x, p, gain, table = unit
        now, power, z = x[:length], x[length:next_one], x[next_one : next_one + length]
        d, u = work[rows.DISTURBANCE][:n], work[rows.EARLY_INPUTS][:m]
        r, g = work[rows.EARLY][:n], work[rows.EARLY_PART][:n]
        for i in range(n):
            position = 0.0
            for j in range(s.size):
                position += gain[i, j] * s[j]
            z[n + i] = (position - z[i]) / h
            z[i] = position
            d[i] = 0.0
        observe(t, h, x, z, p, work)
        copy(z, now, length)
        acts = t + (x.size - fixed) // m * h
        health = law(t, acts, z, d, p, u, r, g)
        allocate(acts, z, u, p, demanded)
        limit(demanded, table, power, h, applied)
        return health

    return control


def run(sense: Kernel, control: Kernel, move: Kernel, size: int) -> Kernel:
    """Make the loop of a sampled controller and a simulated rig.

    At sample k, at time k h, the sensors are read, the controller answers, and its command joins those under way; the
    rig then moves for h. `sense(t, y, p, noise, s)` writes the readings s of a state y for unit normal samples `noise`;
    `move` moves the rig of `size` states under the commands under way, as that of `runge_kutta.steps_under_way`.

    Returns `run(samples, rig, unit, noise, first, recorded, work) -> (status, samples done, first)`; `noise` (count,
    sensors); row k // every of the tables gets what happened at sample k, from sample 0 on; `first` as for
    `runge_kutta.sampled`.
    """

    @compiled
    @requires(
        "samples.every > 0",
        "len(noise) >= samples.samples and len(rig.queue) > 0",
        "(sensors := noise.shape[1]) <= min(work.shape[1], unit.gain.shape[1], recorded.sensed.shape[1])",
        "(channels := rig.queue.shape[1]) <= min(work.shape[1], len(rig.late))",
        "channels <= min(recorded.demanded.shape[1], recorded.applied.shape[1])",
        "recorded.estimates.shape[1] <= len(unit.x)",
        "(begin := max(samples.begin, 0)) >= 0",
        "(rows := kept(begin, samples.begin + samples.samples - begin, samples.every)) <= len(recorded.states)",
        "rows <= min(len(recorded.estimates), len(recorded.sensed), len(recorded.demanded), len(recorded.applied))",
    )
    def loop(
        samples: Samples, rig: Rig, unit: Unit, noise: Matrix, first: float, recorded: Recorded, work: Matrix
    ) -> tuple[int, int, float]:
        begin, count, h, substeps, every = samples
        y, p, queue, late = rig
        under_way = UnderWay(queue, late)
        sensors, channels = noise.shape[1], queue.shape[1]
        s, wanted = work[rows.SENSED][:sensors], work[rows.DEMANDED][:channels]
        given, stages = work[rows.APPLIED][:channels], work[rows.SLOPES : rows.STAGE + 1]
        row = 0
        for index in range(begin, begin + count):
            t = index * h
            sense(t, y, p, noise[index - begin], s)
            health = control(t, h, s, unit, wanted, given, work)
            first = health if first == 0.0 else first
            status = fault(health, first)
            if status != REACHED:
                return status, index - begin, first
            for i in range(channels):
                if not math.isfinite(given[i]):
                    return NOT_FINITE, index - begin, first
            if index >= 0 and index % every == 0:
                copy(y, recorded.states[row], size)
                copy(unit.x, recorded.estimates[row], recorded.estimates.shape[1])
                copy(s, recorded.sensed[row], sensors)
                copy(wanted, recorded.demanded[row], channels)
                copy(given, recorded.applied[row], channels)
                row += 1
            copy(given, queue[queue.shape[0] - 1], channels)
            move(t, y, under_way, p, h, substeps, given, stages)
        return REACHED, count, first

    return loop


def transforms(transform: Kernel, count: int) -> Kernel:
    """Make `transforms(times, states, p, virtual)`, which transforms each state [q, v, s] of a rig.

    `transform(t, q, v, p, out)` writes the virtual state of one with `count` coordinates.
    """

    @compiled
    @requires("min(len(states), len(virtual)) >= len(times)")
    def every(times: Vector, states: Matrix, p: Vector, virtual: Matrix) -> None:
        for i in range(times.size):
            transform(times[i], states[i, :count], states[i, count:], p, virtual[i])

    return every


def along(transform: Kernel, step: Kernel, count: int) -> Kernel:
    """Make `along(times, states, p, virtual, inputs)`: virtual states and inputs of a controller along a motion.

    `transform` is as for `transforms`, and `step(t, q, v, u, p)` writes the inputs.
    """

    @compiled
    @requires("min(len(states), len(virtual), len(inputs)) >= len(times)")
    def every(times: Vector, states: Matrix, p: Vector, virtual: Matrix, inputs: Matrix) -> None:
        for i in range(times.size):
            transform(times[i], states[i, :count], states[i, count:], p, virtual[i])
            step(times[i], states[i, :count], states[i, count:], inputs[i], p)

    return every
