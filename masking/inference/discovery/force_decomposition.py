"""Decomposition of a force along a motion.

Which parts of its energy follow the displacement alone, the rate alone, both together, and neither; how alike it is in
the two directions; what it takes out of the motion; and where in the travel, in speed and in time it sits. Energy is
the mean square, less that of what the force may be wrong by. What follows something is found on four fifths of a
record and held against the rest, stretch by stretch in turn, so that noise follows nothing. Under one sine alone a
force with a memory is a function of displacement and rate; it takes a motion of several sizes to tell it from one.
Under periodic commands that hold odd multiples of a base only, a force that turns round with the motion has odd ones
only, and one that does not has even ones. This needs no displacement, and sees what has a memory, too.
Source: Hastie and Tibshirani (1986), Statistical Science 1(3), 297-310, for additive models; Pratt (1987), Dividing the
indivisible, for parts that add up; Masri and Caughey (1979), J. Applied Mechanics 46, 433-447, for forces over the
plane of displacement and rate; Pintelon and Schoukens, System Identification (2012), section 3.4, for harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result
from masking.inference.discovery.spline_bases import FEW, Curve, Term, pieces
from masking.inference.estimation.periodic_spectra import Spectra, by_period, repeats

MOST = 10_000  # samples that are looked at; forces change slowly beside the samples of a long record
STRETCHES, FOLDS = 100, 5  # most into which a record is cut; each fifth of them is held against the others
SIGN = 0.02  # of the largest rate: width of its sign, as the smoother rounds off what changes with the direction
STIFF = 1e-3  # of the samples of a function: what a bend weighs
CELLS = 12  # of the range of displacement and of rate: an even number has an edge at 0
FEWEST = 4  # samples in a cell
COVERED = 0.5  # part of the time that must be spent where the opposite is visited, too
SEEN = 2.0  # of its deviation's square: a mean square below is not looked at
FOLLOWS = 0.1  # part of the energy that displacement and rate must explain for a symmetry to be stated
ENDS = (0.002, 0.998)  # quantiles of a range
REPEATED = 1e-3  # of their size: commands that differ by less a period later repeat themselves
PERIODS = 3  # at least: one to settle, and two to estimate the noise
FEWEST_CYCLES = 3  # in a record, of a motion that has a frequency
NEAR, LEAKAGE = 0.1, 2  # part of a frequency, and lines on either side by leakage, that are near it
ONE = 0.7  # of the energy of a rate: a motion with more near one frequency has that

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


class Region(NamedTuple):
    """Parts of the energy and of the time that are in a region."""

    energy: float
    time: float


@dataclass(frozen=True)
class Parts(Result):
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
    json_names = ("displacement", "rate", "both", "neither", "odd", "even")

    @property
    def even(self) -> float | None:
        """Part of what follows displacement and rate that does not turn round with both."""
        return None if self.odd is None else 1.0 - self.odd


@dataclass(frozen=True)
class ForceDecomposition(Result):
    """What a force looks like."""

    rms: float
    mean: float
    deviation: float  # standard deviation of what it may be wrong by
    loss: float  # power that it takes out of the motion, its mean product with the rate
    loss_part: float  # that, as a part of the most that a force of this size can take
    energy: Parts | None  # None where it is not beyond its deviation
    regions: Mapping[str, Mapping[str, Region]]  # of travel, speed and record; none where the energy has no parts


@dataclass(frozen=True)
class Harmonics(Result):
    """Parts of the mean square of a force under periodic commands, less its noise; the first period is left out."""

    base: float  # frequency of the first multiple in Hz
    periods: int  # that are used
    only_odd: bool  # whether odd multiples alone are excited: `even` is then what does not turn round with the motion
    # excited, even, odd: parts at excited multiples, and at others that are even, 0 included, or odd; sum 1
    excited: float
    even: float
    odd: float


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
    x, force = _relative(x[every]), force[every]
    return _explained(force, _held_out([[_spring(x)]], x, x, force, stretches))


def _explained(force: Array, parts: Array) -> float:
    """Mean square that a force (m,) loses if its parts (m, c) are taken off; 0 if it gains."""
    return max(float((force**2).mean() - ((force - parts.sum(axis=1)) ** 2).mean()), 0.0)


def period(commands: Array) -> int | None:
    """Samples after which commands (m, actuators) repeat themselves exactly; None where they do not."""
    moving = commands[:, np.ptp(commands, axis=0) > 0.0]
    return repeats(moving, REPEATED) if moving.size else None


def harmonics(commands: Array, force: Array, length: int, rate: float) -> Harmonics | None:
    """Harmonics of a force; None under three periods, or where they are no more than noise.

    Args:
        commands: that are periodic (m, actuators).
        force: along them (m,).
        length: samples of a period.
        rate: samples per second.
    """
    if len(force) < PERIODS * length:
        return None
    tables = commands[None, :, np.ptp(commands, axis=0) > 0.0], force[None, :, None]
    found = Spectra(rate, length, *(by_period(table, length) for table in tables))
    spectrum = found.outputs[0, :, :, 0]
    power = np.abs(spectrum.mean(axis=0)) ** 2 - spectrum.var(axis=0, ddof=1) / found.periods
    power[0] *= 2.0  # the mean square of a sine is half of its amplitude squared, that of a constant all of it
    excited, is_even = np.isin(np.arange(len(power)), found.excited), np.arange(len(power)) % 2 == 0
    parts = np.array([max(float(power[at].sum()), 0.0) for at in (excited, ~excited & is_even, ~excited & ~is_even)])
    whole = float(parts.sum())
    if not whole > 0.0:
        return None
    return Harmonics(found.base, found.periods, bool((found.excited % 2 == 1).all()), *(parts / whole).tolist())


def cycle(rate: Array, sampling: float) -> float | None:
    """Frequency of a motion in Hz, where most of the energy of its rate (m,) is near one; None of others."""
    power = np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate)))) ** 2
    power[0] = 0.0
    at, lines = int(np.argmax(power)), np.arange(len(power))
    near = np.abs(lines - at) <= max(NEAR * at, LEAKAGE)
    if at < FEWEST_CYCLES or not float(power[near].sum()) > ONE * float(power.sum()) > 0.0:
        return None
    return float((lines * power)[near].sum() / power[near].sum() * sampling / len(rate))


def _parts(x: Array, rate: Array, force: Array, energy: float, stretches: Indices) -> Parts:
    x, rate = _relative(x), _relative(rate)
    curve, turn = _spring(x), Term("free_friction", (), SIGN)
    sides = (Curve(pieces(x, FEW, beside=0)), Curve(pieces(rate, FEW, beside=0)))
    together = [Term("free_surface", sides), Term("free_rub", (Curve(pieces(x, FEW)),), SIGN)]
    alone = _held_out([[curve], [Term("free_damping", (Curve(pieces(rate)),)), turn]], x, rate, force, stretches)
    each = (force[:, None] * alone).mean(axis=0).clip(0.0)
    explained = _explained(force, alone)
    residual = force - alone.sum(axis=1) if explained else force
    both = _explained(residual, _held_out([together], x, rate, residual, stretches))
    found = np.array([*(explained * each / (float(each.sum()) or 1.0)), both]) / energy
    found /= max(1.0, float(found.sum()))
    neither = max(0.0, 1.0 - float(found.sum()))
    odd = _odd(x, rate, force, FOLLOWS * energy, stretches % 2 == 0) if neither < 1.0 - FOLLOWS else None
    return Parts(float(found[0]), float(found[1]), float(found[2]), neither, odd)


def _odd(x: Array, rate: Array, force: Array, least: float, half: Mask) -> float | None:
    """Which part of the means over cells of displacement and rate turns round with both."""
    reach = [(-high, high) for high in (max(float(np.quantile(np.abs(v), ENDS[1])), 1e-300) for v in (x, rate))]

    def sums(of: Array) -> Array:
        each = (np.histogram2d(x[h], rate[h], CELLS, reach, weights=of[h])[0] for h in (half, ~half))
        return np.array(list(each))

    many = sums(np.ones_like(x))
    # The cell at the other side of the origin is turned in both directions.
    weights = many.sum(axis=0) * (np.minimum(many, many[:, ::-1, ::-1]) >= FEWEST).all(axis=0)
    if weights.sum() < COVERED * len(x):
        return None
    means = sums(force) / np.maximum(many, 1.0)
    # Their noise differs from half to half, so that it does not count in the product.
    up, down = (
        max(float((weights * np.prod(0.5 * (means + way * means[:, ::-1, ::-1]), axis=0)).sum() / len(x)), 0.0)
        for way in (-1.0, 1.0)
    )
    return up / (up + down) if up + down > least else None


def _regions(x: Array, rate: Array, energy: Array) -> dict[str, dict[str, Region]]:
    """Parts of the energy and of the time in thirds of the travel and the record, and halves by speed."""
    low, high = np.quantile(x, ENDS)
    kinds = {
        "displacement": (("low", "middle", "high"), np.digitize(x, np.linspace(low, high, 4)[1:3])),
        "speed": (("slow", "fast"), np.abs(rate) > np.median(np.abs(rate))),
        "record": (("first", "middle", "last"), np.arange(len(x)) * 3 // len(x)),
    }
    whole = float(energy.sum())

    def region(inside: Mask) -> Region:
        return Region(min(max(float(energy[inside].sum()) / whole, 0.0), 1.0), float(inside.mean()))

    return {kind: {n: region(at == i) for i, n in enumerate(names)} for kind, (names, at) in kinds.items()}


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


def _relative(x: Array) -> Array:
    """Values in parts of the largest."""
    return x / (float(np.abs(x).max()) or 1.0)


def _spring(x: Array) -> Term:
    return Term("free_spring", (Curve(pieces(x)),))


def _held_out(parts: Sequence[Sequence[Term]], x: Array, rate: Array, values: Array, stretches: Indices) -> Array:
    """Values (m,) by terms that are fitted without them, of each part of several terms (m, parts).

    A constant is in the first part alone. The bends of the terms weigh a little, so that curves go on straight where
    there are no samples. Of the stretches of the record, each fifth is left out in turn.
    Source: Eilers and Marx (1996), Statistical Science 11(2), 89-121, for the weight.
    """
    each = [np.hstack([term.values(x, rate) for term in terms]) for terms in parts]
    each[1:] = [part - part.mean(axis=0) for part in each[1:]]
    rows, ends = np.hstack(each), np.cumsum([part.shape[1] for part in each])[:-1]
    bends = linalg.block_diag(*(term.roughness() for terms in parts for term in terms))
    folds = [stretches % FOLDS == i for i in range(FOLDS)]
    sums = [(rows[fold].T @ rows[fold], rows[fold].T @ values[fold]) for fold in folds]
    matrix = sum(m for m, _ in sums) + STIFF * len(rows) / rows.shape[1] * bends
    right = sum(r for _, r in sums)
    found = np.zeros((len(rows), len(parts)))
    for fold, (its_matrix, its_right) in zip(folds, sums, strict=True):
        factors = decompositions.inverse(matrix - its_matrix, 1e-9, hermitian=True) @ (right - its_right)
        split = zip(each, np.split(factors, ends), strict=True)
        found[fold] = np.column_stack([part[fold] @ its for part, its in split])
    return found
