"""Quadratic forms as sums of squares with positive coefficients, by completing squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import sympy as sp

from masking.analysis.stability.algebra import normal, without_void
from masking.analysis.stability.hypotheses import Hypotheses


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
