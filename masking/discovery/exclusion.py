"""Exclusion: laws that a record rules out by itself, whatever the motion was.

A sensor reads no more than its law can give: behind a limit nothing exceeds it, and what has no sign is never negative.
One whose gain would grow several times towards its ends is none: what bends so much is the motion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.discovery.augmented_model import EffectInstance
from masking.discovery.problem import EstimationProblem
from masking.numerics.arrays import Array

OUTLIERS = 10  # readings that exclude nothing: a motion that passes a limit stays there longer
STEEPER = 4.0  # times the slope in the middle, at the largest reading: twice the gain, of a cube
CHORD = 10  # points over which a slope is taken: a twentieth of the largest reading
REACH, POINTS = 10.0, 4001  # times the largest reading: the range of a law is that over these values of what is sensed


def is_excluded(problem: EstimationProblem, instances: Sequence[EffectInstance]) -> bool:
    """Return whether readings are beyond the range of the only law of their sensor, or of one that is far too steep.

    Args:
        problem: the record and the rig.
        instances: the effects of an explanation, with fitted values.
    """
    sensors = [one.at for one in instances if one.where == "sensor"]
    alone = [one for one in instances if one.where == "sensor" and sensors.count(one.at) == 1 and not one.entry.states]
    static = [one for one in instances if one.where == "sensor" and not one.entry.states]
    return any(_is_beyond(problem, one) for one in alone) or any(_is_steep(problem, one) for one in static)


def _given(problem: EstimationProblem, instance: EffectInstance) -> tuple[Array, Array]:
    """Return values of what a sensor senses, and what its law gives (m,)."""
    readings = problem.record.readings[:, problem.rig.index(instance)]
    sensed = REACH * float(np.abs(readings).max()) * np.linspace(-1.0, 1.0, POINTS)
    return sensed, problem.rig.along(instance, sensed, np.zeros(POINTS), problem.dt)[:, 0]


def _is_steep(problem: EstimationProblem, instance: EffectInstance) -> bool:
    """Return whether the gain of a sensor grows several times from the middle to the largest reading."""
    sensed, given = _given(problem, instance)
    largest = float(np.abs(problem.record.readings[:, problem.rig.index(instance)]).max())
    slopes, middle = (given[CHORD:] - given[:-CHORD]) / (sensed[CHORD:] - sensed[:-CHORD]), (POINTS - CHORD) // 2
    beyond = np.flatnonzero(np.abs(given[CHORD // 2 : -CHORD // 2]) > largest)
    within = slice(beyond[beyond < middle].max(initial=-1) + 1, beyond[beyond > middle].min(initial=len(slopes)))
    return bool(np.abs(slopes[within]).max() > STEEPER * np.abs(slopes[middle]) > 0.0)


def _is_beyond(problem: EstimationProblem, instance: EffectInstance) -> bool:
    rig, rules = problem.rig, problem.rules
    at = rig.index(instance)
    readings = problem.record.readings[:, at]
    _, given = _given(problem, instance)
    margin = rules.excluded_deviations * float(problem.sigma[at])
    beyond = (readings > given.max() + margin) | (readings < given.min() - margin)
    return int(beyond.sum()) > OUTLIERS
