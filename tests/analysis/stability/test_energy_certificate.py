"""Energy certificates: the theorems of the thesis, and what must not be certified."""

import time
from functools import cache

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

from masking.analysis.stability.energy_certificate import certificate
from masking.analysis.stability.free_equations import Motion
from masking.analysis.stability.hypotheses import Hypotheses
from masking.analysis.stability.lasalle import invariant_set
from masking.analysis.stability.modes import state_matrix
from masking.model.modelling.model import load_model


def load(name, **values):
    model = load_model(name).with_parameters(**values)
    return model.dimensionless() if model.declaration.scales else model


@cache
def certified(name):
    """Return the certificate of a packaged model."""
    return certificate(load(name))


def relations(found):
    """Return each family as a set of texts."""
    return [{str(r) for r in family.relations} for family in found.invariant.families]


ANTI_PHASE = {
    "setup_identical": {"x1 + x2", "x1' + x2'", "x3", "x3'"},  # theorem 5.1
    "duffing": {"x1 + x2", "x1' + x2'", "x3", "x3'"},  # theorem 7.1
    "duffing_enoc": {"x1 + x2", "x1' + x2'", "x3", "x3'"},
    "discs": {"th1 + th2", "th1' + th2'", "th3", "th3'"},  # theorem 8.1
    "discs_eccentric": {"th1 + th2", "th1' + th2'", "th3", "th3'"},  # conjecture 8.1, at Table 8.4
}
RATES = {  # (A.20), (A.32), (8.15) per unit of the middle mass, and by hand for the pendula and the damped set-up
    "setup_identical": "-2*w3*z3*v**2",
    "setup_undamped": "-2*w3*z3*v**2",
    "duffing": "-2*w3*z3*v**2",
    "discs": "-2*w3*z3*v**2",
    "discs_eccentric": "-2*w3*z3*v**2",
    "huygens": "-2*Om*z*v**2",
    "huygens_lagrangian": "-2*Om*z*v**2",
    "pendula": "-b*v**2",
}


@pytest.mark.parametrize("name", RATES)
def test_the_energy_is_lost_in_the_beam_alone(name):
    model = load_model(name)
    motion = Motion(model, Hypotheses(model))
    names = {s.name: s for s in motion.given.symbols.values() if s.is_Symbol} | {"v": motion.v[2]}
    assert sp.expand(motion.energy_rate - sp.parse_expr(RATES[name], names)) == 0


@pytest.mark.parametrize("name", ANTI_PHASE)
def test_every_motion_ends_in_anti_phase(name):
    found = certified(name)
    assert found.status == "proved"
    assert found.dissipation.status == "proved"
    assert found.boundedness.is_shown
    assert relations(found) == [ANTI_PHASE[name]]
    assert found.others == ()
    assert found.conclusion.startswith("every motion converges to the set")
    assert " or " not in found.conclusion


@pytest.mark.parametrize(
    "name", ["huygens", *(pytest.param(name, marks=pytest.mark.search) for name in ("huygens_lagrangian", "pendula"))]
)
def test_pendulum_clocks_end_in_anti_phase_or_with_one_of_them_upside_down(name):
    """Theorem 9.1 as printed leaves out two equilibria: one pendulum at rest below, the other above."""
    found = certified(name)
    assert found.status == "proved"
    assert relations(found) == [{"th1 + th2", "th1' + th2'", "x", "x'"}]
    places = {(p.position["th1"], p.position["th2"], p.position["x"]) for p in found.others}
    assert places == {("0", "pi", "0"), ("pi", "0", "0")}
    assert all(p.is_unstable for p in found.others)
    assert "almost every motion converges to the set" in found.reasons[-1]


def test_the_two_equilibria_of_the_clocks_are_states_of_rest_off_the_manifold():
    model = load("huygens")
    rate = np.empty(6)
    model.kernels.derivative(0.0, np.array([0.0, np.pi, 0, 0, 0, 0]), np.zeros(0), model.values(), rate)
    assert np.abs(rate).max() < 1e-15
    stiffness = np.diag([1.0, -1.0, 1.3034**2])  # of (9.4)-(9.6) at (0, pi, 0), by hand: its determinant is negative
    assert np.linalg.det(stiffness) < 0


def test_oscillators_that_differ_die_out():
    found = certified("setup_undamped")
    assert found.status == "proved"
    assert relations(found) == [{"x1", "x2", "x3", "x1'", "x2'", "x3'"}]
    assert "w1 - w2 != 0" in found.hypotheses  # where they are equal, anti-phase stays


def test_a_set_up_that_is_damped_everywhere_comes_to_rest():
    found = certified("setup")
    forms = {str(s.form) for s in found.dissipation.squares}
    assert forms == {"x1' - x3'", "x2' - x3'", "x3'"}
    assert relations(found) == [{"x1", "x2", "x3", "x1'", "x2'", "x3'"}]


def test_equal_parameters_are_one_symbol_and_hypotheses_are_told():
    found = certified("duffing")
    assert "w1 = w2 = w > 0" in found.hypotheses
    assert "th1 = th2 = th > 0" in found.hypotheses
    assert not any(text.startswith(("c1", "nu")) for text in certified("setup_identical").hypotheses)
    assert certified("huygens").hypotheses[-1] == "mu <= 1"


def test_the_argument_of_conjecture_8_1():
    """On V' = 0: either th1 is constant, or sin K = 0 and so on, which the beam's equation makes c = 0 and K = 0."""
    model = load("discs_eccentric")
    motion = Motion(model, Hypotheses(model))
    found = invariant_set(motion, [motion.v[2]])
    text = " ".join(found.steps)
    assert "A motion that stays there has th3 = c, constant." in text
    assert "Where th2 = K - th1" in text
    assert "Either th1 is constant, which is an equilibrium, or this holds for every th1" in text
    assert "It holds for K = 0, c = 0." in text
    assert found.is_found
    assert found.equilibria


def test_conjecture_8_1_does_not_hold_for_strong_gravity():
    """With nu1 = nu2 = 2, all its hypotheses hold, and motion ends at rest off the manifold: by scipy."""
    found = certificate(load("discs_eccentric", nu1=2.0, nu2=2.0))
    assert len(found.others) == 16
    assert not all(p.is_unstable for p in found.others)
    assert found.conclusion.endswith("or to one of 16 equilibria outside of it")
    assert "motion may end there" in found.reasons[-1]
    at = next(p for p in found.others if p.stability.startswith("asymptotically stable"))
    rest = np.array([float(x) for x in at.position.values()])
    assert abs(rest[0] + rest[1]) > 1.0

    def rate(_, y):  # (8.4)-(8.6), Table 8.4 with nu_1 = nu_2 = 2
        th, v = y[:3], y[3:]
        outer = -(th[:2] - th[2]) - 4.0 * np.sin(th[:2])
        middle = 0.1043 * (th[0] + th[1] - 2 * th[2]) - 0.4568**2 * th[2]
        return [*v, *outer, middle - 2 * 0.1523 * 0.4568 * v[2] - 0.3577**2 * np.sin(th[2])]

    start = [*(rest + np.array([0.05, -0.05, 0.02])), 0.0, 0.0, 0.0]
    run = solve_ivp(rate, (0, 2000), start, "DOP853", rtol=1e-9, atol=1e-11, max_step=0.5)
    away = np.abs(run.y[:3].T - rest).max(axis=1)
    assert away[run.t > 1950].max() < 0.5 * away[run.t < 50].max() < 0.1


@pytest.mark.parametrize(
    "nu", [0.1, 1.6, pytest.param(0.7004, marks=pytest.mark.search), pytest.param(1.2, marks=pytest.mark.search)]
)
def test_conjecture_8_1_holds_for_weak_gravity(nu):
    found = certificate(load("discs_eccentric", nu1=nu, nu2=nu))
    assert found.others == ()
    assert relations(found) == [ANTI_PHASE["discs_eccentric"]]


def hung_up(declared, springs, masses):
    """Linear oscillators on a damped beam, their parameters declared oscillator by oscillator."""
    xs = [f"x{i + 1}" for i in range(len(springs))]
    force = {x: f"k{x[1:]}*({x} - y)" for x in xs}
    return declared(
        coordinates={**{x: {"initial": 0.1} for x in xs}, "y": {"initial": 0}},
        oscillators=xs,
        parameters={
            name: {"value": value}
            for i, (k, m) in enumerate(zip(springs, masses, strict=True))
            for name, value in ((f"k{i + 1}", k), (f"m{i + 1}", m))
        },
        equations={
            **{f"{x}''": f"-{force[x]}/m{x[1:]}" for x in xs},
            "y''": " + ".join(force.values()) + " - y - y'",
        },
        energy=" + ".join(f"m{x[1:]}*{x}'**2/2 + k{x[1:]}*({x} - y)**2/2" for x in xs) + " + (y'**2 + y**2)/2",
    )


@pytest.mark.parametrize(
    ("springs", "masses", "stays"),
    [
        ([2, 2], [3, 3], {"x1 + x2", "x1' + x2'", "y", "y'"}),
        ([2, 2], [3, 4], {"x1", "x2", "y", "x1'", "x2'", "y'"}),
        # Two pairs of equal springs: each pair is a symbol of its own.
        ([2, 2, 5, 5], [1, 1, 1, 1], {"x1 + x2", "x3 + x4", "x1' + x2'", "x3' + x4'", "y", "y'"}),
        pytest.param(
            [2, 2, 2, 2, 2],
            [1] * 5,
            {"x1 + x2 + x3 + x4 + x5", "x1' + x2' + x3' + x4' + x5'", "y", "y'"},
            marks=pytest.mark.search,
        ),
    ],
)
def test_each_parameter_is_its_own_whatever_the_order_of_the_declaration(declared, springs, masses, stays):
    """Along a motion that stays, the beam rests and the sum of forces in each group of equal k/m is 0."""
    model = hung_up(declared, springs, masses)
    assert relations(certificate(model)) == [stays]
    values = np.linalg.eigvals(state_matrix(model))
    n = 1 + len(springs)
    assert np.sum(np.abs(values.real) < 1e-9) == 2 * n - len(stays)


def unlike(declared, a, d):
    return declared(
        coordinates={"x1": {"initial": 0.1}, "x2": {"initial": 0.2}, "x3": {"initial": 0}},
        parameters={"a": {"value": a}, "d": {"value": d}, "m": {"value": 0.1}},
        definitions={"f": "a*(x1 - x3) + (x1 - x3)**3", "g": "d*(x2 - x3) + (x2 - x3)**3"},
        equations={"x1''": "-f", "x2''": "-g", "x3''": "m*(f + g) - x3 - x3'"},
        energy="m*(x1'**2/2 + a*(x1 - x3)**2/2 + (x1 - x3)**4/4) + m*(x2'**2/2 + d*(x2 - x3)**2/2 + (x2 - x3)**4/4)"
        " + (x3'**2 + x3**2)/2",
    )


def test_what_an_argument_needs_of_parameters_is_a_hypothesis(declared):
    rest = certificate(unlike(declared, 1.0, 1.3))
    assert rest.conclusion.startswith("every motion converges to the equilibrium (x1 = 0, x2 = 0, x3 = 0)")
    assert {"a - d != 0"} <= set(rest.hypotheses) or {"-a + d != 0"} <= set(rest.hypotheses)
    # Equal by chance, under names that are not seen to belong together.
    alike = certificate(unlike(declared, 1.0, 1.0))
    assert relations(alike) == [{"x1 + x2", "x1' + x2'", "x3", "x3'"}]
    assert {"a - d = 0"} <= set(alike.hypotheses) or {"-a + d = 0"} <= set(alike.hypotheses)


# What must not be certified


def test_a_model_whose_energy_grows_is_refused_with_a_state(declared):
    model = declared(
        coordinates={"x": {"initial": 0.1}},
        parameters={"b": {"value": 0.5}},
        equations={"x''": "-x + b*(1 - x**2)*x'"},
        energy="(x'**2 + x**2)/2",
    )
    found = certificate(model)
    assert found.status == "refuted"
    state = found.dissipation.counterexample
    growth = 0.5 * (1 - state["x"] ** 2) * state["x'"] ** 2
    assert 0.0 < found.dissipation.growth <= growth
    assert "certifies nothing" in found.conclusion
    assert found.invariant is None


def test_a_slip_in_an_energy_is_found(declared):
    # Half the spring's energy is left out.
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}},
            parameters={"b": {"value": 0.5}},
            equations={"x''": "-x - b*x'"},
            energy="(x'**2 + x**2/2)/2",
        )
    )
    assert found.status == "refuted"


def test_interval_arithmetic_proves_a_box_and_says_no_more(declared):
    model = declared(
        coordinates={"x": {"initial": 0.1}},
        parameters={"b": {"value": 0.5}},
        equations={"x''": "-x - b*(1 - x**2)*x'"},
        energy="(x'**2 + x**2)/2",
    )
    found = certificate(model, {"x": (-0.9, 0.9), "x'": (-1.0, 2.0)})
    assert found.dissipation.status == "proved"
    assert found.dissipation.method == "interval arithmetic on a box"
    assert found.conclusion == "the energy does not grow while the motion stays in the box |x| <= 0.9, -1 <= x' <= 2"
    assert certificate(model, {"x": (-1.1, 1.1), "x'": (-2.0, 2.0)}).status == "refuted"


def test_where_the_potential_does_not_grow_only_bounded_motion_is_spoken_of(declared):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}},
            parameters={"b": {"value": 0.5}},
            equations={"x''": "-x + x**3 - b*x'"},
            energy="x'**2/2 + x**2/2 - x**4/4",
        )
    )
    assert not found.boundedness.is_shown
    assert found.conclusion.startswith("every motion that is bounded converges to one of 3 equilibria")


def test_a_double_well_ends_in_one_of_its_wells(declared):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}},
            parameters={"b": {"value": 0.5}},
            equations={"x''": "x - x**3 - b*x'"},
            energy="x'**2/2 - x**2/2 + x**4/4",
        )
    )
    assert found.boundedness.is_shown
    assert {(p.position["x"], p.is_unstable) for p in found.others} == {("-1", False), ("0", True), ("1", False)}
    assert all("minimum" in p.stability for p in found.others if not p.is_unstable)


def test_dry_friction_loses_energy_and_no_more_is_said(declared):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.1}},
            parameters={"F": {"value": 0.5}},
            equations={"x''": "-x - F*sign(x')"},
            energy="(x'**2 + x**2)/2",
        )
    )
    assert found.status == "proved"
    assert found.conclusion == "the energy never grows; every motion is bounded"


def test_three_oscillators_with_springs_of_fifth_order_are_left_open(declared):
    oscillators = ("x1", "x2", "x3")
    model = declared(
        coordinates={**{x: {"initial": 0.1} for x in oscillators}, "y": {"initial": 0}},
        parameters={"m": {"value": 0.1}},
        equations={
            **{f"{x}''": f"-({x} - y) - ({x} - y)**5" for x in oscillators},
            "y''": "m*(" + " + ".join(f"({x} - y) + ({x} - y)**5" for x in oscillators) + ") - y - y'",
        },
        energy=" + ".join(f"m*({x}'**2/2 + ({x} - y)**2/2 + ({x} - y)**6/6)" for x in oscillators)
        + " + (y'**2 + y**2)/2",
    )
    found = certificate(model)
    assert found.conclusion == "every motion converges to the largest invariant set on which V' = 0"
    assert "is open" in found.reasons[-1]
    assert found.others is None


def test_what_has_no_energy_is_open(declared):
    found = certificate(declared(coordinates={"x": {"initial": 0.1}}, equations={"x''": "-x"}))
    assert found.status == "open"
    assert "declares no energy" in found.conclusion


def test_negative_damping_of_an_oscillator_is_refuted():
    model = load_model("setup_identical")
    parts = {**model.declaration.parameters}
    parts["z1"] = parts["z1"].model_copy(update={"value": -0.01, "bounds": (None, None)})
    changed = type(model)(model.declaration.model_copy(update={"parameters": parts}))
    found = certificate(changed)
    assert found.status == "refuted"
    assert found.dissipation.growth > 0.0


@pytest.mark.parametrize(("damping", "drift"), [(0.0, 1.0), (0.1, 3.0)])
def test_an_energy_that_holds_the_time_is_refused(declared, damping, drift):
    """V = (x'^2 + x^2)/2 + drift t grows at rest, where x = x' = 0 and V' = drift > 0."""
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.5}},
            equations={"x''": f"-x - {damping}*x'"},
            energy=f"(x'**2 + x**2)/2 + {drift}*t",
        )
    )
    assert found.status == "open"
    assert found.invariant is None
    assert "the energy of test, " in found.conclusion
    assert "holds the time t" in found.conclusion
    assert "declare 'energy:' as a function of coordinates and velocities alone" in found.conclusion


def test_a_factor_of_parameters_that_is_zero_leaves_no_equilibrium_out(declared):
    """x'' = -(ka - kb) sin x - d x': where ka = kb nothing pulls, and every x is an equilibrium."""
    parts = {
        "coordinates": {"x": {"initial": 0.5}},
        "equations": {"x''": "-(ka - kb)*sin(x) - d*x'"},
        "energy": "x'**2/2 + (ka - kb)*(1 - cos(x))",
    }
    values = {"ka": {"value": 1}, "kb": {"value": 1}, "d": {"value": 0.1}}
    free = certificate(declared(parameters=values, **parts))
    assert free.others is None
    assert free.conclusion == "every motion converges to the set of equilibria"
    assert "The equilibria are not isolated: every x is one." in free.reasons
    assert "ka - kb = 0" in free.hypotheses
    pulled = certificate(declared(parameters=values | {"ka": {"value": 2}}, **parts))
    assert {p.position["x"] for p in pulled.others} == {"0", "pi"}
    assert "ka - kb != 0" in pulled.hypotheses


def test_pendula_that_swing_beside_a_body_at_rest_are_not_tied(declared):
    """Where z = 0 stays, x'' = -sin x and y'' = -sin y go on for ever, each alone: nothing ties x to y."""
    model = declared(
        coordinates={"x": {"initial": 0.5}, "y": {"initial": 0.2}, "z": {"initial": 0}},
        parameters={"d": {"value": 0.1}},
        equations={
            "x''": "-sin(x) - z**2*cos(x)/2",
            "y''": "-sin(y) - z**2*cos(y)/2",
            "z''": "-z*(sin(x) + sin(y)) - d*z'",
        },
        energy="(x'**2 + y'**2 + z'**2)/2 - cos(x) - cos(y) + z**2*(sin(x) + sin(y))/2",
    )
    found = certificate(model)
    assert found.dissipation.status == "proved"
    assert not found.invariant.is_found
    assert found.conclusion.endswith("converges to the largest invariant set on which V' = 0")


def test_growth_further_out_than_the_initial_state_is_found(declared):
    """V' = x'^2 (-d + e x^2) > 0 where |x| > sqrt(d/e) = 2.24, more than four times the initial 0.5."""
    model = declared(
        coordinates={"x": {"initial": 0.5}},
        parameters={"d": {"value": 0.1}, "e": {"value": 0.02}},
        equations={"x''": "-x - d*x' + e*x**2*x'"},
        energy="(x'**2 + x**2)/2",
    )
    found = certificate(model)
    assert found.status == "refuted"
    state = found.dissipation.counterexample
    assert abs(state["x"]) > np.sqrt(5.0)
    assert 0.0 < found.dissipation.growth <= state["x'"] ** 2 * (-0.1 + 0.02 * state["x"] ** 2)
    # Whoever declares a box is told of that box alone, by its name.
    inside = certificate(model, {"x": (-2.0, 2.0), "x'": (-3.0, 3.0)})
    assert inside.status == "proved"
    assert inside.conclusion.endswith("while the motion stays in the box |x| <= 2, |x'| <= 3")


@pytest.mark.parametrize(
    ("force", "potential", "rate"),
    [
        ("-x + 0.1*sign(x')", "x**2/2", lambda x, v: 0.1 * abs(v)),  # Coulomb friction with the wrong sign
        ("-x - 0.05*sign(x') + 0.1*x'", "x**2/2", lambda x, v: 0.1 * v**2 - 0.05 * abs(v)),
        ("-max(x - 1, 0) + 0.1*x'", "max(x - 1, 0)**2/2", lambda x, v: 0.1 * v**2),  # a spring behind a gap
        ("-x + 0.1*heaviside(x)*x'", "x**2/2", lambda x, v: 0.1 * v**2 * (x > 0)),
        ("-x - where(x > 0.3, 0.1, -0.2)*x'", "x**2/2", lambda x, v: (-0.1 if x > 0.3 else 0.2) * v**2),
    ],
)
def test_growth_by_forces_that_are_not_smooth_is_refuted_with_a_state(declared, force, potential, rate):
    found = certificate(
        declared(coordinates={"x": {"initial": 0.5}}, equations={"x''": force}, energy=f"x'**2/2 + {potential}")
    )
    assert found.status == "refuted"
    state, growth = found.dissipation.counterexample, found.dissipation.growth
    assert growth > 0.0
    assert growth == pytest.approx(rate(state["x"], state["x'"]), rel=1e-12)


def test_growth_at_speeds_far_beyond_the_motion_is_refuted(declared):
    """V' = -|v|^3 + e v^4 is positive beyond v = 1/e = 1e16."""
    equation = {"x''": "-x - abs(x')*x' + 1e-16*x'**3"}
    found = certificate(declared(coordinates={"x": {"initial": 1}}, equations=equation, energy="(x'**2 + x**2)/2"))
    assert found.status == "refuted"
    assert abs(found.dissipation.counterexample["x'"]) > 1e16


def test_a_set_is_said_with_the_equations_that_it_supposes(declared):
    """Two oscillators of one frequency, ka/ma = kb/mb, leave the mass s at rest where ka a + kb b = 0."""
    found = certificate(
        declared(
            coordinates={"a": {"initial": 1}, "b": {"initial": 0.5}, "s": {"initial": 0}},
            parameters={
                n: {"value": x}
                for n, x in zip(("ma", "mb", "ka", "kb", "M", "K", "d"), (1, 1, 2, 2, 5, 1, 0.3), strict=True)
            },
            equations={
                "ma*a''": "-ka*(a - s)",
                "mb*b''": "-kb*(b - s)",
                "M*s''": "ka*(a - s) + kb*(b - s) - K*s - d*s'",
            },
            energy="(ma*a'**2 + mb*b'**2 + M*s'**2 + ka*(a - s)**2 + kb*(b - s)**2 + K*s**2)/2",
        )
    )
    assert relations(found) == [{"a*ma/mb + b", "a'*ma/mb + b'", "s", "s'"}]
    assert "ka*mb - kb*ma = 0" in found.hypotheses
    assert not any("!=" in one for one in found.hypotheses)


@pytest.mark.parametrize(
    ("force", "potential"),
    [
        ("-x - 0.1*heaviside(x)*x'", "x**2/2"),
    ],
)
def test_losses_by_forces_that_are_not_smooth_are_not_refuted(declared, force, potential):
    found = certificate(
        declared(coordinates={"x": {"initial": 0.5}}, equations={"x''": force}, energy=f"x'**2/2 + {potential}")
    )
    assert found.status == "supported numerically"
    assert "enclosure" not in str(found)


def test_an_energy_that_jumps_has_no_rate(declared):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.5}},
            equations={"x''": "-x - 0.1*x'"},
            energy="x'**2/2 + x**2/2 + heaviside(x)",
        )
    )
    assert found.status == "open"
    assert "the energy jumps at x = 0; declare one that is continuous" in str(found)


@pytest.mark.parametrize(
    ("force", "potential"),
    [("1", "-x"), ("2 - sin(x)", "-2*x - cos(x)")],  # x' tends to 1/d; a pendulum that a torque keeps turning
)
def test_where_nothing_is_at_rest_no_motion_is_bounded(declared, force, potential):
    found = certificate(
        declared(
            coordinates={"x": {"initial": 0.5}},
            parameters={"d": {"value": 0.1}},
            equations={"x''": f"{force} - d*x'"},
            energy=f"x'**2/2 + {potential}",
        )
    )
    assert found.status == "proved"
    assert found.others == ()
    assert found.conclusion == "no motion is bounded: there is no equilibrium to converge to"


def hung(declared, names, stiffness):
    """Two Duffing oscillators on a damped beam, with names for the three coordinates and the two stiffnesses."""
    x, y, z = names
    a, b = stiffness
    f, g = f"({a}*({x} - {z}) + ({x} - {z})**3)", f"({b}*({y} - {z}) + ({y} - {z})**3)"
    lost = f"{a}*({x} - {z})**2/2 + ({x} - {z})**4/4 + {b}*({y} - {z})**2/2 + ({y} - {z})**4/4"
    return declared(
        coordinates={name: {"initial": 0.1} for name in names},
        parameters={name: {"value": 1.0 + 0.3 * i} for i, name in enumerate(dict.fromkeys(stiffness))},
        equations={f"{x}''": f"-{f}", f"{y}''": f"-{g}", f"{z}''": f"0.1*({f} + {g}) - {z} - {z}'"},
        energy=f"0.1*({x}'**2/2 + {y}'**2/2 + {lost}) + ({z}'**2 + {z}**2)/2",
    )


@pytest.mark.parametrize(
    ("names", "stiffness"),
    [
        (("x", "y", "z"), "K"),
        (("c", "K", "z"), "k"),
        pytest.param(("x", "y", "z"), "c", marks=pytest.mark.search),
        pytest.param(("K", "y", "c"), "k", marks=pytest.mark.search),
        pytest.param(("a0", "a1", "a2"), "k", marks=pytest.mark.search),
    ],
)
def test_constants_of_the_argument_have_names_of_their_own(declared, names, stiffness):
    """Theorem 7.1 in other letters: the two end in anti-phase, whatever they are called."""
    x, y, z = names
    found = certificate(hung(declared, names, (stiffness, stiffness)))
    (family,) = relations(found)
    assert family in ({f"{x} + {y}", f"{x}' + {y}'", z, f"{z}'"}, {f"{y} + {x}", f"{y}' + {x}'", z, f"{z}'"})
    assert found.others == ()


def test_a_parameter_k_is_not_the_constant_of_the_argument(declared):
    found = certificate(hung(declared, ("x", "y", "z"), ("K", "k")))
    steps = " ".join(found.invariant.steps)
    assert "x + y is bounded, so that it is a constant, K_." in steps
    assert "Where y = K_ - x" in steps
    assert "this holds for every x: K = 0" not in steps
    assert found.conclusion.startswith("every motion converges to the equilibrium (x = 0, y = 0, z = 0)")


def test_inputs_that_are_taken_to_be_zero_are_told(declared):
    parts = {
        "coordinates": {"x": {"initial": 0.5}},
        "inputs": {"u": {}, "w": {}},
        "energy": "(x'**2 + x**2)/2",
    }
    for equation in ("-x + u + w - 0.1*x'", "-x + u + w + 0.1*x'"):  # proved, refuted
        found = certificate(declared(equations={"x''": equation}, **parts))
        assert found.hypotheses[0] == "the inputs u = w = 0"
        assert "for the inputs u = w = 0" in str(found)
    del parts["inputs"]
    assert not certificate(declared(equations={"x''": "-x - 0.1*x'"}, **parts)).hypotheses


@pytest.mark.parametrize(
    ("damping", "status"),
    [
        ("1 - 3*exp(-((x - 0.5)/0.0001)**2)", "refuted"),  # V' = 0.2 x'^2 at x = 0.5
        ("1 - exp(-(x/0.0001)**2)/2", "proved"),
        ("1 - tanh(100000*x)**2/2", "proved"),
        ("1 - sin(100000*x)**2/2", "proved"),
        ("1 + exp(12345.678*x)", "proved"),
        ("1 + exp(sin(100000*x) + sin(exp(1000*x)))", "proved"),
    ],
)
def test_steep_functions_are_looked_at_in_a_moment(declared, damping, status):
    model = declared(
        coordinates={"x": {"initial": 0.5}},
        parameters={"m": {"value": 0.1}},
        equations={"x''": f"-x - m*x'*({damping})"},
        energy="(x'**2 + x**2)/2",
    )
    start = time.perf_counter()
    assert certificate(model).status == status
    assert time.perf_counter() - start < 20.0  # for ever, where sympy takes exp(10**8 x) to a power of exp(x)


@pytest.mark.parametrize(
    ("spring", "energy", "status"),
    [
        # A spring beyond a gap: its energy is continuous, (x - 0.1)^2/2 from x = 0.1 on.
        ("where(x > 0.1, x - 0.1, 0)", "where(x > 0.1, (x - 0.1)**2/2, 0)", "proved"),
        ("where(x > 0.1, x - 0.1, 0)", "where(x > 0.1, 1 + (x - 0.1)**2/2, 0)", "open"),
    ],
)
def test_an_energy_in_pieces_is_to_be_continuous(declared, spring, energy, status):
    model = declared(
        coordinates={"x": {"initial": 0.5}},
        equations={"x''": f"-x - {spring} - 0.1*x'"},
        energy=f"x'**2/2 + x**2/2 + {energy}",
    )
    found = certificate(model)
    assert found.status == status
    assert ("the energy may jump at the edge of x > " in str(found)) is (status == "open")
