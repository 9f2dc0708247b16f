"""Discontinuities: where an expression with steps or in pieces may not be continuous."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import sympy as sp

from masking.analysis.stability.algebra import is_zero


def jumps(expression: sp.Expr) -> list[str]:
    """Edges, as texts such as x' = 0, at which an expression is not shown to be continuous."""
    found = [f"{f} is a whole number" for f in expression.atoms(sp.floor, sp.ceiling)]
    for step in expression.atoms(sp.sign, sp.Heaviside):
        below = sp.Integer(-1 if step.func == sp.sign else 0)
        if not _agree(expression.xreplace({step: sp.Integer(1)}), expression.xreplace({step: below}), step.args[0]):
            found.append(f"{step.args[0]} = 0")
    for piece in expression.atoms(sp.Piecewise):
        found += map(str, jumps_of(piece))
    return sorted(found)


def jumps_of(piece: sp.Piecewise) -> Iterator[sp.Expr]:
    """Yield the conditions of a function in pieces at whose edge two of them are not shown to agree."""
    for (value, condition), (other, _) in itertools.pairwise(piece.args):
        is_edge = isinstance(condition, sp.core.relational.Relational)
        if not (is_edge and _agree(value, other, condition.lhs - condition.rhs)):
            yield condition


def _agree(value: sp.Expr, other: sp.Expr, edge: sp.Expr) -> bool:
    """Whether two expressions agree where a third is 0, solved for a symbol in which it is linear."""
    edge = sp.expand(edge)
    for symbol in sorted(edge.free_symbols, key=str):
        slope = edge.diff(symbol)
        if slope.is_number and slope != 0:
            return is_zero((value - other).subs(symbol, symbol - edge / slope))
    return False
