"""The largest Lyapunov exponent: textbook systems, closed forms, and scipy beside it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.stability.lyapunov_exponent import largest_exponent
from masking.analysis.stability.variational_equations import Variational
from masking.errors import ModelError
from masking.model.modelling.model import load_model


@pytest.fixture(scope="module")
def lorenz(declared):
    return declared(
        states={"x": {"initial": 1.0}, "y": {"initial": 1.0}, "z": {"initial": 20.0}},
        parameters={"sigma": 10, "r": 28, "b": "8/3"},
        equations={"x'": "sigma*(y - x)", "y'": "x*(r - z) - y", "z'": "x*y - b*z"},
    )


@pytest.fixture(scope="module")
def ueda(declared):
    return declared(
        coordinates={"x": {"initial": 2.5}},
        parameters={"k": 0.05, "B": 7.5},
        equations={"x''": "-k*x' - x**3 + B*sin(t)"},
    )


def test_lorenz(lorenz):
    """Sprott, Chaos and Time-Series Analysis (2003), A.5.1: 0.9056."""
    found = largest_exponent(lorenz, 10_000.0, transient=50.0, interval=1.0)
    assert found.value == pytest.approx(0.9056, rel=0.02)
    assert found.error < 0.005
    assert found.is_chaotic
    assert str(found).startswith("chaotic: the largest Lyapunov exponent is 0.90")


def test_ueda(ueda):
    """Sprott (2003), A.4.5: x'' + 0.05 x' + x^3 = 7.5 sin t has 0.1034."""
    found = largest_exponent(ueda, 200_000.0, transient=200.0, interval=10.0)
    assert found.value == pytest.approx(0.1034, rel=0.02)
    assert found.is_chaotic


def test_a_ueda_oscillator_that_is_driven_less_is_not_chaotic(ueda):
    found = largest_exponent(ueda.with_parameters(B=0.2), 5000.0, transient=500.0)
    assert found.value < 0
    assert not found.is_chaotic


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_a_linear_oscillator(declared, damping):
    model = declared(coordinates={"x": {"initial": 1.0}}, parameters={"c": damping}, equations={"x''": "-x - 2*c*x'"})
    found = largest_exponent(model, 2000.0)
    assert found.value == pytest.approx(-damping, abs=1e-3)
    assert not found.is_chaotic


def test_a_regular_motion_whose_neighbours_part_as_time_does(declared):
    model = declared(coordinates={"x": {"initial": 1.0}}, equations={"x''": "-x**3"})
    found = largest_exponent(model, 5000.0)
    assert 0 < found.value < 3 * np.log(5000.0) / 5000.0
    assert not found.is_chaotic


@pytest.mark.parametrize("name", ["huygens_lagrangian", "discs_eccentric", "duffing"])
def test_the_tangent_is_scipys(name):
    """w' = J w with J from central differences of the model's compiled derivative, integrated by scipy."""
    model = load_model(name).dimensionless()
    y, p, u = model.initial_state({}), model.values(), np.zeros(len(model.inputs))
    size = len(y)

    def slope(t, state):
        rate = np.empty(size)
        model.kernels.derivative(t, np.ascontiguousarray(state), u, p, rate)
        return rate

    def both(t, state):
        y, w = state[:size], state[size:]
        h = 1e-6
        return np.concatenate([slope(t, y), (slope(t, y + h * w) - slope(t, y - h * w)) / (2 * h)])

    w = np.eye(size)[0]
    expected = solve_ivp(both, (0, 30), [*y, *w], "DOP853", rtol=1e-9, atol=1e-12).y[:, -1]
    found = np.concatenate(Variational(model, 1).along((0.0, 30.0), y, w[:, None], tolerance=1e-11), axis=None)
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_the_clocks_are_not_chaotic():
    found = largest_exponent(load_model("huygens").dimensionless(), 2000.0)
    assert not found.is_chaotic


def test_what_has_no_exponent(declared, lorenz):
    with pytest.raises(ModelError, match="the duration at least 20 intervals"):
        largest_exponent(lorenz, 10.0, interval=1.0)
    empty = declared(inputs={"u": "force"}, outputs={"y": "2*u"})
    with pytest.raises(ModelError, match="it does not move"):
        largest_exponent(empty, 100.0)


def test_a_motion_that_goes_off_is_not_chaotic(declared):
    grows = declared(coordinates={"x": {"initial": 1.0}}, equations={"x''": "-x + 0.1*x'"})
    found = largest_exponent(grows, 400.0)
    assert found.value == pytest.approx(0.05, rel=1e-2)
    assert (found.is_bounded, found.is_chaotic) == (False, False)
    assert str(found).startswith("unbounded: the largest Lyapunov exponent is 0.05")
