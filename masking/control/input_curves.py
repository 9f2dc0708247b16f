"""Inputs that act nonlinearly: which value of an input does what a control law wants of it.

The law wants w = g(u), for the curve g of an input. On a branch, on which the curve rises or falls all the way, u is
found by bisection and then by Newton's method within the bracket, both of a fixed number of steps. Beyond an end of the
branch, u stays there, beyond the limit of the input; but beyond an end at 0, such as that of a magnet, which never
pushes, it is not a number, at which a run stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, TypeAlias

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.codegen.tangent import copied, derivatives
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.modelling.affine_equations import AffineEquations
from masking.model.modelling.model import Model

BISECTIONS, NEWTON_STEPS = 12, 5  # the bracket becomes 1/4096 of the branch; there a smooth curve is nearly a line
BEYOND = 2.0  # times its largest value: how far an input is solved for; what is beyond that value is cut off there
ROUNDING = 1e-9  # of what the ends of a branch give: by how much what is wanted may lie beyond an end at 0
TINY = 1e-290  # so that what is wanted, where it is not a number, gives none
LOOKS = 401  # points at which a curve is looked at, to find its branch
FLAT = 1e-9  # of what a curve gives: what rounding makes of a part of it that is flat

Known: TypeAlias = "Mapping[sp.Symbol, Node]"  # nodes of the symbols of a model; as text, so that sympy stays unloaded


class Branch(NamedTuple):
    """Part of the range of an input on which its curve rises or falls all the way, in SI units."""

    low: float
    high: float


@dataclass(frozen=True)
class InputCurve:
    """Curve g(u) of an input."""

    index: int  # of the input among those of the model
    input: sp.Symbol
    text: sp.Expr  # in symbols of the model

    @cached_property
    def _lowered(self) -> tuple[Graph, list[sp.Symbol], list[Node], Node]:
        """Graph of its own, its symbols, the input first, their nodes, and that of the curve."""
        graph, symbols = Graph(), [self.input, *sorted(self.text.free_symbols - {self.input}, key=str)]
        nodes = [graph.symbol(f"x_{i}", varying=True) for i in range(len(symbols))]
        return graph, symbols, nodes, graph.lower(self.text, dict(zip(symbols, nodes, strict=True)))

    def at(self, graph: Graph, known: Known, u: Node) -> tuple[Node, Node]:
        """Curve and its slope at an input, in a graph in which the other symbols are known."""
        own, symbols, nodes, value = self._lowered
        both = [value, *derivatives(own, [value], nodes[:1])[0]]
        curve, slope = copied(own, both, nodes, graph, [u, *(known[s] for s in symbols[1:])])
        return curve, slope

    def values(self, u: Array, known: Mapping[str, float]) -> Array:
        """Curve at some inputs (k,), for values of the other symbols by name."""
        own, symbols, nodes, value = self._lowered
        made = function_of(own, [value], {}, ARRAYS, "value", variables=nodes)
        with np.errstate(all="ignore"):
            (found,) = made([u, *(np.float64(known[s.name]) for s in symbols[1:])])
        return np.broadcast_to(np.asarray(found, dtype=float), u.shape)


@dataclass(frozen=True)
class InputCurves:
    """Curves of the inputs of a rig that act nonlinearly; of most rigs there are none."""

    model: Model  # of the rig, as declared

    @property
    def names(self) -> tuple[str, ...]:
        """Inputs that have one."""
        return tuple(self.model.kernels.meta["curved"])

    @cached_property
    def each(self) -> tuple[InputCurve, ...]:
        """Curves, in the order of `names`; a ModelError where an input has more than one."""
        of = AffineEquations(self.model.declaration).curves if self.names else {}
        return tuple(InputCurve(self.model.inputs.index(u.name), u, curve) for u, curve in of.items())

    @property
    def unsolved(self) -> str:
        """Cause of a command that is not a number, in words; '' where no input has a curve."""
        each = (
            f"no {one.input} gives what is wanted of {one.text}, which has one sign on its branch" for one in self.each
        )
        return ", or ".join(each)

    def forces(self, graph: Graph, known: Known, inputs: Sequence[Node]) -> list[Node]:
        """What inputs do (m,), in a graph in which the other symbols of the model are known."""
        found = list(inputs)
        for curve in self.each:
            found[curve.index], _ = curve.at(graph, known, inputs[curve.index])
        return found

    def solved(self, graph: Graph, known: Known, wanted: Sequence[Node], ends: Sequence[Node]) -> list[Node]:
        """Inputs (m,) that do what is wanted of them; `ends` are low and high of each branch."""
        found = list(wanted)
        for i, curve in enumerate(self.each):
            at = partial(curve.at, graph, known)
            found[curve.index] = _solved(graph, at, wanted[curve.index], ends[2 * i : 2 * i + 2])
        return found

    @cached_property
    def _start(self) -> dict[str, float]:
        """Values of the symbols of the model but for inputs, where it begins."""
        model = self.model
        first = [*model.first_place, *np.zeros(len(model.coordinates)), *model.first_internal]
        return {"t": 0.0, **dict(zip(model.state_names, first, strict=True)), **model.parameter_values()}

    def branches(self, largest: Array) -> tuple[Branch, ...]:
        """Branch of each curve up to `BEYOND` times the largest magnitude (m,) of its input, where the model begins.

        It is the whole range where the curve rises or falls all over it, else the half above 0, else that below. A
        ModelError where the curve turns within each.
        """
        return tuple(self._branch(curve, BEYOND * float(largest[curve.index])) for curve in self.each)

    def _branch(self, curve: InputCurve, most: float) -> Branch:
        for low, high in ((-most, most), (0.0, most), (-most, 0.0)):
            values = curve.values(np.linspace(low, high, LOOKS), self._start)
            steps, flat = np.diff(values), FLAT * np.ptp(values)
            if steps.any() and (np.all(steps >= -flat) or np.all(steps <= flat)):
                return Branch(low, high)
        u = curve.input
        raise ModelError(
            f"{self.model.name}: {curve.text} neither rises nor falls all the way from {u} = 0 to {most:g} or to "
            f"{-most:g} (SI), {BEYOND:g} times its limit: more than one {u} does the same; lower its limit to "
            "less than half of where the curve turns"
        )

    def per_unit(self, branches: Sequence[Branch]) -> Array:
        """Input per unit of what it does (m,): 1, and for a curve its mean up to the limit of the input."""
        found = np.ones(len(self.model.inputs))
        for curve, branch in zip(self.each, branches, strict=True):
            ends = np.array(branch) / BEYOND
            found[curve.index] = np.ptp(ends) / np.ptp(curve.values(ends, self._start))
        return found


def _solved(graph: Graph, at: Callable[[Node], tuple[Node, Node]], wanted: Node, ends: Sequence[Node]) -> Node:
    """Node u between two ends with g(u) = w, or that of them which comes nearest; not a number beyond one at 0."""
    number, sub, mul, apply = graph.number, graph.sub, graph.mul, graph.apply
    low, high = ends
    first, last = at(low)[0], at(high)[0]
    rises = apply("lt", first, last)
    below, above = (apply("where", rises, *pair) for pair in ((low, high), (high, low)))

    def middle() -> Node:
        return mul(number(0.5), graph.add(below, above))

    def bracketed(u: Node, value: Node) -> tuple[Node, Node]:
        is_over = apply("lt", wanted, value)
        return apply("where", is_over, below, u), apply("where", is_over, u, above)

    for _ in range(BISECTIONS):
        u = middle()
        below, above = bracketed(u, at(u)[0])
    u = middle()
    for _ in range(NEWTON_STEPS):
        value, slope = at(u)
        below, above = bracketed(u, value)
        is_flat = apply("le", mul(slope, slope), number(0.0))
        u = sub(u, graph.div(sub(value, wanted), apply("where", is_flat, number(1.0), slope)))
        u = apply("max", apply("min", below, above), apply("min", apply("max", below, above), u))
    # Beyond an end, u stays there, and is cut off at its limit; beyond an end at 0 there is none.
    span, zero = sub(last, first), number(0.0)
    beyond = apply("where", apply("lt", low, zero), sub(last, wanted), sub(wanted, first))
    inside = mul(span, apply("where", apply("lt", mul(low, high), zero), span, beyond))
    rounding = graph.add(mul(number(ROUNDING), mul(span, span)), mul(number(TINY), mul(wanted, wanted)))
    real = apply("sqrt", graph.add(inside, rounding))  # of a negative number, which is none
    return mul(u, graph.div(real, real))
