"""Calibration: excite a rig, record it, fit its plant file to the records, and judge the fit by one it has not seen.

Three records are made, each by multisines of least crest factor on all actuators at once, on lines of their own: a
small one, which tells how large the others may be, one to fit, and one to judge by. What has been recorded is kept, so
that a calibration that was interrupted goes on where it stopped.
Source: Rijlaarsdam (2008), section 4.2 and appendix C.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from masking.errors import MaskingError, ModelError, RecordError
from masking.identification import written
from masking.identification.data import Data
from masking.identification.fit import Fit, fit, independent
from masking.kernels import Array
from masking.plants.interface import Plant
from masking.realtime import FINISHED, run_rig
from masking.recording import Recording
from masking.signals import Multisine, minimise_crest
from masking.twin import Twin

RATE = 1000.0
PERIOD = 20.0  # s; the lines are its harmonics
HIGHEST = 4.0  # Hz
PART = 0.8  # of a limit that a record may reach
SMALL = 0.02  # of the largest command: the first record
STARTS = 5  # of the search for a small crest factor
RECORDS = ("small", "fit", "unseen")
# Effects in elements that are fitted where the plant file declares them, each with its parameters.
FITTED = {
    "dry_friction": ("fc",),
    "stribeck_friction": ("fc",),
    "hysteresis": ("k", "zmax"),
    "hardening_spring": ("k3",),
}
Say = Callable[[str], None]


@dataclass(frozen=True)
class Stage:
    """One model of the plant, fitted: what it holds, and the fit."""

    name: str
    fit: Fit


@dataclass(frozen=True)
class Calibration:
    """What a calibration found: stages from the simplest model to the plant file's own, and where it was written."""

    stages: tuple[Stage, ...]
    folder: Path

    @property
    def best(self) -> Stage:
        """Return the stage with the least error in the record that was not fitted."""
        return min(self.stages, key=lambda stage: max(stage.fit.validation.values()))

    def as_dict(self) -> dict[str, Any]:
        """Return the calibration as JSON can hold it."""
        return {
            "stages": {stage.name: stage.fit.as_dict() for stage in self.stages},
            "best": self.best.name,
            "model": str(self.folder / "model.yaml"),
            "plant": str(self.folder / "plant.yaml"),
        }

    def __str__(self) -> str:
        sensors = self.stages[0].fit.chi
        head = ["", *(f"chi {name}" for name in sensors), *(f"unseen {name}" for name in sensors)]
        rows = [
            [stage.name, *(f"{x:.4f}" for chi in (stage.fit.chi, stage.fit.validation) for x in chi.values())]
            for stage in self.stages
        ]
        floor = self.stages[0].fit.floor.values()
        rows.append(["noise alone", *(f"{x:.4f}" for x in floor), *("" for _ in sensors)])
        widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in [head, *rows]]
        lines.append(f"written: {self.folder / 'model.yaml'}, {self.folder / 'plant.yaml'} ({self.best.name})")
        return "\n".join(lines)


def calibrate(
    twin: Twin,
    plant: Plant,
    out: str | Path,
    *,
    model: str | Path | None = None,
    seconds: float = 2.0 * PERIOD,
    lockstep: bool = False,
    seed: int = 0,
    say: Say | None = None,
) -> Calibration:
    """Calibrate a rig.

    Args:
        twin: what the plant file says of it, with the values to begin from.
        plant: the rig.
        out: folder of the records and of the result; records that are there are not made again.
        model: a model to fit between that of the plant file, without effects in its elements, and all of it.
        seconds: length of each record.
        lockstep: run as fast as both sides can, each waiting for the other.
        seed: of the phases.
        say: told what is done.

    Raises:
        ModelError: the plant file has no limits to stay within.
        PlantError: the plant is lost, refuses, or has other channels.
        MaskingError: a recording was interrupted.
        RecordError: the rig does not move, or a record in the folder cannot be read.
    """
    if seconds < PERIOD:
        raise ModelError(
            f"records of {seconds:g} s are shorter than the excitation's period; give at least {PERIOD:g} s"
        )
    twin.validate()
    folder, tell = Path(out), say or (lambda text: None)
    limits = _limits(twin)
    waves = [_waves(twin, number, seconds, seed) for number in range(len(RECORDS))]
    size = SMALL
    made = []
    for name, wave in zip(RECORDS, waves, strict=True):
        path = folder / "records" / name
        if (path / "manifest.json").exists():
            tell(f"{name}: recorded before")
        else:
            tell(f"{name}: recording {seconds:g} s")
            _record(twin, plant, size * limits * wave, limits, lockstep=lockstep).save(path)
        made.append(Data.of(Recording.load(path), twin, str(path)))
        if name == "small":
            size = _larger(twin, made[0], limits)
            tell(f"up to {size:.0%} of the largest command")
    _, train, unseen = made
    stages = []
    for name, wanted, names in _stages(twin, model, train):
        tell(f"fitting {name}: {len(names)} parameters")
        stages.append(Stage(name, fit(wanted, train, names, validation=unseen)))
    found = Calibration(tuple(stages), folder)
    written.save(found.best.fit, folder)
    (folder / "calibration.json").write_text(json.dumps(found.as_dict(), indent=2) + "\n", encoding="utf-8")
    return found


def _limits(twin: Twin) -> Array:
    """Return the largest command of each actuator (actuators,), in its unit."""
    declared, factors = twin.declaration.limits.inputs, twin.kernels.meta["factors"]
    missing = [name for name in twin.actuators if name not in declared]
    if missing:
        raise ModelError(
            f"{twin.declaration.name}: no largest command of {', '.join(missing)}: write it under limits.inputs, so "
            "that the rig is not excited beyond it"
        )
    ports = twin.declaration.actuators or twin.base.inputs
    return np.array([declared[n].max * factors[declared[n].unit] / factors[ports[n].unit] for n in twin.actuators])


def _waves(twin: Twin, number: int, seconds: float, seed: int) -> Array:
    """Return multisines with peak 1 (samples, actuators): lines in turn, which go round from record to record."""
    count = len(twin.actuators)
    t = np.arange(round(seconds * RATE)) / RATE
    columns = []
    for i in range(count):
        lines = np.arange(1 + (i + number) % count, round(HIGHEST * PERIOD) + 1, count)
        wave = minimise_crest(Multisine.harmonic(lines, PERIOD), starts=STARTS, seed=seed + count * number + i).sample(
            t
        )
        columns.append(wave / np.abs(wave).max())
    return np.array(columns).T


def _larger(twin: Twin, small: Data, limits: Array) -> float:
    """Return the part of the largest command at which the first limit of a coordinate would be reached, and no more.

    Coordinates are what the sensors that measure them read; those without a sensor are not looked at.
    """
    factors, size = twin.kernels.meta["factors"], PART
    for what, limit in twin.declaration.limits.coordinates.items():
        for i, sensor in enumerate(twin.declaration.sensors.values()):
            if sensor.measures.text.replace(" ", "") == what.text.replace(" ", ""):
                gain = sensor.gain.value * factors[sensor.gain.unit] / factors[sensor.unit]
                reached = float(np.abs(small.readings[:, i]).max() / abs(gain))
                size = min(size, PART * SMALL * limit.max * factors[limit.unit] / max(reached, 1e-300))
    if not np.ptp(small.readings, axis=0).any():
        raise RecordError(f"{small.name}: the sensors read the same throughout; look at the rig's power and wiring")
    return max(size, SMALL)


def _record(twin: Twin, plant: Plant, commands: Array, limits: Array, *, lockstep: bool) -> Recording:
    """Return what a plant reads under commands (samples, actuators); a sample that is missed has the one before."""
    first: list[int] = []

    def step(tick: int, readings: Array) -> Array:
        del readings
        first[:] = first or [tick]
        command: Array = commands[min(tick - first[0], len(commands) - 1)]
        return command

    ran = run_rig(step, plant, rate=RATE, samples=len(commands), limits=limits, lockstep=lockstep)
    index = ran.index - ran.index[0]
    at = np.searchsorted(index, np.arange(index[-1] + 1), side="right") - 1
    columns = {"t": np.arange(len(at)) / RATE}
    columns |= {f"input.{name}": ran.applied[at, i] for i, name in enumerate(twin.actuators)}
    columns |= {f"sensor.{name}": ran.sensors[at, i] for i, name in enumerate(twin.sensors)}
    if ran.reason != FINISHED:
        raise MaskingError(f"the recording was {ran.reason} and is not kept; run the same again to go on from here")
    told = {"end": ran.reason, "counters": dict(ran.counters)}
    return Recording(columns, {"name": "calibration", "rate": RATE, "rig": told})


def _stages(twin: Twin, model: str | Path | None, record: Data) -> Iterator[tuple[str, Twin, tuple[str, ...]]]:
    """Give the models to fit, from the simplest to all that the plant file declares, with their parameters."""
    base = twin.as_model()
    yield "the model alone", base, independent(base, record, base.equation_parameters())
    if model is not None:
        base = twin.as_model(model)
        yield str(model), base, independent(base, record, base.equation_parameters())
    used = {e.path.removeprefix("effects."): e.kind for e in twin.effects if e.enabled and e.kind in FITTED}
    if used:
        known = {**base.declaration.effects, **{name: twin.declaration.effects[name] for name in used}}
        whole = Twin(base.declaration.model_copy(update={"effects": known}), base.base)
        more = [f"{e.label}_{name}" for e in whole.effects for name in FITTED.get(e.kind, ()) if e.enabled]
        names = independent(whole, record, (*whole.equation_parameters(), *more))
        yield f"with {', '.join(sorted(set(used.values())))}", whole, names
