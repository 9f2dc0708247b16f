"""Variational equations: a simulated motion and its derivatives by parameters and initial values, in one pass.

    y' = f(t, y, u, p),    S' = (df/dy) S + (df/dp) B

The columns of S are derivatives of the state y by what is estimated; B (`basis`) says how the entries of the parameter
array depend on it. Both are integrated by the classical Runge-Kutta method with the same steps, so that S is the exact
derivative of the computed y. What a least-squares fit needs, the normal equations, is accumulated sample by sample.
Source: Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I, section I.14 and Table II.1.2;
Ljung, System Identification (1999), section 10.3.

Kernels serve any rig: sizes are those of the arrays. Functions of a rig, with n states y = coordinates, velocities,
others, are linked to them:

* `derivative(t, y, u, p, rate)` writes y';
* `slopes(t, y, u, p, rate, by_state, by_entry)` writes y', df/dy (n, n) and df/dp (n, affected);
* `sensed(t, y, u, p, noise, s, by_state, by_entry)` writes the readings s and their derivatives.

`given` stands for the arrays that a rig is simulated with, as one tuple: `Given` for a twin.
Kernels need work space of zeros, and take rows of it from the top.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from masking.numerics.arrays import IntMatrix, IntVector, Matrix, Vector
from masking.numerics.compilation import compiled, inlined
from masking.numerics.integrators import held_late
from masking.numerics.rig_sizes import LANES, TOGETHER

Kernel = Callable[..., Any]


class Given(NamedTuple):
    """What a twin is simulated with.

    Args:
        p: the parameter array.
        basis: derivatives of its affected entries by the parameters (affected, k).
        spans: rows of `basis` that are not 0, and the first column, and the one after the last, in which each is not
            (3, rows), integers.
        coordinates: how many of the states are coordinates, whose rates are the states that follow them.
        late: samples after which each actuator acts.
    """

    p: Any
    basis: Any
    spans: Any
    coordinates: Any
    late: Any


class Late(NamedTuple):
    """Samples after which each actuator acts, where nothing else is given to `drive`."""

    late: Any


@inlined
def take(work, rows):
    """Return the first rows of a work space, and what remains of it."""
    return work[:rows], work[rows:]


@inlined
def command_at(commands, index, channel, late, part, is_linear):
    """Return a command a part of a sample after a sample, as it was `late` samples before.

    Commands go linearly between samples (first-order hold), or are held; then they are means over a sample. Before the
    first sample and after the last they are constant.
    """
    last = commands.shape[0] - 1
    at = index + (part if is_linear else 0.0) - late
    low = math.floor(at)
    share = at - low
    before, after = min(max(low, 0), last), min(max(low + 1, 0), last)
    return (1.0 - share) * commands[before, channel] + share * commands[after, channel]


@inlined
def drive(commands, index, step, substeps, dt, is_linear, given, u, end):
    """Write the commands u that act at the begin and `end` of an integration step after a sample."""
    for a in range(u.shape[0]):
        late = given.late[a]
        if is_linear:
            u[a] = command_at(commands, index, a, late, step / substeps, is_linear)
            end[a] = command_at(commands, index, a, late, (step + 1.0) / substeps, is_linear)
        else:
            mean, rise = held_late(commands, index, a, late, step, substeps)
            u[a], end[a] = mean - rise, mean + rise


@inlined
def add_rows(by, columns, n, row):
    """Add to a row (width,) the first n of `columns`, times `by`; two at once: measured, a row waits for its memory."""
    first, width = -1, columns.shape[1]
    for second in range(n):
        if by[second] == 0.0:
            continue
        if first < 0:
            first = second
            continue
        for j in range(width):
            row[j] += by[first] * columns[first, j] + by[second] * columns[second, j]
        first = -1
    if first >= 0:
        for j in range(width):
            row[j] += by[first] * columns[first, j]


@inlined
def add_chain(by_state, by_entry, columns, basis, spans, n, row):
    """Add to a row (width,) what n states with derivatives `columns` and entries of the parameter array do."""
    add_rows(by_state, columns, n, row)
    for m in range(spans.shape[1]):
        i = spans[0, m]
        by = by_entry[i]
        if by != 0.0:
            first, last = spans[1, m], spans[2, m]
            if last - first == 1:  # measured: most entries are of one parameter, and a loop takes longer to begin
                row[first] += by * basis[i, first]
                continue
            for j in range(first, last):
                row[j] += by * basis[i, j]


def motion_alone(derivative: Kernel) -> Kernel:
    """Make the flow of a motion without any columns, in which `given` is the parameter array."""

    @inlined
    def flow(t, y, columns, u, given, rate, column_rates, work):
        derivative(t, y, u, given, rate)

    return flow


def motion_with_columns(slopes: Kernel) -> Kernel:
    """Make the variational equations of a twin.

    Returns:
        `flow(t, y, columns, u, given, rate, column_rates, work)`, which writes y' and S'; `work` has 2 n rows.
    """

    @inlined
    def flow(t, y, columns, u, given, rate, column_rates, work):
        n, coordinates = columns.shape[0], given.coordinates
        by_state, work = take(work, n)
        by_entry, work = take(work, n)
        slopes(t, y, u, given.p, rate, by_state, by_entry)
        for i in range(n):
            for j in range(columns.shape[1]):
                column_rates[i, j] = columns[coordinates + i, j] if i < coordinates else 0.0
            if i >= coordinates:
                add_chain(by_state[i], by_entry[i], columns, given.basis, given.spans, n, column_rates[i])

    return flow


def readings_with_columns(sensed: Kernel) -> Kernel:
    """Make the readings of a twin and their derivatives.

    Returns:
        `read(t, dt, y, columns, commands, index, is_linear, given, s, rows, work)`, which writes the readings s at a
        sample and their derivatives in `rows` (sensors, width); `work` has 2 sensors + 2 rows.
    """

    @inlined
    def read(t, dt, y, columns, commands, index, is_linear, given, s, rows, work):
        n, sensors = columns.shape[0], rows.shape[0]
        by_state, work = take(work, sensors)
        by_entry, work = take(work, sensors)
        u = work[1][: commands.shape[1]]
        for a in range(u.size):
            u[a] = command_at(commands, index, a, given.late[a], 0.0, is_linear)
        sensed(t, y, u, given.p, work[0], s, by_state, by_entry)
        for o in range(sensors):
            for j in range(columns.shape[1]):
                rows[o, j] = 0.0
            add_chain(by_state[o], by_entry[o], columns, given.basis, given.spans, n, rows[o])

    return read


def runge_kutta_4(flow: Kernel) -> Kernel:
    """Make one step of the classical Runge-Kutta method for a motion and its columns.

    Args:
        flow: writes the rates of both.

    Returns:
        `advance(t, y, columns, stages, u, end, given, h, work)`, which moves y (n,) and the columns (n, width) over h,
        while the commands go linearly from u to `end`; `stages` (5 n, width) is work space, and `work` has 6 rows, and
        then those of the flow. Tables of the columns are contiguous: measured, a part of wider rows is not vectorised.
    """

    @inlined
    def advance(t, y, columns, stages, u, end, given, h, work):
        size, width, channels = columns.shape[0], columns.shape[1], u.shape[0]
        between, slopes = take(stages, size)  # the slopes of one stage after the other
        rates, work = take(work, 4)
        rows, work = take(work, 2)
        state, now = rows[0], rows[1][:channels]
        for stage in range(4):
            c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            for i in range(channels):
                now[i] = u[i] + c * (end[i] - u[i])
            for i in range(size):
                state[i] = y[i] + (c * h * rates[stage - 1, i] if stage > 0 else 0.0)
                for j in range(width):
                    between[i, j] = columns[i, j] + (c * h * slopes[(stage - 1) * size + i, j] if stage > 0 else 0.0)
            flow(
                t + c * h, state[:size], between, now, given, rates[stage],
                slopes[stage * size : (stage + 1) * size], work,
            )  # fmt: skip
        for i in range(size):
            y[i] += h / 6.0 * (rates[0, i] + 2.0 * (rates[1, i] + rates[2, i]) + rates[3, i])
            for j in range(width):
                total = slopes[size + i, j] + slopes[2 * size + i, j]
                columns[i, j] += h / 6.0 * (slopes[i, j] + 2.0 * total + slopes[3 * size + i, j])

    return advance


def simulation(sensed: Kernel, derivative: Kernel) -> Kernel:
    """Make the simulation of readings without derivatives.

    Args:
        sensed: `sensed(t, y, u, p, noise, s)` writes readings.
        derivative: writes y'.

    Returns:
        `simulate(count, dt, substeps, is_linear, y, p, commands, readings, work)`, which writes `readings` (count,
        sensors) from the state y on, which is the last state afterwards.
    """
    advance = runge_kutta_4(motion_alone(derivative))

    @compiled
    def simulate(
        count: int, dt: float, substeps: int, is_linear: int, y: Vector, p: Vector, commands: Matrix, readings: Matrix,
        work: Matrix,
    ) -> None:  # fmt: skip
        n, channels, h = y.size, commands.shape[1], dt / substeps
        rows, work = take(work, 4)
        noise, u, end, given = rows[0], rows[1][:channels], rows[2][:channels], Late(rows[3][:channels])
        none, work = take(work, n)
        work[:] = 0.0
        rows[:] = 0.0
        for index in range(count):
            t = index * dt
            sensed(t, y, commands[index], p, noise, readings[index])
            for step in range(substeps):
                drive(commands, index, step, substeps, dt, is_linear, given, u, end)
                advance(t + step * h, y, none[:n, :0], none[:, :0], u, end, p, h, work)

    return simulate


def normal_equations(read: Kernel, drive: Kernel, flow: Kernel) -> Kernel:
    """Make the accumulation of normal equations over a record.

    Args:
        read: writes readings and their derivatives, as that of `readings_with_columns`.
        drive: writes the commands of an integration step, as `drive`.
        flow: writes the rates of motion and columns.

    Returns:
        `accumulate(count, dt, substeps, interval, is_linear, free, starts, y, columns, given, commands, readings,
        weights, matrix, gradient, squares, simulated, read_work, work) -> status`, which is 1 if the motion is no
        longer finite. Every `interval` samples (multiple shooting) the motion starts again at a row of `starts`
        (intervals, n), where the states `free` may have any value, each with a column of S behind those of the basis;
        columns beyond these are 0 and count for nothing. Each shooting interval has `width` rows of `matrix` (J^T W J;
        above its diagonal, entries mean nothing) and entries of `gradient` (J^T W r). `squares` gets squared residuals
        (sensors,), `simulated` the readings. A reading that is not a number counts for nothing. States beyond n go on
        from one interval to the next. `columns` has `COLUMN_ROWS` rows for each state: the first are the columns, the
        others work space. `read_work` is work space of `read`.
    """
    advance = runge_kutta_4(flow)

    @inlined
    def restart(window, first, free, starts, y, columns):
        for i in range(columns.shape[0]):
            for j in range(first, columns.shape[1]):
                columns[i, j] = 0.0
        for i in range(starts.shape[1]):
            is_free = window == 0
            for m in range(free.size):
                is_free |= free[m] == i
            if is_free:
                y[i] = starts[window, i]
                for j in range(first):
                    columns[i, j] = 0.0
        for i in range(free.size):
            columns[free[i], first + i] = 1.0

    @inlined
    def add(at, width, rows, weighted, residuals, matrix, gradient):
        for i in range(width):
            last = min((i // LANES + 1) * LANES, width)
            for m in range(0, rows.shape[0], TOGETHER):
                first, second, third, fourth = rows[m], rows[m + 1], rows[m + 2], rows[m + 3]
                a, b = weighted[m] * first[i], weighted[m + 1] * second[i]
                c, d = weighted[m + 2] * third[i], weighted[m + 3] * fourth[i]
                if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:
                    continue
                total = gradient[at + i] + a * residuals[m] + b * residuals[m + 1]
                gradient[at + i] = total + c * residuals[m + 2] + d * residuals[m + 3]
                for j in range(last):
                    total = matrix[at + i, j] + a * first[j] + b * second[j]
                    matrix[at + i, j] = total + c * third[j] + d * fourth[j]
        weighted[: rows.shape[0]] = 0.0

    @inlined
    def accumulate(
        count, dt, substeps, interval, is_linear, free, starts, y, columns, given, commands, readings, weights, matrix,
        gradient, squares, simulated, read_work, work,
    ):  # fmt: skip
        channels, h, sensors = commands.shape[1], dt / substeps, readings.shape[1]
        first = given.basis.shape[1]
        width = first + free.size
        columns, stages = take(columns, y.size)
        rows, work = take(work, TOGETHER * sensors)
        vectors, work = take(work, 5)
        s, u, end = vectors[0], vectors[1][:channels], vectors[2][:channels]
        weighted, residuals = vectors[3], vectors[4]
        held = 0
        for index in range(count):
            t, window = index * dt, index // interval
            if index == window * interval:
                restart(window, first, free, starts, y, columns)
            now = held * sensors
            read(t, dt, y, columns, commands, index, is_linear, given, s, rows[now : now + sensors], read_work)
            for o in range(sensors):
                if not math.isfinite(s[o]):
                    return 1
                simulated[index, o] = s[o]
                residual = readings[index, o] - s[o]
                if not math.isnan(residual):
                    squares[o] += residual * residual
                    weighted[now + o], residuals[now + o] = weights[o], residual
            held += 1
            if held == TOGETHER or index + 1 == min((window + 1) * interval, count):
                add(window * width, width, rows, weighted, residuals, matrix, gradient)
                held = 0
            for step in range(substeps):
                drive(commands, index, step, substeps, dt, is_linear, given, u, end)
                advance(t + step * h, y, columns, stages, u, end, given, h, work)
        return 0

    return accumulate


def twin_normal_equations(slopes: Kernel, sensed: Kernel) -> Kernel:
    """Make the normal equations of a twin over one record, from one initial state.

    Returns:
        `normal(count, dt, substeps, is_linear, coordinates, free, starts, y, columns, p, basis, spans, late,
        commands, readings, weights, matrix, gradient, squares, simulated, work) -> status`, as `normal_equations`;
        `starts` is (1, n).
    """
    accumulate = normal_equations(readings_with_columns(sensed), drive, motion_with_columns(slopes))

    @compiled
    def normal(
        count: int, dt: float, substeps: int, is_linear: int, coordinates: int, free: IntVector, starts: Matrix,
        y: Vector, columns: Matrix, p: Vector, basis: Matrix, spans: IntMatrix, late: Vector, commands: Matrix,
        readings: Matrix, weights: Vector, matrix: Matrix, gradient: Vector, squares: Vector, simulated: Matrix,
        work: Matrix,
    ) -> int:  # fmt: skip
        given = Given(p, basis, spans, coordinates, late)
        work[:] = 0.0
        read_work, work = take(work, 2 * readings.shape[1] + 2)
        return accumulate(
            count, dt, substeps, count, is_linear, free, starts, y, columns, given, commands, readings, weights, matrix,
            gradient, squares, simulated, read_work, work,
        )  # fmt: skip

    return normal
