"""What an error budget proposes: what is not on yet, in the words of the experiment's own files, and that it helps."""

import re
from pathlib import Path

import pytest
import yaml

from masking.control.rig.twin import Twin
from masking.lab.runs.error_budget import budget, causes
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.remedies import PARAMETERS, SAMPLING, differing_parameters, remedies
from masking.model.declaration import catalogue
from masking.model.effects import EFFECTS

SAMPLED = [name for name in catalogue.names("experiment") if Experiment.load(name).has_observer]


def written(tmp_path, name: str, **sections) -> Experiment:
    """Experiment of a packaged one's file with other sections, as a user would write it."""
    packaged = Path(next(iter(Experiment.load(name).declaration.files)))
    content = yaml.safe_load(packaged.read_text("utf-8"))
    for key, value in sections.items():
        content[key] = {**content.get(key, {}), **value} if isinstance(value, dict) else value
    path = tmp_path / packaged.name
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return Experiment.load(path)


def proposed(experiment: Experiment) -> dict[str, list[str]]:
    """Words of what is tried against each cause, each of which the experiment accepts."""
    found = {**causes(experiment.twin), SAMPLING: (), PARAMETERS: ()}
    said = {}
    for cause, effects in found.items():
        made = list(remedies(experiment, cause, effects, known=False))
        assert all(isinstance(one.made(), Experiment) for one in made)
        said[cause] = [one.words for one in made]
    return said


@pytest.mark.parametrize("name", SAMPLED)
def test_what_is_proposed_is_not_on_yet_and_names_what_the_rig_has(name):
    experiment = Experiment.load(name)
    if "storey" in name:
        pytest.skip("its limits are compared for a minute")
    said = proposed(experiment)
    uses, settings = experiment.assembly.plant.effects, experiment.declaration.controller
    for words in {text for texts in said.values() for text in texts}:
        assert words.partition(" in ")[2].split(",")[0] in {
            Path(file).name for part in (experiment.declaration, experiment.assembly.plant) for file in part.files
        }
        assert "observer.kind" not in words, "it estimates disturbances already"
        assert "rest" not in words or settings.rest is None
        if effects := re.match(r"controller\.effects: \{(.*?)\}", words):
            assert {part.split(":")[0] for part in effects[1].split(", ")} <= uses.keys() - settings.effects.keys()
    assert any("rate" in words for words in said[SAMPLING])


def test_what_the_controller_has_is_left_out(tmp_path):
    plain = proposed(Experiment.load("cart_sensors"))
    assert plain["friction"] == ["controller.effects: {friction: true} in cart_sensors.yaml"]
    more = {"effects": {"friction": True, "delay": {"samples": 1}}}
    knowing = proposed(written(tmp_path, "cart_sensors", controller=more))
    assert knowing["friction"] == []
    assert knowing["delay"][0] == "controller.effects: {friction: {enabled: true}} in cart_sensors.yaml"
    rough = proposed(written(tmp_path, "cart_sensors", controller={"observer": "differences", "rest": None}))
    assert rough["friction"][0].startswith("controller.observer.kind: disturbance in cart_sensors.yaml")
    assert not any("rest" in words for words in rough["sensor errors"]), "it needs an observer"
    unmeasured = proposed(written(tmp_path, "cart_sensors", controller={"rest": None}))
    assert "controller.rest: 2 s in cart_sensors.yaml" in unmeasured["sensor errors"]


def test_parameters_that_the_controller_takes_otherwise_are_those_of_the_rig():
    experiment = Experiment.load("coil_van_der_pol")
    assert differing_parameters(experiment) == ("R", "kf")
    rig = Twin.load("cart_by_voltage").base.parameters
    (words,) = proposed(experiment)[PARAMETERS]
    assert (
        words == f"controller.parameters: {{R: {rig['R'].value:g}, kf: {rig['kf'].value:g}}} in coil_van_der_pol.yaml"
    )


def test_a_remedy_lowers_the_error_as_it_says_when_it_is_written_into_the_file(tmp_path):
    found = budget(Experiment.load("cart_stop"))
    row = min(found.rows, key=lambda one: one.remedied or found.whole.rms)
    assert row.cause == "friction"
    assert row.remedy == "controller.effects: {friction: true} in cart_stop.yaml"
    assert row.remedied <= 0.9 * found.whole.rms
    assert f"-> {row.remedied:.2g} with {row.remedy})" in found.sentence
    better = written(tmp_path, "cart_stop", controller={"effects": {"friction": True}}).run()
    assert better.manifest["masking_error"]["x"] == pytest.approx(row.remedied, rel=1e-9)
    faster = next(one for one in found.rows if one.cause == SAMPLING)
    assert faster.remedy == "controller.rate: 1 kHz in cart_stop.yaml, in place of 500 Hz"
    sampled = written(tmp_path, "cart_stop", controller={"rate": "1 kHz"}).run()
    assert sampled.manifest["masking_error"]["x"] == pytest.approx(faster.remedied, rel=1e-9)


def test_what_a_controller_was_given_is_known_and_not_proposed_again(tmp_path):
    found = budget(written(tmp_path, "cart_stop", controller={"effects": {"friction": True}}))
    row = next(one for one in found.rows if one.cause == "friction")
    assert "knows it" in row.note
    assert "friction" not in found.without_all.effects
    assert not any("effects" in one.remedy for one in found.rows)


def test_a_push_that_is_felt_is_no_cause():
    found = budget(Experiment.load("cart_felt").changed(duration=3))
    assert "periodic force" in causes(Experiment.load("cart_felt").twin)
    assert "periodic force" not in {row.cause for row in found.rows}
    assert "push" not in found.without_all.effects


def test_what_helps_on_a_rig_names_no_coil_and_no_part_of_a_controller():
    for entry in EFFECTS.values():
        assert not re.search(r"controller|observer|disturbance|voice", entry.remedy), entry.name
        assert "coil" not in entry.remedy or entry.where == "actuator", entry.name
