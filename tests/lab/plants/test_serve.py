"""What a served plant allows, when it trips, and that it stays tripped; faults of the wire and of both processes.

The controller writes the instant at which it computed a command, on the clock that both processes have. So the plant's
own record shows how old each command was when it was written.
"""

import contextlib
import dataclasses
import queue
import signal
import threading
import time
import tracemalloc
from functools import partial

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows.recover import recover
from masking.compile.numerics import safety_tables
from masking.control.rig.twin import Twin
from masking.errors import CommandError, PlantLostError, PlantRefusedError, RecordError
from masking.lab.plants import adapters, wire
from masking.lab.plants.arming import Arming
from masking.lab.plants.authentication import Key
from masking.lab.plants.controller_session import Allowed
from masking.lab.plants.interface import Sample, Settings
from masking.lab.plants.safety_chain import Rules
from masking.lab.plants.serve import Serving
from masking.lab.plants.served_plant_guard import PlantLimits
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.trip_memory import TripMemory
from masking.lab.plants.udp import UdpPlant
from masking.lab.plants.wire import Kind
from masking.lab.records.recording import Recording
from masking.lab.runs import rig_run
from masking.model.declaration import catalogue
from tests.lab.plants.test_wire import LOCKSTEP, NOWHERE, RUN, MassSpring, forged, line, opened, process, served
from tests.lab.runs.test_rig_run import serving
from tests.support.rig_runs import run_rig

pytestmark = pytest.mark.realtime

RATE, WATCHDOG = 1000.0, 0.02
OLDEST = WATCHDOG + 2.0 / RATE  # s, of a command that may be in force


class Dated(MassSpring):
    """A plant whose first command is an instant: it keeps how old the command was when it was written."""

    age = 0.0

    def write(self, index, command):
        self.age = time.monotonic() - command[0] if command[0] else 0.0
        super().write(index, np.zeros(2))
        self.applied = np.array(command) * 1e-9

    def telemetry(self):
        return {"age": self.age}


DATED = "".join(
    [
        "class Dated(MassSpring):\n    age = 0.0\n",
        "    def write(self, index, command):\n",
        "        self.age = time.monotonic() - command[0] if command[0] else 0.0\n",
        "        super().write(index, np.zeros(2))\n",
        "    def telemetry(self):\n        return {'age': self.age}\n",
    ]
)
SERVER = (
    DATED
    + """
def say(address):
    print(address, flush=True)
serve(Dated(), "udp://127.0.0.1:0", Serving(record=sys.argv[1], sessions=1, after_latch=0.1), ready=say)
print("over", flush=True)
"""
)
CONTROLLER = """
import ctypes, faulthandler
from masking.errors import PlantError
def on_tick(row):
    if row == 200:
        print("running", flush=True)
    if row == 300 and sys.argv[2] == "segfault":
        ctypes.string_at(0)
read = UdpPlant.read
def dated(self):
    global seen
    sample = read(self)
    seen = time.monotonic()
    return sample
deactivate, zero = UdpPlant.deactivate, None
def at_zero(self):
    global zero
    zero = zero or time.monotonic()  # the first time: what has left a plant at zero may do so again
    deactivate(self)
UdpPlant.read, UdpPlant.deactivate = dated, at_zero
try:
    run_rig(lambda *_: np.array([time.monotonic(), 0.0]), UdpPlant(sys.argv[1], patience=20.0), Settings(1000.0, 0.02),
            samples=10**6, limits=np.full(2, 1e12), hooks=Hooks(on_tick=on_tick))
except PlantError as error:
    print(f"{zero - seen:.6f} {error}", flush=True)
"""
_WRITTEN = 20.0  # s that the recorder of a process that was killed may take to end


def recovered(session):
    """Recover a session once its recorder has ended."""
    until = time.monotonic() + _WRITTEN
    while True:
        try:
            return recover(session)
        except RecordError as error:
            if "is being recorded" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(0.05)


def test_a_server_whose_record_is_not_wanted_keeps_no_rows(tmp_path):
    """Memory that the process holds grows by nothing like the 64 bytes of each of 2000 ticks."""
    with served(MassSpring(), sessions=2, clock="lockstep", record=None) as (address, _):
        run_rig(lambda *_: np.zeros(2), UdpPlant(address, patience=20.0), **RUN | {"samples": 10})
        tracemalloc.start()
        run_rig(lambda *_: np.zeros(2), UdpPlant(address, patience=20.0), **RUN | {"samples": 2000})
        kept = tracemalloc.take_snapshot().filter_traces([tracemalloc.Filter(True, "*/plants/se*.py")])
        tracemalloc.stop()
    assert sum(one.size for one in kept.statistics("filename")) < 40_000


BUSY = 3  # tries: this machine may be too busy for 1 kHz


def in_two_processes(folder, act, *, fault="none"):
    """Run a controller on a plant, each in its own process, and do something to them once they run.

    Returns:
        the plant's record, and what the controller said last: seconds from its last sample to its end, and the error.
    """
    for attempt in range(BUSY):
        record = folder / str(attempt)
        with process(SERVER, record, 1) as (server, address), process(CONTROLLER, address, fault) as (controller, said):
            if said != "running":
                continue  # the watchdog was first
            act(server, controller)
            answer = controller.stdout.readline().strip()
            controller.wait(20.0)
            if server.poll() is None:
                server.wait(20.0)
        for session in record.glob("session-*"):
            if not (session / "recording.parquet").exists():  # the server was killed
                recovered(session)
            return Recording.load(session), answer
        return None, answer
    pytest.skip("this machine is too busy for 1 kHz")


def judged(folder, act, judge, *, fault="none"):
    """Do something to a controller and a plant in two processes until a judge of how they took it finds no fault.

    At most `BUSY` times: this machine may keep any process waiting for longer than a watchdog.
    """
    for attempt in range(BUSY):
        own, answer = in_two_processes(folder / f"try {attempt}", act, fault=fault)
        try:
            judge(own, answer)
        except AssertionError:
            if attempt == BUSY - 1:
                raise
        else:
            break


def assert_at_zero(own: Recording) -> None:
    """No command was in force for longer than the watchdog and two ticks, and at the end all is zero."""
    latch = own.manifest["latch"]
    assert latch is not None
    row = int(np.flatnonzero(own["tick"] == latch["tick"])[0])
    assert not own.array("input")[row:].any()
    assert own["plant.age"].max() <= OLDEST
    assert own["latched"][row:].all()


def frozen(which):
    def act(server, controller):
        victim = {"controller": controller, "server": server}[which]
        victim.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        victim.send_signal(signal.SIGCONT)

    return act


# --- faults of processes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["controller", "server"])
def test_where_either_side_is_frozen_both_trip_and_nothing_stale_is_used(tmp_path, which):
    def judge(own, answer):
        assert_at_zero(own)
        cause = own.manifest["latch"]["cause"]
        if which == "controller":
            assert cause == "no valid command for 20 ms"
            assert "ended the session: no valid command for 20 ms" in answer
        else:
            assert cause.startswith("the server was held up for ")
            assert "sent no sample for 0.03 s" in answer
            assert float(answer.split()[0]) <= 2.0 * WATCHDOG

    judged(tmp_path, frozen(which), judge)


@pytest.mark.parametrize("fault", ["kill -9", "segfault"])
def test_a_controller_that_dies_leaves_the_plant_at_zero(tmp_path, fault):
    def act(_, controller):
        if fault == "kill -9":
            controller.send_signal(signal.SIGKILL)

    def judge(own, _):
        assert_at_zero(own)
        assert own.manifest["end"] == "no valid command for 20 ms"

    judged(tmp_path, act, judge, fault=fault)


def test_a_plant_that_dies_is_lost_within_two_watchdogs(tmp_path):
    def act(server, _):
        server.send_signal(signal.SIGKILL)
        assert server.wait(20.0) == -signal.SIGKILL

    def judge(own, answer):
        seconds, said = answer.split(" ", 1)
        assert float(seconds) <= 2.0 * WATCHDOG
        assert len(own) >= 200  # all but the row of the tick in which it was killed
        assert own.manifest["recovered"]["missing"] == 0
        assert "latch" not in own.manifest
        assert said.startswith("the plant at udp://127.0.0.1:")
        assert "start it again with 'masking rig serve PLANT'" in said

    judged(tmp_path, act, judge)


def test_a_server_on_a_slow_clock_hears_signals_at_once(tmp_path):
    slow = """
def say(address):
    print(address, flush=True)
serve(MassSpring(), "udp://127.0.0.1:0", Serving(record=sys.argv[1], allowed=Allowed(rates=(1e-3, 10.0))), ready=say)
"""
    with process(slow, tmp_path) as (server, address):
        plant = UdpPlant(address, patience=20.0)
        plant.configure(Settings(rate=0.01))
        plant.activate()
        assert plant.read().index == 0
        time.sleep(0.1)
        began = time.monotonic()
        server.send_signal(signal.SIGTERM)
        with pytest.raises(PlantLostError, match="ended the session: the server was stopped"):
            plant.read()
        assert time.monotonic() - began < 0.5
        assert server.wait(20.0) == 0
        plant.deactivate()


# --- the watchdog on a slow clock -------------------------------------------------------------------------------------


class Timed(MassSpring):
    """A plant that keeps the instant of each command."""

    def __init__(self):
        super().__init__()
        self.written = []

    def write(self, index, command):
        super().write(index, command)
        self.written.append((time.monotonic(), float(command[0])))


def test_the_watchdog_counts_seconds_where_a_tick_is_longer(tmp_path):
    plant, rate = Timed(), 5.0
    with served(plant, record=tmp_path, after_latch=0.4) as (address, folders):
        remote = UdpPlant(address, timeout=2.0, patience=20.0)
        remote.configure(Settings(rate=rate, watchdog=WATCHDOG))
        remote.activate()
        for _ in range(2):
            remote.write(remote.read().index, np.ones(2))
        remote.read()
        began = time.monotonic()
        with pytest.raises(PlantLostError, match="no valid command for 20 ms"):
            while True:
                remote.read()
        remote.deactivate()
    zeros = [at for at, value in plant.written if value == 0.0]
    assert [value for _, value in plant.written][:3] == [1.0, 1.0, 0.0]
    assert zeros[0] - began <= WATCHDOG + 2.0 / rate  # the rule; what follows is that it is within the tick
    assert zeros[0] - began <= 0.5 / rate
    own = Recording.load(folders[0])
    assert sum(own.manifest["timing"]["lateness"]["counts"]) == len(own)
    assert own.manifest["timing"]["lateness"]["max"] == own["late"].max()
    assert own.manifest["latch"] == {"cause": "no valid command for 20 ms", "tick": 2}
    assert own["input.u1"].tolist()[:3] == [1.0, 1.0, 0.0]
    assert np.array_equal(own["tick"], np.arange(len(own)))


def test_the_values_at_expiry_hold_until_the_session_ends(tmp_path):
    """Where the controller is silent; where the server stops, or the session is over, outputs are zero."""
    rules = Rules.of_commands(np.full(2, 2.0), MassSpring.sensors, ("u1", "u2"), 100.0)
    rules.commands[:, safety_tables.EXPIRY] = 0.5, 0.0
    plant, guard = Timed(), PlantLimits(lambda _: rules)
    with served(plant, record=tmp_path, sessions=2, after_latch=0.2, guard=guard) as (address, folders):
        for number, is_silent in ((5, True), (6, False)):
            with line(address) as bare:
                opened(bare, number, Settings(rate=100.0, watchdog=0.1, acknowledge=True))
                index = wire.decode(bare.recv(65535)).index
                bare.send(wire.encode(Kind.COMMAND, number, index, values=np.ones(2)))
                if not is_silent:
                    bare.send(wire.encode(Kind.STOP, number, text="enough"))
                while wire.decode(bare.recv(65535)).kind is not Kind.STOP:
                    pass
                time.sleep(0.5)
    silent, stopped = map(Recording.load, folders)
    latched = silent["latched"] == 1.0
    assert "no valid command for 100 ms" in silent.manifest["latch"]["cause"]
    assert latched.sum() > 2
    assert silent.array("input")[latched][:-1].tolist() == [[0.5, 0.0]] * (latched.sum() - 1)
    assert not silent.array("input")[-1].any()  # of the row after which the plant is deactivated
    assert set(stopped["input.u1"]) <= {0.0, 1.0}
    assert not plant.applied.any()


@pytest.mark.parametrize("kind", [Kind.BYE, Kind.STOP])
def test_a_good_bye_is_heard_within_a_long_tick(tmp_path, kind):
    plant = Timed()
    with (
        served(plant, record=tmp_path, allowed=Allowed(rates=(0.01, 1.0))) as (address, folders),
        line(address) as bare,
    ):
        opened(bare, 5, Settings(rate=0.02))
        bare.recv(65535)
        began = time.monotonic()
        bare.send(wire.encode(kind, 5, text="enough"))
        said = wire.decode(bare.recv(65535))
    assert time.monotonic() - began < 1.0
    stopped = "the controller stopped: enough"
    assert said.text == ("bye" if kind is Kind.BYE else stopped)
    latch = Recording.load(folders[0]).manifest["latch"]
    assert latch == (None if kind is Kind.BYE else {"cause": stopped, "tick": 0})


# --- what a plant allows ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            Settings(1000.0, watchdog=1e6),
            "watchdog is 1e+06 s; this plant allows at most 1 s: ask for less, or serve with",
        ),
        (
            Settings(1e-6),
            "rate is 1e-06 Hz; this plant allows 1 to 100000 Hz: change controller.rate, or serve with other",
        ),
        (Settings(1e6), "rate is 1e+06 Hz; this plant allows 1 to 100000 Hz"),
    ],
)
def test_a_plant_refuses_what_it_does_not_allow_and_says_what_it_does(settings, said):
    with served(MassSpring(), sessions=None, allowed=Allowed()) as (address, _):
        with pytest.raises(PlantRefusedError) as caught:
            UdpPlant(address).configure(settings)
        assert said in str(caught.value)


@pytest.mark.parametrize("text", ["\0" * 60_000, "[" * 60_000, "9" * 60_000, '{"rate": 1e999}', "\U0001f600" * 15_000])
def test_a_hello_that_is_none_is_refused_and_the_server_goes_on(text):
    with served(MassSpring(), clock="lockstep") as (address, _), line(address) as bare:
        bare.send(wire.encode(Kind.HELLO, 4, text=text))
        refused = wire.decode(bare.recv(65535))
        assert refused.kind is Kind.REFUSE
        assert len(refused.text) <= 2000
        opened(bare, 5, LOCKSTEP)
        assert wire.decode(bare.recv(65535)).index == 0
        bare.send(wire.encode(Kind.BYE, 5))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--watchdog", "0"], "the longest watchdog is 0 s; give a positive number of seconds"),
        (["--rates", "10:1"], "rates from 10 to 1 Hz; give a lowest and a highest, both positive"),
        (["--rates", "nan:1"], "rates from nan to 1 Hz; give a lowest and a highest, both positive"),
        (
            ["--address", "udp://0.0.0.0:0"],
            "udp://0.0.0.0:0 is reached from other machines, which may drive the plant: ",
        ),
    ],
)
def test_what_cannot_be_allowed_is_refused_before_anything_is_served(options, said, capsys):
    assert cli.main(["rig", "serve", "ideal", "--sessions", "0", *options]) == 2
    assert said in capsys.readouterr().err


def test_a_range_of_rates_is_written_with_a_colon(capsys):
    with pytest.raises(SystemExit):
        cli.main(["rig", "serve", "ideal", "--rates", "10"])
    assert "argument --rates: invalid" in capsys.readouterr().err


# --- limits -----------------------------------------------------------------------------------------------------------


def test_every_command_is_clamped_on_the_side_of_the_plant(tmp_path):
    run = {"rate": 1000.0, "samples": 50, "limits": np.full(2, 1e300), "lockstep": True}
    guard = PlantLimits(partial(Rules.of_commands, np.array([0.25, 5.0]), MassSpring.sensors, ("u1", "u2")))
    with served(MassSpring(), clock="lockstep", record=tmp_path, guard=guard) as (address, folders):
        run_rig(lambda tick, _: np.array([1e200 * (-1) ** tick, 3.0]), UdpPlant(address, patience=20.0), **run)
    own = Recording.load(folders[0])
    assert own["input.u1"].tolist() == [*([0.25, -0.25] * 25), 0.0]
    assert own["plant.applied.u1"].tolist() == own["input.u1"].tolist()
    assert own["input.u2"].tolist() == [*([3.0] * 50), 0.0]
    assert own.manifest["counters"]["clamped"] == 50


def test_every_command_is_slowed_on_the_side_of_the_plant(tmp_path):
    run = {"rate": 1000.0, "samples": 50, "limits": np.full(2, 1e300), "lockstep": True}
    rules = Rules.of_commands(np.array([0.25, 5.0]), MassSpring.sensors, ("u1", "u2"), 1000.0)
    rules.commands[:, safety_tables.RATE] = 50.0, np.inf
    with served(MassSpring(), clock="lockstep", record=tmp_path, guard=PlantLimits(lambda _: rules)) as (
        address,
        folders,
    ):
        run_rig(lambda tick, _: np.full(2, 9.0 * (-1) ** (tick // 20)), UdpPlant(address, patience=20.0), **run)
    own = Recording.load(folders[0])
    assert np.abs(np.diff(own["plant.applied.u1"][:-1], prepend=0.0)).max() == pytest.approx(0.05)
    assert own["plant.applied.u1"][[19, 39, 49]].tolist() == [0.25, -0.25, pytest.approx(0.25)]
    assert own["input.u2"][[0, 20]].tolist() == [5.0, -5.0]


def test_the_limits_are_those_of_the_plant_file_in_the_units_of_its_commands(tmp_path):
    weak = tmp_path / "weak.yaml"
    text = catalogue.find("plant", "tue_rig").read_text(encoding="utf-8")
    weak.write_text(text.replace("{max: 0.42, unit: V}", "{max: 20, unit: mV}", 1), encoding="utf-8")
    for plant, largest in ((weak, [0.02, 0.42, 0.42]), ("ideal", [0.42, 0.42, 0.42])):
        served, command = SimulatedPlant(Twin.load(plant)), np.full(3, 9.0)
        served.configure(LOCKSTEP)
        guard = rig_run._guard(Twin.load(plant))
        guard.begin(served, LOCKSTEP)
        assert guard.check(Sample(0, np.zeros(3)), command) == ""
        assert command.tolist() == pytest.approx(largest, rel=1e-14)
        assert guard.counters == {"clamped": 1}


def test_limits_of_another_plant_are_refused():
    guard = PlantLimits(partial(Rules.of_commands, np.ones(1), ("x1",), ("V1",)))
    with (
        served(MassSpring(), sessions=None, guard=guard) as (address, _),
        pytest.raises(
            PlantRefusedError,
            match="the limits are those of a plant with the actuator V1, which this one does not have; did you mean",
        ),
    ):
        UdpPlant(address).configure(Settings(1000.0))


def test_a_twin_stops_where_a_sensor_shows_its_limit(tmp_path):
    """The rig is driven with all that its actuators give, at their sign of the velocity, until the server stops it."""
    is_over, found, folders = threading.Event(), [], []
    kept, asked = Serving("lockstep", tmp_path, sessions=1), {"ready": found.append, "stop": is_over.is_set}
    thread = threading.Thread(target=lambda: folders.extend(rig_run.serve("ideal", NOWHERE, kept, **asked)))
    thread.start()
    try:
        while not found:
            assert thread.is_alive()
            time.sleep(0.01)
        before = np.zeros(3)

        def driven(_, values):
            nonlocal before
            command, before = np.sign(values - before + 1e-12), values
            return command

        with pytest.raises(
            PlantLostError, match=r"tick \d+: POSITION_LIMIT: x[12] - x3 is -?5(\.\d+)? mm, beyond its limit of 5 mm"
        ):
            run_rig(driven, UdpPlant(found[0], patience=60.0), **{**RUN, "samples": 20000, "limits": np.full(3, 9.0)})
    finally:
        is_over.set()
        thread.join(60.0)
    own = Recording.load(folders[0])
    assert np.abs(own.array("input")).max() == 0.42
    for name in ("1", "2"):
        moved = own[f"plant.x{name}"] - own["plant.x3"]
        speed = np.abs(np.diff(moved)).max()  # m in a tick
        assert np.abs(moved).max() <= 5e-3 + 2.0 * speed
    assert not own.array("input")[-1].any()


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_noise_at_a_limit_is_no_motion_beyond_it(tmp_path, noise):
    """A sensor of 0.2 V/mm at 5 mm reads 1 V; eight standard deviations of its noise are no motion."""
    (tmp_path / "plant.yaml").write_text(f"""
name: limited
model: cart
sensors:
  s: {{measures: x, gain: {{value: 0.2, unit: V/mm}}, unit: V}}
limits: {{inputs: {{u: {{max: 1, unit: A}}}}, coordinates: {{x: {{max: 5, unit: mm}}}}}}
effects: {{noise: {{effect: noise, at: s, parameters: {{sigma: {noise}}}}}}}
""")
    twin = Twin.load(tmp_path / "plant.yaml")
    for reading, is_beyond in ((1.0 + 7.9 * noise - 1e-9, False), (1.0 + 8.1 * noise + 1e-9, True)):
        guard = rig_run._guard(twin)
        plant = SimulatedPlant(twin)
        plant.configure(LOCKSTEP)
        guard.begin(plant, LOCKSTEP)
        for sign in (1.0, -1.0):
            found = guard.check(Sample(0, np.array([sign * reading])), np.zeros(1))
            assert found.startswith("tick 0: POSITION_LIMIT: x is ") if is_beyond else found == ""


@pytest.mark.parametrize(
    ("reading", "cause"), [(np.nan, "SENSOR_NONFINITE"), (np.inf, "SENSOR_NONFINITE"), (5.1, "POSITION_LIMIT")]
)
def test_a_reading_that_shows_no_place_within_the_limit_trips(reading, cause):
    rules = Rules.of_commands(np.ones(1), ("x2",), ("u2",), 1000.0)
    limit = np.zeros((1, 4))
    limit[0, 0] = 5.0
    rules = dataclasses.replace(rules, limited=("x",), limits=limit, weights=np.ones((1, 1)))
    guard = PlantLimits(lambda _: rules)
    plant = MassSpring()
    guard.begin(plant, LOCKSTEP)
    assert guard.check(Sample(0, np.array([99.0, 5.0])), np.zeros(2)) == ""  # the first is not limited
    assert guard.check(Sample(1, np.array([0.0, reading])), np.zeros(2)).startswith(f"tick 1: {cause}: ")


def test_the_plant_limits_speed_and_mean_power_whoever_drives_it(tmp_path):
    text = catalogue.find("plant", "tue_rig").read_text(encoding="utf-8").replace("max: 0.42", "max: 0.6")
    velocities = "limits:\n  velocities: {x1 - x3: {max: 100, unit: mm/s}}"
    (tmp_path / "slow.yaml").write_text(text.replace("limits:", velocities, 1))
    twin = Twin.load(tmp_path / "slow.yaml")
    gain = 200.0  # V/m
    plant = SimulatedPlant(twin)
    plant.configure(LOCKSTEP)
    for speed, cause in ((0.09, ""), (0.11, "VELOCITY_LIMIT: the rate of x1 - x3 is ")):  # m/s
        guard = rig_run._guard(twin)
        guard.begin(plant, LOCKSTEP)
        found = [
            guard.check(Sample(k, gain * np.array([speed * k / 1000.0, 0.0, 0.0])), np.zeros(3)) for k in range(30)
        ]
        assert cause in found[-1] if cause else not any(found)
    guard.begin(plant, LOCKSTEP)
    spent, found = 0.0, ""
    for k in range(12_000):
        command = np.array([0.6, 0.0, 0.0])
        found = guard.check(Sample(k, np.zeros(3)), command)
        if found:
            break
        spent += 45.35 * command[0] ** 2 / 1000.0  # J, of 16.3 W while it may
    assert ": THERMAL: " in found
    assert 0.9 * 80.0 < spent <= 1.02 * 80.0  # of 8 W over 10 s


class Careful:
    """A guard that trips where the first reading passes a value."""

    def __init__(self, most):
        self.most, self.counters = most, {}

    def begin(self, plant, settings):
        pass

    def expire(self, command):
        command[:] = 0.0

    def check(self, sample, command):
        return "x1 is beyond its limit" if abs(sample.values[0]) > self.most else ""


def test_a_guard_stops_the_plant_before_the_command_is_written(tmp_path):
    plant = Timed()
    with served(plant, clock="lockstep", sessions=2, record=tmp_path, guard=Careful(0.9e-3)) as (address, folders):
        # The first mass begins at 1 mm, so that the fault is there from the first sample on, also after the trip.
        for acknowledge in (False, True):
            remote = UdpPlant(address, patience=20.0)
            with pytest.raises(PlantLostError, match="ended the session: x1 is beyond its limit"):
                run_rig(
                    lambda *_: np.ones(2),
                    remote,
                    rate=1000.0,
                    samples=100,
                    limits=np.full(2, 5.0),
                    lockstep=True,
                    acknowledge=acknowledge,
                )
    assert not any(value for _, value in plant.written)
    assert [Recording.load(folder).manifest["latch"]["tick"] for folder in folders] == [0, 0]


# --- a trip stays until it is acknowledged ----------------------------------------------------------------------------


class Failing(MassSpring):
    def write(self, index, command):
        if index == 3:
            raise ZeroDivisionError("of a driver")
        super().write(index, command)


@pytest.mark.parametrize(
    ("plant", "cause"),
    [
        (Failing, "the plant failed: ZeroDivisionError: of a driver"),
        (MassSpring, "no command for 0.1 s in lockstep"),
    ],
)
def test_a_plant_that_has_tripped_refuses_until_the_cause_is_acknowledged(tmp_path, plant, cause):
    with served(plant(), clock="lockstep", sessions=2, record=tmp_path, patience=0.1) as (address, folders):
        remote = UdpPlant(address, patience=20.0)
        remote.configure(LOCKSTEP)
        remote.activate()
        with pytest.raises(PlantLostError, match=cause):
            for _ in range(10):
                remote.write(remote.read().index, np.zeros(2))
                if plant is MassSpring:
                    time.sleep(0.3)
        remote.deactivate()
        for _ in range(2):  # and stays so
            with pytest.raises(PlantRefusedError) as caught:
                remote.configure(LOCKSTEP)
            assert f"it has tripped: {cause}; look at the rig, then start once with --acknowledge" in str(caught.value)
        remote.configure(Settings(1000.0, lockstep=True, acknowledge=True))
        remote.activate()
        remote.read()
        remote.deactivate()
    assert Recording.load(folders[1]).manifest["acknowledged"] == cause


@pytest.mark.parametrize(
    ("step", "limits", "cause"),
    [
        (lambda *_: np.full(2, np.nan), np.ones(2), r"tick 0: CONTROLLER_NONFINITE: the controller's command for u2"),
        (lambda *_: 1 / 0, np.ones(2), "tick 0: CONTROLLER_EXCEPTION: the controller raised an error"),
        (lambda *_: np.zeros(3), np.ones(2), "tick 0: CONTROLLER_NONFINITE: "),
    ],
)
def test_a_run_that_trips_latches_its_plant(tmp_path, step, limits, cause):
    with served(MassSpring(), clock="lockstep", sessions=2, record=tmp_path) as (address, folders):
        remote = UdpPlant(address, patience=20.0)
        run = {"rate": 1000.0, "samples": 5, "limits": limits, "lockstep": True}
        with contextlib.suppress(CommandError, ZeroDivisionError):
            run_rig(step, remote, **run)
        with pytest.raises(PlantRefusedError, match=f"it has tripped: the controller stopped: {cause}"):
            run_rig(lambda *_: np.zeros(2), remote, **run)
        assert run_rig(lambda *_: np.zeros(2), remote, **run, acknowledge=True).reason == "finished"
    first, second = (Recording.load(folder).manifest for folder in folders)
    assert second["acknowledged"] == first["latch"]["cause"] == first["end"]


def test_a_good_bye_is_no_trip():
    with served(MassSpring(), clock="lockstep", sessions=3) as (address, _):
        for _ in range(3):
            remote = UdpPlant(address, patience=20.0)
            remote.configure(LOCKSTEP)
            remote.activate()
            remote.read()
            remote.deactivate()


def test_a_session_that_is_over_is_not_opened_again():
    with served(MassSpring(), clock="lockstep", sessions=2) as (address, _), line(address) as bare:
        opened(bare, 5, LOCKSTEP)
        bare.recv(65535)
        bare.send(wire.encode(Kind.BYE, 5))
        assert wire.decode(bare.recv(65535)).kind is Kind.STOP
        bare.send(wire.encode(Kind.HELLO, 5, text=wire.settings_text(LOCKSTEP)))
        refused = wire.decode(bare.recv(65535))
        assert (refused.kind, refused.text) == (Kind.REFUSE, "this session is over; open a new one")
        opened(bare, 6, LOCKSTEP)
        bare.recv(65535)
        bare.send(wire.encode(Kind.BYE, 6))


def test_key_and_acknowledgement_on_the_command_line(tmp_path, capsys):
    key = tmp_path / "rig.key"
    key.write_bytes(b"0123456789abcdef")
    key.chmod(0o600)
    with serving("ideal", "--key", key, "--sessions", 1000, "--watchdog", 1) as (server, address):
        remote = UdpPlant(address, patience=20.0, key=Key.read(key))
        remote.configure(Settings(1000.0))
        remote.activate()
        remote.write(remote.read().index, np.zeros(3))
        with pytest.raises(PlantLostError):
            while True:
                remote.read()
        remote.deactivate()
        assert cli.main(["rig", "check", address]) == 1
        assert "its key is another one, or none was given; give the server's by --key FILE" in capsys.readouterr().err
        assert cli.main(["rig", "check", address, "--key", str(key)]) == 1
        assert "it has tripped: no valid command for 20 ms; look at the rig, then start once" in capsys.readouterr().err
        assert cli.main(["rig", "check", address, "--key", str(key), "--acknowledge"]) == 0
        assert capsys.readouterr().out.endswith(f"{address} conforms\n")
        assert cli.main(["rig", "check", address, "--key", str(key)]) == 0
        server.send_signal(signal.SIGTERM)


class Asked(MassSpring):
    def configure(self, settings):
        raise PlantRefusedError(f"acknowledge is {settings.acknowledge}")


@pytest.mark.parametrize("options", [[], ["--acknowledge"]])
def test_a_run_acknowledges_where_it_is_asked_to(tmp_path, options, monkeypatch, capsys):
    monkeypatch.setattr(adapters, "connect", lambda address, key: Asked())
    assert cli.main(["rig", "run", "huygens_rig", "--plant", "x:y", "--out", str(tmp_path / "out"), *options]) == 1
    assert capsys.readouterr().err == f"masking: acknowledge is {bool(options)}\n"


# --- samples that do not arrive ---------------------------------------------------------------------------------------


def sample(session, index):
    return wire.encode(Kind.SENSORS, session, index % 2**64, values=np.full(2, float(index % 1000)))


def indices(given, **options):
    """Return the indices that a controller reads of a plant that sends given ones, one at a time, and how it ended."""
    found = []
    with forged(lambda session: [sample(session, index) for index in given[:1]]) as (address, thread):
        plant = UdpPlant(address, timeout=0.3, **options)
        plant.configure(Settings(rate=1000.0, lockstep=True))  # which takes one sample at a time
        plant.activate()
        thread.join(20.0)
        found.append(plant.read().index)
        end = ""
        for index in given[1:]:
            plant._first = wire.decode(sample(plant._session, index))
            try:
                found.append(plant.read().index)
            except PlantLostError as error:
                end = str(error)
                break
        counters = dict(plant.counters)
        plant.deactivate()
    return found, end, counters


@pytest.mark.parametrize("lost", [0, 1, 4])
def test_a_few_samples_may_be_lost(lost):
    found, end, counters = indices([7, 8, 9 + lost, 10 + lost])
    assert (found, end) == ([7, 8, 9 + lost, 10 + lost], "")
    assert counters.get("lost", 0) == lost


@pytest.mark.parametrize("lost", [5, 20, 10**9, 2**61])
def test_many_lost_samples_or_an_index_that_jumps_lose_the_plant(lost):
    found, end, counters = indices([7, 8, 9 + lost])
    assert found == [7, 8]
    assert f"went from sample 8 to {9 + lost}: {lost} in a row are lost, more than 4" in end
    assert counters["lost"] == lost


@pytest.mark.parametrize("index", [-1, -(10**9), 2**62])
def test_an_index_that_no_sample_has_loses_the_plant(index):
    found, end, _ = indices([7, 8, index])
    assert found == [7, 8]
    assert f"has sample {index % 2**64}, which is no number of a sample" in end


def test_a_new_server_of_a_plant_at_an_address_knows_the_last_trip(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for _ in range(2):
        trips = TripMemory("bench:7")  # of a server of its own
        with served(MassSpring(), sessions=None, clock="lockstep", trips=trips) as (address, _):
            if trips.cause:
                with pytest.raises(PlantRefusedError, match=r"it has tripped: the controller stopped: .*NONFINITE"):
                    UdpPlant(address, patience=20.0).configure(LOCKSTEP)
                acknowledged = UdpPlant(address, patience=20.0)
                acknowledged.configure(dataclasses.replace(LOCKSTEP, acknowledge=True))
                acknowledged.activate()
                acknowledged.read()
                acknowledged.deactivate()
            else:
                run_rig(lambda *_: np.full(2, np.nan), UdpPlant(address, patience=20.0), **RUN)
    assert TripMemory("bench:7").cause == ""
    assert TripMemory("bench:8").cause == ""


def test_a_server_that_is_killed_while_a_plant_is_driven_is_a_trip(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    code = (
        "import os; os.environ['XDG_STATE_HOME'] = sys.argv[1]\n"
        "from masking.lab.plants.trip_memory import TripMemory\n"
        "def say(address):\n    print(address, flush=True)\n"
        "serve(MassSpring(), 'udp://127.0.0.1:0', Serving(trips=TripMemory('bench:7')), ready=say)\n"
    )
    with process(code, tmp_path / "state") as (server, address):
        plant = UdpPlant(address, patience=20.0)
        plant.configure(Settings(100.0, 1.0))
        plant.activate()
        plant.read()
        server.kill()
        server.wait(20.0)
        plant.deactivate()
    assert TripMemory("bench:7").cause == "its server was killed while a controller drove it"


def test_a_plant_is_driven_only_while_its_operator_has_armed_it():
    lines = queue.SimpleQueue()
    arming = Arming(iter(lines.get, None))

    def typed(line, *, is_armed):
        lines.put(line)
        until = time.monotonic() + 20.0
        while arming.is_armed != is_armed:
            assert time.monotonic() < until
            time.sleep(0.001)

    def refused(address):
        with pytest.raises(
            PlantRefusedError, match="it is not armed: the operator arms it by the word 'arm' and Enter"
        ):
            UdpPlant(address, patience=20.0).configure(LOCKSTEP)

    with served(MassSpring(), sessions=None, clock="lockstep", arming=arming) as (address, _):
        refused(address)
        typed("arm\n", is_armed=True)
        for _ in range(2):  # it stays armed from one session that ends in order to the next
            run_rig(lambda *_: np.zeros(2), UdpPlant(address, patience=20.0), **RUN | {"samples": 10})
        typed("\n", is_armed=False)
        refused(address)
        typed("arm\n", is_armed=True)
        run_rig(lambda *_: np.full(2, np.nan), UdpPlant(address, patience=20.0), **RUN)
        refused(address)  # a trip disarms it
        lines.put(None)
    assert not arming.wait()  # nobody can arm it any more
