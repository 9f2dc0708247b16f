"""Exclusion: laws that a record rules out by itself, whatever the motion was.

A sensor reads no more than its law can give: behind a limit nothing exceeds it, and what has no sign is never negative.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.discovery.augmented_model import EffectInstance
from masking.discovery.problem import EstimationProblem

OUTLIERS = 10  # readings that exclude nothing: a motion that passes a limit stays there longer
REACH, POINTS = 10.0, 4001  # times the largest reading: the range of a law is that over these values of what is sensed


def is_excluded(problem: EstimationProblem, instances: Sequence[EffectInstance]) -> bool:
    """Return whether readings are beyond the range of the only law of their sensor.

    Args:
        problem: the record and the rig.
        instances: the effects of an explanation, with fitted values.
    """
    sensors = [one.at for one in instances if one.where == "sensor"]
    alone = [one for one in instances if one.where == "sensor" and sensors.count(one.at) == 1 and not one.entry.states]
    return any(_is_beyond(problem, one) for one in alone)


def _is_beyond(problem: EstimationProblem, instance: EffectInstance) -> bool:
    rig, rules = problem.rig, problem.rules
    at = rig.index(instance)
    readings = problem.record.readings[:, at]
    sensed = REACH * float(np.abs(readings).max()) * np.linspace(-1.0, 1.0, POINTS)
    given = rig.along(instance, sensed, np.zeros(POINTS), problem.dt)[:, 0]
    margin = rules.excluded_deviations * float(problem.sigma[at])
    beyond = (readings > given.max() + margin) | (readings < given.min() - margin)
    return int(beyond.sum()) > OUTLIERS
