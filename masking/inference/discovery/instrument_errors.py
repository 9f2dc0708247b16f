"""Instrument errors: small errors of gain, zero and time that every rig has, adjusted as its parameters are.

One or two of them beside a missing effect are causes like any other. More of them take up the causes that an
explanation may have, and laws that resemble them are found in the place of the right one. Where the laws of a first
round leave hardly anything once all of them are adjusted, and no two of them do as much, the search is repeated with
all, each with a normal prior around none.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from masking.compile.numerics import decompositions
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.composites import are_composite
from masking.inference.discovery.explanation import Explanation, nearest, noted
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.search import Search, SearchResult, Tell
from masking.model.effects import DELAY, GAINS_AND_ZEROS

GAIN = 0.02  # standard deviation of the gain of a sensor or an actuator, relative
OFFSET = 0.02  # that of its zero, in parts of its rms
LATE = 1.0  # that of the time by which all actuators are late, in samples
MOST = 3.0  # standard deviations: what is larger is a cause
FEW = 2  # imperfections that are left to be causes
TRIED = 3  # explanations of the first round that are fitted with all imperfections


def searched(problem: EstimationProblem, tell: Tell, substeps: int = 0) -> tuple[SearchResult, EstimationProblem]:
    """Search for causes, where many imperfections hide them with these adjusted, and the problem in which that was.

    Arguments are those of `Search` and `Search.run`.
    """
    if problem.rig.imperfections:
        return _in_problem(Search(problem, tell), substeps)
    trial = _Trial()
    found, known = _in_problem(Search(problem, tell, ends=trial.ends), substeps)
    is_settled = _is_complete(known, found) and not (trial.is_near and _laws(_last(found)) > 1)
    if not trial.is_shown and (is_settled or not trial.is_likely):
        return found, known
    tell("small errors of sensors and actuators are adjusted", 0.0)
    again, wider = _in_problem(Search(with_imperfections(problem), tell), substeps)
    is_better = not _is_complete(known, found) or _is_likelier(_last(again), _last(found))
    if _is_complete(wider, again) and (trial.is_shown or is_better):
        return again, wider
    if trial.is_shown:  # the first search ended early
        found, known = _in_problem(Search(problem.apart(), tell), substeps)
        if not _is_complete(known, found) and _last(again).cost < _last(found).cost:
            return again, wider
    return found, known


def _in_problem(search: Search, substeps: int) -> tuple[SearchResult, EstimationProblem]:
    found = search.run(substeps)
    return found, found.problem or search.problem


@dataclass
class _Trial:
    """Whether imperfections hide what is missing, by laws of a first round that are fitted with them."""

    is_likely: bool = False  # whether the laws leave far less with them
    is_near: bool = False  # whether one leaves hardly anything
    is_shown: bool = False  # whether it does so with more than a few imperfections

    def ends(self, problem: EstimationProblem, found: Sequence[Explanation]) -> bool:
        """Whether the search ends after its first round, to be repeated with imperfections."""
        size, rules = problem.record.readings.size, problem.rules
        laws = [one for one in found if one.kind == "effects" and _laws(one)]
        if not laws or verdict.reaches_noise(found[0].cost, size, rules):
            return False
        wider, alone = with_imperfections(problem), min(verdict.excess_cost(one.cost, size) for one in laws)
        most = size + max(rules.unexplained_fraction, rules.trace_fraction) * alone
        for made in noted(
            wider, "with all instrument errors", [partial(_beside, wider, one) for one in laws[:TRIED]], most
        ):
            if made is not None:
                left = verdict.excess_cost(made.cost, size)
                self.is_likely |= left < rules.unexplained_fraction * alone
                is_near = left < rules.trace_fraction * alone or verdict.reaches_noise(made.cost, size, rules)
                self.is_near |= is_near
                self.is_shown |= is_near and not _suffice(wider, made.hypothesis)
        return self.is_shown


def _laws(explanation: Explanation) -> int:
    return sum(name not in {*GAINS_AND_ZEROS, DELAY.name} for name, _ in explanation.names)


def _last(found: SearchResult) -> Explanation:
    return found.steps[-1][0] if found.steps else found.base


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


def _is_likelier(one: Explanation, other: Explanation) -> bool:
    like = nearest([one, other])
    return one.score(like) < other.score(like)


def _is_complete(problem: EstimationProblem, found: SearchResult) -> bool:
    last = _last(found)
    is_noise = verdict.reaches_noise(last.cost, problem.record.readings.size, problem.rules)
    return is_noise and not are_composite(last.names, problem.rig, problem.rules)


def with_imperfections(problem: EstimationProblem) -> EstimationProblem:
    """Problem in which imperfections are adjusted, too, with a count of work of its own."""
    pairs = [*_imperfections(problem)]
    instances, sizes = tuple(one for one, _ in pairs), np.array([size for _, size in pairs])
    most = MOST * sizes
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
