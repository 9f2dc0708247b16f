"""Readings that wrap: unwrapped where records are read, also between samples, and refused by controllers."""

import numpy as np
import pytest

from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, ModelError
from masking.inference.estimation.identification_data import Data, turns_of
from masking.model.declaration.plant_units import check_plant_units

MODEL = """
name: motor
coordinates: {th: {meaning: angle, unit: rad}}
inputs: {u: {unit: A}}
parameters: {J: {value: 0.01, unit: kg*m**2}, b: {value: 0.02, unit: N*m*s/rad}, k: {value: 0.1, unit: N*m/A}}
equations: {"J*th''": k*u - b*th'}
"""
T = np.arange(4000) * 0.005
U = np.repeat(np.random.default_rng(5).uniform(-1.0, 3.0, 100), 40)
TURNED = np.cumsum(0.005 * (4.0 + U))  # rad; some 20 turns


def plant(folder, sensor):
    (folder / "motor.yaml").write_text(MODEL)
    file = folder / "plant.yaml"
    file.write_text(f"name: motor\nmodel: motor.yaml\nsensors: {{th: {sensor}}}\n")
    return Twin.load(file)


def record(folder, values):
    np.savetxt(folder / "a.csv", np.c_[T, U, values], delimiter=",", header="t,u,th", comments="", fmt="%.9g")
    return folder / "a.csv"


@pytest.mark.parametrize(
    ("sensor", "unit", "low"),
    [
        ("{measures: th, unit: rad, wraps: 360 deg}", 1.0, 0.0),
        ("{measures: th, unit: rad, wraps: {value: 360, unit: deg}}", 1.0, -np.pi),
        ("{measures: th, unit: deg, wraps: 6.283185307179586 rad}", 180.0 / np.pi, 0.0),
    ],
)
def test_records_are_unwrapped_where_they_are_read(tmp_path, sensor, unit, low):
    file = record(tmp_path, unit * (low + np.mod(TURNED - low, 2.0 * np.pi)))
    twin = plant(tmp_path, sensor)
    assert turns_of(twin)["th"] == pytest.approx(2.0 * np.pi * unit)
    found = Data.read(file, twin)
    np.testing.assert_allclose(found.readings[:, 0], unit * TURNED, atol=1e-5)
    assert found.notes == ()
    between = Data.read(file, twin, resample="400 Hz")
    exact = np.interp(np.arange(len(between)) / 400.0, T, unit * TURNED)
    np.testing.assert_allclose(between.readings[:, 0], exact, atol=0.01 * unit)


def test_what_is_not_declared_is_suspected(tmp_path):
    file = record(tmp_path, np.mod(TURNED, 2.0 * np.pi))
    (note,) = Data.read(file, plant(tmp_path, "{measures: th, unit: rad}")).notes
    assert note.endswith("declare it in the plant: sensors: {th: {wraps: 360 deg}}")


@pytest.mark.parametrize("wraps", ["360", "-360 deg", "deg", "about 360 deg"])
def test_what_is_no_turn_is_refused(tmp_path, wraps):
    with pytest.raises(MaskingError, match=r"wraps"):
        plant(tmp_path, f"{{measures: th, unit: rad, wraps: {wraps}}}")


def test_the_unit_of_a_turn_is_that_of_the_reading(tmp_path):
    twin = plant(tmp_path, "{measures: th, unit: rad, wraps: 5 V}")
    (problem,) = check_plant_units(twin.declaration, twin.base)
    assert problem.message == "th is read in rad, and its turn is in V"


def test_a_controller_follows_readings_that_go_on(tmp_path):
    with pytest.raises(ModelError, match="readings of th wrap, and a controller follows readings that go on"):
        Instruments.of(plant(tmp_path, "{measures: th, unit: rad, wraps: 360 deg}"))
