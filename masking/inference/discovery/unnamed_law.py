"""Unnamed law: the empirical force law of a record that no effect of the dictionary explains, in the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import candidates, closed_form, fitting, free_law, further_places, verdict
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.closed_form import ClosedForm
from masking.inference.discovery.coverage import Coverage
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.free_law import ALIKE, FEWEST, KINDS, PARTS, FreeLaw, likelier
from masking.inference.discovery.grammar import evaluated
from masking.inference.discovery.latent_force import Explained, binned
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.shooting_intervals import finer
from masking.inference.discovery.tabulated_law import tabulated
from masking.inference.estimation.simulation import STUCK

MOST_FINER = 4  # times the integration steps of the model alone: curves are smooth, and have many factors
LITTLE = 0.1  # of what the names leave beyond noise, which a form must take to be their rival


@dataclass(frozen=True)
class UnnamedLaw:
    """A law without a name."""

    free: FreeLaw  # the law as curves, fitted
    explanation: Explanation  # the model with the law as it is written, and with effects elsewhere
    validated: Hypothesis  # the same on the validation record
    error: tuple[dict[str, float], dict[str, float]]  # relative errors of sensors, in both records
    closed: bool  # whether it leaves no more than noise in the validation record
    problem: EstimationProblem  # the validation record in the shooting intervals of `validated`
    form: ClosedForm | None = None  # its closed form; None where none was found
    is_formula: bool = False  # whether the closed form is what is written; else tables are

    @property
    def instance(self) -> EffectInstance:
        """Law as it is written into the model."""
        return self.explanation.hypothesis.instances[-1]

    @property
    def fitted(self) -> Hypothesis:
        """Model with the law, fitted to the record."""
        return self.explanation.hypothesis

    @property
    def simulated(self) -> Hypothesis:
        """Model with the law as a fit has it, a formula or curves, which equations can be made of."""
        return self.fitted if self.is_formula else self.free.hypothesis

    @property
    def known(self) -> EstimationProblem:
        """Record in the shooting intervals of the fit, and the rig that knows the law."""
        known = self.free.problem
        return closed_form.knowing(known, self.simulated.instances) if self.is_formula else known

    def force(self, x: Array, rate: Array) -> Array:
        """Force of the law as it is written at displacements and rates (m,)."""
        if not self.is_formula:
            return self.free.force(x, rate)
        one = self.instance
        values = dict(zip(one.entry.parameters, one.values, strict=True))
        return np.broadcast_to(evaluated(one.entry.expression, {**values, "d": x, "d_rate": rate}), np.shape(x))

    @cached_property
    def curves(self) -> tuple[Array, Array]:
        """Factors of the curves (f,) and their covariance (f, f), beside the parameters that are written."""
        return self.free.given(self.fitted.theta)

    def deviation(self, x: Array, rate: Array) -> Array:
        """Standard deviation of the curves at displacements and rates (m,)."""
        return _deviation(self.free.rows(x, rate), self.curves[1])

    def band(self, x: Array, rate: Array, along: Array) -> tuple[Array, Array, Array]:
        """Band of the curves along a motion (m,): two standard deviations about their means over bins of `along`.

        It is given as the centres of the bins, and the ends of the band there (b,).
        """
        columns = [binned(along, column) for column in self.free.rows(x, rate).T]
        means, (factors, covariance) = np.column_stack([mean for _, mean, _ in columns]), self.curves
        middle, half = means @ factors, 2.0 * _deviation(means, covariance)
        return columns[0][0], middle - half, middle + half

    @cached_property
    def coverage(self) -> Coverage:
        """Where the record moves the place of the law, and how well the law is known there."""
        of_form = self.form.form.of if self.form is not None and self.is_formula else set[str]()
        sides = of_form or self.free.follows  # a constant is of neither
        x, rate = self.free.x, self.free.rate
        return Coverage.of(x, rate, self.force(x, rate), self.deviation(x, rate), sides)

    @property
    def place(self) -> str:
        """Name of the place whose force it is."""
        return self.free.on

    @property
    def rig(self) -> AugmentedModel:
        """Rig whose model it is written into: with a further place where it sits in one."""
        return self.free.problem.rig

    def unexplained(self, found: Explained) -> float:
        """Part of the rms of the model error that the names leave and this law explains, in both records.

        What it leaves itself is of as many independent samples as it is worth, and is larger or smaller by chance.
        """
        costs, samples = np.zeros(3), self.fitted.independent.sum() + self.validated.independent.sum()
        chance = float(found.problem.rules.chance_deviations) * float(np.sqrt(2.0 / samples))
        every = found.search.base.hypothesis, found.explanation.hypothesis
        with threadpool_limits(1):
            for part, law in ((self.free.problem, self.fitted), (self.problem, self.validated)):
                noise = part.record.readings.size
                costs[2] += max(float(law.squares @ part.weights) - noise, 0.0)
                plain = found.problem
                fine = replace(part, substeps=plain.substeps, rig=plain.rig, prior=plain.prior)
                for i, known in enumerate(every):
                    try:
                        left = float(fitting.validated(fine, known).squares @ part.weights) - noise
                    except IntegrationError:
                        left = np.inf
                    costs[i] += max(left, 0.0)
        base, named, left = costs
        if not np.isfinite(named) or named >= base:
            return 1.0
        return float(np.sqrt(max(named - (1.0 + chance) * left, 0.0) / base))

    def follows(self, problem: EstimationProblem, unseen: EstimationProblem) -> bool:
        """Whether it follows both records in intervals as long as those of two problems.

        In shorter ones, each from an initial state of its own, any law leaves less.
        """
        pairs = (self.free.problem, problem), (self.problem, unseen)
        return all(own.interval_samples >= other.interval_samples for own, other in pairs)

    def reaches(self, floor: Mapping[str, float]) -> bool:
        """Whether it leaves little more than the noise floor of each sensor on unseen data."""
        return all(error <= verdict.EXPLAINED * floor[name] for name, error in self.error[1].items())

    def as_dict(self) -> dict[str, Any]:
        """Law as JSON can hold it."""
        return {
            "on": self.place,
            "follows": {"d": self.free.nouns["d"], "d_rate": self.free.nouns["v"]},
            "expression": self.instance.entry.expression,
            "parameters": dict(zip(self.instance.entry.parameters, self.instance.values, strict=True)),
            "closed_form": self.form and self.form.as_dict(self.is_formula),
            "closed": self.closed,
            "coverage": self.coverage.as_dict(),
            "shooting_interval": self.problem.interval / self.problem.record.rate or None,
            "simulation_error": dict(zip(("estimation", "validation"), self.error, strict=True)),
        }


def _deviation(rows: Array, covariance: Array) -> Array:
    """Standard deviations of sums with rows of factors (m, f)."""
    if not np.isfinite(covariance).all():
        return np.full(len(rows), np.inf)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, covariance, rows), 0.0)))


def evidence(found: Explained, validated: Hypothesis, law: UnnamedLaw, *, alone: bool = False) -> float:
    """Score of the names less that of the closed form of a law, each fitted to both records.

    So a parameter that shows in the validation record alone is no evidence against either. The form is no rival, and
    this is -inf, where it is known in other intervals, a motion of both fits is not finite, or it leaves nearly all of
    what the names leave beyond noise: then both are the same law. With more numbers than the names, it may imitate what
    else is missing: it is no rival either, unless it alone leaves no more than noise on unseen data.

    The explanation is `validated` in the shooting intervals of the law.
    """
    named, form = found.explanation.hypothesis, law.form
    if form is None or law.free.problem.interval != found.problem.interval:
        return -np.inf
    numbers = [len(one.theta) + len(fitting.estimated(one.instances)) for one in (named, form.hypothesis)]
    if (numbers[1] > numbers[0] and not alone) or len(form.validated.start) != len(validated.start):
        return -np.inf
    penalty = float(np.log(named.residuals.size + validated.residuals.size))
    known, unseen = found.explanation.with_prior(found.problem), law.problem
    seen = replace(unseen, substeps=known.substeps, rig=known.rig, prior=known.prior)
    fine, other = (closed_form.knowing(one, form.hypothesis.instances) for one in (law.free.problem, unseen))
    try:
        with threadpool_limits(1):
            made = [fitting.together(*both) for both in ((known, seen, named), (fine, other, form.hypothesis))]
    except IntegrationError:
        return -np.inf
    costs, like = [one.cost for one in made], fitting.nearest(made)
    noise = (1.0 + found.problem.rules.screen_resolution) * (named.residuals.size + validated.residuals.size)
    if costs[0] > noise and costs[1] - noise > (1.0 - LITTLE) * (costs[0] - noise):
        return -np.inf
    return made[0].misfit(like) - made[1].misfit(like) + penalty * (numbers[0] - numbers[1])


def law_of(found: Explained, validation: EstimationProblem, substeps: int, part: float) -> UnnamedLaw | None:
    """Law of a record without a name; None where none makes the simulation of unseen data better.

    The integration steps are those of the model alone. After a part of the work of a search, no more is fitted.
    """
    found = replace(found, problem=replace(found.problem, work=found.problem.work.kept(part)))
    steps = min(found.problem.substeps, MOST_FINER * substeps)
    law, size = _law_of(found, validation, steps), found.problem.record.readings.size
    if law is None or found.problem.work.ends():
        return law
    if not verdict.leaves_little(law.free.hypothesis.cost, found.search.base.cost, size, found.problem.rules):
        return law  # smaller steps would make nothing of it
    with threadpool_limits(1):
        needed = finer(law.free.problem, law.free.hypothesis, substeps)
    if needed <= steps:
        return law
    again = _law_of(found, validation, needed)
    return law if again is None else again


def _law_of(found: Explained, validation: EstimationProblem, steps: int) -> UnnamedLaw | None:
    problem, unseen = (replace(one, substeps=steps) for one in (found.problem, validation))
    fine = replace(found, problem=problem)
    with threadpool_limits(1):
        law = _free_law(fine)
        return None if law is None else _in_model(fine, law, unseen)


def _free_law(found: Explained) -> FreeLaw | None:
    """Free law of a record: alone, beside the causes, or at a further place; None where none can be fitted."""
    problem, most = found.problem, ALIKE * found.record.readings.size
    try:
        law = free_law.fit(found)
    except IntegrationError:  # no screen of its record
        return None
    if law is None or not law.hypothesis.cost > most:
        return law
    known = found.explanation.hypothesis.instances
    others = [problem.rig.at_step(one, problem.dt / problem.substeps) for one in known if one.at != law.place.name]
    beside = _better(law, free_law.fit(found, others) if others else None)
    if not beside.hypothesis.cost > most or problem.work.ends():
        return beside
    further = further_places.of(problem.rig, beside.place.name, candidates.time(found.search.motion))
    named = [one for one in beside.hypothesis.instances if one.effect not in KINDS]
    return _better(beside, free_law.fit(found, named, further))


def _better(law: FreeLaw, other: FreeLaw | None) -> FreeLaw:
    return law if other is None else likelier(law, other)


def _in_model(found: Explained, free: FreeLaw, unseen: EstimationProblem) -> UnnamedLaw | None:
    """Free law as a part of the model, as a formula or in tables; None where unseen data are simulated no better."""
    problem, base = found.problem, found.search.base.hypothesis
    try:
        validation, followed = _followed(free.of(unseen), free)
        plain = replace(validation, rig=problem.rig, prior=problem.prior)
        without = [fitting.validated(plain, one) for one in (base, replace(base, theta=problem.prior.mean))]
        form = closed_form.fitted(free, free.problem, (validation, followed))
        # The free law costs what it does in both records, with Schwarz's penalty for each factor.
        penalty = free.size * float(np.log(problem.record.readings.size + validation.record.readings.size))
        cost = free.hypothesis.misfit(free.hypothesis) + followed.misfit(followed) + penalty
        if form is not None and form.score <= cost:
            law, formula = free, form
            fitted, validated = formula.hypothesis, formula.validated
            written = _explanation(fitted, fitted.instances)
        else:
            law, formula = free, None
            fitted, validated = law.hypothesis, fitting.validated(validation, law.hypothesis)
            written = _in_tables(law)
    except IntegrationError:
        return None
    if not validated.squares @ validation.weights < min(one.squares @ validation.weights for one in without):
        return None
    errors, floor = (problem.errors(fitted.squares), validation.errors(validated.squares)), validation.noise_floor
    closed = verdict.at_noise_floor(errors[1].values(), floor.values(), len(validation.record), problem.rules)
    return UnnamedLaw(law, written, validated, errors, closed, validation, formula or form, formula is not None)


def _followed(validation: EstimationProblem, law: FreeLaw) -> tuple[EstimationProblem, Hypothesis]:
    """Validation record in the longest shooting intervals in which a law follows the motion, and the law.

    A chaotic motion is lost whatever the law, since any difference grows. Errors as `fitting.fit`.
    """
    size, kept, most = len(validation.record), law.problem.interval, STUCK * validation.record.readings.size
    for samples in (kept, *(n for part in PARTS if (n := size // part) > FEWEST)):
        part = replace(validation, interval=samples)
        with suppress(IntegrationError):
            found = fitting.validated(part, law.hypothesis, most)
            if found.cost < most:
                return part, found
    part = replace(validation, interval=kept)
    return part, fitting.validated(part, law.hypothesis)


def _in_tables(law: FreeLaw) -> Explanation:
    fitted = law.hypothesis
    others = tuple(one for one in fitted.instances if one.effect not in KINDS)
    many = len(fitted.theta) + len(fitting.estimated(others))
    return _explanation(replace(fitted, covariance=fitted.covariance[:many, :many]), (*others, tabulated(law)))


def _explanation(fitted: Hypothesis, instances: Sequence[EffectInstance]) -> Explanation:
    names = tuple((one.effect, one.at) for one in instances)
    return Explanation("effects", names, replace(fitted, instances=tuple(instances)))
