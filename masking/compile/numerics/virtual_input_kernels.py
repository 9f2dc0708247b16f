"""Kernels that give a control law the inputs of its virtual system: from tables, from sensors, and from a push.

An input is the polynomial c0 + c1 (t - at) + ... of the virtual time, whose five parameters are cells of the parameter
array p of the control law. Behind the parameters stands a tail:

    for each series: number m of points, then (c0, c1, c2, c3, at) before and after each point (m + 1, 5)
    for each sensor: virtual units per unit of reading
    for each push: virtual units per SI unit, rad/s above which it is felt, and what is below
    for each push: what was found last
    the length of the tail, itself included
"""
# ruff: noqa: ANN001, ANN201, ANN202, PLR0917
# The types are numba's to infer.

from __future__ import annotations

import math

from masking.compile.numerics.arrays import Kernel, Matrix, Vector
from masking.compile.numerics.compilation import compiled, requires
from masking.compile.numerics.controller_sizes import Sizes
from masking.compile.numerics.kernel_arguments import Unit
from masking.compile.numerics.sampled_loop import OF_READINGS

PIECE = 5  # numbers of a polynomial
HALVINGS = 32  # of the points between which a time is looked for
OF_PUSH = 3  # numbers of a push before what was found


@compiled
def interpolate(tau, p, at, cell):
    """Copy the polynomial for a time from the table at an index into its cells; return the index behind the table."""
    count = math.floor(p[at])
    low, high = 0, count  # the piece is the number of points up to tau
    for _ in range(HALVINGS):
        if low < high:
            middle = (low + high) // 2
            if p[at + 1 + PIECE * (middle + 1) + 4] <= tau:
                low = middle + 1
            else:
                high = middle
    first = at + 1 + PIECE * low
    for i in range(PIECE):
        p[cell + i] = p[first + i]
    return at + 1 + PIECE * (count + 1)


@compiled
def first_table(t, p):
    """Index of the first table."""
    return p.size - math.floor(p[p.size - 1])


def tables(cells: tuple[int, ...], scale: int) -> Kernel:
    """Make `set_cells(t, p)`, which sets the cells of all series for a time of the rig; it returns the index behind."""
    if not cells:
        return first_table
    others, cell = tables(cells[:-1], scale), cells[-1]

    @compiled
    def set_cells(t, p):
        at = others(t, p)
        return interpolate(t / p[scale], p, at, cell)

    return set_cells


def law(bare: Kernel, cells: tuple[int, ...], scale: int) -> Kernel:
    """Make a control law that reads its series at each instant; `bare` is that of `sampled_loop`.

    `cells` says where the polynomial of each series is among the parameters, `scale` where the seconds per unit of
    virtual time are.
    """
    set_cells = tables(cells, scale)

    @compiled
    def fed(t, since, y, d, p, u, r, g):
        set_cells(t, p)
        return bare(t, since, y, d, p, u, r, g)

    return fed


def virtual(bare: Kernel, cells: tuple[int, ...], scale: int) -> Kernel:
    """Make `virtual` of `energy_balance`, or `remember` of `virtual_memory`, with series read at each instant."""
    set_cells = tables(cells, scale)

    @compiled
    def fed(t, y, p, out):
        set_cells(t, p)
        bare(t, y, p, out)

    return fed


@compiled
def unread(s, p, at):
    """Index behind the inputs of no sensor."""
    return at


def reading(sensors: tuple[tuple[int, int], ...]) -> Kernel:
    """Make `read(s, p, at)`, which sets the cells of all inputs from sensors; it returns the index behind.

    `sensors` has for each of these inputs its cell and the index of the sensor.
    """
    if not sensors:
        return unread
    others, (cell, sensor) = reading(sensors[:-1]), sensors[-1]

    @compiled
    def read(s, p, at):
        own = others(s, p, at)
        p[cell] = p[own] * s[sensor]
        return own + 1

    return read


@compiled
def unfelt(found, p, at, h):
    """Index behind the inputs of no push."""
    return at


def feeling(cells: tuple[int, ...]) -> Kernel:
    """Make `feel(found, p, at, h)`, which sets the cells of all inputs from pushes; it returns the index behind."""
    if not cells:
        return unfelt
    others, cell, i = feeling(cells[:-1]), cells[-1], len(cells) - 1

    @compiled
    def feel(found, p, at, h):
        own = others(found, p, at, h)
        # What lasts is an error of the model, and is cancelled; what comes and goes is a push.
        p[own + 2] += -math.expm1(-p[own + 1] * h) * (found[i] - p[own + 2])
        p[cell] = p[own] * (found[i] - p[own + 2])
        return own + OF_PUSH

    return feel


def control(
    bare: Kernel, push: Kernel, series: int, sensors: tuple[tuple[int, int], ...], pushes: tuple[int, ...], sizes: Sizes
) -> Kernel:
    """Make the step of a controller whose virtual system has inputs from sensors and pushes; `bare` is that without.

    `push(t, y, d, p, out)` writes the force along the coordinate of each push, of the accelerations d that the model
    lacks. `series` is how many there are; `sensors` has for each input from a sensor its cell and the index of the
    sensor, and `pushes` the cells of inputs from pushes.
    """
    following, size, n, pushed = sizes.next, sizes.states, sizes.coordinates, OF_PUSH * len(pushes)
    read, feel = reading(sensors), feeling(pushes)

    @compiled
    @requires(*OF_READINGS)
    def step(t: float, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix) -> float:
        p = unit.p
        at = first_table(t, p)
        for _ in range(series):
            at += 1 + PIECE * (math.floor(p[at]) + 1)
        at = read(s, p, at)
        if pushed > 0:
            z = unit.x[following.start : following.stop]
            found = p[at + pushed : p.size - 1]
            push(t, z[:size], z[size : size + n], p, found)
            feel(found, p, at, h)
        return bare(t, h, s, unit, demanded, applied, work)

    return step
