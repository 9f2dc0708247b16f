"""Records of accelerations alone, and parameters of internal states beside coordinates; records by scipy's DOP853."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking

RATE, SAMPLES, NOISE = 1000.0, 8000, 2e-3
ONE = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters: {m: {value: 1, unit: kg}, k: {value: 402, unit: N/m}, c: {value: 2, unit: N*s/m}}
equations: {"x''": "(f - k*x - c*x')/m"}
outputs: {a: {expression: "x''", unit: m/s**2}}
elements: {spring: {displacement: x, unit: N, acts: {x: -1/m}}}
"""
FREE = """
name: two masses that nothing holds
coordinates: {x1: {unit: m}, x2: {unit: m}}
inputs: {f: {unit: N}}
parameters: {m: {value: 1, unit: kg}, k: {value: 402, unit: N/m}, c: {value: 2, unit: N*s/m}}
equations: {"x1''": "(f - k*(x1 - x2) - c*(x1' - x2'))/m", "x2''": "(k*(x1 - x2) + c*(x1' - x2'))/m"}
outputs: {a1: {expression: "x1''", unit: m/s**2}, a2: {expression: "x2''", unit: m/s**2}}
elements: {joint: {displacement: x1 - x2, unit: N, acts: {x1: -1/m, x2: 1/m}}}
"""
RELAXING = """
name: mass on rubber
coordinates: {x: {unit: m}}
states: {z: {unit: m, meaning: stretch that has not relaxed}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 1.01, unit: kg}
  c: {value: 2, unit: N*s/m}
  k: {value: 405, unit: N/m}
  r: {value: 120, unit: N/m, std: 80}
  tau: {value: 0.06, unit: s, std: 0.1, bounds: [1e-3, 10]}
equations: {"x''": "(f - k*x - c*x' - r*z)/m", "z'": "x' - z/tau"}
elements: {spring: {displacement: x, unit: N, acts: {x: -1/m}}}
"""
HYSTERETIC = """
name: mass on a rope
coordinates: {x: {unit: m}}
states: {z: {unit: N, meaning: hysteretic force}}
inputs: {f: {unit: N}}
parameters:
  m: {value: 1, unit: kg}
  c: {value: 2.1, unit: N*s/m}
  k: {value: 400, unit: N/m}
  alpha: {value: 250, unit: N/m, std: 100}
  beta: {value: 70, unit: 1/m, std: 50}
  gamma: {value: 0.2, std: 0.5}
equations: {"x''": "(f - k*x - c*x' - z)/m", "z'": "alpha*x' - beta*(abs(x')*z + gamma*x'*abs(z))"}
elements: {spring: {displacement: x, unit: N, acts: {x: -1/m}}}
"""


def force(t):
    lines = np.array([[0.7, 0.3], [1.3, 2.0], [2.1, 4.1], [2.9, 1.2], [3.7, 5.5], [4.9, 0.9], [6.1, 3.3]])
    return np.sin(2.0 * np.pi * lines[:, :1] * np.atleast_1d(t) + lines[:, 1:]).sum(axis=0)


def record(folder, model, rates, start, *, measured, names):
    """Return model and record of a system, of what is measured of its state (s, m) and its rates (s, m)."""
    t = np.arange(SAMPLES) / RATE
    states = solve_ivp(rates, (0.0, t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-11).y
    read = measured(states, np.array([rates(time, y) for time, y in zip(t, states.T, strict=True)]).T)
    read = read + NOISE * read.std(axis=1, keepdims=True) * np.random.default_rng(2).standard_normal(read.shape)
    np.savez(folder / "record.npz", t=t, f=force(t), **dict(zip(names, read, strict=True)))
    (folder / "model.yaml").write_text(model)
    return {"model": folder / "model.yaml", "hold": "band-limited"}, folder / "record.npz"


def test_a_hidden_spring_is_found_from_the_acceleration_alone(tmp_path):
    def rates(t, y):
        return [y[1], force(t)[0] - 400.0 * y[0] - 3e4 * y[0] ** 3 - 2.0 * y[1]]

    given, file = record(tmp_path, ONE, rates, [2e-3, 0.05], measured=lambda y, v: v[1:2], names=["a"])
    found = masking.discover(file, **given, out=tmp_path / "found")
    assert [(cause.name, cause.on) for cause in found.effects] == [("hardening_spring", "spring")]
    value, deviation = found.effects[0].parameters["k3"]
    assert abs(value - 3e4) < 4.0 * deviation
    # The plant that is written reads the acceleration, too.
    (written,) = masking.simulate(tmp_path / "found" / "plant.yaml", file, hold="band-limited").chi.values()
    assert written < 1.1 * NOISE


@pytest.mark.search
def test_displacements_and_rates_of_a_free_body_need_not_be_observed(tmp_path):
    def rates(t, y):
        joint = 400.0 * (y[0] - y[1]) + 2.0 * (y[2] - y[3]) + 3e4 * (y[0] - y[1]) ** 3
        return [y[2], y[3], force(t)[0] - joint, joint]

    given, file = record(tmp_path, FREE, rates, [0.0] * 4, measured=lambda y, v: v[2:], names=["a1", "a2"])
    found = masking.discover(file, **given)
    assert [(cause.name, cause.on) for cause in found.effects] == [("hardening_spring", "joint")]
    value, deviation = found.effects[0].parameters["k3"]
    assert abs(value - 3e4) < 4.0 * deviation


def relaxing(t, y):
    return [y[1], force(t)[0] - 400.0 * y[0] - 2.0 * y[1] - 150.0 * y[2], y[1] - y[2] / 0.08]


def hysteretic(t, y):
    loops = 90.0 * (abs(y[1]) * y[2] + 0.5 * y[1] * abs(y[2]))
    return [y[1], force(t)[0] - 400.0 * y[0] - 2.0 * y[1] - y[2], 300.0 * y[1] - loops]


@pytest.mark.parametrize(
    ("model", "rates", "start", "truth"),
    [
        (RELAXING, relaxing, [2e-3, 0.05, 4e-3], [1.0, 2.0, 400.0, 150.0, 0.08]),
        (HYSTERETIC, hysteretic, [2e-3, 0.05, 0.8], [1.0, 2.0, 400.0, 300.0, 90.0, 0.5]),
    ],
    ids=["relaxation", "hysteresis"],
)
def test_parameters_of_an_internal_state_are_fitted_beside_coordinates(tmp_path, model, rates, start, truth):
    given, file = record(tmp_path, model, rates, start, measured=lambda y, v: y[:1], names=["x"])
    (tmp_path / "plant.yaml").write_text("name: p\nmodel: model.yaml\nsensors: {x: {measures: x, unit: m}}\n")
    found = masking.identify(file, plant=tmp_path / "plant.yaml", hold=given["hold"])
    assert np.all(np.abs(found.values - truth) < 4.0 * found.std)
    assert found.chi["x"] < 1.1 * NOISE


@pytest.mark.search
def test_a_model_whose_internal_state_is_off_is_missing_nothing(tmp_path):
    given, file = record(tmp_path, RELAXING, relaxing, [2e-3, 0.05, 4e-3], measured=lambda y, v: y[:1], names=["x"])
    found = masking.discover(file, **given)
    assert found.verdict == "none"
    assert found.explanation.hypothesis.theta == pytest.approx([1.0, 2.0, 400.0, 150.0, 0.08], rel=0.01)
