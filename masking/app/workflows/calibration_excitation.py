"""Records of a calibration: what a rig reads under multisines that stay within the limits of its plant file.

Three are made, each by multisines of least crest factor on all actuators at once, on lines of their own: a small one,
which says how large the others may be, one to fit, and one for validation. They stay on disk, each with its settings,
so that an interrupted calibration resumes where it stopped.
Source: Rijlaarsdam (2008), section 4.2 and appendix C.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST, TIME
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import HoursUsedError, MaskingError, ModelError, RecordError
from masking.inference.estimation.fit import part_of
from masking.inference.estimation.identification_data import Data
from masking.inference.procedures.calibration_findings import HIGHEST, NAMES, PERIOD, Records, reached
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.safety_chain import Cause, Rules
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import MANIFEST, Recording
from masking.lab.runs import safety_limits
from masking.lab.runs.batch_plan import PEOPLE
from masking.lab.runs.holding import Holding
from masking.lab.runs.realtime import Hooks, Look, RigRun, check_channels, every, run_rig
from masking.lab.runs.stopping import FINISHED, STOPPED
from masking.lab.signals import Multisine, minimise_crest

RATE: Final = 1000.0
PART: Final = 0.8  # of a limit that a record may reach
SMALL: Final = 0.02  # of the largest command: the first record, at most
LITTLE: Final = 0.3  # of a limit that the first record reaches, by the plant file, at most
BEGIN: Final = 2.0  # s on the wall's clock in which a run begins and is saved
REST: Final = 1.0  # s that what is held is braked after a run
SMALLER: Final = 0.7  # of its size, with which an excitation is made again that was too large
LEAST: Final = 0.01  # of its size
NEAR: Final = 0.9  # of a limit, within which what nothing holds must be able to come to rest
STILL: Final = 0.01  # of the largest command, that would bring it back to its middle: it is there
QUIET: Final = 0.25  # s for which it must be
# What an excitation does that is too large.
TOO_FAR: Final = {Cause.POSITION_LIMIT, Cause.VELOCITY_LIMIT, Cause.SENSOR_RANGE, Cause.THERMAL, Cause.COMMAND_RATE}
# Of the fastest natural frequency: the excitation ends between these, at HIGHEST where that is between them.
ABOVE: Final = (1.5, 10.0)
PART_OF_RATE: Final = 0.25  # highest frequency that a rate shows
LINES: Final = round(HIGHEST * PERIOD)  # of all actuators, at most: harmonics, or some of them at equal ratios
STARTS: Final = 5  # of the search for a small crest factor
SEED: Final = 0  # of the phases; records made with others are not mixed
_REMEDY = "calibrate that plant, or give the plant file of the one that is there"
_FOUND = ("size", "part")  # settings that the rig itself determines
_DIGITS = 9  # of a number that shows whether a twin is the same

Say = Callable[[str], None]
Progress = Callable[[float], None]


@dataclass
class Rig:
    """A rig that is excited within the limits of its plant file, run after run.

    What no spring holds is held by a controller, so that no excitation drives it away, and braked before its limits are
    reached; a run that its motion ends is made again with less excitation.
    """

    twin: Twin
    plant: Plant
    rate: float = RATE  # Hz
    lockstep: bool = False
    say: Say = lambda text: None
    acknowledge: bool = False  # why the plant tripped in a run before was looked at
    retries: int = 0  # after a trip that is not by its motion
    look: Look | None = None  # called with the safety chain, which it may stop, and the tick of each sample
    used: float = 0.0  # s that the rig was driven
    until: float = math.inf  # s of `now` at which its time is over
    trips: int = 0  # after which a run was made again

    @property
    def now(self) -> float:
        """Time of the rig in s, from any beginning: in lockstep that in which it was driven."""
        return self.used if self.lockstep else time.monotonic()

    @cached_property
    def known(self) -> Instruments:
        """Instruments of the rig."""
        return replace(Instruments.of(self.twin), noise={})

    @cached_property
    def limits(self) -> Array:
        """Largest command of each actuator (actuators,)."""
        return self.known.limits()[:, LARGEST]

    @cached_property
    def holding(self) -> Holding | None:
        """Controller of what no spring holds; None where there is nothing to hold."""
        return Holding.of(Instruments.of(self.twin), self.rate, PERIOD)

    @cached_property
    def rules(self) -> Rules:
        """Rules of its runs; what nothing holds is braked after them."""
        made = safety_limits.without_model(safety_limits.rules(self.known, self.rate, self.twin))
        return made if self.holding is None else replace(made, stop=self.holding.stop(REST))

    @property
    def beside(self) -> float:
        """Seconds that a record takes at most besides its commands, where it is not made again."""
        held = 0.0 if self.holding is None else self.holding.seconds + 2.0 * REST
        return held + (0.0 if self.lockstep else BEGIN)

    @cached_property
    def highest(self) -> float:
        """Highest frequency of the excitation in Hz, by the fastest motion of the plant file and the rate."""
        n = len(self.known.model.coordinates)
        squares = np.abs(np.linalg.eigvals(self.known.linear()[0][n:, :n]))
        fastest = math.sqrt(float(squares.max(initial=0.0))) / (2.0 * math.pi)
        wanted = max(ABOVE[0] * fastest, min(HIGHEST, ABOVE[1] * fastest)) if fastest > 1.0 / PERIOD else HIGHEST
        return float(
            f"{min(wanted, PART_OF_RATE * self.rate):.{_DIGITS}g}"
        )  # the same wherever a record is gone on with

    def waves(self, number: int, seconds: float) -> Array:
        """Multisines with peak 1 (samples, actuators): lines in turn, which go round from record to record."""
        t, columns, count = np.arange(round(seconds * self.rate)) / self.rate, list[Array](), len(self.limits)
        top = max(count, round(self.highest * PERIOD))
        lines = np.arange(1, top + 1)
        if top > LINES:
            lines = np.unique(np.round(np.geomspace(1.0, top, LINES)).astype(int))
        for i in range(count):
            own = lines[(i + number) % count :: count]
            found = minimise_crest(Multisine.harmonic(own, PERIOD), starts=STARTS, seed=SEED + count * number + i)
            wave = found.sample(t)
            columns.append(wave / np.abs(wave).max())
        return np.array(columns).T

    def first_size(self, waves: Array) -> float:
        """Part of the largest command that is small for waves of peak 1 (samples, actuators), by the plant file."""
        ideal = Rig(self.twin, SimulatedPlant(self.twin), self.rate, lockstep=True)
        try:
            made = ideal.record(SMALL * self.limits * waves, {})
        except MaskingError as error:
            why = f"its twin does not rest within its limits under {SMALL:.0%} of the largest commands ({error})"
            raise ModelError(f"{self.twin.declaration.name}: {why}; correct the plant file") from error
        pairs = reached(self.twin, Data.of(made, self.twin, "simulated")).values()
        most = SMALL * float(made.manifest["calibration"]["part"]) * LITTLE
        return min([SMALL, *(most * limit / max(far, 1e-300) for far, limit in pairs)])

    def record(self, commands: Array, settings: Mapping[str, Any], progress: Progress = lambda part: None) -> Recording:
        """Recording under commands (samples, actuators), or the part of these that the rig could follow.

        What nothing holds is brought back to its middle before, and a rig that is too warm rests for the time over
        which its power is a mean. Missed readings are interpolated; what holds a rig is part of its commands. Raises a
        HoursUsedError where the rig's time is over, a MaskingError where the run was interrupted or tripped, and a
        PlantError where the plant is lost, refuses, or has other channels.
        """
        size, retries, wait = 1.0, self.retries, 0.0
        while True:
            ran, is_driven = self.rest(wait), False
            if ran is None or ran.reason in {FINISHED, STOPPED}:
                ran, is_driven = self._run(size * commands, progress, self._passes), True
            cause = Cause.POSITION_LIMIT if ran.reason == STOPPED else None if ran.trip is None else ran.trip.cause
            is_smaller = is_driven and cause in TOO_FAR and size > LEAST and bool(commands.any())
            is_retried = cause is not None and cause not in TOO_FAR and cause.name not in PEOPLE and retries > 0
            if not is_smaller and not is_retried:
                break
            size, retries = (SMALLER * size, retries) if is_smaller else (size, retries - 1)
            wait = self.cooling(str(cause and cause.name))
            self.trips, self.acknowledge = self.trips + 1, True
            what = [f" with {SMALLER:g} of the excitation"] * is_smaller + [f" after {wait:g} s of rest"] * (wait > 0.0)
            self.say(f"once more{' and'.join(what)}: {ran.trip or 'it would have passed a position limit'}")
        if ran.reason != FINISHED:
            why = f"{ran.reason} ({ran.trip})" if ran.trip else ran.reason
            where = "; bring the rig to the middle of its limits by hand" if not is_driven and cause in TOO_FAR else ""
            raise MaskingError(f"the recording was {why} and is not kept{where}; run the same again to go on from here")
        return _recording(self.twin, ran, self.rate, {**settings, "part": size})

    def cooling(self, cause: str | None) -> float:
        """Seconds of rest after a trip by a cause: those over which a power is a mean, where it was too large."""
        return float(self.known.limits()[:, TIME].max()) if cause == Cause.THERMAL.name else 0.0

    def rest(self, seconds: float) -> RigRun | None:
        """Let a rig rest for some seconds, and bring what nothing holds back to its middle; None where neither is."""
        holding, quiet = self.holding, 0
        longest = seconds if holding is None else seconds + holding.seconds

        def is_back(readings: Array) -> bool:
            nonlocal quiet
            assert holding is not None  # noqa: S101  # else it is not called
            quiet = quiet + 1 if (holding.left(readings) < STILL * self.limits).all() else 0
            return not seconds and quiet >= QUIET * self.rate

        zero = np.zeros((max(1, round(longest * self.rate)), len(self.limits)))
        return self._run(zero, lambda part: None, is_back) if longest else None

    def _passes(self, readings: Array) -> bool:
        """Whether a rig that nothing holds, braked from now on, would come near a limit of its position."""
        assert self.holding is not None  # noqa: S101  # else it is not called
        rules = self.rules
        at = rules.weights @ self.holding.braked(readings, self.limits) + rules.limits[:, safety_tables.AT_ZERO]
        is_position = rules.limits[:, safety_tables.OVER] == 0.0
        return bool((np.abs(at) > NEAR * rules.limits[:, safety_tables.BOUND])[is_position].any())

    def _run(self, commands: Array, progress: Progress, ends: Callable[[Array], bool]) -> RigRun:
        """Run of commands (samples, actuators), which `ends` ends by the readings where a controller holds the rig."""
        needed, left = len(commands) / self.rate + (REST if self.holding else 0.0), self.until - self.now
        if needed > left:
            raise HoursUsedError(f"{needed:.0f} s more of the rig are needed, and {max(0.0, left):.0f} s are left")
        first, holding, largest, is_over = list[int](), self.holding, self.limits, False

        def step(tick: int, readings: Array) -> Array:
            nonlocal is_over
            first[:] = first or [tick]
            command: Array = commands[min(tick - first[0], len(commands) - 1)]
            if holding is None:
                return command
            command = np.clip(command + holding.step(readings), -largest, largest)
            is_over = is_over or ends(readings)
            return command

        if holding is not None:
            holding.reset()
        declared = self.twin.declaration
        whose = f"the calibration is for {Path(next(iter(declared.files), declared.name)).stem}"
        hooks = Hooks(
            lambda found: check_channels(found, self.twin.sensors, self.twin.actuators, whose, _REMEDY),
            on_tick=every(progress, len(commands)),
            stop=lambda: is_over,
            look=self.look,
        )
        settings = Settings(self.rate, lockstep=self.lockstep, acknowledge=self.acknowledge)
        ran = run_rig(step, self.plant, settings, samples=len(commands), limits=self.rules, hooks=hooks)
        self.used += len(ran.index) / self.rate
        return ran


def check(twin: Twin, seconds: float) -> None:
    """Refuse, with a `ModelError`, records without sensors, or shorter than a period of the excitation, or endless."""
    if not twin.sensors:
        raise ModelError(f"{twin.declaration.name}: no sensor shows what an actuator does; declare some under sensors")
    if not PERIOD <= seconds < math.inf:
        kind = "shorter than the excitation's period" if seconds < PERIOD else "no records"
        raise ModelError(f"records of {seconds:g} s are {kind}; give at least {PERIOD:g} s")


def make(rig: Rig, folder: Path, *, seconds: float, progress: Progress) -> Records:
    """Make the records that are not in a folder yet, of some seconds each, and read them all.

    Raises:
        ModelError: the plant file has no limits to stay within.
        PlantError: the plant is lost, refuses, or has other channels.
        MaskingError: a recording was interrupted.
        RecordError: the rig does not move, or a record in the folder cannot be read or was made with other settings.
    """
    twin, limits, say = rig.twin, rig.limits, rig.say
    made: list[Data] = []
    missed, size = {}, 0.0
    for number, name in enumerate(NAMES):
        path = folder / name
        settings = _settings(rig, seconds)
        if (path / MANIFEST).exists():
            recording = Recording.load(path)
            _check(recording.manifest.get("calibration"), settings, path)
            say(f"{name}: recorded before")
        else:
            say(f"{name}: recording {seconds:g} s")
            made_of = rig.waves(number, seconds)
            size = size or rig.first_size(made_of)
            part = part_of(progress, number, len(NAMES))
            recording = rig.record(size * limits * made_of, settings | {"size": size}, part)
            recording.save(path, overwrite=True)
            recording = Recording.load(path)
        own = recording.manifest["calibration"]
        size = own["size"] * own["part"]
        missed[name] = int(recording.manifest["rig"]["counters"].get("missed", 0))
        made.append(Data.of(recording, twin, str(path)))
        if not number:
            size = _larger(twin, made[0], size)
            say(f"up to {size:.2g} of the largest command")
        progress((number + 1) / len(NAMES))
    _, fit, unseen = made
    return Records(fit, unseen, size, limits, missed, rig.highest)


def _settings(rig: Rig, seconds: float) -> dict[str, Any]:
    """Settings of a record, as JSON can hold them; of a simulated rig with a digest of its twin."""
    twin, plant = rig.twin, rig.plant
    found = {
        "seconds": seconds,
        "rate": rig.rate,
        "seed": SEED,
        "highest": rig.highest,
        "limits": dict(zip(twin.actuators, map(float, rig.limits), strict=True)),
        "sensors": list(twin.sensors),
    }
    if isinstance(plant, SimulatedPlant):
        values = [f"{value:.{_DIGITS}g}" for value in plant.twin.values()]
        content = json.dumps([plant.twin.structure(), values, plant.twin.late(1.0).tolist(), plant.seed])
        found["twin"] = hashlib.sha256(content.encode()).hexdigest()[:16]
    return found


def _check(before: Mapping[str, Any] | None, now: Mapping[str, Any], path: Path) -> None:
    """Refuse a record that was made with other settings."""
    remedy = f"give another folder with --out, or delete {path.parent} to record anew"
    if before is None:
        raise RecordError(f"{path} does not say with which settings it was recorded; {remedy}")
    names = dict.fromkeys([*now, *before])
    other = [name for name in names if name not in _FOUND and before.get(name) != now.get(name)]
    if other:
        differences = ", ".join(_difference(name, before.get(name), now.get(name)) for name in other)
        raise RecordError(f"{path} was recorded with other settings: {differences}; {remedy}")


def _difference(name: str, before: object, now: object) -> str:
    if name != "twin":
        return f"{name} {_shown(before)} instead of {_shown(now)}"
    if before is None:
        return "of a rig, not of a twin"
    return "of a twin, not of a rig" if now is None else "of another twin"


def _shown(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    return ", ".join(value) if isinstance(value, list) else f"{value:.6g}" if isinstance(value, float) else str(value)


def _larger(twin: Twin, small: Data, size: float) -> float:
    """Part of the largest command at which the first limit of a coordinate would be reached, and no more."""
    if not np.ptp(small.readings, axis=0).any():
        raise RecordError(f"{small.name}: the sensors read the same throughout; look at the rig's power and cables")
    pairs = reached(twin, small).values()
    return min([PART, *(PART * size * limit / max(far, 1e-300) for far, limit in pairs)])


def _recording(twin: Twin, ran: RigRun, rate: float, settings: Mapping[str, Any]) -> Recording:
    """Recording of a run, with a row for each tick."""
    index = ran.index - ran.index[0]
    every_one = np.arange(index[-1] + 1)
    at = np.searchsorted(index, every_one, side="right") - 1  # a command holds until the next
    columns = {"t": every_one / rate}
    columns |= {f"input.{name}": ran.applied[at, i] for i, name in enumerate(twin.actuators)}
    columns |= {f"sensor.{name}": np.interp(every_one, index, ran.sensors[:, i]) for i, name in enumerate(twin.sensors)}
    outcome = {"end": ran.reason, "counters": dict(ran.counters)}
    return Recording(columns, {"name": "calibration", "rate": rate, "rig": outcome, "calibration": dict(settings)})
