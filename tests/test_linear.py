"""Linear systems: the same solutions as numpy's, wherever entries vanish, and a word where there are none."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from masking.codegen.graph import Graph
from masking.codegen.linear import solve
from masking.errors import ModelError


@dataclass
class Numbers:
    """Plain numbers as an algebra; `is_varying` says whether they count as known before a run."""

    kind: type
    is_varying: bool

    def number(self, value):
        return self.kind(value)

    def is_number(self, x, value=None):
        return value is None or x == value

    def varies(self, x):
        return self.is_varying

    def add(self, a, b):
        return a + b

    def sub(self, a, b):
        return a - b

    def mul(self, a, b):
        return a * b

    def div(self, a, b):
        return a / b


def systems(smallest, largest):
    entries = st.integers(-4, 4)
    return st.integers(smallest, largest).flatmap(
        lambda n: st.tuples(
            st.lists(st.lists(entries, min_size=n, max_size=n), min_size=n, max_size=n),
            st.lists(st.lists(entries, min_size=2, max_size=2), min_size=n, max_size=n),
        )
    )


@settings(max_examples=100, deadline=None)
@given(systems(1, 5), st.booleans())
def test_small_systems_are_solved_as_numpy_solves_them(system, is_varying):
    matrix, right = (np.array(part, dtype=float) for part in system)
    assume(np.linalg.cond(matrix) < 1e3)
    found, determinant = solve(Numbers(float, is_varying), matrix.tolist(), right.tolist())
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * (1.0 + np.abs(expected).max()))
    assert abs(determinant) == pytest.approx(abs(np.linalg.det(matrix)), rel=1e-9)


@settings(max_examples=50, deadline=None)
@given(systems(6, 8), st.booleans())
def test_large_systems_are_solved_exactly_in_exact_arithmetic(system, is_varying):
    matrix, right = system
    assume(abs(np.linalg.det(np.array(matrix))) > 0.5)  # of integers, so it is not zero
    exact = Numbers(Fraction, is_varying)
    found, determinant = solve(exact, *([[Fraction(x) for x in row] for row in part] for part in system))
    n = len(matrix)
    assert [[sum(matrix[i][j] * found[j][k] for j in range(n)) for k in (0, 1)] for i in range(n)] == right
    assert abs(determinant) == round(abs(np.linalg.det(np.array(matrix))))


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, math.pi, 0.3])
def test_a_rotation_is_inverted_where_its_diagonal_vanishes(angle):
    graph = Graph()
    c, s = (graph.symbol(name, varying=True) for name in "cs")
    solution, determinant = solve(graph, [[c, graph.apply("neg", s)], [s, c]], [[graph.number(2)], [graph.number(3)]])
    values = value_of(graph, {"c": round(math.cos(angle), 15), "s": round(math.sin(angle), 15)})
    # the inverse of a rotation is its transpose
    assert values[solution[0][0]] == pytest.approx(2 * math.cos(angle) + 3 * math.sin(angle), abs=1e-12)
    assert values[solution[1][0]] == pytest.approx(3 * math.cos(angle) - 2 * math.sin(angle), abs=1e-12)
    assert abs(values[determinant]) == pytest.approx(1.0, abs=1e-12)


def value_of(graph, symbols):
    """Return the value of each node; a graph is in computable order."""
    do = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b}
    do["neg"] = lambda a: -a
    values = []
    for name, *rest in graph.operations:
        if name in do:
            values.append(do[name](*(values[r] for r in rest)))
        else:
            values.append(symbols[rest[0]] if name == "symbol" else rest[0])
    return values


def test_a_constant_pivot_is_taken_before_one_that_varies():
    graph = Graph()
    x = graph.symbol("x", varying=True)
    one, zero = graph.number(1.0), graph.number(0.0)
    solution, determinant = solve(graph, [[x, one], [one, zero]], [[one], [graph.number(5.0)]])
    values = value_of(graph, {"x": 0.0})
    assert [values[row[0]] for row in solution] == [5.0, 1.0]
    assert abs(values[determinant]) == 1.0


@pytest.mark.parametrize("is_varying", [True, False])
@pytest.mark.parametrize(
    "matrix", [[[0.0]], [[1.0, 2.0], [0.0, 0.0]], [[0.0, 1.0, 2.0], [0.0, 3.0, 4.0], [0.0, 5.0, 7.0]]]
)
def test_a_matrix_that_is_singular_by_structure_is_refused(matrix, is_varying):
    with pytest.raises(ModelError, match=r"^the linear system is singular whatever the values"):
        solve(Numbers(float, is_varying), matrix, [[1.0]] * len(matrix))


def test_equal_rows_of_symbols_are_refused():
    graph = Graph()
    a, b = (graph.symbol(name, varying=True) for name in "ab")
    with pytest.raises(ModelError, match="singular"):
        solve(graph, [[a, b], [a, b]], [[graph.number(1.0)], [graph.number(2.0)]])
