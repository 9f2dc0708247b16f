"""The safety chain and the self-test, against faults that are put between the twin of a rig and its controller.

What a fault does is judged on the plant's own record: the true states of the twin, and the commands that reached it.
"""

import dataclasses
import json
import signal
from pathlib import Path

import numpy as np
import pytest

from masking.app.cli import main
from masking.compile.numerics import safety_tables
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER, TIME
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, MaskingError, PlantError
from masking.lab.plants.interface import Sample
from masking.lab.plants.safety_chain import Cause, Chain, Rules
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import stream
from masking.lab.records.recording import Recording
from masking.lab.runs import rig_run, safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import feasibility
from masking.lab.runs.self_test import self_test
from tests.lab.runs.test_rig_run import serving
from tests.support.rig_runs import run_rig

ROOT = Path(__file__).parents[3]
X, V = 0, 1  # of the cart


class Damaged:
    """A twin whose readings and commands are damaged on the way; keeps what reached it and how it moved."""

    owns_clock = False

    def __init__(self, plant, *, reading=lambda tick, values: None, command=lambda tick, values: None, deaf=False):
        self.plant, self.reading, self.command, self.deaf = plant, reading, command, deaf
        self.sensors, self.actuators = plant.sensors, plant.actuators
        self.ticks, self.written, self.states = [], [], []

    def configure(self, settings):
        self.plant.configure(settings)

    def activate(self):
        self.plant.activate()

    def read(self):
        sample = self.plant.read()
        values = sample.values.copy()
        self.reading(sample.index, values)
        return Sample(sample.index, values)

    def write(self, index, command):
        reached = np.zeros_like(command) if self.deaf else np.array(command)
        self.command(index, reached)
        self.ticks.append(index)
        self.written.append(np.array(command))
        self.states.append(self.plant._y.copy())
        self.plant.write(index, reached)

    def deactivate(self):
        self.plant.deactivate()

    def telemetry(self):
        return self.plant.telemetry()


@pytest.fixture(scope="module")
def cart():
    """The Van der Pol oscillator on the imperfect cart, at 500 Hz; 25 mm of stroke, 22 mm of it used."""
    return Experiment.load("cart_van_der_pol").changed(duration=60)


def run(experiment, **damage):
    """Return the end of a run in lockstep on a damaged twin, its trip, and the plant with its record."""
    plant = Damaged(SimulatedPlant(experiment.twin), **damage)
    recording = rig_run.run(experiment, plant, rig_run.RunSettings(lockstep=True))
    return recording.manifest["rig"]["end"], recording.manifest["rig"].get("trip"), plant


def middle(experiment):
    """Return a tick in the midst of the run."""
    return experiment.sampled.before + int(0.5 * 60 * experiment.time_scale * experiment.sampled.rate)


def on_a_plant(experiment, folder, change):
    """Return the experiment on its plant with other limits or sensors."""
    import yaml

    declared = yaml.safe_load((ROOT / "plants" / "cart.yaml").read_text(encoding="utf-8"))
    change(declared)
    (folder / "plant.yaml").write_text(json.dumps(declared), encoding="utf-8")
    return experiment.changed(plant=str(folder / "plant.yaml"))


def test_a_sound_rig_never_trips(cart):
    end, trip, plant = run(cart)
    assert (end, trip) == ("finished", None)
    assert len(plant.ticks) == cart.sampled.before + 1 + int(60 * cart.time_scale * cart.sampled.rate)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_reading_that_is_not_finite_stops_in_its_tick(cart, value):
    at = middle(cart)

    def reading(tick, values):
        values[0] = value if tick == at else values[0]

    end, trip, plant = run(cart, reading=reading)
    assert (end, trip["cause"], trip["channel"], trip["tick"]) == ("tripped", "SENSOR_NONFINITE", "encoder", at)
    assert plant.ticks[-1] == at
    assert plant.written[-1].tolist() == [0.0]
    assert np.isfinite(plant.written).all()


@pytest.mark.parametrize("part", np.linspace(0.3, 0.7, 9))
def test_a_stuck_sensor_is_found_within_50_ms(cart, part):
    at, held = cart.sampled.before + int(part * 60 * cart.time_scale * 500), []

    def reading(tick, values):
        if tick >= at:
            held[:] = held or [values[0]]
            values[0] = held[0]

    end, trip, plant = run(cart, reading=reading)
    assert (end, trip["cause"], trip["channel"]) == ("tripped", "SENSOR_STUCK", "encoder")
    assert (plant.ticks[-1] - at) / 500.0 <= 0.05


@pytest.mark.parametrize("size", [8.0, -8.0])  # mm in 2 ms: 4 m/s, where 1.8 m/s can be reached
def test_a_jump_stops_in_its_tick(cart, size):
    at = middle(cart)

    def reading(tick, values):
        values[0] += size if tick >= at else 0.0

    end, trip, plant = run(cart, reading=reading)
    assert (end, trip["cause"], trip["tick"]) == ("tripped", "SENSOR_JUMP", at)
    assert plant.written[-1].tolist() == [0.0]


def test_a_jump_of_2_mm_on_the_rig_of_the_thesis_stops_in_its_tick():
    experiment = Experiment.load("huygens_rig").changed(duration=10)  # 1 kHz
    for i in range(3):
        at = experiment.sampled.before + 300

        def reading(tick, values, i=i, at=at):
            values[i] += 0.4 if tick >= at else 0.0  # 200 V/m

        end, trip, _ = run(experiment, reading=reading)
        assert (end, trip["cause"], trip["channel"], trip["tick"]) == ("tripped", "SENSOR_JUMP", f"s{i + 1}", at)


def test_a_declared_jump_and_range_are_kept(cart, tmp_path):
    def change(declared):
        declared["sensors"]["encoder"] |= {"jump": 1.0, "range": [-24, 24]}

    changed, at = on_a_plant(cart, tmp_path, change), middle(cart)
    for size, cause in ((1.5, "SENSOR_JUMP"), (60.0, "SENSOR_RANGE")):

        def reading(tick, values, size=size):
            values[0] += size if tick == at else 0.0

        end, trip, _ = run(changed, reading=reading)
        assert (end, trip["cause"], trip["tick"]) == ("tripped", cause, at)


def test_excess_motion_and_speed_stop_where_they_are_declared(cart, tmp_path):
    sound = run(cart)[2]
    reached = np.abs(np.array(sound.states)).max(axis=0)
    for key, column in (("coordinates", X), ("velocities", V)):
        limit = 0.6 * reached[column]

        def change(declared, key=key, limit=limit):
            declared["limits"][key] = {"x": {"max": float(limit), "unit": "m/s" if key == "velocities" else "m"}}

        experiment = on_a_plant(cart, tmp_path, change)
        try:
            end, trip, plant = run(experiment)
        except MaskingError as error:  # before the release
            assert "POSITION_LIMIT" in str(error)
            continue
        states = np.abs(np.array(plant.states))
        assert (end, trip["cause"]) == ("tripped", "POSITION_LIMIT" if column == X else "VELOCITY_LIMIT")
        assert plant.written[-1].tolist() == [0.0]
        rate = reached[V] if column == X else np.abs(np.diff(states[:, V])).max() * 500.0
        assert limit < states[-1, column] <= limit + rate * 2 / 500.0 + 2e-5
        assert states[:-1, column].max() <= limit + rate / 500.0 + 2e-5


def heated(power: float = 8.0, heating: float = 2.0) -> Rules:
    """Return the rules of an actuator of 8 W that may take 10 A."""
    made = Rules.of_commands(np.array([10.0]), ("s",), ("u",), 1000.0)
    made.commands[0, [LARGEST, POWER, HEATING, TIME]] = 10.0, power, heating, 10.0
    return made


def test_no_mean_over_ten_seconds_exceeds_the_power():
    chain, power = Chain(heated()), []
    for tick in range(40_000):
        chain.watch(tick, np.zeros(1))
        wanted = np.sqrt(12.0) * np.sin(2.0 * np.pi * 5.0 * tick / 1000.0)  # 12 W in the mean
        power.append(2.0 * chain.guard(tick, np.array([wanted]))[0] ** 2)
    assert chain.trip.cause is Cause.THERMAL
    means = np.convolve(power, np.full(10_000, 1e-4), mode="valid")
    assert means.max() <= 8.0 * 1.02
    assert means.max() >= 8.0 * 0.98  # all that is allowed may be used
    assert not any(power[chain.trip.tick :])
    assert chain.trip.tick / 1000.0 == pytest.approx(10.0 * 8.0 / 12.0, rel=0.1)


def slowed(rate=50.0):
    """Return a chain of an actuator of 0.42 V that may change by 50 V/s, at 1 kHz."""
    made = Rules.of_commands(np.array([0.42]), ("s",), ("u",), 1000.0)
    made.commands[0, safety_tables.RATE] = rate
    return Chain(made)


def written(chain, demanded):
    """Return the commands that a chain passes on, tick by tick."""
    applied = []
    for tick, command in enumerate(demanded):
        chain.watch(tick, np.zeros(1))
        applied.append(chain.guard(tick, np.array([command]))[0])
    return np.array(applied)


def test_a_jump_of_a_command_takes_as_long_as_its_rate_says():
    chain = slowed()
    applied = written(chain, np.repeat([-0.42, 0.42, -9.0], 40))
    assert np.abs(np.diff(applied, prepend=0.0)).max() == pytest.approx(0.05)
    # 0 to -0.42 V takes 8.4 ticks, -0.42 V to 0.42 V 16.8; then the command is what was asked, to the last bit.
    assert np.flatnonzero(applied == -0.42)[[0, 31]].tolist() == [8, 39]
    assert np.flatnonzero(applied == 0.42).tolist() == list(range(56, 80))
    assert (applied[-1], chain.trip) == (-0.42, None)
    assert chain.clamped == 8 + 16 + 40


def test_a_command_that_stays_too_fast_trips_after_a_quarter_of_a_second():
    period = np.repeat([0.42, -0.42], 5)  # which no actuator of 50 V/s follows
    chain = slowed()
    applied = written(chain, np.tile(period, 60))
    assert (chain.trip.cause, chain.trip.channel, chain.trip.tick) == (Cause.COMMAND_RATE, "u", 250)
    assert "for u has to be slowed for too long" in str(chain.trip)
    assert "50/s are allowed" in str(chain.trip)
    assert np.abs(np.diff(applied[:250])).max() <= 0.05 * (1 + 1e-12)
    assert not applied[250:].any()
    assert written(slowed(np.inf), period).tolist() == period.tolist()


def test_the_rate_of_a_plant_file_holds_in_its_unit_where_the_motion_asks_for_more(cart, tmp_path):
    sound = np.abs(np.diff(run(cart)[2].written, axis=0)).max() * 500.0  # A/s

    def change(declared, rate):
        declared["limits"]["inputs"]["u"] = {"max": 2000, "unit": "mA", "rate": 1000.0 * rate}

    free = on_a_plant(cart, tmp_path, lambda declared: change(declared, 1.01 * sound))
    assert np.array_equal(run(free)[2].written, run(cart)[2].written)
    asked = feasibility(free)["rate of u"]
    assert (asked.unit, asked.fits) == ("mA/s", True)
    allowed = 0.3 * asked.needed / 1000.0
    held = on_a_plant(cart, tmp_path, lambda declared: change(declared, allowed))
    plant = Damaged(SimulatedPlant(held.twin))
    assert not feasibility(held)["rate of u"].fits
    found = rig_run.run(held, plant, rig_run.RunSettings(lockstep=True)).manifest["rig"]
    assert (found["end"], found["trip"]["cause"]) == ("tripped", "COMMAND_RATE")
    assert f"where {allowed:.4g} A/s are allowed" in found["trip"]["sentence"]
    assert np.abs(np.diff(plant.written[:-1], axis=0)).max() <= allowed / 500.0 * (1 + 1e-9)


def test_values_at_expiry_are_those_of_a_silent_plant_alone(cart, tmp_path):
    def change(declared):
        declared["limits"]["inputs"]["u"] = {"max": 2, "unit": "A", "expiry": -0.5}

    rules = safety_limits.rules(on_a_plant(cart, tmp_path, change).instruments, 500.0)
    chain, faulty = Chain(rules), Chain(rules)
    chain.time(9, is_late=True, silence=9.0, missed=8, lost=8)
    assert (chain.trip.cause, chain.guard(9, np.ones(1)).tolist()) == (Cause.COMM_LOST, [-0.5])
    chain.stop(Cause.ESTOP, 10)  # a second cause
    assert (chain.trip.cause, chain.guard(10, np.ones(1)).tolist()) == (Cause.COMM_LOST, [0.0])
    faulty.watch(0, np.array([np.nan]))
    assert faulty.guard(0, np.ones(1)).tolist() == [0.0]
    with pytest.raises(
        DeclarationError, match=r"expiry is -3, beyond the largest command, 2 *\n? *.*write a number within"
    ):
        on_a_plant(cart, tmp_path, lambda declared: declared["limits"]["inputs"]["u"].update(expiry=-3))


def test_the_allowed_power_never_trips():
    chain = Chain(heated())
    for tick in range(40_000):
        chain.watch(tick, np.zeros(1))
        assert chain.guard(tick, np.array([2.0]))[0] == 2.0  # 8 W
    assert chain.trip is None


def test_an_hour_of_quantised_rest_never_trips(cart):
    rules = safety_limits.rules(cart.instruments, 500.0, cart.twin)
    chain, rng = Chain(rules), np.random.default_rng(4)
    assert rules.readings[0, safety_tables.SPAN] > 0  # its motion is watched
    count, command = 3600 * 500, np.zeros(1)
    drift = 0.004 * np.sin(np.linspace(0.0, 20.0, count))  # mm: through some steps, slowly
    noise = 0.0003 * rng.standard_normal(count)  # a third of a step
    readings = np.round((drift + noise) / 0.001) * 0.001
    readings[: count // 3] = 0.127  # and without noise, between two of them
    readings -= 0.127 - readings[count // 3]
    readings[: count // 3] = readings[count // 3]
    for tick, reading in enumerate(readings[:, None]):
        chain.watch(tick, reading)
        chain.guard(tick, command)
    assert chain.trip is None


@pytest.mark.parametrize(("part", "cause"), [(0.0, "NO_RESPONSE"), (-1.0, "WRONG_SIGN")])
def test_an_actuator_that_fails_is_found(cart, part, cause):
    at = middle(cart)

    def command(tick, values):
        values *= part if tick >= at else 1.0

    end, trip, plant = run(cart, command=command)
    assert (end, trip["cause"], trip["channel"]) == ("tripped", cause, "u")
    assert (plant.ticks[-1] - at) / 500.0 < 0.5


def test_a_plant_that_takes_no_command_does_not_finish(cart):
    with pytest.raises(
        MaskingError, match=r"tripped during homing.*COMMANDS_NOT_TAKEN: the plant puts out nothing on u"
    ):
        run(cart, deaf=True)


def test_five_ticks_in_a_row_are_late_or_too_many_of_a_second():
    def late(pattern, missed=1.0):
        chain = Chain(dataclasses.replace(heated(), missed=missed))
        for tick, is_late in enumerate(pattern):
            chain.time(tick, is_late=is_late, silence=1.0, missed=0, lost=0)
        return chain.trip

    assert late([True] * 4 + [False] + [True] * 4) is None
    assert late([False] * 3 + [True] * 5).tick == 7
    often = [i % 10 == 0 for i in range(3000)]
    assert late(often, missed=0.11) is None
    assert late(often, missed=0.09).cause is Cause.OVERRUN


@pytest.mark.parametrize(("lost", "trips"), [(1, False), (4, False), (5, True), (20, True)])
def test_silence_is_borne_for_four_samples(lost, trips):
    chain = Chain(heated())
    chain.time(10, is_late=True, silence=lost + 1.0, missed=lost, lost=lost)
    assert (chain.trip is not None and chain.trip.cause is Cause.COMM_LOST) == trips


def test_a_trip_stays_and_nothing_but_zero_is_written():
    chain = Chain(heated())
    assert chain.guard(0, np.array([1.0])).tolist() == [1.0]
    first = chain.watch(1, np.array([np.nan]))
    assert chain.guard(1, np.array([1.0])).tolist() == [0.0]
    assert chain.watch(2, np.array([0.0])) is first
    assert chain.stop(Cause.ESTOP, 3) is first
    assert chain.guard(3, np.array([1.0])).tolist() == [0.0]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_whatever_a_controller_returns_the_plant_gets_finite_commands_within_limits(cart, value):
    plant = Damaged(SimulatedPlant(cart.twin))
    ran = run_rig(
        lambda tick, _: np.array([value if tick > 20 else 0.0]),
        plant, rate=500.0, samples=100, limits=np.array([2.0]), lockstep=True,
    )  # fmt: skip
    assert np.abs(plant.written).max() <= 2.0
    assert (ran.trip is None) == np.isfinite(value)
    assert ran.trip is None or (ran.trip.cause, ran.trip.tick) == (Cause.CONTROLLER_NONFINITE, 21)


def test_an_emergency_stop_trips(cart):
    plant = Damaged(SimulatedPlant(cart.twin))
    ran = run_rig(
        lambda *_: np.array([0.1]), plant, rate=500.0, samples=100, limits=np.array([2.0]), lockstep=True,
        emergency=lambda: len(plant.ticks) == 7,
    )  # fmt: skip
    assert (ran.reason, ran.trip.cause, ran.trip.tick) == ("tripped", Cause.ESTOP, 7)
    assert plant.written[-1].tolist() == [0.0]


@pytest.mark.parametrize("name", ["cart", "linear_rig", "tue_rig", "cart_pendulum"])
def test_a_sound_rig_passes_its_self_test_with_a_small_pulse(name):
    twin = Twin.load(name)
    plant = Damaged(SimulatedPlant(twin, seed=3))
    found = self_test(twin, plant, lockstep=True)
    assert found.findings == ()
    assert all(0.9 < answer.gain < 1.1 for answer in found.answers if answer.is_clear)
    limits = [twin.declaration.limits.inputs[a].max for a in twin.actuators]
    assert np.abs(plant.written).max(axis=0) == pytest.approx(0.05 * np.array(limits))


def test_a_self_test_names_what_is_wrong():
    twin = Twin.load("linear_rig")

    def findings(**damage):
        plant = Damaged(SimulatedPlant(twin, seed=3), **damage)
        found = self_test(twin, plant, lockstep=True)
        assert np.abs(plant.written).max() <= 0.05 * 0.42
        return found

    def dead(_, values):
        values[1] = 0.0

    def turned(_, values):
        values[2] *= -1.0

    def weak(_, values):
        values[0] *= 0.4

    assert [f.split(":")[0] for f in findings(command=dead).findings] == ["V2 is dead"]
    assert [f.split(":")[0] for f in findings(command=turned).findings] == ["V3 has the wrong sign"]
    assert [f.split(":")[0] for f in findings(reading=turned).findings] == ["s3 has the wrong sign"]
    assert [f.split(":")[0] for f in findings(reading=weak).findings[:1]] == ["s1 answers V1 wrongly"]
    rng, declared = np.random.default_rng(2), twin.noise()["s2"]

    def rough(_, values):
        values[1] += 9.0 * declared * rng.standard_normal()

    said = [f for f in findings(reading=rough).findings if f.startswith("s2 reads ")]
    assert len(said) == 1
    assert "of noise at rest, 9 times what is declared" in said[0]
    with pytest.raises(PlantError, match="the self-test refuses to arm: V2 is dead"):
        findings(command=dead).check()


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_index_that_jumps_far_trips_at_once(cart, lockstep):
    class Jumping(Damaged):
        owns_clock = True

        def read(self):
            sample = super().read()
            return Sample(sample.index + (10**9 if sample.index > 5 else 0), sample.values)

    ran = run_rig(
        lambda *_: np.zeros(1), Jumping(SimulatedPlant(cart.twin)), rate=500.0, samples=50, limits=np.array([2.0]),
        lockstep=lockstep,
    )  # fmt: skip
    assert (ran.reason, ran.trip.cause, len(ran.index)) == ("tripped", Cause.OVERRUN, 7)


@pytest.mark.parametrize("back", [1, 5])
def test_an_index_that_repeats_or_goes_back_ends_the_run_with_the_rows_before(cart, tmp_path, back):
    at, kept = middle(cart), []

    class Stepping(Damaged):
        def read(self):
            sample = self.plant.read()
            return Sample(sample.index - back * (sample.index == at), sample.values)

    settings = rig_run.RunSettings(lockstep=True, keep=kept.append, stream=tmp_path / "rows")
    plant = Stepping(SimulatedPlant(cart.twin))
    with pytest.raises(PlantError, match=rf"the plant gave sample {at - back} after sample {at - 1}: .*rig check"):
        rig_run.run(cart, plant, settings)
    assert plant.ticks == list(range(at))
    kept[0].save(tmp_path / "kept")
    rig = kept[0].manifest["rig"]
    assert (rig["end"], rig["trip"]["cause"], rig["trip"]["tick"]) == ("tripped", "PLANT_ERROR", at - 1)
    assert np.diff(Recording.load(tmp_path / "kept").t) == pytest.approx(1.0 / 500.0)
    assert stream.written(tmp_path / "rows") == at


def test_a_finished_run_whose_masking_error_is_above_one_has_status_1_and_says_why(cart, tmp_path, capsys, monkeypatch):
    """A coil of a hundredth of its current is too weak for the motion: the chain has nothing against it."""

    def change(declared):
        declared["limits"]["inputs"]["u"]["max"] = 0.02

    weak = on_a_plant(cart.changed(duration=30), tmp_path, change)
    file = tmp_path / "weak.yaml"
    file.write_text(json.dumps(weak.declaration.canonical()), encoding="utf-8")
    monkeypatch.setattr("masking.lab.plants.group.adapters.connect", lambda *_: SimulatedPlant(weak.twin))
    arguments = ["rig", "run", str(file), "--plant", "x:y", "--lockstep", "--out", str(tmp_path / "out"), "--json"]
    assert main(arguments) == 1
    said = capsys.readouterr()
    found = json.loads(said.out)
    assert found["rig"]["end"] == "finished"
    assert max(found["masking_error"].values()) > 1.0
    assert "masking: finished, but otherwise than wanted: The masking error is above 1" in said.err
    assert "the rig could not follow there" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_command_line_tests_a_served_rig_and_refuses_the_wrong_plant_file(capsys):
    with serving("linear_rig", "--lockstep", "--sessions", 100) as (server, address):
        assert main(["rig", "check", address, "--lockstep", "--plant", "linear_rig", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)["self_test"]
        assert found["findings"] == []
        assert {answer["actuator"] for answer in found["answers"]} == {"V1", "V2", "V3"}
        assert main(["rig", "check", address, "--lockstep", "--plant", "cart"]) == 2
        assert "the plant file is that of cart" in capsys.readouterr().err
        server.send_signal(signal.SIGTERM)
