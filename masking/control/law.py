"""Control law: the whole of it in one visible order.

The law is u = L + G T^-1[D]. With rig accelerations a = a0 + B u and virtual coordinates eta = T(q), so that
eta'' = J a + J' v, it solves

    (J B) u = -J a0                                L cancels the rig's own dynamics
    (J B) u = D / time_scale^2 - J' v              G T^-1[D] drives the wanted ones

and adds the two. Source: Rijlaarsdam (2008), chapter 6, (6.1)-(6.3), for any model affine in its inputs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.control.blocks import Cancellation, DesiredDynamics, Transform, decouple, dot, product
from masking.model.declaration import schema
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Controller:
    """A control law that makes a rig move as a virtual system.

    Args:
        model: the controller's model of the rig, in SI units.
        virtual: what the rig shall move as.
        transform: how virtual coordinates follow from rig coordinates.
        time_scale: seconds of the rig per unit of the virtual system's time.
        transform_parameters: values of the transform's own parameters.
        regulation: what is held besides the wanted dynamics, if anything.
        energy_balance: rate at which energy is taken out that the rig has gained beyond them, and the frequency of the
            motion, in radians, both per unit of virtual time; None where it is not.
    """

    model: Model
    virtual: Model
    transform: Transform
    time_scale: float
    transform_parameters: Mapping[str, float]
    regulation: schema.Regulation | None = None
    energy_balance: tuple[float, float] | None = None

    @property
    def desired(self) -> DesiredDynamics:
        """Block D."""
        return DesiredDynamics(self.virtual, self.regulation)

    @cached_property
    def lengths(self) -> Array:
        """Size in SI units of one unit of each rig coordinate as the transform sees it (n,)."""
        has_scales = self.virtual.is_dimensionless or self.virtual.units.is_plain
        return self.model.lengths if has_scales else np.ones(len(self.model.coordinates))

    @property
    def driven(self) -> Array:
        """Slope of the virtual coordinates by those of the rig at zero (k, n), per SI unit of the latter."""
        return np.asarray(self.transform.slope(self.transform_parameters) / self.lengths, dtype=np.float64)

    def values(self) -> Array:
        """Parameter array of the control law: model, virtual system, transform, lengths, time scale."""
        own = [self.transform_parameters[name] for name in self.transform.parameters]
        rest = [*self.desired.values(), *(self.energy_balance or ())]
        return np.concatenate([self.model.values(), self.virtual.values(), own, self.lengths, [self.time_scale], rest])

    def structure(self) -> dict[str, object]:
        """All that the compiled control law depends on, apart from values."""
        return {
            "model": self.model.structure(),
            "virtual": self.virtual.structure(),
            "transform": self.transform.declaration.model_dump(mode="json", exclude={"parameters"}),
            "transform_parameters": list(self.transform.parameters),
            "regulation": self.regulation and [self.regulation.energy is not None, self.regulation.phase],
            "energy_balance": self.energy_balance is not None,
        }


@dataclass(frozen=True)
class ControlLaw:
    """The control law as nodes of a graph; L and G T^-1[D] are kept apart so that each can be looked at.

    `given` are the rig accelerations under the inputs, `driven` the part of them that is due to the inputs;
    `remembered` are the rates of the virtual system's internal states, per second, `lagged` what its delayed
    expressions are now, and `delays` by how many seconds they are delayed; `conditions` are those of its events, and
    then the values that jump.
    """

    eta: list[Node]
    rate: list[Node]
    desired: list[Node]
    cancel: list[Node]
    drive: list[Node]
    inputs: list[Node]
    input_matrix: list[list[Node]]
    health: Node
    given: list[Node]
    driven: list[Node]
    remembered: list[Node]
    lagged: list[Node]
    delays: list[Node]
    conditions: list[Node]

    @classmethod
    def of(cls, controller: Controller, graph: Graph, rig: RigSymbols, homing: Homing | None = None) -> ControlLaw:
        """Lower the control law into a graph, for given nodes of the rig, and of its homing, if there is one."""
        p = ControllerParameters.of(controller, graph)
        time = graph.div(rig.t, p.time_scale)
        xi = [graph.div(q, length) for q, length in zip(rig.q, p.lengths, strict=True)]
        xi_rate = [graph.div(v, length) for v, length in zip(rig.v, p.lengths, strict=True)]

        mapped = controller.transform.lower(graph, xi, xi_rate, p.transform)  # T
        rate = [graph.mul(r, p.time_scale) for r in mapped.rate]
        given_d = {"regulation": p.regulation, "memory": rig.memory}
        wanted_d = controller.desired.lower(graph, time, mapped.eta, rate, p.virtual, **given_d)  # D
        desired, remembered = wanted_d.accelerations, [graph.div(r, p.time_scale) for r in wanted_d.rates]
        state = [*rig.v, *rig.s]
        free, gain, inertia = Cancellation(controller.model).lower(graph, rig.t, rig.q, state, p.model)  # L, G
        if rig.disturbance:
            free = [graph.add(a, d) for a, d in zip(free, rig.disturbance, strict=True)]
        jacobian = [[graph.div(j, length) for j, length in zip(row, p.lengths, strict=True)] for row in mapped.jacobian]
        squared = graph.mul(p.time_scale, p.time_scale)
        damping = rig.damping
        balanced = desired if damping is None else controller.desired.damped(graph, desired, rate, damping)
        wanted = [graph.sub(graph.div(d, squared), b) for d, b in zip(balanced, mapped.bias, strict=True)]
        if homing is not None:
            wanted = homing.lower(graph, rig, jacobian, wanted)
        unwanted = [graph.apply("neg", dot(graph, row, free)) for row in jacobian]
        matrix = product(graph, jacobian, gain)
        cancel, drive, decoupling = decouple(graph, matrix, unwanted, wanted)

        inputs = [graph.add(a, b) for a, b in zip(cancel, drive, strict=True)]  # L + G T^-1[D]
        driven = [dot(graph, row, inputs) for row in gain]
        given = [graph.add(a, b) for a, b in zip(free, driven, strict=True)]
        health = graph.mul(inertia, decoupling)
        motion = (mapped.eta, rate, desired, cancel, drive, inputs, gain, health, given, driven)
        delays = [graph.mul(d, p.time_scale) for d in wanted_d.delays]
        return cls(*motion, remembered, wanted_d.lagged, delays, wanted_d.conditions)


@dataclass(frozen=True)
class RigSymbols:
    """Nodes of the rig: time, coordinates, velocities, internal states, and accelerations that the model lacks.

    `damping` is that by which the energy balance is held, where it is; `memory` are the virtual system's internal
    states, and then its delayed expressions.
    """

    t: Node
    q: list[Node]
    v: list[Node]
    s: list[Node] = field(default_factory=list)
    disturbance: list[Node] = field(default_factory=list)
    damping: Node | None = None
    memory: list[Node] = field(default_factory=list)


# The reference reaches its end at this part of the homing phase; the rest is for settling.
MOVING_PART = 0.7
# Decay of a deviation from the reference over the whole homing phase, as an exponent.
SETTLING = 60.0


@dataclass(frozen=True)
class Homing:
    """How the rig is brought from where it stands to its initial state: along a smooth reference, critically damped.

    Before the release, at `since` < 0, the rig's accelerations are those of q'' = r'' - 2 a (q' - r') - a^2 (q - r)
    for a reference r that moves by a polynomial of order five (smoothstep) and then stands still.
    """

    since: Node  # node of the time since the release
    start: list[Node]  # nodes of the coordinates (n,) where the rig stands
    end: list[Node]  # nodes of the coordinates (n,) of its initial state
    time: Node  # node of the length of the homing phase, s

    def lower(self, graph: Graph, rig: RigSymbols, jacobian: list[list[Node]], wanted: list[Node]) -> list[Node]:
        """Wanted virtual accelerations (k,), replaced before the release by those of homing, with J (k, n)."""
        number, mul = graph.number, graph.mul
        one = number(1.0)
        moving = mul(number(MOVING_PART), self.time)
        part = graph.apply("max", number(0.0), graph.div(graph.add(rig.t, self.time), moving))
        x = graph.apply("min", one, part)
        rest = graph.sub(one, x)  # all derivatives of the smoothstep vanish with x and with 1 - x
        path = mul(mul(x, mul(x, x)), graph.add(number(10.0), mul(x, graph.sub(mul(number(6.0), x), number(15.0)))))
        speed = graph.div(mul(number(30.0), mul(mul(x, x), mul(rest, rest))), moving)
        bend = mul(number(60.0), mul(mul(x, rest), graph.sub(rest, x)))
        bend = graph.div(bend, mul(moving, moving))
        a = graph.div(number(SETTLING), self.time)
        accelerations = []
        for q, v, start, end in zip(rig.q, rig.v, self.start, self.end, strict=True):
            way = graph.sub(end, start)
            behind = graph.sub(graph.add(start, mul(way, path)), q)
            slower = graph.sub(mul(way, speed), v)
            pull = graph.add(mul(mul(a, a), behind), mul(mul(number(2.0), a), slower))
            accelerations.append(graph.add(mul(way, bend), pull))
        is_before = graph.apply("lt", self.since, number(0.0))
        rows = zip(jacobian, wanted, strict=True)
        return [graph.apply("where", is_before, dot(graph, row, accelerations), w) for row, w in rows]


@dataclass(frozen=True)
class ControllerParameters:
    """Nodes of the control law's parameter array, in the order of `Controller.values`."""

    model: list[Node]
    virtual: list[Node]
    transform: list[Node]
    lengths: list[Node]
    time_scale: Node
    regulation: list[Node]
    energy_balance: list[Node]

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
            make("r", ("energy", "rate", "coupling")) if controller.regulation else [],
            make("e", ("rate", "frequency")) if controller.energy_balance is not None else [],
        )

    def loads(self, graph: Graph) -> dict[str, str]:
        """For each parameter's text how it is read from the array `p`."""
        scaled = [*self.lengths, self.time_scale, *self.regulation, *self.energy_balance]
        nodes = [*self.model, *self.virtual, *self.transform, *scaled]
        return {str(graph.operations[n][1]): f"p[{i}]" for i, n in enumerate(nodes)}

    @property
    def count(self) -> int:
        """Length of the array."""
        parts = (self.model, self.virtual, self.transform, self.lengths, self.regulation, self.energy_balance)
        return sum(map(len, parts)) + 1
