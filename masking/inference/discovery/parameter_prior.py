"""Prior of the rig's parameters: normal distributions with bounds; and the split of a record in two.

The prior of a cause is `effect_evidence` of `decision_rules`.
Source: MacKay (2003), Information Theory, Inference, and Learning Algorithms, chapter 28, for priors of models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.estimation.identification_data import Data


@dataclass(frozen=True)
class Prior:
    """The distribution of the rig's k parameters before the record, in declared units."""

    mean: Array  # means (k,)
    deviation: Array  # standard deviations (k,)
    # low and high: bounds (k,); infinite if there are none
    low: Array
    high: Array

    def freed(self, index: int, factor: float) -> Prior:
        """Prior with one parameter free: its standard deviation grows by a factor."""
        deviation = self.deviation.copy()
        deviation[index] *= factor
        return replace(self, deviation=deviation)

    def extended(self, at: int, *more: ArrayLike) -> Prior:
        """Prior with further parameters from a number on, by their means, deviations, and least and largest values."""
        columns = zip((self.mean, self.deviation, self.low, self.high), more, strict=True)
        return Prior(*(np.insert(column, at, values) for column, values in columns))


def uncertain(twin: Twin) -> tuple[str, ...]:
    """Parameters of the equations that fits adjust by default: `std: 0` declares one as known."""
    declared = twin.model.declaration.parameters
    return tuple(n for n in twin.equation_parameters() if n not in declared or declared[n].std != 0.0)


def prior_of(twin: Twin, rig: AugmentedModel, tolerance: float, rules: DecisionRules = RULES) -> Prior:
    """Prior of the rig's parameters: declared values, standard deviations and bounds.

    The tolerance is the relative standard deviation of a parameter that declares none.
    """
    declared = twin.model.declaration.parameters
    stds = [declared[name].std if name in declared else None for name in rig.names]
    deviations = [std or tolerance * (abs(float(x)) or 1.0) for std, x in zip(stds, rig.start, strict=True)]
    mean, deviation, (low, high) = rig.start.copy(), np.array(deviations), rig.bounds
    least = rules.sign_deviations * deviation
    low = np.where((mean > 0.0) & (mean >= least), np.maximum(low, 0.0), low)
    high = np.where((mean < 0.0) & (mean <= -least), np.minimum(high, 0.0), high)
    return Prior(mean, deviation, low, high)


def train_validation_split(record: Data, held_out: float) -> tuple[Data, Data]:
    """Part of a record that is fitted, and its last part, a fraction of it, held out for validation.

    Where that part would be at rest, which validates nothing, they are those of the motion before.
    """
    moving = record.until_rest()
    whole = record if len(moving) > (1.0 - held_out) * len(record) else moving
    count = round((1.0 - held_out) * len(whole))
    return whole.part(0, count), whole.part(count, len(whole))
