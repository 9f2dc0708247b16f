"""Control law: the whole of it in one visible order.

The law is u = L + G T^-1[D]. With rig accelerations a = a0 + B u and virtual coordinates eta = T(q), so that
eta'' = J a + J' v, it solves

    (J B) u = -J a0                                L cancels the rig's own dynamics
    (J B) u = D / time_scale^2 - J' v              G T^-1[D] drives the wanted ones

and adds the two. Where the inputs appear first in derivative r > 2 of a virtual coordinate, since they act through
dynamics of their own, its row is the r-th derivative of eta: the rig is kept on the manifold on which eta'' = D and the
derivatives of both agree, and is brought there with the bandwidth w,

    sum over k of C(r-2, k) w^(r-2-k) (eta^(k+2) - D^(k) / time_scale^(k+2)) = 0,    k = 0 ... r - 2

in which the derivatives D^(k) are total ones along the motion; of coordinates that the inputs change at once before,
they are along the wanted one.
Source: Rijlaarsdam (2008), chapter 6, (6.1)-(6.3), for any model affine in its inputs; Isidori (1995), Nonlinear
Control Systems, section 5.1, for higher derivatives.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from masking.compile.codegen import module_store
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.control.cancellation import Cancellation, decouple
from masking.control.desired_dynamics import DesiredDynamics
from masking.control.homing import Ends, Homing
from masking.control.input_curves import Branch, InputCurves
from masking.control.relative_degree import Derivatives, relative_degrees, remainder
from masking.control.transform import Transform, dot, product
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.declaration import schema
from masking.model.modelling.model import Model

# Times the frequency of the virtual motion: the bandwidth with which a rig whose state is known comes to it.
APPROACH = 20.0


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
        actuator_bandwidth: with which the rig is brought to the wanted accelerations, rad/s, where its inputs act
            through dynamics of their own.
        branches: of the curves of inputs that act nonlinearly.
        stroke: what the lengths of the rig that the transform sees are multiplied by.
    """

    model: Model
    virtual: Model
    transform: Transform
    time_scale: float
    transform_parameters: Mapping[str, float]
    regulation: schema.Regulation | None = None
    energy_balance: tuple[float, float] | None = None
    actuator_bandwidth: float = 0.0
    branches: tuple[Branch, ...] = ()
    stroke: float = 1.0

    def __repr__(self) -> str:
        return f"<Controller {self.model.name} as {self.virtual.name}: inputs {', '.join(self.model.inputs)}>"

    @property
    def per_unit(self) -> Array:
        """Input per unit of what it does (m,): 1, and over the branch of one that acts nonlinearly its mean."""
        return self.curves.per_unit(self.branches)

    @cached_property
    def curves(self) -> InputCurves:
        """Curves of inputs that act nonlinearly."""
        return InputCurves(self.model)

    @property
    def degrees(self) -> tuple[int, ...]:
        """Derivative of each virtual coordinate in which an input appears first (k,); errors as `relative_degrees`."""
        return tuple(self._known["degrees"])

    @property
    def remainder(self) -> tuple[int, ...]:
        """States of the rig that the virtual coordinates do not determine, as `relative_degree.remainder`."""
        return tuple(self._known["remainder"])

    @cached_property
    def _known(self) -> Mapping[str, Any]:
        """Degrees and remainder, which are found once for all values of parameters."""
        structure = self.structure()
        key = module_store.key({"degrees": {name: structure[name] for name in ("model", "virtual", "transform")}})
        return module_store.load(key, self._without_functions).meta

    def _without_functions(self) -> Module:
        degrees = relative_degrees(self.model, self.transform)
        left = remainder(self.model, self.transform, degrees)
        return Module(self.model.name, {"kind": "degrees", "degrees": degrees, "remainder": left})

    @property
    def is_direct(self) -> bool:
        """Whether the inputs act on each acceleration at once."""
        return max(self.degrees, default=2) == 2

    def checked(self) -> Controller:
        """Itself; a ModelError where what is declared asks for inputs that act on accelerations at once, or do not."""
        if self.is_direct and self.actuator_bandwidth:
            raise ModelError(
                f"controller.actuator_bandwidth: the inputs of {self.model.name} change accelerations at once; leave "
                "it out"
            )
        if not self.is_direct and self.energy_balance is not None:
            raise ModelError(
                f"controller.energy_balance: {self.model.name}: {self._first}, and an energy is balanced where inputs "
                "change accelerations at once; leave it out"
            )
        return self

    @property
    def _first(self) -> str:
        pairs = zip(self.virtual.coordinates, self.degrees, strict=True)
        return f"an input appears first in derivative {', '.join(f'{degree} of {name}' for name, degree in pairs)}"

    @property
    def approach(self) -> str:
        """Degrees and bandwidth in words; '' where the inputs act on each acceleration at once."""
        words = f"{self._first}: wanted accelerations are approached with {self.actuator_bandwidth:.3g} rad/s"
        return "" if self.is_direct else words

    def known(self, rig: RigSymbols, p: ControllerParameters) -> dict[sp.Symbol, Node]:
        """Nodes of the symbols of the model of the rig, but for the inputs."""
        s = self.model.equations.symbols
        nodes = (rig.t, *rig.q, *rig.v, *rig.s, *p.model)
        return dict(zip((s.t, *s.q, *s.v, *s.s, *s.p), nodes, strict=True))

    @property
    def desired(self) -> DesiredDynamics:
        """Block D."""
        return DesiredDynamics(self.virtual, self.regulation)

    @cached_property
    def lengths(self) -> Array:
        """Size in SI units of one unit of each rig coordinate as the transform sees it (n,)."""
        has_scales = self.virtual.is_dimensionless or self.virtual.units.is_plain
        return self.stroke * (self.model.lengths if has_scales else np.ones(len(self.model.coordinates)))

    @property
    def driven(self) -> Array:
        """Slope of the virtual coordinates by those of the rig at zero (k, n), per SI unit of the latter."""
        return np.asarray(self.transform.slope(self.transform_parameters) / self.lengths, dtype=np.float64)

    def values(self) -> Array:
        """Parameter array of the control law: model, virtual system, transform, lengths, time scale."""
        own = [self.transform_parameters[name] for name in self.transform.parameters]
        rest = [*self.desired.values(), *(self.energy_balance or ())]
        rest += [] if self.is_direct else [self.actuator_bandwidth]
        rest += [end for branch in self.branches for end in branch]
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
    then the values that jump; `off` is how far derivatives of the virtual coordinates are from those of the wanted
    motion which the inputs do not change at once. An input that acts nonlinearly is what it does, but in `acting`.
    """

    eta: list[Node]
    rate: list[Node]
    desired: list[Node]
    cancel: list[Node]
    drive: list[Node]
    inputs: list[Node]
    acting: list[Node]
    input_matrix: list[list[Node]]
    health: Node
    given: list[Node]
    driven: list[Node]
    remembered: list[Node]
    lagged: list[Node]
    delays: list[Node]
    conditions: list[Node]
    off: list[Node]

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
        free, gain, inertia = Cancellation(controller.model.affine).lower(graph, rig.t, rig.q, state, p.model)  # L, G
        if rig.disturbance:
            free = [graph.add(a, d) for a, d in zip(free, rig.disturbance, strict=False)]
        jacobian = [[graph.div(j, length) for j, length in zip(row, p.lengths, strict=True)] for row in mapped.jacobian]
        squared = graph.mul(p.time_scale, p.time_scale)
        damping = rig.damping
        balanced = desired if damping is None else controller.desired.damped(graph, desired, rate, damping)
        wanted = [graph.sub(graph.div(d, squared), b) for d, b in zip(balanced, mapped.bias, strict=True)]
        if homing is not None:
            moved = homing.accelerations(graph, rig.t, rig.q, rig.v)
            wanted = homing.before(graph, [dot(graph, row, moved) for row in jacobian], wanted)
        unwanted = [graph.apply("neg", dot(graph, row, free)) for row in jacobian]
        matrix, off = product(graph, jacobian, gain), list[Node]()
        if not controller.is_direct:
            higher = _Higher.of(controller, graph, rig, p)
            jets: list[Sequence[Node | None]] = [mapped.eta, rate, *higher.jets()]
            orders = higher.per_second(controller.desired.derivatives(graph, time, jets, p.virtual, **given_d))
            if homing is not None:
                ends = _ends(controller, homing, p, higher, rig.memory)
                slowed = replace(homing, bandwidth=p.bandwidth[0])
                orders = slowed.derivatives(graph, rig.t, [mapped.eta, mapped.rate], ends, orders)
            for i, row in higher.rows(orders):
                unwanted[i], wanted[i], matrix[i] = row.unwanted, row.wanted, row.by_inputs
                off += row.off
        cancel, drive, decoupling = decouple(graph, matrix, unwanted, wanted)

        inputs = [graph.add(a, b) for a, b in zip(cancel, drive, strict=True)]  # L + G T^-1[D]
        known = controller.known(rig, p)
        acting = controller.curves.solved(graph, known, inputs, p.branches)
        driven = [dot(graph, row, inputs) for row in gain]
        given = [graph.add(a, b) for a, b in zip(free, driven, strict=True)]
        health = graph.mul(inertia, decoupling)
        motion = (mapped.eta, rate, desired, cancel, drive, inputs, acting, gain, health, given, driven)
        delays = [graph.mul(d, p.time_scale) for d in wanted_d.delays]
        return cls(*motion, remembered, wanted_d.lagged, delays, wanted_d.conditions, off)


class _Row(NamedTuple):
    """What a virtual coordinate asks of the inputs that appear in a higher derivative of it than the second."""

    unwanted: Node  # what the rig does by itself, to be cancelled
    wanted: Node
    by_inputs: list[Node]  # (inputs,)
    off: list[Node]  # see `ControlLaw.off`


@dataclass(frozen=True)
class _Higher:
    """Virtual coordinates with inputs that appear in a higher derivative than the second."""

    graph: Graph
    degrees: tuple[int, ...]
    known: Derivatives  # of the virtual coordinates along the motion of the rig
    values: list[Node]  # of the symbols of these
    scales: list[Node]  # powers of the time scale, from the first on
    bandwidth: list[Node]

    @classmethod
    def of(cls, controller: Controller, graph: Graph, rig: RigSymbols, p: ControllerParameters) -> _Higher:
        degrees = controller.degrees
        unmodelled = rig.disturbance if len(rig.disturbance) > len(rig.q) else [graph.number(0.0)] * (2 * len(rig.q))
        values = [rig.t, *rig.q, *rig.v, *rig.s, *p.model, *p.transform, *p.lengths, *unmodelled]
        scales = [*itertools.accumulate([p.time_scale] * max(degrees), graph.mul)]
        known = Derivatives(controller.model.affine, controller.transform)
        return cls(graph, degrees, known, values, scales, p.bandwidth)

    def jets(self) -> list[list[Node | None]]:
        """Derivatives of the virtual coordinates per unit of virtual time, from the second on; see `derivatives`."""
        found = list[list[Node | None]]()
        for order in range(2, max(self.degrees)):
            own = self.known.within(self.graph, self.known.of_order(order), self.values)
            scaled = [self.graph.mul(x, self.scales[order - 1]) for x in own]
            found.append([x if order < degree else None for x, degree in zip(scaled, self.degrees, strict=True)])
        return found

    def per_second(self, desired: Sequence[Sequence[Node]]) -> list[list[Node]]:
        """D and its derivatives, which are per unit of virtual time (orders, k), per second."""
        return [[self.graph.div(d, size) for d in row] for row, size in zip(desired, self.scales[1:], strict=True)]

    def rows(self, wanted: Sequence[Sequence[Node]]) -> Iterator[tuple[int, _Row]]:
        """Rows of virtual coordinates, by their numbers, from D and its derivatives per second (orders, k)."""
        graph, one = self.graph, self.graph.number(1.0)
        for i, degree in enumerate(self.degrees):
            more = degree - 2
            if not more:
                continue
            every = [*(self.known.of_order(k)[i] for k in range(2, degree + 1)), *self.known.by_inputs(degree)[i]]
            nodes = self.known.within(graph, every, self.values)
            own, by_inputs = nodes[: more + 1], nodes[more + 1 :]
            virtual = [order[i] for order in wanted[: more + 1]]
            powers = [*itertools.accumulate([one, *self.bandwidth * more], graph.mul)][::-1]
            weights = [graph.mul(graph.number(float(math.comb(more, k))), power) for k, power in enumerate(powers)]
            off = [graph.sub(a, b) for a, b in zip(own[:-1], virtual[:-1], strict=True)]
            unwanted = graph.apply("neg", dot(graph, weights, own))
            yield i, _Row(unwanted, dot(graph, weights, virtual), by_inputs, off)


@dataclass(frozen=True)
class RigSymbols:
    """Nodes of the rig: time, coordinates, velocities, internal states, and accelerations that the model lacks.

    Behind the latter are their rates, where inputs have disturbances, too (2 n,).
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


def _ends(controller: Controller, homing: Homing, p: ControllerParameters, higher: _Higher, memory: list[Node]) -> Ends:
    """Ends of a homing phase in virtual coordinates, with internal states of the virtual system."""
    graph = higher.graph
    zero = graph.number(0.0)

    def mapped(place: Sequence[Node]) -> list[Node]:
        scaled = [graph.div(q, length) for q, length in zip(place, p.lengths, strict=True)]
        return controller.transform.lower(graph, scaled, [zero] * len(scaled), p.transform).eta

    end = mapped(homing.end)
    still, free = [zero] * len(end), [None] * len(end)
    jets: list[Sequence[Node | None]] = [end, still, *[free] * (max(higher.degrees) - 2)]
    given = {"regulation": p.regulation, "memory": memory}
    wanted = higher.per_second(controller.desired.derivatives(graph, zero, jets, p.virtual, **given))
    return Ends(mapped(homing.start), [end, still, *wanted])


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
    bandwidth: list[Node]
    branches: list[Node]

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
            [] if controller.is_direct else make("w", ("actuators",)),
            make("b", tuple(f"{name}_{end}" for name in controller.curves.names for end in ("low", "high"))),
        )

    def loads(self, graph: Graph) -> dict[str, str]:
        """For each parameter's text how it is read from the array `p`."""
        return {str(graph.operations[n][1]): f"p[{i}]" for i, n in enumerate(self._nodes)}

    @property
    def count(self) -> int:
        """Length of the array."""
        return len(self._nodes)

    @property
    def _nodes(self) -> list[Node]:
        scaled = [*self.lengths, self.time_scale, *self.regulation, *self.energy_balance]
        return [*self.model, *self.virtual, *self.transform, *scaled, *self.bandwidth, *self.branches]
