"""The sketch of an exported controller, on a Cortex-M4F in QEMU, drives the twin that is served over a serial line."""

import threading
import time

import numpy as np
import pytest

from masking.exports.controllers import sampled_unit
from masking.plants.serve import serve
from masking.plants.simulated import SimulatedPlant
from masking.records.recording import Recording
from tests import arduino
from tests.test_adapters import experiment, folder

__all__ = ["experiment", "folder"]  # fixtures

pytest.importorskip("serial", reason="pyserial is not installed: pip install 'masking[serial]'")
pytestmark = pytest.mark.skipif(not (arduino.COMPILER and arduino.EMULATOR), reason=arduino.MISSING)
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

    options = {"clock": "lockstep", "record": tmp_path / "twin", "stop_after": 1, "ready": ready, "stop": stop}
    server = threading.Thread(target=serve, args=(plant, "serial:pty"), kwargs=options)
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
