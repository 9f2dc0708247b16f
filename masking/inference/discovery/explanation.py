"""Explanation: a hypothesis with a name, its cost, and the Occam factor of its parameters.

Source: MacKay (2003), Information Theory, Inference, and Learning Algorithms, section 28.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np

from masking.compile.numerics import decompositions
from masking.errors import IntegrationError
from masking.inference.discovery import compiled_laws, fitting, verdict
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.trace import Tried
from masking.inference.discovery.verdict import Key, Kind, Law
from masking.inference.discovery.work_budget import Work
from masking.model.declaration.expression import Expression
from masking.model.effects import Effect

AT_ONCE, FEWEST = 4, 2  # fits between which it is asked whether the work ends, and those that are made where it is over
ROUNDING = 1e-12  # eigenvalue over the largest that is 0: larger ones have four digits, smaller pay for a parameter


class Unseen(NamedTuple):
    """A hypothesis along unseen data."""

    alone: Hypothesis  # by what was estimated before
    within: Hypothesis  # with the parameters of the rig within the uncertainty that their record leaves


@dataclass(frozen=True)
class Explanation:
    """A hypothesis with what it is called and how it scores."""

    kind: Kind  # `none`, `parameter` or `effects`
    names: tuple[Key, ...]  # (parameter, '') or (effect, place) of each cause
    hypothesis: Hypothesis  # fitted
    move: str = "parameters within their priors"  # what suggested it
    unseen: Unseen | None = None  # the hypothesis on a validation record, where it has been simulated there

    @property
    def cost(self) -> float:
        """Cost of the record to which it was fitted."""
        return self.hypothesis.cost

    def with_prior(self, problem: EstimationProblem) -> EstimationProblem:
        """Problem with the parameters of this explanation free, if it is one of these."""
        prior = problem.prior
        for name, _ in self.names if self.kind == "parameter" else ():
            prior = prior.freed(problem.rig.names.index(name), problem.rules.freed_factor)
        return replace(problem, prior=prior)

    @property
    def last_strength(self) -> float:
        """Deviations by which what scales the last effect differs from 0, all of it together, in rms (Wald's test).

        Factors of a polynomial may be known together, and none by itself. It is 0 where their covariance is not known.
        """
        instance = self.hypothesis.instances[-1]
        scale = instance.entry.factors or instance.entry.scaled
        own = [i for i, name in enumerate(instance.names) if name in scale] or [*range(len(instance.names))]
        first = len(self.hypothesis.covariance) - len(instance.names)
        values = np.array(instance.estimated)[own]
        covariance = self.hypothesis.covariance[first:, first:][np.ix_(own, own)]
        if not len(values) or not np.isfinite(covariance).all():
            return 0.0
        size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        inverse = decompositions.inverse(covariance / np.outer(size, size), ROUNDING, hermitian=True)
        square = float((values / size) @ inverse @ (values / size))
        return float(np.sqrt(max(square, 0.0) / len(values)))

    def without(self, i: int) -> tuple[tuple[Key, ...], tuple[EffectInstance, ...]]:
        """Its names and effects without one of its causes."""
        names, instances = self.names, self.hypothesis.instances
        return (*names[:i], *names[i + 1 :]), (*instances[:i], *instances[i + 1 :])

    def is_inside(self, richer: Explanation) -> bool:
        """Whether it is a special case of another one: that without a cause, or with one that is nested in it."""
        new, old = {*self.names} - {*richer.names}, {*richer.names} - {*self.names}
        if len(old) != 1 or self.kind == "parameter" or richer.kind != "effects":
            return False
        (key,) = old
        law = richer.hypothesis.instances[richer.names.index(key)].entry
        return new <= {(name, key[1]) for name in law.nested}

    def is_composite(self, rig: AugmentedModel) -> bool:
        """Whether its effects imitate one that the dictionary lacks."""
        return are_composite(self.names, rig, self.hypothesis.rules)

    def score(self, like: Hypothesis) -> float:
        """-2 log evidence, with the residual as coloured as that of another hypothesis, see `Hypothesis.misfit`.

        That is the likelihood and prior, the Occam factor of its parameters, and the price of each cause.
        """
        return self.hypothesis.misfit(like) + self._price

    @cached_property
    def _price(self) -> float:
        rules = self.hypothesis.rules
        each = rules.parameter_evidence if self.kind == "parameter" else rules.effect_evidence
        return occam(self.hypothesis) + each * len(self.names)

    def tried(self, reading: str) -> Tried:
        """It as a line of a trace."""
        one, price = self.hypothesis, self.hypothesis.pull + self._price
        return Tried(reading, self.move, self.names, one.misfits[0], one.independent[0], price, one.residuals.size)


def nearest(explanations: Iterable[Explanation]) -> Hypothesis:
    """Hypothesis that leaves least, whose residual says how coloured those of all are."""
    return fitting.nearest(one.hypothesis for one in explanations)


def ahead(one: Explanation, other: Explanation) -> float:
    """-2 log of the odds of another explanation against one, of the same record."""
    like = nearest([one, other])
    return other.score(like) - one.score(like)


def in_both(explanations: Sequence[Explanation]) -> list[float]:
    """-2 log evidence of explanations in their record and in unseen data, where all have been simulated there.

    That is the score, and the likelihood of unseen data by what was estimated before them, as uncertain as that is.
    Source: Dawid (1984), J. R. Stat. Soc. A 147(2), 278-292, for the likelihood of what comes by what came before.
    """
    like, later = nearest(explanations), on_unseen(explanations)
    return [one.score(like) + unseen for one, unseen in zip(explanations, later, strict=True)]


def on_unseen(explanations: Sequence[Explanation], view: str = "within") -> list[float]:
    """-2 log likelihood of unseen data, see `in_both`; 0 where not all explanations have been simulated there.

    The view is a field of `Unseen`.
    """
    later = [getattr(one.unseen, view) for one in explanations if one.unseen is not None]
    if len(later) < len(explanations):
        return [0.0] * len(explanations)
    like = fitting.nearest(later)
    return [one.misfit(like) for one in later]


def ended(table: Sequence[Explanation], names: Iterable[Key]) -> float:
    """Least cost with which fits of causes ended; infinite where there is none."""
    return min((one.cost for one in table if {*one.names} == {*names}), default=np.inf)


Job = Callable[[float], Explanation]  # a fit, given the cost of a rival
Fit = TypeVar("Fit")


def noted(problem: EstimationProblem, move: str, jobs: Sequence[Job], rival: float) -> list[Explanation | None]:
    """Explanations of fits that a move suggests, as `fitted`, noted in the trace of the problem."""
    made = [one and replace(one, move=move) for one in fitted(jobs, rival, problem.work)]
    problem.trace.tried += [one.tried(problem.trace.reading) for one in made if one is not None]
    return made


def fitted(jobs: Sequence[Callable[[float], Fit]], rival: float, work: Work) -> list[Fit | None]:
    """Results of fits, the likeliest first, two at once; None where the motion is not finite, or the work ends before.

    The first are made however much the work is; where it is over, these are fewer.
    """

    def found(job: Callable[[float], Fit]) -> Fit | None:
        try:
            return job(rival)
        except IntegrationError:
            return None

    made: list[Fit | None] = []
    with ThreadPoolExecutor(2) as pool:
        while len(made) < len(jobs) and not (made and work.ends()):
            many = FEWEST if work.is_over else AT_ONCE
            made += pool.map(found, jobs[len(made) : len(made) + many])
    return made + [None] * (len(jobs) - len(made))


def occam(hypothesis: Hypothesis) -> float:
    """Occam factor of the effects: by how much the record narrows their parameters, as -2 log evidence.

    Before the record, each factor of an effect could have been as large as makes it as strong as the strongest of them,
    and each parameter of its shape twice as large or zero, or a plain number anywhere in its range. A direction that
    the record does not tell costs nothing. It is infinite where the covariance has no inverse.
    Source: MacKay (2003), Information Theory, Inference, and Learning Algorithms, section 28.1.
    """
    added = hypothesis.added
    count = len(added)
    if not count:
        return 0.0
    covariance = hypothesis.covariance[-count:, -count:]
    if not np.isfinite(covariance).all():
        return np.inf
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    try:
        with np.errstate(over="ignore"):  # what is not finite has no inverse
            information = decompositions.inverse(covariance / np.outer(size, size), ROUNDING, hermitian=True)
    except IntegrationError:
        return np.inf
    strength = np.abs(added) / size * np.sqrt(np.maximum(np.diag(information), 0.0))  # each by itself, in deviations
    widths, used = np.abs(added) / size, 0
    for instance in hypothesis.instances:
        own = [used + i for i, name in enumerate(instance.names) if name in instance.entry.factors]
        for i, width in enumerate(_expected(instance)):
            widths[used + i] = max(widths[used + i], width / size[used + i])
        used += len(instance.free)
        if own:
            alone = np.sqrt(np.maximum(np.diag(information)[own], 1e-300))
            widths[own] = np.maximum(widths[own], strength[own].max() / alone)
    with np.errstate(over="ignore", invalid="ignore"):  # a factor that does nothing there has no evidence
        weighed = information * np.outer(widths, widths)
    if not np.isfinite(weighed).all():
        return np.inf
    try:
        ratios = decompositions.symmetric(weighed)[0]
    except IntegrationError:
        return np.inf
    return float(np.log1p(np.maximum(ratios, 0.0)).sum())


def _expected(instance: EffectInstance) -> list[float]:
    """Half the range in which each estimated parameter is expected, where it is a plain number; else 0."""
    if instance.effect == compiled_laws.DELAY:
        return [0.0]
    declared = [instance.entry.parameters[name] for name in instance.names]
    return [0.5 * (p.prior[1] - p.prior[0]) if p.unit == "1" and p.prior and not p.spread else 0.0 for p in declared]


def are_composite(causes: Sequence[Key], rig: AugmentedModel, rules: DecisionRules = RULES) -> bool:
    """Whether several effects imitate one that the dictionary lacks, see `verdict.is_composite`.

    A coordinate that only one element moves counts as that element.
    """
    known = rig.twin.dictionary
    every = [(known[name], at) for name, at in causes if name in known]
    laws = [Law(one.is_linear, _seat(rig, at), _kind(one.reduced({})), one.family) for one, at in every]
    return verdict.is_composite(laws, rules)


def share_a_place(causes: Sequence[Key], rig: AugmentedModel) -> bool:
    """Whether two forces of an explanation act at one place, which may stand for a single law."""
    known = rig.twin.dictionary
    seats = [_seat(rig, at) for name, at in causes if name in known and known[name].where == "element"]
    return len({*seats}) < len(seats)


def _seat(rig: AugmentedModel, name: str) -> str:
    """The only element a coordinate belongs to; other names unchanged."""
    if not any(place.name == name and place.coordinate and not place.declared for place in rig.places):
        return name
    elements = [(p.name, p.element.displacement) for p in rig.places if p.declared]
    those = [element for element, displacement in elements if displacement and name in displacement.symbols]
    return those[0] if len(those) == 1 else name


def _kind(effect: Effect) -> str:
    """Variables that the force of an element follows; '' for neither displacement nor rate."""
    if effect.where != "element" or effect.absorbed_by:
        return ""
    return "memory" if effect.states else " and ".join(sorted(Expression(effect.expression).symbols & {"d", "d_rate"}))
