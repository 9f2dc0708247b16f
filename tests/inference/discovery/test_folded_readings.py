"""A sensor that reads magnitudes, and beside it a law that its readings hide. Motion by scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.app.workflows.discover import discover

MODEL = """
name: two masses
coordinates: {x1: {unit: m}, x2: {unit: m}}
parameters:
  m1: {value: 1, unit: kg}
  m2: {value: 0.8, unit: kg}
  k1: {value: 90, unit: N/m}
  k2: {value: 50, unit: N/m}
  c1: {value: 0.05, unit: N*s/m}
  c2: {value: 0.04, unit: N*s/m}
equations: {m1*x1'': 0, m2*x2'': 0}
elements:
  spring1: {displacement: x1, unit: N, force: k1*d + c1*d_rate, acts: {x1: -1}}
  spring2: {displacement: x1 - x2, unit: N, force: k2*d + c2*d_rate, acts: {x1: -1, x2: 1}}
"""
PLANT = "name: rig\nmodel: model.yaml\nsensors: {s1: {measures: x1, unit: m}, s2: {measures: x2, unit: m}}\n"
OFF = (1.003, 0.797, 90.5, 49.8, 0.0505, 0.0398)  # the parameters of the rig


@pytest.mark.parametrize(("more", "expected"), [(0.0, ()), (9.0, (("bilinear_spring", "spring1"),))])
def test_a_magnitude_is_named_and_what_it_hides(tmp_path, more, expected):
    m1, m2, k1, k2, c1, c2 = OFF

    def rates(_, y):
        x1, x2, v1, v2 = y
        between = k2 * (x1 - x2) + c2 * (v1 - v2)
        return v1, v2, (-k1 * x1 - more * max(x1, 0.0) - c1 * v1 - between) / m1, between / m2

    t = np.arange(3000) / 40.0
    x = solve_ivp(rates, (0.0, t[-1]), (0.02, -0.03, 0.0, 0.0), "DOP853", t, rtol=1e-10, atol=1e-12).y[:2].T
    x += 1e-3 * x.std(axis=0) * np.random.default_rng(3).standard_normal(x.shape)
    np.savez(tmp_path / "record.npz", t=t, s1=np.abs(x[:, 0]), s2=x[:, 1])
    (tmp_path / "model.yaml").write_text(MODEL)
    (tmp_path / "plant.yaml").write_text(PLANT)
    found = discover(tmp_path / "record.npz", plant=tmp_path / "plant.yaml")
    assert found.verdict == "named"
    assert {(one.name, one.on) for one in found.effects} == {("sensor_magnitude", "s1"), *expected}
    assert found.simulation_error.over_noise < 1.1
