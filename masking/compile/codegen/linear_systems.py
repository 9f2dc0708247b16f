"""Linear systems over any algebra: symbolic expressions, or nodes of a graph that is compiled later.

Entries that are zero by structure are never touched: a chain, which is banded, and a beam with pendula, which is an
arrow, take a number of operations in proportion to their size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from masking.compile.codegen.graph import Graph, Node
from masking.errors import ModelError

X = TypeVar("X")

LARGEST_CRAMER = 5
SINGULAR = "the linear system is singular whatever the values of its symbols"


class Algebra(Protocol[X]):
    """The operations that solving takes."""

    def number(self, value: float) -> X:
        """Constant."""

    def is_number(self, x: X, value: float | None = None) -> bool:
        """Whether x is a constant (equal to `value`, if given)."""

    def varies(self, x: X) -> bool:
        """Whether x can change during a run: it depends on time or state."""

    def add(self, a: X, b: X) -> X:
        """+ b."""

    def sub(self, a: X, b: X) -> X:
        """- b."""

    def mul(self, a: X, b: X) -> X:
        """* b."""

    def div(self, a: X, b: X) -> X:
        """/ b."""


@dataclass(frozen=True)
class Divisor(Generic[X]):
    """What a solution was divided by: the matrix is singular where it is zero."""

    value: X  # a pivot, or the determinant of a small block
    entry: X | None  # of a pivot, what the matrix itself has in its place; None for a determinant


def solve(
    algebra: Algebra[X], matrix: Sequence[Sequence[X]], right: Sequence[Sequence[X]]
) -> tuple[list[list[X]], list[Divisor[X]]]:
    """X with `matrix` x = `right`, and all that was divided by.

    Pivots that do not vary are eliminated first, in the order that fills in least (Markowitz); they
    cannot vanish on the way. What remains falls into blocks that share no row and no column. One of up to
    five unknowns is solved by Cramer's rule, whose only division is by the determinant, so that a vanishing
    entry of a regular block does no harm; a larger one is eliminated in the same order.

    `matrix` has n rows of n entries; `right` has n rows of k, one column for each right-hand side. Raises a
    `ModelError` where the matrix is singular by its structure, whatever the values.

    Source: Duff, Erisman and Reid (2017), Direct Methods for Sparse Matrices, chapters 5 (blocks) and 7 (Markowitz).
    """
    return _Elimination(algebra, matrix, right).solve()


class _Elimination(Generic[X]):
    """The rows that are left, without their zeros, and the steps by which they came to be.

    `fixed` holds for each row the columns of entries that do not vary; `rows_of` for each column the open rows that
    have an entry there.
    """

    def __init__(self, algebra: Algebra[X], matrix: Sequence[Sequence[X]], right: Sequence[Sequence[X]]) -> None:
        self.algebra = algebra
        self.rows = [{j: x for j, x in enumerate(r) if not algebra.is_number(x, 0.0)} for r in matrix]
        self.given = [dict(row) for row in self.rows]
        self.sides = [list(r) for r in right]
        self.fixed = [{j for j, x in row.items() if not algebra.varies(x)} for row in self.rows]
        self.rows_of: list[set[int]] = [{i for i, row in enumerate(self.rows) if j in row} for j in range(len(matrix))]
        self.open = set(range(len(matrix)))
        self.steps: list[tuple[int, int]] = []
        self.divisors: list[Divisor[X]] = []
        self.solution: list[list[X]] = [[] for _ in matrix]

    def solve(self) -> tuple[list[list[X]], list[Divisor[X]]]:
        while (pivot := self._pivot(self.open, self.fixed)) is not None:
            self._eliminate(*pivot)
        for block in self._blocks():
            columns = sorted({j for i in block for j in self.rows[i]})
            if len(columns) == len(block) <= LARGEST_CRAMER:
                self._cramer(sorted(block), columns)
                continue
            while block:
                if (pivot := self._pivot(block, self.rows)) is None:
                    raise ModelError(SINGULAR)
                self._eliminate(*pivot)
                block.discard(pivot[0])
        a = self.algebra
        for row, column in reversed(self.steps):
            later = sorted(self.rows[row].keys() - {column})
            for index, side in enumerate(self.sides[row]):
                rest = side
                for j in later:
                    rest = a.sub(rest, a.mul(self.rows[row][j], self.solution[j][index]))
                self.solution[column].append(a.div(rest, self.rows[row][column]))
        return self.solution, self.divisors

    def _pivot(self, rows: set[int], columns: Sequence[set[int] | dict[int, X]]) -> tuple[int, int] | None:
        """Entry whose elimination fills in least, of those in `columns` of each of `rows`, or None.

        Of equals, a number comes before what is computed, and an entry of the diagonal before another: where a mass
        matrix is positive, so are the pivots there.
        """
        best: tuple[int, int] | None = None
        best_cost: tuple[int, bool, bool] | None = None
        for i in sorted(rows):
            in_row = len(self.rows[i]) - 1
            for j in sorted(columns[i]):
                fill = in_row * (len(self.rows_of[j]) - 1)
                if best_cost is not None and fill > best_cost[0]:
                    continue
                cost = (fill, not self.algebra.is_number(self.rows[i][j]), i != j)
                if best_cost is None or cost < best_cost:
                    best, best_cost = (i, j), cost
        return best

    def _eliminate(self, row: int, column: int) -> None:
        a, pivots = self.algebra, self.rows[row]
        self.open.discard(row)
        for j in pivots:
            self.rows_of[j].discard(row)
        self.divisors.append(Divisor(pivots[column], self.given[row].get(column, a.number(0.0))))
        for other in sorted(self.rows_of[column]):
            changed = self.rows[other]
            factor = a.div(changed.pop(column), pivots[column])
            self.fixed[other].discard(column)
            for j in sorted(pivots.keys() - {column}):
                self._set(other, j, a.sub(changed.get(j, a.number(0.0)), a.mul(factor, pivots[j])))
            sides = zip(self.sides[other], self.sides[row], strict=True)
            self.sides[other] = [a.sub(x, a.mul(factor, y)) for x, y in sides]
        self.rows_of[column] = set()
        self.steps.append((row, column))

    def _set(self, row: int, column: int, value: X) -> None:
        self.fixed[row].discard(column)
        if self.algebra.is_number(value, 0.0):
            self.rows[row].pop(column, None)
            self.rows_of[column].discard(row)
            return
        self.rows[row][column] = value
        self.rows_of[column].add(row)
        if not self.algebra.varies(value):
            self.fixed[row].add(column)

    def _blocks(self) -> list[set[int]]:
        """Open rows in groups that share no column."""
        blocks, left = list[set[int]](), set(self.open)
        while left:
            block, reached = set[int](), [min(left)]
            while reached:
                row = reached.pop()
                if row in left:
                    left.discard(row)
                    block.add(row)
                    reached += [other for j in self.rows[row] for other in self.rows_of[j]]
            blocks.append(block)
        return blocks

    def _cramer(self, rows: list[int], columns: list[int]) -> None:
        a = self.algebra
        block = [[self.rows[i].get(j, a.number(0.0)) for i in rows] for j in columns]  # by columns
        determinant = _determinant(a, block)
        if a.is_number(determinant, 0.0):
            raise ModelError(SINGULAR)
        self.divisors.append(Divisor(determinant, None))
        for position, column in enumerate(columns):
            for k in range(len(self.sides[rows[0]])):
                replaced = [*block[:position], [self.sides[i][k] for i in rows], *block[position + 1 :]]
                self.solution[column].append(a.div(_determinant(a, replaced), determinant))


def _determinant(algebra: Algebra[X], columns: list[list[X]]) -> X:
    """Determinant by expansion along the first column."""
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


def health(graph: Graph, divisors: Sequence[Divisor[Node]]) -> Node:
    """Node that vanishes, or changes its sign, where a matrix becomes singular during a run.

    Of divisors as `solve` returns them, it is the smallest magnitude among those that vary, without their constant
    factors, with the sign of their product; 1 where none varies, and 0 where one that does not vary is 0. It neither
    overflows nor falls with the number of unknowns. Where several vary, a pivot p in the place of the entry a counts in
    proportion to the terms that it is the sum of, |a| + |p - a|, so that pivots of different units can be compared.
    """
    varying = [one for one in divisors if graph.varies(one.value)]
    factors = [one.value for one in divisors if not graph.varies(one.value)]
    parts = list[Node]()
    for one in varying:
        value, constant = graph.without_constants(one.value)
        factors += constant
        if len(varying) > 1 and one.entry not in {None, one.value}:
            size = graph.add(graph.apply("abs", one.entry), graph.apply("abs", graph.sub(one.value, one.entry)))
            value = one.value if graph.is_number(one.entry, 0.0) else graph.div(one.value, size)
        parts.append(value)
    parts = list(dict.fromkeys(parts))
    factors += parts if len(parts) > 1 else []
    if len(parts) > 1:
        parts = [graph.apply("abs", part) for part in parts]
    while len(parts) > 1:
        pairs = zip(parts[::2], parts[1::2], strict=False)
        parts = [*(graph.apply("min", *pair) for pair in pairs), *parts[len(parts) // 2 * 2 :]]
    found = parts[0] if parts else graph.number(1.0)
    for factor in dict.fromkeys(factors):
        if not graph.is_number(factor):
            found = graph.mul(found, graph.apply("sign", factor))
    return found
