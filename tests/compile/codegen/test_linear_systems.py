"""Linear systems: the same solutions as numpy's, wherever entries vanish, and a word where there are none."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from masking.compile.codegen.graph import Graph
from masking.compile.codegen.linear_systems import health, solve
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


def product(divisors):
    """Return what is, up to its sign, the determinant: the product of all pivots."""
    return math.prod(one.value for one in divisors)


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
    found, divisors = solve(Numbers(float, is_varying), matrix.tolist(), right.tolist())
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * (1.0 + np.abs(expected).max()))
    assert abs(product(divisors)) == pytest.approx(abs(np.linalg.det(matrix)), rel=1e-9)


@settings(max_examples=50, deadline=None)
@given(systems(6, 8), st.booleans())
def test_large_systems_are_solved_exactly_in_exact_arithmetic(system, is_varying):
    matrix, right = system
    assume(abs(np.linalg.det(np.array(matrix))) > 0.5)  # of integers, so it is not zero
    exact = Numbers(Fraction, is_varying)
    found, divisors = solve(exact, *([[Fraction(x) for x in row] for row in part] for part in system))
    n = len(matrix)
    assert [[sum(matrix[i][j] * found[j][k] for j in range(n)) for k in (0, 1)] for i in range(n)] == right
    assert abs(product(divisors)) == round(abs(np.linalg.det(np.array(matrix))))


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, math.pi, 0.3])
def test_a_rotation_is_inverted_where_its_diagonal_vanishes(angle):
    graph = Graph()
    c, s = (graph.symbol(name, varying=True) for name in "cs")
    solution, divisors = solve(graph, [[c, graph.apply("neg", s)], [s, c]], [[graph.number(2)], [graph.number(3)]])
    values = value_of(graph, {"c": round(math.cos(angle), 15), "s": round(math.sin(angle), 15)})
    # the inverse of a rotation is its transpose
    assert values[solution[0][0]] == pytest.approx(2 * math.cos(angle) + 3 * math.sin(angle), abs=1e-12)
    assert values[solution[1][0]] == pytest.approx(3 * math.cos(angle) - 2 * math.sin(angle), abs=1e-12)
    assert abs(values[divisors[0].value]) == pytest.approx(1.0, abs=1e-12)


def value_of(graph, symbols):
    """Return the value of each node; a graph is in computable order."""
    do = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b}
    do["div"] = lambda a, b: a / b if b else math.inf
    do |= {"neg": lambda a: -a, "abs": abs, "min": min, "sign": np.sign}
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
    solution, divisors = solve(graph, [[x, one], [one, zero]], [[one], [graph.number(5.0)]])
    values = value_of(graph, {"x": 0.0})
    assert [values[row[0]] for row in solution] == [5.0, 1.0]
    assert graph.is_number(health(graph, divisors), 1.0)


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


def tridiagonal(graph, size):
    """Return the mass matrix of a chain of arms, each hung on the one before, with entries that vary."""
    varies = [graph.symbol(f"a{i}", varying=True) for i in range(size)]
    zero, two = graph.number(0.0), graph.number(2.0)
    rows = [[zero] * size for _ in range(size)]
    for i in range(size):
        rows[i][i] = graph.add(two, varies[i])
        if i + 1 < size:
            rows[i][i + 1] = rows[i + 1][i] = graph.sub(graph.number(0.0), graph.mul(varies[i], varies[i]))
    return rows


def arrow(graph, size):
    """Return the mass matrix of arms on a beam, which is the last coordinate."""
    zero, corner = graph.number(0.0), graph.symbol("M", varying=False)
    rows = [[zero] * size for _ in range(size)]
    for i in range(size - 1):
        rows[i][i] = graph.symbol("m", varying=False)
        rows[i][-1] = rows[-1][i] = graph.mul(rows[i][i], graph.symbol(f"c{i}", varying=True))
    rows[-1][-1] = corner
    return rows


@pytest.mark.parametrize("make", [tridiagonal, arrow])
def test_the_work_of_chains_and_beams_grows_with_their_size(make):
    """A band and an arrow are factorised without fill-in, so that each unknown takes equally many operations."""
    counts = []
    for size in (20, 40, 80):
        graph = Graph()
        rows = make(graph, size)
        before = len(graph.operations)
        health(graph, solve(graph, rows, [[graph.symbol(f"f{i}", varying=True)] for i in range(size)])[1])
        counts.append(len(graph.operations) - before)
    assert counts[2] - counts[1] == pytest.approx(2 * (counts[1] - counts[0]), rel=0.02)


@pytest.mark.parametrize("make", [tridiagonal, arrow])
def test_sparse_systems_are_solved_as_numpy_solves_them(make):
    graph = Graph()
    rows = make(graph, 30)
    right = [[graph.number(float(i % 7) - 3.0)] for i in range(30)]
    solution, _ = solve(graph, rows, right)
    rng = np.random.default_rng(1)
    names = [n for operation, *rest in graph.operations if operation == "symbol" for n in rest]
    values = value_of(graph, {**dict(zip(names, rng.uniform(-0.5, 0.5, len(names)), strict=True)), "m": 1.3, "M": 50.0})
    matrix = np.array([[values[x] for x in row] for row in rows])
    expected = np.linalg.solve(matrix, [values[r[0]] for r in right])
    np.testing.assert_allclose([values[x[0]] for x in solution], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_blocks_are_solved_by_themselves_wherever_their_entries_vanish():
    """Sixty planes, each turned by its own angle, some by a right angle; their inverse is the transpose."""
    graph, angles = Graph(), [math.pi / 2 * (i % 3) + 0.1 * (i % 2) for i in range(60)]
    rows = [[graph.number(0.0)] * 120 for _ in range(120)]
    for i in range(60):
        c, s = (graph.symbol(f"{name}{i}", varying=True) for name in "cs")
        rows[i][i], rows[i][i + 60], rows[i + 60][i], rows[i + 60][i + 60] = c, graph.apply("neg", s), s, c
    solution, divisors = solve(graph, rows, [[graph.number(1.0)]] * 120)
    found = health(graph, divisors)
    known = {f"c{i}": round(math.cos(x), 15) for i, x in enumerate(angles)}
    values = value_of(graph, known | {f"s{i}": round(math.sin(x), 15) for i, x in enumerate(angles)})
    expected = [math.cos(x) + math.sin(x) for x in angles] + [math.cos(x) - math.sin(x) for x in angles]
    np.testing.assert_allclose([values[x[0]] for x in solution], expected, rtol=0, atol=1e-12)
    assert values[found] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size", [3, 400])
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_health_neither_overflows_nor_falls_with_the_number_of_unknowns(size, unit):
    """Of a diagonal matrix it is the smallest cosine, whatever the masses, and 0 where a mass is 0."""
    graph = Graph()
    mass = [graph.symbol(f"m{i}", varying=False) for i in range(size)]
    rows = [[graph.number(0.0)] * size for _ in range(size)]
    for i in range(size):
        rows[i][i] = graph.mul(mass[i], graph.symbol(f"c{i}", varying=True))
    found = health(graph, solve(graph, rows, [[graph.number(1.0)]] * size)[1])
    masses = {f"m{i}": unit * (1 + i % 3) for i in range(size)}
    cosines = {f"c{i}": 0.7 + 0.001 * i % 0.2 for i in range(size)}
    assert value_of(graph, masses | cosines)[found] == pytest.approx(min(cosines.values()), rel=1e-12)
    assert value_of(graph, masses | cosines | {"c1": -1e-9})[found] == pytest.approx(-1e-9, rel=1e-12)
    assert value_of(graph, masses | cosines | {"m2": 0.0})[found] == 0.0


def test_a_pivot_counts_in_proportion_to_what_it_is_the_difference_of():
    """A chain of arms of 1e-6 kg m^2 beside a beam of 1 kg: what is nearest to singular is the beam."""
    graph = Graph()
    size, small = 8, graph.symbol("small", varying=False)
    rows = [[graph.number(0.0)] * size for _ in range(size)]
    for i in range(size - 1):
        rows[i][i] = graph.mul(small, graph.add(graph.number(2.0), graph.symbol(f"a{i}", varying=True)))
        rows[i][-1] = rows[-1][i] = graph.symbol(f"b{i}", varying=True)
    rows[-1][-1] = graph.symbol("M", varying=True)
    found = health(graph, solve(graph, rows, [[graph.number(1.0)]] * size)[1])
    known = {"small": 1e-6, **{f"a{i}": 0.0 for i in range(7)}, **{f"b{i}": 1e-3 for i in range(7)}}
    near = 7 * 1e-6 / 2e-6  # what all arms take from the beam
    values = [value_of(graph, known | {"M": near * (1.0 + part)})[found] for part in (1.0, 1e-6, -1e-6)]
    assert 0.1 < values[0] < 3.0
    assert 0.0 < values[1] < 1e-5 * values[0]
    assert values[2] < 0.0
