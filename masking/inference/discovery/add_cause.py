"""One or two more causes: fits with more effects than an explanation has, from the parameters that suit them best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.excluded_laws import is_excluded
from masking.inference.discovery.explanation import Explanation, Job
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import Score, Screen

LESS = (0.25, 0.06, 0.015)  # parts of an effect to begin a fit with
ENOUGH = 0.5  # of the gain in a screen: values that take so much off the cost are near enough to begin from


@dataclass(frozen=True)
class Addition:
    """More effects in an explanation."""

    problem: EstimationProblem
    now: Explanation
    screen: Screen

    def job(self, scores: Sequence[Score], known: Explanation | None = None) -> Job:
        """Fit with the effects of scores; `known` is the same in larger steps of integration."""
        begin = partial(self._fitted, tuple(scores)) if known is None else partial(self._repeated, known)
        return partial(self._or_with_less, tuple(scores), begin)

    def _or_with_less(self, scores: Sequence[Score], begin: Job, rival: float) -> Explanation:
        """Fit; where that ends worse than without the effects, as at a sharp resonance, it begins again with less."""
        found, now = begin(rival), self.now.hypothesis
        if found.hypothesis.cost <= now.cost:
            return found
        less = ([ready(self.problem, score).with_factors_times(part) for score in scores] for part in LESS)
        here = now.theta, now.start
        better = (self._begun(scores, some, here, rival) for some in less if self._cost(some, here) < now.cost)
        return min(found, next(better, found), key=lambda e: e.hypothesis.cost)

    def _fitted(self, scores: Sequence[Score], rival: float) -> Explanation:
        """Fit from screened parameters, or from those as they are or declared where these cost less."""
        made, now = [ready(self.problem, score) for score in scores], self.now.hypothesis
        at = self.screen.around([score.instance for score in scores])
        least = self._cost(made, at)
        if now.cost - least < ENOUGH * max(score.gain for score in scores):
            others = ((now.theta, now.start), (self.problem.prior.mean, now.start))
            costs = [self._cost(made, other) for other in others]
            at = others[int(np.argmin(costs))] if min(costs) <= least else at
        return self._begun(scores, made, at, rival)

    def _repeated(self, known: Explanation, rival: float) -> Explanation:
        return replace(known, hypothesis=fitting.repeated(self.problem, known.hypothesis, rival))

    def _begun(
        self, scores: Sequence[Score], instances: Sequence[EffectInstance], at: tuple[Array, Array], rival: float
    ) -> Explanation:
        every = (*self.now.hypothesis.instances, *instances)
        found = fitting.fit(self.problem, every, theta=at[0], start=at[1], rival=rival)
        names = (*self.now.names, *(score.candidate.key for score in scores))
        return Explanation("effects", names, found, min(score.unique for score in scores))

    def _cost(self, instances: Sequence[EffectInstance], at: tuple[Array, Array]) -> float:
        return fitting.cost(self.problem, (*self.now.hypothesis.instances, *instances), *at)


def ready(problem: EstimationProblem, score: Score) -> EffectInstance:
    """Instance of a score that a fit begins with, not excluded."""
    every = (score.instance, *score.candidate.instances[::-1])
    first = next((one for one in every if not is_excluded(problem, [one])), score.instance)
    return in_steps(problem, first, score.candidate)


def in_steps(problem: EstimationProblem, instance: EffectInstance, candidate: Candidate) -> EffectInstance:
    """Instance, with the step of integration if it sticks."""
    rig, step = problem.rig, problem.dt / problem.substeps
    return instance.at_step(rig.mobilities[instance.at], step) if candidate.sticks else instance
