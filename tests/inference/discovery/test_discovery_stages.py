"""An effect that unseen data alone show is found in these; motion by scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking
from masking.inference.discovery.discovery_result import Alternative, Estimate, Named
from masking.reports import discovery_text

MODEL = """
name: mass on a spring
coordinates: {x: {unit: m}}
inputs: {f: {unit: N}}
parameters: {m: {value: 1, unit: kg}, c: {value: 1, unit: N*s/m}, k: {value: 400, unit: N/m}}
equations: {m*x'': f}
elements: {spring: {displacement: x, unit: N, force: k*d + c*d_rate, acts: {x: -1}}}
"""
STIFFNESS, EDGE = 3e3, 0.02


@pytest.mark.search
def test_a_stop_that_is_touched_at_the_end_alone_is_found_there(tmp_path):
    rng, t = np.random.default_rng(5), np.arange(3000) / 200.0
    f = np.interp(t, t[::20], rng.standard_normal(150)) * np.where(t < 10.6, 1.0, 12.0)

    def moved(at, y):
        stop = STIFFNESS * max(y[0] - EDGE, 0.0)
        return y[1], np.interp(at, t, f) - y[1] - 400.0 * y[0] - stop

    x = solve_ivp(moved, (0.0, t[-1]), (0.0, 0.0), t_eval=t, rtol=1e-9, atol=1e-12, max_step=1e-3).y[0]
    assert x[t < 10.5].max() < EDGE < x.max()
    np.savez(tmp_path / "record.npz", t=t, f=f, x=x + 1e-5 * rng.standard_normal(len(t)))
    (tmp_path / "model.yaml").write_text(MODEL)
    found = masking.discover(tmp_path / "record.npz", model=tmp_path / "model.yaml", hold="first-order")
    assert found.exchanged
    assert found.as_dict()["exchanged"]
    assert [(one.name, one.on) for one in found.effects] == [("stop", "spring")]
    assert abs(found.effects[0].parameters["edge"][0] - EDGE) < 0.01 * EDGE
    assert "Unseen data alone show it" in discovery_text.sentence(found)


def test_numbers_and_alternatives_of_a_cause_have_names_in_json():
    cause = Named("drag", "strut", {"c": Estimate(2.0, 0.1)}, 0.7, (Alternative("damper", "strut", 0.3),))
    assert cause.as_dict() == {
        "name": "drag",
        "on": "strut",
        "parameters": {"c": {"value": 2.0, "std": 0.1}},
        "probability": 0.7,
        "alternatives": [{"name": "damper", "on": "strut", "probability": 0.3}],
    }
