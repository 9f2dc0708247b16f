"""On a rig that runs by itself: passive coordinates, and virtual systems with inputs from files, sensors and pushes."""

import json

import numpy as np
import pytest
import yaml
from test_rig import serving

from masking.cli import main
from masking.plants.simulated import SimulatedPlant
from masking.records.recording import Recording
from masking.runs import hardware
from masking.runs.experiment import Experiment

HELD = {"rate": "500 Hz", "observer": "disturbance", "homing": 1}
FELT = {**HELD, "external": "felt"}
SEEN = ("sensor", "input", "demanded", "virtual_input", "ideal")


def short(name, controller=HELD, seconds=2.0):
    made = Experiment.load(name)
    return made.changed(duration=seconds / made.time_scale, controller=controller)


@pytest.mark.parametrize("name", ["cart_alone_rig", "cart_reference"])
def test_in_lockstep_it_is_the_run_offline(name):
    made = short(name)
    found = hardware.run(made, SimulatedPlant(made.twin, made.declaration.seed), lockstep=True)
    expected = made.run()
    assert found.names() == expected.names()
    for column in expected.columns:
        if column.split(".")[0] in SEEN:
            np.testing.assert_allclose(found[column], expected[column], rtol=1e-9, atol=1e-12, err_msg=column)
    assert found.manifest["masking_error"]["x"] <= 0.03


@pytest.mark.parametrize("name", ["cart_felt", "cart_felt_observer"])
def test_a_push_that_begins_before_the_release_is_felt_from_there_on(name):
    """The hand pushes while the rig is homed; the ideal mass gets what the controller felt."""
    made = short(name, FELT, seconds=10.0)
    found = hardware.run(made, SimulatedPlant(made.twin), lockstep=True)
    assert found.manifest["rig"]["end"] == "finished"
    for run in (found, made.run()):
        assert run.manifest["masking_error"]["x"] <= 0.03


@pytest.mark.parametrize(
    ("name", "plant", "controller"),
    [
        ("cart_alone_rig", "cart_pendulum", HELD),
        ("cart_reference", "cart", HELD),
        ("cart_felt", "cart_pendulum", FELT),
    ],
)
def test_on_the_command_line_over_udp(tmp_path, capsys, name, plant, controller):
    made, file, out = short(name, controller), tmp_path / "short.yaml", tmp_path / "out"
    declared = made.declaration.canonical()
    for source in declared.get("inputs", {}).values():
        if "file" in source:
            source["file"] = str(made.inputs.path("r"))
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


def test_passive_coordinates_in_real_time(tmp_path):
    made, file, out = short("cart_alone_rig", seconds=1.0), tmp_path / "short.yaml", tmp_path / "out"
    made.run()
    file.write_text(yaml.safe_dump(made.declaration.canonical()))
    with serving("cart_pendulum") as (_, address):
        assert main(["rig", "run", str(file), "--plant", address, "--out", str(out)]) == 0
    found = Recording.load(out)
    assert found.manifest["mode"] == "real time"
    assert found.manifest["rig"]["end"] == "finished"
    assert found.manifest["passive"]["coordinates"] == ["th"]
