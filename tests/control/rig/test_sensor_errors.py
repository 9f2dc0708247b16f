"""Errors of sensors that a controller knows: it moves the rig as if its sensors were right."""

import json

import numpy as np
import pytest

from masking.analysis.masking_error import masking_error
from masking.errors import ModelError
from masking.lab.runs.error_budget import budget
from masking.lab.runs.experiment import Experiment
from masking.model.effects import EFFECTS
from tests.benchmarks.learning import CART, CART_RUN

ERRORS = {
    "sensor_drift": {"rate": 0.02},
    "sensor_offset": {"e0": 0.1},
    "sensor_gain": {"e": 0.05},
    "sensor_cubic": {"c": 0.002},
    "sensor_rectification": {"r": 0.03},
}


def moved(folder, effect, *, known, enabled=True, rest=None):
    """Motion of a cart with one error of its encoder, and that which is wanted of it, both in strokes."""
    plant = CART | {"effects": {"wrong": {"effect": effect, "at": "encoder", "parameters": ERRORS[effect]}}}
    controller = CART_RUN["controller"] | {"observer": {"noise": 0.002}, "rest": rest}
    controller |= {"effects": {"wrong": True}} if known else {}
    run = CART_RUN | {"controller": controller, "duration": 40, "effects": {"wrong": {"enabled": enabled}}}
    for name, content in {"rig": plant, "run": run}.items():
        (folder / f"{name}.yaml").write_text(json.dumps(content), encoding="utf-8")
    found = Experiment.load(folder / "run.yaml").run()
    return found["rig.x"] / 0.005, found["ideal.x"]


@pytest.mark.parametrize("rest", [None, 1])
@pytest.mark.parametrize("effect", ERRORS)
def test_a_rig_whose_sensor_error_is_known_moves_as_one_without(effect, rest, tmp_path):
    right, ideal = moved(tmp_path, effect, known=False, enabled=False, rest=rest)
    found, _ = moved(tmp_path, effect, known=True, rest=rest)
    # An observer that expects another slope has another gain.
    bound = 1e-9 if effect in {"sensor_drift", "sensor_offset"} else 1e-3
    assert masking_error(found, right) < bound
    wrong, _ = moved(tmp_path, effect, known=False, rest=rest)
    if not (effect == "sensor_offset" and rest):  # which is measured at rest
        assert masking_error(wrong, ideal) > 10.0 * masking_error(found, ideal)


def test_a_budget_proposes_what_the_controller_does_not_expect_and_knows_what_it_does(tmp_path):
    moved(tmp_path, "sensor_drift", known=False)
    (row,) = (one for one in budget(Experiment.load(tmp_path / "run.yaml")).rows if one.cause == "sensor errors")
    assert row.remedy == "controller.effects: {wrong: true} in run.yaml"
    moved(tmp_path, "sensor_drift", known=True)
    found = budget(Experiment.load(tmp_path / "run.yaml"))
    assert found.whole.rms == pytest.approx(row.remedied, rel=1e-9)
    (row,) = (one for one in found.rows if one.cause == "sensor errors")
    assert "knows it" in row.note
    assert found.without_all.rms <= found.whole.rms


def test_differences_undo_no_error(tmp_path):
    moved(tmp_path, "sensor_gain", known=True)
    made = Experiment.load(tmp_path / "run.yaml").changed(
        controller=CART_RUN["controller"] | {"observer": "differences", "effects": {"wrong": True}}
    )
    with pytest.raises(ModelError, match=r"undo no errors of sensors \(sensor_gain\); take 'observer: disturbance'"):
        made.run()


def test_what_a_sensor_does_by_dynamics_of_its_own_is_not_foreseen():
    held = {name for name, entry in EFFECTS.items() if entry.where == "sensor" and entry.is_held_by_controller}
    assert held >= ERRORS.keys()
    assert not held & {"sensor_lag", "sensor_delay", "noise", "quantisation"}


def test_the_error_of_a_known_drift_is_that_of_its_rate(tmp_path):
    right, _ = moved(tmp_path, "sensor_drift", known=False, enabled=False)
    wrong, _ = moved(tmp_path, "sensor_drift", known=False)
    # A controller that holds the reading moves the rig by the drift: 0.02 mm/s of a stroke of 5 mm, over 4 s.
    assert np.ptp(wrong - right) > 0.5 * 0.02 * 4.0 / 5.0
