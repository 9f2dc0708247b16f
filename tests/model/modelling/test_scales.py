"""Units: SI declarations become the tables of the source document."""

import math

import numpy as np
import pytest

from masking.errors import DeclarationError, ModelError
from masking.model.declaration import registry
from masking.model.modelling.model import Model


def setup():
    return Model(registry.load_model("setup"))


def test_table_b1_becomes_tables_4_2_and_4_4():
    # Rijlaarsdam (2008), Tables 4.2 and 4.4 to one unit of the last printed digit, lam as nu c / (l wbar^2)
    found = setup().dimensionless().parameter_values()
    printed = {
        "w1": (0.9443, 1e-4), "w2": (1.0557, 1e-4), "w3": (0.7325, 1e-4),
        "z1": (0.3362, 1e-4), "z2": (0.4296, 1e-4), "z3": (0.0409, 1e-4),
        "mu1": (0.0411, 1e-4), "mu2": (0.0578, 1e-4),
        "c1": (9.945, 1e-3), "c2": (11.05, 1e-2), "c3": (0.5984, 1e-4),
    }  # fmt: skip
    for name, (value, digit) in printed.items():
        assert found[name] == pytest.approx(value, abs=digit), name


def test_the_scales_are_those_of_the_document():
    # wbar = (w1 + w2)/2 = 13.2929 rad/s, l = 5 mm, nu = 0.42 V
    model = setup()
    scales = model.units.scale_values({})
    assert scales == pytest.approx({"time": 1 / 13.2929, "length": 0.005, "voltage": 0.42}, rel=1e-5)
    assert model.units.size("m/s**2/V", {}) == pytest.approx(0.005 * 13.2929**2 / 0.42, rel=1e-5)


def test_scales_follow_the_parameters_they_are_made_of():
    slow = setup().with_parameters(w1=1.0, w2=3.0)
    assert slow.dimensionless().value("w2") == pytest.approx(3.0 / 2.0)
    assert slow.dimensionless().value("c3") == pytest.approx(1.2589 * 0.42 / (0.005 * 2.0**2))


def test_duffing_in_si_units_is_duffing():
    # digest, section 6: Table 7.2 prints th = 7.4524e-7 where beta l^2 / wbar^2 = 0.3333
    si = Model(registry.load_model("duffing_si")).dimensionless()
    assert si.value("beta") == pytest.approx(1 / 3, abs=5e-5)
    assert si.value("w") == pytest.approx(1.0)
    assert si.value("w3") == pytest.approx(0.5316, abs=5e-5)
    duffing = Model(registry.load_model("duffing"))
    duffing = duffing.with_parameters(th1=si.value("beta"), th2=si.value("beta"), w3=si.value("w3"))
    times = np.linspace(0.0, 50.0, 51)
    np.testing.assert_allclose(si.simulate(times).states, duffing.simulate(times).states, rtol=0, atol=1e-8)


def test_a_trajectory_in_si_units_is_the_dimensionless_one_measured_in_its_scales():
    model = Model(registry.load_model("duffing_si"))
    times = np.linspace(0.0, 20.0, 21)
    second = 1 / 18.3157
    si, plain = model.simulate(times * second), model.dimensionless().simulate(times)
    np.testing.assert_allclose(si.positions / 0.005, plain.positions, rtol=0, atol=1e-8)
    np.testing.assert_allclose(si.velocities / 0.005 * second, plain.velocities, rtol=0, atol=1e-8)
    np.testing.assert_allclose(plain.states[0], [-0.6, -0.5, 0, 0, 0, 0], atol=1e-15)


def test_initial_values_are_given_in_declared_units(declared):
    model = declared(
        coordinates={"x": {"unit": "mm", "initial": 3}},
        parameters={"w": {"value": 2, "unit": "rad/s"}, "l": {"value": 6, "unit": "mm"}},
        equations={"x''": "-w**2*x"},
        scales={"time": {"value": "1/w", "unit": "s"}, "length": {"value": "l", "unit": "m"}},
    )
    np.testing.assert_allclose(model.initial_state({"x'": 12}), [0.003, 0.012])
    np.testing.assert_allclose(model.dimensionless().initial_state({"x'": 12}), [0.5, 1.0])


def test_a_value_outside_its_bounds_is_refused_in_its_own_unit():
    with pytest.raises(DeclarationError, match=r"parameters\.w1\.value: w1 = -1 rad/s is below its lower bound 0$"):
        setup().with_parameters(w1=-1.0)
    with pytest.raises(DeclarationError, match=r"parameters\.mu1\.value: mu1 = 1\.5 is above its upper bound 1$"):
        Model(registry.load_model("huygens")).with_parameters(mu1=1.5)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_no_number_is_refused(value):
    with pytest.raises(DeclarationError, match=r"parameters\.c1\.value: c1 = -?(nan|inf) m/s\*\*2/V is not finite$"):
        setup().with_parameters(c1=value)


def test_an_unknown_parameter_gets_the_nearest_name():
    with pytest.raises(DeclarationError, match=r"has no parameter 'mu_1'; did you mean 'mu1'\?$"):
        setup().with_parameters(mu_1=0.1)


def test_a_scale_must_be_positive():
    with pytest.raises(DeclarationError, match=r"scales\.length: the scale is 0 m; a scale must be positive$"):
        setup().with_parameters(l=0.0).dimensionless().values()


def test_units_without_scales_cannot_become_dimensionless():
    model = Model(registry.load_model("setup_lagrangian"))
    with pytest.raises(
        ModelError, match=r"^set-up from its Lagrangian has units but no scales: declare scales, such as"
    ):
        model.dimensionless()


def test_scales_must_express_every_unit(declared):
    model = declared(
        coordinates={"x": {"unit": "m"}},
        parameters={"w": {"value": 2, "unit": "rad/s"}},
        equations={"x''": "-w**2*x"},
        scales={"time": {"value": "1/w", "unit": "s"}},
    )
    with pytest.raises(DeclarationError, match=r"coordinates\.x\.unit: .* no scale for length; add to scales"):
        model.dimensionless().values()


def test_a_model_without_units_is_dimensionless_as_it_is(declared):
    model = declared(coordinates={"x": {"initial": 0}}, parameters={"w": 2}, equations={"x''": "-w**2*x"})
    assert model.dimensionless() is model
