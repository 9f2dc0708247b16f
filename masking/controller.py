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
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np

from masking.blocks import Cancellation, DesiredDynamics, Transform, check_actuation, decouple
from masking.compile import store
from masking.compile.graph import Graph, Node
from masking.compile.source import Module
from masking.errors import ModelError
from masking.kernels import Array, Kernels
from masking.lowering import SOLVE_RUNGE_KUTTA, LoweredEquations
from masking.model import Model

if TYPE_CHECKING:
    import control
else:
    control = lazy.load("control")


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
        p = _ControllerParameters.of(controller, graph)
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
        unwanted = [graph.apply("neg", _dot(graph, row, free)) for row in jacobian]
        matrix = [[_dot(graph, row, [g[i] for g in gain]) for i in range(len(gain[0]))] for row in jacobian]
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
class _ControllerParameters:
    """Nodes of the controller's parameter array, in the order of `Controller.values`."""

    model: list[Node]
    virtual: list[Node]
    transform: list[Node]
    lengths: list[Node]
    time_scale: Node

    @classmethod
    def of(cls, controller: Controller, graph: Graph) -> _ControllerParameters:
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
        nodes = [*self.model, *self.virtual, *self.transform, *self.lengths, self.time_scale]
        return {str(graph.operations[n][1]): f"p[{i}]" for i, n in enumerate(nodes)}

    @property
    def count(self) -> int:
        return len(self.model) + len(self.virtual) + len(self.transform) + len(self.lengths) + 1


def _dot(graph: Graph, a: list[Node], b: list[Node]) -> Node:
    return graph.total([graph.mul(x, y) for x, y in zip(a, b, strict=True)])


@dataclass(frozen=True)
class Blocks:
    """What the blocks of a control law give at one state.

    Args:
        T: virtual coordinates (k,), in the virtual system's units.
        rate: their rates (k,), per unit of virtual time.
        D: the virtual accelerations that are wanted there (k,) (6.2).
        L: inputs that cancel the rig's own dynamics (m,), in the inputs' units (6.1).
        drive: G T^-1[D], inputs that drive the wanted dynamics (m,).
        G: inputs per rig acceleration (m, n) (6.3).
    """

    T: Array
    rate: Array
    D: Array
    L: Array
    drive: Array
    G: Array

    @property
    def u(self) -> Array:
        """Return the inputs (m,): L + G T^-1[D]."""
        return self.L + self.drive


@dataclass(frozen=True)
class ClosedLoop:
    """A controller and the model of the plant that it drives, compiled together.

    Args:
        controller: the control law.
        plant: what the rig really is, in SI units; its coordinates and inputs are those of the controller's model.
    """

    controller: Controller
    plant: Model

    def __post_init__(self) -> None:
        believed = self.controller.model
        for what in ("coordinates", "inputs"):
            ours, theirs = getattr(believed, what), getattr(self.plant, what)
            if ours != theirs:
                raise ModelError(
                    f"the controller's model {believed.name} has the {what} {', '.join(ours)}, the plant "
                    f"{self.plant.name} has {', '.join(theirs)}; both must have the same, in the same order"
                )

    def values(self) -> Array:
        """Return the parameter array: the controller's, then the plant's."""
        return np.concatenate([self.controller.values(), self.plant.values()])

    @cached_property
    def kernels(self) -> Kernels:
        """Return the compiled loop; from the cache on disk where it has been made before.

        Raises:
            ActuationError: the inputs cannot accelerate every virtual coordinate.
        """
        return Kernels(store.load(self._key, self._build))

    @property
    def is_compiled(self) -> bool:
        """Tell whether the loop is in the cache on disk."""
        return store.exists(self._key)

    @property
    def _key(self) -> str:
        return store.key({"controller": self.controller.structure(), "plant": self.plant.structure()})

    def evaluate(self, t: float, q: Array, v: Array) -> Blocks:
        """Return what each block gives at one state of the rig.

        Args:
            t: time of the rig, s.
            q: rig coordinates (n,), SI units.
            v: rig velocities (n,), SI units.
        """
        k, n, m = len(self.controller.virtual.coordinates), len(self.plant.coordinates), len(self.plant.inputs)
        p, kernels = self.values(), self.kernels

        def block(name: str, size: int) -> Array:
            out = np.empty(size)
            getattr(kernels, name)(float(t), np.asarray(q, float), np.asarray(v, float), p, out)
            return out

        mapped = block("transform", 2 * k)
        return Blocks(
            T=mapped[:k],
            rate=mapped[k:],
            D=block("desired", k),
            L=block("cancel", m),
            drive=block("drive", m),
            G=np.asarray(np.linalg.pinv(block("input_matrix", n * m).reshape(n, m)), dtype=np.float64),
        )

    def to_control(self) -> control.NonlinearIOSystem:
        """Return the closed loop as a nonlinear input/output system of python-control.

        It has no inputs; its states are the rig's coordinates and velocities in SI units, its outputs the virtual
        coordinates, in the virtual system's units, and the rig's inputs.
        """
        kernels, n, p = self.kernels, len(self.plant.coordinates), self.values()
        k, m = len(self.controller.virtual.coordinates), len(self.plant.inputs)

        def update(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
            rate = np.empty(2 * n)
            kernels.derivative(float(t), np.array(x, float), np.zeros(m), p, rate)
            return rate

        def output(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
            state, virtual, inputs = np.array([x], float), np.empty((1, 2 * k)), np.empty((1, m))
            kernels.along(np.array([t], float), state, p, virtual, inputs)
            return np.concatenate([virtual[0, :k], inputs[0]])

        names = self.plant.coordinates
        return control.nlsys(
            update,
            output,
            inputs=0,
            states=[*names, *(f"{c}'" for c in names)],
            outputs=[*self.controller.virtual.coordinates, *self.plant.inputs],
            name=f"{self.plant.name} as {self.controller.virtual.name}",
        )

    def _build(self) -> Module:
        check_actuation(self.controller.model, self.controller.transform)
        return _module(self)


def _module(loop: ClosedLoop) -> Module:
    """Return the generated module of a closed loop."""
    controller, n = loop.controller, len(loop.plant.coordinates)
    graph = Graph()
    s = loop.plant.equations.symbols
    rig = RigSymbols(
        graph.symbol("t", varying=True),
        [graph.symbol(f"q_{c}", varying=True) for c in loop.plant.coordinates],
        [graph.symbol(f"v_{c}", varying=True) for c in loop.plant.coordinates],
    )
    law = ControlLaw.of(controller, graph, rig)
    known = dict(zip((s.t, *s.q, *s.v), (rig.t, *rig.q, *rig.v), strict=True))
    driven = LoweredEquations.of(
        loop.plant.equations, graph, known={**known, **dict(zip(s.u, law.inputs, strict=True))}
    )
    plant = LoweredEquations.of(loop.plant.equations, graph, known=known)

    p = _ControllerParameters.of(controller, graph)
    split = {**p.loads(graph), **plant.loads("q[{i}]", "v[{i}]", offset=p.count)}
    split |= {f"v_{c}": f"v[{i}]" for i, c in enumerate(loop.plant.coordinates)}
    joined = split | {f"q_{c}": f"y[{i}]" for i, c in enumerate(loop.plant.coordinates)}
    joined |= {f"v_{c}": f"y[{n + i}]" for i, c in enumerate(loop.plant.coordinates)}
    derivatives = [*rig.v, *driven.accelerations]
    health = graph.mul(law.health, driven.health)
    meta = {
        "kind": "closed loop",
        "coordinates": list(loop.plant.coordinates),
        "inputs": list(loop.plant.inputs),
        "virtual": list(controller.virtual.coordinates),
        # The virtual system by itself is integrated by Taylor series: two methods that agree check each other.
        "method": "runge_kutta",
    }
    title = f"{loop.plant.name}, masked as {controller.virtual.name}"
    module = Module(title, meta)

    def add(signature: str, target: str, nodes: list[Node], returns: Node | None = None) -> None:
        reads = joined if ", y," in signature else split
        module.add(signature, graph, [(f"{target}[{i}]", x) for i, x in enumerate(nodes)], reads, returns)

    add("transform(t, q, v, p, out)", "out", [*law.eta, *law.rate])
    add("desired(t, q, v, p, out)", "out", law.desired)
    add("cancel(t, q, v, p, out)", "out", law.cancel)
    add("drive(t, q, v, p, out)", "out", law.drive)
    add("input_matrix(t, q, v, p, out)", "out", [x for row in law.input_matrix for x in row])
    add("step(t, q, v, u, p)", "u", law.inputs, law.health)
    add("plant_derivative(t, y, u, p, dy)", "dy", [*rig.v, *plant.accelerations], plant.health)
    add("derivative(t, y, u, p, dy)", "dy", derivatives, health)
    module.add_kernel(SOLVE_RUNGE_KUTTA.format(size=2 * n), "idi", (24, 2 * n))
    module.add_kernel(RUN_SAMPLED.format(size=2 * n), "iid", (5, 2 * n))
    module.add_kernel(ALONG, "")
    return module


RUN_SAMPLED = """
_sampled = integrate.sampled(step, plant_derivative, {size})


@compiled
def run_sampled(begin, count, dt, substeps, every, y, u, p, first, out_y, out_u, work):
    return _sampled(begin, count, dt, substeps, every, y, u, p, first, out_y, out_u, work)
"""
ALONG = """
@compiled
def along(times, states, p, virtual, inputs):
    n = states.shape[1] // 2
    for i in range(times.size):
        transform(times[i], states[i, :n], states[i, n:], p, virtual[i])
        step(times[i], states[i, :n], states[i, n:], inputs[i], p)
"""
