"""Sublevel sets of the energy: inner estimates of basins of attraction.

The part of {V < c} around a minimum of the potential U keeps every motion that starts in it, where V' <= 0 and that
part is bounded. It holds no other equilibrium where c is at most the potential at each equilibrium that is no minimum:
if there were one, on the lowest pass between the two there would be a further one, no minimum, below c. Then LaSalle's
theorem lets all motions in it converge to the equilibrium. It is bounded where every {V <= c} is, or where U >= c on
the faces of a box around the equilibrium.

Source: Khalil (2002), sections 4.2 and 8.2; Ambrosetti and Rabinowitz (1973), Dual variational methods in critical
point theory (the mountain pass theorem).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from masking.analysis.stability.algebra import normal, squares
from masking.analysis.stability.boundedness import Boundedness, is_kinetic, parts_of_energy
from masking.analysis.stability.branch_and_bound import Bound, faces
from masking.analysis.stability.dissipation import default_box
from masking.analysis.stability.equilibria import Equilibria, equilibria
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.lasalle import invariant_set
from masking.compile.codegen.intervals import Interval
from masking.compile.numerics.arrays import Array
from masking.display.printed_result import Printed
from masking.errors import ModelError
from masking.model.modelling.model import Model

_DIGITS = 6
_SCALES = 48  # of boxes that are tried
_INSIDE = 1e-3  # of its distance: a face is nearer than another equilibrium
_ZERO = 1e-12  # of the level: V at the equilibrium is rounding below this
_SAMPLES = 2000  # of the faces, to choose a box
_MOST_COORDINATES = 4
_KINKS = (sp.Abs, sp.sign, sp.Heaviside, sp.Max, sp.Min, sp.Piecewise, sp.floor, sp.ceiling)


@dataclass(frozen=True, repr=False)
class Basin(Printed):
    """An inner estimate of the basin of attraction of an equilibrium, at the declared values."""

    position: dict[str, float]  # of the equilibrium, by coordinate
    least: float  # V there
    level: float  # every motion converges to it that starts with V below this, in the connected part around it
    box: dict[str, tuple[float, float]] | None  # where this part lies; None where the energy alone bounds it

    def __str__(self) -> str:
        place = ", ".join(f"{n} = {x:.6g}" for n, x in self.position.items())
        sides = ", ".join(f"{a:.4g} <= {n} <= {b:.4g}" for n, (a, b) in (self.box or {}).items())
        return (
            f"every motion that starts where V < {self.level:.{_DIGITS}g}, in the connected part of this set around "
            f"({place}), where V = {self.least:.{_DIGITS}g}, converges to it (proved, at the declared values)"
            + (f"; that part lies in {sides}" if sides else "")
        )


def basins(model: Model, bounded: Boundedness | None) -> tuple[Basin, ...]:
    """Inner estimates of the basins of attraction of equilibria, where the energy is smooth and gives any.

    `bounded` says that every {V <= c} is compact, where V' <= 0 everywhere, is 0 only along equilibria; None where V'
    is to be looked at near each equilibrium.
    """
    given = Hypotheses(model)
    motion = Motion(model, given)
    if len(motion.q) > _MOST_COORDINATES or any(f.has(*_KINKS) for f in (*motion.force, motion.energy)):
        return ()
    try:
        found = tuple(_Landscape(motion).basins(bounded))
    except ModelError:
        return ()
    return () if given.coincidences else found


@dataclass(frozen=True)
class _Rest:
    """An equilibrium in a small box (n,), the potential there, and whether it is proved to be a minimum."""

    low: Array
    high: Array
    value: Interval
    is_minimum: bool

    @property
    def middle(self) -> Array:
        return 0.5 * (self.low + self.high)


class _Landscape:
    """The potential of a model over its coordinates, at the declared values."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        kinetic, potential = parts_of_energy(motion)
        if not is_kinetic(kinetic, motion):
            raise ModelError("the kinetic energy could not be shown to be positive definite")
        self.bound = Bound(motion, potential)
        curvature = sp.hessian(potential, motion.q)
        self.minors = [Bound(motion, curvature[:k, :k].det(method="berkowitz")) for k in range(1, curvature.rows + 1)]

    def basins(self, bounded: Boundedness | None) -> Iterator[Basin]:
        whole = equilibria(self.motion.model)
        rest = self._rest(whole)
        for here in rest:
            if not here.is_minimum:
                continue
            box, level = None, -np.inf
            if bounded is not None and bounded.is_shown and whole.is_complete and whole.is_global:
                level = self._pass(here, rest)
            elif (pivots := [] if bounded is not None else self._pivots(here)) is not None:
                box, level = self._around(here, rest, [Bound(self.motion, p) for p in pivots])
            level = _down(level, level - float(here.value.high))
            if float(here.value.high) < level < np.inf:
                names = [q.name for q in self.motion.q]
                at = {n: x + 0.0 for n, x in zip(names, here.middle.tolist(), strict=True)}
                least = float(here.value.middle)
                yield Basin(at, 0.0 if abs(least) < _ZERO * abs(level) else least, level, box)

    def _rest(self, found: Equilibria) -> list[_Rest]:
        points = []
        for point in found.points:
            at = np.array([*point.position.values()])
            low, high = at - point.radius, at + point.radius
            box = Interval(low[None], high[None])
            is_minimum = all(float(minor.over(box).low[0]) > 0.0 for minor in self.minors)
            points.append(_Rest(low, high, self.bound.over(box)[0], is_minimum))
        return points

    def _pivots(self, here: _Rest) -> list[sp.Expr] | None:
        """Expressions whose signs give V' <= 0, and V' = 0 only along equilibria; None where that is not seen."""
        motion, v = self.motion, self.motion.v
        matrix = sp.hessian(-motion.energy_rate, v) / 2
        whole = (sp.Matrix([v]) * matrix * sp.Matrix(v))[0]
        if matrix.free_symbols & {*v} or normal(motion.energy_rate + whole) != 0:
            return None
        at = {q: sp.Rational(x) for q, x in zip(motion.q, here.middle.tolist(), strict=True)}
        found = squares(matrix, v, motion.given, lambda pivot: bool(motion.given.at_values(pivot.subs(at)) > 0))
        if not found:
            return None
        stays = invariant_set(motion, [square.form for square in found])
        is_rest = stays.is_found and stays.equilibria and not stays.families
        return [square.coefficient for square in found] if is_rest else None

    def _pass(self, here: _Rest, rest: Sequence[_Rest]) -> float:
        """Least potential of equilibria that are no minima, those below this one left out."""
        others = [x.value for x in rest if not x.is_minimum and not x.value.high < here.value.low]
        return min((float(x.low) for x in others), default=np.inf)

    def _around(
        self, here: _Rest, rest: Sequence[_Rest], pivots: Sequence[Bound]
    ) -> tuple[dict[str, tuple[float, float]] | None, float]:
        """Box around a minimum, and what the potential is not below on its faces and at its passes."""
        names, (below, above) = [q.name for q in self.motion.q], self._reach(here, rest, pivots)
        for part in (1.0, 0.999, 0.99, 0.9):
            low, high = here.middle - part * below, here.middle + part * above
            if all(p.least(Interval(low[None], high[None]), above=0.0) > 0.0 for p in pivots):
                box = {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}
                inside = equilibria(self.motion.model, box)
                if not inside.is_complete:
                    break
                level = self._pass(here, self._rest(inside))
                return box, min(level, self.bound.least(faces(low, high), base=float(here.value.high)))
        return None, -np.inf

    def _reach(self, here: _Rest, rest: Sequence[_Rest], pivots: Sequence[Bound]) -> tuple[Array, Array]:
        """How far the box, whose coordinates grow in proportion, goes so that the potential on its faces is large."""
        usual, n = default_box(self.motion, {}), len(self.motion.q)
        away = np.array([np.abs(x.middle - here.middle) for x in rest]).reshape(-1, n)
        sides = np.array([max(1.5 * float(away[:, i].max()), usual[q.name][1]) for i, q in enumerate(self.motion.q)])
        sides = np.where([q in self.motion.circles for q in self.motion.q], np.pi * (1.0 - _INSIDE), sides)
        near = np.max(away / sides, axis=1) * (1.0 - _INSIDE)
        scales = np.unique([*np.linspace(0.0, 1.0, _SCALES + 1)[1:], *near[(near > 0.0) & (near <= 1.0)]])
        rng = np.random.default_rng(0)
        ends = []
        for sign in (-1.0, 1.0) if n == 1 else (0.0,):
            best, most = scales[0], -np.inf
            for scale in scales:
                unit = rng.uniform(-1.0, 1.0, (_SAMPLES, n))
                rows = np.arange(_SAMPLES)
                within = here.middle + scale * sides * (np.abs(unit) * sign if sign else unit)
                if any(float(np.min(self._at(p, within))) <= 0.0 for p in pivots):
                    break
                unit[rows, rows % n] = sign or np.sign(unit[rows, rows % n])
                value = float(np.min(self._at(self.bound, here.middle + scale * sides * unit)))
                best, most = (scale, value) if value > most else (best, most)
            ends.append(best * sides)
        return ends[0], ends[-1]

    def _at(self, bound: Bound, points: Array) -> Array:
        return bound.over(Interval.of(points)).low


def _down(level: float, depth: float) -> float:
    """Level of few digits that is not larger."""
    if not (np.isfinite(level) and depth > 0.0):
        return level
    unit = 10.0 ** (np.floor(np.log10(depth)) - _DIGITS + 1)
    return float(min(np.floor(level / unit) * unit, level))
