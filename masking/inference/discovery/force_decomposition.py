"""Decomposition of a force along a motion.

Which parts of its energy follow the displacement alone, the rate alone, both together, and neither; how alike it is in
the two directions; what it takes out of the motion; and where in the travel, in speed and in time it sits. Energy is
the mean square, less that of what the force may be wrong by. What follows something is found on four fifths of a
record and held against the rest, stretch by stretch in turn, so that noise follows nothing. Under one sine alone a
force with a memory is a function of displacement and rate; it takes a motion of several sizes to tell it from one.
Source: Hastie and Tibshirani (1986), Statistical Science 1(3), 297-310, for additive models; Pratt (1987), Dividing the
indivisible, for parts that add up; Masri and Caughey (1979), J. Applied Mechanics 46, 433-447, for forces over the
plane of displacement and rate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.display.json_text import plain

MOST = 10_000  # samples that are looked at; forces change slowly beside the samples of a long record
STRETCHES, FOLDS = 100, 5  # most into which a record is cut; each fifth of them is held against the others
KNOTS, FEW = 17, 9  # of the straight pieces of a curve over a range, and of a surface
NARROW = 0.02  # of the largest rate: as far from rest there are two more knots, for what changes with the direction
STIFF = 1e-3  # of the samples of a piece: what a bend weighs
CELLS = 12  # of the range of displacement and of rate: an even number has an edge at 0
FEWEST = 4  # samples in a cell
COVERED = 0.5  # part of the time that must be spent where the opposite is visited, too
SEEN = 2.0  # of its deviation's square: a mean square below is not looked at
FOLLOWS = 0.1  # part of the energy that displacement and rate must explain for a symmetry to be stated
ENDS = (0.002, 0.998)  # quantiles of a range

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


class Region(NamedTuple):
    """Parts of the energy and of the time that are in a region."""

    energy: float
    time: float


@dataclass(frozen=True)
class Parts:
    """Parts of the energy of a force that follow its displacement, its rate, both together and neither; sum 1.

    What follows the displacement alone gives back what it takes. What follows neither has a memory, changes with time,
    or is of another place. `odd` is the part of what follows displacement and rate that turns round with both, such as
    friction and cubic springs; the rest does not, such as offsets and quadratic springs, and half of the energy of
    contact on one side. It is None where the opposite of the motion is not visited, or where the force follows neither.
    """

    displacement: float
    rate: float
    both: float
    neither: float
    odd: float | None

    def as_dict(self) -> dict[str, Any]:
        """Parts as JSON can hold them."""
        return {**vars(self), "even": None if self.odd is None else 1.0 - self.odd}


@dataclass(frozen=True)
class ForceDecomposition:
    """What a force looks like."""

    size: float  # its root mean square
    mean: float  # its mean
    deviation: float  # standard deviation of what it may be wrong by
    loss: float  # power that it takes out of the motion, its mean product with the rate
    taken: float  # that, as a part of the most that a force of this size can take
    parts: Parts | None  # of its energy; None where it is not beyond its deviation
    regions: Mapping[str, Mapping[str, Region]]  # of travel, speed and record; none where parts are None

    def as_dict(self) -> dict[str, Any]:
        """Decomposition as JSON can hold it."""
        return {
            "rms": self.size,
            "mean": self.mean,
            "deviation": self.deviation,
            "loss": self.loss,
            "loss_part": self.taken,
            "energy": plain(self.parts),
            "regions": plain(self.regions),
        }


def decompose(
    x: Array, rate: Array, force: Array, deviation: float = 0.0, cycle: int | None = None
) -> ForceDecomposition:
    """Decomposition of a force along a motion.

    Args:
        x: displacement (m,).
        rate: of it (m,).
        force: positive where it acts against a positive displacement, as k x of a spring (m,).
        deviation: standard deviation of what the force may be wrong by, in its unit.
        cycle: samples after which the motion repeats itself, if it does: what is held out is not seen a cycle later.
    """
    every, stretches = _thinned(x, cycle)
    x, rate, force = x[every], rate[every], force[every]
    size, loss = _rms(force), float((force * rate).mean())
    most, parts, regions = size * _rms(rate), None, {}
    if math.isfinite(size) and size > math.sqrt(SEEN) * deviation:
        # In any unit, squares are neither too large nor too small.
        relative, rest = force / size, (deviation / size) ** 2
        parts = _parts(x, rate, relative, 1.0 - rest, stretches)
        regions = _regions(x, rate, relative**2 - rest)
    return ForceDecomposition(size, float(force.mean()), deviation, loss, loss / most if most else 0.0, parts, regions)


def _rms(values: Array) -> float:
    """Root mean square, also of numbers whose squares overflow or vanish."""
    scale = float(np.abs(values).max())
    return scale * float(np.sqrt(((values / scale) ** 2).mean())) if 0.0 < scale < math.inf else scale


def followed(x: Array, force: Array, cycle: int | None = None) -> float:
    """Mean square of the part of a force (m,) that is a function of x (m,); the cycle is that of `decompose`."""
    every, stretches = _thinned(x, cycle)
    x, force = x[every], force[every]
    rows, bend = _curve(x, _knots(x))
    return _explained(force, _held_out(rows, bend, force, stretches)[:, 0])


def _explained(force: Array, part: Array) -> float:
    """Mean square that a force loses if its explained part is taken off; 0 if it gains."""
    return max(float((force**2).mean() - ((force - part) ** 2).mean()), 0.0)


def _parts(x: Array, rate: Array, force: Array, energy: float, stretches: Indices) -> Parts:
    (of_x, bend_x), (of_rate, bend_rate) = _curve(x, _knots(x)), _curve(rate, _knots_of_rate(rate))
    split = of_x.shape[1]
    alone = _held_out(np.hstack([of_x, of_rate]), linalg.block_diag(bend_x, bend_rate), force, stretches, split)
    if np.ptp(x) == 0.0:  # of a displacement that is not known, the force follows none but a constant
        total = alone.sum(axis=1)
        alone = np.column_stack([np.full(len(x), total.mean()), total - total.mean()])
    mean = float(alone[:, 1].mean())  # a constant gives back what it takes
    each = np.array([(force * (alone[:, 0] + mean)).mean(), (force * (alone[:, 1] - mean)).mean()]).clip(0.0)
    explained = _explained(force, alone.sum(axis=1))
    residual = force - alone.sum(axis=1) if explained else force
    both = _explained(residual, _held_out(*_surface(x, rate), residual, stretches)[:, 0])
    found = np.array([*(explained * each / (float(each.sum()) or 1.0)), both]) / energy
    found /= max(1.0, float(found.sum()))
    neither = max(0.0, 1.0 - float(found.sum()))
    odd = _odd(x, rate, force, FOLLOWS * energy, stretches % 2 == 0) if neither < 1.0 - FOLLOWS else None
    return Parts(float(found[0]), float(found[1]), float(found[2]), neither, odd)


def _odd(x: Array, rate: Array, force: Array, least: float, half: Mask) -> float | None:
    """Which part of the means over cells of displacement and rate turns round with both."""
    at = _cells(x, *_around(x)) * CELLS + _cells(rate, *_around(rate))
    sums = np.array([np.bincount(at[h], force[h], CELLS**2) for h in (half, ~half)])
    many = np.array([np.bincount(at[h], minlength=CELLS**2) for h in (half, ~half)])
    # The cell at the other side of the origin has the last number less this one.
    weights = many.sum(axis=0) * (np.minimum(many, many[:, ::-1]) >= FEWEST).all(axis=0)
    if weights.sum() < COVERED * len(x):
        return None
    means = sums / np.maximum(many, 1)
    odd, even = 0.5 * (means - means[:, ::-1]), 0.5 * (means + means[:, ::-1])
    # Their noise differs from half to half, so that it does not count in the product.
    up, down = (max(float((weights * side[0] * side[1]).sum() / len(x)), 0.0) for side in (odd, even))
    return up / (up + down) if up + down > least else None


def _regions(x: Array, rate: Array, energy: Array) -> dict[str, dict[str, Region]]:
    """Parts of the energy and of the time in thirds of the travel and the record, and halves by speed."""
    low, high = np.quantile(x, ENDS)
    third = np.clip(np.floor(3.0 * (x - low) / max(high - low, 1e-300)), 0, 2)
    is_fast = np.abs(rate) > np.median(np.abs(rate))
    when = np.arange(len(x)) * 3 // len(x)
    whole = float(energy.sum())

    def region(inside: Mask) -> Region:
        return Region(min(max(float(energy[inside].sum()) / whole, 0.0), 1.0), float(inside.mean()))

    return {
        "displacement": {name: region(third == i) for i, name in enumerate(("low", "middle", "high"))},
        "speed": {"slow": region(~is_fast), "fast": region(is_fast)},
        "record": {name: region(when == i) for i, name in enumerate(("first", "middle", "last"))},
    }


def _thinned(x: Array, cycle: int | None) -> tuple[slice, Indices]:
    """Which samples are looked at, and of which stretch of the record, or of a cycle, each is.

    A stretch is about a swing of the motion (m,) or more: shorter ones would be known from those beside them.
    """
    step = max(1, len(x) // MOST)
    kept = np.arange(-(-len(x) // step))
    each = max(1, cycle // step) if cycle else len(kept)
    turns = np.sign(np.diff(x[: each * step : step]))
    swings = int(np.count_nonzero(np.diff(turns[turns != 0.0]))) // 2
    many = min(max(swings, 2 * FOLDS), STRETCHES)
    return slice(None, None, step), kept % each * many // each


def _knots(x: Array, many: int = KNOTS) -> Array:
    low, high = float(x.min()), float(x.max())
    return np.linspace(low, high, many) if high > low else np.array([low])


def _knots_of_rate(rate: Array, many: int = KNOTS) -> Array:
    high = float(np.abs(rate).max()) or 1.0
    return np.sort(np.append(np.linspace(-high, high, many), [-NARROW * high, NARROW * high]))


def _around(x: Array) -> tuple[float, float]:
    high = max(float(np.quantile(np.abs(x), ENDS[1])), 1e-300)
    return -high, high


def _curve(x: Array, knots: Array) -> tuple[Array, Array]:
    """Functions that a curve over x is made of (m, functions), and what its bends weigh.

    Straight pieces, whose bends weigh a little, and a square and a cube, which weigh nothing: where there are few
    samples, at the ends of the travel, the curve goes on as these.
    """
    many, every = len(knots), np.arange(len(x))
    if many < 3:
        return np.ones((len(x), 1)), np.zeros((1, 1))
    rows = np.zeros((len(x), many + 2))
    at = np.clip(np.searchsorted(knots, x) - 1, 0, many - 2)
    part = (x - knots[at]) / (knots[at + 1] - knots[at])
    rows[every, at], rows[every, at + 1] = 1.0 - part, part
    middle, half = 0.5 * (knots[0] + knots[-1]), 0.5 * (knots[-1] - knots[0])
    rows[:, many] = ((x - middle) / half) ** 2
    rows[:, many + 1] = ((x - middle) / half) ** 3
    slopes = np.diff(np.eye(many), axis=0) / np.diff(knots)[:, None]
    turns = np.diff(slopes, axis=0) * 2.0 * half / (many - 1)
    bend = np.zeros((many + 2, many + 2))
    bend[:many, :many] = turns.T @ turns
    return rows, bend


def _surface(x: Array, rate: Array) -> tuple[Array, Array]:
    """Functions that a surface over x and rate is made of (m, functions), and what its bends weigh."""
    (of_x, bend_x), (of_rate, bend_rate) = _curve(x, _knots(x, FEW)), _curve(rate, _knots_of_rate(rate, FEW))
    if min(of_x.shape[1], of_rate.shape[1]) < 3:
        return np.ones((len(x), 1)), np.zeros((1, 1))
    hats, across = of_x[:, :-2], of_rate[:, :-2]
    products = (hats[:, :, None] * across[:, None, :]).reshape(len(x), -1)
    bend = np.kron(bend_x[:-2, :-2], np.eye(across.shape[1])) + np.kron(np.eye(hats.shape[1]), bend_rate[:-2, :-2])
    a, b = x / (np.abs(x).max() or 1.0), rate / (np.abs(rate).max() or 1.0)
    rows = np.column_stack([products, a * b, a**2 * b, a * b**2])
    return rows, linalg.block_diag(bend, np.zeros((3, 3)))


def _held_out(rows: Array, bend: Array, values: Array, stretches: Indices, split: int | None = None) -> Array:
    """Values (m,) by functions that are fitted without them, of the columns before and after a split (m, 2).

    The functions (m, functions) have bends that weigh a little, so that curves go on straight where there are no
    samples. Of the stretches of the record, each fifth is left out in turn.
    Source: Eilers and Marx (1996), Statistical Science 11(2), 89-121, for the weight.
    """
    folds = [stretches % FOLDS == i for i in range(FOLDS)]
    each = [(rows[fold].T @ rows[fold], rows[fold].T @ values[fold]) for fold in folds]
    weight = STIFF * len(rows) / rows.shape[1] * bend
    matrix, right = sum(m for m, _ in each) + weight, sum(r for _, r in each)
    found = np.zeros((len(rows), 2))
    for fold, (its_matrix, its_right) in zip(folds, each, strict=True):
        heights = decompositions.inverse(matrix - its_matrix, 1e-9, hermitian=True) @ (right - its_right)
        found[fold, 0] = rows[fold, :split] @ heights[:split]
        if split is not None:
            found[fold, 1] = rows[fold, split:] @ heights[split:]
    return found


def _cells(x: Array, low: float, high: float) -> Indices:
    return np.clip((CELLS * (x - low) / max(high - low, 1e-300)).astype(np.intp), 0, CELLS - 1)
