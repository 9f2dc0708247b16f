"""A coordinate that the model lacks: an oscillator on the second of two masses. Motion by scipy, exact in samples."""

import numpy as np
import pytest
import yaml
from scipy import signal

from masking.app.workflows.discover import discover

MODEL = """
name: two masses
coordinates: {x1: {unit: m}, x2: {unit: m}}
inputs: {u: {unit: N}}
parameters:
  m1: {value: 1.01, unit: kg}
  m2: {value: 0.695, unit: kg}
  k1: {value: 60.5, unit: N/m}
  k2: {value: 39.8, unit: N/m}
  c1: {value: 0.4, unit: N*s/m}
  c2: {value: 0.3, unit: N*s/m}
equations:
  m1*x1'': u - k1*x1 - c1*x1' - k2*(x1 - x2) - c2*(x1' - x2')
  m2*x2'': -k2*(x2 - x1) - c2*(x2' - x1')
"""
RATE, M, NU, ZETA = 200.0, 0.08, 2.2, 0.02


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write the model, and a record of it with one mass more."""
    folder, rng = tmp_path_factory.mktemp("rig"), np.random.default_rng(10)
    t, w = np.arange(8000) / RATE, 2.0 * np.pi * NU
    tones = np.arange(4, 164) / 40.0
    u = 0.1 * np.cos(2.0 * np.pi * tones * t[:, None] + rng.uniform(0.0, 6.0, len(tones))).sum(axis=1)
    k, c = M * w**2, 2.0 * ZETA * M * w
    mass = np.diag([1.0, 0.7, M])
    stiffness = np.array([[100.0, -40.0, 0.0], [-40.0, 40.0 + k, -k], [0.0, -k, k]])
    damping = np.array([[0.7, -0.3, 0.0], [-0.3, 0.3 + c, -c], [0.0, -c, c]])
    inverse, none = np.linalg.inv(mass), np.zeros((3, 3))
    a = np.block([[none, np.eye(3)], [-inverse @ stiffness, -inverse @ damping]])
    b = np.concatenate([np.zeros(3), inverse @ [1.0, 0.0, 0.0]])[:, None]
    step, gain, *_ = signal.cont2discrete((a, b, np.eye(6), np.zeros((6, 1))), 1.0 / RATE)
    states = np.zeros((len(t), 6))
    for i in range(len(t) - 1):
        states[i + 1] = step @ states[i] + gain[:, 0] * u[i]
    x = states[:, :2] + 2e-3 * states[:, :2].std(axis=0) * rng.standard_normal((len(t), 2))
    np.savez(folder / "record.npz", t=t, u=u, x1=x[:, 0], x2=x[:, 1])
    (folder / "model.yaml").write_text(MODEL)
    return folder


def test_its_place_frequency_damping_and_mass_are_found_and_written(files):
    found = discover(files / "record.npz", model=files / "model.yaml", out=files / "out")
    (cause,) = found.effects
    assert (found.verdict, cause.name, cause.on) == ("named", "attached_oscillator", "x2")
    for name, truth in {"m": M, "nu": NU, "zeta": ZETA}.items():
        value, deviation = cause.parameters[name]
        assert abs(value - truth) < 4.0 * deviation < 0.1 * truth
    assert found.simulation_error.over_noise < 1.05
    (written,) = (files / "out" / "models").glob("*.yaml")
    assert "attached_oscillator" in str(yaml.safe_load(written.read_text()))
