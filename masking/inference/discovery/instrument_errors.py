"""Instrument errors: small errors of gain, zero and time that every rig has, adjusted as its parameters are.

One or two of them beside a missing effect are causes like any other. More of them take up the causes that an
explanation may have, and laws that resemble them are found in the place of the right one. Where the laws of a first
round leave hardly anything once all of them are adjusted, and no two of them do as much, the search is repeated with
all, each with a normal prior around none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from masking.compile.numerics import decompositions
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation, ahead, noted
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.search import Search, SearchResult
from masking.inference.discovery.search_state import Tell
from masking.model.effects import DELAY, GAINS_AND_ZEROS

GAIN = 0.02  # standard deviation of the gain of a sensor or an actuator, relative
OFFSET = 0.02  # that of its zero, in parts of its rms
LATE = 1.0  # that of the time by which all actuators are late, in samples
FEW = 2  # imperfections that are left to be causes


def searched(problem: EstimationProblem, tell: Tell) -> SearchResult:
    """Search for causes, where many imperfections hide them with these adjusted."""
    search = Search.begun(problem, tell)
    if problem.rig.imperfections:
        return search.run()
    search.first_round()
    trial, found = _trial(search), None
    if not trial.is_shown:
        found = search.run()
        is_settled = _is_complete(found) and not (trial.is_near and _laws(found.best) > 1)
        if is_settled or not trial.is_likely:
            return found
    tell("small errors of sensors and actuators are adjusted", 0.0)
    again = Search.begun(with_imperfections(problem), tell).run()
    if found is None:  # the first search ended early
        if _is_complete(again):
            return again
        found = search.run()
        return again if not _is_complete(found) and again.best.cost < found.best.cost else found
    is_better = not _is_complete(found) or ahead(again.best, found.best) > 0.0
    return again if _is_complete(again) and is_better else found


@dataclass
class _Trial:
    """Whether imperfections hide what is missing, by laws of a first round that are fitted with them."""

    is_likely: bool = False  # whether the laws leave far less with them
    is_near: bool = False  # whether one leaves hardly anything
    is_shown: bool = False  # whether it does so with more than a few imperfections


def _trial(search: Search) -> _Trial:
    """Trial of the likeliest laws of a first round."""
    problem, found, trial = search.ground.problem, search.ground.ranked(search.table), _Trial()
    size, rules = problem.record.readings.size, problem.rules
    laws = [one for one in found if one.kind == "effects" and _laws(one)]
    if not laws or verdict.reaches_noise(found[0].cost, size, rules):
        return trial
    wider, alone = with_imperfections(problem), min(verdict.excess_cost(one.cost, size) for one in laws)
    most = size + max(rules.unexplained_fraction, rules.trace_fraction) * alone
    jobs = [partial(_beside, wider, one) for one in laws[: rules.few_fits]]
    for made in noted(wider, "with all instrument errors", jobs, most):
        if made is not None:
            left = verdict.excess_cost(made.cost, size)
            trial.is_likely |= left < rules.unexplained_fraction * alone
            is_near = left < rules.trace_fraction * alone or verdict.reaches_noise(made.cost, size, rules)
            trial.is_near |= is_near
            trial.is_shown |= is_near and not _suffice(wider, made.hypothesis)
    return trial


def _laws(explanation: Explanation) -> int:
    return sum(name not in {*GAINS_AND_ZEROS, DELAY.name} for name, _ in explanation.names)


def _beside(problem: EstimationProblem, one: Explanation, rival: float) -> Explanation:
    known = one.hypothesis
    theta = np.concatenate([known.theta, np.zeros(len(problem.rig.imperfections))])
    return replace(one, hypothesis=fitting.fit(problem, known.instances, theta=theta, start=known.start, rival=rival))


def _suffice(problem: EstimationProblem, known: Hypothesis) -> bool:
    """Whether a few of the imperfections explain as much as all of them do.

    What it costs to leave out the others is x' C^-1 x, for their values x and the covariance C of these.
    Source: Wald (1943), Trans. Am. Math. Soc. 54(3), 426-482.
    """
    first, many = len(problem.rig.names), len(problem.rig.imperfections)
    size = problem.prior.deviation[first:]
    values = known.theta[first:] / size
    covariance = known.covariance[first : first + many, first : first + many] / np.outer(size, size)
    costs = []
    for kept in itertools.combinations(range(many), min(FEW, many)):
        gone = [i for i in range(many) if i not in kept]
        information = decompositions.inverse(covariance[np.ix_(gone, gone)], hermitian=True)
        costs.append(float(values[gone] @ information @ values[gone]))
    return min(costs) < problem.rules.effect_evidence


def _is_complete(found: SearchResult) -> bool:
    problem, best = found.problem, found.best
    is_noise = verdict.reaches_noise(best.cost, problem.record.readings.size, problem.rules)
    return is_noise and not best.is_composite(problem.rig)


def with_imperfections(problem: EstimationProblem) -> EstimationProblem:
    """Problem in which imperfections are adjusted, too, with a count of work of its own."""
    pairs = [*_imperfections(problem)]
    instances, sizes = tuple(one for one, _ in pairs), np.array([size for _, size in pairs])
    most = problem.rules.excluded_spreads * sizes
    least = [0.0 if one.effect == DELAY.name else -size for one, size in zip(instances, most, strict=True)]
    wider = problem.prior.extended(len(problem.prior.mean), np.zeros(len(sizes)), sizes, least, most)
    apart = problem.apart().under("small errors of instruments adjusted")
    return replace(apart, rig=replace(problem.rig, imperfections=instances), prior=wider)


def _imperfections(problem: EstimationProblem) -> Iterator[tuple[EffectInstance, float]]:
    """Imperfections with the standard deviation of its prior; inputs that are a measured motion have none."""
    twin, record = problem.rig.twin, problem.record
    sensors = zip(twin.sensors, record.readings.T, itertools.repeat(GAINS_AND_ZEROS[:2]))
    actuators = zip(twin.actuators, record.commands.T, itertools.repeat(GAINS_AND_ZEROS[2:]))
    for at, values, (gain, offset) in (*sensors, *actuators):
        if at not in twin.measured_actuators:
            yield EffectInstance(gain, at, (0.0,), (0,)), GAIN
            yield EffectInstance(offset, at, (0.0,), (0,)), OFFSET * (float(np.sqrt((values**2).mean())) or 1.0)
    if twin.actuators and not twin.measured_actuators:
        yield EffectInstance(DELAY.name, "", (0.0,), (0,)), LATE * problem.dt
