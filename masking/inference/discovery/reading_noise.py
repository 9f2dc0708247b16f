"""Noise of each reading of a record, as discovery weighs it.

Source: Rousseeuw and Croux (1993), J. Am. Stat. Assoc. 88(424), 1273-1283, for the noise by a median of magnitudes.
"""

from __future__ import annotations

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import RecordError
from masking.inference.estimation.identification_data import Data
from masking.lab.records.noise_estimate import EXACT, FEWEST, rounding_steps, third_differences, white_noise

FEWER = 0.8  # of the mean noise: a median below is less than by chance, and some readings jump
MEDIAN = 0.6745  # magnitude that half of all samples of a standard normal distribution stay below


def noise_of(twin: Twin, record: Data) -> Array:
    """Standard deviation of the noise of each reading (sensors,), from the record.

    What a force changes at once may jump, as that of a friction does, or a rate where a command changes: there the
    noise is that of most readings. That of measured inputs counts with what the readings have of these by linear
    regression. Parameters of the model have no part in it. Rounding to steps q makes q / sqrt(12) at least. A
    RecordError says that readings carry no noise, so that nothing can be said to be beyond it.
    """
    found, smooth = record.noise, _smooth(record.readings)
    found = np.where(smooth < FEWER * found, smooth, found)
    if twin.is_fed:
        inputs = record.commands[:, [twin.actuators.index(name) for name in twin.measured_actuators]]
        by = decompositions.least_squares(inputs - inputs.mean(axis=0), record.readings - record.readings.mean(axis=0))
        found = np.hypot(smooth, np.linalg.norm(_smooth(inputs)[:, None] * by, axis=0))
    size = np.sqrt((record.readings**2).mean(axis=0))
    for name, value in zip(twin.sensors, size, strict=True):
        if value == 0.0:
            raise RecordError(
                f"{record.name}: {name} reads 0 throughout; look at its cable, or leave it out of the plant"
            )
    return np.asarray(np.maximum.reduce([found, 1e-6 * size, rounding_steps(record.readings) / np.sqrt(12.0)]))


def _smooth(table: Array) -> Array:
    """Noise of piecewise-smooth columns (m, c): the smaller of the median and the mean estimate."""
    columns = [_measured(column)[:, None] for column in table.T]
    usual = [float(np.median(np.abs(third_differences(column)))) / MEDIAN for column in columns]
    return np.array([min(one, float(white_noise(column)[0])) for one, column in zip(usual, columns, strict=True)])


def _measured(column: Array) -> Array:
    """Readings of a column (m,) that was interpolated between fewer; all of them if it was not."""
    kinks = np.flatnonzero(np.abs(np.diff(column, n=2)) > EXACT * np.abs(column).max()) + 1
    every = round(len(column) / max(len(kinks), 1))
    return column if every < 2 or len(kinks) < FEWEST else column[kinks[0] :: every]
