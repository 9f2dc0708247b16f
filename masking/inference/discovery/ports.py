"""Ports: where effects act on a rig, as nodes of its graph, and the tables by which kernels know the effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.codegen.graph import Node
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array, IntMatrix, IntVector
from masking.control.rig.twin import LoweredTwin
from masking.inference.discovery.places import Place
from masking.model.declaration.schema import EffectUse
from masking.model.effects import Effect


@dataclass(frozen=True)
class Instances:
    """Tables of effect instances, as kernels read them."""

    table: IntMatrix  # a row for each instance, those of sensors last (i, 5); columns as `numerics.instances` says
    estimated: IntMatrix  # the column of each parameter in the normal equations, or -1 (i, parameters)
    values: Array  # all parameters, one after the other
    support: Array  # displacements, then rates, between which each acts, as `laws.support` has them (i, 4)
    acting: IntVector  # places, then actuators, where an effect acts, by their numbers
    late: Array  # delay of each actuator, s (actuators,)
    late_columns: IntVector  # column of this delay, or -1 (actuators,)
    states: int  # how many states the effects have

    def known(self) -> Instances:
        """Same with all parameters known: none has a column."""
        estimated, late_columns = np.full_like(self.estimated, -1), np.full_like(self.late_columns, -1)
        return replace(self, estimated=estimated, late_columns=late_columns)


def followed(lowered: LoweredTwin, places: Sequence[Place]) -> list[Node]:
    """Displacement of each place as a node; 0 where it has none."""
    equations, zero = lowered.equations.equations, lowered.graph.number(0.0)
    every = [place.element.displacement for place in places]
    return [zero if one is None else lowered.equations.lower(equations.symbolic(one)) for one in every]


def rates(lowered: LoweredTwin, places: Sequence[Place], loads: Mapping[str, str]) -> list[Node]:
    """Rate of each place as a node: as declared, or by the chain rule from coordinates; 0 where unknown."""
    graph, equations = lowered.graph, lowered.equations.equations
    moving = len(equations.coordinates)
    velocities = [graph.symbol(loads[f"y[{moving + i}]"], varying=True) for i in range(moving)]
    positions = [graph.symbol(loads[f"y[{i}]"], varying=True) for i in range(moving)]
    found = []
    for place, row in zip(places, derivatives(graph, followed(lowered, places), positions), strict=True):
        if place.element.rate is not None:
            found.append(lowered.equations.lower(equations.symbolic(place.element.rate)))
        elif place.has_rate:
            found.append(graph.total([graph.mul(by, v) for by, v in zip(row, velocities, strict=True)]))
        else:
            found.append(graph.number(0.0))
    return found


def port(effect: Effect, at: str) -> EffectUse:
    """Effect at a place, with factors of 0, by which others act there."""
    return EffectUse(effect=effect.name, at=(at,), parameters=dict.fromkeys(effect.factors, 0.0))
