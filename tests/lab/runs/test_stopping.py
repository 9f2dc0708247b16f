"""What ends a run before its duration: offline, in lockstep on a rig, and what is said of it."""

import json
import math

import numpy as np
import pytest
from scipy.signal import hilbert

from masking.app.cli import main
from masking.errors import DeclarationError, ModelError
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import error_budget, rig_run
from masking.lab.runs.experiment import Experiment

STOP = {"when": "synchronised", "of": ["th1", "th2"]}


@pytest.fixture(scope="module")
def clocks():
    return Experiment.load("huygens").changed(stop="synchronised")


def test_a_continuous_run_ends_when_the_clocks_are_in_anti_phase(clocks):
    found, whole = clocks.run(), Experiment.load("huygens").run()
    rows = len(found)
    assert rows < 0.7 * len(whole)
    for name in whole.columns:
        assert np.array_equal(found[name], whole[name][:rows]), name
    told = found.manifest["stop"]
    assert (told["met"], told["of"], told["phase"]) == (True, ["th1", "th2"], "anti")
    assert told["at"] == pytest.approx(found.t[-1] / found.manifest["time_scale"])
    assert told["period"] == pytest.approx(2 * np.pi, rel=0.01)
    # There, and 1.5 periods before, the phase is within asin(0.05) of pi, of which scipy knows; not long before.
    a, b = (hilbert(whole[f"virtual.{name}"]) for name in ("th1", "th2"))
    off = np.abs(np.angle(-a * np.conj(b)))
    assert off[rows - 94 : rows].max() < 1.2 * math.asin(0.05)
    assert off[: rows - 300].max() > 0.1


@pytest.mark.parametrize(
    ("stop", "met"), [({"eps": 1e-6}, False), ({"eps": 0.2}, True), ({"memory": 5}, True), ({"memory": 50}, False)]
)
def test_what_counts_as_synchronised_is_declared(clocks, stop, met):
    told = clocks.changed(stop={"when": "synchronised", **stop}).run().manifest["stop"]
    assert told["met"] is met
    assert (told["at"] is None) is (not met)


def test_clocks_that_begin_in_phase_are_so_at_once(clocks):
    told = clocks.changed(stop={"when": "synchronised", "phase": "in", "of": ["th2", "th1"]}).run().manifest["stop"]
    assert told["at"] < 3 * told["period"]
    assert told["of"] == ["th2", "th1"]


def test_on_a_rig_in_lockstep_the_run_ends_at_the_same_sample_as_offline():
    experiment = Experiment.load("huygens_rig").changed(stop=STOP, record={"rate": "200 Hz"})
    offline = experiment.run()
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    assert offline.manifest["stop"]["met"]
    assert found.manifest["stop"] == offline.manifest["stop"]
    assert found.manifest["rig"]["end"] == "synchronised"
    assert found.t[-1] == offline.t[-1]
    assert len(found) == len(offline) < 500 * 0.16 * 200


def test_a_run_on_a_rig_that_does_not_synchronise_is_finished():
    changes = {"stop": {**STOP, "phase": "in", "eps": 0.001}, "duration": 30.0}
    experiment = Experiment.load("huygens_rig").changed(**changes)
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    assert found.manifest["rig"]["end"] == "finished"
    assert not found.manifest["stop"]["met"]
    assert found.t[-1] == pytest.approx(30.0 * experiment.time_scale, abs=2e-3)


def test_a_budget_is_of_the_run_as_long_as_it_was():
    made = error_budget.in_full(Experiment.load("huygens_rig").changed(stop=STOP), 12.0)
    assert (made.stop_condition, made.declaration.duration) == (None, 12.0)


def test_the_command_line_tells_it(tmp_path, capsys):
    path = tmp_path / "clocks.yaml"
    path.write_text(
        "name: clocks\nplant: ideal\nvirtual: huygens\nduration: 400\n"
        "transform: {matrix: [[pi/4, 0, 0], [0, pi/4, 0], [0, 0, 1]]}\nstop: synchronised\n"
    )
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "The run ended after" in capsys.readouterr().out
    told = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert told["stop"]["met"]


@pytest.mark.parametrize(
    ("stop", "said"),
    [
        ({"of": ["th1", "th3"]}, "'th3' is not a coordinate"),
        ({"of": ["th1"]}, "two coordinates synchronise, not th1"),
        ({"of": ["th1", "th1"]}, "two coordinates synchronise, not th1, th1"),
        ({"eps": 2}, "stop.eps: must be less than 1: it is a part of the amplitude, not 2"),
        ({"memory": 0.2}, "stop.memory: must be at least 0.5 periods, not 0.2"),
        ({"when": "tired"}, "tired|synchronised"),
    ],
)
def test_what_cannot_end_a_run(stop, said):
    with pytest.raises(DeclarationError, match=said):
        Experiment.load("huygens").changed(stop={"when": "synchronised", **stop})


def test_a_motion_without_a_period_and_rows_too_far_apart(clocks):
    with pytest.raises(ModelError, match=r"fewer than three oscillations.*give stop.period"):
        clocks.changed(duration=10.0).validate()
    with pytest.raises(ModelError, match=r"raise record.rate"):
        clocks.changed(stop={"when": "synchronised", "period": 0.5}).validate()
