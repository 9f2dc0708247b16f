"""Trial equations: a rig with effects in the place of its ports, printed and compiled for this structure alone.

The rig with open ports is lowered once. Each combination of effects and places puts nodes of the laws where the ports
are, so that a derivative by a state or a parameter is one of the whole, and nothing is computed that is 0. Effects act
in this order: those of actuators on the commands, those of elements, those of sensors on the readings. Values of
parameters are no part of the structure.

An inertia is a force m a at a place, where a is the acceleration of its displacement. With q'' the accelerations of the
coordinates without it, b what a unit of force adds to them, and j the derivatives of the displacement by the
coordinates, a = j.q'' / (1 - m j.b), where j.b is negative. Several are solved for one after the other, each in the rig
with those before it. Displacements are linear, so that j is constant.
Source: Sherman and Morrison (1950), Ann. Math. Stat. 21(1), 124-127, for inertias.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from masking.compile.codegen import module_store
from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.tangent import copied, derivatives
from masking.compile.numerics.rig_sizes import RigSizes
from masking.control.rig.twin import LoweredTwin
from masking.inference.discovery import compiled_laws
from masking.inference.discovery.places import Place, followed, rates
from masking.inference.estimation.sensitivity import accumulation, with_derivatives
from masking.model.effects import Effect


@dataclass(frozen=True)
class Seated:
    """An effect at a place, as far as equations depend on it."""

    effect: Effect
    at: int  # number of its sensor or actuator; of an element, `laws` have the seats
    laws: tuple[tuple[Effect, int], ...]  # in an element: laws and the seats where they act
    reads: tuple[int, ...]  # places of its parameters among those of all effects: what is the same stands once

    def structure(self) -> list[object]:
        """All that compiled functions depend on."""
        return [self.effect.structure(), self.at, [[law.structure(), seat] for law, seat in self.laws], self.reads]


class Ported:
    """A rig with open ports as nodes of a graph: what effects at its seats follow, and where they act.

    Args:
        lowered: the rig with its ports.
        seats: places, and what may be taken from the motion of their elements.
        forces: index of the port of each seat in the parameter array.
    """

    def __init__(self, lowered: LoweredTwin, seats: Sequence[Place], forces: Sequence[int]) -> None:
        self.graph, self.loads, self.parameters = lowered.graph, lowered.loads, len(lowered.twin.values())
        self.coordinates = len(lowered.equations.equations.coordinates)
        by_text = {text: name for name, text in lowered.loads.items()}
        self.displacements, self.rates = followed(lowered, seats), rates(lowered, seats, by_text)
        self.moving, self.reading = ([x for _, x in part] for part in (lowered.derivatives, lowered.readings))
        named = {text: self.graph.symbol(name, varying=True) for text, name in by_text.items()}
        self.forces = [named[f"p[{entry}]"] for entry in forces]
        self.commands = [named[f"u[{i}]"] for i in range(len(lowered.twin.actuators))]
        self.places = [named[f"y[{i}]"] for i in range(self.coordinates)]


class TrialEquations:
    """Rates of the state and readings of a rig with effects, with their `loads`, as `LoweredTwin` has them.

    Internal states of the effects follow those of the rig in y, and their parameters follow those of the rig in p.
    """

    def __init__(self, ported: Ported, placed: Sequence[Seated]) -> None:
        self._ported, self.graph, self.loads = ported, Graph(), dict(ported.loads)
        base = ported.graph
        self._symbols = [node for node, one in enumerate(base.operations) if one[0] == "symbol"]
        # Simulated readings have no noise, and neither have the states of what follows them.
        self._given = {
            node: self.graph.number(0.0)
            if self.loads.get(str(base.operations[node][1]), "").startswith("noise")
            else self.graph.symbol(str(base.operations[node][1]), varying=base.varying[node])
            for node in self._symbols
        }
        self._states = len(ported.moving)
        self._changes = dict[Node, Node]()  # rates of the states of effects
        known = [self._symbols_of(one) for one in placed]
        pairs = [*zip(placed, known, strict=True)]
        for one, nodes in pairs:
            if one.effect.where == "actuator":
                command = ported.commands[one.at]
                self._given[command] = self._through(one.effect, {**nodes, "u": self._given[command]})
        moving = self._with_inertias(self._act([pair for pair in pairs if pair[0].effect.where == "element"]))
        read = self._moved(ported.reading)
        for one, nodes in pairs:
            if one.effect.where == "sensor":
                read[one.at] = self._through(one.effect, {**nodes, "s": read[one.at]})
        inner = [self._changes[nodes[name]] for one, nodes in pairs for name in one.effect.states]
        self.derivatives = [(f"dy[{i}]", node) for i, node in enumerate([*moving, *inner])]
        self.readings = [(f"s[{i}]", node) for i, node in enumerate(read)]

    def _symbols_of(self, one: Seated) -> dict[str, Node]:
        """Symbols of an effect: time, its states in y, and its parameters in p."""
        first, self._states = self._states, self._states + len(one.effect.states)
        at = [self._ported.parameters + place for place in one.reads]
        known = {"t": self.graph.symbol("t", varying=True)}
        known |= {name: self._read(f"y[{i}]", varying=True) for i, name in enumerate(one.effect.states, first)}
        known |= {x: self._read(f"p[{i}]", varying=False) for i, x in zip(at, one.effect.parameters, strict=True)}
        return known

    def _read(self, text: str, *, varying: bool) -> Node:
        name = f"trial_{text[0]}_{text[2:-1]}"
        self.loads[name] = text
        return self.graph.symbol(name, varying=varying)

    def _moved(self, nodes: Sequence[Node]) -> list[Node]:
        """Nodes of the rig under what acts."""
        given = [self._given[symbol] for symbol in self._symbols]
        return copied(self._ported.graph, nodes, self._symbols, self.graph, given)

    def _through(self, law: Effect, nodes: Mapping[str, Node]) -> Node:
        """Value of a law; the rates of its states are kept."""
        value, *changes = compiled_laws.lowered(self.graph, law, nodes)
        self._changes |= {nodes[name]: x for name, x in zip(law.states, changes, strict=True)}
        return value

    def _act(self, pairs: Sequence[tuple[Seated, Mapping[str, Node]]]) -> dict[int, Node]:
        """Put the forces of effects where the ports are; returns the inertia at each seat that has one."""
        ported, graph = self._ported, self.graph
        x, rate = self._moved(ported.displacements), self._moved(ported.rates)
        forces, inertias = dict[int, Node](), dict[int, Node]()
        for one, nodes in pairs:
            for law, seat in one.laws:
                found = inertias if law.is_inertia else forces
                motion = {"d": x[seat], "d_rate": rate[seat], "d_acc": graph.number(1.0)}
                value = self._through(law, {**nodes, **motion})
                found[seat] = graph.add(found[seat], value) if seat in found else value
        for seat, port in enumerate(ported.forces):
            self._given[port] = forces.get(seat, graph.number(0.0))
        return inertias

    def _with_inertias(self, inertias: Mapping[int, Node]) -> list[Node]:
        """Rates of the rig's states with inertias, whose forces are added to those at their ports."""
        ported, graph, n = self._ported, self.graph, self._ported.coordinates
        moving, before = self._moved(ported.moving), list[tuple[Node, list[Node], list[Node]]]()

        def along(followed: Sequence[Node], changing: Sequence[Node]) -> Node:
            return graph.total([graph.mul(by, x) for by, x in zip(followed, changing[n:], strict=False)])

        def drawn(share: Node, followed: Sequence[Node], pushed: Sequence[Node], changing: list[Node]) -> list[Node]:
            force = graph.mul(share, along(followed, changing))
            return [graph.add(x, graph.mul(by, force)) for x, by in zip(changing, pushed, strict=True)]

        unit, at = graph.symbol("unit", varying=True), [self._given[q] for q in ported.places]
        for seat in sorted(inertias):
            port = ported.forces[seat]
            followed = derivatives(graph, self._moved([ported.displacements[seat]]), at)[0]
            self._given[port] = graph.add(force := self._given[port], unit)
            pushed = [row[0] for row in derivatives(graph, self._moved(ported.moving), [unit])]
            self._given[port] = force
            for one in before:
                pushed = drawn(*one, pushed)
            itself = graph.mul(inertias[seat], along(followed, pushed))
            share = graph.div(inertias[seat], graph.sub(graph.number(1.0), itself))
            before.append((share, followed, pushed))
            moving = drawn(*before[-1], moving)
        for seat, (_, followed, _) in zip(sorted(inertias), before, strict=True):
            port = ported.forces[seat]
            self._given[port] = graph.add(self._given[port], graph.mul(inertias[seat], along(followed, moving)))
        return moving


@dataclass(frozen=True)
class Trial:
    """Compiled equations of a rig with effects.

    Derivatives are by the affected entries of the rig's parameters, by `free` ones of the effects, then by commands.
    """

    equations: Kernels
    free: Sequence[int]  # parameters of the effects that may be estimated, by their places among all
    states: int  # those of the effects included
    sizes: RigSizes
    widths: tuple[int, ...]  # of tables that kernels work with

    @classmethod
    def of(cls, ported: Ported, placed: Sequence[Seated], affected: Sequence[int], key: object) -> Trial:
        """Compile a rig, of which `key` holds all that compiled functions depend on; from the disk where they are."""
        free = [
            place
            for one in placed
            for place, name in zip(one.reads, one.effect.parameters, strict=True)
            if name in compiled_laws.estimable(one.effect)
        ]
        made_from = {"trial": key, "affected": [*affected], "placed": [one.structure() for one in placed]}

        def build() -> Module:
            made = TrialEquations(ported, placed)
            commands = [f"u[{i}]" for i in range(len(ported.commands))]
            columns = [*(f"p[{i}]" for i in affected), *(f"p[{ported.parameters + i}]" for i in free), *commands]
            depends, functions = with_derivatives(made, columns)
            module = Module("a rig with effects", {"kind": "trial", "depends": depends})
            for signature, results in functions.items():
                module.add(signature, made.graph, results, made.loads)
            return module

        states = len(ported.moving) + sum(len(one.effect.states) for one in placed)
        many = len(affected) + len(free) + len(ported.commands)
        sizes = RigSizes(states, ported.coordinates, len(ported.reading))
        equations = Kernels(module_store.load(module_store.key(made_from), build))
        return cls(equations, free, states, sizes, (many + states, sizes.added_rows))

    @cached_property
    def kernels(self) -> Kernels:
        """Normal equations, linked to the rig's."""
        return accumulation(self.equations, self.sizes, max(self.widths))
