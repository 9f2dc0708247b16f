"""Exact algebra of expressions with sines and cosines: normal forms, coefficients, what a few constants must be.

Sines and cosines of different angles are algebraic variables S and C with S^2 + C^2 = 1, so that an expression is zero
where its normal form is, and a function of one variable that is zero everywhere has no coefficient that is not.
Quadratic forms are sums of squares, by completing squares.
Source: Cox, Little and O'Shea, Ideals, Varieties, and Algorithms (2015), chapters 2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from masking.analysis.stability.hypotheses import Hypotheses
from masking.errors import ModelError

_HYPERBOLIC = (sp.sinh, sp.cosh, sp.tanh)
_MOST_ROUNDS = 40
_MOST_ANGLES = 24  # sin(n x) is a polynomial in sin x and cos x up to this n


def normal(expression: sp.Expr) -> sp.Expr:
    """Normal form: one fraction of polynomials in symbols, sines and cosines, even powers of sines gone."""
    expanded, back = _algebraic(expression)
    numerator, denominator = (_reduced(part, back) for part in sp.fraction(sp.cancel(sp.together(expanded))))
    return sp.factor_terms(sp.cancel(numerator / denominator)).xreplace(back)


def is_zero(expression: sp.Expr) -> bool:
    """Whether an expression vanishes identically."""
    return bool(normal(expression) == 0)


def coefficients(
    expression: sp.Expr, variables: Sequence[sp.Symbol], given: Hypotheses | None = None
) -> dict[sp.Expr, sp.Expr]:
    """Coefficients of the linearly independent functions of variables that an expression is a sum of.

    The functions are products of powers of variables, of sines and of cosines of them. The sum vanishes for all values
    of the variables where every coefficient does. With what is `given` of the parameters, sines of multiples s x and r
    x are distinguished where s^2 != r^2.

    Raises:
        ModelError: the expression is no such sum.
    """
    expanded, back = _algebraic(expression)
    numerator, denominator = (_reduced(part, back) for part in sp.fraction(sp.cancel(sp.together(expanded))))
    moving = {*variables}
    own = [s for s in back if back[s].free_symbols & moving] + list(variables)
    if denominator.free_symbols & {*own}:
        raise ModelError(f"{expression} is no polynomial in {', '.join(map(str, variables))}, sines and cosines")
    for generator in own:
        angles = back[generator].args[0] if generator in back else generator
        is_plain = generator not in back or angles in moving or -angles in moving
        if not is_plain and (given is None or not _are_distinct(own, back, numerator, moving, given)):
            raise ModelError(f"{back[generator]} is no function of one variable")
    if not numerator.is_polynomial(*own):
        raise ModelError(f"{expression} is no polynomial in {', '.join(map(str, variables))}, sines and cosines")
    terms = sp.Poly(numerator, *own).terms() if own else [((), numerator)]
    found: dict[sp.Expr, sp.Expr] = {}
    for powers, coefficient in terms:
        function = sp.Mul(*(g**n for g, n in zip(own, powers, strict=True))).xreplace(back)
        found[function] = sp.cancel(coefficient / denominator).xreplace(back)
    return {function: c for function, c in found.items() if c != 0}


def _are_distinct(
    own: Sequence[sp.Symbol], back: dict[sp.Symbol, sp.Expr], total: sp.Expr, moving: set[sp.Symbol], given: Hypotheses
) -> bool:
    """Whether sines and cosines of multiples of one variable are independent: no products, no equal multiples."""
    waves = [g for g in own if g in back]
    angles = list(dict.fromkeys(back[g].args[0] for g in waves))
    (variable, *others) = sorted({x for angle in angles for x in angle.free_symbols & moving}, key=str)
    rates = [sp.diff(angle, variable) for angle in angles]
    if others or any(normal(angle - rate * variable) != 0 for angle, rate in zip(angles, rates, strict=True)):
        return False
    if not total.is_polynomial(*waves) or sp.Poly(total, *waves).total_degree() > 1:
        return False
    pairs = [(a, b) for i, a in enumerate(rates) for b in rates[:i]]
    return all(given.is_nonzero(normal(a**2 - b**2)) for a, b in pairs) and all(given.is_nonzero(a) for a in rates)


def _algebraic(expression: sp.Expr) -> tuple[sp.Expr, dict[sp.Symbol, sp.Expr]]:
    """Expression with symbols for sines, cosines and steep exponentials, and what they stand for."""
    steep = {f: sp.Dummy("e", real=True) for f in _sorted(expression, sp.exp, sp.Pow) if _is_steep(f)}
    expression = expression.xreplace(steep)
    waves = _sorted(expression, *_HYPERBOLIC, sp.sin, sp.cos, sp.tan)
    whole = {f: sp.Dummy("f", real=True) for f in waves if _is_whole(f)}
    expanded = sp.expand_trig(expression.xreplace(whole)).xreplace({symbol: f for f, symbol in whole.items()})
    expanded = expanded.rewrite(sp.tan, sp.sin).subs(sp.tan, sp.sin)
    for tangent in expanded.atoms(sp.tan):
        expanded = expanded.xreplace({tangent: sp.sin(tangent.args[0]) / sp.cos(tangent.args[0])})
    back: dict[sp.Symbol, sp.Expr] = {}
    there: dict[sp.Expr, sp.Symbol] = {}
    for angle in sorted({f.args[0] for f in expanded.atoms(sp.sin, sp.cos)}, key=sp.default_sort_key):
        for function in (sp.sin, sp.cos):
            symbol = sp.Dummy(f"{function.__name__}({angle})", real=True)
            there[function(angle)], back[symbol] = symbol, function(angle)
    kept = {symbol: f for f, symbol in steep.items()}
    return expanded.xreplace(there), {s: f.xreplace(kept) for s, f in back.items()} | kept


def _sorted(expression: sp.Expr, *kinds: type) -> list[sp.Expr]:
    return sorted(expression.atoms(*kinds), key=sp.default_sort_key)


def _is_steep(power: sp.Expr) -> bool:
    """Whether an exponential is one of sines, or to sympy a high power: exp(10**8 x) is one of exp(x)."""
    if power.func == sp.Pow and not power.exp.free_symbols:
        return False
    numbers = [c for c, _ in _terms(power.exp) if c.is_Rational]
    most = max((max(abs(int(c.p)), int(c.q)) for c in numbers), default=0)
    return bool(power.exp.atoms(sp.sin, sp.cos, sp.tan)) or most > _MOST_ANGLES


def _is_whole(function: sp.Expr) -> bool:
    """Whether a function is left as it is, not written in functions of parts of its argument."""
    if function.func in _HYPERBOLIC:
        return True
    return any(c.is_Integer and abs(c) > _MOST_ANGLES for c, rest in _terms(function.args[0]) if rest != 1)


def _terms(total: sp.Expr) -> list[tuple[sp.Expr, sp.Expr]]:
    return [term.as_coeff_Mul() for term in sp.Add.make_args(sp.expand(total))]


def _reduced(polynomial: sp.Expr, back: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Polynomial in which no sine has a power above 1."""
    found = sp.expand(polynomial)
    cosine = {what.args[0]: symbol for symbol, what in back.items() if what.func == sp.cos}
    for symbol, what in back.items():
        if what.func == sp.sin and found.has(symbol):
            found = sp.rem(found, symbol**2 + cosine[what.args[0]] ** 2 - 1, symbol)
    return sp.expand(found)


@dataclass(frozen=True)
class Solution:
    """What constants must be: values of some, and the equations that are left of others."""

    values: dict[sp.Symbol, sp.Expr]
    left: tuple[sp.Expr, ...] = ()


def solve_constants(
    equations: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol], given: Hypotheses, angles: Sequence[sp.Symbol] = ()
) -> tuple[Solution, ...]:
    """Values of real constants at which expressions of them vanish: every solution; empty where there is none.

    Factors that have a sign are left out, powers are taken away, equations that are linear in one unknown are solved
    for it, and what is known of its sine or cosine is put in. Those unknowns that are `angles` count modulo one turn.
    """
    found = _solved(equations, unknowns, given)
    if found is None:
        return ()
    for product in found.left:
        if product.is_Mul and len(product.args) > 1:
            rest = [e for e in found.left if e != product]
            return tuple(
                Solution({k: normal(x.subs(one.values)) for k, x in found.values.items()} | one.values, one.left)
                for factor in product.args
                for one in solve_constants([factor, *rest], unknowns, given, angles)
            )
    for unknown in angles:
        for function, values in ((sp.sin, (sp.Integer(0), sp.pi)), (sp.cos, (sp.pi / 2, -sp.pi / 2))):
            if function(unknown) in found.left:
                options = [
                    solve_constants([e.subs(unknown, x) for e in found.left], unknowns, given, angles) for x in values
                ]
                return tuple(
                    Solution({k: normal(x.subs(unknown, at)) for k, x in found.values.items()} | more, rest.left)
                    for at, option in zip(values, options, strict=True)
                    for rest in option
                    for more in ({unknown: at} | rest.values,)
                )
    return (found,)


def _solved(equations: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol], given: Hypotheses) -> Solution | None:
    """Solution as far as it follows without a choice; None where there is none."""
    pending, values = [normal(e) for e in equations], dict[sp.Symbol, sp.Expr]()
    trigonometric: dict[sp.Expr, sp.Expr] = {}
    for _ in range(_MOST_ROUNDS):
        pending = list(dict.fromkeys(x for e in pending if (x := radical(normal(_put(e, trigonometric)), given)) != 0))
        fixed = [e for e in pending if not e.free_symbols & {*unknowns}]
        if any(given.is_nonzero(e) for e in fixed):
            return None
        for equation in fixed:  # of parameters alone, and true at their declared values
            given.suppose(f"{equation} = 0")
        pending = [e for e in pending if e not in fixed]
        if not pending:
            return Solution(values)
        found = next((s for e in pending if (s := solved_for(e, unknowns, given)) is not None), None)
        if found is not None:
            unknown, value = found
            values = {u: normal(v.subs(unknown, value)) for u, v in values.items()} | {unknown: value}
            pending = [e.subs(unknown, value) for e in pending]
            trigonometric = {f: v for f, v in trigonometric.items() if unknown not in f.free_symbols}
            continue
        known = next((e for e in pending if e.func in {sp.sin, sp.cos} and e.args[0] in unknowns), None)
        if known is None or known in trigonometric:
            return Solution(values, tuple(pending))
        trigonometric[known] = sp.Integer(0)
        rest = [e for e in pending if e != known]
        if [radical(normal(_put(e, trigonometric)), given) for e in rest] == rest:
            return Solution(values, tuple(pending))
    return Solution(values, tuple(pending))


def _put(expression: sp.Expr, zeros: dict[sp.Expr, sp.Expr]) -> sp.Expr:
    """Put in sines and cosines that are 0; where a sine is, the square of the cosine is 1."""
    found = expression.xreplace(zeros)
    for wave in zeros:
        cosine, c = sp.cos(wave.args[0]), sp.Dummy("c", real=True)
        plain = found.xreplace({cosine: c})
        if wave.func == sp.sin and plain.has(c) and plain.is_polynomial(c):
            found = sp.rem(plain, c**2 - 1, c).xreplace({c: cosine})
    return found


def radical(expression: sp.Expr, given: Hypotheses) -> sp.Expr:
    """Product of the different factors of a numerator that may vanish; 1 where none may."""
    expanded, back = _algebraic(expression)
    numerator, _ = sp.fraction(sp.together(expanded))
    if numerator == 0:
        return sp.Integer(0)
    _, factors = sp.factor_list(numerator)
    product = sp.Mul(*(f for factor, _ in factors if given.sign(f := factor.xreplace(back)) is None))
    for what in back.values():
        parts = sp.Mul.make_args(product)
        if what.func == sp.cos and what - 1 in parts and what + 1 in parts:  # (C - 1)(C + 1) = -S^2
            sine = sp.sin(what.args[0])
            product = sp.Mul(*(f for f in parts if f not in {what - 1, what + 1, sine}), sine)
    return product


def without_void(entry: sp.Expr, given: Hypotheses) -> sp.Expr:
    """Entry of parameters, with the equations that were supposed of them; 0 where it vanishes, which is supposed.

    That is, at the declared values.
    """
    if given.equal:
        entry = normal(entry.subs(given.equal))
    if entry == 0 or not given.is_void(entry):
        return entry
    equation = radical(entry, given)
    given.suppose(f"{equation} = 0")
    if (found := solved_for(equation, sorted(equation.free_symbols, key=str), given)) is not None:
        name, value = found
        given.equal = {x: normal(y.subs(name, value)) for x, y in given.equal.items()} | {name: value}
    return sp.Integer(0)


def solved_for(equation: sp.Expr, unknowns: Sequence[sp.Symbol], given: Hypotheses) -> tuple[sp.Symbol, sp.Expr] | None:
    """Unknown that an equation gives, in which it is linear, and its value; None where there is none."""
    for unknown in filter(equation.has, unknowns):
        if equation.is_polynomial(unknown) and sp.Poly(equation, unknown).degree() == 1:
            slope, rest = sp.Poly(equation, unknown).all_coeffs()
            if given.sign(slope) in {1, -1}:
                return unknown, normal(-rest / slope)
    return None


@dataclass(frozen=True)
class Square:
    """A term coefficient * form^2 with a linear form of some symbols."""

    coefficient: sp.Expr
    form: sp.Expr


def squares(
    matrix: sp.Matrix,
    symbols: Sequence[sp.Symbol],
    given: Hypotheses,
    is_positive: Callable[[sp.Expr], bool] | None = None,
) -> tuple[Square, ...] | None:
    """X^T matrix x as a sum of squares with positive coefficients; None where it is not seen to be one.

    By completing squares, one symbol after the other: matrix = L D L^T, with D > 0 or left out where it is 0. An entry
    of D counts as positive where `is_positive` says so; by default, where it is so for all coordinates.
    """
    is_positive = is_positive or (lambda pivot: given.declared_sign(pivot) == 1)
    rest, found = matrix.applyfunc(lambda x: without_void(normal(x), given)), []
    for i in range(rest.rows):
        row = rest[i, :]
        if all(x == 0 for x in row):
            continue
        pivot = rest[i, i]
        if pivot == 0 or not is_positive(pivot):
            return None
        form = sum((normal(row[j] / pivot) * symbols[j] for j in range(rest.cols)), sp.Integer(0))
        found.append(Square(pivot, form))
        rest = (rest - row.T * row / pivot).applyfunc(lambda x: without_void(normal(x), given))
    return tuple(found)
