"""The sketch of an exported controller, on a Cortex-M4F in QEMU, drives the twin that is served over a serial line."""

import threading

import numpy as np
import pytest

from masking.exports.controllers import sampled_unit
from masking.records.recording import Recording
from masking.runs import hardware
from tests import arduino
from tests.arduino import built, started
from tests.test_adapters import experiment, folder

__all__ = ["experiment", "folder"]  # fixtures

pytestmark = pytest.mark.skipif(not (arduino.COMPILER and arduino.EMULATOR), reason=arduino.MISSING)
SAMPLES = 700  # the release is after 500
EPSILON = float(np.finfo(np.float32).eps)


@pytest.mark.parametrize(("real", "within"), [("double", 1e-10), ("float", 1e-3)])
def test_a_sketch_drives_a_served_twin_as_the_kernel_does(experiment, folder, tmp_path, real, within):
    offline = experiment.run()
    program = built(tmp_path, sampled_unit(experiment.sampled, "cart", 0.02), real, '-DLOCKSTEP="true"')
    is_ready, is_over, at = threading.Event(), threading.Event(), []

    def ready(address):
        at.append(address.removeprefix("serial://"))
        is_ready.set()

    thread = threading.Thread(
        target=lambda: hardware.serve(
            folder / "rig.yaml", "serial:pty", lockstep=True, record=tmp_path / "twin", sessions=1, ready=ready,
            stop=is_over.is_set,
        ),
        daemon=True,
    )  # fmt: skip
    thread.start()
    assert is_ready.wait(60.0)
    board = started(program, at[0])
    try:
        thread.join(5.0)
    finally:
        board.kill()
        board.wait()
        is_over.set()
        thread.join(20.0)
    found = Recording.load(tmp_path / "twin" / "session-1")
    print(found.manifest, len(found))
    before = experiment.sampled.before
    assert len(found) > before + SAMPLES
    x = found["sensor.x"][before : before + SAMPLES]
    y = offline["sensor.x"][:SAMPLES]
    n = min(len(x), len(y))
    print(np.max(np.abs(x[:n] - y[:n])) / np.max(np.abs(y)))
    assert np.max(np.abs(x[:n] - y[:n])) <= within * np.max(np.abs(y))
