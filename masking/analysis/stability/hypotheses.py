"""Hypotheses: what a proof takes for granted of the parameters, and the signs of expressions that follow from it.

The hypotheses hold for the declared values, and for all others that satisfy them the proof holds, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy as sp

from masking.compile.codegen.graph import Graph
from masking.compile.codegen.intervals import Interval, enclose
from masking.errors import ModelError
from masking.model.modelling.model import Model

_DISTINCT = 1e-20  # a number that is no fraction is distinguished from 0 by 30 digits
_ROUNDING = 1e-15  # of a value: what its conversion to floating point may change
_COINCIDENCE = 1e-9  # of each value: a sign that does not survive such a change is a coincidence


@dataclass
class Hypotheses:
    """What is assumed of a model's parameters; grows as a proof needs more.

    Parameters of the oscillators that have equal values and names that differ in the number alone, such as w1 and w2,
    are one symbol. Every symbol has the sign of its value; what is 0 is 0.
    """

    model: Model  # whose values say what holds
    extra: list[str] = field(default_factory=list)  # further ones that a proof needed, as texts
    # expressions that are not 0 at the declared values, but nearly, so that no proof may rest on that
    coincidences: list[sp.Expr] = field(default_factory=list)
    equal: dict[sp.Expr, sp.Expr] = field(default_factory=dict)  # parameters by what supposed equations make of them

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters by name, in the units of the model: SI or its scales."""
        return self.model.parameter_values()

    @cached_property
    def exact(self) -> dict[str, sp.Expr]:
        """Parameters by name, as the decimals that are written."""
        return self.model.exact_values()

    @cached_property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Parameters that are equal, each group in declared order; most have one member."""
        numbers = {match[0] for name in self.model.oscillators if (match := re.search(r"\d+$", name))}
        found: dict[tuple[object, ...], list[str]] = {}
        for name, value in self.exact.items():
            stem, digits = re.fullmatch(r"(.*?)_?(\d*)", name).groups()  # type: ignore[union-attr]  # matches any name
            unit = self.model.declaration.parameters[name].unit
            key = (stem, unit, value) if digits and digits in numbers and value != 0 else (name,)
            found.setdefault(key, []).append(name)
        return tuple(tuple(group) for group in found.values())

    @cached_property
    def symbols(self) -> dict[str, sp.Expr]:
        """Symbol of each parameter by name, with the sign of its value; 0 where that is 0."""
        made: dict[str, sp.Expr] = {}
        for group in self.groups:
            value = self.values[group[0]]
            name = group[0] if len(group) == 1 else re.sub(r"_?\d+$", "", group[0])
            taken = {*self.values, *self.model.coordinates, *self.model.states, *(str(s) for s in made.values())}
            if len(group) > 1 and name in taken:
                name = group[0]
            signed = sp.Symbol(name, positive=True) if value > 0.0 else sp.Symbol(name, negative=True)
            made |= dict.fromkeys(group, signed if value != 0.0 else sp.Integer(0))
        return made

    def of(self, expression: sp.Expr) -> sp.Expr:
        """Expression in the symbols of the model with these for its parameters."""
        known = {p: self.symbols[p.name] for p in self.model.equations.symbols.p}
        return sp.nsimplify(expression.subs(known), rational=True)

    def at_values(self, expression: sp.Expr) -> sp.Expr:
        """Expression in these symbols with exact declared values for them."""
        return expression.subs({s: self.exact[name] for name, s in self.symbols.items() if not s.is_number})

    def is_void(self, expression: sp.Expr) -> bool:
        """Whether an expression of parameters is 0 at the declared values."""
        value = self.at_values(expression)
        return bool(value.is_number) and not _is_distinct(value)

    @property
    def texts(self) -> tuple[str, ...]:
        """All hypotheses, for people."""
        found = []
        for group in self.groups:
            if not self._used & {*group}:
                continue
            value = self.values[group[0]]
            sign = "> 0" if value > 0.0 else "< 0" if value < 0.0 else "= 0"
            names = " = ".join(group)
            found.append(f"{names} = {self.symbols[group[0]]} {sign}" if len(group) > 1 else f"{names} {sign}")
        return (*self.inputs, *found, *dict.fromkeys(self.extra))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Hypothesis that the inputs are 0, for people; empty where the model has none."""
        names = [str(u) for u in self.model.equations.symbols.u]
        if not names:
            return ()
        return (f"the input{'s' if len(names) > 1 else ''} {' = '.join(names)} = 0",)

    @cached_property
    def _used(self) -> set[str]:
        """Parameters that equations without inputs, or the energy, hold."""
        e = self.model.equations
        still = dict.fromkeys(e.symbols.u, 0)
        held = [x.subs(still) for x in (*e.mass, *e.force, e.energy or sp.Integer(0))]
        return {s.name for x in held for s in x.free_symbols}

    def suppose(self, text: str) -> None:
        """Add a hypothesis."""
        self.extra.append(text)

    def sign(self, expression: sp.Expr) -> int | None:
        """Sign for all coordinates and velocities: 1, -1, 0 for what is always 0; None if it is unknown or changes."""
        return self._sign(expression, True, lambda factor: self._sign_of_factor(factor, True))

    def declared_sign(self, expression: sp.Expr, *, strictly: bool = True) -> int | None:
        """Sign, of factors at declared values where need be, which is then supposed; not strictly, 1 is >= 0."""
        return self._sign(expression, strictly, lambda factor: self._sign_at_values(factor, strictly))

    def is_nonzero(self, expression: sp.Expr) -> bool:
        """Whether an expression of parameters is not 0: by its sign, or at declared values, which is supposed."""
        if self.sign(expression) in {1, -1}:
            return True
        value = self.at_values(expression)
        if not value.is_number or not _is_distinct(value):
            return False
        for factor, _ in factors(expression):
            if self.sign(factor) is None:
                self.suppose(f"{factor} != 0")
                self._survives(factor)
        return True

    def _survives(self, factor: sp.Expr) -> None:
        """Note a coincidence where a factor may be 0 at values that are almost the declared ones."""
        if self._enclosed(factor, self._around(_COINCIDENCE), strictly=True) is None:
            self.coincidences.append(factor)

    def _around(self, part: float) -> dict[sp.Expr, Interval]:
        declared = {s: self.values[name] for name, s in self.symbols.items() if not s.is_number}
        return {s: Interval.of(x - part * abs(x), x + part * abs(x)) for s, x in declared.items()}

    def _sign(self, expression: sp.Expr, strictly: bool, of_factor: Callable[[sp.Expr], int | None]) -> int | None:
        if expression.is_zero:
            return 0
        total = 1
        for factor, power in factors(expression):
            if not strictly and power > 0 and power % 2 == 0:
                continue
            found = of_factor(factor)
            if found is None:
                return None
            total *= found if power % 2 else 1
        return total

    def _sign_of_factor(self, factor: sp.Expr, strictly: bool) -> int | None:
        # 1 - cos^2 = sin^2: m (cos^2 - 2) is negative in either form, M - m cos^2 + m in one alone.
        in_sines = factor.replace(_is_even_cosine, lambda x: (1 - sp.sin(x.base.args[0]) ** 2) ** (x.exp / 2))
        for form in (factor, sp.expand(in_sines)):
            if form.is_positive or form.is_negative:
                return 1 if form.is_positive else -1
            if not strictly and (form.is_nonnegative or form.is_nonpositive):
                return 1 if form.is_nonnegative else -1
        ranges = self._ranges()
        found = self._enclosed(factor, ranges, strictly)
        if found is not None and strictly:
            self._suppose_bounds(factor, ranges)
        return found

    def _sign_at_values(self, factor: sp.Expr, strictly: bool) -> int | None:
        found = self._sign_of_factor(factor, strictly)
        if found is not None or not any(s in factor.free_symbols for s in self.symbols.values()):
            return found
        value = self.at_values(factor)
        is_zero = bool(value.is_number) and not _is_distinct(value)
        if is_zero:
            found = None if strictly else 1
        elif value.is_number:
            found = 1 if sp.N(value, 30) > 0 else -1
        else:
            found = self._enclosed(factor, self._around(_ROUNDING), strictly)
        if found is not None:
            self.suppose(f"{factor} {'>' if found > 0 else '<'}{'' if strictly else '='} 0")
            if strictly or (value.is_number and not is_zero):
                self._survives(factor)
        return found

    def _ranges(self) -> dict[sp.Expr, Interval]:
        """Ranges of the parameters: the side of 0 that their values are on, within declared bounds."""
        found: dict[sp.Expr, Interval] = {}
        for group in self.groups:
            value = self.values[group[0]]
            low, high = (0.0, np.inf) if value > 0.0 else (-np.inf, 0.0)
            for name in group:
                parameter = self.model.declaration.parameters[name]
                factor = self.model.units.conversions[parameter.unit].factor
                least, most = parameter.bounds
                if low < 0.0 and least is not None:
                    low = max(low, least * factor)
                if high > 0.0 and most is not None:
                    high = min(high, most * factor)
            found[self.symbols[group[0]]] = Interval.of(low, high)
        return found

    def _enclosed(self, factor: sp.Expr, known: dict[sp.Expr, Interval], strictly: bool) -> int | None:
        """Sign of an enclosure over all coordinates and velocities."""
        graph = Graph()
        symbols = {symbol: graph.symbol(str(symbol), varying=True) for symbol in factor.free_symbols}
        given = {node: known.get(symbol, Interval.of(-np.inf, np.inf)) for symbol, node in symbols.items()}
        try:
            (found,) = enclose(graph, [graph.lower(factor, symbols)], given)
        except ModelError:
            return None
        slack = 0.0 if strictly else 1e-300  # of outward rounding at 0
        return 1 if found.low > -slack else -1 if found.high < slack else None

    def _suppose_bounds(self, factor: sp.Expr, known: dict[sp.Expr, Interval]) -> None:
        for symbol in sorted(factor.free_symbols & known.keys(), key=str):
            low, high = float(known[symbol].low), float(known[symbol].high)
            if low == high:
                continue
            if np.isfinite(high) and high > 0.0:
                self.suppose(f"{symbol} <= {high:g}")
            if np.isfinite(low) and low < 0.0:
                self.suppose(f"{symbol} >= {low:g}")


def _is_distinct(number: sp.Expr) -> bool:
    return bool(number != 0 if number.is_Rational else abs(sp.N(number, 30)) > _DISTINCT)


def _is_even_cosine(expression: sp.Expr) -> bool:
    return bool(expression.is_Pow and expression.base.func == sp.cos and expression.exp.is_even)


def factors(expression: sp.Expr) -> Iterable[tuple[sp.Expr, int]]:
    """Factors with their integer powers; their product is the expression."""
    plain, back = without_exponentials(expression)
    numerator, denominator = sp.fraction(sp.together(plain))
    for part, sign in ((numerator, 1), (denominator, -1)):
        if part.is_number:
            yield part, sign
            continue
        constant, factors = sp.factor_list(part)
        yield constant, sign
        for factor, power in factors:
            yield factor.xreplace(back), sign * int(power)


def without_exponentials(expression: sp.Expr) -> tuple[sp.Expr, dict[sp.Symbol, sp.Expr]]:
    """Expression with a symbol for each exponential and root, and what they stand for.

    Else exp(10**8 x) is a power of exp(x) to sympy, and a polynomial with as many coefficients.
    """
    there = {}
    for power in sorted(expression.atoms(sp.Pow, sp.exp), key=sp.default_sort_key):
        if power.func == sp.exp or not power.exp.is_Integer:
            there[power] = sp.Dummy("e", positive=power.is_positive, real=True)
    return expression.xreplace(there), {symbol: power for power, symbol in there.items()}
