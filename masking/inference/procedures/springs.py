"""Springs: force over displacement from a slow ramp, with friction and hysteresis distinguished from it.

Source: Rijlaarsdam (2008), section 4.2.3 and Table B.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike
from scipy import optimize, special

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, RecordError
from masking.inference.procedures import channel_names as motion

POINTS = 3000  # at most, to which a record is averaged in time before a curve is fitted
BATCHES = 48  # stretches of the record that count as independent of each other in the covariance of a curve
SLIDING = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)  # of the travel, where elements slide whose sum is hysteresis
# A ramp is too fast where forces of inertia or damping take more than these parts of the force,
INERTIA_PART, VISCOUS_PART = 0.01, 0.05
SEEN = 0.05  # and explain this part of the power that springs and friction leave
# Speed that is alike to this part in each direction cannot be distinguished from friction: the ramp is then slow.
APART_PART = 0.1
UNEXPLAINED_PART = 0.25  # of the force: a record is too short where friction and noise are more


@dataclass(frozen=True)
class SpringCurve:
    """Force of a spring over its displacement, and what comes on top of it in each direction.

    f / force_scale = sum_j rho_j (x / scale)^j                                                  (4.14), Table B.4
    """

    coefficients: Array  # rho (order + 1,), without unit
    covariance: Array  # of the coefficients (order + 1, order + 1)
    scale: float  # unit of displacement in which the coefficients are, such as 5e-3 m
    force_scale: float  # unit of force in which they are, such as 0.42 V
    lowest: float  # least displacement that was reached
    highest: float  # largest displacement that was reached
    # force against the motion that is there as soon as it turns; viscous forces at the speed of the ramp are part of it
    friction: float
    hysteresis: float  # force against the motion that builds up after it turned
    residual: float  # root mean square of the force that is not explained
    freedom: int  # degrees of freedom of the covariance
    displacement: Array  # averaged record (points,)
    force: Array  # averaged record (points,)
    direction: Array  # 1 where the force rises, -1 where it falls (points,)

    @property
    def half_gap(self) -> float:
        """Half the force between the way up and the way down, far from where the motion turned."""
        return self.friction + self.hysteresis

    @property
    def width(self) -> float:
        """Displacement between the ways up and down at the same force, in the middle of the travel."""
        return float(2.0 * self.half_gap / self.stiffness(0.5 * (self.lowest + self.highest)))

    def at(self, displacement: ArrayLike) -> Array:
        """Force of the spring at displacements, in their shape."""
        x = np.asarray(displacement, dtype=np.float64) / self.scale
        return np.asarray(self.force_scale * polynomial.polyval(x, self.coefficients))

    def stiffness(self, displacement: ArrayLike) -> Array:
        """Slope of the force at displacements, in their shape."""
        x = np.asarray(displacement, dtype=np.float64) / self.scale
        slope = polynomial.polyval(x, polynomial.polyder(self.coefficients))
        return np.asarray(self.force_scale / self.scale * slope)

    def band(self, displacement: ArrayLike, level: float = 0.95) -> Array:
        """Half width of the confidence interval of the force at displacements; a ModelError for a wrong level."""
        x = np.asarray(displacement, dtype=np.float64) / self.scale
        rows = polynomial.polyvander(x, len(self.coefficients) - 1)
        deviation = np.sqrt(np.maximum(np.einsum("...i,ij,...j", rows, self.covariance, rows), 0.0))
        factor = float(special.stdtrit(self.freedom, 0.5 + motion.probability(level) / 2.0))
        return np.asarray(factor * self.force_scale * deviation)


def spring_curve(
    times: ArrayLike,
    displacement: ArrayLike,
    force: ArrayLike,
    *,
    order: int = 5,
    scale: float = 1.0,
    force_scale: float = 1.0,
    settle: float = 2.0,
) -> SpringCurve:
    """Fit the curve of a spring to a slow ramp of force up and down, with friction and hysteresis beside it.

        f = sum_j rho_j x^j + friction sign(df/dt) + sum_k share_k s_k[x] / r_k,    share_k >= 0

    s_k is an elastic element that slides at the displacement r_k. Friction and hysteresis have opposite signs on the
    way up and down, so that the polynomial is the mean of both; near the turns, where a mere mean would be off by the
    hysteresis that has not built up yet, the elements account for it. The covariance is that of the jackknife, one
    stretch of the record left out at a time, so that residuals may be correlated within each.
    Source: Rijlaarsdam (2008), (4.14) and Table B.4; for the elements Iwan, J. Appl. Mech. 33 (1966), 893-900; for the
    covariance Cameron and Miller, J. Human Resources 50 (2015), 317-372, section VI.B (CV3).

    Args:
        times: s (samples,), in equal steps.
        displacement: of the spring (samples,).
        force: on the spring (samples,), without inertia: the ramp must be slow.
        order: of the polynomial.
        scale: unit of displacement of the coefficients.
        force_scale: unit of force of the coefficients.
        settle: time at the start that is left out, in which the rig comes to rest, s.

    Raises:
        RecordError: columns cannot be used, the ramp goes in one direction only, is too fast or too short, or the
            displacement does not follow the force.
        ModelError: the order or a scale makes no sense.
    """
    if isinstance(order, bool) or not isinstance(order, int) or not 1 <= order <= 9:
        raise ModelError(f"order is {order!r}; give a whole number from 1 to 9")
    motion.refuse_not_positive(scale=scale, force_scale=force_scale)
    t, x, f = motion.columns(times=times, displacement=displacement, force=force)
    direction = motion.directions(f)
    kept = t >= t[0] + settle
    if np.count_nonzero(kept) < motion.LEAST_SAMPLES:
        lasts = f"the record lasts {t[-1] - t[0]:.4g} s, of which {settle:g} s are left out"
        raise RecordError(f"{lasts}; record it longer")
    t, x, f, direction = (column[kept] for column in (t, x, f, direction))
    motion.refuse_one_way(x, direction)
    t, x, f, direction = (thinned(column, POINTS) for column in (t, x, f, direction))
    lowest, highest = float(x.min()), float(x.max())
    half, middle = 0.5 * (highest - lowest), 0.5 * (highest + lowest)
    against = np.column_stack([direction, elements(x, 2.0 * half * np.array(SLIDING))])
    rows = np.column_stack([polynomial.polyvander((x - middle) / half, order), against])
    kept = np.abs(direction) == 1.0  # a stretch in which the force turns belongs to neither way
    t, x, f, direction, rows = t[kept], x[kept], f[kept], direction[kept], rows[kept]
    weights, covariance, freedom = _fit_with_covariance(rows, f, order + 1)
    rest = f - rows @ weights
    _refuse_unexplained(t, x, f, rest, rows)
    convert = _conversion(order, scale, middle, half) / force_scale
    return SpringCurve(
        coefficients=convert @ weights[: order + 1], covariance=convert @ covariance @ convert.T,
        scale=float(scale), force_scale=float(force_scale), lowest=lowest, highest=highest,
        friction=float(weights[order + 1]), hysteresis=float(weights[order + 2 :].sum()),
        residual=float(np.sqrt(np.mean(rest**2))), freedom=freedom, displacement=x, force=f, direction=direction,
    )  # fmt: skip


def thinned(column: Array, points: int) -> Array:
    """Means of stretches of equal length, at most `points` of them."""
    size = -(-len(column) // points)
    count = len(column) // size
    return np.asarray(column[: count * size].reshape(count, size).mean(axis=1))


def elements(x: Array, radii: Array) -> Array:
    """Displacement of elastic elements that slide at given displacements, as parts of them (samples, k)."""
    found, z = np.empty((len(x), len(radii))), np.zeros(len(radii))
    for i, change in enumerate(np.diff(x, prepend=x[0])):
        z = np.clip(z + change, -radii, radii)
        found[i] = z / radii
    return found


def _fit_with_covariance(rows: Array, f: Array, free: int) -> tuple[Array, Array, int]:
    """Weights, of which those after the first `free` are not negative, and the covariance of the first."""
    lowest = np.concatenate([np.full(free, -np.inf), np.zeros(rows.shape[1] - free)])
    q, r = np.linalg.qr(rows)  # measured: the search over a few rows takes 1 ms, over all of them 0.3 s
    weights = np.asarray(optimize.lsq_linear(r, q.T @ f, (lowest, np.inf), method="bvls", tol=1e-12).x)
    weights[free:] = np.where(weights[free:] > 1e-9 * np.abs(f).max(), weights[free:], 0.0)
    # Elements without force count as well: which of them have none is itself uncertain, and matters near the turns.
    used, rest = rows, f - rows @ weights
    inverse, one = np.linalg.pinv(used.T @ used), np.eye(used.shape[1])
    batches = zip(np.array_split(used, BATCHES), np.array_split(rest, BATCHES), strict=True)
    apart = [inverse @ np.linalg.lstsq(one - a.T @ a @ inverse, a.T @ b, rcond=None)[0] for a, b in batches]
    left_out = np.array(apart)
    covariance = left_out.T @ left_out * (BATCHES - 1) / BATCHES
    return weights, covariance[:free, :free], BATCHES - used.shape[1]


def _refuse_unexplained(t: Array, x: Array, f: Array, rest: Array, rows: Array) -> None:
    speed = np.gradient(x, t)
    moving = np.column_stack([speed, np.gradient(speed, t)])
    q, _ = np.linalg.qr(rows)
    own, left = moving - q @ (q.T @ moving), f - q @ (q.T @ f)
    weights = np.linalg.lstsq(own / own.std(axis=0), left, rcond=None)[0] / own.std(axis=0)
    is_seen = np.sum((own @ weights) ** 2) > SEEN * (left @ left)  # chance correlates with anything a little
    is_apart = own.std(axis=0) > APART_PART * moving.std(axis=0)
    parts = is_apart * np.abs(weights) * moving.std(axis=0) / np.std(f)
    if is_seen and (parts > (VISCOUS_PART, INERTIA_PART)).any():
        raise RecordError(
            f"the ramp is too fast: inertia takes {100 * parts[1]:.1f} % of the force and damping {100 * parts[0]:.1f} "
            f"%, at most {100 * INERTIA_PART:.0f} % and {100 * VISCOUS_PART:.0f} % are taken for still; make it slower"
            ", such as 60 s up and down, and begin without a jump"
        )
    part = float(np.sqrt(np.mean(rest**2)) / np.std(f))
    if part > UNEXPLAINED_PART:
        raise RecordError(
            f"{100 * part:.0f} % of the force is explained neither by a spring nor by friction; see that the columns "
            "belong to each other, and that nothing else pushes"
        )


def _conversion(order: int, scale: float, middle: float, half: float) -> Array:
    """Matrix from coefficients in (x - middle) / half to those in x / scale (order + 1, order + 1)."""
    found = np.zeros((order + 1, order + 1))
    for j in range(order + 1):
        found[: j + 1, j] = polynomial.polypow([-middle / half, scale / half], j) if j else [1.0]
    return found
