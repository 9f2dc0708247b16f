"""Augmented model: a twin with force ports, at which effects are tried.

A force port at each place and an offset before each actuator are compiled in: along a known motion, responses of the
sensors are to forces at these ports. What is fitted has the effects in the place of the ports, see `trial_equations`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from masking.compile.codegen import module_store
from masking.compile.codegen.compiled_functions import Kernels, linked
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.tangent import jacobian
from masking.compile.numerics.arrays import Array, IntVector
from masking.compile.numerics.kernel_arguments import Course, Pieces
from masking.compile.numerics.rig_sizes import RigSizes, whole_lanes
from masking.control.rig.twin import LoweredTwin, Twin
from masking.inference.discovery import compiled_laws as laws
from masking.inference.discovery.places import Place, degrees, followed, identifier, opened, port, rates, taken
from masking.inference.discovery.trial_equations import Ported, Seated, Trial
from masking.inference.estimation.sensitivity import SIGNATURES, Sensitivity, add_slopes
from masking.lazy_imports import kalman_kernels, known_motion
from masking.model.declaration.dictionary_checks import MOST_PARAMETERS
from masking.model.declaration.expression import Expression
from masking.model.effects import FORCE, OFFSET, Effect

MOST_COLUMNS = 96  # features that are spread at once
Key = tuple[str, str, tuple[int, ...]]  # an effect, its place, and `Seated.reads`
PLACED = "placed(t: float, y, u, p, d, jy: Matrix)"


@dataclass(frozen=True)
class EffectInstance:
    """An effect at a place with values of all its parameters, and which of them are estimated."""

    effect: str  # its name in the dictionary, which may be `delay`
    at: str  # name of the place, sensor or actuator; '' for a delay of all actuators
    # of its parameters, in the order of the dictionary, in coherent units of the place; the last may be left out, and
    # are then as usual
    values: tuple[float, ...]
    free: tuple[int, ...]  # indices of those that are estimated
    # its entry in the dictionary; by default that which comes with the package
    known: Effect | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        left = list(self.entry.parameters.values())[len(self.values) :]
        object.__setattr__(self, "values", (*self.values, *(parameter.value or 0.0 for parameter in left)))

    @property
    def entry(self) -> Effect:
        """Effect's entry in the dictionary."""
        return self.known or laws.USUAL[self.effect]

    @property
    def where(self) -> str:
        """Kind of place in which the effect sits."""
        return self.entry.where

    @property
    def estimated(self) -> tuple[float, ...]:
        """Values of the estimated parameters (f,)."""
        return tuple(self.values[i] for i in self.free)

    def with_values(self, at: Sequence[int], values: Iterable[float]) -> EffectInstance:
        """Instance with other values of some of its parameters."""
        made = dict(enumerate(self.values)) | dict(zip(at, map(float, values), strict=True))
        return replace(self, values=tuple(made.values()))

    def times(self, factor: float, at: Sequence[int]) -> EffectInstance:
        """Instance with some of its parameters multiplied."""
        return self.with_values(at, (self.values[i] * factor for i in at))

    def at_step(self, mobility: float, step: float) -> EffectInstance:
        """Instance with the parameters that follow the step of integration in s, where it has such."""
        rules = self.entry.by_step
        known = {"mobility": mobility, "step": step}
        values = (Expression(text).evaluate(known) for text in rules.values())
        return self.with_values(self.entry.indices(tuple(rules)), values)

    @property
    def creeping(self) -> EffectInstance:
        """Instance with a smooth law, as a controller can follow it, in the place of one that sticks."""
        at = self.entry.indices(tuple(self.entry.by_step) if self.entry.at_zero else ())
        return self.with_values(at, np.zeros(len(at)))

    @property
    def sticks(self) -> bool:
        """Whether parameters that follow the step of integration have been given to it."""
        return any(self.values[i] for i in self.entry.indices(tuple(self.entry.by_step)))

    @property
    def begins(self) -> tuple[float, ...]:
        """How far from 0 its state may begin; 0 where it begins there, and nothing where it has none."""
        values = dict(zip(self.entry.parameters, self.values, strict=True))
        return tuple(Expression(state.size or "0").evaluate(values) for state in self.entry.states.values())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        every = list(self.entry.parameters)
        return tuple(every[i] for i in self.free)


@dataclass(frozen=True)
class Equations:
    """Normal equations of a record: J^T W J (w, w), J^T W r (w,), squared residuals (sensors,), simulated readings.

    Residuals are 0 where commands from before the record act, which are not known.
    Columns: parameters of the rig, free parameters of the effects, where their states begin, then what each interval
    may begin with, as `Twin.free` has it.
    """

    matrix: Array
    gradient: Array
    squares: Array
    simulated: Array
    residuals: Array


@dataclass(frozen=True)
class Given:
    """A rig with effects at values of their parameters, as kernels take it."""

    trial: Trial  # compiled equations
    p: Array  # parameter array, with those of the effects behind
    # how it depends on what is estimated: parameters of the rig, of imperfections and of effects (affected, k)
    basis: Array
    late: Array  # delay of each actuator, s (actuators,)
    late_columns: IntVector  # column of this delay, or -1 (actuators,)


@dataclass(frozen=True)
class AugmentedModel:
    """A twin with open places."""

    twin: Twin  # the rig with its declared values
    names: tuple[str, ...]  # its parameters that may be adjusted
    # the effects that are tried; by default those of the dictionary, and the bases of laws without a name
    tried: tuple[Effect, ...] = ()
    at: tuple[float, ...] = ()  # coordinates at rest (n,), around which it is linearised; 0 if not given
    directed: bool = False  # whether directed places are open, too
    imperfections: tuple[EffectInstance, ...] = ()  # with one parameter each, adjusted as those of the rig are

    @cached_property
    def _opened(self) -> tuple[Twin, tuple[Place, ...]]:
        base, found = opened(self.twin.base, directed=self.directed)
        ports = {f"port_{identifier(p.name)}": port(FORCE, p.name if p.declared else identifier(p.name)) for p in found}
        commands = {f"port_{name}": port(OFFSET, name) for name in self.twin.actuators}
        effects = {**commands, **ports, **self.twin.declaration.effects}
        declaration = self.twin.declaration.model_copy(update={"effects": effects})
        return Twin(declaration, base, self.twin.changes, self.twin.chosen), found

    @cached_property
    def laws(self) -> dict[str, Effect]:
        """Effects that can be tried, in the order of their numbers."""
        tried = {one.name: one for one in self.tried} or {**self.twin.dictionary, **laws.BASES}
        return laws.known({one.effect: one.entry for one in self.imperfections} | tried)

    @property
    def _with_states(self) -> dict[str, Effect]:
        return {name: law for name, law in self.laws.items() if law.states}

    @property
    def places(self) -> tuple[Place, ...]:
        """Places where a force may sit."""
        return self._opened[1]

    @property
    def affected(self) -> int:
        """Number of entries of the parameter array that depend on parameters and ports."""
        return len(self._sensitivity.affected)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Coordinates of the rig."""
        return tuple(self.twin.model.coordinates)

    @cached_property
    def degrees(self) -> tuple[str, ...]:
        """Degrees of freedom that forces move: coordinates, internal states, or outputs of a component."""
        return degrees(self.twin.base)

    @property
    def rest(self) -> Array:
        """State (states,) at rest."""
        return self.twin.rest(np.array(self.at or (0.0,) * len(self.coordinates)))

    @cached_property
    def _sensitivity(self) -> Sensitivity:
        twin, found = self._opened
        forces = [f"port_{identifier(p.name)}_{FORCE.factors[0]}" for p in found]
        commands = [f"port_{name}_{OFFSET.factors[0]}" for name in self.twin.actuators]
        series = [name for i in self._yielding for name in taken(found[i].name)]
        return Sensitivity(twin, (*self.names, *forces, *series, *commands))

    @cached_property
    def _yielding(self) -> tuple[int, ...]:
        return tuple(i for i, place in enumerate(self.places) if place.has_force)

    @property
    def seats(self) -> list[Place]:
        """Places, and what may be taken from the displacement and the rate of those that yield."""
        return [*self.places, *(self.places[i] for i in self._yielding for _ in range(2))]

    def parts(self, instance: EffectInstance) -> list[tuple[int, int]]:
        """Laws of an effect in an element by their numbers, and the seats where they act."""
        at, known = self.index(instance), list(self.laws)
        beside, attaches = (known.index(instance.effect), at), instance.entry.attaches
        if attaches == "beside":
            return [beside]
        first = len(self.places) + 2 * self._yielding.index(at)
        if attaches == "in_series":
            return [(beside[0], first), (known.index(laws.rate_of(instance.effect)), first + 1)]
        return [*((known.index(name), first + i) for i, name in enumerate(laws.ALL_TAKEN)), beside]

    @cached_property
    def _forces(self) -> tuple[float, ...]:
        """Force at its place of a unit at each seat, to first order at rest."""
        _, by = self._slopes_at_rest
        columns, many = self.columns[1], len(self.places)
        found = [1.0] * many
        for seat in range(many, len(columns)):
            force = by[:, columns[self._yielding[(seat - many) // 2]]]
            found.append(float(force @ by[:, columns[seat]]) / max(float(force @ force), 1e-300))
        return tuple(found)

    @property
    def stiffnesses(self) -> dict[str, float]:
        """Stiffness at rest of each element that declares a force of its own."""
        many = len(self.places)
        return {self.places[i].name: abs(self._forces[many + 2 * j]) for j, i in enumerate(self._yielding)}

    @cached_property
    def start(self) -> Array:
        """Declared values of the parameters (k,), in declared units; those of imperfections come last."""
        return np.append(self._sensitivity.start()[: len(self.names)], [one.estimated for one in self.imperfections])

    def imperfect(self, theta: Array) -> list[EffectInstance]:
        """Imperfections with their values among those of all parameters (k,)."""
        values = theta[len(self.names) :]
        return [one.with_values(one.free, (x,)) for one, x in zip(self.imperfections, values, strict=True)]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and the largest allowed value of each of its own parameters, in declared units."""
        low, high = self._sensitivity.bounds()
        return low[: len(self.names)], high[: len(self.names)]

    @cached_property
    def _basis(self) -> tuple[Array, Array]:
        return self._sensitivity.basis(self._sensitivity.start())

    def basis(self, theta: Array) -> tuple[Array, Array]:
        """Parameter array for values (k,), and how it depends on them (affected, k)."""
        p, columns = self._basis
        k, affected = len(self.names), list(self._sensitivity.affected)
        made, more = p.copy(), len(self.imperfections)
        made[affected] += columns[:, :k] @ (theta - self.start)[:k]
        return made, np.ascontiguousarray(np.hstack([columns[:, :k], np.zeros((len(affected), more))]))

    @cached_property
    def columns(self) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """P-indices of the ports of seats, and columns of these and of commands among the affected entries."""
        sensitivity, k, many = self._sensitivity, len(self.names), len(self.seats)
        _, basis = self._basis
        at = [int(np.flatnonzero(basis[:, k + i])[0]) for i in range(basis.shape[1] - k)]
        return tuple(sensitivity.affected[i] for i in at[:many]), tuple(at[:many]), tuple(at[many:])

    @cached_property
    def degree_places(self) -> tuple[int, ...]:
        """For each degree the index of the place that it is."""
        by = {place.coordinate: i for i, place in enumerate(self.places) if place.coordinate}
        return tuple(by[name] for name in self.degrees)

    @cached_property
    def equations(self) -> Kernels:
        """Compiled equations, readings and places of the rig with ports, and their derivatives."""
        made_from = {"augmented": self._opened[0].structure(), "affected": list(self._sensitivity.affected)}
        return Kernels(module_store.load(module_store.key(made_from), self._build))

    def _build(self) -> Module:
        twin, _ = self._opened
        module = Module(f"{twin.declaration.name}, augmented", {"kind": "augmented", **twin.state_kinds})
        lowered = LoweredTwin(twin)
        graph, loads = lowered.graph, lowered.loads
        add_slopes(module, lowered, [f"p[{i}]" for i in self._sensitivity.affected])
        by_text = {text: name for name, text in loads.items()}
        at = [i for i in range(len(twin.state_names)) if f"y[{i}]" in by_text]
        y = [graph.symbol(by_text[f"y[{i}]"], varying=True) for i in at]
        nodes = [*followed(lowered, self.seats), *rates(lowered, self.seats, by_text)]
        results = [(f"d[{i}]", node) for i, node in enumerate(nodes)]
        module.add(PLACED, graph, [*results, *jacobian(graph, "jy", nodes, y, at)], loads)
        return module

    @cached_property
    def kernels(self) -> Kernels:
        """Compiled functions; from the cache on disk where they have been made before."""
        width = whole_lanes(max(self.affected, 2 * len(self.seats), laws.WIDTH, MOST_COLUMNS))
        rows = max(self.sizes.work_rows, self.sizes.response_rows, 2 * len(self.seats) + 2)
        links = {laws.SIGNATURE: laws.library(self._with_states), **self.equations.by_signature(*SIGNATURES, PLACED)}

        def factories() -> dict[str, tuple[Any, ...]]:
            return {
                "respond": (known_motion.linear_responses, "slopes", "sensed"),
                "follow": (kalman_kernels.fixed_gain_filter, "rates", "sensed"),
                "smooth_backward": (kalman_kernels.smooth_backward,),
                "motions": (known_motion.places_along, "rates", "placed"),
                "along": (known_motion.law_along, laws.LAW),
                "read": (known_motion.readings_along, "sensed"),
            }

        return linked("augmented models", factories, links, (rows, width))

    @cached_property
    def latent(self) -> IntVector:
        """For each degree the index of its force in the parameter array."""
        return np.array([self.columns[0][i] for i in self.degree_places], dtype=np.int64)

    @cached_property
    def sizes(self) -> RigSizes:
        """Sizes of the rig."""
        twin = self._opened[0]
        return RigSizes(len(twin.state_names), len(self.coordinates), len(twin.sensors))

    @cached_property
    def mobilities(self) -> dict[str, float]:
        """Acceleration of each place at rest per unit of force, or its rate per unit of a flow."""
        moved, by = self._slopes_at_rest
        pushed = np.split(moved @ by[:, list(self.columns[1])], 2)
        return {place.name: abs(float(pushed[place.has_rate][i, i])) for i, place in enumerate(self.places)}

    @cached_property
    def _slopes_at_rest(self) -> tuple[Array, Array]:
        """How seats and their rates depend on the state (2 seats, n), and its rate on affected entries."""
        n, many, u = len(self._opened[0].state_names), len(self.seats), np.zeros(len(self.twin.actuators))
        by_state, (p, _) = np.zeros((2 * many, n)), self.basis(self.start)
        self.equations.placed(0.0, self.rest, u, p, np.zeros(2 * many), by_state)
        return by_state, self.slopes(self.start)[1]

    def slopes(self, theta: Array) -> tuple[Array, Array]:
        """How rates of states at rest depend on states (n, n) and on affected parameters and ports (n, a)."""
        n, u = len(self.twin.state_names), np.zeros(len(self.twin.actuators))
        by_state, by_entry = np.zeros((n, n)), np.zeros((n, self.affected))
        self.equations.slopes(0.0, self.rest, u, self.basis(theta)[0], np.zeros(n), by_state, by_entry)
        return by_state, by_entry

    def reading(self, theta: Array, state: Array, commands: Array | None = None) -> tuple[Array, Array]:
        """Readings in a state (sensors,), and their derivatives by it (sensors, states); commands are 0 by default."""
        return self._read(theta, state, commands)[:2]

    def direct(self, theta: Array) -> Array:
        """How readings depend at once on the affected entries of the parameter array, at rest (sensors, a)."""
        return self._read(theta, self.rest, None)[2]

    def _read(self, theta: Array, state: Array, commands: Array | None) -> tuple[Array, Array, Array]:
        sensors = len(self.twin.sensors)
        given = np.zeros(len(self.twin.actuators)) if commands is None else np.array(commands, dtype=float)
        p, _ = self.basis(theta)
        s, js, jps = np.zeros(sensors), np.zeros((sensors, len(state))), np.zeros((sensors, self.affected))
        self.equations.sensed(0.0, state, given, p, np.zeros(sensors), s, js, jps)
        return s, js, jps

    def given(self, instances: Sequence[EffectInstance], theta: Array) -> Given:
        """Rig with effects, and how it depends on parameters of the rig, imperfections and effects, in turn (k,)."""
        used, channels = len(self.names), len(self.twin.actuators)
        late, late_columns = np.zeros(channels), np.full(channels, -1)
        own, columns = self.basis(theta[: len(self.start)])
        values, at, seated, same = list[float](), dict[int, int](), list[Key](), dict[float, int]()
        for instance in (*self.imperfections, *instances):
            estimated = {i: used + m for m, i in enumerate(instance.free)}
            of_effect = [float(theta[estimated[i]]) if i in estimated else x for i, x in enumerate(instance.values)]
            used += len(estimated)
            if instance.effect == laws.DELAY:
                delayed = [self.twin.actuators.index(instance.at)] if instance.at else [*range(channels)]
                late[delayed] += of_effect[0]
                late_columns[delayed] = estimated.get(0, -1)
                continue
            reads, may_be = list[int](), laws.estimable(instance.entry)
            for i, (name, x) in enumerate(zip(instance.entry.parameters, of_effect, strict=True)):
                place = len(values) if name in may_be else same.setdefault(x, len(values))
                values += [x] * (place == len(values))
                reads.append(place)
                at |= {place: estimated[i]} if i in estimated else {}
            seated.append((instance.effect, instance.at, tuple(reads)))
        trial = self._trial(tuple(seated))
        basis = np.zeros((len(columns) + len(trial.free), used))
        basis[: len(columns), : columns.shape[1]] = columns
        for row, place in enumerate(trial.free, len(columns)):
            if place in at:
                basis[row, at[place]] = 1.0
        return Given(trial, np.concatenate([own, values]), basis, late, late_columns)

    def _trial(self, keys: tuple[Key, ...]) -> Trial:
        if keys not in self._trials:
            placed = [self._seated(*key) for key in keys]
            self._trials[keys] = Trial.of(self._ported, placed, self._sensitivity.affected, self._opened[0].structure())
        return self._trials[keys]

    def _seated(self, effect: str, at: str, reads: tuple[int, ...]) -> Seated:
        law, known = self.laws[effect], list(self.laws.values())
        instance = EffectInstance(effect, at, (), (), law)
        parts = self.parts(instance) if law.where == "element" else []
        return Seated(law, self.index(instance), tuple((known[number], seat) for number, seat in parts), reads)

    @cached_property
    def _trials(self) -> dict[tuple[Key, ...], Trial]:
        return {}

    @cached_property
    def _ported(self) -> Ported:
        return Ported(LoweredTwin(self._opened[0]), self.seats, self.columns[0])

    def along(self, instance: EffectInstance, x: Array, rate: Array, dt: float, by: Sequence[int] = ()) -> Array:
        """Force or value of an effect along a known motion, and its derivatives by the parameters `by` (m, 1 + c).

        The motion is the displacement, command or reading that the effect acts on (m,) and the rate of it (m,), with dt
        in s. Of one in series with an element or in its place, it is what the element's force gains, linearised.
        """
        names, course = list(self.laws), Course(*map(np.ascontiguousarray, (x, rate)))
        if instance.entry.attaches == "beside":
            return self._follow(instance, instance.effect, course, dt, by)
        parts = ((self._forces[seat], names[number]) for number, seat in self.parts(instance))
        return np.asarray(sum(factor * self._follow(instance, name, course, dt, by) for factor, name in parts))

    def _follow(self, instance: EffectInstance, name: str, course: Course, dt: float, by: Sequence[int]) -> Array:
        given = dict(zip(instance.entry.parameters, instance.values, strict=True))
        law = self.laws[name].reduced(given)
        if not law.states:
            return laws.along(law, course, dt, given, [list(given)[i] for i in by])
        features = np.empty((len(course.x), 1 + len(by)))
        values = np.array([*given.values(), *np.zeros(MOST_PARAMETERS)])
        parameters = np.array([*by, 0], dtype=np.int64)  # of none, nothing is read
        span, number = Pieces(len(course.x), dt, laws.pieces(*course, dt)), list(self._with_states).index(name)
        self.kernels.along(span, number, course, parameters, values, features)
        return features

    def index(self, instance: EffectInstance) -> int:
        """Index of an instance's place among the places, sensors or actuators."""
        names = {"element": [p.name for p in self.places], "sensor": self.twin.sensors, "actuator": self.twin.actuators}
        return list(names[instance.where]).index(instance.at)
