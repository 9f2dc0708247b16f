"""Kernels along a known motion: places and readings, a law with its derivatives, and first-order responses of sensors.

Forces of latent sources on degrees of freedom stand beside the states (count, n + forces); `ports` are the indices of
these forces in the parameter array. Functions of a rig are those of `motion_sensitivities`, and
`placed(t, y, u, p, d, by_state)`, which writes displacements and then rates of places, with derivatives.
"""
# ruff: noqa: ANN001, ANN201, PLR0912, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import IntVector, Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.effect_table import (
    BY_PARAMETER,
    BY_STATE,
    LAW_ROWS,
    MOST_STATES,
    NEARLY_ZERO,
    RATES,
    VALUE,
)
from masking.compile.numerics.kernel_arguments import Blocks, Course, KnownMotion, Pieces, Sources
from masking.compile.numerics.motion_sensitivities import take
from masking.compile.numerics.runge_kutta import copy

ROUNDED = 1e-15  # exponent below which its exponential is linear to the last bit
ALIKE = 1e-4  # difference of exponents below which two are one


def places_along(derivative: Kernel, placed: Kernel) -> Kernel:
    """Make the motion of places.

    Returns `follow(count, dt, coordinates, ports, p, motion, moved, work)`, which writes displacements, rates and
    accelerations of the places (count, 3 places).
    """

    @compiled
    @requires(
        "count <= min(len(motion.states), len(motion.commands), len(moved)) and within(ports, len(p))",
        "motion.states.shape[1] - len(ports) >= max(linked.y, linked.rate) and motion.commands.shape[1] >= linked.u",
        "(places := moved.shape[1] // 3) * 2 >= linked.d and len(p) >= linked.p and coordinates >= 0",
        "len(work) >= 2 * places + 2 and work.shape[1] >= max(linked.width, 2 * places, 2 * coordinates)",
    )
    def follow(
        count: int, dt: float, coordinates: int, ports: IntVector, p: Vector, motion: KnownMotion, moved: Matrix,
        work: Matrix,
    ) -> None:  # fmt: skip
        states, commands = motion
        n, places = states.shape[1] - ports.size, moved.shape[1] // 3
        work[:] = 0.0
        followed, work = take(work, 2 * places)
        d, rate = work[0], work[1]
        for index in range(count):
            for i in range(ports.size):
                p[ports[i]] = states[index, n + i]
            placed(index * dt, states[index], commands[index], p, d, followed)
            derivative(index * dt, states[index], commands[index], p, rate)
            for e in range(places):
                moved[index, e] = d[e]
                moved[index, places + e] = d[places + e]
                total = 0.0
                for i in range(coordinates):
                    total += followed[e, i] * rate[coordinates + i]
                moved[index, 2 * places + e] = total

    return follow


def readings_along(sensed: Kernel) -> Kernel:
    """Make `read(count, dt, ports, p, motion, readings, work)`, which writes readings (count, sensors) along states."""

    @compiled
    @requires(
        "count <= min(len(motion.states), len(motion.commands), len(readings)) and within(ports, len(p))",
        "motion.states.shape[1] - len(ports) >= linked.y and motion.commands.shape[1] >= linked.u",
        "(sensors := readings.shape[1]) >= linked.s and len(p) >= linked.p",
        "len(work) >= 2 * sensors + 2 and work.shape[1] >= max(linked.width, sensors)",
    )
    def read(
        count: int, dt: float, ports: IntVector, p: Vector, motion: KnownMotion, readings: Matrix, work: Matrix
    ) -> None:
        states, commands = motion
        n, sensors = states.shape[1] - ports.size, readings.shape[1]
        work[:] = 0.0
        by_state, work = take(work, sensors)
        by_entry, work = take(work, sensors)
        noise, s = work[0], work[1]
        for index in range(count):
            for i in range(ports.size):
                p[ports[i]] = states[index, n + i]
            sensed(index * dt, states[index], commands[index], p, noise, s, by_state, by_entry)
            copy(s, readings[index], sensors)

    return read


@compiled
def relaxed(h: float, decay: float) -> float:
    """Integral of exp(decay s) over s from 0 to h."""
    return math.expm1(decay * h) / decay if abs(decay * h) > ROUNDED else h


@compiled
@requires("len(rates) == len(weight) == 2 and rates.shape[1] == weight.shape[1] == 2")
def relaxing(h: float, rates: Matrix, weight: Matrix) -> None:
    """Write the integral of exp(A s) over s from 0 to h into `weight`, for A (2, 2) in `rates`.

    For eigenvalues m + q and m - q it is f I + g (A - m I): f is the mean of the two integrals, g their difference over
    2 q. Where they are nearly the same, they are taken a ten-thousandth of 1/h apart.
    """
    if rates[0, 1] == rates[1, 0] == 0.0:  # measured: most effects have one state, and screens follow thousands
        weight[0, 0], weight[0, 1] = relaxed(h, rates[0, 0]), 0.0
        weight[1, 0], weight[1, 1] = 0.0, relaxed(h, rates[1, 1])
        return
    apart, mean = 0.5 * (rates[0, 0] - rates[1, 1]), 0.5 * (rates[0, 0] + rates[1, 1])
    square = apart**2 + rates[0, 1] * rates[1, 0]
    q = max(math.sqrt(abs(square)), ALIKE / h)
    if square < -((ALIKE / h) ** 2):  # a pair of complex ones
        real = math.exp(mean * h) * math.cos(q * h) - 1.0
        imaginary = math.exp(mean * h) * math.sin(q * h)
        size = mean**2 + q**2
        f, g = (real * mean + imaginary * q) / size, (imaginary * mean - real * q) / (size * q)
    else:
        one, other = relaxed(h, mean + q), relaxed(h, mean - q)
        f, g = 0.5 * (one + other), 0.5 * (one - other) / q
    weight[0, 0], weight[0, 1] = f + g * apart, g * rates[0, 1]
    weight[1, 0], weight[1, 1] = g * rates[1, 0], f - g * apart


def law_along(law: Kernel) -> Kernel:
    """Make the value of a law with states along a motion, and its derivatives by parameters.

    The states are integrated by the exponential midpoint rule, with the law linearised in the middle of
    each piece: second order, exact where the law is linear in its states, and stable however fast these decay.
    Source: Hochbruck and Ostermann (2010), Acta Numerica 19, 209-286, section 2.

    Returns `follow(span, number, course, parameters, values, features, work)`, which writes `features` (count, 1 + c):
    the value, then its derivatives by the parameters with indices `parameters` (c,).
    """

    @compiled
    @requires(
        "span.samples <= min(len(course.x), len(course.rate), len(features))",
        f"0 < features.shape[1] <= len(parameters) + 1 and within(parameters, work.shape[1] - {BY_PARAMETER})",
        "len(values) >= linked.case('theta', number)",
        f"len(work) >= {2 * (LAW_ROWS + MOST_STATES)} and work.shape[1] >= max(linked.width, features.shape[1], 2)",
    )
    def follow(
        span: Pieces, number: int, course: Course, parameters: IntVector, values: Vector,
        features: Matrix, work: Matrix,
    ) -> None:  # fmt: skip
        count, dt, pieces = span
        x, rate = course
        rows, work = take(work, LAW_ROWS)
        later, work = take(work, LAW_ROWS)
        dz, work = take(work, MOST_STATES)
        many, h, z, w = features.shape[1], dt / pieces, NEARLY_ZERO, NEARLY_ZERO
        a, weight = later[RATES:, BY_STATE:BY_PARAMETER], work[:MOST_STATES, :MOST_STATES]
        dz[:] = 0.0
        for index in range(count):
            t = index * dt
            law(number, t, x[index], rate[index], z, w, values, rows)
            features[index, 0] = rows[0, VALUE]
            for j in range(1, many):
                through = rows[0, BY_STATE] * dz[0, j] + rows[0, BY_STATE + 1] * dz[1, j]
                features[index, j] = through + rows[0, BY_PARAMETER + parameters[j - 1]]
            if index < count - 1:
                for piece in range(pieces):
                    share = (piece + 0.5) / pieces
                    px = x[index] + share * (x[index + 1] - x[index])
                    pr = rate[index] + share * (rate[index + 1] - rate[index])
                    law(number, t + share * dt, px, pr, z, w, values, later)
                    relaxing(0.5 * h, a, weight)
                    half, beside = z, w
                    half += weight[0, 0] * later[RATES, VALUE] + weight[0, 1] * later[RATES + 1, VALUE]
                    beside += weight[1, 0] * later[RATES, VALUE] + weight[1, 1] * later[RATES + 1, VALUE]
                    law(number, t + share * dt, px, pr, half, beside, values, later)
                    relaxing(h, a, weight)
                    for j in range(1, many):
                        p = BY_PARAMETER + parameters[j - 1]
                        one = a[0, 0] * dz[0, j] + a[0, 1] * dz[1, j] + later[RATES, p]
                        other = a[1, 0] * dz[0, j] + a[1, 1] * dz[1, j] + later[RATES + 1, p]
                        dz[0, j] += weight[0, 0] * one + weight[0, 1] * other
                        dz[1, j] += weight[1, 0] * one + weight[1, 1] * other
                    one = later[RATES, VALUE] + a[0, 0] * (z - half) + a[0, 1] * (w - beside)
                    other = later[RATES + 1, VALUE] + a[1, 0] * (z - half) + a[1, 1] * (w - beside)
                    z += weight[0, 0] * one + weight[0, 1] * other
                    w += weight[1, 0] * one + weight[1, 1] * other

    return follow


@compiled
def transition(by_state, h, phi, product):
    """Write exp(A 4 h) - 1 into phi (n, n): that of h to the third order, doubled twice."""
    n = phi.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += by_state[i, m] * by_state[m, j]
            product[i, j] = total
    for i in range(n):
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += by_state[i, m] * product[m, j]
            phi[i, j] = h * by_state[i, j] + 0.5 * h * h * product[i, j] + h * h * h / 6.0 * total
    for _ in range(2):
        for i in range(n):
            for j in range(n):
                total = 2.0 * phi[i, j]
                for m in range(n):
                    total += phi[i, m] * phi[m, j]
                product[i, j] = total
        for i in range(n):
            copy(product[i], phi[i], n)


def linear_responses(slopes: Kernel, sensed: Kernel) -> Kernel:
    """Make the first-order response of the sensors to forces and to initial states, along a motion.

    Returns `respond(blocks, is_direct, sources, motion, p, features, means, work)` for M responses: to the force
    `features` (count, M) at the entry of its source, or from its initial state at 1 at the begin of each interval.
    `means` (count / every, sensors M) gets means over `every` samples. `is_direct` is 1 if readings depend on entries
    of the parameter array at once.
    """

    @compiled
    @requires(
        "(n := motion.states.shape[1]) >= max(linked.y, linked.rate) and motion.commands.shape[1] >= linked.u",
        "blocks.samples <= min(len(motion.states), len(motion.commands), len(features)) and len(p) >= linked.p",
        "0 < (many := features.shape[1]) <= min(len(sources.entries), len(sources.initial))",
        "(sensors := means.shape[1] // many) >= linked.s and blocks.every > 0 and blocks.interval > 0",
        "within(sources.entries, work.shape[1]) and len(work) >= 6 * n + 2 * sensors + 3",
        "work.shape[1] >= max(linked.width, n, many, sensors)",
    )
    def respond(
        blocks: Blocks, is_direct: int, sources: Sources, motion: KnownMotion, p: Vector, features: Matrix,
        means: Matrix, work: Matrix,
    ) -> None:  # fmt: skip
        count, dt, every, interval = blocks
        entries, initial = sources
        states, commands = motion
        n, many = states.shape[1], features.shape[1]
        sensors = means.shape[1] // many
        work[:] = 0.0
        means[:] = 0.0
        by_state, work = take(work, n)
        by_entry, work = take(work, n)
        read_by_state, work = take(work, sensors)
        read_by_entry, work = take(work, sensors)
        transitions, work = take(work, 2 * n)
        phi, product = transitions[:n, :n], transitions[n:, :n]
        e, work = take(work, n)
        f, work = take(work, n)
        rate, s, noise = work[0], work[1], work[2]
        for index in range(count):
            t = index * dt
            is_first = index % interval == 0
            if is_first:
                for i in range(n):
                    for m in range(many):
                        e[i, m] = 1.0 if initial[m] == i else 0.0
            slopes(t, states[index], commands[index], p, rate, by_state, by_entry)
            sensed(t, states[index], commands[index], p, noise, s, read_by_state, read_by_entry)
            if not is_first:  # the half of the force that comes with this sample
                for i in range(n):
                    for m in range(many):
                        e[i, m] += 0.5 * dt * by_entry[i, entries[m]] * features[index, m]
            block = index // every
            if block < means.shape[0]:
                for o in range(sensors):
                    for i in range(n):
                        by = read_by_state[o, i] / every
                        if by != 0.0:
                            for m in range(many):
                                means[block, o * many + m] += by * e[i, m]
                    if is_direct:
                        for m in range(many):
                            means[block, o * many + m] += read_by_entry[o, entries[m]] * features[index, m] / every
            for i in range(n):
                for m in range(many):
                    e[i, m] += 0.5 * dt * by_entry[i, entries[m]] * features[index, m]
            transition(by_state[:, :n], 0.25 * dt, phi, product)
            for i in range(n):
                copy(e[i], f[i], many)
                for j in range(n):
                    by = phi[i, j]
                    if by != 0.0:
                        for m in range(many):
                            f[i, m] += by * e[j, m]
            for i in range(n):
                copy(f[i], e[i], many)

    return respond
