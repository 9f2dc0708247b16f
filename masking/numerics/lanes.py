"""The integrator by Taylor series for many runs of a model, several of them side by side in lanes.

A lane has one run, with its own parameters, time and step; when the run is over, the lane takes the next. What a lane
computes depends on its run alone: a run gives the same numbers in any lane and beside any others.
"""
# ruff: noqa: ANN001, ANN202, PLR0912, PLR0915, PLR0917
# The types are numba's to infer, and a kernel is one long function.

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from masking.numerics.arrays import Matrix, Vector
from masking.numerics.integrators import SMALLEST_STEP, compiled
from masking.numerics.stop_codes import REACHED
from masking.numerics.taylor import ALL_BUT_ROUNDING, longest_step, obstacle, shortened

Kernel = Callable[..., Any]


def taylor(  # noqa: PLR0913  (sizes of a model)
    coefficients: Kernel, measure: Kernel, evaluate: Kernel, order: int, size: int, inputs: int, parameters: int, lanes: int
) -> Kernel:
    """Make the integrator of many runs, with the steps of `masking.numerics.taylor`.

    Args:
        coefficients: `coefficients(t, y, u, p, c, health)` writes Taylor coefficients of all lanes.
        measure: `measure(c, terms)` writes what the length of a step follows from.
        evaluate: `evaluate(x, c, y)` writes the states of all lanes at times x from where the coefficients hold.
        order: their highest order.
        size: number n of states.
        inputs: number of inputs.
        parameters: number k of parameters.
        lanes: number of lanes.

    Returns:
        `solve(t, y, times, u, p, tolerance, ends, states, work)`, with arguments as those of the integrator of one run,
        but a row of `y` (runs, n), `p` (runs, k) and `ends` (runs, 3), and m rows of `states` (runs m, n) for each
        run; `ends` gets the status, the time reached and the number of steps. At least one run.
    """
    first_c = 8 + 4 + (order - order // 2 - 2) // 2
    first_y = first_c + (order + 1) * size
    first_sample = first_y + size
    first_u = first_sample + size
    first_p = first_u + inputs
    rows = first_p + parameters

    @compiled
    def begin(lane, run, y, p, state, values):
        for i in range(size):
            state[i, lane] = y[run, i]
        for i in range(parameters):
            values[i, lane] = p[run, i]

    @compiled
    def length(terms, lane, tolerance, part):
        largest = max(SMALLEST_STEP, terms[1, lane])
        total, last, before = terms[0, lane], terms[2, lane], terms[3, lane]
        radius = longest_step(total, largest, last, before, tolerance, order) / part
        for k in range(order // 2 + 2, order - 1, 2):
            radius = shortened(radius, k, terms[4 + (k - order // 2) // 2 - 1, lane], largest)
        return part * radius

    @compiled
    def solve(
        t: float, y: Matrix, times: Vector, u: Vector, p: Matrix, tolerance: float, ends: Matrix, states: Matrix,
        work: Matrix,
    ) -> None:  # fmt: skip
        m, runs = times.size, y.shape[0]
        now, x, health, first, number, sample, steps, reached = (
            work[0:1], work[1:2], work[2:3], work[3:4], work[4:5], work[5:6], work[6:7], work[7:8],
        )  # fmt: skip
        terms = work[8:first_c]
        c, state, found = work[first_c:first_y], work[first_y:first_sample], work[first_sample:first_u]
        given, values = work[first_u:first_p], work[first_p:rows]
        end = times[m - 1]
        direction = 1.0 if end >= t else -1.0
        part = tolerance ** (1.0 / order)
        skipped = 0
        while skipped < m and times[skipped] == t:
            for run in range(runs):
                for i in range(size):
                    states[run * m + skipped, i] = y[run, i]
            skipped += 1
        if skipped == m:
            for run in range(runs):
                ends[run, 0], ends[run, 1], ends[run, 2] = REACHED, t, 0.0
            return
        for lane in range(lanes):
            for i in range(inputs):
                given[i, lane] = u[i]
            begin(lane, 0, y, p, state, values)
            number[0, lane], now[0, lane] = -1.0, t
        following, active = 0, 0
        while True:
            for lane in range(lanes):
                if number[0, lane] < 0.0 and following < runs:
                    begin(lane, following, y, p, state, values)
                    number[0, lane], now[0, lane], steps[0, lane], sample[0, lane] = following, t, 0.0, skipped
                    following += 1
                    active += 1
            if active == 0:
                return
            coefficients(now, state, given, values, c, health)
            measure(c, terms)
            for lane in range(lanes):
                x[0, lane] = 0.0
                if number[0, lane] >= 0.0:
                    if steps[0, lane] == 0.0:
                        first[0, lane] = health[0, lane]
                    h = length(terms, lane, tolerance, part)
                    remaining = abs(end - now[0, lane])
                    status = obstacle(now[0, lane], h, remaining, health[0, lane], first[0, lane], steps[0, lane])
                    if status != REACHED:
                        run = int(number[0, lane])
                        ends[run, 0], ends[run, 1], ends[run, 2] = status, now[0, lane], steps[0, lane]
                        for i in range(size):
                            y[run, i] = state[i, lane]
                        number[0, lane] = -1.0
                        active -= 1
                    else:
                        steps[0, lane] += 1.0
                        is_last = h >= remaining * ALL_BUT_ROUNDING
                        reached[0, lane] = end if is_last else now[0, lane] + direction * h
            due = True
            while due:
                due = False
                for lane in range(lanes):
                    j = int(sample[0, lane])
                    x[0, lane] = 0.0
                    if number[0, lane] >= 0.0 and j < m and (times[j] - reached[0, lane]) * direction <= 0.0:
                        x[0, lane] = times[j] - now[0, lane]
                        due = True
                if due:
                    evaluate(x, c, found)
                    for lane in range(lanes):
                        j = int(sample[0, lane])
                        if number[0, lane] >= 0.0 and j < m and (times[j] - reached[0, lane]) * direction <= 0.0:
                            row = int(number[0, lane]) * m + j
                            for i in range(size):
                                states[row, i] = found[i, lane]
                            sample[0, lane] += 1.0
            for lane in range(lanes):
                x[0, lane] = reached[0, lane] - now[0, lane] if number[0, lane] >= 0.0 else 0.0
            evaluate(x, c, state)
            for lane in range(lanes):
                if number[0, lane] >= 0.0:
                    now[0, lane] = reached[0, lane]
                    if sample[0, lane] >= m:
                        run = int(number[0, lane])
                        ends[run, 0], ends[run, 1], ends[run, 2] = REACHED, now[0, lane], steps[0, lane]
                        for i in range(size):
                            y[run, i] = state[i, lane]
                        number[0, lane] = -1.0
                        active -= 1

    return solve
