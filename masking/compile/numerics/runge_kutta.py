"""Integrators of ordinary differential equations, made to measure for a compiled model.

Each function here takes a model's compiled functions and returns a kernel, which numba compiles together with
them into one piece of machine code. Functions of a model, with state `y` = coordinates then velocities:

* `derivative(t, y, u, p, dy) -> health` writes the derivatives;
* `step(t, q, v, u, p) -> health` reads coordinates and velocities and writes the inputs u.

`health` is a measure of what had to be inverted (`codegen.linear_systems.health`): a run stops where it vanishes or
changes sign.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0911, PLR0912, PLR0915, PLR0917
# The types are numba's to infer, and a kernel is one long function with several ways out.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, inlined, requires
from masking.compile.numerics.dop853_coefficients import E3, E5, STAGES, A, C, D
from masking.compile.numerics.kernel_arguments import Accuracy, Samples, States, UnderWay
from masking.compile.numerics.stop_codes import (
    EVENT,
    MOST_STEPS,
    NOT_FINITE,
    REACHED,
    SINGULAR,
    SINGULAR_PART,
    SMALLEST_STEP,
    STEPS_AT_ONCE,
    TOO_MANY_STEPS,
    TOO_SMALL_STEP,
)

# Where the health vanishes like the root of the time left, steps vanish before it has fallen that far.
NEARLY_SINGULAR_PART = 1e-6
OF_STATE = -1  # in the place of a number of states: that of the state
SHORT_STEP = 1e-6  # part of the time; errors of longer ones are larger than those of rounding
ROUNDED = 1e-15  # part of a time, or of the largest state so far, that rounding on the way may make


@compiled
def is_singular(health, first):
    """Whether a health has vanished or changed sign since the start."""
    return not (health > SINGULAR_PART * first if first > 0.0 else health < SINGULAR_PART * first)


@compiled
def fault(health, first):
    """Reason to stop at a health, or REACHED."""
    if not math.isfinite(health):
        return NOT_FINITE
    return SINGULAR if is_singular(health, first) else REACHED


@compiled
def copy(source, target, size):
    """Copy an array element by element; measured: an array assignment takes numba ten times as long to compile."""
    for i in range(size):
        target[i] = source[i]


def runge_kutta(derivative: Kernel, size: int) -> Kernel:
    """Make the Runge-Kutta integrator of order 8(5, 3), with step size control and dense output of order 7.

    For dynamics that have no Taylor series: friction, stops, backlash. The local error is measured relative to
    each state plus a thousandth of the largest. After `STEPS_AT_ONCE` it returns, and may be called to go on.
    Source: Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I, section II.10, DOP853.

    Returns `solve`, for n = `size` states, with arguments and results as those of `taylor`, and `work` (24, n).
    """
    return embedded_steps(derivative, unbounded, forget, size, False, no_event, False)


@compiled
def unbounded(t, u):
    """Bound no step."""
    return math.inf


@compiled
def forget(t, y, f, h, u):
    """Keep no step."""
    return True


@compiled
def no_event(t, y, f, length, u, p):
    """Find no event in a step."""
    return 2.0


def dense_output(size: int) -> Kernel:
    """Make `interpolate(y, f, x, state)`: the state at a part x of a step from y with the coefficients f."""

    @compiled
    def interpolate(y, f, x, state):
        for i in range(size):
            value = f[6, i]
            for r in range(5, -1, -1):
                value = f[r, i] + (1.0 - x if r % 2 == 0 else x) * value
            state[i] = y[i] + x * value

    return interpolate


def embedded_steps(
    derivative: Kernel, bound: Kernel, keep: Kernel, size: int, keeps: bool, crossing: Kernel, watches: bool
) -> Kernel:
    """Make the integrator of `runge_kutta` with steps that are bounded and kept, and that end at events.

    Args:
        derivative: writes the derivatives, and what of y is not integrated.
        bound: `bound(t, u)` gives the longest step at a time; below 0, over how long the state is carried as it is.
        keep: `keep(t, y, f, h, u)` keeps a step of length h from y with the coefficients f of its dense output; false
            where it cannot.
        size: number n of states that are integrated.
        keeps: whether steps are kept, and what of y is not integrated is recorded.
        crossing: `crossing(t, y, f, h, u, p)` gives the part of a step after which an event comes; above 1 for none.
        watches: whether there are events.
    """
    interpolate = dense_output(size)

    @compiled
    def stage(row, y, h, k, state):
        for i in range(size):
            state[i] = 0.0
        for q in range(row):
            a = A[row, q]
            if a != 0.0:
                for i in range(size):
                    state[i] += a * k[q, i]
        for i in range(size):
            state[i] = y[i] + h * state[i]

    @compiled
    def is_finite(state):
        total = 0.0
        for i in range(size):
            total += abs(state[i])
        return math.isfinite(total)

    @compiled
    def first_step(y, dy, length, tolerance):
        largest, rate = SMALLEST_STEP, SMALLEST_STEP
        for i in range(size):
            largest = max(largest, abs(y[i]))
            rate = max(rate, abs(dy[i]))
        return min(length, 0.1 * largest / rate * tolerance**0.125 + 1e-6 * length)

    @compiled
    def change_of_rate(k, i):
        low, high = k[0, i], k[0, i]
        for q in range(1, STAGES + 1):
            low, high = min(low, k[q, i]), max(high, k[q, i])
        return high - low

    @compiled
    def local_error(y, new, k, h, tolerance, of_time, of_states):
        largest = 0.0
        for i in range(size):
            largest = max(largest, abs(y[i]), abs(new[i]))
        e3, e5 = 0.0, 0.0
        for i in range(size):
            scale = tolerance * (max(abs(y[i]), abs(new[i])) + 1e-3 * largest + SMALLEST_STEP)
            a3, a5 = 0.0, 0.0
            for q in range(STAGES + 1):
                a3 += E3[q] * k[q, i]
                a5 += E5[q] * k[q, i]
            if of_time > 0.0:
                scale += of_time * change_of_rate(k, i) + of_states
            e3 += (a3 / scale) ** 2
            e5 += (a5 / scale) ** 2
        total = e5 + 0.01 * e3
        return 0.0 if total == 0.0 else h * e5 / math.sqrt(total * size)

    @compiled
    def interpolant(t, y, new, u, p, h, k, f):
        for s in range(STAGES + 1, 16):
            stage(s, y, h, k, f[0])
            derivative(t + C[s] * h, f[0], u, p, k[s])
        for i in range(size):
            change = new[i] - y[i]
            f[0, i] = change
            f[1, i] = h * k[0, i] - change
            f[2, i] = 2.0 * change - h * (k[STAGES, i] + k[0, i])
            for r in range(4):
                value = 0.0
                for q in range(16):
                    value += D[r, q] * k[q, i]
                f[3 + r, i] = h * value

    @compiled
    @requires("len(states) >= len(times)")
    def solve(
        t: float, y: Vector, times: Vector, u: Vector, p: Vector, accuracy: Accuracy, states: Matrix, work: Matrix
    ) -> tuple[int, float, int]:
        tolerance, fixed_step = accuracy
        m = times.size
        if m == 0:
            return REACHED, t, 0
        k, new, f = work[:16], work[16], work[17:]
        end = times[m - 1]
        direction = 1.0 if end >= t else -1.0
        j, steps, met, widest = 0, 0, REACHED, 0.0
        while j < m and times[j] == t:
            copy(y, states[j], size)
            if keeps:
                derivative(t, states[j], u, p, k[15])
            j += 1
        first = derivative(t, y, u, p, k[0])
        h = fixed_step if fixed_step > 0.0 else first_step(y, k[0], abs(end - t), tolerance)
        while j < m:
            limit = bound(t, u)
            if limit < 0.0:
                t -= limit
                derivative(t, y, u, p, k[0])
                continue
            remaining = abs(end - t)
            wanted = min(h, limit)
            is_last = wanted >= remaining * (1.0 - 1e-12)
            length = direction * (remaining if is_last else wanted)
            if not is_last and wanted <= SMALLEST_STEP * max(abs(t), 1e-3 * remaining):
                return (SINGULAR if met == SINGULAR else TOO_SMALL_STEP), t, steps
            if steps >= (MOST_STEPS if keeps else STEPS_AT_ONCE):
                return TOO_MANY_STEPS, t, steps
            met = fault(first, first)
            for s in range(1, STAGES + 1):
                stage(s, y, length, k, new)
                health = derivative(t + C[s] * length, new, u, p, k[s])
                if met != SINGULAR:
                    met = fault(health, first)
            steps += 1
            if fixed_step <= 0.0:
                error = local_error(y, new, k, abs(length), tolerance, 0.0, 0.0)
                if error > 1.0 and abs(length) <= SHORT_STEP * (abs(t) + remaining):
                    # No step makes the error smaller than rounding is, of the time where rates change.
                    of_time = ROUNDED * (abs(t) + abs(length))
                    rounded = local_error(y, new, k, abs(length), tolerance, of_time, ROUNDED * widest)
                    error = 1.0 if rounded <= 1.0 else error
                if not error <= 1.0:  # also where it is not a number
                    if not math.isfinite(error) and abs(length) <= 1e-10 * (abs(t) + remaining):
                        return (SINGULAR if met == SINGULAR else NOT_FINITE), t, steps
                    h = abs(length) * (max(0.2, 0.9 / error**0.125) if math.isfinite(error) else 0.2)
                    continue
                h = abs(length) * (min(6.0, 0.9 / error**0.125) if error > 0.0 else 6.0)
            elif not is_finite(new):
                return NOT_FINITE, t, steps
            met = fault(health, first)
            if met != REACHED:
                if fixed_step > 0.0 or abs(length) <= 1e-10 * (abs(t) + remaining):
                    return met, t, steps
                h = 0.5 * abs(length)  # come as close to it as time resolves
                continue
            reached = end if is_last else t + length
            part = 2.0
            if keeps or watches or (times[j] - reached) * direction <= 0.0:
                interpolant(t, y, new, u, p, length, k, f)
                if watches:
                    part = crossing(t, y, f, length, u, p)
                    reached = t + part * length if part <= 1.0 else reached
                while j < m and (times[j] - reached) * direction <= 0.0:
                    interpolate(y, f, (times[j] - t) / length, states[j])
                    if keeps:
                        derivative(times[j], states[j], u, p, k[15])
                    j += 1
                if keeps and not keep(t, y, f, length, u):
                    return TOO_MANY_STEPS, t, steps
            if part <= 1.0:
                interpolate(y, f, part, new)
                copy(new, y, size)
                return EVENT, reached, steps
            t = reached
            for i in range(size):
                widest = max(widest, abs(new[i]))
                y[i] = new[i]
                k[0, i] = k[STAGES, i]
        return REACHED, t, steps

    return solve


@inlined
def part_at(stage):
    """Part of a step of the classical Runge-Kutta method at which a stage is, 0 to 3."""
    return 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)


def classical_step(slope: Kernel, size: int) -> Kernel:
    """Make one step of the classical Runge-Kutta method.

    Source: Hairer, Norsett and Wanner (1993), Table II.1.2.

    Args:
        slope: `slope(t, stage, y, u, p, dy)` writes the derivatives at a stage, 0 to 3; u and p are anything.
        size: number n of states, or OF_STATE.

    Returns:
        `advance(t, y, u, p, h, k, state)`, which moves y over h; `k` (4, n) and `state` (n,) are work space.
    """

    @inlined
    def advance(t, y, u, p, h, k, state):
        n = y.size if size == OF_STATE else size
        for stage in range(4):
            c = part_at(stage)
            for i in range(n):
                state[i] = y[i] + (c * h * k[stage - 1, i] if stage > 0 else 0.0)
            slope(t + c * h, stage, state, u, p, k[stage])
        for i in range(n):
            y[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])

    return advance


def runge_kutta_4(derivative: Kernel, size: int) -> Kernel:
    """Make `classical_step` with the derivatives of a model."""

    @compiled
    def slope(t, stage, y, u, p, dy):
        derivative(t, y, u, p, dy)

    return classical_step(slope, size)


@inlined
def held_late(commands, index, channel, late, step, substeps):
    """Held command as it was `late` samples before: its mean over an integration step, and half its rise.

    The line through both has the mean and the first moment of the step that the command makes.
    """
    last = commands.shape[0] - 1
    at = index * substeps + step - late * substeps  # in steps
    low = math.floor(at / substeps)
    share = max(at - (low + 1) * substeps + 1.0, 0.0)  # part of the step in which the next command acts
    before, after = commands[min(max(low, 0), last), channel], commands[min(max(low + 1, 0), last), channel]
    return (1.0 - share) * before + share * after, 3.0 * share * (1.0 - share) * (after - before)


def steps_under_way(derivative: Kernel, size: int) -> Kernel:
    """Make a rig move under commands that act late, in equal steps of the classical Runge-Kutta method.

    Returns `move(t, y, under_way, p, dt, substeps, acting, work)`, which moves y over the sample of length dt that
    begins as the newest command is given. Each step takes the mean of what acts in it; `acting` (actuators,) gets that
    of the last. `work` (5, n).
    """
    step = runge_kutta_4(derivative, size)

    @compiled
    @requires("len(under_way.queue) > 0", "min(len(under_way.late), len(acting)) >= under_way.queue.shape[1]")
    def move(
        t: float, y: Vector, under_way: UnderWay, p: Vector, dt: float, substeps: int, acting: Vector, work: Matrix
    ) -> None:
        queue, late = under_way
        rows, channels = queue.shape
        for i in range(substeps):
            for j in range(channels):
                acting[j], _ = held_late(queue, rows - 1, j, late[j], i, substeps)
            step(t + i * (dt / substeps), y, acting, p, dt / substeps, work[:4], work[4])
        for i in range(rows - 1):
            copy(queue[i + 1], queue[i], channels)

    return move


def steps_of_runge_kutta_4(derivative: Kernel, size: int) -> Kernel:
    """Make `advance(t, y, u, p, dt, substeps, work)`: equal steps of classical Runge-Kutta; `work` (5, n)."""
    step = runge_kutta_4(derivative, size)

    @compiled
    def advance(t: float, y: Vector, u: Vector, p: Vector, dt: float, substeps: int, work: Matrix) -> None:
        for i in range(substeps):
            step(t + i * (dt / substeps), y, u, p, dt / substeps, work[:4], work[4])

    return advance


def sampled(step: Kernel, derivative: Kernel, size: int, coordinates: int) -> Kernel:
    """Make the loop of a controller at a fixed rate, its outputs held between samples, and a plant.

    At sample k, at time k dt, the controller reads the state and writes u; the plant then moves for dt under that u, in
    Runge-Kutta steps of order 4. Samples 0, every, 2 every ... are recorded. `step` is the controller, which returns
    the health of what it had to invert; the first `coordinates` of the plant's n states are these.

    Returns `run(samples, y, u, p, first, recorded, work) -> (status, samples done, first)`, where `y` is the state
    (n,), which is the last state afterwards; `u` (k,) work space; `first` the health at the start of the run, 0 where
    this is the start; `work` (5, n) is work space.
    """
    advance = runge_kutta_4(derivative, size)

    @compiled
    @requires(
        "samples.every > 0",
        "(rows := kept(samples.begin, samples.samples, samples.every)) <= len(recorded.states)",
        f"rows <= len(recorded.inputs) and len(u) <= recorded.inputs.shape[1] and {size} <= recorded.states.shape[1]",
    )
    def run(
        samples: Samples, y: Vector, u: Vector, p: Vector, first: float, recorded: States, work: Matrix
    ) -> tuple[int, int, float]:
        begin, count, dt, substeps, every = samples
        k, state = work[:4], work[4]
        h = dt / substeps
        row = 0
        for index in range(begin, begin + count):
            t = index * dt
            health = step(t, y[:coordinates], y[coordinates:], u, p)
            first = health if first == 0.0 else first
            status = fault(health, first)
            if status != REACHED:
                return status, index - begin, first
            for i in range(u.size):
                if not math.isfinite(u[i]):
                    return NOT_FINITE, index - begin, first
            if index % every == 0:
                copy(y, recorded.states[row], size)
                copy(u, recorded.inputs[row], u.size)
                row += 1
            for i in range(substeps):
                advance(t + i * h, y, u, p, h, k, state)
        return REACHED, count, first

    return run
