"""Inertias at places of an augmented model.

An inertia is a force m a at a place, where a is the acceleration of its displacement. With q'' the accelerations of the
coordinates without it, b what a unit of force adds to them, and j the derivatives of the displacement by the
coordinates, a = j.q'' / (1 - m j.b), where j.b is negative. Several are solved for one after the other, each in the rig
with those before it. Displacements are linear, so that j is constant.
Source: Sherman and Morrison (1950), Ann. Math. Stat. 21(1), 124-127.
"""
# ruff: noqa: ANN001, ANN202
# The types are numba's to infer.

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from masking.numerics.integrators import compiled
from masking.numerics.rig_sizes import PortSizes

Kernel = Callable[..., Any]


def inertias_at_ports(sizes: PortSizes) -> tuple[Kernel, Kernel]:
    """Make what inertias at places do.

    Returns:
        `accelerate(width, by_entry, given, rate, ports)`, which brings the accelerations in `rate` to those with the
        inertias that `ports.acceleration` holds, writes there the accelerations of the places, and adds the forces of
        the inertias to the parameter array, their derivatives to `ports.forces`; and `draw(share, followed, pushed,
        rate)`, which brings rates (n,) to those with one inertia.
    """
    n, coordinates, places = sizes.states, sizes.coordinates, sizes.places
    force_entries, force_columns = sizes.force_entries or (0,), sizes.force_columns or (0,)

    @compiled
    def draw(share, followed, pushed, rate):
        if share != 0.0:
            total = 0.0
            for i in range(coordinates):
                total += followed[i] * rate[coordinates + i]
            for i in range(n):
                rate[i] += share * total * pushed[i]

    @compiled
    def accelerate(width, by_entry, given, rate, ports):
        share, followed, pushed, acceleration = ports.share, ports.followed, ports.pushed, ports.acceleration
        for e in range(places):
            share[e] = acceleration[e]
            if share[e] != 0.0:
                for i in range(n):
                    pushed[e, i] = by_entry[i, force_columns[e]]
                for before in range(e):
                    draw(share[before], followed[before], pushed[before], pushed[e])
                itself = 0.0
                for i in range(coordinates):
                    itself += followed[e, i] * pushed[e, coordinates + i]
                share[e] /= 1.0 - share[e] * itself
                draw(share[e], followed[e], pushed[e], rate)
        for e in range(places):
            inertia, acceleration[e] = acceleration[e], 0.0
            for i in range(coordinates):
                acceleration[e] += followed[e, i] * rate[coordinates + i]
            given.p[force_entries[e]] += inertia * acceleration[e]
            if given.acts[e]:
                for j in range(width):
                    ports.forces[e, j] += ports.inertias[e, j] * acceleration[e]

    return accelerate, draw
