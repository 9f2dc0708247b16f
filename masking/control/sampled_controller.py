"""Sampled controller: from readings to commands at a fixed rate, and such a controller closed around a twin.

One step, in order: observer, prediction to the instant at which the command acts, T, D, L, G, hold, allocation to the
actuators, limits. It is compiled whole, alone to run against a rig, and together with a twin to run offline.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from masking.compile.codegen.compiled_functions import Compiled
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, TIME, Sizes
from masking.compile.numerics.kernel_arguments import Parts
from masking.compile.numerics.newton import STEP, jacobian
from masking.control import followed_sensors
from masking.control.coordinate_match import CoordinateMatch
from masking.control.homing import Homing
from masking.control.known_instruments import Instruments
from masking.control.law import ControlLaw, Controller, ControllerParameters, RigSymbols
from masking.control.observer import SLOWEST, Differences, Observer, Plan, WholePlan, check_told
from masking.control.rig.sensor_errors import known_readings
from masking.control.transform import dot
from masking.control.virtual_inputs import NOTHING, Feed
from masking.errors import ModelError
from masking.lazy_imports import sampled_loop, single_step
from masking.model.modelling.lowering import LoweredEquations

# An offset follows the readings with this many time constants over the rest.
SETTLED = 5.0
# measured: with four steps in a sample, a hysteresis and bristles are resolved as finely as the motion is known.
MOST_MEMORY_STEPS = 4
MEMORY_STEP = 0.2  # rad; its fifth power over 120 is what a step is off by: 3e-6 of the motion
LEVELS = 7  # of noise, each twice the one before, for which an observer is designed where noise is measured at rest
HALVINGS = 8  # of the logarithm of the range in which an actuator bandwidth is sought


@dataclass(frozen=True)
class SampledController(Compiled):
    """A controller at a fixed rate."""

    controller: Controller  # the control law
    instruments: Instruments  # what it knows of the rig's sensors, actuators and limits
    observer: Observer  # how it knows the rig's state
    rate: float  # samples per second
    # standard deviation of every reading, in the sensors' units; that of the plant file where it is None
    noise: float | None
    homing: float  # seconds before the release in which the rig is brought to its initial state; 0 where it is there
    end: Array  # coordinates (n,) of the rig's initial state
    # seconds before homing in which the rig rests without commands and the sensors' offsets and noise are measured
    rest: float = 0.0
    feed: Feed = NOTHING  # what the virtual system gets as inputs while it runs
    remembered: tuple[float, ...] = ()  # the virtual system's internal states at the release
    internal: tuple[float, ...] = ()  # the rig's internal states where it is held in its initial state

    @cached_property
    def match(self) -> CoordinateMatch:
        """Coordinates of the controller's model, in which it is written."""
        return CoordinateMatch(self.controller, self.controller.model, {})

    @property
    def sizes(self) -> Sizes:
        """Sizes that the compiled step is made for."""
        model, virtual = self.controller.model, self.controller.virtual
        is_balanced = self.controller.energy_balance is not None
        n, k, remembered, lags = len(model.coordinates), len(virtual.coordinates), len(virtual.states), len(self.lags)
        own = 2 * n + len(model.states)
        resting = len(self.instruments.sensors) if self.rest else 0
        happening = virtual.kernels.meta
        targets = tuple((event, state + own - 2 * k) for event, state in happening["targets"])
        return Sizes(
            n, own + remembered + lags + is_balanced, len(model.inputs), len(self.instruments.actuators),
            self.observer.order, k if is_balanced else 0, resting, remembered, lags, self._kept,
            len(happening["events"]), targets,
            self._estimates_forces, not self.controller.is_direct, self._memory_steps,
        )  # fmt: skip

    @cached_property
    def lags(self) -> Array:
        """Delays of the virtual system's delayed expressions, in samples, which are at least one."""
        found = self.controller.virtual.delays() * self.controller.time_scale * self.rate
        if len(found) and found.min() < 1.0:
            raise ModelError(
                f"{self.controller.virtual.name}: a delay is {found.min() / self.rate:.3g} s on the rig, shorter than "
                f"the {1.0 / self.rate:.3g} s between samples; raise controller.rate"
            )
        return found

    @property
    def _kept(self) -> int:
        """Samples of delayed expressions that are kept, a power of two; 0 where there are none."""
        return 1 << math.ceil(math.log2(self.lags.max() + self.delay + 8.0)) if len(self.lags) else 0

    @cached_property
    def _estimates_forces(self) -> bool:
        law, known, at = self.controller, self.instruments, self.observer.at
        if law.is_direct and at is not None:
            raise ModelError(
                f"controller.observer.at: the inputs of {law.model.name} change accelerations at once, so that a "
                "disturbance of these is one of the inputs; leave it out"
            )
        if law.is_direct or at == "inputs":
            return law.is_direct
        tells = followed_sensors.tells_forces(law, known, self.end, self.internal, order=self.observer.order)
        if at == "masses" and not tells:
            raise ModelError(
                f"controller.observer.at: masses: the sensors ({', '.join(known.sensors)}) do not tell a force on a "
                f"mass from one of the inputs ({', '.join(law.model.inputs)}), with the derivatives that the law asks "
                "for; write 'at: inputs', leave it out, or add a sensor"
            )
        return tells

    @property
    def unused(self) -> tuple[str, ...]:
        """Sensors that are not followed, as `whole_rig.unused`; none where the model is declared to be right."""
        return () if self._estimates_forces or self.observer.at else followed_sensors.unused(self.instruments)

    @cached_property
    def _memory_steps(self) -> int:
        """Steps of the integration of the virtual system's internal states over a sample: 1, 2 or `MOST_MEMORY_STEPS`.

        A step spans at most `MEMORY_STEP` radians of the fastest motion of a virtual system without corners, linearised
        at zero; one with corners, such as a hysteresis, takes as many as there may be.
        """
        virtual, kernels = self.controller.virtual, self.controller.virtual.kernels
        if not self.remembered or kernels.meta["has_corners"] or virtual.declaration.events:
            return MOST_MEMORY_STEPS
        start = np.concatenate([np.zeros(2 * len(virtual.coordinates)), self.remembered])
        p, u = virtual.values(), np.zeros(len(virtual.inputs))

        def rates(y: Array) -> Array:
            dy = np.empty(len(y) + len(self.lags))
            kernels.derivative(0.0, np.concatenate([y, np.zeros(len(self.lags))]), u, p, dy)
            return dy[: len(y)].copy()

        slopes = jacobian(rates, start, np.full(len(start), STEP))
        if not np.isfinite(slopes).all():
            return MOST_MEMORY_STEPS
        turned = float(np.abs(np.linalg.eigvals(slopes)).max()) / (self.rate * self.controller.time_scale)
        return next((steps for steps in (1, 2) if turned <= steps * MEMORY_STEP), MOST_MEMORY_STEPS)

    @property
    def before(self) -> int:
        """Samples before the release."""
        return round((self.rest + self.homing) * self.rate) + self.delay

    @property
    def delay(self) -> int:
        """Samples between a reading and the first effect of the command that answers it."""
        return self.instruments.delay

    @property
    def has_model(self) -> bool:
        """Whether the observer follows a model."""
        return not isinstance(self.observer, Differences)

    @cached_property
    def gain(self) -> Array:
        """Observer's gain (levels estimate, sensors), C-contiguous: for the noise that is known, and louder ones.

        Those count where the noise is measured at rest. A ModelError where it is faster than the sampling allows, or
        the noise or a limit is not known.
        """
        if self.instruments.errors and not self.has_model:
            raise ModelError(
                f"controller.effects: differences of positions undo no errors of sensors ("
                f"{', '.join(e.entry.name for e in self.instruments.errors)}); take 'observer: disturbance', or leave "
                "them out"
            )
        offset = self.sizes.states - 2 * self.sizes.coordinates
        found = [self.observer.gain(self.plan, offset)]
        with contextlib.suppress(ModelError):  # too much noise for any observer
            for level in range(1, LEVELS if self.rest and self.has_model and self.controller.is_direct else 1):
                found.append(self.observer.gain(replace(self.plan, noise=2.0**level * self.plan.noise), offset))
        return np.ascontiguousarray(np.concatenate(found))

    @cached_property
    def plan(self) -> Plan | WholePlan:
        """What the observer is designed for; errors as `gain`."""
        noise = self.noise if self.has_model else 1.0
        direct = self.controller.is_direct
        return self.instruments.plan(self.rate, noise) if direct else self._whole_plan(noise)

    def as_fast_as_observed(self) -> SampledController:
        """Same with an actuator bandwidth, where one counts, as high as the bandwidth of its observer.

        What the noise of the readings makes of the commands grows with both.
        """
        if self.controller.is_direct or not self.has_model:
            return self
        fastest = self.plan.fastest
        slow, fast, found = SLOWEST * fastest, fastest, self
        for _ in range(HALVINGS):
            now = math.sqrt(slow * fast)
            made = replace(self, controller=replace(self.controller, actuator_bandwidth=now))
            with contextlib.suppress(ModelError):  # too much noise for any observer
                if made.observer.bandwidths(made.plan).min() >= now:
                    slow, found = now, made
                    continue
            fast = now
        return found

    def _whole_plan(self, noise: float | None) -> WholePlan:
        """Plan of an observer that follows the internal states of the rig as well, from the compiled functions."""
        if self.feed.pushes:
            raise ModelError(
                f"inputs: a push is found from the acceleration that it makes, and {self.controller.approach}; read it "
                "with a force sensor, such as 'F: {sensor: force}'"
            )
        sizes, n, m, p = self.sizes, self.sizes.coordinates, self.sizes.inputs, self.values()
        own, kernels = 2 * n + len(self.controller.model.states), self.kernels
        allocated = self.instruments.allocation_inverse * self.controller.per_unit
        rest = np.concatenate([self.end, np.zeros(sizes.states - n)])
        rest[2 * n : own], rest[sizes.memory] = self.internal, self.remembered
        law = getattr(kernels, self.feed.bare("law(").removesuffix("("))

        def rates(x: Array, u: Array) -> Array:
            dy = np.empty(sizes.states)
            kernels.rate(0.0, np.concatenate([x, rest[own:]]), u, p, dy)
            return dy[:own].copy()

        def readings(x: Array) -> Array:  # of a state and the accelerations that the model lacks
            found = np.empty(len(self.instruments.sensors))
            kernels.measure(0.0, np.concatenate([x[:own], rest[own:], x[own:]]), p, found)
            return found.copy()

        def commands(x: Array) -> Array:  # of these, and their rates
            u, r, g = np.empty(m), np.empty(n), np.empty(n)
            law(0.0, 0.0, np.concatenate([x[:own], rest[own:]]), x[own:].copy(), p, u, r, g)
            return allocated @ u / self.limits[:, LARGEST]

        off, lengths = np.zeros(m), self.controller.model.lengths
        x, forced = np.concatenate([rest[:own], np.zeros(2 * n)]), n * sizes.at_masses
        inside = STEP * np.maximum(np.abs(rest[2 * n : own]), 1.0)
        steps = np.concatenate([*(STEP * lengths * self.rate**k for k in (0, 1)), inside,
                                *(STEP * lengths * self.rate**k for k in (2, 3))])  # fmt: skip
        sensing, by = jacobian(readings, x[:-n], steps[:-n]), jacobian(commands, x, steps)
        dynamics = jacobian(lambda y: rates(y, off), x[:own], steps[:own])
        check_told(dynamics, sensing[:, :own], self.controller.model.state_names, self.instruments.sensors)
        driven = np.hstack([np.eye(own)[:, n : n + forced], jacobian(lambda u: rates(x[:own], u), off, np.ones(m))])
        sensing = np.hstack([sensing[:, : own + forced], np.zeros((len(sensing), m))])
        fed = -allocated / self.limits[:, [LARGEST]]
        against = (np.hstack([by[:, own : own + forced], fed]), np.hstack([by[:, own + n :][:, :forced], 0.0 * fed]))
        unused = [followed_sensors.UNUSED if name in self.unused else 1.0 for name in self.instruments.sensors]
        levels = self.instruments.levels(sensing, noise) * unused
        return WholePlan(
            dynamics, driven, sensing, by[:, :own], against, levels, 1.0 / self.rate, self.delay, n, sizes.at_masses
        )  # fmt: skip

    @cached_property
    def limits(self) -> Array:
        """Table of limits (actuators, 4)."""
        return self.instruments.limits()

    def values(self, start: Array | None = None) -> Array:
        """Parameter array; `start` are the coordinates (n,) from which homing begins."""
        known = self.instruments
        parts = [self.controller.values(), known.gains(), known.allocation_inverse.ravel(), known.allocation.ravel()]
        if self.homing:
            parts += [self.end if start is None else start, self.end, np.array([self.homing])]
        if known.errors:
            parts += [*(np.array(error.values) for error in known.errors), np.array([-self.before / self.rate])]
        return np.concatenate([*parts, self.feed.tail()])

    def structure(self) -> dict[str, object]:
        """All that the compiled step depends on, apart from values."""
        known = self.instruments
        return {
            "controller": self.controller.structure(),
            "sensors": [s.measures.text for s in known.plant.sensors.values()],
            "actuators": list(known.actuators),
            "has_model": self.has_model,
            "order": self.observer.order,
            "homing": bool(self.homing),
            "rest": bool(self.rest),
            **({"feed": self.feed.structure()} if self.feed else {}),
            **({"errors": [[e.sensor, e.entry.structure()] for e in errors]} if (errors := known.errors) else {}),
            "kept": self._kept,
            "memory_steps": self._memory_steps,
            "estimates_forces": self._estimates_forces,
        }

    @property
    def _made_from(self) -> Mapping[str, object]:
        return {"sampled": self.structure()}

    def _build(self) -> Module:
        model, unsolved = self.controller.model, self.controller.curves.unsolved
        meta = {"kind": "controller", "coordinates": list(model.coordinates), "unsolved": unsolved}
        module = Module(f"{self.instruments.plant.name}, masked as {self.controller.virtual.name}", meta)
        self.add_to(module)
        module.add_factory("answer", single_step.sampled_step, "control", self.sizes, work=self.work)
        return module

    @property
    def work(self) -> tuple[int, int]:
        """Shape of the work space of a step."""
        rows, width = self.sizes.work
        return rows, max(width, len(self.instruments.sensors))

    def add_to(self, module: Module) -> None:
        """Add the parts of the controller and `control`, which is all of them, to a generated module."""
        lowered = _Lowered(self)
        for signature, results, returns in lowered.functions():
            loads = lowered.loads if "q, v" not in signature else lowered.apart
            module.add(self.feed.bare(signature), lowered.graph, results, loads, returns)
        self.feed.add_laws(module)
        sizes, work = self.sizes, self.work
        step = {"exported": False} if self.feed.is_live else {"work": work}
        name = "bare_control" if self.feed.is_live else "control"
        if self.has_model:
            parts = Parts(*Parts._fields)  # which functions of the module have as names
            module.add_factory(name, sampled_loop.control_with_model, parts, sizes, **step)
        else:
            memory = ("remember", "lagged", "conditions")
            module.add_factory(name, sampled_loop.control_with_differences, "law", "allocate", *memory, sizes, **step)
            module.add_factory("skip", sampled_loop.skip_with_differences, *memory, sizes, work=work)
        if self.feed.is_live:
            self.feed.add_control(module, sizes, work)
        module.add_factory("transforms", sampled_loop.transforms, "transform", sizes.coordinates)

    def begin(self, readings: Array) -> Beginning:
        """How a controller begins on a rig at rest, which reads (sensors,) first, and is held where it is."""
        sizes, n = self.sizes, self.sizes.coordinates
        near = self.end if not (self.homing or self.controller.is_direct) else None
        q = self.instruments.rest() if self.rest else self.instruments.positions(readings, near)
        unused = [0.0] * (sizes.lags + (self.controller.energy_balance is not None))
        own = self.controller.model.first_internal if self.homing else self.internal
        internal = [*own, *self.remembered, *unused]
        estimate = np.concatenate([q, np.zeros(n), internal, np.zeros(sizes.order * sizes.disturbed)])
        p, inputs, y, time = self.values(q), np.empty(sizes.inputs), estimate[: sizes.states].copy(), -self.homing
        command, largest = np.zeros(sizes.actuators), self.limits[:, LARGEST]
        if not self.homing and self.has_model:  # before homing, the rig is where it is without power
            self.kernels.still(time, y, p, inputs)
            self.kernels.allocate(time, y, inputs, p, command)
            command = np.clip(command, -largest, largest)
        self.kernels.wire(time, y, command, p, inputs)
        warmed = -np.expm1(-self.delay / (self.rate * self.limits[:, TIME]))  # by the commands under way
        power = warmed * self.limits[:, HEATING] * command**2
        steady = np.zeros(sizes.fixed - sizes.change.start)
        kept = (np.zeros(sizes.balance.stop - sizes.balance.start), self._standing(q), self._past(), steady)
        return Beginning(np.concatenate([estimate, power, estimate, *kept, np.tile(inputs, self.delay)]), p, command)

    def _past(self) -> Array:
        """Memory of delayed expressions before the release, as `Sizes.past` says."""
        sizes, n = self.sizes, self.sizes.coordinates
        if not sizes.lags:
            return np.empty(0)
        y, values = np.zeros(sizes.states), np.empty(sizes.lags)
        y[: 2 * n], y[sizes.memory] = np.concatenate([self.end, np.zeros(n)]), self.remembered
        self.kernels.lagged(0.0, y, self.values(), values)
        return np.concatenate([[-1.0, 1.0 / self.rate], self.lags, np.tile(values, sizes.kept)])

    def _standing(self, q: Array) -> Array:
        """Memory of a rest at coordinates (n,), as `sampled_loop.stand_still` says."""
        if not self.rest:
            return np.empty(0)
        part = -np.expm1(-SETTLED / (self.rest * self.rate))
        expected, noise = self.instruments.readings(q), self.plan.noise
        weights = np.divide(1.0, noise**2, out=np.zeros_like(noise), where=noise > 0.0)
        begun = (expected, weights, *np.zeros((2, len(expected))), -np.ones(len(expected)))
        return np.concatenate([[-self.homing, part, -self.before / self.rate], np.ravel(begun, order="F")])


@dataclass(frozen=True, eq=False)
class Beginning:
    """What a sampled controller knows when it begins."""

    x: Array  # its memory, as `masking.compile.numerics.controller_sizes.Sizes.power` says
    p: Array  # its parameter array
    holding: Array  # the commands (actuators,) that hold the rig where it was found


Results = list[tuple[str, Node]]


class _Lowered:
    """The symbolic parts of a sampled controller as nodes of one graph."""

    def __init__(self, sampled: SampledController) -> None:
        controller, instruments = sampled.controller, sampled.instruments
        equations = controller.model.affine.equations
        self.graph, self.loads = Graph(), dict[str, str]()
        n, channels, inputs = (len(equations.coordinates), len(instruments.actuators), len(controller.model.inputs))
        self._count, self.is_live = n, sampled.feed.is_live
        time = self._read("t", "t", varying=True)
        y = {name: self._array(name, "y", len(symbols), first, varying=True) for name, symbols, first in (
            ("q", equations.symbols.q, 0), ("v", equations.symbols.v, n), ("s", equations.symbols.s, 2 * n)
        )}  # fmt: skip
        self.loads["since"] = "since"
        sizes = sampled.sizes
        has_rates = sizes.at_masses and sizes.at_inputs
        disturbance = self._array("d", "d", 2 * n if has_rates else n, varying=True)
        u = self._array("u", "u", inputs, varying=True)
        out = self._array("out", "out", channels, varying=True)

        p = ControllerParameters.of(controller, self.graph)
        self.loads |= p.loads(self.graph)
        self._next = p.count
        gains = self._parameters("gain", len(instruments.sensors))
        allocation = [self._parameters(f"alloc_{i}", inputs) for i in range(channels)]
        wires = [self._parameters(f"wire_{i}", channels) for i in range(inputs)]
        homing = None
        if sampled.homing:
            since = self.graph.symbol("since", varying=True)
            start, end = self._parameters("start", n), self._parameters("end", n)
            homing = Homing(since, start, end, self._parameters("homing", 1)[0])

        damping, slot, remembered = None, sizes.memory, sizes.remembered + sizes.lags
        memory = self._array("z", "y", remembered, slot.start, varying=True)
        if controller.energy_balance is not None:
            damping = self._read("damping", f"y[{slot.start + remembered}]", varying=True)
        rig = RigSymbols(time, y["q"], y["v"], y["s"], damping=damping, memory=memory)
        self.law = ControlLaw.of(controller, self.graph, replace(rig, disturbance=disturbance), homing)
        self.still_law = ControlLaw.of(controller, self.graph, replace(rig, v=[self.graph.number(0.0)] * n))
        s = equations.symbols
        at = controller.known(rig, p)
        known = at | dict(zip(s.u, u, strict=True))
        model = LoweredEquations.of(equations, self.graph, known=known)
        self.rates = [*y["v"], *model.accelerations, *model.rates, *[self.graph.number(0.0)] * len(memory)]
        self.virtual, self.momentum = list[Node](), list[Node]()
        if damping is not None:
            self.rates.append(self.graph.number(0.0))
            self._add_balance(controller, p, time)
        self.forces = sampled.feed.forces(self.graph, controller, known, disturbance)
        unmodelled = self._array("unmodelled", "y", n if has_rates and sizes.order else 0, sizes.states, varying=True)
        for symbol, more in zip(s.a, unmodelled, strict=False):  # accelerometers feel what the model lacks
            model.symbols[symbol] = self.graph.add(model.symbols[symbol], more)
        measured = [model.lower(equations.measured(x.measures)) for x in instruments.plant.sensors.values()]
        true = [self.graph.mul(g, m) for g, m in zip(gains, measured, strict=True)]
        self.readings = known_readings(
            instruments.errors, self.graph, dict(zip(instruments.sensors, true, strict=True)), self._parameters, time
        )
        acting = controller.curves.solved(self.graph, at, u, p.branches)
        self.commands = [dot(self.graph, row, acting) for row in allocation]
        self.inputs = controller.curves.forces(self.graph, at, [dot(self.graph, row, out) for row in wires])

    def _add_balance(self, controller: Controller, p: ControllerParameters, time: Node) -> None:
        graph, k = self.graph, len(controller.virtual.coordinates)
        wanted = [graph.div(d, p.time_scale) for d in self.law.desired]
        taken, frequency = p.energy_balance
        self.virtual = [*self.law.eta, *self.law.rate, *wanted, graph.div(frequency, p.time_scale), taken]
        e = self._array("e", "e", 2 * k, varying=True)
        self.momentum = controller.desired.momentum(graph, graph.div(time, p.time_scale), e[:k], e[k:], p.virtual)

    def functions(self) -> list[tuple[str, Results, Node | None]]:
        """Signature, results and returned node of each function."""
        law = self.law

        def into(target: str, nodes: Sequence[Node]) -> Results:
            return [(f"{target}[{i}]", node) for i, node in enumerate(nodes)]

        motion = into("u", law.inputs) + into("r", law.given) + into("g", law.driven)
        return [
            ("law(t: float, since: float, y, d, p, u, r, g)", motion, law.health),
            ("rate(t: float, y, u, p, dy)", into("dy", self.rates), None),
            ("measure(t: float, y, p, s)", into("s", self.readings), None),
            ("allocate(t: float, y, u, p, out)", into("out", self.commands), None),
            ("wire(t: float, y, out, p, u)", into("u", self.inputs), None),
            ("virtual(t: float, y, p, out)", into("out", self.virtual), None),
            ("momentum(t: float, e, p, g)", into("g", self.momentum), None),
            ("remember(t: float, y, p, dz)", into("dz", law.remembered), None),
            ("lagged(t: float, y, p, w)", into("w", law.lagged), None),
            ("conditions(t: float, y, p, w)", into("w", law.conditions), None),
            ("transform(t: float, q, v, p, out)", into("out", [*law.eta, *law.rate]), None),
            ("still(t: float, y, p, u)", into("u", self.still_law.cancel), None),
            *([("push(t: float, y, d, p, out)", into("out", self.forces), None)] if self.is_live else []),
        ]

    @property
    def apart(self) -> dict[str, str]:
        """How symbols are read where coordinates and velocities are given apart."""
        return self.loads | {f"{kind}_{i}": f"{kind}[{i}]" for kind in "qv" for i in range(self._count)}

    def _read(self, name: str, text: str, *, varying: bool) -> Node:
        self.loads[name] = text
        return self.graph.symbol(name, varying=varying)

    def _array(self, name: str, array: str, count: int, first: int = 0, *, varying: bool) -> list[Node]:
        return [self._read(f"{name}_{i}", f"{array}[{first + i}]", varying=varying) for i in range(count)]

    def _parameters(self, name: str, count: int) -> list[Node]:
        nodes = self._array(f"k_{name}", "p", count, self._next, varying=False)
        self._next += count
        return nodes
