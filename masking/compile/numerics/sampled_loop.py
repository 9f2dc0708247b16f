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
# ruff: noqa: ANN001, ANN201, ANN202, PLR0915, PLR0917
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
from masking.compile.numerics.runge_kutta import classical_step, copy, fault
from masking.compile.numerics.stop_codes import NOT_FINITE, REACHED
from masking.compile.numerics.virtual_memory import follow_memory, notice_past, recall_past

# Of readings s, which a gain (estimate, sensors) takes into the estimate.
OF_READINGS = ("unit.gain.shape[1] >= len(s)", "work.shape[1] >= len(s)")


class Disturbed(NamedTuple):
    """Parameters of a model, the estimate z with its disturbance, and the length of a step."""

    p: Vector
    z: Vector
    h: float


def _orders(sizes: Sizes) -> tuple[int, int]:
    """Derivatives of a disturbance of the accelerations, and of one of the inputs, that are estimated."""
    return sizes.order if sizes.at_masses else 0, sizes.order if sizes.at_inputs else 0


def predict(rate: Kernel, sizes: Sizes) -> Kernel:
    """Make the step of the controller's model, with the disturbance that was estimated.

    Returns `predict(t, z, u, p, h, k, y, w)`, which moves the estimate z over h under held inputs by the classical
    Runge-Kutta method; the disturbance is taken where it will be in the middle of the step. `k` (4, .), `y` and `w` are
    work space.
    """
    n, size, m, many = sizes.coordinates, sizes.states, sizes.inputs, sizes.disturbed
    order, added = _orders(sizes)
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


def hold(law: Kernel, rate: Kernel, glide: Kernel, mean_jump: Kernel, recall: Kernel, sizes: Sizes) -> Kernel:
    """Make the control law for an output that is held over a sample.

    An output that is held from t to t + h should act as one that follows the law g(t) continuously does. To fourth
    order in h it does, at the instants of the samples, if its value is

        g(t + h/2) - h^2/24 g''(t + h/2) = 4/3 g(t + h/2) - (g(t) + g(t + h)) / 6,

    with g taken along the motion that is wanted. This motion passes the samples with velocities that differ from those
    of the rig by h^2/12 g', since the rig's own velocity runs ahead of and behind it within each sample. g at the
    beginning, the middle and the end of the sample gives all velocities to fourth order; what those with which it was
    found were off by, the output needs to first order only, so that the middle is looked at again for all three.
    Internal states of the model move along it, too. measured: with that of a hysteresis held, its force is late by half
    a sample, which takes 23 % of the amplitude of clocks in 320 s. Those of the virtual system are integrated along it
    by `glide`. Where they jump within the sample, they are shifted by the mean of that, so that the output has the
    impulse of the law. measured: without, chi of clocks with escapements at 500 Hz, on a rig that is known, is 0.035
    instead of 2e-4.

    Returns `hold(t, since, z, past, p, h, u, work) -> health`, which writes the inputs u for an estimate z at time t.
    """
    n, size, m, many = sizes.coordinates, sizes.states, sizes.inputs, sizes.disturbed
    order, added = _orders(sizes)
    fed, has_rates = size + n * sizes.at_masses, n if added > 0 and order > 0 else 0
    remembers, jumping = sizes.remembered + sizes.lags > 0, sizes.events > 0
    first, last = sizes.memory.start, sizes.memory.stop
    saved, spare = (rows.BEFORE, rows.MEMORY) if remembers else (rows.STATE, rows.STATE)
    shifting = rows.JUMPED if jumping else rows.STATE

    @compiled
    def disturbance(z, ahead, d):
        for i in range(n):
            d[i] = z[size + i] if order > 0 else 0.0
        if order > 1:
            for i in range(n):
                d[i] += ahead * z[size + many + i]
        for i in range(has_rates):
            d[n + i] = z[size + many + i] if order > 1 else 0.0

    @compiled
    def remind(t, h, a, y, past, p, space):
        if remembers:
            glide(t, h, a, y, past, p, space)
            recall(t + h, y, past)

    @compiled
    def drift(z, early, late, s0, s2, y):
        for i in range(2 * n, size):
            y[i] = z[i] + early * s0[i] + late * s2[i]

    @compiled
    def shift(y, m):
        if jumping:
            for i in range(first, last):
                y[i] += m[i]

    @compiled
    def held(t, since, z, past, p, h, u, work):
        y, d, v = work[rows.STATE], work[rows.DISTURBANCE][: n + has_rates], work[rows.DESIRED][:n]
        u0, u1, u2 = work[rows.EARLY_INPUTS][:m], work[rows.MIDDLE_INPUTS][:m], work[rows.LATE_INPUTS][:m]
        r0, r1, r2 = work[rows.EARLY][:n], work[rows.MIDDLE][:n], work[rows.LATE][:n]
        g0, g1, g2 = work[rows.EARLY_PART][:n], work[rows.MIDDLE_PART][:n], work[rows.LATE_PART][:n]
        s0, s2 = work[rows.EARLY_RATES], work[rows.LATE_RATES]
        before, space, jumped = work[saved], work[spare:], work[shifting]
        copy(z, y, size)
        remind(t, 0.0, z, y, past, p, space)
        disturbance(z, 0.0, d)
        health = law(t, since, y, d, p, u0, r0, g0)
        rate(t, y, u0, p, s0)
        for i in range(n):
            y[i] = z[i] + h * (z[n + i] + 0.5 * h * r0[i])
            y[n + i] = z[n + i] + h * r0[i]
        if jumping:
            mean_jump(t, h, z, y, past, p, space, jumped)
        drift(z, h, 0.0, s0, s0, y)
        remind(t, h, z, y, past, p, space)
        shift(y, jumped)
        disturbance(z, h, d)
        law(t + h, since, y, d, p, u2, r2, g2)
        rate(t + h, y, u2, p, s2)
        for i in range(n):
            v[i] = z[n + i] + h / 12.0 * (g2[i] - g0[i])
            y[i] = z[i]
            y[n + i] = v[i]
        drift(z, 0.0, 0.0, s0, s2, y)
        remind(t, 0.0, z, y, past, p, space)
        shift(y, jumped)
        copy(y, before, size)
        disturbance(z, 0.0, d)
        law(t, since, y, d, p, u0, r0, g0)
        for i in range(n):
            y[i] = z[i] + 0.5 * h * v[i] + h * h / 48.0 * (5.0 * r0[i] + r2[i])
            y[n + i] = v[i] + h / 8.0 * (3.0 * r0[i] + r2[i])
        drift(z, 0.375 * h, 0.125 * h, s0, s2, y)
        remind(t, 0.5 * h, before, y, past, p, space)
        copy(y, before, size)
        disturbance(z, 0.5 * h, d)
        law(t + 0.5 * h, since, y, d, p, u1, r1, g1)
        for i in range(n):
            y[i] = z[i] + h * v[i] + h * h / 6.0 * (r0[i] + 2.0 * r1[i])
            y[n + i] = v[i] + h * r1[i]
        drift(z, 0.5 * h, 0.5 * h, s0, s2, y)
        remind(t + 0.5 * h, 0.5 * h, before, y, past, p, space)
        disturbance(z, h, d)
        law(t + h, since, y, d, p, u2, r2, g2)
        for i in range(n):
            more = z[n + i] + h / 12.0 * (4.0 * g1[i] - 3.0 * g0[i] - g2[i]) - v[i]
            y[i] = z[i] + 0.5 * h * v[i] + h * h / 48.0 * (5.0 * r0[i] + r2[i])
            y[n + i] = v[i] + 0.75 * more + h / 16.0 * (3.0 * r0[i] + 6.0 * r1[i] - r2[i])
        drift(z, 0.375 * h, 0.125 * h, s0, s2, y)
        if remembers:
            for i in range(first, last):
                y[i] = before[i]
            recall(t + 0.5 * h, y, past)
        disturbance(z, 0.5 * h, d)
        law(t + 0.5 * h, since, y, d, p, u1, r1, g1)
        for i in range(m):
            u[i] = 4.0 / 3.0 * u1[i] - (u0[i] + u2[i]) / 6.0
            u[i] -= z[fed + i] if added > 0 else 0.0
            u[i] -= 0.5 * h * z[fed + many + i] if added > 1 else 0.0
        return health

    return held


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


def control_with_model(parts: Parts, sizes: Sizes) -> Kernel:
    """Make the step of a controller that follows the rig with a model: observe, predict, T, D, L, G, hold, limit.

    What was applied, not what was demanded, moves the model: in saturation nothing winds up. While the rig is at rest
    before homing, the offsets of the sensors follow what they read beyond the model's rest position.

    Returns `control(t, h, s, unit, demanded, applied, work) -> health` for the readings `s` at time t.
    """
    m, length, fixed, last = sizes.inputs, sizes.estimate, sizes.fixed, sizes.states - 1
    powers, following, remembered, rest = sizes.power, sizes.next, sizes.balance, sizes.rest
    is_balanced, offsets, channels = sizes.balanced > 0, sizes.offsets, sizes.actuators
    rate, measure, allocate, wire = parts.rate, parts.measure, parts.allocate, parts.wire
    remembers, recall, notice = sizes.remembered + sizes.lags > 0, recall_past(sizes), notice_past(parts.lagged, sizes)
    (follow, glide, mean_jump), then = follow_memory(parts.remember, recall, parts.conditions, sizes), sizes.past
    observe = observe_past(follow, notice, recall, sizes)
    step, held, limit = predict(rate, sizes), hold(parts.law, rate, glide, mean_jump, recall, sizes), limiter(sizes)
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
    @requires(*OF_READINGS)
    def control(t: float, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix) -> float:
        x, p, gain, table = unit
        now, power, z, queue = x[:length], x[powers.start : powers.stop], x[following.start : following.stop], x[fixed:]
        delay = queue.size // m
        ahead, u, expected = work[rows.AHEAD], work[rows.INPUTS][:m], work[rows.EXPECTED]
        acts, standing, past = t + delay * h, x[rest.start : rest.stop], x[then.start : then.stop]
        measure(t, z, p, expected)
        for j in range(offsets):
            if t < standing[2 * offsets]:
                standing[j] += standing[2 * offsets + 1] * (s[j] - standing[offsets + j] - standing[j])
            expected[j] += standing[j]
        for i in range(length):
            for j in range(s.size):
                z[i] += gain[i, j] * (s[j] - expected[j])
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
        health = held(acts, acts, ahead, past, p, h, u, work)
        allocate(acts, ahead, u, p, demanded)
        if offsets > 0 and acts < standing[2 * offsets]:
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
