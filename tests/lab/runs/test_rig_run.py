"""An experiment on a rig that runs by itself: in lockstep, in real time, and on the way out.

The twins are the packaged ones, the controller is the real one, at 1 kHz. What the rig did is told by the plant's own
record, and what it should have done by scipy.
"""

import fcntl
import json
import os
import signal
import socket
import tempfile
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from masking.app import cli
from masking.app.workflows.recover import recover
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, ModelError, PlantLostError, PlantMismatchError, PlantRefusedError, RecordError
from masking.lab.plants import wire
from masking.lab.plants.interface import Settings
from masking.lab.plants.serve import Serving
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.udp import UdpPlant
from masking.lab.plants.wire import Kind
from masking.lab.records.recording import Recording
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue, registry
from tests.control.test_sampled_controller import LENGTH, OMEGA, ideal, relative
from tests.support.forked import Forked

RATE = 1000.0
WATCHDOG = 20  # ms
LIMIT = 0.42  # V
NOWHERE = "udp://127.0.0.1:0"
COMMANDED = ("sensor", "input", "demanded", "power")
DUFFING = {
    "name": "duffing on a rig",
    "virtual": "duffing",
    "controller": {"rate": "1 kHz", "observer": "disturbance", "homing": 2},
    "initial": {"x1": -0.6, "x2": -0.5},
    "duration": 55,
}
PLANTS = {"tue_rig": {"model": "setup_springs"}, "linear_rig": {}}
both = pytest.mark.parametrize("plant", PLANTS)


def written(folder: Path, plant: str = "linear_rig", *, controller=None, **changes) -> Path:
    """Write an experiment; None takes a setting of the controller out."""
    settings = {**DUFFING["controller"], **PLANTS.get(plant, {}), **(controller or {})}
    settings = {name: value for name, value in settings.items() if value is not None}
    path = folder / "experiment.yaml"
    path.write_text(json.dumps({**DUFFING, "plant": plant, "controller": settings, **changes}), encoding="utf-8")
    return path


@cache
def compiled(plant: str) -> None:
    """Compile all that a run on a plant needs, once for all processes of these tests."""
    cached = Path(os.environ["MASKING_CACHE"])
    cached.mkdir(parents=True, exist_ok=True)
    with (cached / f"{plant}.lock").open("w") as lock, tempfile.TemporaryDirectory() as folder:
        fcntl.flock(lock, fcntl.LOCK_EX)
        experiment = Experiment.load(written(Path(folder), plant, duration=0.1))
        experiment.run()
        rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))


@pytest.fixture(scope="module")
def offline(tmp_path_factory):
    """Return a function that gives an experiment's file, the experiment, and what it does offline."""

    @cache
    def found(plant, seed=0):
        compiled(plant)
        path = written(tmp_path_factory.mktemp(plant), plant, seed=seed)
        experiment = Experiment.load(path)
        return path, experiment, experiment.run()

    return found


def before(experiment: Experiment) -> int:
    """Return the samples before the release: the homing, and those that the first command is late."""
    return round(experiment.declaration.controller.homing * RATE) + 1


# --- processes --------------------------------------------------------------------------------------------------------


@contextmanager
def serving(plant: str | Path, *options: object):
    """Serve a twin in a process of its own; give it and its address."""
    with Forked(["rig", "serve", plant, "--address", NOWHERE, "--sessions", 1, *options]) as started:
        try:
            said = started.stderr.readline()
            assert " is served at " in said, said + started.stderr.read()
            yield started, said.split()[-1]
            started.wait(20.0)
        finally:
            started.kill()


@contextmanager
def controlling(experiment: Path, address: str, out: Path):
    """Run an experiment on a plant in a process of its own, and give that, once it holds the plant."""
    with Forked(["rig", "run", experiment, "--plant", address, "--out", out, "--json"]) as started:
        try:
            wait_until_held(address, started)
            yield started
        finally:
            started.kill()


def wait_until_held(address: str, controller: Forked) -> None:
    """Wait until a plant refuses others because it has a controller; a hello without settings is refused anyway."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.connect(wire.parse_address(address))
        line.settimeout(5.0)
        text = ""
        while "has this plant" not in text:
            assert controller.poll() is None, controller.stderr.read()
            time.sleep(0.01)
            line.send(wire.encode(Kind.HELLO, 1, text="{}"))
            text = wire.decode(line.recv(65535)).text


def ended(controller: Forked) -> tuple[int, str, str]:
    """Wait for a process; return its status and what it printed."""
    out, err = controller.communicate(timeout=30.0)
    return controller.returncode, out, err


# --- in lockstep ------------------------------------------------------------------------------------------------------


def assert_equal(found, expected, what):
    """Equal to 1e-9 of the size of what is expected."""
    assert len(found) == len(expected), what
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max(), what


def assert_same_run(found: Recording, expected: Recording) -> None:
    for name in expected.columns:
        if name == "t" or name.split(".")[0] in (*COMMANDED, "ideal"):
            assert_equal(found[name], expected[name], name)


@both
def test_step_by_step_in_this_process_is_the_run_offline(offline, plant):
    _, experiment, expected = offline(plant)
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    assert_same_run(found, expected)
    assert (found.manifest["mode"], found.manifest["states"]) == ("lockstep", "estimated")
    assert found.manifest["rig"]["end"] == "finished"
    assert found.manifest["rig"]["counters"] == {"late": 0, "missed": 0, "clamped": 0}
    # What the controller knows of the rig is not what the rig does, but near it.
    assert 1e-5 < relative(found.array("rig"), expected.array("rig")) < 0.01


@both
def test_in_lockstep_with_a_twin_in_its_own_process_is_the_run_offline(offline, plant, tmp_path):
    _, experiment, expected = offline(plant)
    with serving(plant, "--lockstep", "--record", tmp_path) as (_, address):
        found = rig_run.run(experiment, UdpPlant(address), rig_run.RunSettings(lockstep=True))
    assert_same_run(found, expected)
    own, first = Recording.load(tmp_path / "session-1"), before(experiment)
    rows = slice(first, first + len(expected))
    for name in expected.inputs:
        assert_equal(own[f"input.{name}"][rows], expected[f"input.{name}"], name)
        # A command acts a sample after it was given.
        assert np.array_equal(own[f"plant.applied.{name}"][1:-1], own[f"input.{name}"][:-2])
    for name in expected.names("sensor"):
        assert_equal(own[f"sensor.{name}"][rows], expected[f"sensor.{name}"], name)
    # The telemetry of a row is the state at its end.
    for name in (*experiment.plant.coordinates, *(f"{c}'" for c in experiment.plant.coordinates)):
        assert_equal(own[f"plant.{name}"][first - 1 :][: len(expected)], expected[f"rig.{name}"], name)
    assert (own.manifest["end"], own.manifest["latch"]) == ("bye", None)


def test_rows_are_as_far_apart_as_the_experiment_asks(offline, tmp_path):
    experiment = Experiment.load(written(tmp_path, record={"rate": "100 Hz"}, duration=10))
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    _, _, expected = offline("linear_rig")
    assert np.diff(found.t) == pytest.approx(0.01)
    for name in found.inputs:
        assert_equal(found[f"input.{name}"], expected[f"input.{name}"][: 10 * len(found) : 10], name)


def test_a_twin_is_compiled_before_it_can_be_reached(tmp_path, monkeypatch):
    monkeypatch.setenv("MASKING_CACHE", str(tmp_path))
    made = []
    rig_run.serve("ideal", NOWHERE, Serving(sessions=0), ready=lambda _: made.extend(tmp_path.rglob("*")))
    declaration = registry.load_plant("ideal")
    plant = SimulatedPlant(Twin(declaration, registry.load_model(declaration.model)))
    plant.configure(Settings(RATE))
    assert made
    assert set(tmp_path.rglob("*")) == set(made)


# --- commands and samples that do not arrive --------------------------------------------------------------------------


class Disturbed:
    """A twin whose clock goes on when its controller does not follow: the same ticks are missed each time.

    Args:
        twin: the rig.
        stalls: ticks that are missed after a tick.
        late: ticks whose command arrives a tick too late, after the next.
        dies: tick at which the plant is lost.
    """

    owns_clock = True

    def __init__(self, twin, *, stalls=None, late=(), dies=None):
        self.plant, self.stalls, self.late, self.dies = SimulatedPlant(twin), stalls or {}, {*late}, dies
        self.sensors, self.actuators = self.plant.sensors, self.plant.actuators
        self.coordinates, self.positions = twin.model.coordinates, []

    def configure(self, settings):
        self.plant.configure(settings)

    def activate(self):
        self.plant.activate()
        self.held = np.zeros(len(self.actuators))

    def read(self):
        sample = self.sample()
        for _ in range(self.stalls.get(sample.index, 0)):
            self.plant.write(sample.index, self.held)
            sample = self.sample()
        if sample.index == self.dies:
            raise PlantLostError("the cable is off; plug it in")
        return sample

    def sample(self):
        sample, told = self.plant.read(), self.plant.telemetry()
        self.positions.append([told[name] for name in self.coordinates])
        return sample

    def write(self, index, command):
        self.plant.write(index, self.held if index in self.late else command)
        self.held = np.array(command)

    def deactivate(self):
        self.plant.deactivate()


def chi(positions, first: int) -> float:
    """Return the relative error of a rig's motion (m, 3) from the release on, against scipy's Duffing oscillators."""
    moved = np.asarray(positions)[first:] / LENGTH
    return relative(moved, ideal(np.arange(len(moved)) * OMEGA / RATE))


def disturbed(experiment: Experiment, **faults) -> tuple[float, Recording]:
    plant = Disturbed(experiment.twin, **faults)
    found = rig_run.run(experiment, plant, rig_run.RunSettings(lockstep=True))
    return chi(plant.positions, before(experiment)), found


TICKS = np.random.default_rng(1).choice(np.arange(100, 4900), 50, replace=False).tolist()  # 1 % of a run


@both
def test_commands_that_arrive_a_tick_late_cost_nothing(offline, plant):
    _, experiment, _ = offline(plant)
    undisturbed, _ = disturbed(experiment)
    found, _ = disturbed(experiment, late=TICKS)
    assert found < 1.1 * undisturbed + 1e-4, (found, undisturbed)


@pytest.mark.parametrize(
    "stalls",
    [dict.fromkeys(TICKS, 1), {3500: 9}, dict.fromkeys(range(2200, 4800, 500), 15)],
    ids=["1 % singly", "9 in a row", "6 times 15 in a row"],
)
def test_the_observer_makes_up_for_missed_samples(offline, stalls):
    _, experiment, _ = offline("linear_rig")
    undisturbed, _ = disturbed(experiment)
    found, _ = disturbed(experiment, stalls=stalls)
    assert found < 2.0 * undisturbed + 1e-3, (found, undisturbed)


def test_missed_samples_leave_gaps_and_the_run_ends_on_time(offline):
    _, experiment, expected = offline("linear_rig")
    first = before(experiment)
    _, found = disturbed(experiment, stalls={500: 3, first + 99: 7, first + len(expected) - 3: 5})
    counters = found.manifest["rig"]["counters"]
    assert (counters["late"], counters["missed"]) == (3, 15)
    assert found.manifest["rig"]["end"] == "finished"
    kept = np.round(found.t * RATE).astype(int).tolist()
    assert kept == [k for k in range(len(expected) - 3) if not 99 <= k < 106]


def test_what_there_is_since_the_release_is_kept_when_the_plant_is_lost(offline):
    _, experiment, expected = offline("linear_rig")
    kept, first = [], before(experiment)
    with pytest.raises(PlantLostError, match="the cable is off; plug it in"):
        rig_run.run(
            experiment,
            Disturbed(experiment.twin, dies=first + 700),
            rig_run.RunSettings(lockstep=True, keep=kept.append),
        )
    with pytest.raises(PlantLostError, match="the cable is off; plug it in"):
        rig_run.run(
            experiment, Disturbed(experiment.twin, dies=first), rig_run.RunSettings(lockstep=True, keep=kept.append)
        )
    assert len(kept) == 1  # in the second there is nothing
    assert kept[0].manifest["rig"]["end"] == "plant lost"
    for name in ("sensor.s1", "input.V1"):
        assert_equal(kept[0][name], expected[name][:700], name)


def test_a_run_that_is_stopped_in_the_homing_says_that_nothing_was_recorded(offline):
    _, experiment, _ = offline("linear_rig")
    plant = Disturbed(experiment.twin)
    said = "the run was stopped during homing, before the release; nothing was recorded"
    with pytest.raises(MaskingError, match=said) as caught:
        rig_run.run(experiment, plant, rig_run.RunSettings(lockstep=True, stop=lambda: len(plant.positions) == 100))
    assert caught.value.exit_status == 1
    assert not any(plant.plant.telemetry()[f"applied.{name}"] for name in plant.actuators)


# --- in real time -----------------------------------------------------------------------------------------------------


class Canary(threading.Thread):
    """Sleeps from millisecond to millisecond beside a run, and counts those that this machine lets pass."""

    def __init__(self):
        super().__init__()
        self.is_over = threading.Event()
        self.missed = self.ticks = 0

    def run(self):
        due = time.monotonic()
        while not self.is_over.is_set():
            due += 1.0 / RATE
            time.sleep(max(0.0, due - time.monotonic()))
            passed = int((time.monotonic() - due) * RATE)
            self.ticks, self.missed, due = self.ticks + 1 + passed, self.missed + passed, due + passed / RATE

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.is_over.set()
        self.join()


def unanswered(own: Recording) -> np.ndarray:
    """Return the lengths of the gaps in which no command came to a plant, between the first command and the last."""
    came = np.flatnonzero(own["fresh"])
    gaps = np.diff(came) - 1
    return gaps[gaps > 0]


def in_real_time(experiment: Path, plant: str, folder: Path):
    """Run an experiment on a twin, each in its own process.

    Returns:
        whether the run is sound: it ended well, and 99 % of the ticks had their command; whether this machine was too
        busy; all that was counted, in words; the plant's own record.
    """
    options = ("--record", folder / "own", "--seed", 3)
    with (
        Canary() as canary,
        serving(plant, *options) as (_, address),
        controlling(experiment, address, folder / "out") as controller,
    ):
        status, _, err = ended(controller)
    own = Recording.load(folder / "own" / "session-1")
    gaps = unanswered(own)
    told = (
        f"status {status}{': ' if err else ''}{err.strip()}; plant: {len(own)} ticks, {gaps.sum():g} without a command "
        f"in {len(gaps)} gaps, at most {gaps.max(initial=0)}, {own.manifest['counters']}, ended by "
        f"'{own.manifest['end']}'; this machine let {canary.missed} of {canary.ticks} ms pass"
    )
    is_sound = status == 0 and gaps.sum() <= 0.01 * len(own)
    return is_sound, canary.missed > 0.01 * canary.ticks, told, own


def offset(found: Recording, own: Recording, first: int) -> int:
    """Return the tick of the plant at the release, where it showed what the controller saw."""
    rows, seen, shown = np.round(found.t * RATE).astype(int), found.array("sensor"), own.array("sensor")
    for tick in range(first, first + 100):
        if tick + rows[-1] < len(shown) and np.array_equal(shown[tick + rows], seen):
            return tick
    raise AssertionError("the controller recorded readings that the plant did not show")


@pytest.mark.realtime
@pytest.mark.parametrize("plant", ["tue_rig", pytest.param("linear_rig", marks=pytest.mark.search)])
def test_in_real_time_the_rig_moves_as_offline_within_the_noise(offline, plant, tmp_path):
    path, experiment, expected = offline(plant)
    others = [offline(plant, seed)[2] for seed in (1, 2)]
    tries = []
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        is_sound, is_slow, told, own = in_real_time(path, plant, folder)
        tries.append(told)
        if is_sound:
            break
    else:
        assert is_slow, tries
        pytest.skip(f"this machine is too busy for 1 kHz: {tries}")
    found = Recording.load(folder / "out")
    release = offset(found, own, before(experiment))
    assert found.manifest["rig"]["end"] == "finished", told
    assert found.manifest["mode"] == "real time"
    assert np.abs(own.array("input")).max() <= LIMIT

    # What the rig did is in the plant's own record, whose telemetry is that of the end of each tick.
    names = experiment.plant.coordinates
    moved = np.column_stack([own[f"plant.{name}"] for name in names])[release - 1 :][: len(expected)]
    offline_motions = [motion.array("rig") for motion in (expected, *others)]
    # A command that is held n samples too long misses the wanted velocity by (w n h)^2 / 2 of it: the acceleration
    # grows with w t meanwhile. 20 rad/s is above the frequency of the Duffing oscillators at these amplitudes.
    missed = float(np.sum((20.0 * unanswered(own) / RATE) ** 2) / 2.0)
    error, error_offline = chi(moved, 0), max(chi(motion, 0) for motion in offline_motions)
    assert error <= 2.0 * error_offline + missed, (error, error_offline, missed, told)
    apart = relative(moved, offline_motions[0])
    apart_by_noise = max(relative(motion, offline_motions[0]) for motion in offline_motions[1:])
    assert apart <= 3.0 * apart_by_noise + missed, (apart, apart_by_noise, missed, told)
    # The controller's estimates are as near to the truth as those of a run without a clock.
    rows = np.round(found.t * RATE).astype(int)
    assert relative(found.array("rig"), moved[rows]) < 0.01, told


# --- the way out ------------------------------------------------------------------------------------------------------


@dataclass
class Cut:
    """A run in real time that was cut short.

    Args:
        status: of the controller's process, and what it printed.
        out: to standard output.
        err: to standard error.
        passed: seconds from when the controller held the plant to the signal.
        own: the plant's own record.
        told: what the server said.
        saved: folder in which the controller saves.
    """

    status: int
    out: str
    err: str
    passed: float
    own: Recording
    told: str
    saved: Path


def cut_short(folder: Path, seconds: float, number: int) -> Cut:
    """Run an experiment with a homing of a second, and send its process a signal after some time.

    Where this machine is so busy that the plant's watchdog is first, or that no command has come yet, the run is
    repeated.
    """
    experiment = written(folder, controller={"homing": 1}, duration=500)
    compiled("linear_rig")
    tries = []
    for attempt in range(3):
        own, saved = folder / f"own {attempt}", folder / f"saved {attempt}"
        with (
            Canary() as canary,
            serving("linear_rig", "--record", own) as (server, address),
            controlling(experiment, address, saved) as controller,
        ):
            began = time.monotonic()
            time.sleep(seconds + 0.2 * attempt)
            is_running = controller.poll() is None
            controller.send_signal(number)
            passed = time.monotonic() - began
            status, out, err = ended(controller)
            assert server.wait(20.0) == 0
            told = server.stderr.read()
        session = Recording.load(own / "session-1")
        if not session["fresh"].any():
            tries.append(f"no command within {passed:.2f} s")
            continue
        if str((session.manifest["latch"] or {}).get("cause", "")).startswith("the server was held up"):
            tries.append(session.manifest["latch"]["cause"])
            continue
        if is_running:
            return Cut(status, out, err, passed, session, told, saved)
        tries.append(f"{err.strip()}; this machine let {canary.missed} of {canary.ticks} ms pass")
        assert canary.missed > 0.01 * canary.ticks, tries
    pytest.skip(f"this machine is too busy for 1 kHz: {tries}")


def applied(own: Recording) -> np.ndarray:
    """Return what the twin's actuators were given at each tick, (m, 3)."""
    return np.column_stack([own[f"plant.applied.V{i}"] for i in (1, 2, 3)])


@pytest.mark.realtime
@pytest.mark.parametrize(
    "seconds",
    [
        pytest.param(0.35, id="in the homing"),
        pytest.param(1.3, id="after the release", marks=pytest.mark.search),
        pytest.param(2.2, id="later"),
    ],
)
def test_a_controller_that_is_killed_leaves_the_rig_at_zero(tmp_path, seconds):
    cut = cut_short(tmp_path, seconds, signal.SIGKILL)
    own = cut.own
    assert cut.status == -signal.SIGKILL
    last = int(np.flatnonzero(own["fresh"])[-1])
    given = own.array("input")
    assert np.all(np.abs(applied(own)[last - 20 : last]).max(axis=0) > 0.0)
    # The last command holds until the watchdog has seen nothing for 20 ms, which may be 5 % early; from then
    # on all is zero to the end, after fewer ticks where the machine missed some.
    zero = last + int(np.flatnonzero(~given[last:].any(axis=1))[0])
    assert np.array_equal(given[last:zero], np.tile(given[last], (zero - last, 1)))
    due = own["wall"] - np.where(own["late"] * RATE <= 1.0, own["late"], 0.0)
    assert due[zero] - due[last + 1] < WATCHDOG / 1e3 <= (due[zero + 1] - due[last + 1]) / 0.95 + 1e-9
    after = np.arange(len(given)) >= zero + 2
    assert np.count_nonzero(after) > 500
    assert not applied(own)[after].any()
    assert not given[zero:].any()
    assert own["latched"][after].all()
    assert own.manifest["latch"] == {"cause": "no valid command for 20 ms", "tick": zero}
    assert own.manifest["end"] == "no valid command for 20 ms"
    assert "session ended: no valid command for 20 ms" in cut.told
    # What it had seen and written is there up to the last tick, but for one whose command was just on its way.
    found = recovered(cut.saved)
    ticks = Recording.load(cut.saved / "ticks")
    assert (found.missing, found.damages) == (0, ())
    assert last - 1 <= ticks["tick"][-1] <= last + 1
    seen = ticks["tick"].astype(int)
    seen = seen[seen < min(last, len(own.t) - 1)]
    for name in ("s1", "s2", "s3"):
        assert np.array_equal(ticks[f"sensor.{name}"][: len(seen)], own[f"sensor.{name}"][seen])
    assert (found.recording is None) == (ticks["index"][-1] < 0)


def recovered(folder: Path):
    """Recover a run once its recorder has ended."""
    until = time.monotonic() + 10.0
    while True:
        try:
            return recover(folder)
        except RecordError as error:
            assert "is being recorded" in str(error)
            assert time.monotonic() < until
            time.sleep(0.05)


@pytest.mark.realtime
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGINT, id="SIGINT"),
        pytest.param(signal.SIGTERM, id="SIGTERM", marks=pytest.mark.search),  # in the gate, in the homing
    ],
)
def test_a_controller_that_is_told_to_stop_leaves_the_rig_at_zero_and_keeps_its_record(tmp_path, number):
    cut = cut_short(tmp_path, 1.8, number)
    assert cut.err == "masking: interrupted: SIGINT, SIGTERM or SIGHUP came; the record ends there\n"
    own, found = cut.own, Recording.load(cut.saved)
    assert cut.status == 1
    assert cut.err == "masking: interrupted: SIGINT, SIGTERM or SIGHUP came; the record ends there\n"
    assert json.loads(cut.out)["rig"]["end"] == found.manifest["rig"]["end"] == "interrupted"
    # The plant hears of it within 100 ms, and is at zero from then on.
    assert cut.passed - 1.0 < own["wall"][-1] < cut.passed + 0.1
    assert own.manifest["end"] == "bye"
    assert np.abs(own.array("input")[-20:-1]).max() > 0.0
    assert not own.array("input")[-1].any()
    assert not applied(own)[-1].any()
    # The record is that of the ticks from the release, after the homing of a second, to the last that was answered:
    # as many more as this machine kept the controller waiting, within the 100 ms, the plant went on alone.
    last = offset(found, own, 1001) + round(found.t[-1] * RATE)
    assert own["tick"][-1] - 100 < last <= own["tick"][-1]
    assert np.count_nonzero(own["fresh"][last + 1 :]) <= 2


def test_a_run_that_is_interrupted_in_the_homing_says_that_nothing_was_recorded(tmp_path):
    cut = cut_short(tmp_path, 0.4, signal.SIGTERM)
    assert cut.status == 1
    assert cut.err == "masking: the run was interrupted during homing, before the release; nothing was recorded\n"
    assert (cut.own.manifest["end"], cut.own.array("input")[-1].any()) == ("bye", False)
    assert not cut.saved.exists()


def test_what_is_written_stays_within_the_limits_of_the_plant_file(tmp_path):
    weak = tmp_path / "weak.yaml"
    text = catalogue.find("plant", "linear_rig").read_text(encoding="utf-8")
    weak.write_text(text.replace("max: 0.42, unit: V", "max: 20, unit: mV"), encoding="utf-8")
    experiment = Experiment.load(written(tmp_path, str(weak), duration=20))
    with serving(weak, "--lockstep", "--record", tmp_path) as (_, address):
        found = rig_run.run(experiment, UdpPlant(address), rig_run.RunSettings(lockstep=True))
    own = Recording.load(tmp_path / "session-1")
    assert np.abs(found.array("demanded")).max() > 0.03
    for shown in (found.array("input"), own.array("input")):
        assert np.abs(shown).max() == 0.02
    first = before(experiment)
    assert_equal(own.array("input")[first:][: len(found)], found.array("input"), "input")


# --- what does not fit ------------------------------------------------------------------------------------------------


class Refusing:
    """A plant with given channels, which must not be activated."""

    owns_clock = False

    def __init__(self, sensors, actuators):
        self.sensors, self.actuators, self.calls = sensors, actuators, []

    def configure(self, settings):
        self.calls.append("configure")

    def deactivate(self):
        self.calls.append("deactivate")


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("sensors", "actuators", "said"),
    [
        (
            "s1 s2 s3",
            "u1 u2 u3",
            "the plant's actuators are u1, u2, u3; {wanted}, whose actuators are V1, V2, V3, {remedy}",
        ),
        ("s1 s2", "V1 V2 V3", "the plant's sensors are s1, s2; {wanted}, whose sensors are s1, s2, s3, {remedy}"),
        (
            "s2 s1 s3",
            "V1 V2 V3",
            "the plant's sensors are s2, s1, s3; {wanted}, whose sensors are s1, s2, s3, {remedy}",
        ),
        ("s1 s2 s3", "V1", "the plant's actuators are V1; {wanted}, whose actuators are V1, V2, V3, {remedy}"),
    ],
    ids=["other names", "too few sensors", "another order", "too few actuators"],
)
def test_a_plant_with_other_channels_is_refused_before_it_is_activated(offline, sensors, actuators, said):
    _, experiment, _ = offline("linear_rig")
    plant = Refusing(tuple(sensors.split()), tuple(actuators.split()))
    with pytest.raises(PlantMismatchError) as caught:
        rig_run.run(experiment, plant, rig_run.RunSettings(lockstep=True))
    wanted = "the experiment is for linear_rig"
    remedy = "in this order: run it on that plant, or write the plant that is there into it"
    assert str(caught.value) == said.format(wanted=wanted, remedy=remedy)
    assert plant.calls[0] == "configure"
    assert set(plant.calls[1:]) == {"deactivate"}


def test_a_served_plant_with_other_channels_is_refused_on_the_command_line(offline, tmp_path, capsys):
    path, _, _ = offline("linear_rig")
    with serving("ideal", "--record", tmp_path / "own") as (server, address):
        assert cli.main(["rig", "run", str(path), "--plant", address, "--out", str(tmp_path / "out")]) == 2
        server.send_signal(signal.SIGTERM)
        assert server.wait(20.0) == 0
    said = "masking: the plant's actuators are u1, u2, u3; the experiment is for linear_rig, whose actuators are V1, V2"
    assert capsys.readouterr().err.startswith(said)
    assert not (tmp_path / "own").exists()  # it was never active
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        (
            {"homing": None},
            "a rig cannot be placed in its initial state: write controller.homing, the seconds in which the "
            "controller brings it there, such as 'homing: 3'",
        ),
        (
            {"homing": None, "observer": "exact"},
            "a rig is known by its sensors only: give controller.rate and controller.observer, such as "
            "'controller: {rate: 1 kHz, observer: disturbance, homing: 3}'",
        ),
        (
            {"homing": None, "observer": None, "rate": "continuous"},
            "a rig is known by its sensors only: give controller.rate and controller.observer, such as "
            "'controller: {rate: 1 kHz, observer: disturbance, homing: 3}'",
        ),
    ],
    ids=["no homing", "exact observer", "continuous"],
)
def test_an_experiment_that_no_rig_can_run_is_refused_before_the_plant_is_touched(tmp_path, controller, said):
    experiment = Experiment.load(written(tmp_path, controller=controller))
    plant = Refusing(("s1", "s2", "s3"), ("V1", "V2", "V3"))
    with pytest.raises(ModelError) as caught:
        rig_run.run(experiment, plant)
    assert str(caught.value) == said
    assert caught.value.exit_status == 2
    assert plant.calls == []


@pytest.mark.realtime
def test_without_an_observer_a_rig_is_estimated_with_its_disturbances(tmp_path):
    experiment = Experiment.load(written(tmp_path, controller={"observer": None}, duration=1))
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    assert found.manifest["observer"]["kind"] == "disturbance"


def test_where_nobody_listens_it_is_said_what_to_start(offline, tmp_path, capsys):
    path, _, _ = offline("linear_rig")
    address = "udp://127.0.0.1:9"  # whose service, discard, nobody runs
    assert cli.main(["rig", "run", str(path), "--plant", address, "--out", str(tmp_path / "out")]) == 1
    remedy = f"start it with 'masking rig serve PLANT --address {address}', or correct the address"
    assert capsys.readouterr().err == f"masking: no plant answers at {address}; {remedy}\n"


@pytest.mark.realtime
@pytest.mark.parametrize("address", ["127.0.0.1:5005", "udp://127.0.0.1", "udp://127.0.0.1:99999", ""])
def test_an_address_that_is_none_is_refused(offline, address, tmp_path, capsys):
    path, _, _ = offline("linear_rig")
    assert cli.main(["rig", "run", str(path), "--plant", address, "--out", str(tmp_path / "out")]) == 2
    said = f"masking: '{address}' is no address of a plant; write it as udp://127.0.0.1:"
    assert capsys.readouterr().err.startswith(said)


def test_a_host_that_does_not_exist_is_named(offline):
    _, experiment, _ = offline("linear_rig")
    with pytest.raises(PlantLostError, match=r"udp://rig\.invalid:5005 cannot be reached \(.*\); look at its name and"):
        rig_run.run(experiment, UdpPlant("udp://rig.invalid:5005", patience=0.1))


@pytest.mark.realtime
@pytest.mark.parametrize(("served", "wanted"), [("lockstep", "real"), ("real", "lockstep")])
def test_both_sides_must_have_the_same_clock(offline, served, wanted):
    _, experiment, _ = offline("linear_rig")
    with serving("linear_rig", *(["--lockstep"] if served == "lockstep" else [])) as (server, address):
        said = f"its clock is '{served}', the controller wants '{wanted}'; start both in lockstep, or both without"
        with pytest.raises(PlantRefusedError, match=said):
            rig_run.run(experiment, UdpPlant(address), rig_run.RunSettings(lockstep=wanted == "lockstep"))
        server.send_signal(signal.SIGTERM)
