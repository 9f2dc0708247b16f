"""Actuator ratio: which of two is stronger, from the motion that is left where they push against each other.

Source: Rijlaarsdam (2008), appendix C.5.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray
from scipy import special

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, RecordError
from masking.inference.procedures.channel_names import columns, probability, refuse_not_positive

HARMONICS = (1, 2, 3)  # of the drive, which are distinguished in each reading; the drive first
SAMPLES_PER_PERIOD = 10  # that are needed
LEAST_READINGS = 12  # that are needed


@dataclass(frozen=True)
class ActuatorRatio:
    """The gain of one actuator at which it balances another."""

    ratio: float  # command of the second per command of the first that leaves no motion
    deviation: float  # standard deviation of the ratio
    freedom: int  # degrees of freedom of the deviation
    gains: Array  # mean gain of each reading (readings,)
    motion: NDArray[np.complex128]  # complex amplitude at the drive's frequency, phase against the drive (readings,)
    fitted: NDArray[np.complex128]  # the part of `motion` that the ratio and the lag explain (readings,)
    used: NDArray[np.bool_]  # True for readings near the balance, which the ratio rests on (readings,)
    residual: float  # amplitude of motion that is left at the balance

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of the ratio; a ModelError where the level is not between 0 and 1."""
        half = float(special.stdtrit(self.freedom, 0.5 + probability(level) / 2.0)) * self.deviation
        return self.ratio - half, self.ratio + half


def actuator_ratio(
    times: ArrayLike, motion: ArrayLike, gain: ArrayLike, *, frequency: float, span: float = 0.3
) -> ActuatorRatio:
    """Find the gain at which two actuators in anti-phase leave no motion.

    One is commanded A sin(2 pi f t), the other g(t) A sin(2 pi f t), with the sign that lets it push against the first:
    on the rig the same sign, as the oscillators' actuators push against the beam (4.3). g is swept slowly up and down
    through the balance. The motion is demodulated at f over whole periods, so that noise, offset and harmonics of
    friction drop out. Its complex amplitude is, with a lag that changes sign with the direction of the sweep,

        Z = a + b (g - g0) + d (g - g0)^3 + c dg/dt

    and |a + b (g - g0)|^2, a parabola, is least at g0 - Re(a / b).
    Source: Rijlaarsdam (2008), appendix C.5.

    The oscillator must be held, as it was there: one that is free carries a part of its actuator's force to the beam by
    its spring as well, and the balance is another.

    Args:
        times: s (samples,), in equal steps.
        motion: of what both push (samples,).
        gain: g (samples,).
        frequency: f, Hz.
        span: readings with gains so near the balance are used; gains up to it on both sides must occur.

    Raises:
        RecordError: columns cannot be used, the sweep goes one way only or does not pass the balance, or the motion
            does not follow the gain.
        ModelError: the frequency or the span makes no sense.
    """
    refuse_not_positive(frequency=frequency, span=span)
    t, x, g = columns(times=times, motion=motion, gain=gain)
    gains, rates, readings = _demodulated(t, x, g, frequency)
    ratio, used = float(gains.mean()), np.ones(len(gains), dtype=bool)
    a = b = 0j
    for width in (np.inf, 2.0 * span, span, span, span):
        used = np.abs(gains - ratio) <= width
        _refuse_sweep(used, gains, rates, ratio, min(width, span))
        away = gains[used] - ratio
        rows = np.column_stack([np.ones(used.sum()), away, away**3, rates[used]])
        sizes = np.abs(rows).max(axis=0)
        found, *_ = np.linalg.lstsq(rows / sizes, readings[used], rcond=None)
        found = found / sizes
        a, b = found[0], found[1]
        rest = readings[used] - rows @ found
        power = float(np.sum(np.abs(rest) ** 2)) / max(len(rest) - 4, 1)
        shape = np.linalg.pinv((rows / sizes).T @ (rows / sizes)) / np.outer(sizes, sizes)
        if not abs(b) ** 2 > 25.0 * power * shape[1, 1]:
            raise RecordError(
                f"the motion at {frequency:g} Hz does not follow the gain: it changes by {abs(b):.3g} per gain, with a "
                f"deviation of {np.sqrt(power * shape[1, 1]):.3g}; drive harder, or correct the frequency"
            )
        ratio -= float((a / b).real)
        if not gains.min() < ratio < gains.max():
            raise RecordError(
                f"the motion is least at a gain of {ratio:.4g}, outside of {gains.min():.4g} to {gains.max():.4g}; "
                "sweep the gain through the balance"
            )
    along = float(np.sum(rest[1:] * rest[:-1].conj()).real / max(np.sum(np.abs(rest) ** 2), 1e-300))
    alike = min(max(along, 0.0), 0.95)
    variance = 0.5 * power * shape[0, 0] / abs(b) ** 2 * (1.0 + alike) / (1.0 - alike)
    away = gains - ratio
    fitted = np.asarray(a - b * (a / b).real + b * away + found[2] * away**3 + found[3] * rates)
    freedom, left = 2 * (len(rest) - 4), abs((a / b).imag * b)
    return ActuatorRatio(ratio, float(np.sqrt(variance)), freedom, gains, readings, fitted, used, left)


def _demodulated(t: Array, x: Array, g: Array, frequency: float) -> tuple[Array, Array, NDArray[np.complex128]]:
    """Gain, its rate and complex amplitude of a motion in readings over whole periods."""
    step = float(t[-1] - t[0]) / (len(t) - 1)
    if SAMPLES_PER_PERIOD * frequency * step > 1.0:
        raise ModelError(
            f"{1.0 / (frequency * step):.3g} samples in a period of {frequency:g} Hz, at least {SAMPLES_PER_PERIOD} "
            f"are needed; record at {SAMPLES_PER_PERIOD * frequency:g} Hz or more"
        )
    x = x - polynomial.polyval(t - t[0], polynomial.polyfit(t - t[0], x, 1))
    periods = (len(t) * step) * frequency
    each = max(1, int(periods // 150))
    count = int(periods // each)
    if count < LEAST_READINGS:
        raise RecordError(
            f"the record holds {periods:.1f} periods of {frequency:g} Hz, at least {LEAST_READINGS} are needed; record "
            "it longer, or drive faster"
        )
    edges = np.round(np.arange(count + 1) * each / (frequency * step)).astype(int)
    gains, rates = np.empty(count), np.empty(count)
    readings = np.empty(count, dtype=np.complex128)
    for i, (first, last) in enumerate(itertools.pairwise(np.minimum(edges, len(t)))):
        now = t[first:last]
        turn, slope = 2.0 * np.pi * frequency * now, now - now.mean()
        waves = [wave(k * turn) for k in HARMONICS for wave in (np.cos, np.sin)]
        found, *_ = np.linalg.lstsq(np.column_stack([*waves, np.ones(len(now))]), x[first:last], rcond=None)
        readings[i] = found[0] - 1j * found[1]
        gains[i] = g[first:last].mean()
        rates[i] = slope @ g[first:last] / (slope @ slope)
    return gains, rates, readings * 1j


def _refuse_sweep(used: NDArray[np.bool_], gains: Array, rates: Array, ratio: float, span: float) -> None:
    near = used & (np.abs(gains - ratio) <= max(span, 1e-12))
    sides = [np.count_nonzero(used & (side * (gains - ratio) > 0.0)) for side in (1.0, -1.0)]
    if np.count_nonzero(used) < LEAST_READINGS or min(sides) < 3:
        raise RecordError(
            f"{np.count_nonzero(used)} readings lie near the balance at a gain of {ratio:.4g}, {sides[0]} above and "
            f"{sides[1]} below; sweep the gain more slowly, and through the balance"
        )
    if near.any() and not ((rates[near] > 0.0).any() and (rates[near] < 0.0).any()):
        raise RecordError(
            "the gain is swept one way only, so that the lag of the motion shifts the balance; sweep it up and down"
        )
