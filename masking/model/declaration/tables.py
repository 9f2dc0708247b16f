"""Tables: curves through points, as expressions hold them.

    interpolate(x, x1, y1, x2, y2, ...)            a natural cubic spline: two continuous derivatives
    interpolate_monotone(x, x1, y1, x2, y2, ...)   a cubic that rises and falls where the points do: one derivative

Both go on straight beyond the first and the last point. Each is a sum of powers of max(x - xi, 0), which every printer
and every derivative knows.
Source: de Boor (2001), A Practical Guide to Splines, chapter 4; Fritsch and Butland (1984), SIAM J. Sci. Stat. Comput.
5(2), 300-304, for the slopes of the monotone one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from masking.lazy_imports import sympy as sp

FEWEST = 2  # points
TABLES = ("interpolate", "interpolate_monotone")


@dataclass(frozen=True, slots=True)
class Powers:
    """A curve as a straight line from its first point, and what is added beyond each point."""

    points: tuple[float, ...]  # abscissae (p,)
    # value, slope: at the first point
    value: float
    slope: float
    # squares, cubes: factors of powers of what x is beyond each point (p,)
    squares: tuple[float, ...]
    cubes: tuple[float, ...]


Curve = Callable[[tuple[float, ...]], Powers]


def value(curve: Curve, x: float, *points: float) -> float:
    """Curve at x through points, given as abscissa and ordinate of each, in order."""
    terms = curve(points)
    total = terms.value + terms.slope * (x - terms.points[0])
    for at, square, cube in zip(terms.points, terms.squares, terms.cubes, strict=True):
        beyond = x - at
        if beyond > 0.0:
            total += beyond * beyond * (square + cube * beyond)
    return total


def symbolic(curve: Curve, x: sp.Expr, *points: sp.Expr) -> sp.Expr:
    """Curve through points as a sympy expression."""
    terms = curve(tuple(map(float, points)))
    parts = [sp.Float(terms.value), sp.Float(terms.slope) * (x - sp.Float(terms.points[0]))]
    for at, square, cube in zip(terms.points, terms.squares, terms.cubes, strict=True):
        if square or cube:
            beyond = sp.Max(x - sp.Float(at), 0)
            parts.append(beyond**2 * (sp.Float(square) + sp.Float(cube) * beyond))
    return sp.Add(*parts)


def trouble(points: Sequence[float | None]) -> str:
    """Say what is wrong with a table's abscissas and ordinates in turn (None: no number); '' for nothing."""
    if len(points) % 2 or len(points) < 2 * FEWEST:
        return f"a table has {FEWEST} points or more, each x and y"
    known = [value for value in points if value is not None]
    if len(known) < len(points):
        return "the points of a table are numbers"
    for before, after in zip(known[::2], known[2::2], strict=False):
        if not before < after:
            return f"the x of a table must increase, and {after:g} comes after {before:g}"
    return ""


@lru_cache(maxsize=256)
def natural(points: tuple[float, ...]) -> Powers:
    """Natural cubic spline through points."""
    x, y = points[::2], points[1::2]
    h, rise = _rises(x, y)
    bends = [0.0, *_bends(h, rise), 0.0]  # second derivatives
    cubes = [(after - before) / (6.0 * width) for (before, after), width in zip(pairwise(bends), h, strict=True)]
    jumps = [after - before for before, after in zip([0.0, *cubes], [*cubes, 0.0], strict=True)]
    slope = rise[0] - h[0] * bends[1] / 6.0
    return Powers(x, y[0], slope, (0.0,) * len(x), tuple(jumps))


def _bends(h: Sequence[float], rise: Sequence[float]) -> list[float]:
    """Second derivatives at the inner points, by elimination in a tridiagonal matrix."""
    diagonal, right = list[float](), list[float]()
    for i in range(len(h) - 1):
        pivot, value = 2.0 * (h[i] + h[i + 1]), 6.0 * (rise[i + 1] - rise[i])
        if i:
            pivot, value = pivot - h[i] ** 2 / diagonal[-1], value - h[i] / diagonal[-1] * right[-1]
        diagonal.append(pivot)
        right.append(value)
    found = list[float]()
    for i in reversed(range(len(diagonal))):
        found.insert(0, (right[i] - (h[i + 1] * found[0] if found else 0.0)) / diagonal[i])
    return found


@lru_cache(maxsize=256)
def monotone(points: tuple[float, ...]) -> Powers:
    """Cubic through points that rises and falls where they do."""
    x, y = points[::2], points[1::2]
    h, rise = _rises(x, y)
    slopes = [rise[0]]
    for i in range(1, len(h)):
        before, after = rise[i - 1], rise[i]
        is_level = (before > 0.0) != (after > 0.0) or before == 0.0 or after == 0.0
        weights = h[i - 1] + 2.0 * h[i], 2.0 * h[i - 1] + h[i]
        slopes.append(0.0 if is_level else 3.0 * (h[i - 1] + h[i]) / (weights[1] / after + weights[0] / before))
    slopes.append(rise[-1])
    squares, cubes, square, cube, width = list[float](), list[float](), 0.0, 0.0, 0.0
    for i in range(len(x)):
        square_before, cube_before = square + 3.0 * cube * width, cube  # of the piece that ends here
        if i < len(h):
            width, ends = h[i], slopes[i] + slopes[i + 1]
            square = (3.0 * rise[i] - slopes[i] - ends) / width
            cube = (ends - 2.0 * rise[i]) / width**2
        else:
            square = cube = 0.0
        squares.append(square - square_before)
        cubes.append(cube - cube_before)
    return Powers(x, y[0], slopes[0], tuple(squares), tuple(cubes))


def _rises(x: Sequence[float], y: Sequence[float]) -> tuple[list[float], list[float]]:
    """Width of each piece, and the mean slope in it."""
    h = [b - a for a, b in pairwise(x)]
    return h, [(b - a) / width for (a, b), width in zip(pairwise(y), h, strict=True)]
