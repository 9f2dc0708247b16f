"""Controlled stops on twins: judged by the mechanical energy of their true states, and by what reached the plant."""

import contextlib
import dataclasses
import json
import os
import signal
from functools import partial

import numpy as np
import pytest

from masking.compile.numerics import safety_tables
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, EmergencyStopError, ModelError, PlantLostError
from masking.lab.plants.interface import Settings
from masking.lab.plants.safety_chain import Cause
from masking.lab.plants.served_plant_guard import PlantLimits
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.udp import UdpPlant
from masking.lab.records.recording import Recording
from masking.lab.runs import rig_run, safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.realtime import Hooks, run_rig
from masking.model.declaration.instrument_declaration import ControlledStop
from tests.lab.plants.test_safety_chain import Damaged, on_a_plant
from tests.lab.plants.test_wire import served

CASES = {"cart": (500.0, 0.012, 1.0, 900), "tue_rig": (1000.0, 0.03, 2.0, 700)}
NOISE = 1e-3  # of the energy at first, which noise of the readings may give back
UNDER_WAY = 2  # commands that act after a trip, whatever follows it


def rules_of(plant, rate, kind, time=3.0):
    """Return the rules of a packaged plant with another way to stop."""
    twin = Twin.load(plant)
    limits = twin.declaration.limits.model_copy(update={"stop": ControlledStop(kind=kind, time=time)})
    known = dataclasses.replace(Instruments.of(twin), plant=twin.declaration.model_copy(update={"limits": limits}))
    return safety_limits.rules(known, rate, twin), twin


def energy(plant, states):
    """Return the mechanical energy (samples,), from the masses and springs of the sources."""
    p, x = Twin.load(plant).model.parameter_values(), np.array(states).T
    if plant == "cart":
        return p["m"] * x[1] ** 2 / 2 + p["k"] * x[0] ** 2 / 2
    first = p["mu1"] * (x[3] ** 2 + p["w1"] ** 2 * (x[0] - x[2]) ** 2)
    second = p["mu2"] * (x[4] ** 2 + p["w2"] ** 2 * (x[1] - x[2]) ** 2)
    return (first + second + x[5] ** 2 + p["w3"] ** 2 * x[2] ** 2) / 2


def risen(left):
    """Return the largest rise of an energy above what it was before, as a part of it at first."""
    return float((left - np.minimum.accumulate(left)).max() / left[0])


class FailsError(Exception):
    """What the controller raises at speed."""


def stopped(plant, kind, *, change=lambda rules: None, time=3.0, emergency=None, **damage):
    """Move a rig, let the controller fail at speed, and return the run, its plant, its rules, and the tick of it.

    Without a controlled stop the controller is silent instead, so that the record goes on.
    """
    rate, size, frequency, at = CASES[plant]
    rules, twin = rules_of(plant, rate, kind, time)
    change(rules)
    made, ended = Damaged(SimulatedPlant(twin), **damage), []

    def step(tick, _):
        if tick == at and kind != "zero":
            raise FailsError
        return np.full(len(twin.actuators), size * np.sin(2.0 * np.pi * frequency * tick / rate) * (tick < at))

    hooks = Hooks(on_end=ended.append, emergency=None if emergency is None else lambda: len(made.ticks) > emergency)
    with contextlib.suppress(FailsError):
        run_rig(step, made, Settings(rate, lockstep=True), samples=at + 800, limits=rules, hooks=hooks)
    return ended[0], made, rules, at


@pytest.mark.parametrize("rate", [np.inf, 5.0])
@pytest.mark.parametrize("plant", CASES)
def test_a_brake_takes_energy_out_faster_than_zero_and_never_adds_any(plant, rate):
    def change(rules):
        rules.commands[:, safety_tables.RATE] = rate

    _, free, _, at = stopped(plant, "zero")
    run, braked, rules, _ = stopped(plant, "brake", change=change)
    assert (run.reason, run.trip.cause) == ("tripped", Cause.CONTROLLER_EXCEPTION)
    left, kept = (energy(plant, one.states)[at + UNDER_WAY :] for one in (braked, free))
    assert risen(left) < NOISE
    many = min(len(left), len(kept))
    assert np.all(left[10:many] <= kept[10:many])
    assert left[-1] < 0.01 * left[0]  # it ends where the speeds are noise, before its time
    assert len(left) < 3.0 * rules.rate
    assert kept[len(left) - 1] > 10.0 * left[-1]
    written = np.array(braked.written)[at:]
    assert not written[0].any()  # zero, in the tick of the trip
    assert np.abs(written).max() <= rules.commands[:, 0].min()
    assert np.abs(np.diff(written, axis=0)).max() <= rate / rules.rate * (1 + 1e-9)
    assert not braked.plant.telemetry()["applied." + rules.actuators[0]]


def test_a_motion_beyond_its_limit_is_braked():
    """The limit is passed by speed; under zero the rig goes as far as its springs let it."""

    def beyond(kind):
        rules, twin = rules_of("cart", 500.0, kind)
        plant = Damaged(SimulatedPlant(twin))
        step = lambda tick, _: np.array([0.2 if (tick // 250) % 2 else -0.2])  # noqa: E731
        ran = run_rig(step, plant, Settings(500.0, lockstep=True), samples=5000, limits=rules)
        return ran, plant

    ran, braked = beyond("brake")
    assert (ran.reason, ran.trip.cause) == ("tripped", Cause.POSITION_LIMIT)
    at = braked.ticks.index(ran.trip.tick)
    left = energy("cart", braked.states)[at + UNDER_WAY :]
    assert risen(left) < NOISE
    assert left[-1] < 0.01 * left[0]
    assert beyond("zero")[1].ticks[-1] == ran.trip.tick
    assert ran.index[-1] == braked.ticks[-1]  # the rows of the stop are in the record of the run
    assert not ran.table[ran.index > ran.trip.tick, 2].any()  # and none was answered by the controller


@pytest.mark.parametrize("kind", ["hold", "brake"])
def test_after_a_fault_of_a_sensor_commands_are_zero_at_once(kind):
    def reading(tick, values):
        values[0] += 30.0 if tick >= 800 else 0.0

    run, plant, _, _ = stopped("cart", kind, reading=reading)
    assert (run.trip.cause, plant.ticks[-1]) == (Cause.SENSOR_JUMP, 800)
    assert not plant.written[-1].any()


@pytest.mark.parametrize("kind", ["hold", "brake"])
def test_a_second_fault_in_a_stop_is_zero_at_once(kind):
    at = CASES["cart"][3] + 50

    def reading(tick, values):
        values[0] += 30.0 if tick >= at else 0.0

    def pressed(tick, _):
        if tick == at:
            raise EmergencyStopError("pressed")

    for damage in ({"reading": reading}, {"emergency": at}, {"reading": pressed}):
        run, plant, _, _ = stopped("cart", kind, **damage)
        assert run.trip.cause is Cause.CONTROLLER_EXCEPTION  # the first one stays
        assert at - 1 <= plant.ticks[-1] <= at + 1
        assert plant.written[at - 2].any()
        assert not plant.written[-1].any() or damage.get("reading") is pressed
        assert plant.plant.telemetry()["applied.u"] == 0.0


def test_the_last_command_is_held_for_its_time_and_no_longer():
    run, plant, rules, at = stopped("cart", "hold", time=0.5)
    written = np.array(plant.written)[:, 0]
    assert written[at - 1] != 0.0
    assert written[at:].tolist() == [written[at - 1]] * (1 + round(0.5 * rules.rate))
    assert run.applied[at:, 0].tolist() == written[at:].tolist()
    assert plant.plant.telemetry()["applied.u"] == 0.0


@pytest.mark.parametrize("is_interrupted", [False, True])
def test_a_run_that_ends_in_order_is_braked_and_stays_what_it_was(tmp_path, is_interrupted):
    cart = Experiment.load("cart_van_der_pol").changed(duration=10)
    braked = on_a_plant(cart, tmp_path, lambda declared: declared["limits"].update(stop="brake"))
    plants = [Damaged(SimulatedPlant(cart.twin)) for _ in range(2)]

    def interrupt(plant):
        if is_interrupted and len(plant.ticks) >= 1300:
            os.kill(os.getpid(), signal.SIGINT)

    settings = [
        rig_run.RunSettings(lockstep=True, progress=lambda _, plant=plant: interrupt(plant)) for plant in plants
    ]
    found = [rig_run.run(*each) for each in zip((cart, braked), plants, settings, strict=True)]
    assert [one.manifest["rig"]["end"] for one in found] == ["interrupted" if is_interrupted else "finished"] * 2
    assert np.array_equal(found[0].array("rig"), found[1].array("rig"))  # the record of the run is the same
    end = len(plants[0].ticks)
    left = energy("cart", plants[1].states)[end + UNDER_WAY :]
    assert left[-1] < 0.01 * left[0]
    assert risen(left) < NOISE


def test_a_served_plant_brakes_by_itself_whoever_drives_it(tmp_path):
    """The controller has no limits and goes on pushing; the server brakes first, then says why, and is at zero."""
    declared, _ = rules_of("cart", 500.0, "brake")
    twin = Twin.load("cart")
    limits = twin.declaration.limits.model_copy(update={"stop": ControlledStop(kind="brake", time=3.0)})
    known = dataclasses.replace(Instruments.of(twin), plant=twin.declaration.model_copy(update={"limits": limits}))
    guard = PlantLimits(partial(safety_limits.limits, known))
    with (
        served(SimulatedPlant(twin), clock="lockstep", record=tmp_path, guard=guard) as (address, folders),
        pytest.raises(PlantLostError, match=r"POSITION_LIMIT: x is -?25"),
    ):
        run_rig(
            lambda tick, _: np.array([0.2 if (tick // 250) % 2 else -0.2]), UdpPlant(address, patience=20.0),
            Settings(500.0, lockstep=True), samples=5000, limits=np.array([9.0]),
        )  # fmt: skip
    own = Recording.load(folders[0])
    at = int(np.flatnonzero(np.abs(own["plant.x"]) > 0.025)[0])
    left = energy("cart", np.column_stack([own["plant.x"], own["plant.x'"]]))[at + 2 * UNDER_WAY :]
    assert risen(left) < NOISE
    assert left[-1] < 0.01 * left[0]
    assert np.abs(own["input.u"]).max() <= declared.commands[0, 0]
    assert own["input.u"][-1] == 0.0


def test_a_brake_needs_sensors_and_actuators_of_every_coordinate():
    with pytest.raises(ModelError, match="'stop: brake' needs sensors that read every coordinate and actuators"):
        rules_of("cart_pendulum", 500.0, "brake")  # nothing drives the pendulum


def test_a_stop_of_another_kind_is_refused_where_it_is_written(tmp_path):
    cart = Experiment.load("cart_van_der_pol")
    for wrong in ("coast", {"kind": "brake", "time": 0}):
        with pytest.raises(DeclarationError, match=r"plant.yaml:\d+:\d+: limits.stop"):
            on_a_plant(cart, tmp_path, lambda declared, wrong=wrong: declared["limits"].update(stop=wrong))
    assert json.loads((tmp_path / "plant.yaml").read_text(encoding="utf-8"))["limits"]["stop"] == wrong
