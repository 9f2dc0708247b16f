"""Unnamed law: the empirical force law of a record that no effect of the dictionary explains, in the model."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result
from masking.errors import IntegrationError
from masking.inference.discovery import (
    candidates,
    closed_form,
    free_law,
    further_places,
    validation_simulation,
    verdict,
)
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.closed_form import ClosedForm
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.force_decomposition import CELLS
from masking.inference.discovery.free_law import ALIKE, FreeLaw, likelier
from masking.inference.discovery.latent_force import Explained, binned
from masking.inference.discovery.shooting_intervals import finer
from masking.inference.discovery.spline_bases import Curve, Term
from masking.inference.estimation.simulation import STUCK
from masking.model.effects import EffectParameter

MOST_FINER = 4  # times the integration steps of the model alone: curves are smooth, and have many factors
BINS = 10  # of the range of displacements, and of that of speeds
DIGITS = 8  # of the numbers of a table
LEAST = 1e-4  # of the strongest part of a surface: weaker ones are left out
_UNITS = {"f": "F", "c": "F*s/D", "x": "D", "v": "D/s", "s": "D/s"}
_MEANINGS = {
    "f": "force at 1 in the table",
    "c": "damping at 1 in the table",
    "x": "displacement at 1 in the table",
    "v": "rate at 1 in the table",
    "s": "rate below which the sign of the rate is smooth",
}


@dataclass(frozen=True)
class UnnamedLaw:
    """A law without a name."""

    free: FreeLaw  # the law as curves, fitted
    explanation: Explanation  # the model with the law as it is written, and with effects elsewhere
    validated: Hypothesis  # the same on the validation record
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

    @cached_property
    def error(self) -> tuple[dict[str, float], dict[str, float]]:
        """Relative errors of sensors in both records."""
        return self.free.problem.errors(self.fitted.squares), self.problem.errors(self.validated.squares)

    @property
    def closed(self) -> bool:
        """Whether it leaves no more than noise in the validation record."""
        errors, floor = self.error[1].values(), self.problem.noise_floor.values()
        return verdict.at_noise_floor(errors, floor, len(self.problem.record), self.problem.rules)

    def force(self, x: Array, rate: Array) -> Array:
        """Force of the law as it is written at displacements and rates (m,)."""
        return closed_form.force(self.instance, x, rate) if self.is_formula else self.free.force(x, rate)

    @cached_property
    def curves(self) -> tuple[Array, Array]:
        """Factors of the curves (f,) and their covariance (f, f), beside the parameters that are written."""
        return self.free.given(self.fitted.theta)

    def deviation(self, x: Array, rate: Array) -> Array:
        """Standard deviation of the curves at displacements and rates (m,)."""
        rows, (_, covariance) = self.free.rows(x, rate), self.curves
        if not np.isfinite(covariance).all():
            return np.full(len(rows), np.inf)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, covariance, rows), 0.0)))

    def band(self, x: Array, rate: Array, along: Array) -> tuple[Array, Array, Array]:
        """Band of the curves along a motion (m,): two standard deviations about them, means over bins of `along`.

        It is given as the centres of the bins, and the ends of the band there (b,).
        """
        centres, middle, _ = binned(along, self.free.rows(x, rate) @ self.curves[0])
        half = 2.0 * binned(along, self.deviation(x, rate))[1]
        return centres, middle - half, middle + half

    @cached_property
    def coverage(self) -> Coverage:
        """Where the record moves the place of the law, and how well the law is known there."""
        of_form = self.form.formula.of if self.form is not None and self.is_formula else set[str]()
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


def law_of(found: Explained, validation: EstimationProblem, substeps: int, part: float) -> UnnamedLaw | None:
    """Law of a record without a name; None where none can be fitted and simulated on unseen data.

    The integration steps are those of the model alone. After a part of the work of a search, no more is fitted.
    """
    found = replace(found, problem=replace(found.problem, work=found.problem.work.kept(part)))
    rules, size = found.problem.rules, found.record.readings.size
    steps = min(found.problem.substeps, MOST_FINER * substeps)
    law = _in_steps(found, validation, steps)
    if law is None or found.problem.work.ends():
        return law
    if not verdict.leaves_little(law.free.hypothesis.cost, found.search.base.cost, size, rules):
        return law  # smaller steps would make nothing of it
    needed = finer(law.free.problem, law.free.hypothesis, substeps)
    return law if needed <= steps else _in_steps(found, validation, needed) or law


def _in_steps(found: Explained, validation: EstimationProblem, steps: int) -> UnnamedLaw | None:
    """Law in a number of integration steps between samples."""
    problem, unseen = (replace(one, substeps=steps) for one in (found.problem, validation))
    try:
        law = _free_law(replace(found, problem=problem))
        return None if law is None else _in_model(law, unseen)
    except IntegrationError:
        return None


def _free_law(found: Explained) -> FreeLaw | None:
    """Free law of a record: alone, beside the causes, or at a further place; None where none can be fitted."""
    problem, law = found.problem, free_law.fit(found)
    if law is None or _is_enough(law):
        return law
    known = found.explanation.hypothesis.instances
    others = [problem.in_steps(one) for one in known if one.at != law.place.name]
    law = likelier(law, free_law.fit(found, others) if others else None)
    if _is_enough(law):
        return law
    further = further_places.of(problem.rig, law.place.name, candidates.time(found.search.motion))
    return likelier(law, free_law.fit(found, law.others, further))


def _is_enough(law: FreeLaw) -> bool:
    """Whether a law leaves hardly more than noise, or the work is done."""
    return law.hypothesis.cost <= ALIKE * law.problem.record.readings.size or law.problem.work.ends()


def _in_model(free: FreeLaw, validation: EstimationProblem) -> UnnamedLaw:
    """Free law as a part of the model, as a formula or in tables; errors as `fitting.fit`."""
    validation, followed = _followed(validation, free)
    form = closed_form.fitted(free, validation, followed)
    # The free law costs what it does in both records, with Schwarz's penalty for each factor.
    penalty = free.size * float(np.log(free.problem.record.readings.size + validation.record.readings.size))
    cost = free.hypothesis.misfit(free.hypothesis) + followed.misfit(followed) + penalty
    if form is not None and form.score <= cost:
        return UnnamedLaw(free, form.explanation, form.validated, validation, form, is_formula=True)
    fitted, many = free.hypothesis, len(free.hypothesis.deviations) - free.size
    written = replace(fitted, covariance=fitted.covariance[:many, :many], instances=(*free.others, tabulated(free)))
    return UnnamedLaw(free, closed_form.named(written), followed, validation, form)


def _followed(validation: EstimationProblem, law: FreeLaw) -> tuple[EstimationProblem, Hypothesis]:
    """Validation record in the longest shooting intervals in which a law follows the motion, and the law.

    A chaotic motion is lost whatever the law, since any difference grows. Errors as `fitting.fit`.
    """
    unseen = replace(validation, rig=law.problem.rig, prior=law.problem.prior, interval=law.problem.interval)
    most = STUCK * unseen.record.readings.size
    for part in reversed([*free_law.growing(unseen)]):
        with suppress(IntegrationError):
            found = validation_simulation.validated(part, law.hypothesis, most)
            if found.cost < most:
                return part, found
    return unseen, validation_simulation.validated(unseen, law.hypothesis)


class Widest(NamedTuple):
    """The part of a range in which a law is known least."""

    band: float  # two standard deviations of the law there, rms, over the rms of the law along the motion
    of: str  # 'displacement' or 'speed'
    # the ends of the part
    low: float
    high: float


@dataclass(frozen=True)
class Coverage(Result):
    """Where a record moves a place, and how well a law without a name is known there."""

    # displacement and rate: the least and the largest of the record
    displacement: tuple[float, float]
    rate: tuple[float, float]
    band: float  # two standard deviations of the law, rms along the motion, over the rms of the law there
    widest: Widest  # the part of the range in which it is known least
    sides: tuple[str, ...]  # what the law is of: displacement `d`, rate `v`, or both
    visited: float  # part of the rectangle of displacements and rates that the motion visits; 1 of a law of one of them
    json_names = ("displacement", "rate", "band", "widest", "visited")

    @classmethod
    def of(cls, x: Array, rate: Array, force: Array, deviation: Array, sides: Collection[str]) -> Coverage:
        """Coverage of a motion: displacement, rate, and force of the law there with its standard deviation (m,)."""
        squares = (2.0 * deviation / max(float(np.sqrt((force**2).mean())), 1e-300)) ** 2
        parts = []
        for side, name, values in (("d", "displacement", x), ("v", "speed", np.abs(rate))):
            many, edges = np.histogram(values, BINS)
            sums = np.histogram(values, BINS, weights=squares)[0]
            seen = zip(np.sqrt(sums / np.maximum(many, 1)), edges, edges[1:], strict=False)
            parts += [Widest(float(band), name, float(low), float(high)) for band, low, high in seen if side in sides]
        moved, moves = ((float(values.min()), float(values.max())) for values in (x, rate))
        cells = np.histogram2d(x, rate, CELLS)[0]
        visited = np.count_nonzero(cells) / cells.size if {*sides} >= {"d", "v"} else 1.0
        return cls(moved, moves, float(np.sqrt(squares.mean())), max(parts), tuple(sorted(sides)), visited)


def tabulated(law: FreeLaw) -> EffectInstance:
    """Free law as one effect at its place, in tables of displacement and rate."""
    parts, values, kinds = [], dict[str, float](), [term.kind for term in law.terms]
    factors = np.split(law.factors, np.cumsum([term.size for term in law.terms])[:-1])
    if {"free_spring", "free_damping"} <= {*kinds}:  # what the curve over the rate is at rest goes to the other
        one, other = kinds.index("free_damping"), kinds.index("free_spring")
        at_rest = float((law.terms[one].curves[0].values(np.zeros(1)) @ factors[one])[0])
        factors[one], factors[other] = factors[one] - at_rest, factors[other] + at_rest  # B-splines add up to 1
    for i, (term, of_term) in enumerate(zip(law.terms, factors, strict=True)):
        parts += [*_written(term, of_term, "" if i == 0 else str(i + 1), values)]
    parameters = {name: EffectParameter(_UNITS[name[0]], _MEANINGS[name[0]]) for name in values}
    return law.written(" + ".join(parts), parameters, values.values())


def _written(term: Term, factors: Array, label: str, values: dict[str, float]) -> Iterator[str]:
    """Parts of a term as text; adds their parameters with their values."""
    f, x, v, s, c = (f"{letter}{label or 0}" for letter in "fxvsc")
    match term.kind:
        case "free_friction":
            values |= {f: float(factors[0]), s: term.sharp}
            yield f"{f}*tanh(d_rate/{s})"
        case "free_surface":
            along, across = term.curves
            of_rate = along.values(along.points) @ factors.reshape(along.size, across.size)
            heights = of_rate @ across.values(across.points).T
            left, sizes, right = decompositions.svd(heights)
            values |= {f: float(sizes[0]) or 1.0, x: _reach(along), v: _reach(across)}
            for size, a, b in zip(sizes, left.T, right, strict=True):
                if size > LEAST * sizes[0]:
                    of_x, of_v = _table(along, f"d/{x}", a), _table(across, f"d_rate/{v}", b * size / values[f])
                    yield f"{f}*{of_x}*{of_v}"
        case kind:
            (curve,) = term.curves
            heights = curve.values(curve.points) @ factors
            by, at = (c, x) if kind == "free_resistance" else (f, v) if kind == "free_damping" else (f, x)
            values |= {by: float(np.abs(heights).max()) or 1.0, at: _reach(curve)}
            table = _table(curve, f"{'d_rate' if at == v else 'd'}/{at}", heights / values[by])
            turned = {"free_resistance": "d_rate*", "free_rub": f"tanh(d_rate/{s})*"}.get(kind, "")
            values |= {s: term.sharp} if kind == "free_rub" else {}
            yield f"{by}*{turned}{table}"


def _reach(curve: Curve) -> float:
    return float(np.abs(curve.points).max())


def _table(curve: Curve, of: str, heights: Array) -> str:
    pairs = zip(curve.points / _reach(curve), heights, strict=True)
    return f"interpolate({of}, {', '.join(f'{a:.{DIGITS}g}, {b:.{DIGITS}g}' for a, b in pairs)})"
