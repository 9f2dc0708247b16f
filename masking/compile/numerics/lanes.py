"""The integrator by Taylor series for many runs of a model, several of them side by side in lanes.

A lane has one run, with its own parameters, time and step; when that is over, the lane takes the next. What a lane
computes depends on its run alone: a run gives the same numbers in any lane and beside any others.
"""
# ruff: noqa: ANN001, ANN202, PLR0912, PLR0915, PLR0917
# The types are numba's to infer, and a kernel is one long function.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.kernel_arguments import Reached
from masking.compile.numerics.runge_kutta import copy
from masking.compile.numerics.stop_codes import REACHED
from masking.compile.numerics.taylor_integrator import ALL_BUT_ROUNDING, obstacle, shortened


def taylor(
    coefficients: Kernel,
    measure: Kernel,
    evaluate: Kernel,
    order: int,
    size: int,
    inputs: int,
    parameters: int,
    lanes: int,
) -> Kernel:
    """Make the integrator of many runs, with the steps of `masking.compile.numerics.taylor_integrator`.

    `coefficients(t, y, u, p, c, health)` writes Taylor coefficients up to `order`, `measure(c, tolerance, terms)` what
    `codegen.taylor_coefficients.step_terms` gives, and `evaluate(x, c, y)` the states at times x from where they hold,
    for as many runs side by side as there are `lanes`, a column each.

    Returns `solve(t, y, times, u, p, tolerance, out, work)`, with arguments as those of the integrator of one run, but
    for each of at least one run a row of `y` (runs, n) and of `p` (runs, k); `work` as `lane_work` says.
    """
    smaller_orders = (order - order // 2 - 2) // 2
    first_terms = 10
    first_c = first_terms + 3 + smaller_orders
    first_y = first_c + (order + 1) * size
    first_sampled = first_y + size
    first_u = first_sampled + size
    first_p = first_u + inputs
    end_p = first_p + parameters

    @compiled
    def fill(lane, run, y, p, state, values):
        for i in range(size):
            state[i, lane] = y[run, i]
        for i in range(parameters):
            values[i, lane] = p[run, i]

    @compiled
    def length(terms, lane, part):
        if not math.isfinite(terms[0, lane]):
            return math.nan
        radius = terms[2, lane] / part
        for i in range(smaller_orders):
            radius = shortened(radius, order // 2 + 2 + 2 * i, terms[3 + i, lane], terms[1, lane])
        return part * radius

    @compiled
    def leave(lane, status, reached, steps, number, state, ends, y):
        run = int(number[lane])
        ends[run, 0], ends[run, 1], ends[run, 2] = status, reached, steps[lane]
        for i in range(size):
            y[run, i] = state[i, lane]
        number[lane] = -1.0

    @compiled
    @requires(
        "len(times) > 0 and len(y) > 0",
        "len(p) >= len(y) and len(out.ends) >= len(y)",
        "len(out.states) >= len(y) * len(times)",
    )
    def solve(
        t: float, y: Matrix, times: Vector, u: Vector, p: Matrix, tolerance: float, out: Reached, work: Matrix
    ) -> None:
        ends, states = out
        m, runs = times.size, y.shape[0]
        now, x, health, wanted, terms = work[0:1], work[1:2], work[2:3], work[3:4], work[first_terms:first_c]
        first, number, sample, steps, reached, row = work[4], work[5], work[6], work[7], work[8], work[9]
        c, state, sampled = work[first_c:first_y], work[first_y:first_sampled], work[first_sampled:first_u]
        given, values = work[first_u:first_p], work[first_p:end_p]
        end = times[m - 1]
        direction = 1.0 if end >= t else -1.0
        part = tolerance ** (1.0 / order)
        begun = 0
        while begun < m and times[begun] == t:
            for run in range(runs):
                copy(y[run], states[run * m + begun], size)
            begun += 1
        for lane in range(lanes):  # one without a run has a copy of the first
            fill(lane, 0, y, p, state, values)
            now[0, lane], wanted[0, lane], number[lane] = t, tolerance, -1.0
            for i in range(inputs):
                given[i, lane] = u[i]
        following, active = 0, 0
        if begun == m:
            for run in range(runs):
                ends[run, 0], ends[run, 1], ends[run, 2] = REACHED, t, 0.0
            following = runs
        while True:
            for lane in range(lanes):
                if number[lane] < 0.0 and following < runs:
                    fill(lane, following, y, p, state, values)
                    now[0, lane], number[lane], sample[lane], steps[lane] = t, following, begun, 0.0
                    following += 1
                    active += 1
            if active == 0:
                return
            coefficients(now, state, given, values, c, health)
            measure(c, wanted, terms)
            for lane in range(lanes):
                if number[lane] < 0.0:
                    continue
                if steps[lane] == 0.0:
                    first[lane] = health[0, lane]
                h = length(terms, lane, part)
                remaining = abs(end - now[0, lane])
                status = obstacle(now[0, lane], h, remaining, health[0, lane], first[lane], steps[lane])
                if status != REACHED:
                    leave(lane, status, now[0, lane], steps, number, state, ends, y)
                    active -= 1
                    continue
                steps[lane] += 1.0
                is_last = h >= remaining * ALL_BUT_ROUNDING
                reached[lane] = end if is_last else now[0, lane] + direction * h
            due = True
            while due:
                due = False
                for lane in range(lanes):
                    x[0, lane], row[lane] = 0.0, -1.0
                    j = int(sample[lane])
                    if number[lane] >= 0.0 and j < m and (times[j] - reached[lane]) * direction <= 0.0:
                        x[0, lane], row[lane] = times[j] - now[0, lane], number[lane] * m + j
                        sample[lane] += 1.0
                        due = True
                if due:
                    evaluate(x, c, sampled)
                    for lane in range(lanes):
                        if row[lane] >= 0.0:
                            for i in range(size):
                                states[int(row[lane]), i] = sampled[i, lane]
            for lane in range(lanes):  # one without a run stands still
                x[0, lane] = reached[lane] - now[0, lane] if number[lane] >= 0.0 else 0.0
            evaluate(x, c, state)
            for lane in range(lanes):
                if number[lane] >= 0.0:
                    now[0, lane] = reached[lane]
                    if sample[lane] >= m:
                        leave(lane, REACHED, reached[lane], steps, number, state, ends, y)
                        active -= 1

    return solve
