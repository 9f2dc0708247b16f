"""Held-out data: the explanation to give, by how it does on the validation record.

An explanation that is worse there than the model as declared is withheld. One that explains the estimation record may
still have a parameter that shows in the other one alone: a motion ends where friction holds it, a stop is touched late.
If a fit to both explains both as well as the first explained the one, it is given.

Source: Ljung (1999), System Identification, section 16.6, for validation by data that were not used; Gelman et al.
(2013), Bayesian Data Analysis, section 6.3, for predictions that are as uncertain as the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result
from masking.errors import IntegrationError
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.verdict import Cause


@dataclass(frozen=True)
class Withheld(Result):
    """What fits the estimation record best, but is worse on unseen data than the model as declared: it is not given."""

    causes: tuple[Cause, ...]  # (parameter, '') or (effect, place) of each; none for adjusted parameters alone
    # relative error of each sensor in the validation record, by name; None where the motion is not finite
    validation_error: dict[str, float] | None


@dataclass(frozen=True)
class Given:
    """The explanation to give."""

    rivals: tuple[Explanation, ...]  # the explanations that it was chosen from, itself first
    explanation: Explanation  # the prior holds what the record hardly determines
    after: Hypothesis  # the explanation on the validation record
    withheld: Withheld | None = None  # what was worse on that, and came before
    # relative error of each sensor there of a fit to the estimation record alone, where it is fitted to both
    alone: dict[str, float] | None = None


def no_worse(
    tried: Sequence[tuple[Explanation, ...]], problem: EstimationProblem, unseen: EstimationProblem, before: Hypothesis
) -> Given:
    """First explanation that is no worse on unseen data than the model as declared.

    Tried are rivals, the model with adjusted parameters, and the model as declared, which is no worse than itself and
    `before` on the validation record.
    """
    withheld, declared = None, float(before.squares @ unseen.weights)
    for rivals in tried[:-1]:
        chosen, alone = replace(rivals[0], joint=None), None
        causes = tuple(Cause(*key) for key in chosen.names)
        try:
            after = fitting.validated(unseen, chosen.hypothesis)
        except IntegrationError:
            withheld = withheld or Withheld(causes, None)
            continue
        made = None
        with suppress(IntegrationError):
            made = _pooled(chosen, after, problem, unseen)
        if made is not None:
            alone = unseen.errors(after.squares)
            chosen, after = made
        cost = float(after.squares @ unseen.weights)
        if not verdict.is_worse(cost, declared, after.residuals.size, problem.rules):
            return Given(rivals, chosen, after, withheld, alone)
        withheld = withheld or Withheld(causes, unseen.errors(after.squares))
    return Given(tried[-1], tried[-1][0], before, withheld)


def _pooled(
    chosen: Explanation, after: Hypothesis, problem: EstimationProblem, validation: EstimationProblem
) -> tuple[Explanation, Hypothesis] | None:
    """Explanation fitted to both records, and it on the validation record; errors as `fitting.together`.

    None where it explains that as well as the estimation record already, a fit to both explains either less well, or
    the residual is not small.
    """
    rules, free, fitted = problem.rules, chosen.with_prior(problem), chosen.hypothesis
    least = verdict.noise_threshold(min(len(problem.record), len(validation.record)), rules)
    alone = rules.noise_floor * _over_noise(fitted, problem)

    def is_explained(found: Hypothesis, record: EstimationProblem) -> bool:
        left = _over_noise(found, record)
        return bool(((left <= least) | (left <= alone)).all())

    if fitted.cost > rules.small_residual * fitted.residuals.size or is_explained(after, validation):
        return None
    joint = fitting.together(free, validation, fitted)
    starts = joint.start[: problem.intervals], joint.start[problem.intervals :]
    seen, unseen = (
        fitting.fit(part, joint.instances, theta=joint.theta, start=start, frozen=True)
        for part, start in zip((free, validation), starts, strict=True)
    )
    if not (is_explained(seen, problem) and is_explained(unseen, validation)):
        return None
    return replace(chosen, hypothesis=replace(seen, covariance=joint.covariance)), unseen


def _over_noise(found: Hypothesis, problem: EstimationProblem) -> Array:
    """Rms of the residual of each sensor over that of its noise (sensors,)."""
    errors, floor = problem.errors(found.squares), problem.noise_floor
    return np.array([errors[name] / floor[name] for name in floor])
