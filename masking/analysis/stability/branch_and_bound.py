"""Branch and bound with intervals: a number that an expression is nowhere below on a box.

Boxes in which the expression is surely larger than at some point are left out, the others are cut. On each it is
enclosed by intervals and by the mean-value form f(m) + f'(X) (X - m).
Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), chapters 6 and 11.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sympy as sp

from masking.analysis.stability.equilibria import halves
from masking.analysis.stability.free_equations import Motion
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.intervals import Interval, enclose
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError

_MOST_BOXES = 100_000
_ROUNDS = 60
_CLOSE = 1e-4  # of its distance from a given number: nearer to the least value is not looked for
_TURN = (-np.pi * (1.0 + 1e-9), np.pi * (1.0 + 1e-9))


class Bound:
    """An expression, smooth in the coordinates of a motion, on a graph, at the declared values of the parameters.

    Raises:
        ModelError: a function in the expression cannot be evaluated, or has no slope.
    """

    def __init__(self, motion: Motion, expression: sp.Expr) -> None:
        self.graph = Graph()
        symbols, _ = motion.on(self.graph, motion.q)
        self.values = motion.enclosed(symbols)
        self.at = [symbols[q] for q in motion.q]
        self.node = self.graph.lower(expression, symbols)
        self.slopes = derivatives(self.graph, [self.node], self.at)[0]

    def over(self, boxes: Interval) -> Interval:
        """Enclosures (m,) over boxes (m, n)."""
        m, middle = len(boxes.low), Interval.of(boxes.middle)
        plain, *slopes = self._enclosed([self.node, *self.slopes], boxes, m)
        (mean,) = self._enclosed([self.node], middle, m)
        for i, slope in enumerate(slopes):
            mean = mean + slope * (boxes[:, i] - middle[:, i])
        return Interval(np.fmax(plain.low, mean.low), np.fmin(plain.high, mean.high))

    def _enclosed(self, nodes: Sequence[Node], boxes: Interval, m: int) -> list[Interval]:
        given = self.values | {node: boxes[:, i] for i, node in enumerate(self.at)}
        found = enclose(self.graph, nodes, given)
        return [Interval(np.broadcast_to(x.low, m), np.broadcast_to(x.high, m)) for x in found]

    def least(self, boxes: Interval, *, above: float = np.inf, base: float = 0.0) -> float:
        """Number that the expression is nowhere below on boxes (m, n), as large as is soon found.

        A bound that is larger than `above` is not improved; the least is found to a part of its distance from `base`.
        """
        sides, most, settled = np.max(boxes.width, axis=0, initial=0.0), np.inf, np.inf
        sides[sides == 0.0] = np.inf
        for _ in range(_ROUNDS):
            value = self.over(boxes)
            (middle,) = self._enclosed([self.node], Interval.of(boxes.middle), len(boxes.low))
            most = min(float(np.min(middle.high)), most)
            is_done = value.low > above
            settled = min(settled, float(np.min(value.low[is_done], initial=np.inf)))
            kept = ~is_done & (value.low <= most)
            boxes, low = boxes[kept], value.low[kept]
            if not len(low) or most - np.min(low) <= _CLOSE * abs(most - base) or 2 * len(low) > _MOST_BOXES:
                break
            boxes = halves(boxes, np.argmax(boxes.width / sides, axis=1))
        return min(settled, float(np.min(low, initial=np.inf)))


def is_positive(motion: Motion, expression: sp.Expr) -> bool:
    """Whether an expression of the angles alone is positive for all of them, at the declared values."""
    if expression.free_symbols & {*motion.q, *motion.v} - {*motion.circles}:
        return False
    sides = [_TURN if q in motion.circles else (0.0, 0.0) for q in motion.q]
    low, high = (np.array([[side[k] for side in sides]]) for k in (0, 1))
    try:
        return Bound(motion, expression).least(Interval(low, high), above=0.0) > 0.0
    except ModelError:
        return False


def faces(low: Array, high: Array) -> Interval:
    """Faces of a box (n,) as boxes (2 n, n)."""
    n = len(low)
    lows, highs, rows = np.tile(low, (2 * n, 1)), np.tile(high, (2 * n, 1)), np.arange(n)
    highs[rows, rows], lows[n + rows, rows] = low, high
    return Interval(lows, highs)
