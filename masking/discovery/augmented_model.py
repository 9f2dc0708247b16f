"""Open rig: a twin whose places are open, so that any effect can be put anywhere in it without compiling anew.

A force port at each place and an offset in front of each actuator are compiled in; effects are laws of their own, which
drive these ports while the rig is simulated, together with the derivatives by all parameters.
Source: as `masking.estimation.sensitivity`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from masking.codegen import store
from masking.codegen.graph import Node
from masking.codegen.kernels import Kernels
from masking.codegen.source import Module
from masking.codegen.tangent import derivatives
from masking.declaration.dictionary import MOST_PARAMETERS
from masking.declaration.expression import Expression
from masking.declaration.schema import EffectUse
from masking.discovery import laws, steps
from masking.discovery.places import Place, degrees, identifier, opened
from masking.effects import EFFECTS, FORCE, OFFSET, Effect
from masking.estimation.sensitivity import Sensitivity
from masking.numerics.arrays import Array
from masking.rig.twin import LoweredTwin, Twin

NEARLY_ZERO = 1e-200  # the first state of an effect: powers of it have derivatives
MOST_STATES = 6  # of effects together
MOST_COLUMNS = 96  # features that are spread at once
WHERE = {"element": steps.ELEMENT, "actuator": steps.ACTUATOR, "sensor": steps.SENSOR}


@dataclass(frozen=True)
class Slot:
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

    def with_values(self, at: Sequence[int], values: Iterable[float]) -> Slot:
        """Return the slot with other values of some of its parameters."""
        made = list(self.values)
        for i, value in zip(at, values, strict=True):
            made[i] = float(value)
        return replace(self, values=tuple(made))

    def with_free_times(self, factor: float) -> Slot:
        """Return the slot with its estimated parameters multiplied."""
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
        every = ("tau",) if self.effect == laws.DELAY else tuple(self.entry.parameters)
        return tuple(every[i] for i in self.free)


@dataclass(frozen=True)
class Equations:
    """What a record tells: J^T W J (w, w), J^T W r (w,), squared residuals (sensors,), and what is simulated.

    Columns: parameters of the rig, free parameters of the slots, where their states begin, then what each window may
    begin with, as `Twin.free` has it.
    """

    matrix: Array
    gradient: Array
    squares: Array
    simulated: Array


@dataclass(frozen=True)
class OpenRig:
    """A twin with open places.

    Args:
        twin: the rig as it is believed to be.
        names: its parameters that may be adjusted.
    """

    twin: Twin
    names: tuple[str, ...]

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
        return laws.known(self.twin.dictionary)

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
        """Return the number of states that a window of a record may begin with at any value."""
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
    def kernels(self) -> Kernels:
        """Return the compiled functions; from the cache on disk where they have been made before."""
        twin, _ = self._opened
        texts = [effect.structure() for effect in self.laws.values()]
        made_from = {
            "discovery": twin.structure(), "affected": list(self._sensitivity.affected), "laws": texts,
            "steps": [steps.FLOW, steps.RUN, *steps.OTHERS],
            "columns": self.columns, "forces": self.degree_places, "free": self.twin.free,
        }  # fmt: skip
        return Kernels(store.load(store.key(made_from), self._build))

    def _build(self) -> Module:
        twin, found = self._opened
        module = Module(f"{twin.declaration.name}, open", {"kind": "discovery", **twin.state_kinds})
        lowered = LoweredTwin(twin)
        graph, loads = lowered.graph, lowered.loads
        by_text = {text: name for name, text in loads.items()}
        n, moving = len(twin.state_names), len(self.coordinates)
        at = [i for i in range(n) if f"y[{i}]" in by_text]
        y = [graph.symbol(by_text[f"y[{i}]"], varying=True) for i in at]
        affected = self._sensitivity.affected
        p = [graph.symbol(by_text.get(f"p[{i}]", f"unused_{i}"), varying=False) for i in affected]

        def jacobian(name: str, nodes: list[int], symbols: list[int], columns: Sequence[int]) -> list[tuple[str, int]]:
            rows = derivatives(graph, nodes, symbols)
            return [
                (f"{name}[{i}, {c}]", node) for i, row in enumerate(rows) for c, node in zip(columns, row, strict=True)
            ]

        rates, readings = [x for _, x in lowered.derivatives], [x for _, x in lowered.readings]
        every = range(len(p))
        results = [*lowered.derivatives, *jacobian("jy", rates, y, at), *jacobian("jp", rates, p, every)]
        module.add("slopes(t, y, u, p, dy, jy, jp)", graph, results, loads)
        results = [*lowered.readings, *jacobian("jy", readings, y, at), *jacobian("jp", readings, p, every)]
        module.add("sensed(t, y, u, p, noise, s, jy, jp)", graph, results, loads)
        direct = [node for row in derivatives(graph, readings, p) for node in row if not graph.is_number(node, 0.0)]
        nodes = [*_followed(lowered, found), *_rates(lowered, found, by_text)]
        results = [(f"d[{i}]", node) for i, node in enumerate(nodes)]
        module.add("placed(t, y, u, p, d, jy)", graph, [*results, *jacobian("jy", nodes, y, at)], loads)
        module.functions.append(laws.text(self.laws))
        force_p, force_column, command_column = self.columns
        none = (0,)  # of none, nothing is read
        many = {
            "n": n, "moving": moving, "forces": len(self.degrees), "places": len(found),
            "channels": len(twin.actuators), "sensors": len(twin.sensors), "affected": len(affected),
            "force_p": force_p or none, "force_column": force_column or none, "command_column": command_column or none,
            "degree_ports": tuple(force_p[i] for i in self.degree_places) or none,
            "begins": self.begins, "free": twin.free or none,
            "is_free": tuple(int(i in twin.free) for i in range(n)) or none,
            "fed": int(twin.is_fed), "direct": int(bool(direct)),
        }  # fmt: skip
        size = n + MOST_STATES
        width = max(len(self.names) + 4 * MOST_PARAMETERS + size, len(affected), MOST_COLUMNS)
        rows = 12 * size + 12 * len(found) + 16 * len(readings) + 6 * len(twin.actuators) + 60
        module.add_kernel(steps.FLOW.format(**many) + steps.RUN.format(**many), "i", (rows, width))
        for text in steps.OTHERS:
            result, work = ("i" if text is steps.FOLLOW else ""), (None if text is steps.BACK else (rows, width))
            module.add_kernel(text.format(**many), result, work)
        return module

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
        self.kernels.sensed(0.0, state, given, p, np.zeros(sensors), s, js, jps)
        return s, js, jps

    def slots(self, slots: Sequence[Slot], theta: Array) -> tuple[Array, Array, Array, int]:
        """Return the tables of slots and columns, their parameters, and how many states they have.

        Args:
            slots: the effects.
            theta: their free parameters, one after the other (f,).
        """
        table, columns = np.zeros((len(slots), 5)), np.full((len(slots), MOST_PARAMETERS), -1.0)
        values: list[float] = []
        used, states = 0, 0
        n, k = len(self.twin.state_names), len(self.names)
        for i, slot in enumerate(slots):
            first = len(values)
            values += slot.values
            for j in slot.free:
                values[first + j] = float(theta[used])
                columns[i, j] = k + used
                used += 1
            if slot.effect == laws.DELAY:
                at = self.twin.actuators.index(slot.at) if slot.at else -1
                table[i] = -1, steps.ACTUATOR, at, first, -1
                continue
            kind = steps.INERTIA if slot.entry.is_inertia else WHERE[slot.where]
            table[i] = self._number(slot), kind, self.index(slot), first, -1
            if slot.entry.states:
                table[i, 4] = n + states
                states += 1
        # Laws read as many parameters as they have from where theirs begin.
        return table, columns, np.array([*values, *np.zeros(MOST_PARAMETERS)]), states

    def along(self, slot: Slot, x: Array, rate: Array, dt: float, by: Sequence[int] = ()) -> Array:
        """Return what an effect gives along a known motion, and its derivatives by some parameters (m, 1 + c).

        Args:
            slot: the effect with its values.
            x: displacement, command or reading that it acts on (m,).
            rate: of it (m,).
            dt: time between samples, s.
            by: indices of these parameters.
        """
        features = np.empty((len(x), 1 + len(by)))
        theta = np.array([*slot.values, *np.zeros(MOST_PARAMETERS)])
        columns = np.array([[*by]], dtype=float) if by else np.zeros((1, 1))
        kind, states = self._number(slot), len(slot.entry.states)
        x, rate = np.ascontiguousarray(x), np.ascontiguousarray(rate)
        self.kernels.along(len(x), dt, kind, states, x, rate, columns, theta, features)
        return features

    def index(self, slot: Slot) -> int:
        """Return the index of a slot's place among the places, sensors or actuators."""
        names = {"element": [p.name for p in self.places], "sensor": self.twin.sensors, "actuator": self.twin.actuators}
        return list(names[slot.where]).index(slot.at)

    def _number(self, slot: Slot) -> int:
        """Return the number of a slot's effect among the laws."""
        return list(self.laws).index(slot.effect)


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
