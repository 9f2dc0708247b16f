"""Faults 1 to 8, 31, 32 and 34: of sensors, of the motion and of the controller, in lockstep on a served twin."""

from __future__ import annotations

import contextlib
import json
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.errors import PlantError
from masking.lab.plants.interface import Settings
from masking.lab.plants.safety_chain import Chain
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs.realtime import Hooks, RigRun, run_rig
from tests.campaigns.bench import Bench, Ended
from tests.campaigns.damage import Damaged
from tests.campaigns.table import Fault, Judgement
from tests.campaigns.twins import RATE, rules, small, twin

_AT: Final = 250  # tick of the fault
_SENSORS: Final = 3
_JUMP: Final = 0.4  # V, 2 mm
_SPEED: Final = 0.1  # m/s
_PHASES: Final = (200, 235, 270, 305, 340)  # ticks at which a sensor sticks
_HEATED: Final = 0.8  # V that an actuator may take where its heat is tested
_POWER, _HEATING, _ASKED = 8.0, 45.35, 12.0  # W, W/V**2, W
_WINDOW: Final = 10_000  # ticks, 10 s
_RATE: Final = 50.0  # V/s


def _inputs(ended: Ended) -> Array:
    return np.asarray(ended.own.array("input"))


def _at_zero(ended: Ended, judgement: Judgement) -> None:
    """Demand that the plant got finite commands alone, and zero from the tick of the trip on."""
    tick, inputs = ended.own["tick"], _inputs(ended)
    judgement.need(np.isfinite(inputs).all(), "the plant got a command that is not finite")
    judgement.need(not inputs[tick >= ended.tick].any(), "the plant got a command after the trip")


def _trips(ended: Ended, cause: str, within: int, judgement: Judgement, at: int = _AT) -> None:
    """Demand a trip for a cause within a number of ticks of the fault."""
    later = ended.tick - at
    judgement.need(ended.cause == cause, f"ended as {ended.cause or ended.run.reason}, not {cause}")
    judgement.need(0 <= later <= within, f"{later} ticks after the fault, more than {within}")
    _at_zero(ended, judgement)
    judgement.say(f"{ended.cause} {later} ticks after it")


def _not_finite(bench: Bench, judgement: Judgement) -> None:
    for value in ("nan", "inf", "-inf"):
        damage = {"what": "set", "channel": 1, "at": _AT, "value": value}
        _trips(bench.run(damage=damage), "SENSOR_NONFINITE", 0, judgement)


def _moving(channel: int, tick: int, _: Array) -> Array:
    """Answer a tick as a controller does that moves what a sensor measures by about 3 mm."""
    largest = np.where(np.arange(_SENSORS) == channel, (0.05, 0.05, 0.3)[channel], 0.0)
    return np.asarray(largest * np.sin(2.0 * np.pi * 3.0 * tick / RATE))


def _stuck(bench: Bench, judgement: Judgement) -> None:
    for channel in range(_SENSORS):
        later = []
        for at in _PHASES:
            ended = bench.run(
                partial(_moving, channel), damage={"what": "hold", "channel": channel, "at": at}, samples=600
            )
            later.append(ended.tick - at)
            judgement.need(ended.cause == "SENSOR_STUCK", f"s{channel + 1}: {ended.cause or ended.run.reason}")
            _at_zero(ended, judgement)
        judgement.need(max(later) <= 0.05 * RATE, f"s{channel + 1}: {max(later)} ms")
        judgement.say(f"s{channel + 1}: {min(later)} to {max(later)} ms")
    seconds = 60 if bench.is_quick else 3600
    chain, random = Chain(rules()), np.random.default_rng(4)
    step, command = 20.0 / 65536.0, np.zeros(_SENSORS)
    for second in range(seconds):
        # a third of the time without noise, between two steps; else with less of it than a step
        noise = 1e-4 * random.standard_normal((int(RATE), _SENSORS)) * (second >= seconds // 3)
        for k, reading in enumerate(np.round(noise / step) * step):
            chain.watch(second * int(RATE) + k, reading)
            chain.guard(second * int(RATE) + k, command)
    judgement.need(chain.trip is None, f"false trip at rest: {chain.trip}")
    judgement.say(f"no false trip in {seconds} s of quantised rest" if chain.trip is None else "a false trip")


def _jump(bench: Bench, judgement: Judgement) -> None:
    for channel in range(_SENSORS):
        damage = {"what": "add", "channel": channel, "at": _AT, "value": _JUMP}
        _trips(bench.run(damage=damage), "SENSOR_JUMP", 1, judgement)


def _rail(bench: Bench, judgement: Judgement) -> None:
    for value in (10.0, -10.0):
        damage = {"what": "set", "channel": 0, "at": _AT, "value": value}
        _trips(bench.run(damage=damage), "SENSOR_RANGE", 1, judgement)


def _unstable(largest: float) -> tuple[list[Array], partial[Array]]:
    """Return a controller that makes the rig move as an oscillator with negative damping, and what it remembers."""
    past: list[Array] = []
    return past, partial(_negative_damping, past, largest)


def _negative_damping(past: list[Array], largest: float, tick: int, readings: Array) -> Array:
    past.append(readings.copy())
    rate = (readings - past[max(0, len(past) - 11)]) * RATE / 10.0
    wanted = 0.03 * rate + 0.1 * (tick < 100)
    wanted[2] = 0.0
    return np.clip(wanted, -largest, largest)


def _excess(bench: Bench, judgement: Judgement, *, speed: float) -> None:
    _, step = _unstable(0.2)
    ended = bench.run(step, samples=20_000, held=rules(speed=speed) if speed else None)
    cause = "VELOCITY_LIMIT" if speed else "POSITION_LIMIT"
    judgement.need(ended.cause == cause, f"ended as {ended.cause or ended.run.reason}, not {cause}")
    _at_zero(ended, judgement)
    own = ended.own
    where = [np.abs(own[f"plant.x{i}"] - own["plant.x3"]) for i in (1, 2)]
    rates = [np.abs(own[f"plant.x{i}'"] - own["plant.x3'"]) for i in (1, 2)]
    looked = rates if speed else where
    changes = [np.abs(np.diff(rate)).max() * RATE for rate in rates] if speed else [rate.max() for rate in rates]
    limit, unit, scale = (speed, "mm/s", 1e3) if speed else (0.005, "mm", 1e3)
    peak = max(float(x.max()) for x in looked)
    most = limit + max(changes) * 2.0 / RATE
    judgement.need(peak <= most, f"peak {peak * scale:.4g} {unit}, more than {most * scale:.4g}")
    judgement.say(f"{ended.cause}: peak {peak * scale:.4g} {unit}, at most {most * scale:.4g}")


def _heat(bench: Bench, judgement: Judgement) -> None:
    amplitude = np.sqrt(2.0 * _ASKED / _HEATING)

    def step(tick: int, _: Array) -> Array:
        return np.array([0.0, 0.0, amplitude * np.sin(2.0 * np.pi * 100.0 * tick / RATE)])

    ended = bench.run(step, samples=2 * _WINDOW, held=rules("linear_rig", largest=_HEATED), plant="linear_rig")
    power = _HEATING * ended.own["input.V3"] ** 2
    padded = np.concatenate([power, np.zeros(_WINDOW)])
    mean = float(np.convolve(padded, np.full(_WINDOW, 1.0 / _WINDOW), mode="valid").max())
    judgement.need(ended.cause == "THERMAL", f"ended as {ended.cause or ended.run.reason}, not THERMAL")
    judgement.need(mean <= _POWER * 1.02, f"the mean over 10 s is {mean:.3f} W")
    _at_zero(ended, judgement)
    judgement.say(f"{ended.cause} after {ended.tick / RATE:.2f} s, largest mean over 10 s {mean:.3f} W")


def _controller(bench: Bench, judgement: Judgement) -> None:
    for value in (np.nan, np.inf, 1e300):

        def step(tick: int, readings: Array, value: float = value) -> Array:
            return np.full(_SENSORS, value) if tick >= _AT else small(tick, readings)

        ended = bench.run(step)
        if np.isfinite(value):
            most = float(np.abs(_inputs(ended)).max())
            judgement.need(most <= 0.42, f"the plant got {most:g} V")
            judgement.say(f"1e300 is finite: at most {most:g} V reaches the plant")
            judgement.need(np.isfinite(_inputs(ended)).all(), "the plant got a command that is not finite")
        else:
            _trips(ended, "CONTROLLER_NONFINITE", 0, judgement)


def _rate(bench: Bench, judgement: Judgement) -> None:
    held = rules()
    held = replace(held, commands=held.commands.copy())
    held.commands[:, safety_tables.RATE] = _RATE
    for name, half, cause in (("a jump", 10**6, ""), ("jumps at 100 Hz", 5, "COMMAND_RATE")):

        def step(tick: int, readings: Array, half: int = half) -> Array:
            sign = 0 if tick < _AT else (-1) ** ((tick - _AT) // half)
            return np.array([0.0, 0.0, 0.42 * sign]) if tick < _AT + 40 or half == 5 else small(0, readings)

        ended = bench.run(step, held=held, samples=600)
        change = np.abs(np.diff(ended.own["input.V3"][: ended.tick if cause else -1])).max() * RATE
        judgement.need(ended.cause == cause, f"{name}: ended as {ended.cause or ended.run.reason}")
        judgement.need(change <= _RATE * (1.0 + 1e-9), f"{name}: the plant got a change of {change:.4g} V/s")
        if cause:
            _at_zero(ended, judgement)
            judgement.need(ended.tick - _AT <= 250, f"{ended.tick - _AT} ticks until the trip, more than 250")
        judgement.say(
            f"{name}: at most {change:.4g} V/s, {f'{cause} after {ended.tick - _AT} ms' if cause else 'no trip'}"
        )


def _energy(ended: Ended) -> Array:
    """Return the mechanical energy per mass of the beam in a plant's own record, by the springs of the model."""
    p, own = twin().model.parameter_values(), ended.own
    x, v = ([own[f"plant.x{i}{prime}"] for i in (1, 2, 3)] for prime in ("", "'"))
    parts = [p[f"mu{i}"] * (v[i - 1] ** 2 + p[f"w{i}"] ** 2 * (x[i - 1] - x[2]) ** 2) for i in (1, 2)]
    return np.asarray((parts[0] + parts[1] + v[2] ** 2 + p["w3"] ** 2 * x[2] ** 2) / 2)


def _brakes(bench: Bench, judgement: Judgement) -> None:
    at = 700

    def fails(tick: int, _: Array) -> Array:
        if tick == at:
            raise ZeroDivisionError("the controller was asked to raise")
        return np.full(_SENSORS, 0.03 * np.sin(4.0 * np.pi * tick / RATE) * (tick < at))

    def silent(tick: int, readings: Array) -> Array:
        return fails(tick, readings) if tick < at else np.zeros(_SENSORS)

    free = _energy(bench.run(silent, samples=at + 800))[at + 3 :]
    ended = bench.run(fails, samples=at + 800, held=rules(brakes=True))
    left = _energy(ended)[at + 3 :]
    half = int(0.5 * RATE)
    rise = float((left - np.minimum.accumulate(left)).max() / left[0])
    most = float(np.abs(_inputs(ended)[at:]).max())
    judgement.need(ended.cause == "CONTROLLER_EXCEPTION", f"ended as {ended.cause or ended.run.reason}")
    judgement.need(left[half] < 0.01 * left[0] < 0.1 * free[half], f"{left[half] / left[0]:.2g} of the energy is left")
    judgement.need(rise < 1e-3, f"the energy rises by {rise:.2g} of it")
    judgement.need(most <= 0.42, f"the plant got {most:g} V")
    judgement.need(not _inputs(ended)[-1].any(), "the plant is not at zero")
    judgement.say(f"after 0.5 s {left[half] / left[0]:.1e} of the energy, {free[half] / free[0]:.2g} without a brake")
    jump = bench.run(
        fails,
        samples=at + 800,
        held=rules(brakes=True),
        damage={"what": "add", "channel": 0, "at": at + 100, "value": _JUMP},
    )
    later = int(jump.own["tick"][np.flatnonzero(_inputs(jump).any(axis=1))[-1]]) - at - 100
    judgement.need(jump.cause == "CONTROLLER_EXCEPTION", f"the first cause is {jump.cause}")
    judgement.need(later < 1, f"a command {later} ticks after a sensor jumped in the brake")
    judgement.say("zero in the tick in which a sensor jumps")


def _index(bench: Bench, judgement: Judgement) -> None:
    for value in (-1, -5):
        said = f"gave sample {_AT + value} after sample {_AT - 1}"
        served = bench.run(damage={"what": "index", "at": _AT, "value": value})
        end = served.own.manifest["end"]
        judgement.need(said in end, f"the server does not say '{said}': {end}")
        judgement.need(served.run.reason == "plant lost", f"served: ended as {served.run.reason}, not plant lost")
        judgement.need(served.own["tick"].tolist() == list(range(_AT)), "the plant's own record has other ticks")
        own: list[RigRun] = []
        folder = bench.place()
        folder.mkdir(parents=True)
        (folder / "damage.json").write_text(json.dumps({"what": "index", "at": _AT, "value": value}), encoding="utf-8")
        plant = Damaged(SimulatedPlant(twin()), folder / "damage.json")
        with contextlib.suppress(PlantError):
            run_rig(
                small, plant, Settings(RATE, lockstep=True), samples=400, limits=rules(), hooks=Hooks(on_end=own.append)
            )
        ran = own[0]
        cause, detail = ("none", "") if ran.trip is None else (ran.trip.cause.name, ran.trip.detail)
        judgement.need(cause == "PLANT_ERROR" and said in detail, f"ended as {cause}: '{detail}'")
        judgement.need(ran.index.tolist() == list(range(_AT)), "the rows before it are not all there")
        judgement.say(f"{value:+d}: refused at once, {len(ran.index)} rows kept")


FAULTS: Final = (
    Fault(1, "sensor NaN / Inf", "SENSOR_NONFINITE in the same tick; never reaches write()", _not_finite),
    Fault(2, "sensor stuck", "SENSOR_STUCK within 50 ms; none in 1 h of quantised rest", _stuck),
    Fault(3, "sensor jumps by 2 mm in a sample", "SENSOR_JUMP within 1 tick", _jump),
    Fault(4, "sensor at its rail", "SENSOR_RANGE within 1 tick", _rail),
    Fault(5, "excess motion", "POSITION_LIMIT; peak <= limit + v * 2 ticks", partial(_excess, speed=0.0)),
    Fault(6, "excess speed", "VELOCITY_LIMIT; peak <= limit + a * 2 ticks", partial(_excess, speed=_SPEED)),
    Fault(7, "12 W RMS asked of 8 W", "8 W, then THERMAL; mean over 10 s <= 8 W + 2 %", _heat),
    Fault(8, "controller emits NaN / Inf / 1e300", "CONTROLLER_NONFINITE; finite in every tick", _controller),
    Fault(31, "index of a sample repeats, goes back", "refused with both indices; every row before is kept", _index),
    Fault(32, "command jumps by 0.42 V, once / always", "at most 50 V/s; COMMAND_RATE after 0.25 s of it", _rate),
    Fault(
        34, "trip at speed, with a brake; then a jump", "99 % of the energy gone in 0.5 s, never more; zero", _brakes
    ),
)
