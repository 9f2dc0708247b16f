"""The four blocks of masking: T maps coordinates, D computes wanted accelerations, L cancels, G scales.

Each block lowers itself into a graph, from which `controller` prints one control law. Rig coordinates enter
measured in the rig's scales where both systems are dimensionless, in SI units otherwise.

Source: Rijlaarsdam (2008), chapter 6, (6.1)-(6.3).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.linear_systems import health, solve
from masking.compile.codegen.tangent import along, copied
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.declaration import driven_coordinates, schema
from masking.model.modelling.gradient import jacobian, rate
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model

# What to do about a matrix W = J B that becomes singular on the way.
INVERTIBLE = "choose a transform that is invertible, and that the actuators can follow, over the whole motion"


@dataclass(frozen=True)
class Transform:
    """T: virtual coordinates as smooth functions of rig coordinates."""

    rig: Model  # the model of the rig
    virtual: Model  # the model whose coordinates are computed
    declaration: schema.Transform  # identity, a matrix, or one expression for each virtual coordinate

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the transform's own parameters."""
        return tuple(self.declaration.parameters)

    @cached_property
    def parameter_symbols(self) -> tuple[sp.Symbol, ...]:
        """Symbols of the transform's own parameters."""
        return tuple(sp.Symbol(name, real=True) for name in self.parameters)

    @cached_property
    def expressions(self) -> sp.ImmutableMatrix:
        """Eta = T(q) as a column (k, 1) in the rig's coordinate symbols.

        A ModelError where the identity finds neither the names of the virtual coordinates in the rig nor as many.
        """
        q = self.rig.equations.symbols.q
        matrix, expressions = self.declaration.matrix, self.declaration.expressions
        if matrix is None and expressions is None:
            return sp.ImmutableMatrix([q[i] for i in self._selected])
        known = {s.name: s for s in (*q, *self.parameter_symbols)}
        if expressions is not None:
            return sp.ImmutableMatrix([expressions[c].to_sympy(known) for c in self.virtual.coordinates])
        rows = [[e.to_sympy(known) for e in row] for row in matrix or ()]
        return sp.ImmutableMatrix(sp.Matrix(rows) * sp.Matrix(q))

    @property
    def _selected(self) -> tuple[int, ...]:
        """Indices of the rig coordinates that the identity takes."""
        chosen = driven_coordinates.selected(self.rig.coordinates, self.virtual.coordinates)
        if chosen is None:
            raise ModelError(
                "transform: identity takes rig coordinates by the names of the virtual ones, or all in order; "
                f"{self.virtual.name} has {', '.join(self.virtual.coordinates)}, {self.rig.name} has "
                f"{', '.join(self.rig.coordinates)}; declare a matrix or expressions"
            )
        return chosen

    def slope(self, parameters: Mapping[str, float]) -> Array:
        """J at zero coordinates (k, n), for values of T's own parameters; without sympy where T is linear."""
        matrix, expressions = self.declaration.matrix, self.declaration.expressions
        if expressions is not None:
            known = dict.fromkeys(self.rig.equations.symbols.q, 0)
            known |= {symbol: parameters[symbol.name] for symbol in self.parameter_symbols}
            return np.array(self.jacobian.subs(known).evalf().tolist(), dtype=float)
        if matrix is None:
            return np.eye(len(self.rig.coordinates))[list(self._selected)]
        return np.array([[entry.evaluate(parameters) for entry in row] for row in matrix], dtype=float)

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """Indices of the n - k rig coordinates that no virtual one stands for.

        They are those that the transform does not name, and of those that it names the last ones that are needed.
        """
        coordinates, virtual = self.rig.coordinates, self.virtual.coordinates
        names = driven_coordinates.passive(self.declaration, coordinates, virtual)
        return tuple(i for i, name in enumerate(coordinates) if name in names)

    @cached_property
    def jacobian(self) -> sp.ImmutableMatrix:
        """J = dT/dq (k, n)."""
        return sp.ImmutableMatrix(jacobian(self.expressions, self.rig.equations.symbols.q))

    @cached_property
    def bias(self) -> sp.ImmutableMatrix:
        """(dJ/dt) v (k, 1), the virtual acceleration at zero rig acceleration."""
        s, slopes = self.rig.equations.symbols, self.jacobian.tolist()
        rows = [sp.Add(*(rate(j, s.q, s.v) * v for j, v in zip(row, s.v, strict=True) if j != 0)) for row in slopes]
        return sp.ImmutableMatrix(len(rows), 1, rows)

    def lower(self, graph: Graph, q: Sequence[Node], v: Sequence[Node], p: Sequence[Node]) -> MappedCoordinates:
        """Lower eta, its rate, J and (dJ/dt) v for given nodes of rig coordinates, velocities and parameters."""
        s = self.rig.equations.symbols
        known = dict(zip((*s.q, *s.v, *self.parameter_symbols), (*q, *v, *p), strict=True))
        jacobian, eta = graph.rows(self.jacobian, known), graph.lowered(self.expressions, known)
        moving = [dot(graph, row, v) for row in jacobian]
        return MappedCoordinates(eta, moving, jacobian, graph.lowered(self.bias, known))


@dataclass(frozen=True)
class MappedCoordinates:
    """Nodes of T at one state: eta (k,), d eta/dt (k,), J (k, n) and (dJ/dt) v (k,)."""

    eta: list[Node]
    rate: list[Node]
    jacobian: list[list[Node]]
    bias: list[Node]


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


@dataclass(frozen=True)
class Cancellation:
    """L and G from one model of the rig: the input that cancels its dynamics, and that which accelerates it.

    The rig is a = a0(t, q, v) + B(t, q) u. L solves B L = -a0 (6.1), and G is the inverse of B (6.3).
    """

    model: Model  # affine in its inputs

    def lower(
        self, graph: Graph, time: Node, q: Sequence[Node], v: Sequence[Node], p: Sequence[Node]
    ) -> tuple[list[Node], list[list[Node]], Node]:
        """Lower a0 (n,), B (n, k) and the health of the mass matrix; `v` holds the internal states at its end."""
        s = self.model.equations.symbols
        known = dict(zip((s.t, *s.q, *s.v, *s.s, *s.p), (time, *q, *v, *p), strict=True))
        free = self.model.equations.force.xreplace(dict.fromkeys(s.u, sp.Integer(0)))
        entries = graph.rows(free.row_join(self.model.equations.input_force), known)
        solution, divisors = solve(graph, graph.rows(self.model.equations.mass, known), entries)
        return [row[0] for row in solution], [row[1:] for row in solution], health(graph, divisors)


def decouple(
    graph: Graph, matrix: list[list[Node]], cancel: Sequence[Node], drive: Sequence[Node]
) -> tuple[list[Node], list[Node], Node]:
    """Inputs that give two virtual accelerations, and the health of what had to be inverted.

    Solves W u = r, with W (k, inputs), for r = `cancel` and r = `drive` (k,); where there are more inputs than
    coordinates, u is the solution of least norm, u = W^T (W W^T)^-1 r.
    """
    right = [[c, d] for c, d in zip(cancel, drive, strict=True)]
    inputs = len(matrix[0])
    if inputs == len(matrix):
        solution, divisors = solve(graph, matrix, right)
    else:
        square = [[dot(graph, a, b) for b in matrix] for a in matrix]
        part, divisors = solve(graph, square, right)
        columns = [[row[i] for row in matrix] for i in range(inputs)]
        solution = [[dot(graph, column, [z[k] for z in part]) for k in (0, 1)] for column in columns]
    return [x[0] for x in solution], [x[1] for x in solution], health(graph, divisors)


def product(graph: Graph, a: Sequence[Sequence[Node]], b: Sequence[Sequence[Node]]) -> list[list[Node]]:
    """Nodes of the product of two matrices of nodes, without work for zeros of the first."""
    found = []
    for row in a:
        filled = [(x, other) for x, other in zip(row, b, strict=True) if not graph.is_number(x, 0.0)]
        found.append([graph.total([graph.mul(x, other[j]) for x, other in filled]) for j in range(len(b[0]))])
    return found


def dot(graph: Graph, a: Sequence[Node], b: Sequence[Node]) -> Node:
    """Node of the scalar product of two rows of nodes."""
    return graph.total([graph.mul(x, y) for x, y in zip(a, b, strict=True)])
