"""Fits one after the other: an oscillator, then its coupling from free motion, against the truth of a twin."""

from dataclasses import replace

import numpy as np
import pytest

from masking.control.rig.twin import Twin
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.inference.estimation.simulation import refined, simulate

RATE = 100.0
NAMES = ("w1", "z1", "w2", "z2", "k")
FREE = ("w1", "z1", "k")  # in the fits; of one twin with one set of these, compiled functions are shared
MODEL = """\
name: two masses
coordinates: {x1: {unit: m}, x2: {unit: m}}
inputs: {u1: {unit: N}, u2: {unit: N}}
parameters:
  w1: {value: 9, unit: rad/s, bounds: [0, null]}
  z1: {value: 0.1, unit: 1}
  w2: {value: 14, unit: rad/s, bounds: [0, null]}
  z2: {value: 0.05, unit: 1}
  k: {value: 6, unit: 1/s**2}
  g: {value: 1, unit: 1/kg}
equations:
  x1'': -w1**2*x1 - 2*z1*w1*x1' + k*(x2 - x1) + g*u1
  x2'': -w2**2*x2 - 2*z2*w2*x2' + k*(x1 - x2) + g*u2
"""
PLANT = """\
name: two masses
kind: simulated
model: model.yaml
sensors:
  s1: {measures: x1, gain: {value: 100, unit: V/m}, unit: V}
  s2: {measures: x2, gain: {value: 100, unit: V/m}, unit: V}
"""


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plant")
    (folder / "model.yaml").write_text(MODEL, encoding="utf-8")
    (folder / "plant.yaml").write_text(PLANT, encoding="utf-8")
    return Twin.load(folder / "plant.yaml")


def recorded(twin, commands, start, seed, name):
    made = Data(name, RATE, commands, np.zeros((len(commands), 2)), twin.delay)
    clean = Sensitivity(twin, (), FREE).simulate(np.empty(0), start, made.acting, rate=RATE, substeps=4)
    return replace(made, readings=clean + 1e-4 * np.random.default_rng(seed).standard_normal(clean.shape))


@pytest.fixture(scope="module")
def records(twin):
    """Return a record of the first mass pushed while the second is held, and one of free motion."""
    alone = twin.with_parameters({"k": 0.0})
    wave = np.random.default_rng(0).standard_normal(1000).repeat(2)[:2000]
    return (
        recorded(alone, np.column_stack([wave, np.zeros(2000)]), np.zeros(4), 1, "alone"),
        recorded(twin, np.zeros((2000, 2)), np.array([0.01, -0.005, 0.0, 0.0]), 2, "free"),
    )


@pytest.fixture(scope="module")
def begun(twin):
    return twin.with_parameters({"w1": 9.6, "z1": 0.15, "k": 0.0})


def test_a_single_oscillator_then_the_coupling_from_free_motion(twin, begun, records):
    """What is not named stays: the second mass is known."""
    alone, free = records
    first = fit(begun, alone, ["w1", "z1"], shared=FREE)
    second = fit(first.twin, free, ["k"], shared=FREE)
    for name in NAMES:
        assert second.twin.parameter_value(name) == pytest.approx(twin.parameter_value(name), rel=5e-3)


def test_a_last_fit_of_all_parameters_gives_their_covariance(twin, begun, records):
    """Free motion tells all three; what the joint fit finds is what a fit from the truth finds."""
    free, names = records[1], ("k", "w1", "z1")
    joint = fit(fit(begun, free, ["k"], shared=FREE).twin, free, names)
    direct = fit(twin, free, names)
    assert (np.abs(joint.values - direct.values) < 0.05 * direct.std).all()
    np.testing.assert_allclose(joint.std, direct.std, rtol=0.05)


def test_a_simulation_begins_where_the_record_does(twin, records):
    made = simulate(twin, records[1], FREE)
    np.testing.assert_allclose(made.readings[0], [1.0, -0.5], atol=1e-3)
    np.testing.assert_allclose(made.residual.std(axis=0), 1e-4, rtol=0.05)
    whole = np.linalg.norm(made.record.readings, axis=0)
    np.testing.assert_allclose(list(made.chi.values()), 1e-4 * np.sqrt(2000) / whole, rtol=0.05)


def test_a_motion_that_runs_away_in_smaller_steps_takes_the_smallest():
    def simulated(number):
        return np.full((4, 1), np.nan) if number > 4 else np.zeros((4, 1))

    assert refined(simulated, 2, 32, np.ones(1), ahead=4) == 32
    assert refined(lambda number: np.zeros((4, 1)), 2, 32, np.ones(1), ahead=4) == 2
