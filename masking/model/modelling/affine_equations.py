"""Equations of motion in which each input appears to the first power: an input stands for what it does.

An input u that acts nonlinearly does so by its curve g(u): the square of a current in a magnet, the saturation of an
amplifier, the flow through a valve under a pressure. In its place stands w = g(u), for which a control law solves; the
declared input follows from w.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.modelling.equations import Equations
from masking.model.modelling.gradient import gradient


@dataclass(frozen=True)
class AffineEquations(Equations):
    """Equations of a declaration in which each nonlinear input u stands for g(u)."""

    @cached_property
    def _declared(self) -> Equations:
        return Equations(self.declaration, self._lags)

    @cached_property
    def curves(self) -> Mapping[sp.Symbol, sp.Expr]:
        """Curve g(u), which is 0 at u = 0, of each input that acts nonlinearly; it may hold states and parameters.

        A ModelError where an input acts by two different curves, or by one with another input.
        """
        declared = self._declared
        names = (*(f"equation of {c}" for c in self.coordinates), *(f"rate of {s}" for s in self.declaration.states))
        entries = dict(zip(names, (*declared.force, *declared.rates), strict=True))
        found, inputs = dict[sp.Symbol, sp.Expr](), {*declared.symbols.u}
        for u in declared.symbols.u:
            if u in declared.mass.free_symbols:
                raise ModelError(
                    f"{self.name}: {u} multiplies an acceleration; masking needs inputs that add to forces"
                )
            acts = {name: part for name, x in entries.items() if (part := _by(x, u)) != 0}
            if not any(gradient(part, [u])[0].free_symbols & inputs for part in acts.values()):
                continue
            for name, part in acts.items():
                if others := sorted(str(x) for x in part.free_symbols & inputs - {u}):
                    raise ModelError(
                        f"{self.name}: {u} acts together with {', '.join(others)} in the {name}, by {part}; masking "
                        "needs what each input does apart from the others"
                    )
            curve = next(sp.factor_terms(x).as_independent(u, as_Add=False)[1] for x in acts.values())
            for name, part in acts.items():
                if u in _ratio(part, curve, u).free_symbols:
                    raise ModelError(
                        f"{self.name}: the {name} holds {u} in {part}, and the {next(iter(acts))} in {curve}; masking "
                        f"needs one curve of {u}, such as {curve}, times anything but an input"
                    )
            found[u] = curve
        return found

    def _affine(self, expression: sp.Expr) -> sp.Expr:
        for u, curve in self.curves.items():
            if (part := _by(expression, u)) != 0:
                expression = expression.xreplace({u: sp.Integer(0)}) + _ratio(part, curve, u) * u
        return expression

    @cached_property
    def _system(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        return self._declared.mass, self._declared.force.applyfunc(self._affine)

    @cached_property
    def rates(self) -> tuple[sp.Expr, ...]:
        """Rates of the internal states as expressions of time, state, inputs and parameters."""
        return tuple(map(self._affine, self._declared.rates))

    def output(self, name: str) -> sp.Expr:
        """Output in symbols of the model, with the elements that act on it."""
        return self._affine(self._declared.output(name))


def curved(equations: Equations) -> tuple[str, ...]:
    """Names of inputs that do not appear to the first power alone."""
    inputs = equations.symbols.u
    slopes = (slope for x in (*equations.force, *equations.rates) for slope in gradient(x, inputs))
    bad = equations.mass.free_symbols.union(*(slope.free_symbols for slope in slopes))
    return tuple(u.name for u in inputs if u in bad)


def _by(expression: sp.Expr, u: sp.Symbol) -> sp.Expr:
    """Part of an expression that is due to an input."""
    if u not in expression.free_symbols:
        return sp.Integer(0)
    part = expression - expression.xreplace({u: sp.Integer(0)})
    inputs_apart = sp.expand(part)  # such as those that stand in one bracket
    return inputs_apart if len(inputs_apart.free_symbols) < len(part.free_symbols) else part


def _ratio(part: sp.Expr, curve: sp.Expr, u: sp.Symbol) -> sp.Expr:
    """Factor of a curve in a part; it holds the input where the part is no multiple of the curve."""
    factor, inner = sp.factor_terms(part).as_independent(u, as_Add=False)
    return factor if inner == curve else sp.simplify(part / curve)
