"""Intervals: enclosures of expressions over boxes, many boxes at once, rounded outward.

An enclosure holds every value that an expression takes over a box. Sums, products and roots are correct within half a
unit in the last place by IEEE 754 and are widened by one; elementary functions are taken to be correct within four
units, numbers of the expressions that are no integers within four, and are widened by eight. Source: Moore, Kearfott
and Cloud, Introduction to Interval Analysis (2009), chapters 2 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import values_of
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp

_ULPS = 8  # by which elementary functions and numbers are widened
_LARGEST_ANGLE = 1e8  # beyond this a sine may be anything in [-1, 1]


@dataclass(frozen=True)
class Interval:
    """Closed intervals [low, high] of real numbers, as two arrays of one shape."""

    low: Array
    high: Array

    @classmethod
    def of(cls, low: Array | float, high: Array | float | None = None) -> Interval:
        """Intervals of given ends, or of single numbers."""
        a = np.asarray(low, dtype=float)
        return cls(a, a if high is None else np.asarray(high, dtype=float))

    @classmethod
    def around(cls, number: sp.Expr) -> Interval:
        """Interval that holds an exact number: a fraction, or one that 30 digits tell."""
        value = float(sp.N(number, 30))
        if number.is_Rational and Fraction(value) == Fraction(int(number.p), int(number.q)):
            return cls.of(value)
        return _outward(value, value, ulps=2)

    @classmethod
    def stacked(cls, columns: Sequence[Interval], rows: int) -> Interval:
        """Intervals (rows, columns) of columns (rows,) or single ones."""
        ends = (
            [np.broadcast_to(end, rows) for end in ends]
            for ends in ([x.low for x in columns], [x.high for x in columns])
        )
        return cls(*(np.stack(end, axis=1) if end else np.empty((rows, 0)) for end in ends))

    @property
    def width(self) -> Array:
        """High - low."""
        return self.high - self.low

    @property
    def middle(self) -> Array:
        """Number inside of each; NaN where both ends are infinite."""
        with np.errstate(invalid="ignore"):
            return np.asarray(0.5 * self.low + 0.5 * self.high)

    def __getitem__(self, index: Any) -> Interval:  # noqa: ANN401  # any that numpy takes
        return Interval(self.low[index], self.high[index])

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __add__(self, other: Interval) -> Interval:
        return _outward(self.low + other.low, self.high + other.high)

    def __sub__(self, other: Interval) -> Interval:
        return _outward(self.low - other.high, self.high - other.low)

    def __mul__(self, other: Interval) -> Interval:
        with np.errstate(invalid="ignore", over="ignore"):
            products = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        # An end at infinity is never reached: 0 times it is 0.
        stacked = np.nan_to_num(np.stack(np.broadcast_arrays(*products)), nan=0.0, posinf=np.inf, neginf=-np.inf)
        return _outward(stacked.min(axis=0), stacked.max(axis=0))

    def __truediv__(self, other: Interval) -> Interval:
        bad = other.contains_zero()  # then 1/other may be any real number
        with np.errstate(divide="ignore", over="ignore"):
            found = _outward(1.0 / other.high, 1.0 / other.low)
        return self * Interval(np.where(bad, -np.inf, found.low), np.where(bad, np.inf, found.high))

    def __abs__(self) -> Interval:
        a, b = np.abs(self.low), np.abs(self.high)
        return Interval(np.where(self.contains_zero(), 0.0, np.minimum(a, b)), np.maximum(a, b))

    def contains_zero(self) -> NDArray[np.bool_]:
        """Where 0 lies inside."""
        return np.asarray((self.low <= 0.0) & (self.high >= 0.0))


def enclose(graph: Graph, nodes: Sequence[Node], given: Mapping[Node, Interval]) -> list[Interval]:
    """Enclosures of nodes of a graph, of what each symbol may be: (m,) for m boxes or one number for all.

    Raises:
        ModelError: an operation has no enclosure here, such as `floor`, or a symbol is not given.
    """
    return values_of(graph, nodes, given, RULES, "enclosure by intervals")


def _outward(low: Array | float, high: Array | float, ulps: int = 1) -> Interval:
    """Intervals that are wider by units in the last place at both ends."""
    a, b = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    for _ in range(ulps):
        a, b = np.nextafter(a, -np.inf), np.nextafter(b, np.inf)
    return Interval(a, b)


def growing(function: Callable[[Array], Array]) -> Callable[[Interval], Interval]:
    """Rule of a function that grows."""

    def rule(x: Interval) -> Interval:
        with np.errstate(over="ignore"):
            return _outward(function(x.low), function(x.high), ulps=_ULPS)

    return rule


def _sine(x: Interval, shift: float = 0.0) -> Interval:
    """Enclose sin(x), or cos(x) with a shift of a quarter of a period: 1 and -1 where a crest may lie inside."""
    function = np.cos if shift else np.sin
    wide = (x.width >= 2.0 * np.pi) | (np.maximum(np.abs(x.low), np.abs(x.high)) > _LARGEST_ANGLE)
    low, high = np.where(wide, 0.0, x.low), np.where(wide, 0.0, x.high)
    slack = 1e-6  # turns: far more than rounding up to the largest angle; it only widens
    a, b = function(low), function(high)

    def crest(at: float) -> NDArray[np.bool_]:
        start, end = (low + shift - at) / (2.0 * np.pi) - slack, (high + shift - at) / (2.0 * np.pi) + slack
        return np.asarray(wide | (np.floor(end) >= np.ceil(start)))

    found = _outward(np.minimum(a, b), np.maximum(a, b), ulps=_ULPS)
    least, most = np.where(crest(-np.pi / 2), -1.0, found.low), np.where(crest(np.pi / 2), 1.0, found.high)
    return Interval(np.maximum(least, -1.0), np.minimum(most, 1.0))


def _square(x: Interval) -> Interval:
    size = abs(x)
    found = _outward(size.low**2, size.high**2)
    return Interval(np.maximum(found.low, 0.0), found.high)


def _root(x: Interval) -> Interval:
    if np.any(x.low < 0.0):
        raise ModelError("a root of what may be negative has no enclosure by intervals; take a smaller box")
    return _outward(np.sqrt(x.low), np.sqrt(x.high), ulps=_ULPS)


def _logarithm(x: Interval) -> Interval:
    if np.any(x.low <= 0.0):
        raise ModelError("a logarithm of what may not be positive has no enclosure by intervals; take a smaller box")
    return _outward(np.log(x.low), np.log(x.high), ulps=_ULPS)


def _either(condition: Interval, x: Interval, y: Interval) -> Interval:
    """Enclose x where a condition is 1, y where it is 0, both where it may be either."""
    low = np.minimum(np.where(condition.high > 0.0, x.low, np.inf), np.where(condition.low < 1.0, y.low, np.inf))
    high = np.maximum(np.where(condition.high > 0.0, x.high, -np.inf), np.where(condition.low < 1.0, y.high, -np.inf))
    return Interval(low, high)


RULES: dict[str, Callable[..., Interval]] = {
    "number": lambda x: Interval.of(x) if x.is_integer() else _outward(x, x, ulps=_ULPS),
    "square": _square,
    "neg": lambda x: -x,
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "sqrt": _root,
    "pow": lambda x, exponent: growing(np.exp)(exponent * _logarithm(x)),
    "exp": growing(np.exp),
    "log": _logarithm,
    "sin": _sine,
    "cos": lambda x: _sine(x, np.pi / 2),
    "tan": lambda x: _sine(x) / _sine(x, np.pi / 2),
    "atan": growing(np.arctan),
    "sinh": growing(np.sinh),
    "cosh": lambda x: growing(np.cosh)(abs(x)),
    "tanh": growing(np.tanh),
    "abs": abs,
    "sign": lambda x: Interval(np.sign(x.low), np.sign(x.high)),
    "lt": lambda x, y: Interval(1.0 * (x.high < y.low), 1.0 * (x.low < y.high)),
    "le": lambda x, y: Interval(1.0 * (x.high <= y.low), 1.0 * (x.low <= y.high)),
    "where": _either,
    "min": lambda x, y: Interval(np.minimum(x.low, y.low), np.minimum(x.high, y.high)),
    "max": lambda x, y: Interval(np.maximum(x.low, y.low), np.maximum(x.high, y.high)),
}
