"""Twin: a simulated rig with everything that it does wrong, each of which can be switched off.

A plant file declares a model, effects in its elements, sensors and actuators, and how the actuators are wired. All of
it becomes one system of ordinary differential equations with held commands, and what the sensors read of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from masking.compile.codegen.compiled_functions import Compiled, steps_between
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.time_switches import TimeSwitches
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.newton import equilibrium
from masking.control.rig.allocation import allocation
from masking.errors import DeclarationError, Problem, RecordError, RootError, nearest
from masking.lazy_imports import runge_kutta
from masking.lazy_imports import sympy as sp
from masking.model.declaration import couplings, registry, schema, units
from masking.model.declaration.expression import Expression
from masking.model.effects import Attachment, Effect, attach_all, dictionary, expressions
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model

MOST_STEPS = 10_000  # per sample: thirty turns of an undamped motion, of which no record tells
FEWEST_STEPS = 2  # per sample: the linearisation at rest sees neither contact nor friction


@dataclass(frozen=True)
class PlacedEffect:
    """One effect at one place: its label, its kind and what that is, where, how strong, and whether it is on."""

    label: str
    kind: str
    entry: Effect
    at: str
    parameters: Mapping[str, float | Expression]
    enabled: bool
    path: str


@dataclass(frozen=True)
class Twin(Compiled):
    """A simulated rig."""

    declaration: schema.PlantDeclaration  # the content of a plant file
    base: schema.ModelDeclaration  # the model that it names
    # what an experiment changes of its effects, by their names
    changes: Mapping[str, schema.EffectChange] = field(default_factory=dict)
    # values of parameters of effects in sensors and actuators at one place, such as `offset_s1_e0`
    chosen: Mapping[str, float] = field(default_factory=dict)
    # what is known of it from the twin that it was made from, by the name of the property
    built: InitVar[Mapping[str, object] | None] = None

    def __post_init__(self, built: Mapping[str, object] | None) -> None:
        vars(self).update(built or {})

    def __repr__(self) -> str:
        channels = f"sensors {', '.join(self.sensors)}; actuators {', '.join(self.actuators)}"
        return f"<Twin {self.declaration.name}: {channels}; {len(self.declaration.effects)} effects>"

    @classmethod
    def load(cls, name_or_path: str | Path) -> Twin:
        """Load a plant and the model that it names; a packaged name or a file."""
        declaration = registry.load_plant(name_or_path)
        return cls(declaration, registry.load_model(declaration.model, registry.refer(declaration, "model")))

    def as_model(self, name_or_path: str | Path | None = None) -> Twin:
        """Plant with a model, by default its own, and without the effects in its elements."""
        gone = {effect.path.removeprefix("effects.") for effect in self._of("element")}
        kept = {name: use for name, use in self.declaration.effects.items() if name not in gone}
        changes = {name: change for name, change in self.changes.items() if name in kept}
        own = {name: value for name, value in self.declaration.parameters.items() if name in self.base.parameters}
        changed: dict[str, object] = {"effects": kept, "parameters": own}
        base = self.base
        if name_or_path is not None:
            base = registry.load_model(name_or_path)
            changed |= {"model": str(name_or_path), "parameters": {}}
        return replace(self, declaration=self.declaration.model_copy(update=changed), base=base, changes=changes)

    def equation_parameters(self) -> tuple[str, ...]:
        """Parameters of the model that its equations hold, without those of effects.

        These are its equations of motion, those of its internal states, and outputs with a force.
        """
        equations, d = self.model.equations, self.base
        held = equations.mass.free_symbols | equations.force.free_symbols
        for _, rate in zip(d.rates, equations.rates, strict=False):  # those of effects come last
            held |= rate.free_symbols
        held |= {x for n in couplings.driven_outputs(d) for x in equations.output(n).free_symbols}
        own = self.base.parameters.keys() & self.parameter_names.keys()  # without the switches of effects
        return tuple(s.name for s in equations.symbols.p if s in held and s.name in own)

    def validate(self) -> None:
        """Refuse effects and allocation that do not fit the model; a DeclarationError lists all of them."""
        _ = self.dictionary, self.effects, self.allocation, self.attached

    @cached_property
    def dictionary(self) -> Mapping[str, Effect]:
        """All effects that there are: those of the package, and of the dictionaries that the plant names."""
        return dictionary(self.declaration.dictionaries)

    @cached_property
    def effects(self) -> tuple[PlacedEffect, ...]:
        """Every effect at every place, in declared order.

        A DeclarationError where there is no such effect or place, or a parameter is unknown or missing.
        """
        problems: list[Problem] = []
        for name in self.changes:
            if name not in self.declaration.effects:
                message = f"{self.declaration.name} has no effect '{name}'"
                problems.append(Problem(None, f"effects.{name}", message, nearest(name, self.declaration.effects)))
        found = [effect for name in self.declaration.effects for effect in self._at_each_place(name, problems)]
        if problems:
            raise DeclarationError(problems)
        return tuple(found)

    def _at_each_place(self, name: str, problems: list[Problem]) -> Iterator[PlacedEffect]:
        use, change = self.declaration.effects[name], self.changes.get(name, schema.EffectChange())
        path = f"effects.{name}"
        known = self.dictionary.get(use.effect)
        if known is None:
            message, remedy = f"there is no effect '{use.effect}'", nearest(use.effect, self.dictionary)
            problems.append(Problem(self.declaration.place(f"{path}.effect"), f"{path}.effect", message, remedy))
            return
        places = {"element": self.base.elements, "sensor": self.sensors, "actuator": self.actuators}
        allowed = [str(place) for place in places.get(known.where, ())]
        given = {**use.parameters, **change.parameters}
        problems += self._check(name, known, given, allowed)
        enabled = use.enabled if change.enabled is None else change.enabled
        for at in use.at or ("",):
            label = f"{name}_{at}" if len(use.at) > 1 else name
            yield PlacedEffect(label, use.effect, known, at, given, enabled, path)

    def _check(
        self, effect: str, known: Effect, given: Mapping[str, float | Expression], allowed: list[str]
    ) -> Iterator[Problem]:
        use, path = self.declaration.effects[effect], f"effects.{effect}"
        place = self.declaration.key_place(path)
        if known.where == "loop" and use.at:
            yield Problem(place, path, f"the effect {use.effect} sits in the loop, not at {', '.join(use.at)}")
        if known.where != "loop" and not use.at:
            message = f"the effect {use.effect} needs a place: which {known.where}"
            yield Problem(place, path, message, f"write 'at: {allowed[0]}'" if allowed else f"declare {known.where}s")
        for at in use.at if known.where != "loop" else ():
            if at not in allowed:
                message = f"'{at}' is no {known.where} of {self.declaration.name}"
                yield Problem(self.declaration.place(f"{path}.at"), f"{path}.at", message, nearest(at, allowed))
        for name in given.keys() - known.parameters.keys():
            message = f"the effect {use.effect} has no parameter '{name}'"
            yield Problem(place, f"{path}.parameters.{name}", message, nearest(name, known.parameters))
        missing = [name for name, p in known.parameters.items() if p.value is None and name not in given]
        if missing:
            needed = ", ".join(f"{name} [{known.parameters[name].unit}]" for name in missing)
            yield Problem(place, path, f"the effect {use.effect} needs {needed}")

    @cached_property
    def attached(self) -> schema.ModelDeclaration:
        """Declaration of the rig's model with the effects of its elements."""
        placed = [Attachment(e.entry, e.at, e.label, _as_text(e.parameters)) for e in self._of("element")]
        return attach_all(self.base, placed)

    @cached_property
    def model(self) -> Model:
        """Model of the rig with the effects of its elements, in SI units."""
        switches = {f"{effect.label}_on": float(effect.enabled) for effect in self._of("element")}
        return Model(self.attached, {**self.declaration.parameters, **switches})

    def changed(self, changes: Mapping[str, schema.EffectChange]) -> Twin:
        """Twin with other changes; elements whose parameters stay are not attached anew."""
        made = replace(self, changes=changes)
        is_same = [e.parameters for e in made._of("element")] == [e.parameters for e in self._of("element")]
        return replace(made, built={"attached": self.attached, "effects": made.effects}) if is_same else made

    def unrounded(self) -> Twin:
        """Twin with sensors that do not round.

        What is simulated is compared with readings before it is rounded: rounding both would count it twice. Commands
        are known, so that what rounds them in the actuators stays.
        """
        rounding = {e.path.removeprefix("effects.") for e in self._of("sensor") if e.entry.quantum}
        return self.changed({**self.changes, **dict.fromkeys(rounding, schema.EffectChange(enabled=False))})

    def _of(self, where: str) -> list[PlacedEffect]:
        return [effect for effect in self.effects if effect.entry.where == where]

    def _on(self, where: str, at: str) -> list[PlacedEffect]:
        return [effect for effect in self._of(where) if effect.at == at]

    @property
    def actuators(self) -> tuple[str, ...]:
        """Channels that a controller commands; the model's inputs where none are declared."""
        return tuple(self.declaration.actuators or self.base.inputs)

    @property
    def measured_actuators(self) -> tuple[str, ...]:
        """Channels that no one commands: they hold a measured motion, which elements of the model follow."""
        rows = [list(self.base.inputs).index(name) for name in couplings.measured_inputs(self.base)]
        wired = (self.allocation[rows] != 0.0).any(axis=0)
        return tuple(name for name, is_wired in zip(self.actuators, wired, strict=True) if is_wired)

    @cached_property
    def is_fed(self) -> bool:
        """Whether a sensor reads what a command or a force changes at once, as the force of a component."""
        return any(couplings.is_fed(self.base, sensor.measures) for sensor in self.declaration.sensors.values())

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(self.declaration.sensors)

    @property
    def delay(self) -> int:
        """Samples between a reading and the first effect of the command that answers it."""
        return sum(round(self._value(effect, "samples")) for effect in self._of("loop") if effect.enabled)

    def late(self, rate: float) -> Array:
        """Samples after which a command of each actuator acts (actuators,): the delay, and dead times."""
        own = [(e.at, self._value(e, e.entry.grows_with)) for e in self.dead_times]
        return self.delay + rate * np.array([float(sum(tau for at, tau in own if at == a)) for a in self.actuators])

    @property
    def dead_times(self) -> list[PlacedEffect]:
        """Dead times that act in actuators: effects without an expression."""
        return [effect for effect in self._of("actuator") if effect.enabled and not effect.entry.expression]

    @cached_property
    def chain_states(self) -> tuple[tuple[PlacedEffect, str], ...]:
        """Internal states of effects in actuators and sensors, which follow those of the model in y."""
        return tuple((effect, name) for effect in self._chain for name in effect.entry.states)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of y: coordinates, velocities, internal states of the model, of actuators and sensors."""
        coordinates, internal = self.state_kinds.values()
        return (*coordinates, *(f"{c}'" for c in coordinates), *internal)

    @property
    def state_kinds(self) -> dict[str, list[str]]:
        """Names of the coordinates, and of the internal states as `states`."""
        chain = [f"{effect.label}_{name}" for effect, name in self.chain_states]
        return {"coordinates": [*self.model.coordinates], "states": [*self.model.declaration.states, *chain]}

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Indices in y of what a record may begin with: all but the internal states of effects."""
        begins = {*self.state_names[: 2 * len(self.model.coordinates)], *self.base.states}
        return tuple(i for i, name in enumerate(self.state_names) if name in begins)

    @cached_property
    def allocation(self) -> Array:
        """Allocation: input of the model per unit of each command (inputs, actuators)."""
        return allocation(self.declaration, self.base, self.model.parameter_values())

    def noise(self) -> dict[str, float]:
        """Standard deviation of a reading of each sensor that declares any, in the sensor's unit.

        A quantised reading counts with that of rounding, step / sqrt(12).
        """
        found = {}
        for name in self.sensors:
            parts = [
                Expression(e.entry.deviation).evaluate({key: self._value(e, key) for key in e.entry.parameters})
                for e in self._on("sensor", name)
                if e.enabled and e.entry.deviation
            ]
            if parts:
                found[name] = float(np.sqrt(sum(part**2 for part in parts)))
        return found

    def _value(self, effect: PlacedEffect, name: str) -> float:
        declared = effect.parameters.get(name, effect.entry.parameters[name].value)
        value = self.chosen.get(f"{effect.label}_{name}", declared)
        if isinstance(value, Expression):
            return value.evaluate(self.model.parameter_values())
        return float(value)  # type: ignore[arg-type]  # checked in `effects`

    def values(self) -> Array:
        """Parameter array: model, allocation, gains of the sensors, parameters of their effects."""
        rest = [self._value(effect, name) for effect in self._chain for name in effect.entry.parameters]
        gains, switches = [self.gain(name) for name in self.sensors], [float(e.enabled) for e in self._chain]
        return np.concatenate([self.model.values(), self.allocation.ravel(), gains, rest, switches])

    @cached_property
    def parameter_names(self) -> dict[str, tuple[PlacedEffect, str] | None]:
        """Parameters that may be changed by name: None for those of the model, else effect and parameter."""
        model = {name: None for name in self.model.parameters if not name.endswith("_on")}
        chain = {f"{e.label}_{n}": (e, n) for e in (*self._chain, *self.dead_times) for n in e.entry.parameters}
        return {**model, **chain}

    def parameter_value(self, name: str) -> float:
        """Parameter in its declared unit."""
        found = self.parameter_names[name]
        if found is not None:
            return self._value(*found)
        unit = self.model.declaration.parameters[name].unit
        return self.model.value(name) / self.model.units.conversions[unit].factor

    def parameter_bounds(self, name: str) -> tuple[float | None, float | None]:
        """Bounds of a parameter, in its declared unit; None where there is none."""
        found = self.parameter_names[name]
        known = self.model.declaration.parameters[name] if found is None else found[0].entry.parameters[found[1]]
        return known.bounds

    def with_parameters(self, values: Mapping[str, float]) -> Twin:
        """Twin with other values of parameters, in their declared units; nothing is recompiled."""
        model = {name: value for name, value in values.items() if self.parameter_names[name] is None}
        chain = {name: value for name, value in values.items() if name not in model}
        plant = self.declaration.model_copy(update={"parameters": self.declaration.parameters | model})
        built = {name: getattr(self, name) for name in ("dictionary", "attached", "effects", "kernels")}
        built["model"] = self.model.with_parameters(**model)
        return replace(self, declaration=plant, chosen={**self.chosen, **chain}, built=built)

    @property
    def _chain(self) -> list[PlacedEffect]:
        """Effects of actuators and sensors, but for dead times."""
        actuators = [e for a in self.actuators for e in self._on("actuator", a) if e.entry.expression]
        return actuators + [e for s in self.sensors for e in self._on("sensor", s)]

    def gain(self, sensor: str) -> float:
        """Readings of a sensor per SI unit of what it measures."""
        declared, factors = self.declaration.sensors[sensor], self.kernels.meta["factors"]
        return float(declared.gain.value * factors[declared.gain.unit] / factors[declared.unit])

    def substeps(self, rate: float) -> int:
        """Integration steps between samples that resolve the fastest motion at rest."""
        p, u, lengths = self.values(), np.zeros(len(self.actuators)), self._lengths
        state, derivative = self.rest(self.model.first_place), self.kernels.twin_derivative
        sizes = np.resize(lengths, len(state)) if len(lengths) else np.ones(len(state))
        return max(FEWEST_STEPS, steps_between(lambda y, out: derivative(0.0, y, u, p, out), state, sizes, rate))

    def resolving(self, rate: float) -> int:
        """Integration steps between samples of a record, as `substeps`; a RecordError where they are too far apart."""
        steps = self.substeps(rate)
        if steps > MOST_STEPS:
            raise RecordError(
                f"samples are {1.0 / rate:.4g} s apart: between two, the motion of {self.declaration.name} takes "
                f"{steps} integration steps; if the clock is not in seconds, give its unit: --map t=time:ms, or us, ns"
            )
        return steps

    def size(self, unit: str) -> float:
        """Size in SI units of a unit that the plant file uses."""
        return float(self.kernels.meta["factors"][unit])

    @property
    def _lengths(self) -> Array:
        return np.array([self.model.units.size(c.unit, {}) for c in self.model.declaration.coordinates.values()])

    def unpowered(self) -> Array:
        """State (states,) at rest without commands; at the declared place where there is no such rest."""
        n, p, u, out = len(self._lengths), self.values(), np.zeros(len(self.actuators)), np.empty(len(self.state_names))

        def accelerations(q: Array) -> Array:
            self.kernels.twin_derivative(0.0, self.rest(q), u, p, out)
            return out[n : 2 * n].copy()

        try:
            return self.rest(equilibrium(accelerations, self._lengths))
        except RootError:
            return self.rest(self.model.first_place)

    def rest(self, coordinates: Array, internal: Sequence[float] | None = None) -> Array:
        """State (states,) at rest in given coordinates (n,), with internal states as declared if they are not given."""
        n, zeros = len(coordinates), np.zeros(len(coordinates) + len(self.chain_states))
        return np.concatenate([coordinates, zeros[:n], internal or self.model.first_internal, zeros[n:]])

    def structure(self) -> dict[str, object]:
        """All that the compiled functions depend on, apart from values."""
        return {
            "model": self.model.structure(),
            "sensors": {n: [s.measures.text, s.gain.unit, s.unit] for n, s in self.declaration.sensors.items()},
            "actuators": list(self.actuators),
            "chain": [[effect.label, effect.entry.structure(), effect.at] for effect in self._chain],
            "units": sorted(_units(self.declaration, self.base)),
        }

    @property
    def _made_from(self) -> Mapping[str, object]:
        return {"twin": self.structure()}

    def _build(self) -> Module:
        module = Module(self.declaration.name, {"kind": "twin", **self.state_kinds})
        self.add_to(module)
        return module

    def add_to(self, module: Module) -> None:
        """Add `sense(t, y, p, noise, s)`, `twin_derivative(t, y, u, p, dy)`, `advance` and `move` to a module.

        What a command changes at once is read by `sense_under(t, y, u, p, noise, s)`, and `sense` is only there where
        nothing is.
        """
        module.meta["factors"] = {unit: units.factor_of(unit) for unit in _units(self.declaration, self.base)}
        nodes = LoweredTwin(self)
        fixed = {symbol: text for symbol, text in nodes.loads.items() if text.startswith("p[")}  # commands vary
        slopes, time = [node for _, node in nodes.derivatives], nodes.equations.symbols[self.model.equations.symbols.t]
        module.meta["time_switches"] = TimeSwitches.of(nodes.graph, slopes, time, fixed).to_meta()
        module.add("sense_under(t: float, y, u, p, noise, s)", nodes.graph, nodes.readings, nodes.loads)
        if not any(couplings.is_commanded(self.base, sensor.measures) for sensor in self.declaration.sensors.values()):
            module.add("sense(t: float, y, p, noise, s)", nodes.graph, nodes.readings, nodes.loads)
        module.add("twin_derivative(t: float, y, u, p, dy)", nodes.graph, nodes.derivatives, nodes.loads, nodes.health)
        size = len(self.state_names)
        module.add_factory("advance", runge_kutta.steps_of_runge_kutta_4, "twin_derivative", size, work=(5, size))
        module.add_factory("move", runge_kutta.steps_under_way, "twin_derivative", size, work=(5, size))


class LoweredTwin:
    """A twin as nodes of a graph: `readings` of the sensors and `derivatives` of the state, with their `loads`."""

    def __init__(self, twin: Twin) -> None:
        self.twin, self.graph = twin, Graph()
        graph, equations = self.graph, twin.model.equations
        channels, inputs = len(twin.actuators), len(equations.declaration.inputs)
        self.loads: dict[str, str] = {}
        self._next = len(equations.declaration.parameters)

        wires = [[self._parameter(f"w_{i}_{j}") for j in range(channels)] for i in range(inputs)]
        gains = [self._parameter(f"gain_{name}") for name in twin.sensors]
        self.parameters = {
            effect.label: {name: self._parameter(f"e_{effect.label}_{name}") for name in effect.entry.parameters}
            for effect in twin._chain
        }
        self.switches = {effect.label: self._parameter(f"on_{effect.label}") for effect in twin._chain}

        commands = [self._read(f"c_{name}", f"u[{j}]", varying=False) for j, name in enumerate(twin.actuators)]
        first = len(twin.state_names) - len(twin.chain_states)
        self.states = {
            (effect.label, name): self._read(f"a_{effect.label}_{name}", f"y[{first + i}]", varying=True)
            for i, (effect, name) in enumerate(twin.chain_states)
        }
        self.rates: list[Node] = []
        channel = [self._through("actuator", name, x) for name, x in zip(twin.actuators, commands, strict=True)]
        driven = [graph.total([graph.mul(w, x) for w, x in zip(row, channel, strict=True)]) for row in wires]
        model = LoweredEquations.of(equations, graph, known=dict(zip(equations.symbols.u, driven, strict=True)))
        self.equations = model
        self.loads |= model.joined()
        self.health = model.health
        s = equations.symbols
        self.readings = []
        for i, (name, gain) in enumerate(zip(twin.sensors, gains, strict=True)):
            measured = model.lower(equations.measured(twin.declaration.sensors[name].measures))
            noise = self._read(f"xi_{i}", f"noise[{i}]", varying=True)
            self.readings.append((f"s[{i}]", self._through("sensor", name, graph.mul(gain, measured), noise)))
        moving = [*(model.symbols[v] for v in s.v), *model.accelerations, *model.rates, *self.rates]
        self.derivatives = [(f"dy[{i}]", x) for i, x in enumerate(moving)]

    def _parameter(self, name: str) -> Node:
        self._next += 1
        return self._read(name, f"p[{self._next - 1}]", varying=False)

    def _read(self, name: str, text: str, *, varying: bool) -> Node:
        self.loads[name] = text
        return self.graph.symbol(name, varying=varying)

    def _through(self, where: str, at: str, x: Node, noise: Node | None = None) -> Node:
        """Value after the effects at one sensor or actuator, one after the other; no state follows noise."""
        sound, silent = x, self.graph.number(0.0)
        for effect in (e for e in self.twin._on(where, at) if e.entry.expression):
            result, rates = expressions(effect.entry)
            nodes = {name: self.states[effect.label, name] for name in rates}
            nodes |= {"on": self.switches[effect.label], "u" if where == "actuator" else "s": x}
            nodes |= self.parameters[effect.label] | ({} if noise is None else {"xi": noise})
            x = lowered(self.graph, result, nodes)
            if noise is not None:
                nodes |= {"s": sound, "xi": silent}
                sound = lowered(self.graph, result, nodes)
            self.rates += [lowered(self.graph, rate, nodes) for rate in rates.values()]
        return x


def lowered(graph: Graph, expression: Expression, nodes: Mapping[str, Node]) -> Node:
    """Node of an expression of an effect, by the nodes of its names."""
    symbols = {name: sp.Symbol(name, real=True) for name in nodes}
    return graph.lower(expression.to_sympy(symbols), {symbols[name]: node for name, node in nodes.items()})


def _as_text(parameters: Mapping[str, float | Expression]) -> dict[str, float | str]:
    return {name: p.text if isinstance(p, Expression) else p for name, p in parameters.items()}


def _units(plant: schema.PlantDeclaration, model: schema.ModelDeclaration) -> set[str]:
    """Text of every unit in a plant file, and of the inputs of its model."""
    limits = plant.limits
    found = {"1", *(a.unit for a in plant.actuators.values()), *(x.unit for x in limits.inputs.values())}
    found |= {x.unit for s in plant.sensors.values() for x in (s, s.gain, s.wraps) if x}
    found |= {x.unit for x in model.inputs.values()}
    found |= {x.unit for x in limits.coordinates.values()} | {x.unit for x in limits.velocities.values()}
    if limits.power is not None:
        found |= {limits.power.unit, limits.power.heating.unit if limits.power.heating else "1"}
    return found
