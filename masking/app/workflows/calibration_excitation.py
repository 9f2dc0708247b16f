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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, ModelError, RecordError
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
from masking.lab.runs.stopping import FINISHED
from masking.lab.signals import Multisine, minimise_crest

RATE: Final = 1000.0
PART: Final = 0.8  # of a limit that a record may reach
SMALL: Final = 0.02  # of the largest command: the first record, at most
LITTLE: Final = 0.3  # of a limit that the first record reaches, by the plant file, at most
REST: Final = 1.0  # s that what is held gets to come to rest
SMALLER: Final = 0.7  # of its size, with which an excitation is made again that was too large
LEAST: Final = 0.01  # of its size
# What an excitation does that is too large.
TOO_FAR: Final = {Cause.POSITION_LIMIT, Cause.VELOCITY_LIMIT, Cause.SENSOR_RANGE, Cause.THERMAL, Cause.COMMAND_RATE}
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

    What no spring holds is held by a controller, so that no excitation drives it away; a run that its motion ends is
    made again with less excitation.
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
    trips: int = 0  # after which a run was made again

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

    def first_size(self, waves: Array) -> float:
        """Part of the largest command that is small for waves of peak 1 (samples, actuators), by the plant file."""
        ideal = Rig(self.twin, SimulatedPlant(self.twin), self.rate, lockstep=True)
        made = ideal.record(SMALL * self.limits * waves, {})
        pairs = reached(self.twin, Data.of(made, self.twin, "simulated")).values()
        most = SMALL * float(made.manifest["calibration"]["part"]) * LITTLE
        return min([SMALL, *(most * limit / max(far, 1e-300) for far, limit in pairs)])

    def record(self, commands: Array, settings: Mapping[str, Any], progress: Progress = lambda part: None) -> Recording:
        """Recording under commands (samples, actuators), or the part of these that the rig could follow.

        Missed readings are interpolated; what holds a rig is part of its commands. Raises a MaskingError where the run
        was interrupted or tripped, and a PlantError where the plant is lost, refuses, or has other channels.
        """
        rules = safety_limits.without_model(safety_limits.rules(self.known, self.rate, self.twin))
        if self.holding is not None:
            commands = np.vstack([commands, np.zeros((round(REST * self.rate), len(self.limits)))])
        size, retries = 1.0, self.retries
        while (ran := self._run(size * commands, rules, progress)).trip is not None:
            is_far = ran.trip.cause in TOO_FAR and size > LEAST and bool(commands.any())
            if not is_far and (not retries or ran.trip.cause.name in PEOPLE):
                break
            size, retries = (SMALLER * size, retries) if is_far else (size, retries - 1)
            self.trips, self.acknowledge = self.trips + 1, True
            self.say(f"once more{f' with {SMALLER:g} of the excitation' if is_far else ''}: {ran.trip}")
        if ran.reason != FINISHED:
            why = f"{ran.reason} ({ran.trip})" if ran.trip else ran.reason
            raise MaskingError(f"the recording was {why} and is not kept; run the same again to go on from here")
        return _recording(self.twin, ran, self.rate, {**settings, "part": size})

    def _run(self, commands: Array, rules: Rules, progress: Progress) -> RigRun:
        first, holding, largest = list[int](), self.holding, self.limits

        def step(tick: int, readings: Array) -> Array:
            first[:] = first or [tick]
            command: Array = commands[min(tick - first[0], len(commands) - 1)]
            return command if holding is None else np.clip(command + holding.step(readings), -largest, largest)

        if holding is not None:
            holding.reset()
        declared = self.twin.declaration
        whose = f"the calibration is for {Path(next(iter(declared.files), declared.name)).stem}"
        hooks = Hooks(
            lambda found: check_channels(found, self.twin.sensors, self.twin.actuators, whose, _REMEDY),
            on_tick=every(progress, len(commands)),
            look=self.look,
        )
        settings = Settings(self.rate, lockstep=self.lockstep, acknowledge=self.acknowledge)
        ran = run_rig(step, self.plant, settings, samples=len(commands), limits=rules, hooks=hooks)
        self.used += len(ran.index) / self.rate
        return ran


def check_length(seconds: float) -> None:
    """Refuse records that are shorter than a period of the excitation, or never end, with a `ModelError`."""
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
            made_of = waves(len(limits), number, seconds, rig.rate)
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
    return Records(fit, unseen, size, limits, missed)


def _settings(rig: Rig, seconds: float) -> dict[str, Any]:
    """Settings of a record, as JSON can hold them; of a simulated rig with a digest of its twin."""
    twin, plant = rig.twin, rig.plant
    found = {
        "seconds": seconds,
        "rate": rig.rate,
        "seed": SEED,
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


def waves(count: int, number: int, seconds: float, rate: float) -> Array:
    """Multisines with peak 1 (samples, count): lines in turn, which go round from record to record."""
    t = np.arange(round(seconds * rate)) / rate
    columns = []
    for i in range(count):
        lines = np.arange(1 + (i + number) % count, round(HIGHEST * PERIOD) + 1, count)
        found = minimise_crest(Multisine.harmonic(lines, PERIOD), starts=STARTS, seed=SEED + count * number + i)
        wave = found.sample(t)
        columns.append(wave / np.abs(wave).max())
    return np.array(columns).T


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
