"""Derivatives of graphs: every operation against sympy and against central differences."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

from masking.compile.codegen.graph import NOT_ANALYTIC, Graph
from masking.compile.codegen.printers import statements
from masking.compile.codegen.tangent import RULES, SWITCHES, derivatives
from masking.model.declaration.expression import Expression
from tests.support.python_language import PYTHON

# Functions that give nan where the standard library raises, as compiled code does.
QUIET = SimpleNamespace(
    **{f: getattr(np, f) for f in ("sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log")},
    **{f: getattr(np, f"arc{f[1:]}") for f in ("asin", "acos", "atan", "atan2")},
)
X, Y = sp.symbols("x y", real=True)


def evaluated(graph, nodes, **values):
    """Return the values of nodes, computed by the Python that is printed for them."""
    lines = statements(graph, [(f"out[{i}]", node) for i, node in enumerate(nodes)], PYTHON)
    out = np.empty(len(nodes))
    known = {"math": QUIET, "np": np, "out": out, **{name: np.float64(value) for name, value in values.items()}}
    with np.errstate(all="ignore"):
        exec("\n".join(lines), known)  # noqa: S102  # the printed code
    return out


def gradient(text, x, y):
    """Return the value of an expression and its derivatives with respect to x and y, from the graph."""
    graph = Graph()
    nodes = [graph.symbol(name, varying=True) for name in "xy"]
    root = graph.lower(Expression(text).to_sympy({"x": X, "y": Y}), dict(zip((X, Y), nodes, strict=True)))
    (row,) = derivatives(graph, [root], nodes)
    return evaluated(graph, [root, *row], x=x, y=y)


SMOOTH = [
    "x + y - 2*x*y", "-x/y", "x**3*y**2", "(x + 2)**1.7", "(x + 2)**(y/3)", "sqrt(x + 2)*y", "exp(-x)*log(y + 2)",
    "sin(x)*cos(y) + tan(x*y)", "asin(x/3) + acos(y/4) + atan(x - y)", "sinh(x)*cosh(y) - tanh(x + y)",
    "atan2(x, y)", "1/(1 + x**2*y**4)",
]  # fmt: skip
POINTS = [(0.7, 1.1), (-0.4, 0.9), (0.2, 1.6)]


@pytest.mark.parametrize("text", SMOOTH)
@pytest.mark.parametrize(("x", "y"), POINTS)
def test_smooth_expressions_have_the_derivatives_of_sympy(text, x, y):
    symbolic = Expression(text).to_sympy({"x": X, "y": Y})
    expected = [float(e.subs({X: x, Y: y})) for e in (symbolic, symbolic.diff(X), symbolic.diff(Y))]
    np.testing.assert_allclose(gradient(text, x, y), expected, rtol=1e-12, atol=1e-13)


SWITCHED = [
    "abs(x - y)*x", "min(x, y, x*y)", "max(x**2, y - x)", "where(x < 0.1, x**2, y**3)", "where(y <= 1, x*y, x/y)",
    "sign(x)*y", "heaviside(x)*y**2", "where(x > 0, sqrt(max(x, 0)), -x)",
]  # fmt: skip


@pytest.mark.parametrize("text", SWITCHED)
@pytest.mark.parametrize(("x", "y"), POINTS)
def test_switched_expressions_have_the_differences_away_from_their_switches(text, x, y):
    expression, h = Expression(text), 1e-6
    found = gradient(text, x, y)
    for i, (dx, dy) in enumerate(((h, 0.0), (0.0, h)), start=1):
        ahead, behind = (expression.evaluate({"x": x + s * dx, "y": y + s * dy}) for s in (1, -1))
        assert found[i] == pytest.approx((ahead - behind) / (2 * h), rel=1e-7, abs=1e-8)


def test_what_is_not_chosen_does_not_count_even_where_it_is_not_a_number():
    assert gradient("where(x < 0, log(y + 2), sqrt(x))", -1.0, 0.5) == pytest.approx([math.log(2.5), 0.0, 0.4])


def test_a_stair_counts_as_the_line_through_it():
    assert gradient("0.5*floor(x/0.5 + 1/2) + x*y", 0.7, 1.1) == pytest.approx([0.5 + 0.77, 2.1, 0.7])


def test_every_operation_has_a_derivative():
    known = {*RULES, *SWITCHES}
    assert known >= set(NOT_ANALYTIC)
    names = {name for name in (*PYTHON.templates, "add", "sub", "mul", "div", "neg") if not name.startswith("_")}
    assert names <= known


def test_a_node_that_does_not_depend_on_a_symbol_has_no_derivative():
    graph = Graph()
    x, y = (graph.symbol(name, varying=True) for name in "xy")
    rows = derivatives(graph, [graph.mul(x, x), graph.number(3.0)], [y])
    assert all(graph.is_number(node, 0.0) for row in rows for node in row)
