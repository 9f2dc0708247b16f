"""Tables in expressions: the curves of scipy, in every form that a model takes."""

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, PchipInterpolator

from masking.errors import DeclarationError
from masking.model.declaration.expression import Expression
from masking.model.modelling.model import load_model

X = np.array([-1.3, -0.6, -0.1, 0.25, 0.9, 1.0, 1.8])
Y = np.array([0.4, -0.8, 0.1, 0.3, 1.9, 2.0, 2.6])
GRID = np.linspace(X[0], X[-1], 301)
D = sp.Symbol("d", real=True)


def table(name, x, y, of="d"):
    pairs = zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True)
    return f"{name}({of}, {', '.join(f'{a!r}, {b!r}' for a, b in pairs)})"


def values(text, at):
    expression = Expression(text)
    return np.array([expression.evaluate({"d": float(x)}) for x in at])


def slopes(text, at):
    slope = sp.lambdify(D, Expression(text).to_sympy({"d": D}).diff(D), [{"Heaviside": np.heaviside}, "numpy"])
    return np.array([float(slope(x)) for x in at])


def test_a_table_is_the_natural_spline_of_scipy_with_its_derivative():
    truth, text = CubicSpline(X, Y, bc_type="natural"), table("interpolate", X, Y)
    np.testing.assert_allclose(values(text, GRID), truth(GRID), atol=1e-12)
    np.testing.assert_allclose(slopes(text, GRID[1:-1]), truth(GRID[1:-1], 1), atol=1e-10)


def test_a_monotone_table_is_that_of_scipy_between_its_last_pieces():
    truth, text = PchipInterpolator(X, Y), table("interpolate_monotone", X, Y)
    inner = GRID[(X[1] < GRID) & (X[-2] > GRID)]
    np.testing.assert_allclose(values(text, inner), truth(inner), atol=1e-12)
    np.testing.assert_allclose(slopes(text, inner), truth(inner, 1), atol=1e-10)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=3, max_size=12))
def test_a_monotone_table_of_rising_points_never_falls(steps):
    x = np.arange(len(steps), dtype=float)
    found = values(table("interpolate_monotone", x, np.cumsum(steps)), np.linspace(-1.0, len(steps), 200))
    assert (np.diff(found) > -1e-9).all()


@pytest.mark.parametrize("name", ["interpolate", "interpolate_monotone"])
def test_a_table_goes_through_its_points_and_on_in_straight_lines(name):
    text = table(name, X, Y)
    np.testing.assert_allclose(values(text, X), Y, atol=1e-12)
    for outside in (np.linspace(X[0] - 2.0, X[0], 5), np.linspace(X[-1], X[-1] + 2.0, 5)):
        np.testing.assert_allclose(np.diff(values(text, outside), 2), 0.0, atol=1e-10)


MODEL = """
name: spring of a table
coordinates: {{x: {{unit: m}}}}
parameters:
  l: {{value: 0.01, unit: m}}
  a: {{value: 0.2, unit: m/s**2}}
equations: {{"x''": "-a*{spring}"}}
"""


def test_a_model_with_a_table_moves_as_its_curve_says(tmp_path):
    curve, path = CubicSpline(X, Y, bc_type="natural"), tmp_path / "model.yaml"
    path.write_text(MODEL.format(spring=table("interpolate", X, Y, "x/l")))
    found = load_model(path).simulate([0.0, 0.05, 1.0], {"x": -0.008}, tolerance=1e-11)
    truth = solve_ivp(lambda t, y: [y[1], -0.2 * curve(y[0] / 0.01)], (0.0, 1.0), [-0.008, 0.0], rtol=1e-10, atol=1e-13)
    assert found["x"][-1] == pytest.approx(truth.y[0, -1], rel=1e-6)
    path.write_text(MODEL.format(spring=table("interpolate", X, Y, "x + l")))
    with pytest.raises(DeclarationError, match="takes interpolate of m; its argument must be dimensionless"):
        load_model(path).validate()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("interpolate(d, 0, 1, 0, 2)", "the x of a table must increase, and 0 comes after 0"),
        ("interpolate(d, 0, 1, a, 2)", "the points of a table are numbers"),
        ("interpolate(d, 0, 1, 1, 2, 3)", "a table has 2 points or more, each x and y"),
        ("interpolate(d, 0, 1)", "interpolate takes 5 or more arguments, not 3"),
    ],
)
def test_a_table_that_is_none_is_refused_in_words(text, said):
    with pytest.raises(DeclarationError, match=said.replace(".", "[.]")):
        Expression(text)
