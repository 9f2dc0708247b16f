"""Excluded laws: those that a record rules out by itself, whatever the motion was, and those that belie their names.

A sensor reads no more than its law can give: behind a limit nothing exceeds it, and what has no sign is never negative.
Friction that falls with the rate is no such friction where it grows, and what repeats does so within the record.

A sensor whose law reads the same for several values, such as a magnitude, folds: the motion that its readings show is
another one. Where that is known, they are unfolded: to first order, a value s is read as h(s), so that a reading y is
that of s + (y - h(s))/h'(s).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.discovery.smoothing import Motion
from masking.model.declaration.expression import Expression

OUTLIERS = 10  # readings that exclude nothing: a motion that passes a limit stays there longer
REACH, POINTS = 10.0, 4001  # times the largest reading: the range of a law is that over these values of what is sensed
STEP, FLAT = 1e-3, 0.1  # of the largest reading: for a slope; slopes below which a reading shows nothing of its value


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


def folds(problem: EstimationProblem, instance: EffectInstance) -> bool:
    """Whether a law of a sensor reads the same for several values within the readings."""
    if instance.where != "sensor" or instance.entry.states:
        return False
    return bool((np.diff(given(problem, instance, 1.0)) < 0.0).any())


def first_states(problem: EstimationProblem, known: Begun) -> Iterator[Array]:
    """Initial states (w, states) that the first readings show, of either sign where a sensor folds."""
    folded = [problem.rig.index(one) for one in known.instances if folds(problem, one)]
    for sides in itertools.product((1.0, -1.0), repeat=len(folded)):
        signs = np.ones(problem.record.readings.shape[1])
        signs[folded] = sides
        turned = replace(problem.record, readings=signs * problem.record.readings)
        yield replace(problem, record=turned).first_states(known.theta)


def unfolded(problem: EstimationProblem, known: Hypothesis) -> tuple[EstimationProblem, Hypothesis]:
    """Problem with unfolded readings, and a hypothesis there; the same where no sensor folds."""
    folding = [one for one in known.instances if folds(problem, one)]
    if not folding:
        return problem, known
    others = tuple(one for one in known.instances if one not in folding)
    made = problem.equations(known.theta, known.start, others, fitting.estimated(others), frozen=True)
    seen, readings = problem.record.readings, problem.record.readings.copy()
    for one in folding:
        i, small = problem.rig.index(one), STEP * float(np.abs(seen).max())
        s, rest = made.simulated[:, i], np.zeros(len(seen))
        low, at, high = (problem.rig.along(one, s + by, rest, problem.dt)[:, 0] for by in (-small, 0.0, small))
        slope = (high - low) / (2.0 * small)
        shows = np.abs(slope) > FLAT
        readings[:, i] = s + np.where(shows, (seen[:, i] - at) / np.where(shows, slope, 1.0), 0.0)
    there = replace(known, instances=others, residuals=readings - made.simulated)
    return replace(problem, record=replace(problem.record, readings=readings)), there
