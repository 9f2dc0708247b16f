"""More causes: the candidates that a screen puts first, alone or in pairs, fitted beside what an explanation has.

A fit begins with the parameters of the model that suit its effects best.

Along a motion that sticks no law has the force that holds it. To first order along a wrong motion any law may look
best, with a shape that is far from its own. So where the fits of what a screen puts first leave much, every law that
sticks or has a shape is fitted from afar, in a few rounds from each of its starts along the motion of the model that
lacks it, and those that come nearest to the end.

Two laws may explain a residual together, where either alone takes little. They share a place, or are one law in both
directions between two coordinates. A free decay that dry friction and drag damp looks linear to each of them: what is
nearly constant at one amplitude takes from the declared damping what grows with another. Of a gyroscopic force, either
direction alone changes the energy, which both together keep. The scores of pairs come from the products of what
candidates do to the sensors, as single ones do.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import continuation, fitting, validation_simulation, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.excluded_laws import folds, is_excluded
from masking.inference.discovery.explanation import Explanation, Job, are_composite, fitted
from masking.inference.discovery.fitting import Begun, Hypothesis, bounds
from masking.inference.discovery.places import both_of
from masking.inference.discovery.screening import Score, Screen, best_factors
from masking.inference.discovery.search_state import Ground
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
    folding = [one for one in others if folds(ground.problem, one.instance)]  # the motion that they read is another
    jobs = [adding.job((one,)) for one in folding if not is_excluded(ground.problem, [one.instance])]
    found += [one for one in ground.noted(move, jobs, least) if one.cost < least]
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
        simpler = {(name, at) for effect, at in keys for name in ground.nested.get(effect, ())} - keys - {*now.names}
        inside = {name for names in ground.nested.values() for name in names}
        nested = simpler | {key for key in keys if key[0] in inside}
        others = [score for score in scores if score.candidate.key in nested and not _is_among(score, chosen)]
        first = {score.candidate.key: score for score in [*others[::-1], *chosen]}
        chosen += [score for score in others if first[score.candidate.key] is score]
        return cls(chosen, [score for score in others if not _is_among(score, chosen)])


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
            start = validation_simulation.validated(self.problem, Begun(every, theta, start)).start
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


def from_afar(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with the laws that come nearest from any of their starts; beside the model without causes alone."""
    least = min(one.cost for one in table)
    seen = None if now.names or ground.is_near(least) else ground.screened(now)
    if seen is None:
        return []
    problem = ground.problem.apart(ground.rules.afar)
    starts = [(score, one) for score in seen[1] for one in _starts(ground, score)]
    made = fitted([partial(_begun, problem, now.hypothesis, one) for _, one in starts], np.inf, problem.work)
    ended = ((score, one) for (score, _), one in zip(starts, made, strict=True) if one is not None)
    best = dict[Key, Hypothesis]()
    for score, one in sorted(ended, key=lambda pair: pair[1].cost):
        best.setdefault(score.candidate.key, one)
    near = [*best.items()][: ground.rules.few_fits]
    jobs = [ground.refit((key,), one.instances, replace(now, hypothesis=one)) for key, one in near]
    return ground.noted("nearest of all laws and starts", jobs, least)


def _starts(ground: Ground, score: Score) -> Sequence[EffectInstance]:
    """Instances of a candidate from which it is fitted; of one that sticks, with the level that the screen gives."""
    candidate = score.candidate
    if candidate.sticks and not candidate.entry.nested:
        every = [score.instance] if candidate.factors else candidate.instances
        return [ground.problem.in_steps(one, sticks=True) for one in every]
    is_shaped = bool(candidate.factors) and candidate.has_shape and not candidate.sticks
    return candidate.instances if is_shaped else ()


def _begun(problem: EstimationProblem, known: Hypothesis, one: EffectInstance, rival: float) -> Hypothesis | None:
    """Fit in a few rounds from the parameters and initial states of the model alone, whatever its rival."""
    return fitting.solved(problem, Begun((one,), known.theta, known.start), rounds=continuation.ROUNDS)


@dataclass(frozen=True)
class Pair:
    """Two laws: scores with the factors that fit best together, and what they could take off the cost."""

    scores: tuple[Score, Score]
    gain: float


def pairs(screen: Screen, scores: Sequence[Score]) -> list[Pair]:
    """Pairs of laws that may belong together, of single candidates with their best shapes, the best first."""
    found, groups = list[Pair](), dict[tuple[str, ...], list[Score]]()
    for score in scores:
        groups.setdefault(_group(score), []).append(score)
    for group, own in groups.items():
        if not group or len(own) < 2:
            continue
        made = screen.products([(score.candidate, score.instance) for score in own])
        for (first, i), (second, j) in itertools.combinations(zip(own, made.columns, strict=True), 2):
            if first.candidate.key == second.candidate.key:
                continue
            part = np.concatenate([i, j])
            gram, right = made.gram[np.ix_(part, part)], made.right[part]
            factors = best_factors(gram, right, made.squares[part])
            both = _with_factors(first, factors[: len(i)]), _with_factors(second, factors[len(i) :])
            if both[0] and both[1]:
                found.append(Pair((both[0], both[1]), float(2.0 * factors @ right - factors @ gram @ factors)))
    return sorted(found, key=lambda pair: -pair.gain)


def pairs_of_causes(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with two more causes that belong together."""
    rules = ground.rules
    alone = min(one.cost for one in table)
    if ground.is_noise(alone) or len(now.names) + 2 > rules.most_effects:
        return []
    seen = ground.screened(now)
    if seen is None:
        return []
    screen, scores = seen
    noise = float(ground.size // screen.every)
    left = rules.much_less * verdict.excess_cost(alone, ground.size)
    most = rules.fit_ratio * left / verdict.excess_cost(now.cost, ground.size) * (screen.total - noise)
    chosen = list[Pair]()
    for pair in pairs(screen, scores):
        names = (*now.names, *(score.candidate.key for score in pair.scores))
        if screen.total - pair.gain - noise > most or len(chosen) == rules.few_fits:
            break
        if len({*names}) == len(names) and not are_composite(names, ground.problem.rig, rules):
            chosen.append(pair)
    adding = Addition(ground, now, screen)
    return ground.noted("two causes at one place", [adding.job(pair.scores) for pair in chosen], alone)


def _group(score: Score) -> tuple[str, ...]:
    """Key that laws of a pair share: a place, or the law and its two coordinates; empty for other laws.

    At one place, laws that are linear, or in which a simpler one is nested, are left to a search step by step.
    """
    entry, at = score.candidate.entry, score.candidate.at
    if entry.directed == "coordinate":
        return score.candidate.effect, *sorted(both_of(at))
    is_element = score.instance.where == "element" and bool(score.candidate.factors)
    is_simple = is_element and not (entry.nested or entry.is_linear or entry.absorbed_by or entry.scaled)
    return (at,) if is_simple else ()


def _with_factors(score: Score, factors: Array) -> Score | None:
    """Score with other factors; None where they are beyond their bounds."""
    if (factors <= bounds([replace(score.instance, free=score.candidate.factors)]).low).any():
        return None
    return replace(score, instance=score.instance.with_values(score.candidate.factors, factors))
