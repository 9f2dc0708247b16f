"""Equilibria: every state of rest in a box, found by intervals, so that none is missed.

A box in which the force at rest cannot vanish is left out. Where Krawczyk's operator maps a box into its inside, there
is exactly one equilibrium in it, if mpmath's intervals confirm that; other boxes are cut in two. What is too small to
cut stays undecided, such as equilibria that are not isolated. Where these are lines along free directions, each is
found once, where it meets a plane.

Along a free direction no force at rest changes: the angle of a shaft that turns freely is one (a cyclic coordinate),
and the common motion of two bodies that only a spring between them holds. An expression is a sum of functions of the
coordinates, each with a coefficient: what is linear in forces or in their slopes is found from these exactly.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), section 8.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from sympy.polys.matrices import DomainMatrix

from masking.analysis.stability.algebra import is_zero
from masking.analysis.stability.confirmation import enclosed_again, has_root
from masking.analysis.stability.free_equations import check_continuous
from masking.analysis.stability.modes import eigenvalues, is_smooth, state_matrix
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.intervals import Interval, enclose
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array, Complex
from masking.display.printed_result import Printed
from masking.errors import ModelError, nearest
from masking.model.modelling.gradient import jacobian
from masking.model.modelling.model import Model
from masking.model.modelling.scales import Shown

Box = Mapping[str, tuple[float, float]]

STABLE, UNSTABLE = "asymptotically stable", "unstable"
UNDECIDED = "not decided by its eigenvalues"
SMALLEST = 1e-7  # part of a side of the box, below which a box is not cut
MOST_BOXES = 400_000
_FURTHER = 10.0  # times the largest declared initial value, the box where nothing else is known
_MOST_REFINED = 200
_OFF_MIDDLE = 0.4871  # part of a side at which a box is cut: symmetric models have equilibria in the middle
_ROUNDING = 1e-14  # of a sum of products, and of a coefficient from its decimals
_ANYWHERE = 0.3491  # a place where nothing special is
_MARGIN = 0.0137  # of a turn, so that an equilibrium is not on the edge of a box of angles


@dataclass(frozen=True)
class Equilibrium:
    """A state of rest."""

    position: dict[str, float]  # by coordinate, in SI units or in the declared scales
    radius: float  # half the largest side of a box that is proved to hold exactly one equilibrium
    eigenvalues: Complex  # of the model linearised there (2 n + k,), the slowest last to decay first
    verdict: str  # what the eigenvalues tell; see `stability_of`
    # whether an eigenvalue with positive real part is proved to exist: the determinant of the stiffness is negative all
    # over the box, that of the mass positive
    is_unstable: bool
    shown: Mapping[str, Shown]  # how each coordinate is shown

    @property
    def words(self) -> str:
        """Where it is, in the declared units."""
        return ", ".join(f"{name} = {self.shown[name].text(x)}" for name, x in self.position.items())


def stability_of(model: Model, position: Mapping[str, float]) -> tuple[Complex, str]:
    """Eigenvalues at an equilibrium without inputs, the slowest to decay first, and what they tell of its stability.

    They tell nothing where a force has a kink there, nor where rounding may have moved them across the imaginary axis.
    """
    matrix = state_matrix(model, position)
    if not np.all(np.isfinite(matrix)):
        return np.full(len(matrix), np.nan + 0j), UNDECIDED
    values, errors = eigenvalues(matrix)
    order = np.lexsort((-values.imag, -values.real))
    values, errors = values[order], errors[order]
    if not is_smooth(model, position):
        return values, UNDECIDED
    if np.any(values.real > errors):
        return values, UNSTABLE
    return values, STABLE if np.all(values.real < -errors) else UNDECIDED


@dataclass(frozen=True, repr=False)
class Equilibria(Printed):
    """The equilibria in a box."""

    points: tuple[Equilibrium, ...]  # those that are proved to exist, each alone in a box around it
    # where they were looked for, by coordinate; both sides are one where the lines along a direction are met
    box: dict[str, tuple[float, float]]
    is_complete: bool  # whether there are no others in the box: neither undecided ones, nor any along lines
    is_global: bool  # whether there are none outside of the box either; angles modulo one turn
    undecided: Array  # boxes in which it could not be decided whether there are equilibria: least and largest (m, n, 2)
    shown: Mapping[str, Shown]  # how each coordinate is shown
    # directions by coordinate, along which no force changes: there are equilibria all along them through each point
    along: tuple[dict[str, float], ...] = ()

    def __str__(self) -> str:
        count, what = len(self.points), "isolated equilibria"
        sides = (
            f"{n} = {self.shown[n].text(b, 4)}"
            if a == b
            else f"{n} in [{a / self.shown[n].size:.4g}, {self.shown[n].text(b, 4)}]"
            for n, (a, b) in self.box.items()
        )
        where = "" if self.is_global else f" in the box {', '.join(sides)}"
        if self.along or not len(self.undecided):
            what = f"equilibri{'um' if count == 1 else 'a'}"
        if self.along and count:
            ways = " and along ".join(map(self._way, self.along))
            what = f"famil{'y' if count == 1 else 'ies'} of equilibria along {ways}"
        if not len(self.undecided):
            return f"{count} {what}{where}, and no other (proved)"
        boxes = f"{len(self.undecided)} small box{'es' * (len(self.undecided) > 1)}"
        return f"{count} {what}{where}; in {boxes} it is not decided"

    def _way(self, direction: Mapping[str, float]) -> str:
        """Direction in words: the coordinate that it moves, or such as (x1, x2) = (1, 1) in the declared units."""
        parts = ", ".join(f"{x / self.shown[name].size:.4g}" for name, x in direction.items())
        return ", ".join(direction) if len(direction) == 1 else f"({', '.join(direction)}) = ({parts})"


def check_box(model: Model, box: Box, *, with_velocities: bool = True) -> None:
    """Refuse a box of what the model does not have, or without an inside.

    Raises:
        ModelError: a name is no coordinate or, with velocities, no velocity (`x1'`); or an interval is empty.
    """
    names, what = [*model.coordinates], "coordinate"
    if with_velocities:
        names, what = [*names, *(f"{name}'" for name in names)], "coordinate or velocity"
    for name, (low, high) in box.items():
        if name not in names:
            raise ModelError(f"{model.name} has no {what} '{name}'; {nearest(name, names)}")
        if not low < high:
            raise ModelError(f"the box of {name} is [{low:g}, {high:g}]; give the least value, then the largest")


def equilibria(model: Model, box: Box | None = None) -> Equilibria:
    """Find every equilibrium of a model in a box.

    Args:
        model: without inputs acting, in SI units or in its scales; its equations without time and internal states.
        box: least and largest value of coordinates, in the same units; those that are not given are taken from a bound
            that the equations themselves give, which makes the search global, or are ten times the largest declared
            initial value; angles go once around.

    Raises:
        ModelError: a coordinate is unknown, or the equations hold what has no enclosure.
    """
    check_box(model, box or {}, with_velocities=False)
    return _Rest(model, dict(box or {})).search()


class _Rest:
    """The force at rest f(q) and its Jacobian, on a graph.

    Where there are free directions, some coordinates are held, and as many forces left out: most are sums of the
    others, and those that are not are looked at, too.
    """

    def __init__(self, model: Model, given: dict[str, tuple[float, float]]) -> None:
        e = model.equations
        model.check_ordinary("a search for equilibria")
        if model.states:
            raise ModelError(f"{model.name} has internal states, for which equilibria are not looked for")
        if not model.is_autonomous:
            raise ModelError(f"the equations of {model.name} hold the time: it has no equilibria")
        check_continuous(e.force)
        self.model, self.given = model, given
        self.exact = dict(zip(e.symbols.p, model.exact_values().values(), strict=True))
        still = dict.fromkeys((*e.symbols.v, *e.symbols.u), 0)
        self.held, self.along = dict[sp.Symbol, sp.Rational](), list[dict[str, float]]()
        self._lower(e.symbols.q, [f.subs(still) for f in e.force], [])
        if self._may_be_free():
            self._hold()

    def _lower(self, q: Sequence[sp.Symbol], force: list[sp.Expr], others: list[sp.Expr]) -> None:
        self.q, self.force, self.graph = q, force, Graph()
        self.symbols = {x: self.graph.symbol(f"q_{x.name}", varying=True) for x in q}
        self.at: list[Node] = list(self.symbols.values())
        self.symbols |= {p: self.graph.symbol(f"p_{p.name}", varying=False) for p in self.exact}
        self.nodes = [self.graph.lower(f, self.symbols) for f in force]
        self.others = [self.graph.lower(f, self.symbols) for f in others]
        self.ratios = [[self.graph.lower(sp.cancel(f / by), self.symbols) for by in force] for f in others]
        self.slopes = [x for row in derivatives(self.graph, self.nodes, self.at) for x in row]
        self.values = {self.symbols[p]: Interval.around(x) for p, x in self.exact.items()}

    def _may_be_free(self) -> bool:
        """Whether the slopes of the force at some point allow a direction along which it never changes."""
        n = len(self.q)
        slopes = self.enclose(self.slopes, Interval.of(_ANYWHERE + np.arange(n) / (n + 1.0))[None]).middle.reshape(n, n)
        return bool(n and np.isfinite(slopes).all() and np.linalg.matrix_rank(slopes) < n)

    def _hold(self) -> None:
        """Hold coordinates, so that lines of equilibria are met in points."""
        q, exact = self.q, [f.subs(self.exact) for f in self.force]
        directions, moved = free_directions(exact, q)
        along = [
            {x.name: float(d) for x, d in zip(q, directions.row(k), strict=True) if d != 0} for k in range(len(moved))
        ]
        if self.given and any(len(one) > 1 for one in along):
            return  # a line through the box may meet the plane outside of it
        self.along, self.held = along, {q[i]: sp.Rational(np.mean(self.given.get(q[i].name, 0.0))) for i in moved}
        order = [*(i for i in range(len(q)) if i not in moved), *moved]
        found = [order[i] for i in independent([exact[i] for i in order], q)]
        kept = [*found, *(i for i in order if i not in found)][: len(q) - len(moved)]
        force = [f.subs(self.held) for f in self.force]
        self._lower(
            [x for x in q if x not in self.held], [force[i] for i in kept], [force[i] for i in found if i not in kept]
        )

    def enclose(self, nodes: list[Node], boxes: Interval) -> Interval:
        """Enclosures (m, len(nodes)) over boxes (m, n)."""
        given = self.values | {node: boxes[:, i] for i, node in enumerate(self.at)}
        return Interval.stacked(enclose(self.graph, nodes, given), len(boxes.low))

    @cached_property
    def angles(self) -> list[bool]:
        """Which coordinates are angles: neither mass nor force change over one turn."""
        e = self.model.equations
        every = [*e.mass, *e.force]
        return [all(is_zero(x.subs(q, q + 2 * sp.pi) - x) for x in every) for q in self.q]

    def bound(self) -> dict[str, tuple[float, float]]:
        """Box that holds every equilibrium of coordinates that are no angles; empty where none is known.

        With f = A q + g(q) and bounded g, all equilibria have q = -A^-1 g.
        """
        lines = [i for i, is_angle in enumerate(self.angles) if not is_angle]
        names = [self.q[i] for i in lines]
        slopes, rest = np.zeros((len(lines), len(lines))), []
        for row, i in enumerate(lines):
            expression = left = sp.expand(self.force[i])
            for column, q in enumerate(names):
                by = expression.as_independent(*self.q, as_Add=True)[1].coeff(q, 1)
                by = sum((t for t in sp.Add.make_args(by) if not t.free_symbols & {*self.q}), sp.Integer(0))
                slopes[row, column] = float(by.subs(self.exact))
                left -= by * q
            rest.append(sp.expand(left))
        if not lines or np.linalg.matrix_rank(slopes) < len(lines):
            return {}
        given = self.values | dict.fromkeys(self.at, Interval.of(-np.inf, np.inf))
        try:
            ranges = enclose(self.graph, [self.graph.lower(r, self.symbols) for r in rest], given)
        except ModelError:
            return {}
        # With R near A^-1 and E = I - R A: q = -R g + E q, so that |q| <= |R| |g| + |E| max |R g|/(1 - |E|).
        inverse = np.linalg.inv(slopes)
        error = np.abs(np.eye(len(lines)) - inverse @ slopes) + _ROUNDING * (np.abs(inverse) @ np.abs(slopes))
        largest = np.array([max(abs(float(r.low)), abs(float(r.high))) for r in ranges])
        if not np.all(np.isfinite(largest)) or (loss := float(np.max(error.sum(axis=1)))) >= 0.5:
            return {}
        first = np.abs(inverse) @ largest
        reach = first + error.sum(axis=1) * float(np.max(first, initial=0.0)) / (1.0 - loss)
        reach = reach * (1.0 + 1e-6) + 1e-9 * (1.0 + float(reach.max(initial=0.0)))
        return {q.name: (-1.003 * float(r), 1.007 * float(r)) for q, r in zip(names, reach, strict=True)}

    def search(self) -> Equilibria:
        names, given = [q.name for q in self.q], self.given
        box, known = dict[str, tuple[float, float]](), self.bound()
        wide = _FURTHER * float(np.max(np.abs(self.model.first_place), initial=0.0)) or 1.0
        turn = (-np.pi * (1.0 - _MARGIN), np.pi * (1.0 + _MARGIN))
        for name, is_angle in zip(names, self.angles, strict=True):
            box[name] = given.get(name) or (turn if is_angle else known.get(name, (-1.003 * wide, 1.007 * wide)))
        is_global = not given and all(a or n in known for n, a in zip(names, self.angles, strict=True))
        sides = Interval(np.array([[a for a, _ in box.values()]]), np.array([[b for _, b in box.values()]]))
        roots, undecided = self._cut(sides)
        roots = [at for at in roots if self.enclose(self.others, Interval(*at)[None]).contains_zero().all()]
        box |= {q.name: (float(x), float(x)) for q, x in self.held.items()}
        rest = (self.graph, self.nodes, self.slopes, self.at)
        sure = [
            has_root(*rest, given=self.values, box=Interval(low, high)) and self._are_all(Interval(low, high))
            for low, high in roots
        ]
        doubtful = [np.stack([low, high], axis=1)[None] for (low, high), ok in zip(roots, sure, strict=True) if not ok]
        undecided = np.concatenate([undecided, *doubtful])
        points = tuple(self._point(low, high) for (low, high), ok in zip(roots, sure, strict=True) if ok)
        is_complete = not self.along and not len(undecided)
        return Equilibria(points, box, is_complete, is_global, undecided, self.model.shown, tuple(self.along))

    def _cut(self, whole: Interval) -> tuple[list[tuple[Array, Array]], Array]:
        sides = whole.width[0]
        pending, roots, undecided = whole, list[tuple[Array, Array]](), []
        while len(pending.low):
            if len(pending.low) > MOST_BOXES:
                undecided.append(np.stack([pending.low, pending.high], axis=2))
                break
            force = self.enclose([*self.nodes, *self.others], pending)
            pending = pending[np.all(force.contains_zero(), axis=1)]
            for low, high in roots:  # a box that has one root alone has been searched
                inside = np.all((pending.low >= low) & (pending.high <= high), axis=1)
                pending = pending[~inside]
            if not len(pending.low):
                break
            pending = self._contract(pending, roots)
            parts = pending.width / sides
            small = np.max(parts, axis=1, initial=0.0) < SMALLEST
            if np.any(small):
                undecided.append(np.stack([pending.low[small], pending.high[small]], axis=2))
                pending, parts = pending[~small], parts[~small]
            pending = halves(pending, np.argmax(parts, axis=1), _OFF_MIDDLE) if len(pending.low) else pending
        unproved = np.concatenate(undecided) if undecided else np.empty((0, len(sides), 2))
        kept = [not any(np.all((b[:, 0] >= low) & (b[:, 1] <= high)) for low, high in roots) for b in unproved]
        return self._distinct(roots), unproved[kept] if len(unproved) else unproved

    def _contract(self, boxes: Interval, roots: list[tuple[Array, Array]]) -> Interval:
        """Parts of boxes that Krawczyk's operator does not rule out; note boxes with one root."""
        image, is_regular = self._krawczyk(boxes)
        low, high = np.maximum(boxes.low, image.low), np.minimum(boxes.high, image.high)
        one = is_regular & np.all((image.low > boxes.low) & (image.high < boxes.high), axis=1)
        none = is_regular & np.any(low > high, axis=1)
        roots += [(boxes.low[i], boxes.high[i]) for i in np.flatnonzero(one)]
        kept = ~(one | none)
        use = is_regular[:, None]
        left = Interval(np.where(use, low, boxes.low)[kept], np.where(use, high, boxes.high)[kept])
        # A root on the edge of a box is never inside of it: look at a larger box around the small ones.
        for i in range(len(left.low) if len(left.low) <= 64 else 0):
            self._around(left[i : i + 1], roots)
        return left

    def _around(self, box: Interval, roots: list[tuple[Array, Array]]) -> None:
        larger = Interval(box.middle - box.width - 1e-300, box.middle + box.width + 1e-300)
        if any(np.all((box.low[0] >= low) & (box.high[0] <= high)) for low, high in roots):
            return
        image, is_regular = self._krawczyk(larger)
        if is_regular[0] and np.all((image.low > larger.low) & (image.high < larger.high)):
            roots.append((larger.low[0], larger.high[0]))

    def _krawczyk(self, boxes: Interval) -> tuple[Interval, Array]:
        """K = m - Y f(m) + (I - Y J)(X - m), and whether Y = mid(J)^-1 exists; (m, n) and (m,)."""
        m, n = boxes.low.shape
        middle = boxes.middle
        slopes = self.enclose(self.slopes, boxes)
        j = Interval(slopes.low.reshape(m, n, n), slopes.high.reshape(m, n, n))
        finite = np.all(np.isfinite(j.low) & np.isfinite(j.high), axis=(1, 2))
        centre = np.where(finite[:, None, None], j.middle, np.eye(n))
        is_regular = finite & (np.abs(np.linalg.det(centre)) > 0.0)
        centre[~is_regular] = np.eye(n)
        y = Interval.of(np.linalg.inv(centre))
        f = self.enclose(self.nodes, Interval.of(middle))
        spread = Interval(boxes.low, boxes.high) - Interval.of(middle)
        columns = []
        for i in range(n):
            total = Interval.of(middle[:, i])
            for k in range(n):
                total = total - y[:, i, k] * f[:, k]
            for k in range(n):
                entry = Interval.of(float(i == k))
                for p in range(n):
                    entry = entry - y[:, i, p] * j[:, p, k]
                total = total + entry * spread[:, k]
            columns.append(total)
        return Interval.stacked(columns, m), is_regular

    def _distinct(self, roots: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
        """Each root once, in a box as small as Krawczyk's operator makes it; angles in (-pi, pi]."""
        found: list[tuple[Array, Array]] = []
        for low, high in roots:
            box = Interval(low[None], high[None])
            for _ in range(_MOST_REFINED):
                image, _ = self._krawczyk(box)
                new = Interval(np.maximum(box.low, image.low), np.minimum(box.high, image.high))
                if np.all(new.width >= 0.99 * box.width):
                    break
                box = new
            if not any(np.all((box.low[0] <= b) & (a <= box.high[0])) for a, b in found):
                found.append((box.low[0], box.high[0]))
        return sorted(found, key=lambda root: tuple(np.round(root[0] + root[1], 9)))

    def _are_all(self, box: Interval) -> bool:
        """Whether the other forces vanish where these do: each is one of these times what is finite all over a box."""
        found = (self.enclose(ratios, box[None]) for ratios in self.ratios)
        return all(np.any(np.isfinite(ratios.low) & np.isfinite(ratios.high)) for ratios in found)

    def _point(self, low: Array, high: Array) -> Equilibrium:
        position = {q.name: float(x) for q, x in zip(self.q, 0.5 * (low + high), strict=True)}
        position = {
            n: 0.0 if abs(x) <= 0.5 * float(np.max(high - low, initial=0.0)) else x for n, x in position.items()
        }
        position |= {q.name: float(x) for q, x in self.held.items()}
        position = {name: position[name] for name in self.model.coordinates}
        values, verdict = stability_of(self.model, position)
        is_unstable = self._is_unstable(low, high)
        if is_unstable and verdict == STABLE:  # one of the two is wrong
            is_unstable, verdict = False, UNDECIDED
        radius, shown = 0.5 * float(np.max(high - low, initial=0.0)), self.model.shown
        return Equilibrium(position, radius, values, verdict, is_unstable, shown)

    def _is_unstable(self, low: Array, high: Array) -> bool:
        """Whether det(-df/dq) < 0 < det M over a box: the characteristic polynomial has a positive root."""
        n, e = len(self.q), self.model.equations
        if self.held or e.mass.free_symbols - self.symbols.keys():
            return False
        given = self.values | {node: Interval.of(low[i], high[i]) for i, node in enumerate(self.at)}
        nodes = [*self.slopes, *(self.graph.lower(x, self.symbols) for x in e.mass)]
        for entries in (enclose(self.graph, nodes, given), enclosed_again(self.graph, nodes, given)):
            rows = [entries[i : i + n] for i in range(0, len(entries), n)]
            stiffness, mass = _determinant([[-x for x in row] for row in rows[:n]]), _determinant(rows[n:])
            ends = (stiffness.high, mass.low) if isinstance(stiffness, Interval) else (stiffness.b, mass.a)
            if not ends[0] < 0.0 < ends[1]:
                return False
        return True


def halves(boxes: Interval, axis: Array, part: float = 0.5) -> Interval:
    """Cut each box (m, n) in two along its axis (m,), at a part of its side."""
    rows = np.arange(len(boxes.low))
    at = boxes.low[rows, axis] + part * boxes.width[rows, axis]
    first, second = boxes.high.copy(), boxes.low.copy()
    first[rows, axis], second[rows, axis] = at, at
    return Interval(np.concatenate([boxes.low, second]), np.concatenate([first, boxes.high]))


def _determinant(matrix: list[list[Any]]) -> Any:  # noqa: ANN401  # intervals, ours or mpmath's
    """Enclosure of a determinant, by expansion along the first row."""
    if len(matrix) == 1:
        return matrix[0][0]
    parts = [entry * _determinant([row[:k] + row[k + 1 :] for row in matrix[1:]]) for k, entry in enumerate(matrix[0])]
    total = parts[0]
    for k, part in enumerate(parts[1:]):
        total = total + part if k % 2 else total - part
    return total


def free_directions(force: Sequence[sp.Expr], q: Sequence[sp.Symbol]) -> tuple[sp.Matrix, tuple[int, ...]]:
    """Directions (r, n), constant vectors along which forces without parameters (n,) never change; and what holds them.

    That are the indices of r coordinates, of which each direction moves one, by 1.
    """
    slopes = jacobian(force, q)
    null = _coefficients([slopes.col(j) for j in range(len(q))], q).transpose().nullspace()
    reduced, pivots = null.rref()
    return reduced.to_Matrix(), tuple(pivots)


def independent(force: Sequence[sp.Expr], q: Sequence[sp.Symbol]) -> tuple[int, ...]:
    """Indices of forces of which the others are sums with constant factors, the first ones that will do."""
    return tuple(_coefficients([[f] for f in force], q).transpose().rref()[1])


def _coefficients(rows: Sequence[Sequence[sp.Expr]], q: Sequence[sp.Symbol]) -> DomainMatrix:
    """Coefficients of rows of expressions (m, k), a column for each function of the coordinates in each of the k."""
    columns, found = dict[tuple[int, sp.Expr], int](), list[tuple[int, int, sp.Expr]]()
    for i, row in enumerate(rows):
        for k, expression in enumerate(row):
            for term in sp.Add.make_args(sp.expand(expression)):
                factor, function = term.as_independent(*q, as_Add=False)
                found.append((i, columns.setdefault((k, function), len(columns)), factor))
    matrix = sp.zeros(len(rows), len(columns))
    for i, column, factor in found:
        matrix[i, column] += factor
    return DomainMatrix.from_Matrix(matrix).to_field()
