"""A rig that learns what it is: unattended, to the causes that it was given, and to the same end after a crash."""

import csv
import json
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows import calibration_excitation, learned_rig, learning_steps
from masking.app.workflows.learn import JOURNAL, learn
from masking.app.workflows.rig_settings import RigLearning
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import (
    DeclarationError,
    EmergencyStopError,
    MaskingError,
    ModelError,
    PlantError,
    PlantLostError,
    PlantRefusedError,
    RecordError,
)
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.udp import UdpPlant
from masking.lab.records import stream
from masking.lab.records.journal import Journal
from masking.lab.records.recording import Recording
from masking.lab.records.stop_switch import Presser, switches
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from masking.reports import learning_page, model_files
from tests.benchmarks.learning import CART, CART_RUN, RIGS, SETUP, same, written


def settings(out, **changes):
    return RigLearning(**{"out": out, "seconds": 20.0, "lockstep": True} | changes)


def rows(folder):
    with Journal(folder / JOURNAL) as journal:
        return journal.entries[1:]


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """A cart with friction and a delay that its plant file does not have, and what it has learned."""
    folder = tmp_path_factory.mktemp("rubbing")
    plant, true, experiment = written(RIGS["friction"], folder)
    rig = partial(SimulatedPlant, Twin.load(true))
    found = learn(str(plant), rig, settings(folder / "out", experiment=str(experiment)))
    return found, folder


def test_it_finds_the_causes_and_their_values(rubbing):
    found, folder = rubbing
    (row,) = (row for row in found.rows if row["step"] == "discovery")
    assert row["verdict"] == "named"
    assert row["closed"]
    assert row["before"] > 1000.0
    assert row["after"] < 1.1
    assert "dry friction in guide 99 %" in row["odds"]
    twin = Twin.load(str(folder / "out" / "plant.yaml"))
    assert twin.delay == 4
    assert twin.model.value("dry_friction_fc") / twin.model.value("kf") == pytest.approx(0.3 / 8.0, rel=1e-3)


def test_the_masking_error_falls_and_trips_do_not_end_it(rubbing):
    found, folder = rubbing
    before, after = (row["chi"] for row in found.rows if row["step"] in {"before", "after"})
    assert before > 0.2
    assert after < 0.1 * before
    (excited,) = (row for row in found.rows if row["step"] == "excitation")
    assert excited["seconds"] > 60.0  # some excitations were too large, and made again
    made = Experiment.load(folder / "out" / "experiment.yaml")
    assert made.declaration.controller.model is None
    assert made.assembly.plant.files.keys() == {str(folder / "out" / "plant.yaml")}
    read = Recording.load(folder / "out" / "steps" / "05-excitation" / "unseen")["sensor.encoder"]
    assert np.abs(read).max() < 25.0


class Moved(SimulatedPlant):
    """A twin that keeps how it moves."""

    def readings(self):
        self.moved = [*getattr(self, "moved", []), float(self._y[0])]
        return super().readings()


def test_another_experiment_masks_with_the_plant_file_alone(rubbing):
    """One that was not there when it learned; its error is that of the rig's own motion."""
    _, folder = rubbing
    errors = []
    for plant in ("rig.yaml", "out/plant.yaml"):
        run = CART_RUN | {"plant": plant, "initial": {"x": 0.3}, "duration": 40}
        (folder / "other.yaml").write_text(json.dumps(run))
        made, rig = Experiment.load(folder / "other.yaml"), Moved(Twin.load(folder / "true.yaml"))
        ideal = rig_run.run(made, rig, rig_run.RunSettings(lockstep=True))["ideal.x"]
        moved = np.array(rig.moved[made.sampled.before :][: len(ideal)]) / 0.005
        errors.append(np.linalg.norm(moved - ideal[: len(moved)]) / np.linalg.norm(ideal))
    assert errors[1] < 0.02 < 0.1 * errors[0]


def test_its_page_and_its_one_page_say_what_it_took(rubbing, capsys):
    found, folder = rubbing
    out = folder / "out"
    table = list(csv.DictReader((out / "learning.csv").read_text().splitlines()))
    assert [row["step"] for row in table] == [row["step"] for row in found.rows]
    page = (out / "learning.html").read_text()
    assert "dry friction in guide" in page
    assert "masking error" in page
    assert cli.main(["report", str(out), "--one-page"]) == 0
    assert (out / "one_page.pdf").read_bytes().startswith(b"%PDF")
    assert "h of the rig in 6 steps" in found.sentence
    assert "one_page" in capsys.readouterr().out


def test_what_is_finished_is_not_made_again(rubbing):
    found, folder = rubbing

    class Untouched(SimulatedPlant):
        def configure(self, given):
            raise AssertionError

    plant = Untouched(Twin.load(str(folder / "rig.yaml")))
    again = learn(
        str(folder / "rig.yaml"), lambda: plant, settings(folder / "out", experiment=str(folder / "experiment.yaml"))
    )
    assert again.rows == found.rows


def test_a_rig_that_is_killed_goes_on_to_the_same_end(tmp_path):
    """The twin of the plant file itself, in which nothing is missing; killed in its excitation."""
    plant, _, _ = written(RIGS["nothing"], tmp_path)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "masking", "rig", "learn", str(plant), "--seconds", "20", "--out", str(out)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        until = time.monotonic() + 120.0
        while not (out / "steps" / "04-excitation" / "small").exists():
            assert process.poll() is None
            assert time.monotonic() < until
            time.sleep(0.01)
        process.kill()
    kept = (out / JOURNAL).read_bytes()
    assert kept.count(b"\n") == 4
    found = learn(str(plant), partial(SimulatedPlant, Twin.load(str(plant))), settings(out))
    assert (out / JOURNAL).read_bytes().startswith(kept)
    assert [row["step"] for row in found.rows] == ["self-test", "rest", "springs", "excitation", "discovery"]
    assert found.rows[-1]["verdict"] == "none"
    assert Twin.load(str(out / "plant.yaml")).values().tolist() == Twin.load(str(plant)).values().tolist()


@pytest.mark.parametrize(
    ("kind", "at", "given"),
    [
        ("actuator_gain", "u", {"e": 0.1}),
        ("sensor_gain", "encoder", {"e": 0.1}),
        ("sensor_delay", "encoder", {"tau": 3e-3}),
    ],
)
def test_what_was_found_of_instruments_is_what_a_controller_knows_of_them(tmp_path, kind, at, given):
    found = tmp_path / "found.yaml"
    found.write_text(
        json.dumps(CART | {"effects": CART["effects"] | {"e": {"effect": kind, "at": at, "parameters": given}}})
    )
    learned_rig.write(tmp_path, found, 1000.0)
    path = tmp_path / "plant.yaml"
    registry.check_plant_file(path)
    before, after = (Instruments.of(Twin.load(file)) for file in (found, path))
    assert after.allocation / before.allocation == pytest.approx(1.1 if kind == "actuator_gain" else 1.0)
    assert after.gains() / before.gains() == pytest.approx(1.1 if kind == "sensor_gain" else 1.0)
    assert after.delay - before.delay == (3 if kind == "sensor_delay" else 0)
    assert not [one for one in Twin.load(path).effects if one.kind == kind]


@pytest.mark.parametrize(
    ("given", "samples", "said"),
    [
        ({"s1": 3e-3, "s2": 1e-3, "V1": 5.4e-3}, 0, 3),
        ({"s1": 5e-3, "s2": 3e-3, "s3": 3e-3, "V1": 1.4e-3, "V2": 2e-3, "V3": 1.4e-3}, 4, 5),
    ],
)
def test_no_delay_that_was_found_is_dropped(tmp_path, given, samples, said):
    """Each sensor answers each actuator as late as was found, by the sum of what the plant file has then."""
    found = tmp_path / "found.yaml"
    kinds = {name: "sensor_delay" if name.startswith("s") else "actuator_delay" for name in given}
    late = {f"late{n}": {"effect": kinds[n], "at": n, "parameters": {"tau": x}} for n, x in given.items()}
    found.write_text(json.dumps(SETUP | {"effects": late}))
    notes = learned_rig.write(tmp_path, found, 1000.0)
    assert len(notes) == said
    twin = Twin.load(tmp_path / "plant.yaml")
    assert twin.delay == samples
    for sensor in twin.sensors:
        for actuator, acts in zip(twin.actuators, twin.late(1000.0), strict=True):
            read = sum(e.parameters["tau"] for e in twin.effects if (e.kind, e.at) == ("sensor_delay", sensor))
            assert acts / 1000.0 + read == pytest.approx(given.get(sensor, 0.0) + given.get(actuator, 0.0))


def test_a_delay_that_is_rounded_up_to_samples_is_said(tmp_path):
    found = tmp_path / "found.yaml"
    late = {"effect": "sensor_delay", "at": "encoder", "parameters": {"tau": 3.6e-3}}
    found.write_text(json.dumps(CART | {"effects": CART["effects"] | {"late": late}}))
    notes = learned_rig.write(tmp_path, found, 1000.0)
    assert Twin.load(tmp_path / "plant.yaml").delay == 1 + 4
    assert notes == (
        "its delay of 5 samples is that of a controller at 1000 Hz",
        "a delay of 3.6 samples is written as 4, since a controller knows whole samples",
    )


class StoppedError(Exception):
    """A crash."""


@pytest.fixture
def scripted(monkeypatch):
    """Let discoveries say one after the other: either of two, one of them but not all, all."""
    said = [
        {"verdict": "ambiguous", "closed": True, "before": 9.0, "after": 1.5},
        {"verdict": "named", "closed": False, "before": 9.0, "after": 3.0},
        {"verdict": "named", "closed": True, "before": 3.0, "after": 1.0},
    ]
    asked = []

    def discover(record, *, plant, validation, out, **_):
        index = sum(path.is_dir() for path in Path(out).parent.glob("*-discovery"))
        Path(out).mkdir(parents=True, exist_ok=True)
        asked.append((Path(record).name, Path(validation).name, Path(plant).parent.name))
        commands = 0.01 * np.sin(np.arange(800) / 20.0)[:, None]
        coming = SimpleNamespace(commands=commands, separates=True)
        return SimpleNamespace(**said[min(index, 2)], next_experiment=coming if not index else None)

    def adopted(found, folder, records, plant):
        twin = Twin.load(plant)
        made = model_files.plant(twin, folder, {"model": "cart"}, (), twin.declaration.canonical()["effects"])
        (folder / "plant.yaml").write_text(model_files.text(made))
        return folder / "plant.yaml"

    facts = {"cause": "a cause", "odds": "a cause 99 %", "measured": "", "assumed": ""}
    monkeypatch.setattr(calibration_excitation, "RATE", 200.0)
    monkeypatch.setattr(learning_steps, "discover", discover)
    monkeypatch.setattr(learned_rig, "adopted", adopted)
    monkeypatch.setattr(learning_page, "facts", lambda found: facts | {n: getattr(found, n) for n in said[0]})
    return asked


def test_it_parts_causes_goes_on_until_all_is_explained_and_survives_a_crash_between_any_two_steps(tmp_path, scripted):
    plant, _, _ = written(RIGS["nothing"], tmp_path)
    rig = partial(SimulatedPlant, Twin.load(str(plant)))
    whole = learn(str(plant), rig, settings(tmp_path / "whole"))
    begin = ["self-test", "rest", "springs", "excitation"]
    rest = ["discovery", "experiment", "discovery", "record", "discovery"]
    assert [row["step"] for row in whole.rows] == begin + rest
    assert scripted == [
        ("fit", "unseen", tmp_path.name),
        ("06-experiment", "unseen", tmp_path.name),
        ("08-record", "unseen", "07-discovery"),
    ]
    moved = Recording.load(tmp_path / "whole" / "steps" / "06-experiment")
    assert np.abs(moved["input.u"]).max() == pytest.approx(0.01, rel=1e-3)

    def crash(text):
        if not text.startswith(("small", "fit", "unseen", "up to")):
            raise StoppedError

    crashes = 0
    while True:
        try:
            again = learn(str(plant), rig, settings(tmp_path / "again", say=crash))
        except StoppedError:
            crashes += 1
            continue
        break
    assert crashes == len(whole.rows)
    assert all(map(same, again.rows, whole.rows))
    assert Twin.load(str(tmp_path / "again" / "plant.yaml")).declaration.model == "cart"


def test_a_run_of_the_experiment_that_a_crash_cut_off_is_made_again(tmp_path):
    plant, _, experiment = written(RIGS["nothing"], tmp_path)
    rig, out = partial(SimulatedPlant, Twin.load(str(plant))), tmp_path / "out"

    def up_to(step):
        def crash(text):
            if text.startswith(step):
                raise StoppedError

        with pytest.raises(StoppedError):
            learn(str(plant), rig, settings(out, say=crash, experiment=str(experiment)))
        return rows(out)[-1]

    assert up_to("springs:")["next"] == "before"
    stream.begin(out / "steps" / "04-before", {"columns": ["t"], "rate": 500.0, "spare": 0, "number": "1"})
    assert up_to("before:")["measured"] == "finished"
    assert not stream.is_in(out / "steps" / "04-before")


def test_the_hours_end_it(tmp_path, scripted):
    plant, _, _ = written(RIGS["nothing"], tmp_path)
    rig = partial(SimulatedPlant, Twin.load(str(plant)))
    found = learn(str(plant), rig, settings(tmp_path / "out", hours=0.0415))
    assert [row["step"] for row in found.rows][-3:] == ["discovery", "experiment", "discovery"]
    assert found.rows[-1]["why"] == "the budget of 0.0415 h is used up"
    assert "the budget of 0.0415 h is used up" in found.sentence
    assert Twin.load(str(tmp_path / "out" / "plant.yaml")).delay == 1
    more = learn(str(plant), rig, settings(tmp_path / "out", hours=1.0))
    assert more.rows == found.rows  # what has ended has ended


class Odd(SimulatedPlant):
    """A twin that trips in its first runs, or does not answer its commands."""

    def __init__(self, twin, spikes=0, deaf=False):
        super().__init__(twin)
        self.spikes, self.deaf = spikes, deaf

    def readings(self):
        found = super().readings()
        if self.spikes and self._tick == 700:
            self.spikes -= 1
            found[0] = np.nan
        return found

    def step(self, command):
        super().step(0.0 * command if self.deaf else command)


def test_a_trip_by_chance_does_not_end_it(tmp_path):
    plant, _, _ = written(RIGS["nothing"], tmp_path)
    rig = calibration_excitation.Rig(
        Twin.load(str(plant)), Odd(Twin.load(str(plant)), spikes=2), lockstep=True, retries=3, acknowledge=True
    )
    assert len(rig.record(np.zeros((1000, 1)), {})) == 1000
    assert rig.trips == 2
    rig = calibration_excitation.Rig(
        Twin.load(str(plant)), Odd(Twin.load(str(plant)), spikes=9), lockstep=True, retries=3
    )
    with pytest.raises(MaskingError, match="SENSOR_NONFINITE"):
        rig.record(np.zeros((1000, 1)), {})


class Watched(SimulatedPlant):
    """A twin that counts the seconds that it is driven, and keeps its commands."""

    seconds = 0.0

    def step(self, command):
        super().step(command)
        Watched.seconds += 1.0 / self._rate
        self.given = [*getattr(self, "given", []), float(command[0])]


def test_a_rig_that_is_too_warm_rests_for_the_time_that_its_plant_file_declares(tmp_path):
    """80 mW of 0.4 A at 1 ohm, where 30 mW are allowed over 3 s: each try has 0.49 of the power of the one before."""
    plant = tmp_path / "warm.yaml"
    power = {"value": 0.03, "unit": "W", "heating": {"value": 1.0, "unit": "ohm"}, "time": 3.0}
    plant.write_text(json.dumps(CART | {"limits": CART["limits"] | {"power": power}}))
    said = []
    twin = Twin.load(plant)
    rig = calibration_excitation.Rig(twin, Watched(twin), 200.0, lockstep=True, say=said.append)
    wave = 0.4 * np.sin(40.0 * np.pi * np.arange(2000) / 200.0)[:, None]
    made = rig.record(wave, {})
    assert rig.trips == len(said) > 0
    assert all("THERMAL" in text and "after 3 s of rest" in text for text in said), said
    assert np.mean(made["input.u"] ** 2) < 0.03
    still = [len(part) / 200.0 for part in "".join("01"[x != 0.0] for x in rig.plant.given).split("1")]
    assert sum(part >= 3.0 for part in still) == rig.trips


def test_trips_in_a_step_use_up_the_hours_too_and_more_of_them_go_on(tmp_path, scripted):
    plant, true, _ = written(RIGS["friction"], tmp_path)
    rig, hours = partial(Watched, Twin.load(true)), 0.0361
    Watched.seconds = 0.0
    with pytest.raises(MaskingError, match=r"excitation: 20 s more of the rig are needed, and .* s are left.*--hours"):
        learn(str(plant), rig, settings(tmp_path / "out", hours=hours))
    assert 100.0 < Watched.seconds <= 3600.0 * hours
    assert [row["step"] for row in rows(tmp_path / "out")] == ["self-test", "rest", "springs"]
    found = learn(str(plant), rig, settings(tmp_path / "out", hours=0.1))
    assert "discovery" in [row["step"] for row in found.rows]


class Tripped(SimulatedPlant):
    """A twin that has tripped in a session before."""

    def configure(self, settings):
        if not settings.acknowledge:
            raise PlantRefusedError("the plant tripped in its last session; start once with --acknowledge")
        return super().configure(settings)


def test_a_trip_from_before_is_acknowledged_by_a_person_alone(tmp_path, scripted):
    plant, _, _ = written(RIGS["nothing"], tmp_path)
    rig, out = partial(Tripped, Twin.load(str(plant))), tmp_path / "out"
    with pytest.raises(PlantRefusedError, match="--acknowledge"):
        learn(str(plant), rig, settings(out))
    found = learn(str(plant), rig, settings(out, hours=0.0415, acknowledge=True))
    assert found.rows[0]["step"] == "self-test"


def test_what_cannot_be_done_is_refused_before_the_rig_moves(tmp_path):
    plant, _, experiment = written(RIGS["nothing"], tmp_path)
    rig, out = partial(SimulatedPlant, Twin.load(str(plant))), tmp_path / "out"

    def refused(error, said, name=str(plant), **changes):
        with pytest.raises(error, match=said):
            learn(name, rig, settings(out, **changes))
        assert not out.exists()

    refused(
        RecordError, r"0\.01 h are too few for one round, which takes 127 s of the rig: give --hours 0\.04", hours=0.01
    )
    refused(RecordError, "nan h are too few for one round", hours=float("nan"))
    refused(ModelError, "records of 5 s are shorter than the excitation's period; give at least 20 s", seconds=5.0)
    refused(ModelError, "records of nan s are no records; give at least 20 s", seconds=float("nan"))
    refused(ModelError, "records of inf s are no records", seconds=float("inf"), hours=float("inf"))
    refused(DeclarationError, "the tolerance is nan; give a part between 0 and 1", tolerance=float("nan"))
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "plant.yaml").write_text("mine")
    with pytest.raises(RecordError, match=r"own holds an earlier result, plant\.yaml; name another folder"):
        learn(str(plant), rig, settings(tmp_path / "own"))
    assert [path.name for path in (tmp_path / "own").iterdir()] == ["plant.yaml"]
    refused(
        RecordError, r"huygens_rig does not fit the rig .*rig\.yaml: the controller's model", experiment="huygens_rig"
    )
    refused(DeclarationError, "there is no experiment 'huygen'.*huygens", experiment="huygen")
    (tmp_path / "still.yaml").write_text(json.dumps(CART_RUN | {"controller": {"rate": "500 Hz"}}))
    refused(RecordError, "does not fit the rig .*homing", experiment=str(tmp_path / "still.yaml"))
    refused(DeclarationError, "no plant 'no_rig'|no_rig", name="no_rig")
    with pytest.raises(PlantError, match=r"the self-test refuses to arm: u.* is dead"):
        learn(str(plant), lambda: Odd(Twin.load(str(plant)), deaf=True), settings(out))
    with pytest.raises(PlantLostError, match="no plant answers at udp"):
        learn(str(plant), lambda: UdpPlant("udp://127.0.0.1:9", patience=0.2), settings(tmp_path / "far"))
    assert (out / JOURNAL).read_bytes() == b""  # once the plant file is corrected, the same command does
    unread = tmp_path / "unread.yaml"
    unread.write_text(json.dumps({name: x for name, x in CART.items() if name not in {"sensors", "effects"}}))
    with pytest.raises(ModelError, match="cart: no sensor shows what an actuator does"):
        learn(str(unread), partial(SimulatedPlant, Twin.load(unread)), settings(out))
    with Journal(out / JOURNAL) as journal:
        journal.add(event="learn", plan="another")
    with pytest.raises(RecordError, match="holds what another rig has learned"):
        learn(str(plant), rig, settings(out, experiment=str(experiment)))


class Pressed(SimulatedPlant):
    """A rig whose own emergency stop is pressed."""

    def activate(self):
        raise EmergencyStopError("the emergency stop of the rig is pressed")


def test_a_person_who_stops_it_ends_it_in_the_next_step_and_so_does_a_plant_that_stays_away(tmp_path, monkeypatch):
    plant, _, experiment = written(RIGS["nothing"], tmp_path)
    twin, made = Twin.load(str(plant)), []

    def ended(said, kind=SimulatedPlant, pressed=""):
        def press(name, _):
            for switch in switches():
                if name == pressed and switch.process == os.getpid():
                    switch.press(Presser.COMMAND_LINE)

        def rig():
            made.append(kind(twin))
            return made[-1]

        with pytest.raises(MaskingError, match=said):
            learn(str(plant), rig, settings(tmp_path / "out", experiment=str(experiment), tell=press))

    ended("self-test refuses .*ESTOP: .* pressed from the command line", pressed="self-test")
    ended("recording was tripped .*ESTOP", pressed="rest")
    ended("stopped by a person", pressed="before")
    with pytest.raises(RecordError, match="or one of both is a twin"):
        learn(
            str(plant),
            partial(SimulatedPlant, twin),
            settings(tmp_path / "out", experiment=str(experiment), at="udp://127.0.0.1:9"),
        )
    made.clear()
    ended("stopped by a person", kind=Pressed)
    assert len(made) == 2  # one to be excited, and one for a run, which is not tried again
    monkeypatch.setattr(learning_steps, "PATIENCE", 0.1)
    ended("no plant answers at udp", kind=lambda _: UdpPlant("udp://127.0.0.1:9", patience=0.2))
    assert [row["next"] for row in rows(tmp_path / "out")][-1] == "before"
