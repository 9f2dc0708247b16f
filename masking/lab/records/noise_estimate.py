"""Noise: how much white noise there is in readings of something that moves, and up to which frequency it moves."""

from __future__ import annotations

import numpy as np

from masking.compile.numerics.arrays import Array

EXACT = 1e-12  # of the largest reading: a smaller difference is rounding of double precision
NEAR, MOST = 0.1, 0.95  # of a step, and of the gaps between values: as near to its multiples, and as many of them
FEWEST = 256  # readings; fewer are too few for bands
# Bands that a spectrum is cut into, and lines in each, at least as far as there are lines.
FEWEST_BANDS, MOST_BANDS, LINES = 4, 32, 64
LOUDER = 4.0  # deviations above the mean of others by which a band is louder than they
SURELY = 6.0  # the same where none of hundreds of bands may be so by chance
WIDER = 0.26  # part of its lowest frequency that a band reaches beyond it where motion ends: a third of an octave
QUARTERS = 4  # parts of readings in which motion is looked for
ALIKE = 2.63  # variance of the mean over lines of a spectrum by the window sin^4, in parts of that of independent lines
MULTIPLE = 128  # what records are cut to a multiple of, which has a fast transform


def third_differences(readings: Array) -> Array:
    """Third differences of readings (samples, columns), scaled to the size of their white noise (samples - 3, columns).

    In equal steps of time, what moves smoothly leaves next to nothing.
    """
    return np.asarray(np.diff(readings, n=3, axis=0) / np.sqrt(20.0))  # 1 + 9 + 9 + 1


def white_noise(readings: Array) -> Array:
    """Standard deviation of white noise in each column (columns,) of readings, evenly in time (samples, columns).

    White noise is as strong at all frequencies, and motion is not. The spectrum is cut into bands, and the noise is the
    mean of those that differ by chance only, the quietest first: all of them where there is nothing but noise. So
    neither ten samples in a period nor a line near half the rate count as noise. Of noise with a colour, it is what the
    quietest bands hold. Fewer than 256 readings have their noise found from third differences.

    Source: Stoica and Moses, Spectral Analysis of Signals (2005), section 2.7, for smoothed periodograms; von Neumann
    et al., Annals of Mathematical Statistics 12 (1941), 153-162, for differences.
    """
    if len(readings) < FEWEST:
        thirds = third_differences(readings)
        return np.asarray(np.sqrt((thirds**2).mean(axis=0))) if len(thirds) else np.zeros(readings.shape[1])
    power = _periodogram(readings)
    lines = power.shape[1]
    bands = min(max(lines // LINES, FEWEST_BANDS), MOST_BANDS)
    starts = np.arange(bands) * lines // bands
    levels = np.sort(np.add.reduceat(power, starts, axis=1) / np.diff(np.append(starts, lines)), axis=1)
    means = np.cumsum(levels, axis=1) / np.arange(1, bands + 1)
    chance = np.sqrt(ALIKE * bands / lines * (1.0 + 1.0 / np.arange(1, bands)))  # of a band, and of the mean before it
    louder = levels[:, 1:] > means[:, :-1] * (1.0 + LOUDER * chance)
    quiet = np.where(louder.any(axis=1), louder.argmax(axis=1), bands - 1)
    return np.asarray(np.sqrt(means[np.arange(len(means)), quiet]))


def bandwidth(readings: Array) -> float:
    """Highest frequency, in cycles per sample, at which any column is louder than its white noise.

    Each quarter of the readings (samples, columns), in equal steps of time, is looked at, so that motion that decays
    counts where it is. Bands are a third of an octave wide. Of fewer than 1024 readings the quarters are too few for
    bands, and have 0.5.
    """
    if len(readings) < QUARTERS * FEWEST:
        return 0.5
    noise = white_noise(readings)[:, None] ** 2
    return max(_bandwidth(quarter, noise) for quarter in np.array_split(readings, QUARTERS))


def _bandwidth(readings: Array, noise: Array) -> float:
    """Highest frequency at which any column is louder than its noise (columns, 1), a variance."""
    power = _periodogram(readings)
    lines, starts = power.shape[1], [0]
    while (end := starts[-1] + max(LINES, int(WIDER * starts[-1]))) < lines:
        starts.append(end)
    ends = np.append(starts[1:], lines)
    levels = np.add.reduceat(power, starts, axis=1) / (ends - starts)
    louder = (levels > noise * (1.0 + SURELY * np.sqrt(ALIKE / (ends - starts)))).any(axis=0)
    return float(0.5 * ends[louder].max(initial=0) / lines)


def _periodogram(readings: Array) -> Array:
    """Power of each column at all frequencies but 0, in parts of a variance (columns, lines)."""
    count = len(readings) - len(readings) % MULTIPLE
    window = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 4  # side lobes fall by 30 dB in an octave
    window /= np.sqrt((window**2).mean())
    part = readings[:count]
    spectrum = np.fft.rfft((window[:, None] * (part - part.mean(axis=0))).T)[:, 1:]
    return np.asarray(np.abs(spectrum) ** 2 / count)


def rounding_steps(readings: Array) -> Array:
    """Step to which each column of readings (m, c) is rounded (c,); 0 where it is not.

    It is what lies between neighbouring values, or a part of it.
    """
    return np.array([_rounding_step(column) for column in readings.T])


def _rounding_step(column: Array) -> float:
    gaps = np.diff(np.unique(column))
    gaps = gaps[gaps > EXACT * np.abs(column).max()]  # values that differ by rounding of numbers are the same
    if not len(gaps):
        return 0.0
    step = float(np.median(gaps[gaps <= 1.5 * gaps.min()]))
    return step if (np.abs(gaps / step - np.round(gaps / step)) < NEAR).mean() > MOST else 0.0
