"""Derivatives of many expressions with respect to many symbols, most of which are zero."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from masking.lazy_imports import sympy as sp


def gradient(expression: sp.Expr, symbols: Sequence[sp.Symbol]) -> list[sp.Expr]:
    """Derivatives of an expression; each differentiates only the terms that hold its symbol."""
    zero, holding = sp.Integer(0), dict[sp.Symbol, list[sp.Expr]]()
    asked = frozenset(symbols)
    for term in sp.Add.make_args(expression):
        held = term.free_symbols & asked
        factor, inner = term.as_independent(*held, as_Add=False) if term.is_Mul and held else (None, term)
        if factor not in {None, 1} and inner.is_Add:  # a constant before a long sum
            for symbol, slope in zip(symbols, gradient(inner, symbols), strict=True):
                if slope != 0:
                    holding.setdefault(symbol, []).append(factor * slope)
            continue
        for symbol in held:
            holding.setdefault(symbol, []).append(sp.diff(term, symbol))
    return [sp.Add(*holding[s]) if s in holding else zero for s in symbols]


def jacobian(expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol]) -> sp.Matrix:
    """Derivatives of expressions (rows) with respect to symbols (columns)."""
    rows = [gradient(expression, symbols) for expression in expressions]
    return sp.Matrix(len(rows), len(symbols), [entry for row in rows for entry in row])


def rate(expression: sp.Expr, symbols: Sequence[sp.Symbol], rates: Sequence[sp.Expr]) -> sp.Expr:
    """Rate at which an expression changes while its symbols change at given rates."""
    slopes = zip(gradient(expression, symbols), rates, strict=True)
    return sp.Add(*(slope * one for slope, one in slopes if slope != 0))
