"""Folded readings: those of a sensor that reads the same for several values, such as a magnitude.

The motion that such readings show is another one. Where it is known, they are unfolded: to first order, a value s is
read as h(s), so that a reading y is that of s + (y - h(s))/h'(s).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.excluded_laws import given
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.discovery.problem import EstimationProblem

STEP, FLAT = 1e-3, 0.1  # of the largest reading: for a slope; slopes below which a reading shows nothing of its value


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
