"""Augmented model: how a rig moves with trial effects at its places, and how that depends on all parameters.

A force port at each place and an offset of each actuator are entries of the rig's parameter array. Instances of effects
(`instances`) drive these ports; they are laws that know no rig, each with a number:
`law(number, t, x, rate, z, z2, values, rows)`. States of effects follow those of the rig in y. At an instant, the
effects act first: forces, commands and rates of their states. Then the equations of the rig are evaluated. Sensors that
read a force or a command at once see what the effects do, too.
Kernels serve any rig: its functions are linked to them, and the table of `rig_sizes` has its sizes and indices.
Source: as `motion_sensitivities`; of inertias as `inertia`.
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0912, PLR0917
# The types are numba's to infer.

from __future__ import annotations

from typing import Any, NamedTuple

from masking.compile.numerics.arrays import Kernel, Matrix
from masking.compile.numerics.compilation import compiled, inlined, requires
from masking.compile.numerics.effect_table import (
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
    LAW_ROWS,
    PLACE,
    RATES,
    SENSOR,
    STATE,
    STATE_COUNT,
    VALUE,
)
from masking.compile.numerics.inertia import accelerate, draw_rows
from masking.compile.numerics.kernel_arguments import AugmentedArrays, Readings, Shooting, Steps, Sums
from masking.compile.numerics.motion_sensitivities import (
    OF_RECORD,
    command_at,
    drive,
    normal_equations,
    put_entries,
    rows_in,
    take,
)
from masking.compile.numerics.rig_sizes import (
    CHANNELS,
    COORDINATES,
    FORCE_ENTRIES,
    INPUT_COLUMNS,
    IS_FED,
    LANES,
    PLACES,
    READ_ROWS,
    SENSORS,
    SIZES,
    STATES,
)
from masking.compile.numerics.runge_kutta import held_late
from masking.compile.numerics.vectors import add_products, cleared

# Of effects, after `OF_RECORD`, for a rig of `own` states with places, and work space of `rows`.
OF_EFFECTS = (
    f"len(given.table) >= 3 and given.table.shape[1] > {READ_ROWS}",
    f"max(linked.y, linked.rate, linked.columns) <= (own := given.table[{SIZES}, {STATES}]) <= n",
    f"0 <= given.table[{SIZES}, {COORDINATES}] <= own // 2 and given.table[{SIZES}, {SENSORS}] == sensors",
    f"0 <= (places := given.table[{SIZES}, {PLACES}]) and linked.d <= 2 * places <= wide",
    f"given.table[{SIZES}, {CHANNELS}] == channels and given.table.shape[1] >= places + channels",
    f"within(given.table[{FORCE_ENTRIES}, :places], len(given.p))",
    f"within(given.table[{INPUT_COLUMNS}, : places + channels], wide) and within(given.acting, places + channels)",
    "channels <= min(len(given.lead), len(given.late_columns)) and within(given.late_columns + 1, columns + 1)",
    f"(rows := 4 * sensors + 7 * places + 2 * (channels + n + {LAW_ROWS}) + 9) <= given.table[{SIZES}, {READ_ROWS}]",
    f"rows >= 0 and len(work) >= given.table[{SIZES}, {READ_ROWS}] + 2 * n + own + 4 * sensors + 8 + rows",
    "are_terms(given.moved, given.moved_by, own, wide, columns)",
    "(effects := len(given.instances)) <= min(len(given.support), len(given.estimated)) and given.support.shape[1] > 3",
    f"given.instances.shape[1] > {STATE_COUNT} and given.estimated.shape[1] + {BY_PARAMETER} <= wide",
    "within(given.estimated + 1, columns + 1)",
    f"within((at := given.instances[:, {PLACE}])[(kinds := given.instances[:, {KIND}]) == {ACTUATOR}], channels)",
    f"within(at[kinds == {SENSOR}], sensors) and within(at[(kinds == {ELEMENT}) | (kinds == {INERTIA})], places)",
    f"within(z := given.instances[:, {STATE}], n + 1) and within(z + given.instances[:, {STATE_COUNT}], n + 1)",
    f"within(given.instances[:, {FIRST}], len(given.values) + 1)",
    "all(first + linked.case('theta', law) <= len(given.values)"
    f" for law, first in given.instances[:, [{LAW}, {FIRST}]].tolist())",
)


class Ports(NamedTuple):
    """Action of effects at an instant."""

    inputs: Any  # derivatives of the force at each place, then of the command of each channel
    inertias: Any  # derivatives of the inertia at each place
    followed: Any  # derivatives of displacements and rates by the state (2 places, n)
    pushed: Any  # what a unit of force adds to the rates, with the inertias before it (places, n)
    displacement: Any  # of each place, then its rate (2 places,)
    acceleration: Any  # of each place (places,); its inertia first
    share: Any  # part of the acceleration without it that the force of an inertia is (places,)
    command: Any  # of each channel, after its effects (channels,)


@inlined
def lead_of(commands, index, channel, late, part, dt, is_linear):
    """Derivative of a command by its delay: the difference over a sample about it."""
    before = command_at(commands, index, channel, late + 0.5, part, is_linear)
    after = command_at(commands, index, channel, late - 0.5, part, is_linear)
    return (before - after) / dt


@inlined
def drive_late(commands, index, step, steps, given, u, end):
    """Write the delayed commands at the begin and `end` of an integration step, and their derivatives by the delay."""
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
def ports_in(work, places, channels):
    """Work space of the ports, and what remains of it."""
    inputs, work = rows_in(work, places + channels)
    inertias, work = rows_in(work, places)
    followed, work = take(work, 2 * places)
    pushed, work = take(work, places)
    vectors, work = take(work, 4)
    return Ports(inputs, inertias, followed, pushed, vectors[0], vectors[1], vectors[2], vectors[3]), work


@inlined
def add_row(by, r, c, source, i, extent, target, o):
    """Add a row of derivatives, by as many states and columns as `extent` says, times by[r, c], to another."""
    n, width = extent
    add_vectors(by, r, c, source.by_state, i, n, target.by_state, o)
    add_vectors(by, r, c, source.by_column, i, width, target.by_column, o)


@inlined
def add_vectors(by, r, c, source, i, n, target, o):
    """Add the first n of a row, times by[r, c], to another, in whole vectors."""
    for at in range(0, n, LANES):
        add_products(by, (r, c), 1, source, i, target, (o, at))


@inlined
def scale_row(by, target, o, n, width):
    """Multiply a row of derivatives."""
    for j in range(n):
        target.by_state[o, j] *= by
    for j in range(width):
        target.by_column[o, j] *= by


@inlined
def add_inputs(by_entry, i, given, inputs, n, target):
    """Add to derivatives of a rate or reading i what acts at the ports; `by_entry` are those by affected entries."""
    for q in given.acting:
        column = given.table[INPUT_COLUMNS, q]
        if by_entry[i, column] != 0.0:
            add_row(by_entry, i, column, inputs, q, (n, target.by_column.shape[1]), target, i)


@inlined
def put_readings(by_entry, given, ports, n, made):
    """Complete the derivatives of readings: by states of effects, by columns, and through what acts at the ports."""
    put_entries(by_entry, given.read, given.read_by, 0, made.by_column)
    for o in range(made.by_column.shape[0]):
        for z in range(given.table[SIZES, STATES], n):
            made.by_state[o, z] = 0.0
        if given.table[SIZES, IS_FED]:
            add_inputs(by_entry, o, given, ports.inputs, n, made)


@inlined
def is_beyond(support, x, rate):
    """Whether a motion is where an effect does not act; measured: most pieces of a curve do not, most times."""
    return x < support[0] or x > support[1] or rate < support[2] or rate > support[3]


@inlined
def states_in(y, given, i):
    """Values of the states of effect i, 0 of those that it has not."""
    z, many = given.instances[i, STATE], given.instances[i, STATE_COUNT]
    return y[z] if many > 0 else 0.0, y[z + 1] if many > 1 else 0.0


@inlined
def add_law(i, by, given, target, o):
    """Add to derivatives what a law gives (`by`) by the states of its effect i, and by its parameters."""
    for k in range(given.instances[i, STATE_COUNT]):
        target.by_state[o, given.instances[i, STATE] + k] += by[BY_STATE + k]
    for m in range(given.estimated.shape[1]):
        if given.estimated[i, m] >= 0:
            target.by_column[o, given.estimated[i, m]] += by[BY_PARAMETER + m]


@inlined
def add_motion(seat, by, r, extent, ports, readings, target, o):
    """Add to derivatives what a law gives (row r of `by`) by what it follows: a place, a command or a reading.

    `seat` is the kind and the index of that, `extent` the numbers of states and of columns, `ports` what acts at the
    ports, `readings` derivatives of readings, and row o of `target` what is added to.
    """
    kind, at = seat
    n, places = extent[0], ports.inertias.by_state.shape[0]
    if kind == ELEMENT:
        if by[r, BY_DISPLACEMENT] != 0.0 or by[r, BY_RATE] != 0.0:  # pieces of a curve are 0 but for a few
            add_vectors(by, r, BY_DISPLACEMENT, ports.followed, at, n, target.by_state, o)
            add_vectors(by, r, BY_RATE, ports.followed, places + at, n, target.by_state, o)
    elif kind == ACTUATOR:
        add_row(by, r, BY_DISPLACEMENT, ports.inputs, places + at, extent, target, o)
    elif kind == SENSOR:
        add_row(by, r, BY_DISPLACEMENT, readings, at, extent, target, o)


@inlined
def clear(u, n, given, has_inertia, ports):
    """Take forces and inertias out of the ports, and put commands into them."""
    table, places = given.table, given.table[SIZES, PLACES]
    for a in range(table[SIZES, CHANNELS]):
        ports.command[a] = u[a]
    for q in given.acting:
        clear_row(ports.inputs, q, n)
        if q < places:
            given.p[table[FORCE_ENTRIES, q]] = 0.0
            if has_inertia:
                ports.acceleration[q] = 0.0
                clear_row(ports.inertias, q, n)
        elif given.late_columns[q - places] >= 0:
            ports.inputs.by_column[q, given.late_columns[q - places]] = given.lead[q - places]


@inlined
def clear_row(target, o, n):
    """Make a row of derivatives 0."""
    for j in range(n):
        target.by_state[o, j] = 0.0
    cleared(target.by_column, o, o + 1)


def effects_at_ports(law: Kernel, placed: Kernel, sensed: Kernel) -> Kernel:
    """Make the action of effects at an instant.

    `law` writes what a law gives, `sensed` readings, and `placed(t, y, u, p, d, by_state)` displacements, then rates,
    of places, each with derivatives.

    Returns `act(t, y, u, given, rate, made, ports, work) -> has_inertia`, which writes forces into the parameter array,
    and commands, inertias and derivatives into `ports`, the latter only where an effect acts; the rates of the effects'
    states go into `rate`, their derivatives into `made`. `work` has 3 sensors + 5 rows.
    """

    @inlined
    def act(t, y, u, given, rate, made, ports, work):
        n, width, places = y.size, made.by_column.shape[1], given.table[SIZES, PLACES]
        readings, work = rows_in(work, given.table[SIZES, SENSORS])
        by_entry, work = take(work, given.table[SIZES, SENSORS])
        rows, work = take(work, LAW_ROWS)
        s, noise = work[0], work[1]
        instances = given.instances
        has_elements, has_inertia, is_sensed = False, False, False
        for i in range(instances.shape[0]):
            has_elements |= instances[i, KIND] == ELEMENT
            has_inertia |= instances[i, KIND] == INERTIA
        clear(u, n, given, has_inertia, ports)
        if has_elements or has_inertia:
            placed(t, y, ports.command, given.p, ports.displacement, ports.followed)
        for i in range(instances.shape[0]):
            kind, at, many = instances[i, KIND], instances[i, PLACE], instances[i, STATE_COUNT]
            if kind == SENSOR and many == 0:
                continue
            if kind == SENSOR and not is_sensed:
                sensed(t, y, ports.command, given.p, noise, s, readings.by_state, by_entry)
                put_readings(by_entry, given, ports, n, readings)
                is_sensed = True
            x, moved = 1.0, 0.0  # of an inertia
            if kind == ELEMENT:
                x, moved = ports.displacement[at], ports.displacement[places + at]
            elif kind == ACTUATOR:
                x = ports.command[at]
            elif kind == SENSOR:
                x = s[at]
            if is_beyond(given.support[i], x, moved):
                continue
            first, second = states_in(y, given, i)
            law(instances[i, LAW], t, x, moved, first, second, given.values[instances[i, FIRST] :], rows)
            for k in range(many):
                z = instances[i, STATE] + k
                rate[z] = rows[RATES + k, VALUE]
                clear_row(made, z, n)
                add_motion((kind, at), rows, RATES + k, (n, width), ports, readings, made, z)
                add_law(i, rows[RATES + k], given, made, z)
            if kind == ELEMENT:
                given.p[given.table[FORCE_ENTRIES, at]] += rows[0, VALUE]
                add_motion((kind, at), rows, 0, (n, width), ports, readings, ports.inputs, at)
                add_law(i, rows[0], given, ports.inputs, at)
            elif kind == ACTUATOR:
                ports.command[at] = rows[0, VALUE]
                scale_row(rows[0, BY_DISPLACEMENT], ports.inputs, places + at, n, width)
                add_law(i, rows[0], given, ports.inputs, places + at)
            elif kind == INERTIA:
                ports.acceleration[at] += rows[0, VALUE]
                add_law(i, rows[0], given, ports.inertias, at)
        return has_inertia

    return act


def motion_with_effects(act: Kernel, slopes: Kernel) -> Kernel:
    """Make the flow of a rig with effects: `act` is that of `effects_at_ports`, `slopes` writes the rates of its state.

    Returns `flow(t, y, u, given, rate, made, work)`, as that of `motion_sensitivities.motion_with_derivatives`; `work`
    has as many rows as the rig has states, then those of the ports, and one more.
    """

    @inlined
    def flow(t, y, u, given, rate, made, work):
        table, width = given.table, made.by_column.shape[1]
        n, coordinates, places = table[SIZES, STATES], table[SIZES, COORDINATES], table[SIZES, PLACES]
        by_entry, work = take(work, n)
        ports, work = ports_in(work, places, table[SIZES, CHANNELS])
        total, work = take(work, 1)
        has_inertia = act(t, y, u, given, rate, made, ports, work)
        by_state, by_column = made.by_state[:n], made.by_column[:n]
        for again in range(2 if has_inertia else 1):
            if again:
                accelerate(y.size, width, by_entry, given, rate, ports)
            slopes(t, y, ports.command, given.p, rate, made.by_state, by_entry)
        put_entries(by_entry, given.moved, given.moved_by, coordinates, by_column)
        for i in range(coordinates, n):
            for z in range(n, y.size):
                by_state[i, z] = 0.0
            add_inputs(by_entry, i, given, ports.inputs, y.size, made)
        if has_inertia:
            for e in range(places):
                share, followed, pushed = ports.share[e], ports.followed[e], ports.pushed[e]
                draw_rows(n, coordinates, share, followed, pushed, by_state, total[0][: y.size])
                draw_rows(n, coordinates, share, followed, pushed, by_column, total[0][:width])

    return flow


def readings_with_effects(law: Kernel, act: Kernel, sensed: Kernel) -> Kernel:
    """Make the readings of a rig with effects, and their derivatives, of kernels as those of `effects_at_ports`.

    Returns `read`, as that of `motion_sensitivities.readings_with_derivatives`; `work` has `PortSizes.read_rows` rows.
    """

    @inlined
    def bend(t, y, given, s, made, by):
        n, width = y.size, made.by_column.shape[1]
        for i in range(given.instances.shape[0]):
            if given.instances[i, KIND] == SENSOR:
                at, values = given.instances[i, PLACE], given.values[given.instances[i, FIRST] :]
                first, second = states_in(y, given, i)
                law(given.instances[i, LAW], t, s[at], 0.0, first, second, values, by)
                s[at] = by[0, VALUE]
                scale_row(by[0, BY_DISPLACEMENT], made, at, n, width)
                add_law(i, by[0], given, made, at)

    @inlined
    def read(steps, y, commands, index, given, s, made, work):
        t, is_linear, table = index * steps.dt, steps.is_linear, given.table
        channels = table[SIZES, CHANNELS]
        by_entry, work = take(work, table[SIZES, SENSORS])
        by, work = take(work, LAW_ROWS)
        vectors, work = take(work, 3)
        noise, u, rate = vectors[0], vectors[1][:channels], vectors[2]
        moved, work = rows_in(work, y.size)
        ports, work = ports_in(work, table[SIZES, PLACES], channels)
        for a in range(channels):
            u[a] = command_at(commands, index, a, given.late[a], 0.0, is_linear)
            ports.command[a] = u[a]
            if given.late_columns[a] >= 0:
                given.lead[a] = lead_of(commands, index, a, given.late[a], 0.0, steps.dt, is_linear)
        if table[SIZES, IS_FED]:
            act(t, y, u, given, rate, moved, ports, work)
        sensed(t, y, ports.command, given.p, noise, s, made.by_state, by_entry)
        put_readings(by_entry, given, ports, y.size, made)
        bend(t, y, given, s, made, by)

    return read


def augmented_normal_equations(law: Kernel, placed: Kernel, slopes: Kernel, sensed: Kernel, carry: Kernel) -> Kernel:
    """Make the normal equations of an augmented model over a record, of kernels as those of `effects_at_ports`.

    Returns `normal(steps, interval, shooting, given, record, sums, work) -> status`, as
    `motion_sensitivities.normal_equations`.
    """
    act = effects_at_ports(law, placed, sensed)
    flow = motion_with_effects(act, slopes)
    accumulate = normal_equations(readings_with_effects(law, act, sensed), drive_late, flow, carry)

    @compiled
    @requires("interval > 0", *OF_RECORD, *OF_EFFECTS)
    def normal(
        steps: Steps, interval: int, shooting: Shooting, given: AugmentedArrays, record: Readings, sums: Sums,
        work: Matrix,
    ) -> int:  # fmt: skip
        work[:] = 0.0
        read_work, work = take(work, given.table[SIZES, READ_ROWS])
        return accumulate(steps, interval, shooting, given, record, sums, read_work, work)

    return normal
