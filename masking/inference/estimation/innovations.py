"""Innovations: the result of an extended Kalman filter, and whether its innovations are as white as it assumed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from masking.compile.numerics.arrays import Array
from masking.inference.estimation.fit import Estimate
from masking.inference.estimation.whiteness import autocorrelation, ljung_box

LAGS = 20  # of the autocorrelation of the innovations


@dataclass(frozen=True, repr=False, kw_only=True)
class KalmanFit(Estimate):
    """Final values of parameters that a filter found, how sure it is of them, and whether its assumptions hold.

    The covariance is that of the values if the noise is as assumed by the filter.
    """

    times: Array  # of the samples, s (m,)
    trajectory: Array  # values after each sample (m, k)
    deviations: Array  # standard deviations after each sample (m, k)
    states: Array  # the twin's state after each sample (m, states), in SI units
    innovations: Array  # readings less what was expected of them, in their units (m, sensors)
    normalised: Array  # innovations made independent with deviation 1, if the filter's assumptions hold (m, sensors)
    final: Array  # covariance of state and parameters after the last sample (states + k, states + k)

    @property
    def nis(self) -> Array:
        """Normalised innovation squared e^T S^-1 e of each sample (m,).

        Chi-squared with as many degrees of freedom as there are sensors, if the filter's assumptions hold.
        Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2.
        """
        return np.asarray((self.normalised**2).sum(axis=1))

    @property
    def consistency(self) -> tuple[float, float, float]:
        """Mean of the normalised innovation squared, and the 95 % interval that it should be in."""
        m, sensors = self.normalised.shape
        low, high = 2.0 * special.gammaincinv(0.5 * m * sensors, [0.025, 0.975]) / m
        return float(self.nis.mean()), float(low), float(high)

    @property
    def autocorrelation(self) -> Array:
        """Correlation of each normalised innovation with itself 1, 2, ... samples later (lags, sensors).

        About 1 / sqrt(m) and no more where innovations are white. The mean is not taken off: it should be 0.
        """
        lags = min(LAGS, len(self.normalised) - 1)
        return np.column_stack([autocorrelation(e, lags) for e in self.normalised.T])

    @property
    def whiteness(self) -> dict[str, float]:
        """Probability of innovations at least as correlated as these if they were white, by sensor."""
        chances = ljung_box(self.autocorrelation, len(self.normalised))
        return dict(zip(self.twin.sensors, map(float, chances), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Fit as JSON can hold it; what is over time is left out."""
        mean, low, high = self.consistency
        train = {name: value if np.isfinite(value) else None for name, value in self.chi.items()}
        return {
            "parameters": self.parameters(),
            "chi": {"train": train, "validation": self.validation},
            "floor": self.floor,
            "nis": {"mean": mean, "low": low, "high": high},
            "whiteness": self.whiteness,
            "notes": list(self.remarks),
        }

    def __str__(self) -> str:
        mean, low, high = self.consistency
        return "\n".join([*self.lines(), f"NIS {mean:.3g}, expected {low:.3g} to {high:.3g}", *self.remarks])
