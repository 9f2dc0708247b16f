"""The outputs of a plant whose process is killed: they are at zero although nothing in that process could do so."""

import contextlib
import dataclasses
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from masking import process_environment
from masking.app.workflows.recover import recover
from masking.errors import PlantRefusedError, RecordError
from masking.lab.plants.interface import Settings
from masking.lab.plants.udp import UdpPlant
from masking.lab.records import stream_reader
from masking.lab.records.recording import Recording

ADAPTER = """
import fcntl, os
import numpy as np
from masking.lab.plants.interface import LifeCycle, Sample, check_command

class Held:
    '''A plant whose output is the content of a file, which only one process may write.'''
    owns_clock, sensors, actuators = False, ("x",), ("u",)
    def __init__(self, address):
        self.address, self.path = address, address.partition(":")[2]
        self._life, self._file, self._index = LifeCycle(), None, -1
    def _put(self, value):
        os.pwrite(self._file, f"{value:9.3f}".encode(), 0)
    def configure(self, settings):
        self._life.configure()
        self._index = -1
    def activate(self):
        self._life.activate()
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._put(0.0)
    def read(self):
        self._index += 1
        return Sample(self._index, np.zeros(1))
    def write(self, index, command):
        check_command(command, self.actuators)
        self._put(float(command[0]))
    def deactivate(self):
        self._life.deactivate()
        if self._file is not None:
            self._put(0.0)
            os.close(self._file)
            self._file = None
    def rest(self):
        file = os.open(self.path, os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.pwrite(file, f"{0.0:9.3f}".encode(), 0)
        finally:
            os.close(file)
"""
DRIVE = """
import sys, time
import numpy as np
from masking.lab.plants import adapters
from masking.lab.plants.interface import Settings
from masking.lab.runs.realtime import Hooks, run_rig
def said(row):
    if row == 50:
        print("driven", flush=True)
run_rig(lambda *_: np.array([0.7]), adapters.connect(sys.argv[1]), Settings(1000.0, 1.0), samples=int(sys.argv[2]),
        limits=np.ones(1), hooks=Hooks(on_tick=said))
"""
LIMIT = 60.0  # s, on a machine that is busy


@pytest.fixture
def environment(tmp_path):
    (tmp_path / "held_rig.py").write_text(ADAPTER)
    info = tmp_path / "held_rig-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: held_rig\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[masking.plants]\nheld = held_rig:Held\n")
    made = process_environment.minimal()
    return made | {"PYTHONPATH": f"{tmp_path}:{made.get('PYTHONPATH', '')}"}


def awaited(is_so):
    until = time.monotonic() + LIMIT
    while not is_so():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_a_controller_that_is_killed_leaves_its_plant_at_zero(tmp_path, environment):
    output = tmp_path / "output"
    command = [sys.executable, "-c", DRIVE, f"held:{output}", "1000000"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "driven\n"
        assert float(output.read_text()) == 0.7
        process.send_signal(signal.SIGKILL)
        process.wait(LIMIT)
        awaited(lambda: float(output.read_text()) == 0.0)


def test_a_run_that_ends_in_order_needs_nobody(tmp_path, environment):
    output = tmp_path / "output"
    command = [sys.executable, "-c", DRIVE, f"held:{output}", "100"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=LIMIT)
    assert (done.stdout, float(output.read_text())) == ("driven\n", 0.0)
    assert "killed" not in done.stderr


def test_a_server_that_is_killed_while_armed_loses_nothing_and_is_a_trip(tmp_path, environment):
    """The outputs go to zero, the plant's own record is kept, and the next server refuses until somebody has looked."""
    output, record = tmp_path / "output", tmp_path / "record"
    command = [sys.executable, "-m", "masking", "rig", "serve", f"held:{output}", "--address", "udp://127.0.0.1:0"]
    given = environment | {"XDG_STATE_HOME": str(tmp_path / "state")}

    @contextlib.contextmanager
    def served():
        options = ["--record", str(record), "--lockstep"]
        with subprocess.Popen([*command, *options], env=given, stderr=subprocess.PIPE, text=True) as server:
            address = next(line for line in server.stderr if "is served at" in line).split()[-1]
            yield server, UdpPlant(address, patience=LIMIT)
            server.kill()

    settings = Settings(1000.0, 1.0, lockstep=True)
    with served() as (server, plant):
        plant.configure(settings)
        plant.activate()
        for index in range(500):
            assert plant.read().index == index
            plant.write(index, np.array([0.7]))
        assert plant.read().index == 500  # so that the command before is in force
        assert float(output.read_text()) == 0.7
        server.kill()
        server.wait(LIMIT)
        plant.deactivate()
    awaited(lambda: float(output.read_text()) == 0.0)
    session = record / "session-1"
    awaited(lambda: has_ended(session))
    assert recover(session).rows >= 499
    assert (Recording.load(session)["input.u"] == 0.7).all()
    with served() as (_, plant):
        with pytest.raises(
            PlantRefusedError, match="it has tripped: its server was killed while a controller drove it"
        ):
            plant.configure(settings)
        plant.configure(dataclasses.replace(settings, acknowledge=True))
        plant.deactivate()


def has_ended(session):
    """Tell whether the recorder of a session has written its last page."""
    with contextlib.suppress(RecordError):  # it still writes
        return stream_reader.read(session).end is not None
    return False
