"""Models: the equations that the program finds are those that others printed, and its energies do what they must."""

from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import sympy as sp

from masking.errors import ModelError
from masking.model.declaration import catalogue, registry
from masking.model.modelling.model import Model

MAPS = Path("/proc/self/maps")


def load(name):
    return Model(registry.load_model(name))


def is_zero(expression):
    """Tell whether an expression vanishes identically; fractions are cleared first, which is all it takes."""
    numerator = sp.numer(sp.together(expression))
    return sp.expand(sp.expand_trig(numerator)).rewrite(sp.cos).equals(0) or sp.simplify(numerator) == 0


def by_name(model):
    return model.equations.symbols.by_name


def test_the_elimination_of_huygens_pendula_is_9_10():
    model = load("huygens")
    s = by_name(model)
    angles = [(s[f"th{i}"], s[f"th{i}'"], s[f"w{i}"], s[f"mu{i}"]) for i in (1, 2)]
    # Rijlaarsdam (2008), (9.10)
    top = sum(mu / 3 * (sp.sin(2 * th) / 2 + w**-2 * v**2 * sp.sin(th)) for th, v, w, mu in angles)
    top += -2 * s["z"] * s["Om"] * s["x'"] - s["Om"] ** 2 * s["x"]
    beam = top / (1 - sum(mu / 3 * sp.cos(th) ** 2 for th, _, _, mu in angles))
    found = model.equations.accelerations
    assert is_zero(sp.expand_trig(found[2] - beam))
    for (th, _, w, _), acceleration in zip(angles, found[:2], strict=True):
        assert is_zero(sp.expand_trig(acceleration + w**2 * (beam * sp.cos(th) + sp.sin(th))))  # (9.4), (9.5)


def test_the_pendula_from_their_lagrangian_are_the_same():
    ours, theirs = load("huygens"), load("huygens_lagrangian")
    assert ours.coordinates == theirs.coordinates
    assert ours.parameters == theirs.parameters
    for a, b in zip(ours.equations.accelerations, theirs.equations.accelerations, strict=True):
        assert is_zero(a - b)


def test_the_set_up_from_its_lagrangian_is_the_same():
    ours, theirs = load("setup"), load("setup_lagrangian")
    s, m = by_name(ours), by_name(theirs)
    # w_i^2 = k_i/m_i, 2 z_i w_i = b_i/m_i, mu_i = m_i/m3, c_i = k_vi/m_i
    known = {}
    for i in (1, 2, 3):
        known[m[f"k{i}"]] = m[f"m{i}"] * s[f"w{i}"] ** 2
        known[m[f"b{i}"]] = m[f"m{i}"] * 2 * s[f"z{i}"] * s[f"w{i}"]
        known[m[f"kv{i}"]] = m[f"m{i}"] * s[f"c{i}"]
    masses = {m[f"m{i}"]: s[f"mu{i}"] * m["m3"] for i in (1, 2)}
    for a, b in zip(ours.equations.accelerations, theirs.equations.accelerations, strict=True):
        assert is_zero(a - b.subs(known).subs(masses))


def test_the_set_up_and_its_lagrangian_have_the_same_numbers():
    ours, theirs = load("setup").parameter_values(), load("setup_lagrangian").parameter_values()
    for i in (1, 2, 3):
        assert theirs[f"k{i}"] / theirs[f"m{i}"] == pytest.approx(ours[f"w{i}"] ** 2, rel=1e-6)
        assert theirs[f"b{i}"] / theirs[f"m{i}"] == pytest.approx(2 * ours[f"z{i}"] * ours[f"w{i}"], rel=1e-5)
        assert theirs[f"kv{i}"] / theirs[f"m{i}"] == pytest.approx(ours[f"c{i}"], rel=1e-6)


def oscillators_damping(s, weights):
    return sum(2 * s[w] * s[f"z{i}"] * s[f"w{i}"] * (s[f"x{i}'"] - s["x3'"]) ** 2 for i, w in weights.items())


def setup_damping(s):
    return oscillators_damping(s, {1: "mu1", 2: "mu2"}) + 2 * s["z3"] * s["w3"] * s["x3'"] ** 2


def supply(s, x):
    return sum(2 * s[f"mu{i}"] * s[f"e{i}"] * s[f"w{i}"] * (s[f"{x}{i}'"] - s[f"{x}3'"]) ** 2 for i in (1, 2))


def control(s, i, j):
    """The power of the forces that setup_controlled adds to oscillator i, where j is the other one."""
    energy = sum(s[f"w{k}"] ** 2 * (s[f"x{k}"] - s["x3"]) ** 2 + (s[f"x{k}'"] - s["x3'"]) ** 2 for k in (1, 2))
    excess = energy / (s["w1"] ** 2 + s["w2"] ** 2) / s["A"] ** 2 - 1
    v, other, w = s[f"x{i}'"], s[f"x{j}'"], s[f"w{i}"]
    damped = s["of_sum"] * (v + other) + s["of_difference"] * (v - other) + s["r"] * excess * (v - s["x3'"])
    return -s[f"mu{i}"] * v * (s["spring"] * w**2 * (s[f"x{i}"] - s[f"x{j}"]) + 2 * w * damped)


# What each model of the registry loses per time: (A.2), (A.3) of Rijlaarsdam (2008) for Duffing and the discs, and
# the forces on dampers times their speeds for the others.
LOSSES = {
    "duffing": lambda s: 2 * s["z3"] * s["w3"] * s["x3'"] ** 2,
    "duffing_si": lambda s: 2 * s["z3"] * s["w3"] * s["x3'"] ** 2,
    "duffing_enoc": lambda s: s["b"] * s["x3'"] ** 2,
    "duffing_driven": lambda s: 2 * s["z3"] * s["w3"] * s["x3'"] ** 2 - supply(s, "x"),
    "discs_driven": lambda s: 2 * s["z3"] * s["w3"] * s["th3'"] ** 2 - supply(s, "th"),
    "setup_driven": lambda s: setup_damping(s) - supply(s, "x"),
    "setup_controlled": lambda s: setup_damping(s) - control(s, 1, 2) - control(s, 2, 1),
    "setup_oscillator": lambda s: 2 * s["z"] * s["w"] * s["x'"] ** 2,
    "discs": lambda s: 2 * s["z3"] * s["w3"] * s["th3'"] ** 2,
    "discs_eccentric": lambda s: 2 * s["z3"] * s["w3"] * s["th3'"] ** 2,
    "discs_enoc": lambda s: 2 * s["z3"] * s["w3"] * s["th3'"] ** 2,
    "huygens": lambda s: 2 * s["z"] * s["Om"] * s["x'"] ** 2,
    "huygens_lagrangian": lambda s: 2 * s["z"] * s["Om"] * s["x'"] ** 2,
    "cart_pendulum": lambda s: s["c"] * s["x'"] ** 2 + s["d"] * s["th'"] ** 2,
    "cart": lambda s: s["c"] * s["x'"] ** 2,
    "two_masses": lambda s: sp.S.Zero,
    "light_cart": lambda s: s["c"] * s["x'"] ** 2,
    "pendula": lambda s: s["b"] * s["x'"] ** 2,
    "setup": setup_damping,
    "setup_identical": setup_damping,
    "setup_undamped": setup_damping,
    "setup_shapes": setup_damping,
    "setup_springs": setup_damping,
    "setup_springs_table": setup_damping,
    "setup_lagrangian": lambda s: (
        sum(s[f"b{i}"] * (s[f"x{i}'"] - s["x3'"]) ** 2 for i in (1, 2)) + s["b3"] * s["x3'"] ** 2
    ),
}


def test_every_energy_of_the_registry_is_checked():
    with_energy = {name for name in catalogue.names("model") if load(name).equations.energy is not None}
    assert with_energy == LOSSES.keys()


@pytest.mark.parametrize("name", LOSSES)
def test_energy_is_lost_in_the_dampers_alone(name):
    equations = load(name).equations
    s, energy = equations.symbols, equations.energy
    rate = sum(sp.diff(energy, q) * v for q, v in zip(s.q, s.v, strict=True))
    rate += sum(sp.diff(energy, v) * a for v, a in zip(s.v, equations.accelerations, strict=True))
    rate = rate.subs(dict.fromkeys(s.u, 0))
    assert is_zero(rate + LOSSES[name](s.by_name))


def test_the_measured_springs_are_the_polynomials_of_table_b_4():
    # (4.14): the static input, in units of nu, that holds the displacement delta, in units of l, is
    # sum_j rho_ij delta^j; the oscillators push against the beam.
    rho = np.array(
        [
            [0.000234722612437, 0.091796394850297, -0.005071505003798, 0.001755823061963, -0.000495321921394,
             0.000455358409592],
            [0.005243242423923, 0.084268742935300, -0.052699540025315, 0.015739329106770, 0.063153998888216,
             0.020271796321899],
            [-0.003305403062789, 0.680504615284765, 0.089803957869115, 0.203236186622692, -0.064473933604213,
             0.017105175330557],
        ]
    )  # fmt: skip
    model = load("setup_springs_table")
    p = model.parameter_values()
    values = {symbol: p[symbol.name] for symbol in model.equations.symbols.p}
    s = by_name(model)
    accelerations = sp.Matrix([a.subs(values) for a in model.equations.accelerations])
    gain = np.array([p["c1"], p["c2"], p["c3"]])
    mu = np.array([p["mu1"], p["mu2"]])
    for delta in ([0.0, 0.0, 0.0], [0.5, -0.7, 0.3], [-1.0, 1.0, -0.4], [0.9, 0.2, 0.8]):
        static = np.array([np.polynomial.polynomial.polyval(d, row) for d, row in zip(delta, rho, strict=True)])
        push = gain * p["nu"] * static
        expected = [-push[0], -push[1], mu @ push[:2] - push[2]]
        x3 = p["l"] * delta[2]
        state = {s["x1"]: p["l"] * delta[0] + x3, s["x2"]: p["l"] * delta[1] + x3, s["x3"]: x3}
        rest = dict.fromkeys([*model.equations.symbols.v, *model.equations.symbols.u], 0)
        found = accelerations.subs(state).subs(rest).evalf()
        np.testing.assert_allclose(np.array(found.tolist(), dtype=float).ravel(), expected, rtol=1e-9, atol=1e-12)


def pendula(n):
    """Declare n of Huygens' pendula on one beam: (9.4)-(9.6) with sums over n."""
    terms = [f"mu{i}/3*(th{i}''*cos(th{i}) - th{i}'**2*sin(th{i}))/w{i}**2" for i in range(n)]
    return {
        "coordinates": {**{f"th{i}": {"initial": 0.3 - 0.2 * i} for i in range(n)}, "x": {"initial": 0.1}},
        "parameters": {
            "Om": 1.3034,
            "z": 0.2041,
            **{f"w{i}": 1 + 0.05 * i for i in range(n)},
            **{f"mu{i}": 0.1 + 0.02 * i for i in range(n)},
        },
        "equations": {
            **{f"th{i}''": f"-w{i}**2*(x''*cos(th{i}) + sin(th{i}))" for i in range(n)},
            "x''": " - ".join(["-Om**2*x - 2*z*Om*x'", *terms]),
        },
    }


def test_five_pendula_take_no_more_than_a_declaration(declared):
    n = 5
    model = declared(**pendula(n))
    w, mu = 1 + 0.05 * np.arange(n), 0.1 + 0.02 * np.arange(n)

    def by_hand(t, y):
        th, x, v, vx = y[:n], y[n], y[n + 1 : -1], y[-1]
        matrix, right = np.eye(n + 1), np.empty(n + 1)
        matrix[:n, n] = w**2 * np.cos(th)
        matrix[n, :n] = mu / 3 * np.cos(th) / w**2
        right[:n] = -(w**2) * np.sin(th)
        right[n] = np.sum(mu / 3 * v**2 * np.sin(th) / w**2) - 1.3034**2 * x - 2 * 0.2041 * 1.3034 * vx
        return np.concatenate([v, [vx], np.linalg.solve(matrix, right)])

    def by_declaration(t, y):
        dy = np.empty(2 * n + 2)
        model.kernels.derivative(t, y, np.zeros(0), model.values(), dy)
        return dy

    times = np.linspace(0.0, 20.0, 11)
    start = np.array([*(0.3 - 0.2 * np.arange(n)), 0.1, *np.zeros(n + 1)])
    np.testing.assert_array_equal(model.initial_state({}), start)
    mine, declared_one = (
        scipy.integrate.solve_ivp(f, (0.0, 20.0), start, "DOP853", times, rtol=1e-11, atol=1e-12).y
        for f in (by_hand, by_declaration)
    )
    np.testing.assert_allclose(declared_one, mine, rtol=0, atol=1e-8)


def test_time_and_a_constant_input_stand_in_the_equations(declared):
    # x'' = u + sin t from rest is u t^2/2 + t - sin t
    model = declared(
        coordinates={"x": {"initial": 0}}, inputs={"u": {"meaning": "force"}}, equations={"x''": "u + sin(t)"}
    )
    times = np.linspace(0.0, 30.0, 31)
    for u in (0.0, -2.0):
        exact = u * times**2 / 2 + times - np.sin(times)
        np.testing.assert_allclose(model.simulate(times, inputs=[u])["x"], exact, atol=1e-7)


class TestErrors:
    def test_not_affine_in_an_input(self, declared):
        model = declared(
            coordinates={"x": {"initial": 0}}, inputs={"u": {"meaning": "force"}}, equations={"x''": "u + u**2"}
        )
        e, (u,) = model.affine.equations, model.equations.symbols.u
        assert e.curves == {u: u * (u + 1)}
        assert [*e.input_force, *e.force] == [1, u]

    def test_not_linear_in_an_acceleration(self, declared):
        model = declared(coordinates={"x": {"initial": 0}}, equations={"x''": "-x - x''**2"})
        with pytest.raises(ModelError) as caught:
            _ = model.equations.accelerations
        assert str(caught.value) == (
            "test: the equations are not linear in x''; accelerations may appear on both sides, but only to the "
            "first power; write an equation that is solved for x'', and the square of a speed as x'**2"
        )

    def test_a_lagrangian_without_a_mass(self, declared):
        model = declared(coordinates={"x": {}, "y": {}}, lagrangian="x'**2/2 - x**2/2 - (x - y)**2/2")
        with pytest.raises(ModelError) as caught:
            _ = model.equations.accelerations
        assert str(caught.value) == "test: the Lagrangian has no kinetic energy in y'; give y a mass"

    def test_equations_that_say_the_same_twice(self, declared):
        model = declared(coordinates={"x": {}, "y": {}}, equations={"x'' + y''": "-x", "2*x'' + 2*y''": "-y"})
        with pytest.raises(ModelError, match="singular whatever the values"):
            _ = model.equations.accelerations
        with pytest.raises(ModelError, match="singular whatever the values"):
            _ = model.kernels

    def test_an_unknown_initial_value(self):
        with pytest.raises(
            ModelError, match=r"^initial value of 'y': coupled Duffing oscillators has the states x1, x2,"
        ):
            load("duffing").initial_state({"y": 1.0})


def test_coordinates_that_are_left_out_begin_as_declared_or_at_0(declared):
    """One solution of x'' = -x is cos t, and y = 0, z = 0.3 cos t are others."""
    equations = {f"{name}''": f"-{name}" for name in "xyz"}
    model = declared(coordinates={"x": {}, "y": {}, "z": {"initial": 0.3}}, equations=equations)
    times = np.linspace(0.0, 5.0, 51)
    for run in (
        model.simulate(times, {"x": 1.0}),
        model.simulate(times, {"x": 1.0}, inputs={}),
        model.simulate(times, ensemble={"x": [1.0]}),
    ):
        for name, size in (("x", 1.0), ("y", 0.0), ("z", 0.3)):
            np.testing.assert_allclose(np.ravel(run[name]), size * np.cos(times), atol=1e-8)


@pytest.mark.skipif(not MAPS.exists(), reason="needs /proc/self/maps")
def test_many_runs_with_other_values_load_nothing_anew():
    model, times = load("huygens"), np.linspace(0.0, 1.0, 3)

    def run(number):
        for i in range(number):
            model.with_parameters(w1=1.0 + 1e-6 * i).simulate(times, {"th1": 0.1})
        return len(MAPS.read_text(encoding="ascii").splitlines())

    assert model.with_parameters(w1=2.0).kernels is model.kernels
    before = run(100)
    assert run(10_000) <= before + 5  # one of each run would be 10 000
