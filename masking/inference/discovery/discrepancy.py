"""Discrepancy: the likelihood of what a model leaves of readings beyond their noise.

No model of a real rig is exact: what it leaves has a size and a colour that nobody knows. The residual r of a sensor
with m readings has the mean square P over the variance of the noise, and is worth n <= m independent samples, since it
changes slowly. With an unknown size, the likelihood of what exceeds noise is that of n samples at its best value:

    -2 log L = m P                   for m P <= n, as for white noise
    -2 log L = n (1 + log(m P/n))    beyond

A residual that is white and no more than noise has n = m. The colour is that of one hypothesis, by which all others are
compared: with a colour of its own for each, slow residuals of any size would pass for the discrepancy of the model.
Source: Kennedy and O'Hagan (2001), J. R. Stat. Soc. B 63(3), 425-464, for the discrepancy of a model; Seber and Wild
(1989), Nonlinear Regression, section 2.2, for likelihoods at the best value of an unknown variance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy import fft

from masking.compile.numerics.arrays import Array

BANDS = 3  # in an octave: as wide as a resonance with a tenth of critical damping
COLOURED = 0.7  # of the samples that a residual was worth where a fit began, and back: those of its end count
EXACT = np.array(1e300)  # independent samples of a likelihood without discrepancy, of any record and sensor


def independent(residuals: Array, readings: Array, sigma: Array, chance: float) -> Array:
    """Number n of independent samples that residuals are worth, of each sensor (sensors,).

        n = m P/s, at most m

    s is the power density of the residual over that of the noise, at the frequencies where the readings have their
    power: parameters of a model change readings there. It is 1 where it is no more than white noise has by chance.

    Args:
        residuals: measured less simulated (m, sensors).
        readings: measured (m, sensors).
        sigma: standard deviation of the noise of each sensor (sensors,).
        chance: standard deviations of the density of white noise, below which it is that.
    """
    count = len(residuals)
    band = np.concatenate([[0], 1 + np.floor(BANDS * np.log2(np.arange(1, count)))]).astype(int)
    lines, found = np.bincount(band), np.full(len(sigma), float(count))
    for i, size in enumerate(sigma):
        left, read = (
            np.bincount(band, fft.dct(column, norm="ortho") ** 2)
            for column in (residuals[:, i], readings[:, i] - readings[:, i].mean())
        )
        square, power = float(left.sum()), float(read.sum())
        if square <= 0.0 or power <= 0.0:
            continue
        part, many = read / power, np.maximum(lines, 1)
        density = float(left / many @ part) / size**2
        if density > 1.0 + chance * np.sqrt(2.0 * (part**2 / many).sum()):
            found[i] = min(found[i], square / (size**2 * density))
    return np.asarray(np.maximum(found, 1.0))


def weights(squares: Array, samples: Array) -> Array:
    """Part of its weight by noise that a squared residual has, by the likelihood.

    Args:
        squares: sums m P of squared residuals over noise variances.
        samples: their numbers n of independent samples, of the same shape.
    """
    return np.asarray(samples / np.maximum(squares, samples))


def misfit(squares: Array, samples: Array) -> float:
    """-2 log likelihood of residuals; arguments as of `weights`."""
    beyond = np.maximum(squares / samples, 1.0)
    return float((np.minimum(squares, samples) + samples * np.log(beyond)).sum())


@dataclass
class Likelihood:
    """Likelihood as a fit goes on: weights follow the residual of the least cost, its colour is that of the first."""

    # independent samples of each record and sensor (records, sensors); those of the first residual if not given
    samples: Array = field(default_factory=partial(np.empty, 0))
    # of squared residuals, over those by noise (records, sensors)
    weights: Array = field(default_factory=partial(np.empty, 0))
    least: float = np.inf  # cost so far
    first: Array = field(default_factory=partial(np.empty, 0))  # squares over noise variances with which it began

    def of(self, noise: Array) -> Array:
        """Weights of squared residuals, of those by noise (records, sensors)."""
        return noise * self.weights if self.weights.size else noise

    def is_of(self, samples: Array) -> bool:
        """Whether it has nearly this colour."""
        ratio = samples / self.samples
        return bool(((ratio > COLOURED) & (ratio < 1.0 / COLOURED)).all())

    def cost(self, squares: Array, pull: float, worth: Callable[[], Array]) -> tuple[float, float]:
        """-2 log posterior of squares over noise variances, and the factor that equations with the weights lack.

        `pull` is that of the prior, `worth` gives the independent samples, which count where the fit begins.
        """
        if not self.first.size:
            self.first = squares
        if not self.samples.size:
            self.samples = worth()
        cost, times = misfit(squares, self.samples) + pull, 1.0
        if cost < self.least:
            before, self.least = self.weights if self.weights.size else np.ones_like(squares), cost
            self.weights = weights(squares, self.samples)
            times = float((squares * self.weights).sum() / max(float((squares * before).sum()), 1e-300))
        return cost, times

    def level(self, cost: float) -> float:
        """What squares that sum up to a cost weigh here, shared out as those with which it began."""
        if not self.first.size or not np.isfinite(cost):
            return np.inf
        return misfit(self.first * (cost / max(float(self.first.sum()), 1e-300)), self.samples)
