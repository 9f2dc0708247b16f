"""Block D of masking: the accelerations that the virtual system has, and the rates of its internal states.

Source: Rijlaarsdam (2008), chapter 6, (6.2).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.tangent import along, copied
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.declaration import schema
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Wanted:
    """Nodes of D at one state: virtual accelerations (k,), and the rates of the virtual system's internal states.

    Of its delayed expressions, `lagged` is what they are now, and `delays` is by how long they are delayed; of its
    events, `conditions` are the conditions, and then the values that jump.
    """

    accelerations: list[Node]
    rates: list[Node]
    lagged: list[Node]
    delays: list[Node]
    conditions: list[Node]


@dataclass(frozen=True)
class DesiredDynamics:
    """D: the accelerations that the virtual system has at given virtual coordinates and velocities (6.2)."""

    virtual: Model  # the virtual system
    regulation: schema.Regulation | None = None  # what is held besides its dynamics, if anything

    def values(self) -> list[float]:
        """Parameters of the regulation: energy, rate, coupling; 0 for an energy that is not held."""
        wanted = self.regulation
        return [] if wanted is None else [wanted.energy or 0.0, wanted.rate, wanted.coupling]

    def lower(
        self,
        graph: Graph,
        time: Node,
        eta: Sequence[Node],
        rate: Sequence[Node],
        p: Sequence[Node],
        *,
        regulation: Sequence[Node] = (),
        memory: Sequence[Node] = (),
    ) -> Wanted:
        """Lower eta'' = F(tau, eta, eta', z), with the virtual system's inputs at zero, and its regulation.

        `regulation` is as `values` gives it; `memory` are internal states z of the virtual system, and then its delayed
        expressions. A ModelError where an energy is to be held, and the virtual system has none.
        """
        s = self.virtual.equations.symbols
        u = [graph.number(0.0)] * len(s.u)
        behind = (*s.s, *(lag.symbol for lag in self.virtual.equations.lags))
        known = dict(zip((s.t, *s.q, *s.v, *behind, *s.u, *s.p), (time, *eta, *rate, *memory, *u, *p), strict=True))
        lowered = LoweredEquations.of(self.virtual.equations, graph, known=known)
        wanted = list(lowered.accelerations)
        rest = (lowered.rates, lowered.lagged, lowered.delays, lowered.conditions)
        if self.regulation is None:
            return Wanted(wanted, *rest)
        energy, speed, coupling = regulation
        moving = self._moving
        if self.regulation.energy is not None:
            # Oscillators are damped where the energy is above the wanted one, and driven where it is below.
            held = self.virtual.equations.energy
            if held is None:
                raise ModelError(f"{self.virtual.name} has no energy to regulate: declare energy, or a lagrangian")
            excess = graph.sub(graph.div(lowered.lower(held), energy), graph.number(1.0))
            wanted = self.damped(graph, wanted, rate, graph.mul(speed, excess))
        if self.regulation.phase is not None:
            mean = graph.div(graph.total([rate[i] for i in moving]), graph.number(float(len(moving))))
            for i in moving:
                # In-phase motion is the mean, anti-phase motion of two what differs from it: the other is damped.
                unwanted = mean if self.regulation.phase == "anti" else graph.sub(rate[i], mean)
                wanted[i] = graph.sub(wanted[i], graph.mul(coupling, unwanted))
        return Wanted(wanted, *rest)

    def derivatives(
        self,
        graph: Graph,
        time: Node,
        jets: Sequence[Sequence[Node | None]],
        p: Sequence[Node],
        *,
        regulation: Sequence[Node] = (),
        memory: Sequence[Node] = (),
    ) -> list[list[Node]]:
        """Lower D and its total derivatives along the motion, those of each order (k,).

        `jets` are eta, its rate, and its further derivatives per unit of virtual time (orders, k); of those that the
        inputs change at once, which are None, the wanted ones are taken. All else is as of `lower`. A ModelError where
        the virtual system has delays: what they give has no known derivative.
        """
        if self.virtual.equations.lags:
            raise ModelError(
                f"{self.virtual.name} has delays: a rig whose inputs act through dynamics of their own needs the "
                "derivatives of the wanted accelerations; leave the delays out, or mask a rig whose inputs are forces"
            )
        own, known, found = Graph(), [list(row) for row in jets], list[list[Node]]()
        rest = (p, regulation, memory)
        symbols = [own.symbol(f"x_{i}", varying=True) for i in range(1 + sum(map(len, (*jets, *rest))))]
        left = iter(symbols)
        now = next(left)
        *moved, values, held, kept = ([next(left) for _ in part] for part in (*jets, *rest))
        wanted = self.lower(own, now, moved[0], moved[1], values, regulation=held, memory=kept)
        moving = {now: own.number(1.0), **dict(zip(kept, wanted.rates, strict=True))}
        moving |= {x: rate for row, rates in itertools.pairwise(moved) for x, rate in zip(row, rates, strict=True)}
        every, zero = wanted.accelerations, graph.number(0.0)
        for order in range(2, len(jets) + 1):
            given = (zero if x is None else x for row in known for x in row)  # of later ones, nothing is read
            found.append(copied(own, every, symbols, graph, [time, *given, *p, *regulation, *memory]))
            if order < len(jets):
                known[order] = [d if x is None else x for x, d in zip(known[order], found[-1], strict=True)]
                every = along(own, every, moving)
        return found

    @property
    def _moving(self) -> tuple[int, ...]:
        return tuple(self.virtual.coordinates.index(name) for name in self.virtual.oscillators)

    def damped(self, graph: Graph, wanted: Sequence[Node], rate: Sequence[Node], damping: Node) -> list[Node]:
        """Wanted accelerations (k,) with a damping of the oscillators, per unit of virtual time."""
        found = list(wanted)
        for i in self._moving:
            found[i] = graph.sub(wanted[i], graph.mul(damping, rate[i]))
        return found

    def momentum(
        self, graph: Graph, time: Node, eta: Sequence[Node], rate: Sequence[Node], p: Sequence[Node]
    ) -> list[Node]:
        """Lower dE/deta' of the virtual energy E (k,), 0 for what is no oscillator.

        A ModelError where the virtual system has no energy.
        """
        s, energy = self.virtual.equations.symbols, self.virtual.equations.energy
        if energy is None:
            raise ModelError(f"{self.virtual.name} has no energy to balance: declare energy, or a lagrangian")
        known = dict(zip((s.t, *s.q, *s.v, *s.p), (time, *eta, *rate, *p), strict=True))
        found = [graph.number(0.0)] * len(s.v)
        for i in self._moving:
            found[i] = graph.lower(sp.diff(energy, s.v[i]), known)
        return found
