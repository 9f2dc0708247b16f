"""The verb export: a controller, a rig or a model as C or as an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from masking.app.workflows.output_folders import own_folder
from masking.control.exports import unit_files
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.control.exports.rig_units import model_unit, twin_unit
from masking.control.exports.unit import Unit
from masking.control.rig.twin import Twin
from masking.display.json_text import Result
from masking.display.printed_result import Printed
from masking.errors import DeclarationError, Problem
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue
from masking.model.modelling.model import load_model

Target = Literal["c", "fmu"]
Kind = Literal["experiment", "plant", "model"]  # in the order of preference
Real = Literal["double", "float"]
WATCHDOG = 0.02
RATE = 1000.0


@dataclass(frozen=True, repr=False)
class Exported(Printed, Result):
    """Title and files of an export, and what to know of its use."""

    title: str
    kind: str
    files: tuple[Path, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join([f"{self.title}", *self.notes, *(f"written: {file}" for file in self.files)])


def export(
    name_or_path: str | Path,
    *,
    to: Target,
    kind: Kind | None = None,
    changes: Mapping[str, float] | None = None,
    plant: str | None = None,
    real: Real = "double",
    rate: float | None = None,
    watchdog: float = WATCHDOG,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Exported:
    """Write a controller, a rig or a model as source that runs without this package.

    Args:
        name_or_path: an experiment, whose controller is exported; a plant, as a simulated rig; or a model.
        to: 'c' or 'fmu'.
        kind: 'experiment', 'plant' or 'model', where a name stands for several; by default the first of these.
        changes: parameters that replace the declared ones: of an experiment's virtual system, or of a model.
        plant: a plant that replaces that of an experiment.
        real: numbers of C: 'double' or 'float'.
        rate: steps per second of a rig or a model, or per unit of time of a model with scales; 1000 by default. That of
            a controller is declared. A rig with a delay in samples needs it: they are those of its controller.
        watchdog: seconds without a step after which a sampled controller's commands are zero.
        out: folder to write into; `exported/NAME` by default.
        overwrite: whether an earlier export of the same kind is replaced in that folder.

    Raises:
        DeclarationError: a declaration or a setting is wrong.
        ModelError: the controller cannot be made, or a constant is too large for `real`.
        RecordError: the folder cannot be written, or holds such an export.
    """
    _check("--to", to, get_args(Target))
    _check("--real", real, get_args(Real))
    if real == "float" and to != "c":
        raise DeclarationError(Problem(None, "--real", f"float is for C; {to} has double", "leave --real out"))
    for option, value in (("--rate", rate), ("--watchdog", watchdog)):
        if value is not None and not 0.0 < value < float("inf"):
            raise DeclarationError(Problem(None, option, f"{value:g} is no positive number", "give one, such as 1000"))
    folder = Path("exported") / Path(name_or_path).stem if out is None else Path(out)
    unit = _unit(name_or_path, kind, changes, plant, rate=rate, watchdog=watchdog)
    with own_folder(folder, f"{unit.name}{unit_files.ENDINGS[to]}", overwrite=overwrite):
        return Exported(unit.title, unit.kind, unit_files.write(unit, folder, to, real), unit.notes)


def _unit(
    name_or_path: str | Path,
    asked: Kind | None,
    changes: Mapping[str, float] | None,
    plant: str | None,
    *,
    rate: float | None,
    watchdog: float,
) -> Unit:
    named = (kind for kind in get_args(Kind) if str(name_or_path) in catalogue.names(kind))
    kind = asked or next(named, None) or catalogue.kind_of(name_or_path)
    _check("--kind", kind, get_args(Kind))
    stem = Path(name_or_path).stem
    if kind == "experiment":
        if rate is not None:
            remedy = "change controller.rate in the experiment file"
            raise DeclarationError(Problem(None, "--rate", "a controller has the rate that is declared", remedy))
        made = Experiment.load(name_or_path, plant=plant, changes=changes)
        made.validate()
        _check_inputs(made)
        if made.has_observer:
            return sampled_unit(made.sampled, stem, watchdog)
        return law_unit(made.loop, stem, made.declaration.controller.rate)
    if plant is not None:
        raise DeclarationError(Problem(None, "--plant", f"a {kind} runs on no plant", "name an experiment"))
    if kind == "plant":
        catalogue.check_changes(kind, changes)
        twin = Twin.load(name_or_path)
        twin.validate()
        if twin.delay and rate is None:
            what = f"the delay of {stem} is {twin.delay} samples, whose length is that of its controller"
            remedy = "give the controller's samples per second, such as --rate 500"
            raise DeclarationError(Problem(None, "--rate", what, remedy))
        return twin_unit(twin, stem, rate or RATE)
    model = load_model(name_or_path).with_parameters(**(changes or {}))
    model.validate()
    return model_unit(model.dimensionless() if model.declaration.scales else model, stem, rate or RATE)


def _check_inputs(experiment: Experiment) -> None:
    """Refuse inputs of a virtual system that an exported control law does not have."""
    for name, source in experiment.declaration.inputs.items():
        if source.expression is None and not experiment.has_observer:
            path = f"inputs.{name}"
            message = f"an exported control law of the states takes expressions, not a {source.kinds[0]}"
            such = "as an expression, such as '0.1*sin(1.2*t)'"
            remedy = f"write {name} {such}; or give the controller rate and observer"
            raise DeclarationError(Problem(experiment.declaration.key_place(path), path, message, remedy))


def _check(option: str, given: str, allowed: tuple[str, ...]) -> None:
    if given not in allowed:
        remedy = f"allowed: {', '.join(allowed)}"
        raise DeclarationError(Problem(None, option, f"there is no {option.removeprefix('--')} '{given}'", remedy))
