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
from masking.compile.numerics.stop_codes import ALL_BUT_ROUNDING, NOT_PRECISE, REACHED, SMALLEST_STEP
from masking.compile.numerics.taylor_integrator import obstacle

SMALLER_UNIT = 1.0 / 1024.0  # where coefficients are beyond the range of single precision


def taylor(
    hold: Kernel,
    coefficients: Kernel,
    step: Kernel,
    evaluate: Kernel,
    advance: Kernel,
    doubles: int,
    singles: int,
    size: int,
    inputs: int,
    parameters: int,
    held: int,
    lanes: int,
) -> Kernel:
    """Make the integrator of many runs, with the steps of `masking.compile.numerics.taylor_integrator`.

    The functions are those of `codegen.generated_module.Module.add_lanes`, for as many runs side by side as there are
    `lanes`, a column each; `doubles` and `singles` are the numbers of orders of coefficients in double and single
    precision.

    Returns `solve(t, y, times, u, p, tolerance, out, work)`, with arguments as those of the integrator of one run, but
    for each of at least one run a row of `y` (runs, n) and of `p` (runs, k); `work` as `lane_work` says. A run for
    which single precision is not enough ends with `NOT_PRECISE`.
    """
    first_found = 14
    first_c = first_found + 5
    first_s = first_c + doubles * size
    first_y = first_s + singles * size
    first_sampled = first_y + size
    first_u = first_sampled + size
    first_p = first_u + inputs
    first_held = first_p + parameters
    first_rounded = first_held + held

    @compiled
    def fill(lane, run, y, p, state, values):
        for i in range(size):
            state[i, lane] = y[run, i]
        for i in range(parameters):
            values[i, lane] = p[run, i]

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
        given, x, found = work[0:10], work[10:11], work[first_found:first_c]  # as in `codegen.lane_steps`
        now, until, due, unit, wanted, log_wanted = work[0], work[1], work[2], work[3], work[4], work[5]
        health, first, steps = work[6], work[8], work[9]
        number, sample, row = work[11], work[12], work[13]
        part, reached, looks, ahead, is_rough = found[0], found[1], found[2], found[3], found[4]
        c, s, state = work[first_c:first_s], work[first_s:first_y], work[first_y:first_sampled]
        sampled, driven, values = work[first_sampled:first_u], work[first_u:first_p], work[first_p:first_held]
        fixed, rounded = work[first_held:first_rounded], work[first_rounded : first_rounded + held]
        end = times[m - 1]
        direction = 1.0 if end >= t else -1.0
        begun = 0
        while begun < m and times[begun] == t:
            for run in range(runs):
                copy(y[run], states[run * m + begun], size)
            begun += 1
        for lane in range(lanes):  # one without a run has a copy of the first, and stands still
            fill(lane, 0, y, p, state, values)
            now[lane], until[lane], due[lane], unit[lane], number[lane] = t, t, t, end - t, -1.0
            wanted[lane], log_wanted[lane], first[lane], steps[lane] = tolerance, math.log(tolerance), math.nan, 0.0
            for i in range(inputs):
                driven[i, lane] = u[i]
        following, active = 0, 0
        if begun == m:
            for run in range(runs):
                ends[run, 0], ends[run, 1], ends[run, 2] = REACHED, t, 0.0
            following = runs
        hold(driven, values, fixed, rounded)
        while True:
            if active < lanes and following < runs:
                for lane in range(lanes):
                    if number[lane] < 0.0 and following < runs:
                        fill(lane, following, y, p, state, values)
                        now[lane], until[lane], due[lane], unit[lane] = t, end, times[begun], end - t
                        number[lane], sample[lane], steps[lane], first[lane] = following, begun, 0.0, math.nan
                        following += 1
                        active += 1
                hold(driven, values, fixed, rounded)
            if active == 0:
                return
            coefficients(given, state, fixed, rounded, c, s)
            step(given, c, s, found)
            looked = 0
            for lane in range(lanes):
                looked |= int(looks[lane])
            if looked:
                is_due = False
                for lane in range(lanes):
                    if looks[lane] == 0.0:
                        continue
                    at, h, remaining = now[lane], abs(ahead[lane]), abs(end - now[lane])
                    if number[lane] < 0.0:
                        reached[lane], part[lane] = at, 0.0
                        continue
                    if singles > 0 and h == 0.0 and abs(unit[lane]) > SMALLEST_STEP * max(abs(at), 1e-3 * remaining):
                        reached[lane], part[lane], ahead[lane] = at, 0.0, unit[lane] * SMALLER_UNIT
                        steps[lane] -= 1.0
                        continue
                    if steps[lane] == 0.0:
                        first[lane] = health[lane]
                    h = h if h > 0.0 else math.nan
                    status = obstacle(at, h, remaining, health[lane], first[lane], steps[lane])
                    if status == REACHED and is_rough[lane] > 0.0:
                        status = NOT_PRECISE
                    if status != REACHED:
                        leave(lane, status, at, steps, number, state, ends, y)
                        until[lane], reached[lane], part[lane] = at, at, 0.0
                        active -= 1
                        continue
                    if h >= remaining * ALL_BUT_ROUNDING:
                        reached[lane], part[lane] = end, end - at
                        if singles > 0:
                            part[lane] /= unit[lane]
                    is_due |= (due[lane] - reached[lane]) * direction <= 0.0
                while is_due:
                    is_due = False
                    for lane in range(lanes):
                        row[lane] = -1.0
                        if number[lane] >= 0.0 and sample[lane] < m and (due[lane] - reached[lane]) * direction <= 0.0:
                            j = int(sample[lane])
                            x[0, lane], row[lane] = due[lane] - now[lane], number[lane] * m + j
                            if singles > 0:
                                x[0, lane] /= unit[lane]
                            sample[lane] += 1.0
                            due[lane] = times[min(j + 1, m - 1)]
                            is_due = True
                    if is_due:
                        evaluate(x, c, s, sampled)
                        for lane in range(lanes):
                            if row[lane] >= 0.0:
                                for i in range(size):
                                    states[int(row[lane]), i] = sampled[i, lane]
            advance(found, given, c, s, state)
            if looked:
                for lane in range(lanes):
                    if part[lane] == 0.0:  # coefficients may be no numbers
                        for i in range(size):
                            state[i, lane] = c[i, lane]
                    if number[lane] >= 0.0 and sample[lane] >= m:
                        leave(lane, REACHED, reached[lane], steps, number, state, ends, y)
                        until[lane] = now[lane]
                        active -= 1

    return solve
