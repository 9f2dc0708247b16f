"""Evidence: a record, the rig that it is held against, and what is believed of both before."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from masking.discovery.opened import OpenRig
from masking.identification.data import Data
from masking.kernels import Array

BLOCK = 32  # samples: what is left is averaged over these to see whether it changes slowly


@dataclass(frozen=True)
class Belief:
    """What is believed of the rig's parameters before the record.

    Args:
        mean: (k,).
        deviation: standard deviations (k,).
        low, high: what they cannot be below and above (k,).
    """

    mean: Array
    deviation: Array
    low: Array
    high: Array

    def released(self, index: int) -> Belief:
        """Return the belief with one parameter free."""
        deviation = self.deviation.copy()
        deviation[index] *= 1e3
        return replace(self, deviation=deviation)


@dataclass(frozen=True)
class Evidence:
    """A record and the rig that it is held against.

    Args:
        rig: the rig.
        record: commands and readings.
        belief: of the rig's parameters.
        sigma: standard deviation of the noise of each reading (sensors,).
        substeps: integration steps between samples.
        horizon: samples after which the motion begins anew, from a state of its own; 0 for none.
    """

    rig: OpenRig
    record: Data
    belief: Belief
    sigma: Array
    substeps: int
    horizon: int = 0

    @property
    def begin(self) -> int:
        """Return the samples of a window in which the rig moves from one initial state."""
        return self.horizon or len(self.record)

    @property
    def windows(self) -> int:
        """Return the number of these windows."""
        return -(-len(self.record) // self.begin)

    @property
    def weights(self) -> Array:
        """Return the weights of squared residuals (sensors,)."""
        return np.asarray(self.sigma**-2.0)

    @property
    def dt(self) -> float:
        """Return the time between samples in s."""
        return 1.0 / self.record.rate

    def temperature(self, residuals: Array) -> float:
        """Return by how much more is left than white noise, and how much more slowly it changes; at least 1.

        Costs are divided by it: what is left is so many times the noise, or so many readings tell the same.

        Args:
            residuals: of the readings (m, sensors).
        """
        found = 1.0
        for column, sigma in zip(residuals.T, self.sigma, strict=True):
            found = max(found, float((column**2).mean() / sigma**2))
            for length in {BLOCK, self.horizon or BLOCK}:
                blocks = column[: len(column) // length * length].reshape(-1, length).mean(axis=1)
                slow = float((blocks**2).mean() * length / sigma**2)
                found = max(found, slow if slow > 1.3 else 1.0)
        return found
