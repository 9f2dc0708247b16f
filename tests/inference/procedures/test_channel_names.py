"""Channels: what a sensor measures, in the unit that the model declares for it; values by hand."""

import numpy as np
import pytest

from masking.control.rig.twin import Twin
from masking.inference.procedures import measurement
from masking.inference.procedures.channel_names import Source
from masking.lab.records.recording import Recording

DISC = """
name: disc
coordinates: {th: {unit: deg}, x: {unit: mm}}
inputs: {u: {unit: N*m}}
parameters: {J: {value: 2, unit: kg*m**2}, m: {value: 1, unit: kg}, l: {value: 1, unit: m}}
equations: {J*th'': u, m*x'': u/l}
"""
PLANT = """
name: rig
model: model.yaml
sensors:
  angle: {measures: th, gain: {value: 2, unit: V/rad}, unit: V}
  speed: {measures: th', gain: {value: 4, unit: V/(rad/s)}, unit: V}
  plain: {measures: th, unit: deg}
  travel: {measures: x, gain: {value: 100, unit: V/m}, unit: V}
  both: {measures: x + th*l, gain: {value: 100, unit: V/m}, unit: V}
"""


@pytest.fixture
def twin(tmp_path):
    (tmp_path / "model.yaml").write_text(DISC)
    (tmp_path / "plant.yaml").write_text(PLANT)
    return Twin.load(tmp_path / "plant.yaml")


@pytest.mark.parametrize(
    ("sensor", "unit", "of_one"),
    [
        ("angle", "deg", 0.5 * 180.0 / np.pi),
        ("speed", "deg/s", 0.25 * 180.0 / np.pi),
        ("plain", "deg", 1.0),
        ("travel", "mm", 10.0),
        ("both", "m", 0.01),  # of no one declared unit
    ],
)
def test_what_a_sensor_measures_is_in_the_declared_unit(twin, sensor, unit, of_one):
    given = Source("record", Recording({"t": np.arange(4.0), f"sensor.{sensor}": np.arange(4.0)}), twin)
    found = given.displacement(sensor)
    assert found.unit == unit
    assert found.values == pytest.approx(of_one * np.arange(4.0))


def test_the_curve_of_a_spring_is_over_degrees(twin):
    """A spring of 0.6 N m/rad, whose angle is read with 2 V/rad: 0.6 pi / 180 N m for each degree."""
    t = np.arange(6000) / 100.0
    torque = np.interp(t, [0.0, 15.0, 45.0, 60.0], [0.0, 1.0, -1.0, 0.0])
    columns = {"t": t, "input.u": torque, "sensor.angle": 2.0 * torque / 0.6}
    units = {"input.u": {"unit": "N*m"}, "sensor.angle": {"unit": "V"}}
    found = measurement.springs(Source("record", Recording(columns, {"columns": units}), twin), sensor="angle", order=1)
    stiffness = next(row for row in found.rows if row.key == "stiffness")
    assert stiffness.unit == "N*m/deg"
    assert stiffness.value == pytest.approx(0.6 * np.pi / 180.0, rel=1e-6)
