"""Motions that reach a switch and slide along it: when, by closed forms; and motions that cross switches and go on."""

from __future__ import annotations

import re

import numpy as np
import pytest

from masking.errors import IntegrationError
from masking.model.modelling.model import load_model

# What is declared and initial, the switch, and the instant at which the motion gets there.
SLIDING = {
    "relay": ("states: {z: {initial: 1}}", "z': -sign(z)", "z", 1.0),
    "two that meet": (
        "states: {x: {initial: 1.5}, y: {initial: 1}}",
        "x': where(x > y, -2, 2)\n  y': where(y > x, -3, 1.5)",
        "y - x",
        1.0 / 7.0,
    ),
    "thermostat": (
        "states: {T: {initial: 15}}",
        "T': where(T < 20, 5, 0) - 0.1*T",
        "T - 20.0",
        10.0 * np.log(7.0 / 6.0),
    ),
    "sliding mode": (
        "coordinates: {x: {initial: 1}}",
        "x'': -5*sign(x' + 2*x)",
        "x' + x * 2.0",
        (np.sqrt(65.0) - 5.0) / 10.0,
    ),
    "dry friction": ("coordinates: {x: {initial: 1}}", "x'': -x - 0.1*sign(x')", "x'", 5.0 * np.pi),
    "stuck at once": ("coordinates: {x: {initial: 0.005}}", "x'': -100*x - 1.7*sign(x')", "x'", 0.0),
    "step": ("states: {z: {initial: 0}}", "z': 1 - 2*heaviside(z - 1)", "z - 1.0", 1.0),
    "moving switch": ("states: {z: {initial: 2}}", "z': -3*sign(z - t)", "z - t", 0.5),
    "two relays": ("states: {x: {initial: 1}, y: {initial: 1}}", "x': -sign(x)\n  y': -2*sign(y)", "y", 0.5),
    "growing rate": ("states: {z: {initial: 1}}", "z': -sign(z)*(1 + z**2)", "z", np.pi / 4.0),
    "closed case": ("states: {z: {initial: 0}}", "z': where(z <= 0.5, 1, -1)", "z - 0.5", 0.5),
    "belt": ("coordinates: {x: {initial: 0}}", "x'': -x - sign(x' - 0.1)", "x' - 0.1", np.arcsin(0.1)),
}


def load(tmp_path, declared, equations):
    (tmp_path / "m.yaml").write_text(f"name: switched\n{declared}\nequations:\n  {equations}\n")
    return load_model(tmp_path / "m.yaml")


@pytest.mark.parametrize("name", SLIDING)
def test_a_motion_that_slides_is_named_with_its_switch_and_time(name, tmp_path):
    declared, equations, switch, instant = SLIDING[name]
    with pytest.raises(IntegrationError, match=r"both sides lead back to it.* tanh") as raised:
        load(tmp_path, declared, equations).simulate(np.linspace(0.0, 20.0, 21))
    time, along = re.match(r"chattering at t = (\S+) along (.*) = 0:", str(raised.value)).groups()
    assert along == switch
    assert float(time) == pytest.approx(instant, abs=2e-3)


def test_what_crosses_a_switch_goes_on(tmp_path):
    """x'' = -sign(x) from x = 1: parabolas, with a period of 4 sqrt(2)."""
    times = np.linspace(0.0, 400.0, 1001)
    found = load(tmp_path, "coordinates: {x: {initial: 1}}", "x'': -sign(x)").simulate(times)["x"]
    quarter = np.sqrt(2.0)
    phase = np.mod(times, 4.0 * quarter)
    half = np.where(phase < 2.0 * quarter, phase, phase - 2.0 * quarter)
    truth = np.where(phase < 2.0 * quarter, 1.0, -1.0) * (1.0 - half**2 / 2.0) * (half < quarter)
    truth = np.where(half < quarter, truth, -np.sign(2.0 * quarter - phase) * (1.0 - (2.0 * quarter - half) ** 2 / 2.0))
    assert found == pytest.approx(truth, abs=1e-4)


def test_what_is_stiff_and_switches_takes_its_many_steps(tmp_path):
    """z follows cos t by a fast lag, in far more steps than are taken at once: nothing slides."""
    equations = "z': -4e6*(z - cos(t))\n  y': abs(z)*sign(z + 2)"
    found = load(tmp_path, "states: {z: {initial: 1}, y: {initial: 0}}", equations).simulate(np.array([0.0, 0.5, 1.0]))
    assert found.steps > 400_000
    assert found["y"] == pytest.approx(np.sin([0.0, 0.5, 1.0]), abs=1e-5)


def test_runs_of_an_ensemble_that_slide_are_told_apart(tmp_path):
    """z' = a - sign(z) from 1 slides for a below 1, and grows above."""
    model = load(tmp_path, "states: {z: {initial: 1}}\nparameters: {a: 0}", "z': a - sign(z)")
    found = model.simulate(np.array([0.0, 4.0]), ensemble={"a": [0.0, 1.5, 0.5]})
    assert sorted(found.errors) == [0, 2]
    assert "t = 1 along z = 0" in found.errors[0]
    assert "t = 2 along z = 0" in found.errors[2]
    assert found["z"][1] == pytest.approx([1.0, 3.0])
