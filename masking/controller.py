"""Controller: the whole control law in one visible order.

The law is u = L + G T^-1[D]. With rig accelerations a = a0 + B u and virtual coordinates eta = T(q), so that
eta'' = J a + J' v, it solves

    (J B) u = -J a0                                L cancels the rig's own dynamics
    (J B) u = D / time_scale^2 - J' v              G T^-1[D] drives the wanted ones

and adds the two. Source: Rijlaarsdam (2008), chapter 6, (6.1)-(6.3), for any model affine in its inputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.blocks import Cancellation, DesiredDynamics, Transform, decouple, dot
from masking.compile.graph import Graph, Node
from masking.kernels import Array
from masking.model import Model


@dataclass(frozen=True)
class Controller:
    """A control law that makes a rig move as a virtual system.

    Args:
        model: what the controller believes the rig to be, in SI units.
        virtual: what the rig shall move as.
        transform: how virtual coordinates follow from rig coordinates.
        time_scale: seconds of the rig per unit of the virtual system's time.
        transform_parameters: values of the transform's own parameters.
    """

    model: Model
    virtual: Model
    transform: Transform
    time_scale: float
    transform_parameters: Mapping[str, float]

    @cached_property
    def lengths(self) -> Array:
        """Return the size in SI units of one unit of each rig coordinate as the transform sees it (n,)."""
        units = [c.unit for c in self.model.declaration.coordinates.values()]
        if not (self.virtual.is_dimensionless or self.virtual.units.is_plain):
            return np.ones(len(units))
        return np.array([self.model.units.size(unit, self.model.overrides) for unit in units])

    def values(self) -> Array:
        """Return the parameter array of the control law: model, virtual system, transform, lengths, time scale."""
        own = [self.transform_parameters[name] for name in self.transform.parameters]
        return np.concatenate([self.model.values(), self.virtual.values(), own, self.lengths, [self.time_scale]])

    def structure(self) -> dict[str, object]:
        """Return all that the compiled control law depends on, apart from values."""
        return {
            "model": self.model.structure(),
            "virtual": self.virtual.structure(),
            "transform": self.transform.declaration.model_dump(mode="json", exclude={"parameters"}),
            "transform_parameters": list(self.transform.parameters),
        }


@dataclass(frozen=True)
class ControlLaw:
    """The control law as nodes of a graph; L and G T^-1[D] are kept apart so that each can be looked at."""

    eta: list[Node]
    rate: list[Node]
    desired: list[Node]
    cancel: list[Node]
    drive: list[Node]
    inputs: list[Node]
    input_matrix: list[list[Node]]
    health: Node

    @classmethod
    def of(cls, controller: Controller, graph: Graph, rig: RigSymbols) -> ControlLaw:
        """Lower the control law into a graph, for given nodes of time and rig state."""
        p = ControllerParameters.of(controller, graph)
        time = graph.div(rig.t, p.time_scale)
        xi = [graph.div(q, length) for q, length in zip(rig.q, p.lengths, strict=True)]
        xi_rate = [graph.div(v, length) for v, length in zip(rig.v, p.lengths, strict=True)]

        mapped = controller.transform.lower(graph, xi, xi_rate, p.transform)  # T
        rate = [graph.mul(r, p.time_scale) for r in mapped.rate]
        desired = DesiredDynamics(controller.virtual).lower(graph, time, mapped.eta, rate, p.virtual)  # D
        free, gain, health = Cancellation(controller.model).lower(graph, rig.t, rig.q, rig.v, p.model)  # L, G
        jacobian = [[graph.div(j, length) for j, length in zip(row, p.lengths, strict=True)] for row in mapped.jacobian]
        squared = graph.mul(p.time_scale, p.time_scale)
        wanted = [graph.sub(graph.div(d, squared), b) for d, b in zip(desired, mapped.bias, strict=True)]
        unwanted = [graph.apply("neg", dot(graph, row, free)) for row in jacobian]
        matrix = [[dot(graph, row, [g[i] for g in gain]) for i in range(len(gain[0]))] for row in jacobian]
        cancel, drive, determinant = decouple(graph, matrix, unwanted, wanted)

        inputs = [graph.add(a, b) for a, b in zip(cancel, drive, strict=True)]  # L + G T^-1[D]
        return cls(mapped.eta, rate, desired, cancel, drive, inputs, gain, graph.mul(health, determinant))


@dataclass(frozen=True)
class RigSymbols:
    """Nodes of the rig's time and state."""

    t: Node
    q: list[Node]
    v: list[Node]


@dataclass(frozen=True)
class ControllerParameters:
    """Nodes of the control law's parameter array, in the order of `Controller.values`."""

    model: list[Node]
    virtual: list[Node]
    transform: list[Node]
    lengths: list[Node]
    time_scale: Node

    @classmethod
    def of(cls, controller: Controller, graph: Graph) -> ControllerParameters:
        """Make a node of every parameter of a controller."""

        def make(kind: str, names: tuple[str, ...]) -> list[Node]:
            return [graph.symbol(f"{kind}_{name}", varying=False) for name in names]

        return cls(
            make("m", controller.model.parameters),
            make("d", controller.virtual.parameters),
            make("t", controller.transform.parameters),
            make("l", controller.model.coordinates),
            graph.symbol("time_scale", varying=False),
        )

    def loads(self, graph: Graph) -> dict[str, str]:
        """Return for each parameter's text how it is read from the array `p`."""
        nodes = [*self.model, *self.virtual, *self.transform, *self.lengths, self.time_scale]
        return {str(graph.operations[n][1]): f"p[{i}]" for i, n in enumerate(nodes)}

    @property
    def count(self) -> int:
        """Return the length of the array."""
        return len(self.model) + len(self.virtual) + len(self.transform) + len(self.lengths) + 1
