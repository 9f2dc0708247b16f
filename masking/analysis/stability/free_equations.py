"""Free equations: the motion of a model without inputs, in exact symbols, derivatives along it, and where it jumps."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import sympy as sp

from masking.analysis.stability.algebra import is_zero, normal
from masking.analysis.stability.hypotheses import Hypotheses
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.intervals import Interval
from masking.errors import ModelError
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Motion:
    """M(q) a = f(q, v) without inputs, and the energy V(q, v), in the symbols of hypotheses.

    Raises:
        ModelError: the model has internal states, or its equations or energy hold the time.
    """

    model: Model
    given: Hypotheses

    def __post_init__(self) -> None:
        e = self.model.equations
        self.model.check_ordinary("a certificate")
        if self.model.states:
            raise ModelError(f"{self.model.name} has internal states, for which there is no certificate")
        if not self.model.is_autonomous:
            raise ModelError(
                f"the equations of {self.model.name} hold the time, for which there is no certificate; declare what "
                "acts from outside, such as a drive, under 'inputs:'"
            )
        if e.energy is not None and e.symbols.t in e.energy.free_symbols:
            raise ModelError(
                f"the energy of {self.model.name}, {e.energy}, holds the time t, for which there is no certificate; "
                "declare 'energy:' as a function of coordinates and velocities alone"
            )

    @property
    def q(self) -> tuple[sp.Symbol, ...]:
        """Coordinates."""
        return self.model.equations.symbols.q

    @property
    def v(self) -> tuple[sp.Symbol, ...]:
        """Velocities."""
        return self.model.equations.symbols.v

    def _free(self, expression: sp.Expr) -> sp.Expr:
        return self.given.of(expression.subs(dict.fromkeys(self.model.equations.symbols.u, 0)))

    @cached_property
    def mass(self) -> sp.Matrix:
        """M (n, n)."""
        return self.model.equations.mass.applyfunc(self._free)

    @cached_property
    def force(self) -> sp.Matrix:
        """F (n, 1)."""
        return self.model.equations.force.applyfunc(self._free)

    @cached_property
    def at_rest(self) -> tuple[sp.Expr, ...]:
        """F(q, 0), which vanishes at equilibria; a ModelError where it jumps, so that these are not its zeros alone."""
        check_continuous(self.force)
        return tuple(normal(f.subs(dict.fromkeys(self.v, 0))) for f in self.force)

    @cached_property
    def accelerations(self) -> tuple[sp.Expr, ...]:
        """Accelerations, explicitly."""
        return tuple(self._free(a) for a in self.model.equations.accelerations)

    @cached_property
    def energy(self) -> sp.Expr | None:
        """V; None where the model has none."""
        found = self.model.equations.energy
        return None if found is None else self._free(found)

    @cached_property
    def energy_rate(self) -> sp.Expr:
        """V' = dV/dq v + dV/dv a along the motion, in normal form; a ModelError where the model has no energy."""
        if self.energy is None:
            raise ModelError(f"{self.model.name} declares no energy; declare one, such as 'energy: x1'**2/2 + ...'")
        rate = sum(sp.diff(self.energy, q) * v for q, v in zip(self.q, self.v, strict=True))
        rate += sum(sp.diff(self.energy, v) * a for v, a in zip(self.v, self.accelerations, strict=True))
        return normal(without_kinks(rate))

    def on(self, graph: Graph, state: Sequence[sp.Symbol]) -> tuple[dict[sp.Symbol, Node], dict[Node, float]]:
        """Nodes of a graph for coordinates and velocities, first, and parameters, and the declared values."""
        nodes = {x: graph.symbol(f"x_{x.name}", varying=True) for x in state}
        values: dict[Node, float] = {}
        for name, symbol in self.given.symbols.items():
            if not symbol.is_number:
                nodes[symbol] = graph.symbol(f"p_{symbol}", varying=False)
                values[nodes[symbol]] = self.given.values[name]
        return nodes, values

    def enclosed(self, nodes: Mapping[sp.Symbol, Node]) -> dict[Node, Interval]:
        """Intervals that hold the exact declared values of parameters, by node."""
        symbols = self.given.symbols.items()
        return {nodes[s]: Interval.around(self.given.exact[name]) for name, s in symbols if not s.is_number}

    @cached_property
    def circles(self) -> tuple[sp.Symbol, ...]:
        """Coordinates that are angles: V and the equations do not change over one turn of them.

        A coordinate that they do not hold may be one in rad; else it is a length that goes on for ever.
        """
        found, every = [], (*self.mass, *self.force, self.energy or sp.Integer(0))
        for q in self.q:
            is_held = any(q in e.free_symbols for e in every)
            is_angle = is_held or self.model.declaration.coordinates[q.name].unit == "rad"
            if is_angle and all(is_zero(e.subs(q, q + 2 * sp.pi) - e) for e in every):
                found.append(q)
        return tuple(found)

    @cached_property
    def is_linear(self) -> bool:
        """Whether M is constant and f linear in q and v."""
        state = (*self.q, *self.v)
        if self.mass.free_symbols & {*state}:
            return False
        return all(
            f.is_polynomial(*state) and all(sum(powers) == 1 for powers in sp.Poly(f, *state).monoms() if f != 0)
            for f in (sp.expand(f) for f in self.force)
            if f != 0
        )


def without_kinks(expression: sp.Expr) -> sp.Expr:
    """Expression in which steps cancel, as those of max(u, 0) and its slope do; as it is where they do not.

    Steps H(u), which are 0 or 1, stand for all: |u| = u (2 H - 1), sign(u) = 2 H - 1, max(u, w) = w + (u - w) H(u - w).
    At u = 0 the expression is taken to be continuous.
    """
    if not expression.has(sp.Max, sp.Min, sp.Abs, sp.sign, sp.Heaviside):
        return expression
    steps = dict[sp.Expr, sp.Symbol]()

    def step(u: sp.Expr) -> sp.Expr:
        u = sp.factor_terms(u)
        if u.could_extract_minus_sign():
            return 1 - step(-u)
        return steps.setdefault(u, sp.Dummy("h", real=True))

    def larger(u: sp.Expr, w: sp.Expr, sign: int) -> sp.Expr:
        return w + (u - w) * step(sign * (u - w))

    plain = expression.replace(sp.Max, lambda *x: functools.reduce(lambda u, w: larger(u, w, 1), x))
    plain = plain.replace(sp.Min, lambda *x: functools.reduce(lambda u, w: larger(u, w, -1), x))
    plain = plain.replace(sp.Abs, lambda u: u * (2 * step(u) - 1)).replace(sp.sign, lambda u: 2 * step(u) - 1)
    plain = sp.expand(plain.replace(sp.Heaviside, lambda u, *_: step(u)))
    for h in steps.values():
        plain = sp.expand(plain.replace(lambda x, h=h: x.is_Pow and x.base == h and x.exp.is_Integer, lambda x: x.base))
    return expression if plain.free_symbols & {*steps.values()} else plain


def check_continuous(forces: Iterable[sp.Expr]) -> None:
    """Raise a ModelError for forces that jump: where dry friction holds, every place within reach is an equilibrium."""
    edges = dict.fromkeys(edge for force in forces for edge in jumps(force))
    if edges:
        raise ModelError(f"the forces jump where {' or '.join(edges)}, so that equilibria are more than their zeros")


def jumps(expression: sp.Expr) -> list[str]:
    """Edges, as texts such as x' = 0, at which an expression is not shown to be continuous."""
    found = [f"{f} is a whole number" for f in expression.atoms(sp.floor, sp.ceiling)]
    for step in expression.atoms(sp.sign, sp.Heaviside):
        below = sp.Integer(-1 if step.func == sp.sign else 0)
        if not _agree(expression.xreplace({step: sp.Integer(1)}), expression.xreplace({step: below}), step.args[0]):
            found.append(f"{step.args[0]} = 0")
    for piece in expression.atoms(sp.Piecewise):
        found += map(str, jumps_of(piece))
    return sorted(found)


def jumps_of(piece: sp.Piecewise) -> Iterator[sp.Expr]:
    """Yield the conditions of a function in pieces at whose edge two of them are not shown to agree."""
    for (value, condition), (other, _) in itertools.pairwise(piece.args):
        is_edge = isinstance(condition, sp.core.relational.Relational)
        if not (is_edge and _agree(value, other, condition.lhs - condition.rhs)):
            yield condition


def _agree(value: sp.Expr, other: sp.Expr, edge: sp.Expr) -> bool:
    """Whether two expressions agree where a third is 0, solved for a symbol in which it is linear."""
    edge = sp.expand(edge)
    for symbol in sorted(edge.free_symbols, key=str):
        slope = edge.diff(symbol)
        if slope.is_number and slope != 0:
            return is_zero((value - other).subs(symbol, symbol - edge / slope))
    return False
