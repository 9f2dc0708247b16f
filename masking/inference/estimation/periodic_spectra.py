"""Periodic spectra: the period of signals that repeat, and the spectra of whole periods, one by one.

No window is needed, as every period is whole. Spectra are those of peak amplitudes: A cos(2 pi f t + phi) gives
A exp(i phi) at f.
Source: Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2012), chapter 2; de Cheveigne and
Kawahara (2002), J. Acoust. Soc. Am. 111(4), 1917-1930, for the difference function that a period is found by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from masking.compile.numerics.arrays import Array, Complex

Indices = NDArray[np.int64]

EXCITED_PART = 0.01  # of its largest amplitude, from which an input is excited at a line


@dataclass(frozen=True)
class Spectra:
    """Periods of a record as spectra, period by period."""

    rate: float  # samples per second
    length: int  # samples per period
    inputs: Complex  # (experiments, periods, lines, inputs), at harmonics 0 to half the length
    outputs: Complex  # (experiments, periods, lines, outputs)

    @property
    def base(self) -> float:
        """Frequency of the first harmonic, Hz."""
        return self.rate / self.length

    @property
    def periods(self) -> int:
        """Number of periods that are used."""
        return int(self.inputs.shape[1])

    @property
    def excited(self) -> Indices:
        """Harmonics (lines,), without 0, at which an input has 1 % of its largest amplitude or more."""
        return np.flatnonzero(self.moved().any(axis=1))

    def moved(self) -> NDArray[np.bool_]:
        """Harmonics at which each input is excited in any experiment, as a mask (lines, inputs)."""
        size = np.abs(self.inputs.mean(axis=1)).max(axis=0)
        size[0] = 0.0
        return np.asarray(size >= EXCITED_PART * size.max(axis=0))


def by_period(values: Array, length: int, discard: int = 1) -> Complex:
    """Spectra (experiments, periods, lines, channels) of the whole periods of values but the first ones.

    Args:
        values: a table of each experiment (experiments, samples, channels).
        length: samples per period.
        discard: periods at the start that are left out.
    """
    whole = values.shape[1] // length
    kept = values[:, discard * length : whole * length].reshape(len(values), whole - discard, length, values.shape[2])
    spectrum = 2.0 / length * np.fft.rfft(kept, axis=2)
    spectrum[:, :, 0] /= 2.0
    return np.asarray(spectrum)


def repeats(u: Array, difference: float) -> int | None:
    """Samples after which columns (samples, inputs) repeat, at most half of all; None where they do not.

    From one period to the next they differ by no more than a part of their size.
    """
    count, waves = len(u), u - u.mean(axis=0)
    size = np.sqrt(np.mean(waves**2, axis=0))
    waves = waves / np.where(size > 0.0, size, 1.0)
    power = np.concatenate([[0.0], np.cumsum((waves**2).sum(axis=1))])
    spectrum = np.fft.rfft(waves, 2 * count, axis=0)
    along = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), 2 * count)[:count]
    lags = np.arange(1, count // 2 + 1)
    apart = (power[count - lags] + power[count] - power[lags] - 2.0 * along[lags]) / (count - lags)
    # A wave is like itself a few samples later too: the first time that it is no more like it ends that.
    far = np.flatnonzero(apart > 0.5 * u.shape[1])
    close = np.flatnonzero(apart <= difference**2 * u.shape[1])
    close = close[close > far[0]] if len(far) else close[:0]
    if not len(close):
        return None
    first = close[0]
    run = close[close < first + max(2, first // 20)]
    return int(lags[run[np.argmin(apart[run])]])
