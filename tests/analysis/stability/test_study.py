"""Equilibria, modes, orbits, transverse exponents, basins: against closed forms, scipy and the digest's section 7."""

import json

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from masking.analysis.stability.basins import LABELS, basins
from masking.analysis.stability.equilibria import equilibria
from masking.analysis.stability.modes import frequency_response, modes, state_matrix, sum_matrix, sweep, upsilon
from masking.analysis.stability.orbits import orbit
from masking.analysis.stability.settling import settling_time
from masking.analysis.stability.transverse import anti_phase, in_phase, transverse
from masking.analysis.synchronisation import synchronisation_time
from masking.app import cli
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.intervals import Interval, enclose
from masking.errors import DeclarationError, IntegrationError, ModelError
from masking.model.modelling.model import load_model


def load(name, **values):
    model = load_model(name).with_parameters(**values)
    return model.dimensionless() if model.declaration.scales else model


TABLE_8_3 = {"w3": 0.7252, "mu1": 0.0256, "mu2": 0.0256}


@pytest.fixture(scope="module")
def van_der_pol(declared):
    return declared(
        coordinates={"x": {"initial": 2}},
        parameters={"b": {"value": 0.4}},
        equations={"x''": "-x + b*(1 - x**2)*x'"},
    )


# Intervals


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-4, 4), st.floats(0, 3), st.floats(0, 1)), min_size=3, max_size=3))
def test_an_enclosure_holds_the_value_at_every_point_of_the_box(sides):
    import sympy as sp

    x, y, z = sp.symbols("x y z", real=True)
    expression = sp.sin(x * y) - x**3 / (4 + sp.cos(z)) + sp.tanh(y) * sp.exp(-(z**2)) + sp.atan(x - z) * sp.cosh(y / 4)
    graph = Graph()
    nodes = {s: graph.symbol(str(s), varying=True) for s in (x, y, z)}
    top = graph.lower(expression, nodes)
    boxes = {
        n: Interval.of(np.array([a]), np.array([a + w])) for n, (a, w, _) in zip(nodes.values(), sides, strict=True)
    }
    (found,) = enclose(graph, [top], boxes)
    point = [a + part * w for a, w, part in sides]
    exact = expression.subs(dict(zip((x, y, z), map(sp.Rational, point), strict=True))).evalf(30)
    assert found.low[0] <= exact <= found.high[0]


def test_an_enclosure_of_a_point_is_as_narrow_as_rounding():
    import sympy as sp

    x = sp.Symbol("x", real=True)
    graph = Graph()
    node = graph.symbol("x", varying=True)
    top = graph.lower(sp.sin(x) ** 2 + sp.cos(x) ** 2, {x: node})
    (found,) = enclose(graph, [top], {node: Interval.of(0.7)})
    assert found.low < 1.0 < found.high < found.low + 1e-14


def test_what_has_no_enclosure_is_refused():
    import sympy as sp

    graph = Graph()
    x = sp.Symbol("x", real=True)
    node = graph.symbol("x", varying=True)
    with pytest.raises(ModelError, match="'floor' has no enclosure"):
        enclose(graph, [graph.lower(sp.floor(x), {x: node})], {node: Interval.of(0.5)})


# Equilibria


def test_the_pendulum_clocks_have_four_equilibria_and_no_other():
    found = equilibria(load("huygens"))
    places = sorted(tuple(round(x / np.pi, 12) for x in p.position.values()) for p in found.points)
    assert places == [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)]
    assert found.is_complete
    assert found.is_global
    one_up = [p for p in found.points if abs(p.position["th1"] + p.position["th2"] - np.pi) < 1e-9]
    assert all(p.is_unstable and p.verdict == "unstable" for p in one_up)


def test_a_double_well_has_three_equilibria(declared):
    model = declared(
        coordinates={"x": {"initial": 0.1}}, parameters={"b": {"value": 0.2}}, equations={"x''": "x - x**3 - b*x'"}
    )
    found = equilibria(model, {"x": (-5.0, 5.5)})
    assert [round(p.position["x"], 12) for p in found.points] == [-1, 0, 1]
    assert [p.is_unstable for p in found.points] == [False, True, False]
    assert found.is_complete
    assert not found.is_global
    assert all(p.radius < 1e-9 for p in found.points)
    assert len(equilibria(model, {"x": (0.2, 5.0)}).points) == 1


def test_equilibria_that_are_not_isolated_stay_undecided(declared):
    model = declared(coordinates={"x": {"initial": 0.1}}, equations={"x''": "-(x - 1)**2*x'- (x-1)**2"})
    found = equilibria(model, {"x": (-1.0, 3.1)})
    assert not found.is_complete
    assert "not decided" in str(found)
    assert any(
        low[0] <= 1.0 <= high[0] for low, high in zip(found.undecided[..., 0], found.undecided[..., 1], strict=True)
    )


CART = {"coordinates": {"x": {}, "th": {}}, "parameters": {"m": {"value": 1}, "M": {"value": 2}, "g": {"value": 9.81}}}


@pytest.mark.parametrize(
    ("model", "along", "points"),
    [
        pytest.param(
            {"coordinates": {"a": {}}, "parameters": {"c": {"value": 0.1}}, "equations": {"a''": "-c*a'"}},
            [{"a": 1.0}], [(0,)], id="shaft",
        ),
        pytest.param({"coordinates": {"a": {}}, "equations": {"a''": "0.2 - a'"}}, [{"a": 1.0}], [], id="driven shaft"),
        pytest.param(
            {"coordinates": {"a": {}, "b": {}}, "equations": {"2*a''": "-sin(a - b)", "b''": "sin(a - b) - b'"}},
            [{"a": 1.0, "b": 1.0}], [(0, 0), (0, 1)], id="two shafts",
        ),
        pytest.param(
            CART | {"equations": {
                "(M + m)*x'' + m*cos(th)*th''": "m*sin(th)*th'**2", "th'' + cos(th)*x''": "-g*sin(th)",
            }},
            [{"x": 1.0}], [(0, 0), (0, 1)], id="cart and pendulum",
        ),
        pytest.param(
            CART | {"equations": {
                "x''": "(m*sin(th)*th'**2 + m*g*sin(th)*cos(th))/(M + m*sin(th)**2)",
                "th''": "-(m*sin(th)*cos(th)*th'**2 + (M + m)*g*sin(th))/(M + m*sin(th)**2)",
            }},
            [{"x": 1.0}], [(0, 0), (0, 1)], id="cart and pendulum, solved",
        ),
        pytest.param(
            {"coordinates": {"x": {}, "th": {}}, "equations": {"x''": "cos(th)", "th''": "-sin(th)"}},
            [{"x": 1.0}], [], id="pushed by another",
        ),
    ],
)  # fmt: skip
def test_lines_of_equilibria_are_found_once_each_and_without_a_search(declared, model, along, points):
    """By hand; in turns, where an angle is half of one."""
    found = equilibria(declared(**model))
    assert list(found.along) == along
    assert [tuple(round(x / np.pi, 9) for x in p.position.values()) for p in found.points] == points
    assert not found.is_complete
    assert not len(found.undecided)
    assert found.is_global
    assert all(p.verdict != "asymptotically stable" for p in found.points)
    said = (
        f"{len(points)} famil{'y' if len(points) == 1 else 'ies'} of equilibria along"
        if points
        else "0 equilibria, and"
    )
    assert str(found).startswith(said)


def test_a_box_that_is_given_is_searched_where_a_line_may_leave_it(declared):
    model = declared(coordinates={"a": {}, "b": {}}, equations={"a''": "b - a - a'", "b''": "a - b"})
    cyclic = declared(coordinates={"a": {}, "b": {}}, equations={"a''": "-a", "b''": "-b'"})
    assert not equilibria(model, {"a": (1.0, 1.2)}).along
    assert equilibria(cyclic, {"b": (1.0, 3.0)}).points[0].position == {"a": 0.0, "b": 2.0}


def test_sixteen_equilibria_off_the_manifold_where_gravity_is_strong():
    # Counted by hand: h(x) = x + nu^2 sin x = c has up to three solutions x for each c of the middle disc.
    model = load("discs_eccentric", nu1=2.0, nu2=2.0)
    found = equilibria(model)
    assert found.is_complete
    assert found.is_global
    assert len(found.points) == 17
    for point in found.points:
        th1, th2, th3 = point.position.values()
        assert abs(th1 - th3 + 4.0 * np.sin(th1)) < 1e-12
        assert abs(th2 - th3 + 4.0 * np.sin(th2)) < 1e-12
    off = [p for p in found.points if p.verdict == "asymptotically stable"]
    assert len(off) == 4
    assert all(abs(p.position["th1"] + p.position["th2"]) > 1.0 for p in off)


def test_a_box_of_an_unknown_coordinate_is_refused():
    with pytest.raises(ModelError, match="no coordinate 'th9'"):
        equilibria(load("discs"), {"th9": (0.0, 1.0)})


# Modes


def test_the_chain_rule_gives_the_matrix_of_python_control():
    for name in ("setup", "huygens", "duffing"):
        model = load(name)
        at = dict(zip(model.coordinates, (0.3, -0.2, 0.1), strict=True))
        np.testing.assert_allclose(state_matrix(model, at), np.asarray(model.linearise(at).A), atol=1e-12)


def test_modes_of_the_set_up_are_those_of_the_polynomial_eigenproblem():
    model = load("setup")
    found = modes(state_matrix(model), model.coordinates)
    a = state_matrix(model)
    truth = scipy.linalg.eigvals(a)
    for mode in found.modes:
        assert np.min(np.abs(truth - mode.eigenvalue)) < 1e-10
        shape = np.array([mode.shape[c] for c in model.coordinates])
        y = np.concatenate([shape, mode.eigenvalue * shape])
        np.testing.assert_allclose(a @ y, mode.eigenvalue * y, atol=1e-9)
    assert found.is_stable is True


def test_the_slowest_mode_of_the_undamped_set_up_is_the_digests():
    found = modes(state_matrix(load("setup_undamped")), ("x1", "x2", "x3")).modes[0]
    assert found.eigenvalue.real == pytest.approx(-0.001608, rel=0.01)
    ratio = found.shape["x1"] / found.shape["x2"]
    assert abs(ratio) == pytest.approx(3.064, rel=0.01)
    assert abs(np.angle(ratio)) == pytest.approx(0.973 * np.pi, rel=0.01)


def test_an_in_phase_motion_decays_while_anti_phase_stays():
    found = modes(state_matrix(load("discs")), ("th1", "th2", "th3"))
    assert found.is_stable is None
    still = found.modes[0]
    assert still.shape["th1"] + still.shape["th2"] == pytest.approx(0.0, abs=1e-12)
    assert still.frequency == pytest.approx(1.0, rel=1e-12)
    assert still.damping == pytest.approx(0.0, abs=1e-12)


def test_the_sum_system_is_the_matrix_that_is_printed():
    w3, mu, z3 = 0.7252, 0.0256, 0.3
    model = load("discs", **TABLE_8_3, z3=z3)
    found = sum_matrix(state_matrix(model), model.coordinates, ("th1", "th2"))
    # (8.11) in the order delta, th3, delta', th3', with the dimensionless w3 in its last entry
    truth = [[0, 0, 1, 0], [0, 0, 0, 1], [-1, 2, 0, 0], [mu, -(2 * mu + w3**2), 0, -2 * z3 * w3]]
    np.testing.assert_allclose(found, truth, atol=1e-14)


def test_oscillators_that_differ_have_no_sum_system():
    with pytest.raises(ModelError, match="no equation of its own"):
        upsilon(load("setup_undamped"))


def test_figure_8_4_by_eigenvalues():
    model = load("discs", **TABLE_8_3)
    best = minimize_scalar(
        lambda z3: upsilon(model.with_parameters(z3=z3)), bounds=(0.2, 0.8), method="bounded", options={"xatol": 1e-5}
    )
    assert best.fun == pytest.approx(39.0, rel=1e-3)
    # The valley is flat: at 0.394, as the digest has it, upsilon is the same to 1e-4.
    assert best.x == pytest.approx(0.394, rel=0.01)
    assert upsilon(model.with_parameters(z3=0.394)) == pytest.approx(best.fun, rel=1e-4)
    z3 = np.array([0.01, 0.1, 1.0, 2.5])
    assert np.all(sweep(model, "z3", z3) > 1.5 * best.fun)


def test_figure_8_4_by_simulation():
    """tau_s of definition 8.1 against the exact solution of the linear system on a fine grid of time."""
    model = load("discs", **TABLE_8_3)
    z3 = np.array([0.05, 0.2, 0.36, 0.39, 0.6, 2.5])
    found = sweep(model, "z3", z3, settling_time)
    for value, tau in zip(z3, found, strict=True):
        a = state_matrix(model.with_parameters(z3=value))
        values, vectors = np.linalg.eig(a)
        weights = np.linalg.solve(vectors, np.array([-0.05, -0.04, 0, 0, 0, 0], complex))
        t = np.arange(0.0, 2.0 * tau, 2e-3)
        total = ((np.exp(np.outer(t, values)) * weights) @ (vectors[0] + vectors[1])).real
        exact = t[np.flatnonzero(np.abs(total) >= 1e-4)[-1]]
        assert tau == pytest.approx(exact, abs=5e-3)
    # The threshold is crossed once in half a period: tau_s has steps, and its least value near 0.36 is a plateau.
    assert found[3] == pytest.approx(np.min(found), rel=0.01)
    assert found[0] > 2.0 * np.min(found) < found[-1]


def test_synchronisation_time_of_a_decaying_sum():
    t = np.linspace(0.0, 20.0, 2001)
    a, b = np.cos(t) + np.exp(-t), -np.cos(t)
    assert synchronisation_time(t, a + b, 1e-4) == pytest.approx(np.log(1e4), abs=1e-4)


def test_frequency_response_is_the_closed_form_of_one_oscillator(declared):
    model = declared(
        coordinates={"x": {"initial": 0}},
        inputs={"u": {}},
        parameters={"z": {"value": 0.1}},
        equations={"x''": "-x - 2*z*x' + u"},
    )
    w = np.linspace(0.1, 3.0, 30)
    found = frequency_response(model, w)
    np.testing.assert_allclose(found[0, 0], 1.0 / (1.0 - w**2 + 0.2j * w), rtol=1e-10)
    with pytest.raises(ModelError, match="no inputs"):
        frequency_response(load("discs"), w)
    for wrong in (-1.0, np.nan, np.inf):
        with pytest.raises(ModelError, match=f"a frequency is {wrong:g}; give finite ones"):
            frequency_response(model, np.array([1.0, wrong]))


# Orbits


def test_van_der_pols_cycle_and_its_multipliers(van_der_pol):
    run = van_der_pol.simulate([0.0, 60.0])
    found = orbit(van_der_pol, run.states[-1], 6.3)
    # By scipy: the period between upward passages of 0, and Liouville's formula, the product of the multipliers is
    # exp of the integral of the divergence b (1 - x^2).
    b = 0.4

    def rate(_, y):
        return [y[1], -y[0] + b * (1 - y[0] ** 2) * y[1], b * (1 - y[0] ** 2)]

    def upward(_, y):
        return y[0]

    upward.direction = 1
    truth = solve_ivp(rate, (0, 100), [2.0, 0, 0], "DOP853", events=upward, rtol=1e-12, atol=1e-13)
    period = np.diff(truth.t_events[0])[-1]
    divergence = np.diff(truth.y_events[0][:, 2])[-1]
    assert found.period == pytest.approx(period, rel=1e-9)
    sizes = np.abs(found.multipliers)
    assert sizes[0] == pytest.approx(1.0, abs=1e-8)
    assert sizes[1] == pytest.approx(np.exp(divergence), rel=1e-7)
    assert found.is_stable is True


def test_multipliers_of_a_linear_system_are_exponentials_of_its_eigenvalues():
    model = load("discs")
    found = orbit(model, np.array([0.1, -0.1, 0.0, 0.0, 0.0, 0.0]), 6.2)
    assert found.period == pytest.approx(2 * np.pi, rel=1e-9)
    truth = np.exp(np.linalg.eigvals(state_matrix(model)) * found.period)
    for multiplier in found.multipliers:
        # the pair at 1 is defective up to the error of the period: roots of it
        assert np.min(np.abs(truth - multiplier)) < 1e-6
    assert found.is_stable is None


def test_no_orbit_where_everything_decays(declared):
    model = declared(coordinates={"x": {"initial": 1}}, equations={"x''": "-x - x' + 1"})
    with pytest.raises(IntegrationError, match="no periodic orbit of test is found near the period 6"):
        orbit(model, np.array([3.0, 1.0]), 6.0)


# Transverse exponents


def test_the_transverse_exponent_of_a_linear_system_is_minus_one_over_upsilon():
    model = load("discs", z3=0.2)
    found = transverse(model, anti_phase(model), duration=600.0)
    assert found.exponents[0] == pytest.approx(-1.0 / upsilon(model), rel=2e-3)
    assert found.spread < 1e-4
    values = np.linalg.eigvals(sum_matrix(state_matrix(model), model.coordinates, ("th1", "th2")))
    assert np.sum(found.exponents) == pytest.approx(np.sum(values.real), rel=1e-3)


def test_the_transverse_exponent_is_that_of_floquet_on_an_orbit():
    model = load("duffing")
    cycle = orbit(model, model.initial_state({"x1": 0.8, "x2": -0.8}), 6.0)
    start = {"x1": cycle.state[0], "x2": cycle.state[1], "x1'": cycle.state[3], "x2'": cycle.state[4]}
    found = transverse(model, anti_phase(model), start, duration=400 * cycle.period)
    across = np.sort(cycle.exponents)[:4][::-1]
    # The units of the declared velocities are those of the scales here.
    assert found.exponents[0] == pytest.approx(across[0], rel=0.03)
    assert np.sum(found.exponents) == pytest.approx(np.sum(across), rel=1e-3)


MATHIEU = {
    "coordinates": {"a": {"initial": 0.1}, "b": {"initial": 0.1}},
    "equations": {f"{x}''": f"-(1 + 0.6*cos(2*t + 2))*{x} - 0.05*{x}'" for x in "ab"},
}


def test_the_transverse_exponent_of_a_driven_system_is_that_of_its_monodromy(declared):
    def rates(t, y):
        return [y[1], -(1 + 0.6 * np.cos(2 * t + 2)) * y[0] - 0.05 * y[1]]

    columns = [solve_ivp(rates, (0, np.pi), v, rtol=1e-11, atol=1e-12).y[:, -1] for v in ([1, 0], [0, 1])]
    truth = np.log(np.abs(np.linalg.eigvals(np.column_stack(columns))).max()) / np.pi
    model = declared(**MATHIEU)
    assert transverse(model, in_phase(model), duration=300.0, pieces=70).exponents[0] == pytest.approx(truth, abs=2e-3)


def test_what_a_driven_system_has_not_is_refused(declared):
    model = declared(**MATHIEU)
    with pytest.raises(ModelError, match="the equations of test hold the time: they have no constant matrix"):
        upsilon(model)
    with pytest.raises(ModelError, match="the equations of test hold the time: orbits are looked for in autonomous"):
        orbit(model, np.ones(4), np.pi)


def test_the_anti_phase_manifold_of_systems_of_the_thesis_attracts():
    for name in ("discs_eccentric", "huygens"):
        model = load(name)
        assert transverse(model, anti_phase(model), duration=400.0).exponents[0] < -1e-3, name


def test_a_manifold_that_is_not_invariant_is_refused():
    model = load("setup_undamped")
    with pytest.raises(ModelError, match="it is not invariant"):
        transverse(model, anti_phase(model))
    with pytest.raises(ModelError, match="have 3 columns"):
        transverse(model, np.ones((1, 2)))
    assert in_phase(model).tolist() == [[1.0, -1.0, 0.0]]


# Basins


def test_pendulum_clocks_end_in_anti_phase_unless_they_begin_in_phase():
    angles = np.array([-1.0, -0.5, 0.5, 1.0])
    seen = []
    found = basins(load("huygens"), ("th1", angles), ("th2", angles), duration=400.0, last=20.0, progress=seen.append)
    truth = np.full((4, 4), LABELS.index("anti-phase"))
    np.fill_diagonal(truth, LABELS.index("rest"))  # in-phase motion dies out, by symmetry
    np.testing.assert_array_equal(found.ends, truth)
    assert found.shares()["anti-phase"] == 0.75
    assert seen[-1] == 1.0


def test_the_last_part_must_be_shorter_than_the_whole():
    with pytest.raises(ModelError, match="must be shorter than the duration"):
        basins(load("discs"), ("th1", np.ones(2)), ("th2", np.ones(2)), duration=10.0, last=20.0)


# The verb


def run(capsys, *arguments):
    status = cli.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_the_verb_tells_equilibria_modes_and_the_certificate(capsys, tmp_path):
    status, out, _ = run(capsys, "stability", "discs_eccentric", "--out", tmp_path)
    assert status == 0
    assert "1 equilibrium, and no other (proved)" in out
    assert "proved: every motion converges to the set th1 + th2 = 0, th3 = 0, th1' + th2' = 0, th3' = 0" in out
    assert {p.name for p in tmp_path.iterdir()} == {"stability.html", "stability.json", "eigenvalues.png", "modes.png"}
    told = json.loads((tmp_path / "stability.json").read_text())
    assert told["certificate"]["status"] == "proved"
    assert "<script" not in (tmp_path / "stability.html").read_text()


def test_the_closed_loop_has_the_eigenvalues_of_the_virtual_system(capsys, tmp_path):
    status, out, _ = run(capsys, "stability", "discs", "--kind", "experiment", "--json", "--out", tmp_path)
    told = json.loads(out)
    assert status == 0
    assert told["loop"]["distance"] < 1e-9
    truth = np.linalg.eigvals(state_matrix(load("discs")))
    for real, imaginary in told["loop"]["eigenvalues"]:
        assert np.min(np.abs(truth - complex(real, imaginary))) < 1e-9


def test_the_verb_tells_whether_a_motion_is_chaotic(capsys, tmp_path):
    # Sprott, Chaos and Time-Series Analysis (2003), A.4.5: 0.1034.
    ueda = tmp_path / "ueda.yaml"
    ueda.write_text("name: Ueda\ncoordinates: {x: {initial: 2.5}}\nequations: {x'': -0.05*x' - x**3 + 7.5*sin(t)}\n")
    arguments = ["stability", str(ueda), "--exponent", "2000", "--out", str(tmp_path / "out")]
    assert cli.main([*arguments, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["exponent"]
    assert (told["chaotic"], told["bounded"]) == (True, True)
    assert told["value"] == pytest.approx(0.1034, abs=3.0 * told["error"])


def test_parameters_and_boxes_of_the_verb(capsys, tmp_path):
    numbers = tmp_path / "numbers.json"
    arguments = ("stability", "duffing", "--json", numbers, "--set", "z3=0.1", "--box", "x1=-2:2", "--out", tmp_path)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "x1 in [-2, 2]" in out
    assert json.loads(numbers.read_text())["equilibria"]["box"]["x1"] == [-2.0, 2.0]


def test_a_box_of_velocities_is_what_the_energy_is_looked_at_on(capsys, tmp_path):
    """V' = x'^2 (-d + e x^2) is not positive where |x| <= sqrt(d/e), which is 2.24 m, or 2.24 of the scale."""
    path = tmp_path / "grows.yaml"
    path.write_text(
        "name: Grows\n"
        "scales: {length: {value: l, unit: m}, time: {value: 1/w, unit: s}}\n"
        "coordinates: {x: {unit: m, initial: 0.0005}}\n"
        "parameters: {l: {value: 1, unit: mm}, w: {value: 10, unit: rad/s}, e: {value: 2e5, unit: 1/(m**2*s)}}\n"
        "equations: {x'': -w**2*x - 0.1*w*x' + e*x**2*x'}\n"
        "energy: x'**2/2 + w**2*x**2/2\n"
    )
    arguments = ("stability", path, "--overwrite", "--out", tmp_path / "out")
    assert run(capsys, *arguments)[0] == 0
    assert "the energy can grow" in run(capsys, *arguments)[1]
    status, out, _ = run(capsys, *arguments, "--box", "x=-2:2", "--box", "x'=-3:3")
    assert status == 0
    assert "does not grow while the motion stays in the box |x| <= 2, |x'| <= 3" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("tue_rig",), "has no stability of its own; name a model or an experiment"),
        (("discs", "--box", "th1=1"), "'th1=1' cannot be read; write it as in --box x1=-2:2"),
        (("discs", "--box", "th9=0:1"), "has no coordinate or velocity 'th9'"),
        (("discs", "--box", "th1'=1:1"), "the box of th1' is [1, 1]; give the least value, then the largest"),
        (("discs", "--set", "w9=1"), "did you mean"),
    ],
)
def test_mistakes_of_the_verb(capsys, tmp_path, arguments, words):
    status, _, err = run(capsys, "stability", *arguments, "--out", tmp_path)
    assert status == 2
    assert words in err


def test_an_unknown_state_is_refused():
    with pytest.raises(ModelError, match="has no state 'th9'"):
        state_matrix(load("discs"), {"th9": 0.0})
    with pytest.raises(DeclarationError):
        load("discs", w9=1.0)
