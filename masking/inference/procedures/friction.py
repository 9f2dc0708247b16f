"""Friction: how far it shifts the equilibrium, and where over the displacement it sits.

Source: Rijlaarsdam (2008), appendix C.6.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike
from scipy import optimize

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, minimise_residuals
from masking.errors import ModelError, RecordError
from masking.inference.procedures.channel_names import TURNED, columns, directions, part_of, refuse_one_way, turns
from masking.inference.procedures.springs import SLIDING, elements, thinned

THINNED = 20000  # points at most, to which a record is averaged in time before its gap is taken
END_PART = 0.05  # of the travel: a step nearer to an end may be what settles after the turn


@dataclass(frozen=True)
class EquilibriumShift:
    """How far the equilibrium shifts in saw-teeth of force, against how far they moved.

        delta = constant + growth theta,   theta = (max x - min x) / 2

    Dry friction shifts the equilibrium by the same however far the motion went, hysteresis by more after longer travel.
    """

    travel: Array  # theta of each tooth (teeth,)
    shift: Array  # delta, between its two passages of zero force (teeth,)
    constant: float  # delta of the shortest travel, extrapolated to none
    growth: float  # delta per travel
    covariance: Array  # of (constant, growth) (2, 2)
    stiffness: float  # slope of force over displacement where the force is zero

    @property
    def friction(self) -> float:
        """Dry friction that the constant part stands for: half of it times the stiffness."""
        return 0.5 * self.constant * self.stiffness

    @property
    def friction_deviation(self) -> float:
        """Standard deviation of `friction`, of a known stiffness."""
        return 0.5 * self.stiffness * float(np.sqrt(self.covariance[0, 0]))


@dataclass(frozen=True)
class LocatedFriction:
    """Where over the displacement a friction force begins.

        h = level + viscous |v| + hysteresis + step (1 + tanh(side (x - edge) / width)) / 2

    h(x) is half the gap between the way up and the way down.
    """

    is_found: bool  # True where the step is larger than chance and than `level` explain; else the rest is no finding
    edge: float  # displacement at which half of the step is reached
    # standard deviation of the edge by scatter, at most the travel; a friction that depends on speed shifts the edge by
    # a part of the width beside that
    deviation: float
    side: int  # 1: the friction is beyond the edge upwards, -1: downwards
    step: float  # friction force that is added there
    step_deviation: float  # standard deviation of the step
    level: float  # friction force elsewhere
    viscous: float  # force per speed
    width: float  # over which it begins
    displacement: Array  # middle of each bin (bins,)
    half_gap: Array  # half the force between the way up and down in each bin (bins,)
    fitted: Array  # what the formula gives (bins,)


def shift_of_equilibrium(times: ArrayLike, displacement: ArrayLike, force: ArrayLike) -> EquilibriumShift:
    """Measure how far saw-teeth of growing force shift the equilibrium, and what of it is dry friction.

    Each tooth goes from zero to one side, to the other, and back. Its shift is the displacement between its passages of
    zero force on the way back from either side. The record must be slow; viscous forces at its speed count as friction
    where all teeth move equally fast, and as growth where longer ones are faster. Times are in equal steps, s.
    Source: Rijlaarsdam (2008), appendix C.6.2, figure C.6.

    Raises:
        RecordError: columns cannot be used, a tooth does not pass zero, or there are fewer than three teeth whose
            travels differ by a factor of two.
    """
    _, x, f = columns(times=times, displacement=displacement, force=force)
    inner = turns(f, part_of(f, TURNED))[1:-1]
    ends = [*inner, len(f) - 1]
    rows = []
    for k in range(0, len(inner) - 1, 2):
        first, second, last = ends[k], ends[k + 1], ends[k + 2]
        amplitude = 0.5 * abs(f[first] - f[second])
        back = _at_zero(x, f, first, second, amplitude)
        again = _at_zero(x, f, second, last, amplitude)
        if back is None or again is None:
            raise RecordError(
                f"the force does not pass zero between the samples {first} and {last} (counted from 0); let each tooth "
                "go to both sides and come back to zero"
            )
        rows.append((0.5 * abs(x[first] - x[second]), abs(back[0] - again[0]), 0.5 * (back[1] + again[1])))
    if len(rows) < 3 or max(r[0] for r in rows) < 2.0 * min(r[0] for r in rows):
        raise RecordError(
            f"{len(rows)} saw-teeth were found; at least 3 are needed whose travels differ by a factor of two: let the "
            "force go to both sides with growing amplitude"
        )
    travel, shift, compliance = (np.array(column) for column in zip(*rows, strict=True))
    design = np.column_stack([np.ones(len(travel)), travel])
    found, *_ = np.linalg.lstsq(design, shift, rcond=None)
    power = float(np.sum((shift - design @ found) ** 2)) / (len(shift) - 2)
    covariance = power * np.linalg.inv(design.T @ design)
    stiffness = float(1.0 / np.median(compliance))
    return EquilibriumShift(travel, shift, float(found[0]), float(found[1]), covariance, stiffness)


def locate_friction(times: ArrayLike, displacement: ArrayLike, force: ArrayLike, *, bins: int = 100) -> LocatedFriction:
    """Find where over the displacement a friction force begins, from slow ramps or saw-teeth of force.

    Half the gap between the way up and the way down is taken bin by bin, which leaves the spring out whatever its
    curve. Level, viscous force, elements of hysteresis and one step are fitted to it, none of them negative. A step
    counts as found where it is larger than five of its standard deviations and than the level elsewhere, and not within
    a twentieth of the travel from an end, where what settles after the turn looks alike.
    Source: Rijlaarsdam (2008), appendix C.6.2, figure C.5.

    Args:
        times: s (samples,), in equal steps.
        displacement: (samples,), which must go beyond the place by a twentieth of the travel.
        force: (samples,).
        bins: over the travel.

    Raises:
        RecordError: columns cannot be used, or the motion goes in one direction only.
        ModelError: there are too few bins.
    """
    if isinstance(bins, bool) or not isinstance(bins, int) or bins < 40:
        raise ModelError(f"bins is {bins!r}; give a whole number of at least 40")
    t, x, f = columns(times=times, displacement=displacement, force=force)
    direction = directions(f)
    refuse_one_way(x, direction)
    t, x, f, direction = (thinned(column, THINNED) for column in (t, x, f, direction))
    kept = np.abs(direction) == 1.0  # a stretch in which the force turns belongs to neither way
    sources = np.column_stack([f, np.gradient(x, t), elements(x, np.array(SLIDING) * float(np.ptp(x)))])
    middles, gaps = _half_gaps(x[kept], sources[kept], direction[kept], bins)
    gap = gaps[:, 0]
    known = np.column_stack([np.ones(len(gap)), gaps[:, 1:]])
    size = middles[1] - middles[0]

    def residuals(side: int, p: Array) -> Array:
        rows = np.column_stack([known, _step(p, middles, side)])
        return np.asarray(gap - rows @ _not_negative(rows, gap))

    starts = [(side, np.array([edge, 2.0 * size])) for side in (1, -1) for edge in middles[4:-4]]
    side, start = min(starts, key=lambda s: float(np.sum(residuals(*s) ** 2)))
    box = Box(np.array([middles[0], 0.1 * size]), np.array([middles[-1], 0.1 * (middles[-1] - middles[0])]))
    fit = minimise_residuals(partial(residuals, side), start, box, sizes=np.full(2, size), rounds=200)
    rows = np.column_stack([known, _step(fit.x, middles, side)])
    weights = _not_negative(rows, gap)
    used = rows[:, weights > 0.0]
    power = fit.at.cost / (len(gap) - used.shape[1] - 2)
    apart = 1e-4 * size * np.eye(2)
    slopes = [weights[-1] * (_step(fit.x + h, middles, side) - _step(fit.x - h, middles, side)) for h in apart]
    jacobian = np.column_stack([*(slope / (2e-4 * size) for slope in slopes), used])
    deviations = np.sqrt(np.maximum(np.diag(power * np.linalg.pinv(jacobian.T @ jacobian)), 0.0))
    ends = np.array([x.min(), x.max()])
    step, error = float(weights[-1]), float(deviations[-1])
    return LocatedFriction(
        is_found=step > max(5.0 * error, float(weights[0])) and np.abs(fit.x[0] - ends).min() > END_PART * np.ptp(ends),
        edge=float(fit.x[0]), deviation=min(float(deviations[0]), float(np.ptp(x))), side=side, step=step,
        step_deviation=error, level=float(weights[0]), viscous=float(weights[1]), width=float(fit.x[1]),
        displacement=middles, half_gap=gap, fitted=np.asarray(rows @ weights),
    )  # fmt: skip


def _at_zero(x: Array, f: Array, first: int, last: int, amplitude: float) -> tuple[float, float] | None:
    """Displacement where the force is zero on one way, and displacement per force there."""
    force, moved = f[first : last + 1], x[first : last + 1]
    if force.min() > 0.02 * amplitude or force.max() < -0.02 * amplitude:
        return None
    near = np.abs(force) <= 0.1 * amplitude
    if np.count_nonzero(near) < 6:
        near = np.isin(np.arange(len(force)), np.argsort(np.abs(force))[:6])
    found = polynomial.polyfit(force[near] / amplitude, moved[near], 2)
    return float(found[0]), float(found[1] / amplitude)


def _half_gaps(x: Array, values: Array, direction: Array, bins: int) -> tuple[Array, Array]:
    """Middles of bins of displacement, and half the gap of each column between the ways up and down there.

    Each way is averaged in bins, and both are interpolated to the same displacements (bins, columns).
    """
    edges = np.linspace(x.min(), x.max(), bins + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    ways = []
    for sign in (1.0, -1.0):
        chosen = direction == sign
        where = np.clip(np.digitize(x[chosen], edges) - 1, 0, bins - 1)
        count = np.bincount(where, minlength=bins)
        full = count > 0
        table = np.column_stack([x[chosen], values[chosen]])
        means = np.column_stack([np.bincount(where, column, minlength=bins) for column in table.T])
        ways.append(means[full] / count[full, None])
    start, end = max(way[0, 0] for way in ways), min(way[-1, 0] for way in ways)
    middles = middles[(middles >= start) & (middles <= end)]
    up, down = (np.column_stack([np.interp(middles, way[:, 0], c) for c in way[:, 1:].T]) for way in ways)
    return middles, np.asarray(0.5 * (up - down))


def _step(p: Array, x: Array, side: int) -> Array:
    """Step from 0 to 1 at p[0] of the width p[1] (bins,)."""
    return np.asarray(0.5 * (1.0 + np.tanh(side * (x - p[0]) / p[1])))


def _not_negative(rows: Array, values: Array) -> Array:
    """Weights of columns, none of them negative, that come nearest to values in least squares."""
    sizes = np.maximum(np.abs(rows).max(axis=0), 1e-300)
    return np.asarray(optimize.nnls(rows / sizes, values)[0] / sizes)
