"""Prior: normal distributions of the rig's parameters, with bounds, and the split of a record in two.

Source: MacKay (2003), Information Theory, Inference, and Learning Algorithms, chapter 28, for priors in model
comparison.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from masking.discovery.augmented_model import OpenRig
from masking.estimation.data import Data
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

SIGNED = 3.0  # standard deviations from 0 from which a parameter keeps its sign
HELD_OUT = 0.3  # fraction of a record that is held out for validation if no other record is given


@dataclass(frozen=True)
class Prior:
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

    def released(self, index: int) -> Prior:
        """Return the belief with one parameter free."""
        deviation = self.deviation.copy()
        deviation[index] *= 1e3
        return replace(self, deviation=deviation)


def prior_of(twin: Twin, rig: OpenRig, tolerance: float) -> Prior:
    """Return the prior of the rig's parameters: declared values, standard deviations and bounds.

    Args:
        twin: the rig as declared.
        rig: its augmented model, whose k parameters may be re-fitted.
        tolerance: relative standard deviation of a parameter that declares none.
    """
    declared = twin.model.declaration.parameters
    deviations = []
    for name, value in zip(rig.names, rig.start, strict=True):
        std = declared[name].std if name in declared else None
        deviations.append(std or tolerance * (abs(float(value)) or 1.0))
    mean, deviation, (low, high) = rig.start.copy(), np.array(deviations), rig.bounds
    low = np.where(mean > SIGNED * deviation, np.maximum(low, 0.0), low)
    high = np.where(mean < -SIGNED * deviation, np.minimum(high, 0.0), high)
    return Prior(mean, deviation, low, high)


def train_validation_split(record: Data) -> tuple[Data, Data]:
    """Return the part of a record that is fitted, and its last part, held out for validation."""
    seconds = len(record) / record.rate
    return record.first((1.0 - HELD_OUT) * seconds), record.windows(HELD_OUT * seconds)[-1]
