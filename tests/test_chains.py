"""Chains of first order: two tanks in a row, of which the second is read, from unknown levels; records by scipy."""

import numpy as np
import pytest
from scipy import integrate

import masking

TRUE = {"k1": 0.06, "k2": 0.055, "k3": 0.05, "k4": 0.045}
MODEL = """
name: two tanks
states: {{x1: {{unit: V, initial: 5}}, x2: {{unit: V, initial: 5}}}}
inputs: {{u: {{unit: V}}}}
parameters:
  k1: {{value: {k1}, unit: V**0.5/s, std: 0.02}}
  k2: {{value: {k2}, unit: V**0.5/s, std: 0.02}}
  k3: {{value: {k3}, unit: V**0.5/s, std: 0.02}}
  k4: {{value: {k4}, unit: 1/s, std: 0.02}}
equations: {{"x1'": -k1*sqrt(x1) + k4*u, "x2'": k2*sqrt(x1) - k3*sqrt(x2)}}
outputs: {{y: {{expression: x2, unit: V}}}}
"""


def test_parameters_of_a_chain_with_an_unmeasured_state_are_found(tmp_path):
    """The first level in other units makes the same second one, and the two lags may change places."""
    rng, t = np.random.default_rng(0), 4.0 * np.arange(700)
    u = np.repeat(rng.uniform(1.5, 4.0, 70), 10)

    def rates(at, x):
        flow = TRUE["k2"] * np.sqrt(x[0])
        return [
            -TRUE["k1"] * np.sqrt(x[0]) + TRUE["k4"] * u[min(int(at / 4.0), 699)],
            flow - TRUE["k3"] * np.sqrt(x[1]),
        ]

    y = integrate.solve_ivp(rates, (0.0, t[-1]), [4.0, 7.0], t_eval=t, max_step=4.0, rtol=1e-8).y[1]
    np.savez(tmp_path / "record.npz", t=t, u=u, y=y + 0.01 * rng.standard_normal(len(t)))
    (tmp_path / "model.yaml").write_text(MODEL.format(**dict.fromkeys(TRUE, 0.05)))
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml")
    before, after = found.simulation_error.validation
    assert found.verdict == "none"
    assert after["y"] < 0.1 * before["y"]
    values = dict(zip(found.rig.names, found.explanation.hypothesis.theta, strict=True))
    assert gain(values) == pytest.approx(gain(TRUE), rel=0.01)
    assert min(values.values()) > 0.0


def gain(p):
    """Return the root of the second level at rest over the input, which other units of the first do not change."""
    return p["k2"] * p["k4"] / p["k1"] / p["k3"]
