"""Free law: the law at a place without a name, fitted as a curve or a surface over displacement and rate.

Its form is the one that explains most to first order along the measured motion, as candidates are screened. It is then
fitted to the record by least squares, together with the parameters of the model.
Source: as `bases`; Masri and Caughey (1979), J. Appl. Mech. 46, 433-447, for forces over displacement and rate.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import MOST_COLUMNS, EffectInstance
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.further_places import NOUNS, FurtherPlaces
from masking.inference.discovery.latent_force import Explained, directions, projected
from masking.inference.discovery.places import Place
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import COLLINEAR, Screen
from masking.inference.discovery.smoothing import Motion, smooth
from masking.inference.discovery.spline_bases import FEW, Curve, Term, pieces
from masking.model.effects import Effect, EffectParameter

NAME = "unnamed_law"  # of the effect that a model holds
SHARP = 2e-3  # of the largest rate: width of the sign of a rate
NEGLIGIBLE = 1e-9  # of its standard deviation: a force that is not seen at all
BEND = 0.3  # of the largest force: standard deviation of a bend between neighbouring pieces before the record
SIDE = 5  # pieces of each side of a surface
MOST_FORMS = 3  # forms that are fitted
ROUNDS, FIRST_ROUNDS = 25, 8  # of a fit, and of those in shorter shooting intervals before it
PARTS, FEWEST = (60, 12), 20  # of a record in a shooting interval to begin with, and samples in it
NEARER = (2.0, 1.4, 1.2, 1.1, 1.05, 1.025)  # times the best relaxation time: those that are tried next
LOST = 1.5  # times the cost of shorter shooting intervals, from which the motion has lost the record
ALIKE = 1.1  # cost over that of noise from which no richer form is fitted


@dataclass(frozen=True)
class FreeLaw:
    """A law without a name, fitted."""

    place: Place  # where it sits
    terms: tuple[Term, ...]  # what it is made of
    hypothesis: Hypothesis  # the model with it, fitted to the record
    # x and rate: displacement and rate along the record (m,)
    x: Array
    rate: Array
    penalty: Array  # on the free parameters of all effects (f, f), as in `fitting.fit`
    problem: EstimationProblem  # the record in the shooting intervals of the fit
    further: FurtherPlaces | None = None  # further places that it sits in one of; None for places of the rig itself

    def score(self, like: Hypothesis) -> float:
        """-2 log likelihood by the colour of another hypothesis, with Schwarz's penalty for each factor."""
        return self.hypothesis.misfit(like) + self.numbers * float(np.log(self.hypothesis.residuals.size))

    @property
    def numbers(self) -> int:
        """Number of factors, and of a relaxation time."""
        return self.size + bool(self.further and self.further.time)

    @property
    def size(self) -> int:
        """Number of factors."""
        return sum(len(instance.free) for instance in self.instances)

    @property
    def instances(self) -> tuple[EffectInstance, ...]:
        """Instances that the law is made of."""
        return tuple(one for one in self.hypothesis.instances if one.effect in KINDS)

    @property
    def words(self) -> str:
        """Phrase for the law: a force that is the sum of its terms."""
        return f"a force that is {' plus '.join(KINDS[term.kind].format(**self.nouns) for term in self.terms)}"

    @property
    def nouns(self) -> Mapping[str, str]:
        """Nouns of its displacement `d` and its rate `v`."""
        return NOUNS if self.further is None else self.further.nouns[self.place.name]

    @property
    def on(self) -> str:
        """Name of the place of the rig whose force it is."""
        return self.place.name if self.further is None else self.further.on[self.place.name]

    def of(self, problem: EstimationProblem) -> EstimationProblem:
        """Problem of another record for the rig of this law."""
        return replace(problem, rig=self.problem.rig, prior=self.problem.prior)

    @property
    def follows(self) -> set[str]:
        """Its variables: displacement `d`, rate `v`."""
        kinds = {term.kind for term in self.terms}
        return {side for side, other in (("d", OF_RATE), ("v", OF_DISPLACEMENT)) if kinds - other}

    @property
    def factors(self) -> Array:
        """Factors (f,)."""
        return fitting.estimated(self.instances)

    @property
    def covariance(self) -> Array:
        """Covariance of the factors (f, f)."""
        return self.hypothesis.covariance[-self.size :, -self.size :]

    def rows(self, x: Array, rate: Array) -> Array:
        """Basis functions at displacements and rates (m, f)."""
        return np.hstack([term.values(x, rate) for term in self.terms])

    def force(self, x: Array, rate: Array) -> Array:
        """Force at displacements and rates (m,)."""
        return np.asarray(self.rows(x, rate) @ self.factors)

    def written(
        self, text: str, parameters: Mapping[str, EffectParameter], values: Iterable[float], free: Iterable[int] = ()
    ) -> EffectInstance:
        """Law as one effect at its place, by an expression of the motion and of parameters."""
        meaning = "A law without a name, as it was found in a record."
        entry = Effect(NAME, meaning, text, parameters, label="law without a name", is_searched=False)
        return EffectInstance(NAME, self.place.name, tuple(values), tuple(free), entry)

    def given(self, theta: Array) -> tuple[Array, Array]:
        """Factors (f,) and their covariance (f, f) where the parameters (k,) of the rig are known.

        The record does not separate a spring of the law from one of the model, but knows their sum well.
        Source: Gelman et al. (2013), Bayesian Data Analysis, appendix A, for conditional normal distributions.
        """
        every, k = self.hypothesis.covariance, len(theta)
        if not np.isfinite(every).all():  # a law that ran away
            return self.factors, np.full((self.size, self.size), np.inf)
        size = np.sqrt(np.maximum(np.diag(every)[:k], 1e-300))
        inverse = decompositions.inverse(every[:k, :k] / np.outer(size, size), COLLINEAR, hermitian=True)
        gain = every[-self.size :, :k] @ (inverse / np.outer(size, size))
        factors = self.factors + gain @ (theta - self.hypothesis.theta)
        return factors, np.asarray(self.covariance - gain @ every[:k, -self.size :])


def likelier(one: FreeLaw, other: FreeLaw) -> FreeLaw:
    """Likelier one of two laws."""
    like = fitting.nearest([one.hypothesis, other.hypothesis])
    return other if other.score(like) < one.score(like) else one


KINDS = {
    "free_spring": "a curve over the {d}",
    "free_damping": "a curve over the {v}",
    "free_friction": "a dry friction",
    "free_resistance": "the {v} times a curve over the {d}",
    "free_rub": "a dry friction that changes with the {d}",
    "free_surface": "a surface over {d} and {v}",
}
OF_DISPLACEMENT, OF_RATE = {"free_spring"}, {"free_damping", "free_friction"}  # alone


def fit(
    found: Explained, known: Sequence[EffectInstance] = (), further: Sequence[FurtherPlaces] = ()
) -> FreeLaw | None:
    """Law that leaves least, at the place where it does; None where none can be fitted.

    It is fitted beside known effects elsewhere, from their values. Further places take the place of those of the rig.
    """
    if further:
        starts = [start for one in further for start in _further(found, one, known)]
    else:
        theta, search = found.explanation.hypothesis.theta, found.search
        starts = _at(_Ground(found.problem, search.base.hypothesis, search.motion, _places(found)), theta, known)
    best: FreeLaw | None = None
    noise, marks = float(found.record.readings.size), dict[int, float]()
    # Costs are divided by what the best form leaves, if that is more than noise.
    scale = max(1.0, min((one.cost / max(one.rows - one.used, 1.0) for one in starts), default=1.0))
    for one in sorted(starts, key=lambda one: one.cost / scale + one.used * np.log(one.rows))[:MOST_FORMS]:
        law = _fitted(one, known, marks)
        if law is not None:
            best = law if best is None else likelier(best, law)
        if found.problem.work.ends() or (best is not None and best.hypothesis.cost < ALIKE * noise):
            break
    return best


@dataclass(frozen=True)
class _Ground:
    """The model without a law: a fit of it, and the motion that is smoothed with its parameters."""

    problem: EstimationProblem
    base: Hypothesis
    motion: Motion
    places: Collection[str]
    further: FurtherPlaces | None = None


def _further(found: Explained, further: FurtherPlaces, known: Sequence[EffectInstance]) -> Sequence[_Start]:
    """Forms of a law at further places, with the relaxation time that leaves least to first order."""

    def at(seconds: float) -> list[_Start]:
        problem = further.problem(found.problem, seconds)
        base = further.hypothesis(found.search.base.hypothesis, found.rig, seconds)
        try:
            motion = smooth(problem, base.theta, base.start)
        except IntegrationError:
            return []
        return _at(_Ground(problem, base, motion, further.nouns, further), base.theta, known)

    made = {seconds: at(seconds) for seconds in further.tried or (0.0,)}

    def best() -> float:
        return min(made, key=lambda seconds: min((one.score for one in made[seconds]), default=np.inf))

    for factor in NEARER if further.time else ():
        near = best()
        made |= {seconds: at(seconds) for seconds in (near / factor, near * factor)}
    return made[best()]


def explainable(found: Explained) -> float:
    """Part of the cost that a law without a name beside the names could take, to first order; 0 without a screen."""
    named = found.explanation.hypothesis
    ground = _Ground(found.problem, named, found.search.motion, _places(found))
    try:
        starts = _at(ground, named.theta, named.instances, taken=True)
    except IntegrationError:
        return 0.0
    return max((one.screen.total - one.cost for one in starts), default=0.0)


def _places(found: Explained) -> list[str]:
    return [one.name for one in found.rig.places if one.is_open and (one.declared or one.coordinate)]


def _at(ground: _Ground, theta: Array, known: Sequence[EffectInstance], *, taken: bool = False) -> list[_Start]:
    """Forms of a law at each place where one may sit, fitted to first order; arguments as of `Screen`."""
    rig, screen = ground.problem.rig, Screen(ground.problem, ground.base, ground.motion, known, taken=taken)
    room = MOST_COLUMNS - len(rig.start) - len(fitting.estimated(known)) - 2 * len(rig.twin.state_names)
    starts = list[_Start]()
    for at, place in enumerate(rig.places):
        if place.name in ground.places:
            force, deviation = projected(ground.motion, directions(rig, theta, rig.columns[1][at]))
            high = float(np.abs(force).max())
            if high > NEGLIGIBLE * deviation:
                starts += _starts(screen, ground, at, high, room)
    return starts


@dataclass(frozen=True)
class _Start:
    """A form at a place, to first order: with its factors (f,), and the penalty on these (f, f).

    Displacement and rate (m,) are those of the place; `used` is the effective number of factors.
    """

    ground: _Ground
    screen: Screen
    place: Place
    form: tuple[Term, ...]
    x: Array
    rate: Array
    factors: Array
    penalty: Array
    cost: float
    used: float

    @property
    def rows(self) -> int:
        return len(self.screen.left)

    @property
    def score(self) -> float:
        return self.cost + self.used * float(np.log(self.rows))


def _forms(place: Place, x: Array, rate: Array) -> list[tuple[Term, ...]]:
    high = float(np.abs(rate).max())
    turn = Term("free_friction", (), SHARP * high)
    along = Term("free_spring", (Curve(pieces(x)),))
    moving = Term("free_damping", (Curve(pieces(rate)),))
    held = Term("free_resistance", (Curve(pieces(x, FEW)),), unit=high)
    rubbed = Term("free_rub", (Curve(pieces(x, FEW, is_even=True)),), SHARP * high)
    sides = (Curve(pieces(x, SIDE, beside=0, is_even=True)), Curve(pieces(rate, SIDE, beside=0, is_even=True)))
    surface = Term("free_surface", sides)
    if place.element.displacement is None:
        return [(moving,), (moving, turn)]
    if not place.has_rate:
        return [(along,)]
    return [
        (along,), (moving,), (moving, turn), (along, moving), (held,), (rubbed,), (along, held), (along, moving, turn),
        (along, rubbed), (moving, rubbed), (moving, held), (surface,), (surface, turn),
    ]  # fmt: skip


def _starts(screen: Screen, ground: _Ground, at: int, high: float, room: int) -> list[_Start]:
    """Forms of a law at a place, fitted to first order.

    Source: Hastie and Tibshirani (1990), Generalized Additive Models, section 3.5, for the effective number of factors.
    """
    place, x, rate = screen.rig.places[at], ground.motion.displacement[:, at], ground.motion.rate[:, at]
    forms = [form for form in _forms(place, x, rate) if sum(term.size for term in form) <= room]
    if ground.further is not None:  # friction is of the rate of its own place
        forms = [form for form in forms if not any(term.sharp for term in form)]
    terms = {term.kind: term for form in forms for term in form}
    columns = {kind: screen.responses(_instances([term], place.name)) for kind, term in terms.items()}
    found = []
    for form in forms:
        rows_of = np.hstack([columns[term.kind] for term in form])
        penalty = linalg.block_diag(*(term.roughness() * (term.unit / (BEND * high)) ** 2 for term in form))
        with np.errstate(over="ignore", invalid="ignore"):
            gram, right = rows_of.T @ rows_of, rows_of.T @ screen.left
        if not (np.isfinite(gram).all() and np.isfinite(right).all()):  # a response that runs away
            continue
        size = np.sqrt(np.maximum(np.diag(gram + penalty), 1e-300))
        inverse = decompositions.inverse((gram + penalty) / np.outer(size, size), COLLINEAR, hermitian=True)
        factors = inverse @ (right / size) / size
        used = float(np.einsum("ij,ji->", inverse, gram / np.outer(size, size)))
        left = screen.total - 2.0 * float(factors @ right) + float(factors @ (gram + penalty) @ factors)
        found.append(_Start(ground, screen, place, form, x, rate, factors, penalty, left, used))
    return found


def _instances(form: Sequence[Term], at: str, factors: Array | None = None) -> tuple[EffectInstance, ...]:
    """Form at a place as effects, with factors (f,); 0 if none are given."""
    sizes = [term.size for term in form]
    parts = np.split(np.zeros(sum(sizes)) if factors is None else factors, np.cumsum(sizes)[:-1])
    return tuple(one for term, part in zip(form, parts, strict=True) for one in term.instances(at, part))


def _fitted(one: _Start, known: Sequence[EffectInstance], marks: dict[int, float]) -> FreeLaw | None:
    """Form with effects elsewhere, fitted to the record from where the smoothed motion is.

    Shooting intervals grow from a fraction of the record to those of the problem: with the first factors the simulated
    motion would lose the record. If it loses it with the last ones, too, as chaotic motions do, shorter ones are kept.
    Marks are the least cost of a form, by the samples of shooting intervals; one that costs far more is given up.
    """
    problem = one.ground.problem
    instances: tuple[EffectInstance, ...] = (*known, *_instances(one.form, one.place.name, one.factors))
    many = len(fitting.estimated(instances))
    whole = np.zeros((many, many))
    whole[-len(one.penalty) :, -len(one.penalty) :] = one.penalty
    theta, best = one.ground.base.theta, None
    if one.ground.further is not None:  # the parameters that go with it, which the fit without it has led away
        theta, _ = one.screen.around(instances)
    most, noise = problem.interval_samples, float(problem.record.readings.size)
    for samples in (*(n for part in PARTS if FEWEST < (n := len(problem.record) // part) < most), most):
        stage = replace(problem, interval=0 if samples == len(problem.record) else samples)
        start = np.ascontiguousarray(one.ground.motion.states[::samples][: stage.intervals])
        rounds, mark = ROUNDS if samples == most else FIRST_ROUNDS, LOST * marks.get(samples, np.inf)
        try:
            fitted = fitting.fit(stage, instances, theta=theta, start=start, rounds=rounds, rival=mark, penalty=whole)
        except IntegrationError:
            break
        if fitted.cost > mark:
            return None
        if best is not None and fitted.cost > LOST * max(best.hypothesis.cost, noise):
            break
        instances, theta = fitted.instances, fitted.theta
        marks[samples] = min(fitted.cost, marks.get(samples, np.inf))
        best = FreeLaw(one.place, one.form, fitted, one.x, one.rate, whole, stage, one.ground.further)
    return best
