"""Noise: how much of it there is in each reading of a record, and whether readings are rounded.

Source: Rousseeuw and Croux (1993), J. Am. Stat. Assoc. 88(424), 1273-1283, for the median of magnitudes.
"""

from __future__ import annotations

import numpy as np

from masking.discovery.augmented_model import AugmentedModel
from masking.discovery.rules import RULES, DecisionRules
from masking.errors import RecordError
from masking.estimation.data import Data
from masking.numerics.arrays import Array
from masking.records.noise import third_differences, white_noise

MEDIAN = 0.6745  # magnitude that half of all samples of a standard normal distribution stay below


def noise_of(rig: AugmentedModel, record: Data, rules: DecisionRules = RULES) -> Array:
    """Return the standard deviation of the noise of each reading (sensors,), from the record.

    What a force changes at once may jump, as that of a friction does: there the noise is that of most readings, and
    that of measured inputs counts with what it makes of the readings.

    Args:
        rig: the augmented model.
        record: commands and readings.
        rules: from how few different values readings are rounded.

    Raises:
        RecordError: readings carry no noise, so that nothing can be said to be beyond it.
    """
    twin, found = rig.twin, record.noise
    if twin.is_fed:
        at = [twin.actuators.index(name) for name in twin.measured_actuators]
        by = rig.direct(rig.start)[:, [rig.columns[2][i] for i in at]]
        found = np.hypot(_smooth(record.readings), np.linalg.norm(by * _smooth(record.commands[:, at]), axis=1))
    size = np.sqrt((record.readings**2).mean(axis=0))
    for name, value in zip(twin.sensors, size, strict=True):
        if value == 0.0:
            raise RecordError(
                f"{record.name}: {name} reads 0 throughout; look at its cable, or leave it out of the plant"
            )
    rounding = np.array([step / np.sqrt(12.0) for step in steps_of(record, rules.rounded_values)])
    floor: Array = np.maximum.reduce([found, 1e-6 * size, rounding])
    return floor


def _smooth(table: Array) -> Array:
    """Return the noise of columns (m, c) that are smooth but for jumps: what is usual of it, if less than its mean."""
    usual = np.median(np.abs(third_differences(table)), axis=0) / MEDIAN
    return np.asarray(np.minimum(usual, white_noise(table)))


def steps_of(record: Data, rounded_values: float = RULES.rounded_values) -> Array:
    """Return the step of which all readings of a sensor are multiples (sensors,); 0 where they are not rounded."""
    steps = []
    for column in record.readings.T:
        values = np.unique(column)
        apart = np.diff(values)
        step = float(np.median(apart[apart <= 1.5 * apart.min()])) if len(apart) else 0.0
        is_coarse = len(values) < rounded_values * len(column)
        rounded = is_coarse and np.allclose(values / step, np.round(values / step), atol=1e-3)
        steps.append(step if rounded else 0.0)
    return np.array(steps)
