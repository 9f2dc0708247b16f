"""Kernels that give a control law the inputs of its virtual system: from tables, from sensors, and from a push.

An input is the polynomial c0 + c1 (t - at) + ... of the virtual time, whose five parameters are cells of the parameter
array p of the control law, from `cell` on. Behind the parameters stands a tail:

    for each series: cell, number m of points, then (c0, c1, c2, c3, at) before and after each point (m + 1, 5)
    for each sensor: cell, index of the sensor, virtual units per unit of reading
    for each push: cell, virtual units per SI unit, rad/s above which it is felt, and what is below
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
OF_SENSOR, OF_PUSH = 3, 4  # numbers of a sensor, and of a push before what was found


@compiled
def interpolate(tau, p, begin):
    """Copy the polynomial for a time from the table at an index into its cells; return the index behind the table."""
    cell, at = math.floor(p[begin]), begin + 1
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
def first_table(p):
    """Index of the first table."""
    return p.size - math.floor(p[p.size - 1])


def tables(series: int, scale: int) -> Kernel:
    """Make `set_cells(t, p)`, which sets the cells of all series for a time of the rig."""

    @compiled
    def set_cells(t, p):
        at = first_table(p)
        for _ in range(series):
            at = interpolate(t / p[scale], p, at)

    return set_cells


def law(bare: Kernel, series: int, scale: int) -> Kernel:
    """Make a control law that reads its series at each instant; `bare` is that of `sampled_loop`.

    `scale` says where the seconds per unit of virtual time are among the parameters.
    """
    set_cells = tables(series, scale)

    @compiled
    def fed(t, since, y, d, p, u, r, g):
        set_cells(t, p)
        return bare(t, since, y, d, p, u, r, g)

    return fed


def virtual(bare: Kernel, series: int, scale: int) -> Kernel:
    """Make `virtual` of `energy_balance`, or `remember` of `virtual_memory`, with series read at each instant."""
    set_cells = tables(series, scale)

    @compiled
    def fed(t, y, p, out):
        set_cells(t, p)
        bare(t, y, p, out)

    return fed


def control(bare: Kernel, push: Kernel, series: int, sensors: int, pushes: int, sizes: Sizes) -> Kernel:
    """Make the step of a controller whose virtual system has inputs from sensors and pushes; `bare` is that without.

    `push(t, y, d, p, out)` writes the force along the coordinate of each push, of the accelerations d that the model
    lacks. The numbers of series, sensors and pushes are those of the tail.
    """
    following, size, n, pushed = sizes.next, sizes.states, sizes.coordinates, OF_PUSH * pushes

    @compiled
    @requires(*OF_READINGS)
    def step(t: float, h: float, s: Vector, unit: Unit, demanded: Vector, applied: Vector, work: Matrix) -> float:
        p = unit.p
        at = first_table(p)
        for _ in range(series):
            at += 2 + PIECE * (math.floor(p[at + 1]) + 1)
        for _ in range(sensors):
            p[math.floor(p[at])] = p[at + 2] * s[math.floor(p[at + 1])]
            at += OF_SENSOR
        if pushed > 0:
            z = unit.x[following.start : following.stop]
            found = p[at + pushed : p.size - 1]
            push(t, z[:size], z[size : size + n], p, found)
            for i in range(pushes):
                # What lasts is an error of the model, and is cancelled; what comes and goes is a push.
                p[at + 3] += -math.expm1(-p[at + 2] * h) * (found[i] - p[at + 3])
                p[math.floor(p[at])] = p[at + 1] * (found[i] - p[at + 3])
                at += OF_PUSH
        return bare(t, h, s, unit, demanded, applied, work)

    return step
