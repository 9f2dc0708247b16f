"""Delays: what a delayed expression was, read from the dense output of the steps that an integrator has taken.

The method of steps: no step is longer than the shortest delay, so that all that a step reads is behind it, and steps
end where the kink at the initial time comes back, until it is as smooth as the integrator can see. Before the initial
time everything was as it is then. Source: Hairer, Norsett and Wanner (1993), section II.17.

The state is followed by the values of the delayed expressions, y = [q, v, s, w], which are read and not integrated, and
by the instants at which something switches with time, of each the last time before it and the first behind it.
"""
# ruff: noqa: ANN001, ANN202, PLR0915, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math
from typing import NamedTuple

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.kernel_arguments import Accuracy
from masking.compile.numerics.runge_kutta import copy, embedded_steps, no_event
from masking.compile.numerics.stop_codes import SMALLEST_STEP

STEPS = 4096  # that are kept: as many as fit into the longest delay
KINKS = 9  # derivatives of the solution in which the kink at the initial time comes back
# Rows of the history: initial time and number of steps, delays, initial state, two for work, inputs; then nine for each
# of the latest steps: its beginning and its length, the state there, and the seven coefficients of its dense output.
HEAD, DELAYS, BEFORE, THEN, VALUES, INPUTS, FIRST = range(7)
ROWS = 9


class Past(NamedTuple):
    """What is known of a run besides its state: the steps that it has taken, and instants of switches, in pairs."""

    history: Matrix
    instants: Vector


def history_shape(size: int, lags: int, inputs: int) -> tuple[int, int]:
    """Shape of the work space of `runge_kutta`, by the numbers of integrated states, delayed expressions and inputs."""
    return 24 + FIRST + ROWS * STEPS, max(size + lags, inputs, 2)


def runge_kutta(derivative: Kernel, lagged: Kernel, delays: Kernel, size: int, lags: int, inputs: int) -> Kernel:
    """Make the integrator of `runge_kutta.runge_kutta` for equations with delays.

    `derivative` writes the derivatives of y = [q, v, s, w], whose first `size` are integrated; `lagged(t, y, p, w)`
    what the delayed expressions are now, and `delays(p, w)` their delays.

    Returns:
        `solve`, as that of `runge_kutta.runge_kutta`, with states [q, v, s, w] and the work space of `history_shape`.
    """

    @compiled
    def state_at(t, past, y):
        if t <= past[HEAD, 0]:
            copy(past[BEFORE], y, size)
            return
        count = int(past[HEAD, 1])
        low, high = max(0, count - STEPS), count - 1
        while low < high:
            middle = (low + high + 1) // 2
            if past[FIRST + ROWS * (middle % STEPS), 0] <= t:
                low = middle
            else:
                high = middle - 1
        at = FIRST + ROWS * (low % STEPS)
        x = (t - past[at, 0]) / past[at, 1]
        for i in range(size):
            value = past[at + 8, i]
            for r in range(5, -1, -1):
                value = past[at + 2 + r, i] + (1.0 - x if r % 2 == 0 else x) * value
            y[i] = past[at + 1, i] + x * value

    @compiled
    def filled(t, y, known, p, dy):
        past = known.history
        for j in range(lags):
            then = t - past[DELAYS, j]
            state_at(then, past, past[THEN])
            lagged(then, past[THEN], p, past[VALUES])
            y[size + j] = past[VALUES, j]
        return derivative(t, y, past[INPUTS], p, dy)

    @compiled
    def bound(t, known):
        past, limit = known.history, math.inf
        for k in range(0, known.instants.size, 2):
            before, behind = known.instants[k], known.instants[k + 1]
            if t < behind and t >= before - SMALLEST_STEP * abs(t):
                return t - behind
            if t < before:
                limit = before - t
                break
        for j in range(lags):
            time = past[DELAYS, j]
            limit = min(limit, time)
            kink = math.floor((t - past[HEAD, 0]) / time + 1e-9) + 1.0
            if kink <= KINKS:
                limit = min(limit, past[HEAD, 0] + kink * time - t)
        return limit

    @compiled
    def keep(t, y, f, length, known):
        past = known.history
        count, longest = int(past[HEAD, 1]), 0.0
        at = FIRST + ROWS * (count % STEPS)
        oldest = past[at, 0]
        for j in range(lags):
            longest = max(longest, past[DELAYS, j])
        past[at, 0], past[at, 1] = t, length
        copy(y, past[at + 1], size)
        for r in range(7):
            copy(f[r], past[at + 2 + r], size)
        past[HEAD, 1] = count + 1.0
        return count < STEPS or oldest + longest < t

    solve_with = embedded_steps(filled, bound, keep, size, True, no_event, False)

    @compiled
    @requires("len(states) >= len(times)", f"len(y) % 2 == {(size + lags) % 2}")
    def solve(
        t: float, y: Vector, times: Vector, u: Vector, p: Vector, accuracy: Accuracy, states: Matrix, work: Matrix
    ) -> tuple[int, float, int]:
        past = work[24:]
        copy(u, past[INPUTS], inputs)
        past[HEAD, 0], past[HEAD, 1] = t, 0.0
        delays(p, past[DELAYS])
        copy(y, past[BEFORE], size)
        known = Past(past, y[size + lags :])
        return solve_with(t, y, times, known, p, accuracy, states, work[:24])

    return solve
