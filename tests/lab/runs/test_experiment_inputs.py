"""On a rig that runs by itself: passive coordinates, and virtual systems with inputs from files, sensors and pushes."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from masking.app.cli import main
from masking.lab.plants import adapters
from masking.lab.plants.interface import Sample
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from tests.lab.runs.test_rig_run import serving

HELD = {"rate": "500 Hz", "observer": "disturbance", "homing": 1}
FELT = {**HELD, "external": "felt"}
SEEN = ("sensor", "input", "demanded", "virtual_input", "ideal")


def short(name, controller=HELD, seconds=2.0):
    made = Experiment.load(name)
    return made.changed(duration=seconds / made.time_scale, controller=controller)


@pytest.mark.parametrize("name", ["cart_alone_rig", "cart_reference"])
def test_in_lockstep_it_is_the_run_offline(name):
    made = short(name)
    found = rig_run.run(made, SimulatedPlant(made.twin, made.declaration.seed), rig_run.RunSettings(lockstep=True))
    expected = made.run()
    assert found.names() == expected.names()
    for column in expected.columns:
        if column.split(".")[0] in SEEN:
            np.testing.assert_allclose(found[column], expected[column], rtol=1e-9, atol=1e-12, err_msg=column)
    assert found.manifest["masking_error"]["x"] <= 0.03


@pytest.mark.parametrize("name", [pytest.param("cart_felt", marks=pytest.mark.search), "cart_felt_observer"])
def test_a_push_that_begins_before_the_release_is_felt_from_there_on(name):
    """The hand pushes while the rig is homed; the ideal mass gets what the controller felt."""
    made = short(name, FELT, seconds=10.0)
    found = rig_run.run(made, SimulatedPlant(made.twin), rig_run.RunSettings(lockstep=True))
    assert found.manifest["rig"]["end"] == "finished"
    for run in (found, made.run()):
        assert run.manifest["masking_error"]["x"] <= 0.03


@pytest.mark.parametrize(
    ("name", "plant", "controller"),
    [
        ("cart_alone_rig", "cart_pendulum", HELD),
        pytest.param("cart_reference", "cart", HELD, marks=pytest.mark.search),
        ("cart_felt", "cart_pendulum", FELT),
    ],
)
def test_on_the_command_line_over_udp(tmp_path, capsys, name, plant, controller):
    made, file, out = short(name, controller), tmp_path / "short.yaml", tmp_path / "out"
    declared = made.declaration.canonical()
    for source in declared.get("inputs", {}).values():
        if "file" in source:
            source["file"] = registry.canonical(made.declaration)["inputs"]["r"]["file"]
    file.write_text(yaml.safe_dump(declared))
    with serving(plant, "--lockstep") as (_, address):
        capsys.readouterr()
        assert main(["rig", "run", str(file), "--plant", address, "--lockstep", "--out", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert not any(said["rig"]["counters"].values())
    found = Recording.load(out)
    assert len(found) == 1001
    if name == "cart_felt":  # no hand pushes the twin that is served: the mass rests
        assert np.abs(found["virtual_input.F"]).max() <= 0.2
        assert np.abs(found["virtual.x"]).max() <= 1e-3
    else:
        assert said["masking_error"]["x"] <= 0.03


@pytest.mark.realtime
def test_passive_coordinates_in_real_time():
    """The plant may be silent for 0.75 s, as no busy machine is; the command line is tested above."""
    made = short("cart_alone_rig", seconds=1.0)
    with serving("cart_pendulum") as (_, address):
        found = rig_run.run(made, adapters.connect(address), rig_run.RunSettings(watchdog=0.5))
    assert found.manifest["mode"] == "real time"
    assert found.manifest["rig"]["end"] == "finished"
    assert found.manifest["passive"]["coordinates"] == ["th"]


class Turned:
    """A twin of which someone sets a reading: `value` of the time in s is added to what a sensor reads."""

    owns_clock = False

    def __init__(self, plant, sensor, value):
        self.plant, self.at, self.value = plant, plant.sensors.index(sensor), value
        self.sensors, self.actuators = plant.sensors, plant.actuators

    def __getattr__(self, name):
        return getattr(self.plant, name)

    def read(self):
        sample = self.plant.read()
        values = sample.values.copy()
        values[self.at] += self.value(sample.index / 500.0)
        return Sample(sample.index, values)


def packets(t):
    """A knob that is turned to and fro from 2.4 s to 6 s, and arrives 20 times a second in steps of 0.01."""
    return round(0.4 * np.sin(4.0 * np.floor(20 * t) / 20), 2) if 2.4 < t < 6.0 else 0.0


def with_a_knob(folder, effects):
    declared = yaml.safe_load((Path(__file__).parents[3] / "plants" / "cart.yaml").read_text(encoding="utf-8"))
    declared["sensors"]["knob"] = {"measures": 0, "unit": "V"}
    declared["effects"] |= effects
    (folder / "plant.yaml").write_text(json.dumps(declared), encoding="utf-8")
    changes = {"plant": str(folder / "plant.yaml"), "effects": {}, "inputs": {"F": {"sensor": "knob"}}}
    return Experiment.load("cart_felt").changed(controller=HELD, duration=6, **changes)


@pytest.mark.parametrize("step", [None, 0.01])
def test_a_knob_that_is_turned_drives_the_masked_mass(tmp_path, step):
    effects = {"knob_steps": {"effect": "quantisation", "at": "knob", "parameters": {"step": step}}} if step else {}
    made = with_a_knob(tmp_path, effects)
    run = rig_run.run(made, Turned(SimulatedPlant(made.twin), "knob", packets), rig_run.RunSettings(lockstep=True))
    rig, released = run.manifest["rig"], made.sampled.before / 500.0
    assert (rig["end"], rig.get("trip")) == ("finished", None)
    assert "jumps of knob are not watched: give sensors.knob.jump" in rig["unwatched"]
    late = (made.sampled.delay + 0.5) / 500.0  # it is felt as late as commands act
    motion = solve_ivp(
        lambda t, y: [y[1], (packets(t + released - late) - 40 * y[0] - 2 * y[1]) / 0.3],
        (0, run.t[-1]), [0.0, 0.0], t_eval=run.t, max_step=0.004, rtol=1e-6, atol=1e-9,
    ).y[0]  # fmt: skip
    assert np.abs(motion).max() > 0.01
    assert np.linalg.norm(run["virtual.x"] - motion) <= 0.03 * np.linalg.norm(motion)
    assert run.manifest["masking_error"]["x"] <= 0.03


@pytest.mark.parametrize("value", [lambda t: 0.0, lambda t: 0.3, lambda t: 0.6 * (t % 1.5 < 0.004)])
def test_a_reading_that_the_rig_does_not_move_may_stay_as_it_is(tmp_path, value):
    """A knob that nobody turns, and a force sensor at rest between taps."""
    felt = short("cart_felt", FELT, seconds=4.0).changed(effects={"push": False})
    for made, sensor in ((with_a_knob(tmp_path, {}), "knob"), (felt, "force")):
        run = rig_run.run(made, Turned(SimulatedPlant(made.twin), sensor, value), rig_run.RunSettings(lockstep=True))
        assert (run.manifest["rig"]["end"], run.manifest["rig"].get("trip")) == ("finished", None)
