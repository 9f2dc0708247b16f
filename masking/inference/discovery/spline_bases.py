"""Spline bases: cubic B-splines over displacement and rate, as effects that a fit puts at a place in any number.

The parts of a latent force are fitted in them, too. A curve is a sum of B-splines with one factor each; a surface is
one of curves over the displacement, times functions of the rate, or of products. A bend that the motion does not visit
is held at zero, so that curves go on straight there.
Source: de Boor (2001), A Practical Guide to Splines, chapter 9; Eilers and Marx (1996), Statistical Science 11(2),
89-121, for the penalty on bends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.compiled_laws import BASES

PIECES = 18  # of a curve over a range
FEW = 8  # of each side of a surface, and of a curve that is a factor
BESIDE = 2  # further pieces on both sides of the range
MARGIN = 0.06  # of the range: as far beyond it on both sides these begin
STRAIGHT = 1e3  # times: weight of a bend at an end
DENSER = 1.5  # power of the spacing of pieces around rest, where laws have corners


def pieces(x: Array, many: int = PIECES, *, is_even: bool = False, beside: int = BESIDE) -> Array:
    """Points between the pieces of a curve over the range of x (many + 2 beside + 1,), denser around 0 if not even.

    There are `many` pieces of the range, and `beside` further ones on both sides of it.
    """
    low, high = float(x.min()), float(x.max())
    pad = MARGIN * (high - low or 1.0)  # also around a motion that stands still
    low, high = low - pad, high + pad
    if low < 0.0 < high and not is_even:
        reach = max(-low, high)
        first, last = (np.sign(end) * (abs(end) / reach) ** (1.0 / DENSER) for end in (low, high))
        even = np.linspace(first, last, many + 1)
        found = reach * np.sign(even) * np.abs(even) ** DENSER
    else:
        found = np.linspace(low, high, many + 1)
    before, after = found[0] - found[1], found[-1] - found[-2]
    ahead = np.arange(1, beside + 1)
    return np.concatenate([found[0] + before * ahead[::-1], found, found[-1] + after * ahead])


@dataclass(frozen=True)
class Curve:
    """A cubic spline with straight ends over points (p,), as a sum of p + 2 B-splines."""

    points: Array

    def knots(self, beyond: int = 3) -> Array:
        """Points with some more on both sides."""
        first, last = self.points[1] - self.points[0], self.points[-1] - self.points[-2]
        ahead = np.arange(1, beyond + 1)
        return np.concatenate([self.points[0] - first * ahead[::-1], self.points, self.points[-1] + last * ahead])

    @property
    def size(self) -> int:
        """Number of B-splines."""
        return len(self.points) + 2

    def values(self, x: Array, derivative: int = 0) -> Array:
        """B-splines at x, or a derivative of them (m, p + 2)."""
        alone = np.pad(np.eye(self.size), ((3, 3), (0, 0)))  # further ones of no weight: each is whole
        return np.nan_to_num(BSpline(self.knots(6), alone, 3, extrapolate=False)(x, derivative))

    def bends(self) -> Array:
        """Second derivative at each point times the distance of its neighbours squared (p, p + 2).

        Those of the ends count so much that they are 0: there the curve goes on straight.
        """
        apart = np.diff(self.points)
        near = np.concatenate([apart[:1], 0.5 * (apart[1:] + apart[:-1]), apart[-1:]])
        found = self.values(self.points, 2) * near[:, None] ** 2
        found[[0, -1]] *= STRAIGHT
        return np.asarray(found)

    def parameters(self) -> list[tuple[float, ...]]:
        """Five knots of each B-spline."""
        return [*map(tuple, np.lib.stride_tricks.sliding_window_view(self.knots(), 5).tolist())]


@dataclass(frozen=True)
class Term:
    """A part of a law: curves over displacement or rate, alone or multiplied."""

    kind: str  # name of its basis
    curves: tuple[Curve, ...] = ()  # over displacement, rate, or both in this order
    sharp: float = 0.0  # rate below which the sign of the rate is smooth
    unit: float = 1.0  # size of what a curve is multiplied by

    def values(self, x: Array, rate: Array) -> Array:
        """Functions along a motion (m, f)."""
        turned = np.tanh(rate / self.sharp) if self.sharp else rate
        match self.kind:
            case "free_spring":
                return self.curves[0].values(x)
            case "free_damping":
                return self.curves[0].values(rate)
            case "free_friction":
                return turned[:, None]
            case "free_surface":
                a, b = self.curves[0].values(x), self.curves[1].values(rate)
                return np.asarray((a[:, :, None] * b[:, None, :]).reshape(len(x), -1))
            case _:  # a curve over the displacement times the rate, or its sign
                return np.asarray(self.curves[0].values(x) * turned[:, None])

    @property
    def size(self) -> int:
        """Number of factors."""
        return int(np.prod([curve.size for curve in self.curves]))

    def roughness(self) -> Array:
        """Sum of the squares of bends as a form of the factors (f, f)."""
        if not self.curves:
            return np.zeros((1, 1))
        if len(self.curves) == 1:
            bends = self.curves[0].bends()
        else:
            a, b = (curve.bends() for curve in self.curves)
            bends = np.vstack([np.kron(a, np.eye(b.shape[1])), np.kron(np.eye(a.shape[1]), b)])
        return np.asarray(bends.T @ bends)

    def instances(self, at: str, factors: Array) -> list[EffectInstance]:
        """Term as effects at a place, with their factors (f,) free."""
        entry = BASES[self.kind]
        match self.kind:
            case "free_friction":
                shapes: list[tuple[float, ...]] = [(self.sharp,)]
            case "free_surface":
                shapes = [(*a, *b) for a in self._even(0) for b in self._even(1)]
            case "free_rub":
                shapes = [(*one, self.sharp) for one in self._even(0)]
            case _:
                shapes = self.curves[0].parameters()
        pairs = zip(factors, shapes, strict=True)
        return [EffectInstance(entry.name, at, (float(factor), *shape), (0,), entry) for factor, shape in pairs]

    def _even(self, number: int) -> list[tuple[float, float]]:
        return [(five[2], five[3] - five[2]) for five in self.curves[number].parameters()]
