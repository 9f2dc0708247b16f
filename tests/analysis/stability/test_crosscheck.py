"""Certificates against truths from elsewhere: eigenvalues of matrices written by hand, and scipy's simulations."""

import numpy as np
import pytest
import sympy as sp

from masking.analysis.stability.crosscheck import contradiction
from masking.analysis.stability.energy_certificate import certificate
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.lasalle import Family, InvariantSet
from masking.model.modelling.model import load_model


def on_beam(*values):
    """Return two oscillators on a damped beam of mass 1 and stiffness 90, by texts or numbers."""
    texts = dict(zip(("m1", "k1", "m2", "k2"), values, strict=True))
    return {
        "coordinates": {x: {"initial": 0.1} for x in ("x1", "x2", "x3")},
        "parameters": {n: {"value": x} for n, x in texts.items()},
        "lagrangian": "(m1*x1'**2 + m2*x2'**2 + x3'**2 - k1*(x1 - x3)**2 - k2*(x2 - x3)**2 - 90*x3**2)/2",
        "dissipation": "0.8*x3'**2/2",
    }


def test_the_set_up_whose_frequencies_agree_keeps_its_anti_phase_motion():
    model = load_model("setup_lagrangian").with_parameters(m1=0.041, k1=7.38, m2=0.058, k2=10.44, b1=0.0, b2=0.0)
    found = certificate(model)
    assert "k1*m2 - k2*m1 = 0" in found.hypotheses
    assert "x1 = 0, x2 = 0" not in found.conclusion
    assert found.conclusion.endswith("m1*x1/m2 + x2 = 0, x3 = 0, m1*x1'/m2 + x2' = 0, x3' = 0")


def test_a_coincidence_is_named(declared):
    found = certificate(declared(**on_beam(0.041, 7.38, 0.058, 10.440000001)))
    assert found.status == "open"
    assert "k1*m2 - k2*m1 is not 0 at the declared values, but 0 within 1e-9 of them" in found.conclusion
    assert "proved" not in str(found)


@pytest.mark.parametrize(("one", "two"), [("2*pi*0.1", "pi/5"), ("sqrt(7.38/0.041)", "6*sqrt(5)")])
def test_frequencies_that_are_equal_and_no_fractions(declared, one, two):
    """A damper between two equal oscillators leaves the motion in phase alone."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 1}, "y": {"initial": 1}},
            parameters={"w": {"value": one}, "u": {"value": two}},
            equations={"x''": "-w**2*x - (x' - y')/5", "y''": "-u**2*y - (y' - x')/5"},
            energy="(x'**2 + y'**2 + w**2*x**2 + u**2*y**2)/2",
        )
    )
    assert found.status == "proved"
    (family,) = found.invariant.families
    assert len(family.relations) == 2


@pytest.mark.parametrize(
    ("linear", "cubic"), [("1.1000000000001", "0"), ("1.1000000000001", "0.3"), ("1.1", "0.3000000000001")]
)
def test_a_coincidence_of_numbers_is_seen_by_modes_or_simulation(declared, linear, cubic):
    """Springs 1.1 and `linear`, 0.3 (or 0) and `cubic`, are in no parameter, so that no hypothesis tells them."""
    first = f"(1.1*(x1 - x3) + {'0' if cubic == '0' else '0.3'}*(x1 - x3)**3)"
    second = f"({linear}*(x2 - x3) + {cubic}*(x2 - x3)**3)"
    found = certificate(
        declared(
            coordinates={"x1": {"initial": 1}, "x2": {"initial": -1}, "x3": {"initial": 0}},
            equations={"x1''": f"-{first}", "x2''": f"-{second}", "x3''": f"{first} + {second} - x3 - x3'"},
            energy=f"(x1'**2 + x2'**2 + x3'**2 + x3**2 + 1.1*(x1 - x3)**2 + {linear}*(x2 - x3)**2)/2"
            f" + {'0' if cubic == '0' else '0.3'}*(x1 - x3)**4/4 + {cubic}*(x2 - x3)**4/4",
        )
    )
    assert found.status == "open"
    assert "outside of this set" in found.conclusion


def test_the_theorem_alone_is_no_result(declared):
    oscillators = ("x1", "x2", "x3")
    forces = {x: f"(({x} - y) + ({x} - y)**5)" for x in oscillators}
    found = certificate(
        declared(
            coordinates={x: {"initial": 0.1} for x in (*oscillators, "y")},
            equations={
                **{f"{x}''": f"-{f}" for x, f in forces.items()},
                "y''": f"{'+'.join(forces.values())} - y - y'",
            },
            energy=" + ".join(f"{x}'**2/2 + ({x} - y)**2/2 + ({x} - y)**6/6" for x in oscillators)
            + " + (y'**2 + y**2)/2",
        )
    )
    assert found.status == "open"
    assert found.conclusion == "every motion converges to the largest invariant set on which V' = 0"


# What contradicts a proof that is not so


def rest_alone(motion):
    """Return the false claim that nothing but rest at 0 keeps its energy."""
    return InvariantSet(True, (Family((*motion.q, *motion.v)),))


def test_modes_contradict_a_false_proof(declared):
    model = declared(**on_beam(0.041, 7.38, 0.058, 10.44))
    motion = Motion(model, Hypotheses(model))
    against = contradiction(motion, [motion.v[2]], rest_alone(motion), is_bounded=True)
    assert f"a mode of frequency {np.sqrt(180):.6g} does not decay" in against


def test_a_mode_that_decays_as_slowly_as_rounding_contradicts_nothing(declared):
    """Its eigenvalue has the real part -c/2 = -5e-14, by the formula of a damped oscillator."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 1}, "y": {"initial": 1}},
            parameters={"c": {"value": 1e-13}, "b": {"value": 1}},
            equations={"x''": "-x - c*x'", "y''": "-y - b*y'"},
            energy="(x'**2 + y'**2 + x**2 + y**2)/2",
        )
    )
    assert found.status == "proved"
    assert found.conclusion == "every motion converges to the set x = 0, y = 0, x' = 0, y' = 0"


def test_simulated_motions_contradict_a_false_proof():
    model = load_model("duffing").dimensionless()
    motion = Motion(model, Hypotheses(model))
    against = contradiction(motion, [motion.v[2]], rest_alone(motion), is_bounded=True)
    assert "keeps its energy outside of this set" in against


def test_simulated_motions_contradict_an_energy_that_is_said_not_to_grow(declared):
    model = declared(coordinates={"x": {"initial": 0.5}}, equations={"x''": "-x + 0.1*x'"}, energy="(x'**2 + x**2)/2")
    motion = Motion(model, Hypotheses(model))
    assert "gains energy" in contradiction(motion, (), None, is_bounded=True)


def test_a_certificate_that_is_contradicted_is_withdrawn(declared, monkeypatch):
    monkeypatch.setattr(
        "masking.analysis.stability.energy_certificate.invariant_set", lambda motion, forms: rest_alone(motion)
    )
    found = certificate(declared(**on_beam(0.041, 7.38, 0.058, 10.44)))
    assert found.status == "open"
    assert "does not decay" in found.conclusion
    assert "proved" not in str(found)


# Values as they are written


def test_values_are_the_decimals_that_are_written(declared):
    model = declared(
        coordinates={"x": {"initial": 0}},
        parameters={"m": {"value": 0.0413}, "k": {"value": "180*m"}, "w": {"value": "sqrt(2*k/m)"}},
        equations={"x''": "-k/m*x"},
    )
    assert model.exact_values() == {"m": sp.Rational(413, 10**4), "k": sp.Rational(7434, 1000), "w": 6 * sp.sqrt(10)}
    assert model.with_parameters(m=0.1).exact_values()["k"] == 18


def test_units_are_converted_exactly(declared):
    model = declared(
        coordinates={"x": {"initial": 0, "unit": "m"}},
        parameters={"m": {"value": 41, "unit": "g"}, "k": {"value": 0.00738, "unit": "N/mm"}},
        equations={"x''": "-k/m*x"},
    )
    assert model.exact_values() == {"m": sp.Rational(41, 1000), "k": sp.Rational(738, 100)}


@pytest.mark.parametrize("name", ["setup_lagrangian", "duffing", "huygens", "discs_eccentric"])
def test_exact_values_are_those_of_the_compiled_functions(name):
    model = load_model(name)
    model = model.dimensionless() if model.declaration.scales else model
    exact = [float(x) for x in model.exact_values().values()]
    np.testing.assert_allclose(exact, model.values(), rtol=1e-14, atol=0.0)
