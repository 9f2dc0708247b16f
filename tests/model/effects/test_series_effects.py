"""Elements with a force of their own, and effects in series with them or in their place, against closed forms."""

import itertools
import math

import numpy as np
import pytest

from masking import load_model
from masking.errors import DeclarationError
from masking.inference.discovery.places import opened, taken
from masking.model.modelling.model import Model

M, K, C = 2.0, 8.0, 0.6
W = math.sqrt(K / M)


@pytest.fixture
def spring(declared):
    """Return m x'' = u with a spring and damper that declares its own force."""

    def make(**changes):
        content = {
            "coordinates": {"x": {"initial": 1.0}},
            "parameters": {"m": M, "k": K, "c": 0.0},
            "equations": {"m*x''": "0"},
            "elements": {"spring": {"displacement": "x", "force": "k*d + c*d_rate", "acts": {"x": -1}}},
        }
        return declared(**content | changes)

    return make


def eigenvalues(model):
    """Return the eigenvalues of a linear model at 0, by differences of its derivative."""
    n = 2 * len(model.declaration.coordinates) + len(model.declaration.states)
    columns = []
    for unit in np.eye(n):
        rates = [np.empty(n), np.empty(n)]
        for rate, y in zip(rates, (unit, -unit), strict=True):
            model.kernels.derivative(0.0, y, np.empty(0), model.values(), rate)
        columns.append((rates[0] - rates[1]) / 2.0)
    return np.sort_complex(np.linalg.eigvals(np.array(columns).T))


def test_the_force_of_an_element_acts_as_it_says(spring):
    model = spring(parameters={"m": M, "k": K, "c": C})
    np.testing.assert_allclose(eigenvalues(model), np.sort_complex(np.roots([M, C, K])))


def test_the_force_acts_on_outputs_and_rates_of_states_too(declared):
    model = declared(
        states={"w": {"initial": 1.0}}, parameters={"b": 3.0}, equations={"w'": "0"}, outputs={"torque": "0"},
        elements={"shaft": {"rate": "w", "force": "b*d_rate", "acts": {"w": -1, "torque": 2}}},
    )  # fmt: skip
    assert model.simulate([0.0, 0.5])["w"][-1] == pytest.approx(math.exp(-1.5), rel=1e-8)
    assert str(model.equations.output("torque")) == "2*b*w"


def test_play_lengthens_the_period_by_the_time_in_its_gap(spring):
    gap = 0.4
    model = spring().attach("play", "spring", gap=gap)
    period = 2.0 * math.pi / W + 2.0 * gap / (W * (1.0 - gap / 2.0))  # at constant speed through the gap, twice
    assert model.simulate([0.0, period])["x"][-1] == pytest.approx(1.0, abs=1e-7)


def test_a_bilinear_spring_has_half_a_period_of_each_stiffness(spring):
    model = spring().attach("bilinear_spring", "spring", k=3.0 * K)
    assert model.simulate([0.0, 1.5 * math.pi / W])["x"][-1] == pytest.approx(1.0, abs=1e-7)


def test_asymmetric_damping_has_half_a_swing_of_each_damping(spring):
    more = 1.1
    model = spring(parameters={"m": M, "k": K, "c": C}).attach("asymmetric_damping", "spring", c=more)
    turns, x = 0.0, 1.0  # it goes down with the declared damping, and up with more
    for damping in (C, C + more):
        sigma = damping / (2.0 * M)
        swing = math.pi / math.sqrt(W**2 - sigma**2)
        turns, x = turns + swing, -x * math.exp(-sigma * swing)
        assert model.simulate([0.0, turns])["x"][-1] == pytest.approx(x, rel=1e-6)


@pytest.mark.parametrize("hold", [10.0, 1e4])
def test_a_slider_that_is_dragged_with_play_takes_its_work_from_each_swing(spring, hold):
    """From one turning point to the next it is dragged over their distance but for the gap, and takes that work.

    How fast it is held where it should be does not count: it moves with its pin.
    """
    fc, gap = 0.3, 0.4
    model = spring().attach("play_with_friction", "spring", fc=fc, gap=gap, x0=1e-6, hold=hold)
    t = np.linspace(0.0, 6.0, 60001)
    found = model.simulate(t, {"x": 0.0, "x'": 2.0 * W}, tolerance=1e-9)
    x, v = found["x"], found["x'"]
    turns = np.abs(x[1:-1][(v[1:-1] > 0) != (v[2:] > 0)])
    assert len(turns) == 4
    for first, then in itertools.pairwise(turns):
        assert K / 2 * (first**2 - then**2) == pytest.approx(fc * (first + then - gap), rel=1e-3)


def test_a_maxwell_element_takes_the_place_of_the_spring(spring):
    k, tau = 5.0, 0.7
    model = spring().attach("maxwell_element", "spring", k=k, tau=tau)
    # m s^2 x + k tau s/(1 + tau s) x = 0
    expected = np.roots([M * tau, M, k * tau, 0.0])
    np.testing.assert_allclose(eigenvalues(model), np.sort_complex(expected), atol=1e-10)
    off = model.with_parameters(spring_maxwell_element_on=0.0)
    assert off.simulate([0.0, math.pi / W])["x"][-1] == pytest.approx(-1.0, abs=1e-7)


def test_relaxation_makes_a_standard_linear_solid(spring):
    k, tau = 5.0, 0.7
    model = spring().attach("relaxation", "spring", k=k, tau=tau)
    expected = np.roots([M * tau, M, (K + k) * tau, K])
    np.testing.assert_allclose(eigenvalues(model), np.sort_complex(expected), atol=1e-10)


def test_an_oscillator_on_the_mass_splits_its_frequency(spring):
    m, nu, zeta = 0.3, 0.8, 0.02
    model = spring().attach("attached_oscillator", "spring", m=m, nu=nu, zeta=zeta)
    w = (
        2.0 * math.pi * nu
    )  # Den Hartog (1985), section 3.2: (M s^2 + K)(s^2 + 2 zeta w s + w^2) + m s^2 (2 zeta w s + w^2)
    own, carried = [1.0, 2.0 * zeta * w, w**2], [2.0 * zeta * w * m, w**2 * m, 0.0, 0.0]
    expected = np.roots(np.polyadd(np.polymul([M, 0.0, K], own), carried))
    np.testing.assert_allclose(eigenvalues(model), np.sort_complex(expected), atol=1e-9)


def test_what_needs_a_force_of_the_element_is_refused_without(spring):
    elements = {"spring": {"displacement": "x", "acts": {"x": -1}}}
    with pytest.raises(DeclarationError, match="'spring' declares none; give elements"):
        spring(equations={"m*x''": "-k*x - c*x'"}, elements=elements).attach("play", "spring", gap=0.1)
    with pytest.raises(DeclarationError, match="that of 'beam' has definitions that hold coordinates; write it over d"):
        load_model("setup_springs").attach("play", "beam", gap=0.1)


def test_a_force_of_another_unit_than_its_element_is_refused(declared):
    with pytest.raises(DeclarationError, match=r"the unit of the element is kg\*m/s\*\*2, its force is kg\*m\*\*2"):
        declared(
            coordinates={"x": {"unit": "m"}},
            parameters={"m": {"value": 1, "unit": "kg"}, "k": {"value": 1, "unit": "N"}},
            equations={"m*x''": "0"},
            elements={"spring": {"displacement": "x", "unit": "N", "force": "k*d", "acts": {"x": -1}}},
        ).validate()  # fmt: skip


@pytest.mark.parametrize(
    ("force", "names"), [("k*d", "mk"), ("c*d_rate", "mc"), ("k*d + c*d_rate", "mkc"), ("k", "mk")]
)
def test_an_element_whose_force_follows_a_part_of_its_motion_can_be_in_series(spring, force, names):
    element = {"displacement": "x", "force": force, "acts": {"x": -1}}
    made = spring(parameters=dict.fromkeys(names, 2.0), elements={"spring": element})
    open_to_effects = Model(opened(made.declaration)[0])
    open_to_effects.validate()
    values = open_to_effects.parameter_values()
    assert {*taken("spring")} <= values.keys()
    rates = [np.empty(2), np.empty(2)]
    for rate, model in zip(rates, (made, open_to_effects), strict=True):
        model.kernels.derivative(0.0, np.array([0.3, -0.7]), np.empty(0), model.values(), rate)
    assert np.array_equal(*rates)
