"""Free law: the law at a place without a name, fitted as a curve or a surface over displacement and rate.

Its form is the one that explains most to first order along the measured motion, as candidates are screened. It is then
fitted to the record by least squares, together with the parameters of the model.
Source: as `bases`; Masri and Caughey (1979), J. Appl. Mech. 46, 433-447, for forces over displacement and rate.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import fitting, further_places
from masking.inference.discovery.augmented_model import MOST_COLUMNS, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.further_places import LawPlaces
from masking.inference.discovery.latent_force import Explained, directions, projected
from masking.inference.discovery.places import Place
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
    """A law without a name as a sum of curves, fitted."""

    place: Place  # where it sits
    terms: tuple[Term, ...]  # what it is made of
    hypothesis: Hypothesis  # the model with it, and with effects elsewhere before it
    penalty: Array  # on its factors (f, f)
    problem: EstimationProblem  # the record in the shooting intervals of the fit
    motion: Motion  # the record, smoothed
    places: LawPlaces  # those that it sits in one of

    def score(self, like: Hypothesis) -> float:
        """-2 log likelihood by the colour of another hypothesis, with Schwarz's penalty for each number."""
        numbers = self.size + bool(self.places.time)
        return self.hypothesis.misfit(like) + numbers * float(np.log(self.hypothesis.residuals.size))

    @property
    def x(self) -> Array:
        """Displacement of its place along the record (m,)."""
        return self.motion.displacement[:, self.problem.rig.places.index(self.place)]

    @property
    def rate(self) -> Array:
        """Rate of its place along the record (m,)."""
        return self.motion.rate[:, self.problem.rig.places.index(self.place)]

    @property
    def size(self) -> int:
        """Number of factors."""
        return len(self.penalty)

    @property
    def instances(self) -> tuple[EffectInstance, ...]:
        """Instances that the law is made of."""
        return tuple(one for one in self.hypothesis.instances if one.effect in KINDS)

    @property
    def others(self) -> tuple[EffectInstance, ...]:
        """Effects elsewhere."""
        return tuple(one for one in self.hypothesis.instances if one.effect not in KINDS)

    @property
    def words(self) -> str:
        """Phrase for the law: a force that is the sum of its terms."""
        return f"a force that is {' plus '.join(KINDS[term.kind].format(**self.nouns) for term in self.terms)}"

    @property
    def nouns(self) -> Mapping[str, str]:
        """Nouns of its displacement `d` and its rate `v`."""
        return self.places.nouns[self.place.name]

    @property
    def on(self) -> str:
        """Name of the place of the rig whose force it is."""
        return self.places.on[self.place.name]

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

    def with_factors(self, factors: Array) -> FreeLaw:
        """Law with factors (f,) beside the effects elsewhere."""
        parts = np.split(factors, np.cumsum([term.size for term in self.terms])[:-1])
        made = (
            one for term, part in zip(self.terms, parts, strict=True) for one in term.instances(self.place.name, part)
        )
        return replace(self, hypothesis=replace(self.hypothesis, instances=(*self.others, *made)))

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


def likelier(one: FreeLaw, other: FreeLaw | None) -> FreeLaw:
    """Likelier one of two laws; one where there is no other."""
    if other is None:
        return one
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


class _Start(NamedTuple):
    """A law to first order."""

    law: FreeLaw  # with the factors that are best to first order
    cost: float  # with the penalty
    used: float  # effective number of factors
    screen: Screen

    @property
    def rows(self) -> int:
        return len(self.screen.left)

    def score(self, scale: float = 1.0) -> float:
        """-2 log likelihood with the cost divided by a scale, and with Schwarz's penalty."""
        return self.cost / scale + self.used * float(np.log(self.rows))


def fit(found: Explained, known: Sequence[EffectInstance] = (), places: Sequence[LawPlaces] = ()) -> FreeLaw | None:
    """Law that leaves least, at the place where it does; None where none can be fitted.

    It is fitted beside known effects elsewhere, from their values. By default, it sits in a place of the rig itself.
    """
    starts = [start for one in places or [further_places.own(found.rig)] for start in _nearest(found, one, known)]
    best: FreeLaw | None = None
    noise, marks = float(found.record.readings.size), dict[int, float]()
    # Costs are divided by what the best form leaves, if that is more than noise.
    scale = max(1.0, min((one.cost / max(one.rows - one.used, 1.0) for one in starts), default=1.0))
    for one in sorted(starts, key=lambda one: one.score(scale))[:MOST_FORMS]:
        law = _fitted(one, marks)
        best = law if best is None else likelier(best, law)
        if found.problem.work.ends() or (best is not None and best.hypothesis.cost < ALIKE * noise):
            break
    return best


def _nearest(found: Explained, places: LawPlaces, known: Sequence[EffectInstance]) -> list[_Start]:
    """Forms of a law at places, to first order, with the relaxation time that leaves least."""
    base = replace(found.search.base.hypothesis, instances=tuple(known))

    def at(seconds: float) -> list[_Start]:
        problem, begun = places.begun(found.problem, base, seconds)
        try:
            return _starts(problem, begun, smooth(problem, begun.theta, begun.start), places)
        except IntegrationError:
            return []

    made = {seconds: at(seconds) for seconds in places.tried or (0.0,)}

    def best() -> float:
        return min(made, key=lambda seconds: min((one.score() for one in made[seconds]), default=np.inf))

    for factor in NEARER if places.tried else ():
        near = best()
        made |= {seconds: at(seconds) for seconds in (near / factor, near * factor)}
    return made[best()]


def explainable(found: Explained) -> float:
    """Part of the cost that a law without a name beside the names could take, to first order; 0 without a screen."""
    own, named = further_places.own(found.rig), found.explanation.hypothesis
    try:
        starts = _starts(found.problem, named, found.search.motion, own, taken=True)
    except IntegrationError:
        return 0.0
    return max((0.0, *(one.screen.total - one.cost for one in starts)))


def _starts(
    problem: EstimationProblem, base: Hypothesis, motion: Motion, places: LawPlaces, *, taken: bool = False
) -> list[_Start]:
    """Forms of a law at each place where one may sit, to first order beside the effects of a fit.

    Where these are taken, they are in its residual already.
    """
    rig, known = problem.rig, base.instances
    screen = Screen(problem, base, motion, known, taken=taken)
    room = MOST_COLUMNS - len(rig.start) - len(fitting.estimated(known)) - 2 * len(rig.twin.state_names)
    starts = list[_Start]()
    for at, place in enumerate(rig.places):
        if place.name in places.on:
            force, deviation = projected(motion, directions(rig, base.theta, rig.columns[1][at]))
            high = float(np.abs(force).max())
            if high > NEGLIGIBLE * deviation:
                forms = _forms(place, motion.displacement[:, at], motion.rate[:, at], has_friction=places.are_own)
                laws = [FreeLaw(place, form, base, _penalty(form, high), problem, motion, places) for form in forms]
                starts += _first_order(screen, [law for law in laws if law.size <= room])
    return starts


def _forms(place: Place, x: Array, rate: Array, *, has_friction: bool) -> list[tuple[Term, ...]]:
    """Forms over displacements and rates (m,) of a place; a dry friction is of its own rate alone."""
    high = float(np.abs(rate).max())
    turn = Term("free_friction", (), SHARP * high)
    along = Term("free_spring", (Curve(pieces(x)),))
    moving = Term("free_damping", (Curve(pieces(rate)),))
    held = Term("free_resistance", (Curve(pieces(x, FEW)),), unit=high)
    rubbed = Term("free_rub", (Curve(pieces(x, FEW, is_even=True)),), SHARP * high)
    sides = (Curve(pieces(x, SIDE, beside=0, is_even=True)), Curve(pieces(rate, SIDE, beside=0, is_even=True)))
    surface = Term("free_surface", sides)
    if place.element.displacement is None:
        forms = [(moving,), (moving, turn)]
    elif not place.has_rate:
        forms = [(along,)]
    else:
        forms = [
            (along,), (moving,), (moving, turn), (along, moving), (held,), (rubbed,), (along, held),
            (along, moving, turn), (along, rubbed), (moving, rubbed), (moving, held), (surface,), (surface, turn),
        ]  # fmt: skip
    return [form for form in forms if has_friction or not any(term.sharp for term in form)]


def _penalty(form: Sequence[Term], high: float) -> Array:
    """Penalty on the factors of a form (f, f), at a place whose largest force is known."""
    return np.asarray(linalg.block_diag(*(term.roughness() * (term.unit / (BEND * high)) ** 2 for term in form)))


def _first_order(screen: Screen, laws: Sequence[FreeLaw]) -> list[_Start]:
    """Laws at one place with the factors that are best to first order.

    Source: Hastie and Tibshirani (1990), Generalized Additive Models, section 3.5, for the effective number of factors.
    """
    terms = {term.kind: (term, law.place.name) for law in laws for term in law.terms}
    columns = {kind: screen.responses(term.instances(at, np.zeros(term.size))) for kind, (term, at) in terms.items()}
    found = []
    for law in laws:
        rows = np.hstack([columns[term.kind] for term in law.terms])
        with np.errstate(over="ignore", invalid="ignore"):
            gram, right = rows.T @ rows, rows.T @ screen.left
        if not (np.isfinite(gram).all() and np.isfinite(right).all()):  # a response that runs away
            continue
        whole = gram + law.penalty
        size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        inverse = decompositions.inverse(whole / np.outer(size, size), COLLINEAR, hermitian=True)
        factors = inverse @ (right / size) / size
        used = float(np.einsum("ij,ji->", inverse, gram / np.outer(size, size)))
        cost = screen.total - 2.0 * float(factors @ right) + float(factors @ whole @ factors)
        found.append(_Start(law.with_factors(factors), cost, used, screen))
    return found


def growing(problem: EstimationProblem) -> Iterator[EstimationProblem]:
    """Problem in shooting intervals that grow to its own."""
    for part in PARTS:
        samples = len(problem.record) // part
        if FEWEST < samples < problem.interval_samples:
            yield replace(problem, interval=samples)
    yield problem


def _fitted(start: _Start, marks: dict[int, float]) -> FreeLaw | None:
    """Law fitted to the record, with effects elsewhere, from where the smoothed motion is.

    Shooting intervals grow to those of the problem: with the first factors the simulated motion would lose the record.
    If it loses it with the last ones, too, as chaotic motions do, shorter ones are kept. Marks are the least cost of a
    law, by the samples of shooting intervals; one that costs far more is given up.
    """
    law, problem, best = start.law, start.law.problem, None
    instances, noise = law.hypothesis.instances, float(problem.record.readings.size)
    theta, _ = start.screen.around(instances)
    many = len(fitting.estimated(law.others))
    penalty = linalg.block_diag(np.zeros((many, many)), law.penalty)
    for stage in growing(problem):
        samples = stage.interval_samples
        begin = np.ascontiguousarray(law.motion.states[::samples][: stage.intervals])
        rounds, mark = ROUNDS if stage is problem else FIRST_ROUNDS, LOST * marks.get(samples, np.inf)
        try:
            made = fitting.fit(stage, instances, theta=theta, start=begin, rounds=rounds, rival=mark, penalty=penalty)
        except IntegrationError:
            break
        if made.cost > mark:
            return None
        if best is not None and made.cost > LOST * max(best.hypothesis.cost, noise):
            break
        instances, theta, best = made.instances, made.theta, replace(law, hypothesis=made, problem=stage)
        marks[samples] = min(made.cost, marks.get(samples, np.inf))
    return best
