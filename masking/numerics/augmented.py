"""Augmented model: how a rig moves with trial effects at its places, and how that depends on all parameters.

A force port at each place and an offset of each actuator are entries of the rig's parameter array. Instances of effects
(`instances`) drive these ports; they are laws that know no rig, each with a number:
`law(number, t, x, rate, z, values, rows)`. States of effects follow those of the rig in y. At an instant, the effects
act first: forces, commands and rates of their states. Then the equations of the rig are evaluated. Sensors that read a
force or a command at once see what the effects do, too.
Kernels serve any rig: its functions are linked to them, and the table of `rig_sizes` has its sizes and indices.
Source: as `variational`; of inertias as `inertia`.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0912, PLR0917
# The types are numba's to infer.

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from masking.numerics.arrays import IntMatrix, IntVector, Matrix, Vector
from masking.numerics.compilation import compiled, inlined
from masking.numerics.inertia import accelerate, draw_rows
from masking.numerics.instances import (
    ACTUATOR,
    BY_DISPLACEMENT,
    BY_PARAMETER,
    BY_RATE,
    BY_STATE,
    ELEMENT,
    FIRST,
    INERTIA,
    KIND,
    LAW,
    PLACE,
    SENSOR,
    STATE,
    VALUE,
)
from masking.numerics.integrators import held_late
from masking.numerics.rig_sizes import (
    CHANNELS,
    COMMAND_COLUMNS,
    COORDINATES,
    FORCE_COLUMNS,
    FORCE_ENTRIES,
    IS_FED,
    PLACES,
    READ_ROWS,
    SENSORS,
    SIZES,
    STATES,
)
from masking.numerics.variational import add_chain, add_rows, command_at, drive, normal_equations, take

Kernel = Callable[..., Any]


class Given(NamedTuple):
    """What an augmented model is simulated with.

    Args:
        table: sizes and indices of the rig, as `rig_sizes` has them.
        p: the parameter array of the rig.
        basis: derivatives of its affected entries by the parameters (affected, k).
        spans: where `basis` is not 0 (3, rows), as `variational.Given` has them.
        instances: of effects, those of sensors last; columns as `instances` says.
        estimated: column of each parameter of an instance, -1 where it is not estimated (instances, parameters).
        values: parameters of the instances, one after the other.
        support: displacements, then rates, between which each instance acts (instances, 4).
        acts: 1 where an effect acts, of places, then of channels.
        late: delay of each channel, in samples.
        late_columns: column of each channel's delay, or -1.
        lead: derivative of each command by its delay.
    """

    table: Any
    p: Any
    basis: Any
    spans: Any
    instances: Any
    estimated: Any
    values: Any
    support: Any
    acts: Any
    late: Any
    late_columns: Any
    lead: Any


class Ports(NamedTuple):
    """What effects do at an instant.

    Args:
        forces, commands, inertias: derivatives by the columns (places, width), (channels, width), (places, width).
        followed: derivatives of displacements and rates by the state (2 places, n).
        pushed: what a unit of force adds to the rates, with the inertias before it (places, n).
        displacement: of each place, then its rate (2 places,).
        acceleration: of each place (places,); its inertia first.
        share: part of the acceleration without it that the force of an inertia is (places,).
        command: of each channel, after its effects (channels,).
    """

    forces: Any
    commands: Any
    inertias: Any
    followed: Any
    pushed: Any
    displacement: Any
    acceleration: Any
    share: Any
    command: Any


@inlined
def lead_of(commands, index, channel, late, part, dt, is_linear):
    """Return the derivative of a command by its delay: the difference over a sample about it."""
    before = command_at(commands, index, channel, late + 0.5, part, is_linear)
    after = command_at(commands, index, channel, late - 0.5, part, is_linear)
    return (before - after) / dt


@inlined
def drive_late(commands, index, step, substeps, dt, is_linear, given, u, end):
    """Write the delayed commands at the begin and `end` of an integration step, and their derivatives by the delay."""
    drive(commands, index, step, substeps, dt, is_linear, given, u, end)
    for a in range(u.shape[0]):
        late = given.late[a]
        if is_linear:
            given.lead[a] = lead_of(commands, index, a, late, (step + 0.5) / substeps, dt, is_linear)
        else:
            before, _ = held_late(commands, index, a, late + 0.5 / substeps, step, substeps)
            after, _ = held_late(commands, index, a, late - 0.5 / substeps, step, substeps)
            given.lead[a] = (before - after) * substeps / dt


@inlined
def ports_in(work, places, channels):
    """Return the work space of the ports, and what remains of it."""
    forces, work = take(work, places)
    commands, work = take(work, channels)
    inertias, work = take(work, places)
    followed, work = take(work, 2 * places)
    pushed, work = take(work, places)
    vectors, work = take(work, 4)
    return Ports(forces, commands, inertias, followed, pushed, vectors[0], vectors[1], vectors[2], vectors[3]), work


@inlined
def at_once(table, by_entry, forces, commands, j):
    """Return the derivative of a reading by column j through forces and commands at once.

    Its derivatives by the affected entries are `by_entry`.
    """
    total = 0.0
    if table[SIZES, IS_FED]:
        for e in range(table[SIZES, PLACES]):
            total += by_entry[table[FORCE_COLUMNS, e]] * forces[e, j]
        for a in range(table[SIZES, CHANNELS]):
            total += by_entry[table[COMMAND_COLUMNS, a]] * commands[a, j]
    return total


@inlined
def subject(kind, at, columns, given, ports, s, by_state, by_entry, by, by_rate):
    """Return what a law follows: the displacement of a place and its rate, a command, a reading, or 1 for an inertia.

    Derivatives by the columns go into `by` and `by_rate` (width,); those of the readings s are `by_state` and
    `by_entry`.
    """
    width, n, places = columns.shape[1], given.table[SIZES, STATES], given.table[SIZES, PLACES]
    for j in range(width):
        by[j] = ports.commands[at, j] if kind == ACTUATOR else 0.0
        by_rate[j] = 0.0
    if kind == ELEMENT:
        add_rows(ports.followed[at], columns, n, by)
        add_rows(ports.followed[places + at], columns, n, by_rate)
        return ports.displacement[at], ports.displacement[places + at]
    if kind == ACTUATOR:
        return ports.command[at], 0.0
    if kind == SENSOR:
        add_chain(by_state[at], by_entry[at], columns, given.basis, given.spans, n, by)
        for j in range(width):
            by[j] += at_once(given.table, by_entry[at], ports.forces, ports.commands, j)
        return s[at], 0.0
    return 1.0, 0.0


@inlined
def is_same_place(instances, i):
    """Tell whether instance i follows the same motion as the one before it."""
    return i > 0 and instances[i - 1, KIND] == instances[i, KIND] and instances[i - 1, PLACE] == instances[i, PLACE]


@inlined
def is_beyond(support, x, rate):
    """Tell whether a motion is where an effect does not act; measured: most pieces of a curve do not, most times."""
    return x < support[0] or x > support[1] or rate < support[2] or rate > support[3]


@inlined
def put_state(i, z, columns, given, rows, by, by_rate, rate, column_rates):
    """Put the rate of an effect's state where it is integrated, with its derivatives."""
    rate[z] = rows[1, VALUE]
    for j in range(columns.shape[1]):
        inside = rows[1, BY_STATE] * columns[z, j]
        column_rates[z, j] = rows[1, BY_DISPLACEMENT] * by[j] + rows[1, BY_RATE] * by_rate[j] + inside
    for m in range(given.estimated.shape[1]):
        if given.estimated[i, m] >= 0:
            column_rates[z, given.estimated[i, m]] += rows[1, BY_PARAMETER + m]


@inlined
def put(i, columns, given, ports, rows, by, by_rate, rate, column_rates):
    """Put what the law of instance i gives (`rows`) where it acts, with its derivatives."""
    kind, at, z = given.instances[i, KIND], given.instances[i, PLACE], given.instances[i, STATE]
    if z >= 0:
        put_state(i, z, columns, given, rows, by, by_rate, rate, column_rates)
    if kind == SENSOR:
        return
    if kind == ELEMENT:
        given.p[given.table[FORCE_ENTRIES, at]] += rows[0, VALUE]
        target = ports.forces[at]
    elif kind == ACTUATOR:
        ports.command[at] = rows[0, VALUE]
        target = ports.commands[at]
    else:
        ports.acceleration[at] += rows[0, VALUE]
        target = ports.inertias[at]
    by_motion, by_rates = rows[0, BY_DISPLACEMENT], rows[0, BY_RATE]
    if kind == ACTUATOR:
        for j in range(columns.shape[1]):
            target[j] = by_motion * by[j]
    elif kind == ELEMENT and (by_motion != 0.0 or by_rates != 0.0):  # pieces of a curve are 0 but for a few
        for j in range(columns.shape[1]):
            target[j] += by_motion * by[j] + by_rates * by_rate[j]
    if z >= 0:
        for j in range(columns.shape[1]):
            target[j] += rows[0, BY_STATE] * columns[z, j]
    for m in range(given.estimated.shape[1]):
        if given.estimated[i, m] >= 0:
            target[given.estimated[i, m]] += rows[0, BY_PARAMETER + m]


@inlined
def clear(u, width, given, ports):
    """Take forces and inertias out of the ports, and put commands into them."""
    table = given.table
    for e in range(table[SIZES, PLACES]):
        given.p[table[FORCE_ENTRIES, e]] = 0.0
        ports.acceleration[e] = 0.0
        if given.acts[e]:
            for j in range(width):
                ports.forces[e, j] = 0.0
                ports.inertias[e, j] = 0.0
    for a in range(table[SIZES, CHANNELS]):
        ports.command[a] = u[a]
        if given.acts[table[SIZES, PLACES] + a]:
            for j in range(width):
                ports.commands[a, j] = 0.0
            if given.late_columns[a] >= 0:
                ports.commands[a, given.late_columns[a]] = given.lead[a]


def effects_at_ports(law: Kernel, placed: Kernel, sensed: Kernel) -> Kernel:
    """Make what effects do at an instant.

    Args:
        law: writes what a law gives, and its derivatives.
        placed: `placed(t, y, u, p, d, by_state)` writes displacements, then rates, of places, and their derivatives.
        sensed: writes readings, and their derivatives.

    Returns:
        `act(t, y, columns, u, given, rate, column_rates, ports, work) -> has_inertia`, which writes forces into the
        parameter array, and commands, inertias and derivatives into `ports`, the latter only where an effect acts; the
        rates of the effects' states go into `rate` and `column_rates`. `work` has 2 sensors + 6 rows.
    """

    @inlined
    def act(t, y, columns, u, given, rate, column_rates, ports, work):
        by_state, work = take(work, given.table[SIZES, SENSORS])
        by_entry, work = take(work, given.table[SIZES, SENSORS])
        rows, work = take(work, 2)
        s, noise, by, by_rate = work[0], work[1], work[2], work[3]
        instances = given.instances
        clear(u, columns.shape[1], given, ports)
        has_elements, has_inertia, is_sensed, x, moved = False, False, False, 0.0, 0.0
        for i in range(instances.shape[0]):
            has_elements |= instances[i, KIND] == ELEMENT
            has_inertia |= instances[i, KIND] == INERTIA
        if has_elements or has_inertia:
            placed(t, y, ports.command, given.p, ports.displacement, ports.followed)
        for i in range(instances.shape[0]):
            kind, z = instances[i, KIND], instances[i, STATE]
            if kind == SENSOR and z < 0:
                continue
            if kind == SENSOR and not is_sensed:
                sensed(t, y, ports.command, given.p, noise, s, by_state, by_entry)
                is_sensed = True
            if kind != ELEMENT or not is_same_place(instances, i):
                x, moved = subject(kind, instances[i, PLACE], columns, given, ports, s, by_state, by_entry, by, by_rate)
            if is_beyond(given.support[i], x, moved):
                continue
            inside = y[z] if z >= 0 else 0.0
            law(instances[i, LAW], t, x, moved, inside, given.values[instances[i, FIRST] :], rows)
            put(i, columns, given, ports, rows, by, by_rate, rate, column_rates)
        return has_inertia

    return act


def motion_with_effects(act: Kernel, slopes: Kernel) -> Kernel:
    """Make the variational equations of a rig with effects.

    Args:
        act: writes what effects do, as that of `effects_at_ports`.
        slopes: writes the rates of the rig's state, and their derivatives.

    Returns:
        `flow(t, y, columns, u, given, rate, column_rates, work)`, which writes y' and S'; `work` has 2 n rows, and then
        those of the ports.
    """

    @inlined
    def flow(t, y, columns, u, given, rate, column_rates, work):
        table, width = given.table, columns.shape[1]
        n, coordinates = table[SIZES, STATES], table[SIZES, COORDINATES]
        places, channels = table[SIZES, PLACES], table[SIZES, CHANNELS]
        by_state, work = take(work, n)
        by_entry, work = take(work, n)
        ports, work = ports_in(work, places, channels)
        has_inertia = act(t, y, columns, u, given, rate, column_rates, ports, work)
        for again in range(2 if has_inertia else 1):
            if again:
                accelerate(width, by_entry, given, rate, ports)
            slopes(t, y, ports.command, given.p, rate, by_state, by_entry)
        for i in range(n):
            for j in range(width):
                column_rates[i, j] = columns[coordinates + i, j] if i < coordinates else 0.0
            if i < coordinates:
                continue
            add_chain(by_state[i], by_entry[i], columns, given.basis, given.spans, n, column_rates[i])
            for e in range(places):
                if given.acts[e]:
                    by = by_entry[i, table[FORCE_COLUMNS, e]]
                    for j in range(width if by != 0.0 else 0):
                        column_rates[i, j] += by * ports.forces[e, j]
            for a in range(channels):
                if given.acts[places + a]:
                    by = by_entry[i, table[COMMAND_COLUMNS, a]]
                    for j in range(width if by != 0.0 else 0):
                        column_rates[i, j] += by * ports.commands[a, j]
        if has_inertia:
            for e in range(places):
                draw_rows(
                    n, coordinates, ports.share[e], ports.followed[e], ports.pushed[e], column_rates, work[0][:width]
                )

    return flow


def readings_with_effects(law: Kernel, act: Kernel, sensed: Kernel) -> Kernel:
    """Make the readings of a rig with effects, and their derivatives.

    Args:
        law: writes what a law gives, and its derivatives.
        act: writes what effects do, as that of `effects_at_ports`.
        sensed: writes readings, and their derivatives.

    Returns:
        `read`, as that of `variational.readings_with_columns`; `work` has `PortSizes.read_rows` rows.
    """

    @inlined
    def bend(t, y, columns, given, s, rows, by):
        for i in range(given.instances.shape[0]):
            if given.instances[i, KIND] == SENSOR:
                at, first, z = given.instances[i, PLACE], given.instances[i, FIRST], given.instances[i, STATE]
                law(given.instances[i, LAW], t, s[at], 0.0, y[z] if z >= 0 else 0.0, given.values[first:], by)
                s[at] = by[0, VALUE]
                for j in range(columns.shape[1]):
                    inside = by[0, BY_STATE] * columns[z, j] if z >= 0 else 0.0
                    rows[at, j] = by[0, BY_DISPLACEMENT] * rows[at, j] + inside
                for m in range(given.estimated.shape[1]):
                    j = given.estimated[i, m]
                    if j >= 0:
                        rows[at, j] += by[0, BY_PARAMETER + m]

    @inlined
    def read(t, dt, y, columns, commands, index, is_linear, given, s, rows, work):
        table, width, n = given.table, columns.shape[1], given.table[SIZES, STATES]
        sensors, channels = table[SIZES, SENSORS], table[SIZES, CHANNELS]
        by_state, work = take(work, sensors)
        by_entry, work = take(work, sensors)
        by, work = take(work, 2)
        vectors, work = take(work, 3)
        noise, u, rate = vectors[0], vectors[1][:channels], vectors[2]
        column_rates, work = take(work, columns.shape[0])
        ports, work = ports_in(work, table[SIZES, PLACES], channels)
        for a in range(channels):
            u[a] = command_at(commands, index, a, given.late[a], 0.0, is_linear)
            ports.command[a] = u[a]
            given.lead[a] = lead_of(commands, index, a, given.late[a], 0.0, dt, is_linear)
        if table[SIZES, IS_FED]:
            act(t, y, columns, u, given, rate, column_rates, ports, work)
        sensed(t, y, ports.command, given.p, noise, s, by_state, by_entry)
        for o in range(sensors):
            for j in range(width):
                rows[o, j] = at_once(table, by_entry[o], ports.forces, ports.commands, j)
            add_chain(by_state[o], by_entry[o], columns, given.basis, given.spans, n, rows[o])
        bend(t, y, columns, given, s, rows, by)

    return read


def augmented_normal_equations(law: Kernel, placed: Kernel, slopes: Kernel, sensed: Kernel) -> Kernel:
    """Make the normal equations of an augmented model over a record.

    Args:
        law: writes what a law gives, and its derivatives.
        placed: writes displacements and rates of places, with derivatives.
        slopes: writes the rates of the rig's state, and their derivatives.
        sensed: writes readings, and their derivatives.

    Returns:
        `normal(count, dt, substeps, interval, is_linear, table, free, starts, y, columns, p, basis, spans, instances,
        estimated, values, support, acts, late, late_columns, commands, readings, weights, matrix, gradient, squares,
        simulated, work) -> status`, as `variational.normal_equations`, with the arrays of `Given`.
    """
    act = effects_at_ports(law, placed, sensed)
    accumulate = normal_equations(readings_with_effects(law, act, sensed), drive_late, motion_with_effects(act, slopes))

    @compiled
    def normal(
        count: int, dt: float, substeps: int, interval: int, is_linear: int, table: IntMatrix, free: IntVector,
        starts: Matrix, y: Vector, columns: Matrix, p: Vector, basis: Matrix, spans: IntMatrix, instances: IntMatrix,
        estimated: IntMatrix, values: Vector, support: Matrix, acts: IntVector, late: Vector, late_columns: IntVector,
        commands: Matrix, readings: Matrix, weights: Vector, matrix: Matrix, gradient: Vector, squares: Vector,
        simulated: Matrix, work: Matrix,
    ) -> int:  # fmt: skip
        work[:] = 0.0
        first, work = take(work, 1)
        read_work, work = take(work, table[SIZES, READ_ROWS])
        lead = first[0][: table[SIZES, CHANNELS]]
        given = Given(table, p, basis, spans, instances, estimated, values, support, acts, late, late_columns, lead)
        return accumulate(
            count, dt, substeps, interval, is_linear, free, starts, y, columns, given, commands, readings, weights,
            matrix, gradient, squares, simulated, read_work, work,
        )  # fmt: skip

    return normal
