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
from masking.inference.discovery import discrepancy, fitting, verdict
from masking.inference.discovery.composites import are_composite
from masking.inference.discovery.explanation import Explanation, in_both, nearest
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.search import SearchResult
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


def likeliest(found: SearchResult, validation: EstimationProblem) -> tuple[Explanation, ...]:
    """Explanations that are nearly as good as the best and those that lack causes of these, the likeliest in both.

    None has a cause in doubt, and each cause makes a part of the error on unseen data.
    """
    problem, like, near = found.problem, nearest(found.ranked), list[Explanation]()

    def simulated(one: Explanation) -> bool:
        doubt = _doubt(one, problem)
        if doubt:
            problem.trace.refuse(one.names, doubt)
            return False
        with suppress(IntegrationError):  # one whose motion ends in the other record is no answer
            near.append(replace(one, unseen=fitting.validated(validation, one.hypothesis)))
            return True
        return False

    most, others = np.inf, list[Explanation]()
    for one in found.ranked:
        if one.score(like) > most or len(near) >= problem.rules.most_fits:
            others.append(one)
        elif simulated(one):
            most = min(most, one.score(like) + problem.rules.validation_margin)

    def is_part(simple: Explanation, richer: Explanation) -> bool:
        return {*simple.names} < {*richer.names} or simple.is_inside(richer)

    for one in others:
        if any(is_part(one, richer) for richer in near):
            simulated(one)

    def is_idle(richer: Explanation) -> bool:
        rules = problem.rules  # causes that imitate another law are worth a name only where they leave far less
        most = rules.much_less**2 if are_composite(richer.names, problem.rig, rules) else 1.0 - rules.gain_fraction
        simpler = (one for one in near if is_part(one, richer))
        return any(_does_nearly_as_much(one, richer, most) for one in simpler)

    idle = [*filter(is_idle, near)]
    for one in idle:
        problem.trace.refuse(one.names, "a simpler one leaves hardly more of unseen data")
    sound = [one for one in near if not any(one is other for other in idle)]
    return tuple(sound[i] for i in np.argsort(in_both(sound), kind="stable")) if sound else (found.base,)


def weights(rivals: Sequence[Explanation]) -> list[float]:
    """Probabilities of explanations, the likeliest in both records first.

    Where the first leaves more than noise, one that leaves less of unseen data is as likely: what only the record says
    against that may be what both lack.
    """
    scores, unseen = in_both(rivals), [one.unseen for one in rivals if one.unseen is not None]
    first = rivals[0].hypothesis
    is_noise = verdict.reaches_noise(first.cost, first.residuals.size, first.rules)
    if len(unseen) == len(rivals) and not is_noise:
        like = fitting.nearest(unseen).independent
        left = [discrepancy.misfit(one.misfits, like) for one in unseen]
        most = left[0] - first.rules.indifferent
        scores = [min(score, scores[0]) if other < most else score for score, other in zip(scores, left, strict=True)]
    return [float(one) for one in verdict.probabilities(scores)]


def _does_nearly_as_much(simple: Explanation, richer: Explanation, most: float) -> bool:
    """Whether a special case of an explanation leaves hardly more of unseen data, if what it leaves is no chance.

    The richer one is to leave at most a part of its excess cost.
    """
    if simple.unseen is None or richer.unseen is None:
        return False
    size, rules = richer.unseen.residuals.size, simple.hypothesis.rules
    left, more = (float(one.misfits.sum()) for one in (simple.unseen, richer.unseen))
    if not verdict.is_excess(max(left, more), size, rules):
        return False
    return verdict.excess_cost(more, size) > most * verdict.excess_cost(left, size)


def _doubt(explanation: Explanation, problem: EstimationProblem) -> str:
    """Why one of several causes that leave more than noise is not given a name; '' where it is."""
    rules, names = problem.rules, explanation.names
    if len(names) < 2 or verdict.reaches_noise(explanation.cost, explanation.hypothesis.residuals.size, rules):
        return ""
    is_significant = explanation.kind != "effects" or explanation.last_strength >= rules.significant_deviations
    return "" if is_significant else "its last cause does not differ from nothing"


def no_worse(
    tried: Sequence[tuple[Explanation, ...]], problem: EstimationProblem, unseen: EstimationProblem, before: Hypothesis
) -> Given:
    """First explanation that is no worse on unseen data than the model as declared.

    Tried are rivals, the model with adjusted parameters, and the model as declared, which is no worse than itself and
    `before` on the validation record.
    """
    withheld, declared = None, float(before.squares @ unseen.weights)
    for rivals in tried[:-1]:
        chosen, alone = rivals[0], None
        causes = tuple(Cause(*key) for key in chosen.names)
        try:
            after = chosen.unseen or fitting.validated(unseen, chosen.hypothesis)
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
