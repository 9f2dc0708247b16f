"""The rig and the records of a discovery, read and checked before anything is searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from masking.control.rig.twin import Twin
from masking.errors import DeclarationError, Problem, RecordError, nearest
from masking.inference.discovery import parameter_prior
from masking.inference.estimation.identification_data import Data
from masking.lab.records import readers
from masking.lab.records.record_form import RecordForm
from masking.lab.records.time_slice import Part
from masking.model.declaration import catalogue, registry
from masking.model.declaration.couplings import driven_outputs
from masking.model.declaration.expression import Expression
from masking.model.declaration.instrument_declaration import Sensor
from masking.model.declaration.model_checks import beyond_ordinary
from masking.model.declaration.schema import ModelDeclaration, PlantDeclaration
from masking.reports.discovery_files import Origin

FEWEST = 400  # samples of a record
STILL = 1.2  # deviations of the noise: readings that vary by less do not move
ALIKE = 1e-6  # relative difference of two rates that are the same


@dataclass(frozen=True)
class Inputs:
    """The record to be explained, a validation record, and where these come from."""

    record: Data
    validation: Data | None
    origin: Origin


def read(twin: Twin, record: str | Path, validation: str | Path | None, form: RecordForm) -> Inputs:
    """Read and check the records of a rig, each a path or `FILE@10:20`, its part from 10 s to 20 s.

    Raises a `RecordError` where one cannot be read, lacks a channel, is too short, or the two have different rates or
    share samples.
    """

    def one(path: str | Path) -> Data:
        found = Data.read(path, twin, **form.reading)
        if len(found) < FEWEST:
            raise RecordError(
                f"{path}: {len(found)} samples are too few to tell effects apart; give a record of at least {FEWEST}, "
                "over several periods of the slowest motion"
            )
        if bool((found.readings.var(axis=0) < (STILL * found.noise) ** 2).all()):
            raise RecordError(
                f"{path}: nothing moves: the readings vary no more than their noise; excite the rig, or let it go from "
                "somewhere else than rest"
            )
        return found

    train = one(record)
    held_out = None if validation is None else one(validation)
    if held_out is not None and abs(held_out.rate / train.rate - 1.0) > ALIKE:
        raise RecordError(
            f"{record} has {train.rate:g} samples in a second, {validation} {held_out.rate:g}: two rates; resample "
            "one of them, or leave --validate out, and the last part of the record is held out"
        )
    paths = {"record": record} | ({"validation": validation} if validation is not None else {})
    origin = Origin({what: (str(p), readers.digest(p)) for what, p in paths.items()})
    if held_out is not None:
        _check_unseen(train, held_out, origin)
    return Inputs(train, held_out, origin)


def _check_unseen(train: Data, held_out: Data, origin: Origin) -> None:
    """Refuse for validation what is searched: the same record, or parts of one file that overlap."""
    (record, content), (validation, other) = origin.records["record"], origin.records["validation"]
    remedy = "leave --validate out, and the last 30 % of the record are held out, or give another record"
    if np.array_equal(train.readings, held_out.readings) and np.array_equal(train.commands, held_out.commands):
        raise RecordError(f"{validation}: it holds the same samples as {record}, which it is to validate; {remedy}")
    first, second = Part.of(record), Part.of(validation)
    start, end = max(first.limits[0], second.limits[0]), min(first.limits[1], second.limits[1])
    if content == other and start < end:
        border = start if np.isfinite(start) else end
        raise RecordError(
            f"{validation}: its samples{_between(start, end)} are also in {record}, which it is to validate; give "
            f"parts that share no time, such as {first.file}@:{border:.9g} and {first.file}@{border:.9g}:, or {remedy}"
        )


def _between(start: float, end: float) -> str:
    """Interval in s, in words; nothing of a side that is infinite."""
    if np.isinf(start):
        return "" if np.isinf(end) else f" up to {end:.9g} s"
    return f" from {start:.9g} s {'on' if np.isinf(end) else f'to {end:.9g} s'}"


def rig(model: str | Path | None, plant: str | Path | None = None) -> Twin:
    """Rig of a plant, or of a model alone: perfect sensors of its outputs, or else of its coordinates.

    Where one of both is given, its content says which it is; a packaged name that both kinds have is what it is given
    as. Raises a `DeclarationError` where neither is given, or one is wrong, and a `ModelError` where a mass is 0.
    """
    given = plant if model is None else model
    if given is not None and (model is None or plant is None):
        is_plant = catalogue.kind_of(given) == "plant" or (model is None and str(given) in catalogue.names("plant"))
        model, plant = (None, given) if is_plant else (given, None)
    if plant is not None:
        twin = Twin.load(plant) if model is None else Twin.load(plant).as_model(model)
    elif model is None:
        remedy = "name a model, such as --model setup, or a plant with --plant"
        raise DeclarationError(Problem(None, "model", "there is nothing to hold the record against", remedy))
    else:
        base = registry.load_model(model)
        for what in beyond_ordinary(base):
            message = f"the model {base.name} has {what}, which are not estimated"
            raise DeclarationError(Problem(None, "model", message, f"name a model without {what}"))
        twin = Twin(PlantDeclaration(name=base.name, model=str(model), sensors=_sensors(base)), base)
    twin.validate()
    twin.model.check_mass()
    return twin


def with_effects(twin: Twin, effects: str | Path | None) -> Twin:
    """Rig that knows the effects of a dictionary, too; the rig itself where none is named."""
    if effects is None:
        return twin
    made = replace(twin, declaration=registry.with_dictionary(twin.declaration, effects))
    made.validate()
    return made


def parameters(twin: Twin, names: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the equations that may be off: where none are named, all that are not known."""
    known = twin.equation_parameters()
    for name in names:
        if name not in known:
            message = f"the equations of {twin.base.name} hold no parameter '{name}'"
            raise DeclarationError(Problem(None, "parameters", message, nearest(name, known)))
    return tuple(names) or parameter_prior.uncertain(twin)


def _sensors(base: ModelDeclaration) -> dict[str, Sensor]:
    if base.outputs:
        by_name = driven_outputs(base)  # with the forces of effects in them
        return {
            name: Sensor(measures=Expression(name) if name in by_name else o.expression, unit=o.unit, meaning=o.meaning)
            for name, o in base.outputs.items()
        }
    moving = base.coordinates or base.states
    return {name: Sensor(measures=Expression(name), unit=c.unit, meaning=c.meaning) for name, c in moving.items()}
