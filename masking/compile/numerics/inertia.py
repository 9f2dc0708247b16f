"""Inertias at places of an augmented model.

An inertia is a force m a at a place, where a is the acceleration of its displacement. With q'' the accelerations of the
coordinates without it, b what a unit of force adds to them, and j the derivatives of the displacement by the
coordinates, a = j.q'' / (1 - m j.b), where j.b is negative. Several are solved for one after the other, each in the rig
with those before it. Displacements are linear, so that j is constant.
Source: Sherman and Morrison (1950), Ann. Math. Stat. 21(1), 124-127.
"""
# ruff: noqa: ANN001, ANN201, PLR0917
# The types are numba's to infer.

from __future__ import annotations

from masking.compile.numerics.compilation import inlined
from masking.compile.numerics.rig_sizes import COORDINATES, FORCE_ENTRIES, INPUT_COLUMNS, PLACES, SIZES, STATES


@inlined
def draw(n, coordinates, share, followed, pushed, rate):
    """Bring rates (n,) to those with one inertia."""
    if share != 0.0:
        total = 0.0
        for i in range(coordinates):
            total += followed[i] * rate[coordinates + i]
        for i in range(n):
            rate[i] += share * total * pushed[i]


@inlined
def draw_rows(n, coordinates, share, followed, pushed, rates, total):
    """Bring the derivatives of rates (n, width) to those with one inertia; `total` (width,) is work space."""
    if share != 0.0:
        for j in range(total.size):
            total[j] = 0.0
            for i in range(coordinates):
                total[j] += followed[i] * rates[coordinates + i, j]
        for i in range(n):
            by = share * pushed[i]
            for j in range(total.size if by != 0.0 else 0):
                rates[i, j] += by * total[j]


@inlined
def accelerate(states, width, by_entry, given, rate, ports):
    """Bring the accelerations in `rate` to those with the inertias that `ports.acceleration` holds.

    The accelerations of the places are written there, and the forces of the inertias are added to the parameter array,
    their derivatives by all states and by the columns, `width`, to `ports.inputs`.
    """
    table = given.table
    n, coordinates, places = table[SIZES, STATES], table[SIZES, COORDINATES], table[SIZES, PLACES]
    share, followed, pushed, acceleration = ports.share, ports.followed, ports.pushed, ports.acceleration
    for e in given.acting:
        if e >= places:
            break
        share[e] = acceleration[e]
        if share[e] != 0.0:
            for i in range(n):
                pushed[e, i] = by_entry[i, table[INPUT_COLUMNS, e]]
            for before in range(e):
                draw(n, coordinates, share[before], followed[before], pushed[before], pushed[e])
            itself = 0.0
            for i in range(coordinates):
                itself += followed[e, i] * pushed[e, coordinates + i]
            share[e] /= 1.0 - share[e] * itself
            draw(n, coordinates, share[e], followed[e], pushed[e], rate)
    for e in given.acting:
        if e >= places:
            break
        inertia, acceleration[e] = acceleration[e], 0.0
        for i in range(coordinates):
            acceleration[e] += followed[e, i] * rate[coordinates + i]
        given.p[table[FORCE_ENTRIES, e]] += inertia * acceleration[e]
        for j in range(states):
            ports.inputs.by_state[e, j] += ports.inertias.by_state[e, j] * acceleration[e]
        for j in range(width):
            ports.inputs.by_column[e, j] += ports.inertias.by_column[e, j] * acceleration[e]
