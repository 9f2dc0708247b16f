"""Derivatives of many expressions with respect to many symbols, most of which are zero."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import lazy_loader as lazy

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy.load("sympy")


def gradient(expression: sp.Expr, symbols: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """Return the derivatives of an expression; each differentiates only the terms that hold its symbol."""
    zero, holding = sp.Integer(0), dict[sp.Symbol, list[sp.Expr]]()
    for term in sp.Add.make_args(expression):
        for symbol in term.free_symbols:
            holding.setdefault(symbol, []).append(term)
    return [sp.Add(*(sp.diff(term, s) for term in holding[s])) if s in holding else zero for s in symbols]


def jacobian(expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol]) -> sp.Matrix:
    """Return the derivatives of expressions (rows) with respect to symbols (columns)."""
    rows = [gradient(expression, symbols) for expression in expressions]
    return sp.Matrix(len(rows), len(symbols), [entry for row in rows for entry in row])


def rate(expression: sp.Expr, symbols: Sequence[sp.Symbol], rates: Sequence[sp.Expr]) -> sp.Expr:
    """Return the rate at which an expression changes while its symbols change at given rates."""
    slopes = zip(gradient(expression, symbols), rates, strict=True)
    return sp.Add(*(slope * one for slope, one in slopes if slope != 0))
