"""Energy certificate: what a declared energy proves of all motions of a model, word for word and no more.

V' <= 0 and compact sets {V <= c} let every motion converge to the largest invariant set on which V' = 0 (LaSalle). That
set, and the equilibria in it, make the conclusion. Theorems 5.1, 7.1, 8.1 and 9.1 and conjecture 8.1 of Rijlaarsdam
(2008) are of this kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import sympy as sp

from masking.analysis.stability.algebra import normal, radical, solved_for
from masking.analysis.stability.boundedness import Boundedness, boundedness, is_positive_definite
from masking.analysis.stability.crosscheck import contradiction, misjudged
from masking.analysis.stability.dissipation import Dissipation, Status, dissipation
from masking.analysis.stability.equilibria import UNDECIDED, Box, equilibria, stability_of
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.lasalle import Family, InvariantSet, invariant_set
from masking.analysis.stability.sublevel import Basin, basins
from masking.display.json_text import plain
from masking.display.printed_result import Printed
from masking.errors import ModelError
from masking.model.modelling.model import Model
from masking.model.modelling.scales import Shown

_MOST_POINTS = 64
_MOST_SETS = 6  # of motions that a sentence lists
_THIN = (
    "unstable, with an eigenvalue of positive real part (proved), so that motions that converge to them start from a "
    "set of measure zero"
)
_CLOSE = 1e-10  # of the largest coordinate: nearer to a relation than this, an equilibrium belongs to a family


class NotIsolatedError(ModelError):
    """Equilibria are whole curves or surfaces, so that no list holds them."""


@dataclass(frozen=True, repr=False)
class RestPoint(Printed):
    """An equilibrium outside of the families: where it is, as texts and numbers, and what is known of its stability."""

    position: dict[str, str]
    values: dict[str, float]
    stability: str
    is_unstable: bool

    @property
    def place(self) -> str:
        """Where it is, for people."""
        return "(" + ", ".join(f"{n} = {x}" for n, x in self.position.items()) + ")"

    def __str__(self) -> str:
        return f"{self.place}: {self.stability}"


@dataclass(frozen=True, repr=False)
class Certificate(Printed):
    """What an energy proves."""

    name: str  # of the model
    status: Status  # of the conclusion
    conclusion: str  # what every motion does, as far as it is shown
    energy: sp.Expr | None = None  # V, in symbols of the hypotheses; None where none is declared
    # that inputs are 0, and what is assumed of the parameters, which holds for the declared values; the proof holds
    # wherever they do
    hypotheses: tuple[str, ...] = ()
    dissipation: Dissipation | None = None  # of V'; None without an energy, or for equations of another kind
    boundedness: Boundedness | None = None  # whether every set {V <= c} is compact
    invariant: InvariantSet | None = None  # the largest invariant set in V' = 0; None where it was not looked for
    others: tuple[RestPoint, ...] | None = None  # equilibria outside of its families; None where they are not found
    reasons: tuple[str, ...] = ()  # what is missing for more, or must be known to read the conclusion
    basins: tuple[Basin, ...] = ()  # inner estimates, where not every motion converges to one equilibrium
    shown: Mapping[str, Shown] = field(default_factory=dict)  # how coordinates and velocities are shown, by name

    def __str__(self) -> str:
        lines = [f"{self.status}: {self.conclusion}"]
        if self.hypotheses:
            lines.append(f"  for {', '.join(self.hypotheses)}")
        if (lost := self.dissipation) is not None:
            where = "" if lost.box is None else f" on {_box(lost.box, self.shown)}"
            sign = "V' <= 0, " if lost.status == "proved" and lost.rate != 0 else ""
            lines.append(f"  V' = {lost.rate}: {sign}{lost.method}{where} ({lost.status})")
        if self.boundedness is not None:
            lines.append(f"  {self.boundedness.text}")
        lines += [f"  {step}" for step in (self.invariant.steps if self.invariant else ())]
        lines += [f"  equilibrium {point}" for point in (self.others or ())[:_MOST_POINTS]]
        lines += [f"  {reason}" for reason in self.reasons]
        lines += [f"  basin of attraction: {basin}" for basin in self.basins]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Certificate as JSON can hold it."""
        d, i = self.dissipation, self.invariant
        return dict(plain({
            "model": self.name,
            "status": self.status,
            "conclusion": self.conclusion,
            "hypotheses": self.hypotheses,
            "energy": None if self.energy is None else str(self.energy),
            "dissipation": d and {
                **vars(d),
                "rate": str(d.rate),
                "forms": [str(form) for form in d.forms],
                "squares": [{"coefficient": str(s.coefficient), "form": str(s.form)} for s in d.squares],
            },
            "boundedness": self.boundedness,
            "invariant_set": i and {
                "is_found": i.is_found,
                "families": [[str(r) for r in family.relations] for family in i.families],
                "equilibria": i.equilibria,
                "steps": i.steps,
            },
            "other_equilibria": self.others,
            "reasons": self.reasons,
            "basins": self.basins,
        }))  # fmt: skip


def certificate(model: Model, box: Box | None = None) -> Certificate:
    """Derive what the declared energy of a model without internal states proves of its motion without inputs.

    The box is for what is not proved everywhere; see `dissipation`.
    """
    return replace(_derived(model, box), shown=model.shown)


def _derived(model: Model, box: Box | None) -> Certificate:
    given = Hypotheses(model)
    try:
        motion = Motion(model, given)
        lost = dissipation(motion, box)
    except ModelError as error:
        return Certificate(model.name, "open", f"not shown: {error}")
    if lost.status == "refuted":
        where = ", ".join(f"{n} = {model.shown[n].text(x)}" for n, x in (lost.counterexample or {}).items())
        growth = f"V' >= {lost.growth:.3g} > 0 at {where}"
        text = f"the energy can grow: {growth}, at the declared values; it certifies nothing"
        hypotheses = (*given.inputs, *(f"{name} = {value:g}" for name, value in given.values.items()))
        return Certificate(model.name, "refuted", text, motion.energy, hypotheses, lost, basins=basins(model, None))
    if lost.status != "proved":
        text = "whether the energy can grow is not shown"
        return Certificate(model.name, lost.status, text, motion.energy, given.texts, lost, basins=basins(model, None))
    proof = _withdrawn(_concluded(motion, lost, boundedness(motion)), motion)
    if lost.box is not None:
        return replace(proof, basins=basins(model, None))
    only_rest = proof.invariant is not None and proof.invariant.equilibria and not proof.invariant.families
    if not (proof.status == "proved" and only_rest and (proof.others is None or len(proof.others) > 1)):
        return proof
    return replace(proof, basins=basins(model, proof.boundedness))


def _concluded(motion: Motion, lost: Dissipation, bounded: Boundedness) -> Certificate:
    """Certificate where the energy does not grow."""
    found, others, reasons, status = None, None, tuple[str, ...](), lost.status
    if lost.box is not None:
        text = f"the energy does not grow while the motion stays in the box {_box(lost.box, motion.model.shown)}"
        reasons = ("That motion stays there is not shown, so that nothing follows for its end.",)
    elif not lost.forms:  # V' is no sum of squares of velocities, so that there is no elimination
        stays = "every motion is bounded" if bounded.is_shown else "whether motion is bounded is not shown"
        text = f"the energy never grows; {stays}"
    else:
        found = invariant_set(motion, lost.forms)
        others, reasons = _others(motion, found, is_lone=bounded.is_lone)
        text, further = _conclusion(bounded, found, others)
        reasons = (*reasons, *further)
        status = "proved" if found.is_found else "open"  # LaSalle's theorem by itself is no result
    name, given = motion.model.name, motion.given.texts
    return Certificate(name, status, text, motion.energy, given, lost, bounded, found, others, reasons)


def _withdrawn(proof: Certificate, motion: Motion) -> Certificate:
    """Certificate, open where it rests on a coincidence or is contradicted by modes or a simulation."""
    if proof.status != "proved" or proof.dissipation is None:
        against = ""
    elif proof.dissipation.box is not None:
        against = contradiction(motion, box=proof.dissipation.box)
    else:
        is_bounded = proof.boundedness is not None and proof.boundedness.is_shown
        against = misjudged(motion.model, ((point.values, point.stability) for point in proof.others or ()))
        against = against or contradiction(motion, proof.dissipation.forms, proof.invariant, is_bounded=is_bounded)
    texts = [f"{x} is not 0 at the declared values, but 0 within 1e-9 of them" for x in motion.given.coincidences]
    texts += [against] if against else []
    if not texts:
        return proof
    return replace(
        proof,
        status="open",
        conclusion=f"not shown: {'; '.join(dict.fromkeys(texts))}",
        dissipation=proof.dissipation and replace(proof.dissipation, status="open"),
        invariant=None,
        others=None,
        reasons=(f"The energy alone would say: {proof.conclusion}.",),
    )


def _box(box: Box, shown: Mapping[str, Shown]) -> str:
    def side(name: str, low: float, high: float) -> str:
        one = shown[name]
        return (
            f"|{name}| <= {one.text(high, 4)}"
            if low == -high
            else f"{one.text(low, 4)} <= {name} <= {one.text(high, 4)}"
        )

    return ", ".join(side(name, *ends) for name, ends in box.items())


def _conclusion(  # noqa: PLR0911  # one way each
    bounded: Boundedness, found: InvariantSet, others: tuple[RestPoint, ...] | None
) -> tuple[str, tuple[str, ...]]:
    """Sentence on the end of every motion, and the open points."""
    is_every = bounded.is_shown or (bounded.is_adrift and not found.is_of_bounded)
    who = "every motion" if is_every else "every motion that is bounded"
    if not found.is_found:
        return (
            f"{who} converges to the largest invariant set on which V' = 0",
            ("What that set is, is open: it could not be eliminated.",),
        )
    sets = _union(found.families)
    if not sets and others == ():
        why = "A motion that is bounded would converge to the largest invariant set on which V' = 0, which is empty."
        return "no motion is bounded: there is no equilibrium to converge to", (why,)
    if not found.equilibria or others == ():
        return f"{who} converges to {sets}", ()
    if others is None:
        rest = f"the equilibria and {sets}, taken together" if sets else "the set of equilibria"
        return f"{who} converges to {rest}", ("There is no complete list of the equilibria.",)
    if not sets and len(others) == 1:
        return f"{who} converges to the equilibrium {others[0]}", ()
    if not sets:
        stay = [point for point in others if not point.is_unstable]
        almost = f"almost {who} converges to {stay[0].place}" if len(stay) == 1 else ""
        thin = (f"The others are {_THIN}: {almost}.",) if almost else ()
        return f"{who} converges to one of {len(others)} equilibria", thin
    text = f"{who} converges to {sets}, or to one of {len(others)} equilibria outside of it"
    if all(point.is_unstable for point in others):
        return text, (f"These are {_THIN}: almost every motion converges to the set.",)
    return text, ("Some of these are not proved to be unstable: motion may end there instead of in the set.",)


def _union(families: tuple[Family, ...]) -> str:
    """Sets that a motion converges to, taken together: where they meet, it may come near to several."""
    if len(families) > _MOST_SETS:
        return f"the union of {len(families)} sets that differ in what moves together, such as {families[0]}"
    if len(families) > 1:
        return f"the union of the sets {'; '.join(map(str, families))}"
    return "".join(f"the set {family}" for family in families)


def _others(
    motion: Motion, found: InvariantSet, *, is_lone: bool
) -> tuple[tuple[RestPoint, ...] | None, tuple[str, ...]]:
    """Equilibria outside of the families, and how they were found; None where that is open."""
    if not found.is_found or not found.equilibria:
        return (None if not found.is_found else ()), ()
    try:
        exact = (dict.fromkeys(motion.q, sp.Integer(0)),) if is_lone else rest_points(motion, found.known)
    except NotIsolatedError as error:
        return None, (f"{error}.",)
    if exact is not None:
        outside = [p for p in exact if not any(_is_in(family, p, motion) for family in found.families)]
        return tuple(_exact_point(motion, p) for p in outside), ()
    try:
        numeric = equilibria(motion.model)
    except ModelError as error:
        return None, (f"The equilibria could not be enclosed: {error}.",)
    if not (numeric.is_complete and numeric.is_global):
        return None, (f"Of the equilibria is known: {numeric}.",)
    values = ", ".join(f"{n} = {x:g}" for n, x in motion.model.parameter_values().items())
    points = []
    for point in numeric.points:
        if not any(_is_near(family, point.position) for family in found.families):
            texts = {n: point.shown[n].text(x) for n, x in point.position.items()}
            proved = " (proved)" if point.is_unstable else " (by its eigenvalues)"
            if point.verdict == UNDECIDED:
                proved = ""
            points.append(RestPoint(texts, point.position, point.verdict + proved, point.is_unstable))
    motion.given.suppose(f"and, as to which equilibria there are, {values}")
    return tuple(points), (f"Equilibria there, by intervals: {numeric}.",)


def rest_points(motion: Motion, known: dict[sp.Symbol, sp.Expr]) -> tuple[dict[sp.Symbol, sp.Expr], ...] | None:
    """Every equilibrium exactly, angles in (-pi, pi]; None where they are not found by factors one by one.

    At all of them, coordinates have the values that are `known`.

    Raises:
        NotIsolatedError: at the declared values, equilibria are whole curves.
    """
    try:
        return _branch([e.subs(known) for e in motion.at_rest], dict(known), motion)
    except NotIsolatedError:
        raise
    except ModelError:
        return None


def _branch(
    equations: list[sp.Expr], values: dict[sp.Symbol, sp.Expr], motion: Motion
) -> tuple[dict[sp.Symbol, sp.Expr], ...]:
    pending = [r for e in equations if (r := radical(normal(e), motion.given)) != 0]
    unknown = [q for q in motion.q if q not in values]
    fixed = [e for e in pending if not e.free_symbols & {*unknown}]
    if any(motion.given.is_nonzero(e) for e in fixed):
        return ()
    for equation in fixed:  # of parameters alone, and true at their declared values
        motion.given.suppose(f"{equation} = 0")
    pending = [e for e in pending if e not in fixed and not _is_void(e, unknown, motion)]
    if not pending:
        if unknown:
            some = ", ".join(f"{q} = {x}" for q, x in values.items())
            every = ", ".join(map(str, unknown))
            where = f" with {some}" if some else ""
            raise NotIsolatedError(f"The equilibria are not isolated: every {every}{where} is one")
        return (values,)
    pending.sort(key=sp.count_ops)
    for equation in pending:
        factors = sp.Mul.make_args(sp.factor(equation))
        parts = [f for f in factors if f.free_symbols & {*unknown}]
        options = [_solved(f, unknown, motion) for f in parts]
        if all(option is not None for option in options):
            if not all(motion.given.is_nonzero(f) for f in factors if f not in parts):
                raise ModelError(f"{equation} = 0 may hold whatever the coordinates are")
            found: dict[tuple[tuple[str, str], ...], dict[sp.Symbol, sp.Expr]] = {}
            for option in options:
                for q, value in option or ():
                    for point in _branch([e.subs(q, value) for e in pending], values | {q: value}, motion):
                        found[tuple(sorted((str(a), str(b)) for a, b in point.items()))] = point
            return tuple(found.values())
    raise ModelError("no factor can be solved")


def _is_void(equation: sp.Expr, unknown: list[sp.Symbol], motion: Motion) -> bool:
    """Whether a factor of parameters is 0 at declared values, so that the equation says nothing."""
    for factor in sp.Mul.make_args(sp.factor(equation)):
        if not factor.free_symbols & {*unknown} and motion.given.is_void(factor):
            motion.given.suppose(f"{factor} = 0")
            return True
    return False


def _solved(factor: sp.Expr, unknown: list[sp.Symbol], motion: Motion) -> list[tuple[sp.Symbol, sp.Expr]] | None:
    """Values that a coordinate has where a factor vanishes; None where it is not seen."""
    mine = [q for q in unknown if factor.has(q)]
    if len(mine) != 1:
        return None
    (q,) = mine
    if q in motion.circles and factor == sp.sin(q):
        return [(q, sp.Integer(0)), (q, sp.pi)]
    if q in motion.circles and factor == sp.cos(q):
        return [(q, sp.pi / 2), (q, -sp.pi / 2)]
    found = solved_for(factor, mine, motion.given)
    return None if found is None else [found]


def _is_in(family: Family, point: dict[sp.Symbol, sp.Expr], motion: Motion) -> bool:
    still = dict.fromkeys(motion.v, 0)
    for relation in family.relations:
        value = normal(relation.subs(still).subs(point))
        is_angle = bool(relation.free_symbols & {*motion.circles})
        if value != 0 and not (is_angle and (value / (2 * sp.pi)).is_integer):
            return False
    return True


def _is_near(family: Family, position: dict[str, float]) -> bool:
    """Whether an enclosed equilibrium, which no angle modulo one turn brings nearer, is in a family."""
    slack = _CLOSE * max([1.0, *map(abs, position.values())])
    values = (r.subs({s: position.get(s.name, 0) for s in r.free_symbols}) for r in family.relations)
    return not any(abs(float(value)) > slack for value in values)


def _exact_point(motion: Motion, point: dict[sp.Symbol, sp.Expr]) -> RestPoint:
    """Whether an equilibrium is unstable: an eigenvalue has a positive real part.

    That is so where the determinant of the stiffness is negative, that of the mass positive; and where the potential
    falls along a coordinate and every velocity costs energy to second order (theorem of Kelvin, Tait and Chetaev).
    """
    values = {q.name: float(sp.N(motion.given.at_values(point[q]))) for q in motion.q}
    given, at = motion.given, point | dict.fromkeys(motion.v, sp.Integer(0))
    stiffness = -sp.Matrix(motion.at_rest).jacobian(motion.q)
    signs = [given.declared_sign(normal(m.subs(point).det())) for m in (stiffness, motion.mass)]
    curvature, n = sp.hessian(motion.energy or sp.Integer(0), (*motion.q, *motion.v)), len(motion.q)
    curvature = curvature.subs(at).applyfunc(normal)
    falls = any(given.declared_sign(curvature[i, i]) == -1 for i in range(n)) and curvature[:n, n:].is_zero_matrix
    is_unstable = signs in ([-1, 1], [1, -1])
    if falls and not is_unstable:  # it is if V' is negative definite in the velocities, to second order
        lost = -sp.hessian(motion.energy_rate, motion.v).subs(at).applyfunc(normal)
        is_unstable = is_positive_definite(lost, given)
    if is_unstable:
        words = "unstable, it has an eigenvalue with positive real part (proved)"
    elif is_positive_definite(curvature, given):
        words = "stable, the energy has a minimum there (proved)"
    else:
        verdict = stability_of(motion.model, values)[1]
        words = "its stability is not shown" if verdict == UNDECIDED else f"{verdict} (by its eigenvalues)"
    # Exactly, where the unit is that of what is computed.
    shown = {q: motion.model.shown[q.name] for q in motion.q}
    texts = {q.name: str(point[q]) if shown[q].size == 1.0 else shown[q].text(values[q.name]) for q in motion.q}
    return RestPoint(texts, values, words, is_unstable)
