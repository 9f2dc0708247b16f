"""Answer by validation: the explanation to give, by how it does on the validation record.

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
from masking.inference.discovery import fitting, validation_simulation, verdict
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation, Unseen, in_both, nearest, on_unseen
from masking.inference.discovery.fitting import Hypothesis
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
    unseen: Unseen  # the explanation on the validation record
    withheld: Withheld | None = None  # what was worse on that, and came before
    # relative error of each sensor there of a fit to the estimation record alone, where it is fitted to both
    alone: dict[str, float] | None = None


def likeliest(found: SearchResult, base: Explanation, validation: EstimationProblem) -> tuple[Explanation, ...]:
    """Explanations that are nearly as good as the best and those that lack causes of these, the likeliest in both.

    The best is one whose causes imitate no other law; those that do are given only where they leave far less. None has
    a cause in doubt, and each cause makes a part of the error on unseen data. `base` is the model without causes,
    simulated along these.
    """
    problem, like, near = found.problem, nearest(found.ranked), list[Explanation]()

    def is_simulated(one: Explanation) -> bool:
        doubt = _doubt(one, problem)
        if doubt:
            problem.trace.refuse(one.names, doubt)
            return False
        with suppress(IntegrationError):  # one whose motion ends in the other record is no answer
            near.append(base if one is found.base else simulated(one, validation))
            return True
        return False

    most, others = np.inf, list[Explanation]()
    for one in found.ranked:
        if one.score(like) > most or len(near) >= problem.rules.most_fits:
            others.append(one)
        elif is_simulated(one) and not one.is_composite(problem.rig):
            most = min(most, one.score(like) + problem.rules.validation_margin)

    for one in others:
        if any(_is_part(one, richer) for richer in near):
            is_simulated(one)

    def is_idle(richer: Explanation) -> bool:
        rules, imitates = problem.rules, richer.is_composite(problem.rig)
        most = rules.much_less**2 if imitates else 1.0 - rules.gain_fraction

        def is_simpler(one: Explanation) -> bool:
            is_plainer = imitates and 0 < len(one.names) < len(richer.names) and not one.is_composite(problem.rig)
            return is_plainer or _is_part(one, richer)

        simpler = filter(is_simpler, near)
        return any(_does_nearly_as_much(one, richer, most) for one in simpler)

    idle = [*filter(is_idle, near)]
    for one in idle:
        problem.trace.refuse(one.names, "a simpler one leaves hardly more of unseen data")
    sound = [one for one in near if not any(one is other for other in idle)]
    return tuple(sound[i] for i in np.argsort(in_both(sound), kind="stable")) if sound else (base,)


def _is_part(simple: Explanation, richer: Explanation) -> bool:
    return {*simple.names} < {*richer.names} or simple.is_inside(richer)


def simulated(one: Explanation, validation: EstimationProblem) -> Explanation:
    """Explanation along unseen data; errors as `fitting.fit`."""
    alone = validation_simulation.validated(validation, one.hypothesis)
    is_noise = verdict.reaches_noise(float(alone.misfits.sum()), alone.residuals.size, validation.rules)
    within = alone.as_given if is_noise else validation_simulation.predicted(validation, one.hypothesis, alone)
    return replace(one, unseen=Unseen(alone.as_given, within))


def weights(rivals: Sequence[Explanation]) -> list[float]:
    """Probabilities of explanations, the likeliest in both records first.

    Where the first leaves more than noise, one that leaves less of unseen data, by the estimates and within their
    uncertainty, is as likely: what only the record says against that may be what both lack.
    """
    scores, first = in_both(rivals), rivals[0].hypothesis
    if not verdict.reaches_noise(first.cost, first.residuals.size, first.rules):
        views = [on_unseen(rivals, view) for view in Unseen._fields]
        for i in range(1, len(rivals)):
            if all(left[i] < left[0] - first.rules.indifferent for left in views):
                scores[i] = min(scores[i], scores[0])
    return [float(one) for one in verdict.probabilities(scores)]


def _does_nearly_as_much(simple: Explanation, richer: Explanation, most: float) -> bool:
    """Whether a special case of an explanation leaves hardly more of unseen data, if what it leaves is no chance.

    The richer one is to leave at most a part of its excess cost, by the estimates or within their uncertainty.
    """
    if simple.unseen is None or richer.unseen is None:
        return False
    size, rules = richer.unseen.alone.residuals.size, simple.hypothesis.rules

    def is_no_less(one: Hypothesis, other: Hypothesis) -> bool:
        left, more = float(one.misfits.sum()), float(other.misfits.sum())
        is_shown = verdict.is_excess(max(left, more), size, rules)
        return is_shown and verdict.excess_cost(more, size) > most * verdict.excess_cost(left, size)

    return all(is_no_less(one, other) for one, other in zip(simple.unseen, richer.unseen, strict=True))


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

    Tried are rivals, the model with adjusted parameters, both simulated along unseen data as far as their motion is
    finite there, and the model as declared, which is no worse than itself and `before` on the validation record.
    """
    withheld, declared = None, float(before.squares @ unseen.weights)
    for rivals in tried[:-1]:
        chosen, later, alone = rivals[0], rivals[0].unseen, None
        causes = tuple(Cause(*key) for key in chosen.names)
        if later is None:
            withheld = withheld or Withheld(causes, None)
            continue
        made = None
        with suppress(IntegrationError):
            made = _pooled(chosen, later.alone, problem, unseen)
        if made is not None:
            alone = unseen.errors(later.alone.squares)
            chosen, later = made[0], Unseen(made[1], made[1])
        cost, size = float(later.alone.squares @ unseen.weights), later.alone.residuals.size
        if not verdict.is_worse(cost, declared, size, problem.rules):
            return Given(rivals, chosen, later, withheld, alone)
        withheld = withheld or Withheld(causes, unseen.errors(later.alone.squares))
    return Given(tried[-1], tried[-1][0], Unseen(before, before), withheld)


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
    joint = fitting.together(free, validation, fitted, after.start)
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
