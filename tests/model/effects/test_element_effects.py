"""Effects, elements and internal states: what physics says of each, from closed forms and other integrators."""

import ast
import itertools
import math
from pathlib import Path

import control
import numpy as np
import pytest
import scipy.integrate
import scipy.special
from hypothesis import given
from hypothesis import strategies as st

from masking.errors import DeclarationError, IntegrationError, ModelError
from masking.model import effects
from masking.model.declaration.differentiate import rate_of
from masking.model.declaration.dimensions import check_dimensions, dimension_in
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import check_model
from masking.model.declaration.schema import ModelDeclaration
from masking.model.declaration.units import describe, dimension_of
from masking.model.effects import EFFECTS, Span
from masking.model.modelling.model import Model, load_model

PACKAGE = Path(effects.__file__).parent.parent
IN_ELEMENTS = [name for name, effect in EFFECTS.items() if effect.where == "element"]
OUTSIDE = [name for name, effect in EFFECTS.items() if effect.where in {"sensor", "actuator"} and effect.expression]
LETTERS = {"element": ("d", "d_rate", "d_acc", "t"), "sensor": ("s", "xi"), "actuator": ("u",), "loop": ()}
SIZES = st.floats(-1.0, 1.0)


def nominal(name):
    return {key: entry.nominal for key, entry in EFFECTS[name].parameters.items()}


@pytest.fixture(scope="module")
def oscillator(declared):
    """Return x'' = -k x - c x', with its spring as an element."""
    return declared(
        coordinates={"x": {"initial": 1.0}},
        parameters={"k": 1.0, "c": 0.0},
        equations={"x''": "-k*x - c*x'"},
        elements={"spring": {"displacement": "x", "acts": {"x": -1}}},
    )


def force(name, d=0.0, d_rate=0.0, states=(), **parameters):
    """Return the force of an effect as plain arithmetic of its text gives it."""
    values = {key: entry.value for key, entry in EFFECTS[name].parameters.items()} | parameters
    return Expression(EFFECTS[name].expression).evaluate({"d": d, "d_rate": d_rate, **values, **dict(states)})


def problems(call, *args, **named):
    with pytest.raises(DeclarationError) as caught:
        call(*args, **named)
    return [str(problem) for problem in caught.value.problems]


def derivative(model, t, y, u=()):
    rate = np.empty(len(y))
    model.kernels.derivative(t, np.array(y, float), np.array(u, float), model.values(), rate)
    return rate


class TestDictionary:
    @pytest.mark.parametrize("name", EFFECTS)
    def test_an_entry_is_whole(self, name):
        effect = EFFECTS[name]
        assert effect.name == name
        for text in (effect.meaning, effect.cause, effect.remedy, effect.source):
            assert len(text) > 10
        assert any(year.strip("(),;").isdigit() for year in effect.source.split())
        assert bool(effect.expression) == (name not in {"delay", "actuator_delay"})
        for entry in effect.parameters.values():
            low, high = entry.prior
            assert low < high
            assert low <= entry.nominal <= high
            assert entry.value is None or low <= entry.value <= high
            assert entry.meaning
            least, most = entry.bounds
            assert least is None or least <= low
            assert most is None or high <= most
        names = {*effect.parameters, *effect.states}
        assert not names & {"d", "v", "f", "on", "s", "u", "xi", "t", "d_rate", "d_acc", "label", "at", "effect"}

    @pytest.mark.parametrize("name", [name for name in EFFECTS if EFFECTS[name].expression])
    def test_its_expressions_are_over_what_is_there(self, name):
        effect = EFFECTS[name]
        result, rates = effects.expressions(name)
        allowed = {*LETTERS[effect.where], *effect.parameters, *effect.states, "on"}
        assert result.symbols <= allowed
        assert rates.keys() == effect.states.keys()
        assert all(rate.symbols <= allowed for rate in rates.values())
        used = result.symbols.union(*(rate.symbols for rate in rates.values()))
        assert effect.parameters.keys() - used <= set()

    @pytest.mark.parametrize("name", IN_ELEMENTS)
    @pytest.mark.parametrize("element", ["spring1", "beam"])
    def test_its_units_fit_an_element_with_units(self, name, element):
        attached = load_model("setup").attach(name, element, **nominal(name))
        attached.validate()
        assert np.all(np.isfinite(attached.dimensionless().values()))

    @pytest.mark.parametrize("name", OUTSIDE)
    def test_its_units_fit_a_sensor_or_actuator(self, name):
        effect, units = EFFECTS[name], {"S": "V", "U": "V", "s": "s"}
        entries = {**effect.parameters, **effect.states}
        symbols = {key: dimension_of(effects.unit_of(entry.unit, units)) for key, entry in entries.items()}
        volt = dimension_of("V")
        symbols |= {"s": volt, "u": volt, "xi": dimension_of("1"), "on": dimension_of("1")}
        result, rates = effects.expressions(name)
        assert dimension_in(result, symbols) == volt
        for state, rate in rates.items():
            per_second = describe(symbols[state])
            assert dimension_in(rate, symbols) == dimension_of(f"{per_second}/s")

    def test_parameters_are_made_for_other_places_too(self):
        found = effects.parameters("thermal", "u1_heat", {"r": 2.0}, {"U": "V", "s": "s"})
        assert {name: (p.value, p.unit) for name, p in found.items()} == {
            "u1_heat_on": (1.0, "1"),
            "u1_heat_r": (2.0, describe(dimension_of("W/V**2"))),
            "u1_heat_tau": (10.0, "s"),
            "u1_heat_limit": (8.0, describe(dimension_of("W"))),
        }


class TestLaws:
    def test_dry_friction_takes_the_same_from_every_cycle(self, oscillator):
        # Coulomb: the amplitude falls by 4 fc/k per cycle, which lasts as long as without friction
        k, fc = 4.0, 0.02
        model = oscillator.with_parameters(k=k).attach("dry_friction", "spring", fc=fc, vs=1e-5)
        times = 2.0 * np.pi / math.sqrt(k) * np.arange(6)
        np.testing.assert_allclose(model.simulate(times)["x"], 1.0 - 4.0 * fc / k * np.arange(6), atol=1e-8)

    @pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
    def test_what_sticks_rests_where_friction_holds_it_and_never_creeps(self, oscillator, scale):
        # Coulomb: extremes fall by 2 fc/k from one to the next, and one within fc/k of 0 is the last
        k, fc, step = 4.0, 0.15, 1e-3
        held = {"c": 1.0 / (0.55 * step), "hold": 1.0 / (1.75 * step)}
        model = oscillator.with_parameters(k=k).attach("dry_friction", "spring", fc=scale * fc, **held)
        times = np.array([0.0, 25.0, 2000.0])
        x = model.simulate(times, {"x": scale}, tolerance=1e-8)["x"]
        assert x[1] == pytest.approx(scale * (-1.0) ** 13 * (1.0 - 13 * 2.0 * fc / k), abs=2e-5 * scale)
        assert x[2] == pytest.approx(x[1], abs=1e-9 * scale)

    def test_what_does_not_stick_is_attached_without_a_memory(self, oscillator):
        smooth = oscillator.attach("dry_friction", "spring", fc=1.0)
        assert not smooth.declaration.states
        assert force("dry_friction", d_rate=2e-3, fc=3.0) == pytest.approx(3.0 * math.tanh(2.0))

    @pytest.mark.parametrize("k3", [3.0, -0.6])
    def test_a_cubic_spring_has_the_period_of_the_elliptic_integral(self, oscillator, k3):
        # Kovacic and Brennan (2011): T = 4 K(m)/sqrt(k + k3 A^2), m = k3 A^2/(2 (k + k3 A^2))
        model = oscillator.attach("hardening_spring", "spring", k3=k3)
        assert model.kernels.meta["method"] == "taylor"
        period = 4.0 * scipy.special.ellipk(k3 / (2.0 * (1.0 + k3))) / math.sqrt(1.0 + k3)
        np.testing.assert_allclose(model.simulate([0.0, period / 2.0, period])["x"], [1.0, -1.0, 1.0], atol=1e-8)

    def test_springs_and_dampers_add_to_what_is_declared(self, oscillator):
        model = oscillator.attach("linear_spring", "spring", k=3.0).attach("viscous_damping", "spring", c=0.2)
        assert derivative(model, 0.0, [1.0, 0.0])[1] == -4.0
        assert derivative(model, 0.0, [0.0, 1.0])[1] == -0.2
        assert force("quadratic_damping", d_rate=-3.0, c=2.0) == -18.0
        assert force("constant_force", f0=2.5) == 2.5

    @pytest.mark.parametrize("is_lagrangian", [False, True])
    def test_an_added_mass_slows_a_spring_down(self, declared, is_lagrangian):
        # w^2 = k/(m0 + m), also where both masses are of the equation of a factor
        parts = {"equations": {"m0*x''": "-k*x"}} if not is_lagrangian else {"lagrangian": "m0*x'**2/2 - k*x**2/2"}
        model = declared(
            coordinates={"x": {"initial": 1.0}},
            parameters={"m0": 2.0, "k": 3.0},
            elements={"spring": {"displacement": "x", "acts": {"x": -1}}},
            **parts,
        ).attach("added_mass", "spring", label="more", m=0.5)
        times = np.linspace(0.0, 9.0, 19)
        np.testing.assert_allclose(model.simulate(times)["x"], np.cos(math.sqrt(3.0 / 2.5) * times), atol=1e-8)
        bare = model.with_parameters(more_on=0.0).simulate(times)["x"]
        np.testing.assert_allclose(bare, np.cos(math.sqrt(1.5) * times), atol=1e-8)

    def test_an_inertia_between_two_leaves_their_momentum(self, declared):
        # m1 x1'' + m2 x2'' = 0, and with mu = m1 m2/(m1 + m2) the distance has w^2 = k/(mu + m)
        m1, m2, k, m = 1.0, 3.0, 2.0, 0.4
        model = declared(
            coordinates={"x1": {"initial": 1.0}, "x2": {"initial": 0.0}},
            equations={"x1''": f"-{k / m1}*(x1 - x2)", "x2''": f"{k / m2}*(x1 - x2)"},
            elements={"spring": {"displacement": "x1 - x2", "acts": {"x1": -1.0 / m1, "x2": 1.0 / m2}}},
        ).attach("added_mass", "spring", m=m)
        times = np.linspace(0.0, 9.0, 19)
        run, speed = model.simulate(times), math.sqrt(k / (m1 * m2 / (m1 + m2) + m))
        np.testing.assert_allclose(run["x1"] - run["x2"], np.cos(speed * times), atol=1e-8)
        np.testing.assert_allclose(m1 * run["x1"] + m2 * run["x2"], m1, atol=1e-8)

    @pytest.mark.parametrize("is_lagrangian", [False, True])
    def test_a_mass_at_the_end_of_an_arm_keeps_its_energy(self, declared, is_lagrangian):
        # d = l sin(th) of a free arm of inertia 1: (1 + m (l cos th)^2) th'^2 is conserved
        parts = {"equations": {"th''": "0"}} if not is_lagrangian else {"lagrangian": "th'**2/2"}
        model = declared(
            coordinates={"th": {"initial": 0.4, "initial_velocity": 0.7}},
            parameters={"l": 2.0},
            elements={"end": {"displacement": "l*sin(th)", "acts": {"th": "-l*cos(th)"}}},
            **parts,
        ).attach("added_mass", "end", m=0.8)
        run = model.simulate(np.linspace(0.0, 8.0, 17))
        energy = (1.0 + 0.8 * (2.0 * np.cos(run["th"])) ** 2) * run["th'"] ** 2
        np.testing.assert_allclose(energy, energy[0], rtol=1e-8)
        assert np.ptp(run["th'"]) > 0.3

    def test_friction_of_stribeck_falls_from_the_static_to_the_sliding_force(self):
        parameters = {"fc": 1.0, "fs": 2.0, "vst": 1e-2, "vs": 1e-6}
        assert force("stribeck_friction", d_rate=1e-5, **parameters) == pytest.approx(2.0, rel=1e-5)
        assert force("stribeck_friction", d_rate=-1.0, **parameters) == -1.0

    @pytest.mark.parametrize("speed", [0.002, -0.01, 0.3])
    def test_bristles_that_slide_give_the_curve_of_stribeck(self, declared, speed):
        # Canudas de Wit et al. (1995), (5): in steady sliding f = (fc + (fs - fc) exp(-(v/vst)^2)) sgn v + s2 v
        model = declared(
            coordinates={"x": {"initial": 0.0, "initial_velocity": speed}},
            equations={"x''": "0"},
            elements={"guide": {"displacement": "x", "acts": {"x": -1}}},
        ).attach("lugre_friction", "guide", label="g", fc=1.0, fs=1.5, vst=0.01, s0=1e3, s1=5.0, s2=0.4)
        moved = model.with_parameters(g_on=0.0).simulate([0.0, 0.05 / abs(speed)])
        np.testing.assert_array_equal(moved["x'"], speed)
        expected = math.copysign(1.0 + 0.5 * math.exp(-((speed / 0.01) ** 2)), speed)
        assert 1e3 * moved["g_z"][-1] == pytest.approx(expected, rel=1e-8)
        out = np.empty(1)
        state = moved.states[-1]
        model.kernels.accelerations(0.0, state[:1], state[1:], np.zeros(0), model.values(), out)
        assert out[0] == pytest.approx(-(expected + 0.4 * speed), rel=1e-7)

    def test_a_force_with_memory_is_that_of_another_integrator(self, oscillator):
        k, zmax, beta, n = 0.8, 0.3, 0.7, 1.5
        model = oscillator.attach("hysteresis", "spring", label="h", k=k, zmax=zmax, beta=beta, n=n)

        def by_hand(t, y):
            x, v, z = y
            slope = 1.0 - (beta * np.sign(v * z) + 1.0 - beta) * np.abs(z / zmax) ** n
            return [v, -x - k * z, v * slope]

        times = np.linspace(0.0, 20.0, 41)
        truth = scipy.integrate.solve_ivp(by_hand, (0.0, 20.0), [1.0, 0.0, 0.0], "LSODA", times, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(model.simulate(times).states, truth.y.T, atol=1e-6)

    def test_a_force_with_memory_yields_in_an_exponential_and_takes_energy(self, oscillator):
        # With beta = 1/2 and n = 1 loading is dz/dx = 1 - z/zmax and unloading dz/dx = 1
        k, zmax = 2.0, 0.4
        model = oscillator.attach("hysteresis", "spring", label="h", k=k, zmax=zmax, n=1.0).with_parameters(h_on=0.0)
        times = np.linspace(0.0, 6.0 * np.pi, 6001)
        run = model.simulate(times, initial={"x": 0.0, "x'": 1.0})  # x = sin t
        rising = times <= np.pi / 2.0
        np.testing.assert_allclose(run["h_z"][rising], zmax * (1.0 - np.exp(-run["x"][rising] / zmax)), atol=1e-8)
        cycle = times >= 4.0 * np.pi
        area = k * np.trapezoid(run["h_z"][cycle], run["x"][cycle])
        assert 0.0 < area < 4.0 * k * zmax  # less than the rectangle between -zmax and zmax
        # loading from -z0 unloads to 0 over z0 and yields over the rest of the stroke of 2
        z0 = np.max(run["h_z"][cycle])
        assert z0 == pytest.approx(zmax * (1.0 - math.exp(-(2.0 - z0) / zmax)), rel=1e-5)
        below = -(z0**2) / 2.0  # integral of z over the stroke up
        above = zmax * (2.0 - z0) - zmax * z0
        assert area == pytest.approx(2.0 * k * (below + above), rel=1e-5)

    def test_play_gives_no_force_and_then_a_linear_one(self):
        for d, expected in ((-0.3, 0.0), (0.5, 0.0), (0.7, 2.0), (-1.5, -10.0)):
            assert force("backlash", d, k=10.0, gap=1.0) == pytest.approx(expected)

    @given(d=SIZES, rate=SIZES, edge=SIZES, c=st.floats(0.0, 50.0), side=st.sampled_from([1.0, -1.0]))
    def test_a_stop_never_pulls(self, d, rate, edge, c, side):
        pushed = force("stop", d, rate, k=100.0, c=c, edge=edge, side=side) * side
        assert pushed >= 0.0
        assert pushed == 0.0 or side * (d - edge) > 0.0

    def test_a_stop_gives_back_the_speed_or_less_of_it(self, declared):
        free = declared(
            coordinates={"x": {"initial": 0.0, "initial_velocity": -2.0}},
            equations={"x''": "0"},
            elements={"stroke": {"displacement": "x", "acts": {"x": -1}}},
        )
        settings = {"k": 400.0, "edge": -1.0, "side": -1.0}
        times = np.array([0.0, 0.5, 0.5 + np.pi / 20.0, 1.0])  # half a period of a spring of 400 long
        run = free.attach("stop", "stroke", **settings).simulate(times, tolerance=1e-12)
        np.testing.assert_allclose(run["x'"], [-2.0, -2.0, 2.0, 2.0], atol=1e-7)
        damped = free.attach("stop", "stroke", c=0.1, **settings).simulate(times)["x'"][-1]
        # Hunt and Crossley (1975): the coefficient of restitution is about 1 - 2 c v/3
        assert damped / 2.0 == pytest.approx(1.0 - 2.0 * 0.1 * 2.0 / 3.0, abs=0.02)

    def test_friction_in_one_part_of_the_stroke(self):
        given_values = {"fc": 2.0, "edge": 5.8, "width": 0.1, "vs": 1e-3}
        assert force("local_friction", 5.0, 1.0, **given_values) == pytest.approx(0.0, abs=1e-6)
        assert force("local_friction", 5.8, 1.0, **given_values) == pytest.approx(1.0)
        assert force("local_friction", 6.6, -1.0, **given_values) == pytest.approx(-2.0, abs=1e-6)
        assert force("local_friction", 5.0, 1.0, side=-1.0, **given_values) == pytest.approx(2.0, abs=1e-6)

    def test_the_measured_springs_are_polynomials_in_the_springs(self):
        ours, theirs = load_model("setup"), load_model("setup_springs")
        p = theirs.parameter_values()
        for i, element in ((1, "spring1"), (2, "spring2"), (3, "beam")):
            texts = {f"k{j}": f"c{i}*nu*({p[f'rho{i}{j}']!r})/l**{j}" for j in range(1, 6)}
            texts |= {"k0": f"c{i}*nu*({p[f'rho{i}0']!r})", "k1": f"{texts['k1']} - w{i}**2"}
            ours = ours.attach("polynomial_spring", element, **texts)
        draw = np.random.default_rng(1)
        for _ in range(20):
            q, v, u = draw.uniform(-5e-3, 5e-3, 3), draw.uniform(-0.1, 0.1, 3), draw.uniform(-0.4, 0.4, 3)
            found, expected = np.empty(3), np.empty(3)
            ours.kernels.accelerations(0.0, q, v, u, ours.values(), found)
            theirs.kernels.accelerations(0.0, q, v, u, theirs.values(), expected)
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


class TestSensorsAndActuators:
    @pytest.mark.parametrize("name", OUTSIDE)
    def test_switched_off_it_passes_what_it_gets(self, name):
        result, _ = effects.expressions(name)
        states = dict.fromkeys(EFFECTS[name].states, 0.9)
        values = {"s": 0.37, "u": 0.37, "xi": 0.4, **nominal(name), **states}
        assert result.evaluate({**values, "on": 0.0}) == 0.37

    @given(x=st.floats(-100.0, 100.0), step=st.sampled_from([0.5, 0.25, 3e-4]))
    def test_a_converter_gives_the_nearest_step(self, x, step):
        for name, subject in (("quantisation", "s"), ("dac_quantisation", "u")):
            found = Expression(EFFECTS[name].expression).evaluate({subject: x, "step": step})
            assert abs(found - x) <= step / 2.0 * (1.0 + 1e-9)
            assert found / step == pytest.approx(round(found / step), abs=1e-9)
            assert Expression(EFFECTS[name].expression).evaluate({subject: x, "step": 0.0}) == x

    @pytest.mark.parametrize(
        ("name", "values", "expected"),
        [
            ("sensor_offset", {"s": 2.0, "e0": 0.1}, 2.1),
            ("sensor_gain", {"s": 2.0, "e": 0.1}, 2.2),
            ("sensor_saturation", {"s": -2.0, "limit": 1.5}, -1.5),
            ("noise", {"s": 2.0, "sigma": 0.1, "xi": -2.0}, 1.8),
            ("actuator_gain", {"u": 2.0, "e": -0.1}, 1.8),
            ("actuator_offset", {"u": 2.0, "u0": 0.1}, 2.1),
            ("saturation", {"u": 2.0, "limit": 1.5}, 1.5),
            ("dead_zone", {"u": -2.0, "width": 0.5}, -1.5),
            ("dead_zone", {"u": 0.4, "width": 0.5}, 0.0),
        ],
    )
    def test_what_it_makes_of_a_value(self, name, values, expected):
        assert effects.expressions(name)[0].evaluate({**values, "on": 1.0}) == pytest.approx(expected)

    def test_a_coil_warms_up_to_its_mean_power(self):
        rate = effects.expressions("thermal")[1]["P"]
        coil = {"u": 0.5, "r": 8.0, "tau": 4.0, "limit": 3.0}
        assert rate.evaluate({**coil, "P": 0.0}) == 0.5
        assert rate.evaluate({**coil, "P": 2.0}) == 0.0

    def test_a_hot_coil_gets_what_keeps_its_mean_power_and_no_more(self):
        result, rates = effects.expressions("thermal")
        hot = {"r": 8.0, "tau": 4.0, "limit": 2.0, "P": 2.0, "on": 1.0}
        assert result.evaluate({**hot, "u": -3.0}) == -0.5
        assert result.evaluate({**hot, "u": 0.4}) == 0.4
        assert result.evaluate({**hot, "u": -3.0, "P": 1.9}) == -3.0
        assert rates["P"].evaluate({**hot, "u": -3.0}) == 0.0


class TestSwitch:
    @pytest.mark.parametrize("name", IN_ELEMENTS)
    def test_switched_off_the_model_is_what_it_was(self, name):
        bare = load_model("setup")
        attached = bare.attach(name, "spring1", label="e", **nominal(name)).with_parameters(e_on=0.0)
        draw = np.random.default_rng(2)
        for _ in range(5):
            y, u = draw.uniform(-0.01, 0.01, 6), draw.uniform(-0.4, 0.4, 3)
            more = draw.uniform(-1e-3, 1e-3, len(attached.states))
            found = derivative(attached, 0.0, [*y, *more], u)[:6]
            np.testing.assert_allclose(found, derivative(bare, 0.0, y, u), rtol=1e-14, atol=1e-16)

    def test_half_on_is_half_the_force(self, oscillator):
        model = oscillator.attach("constant_force", "spring", f0=3.0).with_parameters(spring_constant_force_on=0.5)
        assert derivative(model, 0.0, [0.0, 0.0])[1] == -1.5


class TestAttach:
    def test_one_effect_in_two_places_and_twice_in_one(self):
        model = load_model("setup").attach("dry_friction", "spring1", fc=0.1).attach("dry_friction", "spring2", fc=0.2)
        model = model.attach("dry_friction", "spring1", label="more", fc="2*spring1_dry_friction_fc")
        assert model.value("more_fc") == 0.2
        draw = np.random.default_rng(3)
        y, p = draw.uniform(-0.01, 0.01, 6), model.parameter_values()
        f1, f2 = (f * math.tanh((y[2 + i] - y[5]) / 1e-3) for f, i in ((0.3, 1), (0.2, 2)))
        change = derivative(model, 0.0, y, np.zeros(3)) - derivative(load_model("setup"), 0.0, y, np.zeros(3))
        np.testing.assert_allclose(change[3:], [-f1, -f2, p["mu1"] * f1 + p["mu2"] * f2], rtol=1e-9)

    def test_a_value_with_a_unit_and_one_by_expression(self):
        model = load_model("setup").attach(
            "local_friction", "spring1", label="red", fc="w1**2*l/10", edge={"value": 5.8, "unit": "mm"}
        )
        assert model.value("red_edge") == pytest.approx(5.8e-3)
        assert model.value("red_fc") == pytest.approx(12.5521**2 * 0.5e-3)
        assert model.declaration.parameters["red_edge"].unit == "mm"
        scaled = model.dimensionless()
        assert scaled.value("red_edge") == pytest.approx(1.16)
        assert scaled.value("red_width") == pytest.approx(0.04)

    def test_in_a_lagrangian_it_is_a_generalised_force(self, declared):
        parts = {
            "coordinates": {"x": {"initial": 0.3}, "y": {"initial": -0.1}},
            "parameters": {"m": 2.0},
            "lagrangian": "(m*x'**2 + y'**2)/2 - (x - y)**2/2",
            "forces": {"x": "0.1*t"},
            "elements": {"spring": {"displacement": "x - y", "acts": {"x": -1, "y": 1}}},
        }
        model = declared(**parts).attach("hysteresis", "spring", label="h", k=3.0, zmax=0.1)
        model = model.with_parameters(h_beta=0.75)
        found = derivative(model, 2.0, [0.3, -0.1, 0.2, 0.5, 0.05])
        bare = derivative(declared(**parts), 2.0, [0.3, -0.1, 0.2, 0.5])
        np.testing.assert_allclose(found[2:4] - bare[2:], [-3.0 * 0.05 / 2.0, 3.0 * 0.05])
        # stretched by 0.05 and let go at a rate of -0.3: beta sgn(v z) + 1 - beta = -1/2
        assert found[4] == pytest.approx(-0.3 * (1.0 + 0.5 * 0.5**2))

    def test_a_displacement_need_not_be_linear(self, declared):
        # a spring from the end of an arm of length l to a wall: d = l sin(th), and its rate is l cos(th) th'
        model = declared(
            coordinates={"th": {"initial": 0.4, "initial_velocity": 0.7}},
            parameters={"l": 2.0},
            equations={"th''": "0"},
            elements={"cable": {"displacement": "l*sin(th)", "acts": {"th": "-l*cos(th)"}}},
        ).attach("viscous_damping", "cable", c=3.0)
        arm = 2.0 * math.cos(0.4)
        assert derivative(model, 0.0, [0.4, 0.7])[1] == pytest.approx(-arm * 3.0 * arm * 0.7)

    def test_the_declaration_is_left_as_it_was_and_the_new_one_can_be_written(self):
        bare = load_model("setup")
        before = bare.declaration.canonical()
        attached = bare.attach("lugre_friction", "beam", **nominal("lugre_friction"))
        assert bare.declaration.canonical() == before
        again = Model(ModelDeclaration.model_validate(attached.declaration.canonical()))
        assert again.structure() == attached.structure()
        np.testing.assert_array_equal(again.values(), attached.values())

    def test_elements_are_inherited(self):
        inherited, first = (load_model(name).declaration.elements for name in ("setup_springs", "setup"))
        assert {name: (e.displacement, e.acts) for name, e in inherited.items()} == {
            name: (e.displacement, e.acts) for name, e in first.items()
        }
        assert inherited["beam"].force.text == "w3**2*eta3*d + 2*z3*w3*sigma3*d_rate"  # field by field


class TestErrors:
    @pytest.fixture
    def setup(self):
        return load_model("setup")

    def test_unknown_names(self, setup):
        assert problems(setup.attach, "dry_frictoin", "spring1") == [
            "there is no effect 'dry_frictoin'; did you mean 'dry_friction'?"
        ]
        assert problems(setup.attach, "dry_friction", "sprin1", fc=1.0) == [
            "sprin1: experimental set-up has no element 'sprin1'; did you mean 'spring1'?"
        ]
        assert problems(setup.attach, "dry_friction", "spring1", fd=1.0, vs=0.1) == [
            "spring1_dry_friction: the effect 'dry_friction' has no parameter 'fd'; did you mean 'fc'?",
            "spring1_dry_friction: the effect 'dry_friction' needs values; give fc in m/s**2 (force while sliding, "
            "such as 0.1)",
        ]
        assert problems(setup.attach, "noise", "spring1") == [
            "spring1: the effect 'noise' sits in a sensor, not in an element of a model; declare it in a plant"
        ]
        assert problems(effects.expressions, "delay") == [
            "the effect 'delay' has no expression: it makes commands late"
        ]

    def test_labels_that_are_none_or_taken(self, setup):
        assert problems(setup.attach, "constant_force", "beam", label="1a", f0=1.0) == [
            "1a: '1a' is not a label; a label is made of ASCII letters, digits and _, and starts with a letter"
        ]
        once = setup.attach("constant_force", "beam", f0=1.0)
        assert problems(once.attach, "constant_force", "beam", f0=1.0) == [
            "beam_constant_force: there is already an effect 'beam_constant_force'; give this one another label"
        ]
        other = Model(ModelDeclaration.model_validate(MEMORY | {
            "name": "test", "definitions": {"g_f": "x**2"}, "energy": "g_f",
            "elements": {"spring": {"displacement": "x", "acts": {"x": -1}}},
        }))  # fmt: skip
        assert problems(other.attach, "constant_force", "spring", label="g", f0=1.0) == [
            "g: the name 'g_f' is already used in definitions; give another label"
        ]

    def test_values_that_are_none(self, setup):
        name, at = "constant_force", "beam"
        assert problems(setup.attach, name, at, f0={"value": 1.0, "unit": "mm"}) == [
            "beam_constant_force.f0: the unit mm is not one of m/s**2; give a value in m/s**2"
        ]
        assert problems(setup.attach, name, at, f0=math.nan) == ["beam_constant_force.f0: the value is nan, not finite"]
        assert problems(setup.attach, name, at, f0=[1.0]) == [
            "beam_constant_force.f0: a value is a number, an expression or {value, unit}, not [1.0]"
        ]
        assert problems(setup.attach, name, at, f0="w4*nu") == [
            "beam_constant_force.f0: unknown symbol 'w4'; did you mean 'w3'?\n    w4*nu\n    ^^"
        ]
        assert problems(setup.attach, name, at, f0="w3*l") == [
            "beam_constant_force.f0: the declared unit is m/s**2, the expression m/s\n    w3*l\n    ^^^^"
        ]
        assert problems(setup.attach, "dry_friction", at, fc=-1.0)[0].endswith("is below its lower bound 0")

    def test_a_displacement_without_a_rate(self, declared):
        model = declared(
            coordinates={"x": {}},
            equations={"x''": "-x"},
            elements={"e": {"displacement": "abs(x)", "acts": {"x": -1}}},
        )
        assert problems(model.attach, "constant_force", "e", f0=1.0) == [
            "has no derivative, so that its rate cannot be derived; write a smooth expression, such as x1 - x3\n"
            "    abs(x)\n    ^^^^^^"
        ]


MEMORY = {
    "coordinates": {"x": {"initial": 1.0}},
    "states": {"z": {"meaning": "a filtered x", "initial": 0.5}},
    "equations": {"x''": "-x", "z'": "x - z"},
}


def memory(times):
    """Return z of z' = cos t - z with z = 1/2 at first: (cos t + sin t)/2."""
    return (np.cos(times) + np.sin(times)) / 2.0


class TestStates:
    @pytest.mark.parametrize("method", ["taylor", "runge_kutta"])
    def test_an_internal_state_follows_its_equation(self, declared, method):
        model = declared(**MEMORY)
        assert model.states == ("z",)
        times = np.linspace(0.0, 20.0, 41)
        start = model.initial_state({})
        np.testing.assert_array_equal(start, [1.0, 0.0, 0.5])
        run = model.kernels.integrate(times, start, np.zeros(0), np.zeros(0), tolerance=1e-12, method=method)
        np.testing.assert_allclose(run["z"], memory(times), atol=1e-9)
        np.testing.assert_allclose(run["x"], np.cos(times), atol=1e-9)
        assert run.velocities.shape == run.positions.shape == (41, 1)

    def test_it_converges_with_the_order_of_the_integrator(self, declared):
        # x = cos t and z' = x z give z = z0 exp(sin t)
        model, errors = declared(**MEMORY | {"equations": {"x''": "-x", "z'": "x*z"}}), []
        for step in (0.5, 0.25):
            run = model.kernels.integrate(
                np.array([0.0, 4.0]),
                model.initial_state({}),
                np.zeros(0),
                np.zeros(0),
                tolerance=1.0,
                method="runge_kutta",
                fixed_step=step,
            )
            errors.append(abs(run["z"][-1] - 0.5 * math.exp(math.sin(4.0))))
        assert 2**7.5 < errors[0] / errors[1] < 2**9

    def test_a_model_may_have_states_alone(self, declared):
        model = declared(
            states={"z": {"initial": 2.0}}, parameters={"k": 0.5}, equations={"z'": "-k*z"}, outputs={"y": "z**2"}
        )
        times = np.linspace(0.0, 4.0, 5)
        np.testing.assert_allclose(model.simulate(times)["z"], 2.0 * np.exp(-times / 2.0), atol=1e-8)
        np.testing.assert_array_equal(model.to_control().output(0.0, [3.0], []), [9.0])

    def test_values_have_units_and_scales(self, declared):
        model = declared(
            coordinates={"x": {"unit": "m", "initial": 0.0}},
            states={"z": {"unit": "mm", "initial": 3.0}},
            parameters={"tau": {"value": 2.0, "unit": "s"}, "w": {"value": 3.0, "unit": "1/s"}},
            equations={"x''": "-w**2*(x - z)", "z'": "(x - z)/tau"},
            scales={"time": {"value": 2.0, "unit": "s"}, "length": {"value": 6.0, "unit": "mm"}},
        )
        model.validate()
        np.testing.assert_allclose(model.initial_state({}), [0.0, 0.0, 3e-3])
        np.testing.assert_allclose(model.dimensionless().initial_state({"z": 6.0}), [0.0, 0.0, 1.0])
        slow, scaled = model.simulate([0.0, 2.0])["z"], model.dimensionless().simulate([0.0, 1.0])["z"]
        np.testing.assert_allclose(scaled * 6e-3, slow, rtol=1e-8)

    @pytest.mark.parametrize("point", [{}, {"x1": 2e-3, "x1'": 0.03, "x3'": -0.01, "h_z": 4e-4}])
    def test_its_linear_form_is_that_of_finite_differences(self, point):
        model = load_model("setup").attach("hysteresis", "spring1", label="h", **nominal("hysteresis"))
        names = [*model.coordinates, *(f"{c}'" for c in model.coordinates), "h_z"]
        y, u = np.array([point.get(name, 0.0) for name in names]), np.zeros(3)
        steps = 1e-7 * np.eye(7)
        columns = [(derivative(model, 0.0, y + h, u) - derivative(model, 0.0, y - h, u)) / 2e-7 for h in steps]
        linear = model.linearise(at=point)
        assert linear.state_labels == names
        np.testing.assert_allclose(linear.A, np.array(columns).T, rtol=1e-5, atol=1e-5)
        system = model.to_control()
        np.testing.assert_array_equal(system.dynamics(0.0, y, u), derivative(model, 0.0, y, u))
        np.testing.assert_allclose(control.linearize(system, y, u).B, linear.B, rtol=1e-5, atol=1e-5)

    def test_outputs_energy_and_forces_may_use_it(self, declared):
        model = declared(**MEMORY | {"outputs": {"y": "2*z"}, "energy": "x'**2/2 + x**2/2 + z**2"})
        out = np.empty(1)
        model.kernels.outputs(0.0, np.array([1.0]), np.array([0.0, 0.5]), np.zeros(0), np.zeros(0), out)
        assert out[0] == 1.0
        assert model.kernels.energy(0.0, np.array([1.0]), np.array([0.0, 0.5]), np.zeros(0)) == 0.75
        assert model.to_control().output(0.0, [1.0, 0.0, 0.5], []) == pytest.approx(1.0)

    def test_a_lagrangian_may_depend_on_it(self, declared):
        # a mass m = 1 + z that grows: d/dt (m v) = 0
        model = declared(
            coordinates={"x": {"initial": 0.0, "initial_velocity": 2.0}},
            states={"z": ""},
            lagrangian="(1 + z)*x'**2/2",
            equations={"z'": "0.5"},
        )
        times = np.linspace(0.0, 4.0, 5)
        np.testing.assert_allclose(model.simulate(times)["x'"], 2.0 / (1.0 + 0.5 * times), atol=1e-8)

    def test_a_run_that_stops_names_it(self, declared):
        model = declared(states={"z": {"initial": 1.0}}, equations={"z'": "z**2"}, outputs={"y": "z"})
        with pytest.raises(IntegrationError, match=r"\(z = "):
            model.simulate([0.0, 2.0])

    def test_an_extension_adds_terms_to_its_equation(self, tmp_path):
        (tmp_path / "base.yaml").write_text(
            "coordinates: {x: {initial: 0}}\nstates: {z: memory}\nequations: {x'': -x, z': x - z}\n"
        )
        (tmp_path / "more.yaml").write_text("extends: base.yaml\nterms: {z': '-3*z'}\nstates: {z: {initial: 2}}\n")
        model = load_model(tmp_path / "more.yaml")
        assert model.declaration.states["z"].meaning == "memory"
        np.testing.assert_allclose(model.simulate([0.0, 1.0])["z"], [2.0, 2.0 * math.exp(-4.0)], rtol=1e-8)

    def test_its_rate_may_have_a_factor(self, declared):
        """Tau z' + z = u + F has the solution (u + F) (1 - exp(-t/tau)), whatever stands on which side."""
        times, units = np.linspace(0.0, 3.0, 7), {"inputs": {"u": {"unit": "N"}}, "states": {"z": {"unit": "N"}}}
        units["parameters"] = {"tau": {"value": 0.5, "unit": "s"}, "F": {"value": 3.0, "unit": "N"}}
        cases = (("tau*z'", "u - z", "1"), ("tau*z' + z", "u", "1"), ("z - 2*(u - tau*z')", "-z", "2"))
        for left, right, acts in cases:
            force = {"e": {"displacement": "z", "unit": "N", "force": "F", "acts": {"z": acts}}}
            model = declared(**units, elements=force, equations={left: right})
            model.validate()
            found = model.simulate(times, inputs=[2.0])["z"]
            np.testing.assert_allclose(found, 5.0 * (1.0 - np.exp(-times / 0.5)), rtol=1e-8, atol=1e-9)

    @pytest.mark.parametrize(
        ("left", "factor"),
        [("x*z'", "x"), ("z'**2", "2*z'"), ("k*z'", "k"), ("z' - z'", "0"), ("(k + 1)*z' - z'", "k")],
    )
    def test_a_factor_that_may_vanish_is_refused_where_it_stands(self, declared, left, factor):
        model = declared(**MEMORY | {"parameters": {"k": 0}, "equations": {"x''": "-k*x", left: "x - z"}})
        with pytest.raises(
            ModelError, match="give it parameters alone, with values other than 0, or write z': "
        ) as caught:
            model.validate()
        assert f"the factor of z' is {factor}: it is 0, or may become 0" in str(caught.value)
        assert caught.value.problem is not None

    def test_what_its_structure_and_meta_say(self, declared):
        model = declared(**MEMORY)
        assert model.structure()["states"] == {"z": "1"}
        assert model.kernels.meta["states"] == ["z"]
        with pytest.raises(ModelError, match="has the states x, x', z"):
            model.initial_state({"z'": 1.0})

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                {"equations": {"x''": "-x"}},
                "states.z: the internal state 'z' has no equation; write z': ... under equations",
            ),
            (
                {"equations": {"x''": "-x", "z'": "x", "(z')": "-x"}},
                "equations.(z'): the internal state 'z' has two equations; remove one of them",
            ),
            (
                {"equations": {"x''": "-x - z'", "z'": "x"}},
                "'z'' is a rate of the internal state 'z', which stands only in its own equation; write z': ... under "
                "equations, on the left side without other rates and accelerations\n    -x - z'\n         ^^",
            ),
            (
                {"equations": {"x''": "-x", "2*z' + x''": "x"}},
                "'z'' is a rate of the internal state 'z', which stands only in its own equation; write z': ... under "
                "equations, on the left side without other rates and accelerations\n    2*z' + x''\n      ^^",
            ),
            (
                {"equations": {"x''": "-x", "k*z'": "x"}},
                "unknown symbol 'k'; allowed: x, x', z, t, x'', z'\n    k*z'\n    ^",
            ),
            (
                {"equations": {"x''": "-x", "z'": "x''"}},
                "'x''' is an acceleration, which the equation of an internal state may not contain\n    x''\n    ^^^",
            ),
            (
                {"equations": {"x''": "-x", "z'": "x"}, "inputs": {"z": "twice"}},
                "inputs.z: the name 'z' is already used in states; rename one of them",
            ),
            (
                {"equations": {"x''": "-x", "z'": "x - y"}},
                "unknown symbol 'y'; allowed: x, x', z, t, x''\n    x - y\n        ^",
            ),
        ],
    )
    def test_what_is_wrong_with_one_is_said(self, change, message):
        declaration = ModelDeclaration.model_validate({"name": "test", **MEMORY, **change})
        found = [str(problem) for problem in check_model(declaration)]
        assert message in found

    def test_the_unit_of_its_rate(self, declared):
        model = declared(
            coordinates={"x": {"unit": "m"}},
            states={"z": {"unit": "m"}},
            parameters={"w": {"value": 1, "unit": "1/s"}},
            equations={"x''": "-w**2*z", "z'": "x"},
        )
        found = [str(problem) for problem in check_dimensions(model.declaration)]
        assert found == ["the left side is m/s, the right side m\n    x\n    ^"]


class TestElements:
    @pytest.mark.parametrize(
        ("element", "message"),
        [
            (
                {"displacement": "x", "acts": {"y": -1}},
                "elements.e.acts.y: 'y' is not a coordinate; allowed: x",
            ),
            (
                {"displacement": "x'", "acts": {"x": -1}},
                "'x'' may not be used here; allowed: k, x\n    x'\n    ^^",
            ),
            (
                {"displacement": "k", "acts": {"x": -1}},
                "elements.e.displacement: a displacement must contain a coordinate; write the difference of two, such "
                "as x1 - x3",
            ),
            (
                {"displacement": "x", "acts": {}},
                "elements.e.acts: an element acts on at least one coordinate; write {x1: -1, x3: 1}",
            ),
        ],
    )
    def test_what_is_wrong_with_one_is_said(self, element, message):
        declaration = ModelDeclaration.model_validate(
            {
                "name": "test",
                "coordinates": {"x": ""},
                "parameters": {"k": 1},
                "equations": {"x''": "-k*x"},
                "elements": {"e": element},
            }
        )
        assert message in [str(problem) for problem in check_model(declaration)]

    def test_it_acts_in_an_equation_of_its_own(self, declared):
        model = declared(
            coordinates={"x": ""},
            equations={"2*x''": "-x"},
            elements={"e": {"displacement": "x", "acts": {"x": -1}}},
        ).attach("constant_force", "e", f0=3.0)
        assert derivative(model, 0.0, [0.0, 0.0])[1] == -1.5
        model = declared(
            coordinates={"x": "", "y": ""},
            equations={"x'' + y''": "-x", "y''": "-y"},
            elements={"e": {"displacement": "x", "acts": {"x": -1, "y": 1}}},
        )
        assert [str(problem) for problem in check_model(model.declaration)] == [
            "elements.e.acts.x: no equation has x'' and no other acceleration on its left side; a force on x acts in "
            "such an equation, as x'': ..., or in those of a lagrangian"
        ]

    def test_its_force_may_hold_accelerations_to_the_first_power(self, declared):
        parts = {"coordinates": {"x": {}}, "lagrangian": "x'**2/2 - x**2/2"}
        assert derivative(declared(**parts, forces={"x": "-3*x''"}), 0.0, [1.0, 0.0])[1] == -0.25
        with pytest.raises(ModelError, match="not linear in x''"):
            declared(**parts, forces={"x": "-x''**2"}).validate()

    @pytest.mark.parametrize("is_lagrangian", [False, True])
    def test_its_unit(self, declared, is_lagrangian):
        parts = {
            "coordinates": {"x": {"unit": "m"}},
            "parameters": {"m": {"value": 1, "unit": "kg"}, "k": {"value": 1, "unit": "N/m"}},
            "elements": {"e": {"displacement": "x", "unit": "N", "acts": {"x": "-k" if is_lagrangian else -1}}},
        }
        parts |= {"lagrangian": "m*x'**2/2 - k*x**2/2"} if is_lagrangian else {"equations": {"x''": "-k*x/m"}}
        wanted, found = ("a number without unit", "kg/s**2") if is_lagrangian else ("1/kg", "a number without unit")
        caret = "    -k\n    ^^" if is_lagrangian else "    -1\n    ^^"
        assert [str(problem) for problem in check_dimensions(declared(**parts).declaration)] == [
            f"the force in N must be multiplied by {wanted} to act here, not by {found}\n{caret}"
        ]


RATES = ["x - y", "-x", "p*sin(x)", "x*y/p", "p/x", "sqrt((x - y)**2 + p**2)", "exp(-x)**3", "x**p", "2 - (x - y)",
         "tan(x) - (y - x)", "log(1 + x**2)*tanh(y)", "atan(x)/(1 + y**2)", "-x*-y", "where(p > 0, 1, 2)*x",
         "cosh(x) + sinh(y)", "asin(x/9) - acos(y/9)", "x/y/p", "p"]  # fmt: skip


@pytest.mark.parametrize("text", RATES)
def test_the_rate_of_a_displacement_is_that_of_finite_differences(text):
    expression = Expression(text)
    rate = Expression(rate_of(expression, ("x", "y")))
    h, start, speed = 1e-5, np.array([0.7, -0.4]), np.array([-1.3, 0.6])
    ahead, behind = (
        expression.evaluate(dict(zip(("x", "y"), start + sign * h * speed, strict=True)) | {"p": 1.7})
        for sign in (1.0, -1.0)
    )
    found = rate.evaluate({"x": 0.7, "y": -0.4, "x'": -1.3, "y'": 0.6, "p": 1.7})
    assert found == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("text", RATES)
def test_the_rate_of_a_rate_is_that_of_finite_differences(text):
    rate = Expression(rate_of(Expression(text), ("x", "y")))
    second = Expression(rate_of(rate, ("x", "y", "x'", "y'")))
    h, start, speed, force = 1e-5, np.array([0.7, -0.4]), np.array([-1.3, 0.6]), np.array([0.9, 2.0])

    def at(position, velocity):
        return dict(zip(("x", "y", "x'", "y'"), (*position, *velocity), strict=True)) | {"p": 1.7}

    ahead, behind = (rate.evaluate(at(start + s * speed, speed + s * force)) for s in (h, -h))
    found = second.evaluate(at(start, speed) | {"x''": 0.9, "y''": 2.0})
    assert found == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-6, abs=1e-8)


def test_floor_is_flat_between_its_steps(declared):
    model = declared(
        coordinates={"x": {"initial": 0.0}},
        inputs={"u": "a force"},
        equations={"x''": "-floor(3*x) - x + u"},
    )
    np.testing.assert_array_equal(model.linearise(at={"x": 0.4}).A, [[0.0, 1.0], [-1.0, 0.0]])


# Names of effects that are words of the language, too: arguments, verbs, keys of files and manifests, rows and labels.
ALSO_WORDS = {
    "codegen": {"noise"},
    "cli": {"stop"},
    "declaration": {"delay", "stop"},
    "exports": {"noise"},
    "procedures": {"hysteresis", "noise"},
    "reports": {"delay", "noise", "stop"},
    "runs": {"delay", "noise", "stop"},
}


def test_no_effect_is_named_outside_of_the_dictionary():
    for path in PACKAGE.rglob("*.py"):
        folders = path.relative_to(PACKAGE).parts[:-1]
        if "effects" in folders:
            continue
        texts = {n.value for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Constant)}
        allowed = set[str]().union(*(ALSO_WORDS.get(folder, ()) for folder in folders))
        assert {text for text in texts if isinstance(text, str)} & EFFECTS.keys() <= allowed, path


def test_what_an_entry_names_is_there():
    for effect in EFFECTS.values():
        named = {*effect.factors, *effect.scaled, *effect.calibrated, effect.grows_with, effect.quantum} - {""}
        span = Span(-1.0, 1.0, 1.0, 1.0, 1.0, (1.0,))
        for trial in effect.ways:
            named |= {*trial.factors, *trial.free, *effect.by_step, *effect.at_zero}.union(*trial.starts(span))
        assert named <= effect.parameters.keys()
        assert all(EFFECTS[simpler].where == effect.where for simpler in effect.nested)
        assert effect.is_linear or not effect.absorbed_by


def test_no_two_effects_are_the_same():
    for one, other in itertools.combinations(EFFECTS.values(), 2):
        assert one.meaning != other.meaning


@pytest.mark.parametrize("acts", [1, -1])
def test_a_periodic_force_pushes_as_its_element_acts(tmp_path, acts):
    path, w, t = tmp_path / "mass.yaml", 2.0 * np.pi * 0.25, np.linspace(0.0, 6.0, 25)
    path.write_text(
        f"name: mass\ncoordinates: {{x: {{initial: 0}}}}\nequations: {{x'': 0}}\n"
        f"elements: {{hand: {{displacement: x, acts: {{x: {acts}}}}}}}\n"
    )
    moved = load_model(path).attach("periodic_force", "hand", label="push", a=2.0, nu=0.25).simulate(t)["x"]
    np.testing.assert_allclose(moved, acts * 2.0 / w * (t - np.sin(w * t) / w), atol=1e-8)
