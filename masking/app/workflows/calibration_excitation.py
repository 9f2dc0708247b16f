"""Records of a calibration: what a rig reads under multisines that stay within the limits of its plant file.

Three are made, each by multisines of least crest factor on all actuators at once, on lines of their own: a small one,
which says how large the others may be, one to fit, and one for validation. They stay on disk, each with its settings,
so that an interrupted calibration resumes where it stopped.
Source: Rijlaarsdam (2008), section 4.2 and appendix C.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.errors import MaskingError, RecordError
from masking.inference.estimation.fit import part_of
from masking.inference.estimation.identification_data import Data
from masking.inference.procedures.calibration_findings import HIGHEST, NAMES, PERIOD, Records, reached
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.safety_chain import Rules
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records.recording import MANIFEST, Recording
from masking.lab.runs import safety_limits
from masking.lab.runs.realtime import Hooks, check_channels, every, run_rig
from masking.lab.runs.stopping import FINISHED
from masking.lab.signals import Multisine, minimise_crest

RATE: Final = 1000.0
PART: Final = 0.8  # of a limit that a record may reach
SMALL: Final = 0.02  # of the largest command: the first record
STARTS: Final = 5  # of the search for a small crest factor
SEED: Final = 0  # of the phases; records made with others are not mixed
_REMEDY = "calibrate that plant, or give the plant file of the one that is there"
_DIGITS = 9  # of a number that shows whether a twin is the same

Say = Callable[[str], None]
Progress = Callable[[float], None]


def make(
    twin: Twin, plant: Plant, folder: Path, *, seconds: float, lockstep: bool, say: Say, progress: Progress
) -> Records:
    """Make the records that are not in a folder yet, of some seconds each, and read them all.

    Raises:
        ModelError: the plant file has no limits to stay within.
        PlantError: the plant is lost, refuses, or has other channels.
        MaskingError: a recording was interrupted.
        RecordError: the rig does not move, or a record in the folder cannot be read or was made with other settings.
    """
    instruments = replace(Instruments.of(twin), noise={})
    limits, size = instruments.limits()[:, LARGEST], SMALL
    rules = safety_limits.without_model(safety_limits.rules(instruments, RATE, twin))
    made: list[Data] = []
    missed = {}
    for number, name in enumerate(NAMES):
        path = folder / name
        settings = _settings(plant, limits, seconds=seconds, size=size, twin=twin)
        if (path / MANIFEST).exists():
            recording = Recording.load(path)
            _check(recording.manifest.get("calibration"), settings, path)
            say(f"{name}: recorded before")
        else:
            say(f"{name}: recording {seconds:g} s")
            commands = size * limits * _waves(len(limits), number, seconds)
            part = part_of(progress, number, len(NAMES))
            _record(twin, plant, commands, rules, settings, lockstep=lockstep, part=part).save(path, overwrite=True)
            recording = Recording.load(path)
        missed[name] = int(recording.manifest["rig"]["counters"].get("missed", 0))
        made.append(Data.of(recording, twin, str(path)))
        if not number:
            size = _larger(twin, made[0])
            say(f"up to {size:.0%} of the largest command")
        progress((number + 1) / len(NAMES))
    _, fit, unseen = made
    return Records(fit, unseen, size, limits, missed)


def _settings(plant: Plant, limits: Array, *, seconds: float, size: float, twin: Twin) -> dict[str, Any]:
    """Settings of a record, as JSON can hold them; of a simulated rig with a digest of its twin."""
    found = {
        "seconds": seconds,
        "seed": SEED,
        "size": size,
        "limits": dict(zip(twin.actuators, map(float, limits), strict=True)),
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
    other = [name for name in dict.fromkeys([*now, *before]) if before.get(name) != now.get(name)]
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


def _waves(count: int, number: int, seconds: float) -> Array:
    """Multisines with peak 1 (samples, count): lines in turn, which go round from record to record."""
    t = np.arange(round(seconds * RATE)) / RATE
    columns = []
    for i in range(count):
        lines = np.arange(1 + (i + number) % count, round(HIGHEST * PERIOD) + 1, count)
        found = minimise_crest(Multisine.harmonic(lines, PERIOD), starts=STARTS, seed=SEED + count * number + i)
        wave = found.sample(t)
        columns.append(wave / np.abs(wave).max())
    return np.array(columns).T


def _larger(twin: Twin, small: Data) -> float:
    """Part of the largest command at which the first limit of a coordinate would be reached, and no more."""
    if not np.ptp(small.readings, axis=0).any():
        raise RecordError(f"{small.name}: the sensors read the same throughout; look at the rig's power and cables")
    pairs = reached(twin, small).values()
    size = min([PART, *(PART * SMALL * limit / max(far, 1e-300) for far, limit in pairs)])
    return max(size, SMALL)


def _record(
    twin: Twin, plant: Plant, commands: Array, rules: Rules, settings: dict[str, Any], *, lockstep: bool, part: Progress
) -> Recording:
    """Recording of a plant under commands (samples, actuators); missed readings are interpolated."""
    first: list[int] = []

    def step(tick: int, readings: Array) -> Array:
        del readings
        first[:] = first or [tick]
        command: Array = commands[min(tick - first[0], len(commands) - 1)]
        return command

    whose = f"the calibration is for {Path(next(iter(twin.declaration.files), twin.declaration.name)).stem}"
    hooks = Hooks(
        lambda found: check_channels(found, twin.sensors, twin.actuators, whose, _REMEDY),
        on_tick=every(part, len(commands)),
    )
    ran = run_rig(step, plant, Settings(RATE, lockstep=lockstep), samples=len(commands), limits=rules, hooks=hooks)
    if ran.reason != FINISHED:
        why = f"{ran.reason} ({ran.trip})" if ran.trip else ran.reason
        raise MaskingError(f"the recording was {why} and is not kept; run the same again to go on from here")
    index = ran.index - ran.index[0]
    every_one = np.arange(index[-1] + 1)
    at = np.searchsorted(index, every_one, side="right") - 1  # a command holds until the next
    columns = {"t": every_one / RATE}
    columns |= {f"input.{name}": ran.applied[at, i] for i, name in enumerate(twin.actuators)}
    columns |= {f"sensor.{name}": np.interp(every_one, index, ran.sensors[:, i]) for i, name in enumerate(twin.sensors)}
    outcome = {"end": ran.reason, "counters": dict(ran.counters)}
    return Recording(columns, {"name": "calibration", "rate": RATE, "rig": outcome, "calibration": dict(settings)})
