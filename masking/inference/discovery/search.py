"""Search: explanations of a record, each by the move that suggests it, until none is likelier than the best.

A queue holds what has been fitted. The likeliest explanation, and the simpler one that does nearly as much, is given to
each move in turn: another shape or another law, without a cause, with one more, with two. One evidence weighs them all:
moves decide what is looked at and never what is true.
Source: Kass and Raftery (1995), JASA 90(430), 773-795; for what is worth a fit, Schwarz (1978), Ann. Stat. 6, 461.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from masking.inference.discovery import fitting, shooting_intervals
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.more_causes import from_afar, one_more_cause, pairs_of_causes
from masking.inference.discovery.other_laws import other_causes, richer_laws, simpler_explanations
from masking.inference.discovery.screening import Score
from masking.inference.discovery.search_state import Ground, Tell
from masking.inference.discovery.smoothing import Motion
from masking.inference.discovery.wrong_parameters import several_parameters, wrong_parameters

Move = Callable[[Ground, Explanation, Sequence[Explanation]], list[Explanation]]  # beside one, of those in the table

MOVES: tuple[Move, ...] = (
    richer_laws,
    other_causes,
    simpler_explanations,
    wrong_parameters,
    one_more_cause,
    several_parameters,
    from_afar,
    pairs_of_causes,
)


@dataclass(frozen=True)
class SearchResult:
    """What a search found."""

    base: Explanation  # the model, its parameters fitted within their priors
    ranked: tuple[Explanation, ...]  # what explains the record, the likeliest first
    motion: Motion  # smoothed record
    problem: EstimationProblem  # the record, in the integration steps that the laws need
    tried: tuple[Score, ...] = ()  # what each candidate could take off at first, the best first

    @property
    def best(self) -> Explanation:
        """Likeliest explanation."""
        return self.ranked[0]


@dataclass
class Search:
    """A search in a record."""

    ground: Ground
    alone: int  # integration steps between samples of the model without effects
    table: list[Explanation]  # what has been fitted
    looked_at: set[object] = field(default_factory=set)  # explanations that were given to the moves
    tried: tuple[Score, ...] = ()  # candidates to first order, beside the model without causes
    resolved: Explanation | None = None  # whose law the steps of integration resolve

    @classmethod
    def begun(cls, problem: EstimationProblem, tell: Tell) -> Search:
        """Search in a record, in the integration steps of the model alone; laws have as many as they need."""
        ground = Ground.of(problem, tell)
        return cls(ground, problem.substeps, [ground.base])

    @property
    def best(self) -> Explanation:
        """Likeliest explanation."""
        return self.ground.ranked(self.table)[0]

    def first_round(self) -> None:
        """Look at what goes beside the model without causes."""
        if not self.looked_at:
            self._look_beside(self.ground.base)
            seen = self.ground.screened(self.ground.base)
            self.tried = () if seen is None else tuple(seen[1])

    def run(self) -> SearchResult:
        """Go on until nothing is likelier, nothing is left, or the work is done."""
        self.first_round()
        while (now := self._next()) is not None:
            self._look_beside(now)
        best, ground = self.best, self.ground
        if best.kind == "effects" and self._in_finer_steps(best):
            return self.run()
        if best.kind != "effects" and ground.is_noise(best.cost):
            steps = shooting_intervals.finer(ground.problem, best.hypothesis, self.alone)
            if steps > ground.problem.substeps:
                return Search.begun(replace(ground.problem.under("finer steps"), substeps=steps), ground.tell).run()
        return SearchResult(ground.base, tuple(ground.ranked(self.table)), ground.motion, ground.problem, self.tried)

    def _next(self) -> Explanation | None:
        """Explanation to look at: the best, or the simpler one that does nearly as much; None if there is none."""
        ground = self.ground
        ranked = ground.ranked(self.table)
        best = ranked[0]
        if ground.problem.work.ends():
            return None
        least = ground.nearly(best.cost, ground.base.cost)
        inside = [one for one in ranked if one.cost < least and one.is_inside(best)]
        near = (one for one in (best, *inside[:1]) if one.kind == "effects")
        return next((one for one in near if _signature(one) not in self.looked_at), None)

    def _look_beside(self, now: Explanation) -> None:
        """Add what the moves make of an explanation; they end where one makes it likelier with no more causes."""
        self.looked_at.add(_signature(now))
        before = best = self.best
        for move in MOVES:
            self.table += move(self.ground, now, self.table)
            best = self.best
            if best is not before and best.kind == "effects" and len(best.names) <= len(now.names):
                break
        if best.kind == "effects" and self.ground.is_near(best.cost):
            self._in_finer_steps(best)

    def _in_finer_steps(self, best: Explanation) -> bool:
        """Repeat the fits that come near the best in steps of integration that resolve its law, if these are more."""
        ground = self.ground
        if best is self.resolved:
            return False
        self.resolved = best
        steps = shooting_intervals.finer(ground.problem, best.hypothesis, self.alone)
        if steps == ground.problem.substeps:
            return False
        ground.tell(f"with {steps} steps between samples", 0.3)
        self.ground = ground.finer(steps)
        most = best.cost / ground.rules.much_less**2
        near = [one for one in ground.ranked(self.table) if one.kind == "effects" and one.cost <= most]
        jobs = [partial(_repeated, self.ground.problem, one) for one in near[: ground.rules.most_fits]]
        others = [one for one in self.table if one.kind != "effects"]
        far = [one for one in self.table if one.kind == "effects" and one.cost > most]  # steps change them by less
        self.table = [*others, *far, *self.ground.noted("finer steps", jobs, min(one.cost for one in others))]
        self.resolved = None
        return True


def _signature(one: Explanation) -> object:
    """Signature of an explanation that is looked at: its causes, and what is estimated of each."""
    instances = one.hypothesis.instances
    return tuple(sorted((part.effect, part.at, part.free, part.sticks) for part in instances))


def _repeated(problem: EstimationProblem, known: Explanation, rival: float) -> Explanation:
    return replace(known, hypothesis=fitting.repeated(problem, known.hypothesis, rival))
