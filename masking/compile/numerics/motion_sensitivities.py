"""Variational equations: a simulated motion and its derivatives by parameters and initial values, in one pass.

    y' = f(t, y, u, p),    S' = (df/dy) S + (df/dp) B

The columns of S are derivatives of the state y by what is estimated; B (`basis`) says how the entries of the parameter
array depend on it. Both are integrated by the classical Runge-Kutta method with the same steps, so that S is the exact
derivative of the computed y: the motion of a step comes first, with df/dy and (df/dp) B at each of its stages, and then
the columns, which are linear in these. What a least-squares fit needs, the normal equations, is accumulated sample by
sample.
Source: Hairer, Norsett and Wanner (1993), Solving Ordinary Differential Equations I, section I.14 and Table II.1.2;
Ljung, System Identification (1999), section 10.3.

Kernels serve any rig: sizes are those of the arrays. Functions of a rig, with n states y = coordinates, velocities,
others, are linked to them:

* `derivative(t, y, u, p, rate)` writes y';
* `slopes(t, y, u, p, rate, by_state, by_entry)` writes y', df/dy (n, n) and df/dp (n, affected);
* `sensed(t, y, u, p, noise, s, by_state, by_entry)` writes the readings s and their derivatives;
* `carry(by_state, by_column, columns, h)` moves the columns S (n, width) over a step, `codegen.column_step`.

`given` stands for the arrays that a rig is simulated with: `TwinArrays` for a twin.
Kernels need work space of zeros, and take rows of it from the top.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from masking.compile.numerics.arrays import Kernel, Matrix
from masking.compile.numerics.compilation import compiled, inlined, requires
from masking.compile.numerics.kernel_arguments import Readings, Shooting, Steps, Sums, TwinArrays
from masking.compile.numerics.rig_sizes import LANES, TOGETHER
from masking.compile.numerics.runge_kutta import OF_STATE, classical_step, held_late, part_at
from masking.compile.numerics.vectors import add_products, cleared

# Of a record whose normal equations are summed up, for n states, `sensors`, `channels` and columns, in work space that
# is `wide`.
OF_RECORD = (
    "(n := len(shooting.y)) >= max(linked.y, linked.rate, linked.columns) and len(given.p) >= linked.p",
    "(channels := record.commands.shape[1]) >= linked.u and (sensors := record.readings.shape[1]) >= linked.s",
    f"(wide := work.shape[1]) >= max(linked.width, n, channels, {TOGETHER} * sensors) and wide % {LANES} == 0",
    "(columns := shooting.columns.shape[1]) <= min(wide, sums.matrix.shape[1]) and len(shooting.columns) >= 5 * n",
    f"columns % {LANES} == 0 and 0 <= shooting.k and within(shooting.free, n)",
    "(width := shooting.k + len(shooting.free)) <= columns and shooting.starts.shape[1] <= n",
    "(windows := -(-max(steps.samples, 1) // interval)) <= len(shooting.starts)",
    "windows * width <= min(len(sums.matrix), len(sums.gradient))",
    "steps.samples <= min(len(record.readings), len(sums.simulated)) and len(record.commands) > 0",
    "sensors <= min(len(record.weights), len(sums.squares), sums.simulated.shape[1]) and len(given.late) >= channels",
    "are_terms(given.read, given.read_by, sensors, wide, columns)",
    "channels <= min(len(given.lead), len(given.late_columns)) and within(given.late_columns + 1, columns + 1)",
    "0 <= given.commanded <= wide - channels",
)


class Late(NamedTuple):
    """Samples after which each actuator acts, where nothing else is given to `drive`."""

    late: Any


class Derivatives(NamedTuple):
    """Derivatives of rates or readings, a row each."""

    by_state: Any  # df/dy (rows, n)
    by_column: Any  # (df/dp) B (rows, width), by what is estimated while the state is held


@inlined
def take(work, rows):
    """First rows of a work space, and what remains of it."""
    return work[:rows], work[rows:]


@inlined
def command_at(commands, index, channel, late, part, is_linear):
    """Command a part of a sample after a sample, as it was `late` samples before.

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
def drive(commands, index, step, steps, given, u, end):
    """Write the commands u that act at the begin and `end` of an integration step after a sample."""
    substeps, is_linear = steps.substeps, steps.is_linear
    for a in range(u.shape[0]):
        late = given.late[a]
        if is_linear:
            u[a] = command_at(commands, index, a, late, step / substeps, is_linear)
            end[a] = command_at(commands, index, a, late, (step + 1.0) / substeps, is_linear)
        else:
            mean, rise = held_late(commands, index, a, late, step, substeps)
            u[a], end[a] = mean - rise, mean + rise


@inlined
def lead_of(commands, index, channel, late, part, dt, is_linear):
    """Derivative of a command by its delay: the difference over a sample about it."""
    before = command_at(commands, index, channel, late + 0.5, part, is_linear)
    after = command_at(commands, index, channel, late - 0.5, part, is_linear)
    return (before - after) / dt


@inlined
def drive_late(commands, index, step, steps, given, u, end):
    """Write what `drive` does, and the derivatives by delays that are estimated."""
    substeps, dt, is_linear = steps.substeps, steps.dt, steps.is_linear
    drive(commands, index, step, steps, given, u, end)
    for a in range(u.shape[0]):
        late = given.late[a]
        if given.late_columns[a] < 0:
            continue
        if is_linear:
            given.lead[a] = lead_of(commands, index, a, late, (step + 0.5) / substeps, dt, is_linear)
        else:
            before, _ = held_late(commands, index, a, late + 0.5 / substeps, step, substeps)
            after, _ = held_late(commands, index, a, late - 0.5 / substeps, step, substeps)
            given.lead[a] = (before - after) * substeps / dt


@inlined
def put_entries(by_entry, terms, values, first, out):
    """Write (df/dp) B into the rows of a table from `first` on, which are 0 where there is no term.

    `by_entry` is df/dp (rows, affected); `terms` (3, terms) are integers: rows, entries and columns whose products are
    not 0, with `values` (terms,) of B.
    """
    cleared(out, first, out.shape[0])
    for m in range(values.size):
        i, j = np.uintp(terms[0, m]), np.uintp(terms[2, m])
        out[i, j] += by_entry[i, np.uintp(terms[1, m])] * values[m]


@inlined
def add_leads(by_entry, given, first, out):
    """Add what delays do to the rows of a table from `first` on; columns of commands are the last of `by_entry`."""
    for a in range(given.late_columns.size):
        column = given.late_columns[a]
        if column >= 0:
            for i in range(first, out.shape[0]):
                out[i, column] += by_entry[i, given.commanded + a] * given.lead[a]


def motion_alone(derivative: Kernel) -> Kernel:
    """Make the flow of a motion without derivatives, in which `given` is the parameter array."""

    @inlined
    def flow(t, y, u, given, rate, made, work):
        derivative(t, y, u, given, rate)

    return flow


def motion_with_derivatives(slopes: Kernel) -> Kernel:
    """Make the flow of a twin's motion.

    Returns `flow(t, y, u, given, rate, made, work)`, which writes y' and its derivatives, the latter but those of
    coordinates; `work` has n rows.
    """

    @inlined
    def flow(t, y, u, given, rate, made, work):
        by_entry, _ = take(work, y.size)
        slopes(t, y, u, given.p, rate, made.by_state, by_entry)
        put_entries(by_entry, given.moved, given.moved_by, given.coordinates, made.by_column)
        add_leads(by_entry, given, given.coordinates, made.by_column)

    return flow


def readings_with_derivatives(sensed: Kernel) -> Kernel:
    """Make the readings of a twin and their derivatives.

    Returns `read(steps, y, commands, index, given, s, made, work)`, which writes the readings s at a sample and their
    derivatives; `work` has sensors + 2 rows.
    """

    @inlined
    def read(steps, y, commands, index, given, s, made, work):
        sensors = made.by_state.shape[0]
        by_entry, work = take(work, sensors)
        u = work[1][: commands.shape[1]]
        for a in range(u.size):
            u[a] = command_at(commands, index, a, given.late[a], 0.0, steps.is_linear)
            if given.late_columns[a] >= 0:
                given.lead[a] = lead_of(commands, index, a, given.late[a], 0.0, steps.dt, steps.is_linear)
        sensed(index * steps.dt, y, u, given.p, work[0], s, made.by_state, by_entry)
        put_entries(by_entry, given.read, given.read_by, 0, made.by_column)
        add_leads(by_entry, given, 0, made.by_column)

    return read


def driven_step(flow: Kernel) -> Kernel:
    """Make one step of a motion whose rates and their derivatives `flow` writes.

    Returns `advance(t, y, u, end, given, h, stages, work)`, which moves y (n,) over h, while the commands go linearly
    from u to `end`; `stages` (4 n rows) gets the derivatives of each stage after the other, and `work` has 6 rows, and
    then those of the flow.
    """

    @inlined
    def slope(t, stage, y, drives, moving, rate):
        begin, end, now = drives
        given, stages, work = moving
        c = part_at(stage)
        for i in range(now.size):
            now[i] = begin[i] + c * (end[i] - begin[i])
        of_stage = slice(stage * y.size, (stage + 1) * y.size)
        flow(t, y, now, given, rate, Derivatives(stages.by_state[of_stage], stages.by_column[of_stage]), work)

    step = classical_step(slope, OF_STATE)

    @inlined
    def advance(t, y, u, end, given, h, stages, work):
        rates, work = take(work, 4)
        rows, work = take(work, 2)
        step(t, y, (u, end, rows[1][: u.size]), (given, stages, work), h, rates, rows[0][: y.size])

    return advance


@inlined
def restart(window, shooting, columns):
    """Begin a shooting interval: with the state of its start, and columns of 1 for free states."""
    first, free, starts, y, _ = shooting
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
def add(at, width, rows, weighted, residuals, products, matrix, gradient):
    """Add rows of readings to the normal equations from a row on, and forget their weights."""
    many = rows.shape[0]
    for i in range(width):
        for m in range(many):
            products[0, m] = weighted[m] * rows[m, i]
            gradient[at + i] += products[0, m] * residuals[m]
        for j in range(0, i + 1, LANES):
            add_products(products, (0, 0), many, rows, 0, matrix, (at + i, j))
    weighted[:many] = 0.0


def normal_equations(slopes: Kernel, sensed: Kernel, carry: Kernel) -> Kernel:
    """Make the accumulation of the normal equations of a twin over a record.

    Returns `normal(steps, interval, shooting, given, record, sums, work) -> status`, which is 1 if the motion is no
    longer finite. Every `interval` samples (multiple shooting) the motion starts again at a row of `starts`, where the
    states `free` may have any value, each with a column of S behind the k of the basis; columns beyond these are 0 and
    count for nothing. Each shooting interval has `width` rows of `matrix` (J^T W J; above its diagonal, entries mean
    nothing, and rows are as long as those of `columns`) and entries of `gradient` (J^T W r). A reading that is not a
    number counts for nothing. States beyond those of `starts` go on from one interval to the next.
    """
    advance, read = driven_step(motion_with_derivatives(slopes)), readings_with_derivatives(sensed)

    @compiled
    @requires(
        "interval > 0",
        *OF_RECORD,
        "len(work) >= 5 * n + 6 * sensors + 14 and 0 <= given.coordinates <= n",
        "are_terms(given.moved, given.moved_by, n, wide, columns)",
    )
    def normal(
        steps: Steps, interval: int, shooting: Shooting, given: TwinArrays, record: Readings, sums: Sums, work: Matrix
    ) -> int:
        work[:] = 0.0
        read_work, work = take(work, record.readings.shape[1] + 2)
        count, dt, substeps, _ = steps
        first, free, y = shooting.k, shooting.free, shooting.y
        commands, readings, weights = record
        matrix, gradient, squares, simulated = sums
        n, channels, h, sensors = y.size, commands.shape[1], dt / substeps, readings.shape[1]
        width = first + free.size
        columns, moved = take(shooting.columns, n)
        by_state, work = take(work, 4 * n)
        stages = Derivatives(by_state, moved)
        read_by_state, work = take(work, sensors)
        rows, work = take(work, TOGETHER * sensors)
        vectors, work = take(work, 5)
        s, u, end = vectors[0], vectors[1][:channels], vectors[2][:channels]
        weighted, residuals = vectors[3], vectors[4]
        products, work = take(work, 1)
        held = 0
        for index in range(count):
            t, window = index * dt, index // interval
            if index == window * interval:
                restart(window, shooting, columns)
            now = held * sensors
            made = Derivatives(read_by_state, rows[now : now + sensors])
            read(steps, y, commands, index, given, s, made, read_work)
            for o in range(sensors):
                for j in range(0, columns.shape[1], LANES):
                    add_products(read_by_state, (o, 0), n, columns, 0, rows, (now + o, j))
                if not math.isfinite(s[o]):
                    return 1
                simulated[index, o] = s[o]
                residual = readings[index, o] - s[o]
                if not math.isnan(residual):
                    squares[o] += residual * residual
                    weighted[now + o], residuals[now + o] = weights[o], residual
            held += 1
            if held == TOGETHER or index + 1 == min((window + 1) * interval, count):
                add(window * width, width, rows, weighted, residuals, products, matrix, gradient)
                held = 0
            for step in range(substeps):
                drive_late(commands, index, step, steps, given, u, end)
                advance(t + step * h, y, u, end, given, h, stages, work)
                carry(stages.by_state, stages.by_column, columns, h)
        return 0

    return normal
