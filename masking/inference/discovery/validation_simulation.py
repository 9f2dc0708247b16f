"""Validation by simulation: a hypothesis along a record that it was not fitted to."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import continuation, fitting
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.excluded_laws import first_states
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.estimation.initial_states import FIRST_READINGS
from masking.inference.estimation.simulation import PARTS, STUCK


def validated(problem: EstimationProblem, hypothesis: Begun, rival: float = np.inf) -> Hypothesis:
    """Hypothesis on a validation record: its initial state alone is fitted, by parts if need be.

    Errors as `fitting.fit`.
    """
    fitted = partial(fitting.fit, instances=hypothesis.instances, theta=hypothesis.theta, frozen=True, rival=rival)
    found, record = fitted(problem), problem.record
    if problem.interval or found.cost < STUCK * record.readings.size:
        return found
    for guess in first_states(problem, hypothesis):
        start = guess
        with suppress(IntegrationError):
            for part in PARTS:
                if part * len(record) >= FIRST_READINGS:
                    begin = replace(problem, record=record.first(part * len(record) / record.rate))
                    start = fitted(begin, start=start).start
            found = min(found, fitted(problem, start=start), key=lambda one: one.cost)
        if found.cost < STUCK * record.readings.size:
            break
    return found


def predicted(problem: EstimationProblem, known: Hypothesis, alone: Hypothesis) -> Hypothesis:
    """Hypothesis on unseen data, with the parameters of the rig as uncertain as its own record leaves them.

    The effects are as they were found. `alone` is what `validated` gives: the parameters go from there.
    Source: Gelman et al. (2013), Bayesian Data Analysis, section 6.3, for predictions as uncertain as parameters are.
    """
    prior, size = problem.prior, known.deviations[: len(known.theta)]
    deviation = np.where(size > 0.0, np.minimum(size, prior.deviation), prior.deviation)
    wider = replace(problem, prior=replace(prior, mean=known.theta, deviation=deviation))
    fixed = tuple(replace(one, free=()) for one in known.instances)
    stays = alone.as_given
    made = fitting.solved(wider, Begun(fixed, known.theta, alone.start), rounds=continuation.ROUNDS)
    return made if made is not None and made.misfit(made) < stays.misfit(made) else stays
