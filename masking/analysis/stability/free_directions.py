"""Free directions: along which no force at rest changes, so that equilibria are whole lines.

The angle of a shaft that turns freely is one (a cyclic coordinate), and the common motion of two bodies that only a
spring between them holds. An expression is a sum of functions of the coordinates, each with a coefficient: what is
linear in forces or in their slopes is found from these exactly.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp
from sympy.polys.matrices import DomainMatrix

from masking.model.modelling.gradient import jacobian


def free_directions(force: Sequence[sp.Expr], q: Sequence[sp.Symbol]) -> tuple[sp.Matrix, tuple[int, ...]]:
    """Directions (r, n), constant vectors along which forces without parameters (n,) never change; and what holds them.

    That are the indices of r coordinates, of which each direction moves one, by 1.
    """
    slopes = jacobian(force, q)
    null = _coefficients([slopes.col(j) for j in range(len(q))], q).transpose().nullspace()
    reduced, pivots = null.rref()
    return reduced.to_Matrix(), tuple(pivots)


def independent(force: Sequence[sp.Expr], q: Sequence[sp.Symbol]) -> tuple[int, ...]:
    """Indices of forces of which the others are sums with constant factors, the first ones that will do."""
    return tuple(_coefficients([[f] for f in force], q).transpose().rref()[1])


def _coefficients(rows: Sequence[Sequence[sp.Expr]], q: Sequence[sp.Symbol]) -> DomainMatrix:
    """Coefficients of rows of expressions (m, k), a column for each function of the coordinates in each of the k."""
    columns, found = dict[tuple[int, sp.Expr], int](), list[tuple[int, int, sp.Expr]]()
    for i, row in enumerate(rows):
        for k, expression in enumerate(row):
            for term in sp.Add.make_args(sp.expand(expression)):
                factor, function = term.as_independent(*q, as_Add=False)
                found.append((i, columns.setdefault((k, function), len(columns)), factor))
    matrix = sp.zeros(len(rows), len(columns))
    for i, column, factor in found:
        matrix[i, column] += factor
    return DomainMatrix.from_Matrix(matrix).to_field()
