"""Growth: a state at which an expression of the state, such as the rate of an energy, is positive.

States are tried in floating point. What is found there is confirmed, by intervals, or, where an operation has no
enclosure, such as `max` or `heaviside`, by exact arithmetic: the state and the parameters are fractions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp

from masking.analysis.stability.confirmation import enclosed_again
from masking.analysis.stability.free_equations import Motion
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import ARRAYS, function_of, values_of
from masking.compile.codegen.intervals import Interval, enclose
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError

SAMPLES = 20_000
_MOST_CONFIRMED = 20  # of the states where the expression is largest
_ROUNDING = 1e-15  # of an exact value, written as a floating-point number
_DISTINCT = 1e-20  # an exact value is taken to be positive above this: it is evaluated to 30 digits


class Growth:
    """An expression of the state of a motion on a graph, at the declared values, and the edges across which it jumps.

    At an edge, such as v = 0 of sign(v), the expression has no one value: no state there counts.

    Raises:
        ModelError: a function in the expression cannot be evaluated.
    """

    def __init__(self, motion: Motion, expression: sp.Expr) -> None:
        self.motion = motion
        self.smooth = expression.replace(sp.DiracDelta, lambda *_: sp.Integer(0))
        self.state = [x for x in (*motion.q, *motion.v) if x in expression.free_symbols]
        jumps = [f.args[0] for f in expression.atoms(sp.sign, sp.Heaviside, sp.DiracDelta)]
        jumps += [r.lhs - r.rhs for r in expression.atoms(sp.core.relational.Relational)]
        self.graph = Graph()
        symbols, self.values = motion.on(self.graph, self.state)
        self.at, self.exact = [symbols[x] for x in self.state], motion.enclosed(symbols)
        self.node = self.graph.lower(self.smooth, symbols)
        self.edges = [self.graph.lower(x, symbols) for x in dict.fromkeys(jumps)]

    def search(self, sides: Mapping[str, tuple[float, float]]) -> tuple[dict[str, float], float] | None:
        """State of a box, its numbers short, and the least that the expression is there, which is positive.

        None where there is no such state among those tried.
        """
        rng = np.random.default_rng(0)
        low, high = (np.array([sides[x.name][k] for x in self.state]) for k in (0, 1))
        points = rng.uniform(low, high, (SAMPLES, len(self.state)))
        # Also samples at few places at a time: growth may need a coordinate to be 0.
        points[::3] *= rng.integers(0, 2, (len(points[::3]), len(self.state)))
        span = float(np.max(np.abs([low, high]), initial=0.0)) or 1.0
        digits = 2 - int(np.floor(np.log10(span)))
        points = np.clip(np.round(points, digits), low, high)
        given = self.values | {node: points[:, i] for i, node in enumerate(self.at)}
        value, *edges = (np.broadcast_to(x, SAMPLES) for x in evaluated(self.graph, [self.node, *self.edges], given))
        is_fit = np.isfinite(value) & np.all([edge != 0.0 for edge in edges], axis=0)
        value = np.where(is_fit, value, -np.inf)
        for best in np.argsort(-value, kind="stable")[:_MOST_CONFIRMED]:
            if value[best] <= 0.0:
                return None
            growth = self._confirmed(points[best])
            if growth > 0.0:
                state = {x.name: 0.0 for x in (*self.motion.q, *self.motion.v)}
                return state | {x.name: float(y) for x, y in zip(self.state, points[best], strict=True)}, growth
        return None

    def _confirmed(self, point: Array) -> float:
        """Number that the expression is not below at a state; -inf where none is found."""
        given = self.exact | {n: Interval.of(float(x)) for n, x in zip(self.at, point, strict=True)}
        try:
            low = float(enclose(self.graph, [self.node], given)[0].low)
            return low if low <= 0.0 or enclosed_again(self.graph, [self.node], given)[0].a > 0.0 else -np.inf
        except ModelError:
            at = {x: sp.Rational(float(y)) for x, y in zip(self.state, point, strict=True)}
            value = self.motion.given.at_values(self.smooth.subs(at))
            if not (value.is_number and value.is_real and value.is_finite):
                return -np.inf
            about = sp.N(value, 30)
            return float(about) * (1.0 - _ROUNDING) if value.is_Rational or about > _DISTINCT else -np.inf


def evaluated(graph: Graph, nodes: list[Node], given: Mapping[Node, Any]) -> list[Any]:
    """Nodes of a graph at many states at once, in floating point."""
    with np.errstate(all="ignore"):
        return values_of(graph, nodes, given, ARRAYS, _KIND)


def along(
    graph: Graph, nodes: list[Node], variables: Sequence[Node], given: Mapping[Node, Any]
) -> Callable[[Array], list[Any]]:
    """Function of states (..., variables) that gives nodes of a graph at each, in floating point."""
    with np.errstate(all="ignore"):
        function = function_of(graph, nodes, given, ARRAYS, _KIND, variables=variables)

    def at(states: Array) -> list[Any]:
        with np.errstate(all="ignore"):
            return function(np.moveaxis(states, -1, 0))

    return at


_KIND = "value in floating point"
