"""Closed loop: a controller and the model of the plant that it drives, compiled together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from masking.compile.codegen.compiled_functions import Compiled
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.control.coordinate_match import CoordinateMatch
from masking.control.law import ControlLaw, Controller, ControllerParameters, RigSymbols
from masking.errors import ModelError
from masking.lazy_imports import control, runge_kutta, sampled_loop, single_step
from masking.model.declaration.instrument_declaration import Sensor
from masking.model.modelling.lowering import Added, LoweredEquations, add_runge_kutta
from masking.model.modelling.model import Model


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
        u: inputs (m,): L + drive. Of an input that acts nonlinearly, these two and G are of what it does, not of it.
    """

    T: Array
    rate: Array
    D: Array
    L: Array
    drive: Array
    G: Array
    u: Array


@dataclass(frozen=True)
class ClosedLoop(Compiled):
    """A controller and the model of the plant that it drives, compiled together.

    Args:
        controller: the control law.
        plant: what the rig really is, in SI units; its inputs are those of the controller's model.
        sensors: of the plant, after which coordinates of the controller's model may be named.
    """

    controller: Controller
    plant: Model
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        assumed, _ = self.controller.model, self.match
        unknown = [name for name in assumed.declaration.states if name not in self.plant.declaration.states]
        if unknown:
            raise ModelError(
                f"the controller's model {assumed.name} has the internal states {', '.join(unknown)}, which the plant "
                f"{self.plant.name} does not have: a controller that knows the true state needs them there; let it "
                "estimate them with an observer, or take another controller.model"
            )

    def __repr__(self) -> str:
        return f"<ClosedLoop {self.plant.name} as {self.controller.virtual.name}: {self.controller!r}>"

    @cached_property
    def match(self) -> CoordinateMatch:
        """Coordinates of the controller's model among the plant's."""
        return CoordinateMatch(self.controller, self.plant, self.sensors)

    @property
    def internal(self) -> tuple[str, ...]:
        """Names of the states after coordinates and velocities: the plant's, then the virtual system's."""
        return (*self.plant.states, *(f"virtual.{name}" for name in self.controller.virtual.states))

    def values(self) -> Array:
        """Parameter array: the controller's, then the plant's."""
        return np.concatenate([self.controller.values(), self.plant.values()])

    @property
    def _made_from(self) -> Mapping[str, object]:
        both = {"controller": self.controller.structure(), "plant": self.plant.structure()}
        return both | self.match.structure()

    def evaluate(self, t: float, q: Array, v: Array) -> Blocks:
        """Results of the blocks at one state of the rig.

        Args:
            t: time of the rig, s.
            q: rig coordinates (n,), SI units.
            v: rig velocities (n,), SI units, and then the states of `internal`.
        """
        k, n, m = len(self.controller.virtual.coordinates), len(self.plant.coordinates), len(self.plant.inputs)
        p, kernels = self.values(), self.kernels

        def block(name: str, size: int) -> Array:
            out = np.empty(size)
            getattr(kernels, name)(float(t), np.asarray(q, float), np.asarray(v, float), p, out)
            return out

        mapped, u = block("transform", 2 * k), np.empty(m)
        kernels.step(float(t), np.asarray(q, float), np.asarray(v, float), u, p)
        return Blocks(
            T=mapped[:k],
            rate=mapped[k:],
            D=block("desired", k),
            L=block("cancel", m),
            drive=block("drive", m),
            G=np.asarray(np.linalg.pinv(block("input_matrix", n * m).reshape(n, m)), dtype=np.float64),
            u=u,
        )

    def to_control(self) -> control.NonlinearIOSystem:
        """Closed loop as a nonlinear input/output system of python-control.

        It has no delays and no inputs; its states are the rig's coordinates and velocities in SI units and those of
        `internal`, its outputs the virtual coordinates, in the virtual system's units, and the rig's inputs.
        """
        self.controller.virtual.check_ordinary("python-control")
        kernels, p = self.kernels, self.values()
        k, m = len(self.controller.virtual.coordinates), len(self.plant.inputs)

        def update(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
            rate = np.empty(len(x))
            kernels.derivative(float(t), np.array(x, float), np.zeros(m), p, rate)
            return rate

        def output(t: float, x: Array, u: Array, params: Mapping[str, float]) -> Array:
            state, virtual, inputs = np.array([x], float), np.empty((1, 2 * k)), np.empty((1, m))
            kernels.along(np.array([t], float), state, p, virtual, inputs)
            return np.concatenate([virtual[0, :k], inputs[0]])

        coordinates = self.plant.coordinates
        virtual = self.controller.virtual
        names: dict[str, Any] = {"states": [*coordinates, *(f"{c}'" for c in coordinates), *self.internal]}
        names |= {"outputs": [*virtual.coordinates, *self.plant.inputs], "name": f"{self.plant.name} as {virtual.name}"}
        return control.nlsys(update, output, inputs=0, **names)

    def _build(self) -> Module:
        made = module(self)
        made.add_factory("answer", single_step.law_step, "step", len(self.plant.coordinates), len(self.plant.inputs))
        return made


def module(loop: ClosedLoop) -> Module:
    """Generated module of a closed loop."""
    controller, n = loop.controller, len(loop.plant.coordinates)
    graph = Graph()
    s = loop.plant.equations.symbols
    internal = {name: graph.symbol(f"s_{name}", varying=True) for name in loop.plant.declaration.states}
    rig = RigSymbols(
        graph.symbol("t", varying=True),
        [graph.symbol(f"q_{c}", varying=True) for c in loop.plant.coordinates],
        [graph.symbol(f"v_{c}", varying=True) for c in loop.plant.coordinates],
        [internal[name] for name in controller.model.declaration.states],
        memory=[graph.symbol(f"z_{name}", varying=True) for name in controller.virtual.remembered],
    )
    seen = loop.match.view.lower(graph, rig.q, rig.v, [])
    law = ControlLaw.of(controller, graph, replace(rig, q=seen.eta, v=seen.rate))
    known = dict(zip((s.t, *s.q, *s.v, *s.s), (rig.t, *rig.q, *rig.v, *internal.values()), strict=True))
    fed = known | dict(zip(s.u, law.acting, strict=True))
    driven = LoweredEquations.of(loop.plant.equations, graph, known=fed)
    plant = LoweredEquations.of(loop.plant.equations, graph, known=known)

    p = ControllerParameters.of(controller, graph)
    split = {**p.loads(graph), **plant.loads("q[{i}]", "v[{i}]", offset=p.count)}
    joined = {**p.loads(graph), **plant.joined(offset=p.count)}
    for i, node in enumerate(rig.memory, n + len(internal)):
        text = str(graph.operations[node][1])
        split[text], joined[text] = f"v[{i}]", f"y[{n + i}]"
    size = 2 * n + len(loop.internal)
    derivatives = [*rig.v, *driven.accelerations, *driven.rates, *law.remembered]
    health = graph.mul(law.health, driven.health)
    happening, moved = controller.virtual.equations.events, size - len(law.remembered) - 2 * len(law.eta)
    targets = tuple((event, state + moved) for event, state in happening.targets)
    meta = {
        "kind": "closed loop",
        "coordinates": list(loop.plant.coordinates),
        "states": list(loop.internal),
        "lags": len(law.lagged),
        "events": list(happening.names),
        "targets": list(targets),
        "inputs": list(loop.plant.inputs),
        "virtual": list(controller.virtual.coordinates),
        "unsolved": controller.curves.unsolved,
        # The virtual system by itself is integrated by Taylor series: two methods that agree check each other.
        "method": "runge_kutta",
    }
    made = Module(f"{loop.plant.name}, masked as {controller.virtual.name}", meta)

    def add(signature: str, target: str, nodes: list[Node], returns: Node | None = None) -> None:
        reads = joined if ", y," in signature else split
        made.add(signature, graph, [(f"{target}[{i}]", x) for i, x in enumerate(nodes)], reads, returns)

    add("transform(t: float, q, v, p, out)", "out", [*law.eta, *law.rate])
    add("desired(t: float, q, v, p, out)", "out", law.desired)
    add("cancel(t: float, q, v, p, out)", "out", law.cancel)
    add("drive(t: float, q, v, p, out)", "out", law.drive)
    add("input_matrix(t: float, q, v, p, out)", "out", [x for row in law.input_matrix for x in row])
    add("step(t: float, q, v, u, p)", "u", law.acting, law.health)
    if law.off:
        add("off(t: float, q, v, p, out)", "out", law.off)
    by_plant = [*rig.v, *plant.accelerations, *plant.rates, *law.remembered]
    add("plant_derivative(t: float, y, u, p, dy)", "dy", by_plant, plant.health)
    add("derivative(t: float, y, u, p, dy)", "dy", derivatives, health)
    added = Added(rig.t, derivatives, law.lagged, law.delays, law.conditions, targets)
    add_runge_kutta(made, graph, added, joined, (size, len(loop.plant.inputs)))
    made.add_factory("run_sampled", runge_kutta.sampled, "step", "plant_derivative", size, n, work=(5, size))
    made.add_factory("along", sampled_loop.along, "transform", "step", n)
    return made
