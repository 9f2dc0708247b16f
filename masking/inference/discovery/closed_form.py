"""Closed form: the law without a name as a formula.

A form is a sum of terms with a factor each; a term is a shape of the displacement or of the rate, or a product of both.
Shapes are of u, displacement or rate over the largest in the record; at most three numbers shape a form.

A free law is known with a covariance, so that a formula costs what it deviates from it, in that covariance, and
Schwarz's penalty for each of its numbers. The best few are fitted to the record like any other effect, and the one that
explains both records with the fewest numbers is taken.
Source: as `fitting`; Golub and Pereyra (1973), SIAM J. Numer. Anal. 10(2), 413-432, for factors that are eliminated.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from masking.compile.codegen.graph import Graph
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.least_squares import Box, minimise_residuals
from masking.inference.discovery import explanation, fitting, validation_simulation
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.free_law import FreeLaw
from masking.lazy_imports import sympy as sp
from masking.model.declaration.dictionary_checks import MOST_PARAMETERS
from masking.model.declaration.expression import Expression
from masking.model.effects import EffectParameter

MOST_SHAPES = 3  # numbers that shape a form
_TINY = "1e-9"  # of the largest displacement or rate: powers have derivatives from there on
_BASES = {"d": "d/x0", "v": "d_rate/v0"}


@dataclass(frozen=True)
class Shape:
    """A function of u with numbers that shape it."""

    name: str  # of the shape
    text: str  # over u and the numbers, in braces
    noun: str  # what it is, of x, with the numbers in braces
    tried: Mapping[str, tuple[float, ...]]  # values from which fits start, by number
    bounds: Mapping[str, tuple[float, float]]  # of each number
    grows: bool = True  # whether a force of this shape grows with its displacement or rate


def _shape(name: str, text: str, noun: str, /, **tried: Sequence[float]) -> Shape:
    values = {key: tuple(values) for key, values in tried.items()}
    return Shape(name, text, noun, values, {key: _BOUNDS[key] for key in values}, name not in _FALLING)


_FALLING = {"constant", "sign", "peak", "wave", "bell", "growth"}
_BOUNDS = {"n": (0.1, 9.0), "b": (1e-3, 1e3), "e": (-1e3, 1e3), "r": (1.02, 1e3), "l": (-1e3, -1.02), "p": (-4.0, 4.0)}
_POWERS = (0.35, 0.6, 1.35, 1.7, 2.0, 2.5, 3.0, 3.5, 4.5, 6.0)
_SIDES = (1.0, 1.5, 2.0, 3.0)
_WIDTHS = (0.05, 0.12, 0.25, 0.5, 1.0)
_SIZE = f"max(abs({{u}}), {_TINY})"
CONSTANT = _shape("constant", "1", "nothing that moves")
SIGN = _shape("sign", "tanh({u}/0.002)", "the direction of the {x}")
LINEAR = _shape("linear", "{u}", "the {x}")
EVEN = _shape("even power", f"{_SIZE}**{{n}}", "the {n} power of the {x}, alike on both sides", n=_POWERS)
RATES: tuple[Shape, ...] = (
    LINEAR,
    _shape("odd power", f"sign({{u}})*{_SIZE}**{{n}}", "the {n} power of the {x}", n=_POWERS),
    _shape("tanh", "tanh({u}/{b})", "the {x} up to a limit", b=_WIDTHS),
    _shape("peak", "{u}/(1 + ({u}/{b})**2)", "the {x} up to a peak, beyond which it falls", b=_WIDTHS),
)
BOTH: tuple[Shape, ...] = (
    _shape("growth", "exp({u}/{e})", "an exponential of the {x}", e=(0.2, 0.4, 0.8, 1.6, -0.2, -0.4, -0.8, -1.6)),
    _shape("wave", "sin({u}/{b} + {p})", "a sine of the {x}", b=(0.1, 0.18, 0.3, 0.5), p=(-1.6, -0.8, 0.0, 0.8, 1.6)),
    _shape("upper pole", "1/(1 - {u}/{r})**2", "the inverse square of the distance to a {x} above the travel",
           r=(1.15, 1.5, 2.2, 4.0)),
    _shape("lower pole", "1/(1 - {u}/{l})**2", "the inverse square of the distance to a {x} below the travel",
           l=(-1.15, -1.5, -2.2, -4.0)),
)  # fmt: skip
AT_REST = {"growth": "1", "wave": "sin({p})", "upper pole": "1", "lower pole": "1"}  # values at rest
ALONE = tuple(replace(one, text=f"({one.text} - {AT_REST[one.name]})") for one in BOTH)
DISPLACEMENTS: tuple[Shape, ...] = (
    *RATES,
    EVEN,
    *ALONE,
    _shape("upper side", f"max({{u}}, {_TINY})**{{n}}", "the {n} power of the {x} above rest", n=_SIDES),
    _shape("lower side", f"max(-{{u}}, {_TINY})**{{n}}", "the {n} power of the {x} below rest", n=_SIDES),
    _shape("sinh", "sinh({u}/{b})", "a hyperbolic sine of the {x}", b=(0.15, 0.3, 0.6)),
    _shape("arc tangent", "atan({u}/{b})", "an arc tangent of the {x}", b=_WIDTHS),
    _shape("tangent", "tan({u}/{r}*pi/2)", "a tangent of the {x}", r=(1.05, 1.3, 1.8, 3.0)),
    _shape("bell", "{u}*exp(-({u}/{b})**2)", "the {x} near rest alone", b=(0.1, 0.25, 0.5)),
    _shape("logarithm", "sign({u})*log(1 + abs({u})/{b})", "the logarithm of the {x}", b=(0.01, 0.05, 0.2)),
)


@dataclass(frozen=True)
class Atom:
    """A term of a form, without its factor: shapes of displacement and rate, one or both."""

    of_d: Shape | None
    of_v: Shape | None

    @cached_property
    def shapes(self) -> tuple[tuple[str, Shape], ...]:
        """Shapes with what they are of."""
        return tuple((of, shape) for of, shape in (("d", self.of_d), ("v", self.of_v)) if shape is not None)

    def starts(self) -> list[tuple[float, ...]]:
        """Values from which fits start, one after the other."""
        return [*itertools.product(*(values for _, shape in self.shapes for values in shape.tried.values()))]

    @property
    def count(self) -> int:
        """How many numbers shape it."""
        return sum(len(shape.tried) for _, shape in self.shapes)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of these numbers."""
        return [bounds for _, shape in self.shapes for bounds in shape.bounds.values()]

    def text(self, names: Sequence[str]) -> str:
        """Term over `d`, `d_rate`, `x0`, `v0` and named numbers."""
        parts, left = [], list(names)
        for of, shape in self.shapes:
            known = {key: left.pop(0) for key in shape.tried}
            parts.append(shape.text.format(u=f"({_BASES[of]})", **known))
        return "*".join(parts)

    def along(self, motion: Mapping[str, Array | float], values: Sequence[float]) -> Array:
        """Values (m,) along displacements and rates `d` and `d_rate` (m,), of largest sizes `x0` and `v0`."""
        names = [f"p{i}" for i in range(self.count)]
        return np.broadcast_to(
            evaluated(self.text(names), {**motion, **dict(zip(names, values, strict=True))}), np.shape(motion["d"])
        )

    def words(self, values: Sequence[float], nouns: Mapping[str, str]) -> str:
        """Phrase for the force of the term, with the values of its numbers and nouns of displacement and rate."""
        left, said = [*values], []
        for of, shape in reversed(self.shapes):
            numbers = [left.pop() for _ in shape.tried][::-1]
            known = {key: _ordinal(value) for key, value in zip(shape.tried, numbers, strict=True)}
            said.append(shape.noun.format(x=nouns[of], **known))
        return f"{'grows with' if self.shapes[-1][1].grows else 'follows'} {', times '.join(said)}"

    @property
    def name(self) -> str:
        """Shapes that it is made of."""
        return " x ".join(f"{shape.name} of {of}" for of, shape in self.shapes)


def atoms(has_displacement: bool, has_rate: bool) -> list[Atom]:
    """Every term of a law at a place that has a displacement, a rate, or both."""
    found = [Atom(shape, None) for shape in (CONSTANT, *(DISPLACEMENTS if has_displacement else ()))]
    if has_rate:
        turning = (SIGN, *RATES)
        found += [Atom(None, shape) for shape in (*turning, EVEN, *ALONE[:1])]
        factors = (EVEN, *BOTH, LINEAR) if has_displacement else ()
        found += [Atom(a, b) for a in factors for b in turning if len(a.tried) + len(b.tried) <= MOST_SHAPES]
    return found


def _ordinal(value: float) -> str:
    """Power as one says it: 2nd, 1.7th."""
    text = f"{value:.3g}"
    return text + {"1": "st", "2": "nd", "3": "rd"}.get(text, "th")


@cache
def _function(text: str, names: tuple[str, ...]) -> Callable[[Iterable[Any]], list[Any]]:
    """Function that an expression is, of arrays by symbol."""
    graph = Graph()
    nodes = {sp.Symbol(name, real=True): graph.symbol(name, varying=True) for name in names}
    value = graph.lower(Expression(text).to_sympy({symbol.name: symbol for symbol in nodes}), nodes)
    return function_of(graph, [value], {}, ARRAYS, "value", variables=[*nodes.values()])


def evaluated(text: str, known: Mapping[str, Array | float]) -> Array:
    """Values of an expression (m,) for columns (m,) or numbers by symbol."""
    with np.errstate(all="ignore"):
        (found,) = _function(text, tuple(known))(known.values())
    return np.asarray(found, dtype=float)


def force(instance: EffectInstance, x: Array, rate: Array) -> Array:
    """Force of a law at displacements and rates (m,)."""
    values = dict(zip(instance.entry.parameters, instance.values, strict=True))
    found = evaluated(instance.entry.expression, {**values, "d": x, "d_rate": rate})
    return np.broadcast_to(found, np.shape(x))


MOST_TERMS = 2  # of a form
WIDE, FITS = 10, 2  # forms of each number of terms that are sharpened, and those that are fitted to the record
TRIED = 400  # forms of each number of terms whose factors are found
ALIKE = 1e-6  # of a term: what others leave of one that is the same
SAMPLES = 240  # of the motion at which forms are compared
EXACT = 2e-3  # of a force: how exactly splines of few pieces hold a formula
ROUNDING = 1e-14  # of the largest variance: what a smaller one is


@dataclass(frozen=True)
class Formula:
    """A sum of terms, with the values of the numbers that shape each, and a factor of each (terms,)."""

    atoms: tuple[Atom, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()
    factors: tuple[float, ...] = ()
    cost: float = np.inf  # what it deviates from the free law, with a penalty for each number

    @property
    def terms(self) -> list[tuple[Atom, tuple[float, ...], float]]:
        """Terms with the numbers that shape them, and their factors."""
        return [*zip(self.atoms, self.values, self.factors, strict=True)]

    @property
    def shapes(self) -> int:
        """How many numbers shape it."""
        return sum(atom.count for atom in self.atoms)

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return self.shapes + len(self.atoms)

    @property
    def of(self) -> set[str]:
        """Its variables: displacement `d`, rate `v`."""
        return {of for atom in self.atoms for of, shape in atom.shapes if "{u}" in shape.text}

    @property
    def is_allowed(self) -> bool:
        """Whether it is an effect of as many numbers as one may have."""
        return self.shapes <= MOST_SHAPES and self.size + len(self.of) <= MOST_PARAMETERS

    def fitted(self, numbers: Sequence[float]) -> Formula:
        """Formula with other numbers, for each term its factor and those that shape it."""
        left = iter(numbers)
        parts = [(next(left), tuple(next(left) for _ in values)) for values in self.values]
        return replace(self, factors=tuple(f for f, _ in parts), values=tuple(values for _, values in parts))

    def shares(self, law: FreeLaw) -> list[float]:
        """Size of each term along the motion of a free law, over that of all together."""
        motion: dict[str, Array | float] = {"d": law.x, "d_rate": law.rate, **_sizes(law)}
        parts = [factor * atom.along(motion, values) for atom, values, factor in self.terms]
        whole = float(np.sqrt((np.sum(parts, axis=0) ** 2).mean())) or 1.0
        return [float(np.sqrt((part**2).mean())) / whole for part in parts]


def _sizes(law: FreeLaw) -> dict[str, float]:
    """Largest displacement and rate of the record, by their names in a form."""
    return {"x0": float(np.abs(law.x).max()) or 1.0, "v0": float(np.abs(law.rate).max()) or 1.0}


@dataclass(frozen=True)
class _Known:
    """The free law as forms are compared with it: at some samples, by deviations in its covariance."""

    law: FreeLaw
    penalty: float  # for each number

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        step = max(1, len(self.law.x) // SAMPLES)
        return self.law.x[::step], self.law.rate[::step]

    @cached_property
    def spread(self) -> Array:
        """Covariance of the free law at the samples (m, m), not finite where that ran away."""
        at = self.law.rows(*self.samples)
        with np.errstate(over="ignore", invalid="ignore"):
            exact = np.eye(len(at)) * (EXACT * float((at @ self.law.factors).std())) ** 2
            return np.asarray(at @ self.law.covariance @ at.T + exact)

    @cached_property
    def whitening(self) -> Array:
        """Whitening of deviations from the free law at the samples (m, m): independent then, of variance 1."""
        sizes, vectors = decompositions.symmetric(self.spread)
        return np.asarray((vectors / np.sqrt(np.maximum(sizes, ROUNDING * sizes[-1]))).T)

    @cached_property
    def target(self) -> Array:
        return np.asarray(self.whitening @ self.law.force(*self.samples))

    @cached_property
    def terms(self) -> list[tuple[Atom, tuple[float, ...], Array]]:
        """Every term with values that fits start from, and the column that it is (m,), where that is finite."""
        place = self.law.place
        tried = atoms(place.element.displacement is not None, place.has_rate)
        every = [(atom, values, self.column(atom, values)) for atom in tried for values in atom.starts()]
        return [term for term in every if np.isfinite(term[2]).all()]

    def column(self, atom: Atom, values: Sequence[float]) -> Array:
        motion = dict(zip(("d", "d_rate"), self.samples, strict=True))
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self.whitening @ atom.along({**motion, **_sizes(self.law)}, values))

    def solved(self, form: Formula) -> tuple[Formula, Array]:
        """Formula with the best factors, and what it leaves of the target (m,)."""
        table = np.column_stack([self.column(atom, v) for atom, v in zip(form.atoms, form.values, strict=True)])
        with np.errstate(over="ignore", invalid="ignore"):
            size = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        if not np.isfinite(size).all():
            return form, 1e3 * (1.0 + np.abs(self.target))
        factors = decompositions.least_squares(table / size, self.target, 1e-9) / size
        left = self.target - table @ factors
        cost = float(left @ left) + self.penalty * form.size
        return replace(form, factors=tuple(map(float, factors)), cost=cost), left

    def sharpened(self, form: Formula) -> Formula:
        """Formula with the best values of the numbers that shape it."""
        if not form.shapes:
            return form
        ends = np.cumsum([atom.count for atom in form.atoms])[:-1]

        def at(x: Array) -> Formula:
            return replace(form, values=tuple(tuple(part.tolist()) for part in np.split(x, ends)))

        start = np.concatenate(form.values)
        box = Box(*np.array([pair for atom in form.atoms for pair in atom.bounds]).T)
        sizes = np.maximum(np.abs(start), 0.1)
        best = minimise_residuals(lambda x: self.solved(at(x))[1], start, box, sizes=sizes).x
        return min(form, self.solved(at(best))[0], key=lambda one: one.cost)

    def longer(self, form: Formula) -> list[tuple[float, Formula]]:
        """Formula with each further term that there is room for, and what it costs then with the shapes as they are."""
        table = np.column_stack([np.zeros((len(self.target), 0)), *(self.column(*term[:2]) for term in form.terms)])
        basis = np.linalg.qr(table / np.maximum(np.linalg.norm(table, axis=0), 1e-300))[0]
        columns, counts = np.column_stack([column for _, _, column in self.terms]), [len(v) for _, v, _ in self.terms]
        left, others = (x - basis @ (basis.T @ x) for x in (self.target, columns))
        size = np.linalg.norm(others, axis=0)
        is_new = size > ALIKE * np.linalg.norm(columns, axis=0)
        gains = np.divide(left @ others, size, out=np.zeros_like(size), where=is_new) ** 2
        costs = np.where(is_new, float(left @ left) - gains + self.penalty * (form.size + 1 + np.array(counts)), np.inf)
        found = []
        for i in np.argsort(costs)[: min(TRIED, np.count_nonzero(is_new))]:
            atom, values, _ = self.terms[i]
            more = Formula((*form.atoms, atom), (*form.values, values), (*form.factors, 1.0))
            if more.is_allowed:
                found.append((float(costs[i]), more))
        return found


def forms(law: FreeLaw, readings: int) -> list[Formula]:
    """Forms that deviate least from a free law, the best first; none where it ran away."""
    known = _Known(law, float(np.log(readings)))
    if not np.isfinite(known.spread).all():
        return []
    found, level = list[Formula](), [Formula()]
    for _ in range(MOST_TERMS):
        more = sorted((pair for form in level for pair in known.longer(form)), key=lambda pair: pair[0])[:TRIED]
        tried = _best([known.solved(form)[0] for _, form in more], 2)
        sharpened = [known.sharpened(form) for form in tried[:WIDE]]
        found, level = [*found, *sharpened], [*sharpened, *tried]
    return _best(found)


def _best(found: Sequence[Formula], alike: int = 1) -> list[Formula]:
    """Forms, the best first, as many of the same terms as may be alike."""
    kept, seen = list[Formula](), Counter[tuple[str, ...]]()
    for form in sorted(found, key=lambda one: one.cost):
        key = tuple(sorted(atom.name for atom in form.atoms))
        seen[key] += 1
        if seen[key] <= alike:
            kept.append(form)
    return kept


def instance(form: Formula, law: FreeLaw) -> EffectInstance:
    """Formula as an effect at the place of a free law, with all but the sizes of the motion free."""
    parameters, values, parts = dict[str, EffectParameter](), list[float](), list[str]()

    def add(name: str, parameter: EffectParameter, value: float) -> str:
        label = next(n for n in (name, *(f"{name}{j}" for j in range(1, 9))) if n not in parameters)
        parameters[label] = parameter
        values.append(value)
        return label

    for i, (atom, shapes, factor) in enumerate(form.terms, start=1):
        name = add(f"f{i}", EffectParameter("F", "force at 1"), factor)
        keys = [(key, shape) for _, shape in atom.shapes for key in shape.tried]
        names = [
            add(key, EffectParameter("1", f"shape: {shape.name}", bounds=shape.bounds[key]), value)
            for (key, shape), value in zip(keys, shapes, strict=True)
        ]
        text = atom.text(names)
        parts.append(name if text == "1" else f"{name}*{text}")
    free, sizes = range(len(values)), _sizes(law)
    if "d" in form.of:
        add("x0", EffectParameter("D", "largest displacement of the record"), sizes["x0"])
    if "v" in form.of:
        add("v0", EffectParameter("D/s", "largest rate of the record"), sizes["v0"])
    return law.written(" + ".join(parts), parameters, values, free)


@dataclass(frozen=True)
class ClosedForm:
    """A form that was fitted to the record."""

    formula: Formula  # with the fitted numbers
    explanation: Explanation  # the model with it, and with effects elsewhere
    validated: Hypothesis  # the same on the validation record
    score: float  # cost of both records, with Schwarz's penalty for each number

    @property
    def instance(self) -> EffectInstance:
        """Formula as an effect with its fitted values."""
        return self.explanation.hypothesis.instances[-1]

    def as_dict(self, is_written: bool) -> dict[str, Any]:
        """Formula as JSON can hold it, with whether it is what the model holds."""
        one = self.instance
        return {
            "written": is_written,
            "expression": one.entry.expression,
            "parameters": dict(zip(one.entry.parameters, one.values, strict=True)),
            "terms": [{"shape": a.name, "factor": factor, "numbers": [*v]} for a, v, factor in self.formula.terms],
        }


def fitted(law: FreeLaw, unseen: EstimationProblem, followed: Hypothesis) -> ClosedForm | None:
    """Closed form of a free law that explains both records best; None where none can be simulated.

    Forms of fewer terms come first, and one that leaves no more than the free law ends the search. The validation
    record is that of `followed`, the free law on it.
    """
    problem, known, price = law.problem, law.hypothesis, law.problem.rules.effect_evidence
    both = float(np.log(problem.record.readings.size + unseen.record.readings.size))
    best: ClosedForm | None = None

    def made(form: Formula, rival: float) -> ClosedForm:
        every = (*law.others, instance(form, law))
        found = fitting.fit(knowing(problem, every), every, theta=known.theta, start=known.start, rival=rival)
        checked = validation_simulation.validated(knowing(unseen, every), found)
        cost = found.misfit(known) + checked.misfit(followed) + both * form.size + price * len(form.atoms)
        return ClosedForm(form.fitted(found.instances[-1].estimated), named(found), checked, cost)

    every = forms(law, problem.record.readings.size)
    for many in range(1, MOST_TERMS + 1):
        jobs = [partial(made, form) for form in every if len(form.atoms) == many][:FITS]
        tried = explanation.fitted(jobs, np.inf, problem.work)
        best = min((one for one in (best, *tried) if one is not None), key=lambda one: one.score, default=None)
        if best is not None:
            left = best.explanation.hypothesis.misfit(known)
            if problem.work.ends() or left < known.misfit(known) + price:
                break
    return best


def named(hypothesis: Hypothesis) -> Explanation:
    """Model with a law as an explanation."""
    return Explanation("effects", tuple((one.effect, one.at) for one in hypothesis.instances), hypothesis)


def knowing(problem: EstimationProblem, instances: Sequence[EffectInstance]) -> EstimationProblem:
    """Problem whose rig knows the effects of instances."""
    return replace(problem, rig=replace(problem.rig, tried=tuple(one.entry for one in instances)))
