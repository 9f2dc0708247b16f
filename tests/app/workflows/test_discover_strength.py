"""Discovery where the motion hardly resembles the model's: strong laws, stiff ones, and records in other units.

Records are made here, by the classical Runge-Kutta method in plain Python, in eight steps a sample.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, signal

import masking
from masking.inference.discovery import wrong_parameters
from masking.inference.discovery.search_state import Ground
from masking.reports import discovery_text

M, C, K = 2.0, 1.5, 800.0  # kg, N s/m, N/m: 3.2 Hz, damping ratio 0.019
NOISE = 1e-5  # m
MODEL = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {force: {unit: N}}
parameters: {m: {value: 2, unit: kg, bounds: [0, null]}, c: {value: 1.5, unit: N*s/m}, k: {value: 800, unit: N/m}}
equations: {m*x'': force - c*x' - k*x}
elements: {spring: {displacement: x, unit: N, acts: {x: -1}}}
"""


def motion(force, rate, law, steps=8):
    """Return the displacement (m,) of the mass under a force (m,) that is held between samples."""

    def acceleration(x, v, u):
        return (u - K * x - C * v - law(x, v)) / M

    x, v, h, found = 0.0, 0.0, 1.0 / (rate * steps), np.empty(len(force))
    for i, u in enumerate(force):
        found[i] = x
        for _ in range(steps):
            a1 = acceleration(x, v, u)
            v2 = v + 0.5 * h * a1
            a2 = acceleration(x + 0.5 * h * v, v2, u)
            v3 = v + 0.5 * h * a2
            a3 = acceleration(x + 0.5 * h * v2, v3, u)
            v4 = v + h * a3
            a4 = acceleration(x + h * v3, v4, u)
            x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return found


@pytest.fixture(scope="module")
def discovered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strong")
    (folder / "mass.yaml").write_text(MODEL)

    def record(name, law, *, rate=500.0, seconds=40.0, sign=1.0, scale=1.0, every=1, loud=1.0):
        rng = np.random.default_rng(0)
        t = np.arange(round(seconds * rate)) / rate
        lines = np.arange(10, 241) / 20.0  # Hz, 0.5 to 12
        phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
        force = 4.0 * loud * sum(np.sin(2.0 * np.pi * f * t + p) for f, p in zip(lines, phases, strict=True))
        force /= math.sqrt(len(lines) / 2.0)
        x = motion(force, rate, law) + NOISE * rng.standard_normal(len(t))
        table = np.column_stack([t, sign * force, scale * x])[::every]
        np.savetxt(folder / name, table, delimiter=",", header="t,force,x", comments="", fmt="%.9g")
        return folder / name

    def find(law, *, louder=0.0, **settings):
        made = record("record.csv", law, **settings)
        judge = record("louder.csv", law, loud=louder) if louder else None
        return masking.discover(made, model=folder / "mass.yaml", validation=judge)

    return find


@pytest.mark.parametrize("k3", [pytest.param(4e5, marks=pytest.mark.search), 2e6])
def test_a_strong_spring_is_found(discovered, k3):
    """At the ends of the travel the cubic force is larger than the linear one: the linear model comes out of step.

    From there a fit of the whole record ends in the wrong place, and one in intervals that grow does not.
    """
    found = discovered(lambda x, v: k3 * x**3)
    assert (found.verdict, [(e.name, e.on) for e in found.effects]) == ("named", [("hardening_spring", "spring")])
    assert found.effects[0].parameters["k3"][0] == pytest.approx(k3, rel=1e-3)
    assert found.closed
    assert not found.problem.interval


def test_what_only_the_record_that_judges_shows_is_searched_for_there(discovered):
    found = discovered(lambda x, v: 5e3 * x**3, loud=0.05, louder=1.0)
    assert found.exchanged
    assert (found.verdict, [(e.name, e.on) for e in found.effects]) == ("named", [("hardening_spring", "spring")])
    assert found.effects[0].parameters["k3"][0] == pytest.approx(5e3, rel=0.05)
    assert found.simulation_error.validation[1]["x"] < 1.1 * found.simulation_error.validation_noise_floor["x"]


@pytest.mark.search
def test_friction_that_turns_round_fast_is_simulated_in_finer_steps(discovered):
    """In one step a sample, this is called Stribeck's friction, with less force at rest than while sliding."""
    found = discovered(lambda x, v: 0.5 * math.tanh(v / 1e-3), rate=1000.0, seconds=20.0)
    assert (found.verdict, [(e.name, e.on) for e in found.effects]) == ("named", [("dry_friction", "spring")])
    value, std = found.effects[0].parameters["fc"]
    assert abs(value - 0.5) < 4.0 * std < 1e-3
    assert found.problem.substeps > 1


@pytest.mark.search
def test_a_command_that_is_one_slow_sample_behind_is_a_delay(tmp_path):
    """Fitted without the delay, the mass is so wrong that screens put a lag and a delay of the sensor before it.

    The truth is the exact response to a force that is held between samples.
    """
    m, c, k, rate, count, rng = 0.133, 0.367, 7.08, 15.0, 4000, np.random.default_rng(0)
    t, lines, phases = np.arange(count) / rate, rng.uniform(0.05, 4.0, (40, 1)), rng.uniform(0.0, 2.0 * np.pi, (40, 1))
    force = np.sin(2.0 * np.pi * lines * t + phases).sum(0)
    continuous = np.array([[0.0, 1.0], [-k / m, -c / m]]), np.array([[0.0], [1.0 / m]]), np.eye(2)[:1], np.zeros((1, 1))
    exact = signal.cont2discrete(continuous, 1.0 / rate)
    x = signal.dlsim(exact, np.concatenate([[0.0], force[:-1]]))[1][:, 0]
    x += 5e-4 * x.std() * rng.standard_normal(count)
    model = MODEL.replace("value: 2,", "value: 0.132,").replace("1.5", "0.37").replace("800", "7.1")
    (tmp_path / "mass.yaml").write_text(model)
    np.savetxt(tmp_path / "late.csv", np.column_stack([t, force, x]), delimiter=",", header="t,force,x", comments="")
    found = masking.discover(tmp_path / "late.csv", model=tmp_path / "mass.yaml")
    assert (found.verdict, [(e.name, e.on) for e in found.effects]) == ("named", [("delay", "force")])
    assert found.effects[0].parameters["tau"][0] == pytest.approx(1.0 / rate, abs=1e-4)


@pytest.mark.search
def test_a_command_of_the_other_sign_hides_no_spring(discovered):
    found = discovered(lambda x, v: 5e4 * x**3, sign=-1.0)
    assert (found.verdict, found.closed) == ("named", True)
    told = {(e.name, e.on): e.parameters for e in found.effects}
    assert told["actuator_gain", "force"]["e"][0] == pytest.approx(-2.0, abs=0.02)
    assert told["hardening_spring", "spring"]["k3"][0] == pytest.approx(5e4, rel=0.02)


@pytest.mark.search
def test_commands_that_were_measured_are_told_from_those_that_are_held(discovered):
    found = discovered(lambda x, v: 0.0, rate=4000.0, seconds=20.0, every=8)
    assert found.verdict == "unknown"
    assert found.none_of_these > 0.5
    assert found.first_order_hold["x"] < 0.2 * found.simulation_error.estimation[1]["x"]


@pytest.mark.search
def test_parameters_keep_their_signs_and_bounds(discovered):
    """Readings in mm are a thousand times too large: no mass, damper or spring becomes negative for them."""
    found = discovered(lambda x, v: 5e4 * x**3, scale=1e3)
    assert (found.explanation.hypothesis.theta > 0.0).all()


DAMPER = """name: damper
coordinates: {x: {unit: m}}
inputs: {u: {unit: N}}
parameters: {m: {value: 0.3, unit: kg}, k: {value: 900, unit: N/m}, c: {value: 1.5, unit: N*s/m}}
equations: {"m*x''": u}
elements: {strut: {displacement: x, unit: N, force: k*d + c*d_rate, acts: {x: -1}}}
"""


def shaken(folder, rates, seed, model=DAMPER):
    """Return what is found in 10 s of a linear system (s, s) whose second state is the rate of the mass of 0.3 kg."""
    rng, rate, n = np.random.default_rng(seed), 400.0, len(rates)
    command = signal.sosfilt(signal.butter(2, 15.0, fs=rate, output="sos"), rng.standard_normal(4000))
    push = np.eye(n)[:, 1:2] / 0.3
    system = signal.cont2discrete((np.array(rates), push, np.eye(n)[:1], np.zeros((1, 1))), 1.0 / rate)
    _, moved, _ = signal.dlsim(system, command)
    reading = moved[:, 0] + 1e-3 * moved.std() * rng.standard_normal(len(moved))
    np.savez(folder / "record.npz", t=np.arange(len(command)) / rate, u=command, x=reading)
    (folder / "model.yaml").write_text(model)
    return masking.discover(folder / "record.npz", model=folder / "model.yaml", out=folder / "out")


@pytest.mark.search
def test_a_law_that_takes_the_element_away_is_that_law_instead_of_it(tmp_path):
    """The spring and damper that are declared are a Maxwell element, 1.5 times as stiff: nothing holds the mass."""
    stiffness, tau = 1350.0, 0.03
    found = shaken(tmp_path, [[0.0, 1.0, 0.0], [0.0, 0.0, -stiffness / 0.3], [0.0, 1.0, -1.0 / tau]], seed=12)
    assert found.verdict == "named"
    assert [(cause.name, cause.on) for cause in found.effects] == [("maxwell_element", "strut")]
    values = found.effects[0].parameters
    assert values["k"][0] == pytest.approx(stiffness, rel=0.01)
    assert values["tau"][0] == pytest.approx(tau, rel=0.01)


def test_several_parameters_that_are_far_off_are_named_together(tmp_path):
    """Stiffness and damping are half and a third larger than declared: no other cause is needed."""
    stiffness, damping = 1350.0, 2.0
    found = shaken(tmp_path, [[0.0, 1.0], [-stiffness / 0.3, -damping / 0.3]], seed=13)
    assert found.verdict == "parameter"
    assert {cause.name for cause in found.effects} == {"k", "c"}
    values = {cause.name: cause.parameters[cause.name][0] for cause in found.effects}
    assert values == {"k": pytest.approx(stiffness, rel=1e-3), "c": pytest.approx(damping, rel=0.01)}
    assert "50 % more than declared" in discovery_text.sentence(found)
    again = masking.simulate(tmp_path / "out" / "plant.yaml", tmp_path / "record.npz")
    assert again.chi["x"] == pytest.approx(1e-3, rel=0.05)


def test_no_parameter_is_named_where_a_fit_ended_elsewhere_and_none_is_far_off(tmp_path):
    found = shaken(tmp_path, [[0.0, 1.0], [-900.0 / 0.3, -1.5 / 0.3]], seed=16)
    assert found.verdict == "none"
    base = found.search.base
    elsewhere = replace(base, hypothesis=replace(base.hypothesis, pull=1e9))
    ground = Ground(found.problem, base, found.search.motion, [])
    assert wrong_parameters.several_parameters(ground, elsewhere, [elsewhere]) == []


@pytest.mark.parametrize(
    "known",
    [
        pytest.param(("m",), marks=pytest.mark.search),
        pytest.param(("m", "c"), marks=pytest.mark.search),
        ("m", "k", "c"),
    ],
)
def test_parameters_without_uncertainty_stay_as_they_are(tmp_path, known):
    """The spring is a tenth stiffer than declared; where its stiffness is known, another spring is beside it."""
    model = DAMPER
    for name in known:
        model = re.sub(rf"({name}: {{value: [0-9.]+)", r"\1, std: 0", model)
    found = shaken(tmp_path, [[0.0, 1.0], [-990.0 / 0.3, -1.5 / 0.3]], 15, model)
    assert not {*known} & {*found.problem.rig.names}
    name, expected = ("linear_spring", 90.0) if "k" in known else ("k", 990.0)
    assert [cause.name for cause in found.effects] == [name]
    assert next(iter(found.effects[0].parameters.values()))[0] == pytest.approx(expected, rel=1e-3)


MOTOR = """name: motor
coordinates: {th: {unit: rad}}
inputs: {i: {unit: A}}
parameters:
  J: {value: 0.002, unit: kg*m**2, std: 2e-5}
  b: {value: 0.0011, unit: N*m*s/rad, std: 1e-4}
  kt: {value: 0.05, unit: N*m/A, std: 1e-5}
equations: {"J*th''": kt*i - b*th'}
elements: {shaft: {displacement: th, unit: N*m, acts: {th: -1}}}
"""


@pytest.mark.search
def test_cogging_is_named_over_many_turns(tmp_path):
    """Seven teeth pull at a shaft that turns some twenty times: its force repeats a hundred times within the travel."""
    rate, rng = 200.0, np.random.default_rng(14)
    times = np.arange(3000) / rate
    current = 0.3 + sum(0.2 * np.sin(2.0 * np.pi * f * times + rng.uniform(0.0, 6.0)) for f in (0.1, 0.23, 0.57, 1.3))

    def rates(t, y):
        return [
            y[1],
            (0.05 * current[min(int(t * rate + 1e-9), 2999)] - 0.001 * y[1] - 4e-3 * np.sin(7.0 * y[0])) / 2e-3,
        ]

    state, angles = np.zeros(2), np.zeros(3000)
    for i, t in enumerate(times):
        angles[i] = state[0]
        state = integrate.solve_ivp(rates, (t, t + 1.0 / rate), state, "DOP853", rtol=1e-9, atol=1e-9).y[:, -1]
    assert np.ptp(angles) > 15.0 * 2.0 * np.pi
    np.savez(tmp_path / "record.npz", t=times, i=current, th=angles + 1e-3 * rng.standard_normal(3000))
    (tmp_path / "model.yaml").write_text(MOTOR)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    assert found.verdict == "named"
    assert [(cause.name, cause.on) for cause in found.effects] == [("cogging", "shaft")]
    assert re.fullmatch(
        r"Probabilities: cogging in shaft \d+ % and none of these \d+ %", discovery_text.probability_sentence(found)
    )
    values = {name: value for name, (value, _) in found.effects[0].parameters.items()}
    assert values["pitch"] == pytest.approx(2.0 * np.pi / 7.0, rel=1e-3)
    assert values["a"] == pytest.approx(4e-3, rel=0.03)


PAIR = """name: two carriages
coordinates: {x1: {unit: m}, x2: {unit: m}}
parameters:
  m1: {value: 2, unit: kg}
  m2: {value: 3, unit: kg}
  k1: {value: 900, unit: N/m}
  k2: {value: 2500, unit: N/m}
  c1: {value: 0.2, unit: N*s/m}
  c2: {value: 0.3, unit: N*s/m}
equations: {"m1*x1''": 0, "m2*x2''": 0}
elements:
  coupling: {displacement: x1 - x2, unit: N, force: k1*d + c1*d_rate, acts: {x1: -1, x2: 1}}
  ground: {displacement: x2, unit: N, force: k2*d + c2*d_rate, acts: {x2: -1}}
"""


@pytest.mark.parametrize("drag", [300.0, 60.0])
@pytest.mark.search
def test_strong_damping_is_found_in_a_free_decay_of_which_one_of_two_masses_is_seen(tmp_path, drag):
    """The parameters of the model alone would run to a tenth of their values, since masses have no scale here."""
    times, rng = np.arange(3000) / 100.0, np.random.default_rng(17)

    def rates(t, y):
        x1, x2, v1, v2 = y
        pull = 909.0 * (x1 - x2) + 0.2 * (v1 - v2) + drag * (v1 - v2) * abs(v1 - v2)
        return [v1, v2, -pull / 1.98, (pull - 2480.0 * x2 - 0.3 * v2) / 3.0]

    found = integrate.solve_ivp(rates, (0.0, 30.0), [0.05, -0.03, 0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-13)
    readings = found.y[3]
    readings = readings + 2e-3 * readings.std() * rng.standard_normal(len(times))
    (tmp_path / "model.yaml").write_text(PAIR)
    plant = 'name: bench\nmodel: model.yaml\nsensors: {v2: {measures: "x2\'", unit: m/s}}\n'
    (tmp_path / "plant.yaml").write_text(plant)
    np.savez(tmp_path / "unseen.npz", t=times[2000:], v2=readings[2000:])
    np.savez(tmp_path / "record.npz", t=times[:2000], v2=readings[:2000])
    found = masking.discover(
        tmp_path / "record.npz",
        plant=tmp_path / "plant.yaml",
        validation=tmp_path / "unseen.npz",
        out=tmp_path / "out",
    )
    assert found.verdict == "named"
    assert [(cause.name, cause.on) for cause in found.effects] == [("quadratic_damping", "coupling")]
    assert next(iter(found.effects[0].parameters.values()))[0] == pytest.approx(drag, rel=0.05)
    again = masking.simulate(tmp_path / "out" / "plant.yaml", tmp_path / "record.npz")
    assert again.chi["v2"] == pytest.approx(found.simulation_error.estimation[1]["v2"], rel=0.02)
