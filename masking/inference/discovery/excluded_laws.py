"""Excluded laws: those that a record rules out by itself, whatever the motion was, and those that belie their names.

A sensor reads no more than its law can give: behind a limit nothing exceeds it, and what has no sign is never negative.
Friction that falls with the rate is no such friction where it grows, and what repeats does so within the record.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.smoothing import Motion
from masking.model.declaration.expression import Expression

OUTLIERS = 10  # readings that exclude nothing: a motion that passes a limit stays there longer
REACH, POINTS = 10.0, 4001  # times the largest reading: the range of a law is that over these values of what is sensed


def is_excluded(problem: EstimationProblem, instances: Sequence[EffectInstance], motion: Motion | None = None) -> bool:
    """Whether readings are beyond the range of the only law of their sensor, or a law is not what it is called.

    What depends on how far a place moves is looked at where the smoothed motion is given.
    """
    sensors = [one.at for one in instances if one.where == "sensor"]
    alone = [one for one in instances if one.where == "sensor" and sensors.count(one.at) == 1 and not one.entry.states]
    return any(_is_beyond(problem, one) for one in alone) or any(
        _belies_its_name(problem, one, motion) for one in instances
    )


def is_beyond_instruments(problem: EstimationProblem, instances: Sequence[EffectInstance]) -> bool:
    """Whether an error of an instrument is larger than instruments have."""
    most = problem.rules.excluded_spreads
    pairs = [pair for one in instances for pair in zip(one.estimated, problem.spreads(one), strict=True)]
    return any(abs(value) > most * spread for value, spread in pairs)


def given(problem: EstimationProblem, instance: EffectInstance, reach: float) -> Array:
    """Readings of a law of a sensor, without a state, over values (v,) up to `reach` largest readings on both sides."""
    largest = float(np.abs(problem.record.readings[:, problem.rig.index(instance)]).max())
    sensed = reach * largest * np.linspace(-1.0, 1.0, POINTS)
    return np.asarray(problem.rig.along(instance, sensed, np.zeros(POINTS), problem.dt)[:, 0])


def _is_beyond(problem: EstimationProblem, instance: EffectInstance) -> bool:
    at, law = problem.rig.index(instance), given(problem, instance, REACH)
    readings = problem.record.readings[:, at]
    margin = problem.rules.excluded_deviations * float(problem.sigma[at])
    return int(((readings > law.max() + margin) | (readings < law.min() - margin)).sum()) > OUTLIERS


def _belies_its_name(problem: EstimationProblem, instance: EffectInstance, motion: Motion | None) -> bool:
    if not instance.entry.positive:
        return False
    condition = Expression(instance.entry.positive)
    known = dict(zip(instance.entry.parameters, instance.values, strict=True))
    known["duration"] = len(problem.record) * problem.dt
    if motion is not None and instance.where == "element":
        known["travel"] = float(np.ptp(motion.displacement[:, problem.rig.index(instance)]))
    return condition.names <= known.keys() and not condition.evaluate(known) > 0.0
