"""One more cause: the candidates that a screen puts first, fitted beside what an explanation has.

A fit begins with the parameters of the model that suit its effects best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import fitting, unseen_data, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.excluded_laws import folds, is_excluded
from masking.inference.discovery.explanation import Explanation, Job
from masking.inference.discovery.fitting import Begun
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import Score, Screen
from masking.inference.discovery.verdict import Key
from masking.inference.discovery.wrong_parameters import scores as parameter_scores

LESS = (0.25, 0.06, 0.015)  # parts of an effect to begin a fit with


def one_more_cause(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with one more effect.

    The best scores set the mark for the others. Screens expect too much of others, so that where the fits leave more
    than noise, those that the screen puts beside the best fit are fitted, too. Laws of sensors that fold are fitted
    whatever it says, and count where they leave least. Of a law that does a part of what the best does, other shapes
    are fitted as well.
    """
    if len(now.names) >= ground.rules.most_effects or (now.names and now.is_composite(ground.problem.rig)):
        return []  # one more law would leave it composite
    seen = ground.screened(now)
    if seen is None:
        return []
    (screen, scores), adding, move = seen, Addition(ground, now, seen[0]), "one more cause"
    of_parameters = () if now.names else parameter_scores(ground.problem, now.hypothesis)
    best = max([*of_parameters, *(score.gain for score in scores)], default=0.0)
    chosen = _Chosen.of(ground, now, scores, screen, screen.total - best)
    ground.tell(f"fitting {len(chosen.worth)} of {len(scores)} candidates", 0.3)
    jobs = [adding.job((score,)) for score in chosen.worth]
    found = ground.noted(move, jobs[:2], now.cost)
    found += ground.noted(move, jobs[2:], min(one.cost for one in (now, *found)))
    others = [score for score in scores if not _is_among(score, chosen.worth) and score.candidate.key not in now.names]
    least = min(one.cost for one in (now, *found))
    folding = ground.noted(move, [adding.job((score,)) for score in others if _folds(ground, score)], least)
    found += [one for one in folding if one.cost < least]
    if not found:
        return []
    near = min((now, *found), key=lambda one: one.cost)
    if not ground.is_noise(near.cost):
        is_more = near.cost / screen.every > ground.worth(screen, screen.total - best)
        gain = next((one.gain for one in scores if one.candidate.key in near.names[-1:]), best)
        wider = _Chosen.of(ground, now, scores, screen, np.inf if is_more else screen.total - gain)
        more = [adding.job((score,)) for score in wider.worth if not _is_among(score, chosen.worth)]
        found += ground.noted("one of many that look alike", more, near.cost)
        chosen = wider
    rival = min(one.cost for one in found)
    least = ground.nearly(rival, now.cost)
    keys = {one.names[-1] for one in found if one.cost < least}
    again = [adding.job((score,)) for score in chosen.variants if score.candidate.key in keys]
    return found + ground.noted("another shape of a simpler cause", again, rival)


@dataclass(frozen=True)
class _Chosen:
    """Scores that are worth a fit, and those of other shapes of nested laws."""

    worth: list[Score]
    variants: list[Score]

    @classmethod
    def of(cls, ground: Ground, now: Explanation, scores: Sequence[Score], screen: Screen, left: float) -> _Chosen:
        """Scores that are worth a fit where the best leaves `left` in the screen."""
        rules, most, penalty = ground.rules, ground.worth(screen, left), float(np.log(ground.size))
        chosen: list[Score] = []
        for score in scores:
            pays = score.gain > penalty * len(score.candidate.free) + 0.5 * rules.effect_evidence
            if score.candidate.key in now.names or not pays or len(chosen) == rules.most_fits:
                continue
            if screen.total - score.gain < most or len(chosen) < rules.few_fits:
                chosen.append(score)
        if now.names and ground.is_noise(now.cost) and verdict.is_excess(now.cost, ground.size, rules):
            chosen = [score for score in chosen if score.gain > rules.gain_fraction * (now.cost - ground.size)]
        keys = {score.candidate.key for score in chosen}
        simpler = set[Key]().union(*map(ground.nested_in, keys)) - keys - {*now.names}
        inside = {name for names in ground.nested.values() for name in names}
        nested = simpler | {key for key in keys if key[0] in inside}
        others = [score for score in scores if score.candidate.key in nested and not _is_among(score, chosen)]
        first = {score.candidate.key: score for score in [*others[::-1], *chosen]}
        chosen += [score for score in others if first[score.candidate.key] is score]
        return cls(chosen, [score for score in others if not _is_among(score, chosen)])


def _folds(ground: Ground, score: Score) -> bool:
    """Whether a law of a sensor reads the same for several values: the motion that its readings show is another one."""
    return folds(ground.problem, score.instance) and not is_excluded(ground.problem, [score.instance])


def _is_among(score: Score, scores: Sequence[Score]) -> bool:
    return any(one is score for one in scores)


@dataclass(frozen=True)
class Addition:
    """More effects in an explanation."""

    ground: Ground
    now: Explanation
    screen: Screen

    @property
    def problem(self) -> EstimationProblem:
        """Record and rig."""
        return self.ground.problem

    def job(self, scores: Sequence[Score]) -> Job:
        """Fit with the effects of scores."""
        return partial(self._or_with_less, tuple(scores))

    def _or_with_less(self, scores: Sequence[Score], rival: float) -> Explanation:
        """Fit; where that ends worse than without the effects, as at a sharp resonance, it begins again with less."""
        found, now = self._fitted(scores, rival), self.now.hypothesis
        if found.hypothesis.cost <= now.cost:
            return found
        less = ([_with_part(ready(self.problem, score), part) for score in scores] for part in LESS)
        here = now.theta, now.start
        better = (self._begun(scores, some, here, rival) for some in less if self._cost(some, here) < now.cost)
        return min(found, next(better, found), key=lambda e: e.hypothesis.cost)

    def _fitted(self, scores: Sequence[Score], rival: float) -> Explanation:
        """Fit from screened parameters, or from those as they are or declared where these cost less."""
        made, now = [ready(self.problem, score) for score in scores], self.now.hypothesis
        at = self.screen.around([score.instance for score in scores])
        least = self._cost(made, at)
        if now.cost - least < self.problem.rules.much_less * max(score.gain for score in scores):
            others = ((now.theta, now.start), (self.problem.prior.mean, now.start))
            costs = [self._cost(made, other) for other in others]
            at = others[int(np.argmin(costs))] if min(costs) <= least else at
        return self._begun(scores, made, at, rival)

    def _begun(
        self, scores: Sequence[Score], instances: Sequence[EffectInstance], at: tuple[Array, Array], rival: float
    ) -> Explanation:
        every, (theta, start) = (*self.now.hypothesis.instances, *instances), at
        if any(folds(self.problem, one) for one in instances):  # the motion so far is another one
            start = unseen_data.validated(self.problem, Begun(every, theta, start)).start
        found = fitting.fit(self.problem, every, theta=theta, start=start, rival=rival)
        names = (*self.now.names, *(score.candidate.key for score in scores))
        return Explanation("effects", names, found)

    def _cost(self, instances: Sequence[EffectInstance], at: tuple[Array, Array]) -> float:
        return fitting.cost(self.problem, (*self.now.hypothesis.instances, *instances), *at)


def _with_part(one: EffectInstance, part: float) -> EffectInstance:
    return one.times(part, [i for i, name in zip(one.free, one.names, strict=True) if name in one.entry.factors])


def ready(problem: EstimationProblem, score: Score) -> EffectInstance:
    """Instance of a score that a fit begins with, not excluded."""
    every = (score.instance, *score.candidate.instances[::-1])
    first = next((one for one in every if not is_excluded(problem, [one])), score.instance)
    return problem.in_steps(first, sticks=score.candidate.sticks)
