"""Expressions as one graph of elementary operations, each computed once.

A `Graph` is a list of nodes in the order in which they can be computed. A node is an operation and the
indices of its arguments; two equal nodes are the same node, so common sub-expressions are shared by
construction. Every printer (numba, C, Taylor coefficients) walks this one list.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial, partialmethod, reduce
from typing import Any

from masking.errors import ModelError
from masking.lazy_imports import sympy as sp

Node = int

NOT_ANALYTIC = ("abs", "sign", "min", "max", "heaviside", "where", "lt", "le", "atan2", "floor")


@dataclass
class Graph:
    """Operations in computable order: `operations[i]` is `(name, *arguments)`.

    Arguments are indices of earlier nodes, except for `("number", value)` and `("symbol", name)`.
    `varying` holds, for each node, whether it can change during a run (it depends on time, state or
    input); nodes that depend on parameters alone do not vary.
    """

    operations: list[tuple[str | float | int, ...]] = field(default_factory=list)
    varying: list[bool] = field(default_factory=list)
    _index: dict[tuple[str | float | int, ...], Node] = field(default_factory=dict)

    def symbol(self, name: str, *, varying: bool) -> Node:
        """Node of a symbol; `name` is the text that stands for it in printed code."""
        return self._node(("symbol", name), varying)

    def number(self, value: float) -> Node:
        """Node of a constant; raises a `ModelError` if it is not finite."""
        if not math.isfinite(value):
            raise ModelError(f"the equations contain the constant {value}; constants must be finite")
        return self._node(("number", float(value)), False)

    def is_number(self, node: Node, value: float | None = None) -> bool:
        """Whether a node is a constant (equal to `value`, if given)."""
        operation = self.operations[node]
        return operation[0] == "number" and (value is None or operation[1] == value)

    def varies(self, node: Node) -> bool:
        """Whether a node can change during a run."""
        return self.varying[node]

    def apply(self, name: str, *arguments: Node) -> Node:
        """Node of an operation on nodes, simplified where an argument is 0, 1 or a constant."""
        simpler = self._simplify(name, arguments)
        if simpler is not None:
            return simpler
        if name in {"add", "mul"}:
            arguments = tuple(sorted(arguments))
        return self._node((name, *arguments), any(self.varying[a] for a in arguments))

    add, sub = partialmethod(apply, "add"), partialmethod(apply, "sub")
    mul, div = partialmethod(apply, "mul"), partialmethod(apply, "div")

    def total(self, terms: Sequence[Node]) -> Node:
        """Sum of nodes; zero for none."""
        return reduce(self.add, terms, self.number(0.0))

    def lower(self, expression: sp.Expr, symbols: Mapping[sp.Symbol, Node]) -> Node:
        """Node of a sympy expression, given nodes of its symbols; a `ModelError` names what cannot be compiled."""
        return self.lowered([expression], symbols)[0]

    def lowered(self, expressions: Iterable[sp.Expr], symbols: Mapping[sp.Symbol, Node]) -> list[Node]:
        """Node of each expression, as `lower`, in one walk."""
        return [*map(_Lowering(self, symbols).node, expressions)]

    def rows(self, matrix: sp.Matrix, symbols: Mapping[sp.Symbol, Node]) -> list[list[Node]]:
        """Nodes of the entries of a matrix, as `lowered`: most entries of a large one are the same."""
        entries, width = self.lowered(matrix.flat(), symbols), matrix.cols
        return [entries[width * i : width * (i + 1)] for i in range(matrix.rows)]

    def _node(self, operation: tuple[str | float | int, ...], varying: bool) -> Node:
        node = self._index.get(operation)
        if node is None:
            node = len(self.operations)
            self.operations.append(operation)
            self.varying.append(varying)
            self._index[operation] = node
        return node

    def inner(self, node: Node) -> Node:
        """Argument of an operation on one argument."""
        return int(self.operations[node][1])

    def is_negative(self, node: Node) -> bool:
        """Whether a node is the negative of another."""
        return self.operations[node][0] == "neg"

    def without_constants(self, node: Node) -> tuple[Node, list[Node]]:
        """Node without the factors that do not vary and without its sign, and these factors."""
        factors = list[Node]()
        while True:
            name, *given = self.operations[node]
            fixed = [int(a) for a in given if not self.varies(int(a))] if name in {"mul", "div"} else []
            if name == "mul" and len(fixed) == 1:
                factors += fixed
                node = int(given[1]) if given[0] == fixed[0] else int(given[0])
            elif name == "neg" or (name == "div" and fixed == given[1:]):
                node = int(given[0])
            else:
                return node, factors

    def _simplify(self, name: str, arguments: tuple[Node, ...]) -> Node | None:
        if name in FOLDED and all(self.is_number(a) for a in arguments):
            values = [float(self.operations[a][1]) for a in arguments]
            return None if name == "div" and values[1] == 0.0 else self.number(FOLDED[name](*values))
        for holds, simpler in RULES.get(name, ()):
            if holds(self, *arguments):
                return simpler(self, *arguments)
        return None


# Operations on constants that are done at once.
FOLDED: dict[str, Callable[..., float]] = {
    "neg": operator.neg,
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
}
# What an operation is where something holds of its arguments; the first that holds counts.
RULES: dict[str, tuple[tuple[Callable[..., bool], Callable[..., Node]], ...]] = {
    "neg": ((lambda g, a: g.is_negative(a), lambda g, a: g.inner(a)),),  # -(-a) = a
    "add": (
        (lambda g, a, b: g.is_number(a, 0.0), lambda g, a, b: b),  # 0 + b = b
        (lambda g, a, b: g.is_number(b, 0.0), lambda g, a, b: a),  # a + 0 = a
        (lambda g, a, b: g.is_negative(b), lambda g, a, b: g.sub(a, g.inner(b))),  # a + -b = a - b
        (lambda g, a, b: g.is_negative(a), lambda g, a, b: g.sub(b, g.inner(a))),  # -a + b = b - a
    ),
    "sub": (
        (lambda g, a, b: a == b, lambda g, a, b: g.number(0.0)),  # a - a = 0
        (lambda g, a, b: g.is_number(b, 0.0), lambda g, a, b: a),  # a - 0 = a
        (lambda g, a, b: g.is_number(a, 0.0), lambda g, a, b: g.apply("neg", b)),  # 0 - b = -b
    ),
    "mul": (
        (lambda g, a, b: g.is_number(a, 0.0) or g.is_number(b, 0.0), lambda g, a, b: g.number(0.0)),  # 0 b = a 0 = 0
        (lambda g, a, b: g.is_number(a, 1.0), lambda g, a, b: b),  # 1 b = b
        (lambda g, a, b: g.is_number(b, 1.0), lambda g, a, b: a),  # a 1 = a
        (lambda g, a, b: g.is_number(a, -1.0), lambda g, a, b: g.apply("neg", b)),  # -1 b = -b
        (lambda g, a, b: g.is_number(b, -1.0), lambda g, a, b: g.apply("neg", a)),  # a -1 = -a
    ),
    "single": ((lambda g, a: g.is_number(a) or g.operations[a][0] == "single", lambda g, a: a),),
    "div": ((lambda g, a, b: g.is_number(b, 1.0) or g.is_number(a, 0.0), lambda g, a, b: a),),  # a / 1 = a, 0 / b = 0
}


class _Lowering:
    """One walk over a sympy expression; `table` has one rule for each class of expression."""

    def __init__(self, graph: Graph, symbols: Mapping[sp.Symbol, Node]) -> None:
        self.graph = graph
        self.known: dict[sp.Expr, Node] = dict(symbols)
        self.table: dict[Any, Callable[[sp.Expr], Node]] = {
            sp.Add: self._sum,
            sp.Mul: self._product,
            sp.Pow: self._power,
            sp.cot: lambda e: graph.div(graph.number(1.0), graph.apply("tan", self.node(e.args[0]))),
            sp.ceiling: lambda e: graph.apply("neg", graph.apply("floor", self.node(-e.args[0]))),
            sp.Min: lambda e: self._fold("min", e.args),
            sp.Max: lambda e: self._fold("max", e.args),
            sp.Piecewise: self._piecewise,
            sp.Heaviside: lambda e: graph.apply("heaviside", self.node(e.args[0])),
            sp.Abs: lambda e: self._call("abs", e),
            sp.StrictLessThan: lambda e: self._call("lt", e),
            sp.LessThan: lambda e: self._call("le", e),
            sp.StrictGreaterThan: lambda e: graph.apply("lt", self.node(e.args[1]), self.node(e.args[0])),
            sp.GreaterThan: lambda e: graph.apply("le", self.node(e.args[1]), self.node(e.args[0])),
        }
        names = ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "exp", "log")
        self.table |= {getattr(sp, name): partial(self._call, name) for name in (*names, "sign", "floor")}

    def node(self, expression: sp.Expr) -> Node:
        known = self.known.get(expression)
        if known is None:
            known = self._new(expression)
            self.known[expression] = known
        return known

    def _new(self, expression: sp.Expr) -> Node:
        if expression.is_number:
            try:
                return self.graph.number(float(expression))
            except TypeError:
                raise ModelError(f"the equations contain the constant {expression}; constants must be real") from None
        rule = self.table.get(expression.func)
        if rule is None:
            what = f"the symbol {expression}" if expression.is_Symbol else f"the function {expression.func.__name__}"
            raise ModelError(f"{what} has no compiled form")
        return rule(expression)

    def _call(self, name: str, expression: sp.Expr) -> Node:
        return self.graph.apply(name, *(self.node(a) for a in expression.args))

    def _fold(self, name: str, arguments: Sequence[sp.Expr]) -> Node:
        return reduce(partial(self.graph.apply, name), map(self.node, arguments))

    def _sum(self, expression: sp.Expr) -> Node:
        # Terms that do not vary are added first, so that they are computed once outside a loop.
        plus = [self.node(a) for a in expression.args if not a.could_extract_minus_sign()]
        minus = [self.node(-a) for a in expression.args if a.could_extract_minus_sign()]
        plus.sort(key=lambda n: (self.graph.varying[n], n))
        return reduce(self.graph.sub, minus, self.graph.total(plus))

    def _product(self, expression: sp.Expr) -> Node:
        if expression.could_extract_minus_sign():
            return self.graph.apply("neg", self.node(-expression))
        numerator, denominator = [], []
        for factor in expression.args:
            base, exponent = factor.as_base_exp()
            if exponent.is_number and exponent.is_negative:
                denominator.append(self.node(base**-exponent))
            else:
                numerator.append(self.node(factor))
        top = self._multiply(numerator)
        return self.graph.div(top, self._multiply(denominator)) if denominator else top

    def _multiply(self, factors: list[Node]) -> Node:
        # Factors that do not vary are multiplied first, so that they are computed once outside a loop.
        ordered = sorted(factors, key=lambda n: (self.graph.varying[n], n))
        return reduce(self.graph.mul, ordered, self.graph.number(1.0))

    def _power(self, expression: sp.Expr) -> Node:
        base, exponent = expression.args
        if base == sp.E:
            return self.graph.apply("exp", self.node(exponent))
        if exponent.is_number and exponent.is_negative:
            return self.graph.div(self.graph.number(1.0), self.node(base**-exponent))
        if exponent.is_Integer:
            return self._integer_power(self.node(base), int(exponent))
        if exponent == sp.Rational(1, 2):
            return self.graph.apply("sqrt", self.node(base))
        power = self.node(exponent)
        if self.graph.varying[power]:
            return self.graph.apply("exp", self.graph.mul(power, self.graph.apply("log", self.node(base))))
        return self.graph.apply("pow", self.node(base), power)

    def _integer_power(self, base: Node, exponent: int) -> Node:
        if exponent == 1:
            return base
        half = self._integer_power(base, exponent // 2)
        square = self.graph.mul(half, half)
        return self.graph.mul(square, base) if exponent % 2 else square

    def _piecewise(self, expression: sp.Expr) -> Node:
        *cases, (last, condition) = expression.args
        if condition != sp.true:
            raise ModelError(f"{expression} has no value where none of its conditions hold; end it with a last case")
        result = self.node(last)
        for value, case in reversed(cases):
            result = self.graph.apply("where", self.node(case), self.node(value), result)
        return result
