"""Hold: the value of an output that is held over a sample, so that it acts as one that follows the law continuously.

An output that is held from t to t + h should act as one that follows the law g(t) continuously does. To fourth order in
h it does, at the instants of the samples, if its value is

    g(t + h/2) - h^2/24 g''(t + h/2) = 4/3 g(t + h/2) - (g(t) + g(t + h)) / 6,

with g taken along the motion that is wanted. This motion passes the samples in states that differ from those of the rig
by h^2/12 dg/dt, g being what the output adds to their rates, since the rig runs ahead of and behind it within each
sample. So g and the motion are found from each other.

The functions that these kernels take are those of `sampled_loop` and `virtual_memory`.
"""
# ruff: noqa: ANN001, ANN202, PLR0915, PLR0917
# The types are numba's to infer, and what a kernel calls stands before it.

from __future__ import annotations

from typing import NamedTuple

from masking.compile.numerics import controller_rows as rows
from masking.compile.numerics.arrays import Kernel
from masking.compile.numerics.compilation import compiled
from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.runge_kutta import copy

PASSES = 2  # in which inputs behind dynamics and the motion are found from each other


class _Along(NamedTuple):
    """What both holds do along the motion that is wanted."""

    disturbance: Kernel  # (z, ahead, d): accelerations that the model lacks, and their rates
    remind: Kernel  # (t, h, a, y, past, p, space): internal states of the virtual system over h from a state a on
    shift: Kernel  # (y, m): these, shifted by the mean of their jumps
    settle: Kernel  # (z, h, u0, u1, u2, u): the output by the law at the beginning, the middle and the end


def orders(sizes: Sizes) -> tuple[int, int]:
    """Derivatives of a disturbance of the accelerations, and of one of the inputs, that are estimated."""
    return sizes.order if sizes.at_masses else 0, sizes.order if sizes.at_inputs else 0


def hold(law: Kernel, rate: Kernel, memory: tuple[Kernel, Kernel, Kernel], sizes: Sizes) -> Kernel:
    """Make the control law for an output that is held over a sample; `memory` are `glide`, `mean_jump` and `recall`.

    Returns `hold(t, since, z, past, change, p, h, u, work) -> health`, which writes the inputs u for an estimate z at
    time t, and, where they act through dynamics of their own, by how much they change in a sample, which it reads, too.
    """
    made = _behind if sizes.at_inputs else _direct
    return made(law, rate, memory, _along(memory, sizes), sizes)


def _along(memory: tuple[Kernel, Kernel, Kernel], sizes: Sizes) -> _Along:
    glide, _, recall = memory
    n, size, m, many = sizes.coordinates, sizes.states, sizes.inputs, sizes.disturbed
    order, added = orders(sizes)
    fed, has_rates = size + n * sizes.at_masses, n if added > 0 and order > 0 else 0
    remembers, jumping = sizes.remembered + sizes.lags > 0, sizes.events > 0
    first, last = sizes.memory.start, sizes.memory.stop

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
    def shift(y, m):
        if jumping:
            for i in range(first, last):
                y[i] += m[i]

    @compiled
    def settle(z, h, u0, u1, u2, u):
        for i in range(m):
            u[i] = 4.0 / 3.0 * u1[i] - (u0[i] + u2[i]) / 6.0
            u[i] -= z[fed + i] if added > 0 else 0.0
            u[i] -= 0.5 * h * z[fed + many + i] if added > 1 else 0.0

    return _Along(disturbance, remind, shift, settle)


def _rows(sizes: Sizes) -> tuple[int, int, int]:
    """Rows of the state before, of the work space of the virtual system's memory, and of its mean jump."""
    saved, spare = (rows.BEFORE, rows.MEMORY) if sizes.remembered + sizes.lags > 0 else (rows.STATE, rows.STATE)
    return saved, spare, rows.JUMPED if sizes.events else rows.STATE


def _direct(law: Kernel, rate: Kernel, memory: tuple[Kernel, Kernel, Kernel], along: _Along, sizes: Sizes) -> Kernel:
    """Make the hold of inputs that act on each acceleration at once.

    g at the beginning, the middle and the end of the sample gives all velocities to fourth order; what those with which
    it was found were off by, the output needs to first order only, so that the middle is looked at again for all three.
    Internal states of the model move along the motion, too. measured: with that of a hysteresis held, its force is late
    by half a sample, which takes 23 % of the amplitude of clocks in 320 s. Those of the virtual system are integrated
    along it by `glide`. Where they jump within the sample, they are shifted by the mean of that, so that the output has
    the impulse of the law. measured: without, chi of clocks with escapements at 500 Hz, on a rig that is known, is
    0.035 instead of 2e-4.
    """
    (_, mean_jump, recall), (disturbance, remind, shift, settle) = memory, along
    n, size, m = sizes.coordinates, sizes.states, sizes.inputs
    remembers, jumping = sizes.remembered + sizes.lags > 0, sizes.events > 0
    first, last = sizes.memory.start, sizes.memory.stop
    saved, spare, shifting = _rows(sizes)

    @compiled
    def drift(z, early, late, s0, s2, y):
        for i in range(2 * n, size):
            y[i] = z[i] + early * s0[i] + late * s2[i]

    @compiled
    def held(t, since, z, past, change, p, h, u, work):
        y, d, v = work[rows.STATE], work[rows.DISTURBANCE][:n], work[rows.DESIRED][:n]
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
        settle(z, h, u0, u1, u2, u)
        return health

    return held


def _behind(law: Kernel, rate: Kernel, memory: tuple[Kernel, Kernel, Kernel], along: _Along, sizes: Sizes) -> Kernel:
    """Make the hold of inputs that act through dynamics of their own.

    What cancels these dynamics is by far larger than what is wanted of them, and what a state that is off makes of it
    must not count: the motion is found in passes. measured: a hydraulic rig of 431 rad/s, approached with 80 rad/s at
    8 kHz, swings as a pendulum of 6 rad/s with chi 3e-4 over 5 s; where its internal states are those at the samples,
    it stops instead.
    """
    (_, mean_jump, _), (disturbance, remind, shift, settle) = memory, along
    n, size, m = sizes.coordinates, sizes.states, sizes.inputs
    is_forced, jumping = orders(sizes)[0] > 0, sizes.events > 0
    width = 2 * n if is_forced else n
    saved, spare, shifting = _rows(sizes)

    @compiled
    def flow(t, y, u, d, p, f):
        rate(t, y, u, p, f)
        if is_forced:
            for i in range(n):
                f[n + i] += d[i]

    @compiled
    def held(t, since, z, past, change, p, h, u, work):
        y, base, d = work[rows.STATE], work[rows.SMOOTH], work[rows.DISTURBANCE][:width]
        u0, u1, u2 = work[rows.EARLY_INPUTS][:m], work[rows.MIDDLE_INPUTS][:m], work[rows.LATE_INPUTS][:m]
        f0, f1, f2 = work[rows.EARLY_RATES], work[rows.MIDDLE_RATES], work[rows.LATE_RATES]
        r, g, free, pushed = work[rows.EARLY][:n], work[rows.EARLY_PART][:n], work[rows.FREE_RATES], work[rows.PUSHED]
        before, space, jumped, health = work[saved], work[spare:], work[shifting], 0.0
        for i in range(m):
            u[i] = 0.0
        rate(t, z, u, p, free)
        for j in range(PASSES):
            rate(t, z, change, p, pushed)
            for i in range(size):
                base[i] = z[i] + h / 12.0 * (pushed[i] - free[i])
                y[i] = base[i]
            remind(t, 0.0, z, y, past, p, space)
            if jumping and j > 0:
                shift(y, jumped)
            copy(y, before, size)
            disturbance(z, 0.0, d)
            health = law(t, since, y, d, p, u0, r, g)
            flow(t, y, u0, d, p, f0)
            if j == 0:
                copy(f0, f2, size)
            for i in range(size):
                y[i] = base[i] + h / 8.0 * (3.0 * f0[i] + f2[i])
            remind(t, 0.5 * h, before, y, past, p, space)
            copy(y, before, size)
            disturbance(z, 0.5 * h, d)
            law(t + 0.5 * h, since, y, d, p, u1, r, g)
            flow(t + 0.5 * h, y, u1, d, p, f1)
            for i in range(size):
                y[i] = base[i] + h / 6.0 * (f0[i] + 4.0 * f1[i] + f2[i])
            remind(t + 0.5 * h, 0.5 * h, before, y, past, p, space)
            disturbance(z, h, d)
            law(t + h, since, y, d, p, u2, r, g)
            flow(t + h, y, u2, d, p, f2)
            for i in range(m):  # in a sample, as it begins
                change[i] = 4.0 * u1[i] - 3.0 * u0[i] - u2[i]
            if jumping and j == 0:
                mean_jump(t, h, z, y, past, p, space, jumped)
        settle(z, h, u0, u1, u2, u)
        return health

    return held
