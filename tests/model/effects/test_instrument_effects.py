"""Dead time of single actuators: exact against shifted closed forms, the same in loop, plant and identification."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import masking
from masking.control.rig.twin import Twin
from masking.errors import ModelError
from masking.inference.estimation.extended_kalman import extended_kalman
from masking.inference.estimation.fit import fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.inference.estimation.simulation import simulate
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant

RATE, SAMPLES = 100.0, 60
MODEL = """
name: two free masses
coordinates: {x: {meaning: of the first, unit: m}, y: {meaning: of the second, unit: m}}
inputs: {a: {meaning: force, unit: N}, b: {meaning: force, unit: N}}
parameters: {m: {value: 2.0, unit: kg, meaning: mass}}
equations: {x'': a/m, y'': b/m}
"""
PLANT = """
name: two carts
model: carts.yaml
sensors:
  p: {measures: x, unit: m}
  q: {measures: y, unit: m}
effects:
  late: {effect: actuator_delay, at: a, parameters: {tau: TAU}}
"""


def carts(folder, tau):
    """Return the plant: two masses under held forces, the first of which acts late by tau."""
    (folder / "carts.yaml").write_text(MODEL)
    (folder / "plant.yaml").write_text(PLANT.replace("TAU", str(tau)))
    return Twin.load(folder / "plant.yaml")


def moved(forces, late, times):
    """Return the displacement of 2 kg from rest under held forces that act `late` s later, by twofold integration."""
    steps = np.diff(forces, prepend=0.0)
    begun = np.arange(len(forces)) / RATE + late
    return (steps * 0.5 * np.maximum(times[:, None] - begun, 0.0) ** 2).sum(axis=1) / 2.0


@pytest.mark.parametrize("tau", [0.0, 0.004, 0.01, 0.0237, 0.05])
def test_the_simulation_of_a_record_is_exact(tmp_path, tau):
    twin, rng = carts(tmp_path, tau), np.random.default_rng(3)
    commands, times = rng.normal(size=(SAMPLES, 2)), np.arange(SAMPLES) / RATE
    commands[0] = 0.0
    expected = np.array([moved(commands[:, 0], tau, times), moved(commands[:, 1], 0.0, times)]).T
    record = Data("made", RATE, commands, expected, late=twin.late(RATE))
    sensing = Sensitivity(twin, ())
    for substeps in (1, 3):
        basis = sensing.basis(np.empty(0))
        found = sensing.normal_equations(basis, twin.rest(np.zeros(2)), record, np.ones(2), substeps)
        np.testing.assert_allclose(found.simulated, expected, rtol=0, atol=1e-12)


def test_a_plant_and_the_loop_are_the_same(tmp_path):
    twin = carts(tmp_path, 0.0237)
    rng, plant = np.random.default_rng(4), SimulatedPlant(twin)
    plant.configure(Settings(rate=RATE))
    plant.activate()
    commands, read = rng.normal(size=(SAMPLES, 2)), np.empty((SAMPLES, 2))
    commands[0] = 0.0
    for k in range(SAMPLES):
        sample = plant.read()
        read[k] = sample.values
        plant.write(sample.index, commands[k])
    times = np.arange(SAMPLES) / RATE
    assert np.abs(read[:, 1] - moved(commands[:, 1], 0.0, times)).max() < 1e-12
    # Within a step the plant takes the mean of the command: its first moment is off by at most h^2/8 of each change.
    off = np.abs(read[:, 0] - moved(commands[:, 0], 0.0237, times)).max()
    assert off < SAMPLES * np.abs(np.diff(commands[:, 0])).max() / 2.0 / 8.0 / (2.0 * RATE) ** 2


def test_parts_of_a_record_keep_the_commands_under_way():
    rng = np.random.default_rng(5)
    record = Data("made", RATE, rng.normal(size=(40, 2)), np.zeros((40, 2)), late=np.array([2.37, 0.0]))
    np.testing.assert_allclose(record.part(10, 30).acting[1:], record.acting[11:30], rtol=0, atol=1e-12)
    assert math.isclose(record.part(10, 30).late[0], 0.37)


def test_means_over_a_sample_keep_what_a_command_does():
    record = Data("made", RATE, np.eye(8)[:, 2:3], np.zeros((8, 1)), late=1.25)
    np.testing.assert_allclose(record.acting[:, 0], [0, 0, 0, 0.75, 0.25, 0, 0, 0], rtol=0, atol=1e-15)
    assert replace(record, late=0.0).acting is not None


def test_a_late_actuator_is_simulated_as_its_record_was_made(tmp_path):
    twin, rng = carts(tmp_path, 0.0237), np.random.default_rng(6)
    commands, times = rng.normal(size=(SAMPLES, 2)), np.arange(SAMPLES) / RATE
    commands[0] = 0.0
    columns = {"a": commands[:, 0], "b": commands[:, 1]}
    columns |= {"p": moved(commands[:, 0], 0.0237, times), "q": moved(commands[:, 1], 0.0, times)}
    np.savez(tmp_path / "record.npz", t=times, **columns)
    del twin
    found = masking.simulate(tmp_path / "plant.yaml", tmp_path / "record.npz")
    assert max(found.chi.values()) < 1e-9


@pytest.mark.parametrize("begun", [0.0, 0.02])
def test_a_dead_time_is_fitted_with_the_other_parameters(tmp_path, begun):
    """Commands of one actuator act 0.0137 s late, 1.37 samples: closed form, read with another dead time."""
    twin, rng = carts(tmp_path, begun), np.random.default_rng(4)
    commands, times = rng.normal(size=(SAMPLES, 2)), np.arange(SAMPLES) / RATE
    commands[0] = 0.0
    exact = np.array([moved(commands[:, 0], 0.0137, times), moved(commands[:, 1], 0.0, times)]).T
    noise = 1e-6 * rng.standard_normal(exact.shape)
    record = Data("made", RATE, commands, 1.05 * exact + noise, late=twin.late(RATE))
    found = fit(twin, record, ("m", "late_tau"))
    off = (found.values - [2.0 / 1.05, 0.0137]) / np.sqrt(np.diag(found.covariance))
    assert np.abs(off).max() < 3.0
    assert np.sqrt(found.covariance[1, 1]) < 1e-4
    assert found.twin.late(RATE)[0] == pytest.approx(1.37, abs=0.01)
    with pytest.raises(ModelError, match="late_tau: a filter cannot follow a dead time; take the method least-squares"):
        extended_kalman(twin, record, ("late_tau",))


def test_the_first_commands_stand_for_those_before_where_readings_are_too_few(tmp_path):
    """Four readings of either sensor; commands before the record make all but one of them, which gives no speed."""
    twin, rng = carts(tmp_path, 0.025), np.random.default_rng(5)
    commands, times = rng.normal(size=(SAMPLES, 2)), np.arange(SAMPLES) / RATE
    commands[:1] = 0.0
    exact = np.array([moved(commands[:, 0], 0.025, times), moved(commands[:, 1], 0.0, times)]).T
    exact += 0.3 * times[:, None] + 0.01
    record = Data("made", RATE, commands, exact + 1e-9 * rng.standard_normal(exact.shape), late=twin.late(RATE))
    made = simulate(twin, record, initial=4 / RATE)
    assert np.abs(made.readings - exact).max() < 1e-5 * np.abs(exact).max()
