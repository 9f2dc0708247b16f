"""State of a search: the record, the model without causes, its motion and candidates, at which every move looks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

from masking.errors import IntegrationError
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate, candidates, spans
from masking.inference.discovery.decision_rules import DecisionRules
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.excluded_laws import is_beyond_instruments, is_excluded, unfolded
from masking.inference.discovery.explanation import Explanation, Job, nearest, noted
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.motion_features import Kept
from masking.inference.discovery.screening import Score, Screen
from masking.inference.discovery.smoothing import Motion, smooth
from masking.inference.discovery.verdict import Key

Tell = Callable[[str, float], None]  # called with what is done, and the fraction done
Seen = tuple[Screen, list[Score]]  # a screen, and the scores of candidates in it


def silent(text: str, part: float) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Ground:
    """A record with the model that was fitted to it within its priors, without causes."""

    problem: EstimationProblem  # the record, in the steps of integration that its laws need
    base: Explanation  # the model without causes, in the steps that it needs itself
    motion: Motion  # smoothed with its parameters
    every: Sequence[Candidate]
    tell: Tell = silent
    kept: Kept = field(default_factory=Kept)  # what candidates do along the motion
    last: list[tuple[Explanation, Seen | None]] = field(default_factory=list)  # what was screened last

    @classmethod
    def of(cls, problem: EstimationProblem, tell: Tell) -> Ground:
        """Ground of a record; an IntegrationError says that the model cannot follow it."""
        tell("fitting the model as it is", 0.0)
        base = Explanation("none", (), fitting.fit(problem))
        problem.trace.tried.append(base.tried(problem.trace.reading))
        tell("smoothing the motion", 0.1)
        return cls.beside(problem, base, tell)

    @classmethod
    def beside(cls, problem: EstimationProblem, base: Explanation, tell: Tell = silent) -> Ground:
        """Ground of a record with a fit of its model; errors as `of`."""
        motion = smooth(problem, base.hypothesis.theta, base.hypothesis.start)
        every = [*candidates(problem.rig, spans(problem, motion), problem.dt)]
        return cls(problem, base, motion, every, tell)

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

    def screen(self, looked_at: Hypothesis, found: Sequence[EffectInstance] = (), *, taken: bool = False) -> Screen:
        """Screen of a fit, with what effects explain taken out; these are in the fit already where they are `taken`."""
        return Screen(self.problem, looked_at, self.motion, found, taken=taken, kept=self.kept)

    def screened(self, now: Explanation) -> Seen | None:
        """Screen of the model, or of an explanation where that leaves less, and the scores of candidates in it.

        It is None where the motion cannot be screened.
        """
        if not (self.last and self.last[0][0] is now):
            try:
                self.last[:] = [(now, self._screened(now))]
            except IntegrationError:
                self.last[:] = [(now, None)]
        return self.last[0][1]

    def _screened(self, now: Explanation) -> Seen:
        instances, most = now.hypothesis.instances, self.rules.small_residual * self.size
        problem, known = unfolded(self.problem, now.hypothesis)
        if known is not now.hypothesis:
            motion = smooth(problem, known.theta, known.start)
            screen = Screen(problem, known, motion, known.instances, taken=True)
            return screen, screen.scores(self.every)
        screen = self.screen(self.base.hypothesis, instances)
        if instances and now.cost < max(most, screen.total):
            screen = self.screen(now.hypothesis, instances, taken=True)
        return screen, screen.scores(self.every)

    def worth(self, screen: Screen, left: float) -> float:
        """Largest cost in a screen of a candidate that is worth a fit, where the best leaves `left`."""
        rules, noise = self.rules, float(self.size // screen.every)
        return rules.fit_ratio * max(left - noise, rules.screen_resolution * noise) + rules.slow_excess * noise

    def noted(self, move: str, jobs: Sequence[Job], rival: float) -> list[Explanation]:
        """Fits that a move suggests whose motion is finite, noted in the trace."""
        return [one for one in noted(self.problem, move, jobs, rival) if one is not None]

    def refit(self, names: tuple[Key, ...], instances: tuple[EffectInstance, ...], like: Explanation) -> Job:
        """Fit of effects from the parameters and initial states of an explanation."""
        return partial(self._refitted, names, instances, like)

    def _refitted(
        self, names: tuple[Key, ...], instances: tuple[EffectInstance, ...], like: Explanation, rival: float
    ) -> Explanation:
        known = like.hypothesis
        found = fitting.fit(self.problem, instances, theta=known.theta, start=known.start, rival=rival)
        return Explanation("effects", names, found)

    def is_noise(self, cost: float) -> bool:
        """Whether a cost is that of noise."""
        return verdict.reaches_noise(cost, self.size, self.rules)

    def is_near(self, cost: float) -> bool:
        """Whether a cost is hardly any of what the model without causes leaves, or is that of noise."""
        return self.is_noise(cost) or verdict.leaves_little(cost, self.base.cost, self.size, self.rules)

    def nearly(self, least: float, since: float) -> float:
        """Cost below which nearly as much is gained, since a cost, as by the least one."""
        return since - (1.0 - self.rules.gain_fraction) * (since - least)

    def refusal(self, explanation: Explanation) -> str:
        """Why an explanation is not possible; '' where it is."""
        instances = explanation.hypothesis.instances
        if is_excluded(self.problem, instances, self.motion):
            return "readings contradict it"
        if not self.is_noise(explanation.cost) and is_beyond_instruments(self.problem, instances):
            return "larger than errors of instruments are"
        return ""

    def numerical(self, explanation: Explanation) -> float:
        """Error of a cost with laws that follow the steps of integration, or whose cost jumps with their parameter."""
        jumps = any(one.entry.by_step or one.entry.quantum for one in explanation.hypothesis.instances)
        return self.rules.law_error**2 * self.size if jumps else 0.0

    def ranked(self, table: Sequence[Explanation]) -> list[Explanation]:
        """Explanations that are possible and distinct, the likeliest first."""
        refusals = [self.refusal(one) for one in table]
        for one, why in zip(table, refusals, strict=True):
            if why:
                self.problem.trace.refuse(one.names, why)
        possible = [one for one, why in zip(table, refusals, strict=True) if not why]
        like, merged = nearest(possible), dict[tuple[Key, ...], Explanation]()
        for one in sorted(possible, key=lambda one: one.score(like)):
            merged.setdefault(tuple(sorted(one.names)), one)
        every = [*merged.values()]
        idle = [one for one in every if any(self._does_as_much(other, one, like) for other in every)]
        for one in idle:
            self.problem.trace.refuse(one.names, "a simpler law does as much")
        return [one for one in every if not any(one is other for other in idle)]

    def _does_as_much(self, simple: Explanation, richer: Explanation, like: Hypothesis) -> bool:
        """Whether an explanation does all that one with a richer law or one more does, beyond numerical errors."""
        if not simple.names or not simple.is_inside(richer):
            return False
        margin = max(self.rules.redundant_fraction * (self.base.cost - richer.cost), self.numerical(richer))
        if len(simple.names) == len(richer.names):
            margin = max(margin, self.rules.indifferent * like.scale)
        return simple.cost < richer.cost + margin

    def finer(self, substeps: int) -> Ground:
        """Ground in more steps of integration."""
        return replace(self, problem=replace(self.problem, substeps=substeps))
