"""Linear systems over any algebra: symbolic expressions, or nodes of a graph that is compiled later."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

from masking.errors import ModelError

X = TypeVar("X")

LARGEST_CRAMER = 5


class Algebra(Protocol[X]):
    """The operations that solving takes."""

    def number(self, value: float) -> X:
        """Return a constant."""

    def is_number(self, x: X, value: float | None = None) -> bool:
        """Tell whether x is a constant (equal to `value`, if given)."""

    def varies(self, x: X) -> bool:
        """Tell whether x can change during a run: it depends on time or state."""

    def add(self, a: X, b: X) -> X:
        """Return a + b."""

    def sub(self, a: X, b: X) -> X:
        """Return a - b."""

    def mul(self, a: X, b: X) -> X:
        """Return a * b."""

    def div(self, a: X, b: X) -> X:
        """Return a / b."""


def solve(algebra: Algebra[X], matrix: Sequence[Sequence[X]], right: Sequence[Sequence[X]]) -> tuple[list[list[X]], X]:
    """Return x with `matrix` x = `right`, and the determinant of `matrix` up to its sign.

    Pivots that do not vary are eliminated first, in the order that fills in least (Markowitz); they
    cannot vanish on the way. What remains is solved by Cramer's rule, whose only division is by the
    determinant, so that a vanishing entry of a regular matrix does no harm; a remainder of more than
    five unknowns is eliminated in the same order instead.

    Args:
        algebra: the operations.
        matrix: n rows of n entries.
        right: n rows of k entries, one column for each right-hand side.

    Raises:
        ModelError: the matrix is singular by its structure, whatever the values.
    """
    rows = [list(r) for r in matrix]
    sides = [list(r) for r in right]
    size = len(rows)
    open_rows, open_columns = set(range(size)), set(range(size))
    steps: list[tuple[int, int, set[int]]] = []
    determinant = algebra.number(1.0)
    while open_rows:
        pivot = _pivot(algebra, rows, open_rows, open_columns, constant=True)
        if pivot is None and len(open_rows) > LARGEST_CRAMER:
            pivot = _pivot(algebra, rows, open_rows, open_columns, constant=False)
        if pivot is None:
            break
        row, column = pivot
        open_rows.discard(row)
        open_columns.discard(column)
        determinant = algebra.mul(determinant, rows[row][column])
        for other in open_rows:
            if algebra.is_number(rows[other][column], 0.0):
                continue
            factor = algebra.div(rows[other][column], rows[row][column])
            for j in open_columns:
                rows[other][j] = algebra.sub(rows[other][j], algebra.mul(factor, rows[row][j]))
            sides[other] = [
                algebra.sub(a, algebra.mul(factor, b)) for a, b in zip(sides[other], sides[row], strict=True)
            ]
        steps.append((row, column, set(open_columns)))

    solution: list[list[X]] = [[] for _ in range(size)]
    if open_rows:
        core_rows, core_columns = sorted(open_rows), sorted(open_columns)
        core = [[rows[i][j] for j in core_columns] for i in core_rows]
        values, core_determinant = _cramer(algebra, core, [sides[i] for i in core_rows])
        determinant = algebra.mul(determinant, core_determinant)
        for j, value in zip(core_columns, values, strict=True):
            solution[j] = value
    for row, column, later in reversed(steps):
        for side_index, side in enumerate(sides[row]):
            rest = side
            for j in sorted(later):
                rest = algebra.sub(rest, algebra.mul(rows[row][j], solution[j][side_index]))
            solution[column].append(algebra.div(rest, rows[row][column]))
    return solution, determinant


def _pivot(
    algebra: Algebra[X], rows: list[list[X]], open_rows: set[int], open_columns: set[int], *, constant: bool
) -> tuple[int, int] | None:
    """Return the open entry whose elimination fills in least, or None."""

    def filled(entry: X) -> bool:
        return not algebra.is_number(entry, 0.0)

    best: tuple[int, int] | None = None
    best_cost: tuple[int, bool] | None = None
    for i in sorted(open_rows):
        for j in sorted(open_columns):
            entry = rows[i][j]
            if not filled(entry) or (constant and algebra.varies(entry)):
                continue
            in_row = sum(filled(rows[i][k]) for k in open_columns) - 1
            in_column = sum(filled(rows[k][j]) for k in open_rows) - 1
            cost = (in_row * in_column, not algebra.is_number(entry))
            if best_cost is None or cost < best_cost:
                best, best_cost = (i, j), cost
    return best


def _cramer(algebra: Algebra[X], matrix: list[list[X]], right: list[list[X]]) -> tuple[list[list[X]], X]:
    """Return the solution and the determinant by Cramer's rule."""
    size = len(matrix)
    columns = [[matrix[i][j] for i in range(size)] for j in range(size)]
    determinant = _determinant(algebra, columns)
    if algebra.is_number(determinant, 0.0):
        raise ModelError("the linear system is singular whatever the values of its symbols")
    solution = []
    for j in range(size):
        values = []
        for k in range(len(right[0])):
            replaced = [*columns[:j], [row[k] for row in right], *columns[j + 1 :]]
            values.append(algebra.div(_determinant(algebra, replaced), determinant))
        solution.append(values)
    return solution, determinant


def _determinant(algebra: Algebra[X], columns: list[list[X]]) -> X:
    """Return the determinant by expansion along the first column."""
    if len(columns) == 1:
        return columns[0][0]
    result = algebra.number(0.0)
    for i, entry in enumerate(columns[0]):
        if algebra.is_number(entry, 0.0):
            continue
        minor = _determinant(algebra, [c[:i] + c[i + 1 :] for c in columns[1:]])
        term = algebra.mul(entry, minor)
        result = algebra.sub(result, term) if i % 2 else algebra.add(result, term)
    return result
