"""Stages: record a rig, fit models of it, the simplest first, and write the one that an unseen record speaks for.

Source: Rijlaarsdam (2008), section 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from masking.app.workflows import calibration_excitation
from masking.app.workflows.calibration_excitation import Progress, Rig, Say
from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import with_fields_of
from masking.control.rig.twin import Twin
from masking.display.json_text import json_text
from masking.inference.discovery import parameter_prior
from masking.inference.estimation.fit import fit, independent
from masking.inference.procedures.calibration_findings import NAMES, PERIOD, Calibration, Stage
from masking.lab.plants import adapters
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant
from masking.lab.plants.simulated import SimulatedPlant
from masking.reports import calibration_page, model_files

__all__ = ["Calibration", "Stage", "calibrate"]

# What takes time, in parts of a record's own: making one in lockstep, fitting a parameter, and writing the report.
_LOCKSTEP, _PARAMETER, _REPORT = 0.03, 0.01, 0.1
NUMBERS = "calibration.json"


@dataclass(frozen=True, kw_only=True)
class RigCalibration:
    """How a rig at an address is calibrated.

    Args:
        at: address of the rig, such as udp://127.0.0.1:5005 or serial:///dev/ttyACM0; by default the plant's twin.
        key: file of mode 0600 with a key that the server has, too.
        model: a model of the rig to fit beside that of the plant file.
        seconds: length of each record.
        lockstep: each side waits for the other; no clock.
        out: folder of the records and of the result; records that are there are not made again.
        overwrite: whether an earlier result in that folder may be replaced; its records are kept.
        say: called with the step under way.
        progress: called with the fraction done.
    """

    at: str | None = None
    key: str | None = None
    model: str | None = None
    seconds: float = 2.0 * PERIOD
    lockstep: bool = False
    out: str | Path
    overwrite: bool = False
    say: Say | None = None
    progress: Progress | None = None


@with_fields_of(RigCalibration)
def calibrate_at(plant: str, settings: RigCalibration) -> Calibration:
    """Calibrate a rig at an address, or the twin of its plant file.

    Args:
        plant: the rig's plant file, or a packaged plant.
        settings: the fields of `RigCalibration`.
    """
    twin, key = Twin.load(plant), None if settings.key is None else Key.read(settings.key)
    if settings.at:
        return calibrate(twin, adapters.connect(settings.at, key), settings)
    return calibrate(twin, SimulatedPlant(twin), replace(settings, lockstep=True))


def calibrate(twin: Twin, plant: Plant, settings: RigCalibration) -> Calibration:
    """Calibrate a rig.

    Args:
        twin: what the plant file says of it, with the values to begin from.
        plant: the rig.
        settings: all but its address and its key.

    Raises:
        RecordError: the folder cannot be written, or holds an earlier result.
        ModelError: the plant file has no limits to stay within or no sensors, or records are too short.
        PlantError: the plant is lost, refuses, or has other channels.
        MaskingError: a recording was interrupted.
        RecordError: the rig does not move, or a record in the folder cannot be read or was made with other settings.
    """
    seconds, lockstep, progress = settings.seconds, settings.lockstep, settings.progress or (lambda part: None)
    calibration_excitation.check(twin, seconds)
    with own_folder(settings.out, NUMBERS, overwrite=settings.overwrite):
        twin.validate()
        folder, tell = Path(settings.out), settings.say or (lambda text: None)
        candidates = tuple(_candidates(twin, settings.model))
        costs = [len(NAMES) * (_LOCKSTEP if lockstep else 1.0)]
        costs += [*(_PARAMETER * len(shared) for _, _, shared in candidates), _REPORT]
        parts = iter(_parts(progress, costs))
        rig = Rig(twin, plant, lockstep=lockstep, say=tell)
        made = calibration_excitation.make(rig, folder / "records", seconds=seconds, progress=next(parts))
        stages = []
        for (name, base, shared), part in zip(candidates, parts, strict=False):
            names = independent(base, made.fit, shared)
            tell(f"fitting {name}: {len(names)} parameters")
            found = fit(base, made.fit, names, validation=made.unseen, shared=shared, progress=part)
            stages.append(Stage(name, found, shared))
        calibration = Calibration(twin, made, tuple(stages), folder)
        model_files.save_fit(calibration.best.fit, folder, calibration_page.sheet(calibration))
        calibration_page.save(calibration)
        (folder / NUMBERS).write_text(json_text(calibration.as_dict()), encoding="utf-8")
        progress(1.0)
        return calibration


def _parts(progress: Progress, costs: list[float]) -> Iterator[Progress]:
    """Callbacks of several steps, each with the fraction done of its own step."""

    def part(before: float, cost: float) -> Progress:
        return lambda done: progress((before + cost * done) / sum(costs))

    before = 0.0
    for cost in costs:
        yield part(before, cost)
        before += cost


def _candidates(twin: Twin, model: str | Path | None) -> Iterator[tuple[str, Twin, tuple[str, ...]]]:
    """What is fitted, from the simplest model to the whole plant file: its name, the plant that has it, parameters."""
    base = twin.as_model()
    yield "the model alone", base, parameter_prior.uncertain(base)
    if model is not None:
        base = twin.as_model(model)
        yield str(model), base, parameter_prior.uncertain(base)
    used = {e.path.removeprefix("effects."): e.kind for e in twin.effects if e.enabled and e.entry.calibrated}
    if used:
        known = {**base.declaration.effects, **{name: twin.declaration.effects[name] for name in used}}
        changes = {**base.changes, **{name: twin.changes[name] for name in used if name in twin.changes}}
        whole = replace(base, declaration=base.declaration.model_copy(update={"effects": known}), changes=changes)
        more = [f"{e.label}_{name}" for e in whole.effects for name in e.entry.calibrated if e.enabled]
        yield f"with {', '.join(sorted(set(used.values())))}", whole, (*parameter_prior.uncertain(whole), *more)
