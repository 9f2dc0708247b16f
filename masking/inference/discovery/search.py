"""Search: the best explanation of the residual: nothing, a wrong parameter, or effects, one after the other.

Hypotheses are compared by their cost, -2 log likelihood with the priors of the rig's parameters, and the Occam factor
of the added ones. What the best hypothesis leaves beyond noise says how much the residual of each is worth, see
`discrepancy`.
Source: Kass and Raftery (1995), JASA 90(430), 773-795; for what is worth a fit, Schwarz (1978), Ann. Stat. 6, 461.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import fitting, simpler_explanations, sticking_laws, verdict, wrong_parameters
from masking.inference.discovery import shooting_intervals as shooting
from masking.inference.discovery.add_cause import Addition, in_steps, ready
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import candidates
from masking.inference.discovery.composites import are_composite
from masking.inference.discovery.excluded_laws import is_beyond_instruments, is_excluded
from masking.inference.discovery.explanation import Explanation, Job, nearest, noted
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.pairs_of_causes import pairs_first
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.rules import DecisionRules
from masking.inference.discovery.screening import Score, Screen
from masking.inference.discovery.signal_ranges import spans
from masking.inference.discovery.smoothing import Motion, smooth
from masking.inference.discovery.verdict import Key
from masking.inference.discovery.views_of_record import Ground, views

Tell = Callable[[str, float], None]
Fits = dict[int, "Explanation"]  # of one more cause each, by the candidate; of a parameter by -1 and less

FAR = 4.0  # times the cost of the best fit in large steps, from which one is not repeated in small ones: twice its rms


@dataclass(frozen=True)
class SearchResult:
    """What a search found: the steps that were taken, and the explanations of the last, best first."""

    base: Explanation  # the model, its parameters fitted within their priors
    steps: tuple[tuple[Explanation, ...], ...]  # the explanations that were compared in each step, the best first
    motion: Motion  # smoothed record
    tried: tuple[Score, ...] = ()  # what each candidate could take off at first, the best first
    # the record, in the integration steps that the laws need; by default those of the model
    problem: EstimationProblem | None = None
    # steps of which the last is the likeliest law, in the place of which a nested one was taken
    passed_over: tuple[tuple[Explanation, ...], ...] = ()


@dataclass(frozen=True)
class Search:
    """A search in one record."""

    problem: EstimationProblem
    tell: Tell = lambda text, part: None  # called with what is done, and the fraction done
    rough: EstimationProblem | None = None  # the problem in the steps of the model alone, where laws need smaller ones
    # of each round by the causes before it, in those steps
    fits: dict[tuple[Key, ...], Fits] = field(default_factory=dict)
    # given the explanations of the first round, returns whether the search ends there
    ends: Callable[[EstimationProblem, Sequence[Explanation]], bool] = lambda problem, found: False

    @property
    def rules(self) -> DecisionRules:
        """Thresholds of all decisions."""
        return self.problem.rules

    @property
    def size(self) -> int:
        """Number of readings."""
        return self.problem.record.readings.size

    @cached_property
    def nested(self) -> dict[str, tuple[str, ...]]:
        """Simpler effects that are nested in each effect."""
        return {name: effect.nested for name, effect in self.problem.rig.twin.dictionary.items()}

    def _nested_in(self, key: Key) -> set[Key]:
        effect, at = key
        return {(name, at) for name in self.nested.get(effect, ())}

    def run(self, substeps: int = 0) -> SearchResult:
        """Search for causes, one after the other, until none is worth its complexity penalty.

        Models with effects are integrated in as many steps between samples as they need, where none are given.
        """
        self.tell("fitting the model as it is", 0.0)
        plain = fitting.fit(self.problem)
        base = Explanation("none", (), plain)
        self.problem.trace.tried.append(base.tried(self.problem.trace.reading, "parameters within their priors"))
        self.tell("smoothing the motion", 0.1)
        motion = smooth(self.problem, base.hypothesis.theta, base.hypothesis.start)
        every = list(candidates(self.problem.rig, spans(self.problem, motion), self.problem.dt))
        ground = Ground(base, views(self.problem, plain, motion), every)
        search = self.finer(substeps or self.problem.substeps)
        found = search._searched(ground)
        while found.problem and found.problem.substeps > search.problem.substeps:
            search = self.finer(found.problem.substeps)
            self.tell(f"with {search.problem.substeps} steps between samples", 0.3)
            found = search._searched(ground)
        if found.passed_over and self._is_composite(found.steps[-1][0]):
            # A law in which simpler ones are nested may do what they do together.
            found = replace(search._searched(ground, found.passed_over), tried=found.tried, problem=search.problem)
        return found

    def finer(self, substeps: int) -> Search:
        """Search in other integration steps, with the fits of this one."""
        if substeps == self.problem.substeps:
            return self
        return replace(self, problem=replace(self.problem, substeps=substeps), rough=self.problem)

    def _is_composite(self, explanation: Explanation) -> bool:
        return are_composite(explanation.names, self.problem.rig, self.rules)

    def _searched(self, ground: Ground, begun: Sequence[tuple[Explanation, ...]] = ()) -> SearchResult:
        """Search in the steps of the problem, on from some causes; end where a law needs smaller ones, with these."""
        base, motion, steps = ground.base, ground.motion, list(begun)
        tried, passed_over = tuple[Score, ...](), tuple[tuple[Explanation, ...], ...]()
        now = settled = steps[-1][0] if steps else base
        number = len(steps)
        while number < self.rules.most_effects and not (number > 1 and self.problem.work.ends()):
            if self._is_composite(now):
                # One more law would leave it composite; another one in the place of these may not.
                if now is settled:
                    break
                settled = self._settled(now, ground)
                steps[-1] = steps[-1] if settled is now else (settled,)
                now = settled
                continue
            if now.kind == "effects":
                wider = self._widened(now, ground)
                steps[-1], now = (steps[-1], now) if wider is now else ((wider, *steps[-1][1:]), wider)
            scores, found, likeliest = self._with_another(now, ground, number)
            tried = tried or tuple(scores)
            if not found:
                break
            if verdict.is_too_little(base.cost, now, found[0], self.size, self.rules):
                self.problem.trace.refuse(found[0].names, "its last cause explains too little of the rest")
                break
            # In steps that are too large, the right law leaves so much that one nested in it is taken in its place.
            needed = self._steps_of(base, found[0])
            needed = needed if likeliest is found[0] else max(needed, self._steps_of(base, likeliest))
            if needed > self.problem.substeps or (not steps and self.ends(self.problem, found)):
                return SearchResult(base, (*steps, tuple(found)), motion, tried, replace(self.problem, substeps=needed))
            if len(now.hypothesis.instances) > 1 and now is not settled:
                # The first effects may only resemble the true ones: they were compared while the others were missing.
                settled = self._settled(now, ground)
                if settled is not now:
                    now, steps[-1] = settled, (settled,)
                    continue
            number += 1
            is_kept = any(one is likeliest for one in (now, *found)) or self._is_composite(likeliest)
            passed_over = passed_over if is_kept else (*steps, (likeliest,))
            now, before = self._reduced(found[0], ground), now
            if now is not found[0] and set(now.names) == set(before.names):
                steps[-1] = (now, *steps[-1][1:])  # the last adds nothing: the others had not settled
                break
            steps.append(tuple(found) if now is found[0] else (now,))
            if now.kind == "parameter":
                break
        if len(now.hypothesis.instances) > 1 and now is steps[-1][0] and now is not settled:
            settled = self._settled(now, ground)
            steps[-1] = steps[-1] if settled is now else (settled,)
        return SearchResult(base, tuple(steps), motion, tried, self.problem, passed_over)

    def _with_another(
        self, now: Explanation, ground: Ground, number: int
    ) -> tuple[Sequence[Score], list[Explanation], Explanation]:
        """Scores of candidates, explanations with one or two more causes, best first, and the likeliest.

        There are none where the motion cannot be screened: what is found so far is the answer.
        """
        self.tell(f"screening {len(ground.every)} candidates", 0.2 + 0.25 * number)
        try:
            screen, scores = ground.screened(self.problem, now)
        except IntegrationError:
            return (), [], now
        found, likeliest = self._round(now, scores, screen, ground, parameters=number == 0)
        adding = Addition(self.problem, now, screen)
        return scores, pairs_first(self.problem, now, found, screen, scores=scores, job=adding.job), likeliest

    def _steps_of(self, base: Explanation, best: Explanation) -> int:
        """Integration steps between samples that an explanation needs, if it leaves hardly anything."""
        if best.kind != "effects" or not verdict.leaves_little(best.cost, base.cost, self.size, self.rules):
            return self.problem.substeps
        return shooting.finer(self.problem, best.hypothesis, (self.rough or self.problem).substeps)

    def _known(
        self, now: Explanation, scores: Sequence[Score], screen: Screen, ground: Ground, *, parameters: bool
    ) -> Fits:
        """Fits of a round in the steps of the model alone; none where the problem has these."""
        if self.rough is None:
            return {}
        if now.hypothesis.instances:
            rougher = shooting.corrected(self.rough, now.hypothesis)
            if rougher is None:
                return {}
            problem, hypothesis = rougher
            search = replace(self, problem=problem, rough=None)
            search._round(replace(now, hypothesis=hypothesis), scores, screen, ground, parameters=parameters)
        return self.fits.get(now.names, {})

    def _round(
        self, now: Explanation, scores: Sequence[Score], screen: Screen, ground: Ground, *, parameters: bool
    ) -> tuple[list[Explanation], Explanation]:
        """Explanations with one more cause, best first, and the likeliest, nested or not; none if all are chance."""
        rules, gains = self.rules, wrong_parameters.scores(self.problem, now.hypothesis)
        known = self._known(now, scores, screen, ground, parameters=parameters)
        made = self.fits.setdefault(now.names, {}) if self.rough is None else Fits()
        made.clear()
        far = FAR * min((one.cost for one in known.values()), default=np.inf)
        adding = Addition(self.problem, now, screen)

        def near(jobs: Sequence[tuple[int, Job]]) -> list[tuple[int, Job]]:
            return [(number, job) for number, job in jobs if number not in known or not known[number].cost > far]

        def added(some: Sequence[Score]) -> list[tuple[int, Job]]:
            numbers = [id(score.candidate) for score in some]
            return [(i, adding.job((score,), known.get(i))) for i, score in zip(numbers, some, strict=True)]

        best = max([*gains, *(score.gain for score in scores)], default=0.0)
        worth, variants = self._worth_a_fit(now, scores, screen, screen.total - best)
        repeated = [p for p in scores if id(p.candidate) in known and not _is_among(p, worth)]
        wrong = [int(i) for i in np.argsort(-gains)[: rules.most_freed] if gains[i] > rules.parameter_evidence]
        freed = [(-1 - i, partial(self._freed, now, i)) for i in wrong if parameters]
        jobs, problem, move = near([*added([*worth, *repeated]), *freed]), self.problem, "one more cause"
        if jobs:
            self.tell(f"fitting {len(jobs)} of them", 0.3)
        # The best scores set the mark for the others.
        leading = self._noted(problem, move, jobs[:2], now.hypothesis.cost, made)
        first = [*leading, *self._noted(problem, move, jobs[2:], min(e.hypothesis.cost for e in (now, *leading)), made)]
        close = min((now, *first), key=lambda e: e.hypothesis.cost)
        rival, further = close.hypothesis.cost, list[Explanation]()
        if first and not verdict.reaches_noise(rival, self.size, rules):
            # Screens expect too much of others: those that they put beside the best fit may be right.
            is_more = ground.declared is None and rival / screen.every > self._worth(screen, screen.total - best)
            gain = next((one.gain for one in scores if one.candidate.key in close.names[-1:]), best)
            others, variants = self._worth_a_fit(now, scores, screen, np.inf if is_more else screen.total - gain)
            more = near(added([p for p in others if not _is_among(p, [*worth, *repeated])]))
            further = self._noted(problem, "one of many that look alike", more, rival, made)
        every = [*first, *further]
        if parameters and not known:
            note = partial(self._noted, rival=rival, made=made)
            every += sticking_laws.fits(self.problem, now, every, ground, note)
            every += sticking_laws.nearest(self.problem, now, every, ground, note)
            every += wrong_parameters.several(self.problem, now, every)
        if not every:
            return [], now
        # Other shapes of a nested model are fitted if one takes a part of what the best does.
        rival = min(e.hypothesis.cost for e in every)
        least = now.hypothesis.cost - (1.0 - rules.gain_fraction) * (now.hypothesis.cost - rival)
        keys = {e.names[-1] for e in every if e.hypothesis.cost < least}
        again = added([p for p in variants if p.candidate.key in keys and not _is_among(p, repeated)])
        shaped = [*every, *self._noted(problem, "another shape of a simpler cause", again, rival, made)]
        possible = [e for e in (*shaped, *self._simpler(shaped)) if self._is_possible(e)]
        return self._compared(now, possible) if possible else ([], now)

    def _compared(self, now: Explanation, found: Sequence[Explanation]) -> tuple[list[Explanation], Explanation]:
        """Distinct explanations, the best first, and the likeliest; none if the best is no better than chance."""
        rules = self.rules
        like = nearest(found)
        merged: dict[tuple[Key, ...], Explanation] = {}
        for explanation in sorted(found, key=lambda e: e.score(like)):
            merged.setdefault(tuple(sorted(explanation.names)), explanation)
        every = merged.values()
        redundant = partial(verdict.is_redundant, others=every, now=now.cost, rules=rules, scale=like.scale)
        distinct = [e for e in every if not redundant(e, nested=self._nested_in(e.names[-1]))]
        for idle in (e for e in every if not any(e is one for one in distinct)):
            self.problem.trace.refuse(idle.names, "a simpler law does as much")
        # Of what is the same, a parameter of the rig comes first.
        bonus = rules.parameter_preference * float(np.log(self.size))
        ranked = sorted(distinct, key=lambda e: e.score(like) - bonus * (e.kind == "parameter"))
        if verdict.reaches_noise(now.cost, self.size, rules):  # nothing is left that several laws would imitate
            ranked = [e for e in ranked if not are_composite(e.names, self.problem.rig, rules)]
        if not ranked:
            return [], now
        least = rules.parameter_evidence if ranked[0].kind == "parameter" else rules.effect_evidence
        if now.score(like) - ranked[0].score(like) < least:
            return [], now
        numerical = self._numerical(ranked[0].hypothesis.instances[-1:])
        ordered = verdict.simplest_first(ranked, now.cost, self.nested, self.size, rules, numerical=numerical)
        if ordered[0] is not ranked[0]:
            self.problem.trace.refuse(ranked[0].names, "a simpler law does nearly as much")
        return ordered, ranked[0]

    def _numerical(self, instances: Sequence[EffectInstance]) -> float:
        """Error of a cost with laws that follow the steps of integration, or whose cost jumps with their parameter."""
        jumps = any(one.entry.by_step or one.entry.quantum for one in instances)
        return self.rules.law_error**2 * self.size if jumps else 0.0

    def _simpler(self, found: Sequence[Explanation]) -> list[Explanation]:
        """Nested models of the best fit, fitted from its parameters if they begin better than they ended."""
        best = min(found, key=lambda e: e.hypothesis.cost)
        if best.kind != "effects":
            return []
        known, better = best.hypothesis, []
        for nested in (one for one in found if one.names[-1] in self._nested_in(best.names[-1])):
            instance = simpler_explanations.begun(nested.hypothesis.instances[-1], known.instances[-1])
            instances = (*known.instances[:-1], instance)
            if fitting.cost(self.problem, instances, known.theta, known.start) < nested.hypothesis.cost:
                better.append(replace(nested, hypothesis=self._fit(instances, known, known.cost)))
        return better

    def _worth_a_fit(
        self, now: Explanation, scores: Sequence[Score], screen: Screen, left: float
    ) -> tuple[list[Score], list[Score]]:
        """Scores whose candidates are fitted, and of other shapes of nested models; the best leaves `left`."""
        rules, most, penalty = self.rules, self._worth(screen, left), float(np.log(self.size))
        chosen: list[Score] = []
        for score in scores:
            pays = score.gain > penalty * len(score.candidate.free) + 0.5 * rules.effect_evidence
            if score.candidate.key in now.names or not pays or len(chosen) == rules.most_fits:
                continue
            if screen.total - score.gain < most or len(chosen) < rules.fewest_fits:
                chosen.append(score)
        is_noise = verdict.reaches_noise(now.cost, self.size, rules)
        if now.names and is_noise and verdict.is_excess(now.cost, self.size, rules):
            chosen = [score for score in chosen if score.gain > rules.gain_fraction * (now.cost - self.size)]
        keys = {p.candidate.key for p in chosen}
        simpler = set().union(*map(self._nested_in, keys)) - keys - {*now.names}
        inside = {name for names in self.nested.values() for name in names}
        nested = simpler | {key for key in keys if key[0] in inside}
        others = [p for p in scores if p.candidate.key in nested and not _is_among(p, chosen)]
        first = {p.candidate.key: p for p in [*others[::-1], *chosen]}
        chosen += [p for p in others if first[p.candidate.key] is p]
        return chosen, [p for p in others if not _is_among(p, chosen)]

    def _noted(
        self, problem: EstimationProblem, move: str, jobs: Sequence[tuple[int, Job]], rival: float, made: Fits
    ) -> list[Explanation]:
        """Fits whose motion is finite, noted by their numbers.

        A round in which some are noted already begins no more where the work is over.
        """
        if jobs and made and problem.work.ends():
            return []
        every = zip(jobs, noted(problem, move, [job for _, job in jobs], rival), strict=True)
        found = {number: e for (number, _), e in every if e is not None}
        made.update({number: e for number, e in found.items() if number not in made or e.cost < made[number].cost})
        return [*found.values()]

    def _worth(self, screen: Screen, left: float) -> float:
        """Largest cost in a screen of a candidate that is worth a fit, where the best leaves `left`."""
        rules, noise = self.rules, float(self.size // screen.every)
        return rules.fit_ratio * max(left - noise, rules.screen_resolution * noise) + rules.slow_excess * noise

    def _settled(self, best: Explanation, ground: Ground) -> Explanation:
        """Explanation in which no other effect would do better in the place of one, and none is idle."""
        found = best if self.problem.work.ends() else self._swapped(best, ground)
        return best if found is best else self._reduced(found, ground)

    def _swapped(self, best: Explanation, ground: Ground) -> Explanation:
        """Try other effects in the place of each but the last, which has just been chosen among all."""
        for i in range(len(best.names) - 1):
            self.tell(f"trying others than {best.names[i][0]}", 0.9)
            try:
                screen = ground.screen(self.problem, ground.base.hypothesis, best.without(i)[1])
            except IntegrationError:
                continue
            most = self._worth(screen, best.hypothesis.cost / screen.every)
            scores = [p for p in screen.scores(ground.every) if p.candidate.key not in best.names]
            chosen = [p for p in scores if screen.total - p.gain < most][: self.rules.most_exchanges]
            jobs = [partial(self._in_place, best, i, score) for score in chosen]
            made = noted(self.problem, "another in the place of a cause", jobs, best.hypothesis.cost)
            others = [e for e in made if e and self._is_possible(e) and self._is_better(ground.base, e, best, i)]
            if others:
                like = nearest(others)
                best = min(others, key=lambda e: e.score(like))
                return self._swapped(best, ground) if i + 1 < len(best.names) - 1 else best
        return best

    def _in_place(self, best: Explanation, i: int, score: Score, rival: float) -> Explanation:
        names, others = best.without(i)
        found = self._fit((ready(self.problem, score), *others), best.hypothesis, rival)
        return Explanation("effects", (score.candidate.key, *names), found, min(best.unique, score.unique))

    def _is_possible(self, explanation: Explanation) -> bool:
        problem, instances = self.problem, explanation.hypothesis.instances
        is_noise = verdict.reaches_noise(explanation.cost, self.size, self.rules)
        why = "readings contradict it" if is_excluded(problem, instances) else ""
        if not why and not is_noise and is_beyond_instruments(problem, instances):
            why = "larger than errors of instruments are"
        if why:
            problem.trace.refuse(explanation.names, why)
        return not why

    def _is_better(self, base: Explanation, other: Explanation, best: Explanation, i: int) -> bool:
        """Whether an explanation is better than the best with another effect in the place of one."""
        richer = best.names[i][0] in self.nested[other.names[0][0]]
        if richer and verdict.is_too_little(base.cost, best, other, self.size, self.rules):
            return False
        like = nearest([other, best])
        return other.score(like) < best.score(like) - self.rules.indifferent

    def _widened(self, now: Explanation, ground: Ground) -> Explanation:
        """Free further parameters of the shape of each effect, or let one that sticks creep, where a trial does."""
        rules = self.rules
        if verdict.reaches_noise(now.cost, self.size, rules) and not verdict.is_excess(now.cost, self.size, rules):
            return now
        jobs = []
        for i, instance in enumerate(now.hypothesis.instances):
            for other in ground.every:
                more = tuple(sorted({*other.free} - {*instance.free}))
                one = instance if other.sticks == instance.sticks else instance.creeping
                is_same = other.key == now.names[i] and other.sticks == one.sticks
                if is_same and {*instance.free} < {*other.free} and not {*more} & {*other.factors}:
                    starts = {tuple(each.values[j] for j in more): None for each in other.instances}
                    wider = replace(one, free=other.free)
                    before, after = now.hypothesis.instances[:i], now.hypothesis.instances[i + 1 :]
                    shaped = ((*before, wider.with_values(more, start), *after) for start in starts)
                    jobs += [partial(self._refitted, now, now.names, instances) for instances in shaped]
        found = [e for e in noted(self.problem, "a freer shape", jobs, now.hypothesis.cost) if e is not None]
        if not found:
            return now
        best = min(found, key=lambda e: e.hypothesis.cost)
        like = nearest([best, now])
        return best if best.score(like) < now.score(like) - rules.effect_evidence else now

    def _reduced(self, best: Explanation, ground: Ground) -> Explanation:
        """Simpler explanation that does as well as one of several causes, or that one where there is none."""
        if len(best.hypothesis.instances) < 2:
            return best
        simpler = simpler_explanations.simpler(best, ground.every, partial(in_steps, self.problem))
        jobs = [partial(self._refitted, best, names, instances) for names, instances in simpler]
        jumping = [one for one in best.hypothesis.instances if one.entry.quantum]
        most = best.score(best.hypothesis) + self.rules.effect_evidence + self._numerical(jumping)
        for fewer in noted(self.problem, "a simpler one", jobs, best.hypothesis.cost):
            if fewer and fewer.score(best.hypothesis) < most:
                return self._reduced(fewer, ground)
        return best

    def _refitted(
        self, best: Explanation, names: tuple[Key, ...], instances: tuple[EffectInstance, ...], rival: float
    ) -> Explanation:
        return Explanation("effects", names, self._fit(instances, best.hypothesis, rival), best.unique)

    def _fit(self, instances: tuple[EffectInstance, ...], like: Hypothesis, rival: float) -> Hypothesis:
        return fitting.fit(self.problem, instances, theta=like.theta, start=like.start, rival=rival)

    def _freed(self, now: Explanation, index: int, rival: float) -> Explanation:
        names = ((self.problem.rig.names[index], ""),)
        free = Explanation("parameter", names, now.hypothesis).with_prior(self.problem)
        found = fitting.fit(free, theta=now.hypothesis.theta, start=now.hypothesis.start, rival=rival)
        return Explanation("parameter", names, found)


def _is_among(score: Score, scores: Sequence[Score]) -> bool:
    return any(one is score for one in scores)
