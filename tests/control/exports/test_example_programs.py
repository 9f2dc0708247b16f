"""Sketches on a Cortex-M4F in QEMU, at a serial line: a controller drives a served twin, and a twin is a plant."""

import subprocess
import threading
import time

import numpy as np
import pytest

from masking.control.exports.controller_units import sampled_unit
from masking.control.exports.rig_units import twin_unit
from masking.errors import PlantLostError, PlantRefusedError
from masking.lab.plants import adapters
from masking.lab.plants.conformance import check
from masking.lab.plants.interface import Settings
from masking.lab.plants.serve import Serving, serve
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import Recording
from tests.lab.plants.test_adapters import experiment, folder
from tests.support import arduino
from tests.support.rig_runs import run_rig

__all__ = ["experiment", "folder"]  # fixtures

pytest.importorskip("serial", reason="pyserial is not installed: pip install 'masking[serial]'")
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(not (arduino.COMPILER and arduino.EMULATOR), reason=arduino.MISSING),
]
AFTER = 250  # samples since the release
PATIENCE = 60.0  # s
# The readings of a loop in float are off by roundings of commands and estimates, half a unit of the last place each.
ROUNDING = 0.5 * float(np.finfo(np.float32).eps)


@pytest.mark.parametrize(("real", "within"), [("double", 1e-12), ("float", 20.0 * ROUNDING)])
def test_a_sketch_drives_a_served_twin_as_the_kernel_does(experiment, tmp_path, real, within):
    program = arduino.built(tmp_path, sampled_unit(experiment.sampled, "cart", 0.02), real, '-DLOCKSTEP="true"')
    plant, before = SimulatedPlant(experiment.twin), experiment.sampled.before
    is_ready, give_up, at, ticks = threading.Event(), time.monotonic() + PATIENCE, [], before + AFTER

    def ready(address):
        at.append(address.removeprefix("serial://"))
        is_ready.set()

    def stop():
        telling = plant._tick if plant._life.state == "active" else 0
        return telling >= ticks or time.monotonic() > give_up

    serving = Serving("lockstep", tmp_path / "twin", sessions=1)
    server = threading.Thread(target=serve, args=(plant, "serial:pty", serving), kwargs={"ready": ready, "stop": stop})
    server.start()
    assert is_ready.wait(PATIENCE)
    board = arduino.started(program, at[0])
    try:
        server.join(2.0 * PATIENCE)
    finally:
        board.kill()
        board.wait()
    found = Recording.load(tmp_path / "twin" / "session-1")
    assert found["tick"].tolist() == list(range(ticks + 1))
    assert found["fresh"][:-1].all()
    expected = experiment.run()["sensor.x"][: AFTER + 1]
    error = np.max(np.abs(found["sensor.x"][before:] - expected)) / np.max(np.abs(expected))
    assert error <= within


@pytest.fixture(scope="module")
def board(experiment, tmp_path_factory):
    """Return the address of a board that is a plant, at 500 Hz."""
    program = arduino.built(tmp_path_factory.mktemp("board"), twin_unit(experiment.twin, "cart", 500.0), "double")
    started = arduino.started(program, "pty", stdout=subprocess.PIPE, text=True)
    try:
        yield f"serial://{started.stdout.readline().split('redirected to ')[1].split()[0]}"
    finally:
        started.kill()
        started.wait()
        started.stdout.close()


def test_a_board_keeps_the_rules_of_a_plant(board):
    assert check(lambda: adapters.connect(board), Settings(500.0, 1.0, lockstep=True)) == []


def test_a_board_moves_as_the_twin_does(experiment, board):
    def damped(_, values):
        return -300.0 * values + 0.1 * np.cos(1e4 * values)

    settings = {"rate": 500.0, "samples": 200, "limits": np.ones(1), "lockstep": True}
    here, there = (
        run_rig(damped, plant, **settings) for plant in (SimulatedPlant(experiment.twin), adapters.connect(board))
    )
    assert np.max(np.abs(here.sensors)) > 1e-4
    assert np.max(np.abs(here.sensors - there.sensors)) <= 1e-12 * np.max(np.abs(here.sensors))
    assert np.array_equal(here.index, there.index)


def test_a_board_refuses_another_rate(board):
    with pytest.raises(PlantRefusedError, match="this plant has 500 samples per second: give that rate"):
        adapters.connect(board).configure(Settings(1000.0))


def test_a_board_keeps_that_its_controller_tripped(board):
    run = {"rate": 500.0, "samples": 5, "limits": np.ones(1), "lockstep": True}
    assert run_rig(lambda *_: np.full(1, np.nan), adapters.connect(board), **run).reason == "tripped"
    with pytest.raises(PlantRefusedError, match="refuses: it has tripped: the controller stopped; look at the rig"):
        run_rig(lambda *_: np.zeros(1), adapters.connect(board), **run)
    assert run_rig(lambda *_: np.zeros(1), adapters.connect(board), **run, acknowledge=True).reason == "finished"


def test_a_board_that_has_tripped_waits_for_an_acknowledgement(board):
    plant = adapters.connect(board)
    plant.configure(Settings(500.0, 0.1))
    plant.activate()
    plant.write(plant.read().index, np.zeros(1))
    with pytest.raises(PlantLostError, match="ended the session: no valid command in the time of the watchdog"):
        while True:
            plant.read()
    plant.deactivate()
    said = "refuses: it has tripped: no valid command in the time of the watchdog; look at the rig, then start once"
    for _ in range(2):
        with pytest.raises(PlantRefusedError, match=said):
            plant.configure(Settings(500.0, 0.1))
    plant.configure(Settings(500.0, 1.0, acknowledge=True))
    plant.activate()
    assert plant.read().index < 200  # its clock began anew; a busy machine reads the newest of several samples
    plant.deactivate()
    plant.configure(Settings(500.0, 1.0))
    plant.deactivate()
