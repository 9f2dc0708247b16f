"""Experiments: what a run records, what can be changed from outside, what is refused and where."""

import json
import pickle
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from masking.errors import DeclarationError
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue, registry
from masking.model.modelling.model import Model

COPIED = {"plant": "cart"}
BASE = {"plant": "ideal", "virtual": "duffing", "duration": 20}


def load(folder, *, plant=None, changes=None, **settings):
    path = folder / "run.yaml"
    path.write_text(json.dumps({"name": "run", **BASE, **settings}))
    return Experiment.load(path, plant=plant, changes=changes)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return load(tmp_path_factory.mktemp("short")).run()


def test_a_start_loads_no_package_that_only_compiling_needs():
    code = (
        "import sys, masking.lab.runs.experiment\n"
        "loaded = [m for m in ('sympy.core', 'numba.core', 'pint.util', 'matplotlib.figure') if m in sys.modules]\n"
        "assert not loaded, loaded"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_columns_of_a_recording(short):
    states = ("x1", "x2", "x3", "x1'", "x2'", "x3'")
    expected = {"t", *(f"{kind}.{name}" for kind in ("rig", "virtual", "ideal") for name in states)}
    assert set(short.columns) == expected | {"input.u1", "input.u2", "input.u3"}
    assert set(short.manifest["columns"]) == set(short.columns)
    units = {name: column["unit"] for name, column in short.manifest["columns"].items()}
    found = [units[name] for name in ("t", "rig.x1", "rig.x1'", "virtual.x1", "virtual.x1'", "input.u1")]
    assert found == ["s", "m", "m/s", "1", "1", "V"]


def test_columns_hold_what_their_names_say(short):
    """Rig in metres and seconds, virtual in 5 mm and 1/18.3157 s; the initial state is that of the declaration."""
    for name in ("x1", "x2", "x3"):
        np.testing.assert_allclose(short[f"rig.{name}"], 0.005 * short[f"virtual.{name}"], rtol=1e-12)
        np.testing.assert_allclose(short[f"rig.{name}'"], 0.005 * 18.3157 * short[f"virtual.{name}'"], rtol=1e-12)
    assert [short[f"rig.{name}"][0] for name in ("x1", "x2", "x3")] == pytest.approx([-0.003, -0.0025, 0.0], abs=1e-16)
    assert short.t[-1] == pytest.approx(20 / 18.3157, rel=1e-12)


def test_inputs_are_those_that_move_the_rig_as_recorded(short):
    """The set-up's equation of oscillator 1 (4.4) in SI units, solved for its input."""
    omega = 18.3157
    x1, x3, v1, v3 = (short[f"rig.{name}"] for name in ("x1", "x3", "x1'", "x3'"))
    d = short["virtual.x1"] - short["virtual.x3"]
    wanted = -(d + d**3 / 3) * 0.005 * omega**2
    by_hand = (wanted + 12.5521**2 * (x1 - x3) + 2 * 0.3362 * 12.5521 * (v1 - v3)) / 20.9218
    np.testing.assert_allclose(short["input.u1"], by_hand, rtol=0, atol=1e-12)


def test_manifest(short):
    manifest = short.manifest
    assert manifest["versions"].keys() == {"python", "masking", "numpy", "numba", "sympy"}
    assert manifest["versions"]["masking"] == version("masking")
    assert manifest["seed"] == 0
    assert set(manifest["files"]) == {"run.yaml", "ideal.yaml", "setup.yaml", "duffing.yaml"}
    assert all(len(digest) == 64 for digest in manifest["files"].values())
    assert manifest["declarations"].keys() == {"experiment", "plant", "plant_model", "virtual", "controller_model"}
    assert manifest["masking_error"].keys() == {"x1", "x2", "x3"}
    assert (manifest["mode"], manifest["rate"]) == ("continuous", None)
    assert manifest["limits"]["u1"] == {"max": 0.42, "unit": "V"}
    assert manifest["oscillators"] == ["x1", "x2"]
    assert "commit" in manifest
    # The declarations are whole: the virtual system comes back from them.
    again = Model(registry.ModelDeclaration.model_validate(manifest["declarations"]["virtual"]))
    assert again.parameter_values() == pytest.approx(manifest["parameters"])


def test_recording_comes_back_from_disk(short, tmp_path):
    short.save(tmp_path)
    again = Recording.load(tmp_path)
    assert again.manifest["masking_error"] == short.manifest["masking_error"]
    for name, column in short.columns.items():
        np.testing.assert_array_equal(again[name], column)


def test_two_runs_are_identical_but_for_the_clock(short, tmp_path):
    again = load(tmp_path).run()
    assert again.columns.keys() == short.columns.keys()
    for name, column in short.columns.items():
        np.testing.assert_array_equal(again[name], column)
    clock = {"created", "timing", "commit"}  # the folders of the two files may lie in different repositories
    assert {k: v for k, v in again.manifest.items() if k not in clock} == {
        k: v for k, v in short.manifest.items() if k not in clock
    }


# What can be changed from outside.


def test_changed_parameter_takes_effect(short, tmp_path):
    changed = load(tmp_path, changes={"w3": 0.6}).run()
    assert changed.manifest["parameters"]["w3"] == 0.6
    assert changed.manifest["declarations"]["experiment"]["parameters"] == {"w3": 0.6}
    assert max(changed.manifest["masking_error"].values()) < 1e-6
    assert np.abs(changed["rig.x3"] - short["rig.x3"]).max() > 0.1 * np.abs(short["rig.x3"]).max()


def test_change_wins_over_the_file(tmp_path):
    found = load(tmp_path, parameters={"w3": 0.7, "z3": 0.1}, changes={"w3": 0.6})
    assert found.virtual.value("w3") == 0.6
    assert found.virtual.value("z3") == 0.1


def test_unknown_parameter_is_refused_with_the_nearest_name(tmp_path):
    with pytest.raises(DeclarationError, match=r"'zz3' is not a parameter of .*did you mean 'z3'\?"):
        load(tmp_path, changes={"zz3": 0.6})
    with pytest.raises(DeclarationError, match=r"run\.yaml:1:\d+: parameters\.zz3: .*did you mean 'z3'\?"):
        load(tmp_path, parameters={"zz3": 0.6})


def test_value_out_of_bounds_is_refused(tmp_path):
    with pytest.raises(DeclarationError, match=r"parameters\.w3: .*bound 0"):
        load(tmp_path, changes={"w3": -1.0})


def test_missing_initial_value_is_refused_with_its_place(tmp_path):
    with pytest.raises(DeclarationError) as error:
        load(tmp_path, virtual="setup", initial={"x1": -3}, inputs={"u1": 0, "u2": 0, "u3": 0})
    assert len(error.value.problems) == 1
    assert str(error.value).startswith(f"{tmp_path}/run.yaml:1:")
    assert "initial: no initial value for x2; give initial.x2 here" in str(error.value)


def test_initial_state_of_something_else_is_refused(tmp_path):
    with pytest.raises(DeclarationError, match=r"initial\.x4: 'x4' is not a coordinate of coupled Duffing"):
        load(tmp_path, initial={"x4": 0.1})


def test_initial_positions_and_velocities(tmp_path):
    run = load(tmp_path, initial={"x1": 0.25, "x2'": 0.5}).run()
    first = [run[f"virtual.{name}"][0] for name in ("x1", "x2", "x3", "x1'", "x2'", "x3'")]
    assert first == pytest.approx([0.25, -0.5, 0, 0, 0.5, 0], abs=1e-14)


def test_plant_is_replaced(tmp_path):
    other = tmp_path / "heavier.yaml"
    other.write_text("{name: heavier beam, model: setup, parameters: {mu1: 0.02, mu2: 0.03, c3: 0.7}}")
    run = load(tmp_path, plant=str(other)).run()
    assert run.manifest["plant_name"] == "heavier beam"
    assert run.manifest["limits"] == {}
    assert max(run.manifest["masking_error"].values()) < 1e-6  # the controller knows the plant's parameters


def test_plant_that_differs_from_what_the_controller_believes(tmp_path):
    run = load(tmp_path, controller={"parameters": {"mu1": 0.02}}).run()
    assert 1e-6 < max(run.manifest["masking_error"].values()) < 1.0


def test_time_scale_is_what_the_file_says(short, tmp_path):
    run = load(tmp_path, time_scale=0.1).run()
    assert run.manifest["time_scale"] == 0.1
    assert run.t[-1] == pytest.approx(2.0, rel=1e-12)
    np.testing.assert_allclose(run["virtual.x1"], short["virtual.x1"], atol=1e-7)
    assert short.manifest["time_scale"] == pytest.approx(1 / 18.3157, rel=1e-12)


def test_rows_are_taken_at_the_rate_of_the_record(short, tmp_path):
    run = load(tmp_path, record={"rate": "100 Hz"}).run()
    np.testing.assert_allclose(np.diff(run.t), 0.01, rtol=1e-12)
    assert len(run) == int(20 / 18.3157 * 100) + 1
    sampled = load(tmp_path, controller={"rate": "1 kHz", "observer": "exact"}, record={"rate": "100 Hz"}).run()
    np.testing.assert_array_equal(sampled.t, run.t)
    assert (sampled.manifest["mode"], sampled.manifest["rate"]) == ("sampled", 1000.0)
    np.testing.assert_allclose(
        np.diff(load(tmp_path, controller={"rate": "1 kHz", "observer": "exact"}).run().t), 0.001, rtol=1e-9
    )
    assert len(short) == 201  # ten rows per unit of virtual time where nothing is asked for


def test_models_without_units_on_a_plain_rig(tmp_path):
    lever = "{name: lever, coordinates: {x: ''}, inputs: {u: ''}, equations: {x'': -4*x + cos(x)*u}}"
    (tmp_path / "lever.yaml").write_text(lever)
    (tmp_path / "rig.yaml").write_text("{name: rig, model: lever.yaml}")
    (tmp_path / "spring.yaml").write_text("{name: spring, coordinates: {x: {initial: 1}}, equations: {x'': -x}}")
    found = load(tmp_path, virtual="spring.yaml", plant=str(tmp_path / "rig.yaml"))
    assert found.time_scale == 1.0
    run = found.run()
    x = np.cos(run.t)
    np.testing.assert_allclose(run["rig.x"], x, atol=1e-8)
    np.testing.assert_allclose(run["input.u"], 3 * x / np.cos(x), atol=1e-7)


def test_progress_is_told_and_ends_at_one(tmp_path):
    told = []
    load(tmp_path).run(told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_sections_of_an_experiment_are_changed_as_if_its_file_said_so():
    found = Experiment.load("huygens_rig").changed(
        controller={"rate": "2 kHz", "observer": "differences"}, duration=10, effects={"noise": False}
    )
    assert found.declaration.controller.rate == 2000.0
    assert found.declaration.duration == 10.0
    assert not found.twin.noise()["s1"] > 1.0e-4
    assert found.twin.declaration.name == Experiment.load("huygens_rig").twin.declaration.name
    assert Experiment.load("duffing", plant="linear_rig").changed(duration=5).assembly.plant.name == "linear rig"


def test_a_controller_may_take_noise_and_delay_to_be_other_than_they_are():
    controller = {"rate": "1 kHz", "effects": {"delay": {"samples": 1}}}
    effects = {"delay": {"samples": 2}, "noise": {"sigma": 0.001}}
    aware = Experiment.load("huygens_rig").changed(effects=effects)
    unaware = aware.changed(controller=controller)
    assert (aware.twin.delay, aware.sampled.delay) == (2, 2)
    assert (unaware.twin.delay, unaware.sampled.delay) == (2, 1)
    assert unaware.instruments.noise == aware.instruments.noise
    unaware = aware.changed(controller={"rate": "1 kHz", "effects": {"noise": {"sigma": 0.0002}, "steps": False}})
    assert unaware.instruments.noise["s1"] == pytest.approx(0.0002)
    assert unaware.twin.noise()["s1"] > 0.001
    assert unaware.sampled.delay == 2


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "nois",
            "controller.effects.nois: 'nois' is not an effect of twin of the experimental rig; did you mean 'noise'",
        ),
        (
            "strong_gain",
            "controller.effects.strong_gain: a controller is not designed with actuator_gain; allowed: measured_spri",
        ),
    ],
)
def test_effects_that_a_controller_cannot_take_are_refused(name, said):
    with pytest.raises(DeclarationError) as error:
        Experiment.load("huygens_rig").changed(controller={"rate": "1 kHz", "effects": {name: False}}).validate()
    assert said in str(error.value)


def test_a_wrong_section_of_a_changed_experiment_is_refused_as_in_its_file():
    with pytest.raises(DeclarationError) as error:
        Experiment.load("huygens_rig").changed(controler={}, duration=-1)
    assert "the key 'controler' is not known; did you mean 'controller'?" in str(error.value)
    assert "duration: must be greater than 0, not -1" in str(error.value)


@pytest.mark.parametrize(
    ("regulate", "said"),
    [
        ({}, "controller.regulate: nothing is regulated; give 'energy: 0.02', 'phase: anti', or both"),
        ({"coupling": 0.2}, "controller.regulate: nothing is regulated"),
        ({"energy": 0.02, "coupling": 0.2}, "controller.regulate.coupling: coupling has no effect without phase"),
        ({"phase": "in", "rate": 0.2}, "controller.regulate.rate: rate has no effect without energy"),
    ],
)
def test_a_regulation_that_does_nothing_is_refused(regulate, said):
    with pytest.raises(DeclarationError) as error:
        Experiment.load("huygens_rig").changed(controller={"rate": "1 kHz", "regulate": regulate})
    assert said in str(error.value)


def test_limits_are_told_in_the_unit_of_the_commands(tmp_path):
    (packaged,) = registry.load_plant("linear_rig").files
    text = Path(packaged).read_text(encoding="utf-8").replace("{max: 0.42, unit: V}", "{max: 420, unit: mV}")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    found = Experiment.load("duffing", plant=str(tmp_path / "rig.yaml")).changed(
        controller={"rate": "1 kHz", "observer": "disturbance"}, duration=10, record=None
    )
    assert found.run().manifest["limits"]["V1"] == {"max": pytest.approx(0.42), "unit": "V"}


def test_only_effects_that_act_are_told_as_on():
    """A controller that knows the true state needs no sensors, and its commands are not late."""
    told = Experiment.load("duffing", plant="linear_rig").changed(duration=5, effects={"friction1": True}).run()
    assert told.manifest["effects"]["friction1"]
    assert not told.manifest["effects"]["delay"]


def test_what_was_read_once_stays_whatever_becomes_of_the_files(tmp_path):
    """A copy in another process, and one with other values, are those of the files as they were."""
    rows = "\n".join(f"{i / 10},{i % 7 / 10}" for i in range(40))
    texts = {"r.csv": f"t,r\n{rows}\n"}
    texts |= {f"{kind}.yaml": catalogue.find(kind, name).read_text() for kind, name in COPIED.items()}
    texts["plant.yaml"] = re.sub(r"(?m)^model: .*", "model: ./model.yaml", texts["plant.yaml"])
    for name, text in (texts | {"model.yaml": catalogue.find("model", "cart").read_text()}).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "virtual.yaml").write_text(catalogue.find("model", "relaxing_mass").read_text())
    path, source = tmp_path / "run.yaml", {"r": {"file": "r.csv", "interpolation": "linear"}}
    own = {"plant": "./plant.yaml", "virtual": "./virtual.yaml", "inputs": source, "duration": 2}
    path.write_text(json.dumps({"name": "run", **own}))
    made, frozen = Experiment.load(path), pickle.dumps(Experiment.load(path))
    before, shorter = made.run(), made.changed(duration=1).run()
    for file in tmp_path.iterdir():
        file.write_text("name: edited meanwhile\n")
    copy = pickle.loads(frozen)  # noqa: S301
    assert all(np.array_equal(copy.run()[name], before[name]) for name in before.columns)
    assert all(np.array_equal(copy.changed(duration=1).run()[name], shorter[name]) for name in shorter.columns)
    assert copy.run().manifest["inputs"] == before.manifest["inputs"]
    with pytest.raises(DeclarationError, match=r"virtual\.yaml"):
        copy.changed(virtual="./virtual.yaml")
