"""The plant that the controller does not own: its rules, its frames, its server, its watchdog."""

import inspect
import signal
import socket
import threading
import time
import zlib
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from masking.errors import (
    CommandError,
    PlantLostError,
    PlantMismatchError,
    PlantOrderError,
    PlantRefusedError,
    WireError,
)
from masking.lab.plants import controller_session as sessions
from masking.lab.plants import serve as serving
from masking.lab.plants import wire
from masking.lab.plants.conformance import check
from masking.lab.plants.controller_session import Allowed
from masking.lab.plants.interface import LifeCycle, Sample, Settings, check_command
from masking.lab.plants.serve import Serving, serve
from masking.lab.plants.udp import UdpPlant
from masking.lab.plants.wire import Kind
from masking.lab.records.recording import Recording
from tests.support.forked import Forked
from tests.support.rig_runs import run_rig

pytestmark = pytest.mark.realtime

LOCKSTEP = Settings(rate=1000.0, lockstep=True)
NOWHERE = "udp://127.0.0.1:0"
SLOW = Allowed(watchdog=5.0)


class MassSpring:
    """Two masses on springs, exact between samples: the example of an adapter."""

    sensors = ("x1", "x2")
    actuators = ("u1", "u2")
    owns_clock = False
    stiffness = 4000.0  # 1/s**2

    def __init__(self):
        self.life = LifeCycle()
        self.applied = np.zeros(2)

    def configure(self, settings):
        self.life.configure()
        w = np.sqrt(self.stiffness)
        c, s = np.cos(w / settings.rate), np.sin(w / settings.rate)
        self.forward = np.array([[c, s / w], [-w * s, c]])
        self.tick, self.is_due = 0, False
        self.state = np.array([[1e-3, -2e-3], [0.0, 0.0]])  # positions and velocities of both

    def activate(self):
        self.life.activate()

    def read(self):
        self.life.need_active("read")
        if self.is_due:
            rest = np.array([self.applied / self.stiffness, np.zeros(2)])
            self.state = rest + self.forward @ (self.state - rest)
            self.tick, self.is_due = self.tick + 1, False
        return Sample(self.tick, self.state[0].copy())

    def write(self, index, command):
        self.life.need_active("write")
        check_command(command, self.actuators)
        self.applied, self.is_due = np.array(command), True

    def deactivate(self):
        self.applied = np.zeros(2)
        self.life.deactivate()

    def telemetry(self):
        return {f"applied.{name}": float(value) for name, value in zip(self.actuators, self.applied, strict=True)}


IMPORTS = """\
import os, sys, time
import numpy as np
from masking.lab.plants.interface import LifeCycle, Sample, Settings, check_command
from masking.lab.plants.serve import Serving, serve
from masking.lab.plants.controller_session import Allowed
from masking.lab.plants.udp import UdpPlant
from masking.lab.runs.realtime import Hooks, run_rig
"""


@contextmanager
def process(code: str, *arguments: object):
    """Run code in a process of its own; give it and the first line that it prints."""
    with Forked(arguments, IMPORTS + inspect.getsource(MassSpring) + code) as started:
        try:
            yield started, started.stdout.readline().strip()
        finally:
            started.kill()


SERVER = """
def say(address):
    print(address, flush=True)
serving = Serving(record=sys.argv[1], sessions=int(sys.argv[2]), after_latch=0.1, allowed=Allowed(watchdog=5.0))
serve(MassSpring(), "udp://127.0.0.1:0", serving, ready=say)
"""

# Writes 1 V to both actuators at every tick, and says so after the first.
CONTROLLER = """
def on_tick(row):
    if row == 0:
        print("running", flush=True)
run = run_rig(lambda *_: np.ones(2), UdpPlant(sys.argv[1], timeout=5.0, patience=20.0),
              Settings(1000.0, float(sys.argv[2])), samples=10**6, limits=np.full(2, 5.0), hooks=Hooks(on_tick=on_tick))
print(run.reason, flush=True)
"""


@contextmanager
def served(plant, *, sessions: int | None = 1, **settings):
    """Serve a plant in a thread; give its address and, once it ended, the folders of its recordings."""
    is_ready, is_over, addresses, folders, told = threading.Event(), threading.Event(), [], [], []
    serving = Serving(**{"allowed": SLOW, "sessions": sessions, **settings})

    def ready(address):
        addresses.append(address)
        is_ready.set()

    def run():
        folders.extend(serve(plant, NOWHERE, serving, stop=is_over.is_set, ready=ready, tell=told.append))

    thread = threading.Thread(target=run)
    thread.start()
    assert is_ready.wait(20.0)
    try:
        yield addresses[0], folders
        if sessions is None:
            is_over.set()
    except BaseException:
        is_over.set()
        raise
    finally:
        thread.join(20.0)
        assert not thread.is_alive()


@contextmanager
def line(address: str):
    """Open a bare socket to a plant."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.connect(wire.parse_address(address))
        opened.settimeout(20.0)
        yield opened


# --- the wire ---------------------------------------------------------------------------------------------------------

U64 = st.integers(0, 2**64 - 1)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(session=U64, index=U64, values=st.lists(FINITE, max_size=20))
def test_values_come_back_as_they_went(session, index, values):
    frame = wire.decode(wire.encode(Kind.COMMAND, session, index, values=np.array(values, dtype=float)))
    assert (frame.kind, frame.session, frame.index) == (Kind.COMMAND, session, index)
    assert frame.values.tobytes() == np.array(values, dtype=float).tobytes()


@given(kind=st.sampled_from(sorted(wire.TEXTUAL)), text=st.text(st.characters(exclude_categories=["Cs"])))
def test_text_comes_back_as_it_went(kind, text):
    frame = wire.decode(wire.encode(kind, 7, text=text))
    assert (frame.kind, frame.text, len(frame.values)) == (kind, text, 0)


@pytest.mark.parametrize(
    "datagram",
    [wire.encode(Kind.COMMAND, 2**63 + 5, 12, values=np.array([1.0, -2.5])), wire.encode(Kind.HELLO, 3, text="{}")],
    ids=["values", "text"],
)
def test_no_single_bit_can_turn(datagram):
    wire.decode(datagram)
    for bit in range(8 * len(datagram)):
        turned = bytearray(datagram)
        turned[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError):
            wire.decode(bytes(turned))


@given(st.binary(max_size=100))
def test_noise_is_refused(noise):
    with pytest.raises(WireError):
        wire.decode(noise)


def resealed(datagram: bytes, at: int, new: bytes) -> bytes:
    """Change bytes of a frame and make its check sum right again."""
    body = datagram[:at] + new + datagram[at + len(new) : -4]
    return body + zlib.crc32(body).to_bytes(4, "little")


COMMAND = wire.encode(Kind.COMMAND, 1, 2, values=np.ones(2))


@pytest.mark.parametrize(
    ("datagram", "cause"),
    [
        (b"", "foreign"),
        (b"GET / HTTP/1.1\r\nHost: masking, which is long enough\r\n", "foreign"),
        (COMMAND[:-1], "corrupt"),
        (COMMAND + b"\0", "corrupt"),
        (resealed(COMMAND, 4, b"\2"), "version"),
        (resealed(COMMAND, 5, b"\x63"), "malformed"),
        (resealed(COMMAND, 6, b"\1"), "malformed"),
        (resealed(COMMAND, 32, b"\3"), "malformed"),
        (resealed(wire.encode(Kind.HELLO, 1, text="ab"), 36, b"\xff"), "malformed"),
        (wire.encode(Kind.COMMAND, 1, 2, values=np.array([1.0, np.nan])), "nonfinite"),
        (wire.encode(Kind.COMMAND, 1, 2, values=np.array([-np.inf])), "nonfinite"),
    ],
    ids=["empty", "http", "short", "long", "version", "kind", "reserved", "count", "utf-8", "nan", "inf"],
)
def test_each_fault_has_its_name(datagram, cause):
    with pytest.raises(WireError) as caught:
        wire.decode(datagram)
    assert caught.value.cause == cause


def test_sensors_may_show_that_they_are_broken():
    assert np.isnan(wire.decode(wire.encode(Kind.SENSORS, 1, 2, values=np.array([np.nan]))).values).all()


def test_settings_and_channels_survive_the_wire():
    settings = Settings(rate=800.0, watchdog=0.05, lockstep=True)
    assert wire.read_settings(wire.settings_text(settings)) == settings
    assert wire.read_channels(wire.channels_text(("a", "b"), ("u",))) == (("a", "b"), ("u",))


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (wire.read_settings, "no", "does not speak this language"),
        (wire.read_settings, "[1]", "does not speak this language"),
        (wire.read_settings, '{"rate": 1}', "a hello holds rate, watchdog, lockstep"),
        (wire.read_settings, '{"rate": 0, "watchdog": 1, "lockstep": true}', "rate is 0; give a positive number"),
        (wire.read_settings, '{"rate": 1, "watchdog": NaN, "lockstep": true}', "does not speak this language"),
        (wire.read_settings, '{"rate": 1, "watchdog": "1", "lockstep": true}', "watchdog is '1'; give a positive"),
        (wire.read_settings, '{"rate": 1, "watchdog": 1, "lockstep": 1}', "lockstep is 1; give true or false"),
        (wire.read_channels, '{"sensors": ["a", "a"], "actuators": ["u"]}', "does not name its sensors"),
        (wire.read_channels, '{"sensors": ["a"], "actuators": []}', "does not name its actuators"),
        (wire.read_channels, '{"sensors": ["a"]}', "does not name its actuators"),
        (wire.parse_address, "http://127.0.0.1:1", "write it as udp://127.0.0.1:5005"),
        (wire.parse_address, "udp://127.0.0.1", "write it as udp://127.0.0.1:5005"),
        (wire.parse_address, "udp://127.0.0.1:99999", "write it as udp://127.0.0.1:5005"),
    ],
)
def test_what_the_other_side_says_is_checked(read, text, said):
    with pytest.raises(PlantMismatchError, match=said):
        read(text)


# --- the rules of a plant ---------------------------------------------------------------------------------------------


def test_the_example_conforms():
    assert check(MassSpring) == []


def test_a_served_plant_conforms():
    with served(MassSpring(), sessions=None, clock="lockstep") as (address, _):
        settings = Settings(rate=1000.0, watchdog=1.0, lockstep=True)
        assert check(lambda: UdpPlant(address), settings) == []


class Forgetful(MassSpring):
    def deactivate(self):
        self.life.deactivate()


class Careless(MassSpring):
    def write(self, index, command):
        self.applied[:] = np.resize(command, 2)
        self.is_due = True


class Touchy(MassSpring):
    def deactivate(self):
        self.life.need_active("deactivate")
        super().deactivate()


class Shared(MassSpring):
    def read(self):
        sample = super().read()
        if not hasattr(self, "values"):
            self.values = sample.values
        self.values[:] = sample.values
        return Sample(sample.index, self.values)


class Coarse(MassSpring):
    sensors = ("x", "x")

    def read(self):
        sample = super().read()
        return Sample(sample.index // 2, sample.values.astype(np.float32))


class Crashing(MassSpring):
    def read(self):
        raise ZeroDivisionError("of a driver")


@pytest.mark.parametrize(
    ("plant", "said"),
    [
        (Forgetful, "the output u1 is 0.001 after deactivate; it must be 0"),
        (Careless, "a command of shape (3,) was accepted; it must be refused with a PlantError"),
        (Careless, "a command of nan was accepted; it must be refused with a PlantError"),
        (Careless, "write before activate was accepted; it must be refused with a PlantError"),
        (Touchy, "deactivate before configure raised PlantOrderError"),
        (Shared, "the values of a sample changed after it was read; give each sample an array of its own"),
        (Coarse, "sensors are x, x; no name may stand twice"),
        (Coarse, "sample 0 came after sample 0; the index must increase"),
        (Coarse, "the values of a sample are float32 of shape (2,); they must be float64 of (2,)"),
        (Crashing, "read before configure raised ZeroDivisionError: of a driver; it must be refused"),
        (Crashing, "A sample is one finite float64 for each sensor, and its index increases, but it raised ZeroDiv"),
    ],
)
def test_what_a_plant_breaks_is_said(plant, said):
    assert any(said in rule for rule in check(plant))


def test_the_life_cycle_says_what_to_call_first():
    plant = MassSpring()
    with pytest.raises(PlantOrderError, match="read: the plant is unconfigured; call configure and activate first"):
        plant.read()
    plant.configure(LOCKSTEP)
    with pytest.raises(PlantOrderError, match="write: the plant is inactive; call activate first"):
        plant.write(0, np.zeros(2))
    plant.activate()
    with pytest.raises(PlantOrderError, match="configure: the plant is active; call deactivate first"):
        plant.configure(LOCKSTEP)
    with pytest.raises(CommandError, match="the command for u2 is nan; give a finite number"):
        plant.write(0, np.array([0.0, np.nan]))


# --- over the wire ----------------------------------------------------------------------------------------------------


def damped(_, values):
    """Return a command that depends on every bit of the sensors."""
    return -300.0 * values + 0.1 * np.sin(1e3 * values)


RUN = {"rate": 1000.0, "samples": 300, "limits": np.array([0.2, 0.4]), "lockstep": True}


def test_lockstep_over_the_wire_is_the_run_in_this_process_bit_for_bit(tmp_path):
    here = run_rig(damped, MassSpring(), **RUN)
    with served(MassSpring(), clock="lockstep", record=tmp_path) as (address, folders):
        there = run_rig(damped, UdpPlant(address, patience=20.0), **RUN)
    assert here.reason == there.reason == "finished"
    for name in ("times", "index", "sensors", "demanded", "applied"):
        assert getattr(here, name).tobytes() == getattr(there, name).tobytes(), name
    recording = Recording.load(folders[0])
    assert recording.array("sensor")[:300].tobytes() == there.sensors.tobytes()
    assert recording.array("input")[:300].tobytes() == there.applied.tobytes()
    assert np.array_equal(recording["plant.applied.u1"], recording["input.u1"])
    assert recording["input.u1"][-1] == 0.0
    assert recording.manifest["end"] == "bye"
    assert recording.manifest["latch"] is None


def opened(bare, session: int, settings: Settings) -> None:
    """Open a session by hand and start it."""
    bare.send(wire.encode(Kind.HELLO, session, text=wire.settings_text(settings)))
    assert wire.decode(bare.recv(65535)).kind is Kind.ACCEPT
    bare.send(wire.encode(Kind.START, session))


def test_the_plant_rejects_and_counts_what_is_no_fresh_command(tmp_path):
    def command(session, index, value, size=2):
        return wire.encode(Kind.COMMAND, session, index, values=np.full(size, value))

    with served(MassSpring(), clock="lockstep", record=tmp_path) as (address, folders), line(address) as bare:
        opened(bare, 5, LOCKSTEP)
        for tick in range(30):
            assert wire.decode(bare.recv(65535)).index == tick
            if tick == 25:
                bare.send(command(5, 24, 9.0))  # again
                bare.send(command(5, 20, 9.0))  # late
                bare.send(command(5, 26, 9.0))  # for a sample that is not there yet
                bare.send(command(6, 25, 9.0))  # of somebody else
                bare.send(command(5, 25, 9.0, size=3))
                bare.send(command(5, 25, np.nan))
                bare.send(damaged(COMMAND))
                bare.send(b"noise")
                bare.send(wire.encode(Kind.SENSORS, 5, 25, values=np.ones(2)))
            bare.send(command(5, tick, tick / 100))
        bare.recv(65535)
        bare.send(wire.encode(Kind.BYE, 5))
    recording = Recording.load(folders[0])
    wrong = ("duplicate", "reordered", "ahead", "other session", "wrong size", "nonfinite", "corrupt", "foreign")
    counters = recording.manifest["counters"]
    assert {name: counters.get(name) for name in (*wrong, "unexpected")} == dict.fromkeys((*wrong, "unexpected"), 1)
    assert counters["commands"] == 30
    assert recording["input.u1"].tolist() == [*(tick / 100 for tick in range(30)), 0.0]


def test_a_command_that_answers_an_old_sample_is_as_good_as_none(tmp_path):
    with served(MassSpring(), record=tmp_path) as (address, folders), line(address) as bare:
        opened(bare, 5, Settings(rate=500.0, watchdog=0.02))
        while wire.decode(bare.recv(65535)).index < 12:
            pass
        bare.send(wire.encode(Kind.COMMAND, 5, 2, values=np.ones(2)))  # the first, newer than none, 10 ticks old
        bare.send(wire.encode(Kind.BYE, 5))
    recording = Recording.load(folders[0])
    assert recording.manifest["counters"]["stale"] == 1
    assert not recording["input.u1"].any()
    assert not recording["fresh"].any()


def damaged(frame):
    """Invert the last byte, so that the checksum fails for every frame."""
    return frame[:-1] + bytes([frame[-1] ^ 0xFF])


@contextmanager
def forged(frames):
    """Play a plant with sensors a and b that sends given datagrams (bytes of a session) once it is started."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(20.0)

        def play():
            frame, is_started = None, False
            while not is_started:
                datagram, address = opened.recvfrom(65535)
                frame = wire.decode(datagram)
                if frame.kind is Kind.HELLO:
                    text = wire.channels_text(("a", "b"), ("u",))
                    opened.sendto(wire.encode(Kind.ACCEPT, frame.session, text=text), address)
                is_started = frame.kind is Kind.START
            for datagram in frames(frame.session):
                opened.sendto(datagram, address)

        thread = threading.Thread(target=play)
        thread.start()
        yield f"udp://127.0.0.1:{opened.getsockname()[1]}", thread
        thread.join(20.0)


def test_the_controller_gets_the_newest_sample_and_counts_the_rest():
    def sample(session, index, size=2):
        return wire.encode(Kind.SENSORS, session, index, values=np.full(size, float(index)))

    def frames(session):
        broken = damaged(sample(session, 9))
        return [
            *(sample(session, index) for index in (3, 4, 4, 2, 5)),
            sample(session + 1, 90),
            sample(session, 91, size=3),
            broken,
            b"noise",
            wire.encode(Kind.COMMAND, session, 92, values=np.ones(2)),
        ]

    plant = UdpPlant(NOWHERE)
    with forged(frames) as (address, thread):
        plant = UdpPlant(address, timeout=0.3)
        plant.configure(Settings(rate=1000.0))
        plant.activate()
        thread.join(20.0)
        found = plant.read()
        with pytest.raises(PlantLostError, match=r"sent no sample for 0\.3 s"):
            plant.read()
        counters = dict(plant.counters)
        plant.deactivate()
    assert (found.index, found.values.tolist()) == (5, [5.0, 5.0])
    assert counters == {
        "skipped": 2,
        "duplicate": 1,
        "reordered": 1,
        "other session": 1,
        "wrong size": 1,
        "corrupt": 1,
        "foreign": 1,
        "unexpected": 1,
    }


def test_without_a_plant_it_is_said_how_to_start_one():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"udp://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(PlantLostError, match=f"no plant answers at {address}; start it with 'masking rig serve"):
            UdpPlant(address, patience=0.1).configure(LOCKSTEP)
    with pytest.raises(PlantLostError, match=f"no plant answers at {address}; start it with 'masking rig serve"):
        UdpPlant(address, patience=0.1).configure(LOCKSTEP)  # nobody is there at all


def test_a_second_controller_is_refused_and_the_first_goes_on():
    with served(MassSpring(), clock="lockstep") as (address, _):
        first, second = UdpPlant(address, patience=20.0), UdpPlant(address, patience=20.0)
        refused = pytest.raises(PlantRefusedError, match=r"a controller at 127\.0\.0\.1:\d+ has this plant; stop that")
        first.configure(LOCKSTEP)
        with refused:
            second.configure(LOCKSTEP)
        first.activate()
        with refused:
            second.configure(LOCKSTEP)
        for tick in range(3):
            sample = first.read()
            assert sample.index == tick
            first.write(sample.index, np.zeros(2))
        first.deactivate()


class Stalling(MassSpring):
    def write(self, index, command):
        super().write(index, command)
        if index == 5:
            time.sleep(0.03)


def test_a_server_that_was_held_up_counts_and_does_not_catch_up(tmp_path):
    with served(Stalling(), record=tmp_path) as (address, folders):
        run = run_rig(
            damped,
            UdpPlant(address, timeout=5.0, patience=20.0),
            rate=1000.0,
            samples=40,
            limits=np.ones(2),
            watchdog=5.0,
        )
    assert run.reason == "finished"
    recording = Recording.load(folders[0])
    wall, tick = recording["wall"], recording["tick"]
    assert recording.manifest["counters"]["overruns"] >= 29
    assert wall[6] - wall[5] >= 0.029
    assert recording["late"].max() >= 0.028
    assert np.array_equal(tick, np.arange(len(tick)))
    assert np.all(wall[7:] >= tick[7:] / 1000.0 + 0.027)  # what was left out is not made up for


def test_a_server_of_another_clock_refuses():
    with served(MassSpring()) as (address, _):
        plant = UdpPlant(address)
        with pytest.raises(PlantRefusedError, match="its clock is 'real', the controller wants 'lockstep'"):
            plant.configure(LOCKSTEP)
        plant.configure(Settings(rate=100.0))
        plant.activate()
        plant.deactivate()


def test_only_a_plant_that_does_not_own_its_clock_is_served():
    with pytest.raises(PlantMismatchError, match="this plant owns its clock"):
        serve(UdpPlant(NOWHERE), NOWHERE, Serving())


class Failing(MassSpring):
    def write(self, index, command):
        if index == 3:
            raise ZeroDivisionError("of a driver")
        super().write(index, command)


class Blind(MassSpring):
    def read(self):
        sample = super().read()
        return Sample(sample.index, np.array([np.nan, 1.0]) if sample.index == 2 else sample.values)


def test_a_plant_that_fails_ends_the_session_and_keeps_the_record(tmp_path):
    with served(Failing(), clock="lockstep", record=tmp_path) as (address, folders):  # noqa: SIM117
        with pytest.raises(PlantLostError, match="the plant failed: ZeroDivisionError: of a driver"):
            run_rig(damped, UdpPlant(address), **RUN)
    recording = Recording.load(folders[0])
    assert recording.manifest["end"] == "the plant failed: ZeroDivisionError: of a driver"
    assert recording["tick"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert recording["input.u1"][-1] == 0.0


def test_a_broken_sensor_does_not_cost_the_record(tmp_path):
    with served(Blind(), clock="lockstep", record=tmp_path) as (address, folders):
        run_rig(lambda *_: np.zeros(2), UdpPlant(address, patience=20.0), **{**RUN, "samples": 5})
    recording = Recording.load(folders[0])
    assert recording["nonfinite.sensor.x1"].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0, 0.0][: len(recording)]
    assert recording["sensor.x1"][2] == 0.0


def test_in_lockstep_a_silent_controller_is_given_up(tmp_path):
    with served(MassSpring(), clock="lockstep", record=tmp_path, patience=0.1) as (address, folders):
        plant = UdpPlant(address, patience=20.0)
        plant.configure(LOCKSTEP)
        plant.activate()
        plant.write(plant.read().index, np.ones(2))
        plant.read()
        with pytest.raises(PlantLostError, match=r"ended the session: no command for 0\.1 s in lockstep"):
            plant.read()
        plant.deactivate()
    recording = Recording.load(folders[0])
    assert recording["input.u1"].tolist() == [1.0, 0.0]
    assert recording["latched"].tolist() == [0.0, 1.0]
    assert recording.manifest["latch"] == {"cause": "no command for 0.1 s in lockstep", "tick": 1}


def test_a_controller_that_never_commands_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(sessions, "SILENT_START", 0.02)
    with served(MassSpring(), record=tmp_path, after_latch=0.0) as (address, folders):
        plant = UdpPlant(address, timeout=5.0, patience=20.0)
        plant.configure(Settings(rate=1000.0))
        plant.activate()
        with pytest.raises(PlantLostError, match=r"ended the session: no command for 0\.02 s after the start"):
            while True:
                plant.read()
        plant.deactivate()
    assert not Recording.load(folders[0]).array("input").any()


def test_a_controller_that_never_starts_is_given_up(monkeypatch):
    monkeypatch.setattr(serving, "RESERVED", 0.05)
    with served(MassSpring(), sessions=None, clock="lockstep") as (address, _):
        first, second = UdpPlant(address), UdpPlant(address)
        first.configure(LOCKSTEP)
        give_up = time.monotonic() + 20.0
        while time.monotonic() < give_up:
            with suppress(PlantRefusedError):
                second.configure(LOCKSTEP)
                break
        second.activate()
        assert second.read().index == 0
        first.deactivate()
        second.deactivate()


def test_sessions_follow_each_other_from_the_same_start(tmp_path):
    with served(MassSpring(), sessions=2, clock="lockstep", record=tmp_path) as (address, folders):
        runs = [run_rig(damped, UdpPlant(address, patience=20.0), **RUN) for _ in range(2)]
    assert runs[0].sensors.tobytes() == runs[1].sensors.tobytes()
    assert [folder.name for folder in folders] == ["session-1", "session-2"]


# --- in real time, in a process of its own ----------------------------------------------------------------------------


def test_real_time_counts_agree_on_both_sides(tmp_path):
    with process(SERVER, tmp_path, 1) as (server, address):
        run = run_rig(
            damped,
            UdpPlant(address, timeout=5.0, patience=20.0),
            rate=1000.0,
            samples=1000,
            limits=np.full(2, 0.5),
            watchdog=5.0,
        )
        server.wait(20.0)
    recording = Recording.load(tmp_path / "session-1")
    assert run.reason == "finished"
    assert len(run.index) == 1000
    gaps = np.diff(run.index)
    assert np.all(gaps >= 1)
    assert run.late.tolist() == [False, *(gaps > 1).tolist()]
    assert run.counters["late"] == np.count_nonzero(gaps > 1)
    assert run.counters["missed"] == run.index[-1] - run.index[0] - 999
    assert set(run.counters) <= {"late", "missed", "clamped", "skipped"}
    # Every sample that the controller saw is the plant's own, and what it sent is in force from then or a tick later.
    assert np.array_equal(recording["tick"], np.arange(len(recording)))
    assert np.array_equal(recording.array("sensor")[run.index], run.sensors)
    fresh = recording["fresh"] == 1.0
    assert np.count_nonzero(fresh) <= recording.manifest["counters"]["commands"] <= 1000
    sent = {row.tobytes() for row in run.applied}
    assert {row.tobytes() for row in recording.array("input")[fresh]} <= sent
    # The plant's clock never runs ahead of the wall's.
    assert np.all(recording["wall"] >= recording["t"] - 1e-3)


def last_command(recording: Recording) -> int:
    """Return the row of the last command that arrived."""
    return int(np.flatnonzero(recording["fresh"])[-1])


def latched_in_time(recording: Recording, last: int) -> bool:
    """Whether the watchdog of 20 ms latched at its time after a row, in fewer samples where the server was held up."""
    tick, wall = recording.manifest["latch"]["tick"], recording["wall"]
    return bool(last < tick <= last + 20 and wall[tick] - wall[last] > 0.018)


def test_a_controller_that_is_killed_leaves_a_plant_at_zero(tmp_path):
    with process(SERVER, tmp_path, 1) as (server, address), process(CONTROLLER, address, 0.02) as (controller, said):
        assert said == "running", controller.stderr.read()
        controller.send_signal(signal.SIGKILL)
        controller.wait(20.0)
        server.wait(20.0)
    recording = Recording.load(tmp_path / "session-1")
    last = last_command(recording)
    zero = recording.array("input") == 0.0
    applied = np.column_stack([recording["plant.applied.u1"], recording["plant.applied.u2"]])
    after = recording.t >= recording.t[last] + 0.020 + 2e-3 - 1e-9
    assert np.count_nonzero(after) > 50
    assert zero[after].all()
    assert not applied[after].any()
    assert recording["latched"][after].all()
    assert (recording.array("input")[last] == 1.0).all()
    assert recording.manifest["latch"]["cause"] == "no valid command for 20 ms"
    assert latched_in_time(recording, last)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=["SIGTERM", "SIGHUP"])
def test_a_controller_that_is_told_to_stop_says_goodbye(tmp_path, number):
    with process(SERVER, tmp_path, 1) as (server, address), process(CONTROLLER, address, 5.0) as (controller, said):
        assert said == "running", controller.stderr.read()
        controller.send_signal(number)
        assert controller.stdout.readline().strip() == "interrupted"
        assert controller.wait(20.0) == 0
        server.wait(20.0)
    recording = Recording.load(tmp_path / "session-1")
    assert recording.manifest["end"] == "bye"
    assert (recording["input.u1"][-1], recording["plant.applied.u1"][-1]) == (0.0, 0.0)


def test_a_server_that_is_told_to_stop_saves_its_record_and_its_controller_knows(tmp_path):
    with process(SERVER, tmp_path, 1) as (server, address), process(CONTROLLER, address, 5.0) as (controller, said):
        assert said == "running", controller.stderr.read()
        server.send_signal(signal.SIGTERM)
        assert server.wait(20.0) == 0
        assert controller.wait(20.0) == 1
        assert "ended the session: the server was stopped" in controller.stderr.read()
    recording = Recording.load(tmp_path / "session-1")
    assert recording.manifest["end"] == "the server was stopped"
    assert recording["input.u1"][-1] == 0.0


def test_both_sides_know_that_a_controller_was_frozen(tmp_path):
    with process(SERVER, tmp_path, 1) as (server, address), process(CONTROLLER, address, 0.02) as (controller, said):
        assert said == "running", controller.stderr.read()
        controller.send_signal(signal.SIGSTOP)
        server.wait(20.0)
        controller.send_signal(signal.SIGCONT)
        assert controller.wait(20.0) == 1
        assert "ended the session: no valid command for 20 ms" in controller.stderr.read()
    recording = Recording.load(tmp_path / "session-1")
    last = last_command(recording)
    assert latched_in_time(recording, last)
    assert not recording.array("input")[last + 20 :].any()


@pytest.mark.parametrize("commands", [0, 1, 2, 3])
def test_what_a_plant_said_last_is_read_also_when_it_is_gone(commands):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bare:
        bare.bind(("127.0.0.1", 0))
        bare.settimeout(20.0)

        def play():
            answers = {Kind.HELLO: (Kind.ACCEPT, wire.channels_text(("s",), ("u",))), Kind.START: (Kind.SENSORS, "")}
            for _ in answers:
                datagram, peer = bare.recvfrom(65535)
                asked = wire.decode(datagram)
                kind, text = answers[asked.kind]
                values = np.zeros(1 if kind is Kind.SENSORS else 0)
                bare.sendto(wire.encode(kind, asked.session, 0, values=values, text=text), peer)
            bare.sendto(wire.encode(Kind.STOP, asked.session, text="the bell rang"), peer)
            bare.close()

        plant = UdpPlant(f"udp://127.0.0.1:{bare.getsockname()[1]}", patience=20.0)
        player = threading.Thread(target=play)
        player.start()
        plant.configure(Settings(rate=1000.0, watchdog=5.0, lockstep=True))
        plant.activate()
        assert plant.read().index == 0
        player.join()
        for _ in range(commands):
            plant.write(0, np.zeros(1))
        with pytest.raises(PlantLostError, match="ended the session: the bell rang"):
            plant.read()
        with pytest.raises(PlantLostError, match="is gone"):
            for _ in range(3):
                plant.write(0, np.zeros(1))
        plant.deactivate()


def test_a_plant_that_has_tripped_takes_the_next_controller_that_acknowledges_it(tmp_path):
    with process(SERVER.replace("after_latch=0.1", "after_latch=1e3"), tmp_path, 2) as (server, address):
        with process(CONTROLLER, address, 0.02) as (controller, said):
            assert said == "running", controller.stderr.read()
            controller.send_signal(signal.SIGKILL)
        plant = UdpPlant(address, patience=20.0)
        while True:
            try:
                plant.configure(Settings(rate=1000.0, watchdog=5.0))
            except PlantRefusedError as error:
                if "has this plant" in str(error):  # the watchdog has not seen it yet
                    continue
                said = "it has tripped: no valid command for 20 ms; look at the rig, then start once with --acknowledge"
                assert said in str(error)
                break
        plant.configure(Settings(rate=1000.0, watchdog=5.0, acknowledge=True))
        plant.activate()
        assert plant.read().index >= 0
        plant.deactivate()
        server.wait(20.0)
    first = Recording.load(tmp_path / "session-1")
    assert first.manifest["end"] == "no valid command for 20 ms"
    assert first["input.u1"][-1] == 0.0
    second = Recording.load(tmp_path / "session-2")
    assert (second.manifest["end"], second.manifest["acknowledged"]) == ("bye", "no valid command for 20 ms")
