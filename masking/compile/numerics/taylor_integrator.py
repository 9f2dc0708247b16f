"""The integrator by Taylor series, made to measure for a compiled model, and the rules of its steps.

`coefficients(t, y, u, p, c) -> health` writes Taylor coefficients of a model, `c[k, i]` of order k of state i.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0917
# The types are numba's to infer, and a kernel is one long function with several ways out.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, inlined, requires
from masking.compile.numerics.kernel_arguments import Accuracy
from masking.compile.numerics.runge_kutta import NEARLY_SINGULAR_PART, copy, fault
from masking.compile.numerics.stop_codes import (
    ALL_BUT_ROUNDING,
    MOST_STEPS,
    NOT_FINITE,
    REACHED,
    SINGULAR,
    SMALLEST_STEP,
    TOO_MANY_STEPS,
    TOO_SMALL_STEP,
)


@inlined
def shortened(radius, k, term, largest):
    """Radius of convergence at which the largest term of order k is no larger than the state is."""
    if term > 0.0 and term * radius**k > largest:
        return (largest / term) ** (1.0 / k)
    return radius


@inlined
def obstacle(t, h, remaining, health, first, steps):
    """Reason against a step of length h from t, or REACHED."""
    status = fault(health, first)
    if status != REACHED:
        return status
    if math.isnan(h):
        return NOT_FINITE
    if h < remaining * ALL_BUT_ROUNDING and h <= SMALLEST_STEP * max(abs(t), 1e-3 * remaining):
        return SINGULAR if abs(health) <= NEARLY_SINGULAR_PART * abs(first) else TOO_SMALL_STEP
    return TOO_MANY_STEPS if steps >= MOST_STEPS else REACHED


def taylor(coefficients: Kernel, order: int, size: int) -> Kernel:
    """Make the integrator by Taylor series, with step size control and dense output.

    The step is that of Jorba and Zou (2005), eq. (10): the smaller of the two lengths at which the last two terms
    of the series equal the tolerance times the size of the state. It is shortened where an earlier term shows a
    smaller radius of convergence: x'' = -x^7 from x = 0 has no terms between order 9 and order 17.

    Args:
        coefficients: writes Taylor coefficients.
        order: their highest order.
        size: number n of states.

    Returns:
        `solve(t, y, times, u, p, accuracy, states, work) -> (status, time reached, steps)`, where `t` is the initial
        time; `y` the state (n,), which is the last state afterwards; `times` monotone (m,), the last of which ends the
        integration; `u` the inputs, held constant; `accuracy` the local error of a step relative to the largest state;
        `states` (m, n) gets the states; `work` (order + 1, n) is work space.
    """

    @compiled
    def evaluate(c, x, state):
        for i in range(size):
            state[i] = c[order, i]
        for k in range(order - 1, -1, -1):
            for i in range(size):
                state[i] = state[i] * x + c[k, i]

    @compiled
    def step_length(c, tolerance, part):
        total, largest, last, before = 0.0, SMALLEST_STEP, 0.0, 0.0
        for i in range(size):
            total += abs(c[order, i]) + abs(c[order - 1, i])
            largest = max(largest, abs(c[0, i]))
            last = max(last, abs(c[order, i]))
            before = max(before, abs(c[order - 1, i]))
        if not math.isfinite(total):
            return math.nan
        # In logarithms, which measured 8 % faster than two powers; exp(inf) stands where the series ends.
        h = math.inf
        if last > 0.0:
            h = math.log(tolerance * largest / last) * (1.0 / order)
        if before > 0.0:
            h = min(h, math.log(tolerance * largest / before) * (1.0 / (order - 1)))
        h = math.exp(h)
        # With part = tolerance^(1/order), no term may be larger at the radius h / part than the state is. Order k
        # of a coordinate and k - 1 of its velocity vanish together: every second order shows all gaps.
        radius = h / part
        for k in range(order // 2 + 2, order - 1, 2):
            term = 0.0
            for i in range(size):
                term = max(term, abs(c[k, i]))
            radius = shortened(radius, k, term, largest)
        return part * radius

    @compiled
    @requires("len(states) >= len(times)")
    def solve(
        t: float, y: Vector, times: Vector, u: Vector, p: Vector, accuracy: Accuracy, states: Matrix, work: Matrix
    ) -> tuple[int, float, int]:
        tolerance, fixed_step = accuracy
        m = times.size
        if m == 0:
            return REACHED, t, 0
        c = work
        end = times[m - 1]
        direction = 1.0 if end >= t else -1.0
        part = tolerance ** (1.0 / order)
        j, steps, first = 0, 0, 0.0
        while j < m and times[j] == t:
            copy(y, states[j], size)
            j += 1
        while j < m:
            health = coefficients(t, y, u, p, c)
            first = health if steps == 0 else first
            length = step_length(c, tolerance, part)
            h = fixed_step if fixed_step > 0.0 and not math.isnan(length) else length
            remaining = abs(end - t)
            status = obstacle(t, h, remaining, health, first, steps)
            if status != REACHED:
                return status, t, steps
            is_last = h >= remaining * ALL_BUT_ROUNDING
            steps += 1
            reached = end if is_last else t + direction * h
            while j < m and (times[j] - reached) * direction <= 0.0:
                evaluate(c, times[j] - t, states[j])
                j += 1
            evaluate(c, reached - t, y)
            t = reached
        return REACHED, t, steps

    return solve
