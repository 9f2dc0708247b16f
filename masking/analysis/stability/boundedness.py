"""Boundedness: where energy cannot grow, whether motion stays in a compact set, as LaSalle's theorem wants.

Energy is V = v^T H(q) v/2 + U(q). Its sets {V <= c} are compact where H is positive definite and U grows without bound
in every direction that is no angle. U does so where it is a sum of bounded terms and of a convex one, of even powers of
linear forms and a quadratic form, which grows along every ray.
Source: LaSalle (1960), Some extensions of Liapunov's second method; Rockafellar, Convex Analysis (1970), theorem 8.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp
from sympy.simplify.fu import TR8

from masking.analysis.stability.algebra import is_zero, normal, squares
from masking.analysis.stability.branch_and_bound import is_positive
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.errors import ModelError


@dataclass(frozen=True)
class Boundedness:
    """Whether every set {V <= c} is compact, angles counted modulo one turn."""

    is_shown: bool  # whether that is proved
    text: str  # why, or what is missing
    is_lone: bool = False  # whether the potential grows along every ray from 0, so that 0 is the only equilibrium
    is_adrift: bool = False  # whether they are so, but modulo displacements that change neither equations nor energy


def boundedness(motion: Motion) -> Boundedness:
    """Whether the energy of a model bounds its motion."""
    try:
        kinetic, potential = parts_of_energy(motion)
        if not is_kinetic(kinetic, motion):
            return Boundedness(False, "the kinetic energy could not be shown to be positive definite")
        missing, level = _unbounded(potential, motion)
        steps = [_step(direction, motion) for direction in level]
    except ModelError as error:
        return Boundedness(False, str(error))
    if missing:
        return Boundedness(False, missing)
    angles = ", ".join(map(str, motion.circles))
    turn = f" (the angles {angles} modulo one turn)" if angles else ""
    why = "the kinetic energy is positive definite and the potential grows in every"
    if not level:
        is_lone = not motion.circles and _is_lone(potential, motion)
        return Boundedness(True, f"{why} direction: {{V <= c}} is compact{turn}", is_lone)
    if None in steps:
        return Boundedness(False, "there is a direction in which the potential does not grow")
    text = f"{why} other direction: {{V <= c}} is compact modulo displacements {', '.join(map(str, steps))}{turn}"
    return Boundedness(False, f"{text}, which change nothing; motion may go on for ever along them", is_adrift=True)


def _step(direction: Sequence[sp.Expr], motion: Motion) -> str | None:
    """Displacement along a direction that changes neither equations nor energy, in words; None for none.

    It may be of any length, or by the longest period of the sines and cosines.
    """
    pairs = list(zip([q for q in motion.q if q not in motion.circles], direction, strict=True))
    every = (*motion.mass, *motion.force, motion.energy or sp.Integer(0))
    waves = {f.args[0] for e in every for f in e.atoms(sp.sin, sp.cos)}
    rates = {abs(sum(sp.diff(wave, q) * d for q, d in pairs)) for wave in waves} - {0}
    any_length = sp.Dummy("s", real=True)
    lengths = [any_length, *(2 * sp.pi / rate for rate in sorted(rates, key=sp.default_sort_key))]
    for length in lengths:
        moved = {q: q + length * d for q, d in pairs}
        if all(is_zero(sp.expand(e.subs(moved, simultaneous=True)) - e) for e in every):
            far = "" if length == any_length else f" times {length}"
            along = ", ".join(str(dict(pairs).get(q, 0)) for q in motion.q)
            return f"along ({along}){far} of ({', '.join(map(str, motion.q))})"
    return None


def parts_of_energy(motion: Motion) -> tuple[sp.Matrix, sp.Expr]:
    """H and U of the energy v^T H v/2 + U; a ModelError where there is no energy, or one of another kind."""
    if motion.energy is None:
        raise ModelError("no energy is declared")
    potential = motion.energy.subs(dict.fromkeys(motion.v, 0))
    kinetic = sp.hessian(motion.energy, motion.v) if motion.v else sp.zeros(0, 0)
    rest = motion.energy - potential - (sp.Matrix([motion.v]) * kinetic * sp.Matrix(motion.v))[0] / 2
    if kinetic.free_symbols & {*motion.v} or normal(rest) != 0:
        raise ModelError("the energy is no sum of a quadratic form of the velocities and a potential")
    return kinetic, potential


def is_kinetic(matrix: sp.Matrix, motion: Motion) -> bool:
    """Whether a matrix of angles is positive definite for all of them: by its leading minors (Sylvester).

    Their signs are found as they stand, in normal form, or at the declared values by intervals over one turn.
    """
    at_values = False
    matrix = matrix.applyfunc(lambda x: sp.expand(TR8(sp.expand(x))))  # cos(a - b), not cos a cos b + sin a sin b
    for k in range(1, matrix.rows + 1):
        minor = matrix[:k, :k].det(method="berkowitz")
        if any(motion.given.declared_sign(form) == 1 for form in (sp.factor(minor), normal(minor))):
            continue
        if not is_positive(motion, minor):
            return False
        at_values = True
    if at_values:
        values = ", ".join(f"{n} = {x:g}" for n, x in motion.model.parameter_values().items())
        motion.given.suppose(f"and, as to the kinetic energy, {values}")
    return True


def is_positive_definite(matrix: sp.Matrix, given: Hypotheses) -> bool:
    """Whether a symmetric matrix is positive definite for all coordinates: by its leading minors (Sylvester)."""
    return all(given.declared_sign(normal(matrix[:k, :k].det())) == 1 for k in range(1, matrix.rows + 1))


def _unbounded(potential: sp.Expr, motion: Motion) -> tuple[str, list[list[sp.Expr]]]:
    """Reason why a potential may not grow in directions that are no angles, '' where it does; and level directions."""
    lines = [q for q in motion.q if q not in motion.circles]
    given, forms, remainder = motion.given, [], sp.Integer(0)
    for term in sp.Add.make_args(sp.expand_mul(potential)):
        if _is_bounded(term, motion.q):
            continue
        if not term.free_symbols & {*lines}:
            return f"the term {term} of the energy is not bounded", []
        form = _even_power(term, lines, given)
        if form is not None:
            _, power = _power(term.as_independent(*lines, as_Add=False)[1])
            forms.append((form, int(power)))
        elif not (term.has(sp.Max, sp.Min) and given.declared_sign(term, strictly=False) == 1):  # else it is >= 0
            remainder += term
    remainder = sp.expand(remainder)
    is_polynomial = remainder.is_polynomial(*lines) and not remainder.free_symbols & {*motion.circles}
    if not is_polynomial or (remainder != 0 and sp.Poly(remainder, *lines).total_degree() > 2):
        return f"the part {remainder} of the potential is not seen to grow", []
    steep = [form for form, power in forms if power > 2]
    if _rank_is_full(steep, lines, given):  # of fourth order or more in every direction: they outgrow all squares
        return "", []
    quadratic = sp.hessian(remainder, lines) if lines else sp.zeros(0, 0)
    found = squares(quadratic, lines, given) if lines else ()
    if found is None:
        return f"the quadratic part of the potential, {remainder}, is not seen to be positive", []
    every = [form for form, _ in forms] + [square.form for square in found]
    level = [] if _rank_is_full(every, lines, given) else _directions(every, lines).nullspace(simplify=normal)
    return "", [list(x) for x in level]


def _is_lone(potential: sp.Expr, motion: Motion) -> bool:
    """Whether a potential that grows in every direction is a sum of homogeneous terms that are nowhere negative.

    Then q . dU/dq is the sum of these terms times their degrees, which vanishes at 0 alone. Terms of stops are convex
    and 0 at 0, so that they add nothing negative.
    """
    remainder = sp.Integer(0)
    for term in sp.Add.make_args(sp.expand_mul(potential - potential.subs(dict.fromkeys(motion.q, 0)))):
        form = _even_power(term, motion.q, motion.given)
        if _is_stop(term, motion):
            continue
        if form is None:
            remainder += term
        elif form.subs(dict.fromkeys(motion.q, 0)) != 0:
            return False
    remainder = sp.expand(remainder)
    if remainder == 0:
        return True
    if not remainder.is_polynomial(*motion.q) or {sum(n) for n in sp.Poly(remainder, *motion.q).monoms()} != {2}:
        return False
    return squares(sp.hessian(remainder, motion.q), motion.q, motion.given) is not None


def _is_stop(term: sp.Expr, motion: Motion) -> bool:
    """Whether a term is a positive number times a power of max(0, u) with u linear, which is 0 at q = 0."""
    coefficient, dependent = term.as_independent(*motion.q, as_Add=False)
    base, power = dependent.as_base_exp()
    if base.func != sp.Max or len(base.args) != 2 or 0 not in base.args or not (power.is_Integer and power > 0):
        return False
    (form,) = (x for x in base.args if x != 0)
    is_linear = form.is_polynomial(*motion.q) and sp.Poly(form, *motion.q).total_degree() == 1
    at_rest = form.subs(dict.fromkeys(motion.q, 0))
    return bool(
        is_linear
        and motion.given.declared_sign(coefficient) == 1
        and (at_rest == 0 or motion.given.declared_sign(at_rest) == -1)
    )


def _rank_is_full(forms: Sequence[sp.Expr], lines: Sequence[sp.Symbol], given: Hypotheses) -> bool:
    """Whether linear forms vanish together at one point alone."""
    if len(forms) < len(lines):
        return False
    directions = _directions(forms, lines)
    return not lines or given.declared_sign(normal((directions.T * directions).det())) == 1


def _directions(forms: Sequence[sp.Expr], lines: Sequence[sp.Symbol]) -> sp.Matrix:
    """Coefficients of linear forms (m, n)."""
    return sp.Matrix(len(forms), len(lines), [sp.diff(form, q) for form in forms for q in lines])


def _is_bounded(term: sp.Expr, coordinates: Sequence[sp.Symbol]) -> bool:
    """Whether a term is a product of parameters, sines and cosines."""
    powers = [factor.as_base_exp() for factor in sp.Mul.make_args(term)]
    moving = [(base, power) for base, power in powers if base.free_symbols & {*coordinates}]
    return all(f.func in {sp.sin, sp.cos, sp.tanh, sp.atan} and n.is_integer and n > 0 for f, n in moving)


def _power(dependent: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """X and n for x^n with even n, and for |x|^n, |x| x^2 and the like; n = 0 for what is of another kind."""
    parts = [factor.as_base_exp() for factor in sp.Mul.make_args(dependent)]
    bases = {base.args[0] if base.func == sp.Abs else base for base, _ in parts}
    plain = sum((n for base, n in parts if base.func != sp.Abs), sp.Integer(0))
    if len(bases) != 1 or not plain.is_even:
        return dependent, sp.Integer(0)
    return bases.pop(), sum((n for _, n in parts), sp.Integer(0))


def _even_power(term: sp.Expr, lines: Sequence[sp.Symbol], given: Hypotheses) -> sp.Expr | None:
    """Linear form of a term that is a positive number times an even power of it; None where it is not."""
    coefficient, dependent = term.as_independent(*lines, as_Add=False)
    base, power = _power(dependent)
    if not (power.is_Integer and power > 0) or coefficient.free_symbols & {*lines}:
        return None
    if not base.is_polynomial(*lines) or sp.Poly(base, *lines).total_degree() != 1:
        return None
    if base.free_symbols - {*lines} - {*given.symbols.values()}:
        return None
    return base if given.declared_sign(coefficient) == 1 else None
