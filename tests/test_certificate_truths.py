"""Certificates against truths from elsewhere: eigenvalues of matrices written by hand, and scipy's simulations."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from masking.analysis.stability.certificate import certificate
from masking.analysis.stability.crosscheck import contradiction
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.lasalle import Family, InvariantSet
from masking.analysis.stability.motion import Motion
from masking.modelling.model import load_model


def decays(mass, damping, stiffness):
    """Tell whether every mode of M a + C v + K q = 0 decays."""
    n = len(mass)
    lower = np.linalg.solve(mass, np.hstack([-np.array(stiffness), -np.array(damping)]))
    values = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower]))
    return bool(values.real.max() < -1e-12 * np.abs(values).max())


def speed_left(rates, start, duration):
    """Return the largest speed over the last tenth of a motion, of the largest of all."""
    n, times = len(start) // 2, np.linspace(0.0, duration, 2001)
    run = solve_ivp(lambda _, y: [*y[n:], *rates(y[:n], y[n:])], (0, duration), start, "DOP853", times, rtol=1e-10)
    speed = np.abs(run.y[n:]).max(axis=0)
    return speed[-200:].max() / speed.max()


def on_beam(*values, definitions=None, parameters=None):
    """Return two oscillators on a damped beam of mass 1 and stiffness 90, by texts or numbers."""
    texts = dict(zip(("m1", "k1", "m2", "k2"), values, strict=True))
    names = [n for n in texts if n not in (definitions or {})]
    return {
        "coordinates": {x: {"initial": 0.1} for x in ("x1", "x2", "x3")},
        "parameters": {n: {"value": texts[n]} for n in names} | (parameters or {}),
        "definitions": definitions or {},
        "lagrangian": "(m1*x1'**2 + m2*x2'**2 + x3'**2 - k1*(x1 - x3)**2 - k2*(x2 - x3)**2 - 90*x3**2)/2",
        "dissipation": "0.8*x3'**2/2",
    }


# The last column: whether anti-phase stays, since k1/m1 = k2/m2 in decimals.
BEAMS = {
    "k/m = 3": (on_beam(0.1, 0.3, 0.7, 2.1), (0.1, 0.3, 0.7, 2.1), True),
    "different by 1e-4": (on_beam(0.041, 7.38, 0.058, 10.441), (0.041, 7.38, 0.058, 10.441), False),
    "a sum in a definition": (
        on_beam(1, 0, 1, 0.3, definitions={"k1": "a + d"}, parameters={"a": {"value": 0.1}, "d": {"value": 0.2}}),
        (1, 0.3, 1, 0.3),
        True,
    ),
    "decimals in a definition": (on_beam(1, 0, 1, 0.3, definitions={"k1": "0.1 + 0.2"}), (1, 0.3, 1, 0.3), True),
    "an expression as value": (on_beam(0.041, 7.38, 0.058, "180*m2"), (0.041, 7.38, 0.058, 10.44), True),
}


@pytest.mark.parametrize("name", BEAMS)
def test_oscillators_on_a_beam_are_told_apart_by_their_decimals(declared, name):
    parts, (m1, k1, m2, k2), is_anti_phase = BEAMS[name]
    stiffness = np.array([[k1, 0, -k1], [0, k2, -k2], [-k1, -k2, 90 + k1 + k2]])
    found = certificate(declared(**parts))
    if is_anti_phase:
        assert not decays(np.diag([m1, m2, 1.0]), np.diag([0, 0, 0.8]), stiffness)
        (family,) = found.invariant.families
        assert len(family.relations) == 4  # of 6 states: one mode stays
    else:
        assert decays(np.diag([m1, m2, 1.0]), np.diag([0, 0, 0.8]), stiffness)
        assert "x1 = 0, x2 = 0, x3 = 0" in found.conclusion
    assert found.status == "proved"


def test_the_set_up_whose_frequencies_agree_keeps_its_anti_phase_motion():
    model = load_model("setup_lagrangian").with_parameters(m1=0.041, k1=7.38, m2=0.058, k2=10.44, b1=0.0, b2=0.0)
    found = certificate(model)
    assert "k1*m2 - k2*m1 = 0" in found.hypotheses
    assert "x1 = 0, x2 = 0" not in found.conclusion
    assert found.conclusion.endswith(" = 0, x3 = 0, k1*x1'/k2 + x2' = 0, x3' = 0")


def test_a_coincidence_is_named(declared):
    found = certificate(declared(**on_beam(0.041, 7.38, 0.058, 10.440000001)))
    assert found.status == "open"
    assert "k1*m2 - k2*m1 is not 0 at the declared values, but 0 within 1e-9 of them" in found.conclusion
    assert "proved" not in str(found)


@pytest.mark.parametrize(("third", "stays"), [(0.3, True), (0.9, False)])
def test_cubic_springs_that_agree_in_decimals(declared, third, stays):
    """Equal oscillators but for cubic springs, 0.1 + 0.2 and `third`: anti-phase stays where they are equal, too."""
    one, two = "(1.1*(x1 - x3) + (g + h)*(x1 - x3)**3)", "(1.1*(x2 - x3) + k*(x2 - x3)**3)"
    model = declared(
        coordinates={"x1": {"initial": 1}, "x2": {"initial": -1}, "x3": {"initial": 0}},
        parameters={"g": {"value": 0.1}, "h": {"value": 0.2}, "k": {"value": third}},
        definitions={"one": one, "two": two},
        equations={"x1''": "-one", "x2''": "-two", "x3''": "one + two - x3 - x3'"},
        energy="(x1'**2 + x2'**2 + x3'**2 + x3**2 + 1.1*(x1 - x3)**2 + 1.1*(x2 - x3)**2)/2"
        " + (g + h)*(x1 - x3)**4/4 + k*(x2 - x3)**4/4",
    )
    found = certificate(model)

    def rates(q, v):
        f, g = (1.1 * (x - q[2]) + k * (x - q[2]) ** 3 for x, k in ((q[0], 0.3), (q[1], third)))
        return [-f, -g, f + g - q[2] - v[2]]

    left = speed_left(rates, [1.0, -1.0, 0.0, 0.0, 0.0, 0.0], 300.0)
    assert left > 0.99 if stays else left < 0.8
    assert found.status == "proved"
    assert ("to the set x1 + x2 = 0" in found.conclusion) is stays


GYRATED = {"g != 0": ((0.1, 0.2, 0.2), True), "g = 0 in decimals": ((0.1, 0.2, 0.3), False)}


@pytest.mark.parametrize("name", GYRATED)
def test_a_gyroscopic_force_passes_damping_on_if_it_is_there(declared, name):
    (a, d, c), is_damped = GYRATED[name]
    g = round(a + d - c, 12)
    model = declared(
        coordinates={"x": {"initial": 1}, "y": {"initial": 1}},
        parameters={"a": {"value": a}, "d": {"value": d}, "c": {"value": c}},
        equations={"x''": "-x + (a + d - c)*y' - x'/2", "y''": "-2*y - (a + d - c)*x'"},
        energy="(x'**2 + y'**2 + x**2 + 2*y**2)/2",
    )
    found = certificate(model)
    assert decays(np.eye(2), [[0.5, -g], [g, 0]], np.diag([1, 2])) is is_damped
    assert found.status == "proved"
    assert ("x = 0, y = 0" in found.conclusion) is is_damped


DAMPERS = {  # a, b, c of [[a, c], [c, b]], and whether that is definite; c^2 = a b in decimals is not so in binary
    "definite": ((0.1, 0.4, 0.19), True),
    "semidefinite": ((0.1, 0.4, 0.2), False),
}


@pytest.mark.parametrize("name", DAMPERS)
def test_dampers_that_are_definite_or_not_by_their_decimals(declared, name):
    (a, b, c), is_damped = DAMPERS[name]
    assert decays(np.eye(2), [[a, c], [c, b]], np.eye(2)) is is_damped
    found = certificate(
        declared(
            coordinates={"x": {"initial": 1}, "y": {"initial": 1}},
            parameters={"a": {"value": a}, "b": {"value": b}, "c": {"value": c}},
            equations={"x''": "-x - a*x' - c*y'", "y''": "-y - c*x' - b*y'"},
            energy="(x'**2 + y'**2 + x**2 + y**2)/2",
        )
    )
    assert found.status == "proved"
    assert ("x = 0, y = 0" in found.conclusion) is is_damped


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


def chain(m3, c1):
    """Return three masses between walls, all springs 1, the middle one damped by 0.4 and the first by c1."""
    return {
        "coordinates": {x: {"initial": 1} for x in ("x1", "x2", "x3")},
        "parameters": {"m": {"value": m3}, "c": {"value": c1}},
        "lagrangian": "(x1'**2 + x2'**2 + m*x3'**2 - x1**2 - (x1 - x2)**2 - (x2 - x3)**2 - x3**2)/2",
        "dissipation": "(0.4*x2'**2 + c*x1'**2)/2",
    }


@pytest.mark.parametrize(("m3", "c1"), [(1.0, 0.0), (1.1, 0.0), (1.0, 0.1)])
def test_a_damper_at_the_node_of_a_mode_does_not_damp_it(declared, m3, c1):
    stiffness = np.array([[2, -1, 0], [-1, 2, -1], [0, -1, 2]])
    is_damped = decays(np.diag([1, 1, m3]), np.diag([c1, 0.4, 0]), stiffness)
    assert is_damped is ((m3, c1) != (1.0, 0.0))
    found = certificate(declared(**chain(m3, c1)))
    assert found.status == "proved"
    assert ("x1 = 0, x2 = 0, x3 = 0" in found.conclusion) is is_damped


@pytest.mark.parametrize("coupling", [0.0, 0.5])
def test_two_free_masses_with_a_damper_do_not_come_to_rest(declared, coupling):
    """Their momentum is constant, so that not every motion is bounded: coordinates in metres are no angles."""
    assert not decays(np.eye(2), 0.2 * np.array([[1, -1], [-1, 1]]), coupling * np.array([[1, -1], [-1, 1]]))
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}, "y": {"initial": 0}},
            parameters={"k": {"value": coupling}},
            lagrangian="(x'**2 + y'**2 - k*(x - y)**2)/2",
            dissipation="0.2*(x' - y')**2/2",
        )
    )
    assert not found.boundedness.is_shown
    assert "every motion converges" not in found.conclusion


@pytest.mark.parametrize(
    ("equations", "status"),
    [
        ({"x''": "-x - y/2 - x'/10", "y''": "-y + x/2 - y'/10"}, "refuted"),  # circulatory
        ({"x''": "-x*(1 + cos(2*t)/2) - x'/10", "y''": "-y - y'"}, "open"),  # parametrically excited
        ({"x''": "-x - x'/10", "y''": "-y - (1 + 2*sin(t))*y'"}, "open"),  # damping that changes its sign
        ({"x''": "-x - x'**3/10", "y''": "-y - y'**3"}, "proved"),  # neutral by its modes, and yet at rest in the end
        ({"x''": "-x + y'*x - x'/10", "y''": "-y - x'*x - y'"}, "proved"),  # gyroscopic, not linear
    ],
)
def test_forces_of_other_kinds(declared, equations, status):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 1}, "y": {"initial": 1}},
            equations=equations,
            energy="(x'**2 + y'**2 + x**2 + y**2)/2",
        )
    )
    assert found.status == status
    if status == "proved":
        assert "converges to the equilibrium (x = 0, y = 0)" in found.conclusion


def test_the_coupled_oscillators_without_proof_grow_or_may_grow():
    """Circulatory and parametrically excited: the motions that no certificate may call convergent."""
    assert not decays(np.eye(2), np.eye(2) / 10, [[1, 0.5], [-0.5, 1]])
    run = solve_ivp(lambda t, y: [y[1], -y[0] * (1 + np.cos(2 * t) / 2) - y[1] / 10], (0, 100), [1, 0], rtol=1e-8)
    assert np.abs(run.y[0]).max() > 10.0


def test_the_theorem_alone_is_no_result(declared):
    oscillators = ("x1", "x2", "x3")
    forces = {x: f"(({x} - y) + ({x} - y)**3)" for x in oscillators}
    found = certificate(
        declared(
            coordinates={x: {"initial": 0.1} for x in (*oscillators, "y")},
            equations={
                **{f"{x}''": f"-{f}" for x, f in forces.items()},
                "y''": f"{'+'.join(forces.values())} - y - y'",
            },
            energy=" + ".join(f"{x}'**2/2 + ({x} - y)**2/2 + ({x} - y)**4/4" for x in oscillators)
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
        "masking.analysis.stability.certificate.invariant_set", lambda motion, forms: rest_alone(motion)
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
