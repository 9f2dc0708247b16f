"""Identification of a rig whose input acts through a coil: values by scipy's motion, and how inputs are taken."""

import numpy as np
import pytest
from scipy.signal import lsim, lti

from masking.app.workflows.identify import identify

COIL = """
name: coil
coordinates: {x: {unit: m}}
states: {i: {meaning: current, unit: A}}
inputs: {u: {unit: V}}
parameters:
  m: {value: 0.5, unit: kg, std: 0}
  k: {value: 210, unit: N/m}
  b: {value: 1.5, unit: N*s/m}
  K: {value: 8, unit: N/A, std: 0}
  R: {value: 4.4, unit: ohm}
  L: {value: 0.03, unit: H}
equations: {m*x'': K*i - k*x - b*x', i': (u - R*i - K*x')/L}
"""
TRUE = {"k": 200.0, "b": 1.5, "R": 4.0, "L": 0.02}
RIG = lti([[0.0, 1, 0], [-400, -3, 16], [0, -400, -200]], [[0.0], [0], [50]], [[1.0, 0, 0]], [[0.0]])


def record(folder, *, held):
    """Write a record of 6 s at 1 kHz, of an input that sweeps from 0.5 to 9.5 Hz; held or in straight lines."""
    t = np.arange(6000) * 1e-3
    u = 6 * np.sin(2 * np.pi * (0.5 * t + 0.75 * t**2))
    x = lsim(RIG, u, t, interp=not held)[1]
    noise = np.random.default_rng(0).normal(0.0, 1e-6, len(t))
    path = folder / "record.csv"
    np.savetxt(path, np.column_stack([t, u, x + noise]), delimiter=",", header="t,u,x", comments="")
    (folder / "coil.yaml").write_text(COIL)
    return path


@pytest.mark.parametrize("held", [True, False])
def test_a_coil_is_identified_and_the_hold_of_its_input_is_proposed(tmp_path, held):
    path = record(tmp_path, held=held)
    found = identify(path, model=tmp_path / "coil.yaml")
    proposed = [
        note for note in found.notes if note.startswith("inputs that go in straight lines between samples leave")
    ]
    assert len(proposed) == (not held)
    right = found if held else identify(path, model=tmp_path / "coil.yaml", hold="first-order")
    assert max(right.chi.values()) <= 1.1 * max(right.floor.values())
    np.testing.assert_allclose(right.values, [TRUE[name] for name in right.names], rtol=2e-3)
