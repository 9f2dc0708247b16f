"""Tempered fits: the residual counts as noise, so that the prior holds the parameters of the rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem

NEARER = 0.7  # of what effects left before, to go on with their approach
ROUNDS = 12  # of each fit on the way


def approached(
    problem: EstimationProblem, instances: Sequence[EffectInstance], known: Hypothesis, *, once: bool = False
) -> Hypothesis:
    """Effects on the way from what is known of a rig: what they leave counts as noise, while that goes down.

    Far from the values of an effect, parameters of the rig take whatever value stands best for it, and none leads from
    there to the effect. With a residual that is weighted by its own size they stay as near as their prior holds them.
    With `once`, they end where what they leave would count for less. Errors as `fitting.fit`.
    """
    begun, left, size = fitting.Begun(tuple(instances), known.theta, known.start), np.inf, problem.record.readings.size
    found, now = None, fitting.cost(problem, instances, known.theta, known.start)
    while 1.0 < now / size < NEARER * left:
        left = now / size
        made = fitting.solved(replace(problem, sigma=np.sqrt(left) * problem.sigma), begun, rounds=ROUNDS)
        if made is None:
            break
        now = fitting.cost(problem, made.instances, made.theta, made.start)
        begun, found = fitting.Begun.at(made), replace(made, cost=now)
        if once:
            break
    if found is None:
        raise IntegrationError("the simulated motion is no longer finite")
    return found


def tempered(problem: EstimationProblem, known: Hypothesis, penalty: Array | None = None) -> Hypothesis:
    """Hypothesis with the record weighted as its residual allows, and the prior as it is; the penalty as in `fit`.

    The cost takes all of a residual for white noise. What a missing force leaves is far larger, and its likelihood is
    divided by the tempering factor. Directions that the record hardly determines then go back to the prior.
    """
    factor = problem.tempering(known.residuals)
    if factor <= problem.rules.slow_excess:
        return known
    begun = fitting.Begun.at(known)
    found = fitting.solved(replace(problem, sigma=np.sqrt(factor) * problem.sigma), begun, penalty=penalty)
    if found is None:
        return known
    pull = (found.theta - problem.prior.mean) / problem.prior.deviation
    rough = 0.0 if penalty is None else float(found.added @ penalty @ found.added)
    cost = float(found.squares @ problem.weights + pull @ pull) + rough
    return replace(found, cost=cost, covariance=found.covariance / factor)
