"""Observability: the motions of a linear model along which linear forms of its velocities stay 0, exactly."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from masking.analysis.stability.algebra import normal, without_void
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses


def unobserved(motion: Motion, forms: Sequence[sp.Expr]) -> tuple[sp.Expr, ...]:
    """Relations, linear in the states, of the unobservable subspace of a linear model, outputs being the forms.

    The states x with O x = 0 for O = [C; C A; C A^2; ...], by elimination of rows that are linearly dependent.
    """
    n = len(motion.q)
    state = (*motion.q, *motion.v)
    inverse = motion.mass.inv()
    lower = (inverse * motion.force.jacobian(state)).applyfunc(normal)
    a = sp.Matrix.vstack(sp.Matrix.hstack(sp.zeros(n), sp.eye(n)), lower)
    rows, fresh = list[sp.Matrix](), [sp.Matrix([[sp.diff(form, x) for x in state]]) for form in forms]
    pivots, determinant = list[int](), sp.Integer(1)
    while fresh:
        row = fresh.pop(0)
        reduced = row
        for pivot, other in zip(pivots, rows, strict=True):
            reduced = (reduced - reduced[pivot] * other).applyfunc(normal)
        reduced = reduced.applyfunc(lambda x: without_void(x, motion.given))
        entry = _pivot(reduced, motion.given)
        if entry is None:
            continue
        determinant *= reduced[entry]
        reduced = (reduced / reduced[entry]).applyfunc(normal)
        rows = [(r - r[entry] * reduced).applyfunc(normal) for r in rows]
        rows.append(reduced)
        pivots.append(entry)
        fresh.append((row * a).applyfunc(normal))
    # Earlier pivots are eliminated from later rows: the product is a minor of O; the result holds where it is not 0.
    motion.given.is_nonzero(without_void(normal(determinant), motion.given))
    ordered = sorted(zip(pivots, rows, strict=True), key=lambda x: x[0])
    plain = [row.applyfunc(lambda x: without_void(x, motion.given)) for _, row in ordered]
    return tuple(sum((row[j] * x for j, x in enumerate(state)), sp.Integer(0)) for row in plain)


def _pivot(row: sp.Matrix, given: Hypotheses) -> int | None:
    """Last entry of a row that is not 0, one with a sign first; None where all are 0."""
    order = [j for j in reversed(range(row.cols)) if row[j] != 0]
    return next((j for j in order if given.sign(row[j]) in {1, -1}), order[0] if order else None)
