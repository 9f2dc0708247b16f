"""Augmented model: a twin with force ports, so that any effect can act at any place without compiling again.

A force port at each place and an offset before each actuator are compiled in; effects are laws of their own, which
drive these ports in the simulation, together with the derivatives by all parameters.
Source: as `masking.numerics.augmented`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy
import numpy as np

from masking.codegen import store
from masking.codegen.graph import Node
from masking.codegen.kernels import Kernels, linked
from masking.codegen.source import Module
from masking.codegen.tangent import derivatives, jacobian
from masking.declaration.dictionary import MOST_PARAMETERS
from masking.declaration.expression import Expression
from masking.declaration.schema import EffectUse
from masking.discovery import laws
from masking.discovery.places import Place, degrees, identifier, opened
from masking.effects import EFFECTS, FORCE, OFFSET, Effect
from masking.estimation.sensitivity import SIGNATURES, Sensitivity, add_slopes
from masking.numerics.arrays import Array, IntMatrix, IntVector
from masking.numerics.instances import ACTUATOR, COLUMNS, ELEMENT, INERTIA, SENSOR
from masking.numerics.rig_sizes import PortSizes
from masking.rig.twin import LoweredTwin, Twin

if TYPE_CHECKING:
    from masking.numerics import augmented, kalman, responses
else:
    augmented = lazy.load("masking.numerics.augmented", suppress_warning=True)
    kalman = lazy.load("masking.numerics.kalman", suppress_warning=True)
    responses = lazy.load("masking.numerics.responses", suppress_warning=True)

NEARLY_ZERO = 1e-200  # the first state of an effect: powers of it have derivatives
MOST_STATES = 6  # of effects together
MOST_COLUMNS = 96  # features that are spread at once
PLACED = "placed(t: float, y, u, p, d, jy: Matrix)"
KINDS = {"element": ELEMENT, "actuator": ACTUATOR, "sensor": SENSOR}


@dataclass(frozen=True)
class EffectInstance:
    """An effect at a place with values of all its parameters, and which of them are estimated.

    Args:
        effect: its name in the dictionary, which may be `delay`.
        at: name of the place, sensor or actuator; '' for a delay of all actuators.
        values: of its parameters, in the order of the dictionary, in coherent units of the place.
        free: indices of those that are estimated.
        known: its entry in the dictionary; by default that which comes with the package.
    """

    effect: str
    at: str
    values: tuple[float, ...]
    free: tuple[int, ...]
    known: Effect | None = field(default=None, compare=False, repr=False)

    @property
    def entry(self) -> Effect:
        """Return the effect's entry in the dictionary."""
        return self.known or EFFECTS[self.effect]

    @property
    def where(self) -> str:
        """Return where the effect sits; a delay sits in the actuators."""
        return "actuator" if self.effect == laws.DELAY else self.entry.where

    @property
    def estimated(self) -> tuple[float, ...]:
        """Return the values of the estimated parameters (f,)."""
        return tuple(self.values[i] for i in self.free)

    def with_values(self, at: Sequence[int], values: Iterable[float]) -> EffectInstance:
        """Return the instance with other values of some of its parameters."""
        made = list(self.values)
        for i, value in zip(at, values, strict=True):
            made[i] = float(value)
        return replace(self, values=tuple(made))

    def with_free_times(self, factor: float) -> EffectInstance:
        """Return the instance with its estimated parameters multiplied."""
        return self.with_values(self.free, (self.values[i] * factor for i in self.free))

    @property
    def begins(self) -> tuple[float, ...]:
        """Return how far from 0 its state may begin; 0 where it begins there, and nothing where it has none."""
        if self.effect == laws.DELAY:
            return ()
        values = dict(zip(self.entry.parameters, self.values, strict=True))
        return tuple(Expression(state.size or "0").evaluate(values) for state in self.entry.states.values())

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the estimated parameters."""
        every = (laws.DEAD_TIME,) if self.effect == laws.DELAY else tuple(self.entry.parameters)
        return tuple(every[i] for i in self.free)


@dataclass(frozen=True)
class Equations:
    """Normal equations of a record: J^T W J (w, w), J^T W r (w,), squared residuals (sensors,), simulated readings.

    Columns: parameters of the rig, free parameters of the effects, where their states begin, then what each interval
    may begin with, as `Twin.free` has it.
    """

    matrix: Array
    gradient: Array
    squares: Array
    simulated: Array


@dataclass(frozen=True)
class Instances:
    """Tables of effect instances, as kernels read them.

    Args:
        table: a row for each instance, those of sensors last (i, 5); columns as `numerics.instances` says.
        estimated: the column of each parameter in the normal equations, or -1 (i, parameters).
        values: all parameters, one after the other.
        acts: 1 where an effect acts, of places, then of actuators (places + actuators,).
        late: delay of each actuator, s (actuators,).
        late_columns: column of this delay, or -1 (actuators,).
        states: how many states the effects have.
    """

    table: IntMatrix
    estimated: IntMatrix
    values: Array
    acts: IntVector
    late: Array
    late_columns: IntVector
    states: int


@dataclass(frozen=True)
class AugmentedModel:
    """A twin with open places.

    Args:
        twin: the rig with its declared values.
        names: its parameters that may be adjusted.
        tried: the effects that are tried; by default those of the dictionary, and the bases of laws without a name.
    """

    twin: Twin
    names: tuple[str, ...]
    tried: tuple[Effect, ...] = ()

    @cached_property
    def _opened(self) -> tuple[Twin, tuple[Place, ...]]:
        base, found = opened(self.twin.base)
        ports = {
            f"port_{identifier(p.name)}": _port(FORCE, p.name if p.declared else identifier(p.name)) for p in found
        }
        commands = {f"port_{name}": _port(OFFSET, name) for name in self.twin.actuators}
        effects = {**commands, **ports, **self.twin.declaration.effects}
        declaration = self.twin.declaration.model_copy(update={"effects": effects})
        return Twin(declaration, base, self.twin.changes, self.twin.chosen), found

    @cached_property
    def laws(self) -> dict[str, Effect]:
        """Return the effects that can be tried, in the order of their numbers."""
        return laws.known({one.name: one for one in self.tried} or {**self.twin.dictionary, **laws.BASES})

    @property
    def places(self) -> tuple[Place, ...]:
        """Return the places where a force may sit."""
        return self._opened[1]

    @property
    def affected(self) -> int:
        """Return the number of entries of the parameter array that depend on parameters and ports."""
        return len(self._sensitivity.affected)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the coordinates of the rig."""
        return tuple(self.twin.model.coordinates)

    @cached_property
    def degrees(self) -> tuple[str, ...]:
        """Return what forces move: coordinates, internal states, or outputs of a component."""
        return degrees(self.twin.base)

    @property
    def begins(self) -> int:
        """Return the number of states that a shooting interval may begin with at any value."""
        return len(self.twin.free)

    @property
    def rest(self) -> Array:
        """Return the state (states,) at rest."""
        return self.twin.rest(np.zeros(len(self.coordinates)))

    @cached_property
    def _sensitivity(self) -> Sensitivity:
        twin, found = self._opened
        forces = [f"port_{identifier(p.name)}_{FORCE.factors[0]}" for p in found]
        commands = [f"port_{name}_{OFFSET.factors[0]}" for name in self.twin.actuators]
        return Sensitivity(twin, (*self.names, *forces, *commands))

    @cached_property
    def start(self) -> Array:
        """Return the declared values of the parameters (k,), in declared units."""
        return self._sensitivity.start()[: len(self.names)]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the largest allowed value of each parameter (k,), in declared units."""
        low, high = self._sensitivity.bounds()
        return low[: len(self.names)], high[: len(self.names)]

    @cached_property
    def _basis(self) -> tuple[Array, Array]:
        """Return the parameter array as declared, and how its affected entries depend on names and ports."""
        return self._sensitivity.basis(self._sensitivity.start())

    def basis(self, theta: Array, more: int = 0) -> tuple[Array, Array]:
        """Return the parameter array for values (k,), and how it depends on them (affected, k + more)."""
        p, columns = self._basis
        k, affected = len(self.names), list(self._sensitivity.affected)
        made = p.copy()
        made[affected] += columns[:, :k] @ (theta - self.start)
        return made, np.ascontiguousarray(np.hstack([columns[:, :k], np.zeros((len(affected), more))]))

    @cached_property
    def columns(self) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """Return p-indices of the force ports, and columns of force ports and commands among the affected entries."""
        sensitivity, k, many = self._sensitivity, len(self.names), len(self.places)
        _, basis = self._basis
        at = [int(np.flatnonzero(basis[:, k + i])[0]) for i in range(basis.shape[1] - k)]
        return tuple(sensitivity.affected[i] for i in at[:many]), tuple(at[:many]), tuple(at[many:])

    @cached_property
    def degree_places(self) -> tuple[int, ...]:
        """Return for each degree the index of the place that it is."""
        by = {place.coordinate: i for i, place in enumerate(self.places) if place.coordinate}
        return tuple(by[name] for name in self.degrees)

    @property
    def coordinate_places(self) -> tuple[int, ...]:
        """Return for each coordinate the index of the place that it is."""
        return self.degree_places[: len(self.coordinates)]

    @cached_property
    def equations(self) -> Kernels:
        """Return the compiled equations, readings and places of the rig with ports, and their derivatives."""
        made_from = {"augmented": self._opened[0].structure(), "affected": list(self._sensitivity.affected)}
        return Kernels(store.load(store.key(made_from), self._build))

    def _build(self) -> Module:
        twin, found = self._opened
        module = Module(f"{twin.declaration.name}, augmented", {"kind": "augmented", **twin.state_kinds})
        lowered = LoweredTwin(twin)
        graph, loads = lowered.graph, lowered.loads
        by_entry = add_slopes(module, lowered, self._sensitivity.affected)
        module.meta["is_direct"] = not all(graph.is_number(node, 0.0) for node in by_entry)
        by_text = {text: name for name, text in loads.items()}
        at = [i for i in range(len(twin.state_names)) if f"y[{i}]" in by_text]
        y = [graph.symbol(by_text[f"y[{i}]"], varying=True) for i in at]
        nodes = [*_followed(lowered, found), *_rates(lowered, found, by_text)]
        results = [(f"d[{i}]", node) for i, node in enumerate(nodes)]
        module.add(PLACED, graph, [*results, *jacobian(graph, "jy", nodes, y, at)], loads)
        return module

    @cached_property
    def kernels(self) -> Kernels:
        """Return the compiled functions; from the cache on disk where they have been made before."""
        width = max(
            len(self.names) + 4 * MOST_PARAMETERS + self.sizes.states + MOST_STATES, self.affected,
            2 * len(self.places), MOST_COLUMNS,
        )  # fmt: skip
        links = {laws.SIGNATURE: laws.library(self.laws), **self.equations.by_signature(*SIGNATURES, PLACED)}

        def factories() -> dict[str, tuple[Any, ...]]:
            return {
                "run": (augmented.augmented_normal_equations, laws.LAW, "placed", "slopes", "sensed"),
                "respond": (responses.linear_responses, "slopes", "sensed"),
                "follow": (kalman.fixed_gain_filter, "rates", "sensed"),
                "smooth_backward": (kalman.backward_smoother,),
                "motions": (responses.places_along, "rates", "placed"),
                "along": (responses.law_along, laws.LAW),
                "read": (responses.readings_along, "sensed"),
            }

        return linked("augmented models", factories, links, (self.sizes.work_rows, width))

    @cached_property
    def latent(self) -> IntVector:
        """Return for each degree the index of its force in the parameter array."""
        return np.array([self.columns[0][i] for i in self.degree_places], dtype=np.int64)

    @cached_property
    def sizes(self) -> PortSizes:
        """Return the sizes of the rig with ports, as kernels read them."""
        twin = self._opened[0]
        return PortSizes(
            len(twin.state_names), len(self.coordinates), len(twin.sensors), *self.columns, twin.is_fed, MOST_STATES
        )

    def reading(self, theta: Array, state: Array, commands: Array | None = None) -> tuple[Array, Array]:
        """Return what the sensors read in a state (sensors,), and how that depends on it (sensors, states).

        Args:
            theta: parameters (k,).
            state: of the rig (states,).
            commands: of the actuators (actuators,); 0 where none are given.
        """
        read, by_state, _ = self._read(theta, state, commands)
        return read, by_state

    def direct(self, theta: Array) -> Array:
        """Return how readings depend at once on the affected entries of the parameter array, at rest (sensors, a)."""
        return self._read(theta, self.rest, None)[2]

    def _read(self, theta: Array, state: Array, commands: Array | None) -> tuple[Array, Array, Array]:
        sensors = len(self.twin.sensors)
        given = np.zeros(len(self.twin.actuators)) if commands is None else np.array(commands, dtype=float)
        p, _ = self.basis(theta)
        s, js, jps = np.zeros(sensors), np.zeros((sensors, len(state))), np.zeros((sensors, self.affected))
        self.equations.sensed(0.0, state, given, p, np.zeros(sensors), s, js, jps)
        return s, js, jps

    def instances(self, instances: Sequence[EffectInstance], theta: Array) -> Instances:
        """Return the tables of effect instances that kernels read.

        Args:
            instances: the effects.
            theta: their free parameters, one after the other (f,).
        """
        channels, used, states = len(self.twin.actuators), len(self.names), 0
        acts, late = np.zeros(len(self.places) + channels, dtype=np.int64), np.zeros(channels)
        late_columns = np.full(channels, -1)
        rows, columns, values = [], [], list[float]()
        for instance in instances:
            first, estimated = len(values), [-1] * MOST_PARAMETERS
            values += instance.values
            for j in instance.free:
                values[first + j] = float(theta[used - len(self.names)])
                estimated[j] = used
                used += 1
            if instance.effect == laws.DELAY:
                at = [self.twin.actuators.index(instance.at)] if instance.at else range(channels)
                for channel in at:
                    late[channel] += values[first]
                    late_columns[channel] = estimated[0]
                    acts[len(self.places) + channel] |= estimated[0] >= 0
                continue
            kind, place = INERTIA if instance.entry.is_inertia else KINDS[instance.where], self.index(instance)
            if kind != SENSOR:
                acts[place + len(self.places) * (kind == ACTUATOR)] = 1
            state = len(self.twin.state_names) + states if instance.entry.states else -1
            states += len(instance.entry.states)
            rows.append((self._number(instance), kind, place, first, state))
            columns.append(estimated)
        # Sensors last: they may read what the others do.
        order = sorted(range(len(rows)), key=lambda i: rows[i][1] == SENSOR)
        # Laws read as many parameters as they have from where theirs begin.
        read = np.array([*values, *np.zeros(MOST_PARAMETERS)])
        table = np.array([rows[i] for i in order], dtype=np.int64).reshape(-1, len(COLUMNS))
        found = np.array([columns[i] for i in order], dtype=np.int64).reshape(-1, MOST_PARAMETERS)
        return Instances(table, found, read, acts, late, late_columns, states)

    def along(self, instance: EffectInstance, x: Array, rate: Array, dt: float, by: Sequence[int] = ()) -> Array:
        """Return what an effect gives along a known motion, and its derivatives by some parameters (m, 1 + c).

        Args:
            instance: the effect with its values.
            x: displacement, command or reading that it acts on (m,).
            rate: of it (m,).
            dt: time between samples, s.
            by: indices of these parameters.
        """
        features = np.empty((len(x), 1 + len(by)))
        values = np.array([*instance.values, *np.zeros(MOST_PARAMETERS)])
        number, has_state = self._number(instance), bool(instance.entry.states)
        x, rate = np.ascontiguousarray(x), np.ascontiguousarray(rate)
        parameters = np.array([*by, 0], dtype=np.int64)  # of none, nothing is read
        self.kernels.along(len(x), dt, number, has_state, x, rate, parameters, values, features)
        return features

    def index(self, instance: EffectInstance) -> int:
        """Return the index of an instance's place among the places, sensors or actuators."""
        names = {"element": [p.name for p in self.places], "sensor": self.twin.sensors, "actuator": self.twin.actuators}
        return list(names[instance.where]).index(instance.at)

    def _number(self, instance: EffectInstance) -> int:
        """Return the number of an instance's effect among the laws."""
        return list(self.laws).index(instance.effect)


def _followed(lowered: LoweredTwin, places: Sequence[Place]) -> list[Node]:
    """Return the displacement of each place as a node; 0 where it has none."""
    equations, zero = lowered.equations.equations, lowered.graph.number(0.0)
    every = [place.element.displacement for place in places]
    return [zero if one is None else lowered.equations.lower(equations.symbolic(one)) for one in every]


def _rates(lowered: LoweredTwin, places: Sequence[Place], loads: Mapping[str, str]) -> list[Node]:
    """Return the rate of each place as a node: as declared, or by the chain rule from coordinates; 0 where unknown."""
    graph, equations = lowered.graph, lowered.equations.equations
    moving = len(equations.coordinates)
    velocities = [graph.symbol(loads[f"y[{moving + i}]"], varying=True) for i in range(moving)]
    positions = [graph.symbol(loads[f"y[{i}]"], varying=True) for i in range(moving)]
    found = []
    for place, row in zip(places, derivatives(graph, _followed(lowered, places), positions), strict=True):
        if place.element.rate is not None:
            found.append(lowered.equations.lower(equations.symbolic(place.element.rate)))
        elif place.has_rate:
            found.append(graph.total([graph.mul(by, v) for by, v in zip(row, velocities, strict=True)]))
        else:
            found.append(graph.number(0.0))
    return found


def _port(effect: Effect, at: str) -> EffectUse:
    return EffectUse(effect=effect.name, at=(at,), parameters=dict.fromkeys(effect.factors, 0.0))
