"""Whiteness of residuals: whether they are white noise, and if not, the frequency at which they are least so.

Two tests see different things: that of Ljung and Box correlations from sample to sample, that of the spectrum a little
more power in a few of its lines than in the others.
Source: Ljung and Box, Biometrika 65 (1978), 297-303; Fisher, Proceedings of the Royal Society A 125 (1929), 54-59, for
the largest share of a spectrum; Oppenheim and Schafer, Discrete-Time Signal Processing (2010), section 10.6, for
correlations by Fourier transforms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from masking.compile.numerics.arrays import Array

SECONDS = 0.1  # over which samples are held against each other
FEWEST, MOST = 10, 200  # lags
DOUBTED = 0.001  # probability below which white noise is rejected; several sensors are tested at once
BANDS = 2  # in an octave
SLOW = 0.25  # of the frequency at which a sensor moves: what is below is called slow


@dataclass(frozen=True)
class Whiteness:
    """How white residuals are."""

    p: float  # probability of residuals at least as correlated, or as uneven in their spectrum, if they were white
    beyond: float  # part of their mean square that is beyond the noise of the sensor
    frequency: float  # in Hz, where they are furthest above white noise; 0 for a constant
    slow: bool  # whether that is far below the frequencies at which the sensor moves

    @property
    def white(self) -> bool:
        """Whether they may be white noise."""
        return self.p >= DOUBTED

    def as_dict(self) -> dict[str, Any]:
        """Whiteness as JSON can hold it."""
        result: dict[str, Any] = {"p": self.p, "white": self.white, "beyond": self.beyond}
        return result | ({} if self.white else {"frequency": self.frequency, "slow": self.slow})


def whiteness(residuals: Array, readings: Array, sigma: float, rate: float) -> Whiteness:
    """How white the residuals of a sensor are.

    Args:
        residuals: measured less simulated (m,), with a mean that should be 0.
        readings: of the sensor (m,), in the same unit.
        sigma: standard deviation of its noise, in the same unit.
        rate: samples per second.
    """
    m, square = len(residuals), float((residuals**2).mean())
    if square == 0.0:
        return Whiteness(1.0, 0.0, 0.0, slow=False)
    lags = min(max(FEWEST, min(MOST, round(SECONDS * rate))), m // 4)
    p = min(1.0, 2.0 * min(float(ljung_box(autocorrelation(residuals, lags), m)), evenness(residuals)))
    frequency = _loudest(residuals, rate)
    energy = np.cumsum(np.abs(np.fft.rfft(readings - readings.mean())) ** 2)
    middle = float(np.searchsorted(energy, 0.5 * energy[-1])) * rate / m  # Hz: half of the energy is on either side
    return Whiteness(p, max(0.0, 1.0 - sigma**2 / square), frequency, slow=frequency < SLOW * middle)


def autocorrelation(values: Array, lags: int) -> Array:
    """Correlation of values (m,) with themselves 1, 2, ... samples later (lags,); no mean is taken off."""
    length = 1 << (len(values) + lags - 1).bit_length()
    found = np.fft.irfft(np.abs(np.fft.rfft(values, length)) ** 2, length)
    return np.asarray(found[1 : lags + 1] / max(float(found[0]), 1e-300))


def ljung_box(rho: Array, samples: int) -> Array:
    """Probability of correlations at lags 1, 2, ... (lags, ...) of m samples at least this large if there were none.

        Q = m (m + 2) sum_k rho_k^2 / (m - k),   chi-squared with as many degrees of freedom as lags

    Source: Ljung and Box, Biometrika 65 (1978), 297-303.
    """
    left = samples - np.arange(1, len(rho) + 1)
    statistic = samples * (samples + 2) * np.tensordot(1.0 / left, rho**2, axes=1)
    return np.asarray(special.chdtrc(len(rho), statistic))


def evenness(values: Array) -> float:
    """Probability of a spectrum at least as uneven as that of values (m,) if they were white.

    The share of a band of n among N lines is distributed as Beta(n, N - n) then; that of the strongest line is above g
    with a probability of at most N (1 - g)^(N - 1).
    Source: Fisher, Proceedings of the Royal Society A 125 (1929), 54-59.
    """
    power, band = _banded(values)
    power[0] /= 2.0  # a constant is one number, as half of a line is
    many = np.bincount(band).astype(float)
    many[0] = 0.5
    shares, lines = np.bincount(band, power) / power.sum(), float(many.sum())
    used = many > 0.0
    of_bands = np.count_nonzero(used) * float(special.betaincc(many[used], lines - many[used], shares[used]).min())
    of_lines = lines * (1.0 - float(power.max() / power.sum())) ** (lines - 1.0)
    return float(min(1.0, 2.0 * min(of_bands, of_lines)))


def _banded(values: Array) -> tuple[Array, NDArray[np.int_]]:
    """Power of each line of a spectrum, and the band that it is in, from a constant on."""
    power = np.abs(np.fft.rfft(values)) ** 2
    return power, np.concatenate([[0], 1 + np.floor(BANDS * np.log2(np.arange(1, len(power))))]).astype(int)


def _loudest(values: Array, rate: float) -> float:
    """Frequency in Hz at which a spectrum is furthest above that of white noise: of a line, or a band.

    How unlikely n lines with a mean r of its level are, if it is white: log p <= -n (r - 1 - log r).
    Source: Chernoff (1952), Annals of Mathematical Statistics 23(4), 493-507, for a sum of what is exponential.
    """
    power, band = _banded(values)
    power /= max(float(np.median(power)) / np.log(2.0), 1e-300)  # median of what is exponential
    many = np.bincount(band)
    means = np.maximum(np.bincount(band, power) / np.maximum(many, 1), 1.0)
    of_bands = many * (means - 1.0 - np.log(means)) - np.log(len(many))
    loud, strongest = int(np.argmax(of_bands)), int(np.argmax(power))
    if power[strongest] - 1.0 - np.log(max(power[strongest], 1.0)) - np.log(len(power)) > of_bands[loud]:
        return strongest * rate / len(values)
    inside = np.flatnonzero(band == loud)
    weights = np.maximum(power[inside] - 1.0, 0.0) ** 2
    return float(np.average(inside, weights=weights) if weights.any() else inside[0]) * rate / len(values)
