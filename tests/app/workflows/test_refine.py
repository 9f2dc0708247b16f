"""The verb refine: what it finds, what that makes of masking, what it writes, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import masking
from masking.app import cli
from masking.app.workflows import calibration_excitation
from masking.app.workflows import refine as refinement
from masking.app.workflows.refine import assumed, refined
from masking.errors import DeclarationError, RecordError
from masking.inference.discovery.discovery_result import Named
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment

SECONDS = 6.0
HIDDEN = 0.005 * 5e-3 * ((12.5521 + 14.0337) / 2.0) ** 2  # dry friction: 0.005 of the stroke times wbar^2
EXPERIMENT = """
name: on a rig that rubs
plant: linear_rig
virtual: duffing
controller: {rate: 1 kHz, observer: disturbance}
effects:
  damping1: true
  damping2: true
  damping3: true
  gains: {enabled: true, parameters: {e: -0.05}}
  friction3: true
duration: 100
"""


def recorded(folder, experiment, seconds):
    """Write an experiment, and what is recorded of its imperfect rig, all that is wrong with it hidden."""
    (folder / "e.yaml").write_text(experiment)
    twin = Experiment.load(folder / "e.yaml").twin
    rig = calibration_excitation.Rig(twin, SimulatedPlant(twin, 3), lockstep=True)
    calibration_excitation.make(rig, folder / "records", seconds=seconds, progress=lambda p: None)
    return folder


def refine(folder):
    at = folder / "records"
    settings = {"record": at / "fit", "validation": at / "unseen", "tolerance": 0.05}
    return masking.refine(folder / "e.yaml", **settings, out=folder / "out")


@pytest.fixture(scope="module")
def rubs(tmp_path_factory):
    """Return the folder of an experiment on a rig of which one bearing rubs, with records."""
    return recorded(tmp_path_factory.mktemp("refine"), EXPERIMENT, SECONDS)


@pytest.fixture(scope="module")
def found(rubs):
    return refine(rubs)


@pytest.fixture
def told(found):
    return json.loads((found.folder / "refine.json").read_text())


@pytest.fixture
def known(found, monkeypatch):
    """Let a discovery take no time: it is what was found before."""
    monkeypatch.setattr(refinement, "discover", lambda *wanted, **settings: found.discovery)


def test_the_controller_believes_neither_hidden_effects_nor_gains(rubs):
    made = Experiment.load(rubs / "e.yaml")
    twin = assumed(made.changed(effects={"gains": True, "noise": {"parameters": {"sigma": 3e-4}}}))
    assert {effect.kind for effect in twin.effects} == {"noise", "delay"}
    assert twin.noise() == dict.fromkeys(("s1", "s2", "s3"), 3e-4)
    assert (twin.delay, twin.declaration.model) == (1, "setup")
    other = assumed(made.changed(controller={"rate": "1 kHz", "parameters": {"w1": 12.0}}))
    assert other.parameter_value("w1") == 12.0


def test_friction_is_found_and_masking_is_truer(found, told):
    effects = told["discovery"]["effects"]
    assert [(effect["name"], effect["on"]) for effect in effects] == [("dry_friction", "beam")]
    assert effects[0]["parameters"]["fc"]["value"] == pytest.approx(HIDDEN, rel=0.01)
    assert max(told["after"]["masking_error"].values()) == found.after.worst < 0.02
    assert max(told["before"]["masking_error"].values()) == found.before.worst > 0.05
    assert told["sentence"].startswith("With ")
    assert " and adjusted parameters in the controller's model, masking error chi went " in told["sentence"]


@pytest.mark.search
def test_friction_at_three_places_is_found(tmp_path):
    everywhere = EXPERIMENT.replace("  friction3: true", "".join(f"  friction{i}: true\n" for i in (1, 2, 3)).rstrip())
    found = refine(recorded(tmp_path, everywhere, 12.0))
    assert {(effect.name, effect.on) for effect in found.discovery.effects} == {
        ("dry_friction", place) for place in ("spring1", "spring2", "beam")
    }
    values = [effect.parameters["fc"].value for effect in found.discovery.effects]
    assert values == pytest.approx([HIDDEN] * 3, rel=0.01)
    assert found.before.worst > 0.05
    assert found.after.worst < 0.02


def test_everything_is_saved_and_runs_again(found, told):
    out = found.folder
    assert json.loads((out / "refine.json").read_text()) == told
    written = json.loads((out / "discovery.json").read_text())
    assert {name: content for name, content in written.items() if name != "files"} == told["discovery"]
    assert {"before", "after", "models", "plant.yaml", "discovery.html", "experiment.yaml"} <= {
        path.name for path in out.iterdir()
    }
    for when in ("before", "after"):
        made = Recording.load(told[when]["recording"])
        assert made.manifest["masking_error"] == told[when]["masking_error"]
        assert Path(told[when]["report"]).is_file()
    model = made.manifest["declarations"]["experiment"]["controller"]["model"]
    assert model == told["discovery"]["model"]
    assert Path(model).is_file()
    assert masking.check(out / "experiment.yaml", out / "plant.yaml", model)[1].problems == ()
    again = masking.run(told["experiment"], budget=False)
    assert again.manifest["masking_error"] == told["after"]["masking_error"]
    assert not list(out.parent.glob(".out*"))


def test_bad_input_is_refused_and_nothing_is_written(rubs, tmp_path, capsys):
    record, out = rubs / "records" / "fit", tmp_path / "out"
    with pytest.raises(DeclarationError, match="there is no experiment 'duffin'"):
        masking.refine("duffin", record=record, out=out)
    with pytest.raises(DeclarationError, match="tolerance is 2"):
        masking.refine(rubs / "e.yaml", record=record, tolerance=2, out=out)
    with pytest.raises(DeclarationError, match="hold no parameter 'z9'"):
        masking.refine(rubs / "e.yaml", record=record, parameters=["z9"], out=out)
    with pytest.raises(RecordError, match="no such record"):
        masking.refine(rubs / "e.yaml", record=tmp_path / "nothing", out=out)
    columns = {name: x for name, x in Recording.load(record).columns.items() if name != "sensor.s2"}
    Recording(columns).save(tmp_path / "less")
    assert cli.main(["refine", str(rubs / "e.yaml"), "--record", str(tmp_path / "less"), "--out", str(out)]) == 2
    assert "there is no column sensor.s2 or s2" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"less"}


@pytest.mark.usefixtures("known")
def test_command_line(rubs, found, tmp_path, capsys):
    asked = ["refine", str(rubs / "e.yaml"), "--record", str(rubs / "records" / "fit"), "--out", str(tmp_path / "out")]
    assert cli.main(asked) == 0
    said = capsys.readouterr().out
    for words in (found.sentence, "masking error chi", f"experiment: {tmp_path / 'out' / 'experiment.yaml'}"):
        assert words in said
    assert cli.main([*asked, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["after"]["masking_error"] == found.after.chi


def test_what_sits_in_actuators_and_sensors_is_told_as_not_compensated(found):
    cause = Named("saturation", "V3", {"limit": (0.08, 0.001)}, 1.0)
    made = replace(found, discovery=replace(found.discovery, effects=(cause,)))
    assert found.uncompensated == ()
    assert made.uncompensated[0].startswith("Saturation of V3 is not compensated")
    assert "saturation" not in made.sentence


def test_where_no_effect_is_missing_the_controller_gets_the_adjusted_parameters(found):
    wanted = Experiment.load(found.folder.parent / "e.yaml")
    nothing = replace(found.discovery, verdict="none", effects=())
    made = refined(wanted, nothing, replace(found.files, model=None), found.folder)
    assert made.declaration.controller.model is None
    assert made.declaration.controller.parameters.keys() == set(found.discovery.rig.names)


def test_a_run_that_cannot_go_on_is_told(found):
    lost = replace(found, after=refinement.Run(None, "it grew without bound"))
    assert "the run could not go on: it grew without bound" in lost.sentence
    assert lost.as_dict()["after"]["masking_error"] is None
    assert lost.as_dict()["after"]["recording"] is None


@pytest.mark.parametrize("when", ["running with the model as it is", "running with what was found"])
@pytest.mark.usefixtures("known")
def test_an_interrupt_leaves_nothing(rubs, tmp_path, when):
    def stop(text, part):
        if text == when and part > 0.0:
            raise KeyboardInterrupt

    record = rubs / "records" / "fit"
    with pytest.raises(KeyboardInterrupt):
        masking.refine(rubs / "e.yaml", record=record, out=tmp_path / "out", tell=stop)
    assert list(tmp_path.iterdir()) == []
