"""Closed form: the law without a name as a formula of the grammar.

A free law is known with a covariance, so that a formula costs what it deviates from it, in that covariance, and
Schwarz's penalty for each of its numbers. The best few are fitted to the record like any other effect, and the one that
explains both records with the fewest numbers is taken.
Source: as `fitting`; Golub and Pereyra (1973), SIAM J. Numer. Anal. 10(2), 413-432, for factors that are eliminated.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, minimise_residuals
from masking.inference.discovery import explanation, fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.free_law import KINDS, FreeLaw
from masking.inference.discovery.grammar import MOST_SHAPES, Atom, atoms, evaluated
from masking.inference.discovery.problem import EstimationProblem
from masking.model.declaration.dictionary_checks import MOST_PARAMETERS
from masking.model.effects import EffectParameter

WIDE, DEEP = 10, 5  # forms that are sharpened of each number of terms, and those to which a term is added
FITS = {1: 2, 2: 2, 3: 1}  # forms of so many terms that are fitted to the record
SAMPLES = 240  # of the motion at which forms are compared
PLUS = "  +  "  # between the terms of a form
ALIKE = 1e-6  # one less the cosine of two terms that are the same
EXACT = 2e-3  # of a force: how exactly splines of few pieces hold a formula
ROUNDING = 1e-14  # of the largest variance: what a smaller one is


@dataclass(frozen=True)
class Form:
    """A sum of terms, with the values of the numbers that shape each, and a factor of each (terms,).

    Its cost is what it deviates from the free law, with a penalty for each number.
    """

    atoms: tuple[Atom, ...]
    values: tuple[tuple[float, ...], ...]
    factors: tuple[float, ...]
    cost: float

    @property
    def shapes(self) -> int:
        """How many numbers shape it."""
        return sum(map(len, self.values))

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return self.shapes + len(self.atoms)

    @property
    def of(self) -> set[str]:
        """Its variables: displacement `d`, rate `v`."""
        return _variables(self.atoms)


@dataclass(frozen=True)
class _Known:
    """The free law as forms are compared with it."""

    law: FreeLaw
    penalty: float

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        step = max(1, len(self.law.x) // SAMPLES)
        return self.law.x[::step], self.law.rate[::step]

    @cached_property
    def motion(self) -> dict[str, Array | float]:
        """Displacement and rate at some samples, and their sizes."""
        law, (x, v) = self.law, self.samples
        sizes = {"x0": float(np.abs(law.x).max()) or 1.0, "v0": float(np.abs(law.rate).max()) or 1.0}
        return {"d": x, "d_rate": v, **sizes}

    @cached_property
    def spread(self) -> Array:
        """Covariance of the free law at the samples (m, m), not finite where that ran away."""
        at = self.law.rows(*self.samples)
        with np.errstate(over="ignore", invalid="ignore"):
            exact = np.eye(len(at)) * (EXACT * float((at @ self.law.factors).std())) ** 2
            return np.asarray(at @ self.law.covariance @ at.T + exact)

    @cached_property
    def _whitening(self) -> Array:
        """Whitening of deviations from the free law at the samples (m, m): independent then, of variance 1."""
        sizes, vectors = decompositions.symmetric(self.spread)
        return np.asarray((vectors / np.sqrt(np.maximum(sizes, ROUNDING * sizes[-1]))).T)

    @cached_property
    def target(self) -> Array:
        return np.asarray(self._whitening @ self.law.force(*self.samples))

    def column(self, atom: Atom, values: Sequence[float]) -> Array:
        known = self.motion | {f"p{i}": value for i, value in enumerate(values)}
        found = evaluated(atom.text([f"p{i}" for i in range(len(values))]), known)
        found = np.broadcast_to(found, np.shape(self.motion["d"]))
        return np.asarray(self._whitening @ found) if np.isfinite(found).all() else np.full(len(found), np.nan)

    def solved(self, terms: Sequence[Atom], values: Sequence[Sequence[float]]) -> tuple[Array, Array]:
        """Best factors of terms, and what they leave of the target (f,)."""
        table = np.column_stack([self.column(atom, v) for atom, v in zip(terms, values, strict=True)])
        with np.errstate(over="ignore", invalid="ignore"):
            size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        if not np.isfinite(size).all():
            return np.zeros(len(terms)), 1e3 * (1.0 + np.abs(self.target))
        factors = decompositions.least_squares(table / size, self.target, 1e-9) / size
        return factors, self.target - table @ factors

    def form(self, terms: tuple[Atom, ...], values: Sequence[Sequence[float]]) -> Form:
        factors, left = self.solved(terms, values)
        cost = float(left @ left) + self.penalty * (len(terms) + sum(map(len, values)))
        return Form(terms, tuple(map(tuple, values)), tuple(map(float, factors)), cost)

    def sharpened(self, form: Form) -> Form:
        """Form with the best values of the numbers that shape it."""
        bounds = [pair for atom in form.atoms for pair in atom.bounds]
        if not bounds:
            return form
        sizes = np.cumsum([len(values) for values in form.values])[:-1]

        def left(x: Array) -> Array:
            return self.solved(form.atoms, [part.tolist() for part in np.split(x, sizes)])[1]

        start, (low, high) = np.concatenate([np.array(values) for values in form.values]), np.array(bounds).T
        best = minimise_residuals(left, start, Box(low, high), sizes=np.maximum(np.abs(start), 0.1)).x
        better = self.form(form.atoms, [part.tolist() for part in np.split(best, sizes)])
        return min(form, better, key=lambda one: one.cost)


def forms(law: FreeLaw, readings: int) -> list[Form]:
    """Forms that deviate least from a free law, the best first; none where it ran away."""
    known, place = _Known(law, float(np.log(readings))), law.place
    if not np.isfinite(known.spread).all():
        return []
    tried = atoms(place.element.displacement is not None, place.has_rate)
    every = [(atom, values) for atom in tried for values in atom.starts()]
    columns = np.column_stack([known.column(atom, values) for atom, values in every])
    usable: Array = np.asarray(np.isfinite(columns).all(axis=0))
    every = [one for one, is_usable in zip(every, usable, strict=True) if is_usable]
    columns = columns[:, usable]
    found = _best([known.sharpened(form) for form in _best([known.form((a,), [v]) for a, v in every], 2)[:WIDE]])
    pairs = _best([known.sharpened(form) for form in _pairs(known, every, columns)])
    more = [three for two in pairs[:DEEP] for three in _with_another(known, two, every, [*columns.T])]
    return _best([*found, *pairs, *(known.sharpened(form) for form in _best(more, 2)[:WIDE])])


def _pairs(known: _Known, every: Sequence[tuple[Atom, tuple[float, ...]]], columns: Array) -> list[Form]:
    """Sums of two terms that deviate least, with the shapes as they are tried."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    right, cosine = scaled.T @ known.target, scaled.T @ scaled
    shapes = np.array([len(values) for _, values in every])
    with np.errstate(divide="ignore", invalid="ignore"):
        both = right[:, None] ** 2 + right[None, :] ** 2 - 2.0 * cosine * np.outer(right, right)
        gains = both / (1.0 - cosine**2) - known.penalty * np.add.outer(shapes, shapes)
    gains[(np.abs(cosine) > 1.0 - ALIKE) | (np.add.outer(shapes, shapes) > MOST_SHAPES)] = -np.inf
    gains[np.tril_indices(len(gains))] = -np.inf
    order = np.argsort(gains, axis=None)[::-1][: 40 * WIDE]
    found = []
    for i, j in zip(*np.unravel_index(order, gains.shape), strict=True):
        terms = (every[i][0], every[j][0])
        if np.isfinite(gains[i, j]) and _fits(terms):
            found.append(known.form(terms, [every[i][1], every[j][1]]))
    return _best(found, 2)[:WIDE]


def _with_another(
    known: _Known, form: Form, every: Sequence[tuple[Atom, tuple[float, ...]]], columns: Sequence[Array]
) -> list[Form]:
    """Form with each further term that there is room for, by what it leaves with the shapes as they are."""
    table = np.column_stack([known.column(atom, v) for atom, v in zip(form.atoms, form.values, strict=True)])
    basis = np.linalg.qr(table / np.maximum(np.linalg.norm(table, axis=0), 1e-300))[0]
    left = known.target - basis @ (basis.T @ known.target)
    gains = []
    for i, ((atom, values), column) in enumerate(zip(every, columns, strict=True)):
        other = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(other))
        is_new = np.isfinite(size) and size > 1e-6 * float(np.linalg.norm(column))
        if is_new and form.shapes + len(values) <= MOST_SHAPES and _fits((*form.atoms, atom)):
            gains.append((float(left @ other) ** 2 / size**2 - known.penalty * (1 + len(values)), i))
    best = sorted(gains, reverse=True)[: 2 * WIDE]
    return [known.form((*form.atoms, every[i][0]), [*form.values, every[i][1]]) for _, i in best]


def _variables(terms: Sequence[Atom]) -> set[str]:
    return {of for atom in terms for of, shape in atom.shapes if "{u}" in shape.text}


def _fits(terms: Sequence[Atom]) -> bool:
    return len(terms) + sum(atom.count for atom in terms) + len(_variables(terms)) <= MOST_PARAMETERS


def _best(found: Sequence[Form], alike: int = 1) -> list[Form]:
    """Forms, the best first, as many of the same terms as may be alike."""
    kept, seen = list[Form](), Counter[tuple[str, ...]]()
    for form in sorted(found, key=lambda one: one.cost):
        key = tuple(sorted(atom.name for atom in form.atoms))
        seen[key] += 1
        if seen[key] <= alike:
            kept.append(form)
    return kept


def instance(form: Form, law: FreeLaw) -> EffectInstance:
    """Form as an effect at the place of a free law, with all but the sizes of the motion free."""
    known = _Known(law, 0.0)
    parameters, values, free, parts = dict[str, EffectParameter](), list[float](), list[int](), list[str]()

    def add(name: str, parameter: EffectParameter, value: float, is_free: bool) -> str:
        free.extend([len(values)] if is_free else [])
        parameters[name] = parameter
        values.append(value)
        return name

    for i, (atom, shapes, factor) in enumerate(zip(form.atoms, form.values, form.factors, strict=True), start=1):
        name = add(f"f{i}", EffectParameter("F", "force at 1"), factor, True)
        keys = [(key, shape) for _, shape in atom.shapes for key in shape.tried]
        names = []
        for (key, shape), value in zip(keys, shapes, strict=True):
            label = next(n for n in (key, *(f"{key}{j}" for j in range(1, 9))) if n not in parameters)
            parameter = EffectParameter("1", f"shape: {shape.name}", bounds=shape.bounds[key])
            names.append(add(label, parameter, value, True))
        text = atom.text(names)
        parts.append(name if text == "1" else f"{name}*{text}")
    if "d" in form.of:
        add("x0", EffectParameter("D", "largest displacement of the record"), float(known.motion["x0"]), False)
    if "v" in form.of:
        add("v0", EffectParameter("D/s", "largest rate of the record"), float(known.motion["v0"]), False)
    return law.written(PLUS.join(parts), parameters, values, free)


@dataclass(frozen=True)
class ClosedForm:
    """A form that was fitted to the record; its values are those of the start."""

    form: Form
    # hypothesis and validated: the model with it, and with effects elsewhere, in both records
    hypothesis: Hypothesis
    validated: Hypothesis
    score: float  # cost of both records, with Schwarz's penalty for each number

    @property
    def instance(self) -> EffectInstance:
        """Form as an effect with its fitted values."""
        return self.hypothesis.instances[-1]

    @property
    def terms(self) -> list[tuple[Atom, tuple[float, ...], float]]:
        """Terms with the numbers that shape them, and their factors, as they were fitted."""
        left, found = [*self.instance.estimated], []
        for atom in self.form.atoms:
            factor, *values = left[: 1 + atom.count]
            left = left[1 + atom.count :]
            found.append((atom, tuple(values), factor))
        return found

    def shares(self, law: FreeLaw) -> list[float]:
        """Size of each term along the motion of the free law, over that of all together."""
        known = _Known(law, 0.0).motion | dict(zip(self.instance.entry.parameters, self.instance.values, strict=True))
        parts = [np.broadcast_to(evaluated(part, known), np.shape(known["d"])) for part in self.parts]
        whole = float(np.sqrt((np.sum(parts, axis=0) ** 2).mean())) or 1.0
        return [float(np.sqrt((part**2).mean())) / whole for part in parts]

    @property
    def parts(self) -> list[str]:
        """Terms as text, each with its factor."""
        return self.instance.entry.expression.split(PLUS)

    def as_dict(self, is_written: bool) -> dict[str, Any]:
        """Form as JSON can hold it, with whether it is what the model holds."""
        one = self.instance
        return {
            "written": is_written,
            "expression": one.entry.expression,
            "parameters": dict(zip(one.entry.parameters, one.values, strict=True)),
            "terms": [{"shape": a.name, "factor": factor, "numbers": [*values]} for a, values, factor in self.terms],
        }


def fitted(law: FreeLaw, problem: EstimationProblem, unseen: tuple[EstimationProblem, Hypothesis]) -> ClosedForm | None:
    """Closed form of a free law that explains both records best; None where none can be simulated.

    Forms of fewer terms come first, and one that leaves no more than the free law ends the search. `unseen` is the
    validation record, and the free law on it.
    """
    (validation, followed), known, evidence = unseen, law.hypothesis, problem.rules.effect_evidence
    others = tuple(one for one in known.instances if one.effect not in KINDS)
    best: ClosedForm | None = None
    both = float(np.log(problem.record.readings.size + validation.record.readings.size))
    every = forms(law, problem.record.readings.size)

    def made(form: Form, rival: float) -> ClosedForm:
        every_one = (*others, instance(form, law))
        found = fitting.fit(knowing(problem, every_one), every_one, theta=known.theta, start=known.start, rival=rival)
        checked = fitting.validated(knowing(validation, every_one), found)
        cost = found.misfit(known) + checked.misfit(followed)
        return ClosedForm(form, found, checked, cost + both * form.size + evidence * len(form.atoms))

    for many, fits in FITS.items():
        jobs = [partial(made, form) for form in every if len(form.atoms) == many][:fits]
        found = explanation.fitted(jobs, np.inf, problem.work)
        best = min((one for one in (best, *found) if one is not None), key=lambda one: one.score, default=None)
        if best is not None and (problem.work.ends() or best.hypothesis.misfit(known) < known.misfit(known) + evidence):
            break
    return best


def knowing(problem: EstimationProblem, instances: Sequence[EffectInstance]) -> EstimationProblem:
    """Problem whose rig knows the effects of instances."""
    return replace(problem, rig=replace(problem.rig, tried=tuple(one.entry for one in instances)))
