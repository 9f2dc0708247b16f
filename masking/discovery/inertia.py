"""Inertia: forces of the accelerations that they change, as text of kernels.

An inertia is a force m a at a place, where a is the acceleration of its displacement. With q'' the accelerations of the
coordinates without it, b what a unit of force adds to them, and j the derivatives of the displacement by the
coordinates, a = j.q'' / (1 - m j.b), where j.b is negative. Several are solved for one after the other, each in the rig
with those before it. Displacements are linear, so that j does not change.
Source: Sherman and Morrison (1950), Ann. Math. Stat. 21(1), 124-127.
"""

from __future__ import annotations

INERTIAS = """
@compiled
def _inertias(width, jp, jd, share, pushed, acc, heavier, p, dy, df):
    # Bring accelerations in dy to those with inertias, which `acc` holds, and write accelerations of places into `acc`.
    # Forces go into p, and their derivatives by parameters into df, from those of the inertias (heavier). A unit of a
    # force adds `pushed` to the rates; a force is its `share` of the acceleration without it.
    n, moving, places = {n}, {moving}, {places}
    for e in range(places):
        share[e] = acc[e]
        if share[e] != 0.0:
            for i in range(n):
                pushed[e, i] = jp[i, {force_column}[e]]
            for before in range(e):
                _drawn(share[before], jd[before], pushed[before], pushed[e])
            itself = 0.0
            for i in range(moving):
                itself += jd[e, i] * pushed[e, moving + i]
            share[e] /= 1.0 - share[e] * itself
            _drawn(share[e], jd[e], pushed[e], dy)
    for e in range(places):
        inertia, acc[e] = acc[e], 0.0
        for i in range(moving):
            acc[e] += jd[e, i] * dy[moving + i]
        p[{force_p}[e]] += inertia * acc[e]
        for j in range(width):
            df[e, j] += heavier[e, j] * acc[e]


@compiled
def _drawn(share, jd, pushed, rates):
    # Bring rates (n,) to those with an inertia.
    if share != 0.0:
        total = 0.0
        for i in range({moving}):
            total += jd[i] * rates[{moving} + i]
        for i in range({n}):
            rates[i] += share * total * pushed[i]
"""
