"""A shaft that nothing holds keeps its stroke while it is excited, and one that springs hold is left alone."""

import json

import numpy as np
import pytest

from masking.app.workflows.calibrate import RigCalibration, calibrate
from masking.app.workflows.calibration_excitation import PERIOD, Rig
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import MaskingError
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from masking.lab.runs.holding import Holding
from masking.lab.runs.self_test import self_test

MODEL = {
    "name": "shaft",
    "coordinates": {"th": {"unit": "rad"}},
    "inputs": {"i": {"unit": "A"}},
    "parameters": {
        "J": {"value": 0.004, "unit": "kg*m**2"},
        "b": {"value": 0.01, "unit": "N*m*s/rad"},
        "kt": {"value": 0.2, "unit": "N*m/A"},
    },
    "equations": {"J*th''": "kt*i - b*th'"},
    "elements": {"shaft": {"displacement": "th", "unit": "N*m", "acts": {"th": -1}}},
}
PLANT = {
    "name": "drive",
    "model": "shaft.yaml",
    "sensors": {
        "encoder": {"measures": "th", "gain": {"value": 1, "unit": "rad/rad"}, "unit": "rad", "meaning": "encoder"}
    },
    "limits": {
        "missed": 0.2,
        "inputs": {"i": {"max": 3, "unit": "A"}},
        "coordinates": {"th": {"max": 3, "unit": "rad"}},
    },
    "effects": {
        "noise": {"effect": "noise", "at": "encoder", "parameters": {"sigma": 2e-4}},
        "delay": {"effect": "delay", "parameters": {"samples": 1}},
    },
}


def drive(folder, **effects):
    (folder / "shaft.yaml").write_text(json.dumps(MODEL))
    path = folder / f"drive{len(effects)}.yaml"
    path.write_text(json.dumps(PLANT | {"effects": PLANT["effects"] | effects}))
    return Twin.load(path)


def test_what_springs_hold_is_commanded_as_wanted():
    for name in ("tue_rig", "cart"):
        assert Holding.of(Instruments.of(Twin.load(name)), 1000.0, PERIOD) is None


def test_a_force_that_never_ends_moves_a_free_shaft_by_what_the_virtual_spring_gives(tmp_path):
    """J w^2 (th - th0) = kt i0, where the spring takes a quarter of the largest torque at the stroke, 3 rad."""
    pushed = 0.02
    rig = Rig(drive(tmp_path), SimulatedPlant(drive(tmp_path, bias={
        "effect": "actuator_offset", "at": "i", "parameters": {"u0": pushed}})), lockstep=True)  # fmt: skip
    made = rig.record(np.zeros((6000, 1)), {})
    moved = made["sensor.encoder"][5000:6000].mean()
    assert moved == pytest.approx(pushed / (0.25 * 3.0 / 3.0), rel=0.02)
    assert made["input.i"][5000:6000].mean() == pytest.approx(-pushed, rel=0.02)  # what holds it is recorded


def test_a_limit_of_what_no_actuator_pushes_does_not_weaken_what_is_held(tmp_path):
    """Beside the shaft is a mass on its own spring, with a limit."""
    beside = MODEL["equations"] | {"m*y'' + k*y": "0"}
    more = MODEL["parameters"] | {"m": {"value": 1, "unit": "kg"}, "k": {"value": 100, "unit": "N/m"}}
    places = MODEL["coordinates"] | {"y": {"unit": "m"}}
    (tmp_path / "both.yaml").write_text(
        json.dumps(MODEL | {"name": "both", "coordinates": places, "parameters": more, "equations": beside})
    )
    gauge = {"measures": "y", "gain": {"value": 1, "unit": "m/m"}, "unit": "m", "meaning": "gauge"}
    limits = PLANT["limits"] | {"coordinates": PLANT["limits"]["coordinates"] | {"y": {"max": 0.1, "unit": "m"}}}
    sensors = PLANT["sensors"] | {"gauge": gauge}
    (tmp_path / "both_rig.yaml").write_text(
        json.dumps(PLANT | {"model": "both.yaml", "sensors": sensors, "limits": limits})
    )
    alone, both = (Instruments.of(x) for x in (drive(tmp_path), Twin.load(tmp_path / "both_rig.yaml")))
    held, wanted = Holding.of(both, 1000.0, PERIOD), Holding.of(alone, 1000.0, PERIOD)
    for shift in (0.0, 0.2):
        assert held.step(np.array([shift, 0.05])) == pytest.approx(wanted.step(np.array([shift])))


def test_a_shaft_that_nothing_holds_passes_its_self_test(tmp_path):
    twin = drive(tmp_path)
    found = self_test(twin, SimulatedPlant(twin, 3), lockstep=True)
    assert found.findings == ()
    assert all(0.9 < answer.gain < 1.1 for answer in found.answers if answer.is_clear)


def test_a_shaft_that_nothing_holds_is_calibrated_within_its_stroke(tmp_path):
    """With a bias and friction that its plant file does not have, which would drive it away without bound."""
    bias = {"effect": "actuator_offset", "at": "i", "parameters": {"u0": 0.01}}
    twin = drive(tmp_path)
    settings = RigCalibration(out=tmp_path / "out", seconds=20.0, lockstep=True)
    found = calibrate(twin, SimulatedPlant(drive(tmp_path, bias=bias), 3), settings)
    reach = [
        np.abs(Recording.load(tmp_path / "out" / "records" / n)["sensor.encoder"]).max() for n in ("fit", "unseen")
    ]
    assert max(reach) < 3.0
    assert min(reach) > 0.5
    assert len(found.stages) == 1


def test_an_excitation_that_is_too_large_is_made_smaller(tmp_path):
    """A resonance of a hundredth of the damping: the linear estimate from a small record is far too large."""
    twin = Twin.load("cart")
    rubs = twin.with_parameters({"friction_fc": 0.3})  # in which the small record hardly moves
    said = []
    rig = Rig(twin, SimulatedPlant(rubs), lockstep=True, say=said.append)
    t = np.arange(4000) / 1000.0
    made = rig.record(2.0 * np.sin(2.0 * np.pi * t)[:, None], {})
    assert rig.trips == len(said) > 0
    assert all("POSITION_LIMIT" in text for text in said)
    part = made.manifest["calibration"]["part"]
    assert part == pytest.approx(0.7**rig.trips)
    assert np.abs(made["sensor.encoder"]).max() < 25.1
    assert np.abs(made["input.u"]).max() == pytest.approx(2.0 * part)


class Kept(SimulatedPlant):
    """A rig that stays where a run has left it, as one does; `far` is where it has been."""

    def __init__(self, twin, at):
        super().__init__(twin)
        self._y[0], self.far = at, [at]

    def begin(self, settings):
        before = self._y.copy()
        super().begin(settings)
        self._y[:] = before

    def step(self, command):
        super().step(command)
        self.far.append(float(self._y[0]))


def test_a_free_shaft_is_brought_back_to_its_middle_before_it_is_excited(tmp_path):
    twin = drive(tmp_path)
    plant = Kept(twin, 2.6)
    rig = Rig(twin, plant, lockstep=True)
    made = rig.record(np.zeros((500, 1)), {})
    assert np.abs(made["sensor.encoder"]).max() < 0.04 * 3.0  # where a hundredth of the largest torque would hold it
    assert rig.trips == 0
    assert max(plant.far) < 2.61  # without going the other way first
    assert rig.used == pytest.approx(0.5 + rig.beside, rel=0.3)


def test_a_trip_of_a_free_shaft_is_braked_within_its_limit_and_the_next_try_begins_in_the_middle(tmp_path):
    """An excitation that is too large takes few tries, each from the middle, and never passes the limit itself."""
    twin = drive(tmp_path)
    plant = Kept(twin, 0.0)
    rig = Rig(twin, plant, lockstep=True)
    t = np.arange(3000) / 1000.0
    made = rig.record(2.0 * np.sin(np.pi * t)[:, None], {})
    assert 1 <= rig.trips <= 8
    assert made.manifest["calibration"]["part"] == pytest.approx(0.7**rig.trips)
    assert abs(made["sensor.encoder"][0]) < 0.04 * 3.0
    assert np.abs(plant.far).max() < 3.0


def test_a_shaft_that_lies_beyond_its_limit_is_left_there_with_a_remedy(tmp_path):
    twin = drive(tmp_path)
    plant = Kept(twin, 3.2)
    with pytest.raises(MaskingError, match=r"POSITION_LIMIT.*bring the rig to the middle of its limits by hand"):
        Rig(twin, plant, lockstep=True, retries=3).record(np.zeros((500, 1)), {})
    assert plant.far[-1] == pytest.approx(3.2, rel=1e-3)
