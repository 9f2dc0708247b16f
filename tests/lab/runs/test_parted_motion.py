"""Runs whose motion parts from the wanted one: chaos, and another attractor, offline and on a plant of its own."""

import math
from pathlib import Path

import pytest
import yaml

import masking
from masking.app import cli
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.reports.run_report import report, strayed, summary, warnings

UEDA = {"equations": {"x''": "B*cos(t) - k*x' - x**3"}, "parameters": {"B": {"value": 7.5}, "k": {"value": 0.05}}}
WELLS = {"equations": {"x''": "x - x**3 - d*x'"}, "parameters": {"d": {"value": 0.15}}}
DUFFING = {
    "equations": {"x''": "F*cos(w*t) - 2*z*x' - x - b*x**3"},
    "parameters": {"F": {"value": 0.3}, "w": {"value": 1.3}, "z": {"value": 0.05}, "b": {"value": 0.25}},
}


def written(folder: Path, virtual: dict, start: float, duration: float) -> Path:
    """Experiment of the cart as a system of one coordinate, whose friction its controller does not know."""
    model = {"name": "wanted system", "coordinates": {"x": {"initial": start}}, **virtual}
    (folder / "wanted.yaml").write_text(yaml.safe_dump(model), encoding="utf-8")
    experiment = {
        "name": "the cart as another system", "plant": "cart", "virtual": "wanted.yaml",
        "transform": {"expressions": {"x": "x/stroke"}, "parameters": {"stroke": 0.005}},
        "controller": {"rate": "500 Hz", "observer": "disturbance", "homing": 2},
        "effects": {"delay": {"parameters": {"samples": 2}}},
        "initial": {"x": start}, "time_scale": 0.2, "duration": duration,
    }  # fmt: skip
    path = folder / "experiment.yaml"
    path.write_text(yaml.safe_dump(experiment), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def wells(tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp("wells"), WELLS, 2.605, 100)


def test_chaos_is_no_failure_of_a_run(tmp_path):
    found = masking.run(written(tmp_path, UEDA, 2.5, 200))
    chaos = found.manifest["parting"]["chaos"]
    assert found.manifest["masking_error"]["x"] > 0.5
    assert chaos["exponent"] == pytest.approx(0.1034, abs=0.02), "Sprott (2003), A.4.5"
    assert chaos["is_alike"]
    assert 0 < chaos["time"] < 100
    first, parted, measured, *_ = summary(found).splitlines()
    assert first.startswith("The cart moved as wanted system, whose motions are chaotic and part whatever moves them: ")
    assert parted.startswith("With a largest Lyapunov exponent of 0.1, a difference of ")
    assert "states are below any value differ from those of the wanted system by " in measured
    assert not strayed(found)
    assert "budget" not in found.manifest, "its masking error has no cause"


def test_another_attractor_is_named_and_the_status_is_1(wells, tmp_path, capsys):
    status = cli.main(["run", str(wells), "--out", str(tmp_path / "out"), "--no-budget"])
    printed = capsys.readouterr().out
    settled = "The cart settled on another attractor of wanted system, rest at x = -1, than the wanted motion, "
    assert printed.startswith(f"{settled}rest at x = 1: masking error chi = ")
    assert "masking rig check" not in printed, "what is known needs no search"
    assert status == 1


def test_it_is_known_of_a_run_on_a_plant_and_in_its_report(wells, tmp_path):
    experiment = Experiment.load(wells)
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    assert found.manifest["parting"]["reached"]["middle"]["x"] == pytest.approx(-1.0, abs=1e-6)
    made = report(found, tmp_path)
    assert "settled on another attractor of wanted system, rest at " in made.path.read_text("utf-8")
    assert strayed(found)
    assert warnings(found)[0] == strayed(found)


def test_a_periodic_attractor_is_named_by_period_and_amplitude(tmp_path):
    found = masking.run(written(tmp_path, DUFFING, 1.25, 200), budget=False)
    ends = found.manifest["parting"]
    assert (ends["wanted"]["kind"], ends["reached"]["kind"]) == ("periodic", "periodic")
    assert ends["reached"]["period"] == pytest.approx(2 * math.pi / 1.3, rel=1e-5)
    assert "a periodic motion (period 4.83; amplitude x = 2.04; about x = 0)" in summary(found)


def test_a_run_that_moves_as_wanted_is_not_asked(tmp_path):
    found = masking.run(written(tmp_path, WELLS, 1.5, 100), budget=False)
    assert max(found.manifest["masking_error"].values()) < 0.3
    assert "parting" not in found.manifest
