"""Discovery on rigs of its users: an actuator that is late, a free decay; records by exact solutions."""

import re

import numpy as np
import pytest
from scipy import integrate, linalg, signal

import masking
from masking.reports import discovery_text

M, K, C = np.array([1.0, 0.5]), np.array([200.0, 90.0]), np.array([1.0, 0.6])
RATE, SAMPLES, NOISE = 500.0, 4000, 1e-3
EQUATIONS = """
parameters:
  m1: {value: 1, unit: kg}
  m2: {value: 0.5, unit: kg}
  k1: {value: 200.5, unit: N/m}
  k2: {value: 90.2, unit: N/m}
  c1: {value: 1, unit: N*s/m}
  c2: {value: 0.6, unit: N*s/m}
elements:
  ground: {displacement: x1, unit: N, acts: {x1: -1}}
  joint: {displacement: x2 - x1, unit: N, acts: {x2: -1, x1: 1}}
equations:
"""
DRIVEN = f"""
name: two masses with two motors
coordinates: {{x1: {{unit: m}}, x2: {{unit: m}}}}
inputs: {{F1: {{unit: N}}, F2: {{unit: N}}}}
{EQUATIONS}
  m1*x1'': -k1*x1 - c1*x1' + k2*(x2 - x1) + c2*(x2' - x1') + F1
  m2*x2'': -k2*(x2 - x1) - c2*(x2' - x1') + F2
"""
FREE = DRIVEN.replace("inputs: {F1: {unit: N}, F2: {unit: N}}", "").replace(" + F1", "").replace(" + F2", "")
PLANT = "name: rig\nmodel: model.yaml\nsensors: {s1: {measures: x1, unit: m}, s2: {measures: x2, unit: m}}\n"


def matrices(k):
    stiffness, damping = ([[a[0] + a[1], -a[1]], [-a[1], a[1]]] for a in (k, C))
    lower = -np.hstack([np.array(stiffness), np.array(damping)]) / M[:, None]
    return np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower]), np.vstack([np.zeros((2, 2)), np.diag(1 / M)])


def saved(folder, model, columns, plant=PLANT):
    (folder / "model.yaml").write_text(model)
    if plant:
        (folder / "plant.yaml").write_text(plant)
    table, head = np.column_stack([*columns.values()]), ",".join(columns)
    np.savetxt(folder / "record.csv", table, delimiter=",", header=head, comments="", fmt="%.9g")
    return folder


def noisy(readings, seed):
    return readings + NOISE * readings.std(axis=0) * np.random.default_rng(seed).standard_normal(readings.shape)


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """The second of two motors acts five samples late."""
    generator, t = np.random.default_rng(1), np.arange(SAMPLES) / RATE
    lines = generator.uniform([[0.2], [0.0]], [[8.0], [6.0]], (2, 2, 10))
    force = np.sin(2 * np.pi * lines[:, 0, :, None] * t + lines[:, 1, :, None]).sum(axis=1).T
    acting = force.copy()
    acting[:, 1] = np.concatenate([np.zeros(5), force[:-5, 1]])
    a, b, *_ = signal.cont2discrete((*matrices(K), np.eye(4), np.zeros((4, 2))), 1 / RATE)
    state, motion = np.zeros(4), np.empty((SAMPLES, 2))
    for i, u in enumerate(acting):
        motion[i] = state[:2]
        state = a @ state + b @ u
    s1, s2 = noisy(motion, 2).T
    columns = {"t": t, "F1": force[:, 0], "F2": force[:, 1], "s1": s1, "s2": s2}
    return saved(tmp_path_factory.mktemp("late"), DRIVEN, columns)


@pytest.mark.parametrize(
    "k2", [pytest.param(90.0, marks=pytest.mark.search, id="as declared"), pytest.param(99.0, id="a stiff joint")]
)
def test_a_free_decay_needs_no_inputs(tmp_path, k2):
    t = np.arange(1500) / RATE
    a, _ = matrices((K[0], k2))
    motion = np.array([linalg.expm(a * time)[:2] @ [0.01, -0.004, 0.0, 0.0] for time in t])
    s1, s2 = noisy(motion, 3).T
    folder = saved(tmp_path, FREE, {"t": t, "s1": s1, "s2": s2})
    found = masking.discover(folder / "record.csv", plant=folder / "plant.yaml", out=tmp_path / "found")
    assert (tmp_path / "found" / "discovery.html").exists()
    if k2 == K[1]:
        assert found.verdict == "none"
    else:
        assert (found.verdict, found.effects[0].name) == ("parameter", "k2")
        assert found.effects[0].parameters["k2"][0] == pytest.approx(k2, rel=0.01)


def test_a_delay_of_one_actuator_has_its_name_time_and_unit(late):
    found = masking.discover(late / "record.csv", plant=late / "plant.yaml", out=late / "found")
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.on) == ("named", "delay", "F2")
    assert effect.parameters["tau"][0] == pytest.approx(5 / RATE, rel=1e-3)
    assert re.match(r"A delay of F2, tau = 0\.0\d+ ± 0\.\d+ s, is missing", discovery_text.sentence(found))


def free_decay(k, band, samples, vs):
    """Return times and displacement (m,) of 1 kg on a spring of k N/m, let go at 0.1 m with dry friction k*band N.

    Friction that sticks is solved by hand: between two turns, x = s band + (X - s band) cos(w t) with s = sign(X) from
    the turn at X, at rest where |X| <= band. Friction k*band*tanh(rate/vs), which creeps there, is integrated by LSODA.
    """
    t, w, turns = np.arange(samples) / 200.0, np.sqrt(k), [0.1]
    if vs:
        law = [lambda _, y: [y[1], -k * y[0] - k * band * np.tanh(y[1] / vs)], (0.0, t[-1]), [0.1, 0.0]]
        return t, integrate.solve_ivp(*law, method="LSODA", t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    while abs(turns[-1]) > band:
        turns.append(2.0 * band * np.sign(turns[-1]) - turns[-1])
    half = np.minimum((t * w / np.pi).astype(int), len(turns) - 1)
    turn = np.array(turns)[half]
    side = band * np.sign(turn)
    return t, np.where(half < len(turns) - 1, side + (turn - side) * np.cos(w * t - np.pi * half), turn)


@pytest.mark.parametrize(
    ("samples", "vs"),
    [pytest.param(3600, 0.0, id="sticks"), pytest.param(4200, 7e-4, marks=pytest.mark.search, id="creeps")],
)
def test_friction_is_named_that_ends_a_free_decay_beyond_the_fitted_part(tmp_path, samples, vs):
    """Where the mass comes to rest, and how it creeps, shows in the last part alone, which is held out."""
    k, band, noise = 40.0, 1.3e-3, 1e-4  # N/m, m, m
    t, x = free_decay(k, band, samples, vs)
    x = x + noise * np.random.default_rng(4).standard_normal(len(t))
    model = (
        "name: mass on a spring\ncoordinates: {x: {unit: m}}\nequations: {m*x'': -k*x}\n"
        "parameters: {m: {value: 1, unit: kg, std: 0}, k: {value: 40.2, unit: N/m}}\n"
        "elements: {guide: {displacement: x, unit: N, acts: {x: -1}}}\n"
    )
    saved(tmp_path, model, {"t": t, "x": x}, plant="")
    found = masking.discover(tmp_path / "record.csv", model=tmp_path / "model.yaml")
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.on) == ("named", "dry_friction", "guide")
    assert effect.parameters["fc"][0] == pytest.approx(k * band, rel=1e-3)
    assert effect.probability > 0.95
    errors = found.simulation_error
    assert errors.validation[1]["x"] < 1.1 * errors.validation_noise_floor["x"]
    assert ("fitted to both records" in discovery_text.sentence(found)) == bool(vs) == bool(errors.fitted_alone)
    if vs:
        assert effect.parameters["vs"][0] == pytest.approx(vs, rel=0.1)
        assert errors.fitted_alone["x"] > 1.2 * errors.validation_noise_floor["x"]


@pytest.mark.search
def test_stribeck_friction_that_creeps_is_one_law(tmp_path):
    """A disc whose speed alone is known, by the classical Runge-Kutta method in steps of 0.5 ms."""
    inertia, drag, low, high, falls, vs, rate = 0.01, 0.02, 0.03, 0.05, 0.4, 0.01, 200.0
    t = np.arange(6000) / rate
    torque = 0.12 * np.sin(2.0 * np.pi * 0.1 * t) + 0.05 * np.sin(2.0 * np.pi * 0.37 * t + 1.0)

    def slope(w, u):
        return (u - drag * w - (low + (high - low) * np.exp(-((w / falls) ** 2))) * np.tanh(w / vs)) / inertia

    w, h, speed = 0.0, 5e-4, np.empty(len(t))
    for i, u in enumerate(torque):
        speed[i] = w
        for _ in range(round(1.0 / (rate * h))):
            a = slope(w, u)
            b = slope(w + 0.5 * h * a, u)
            c = slope(w + 0.5 * h * b, u)
            w += h / 6.0 * (a + 2.0 * b + 2.0 * c + slope(w + h * c, u))
    speed += 5e-3 * np.random.default_rng(7).standard_normal(len(t))
    model = (
        "name: rotating disc\nstates: {w: {unit: rad/s}}\ninputs: {torque: {unit: N*m}}\n"
        "parameters: {J: {value: 0.01, unit: kg*m**2}, b: {value: 0.02, unit: N*m*s/rad}}\n"
        "equations: {w': (torque - b*w)/J}\noutputs: {speed: {expression: w, unit: rad/s}}\n"
        "elements: {bearing: {rate: w, unit: N*m, acts: {w: -1/J}}}\n"
    )
    saved(tmp_path, model, {"t": t, "torque": torque, "speed": speed}, plant="")
    found = masking.discover(tmp_path / "record.csv", model=tmp_path / "model.yaml")
    (effect,) = found.effects
    assert (found.verdict, effect.name, effect.on) == ("named", "stribeck_friction", "bearing")
    for name, value, part in (("fc", low, 0.01), ("fs", high, 0.02), ("vst", falls, 0.05), ("vs", vs, 0.3)):
        assert effect.parameters[name][0] == pytest.approx(value, rel=part)
