"""The verb check: declarations against all that they must fulfil, and experiments against the limits of their rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from masking.control.rig.twin import Twin
from masking.display.json_text import Result
from masking.display.printed_result import Printed
from masking.errors import DeclarationError, MaskingError, ModelError, Place, Problem
from masking.lab.runs import batch_plan
from masking.lab.runs.error_budget import Prediction, predict
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import Feasibility, Motion, feasibility
from masking.model import effects
from masking.model.declaration import catalogue, registry
from masking.model.modelling.model import load_model


@dataclass(frozen=True, repr=False)
class Checked(Printed, Result):
    """A file that was looked at, and all that is wrong with it."""

    file: str  # as it was named
    kind: str  # one of `catalogue.KINDS`, or "file" if it is not known
    problems: tuple[Problem, ...]  # all that is wrong
    feasibility: Feasibility | None = None  # what a sound experiment asks of its rig; None for all else, or unknown
    unknown: str = ""  # why it is not known whether the experiment fits
    prediction: Prediction | None = None  # of a controller that reads sensors

    @property
    def headline(self) -> str:
        """First problem and the number of others, or what a sound file is, and whether an experiment fits its rig."""
        first, *others = map(str, self.problems or [f"{self.file}: a sound {self.kind}"])
        fit = "" if self.feasibility is None else f"; {self.feasibility.verdict}"
        return f"{first}{f' (and {len(others)} more)' if others else ''}{fit}"

    def __str__(self) -> str:
        lines = [*map(str, self.problems)] or [f"{self.file}: a sound {self.kind}"]
        lines += [str(self.feasibility)] if self.feasibility is not None else []
        lines += [f"  {self.prediction}"] if self.prediction is not None else []
        return "\n".join([*lines, f"  whether it fits is unknown: {self.unknown}"] if self.unknown else lines)


def check(
    *files: str | Path, changes: Mapping[str, float] | None = None, compiling: Callable[[], None] | None = None
) -> tuple[Checked, ...]:
    """Check declarations whole: spelling, schema, symbols, units, equations, and that an experiment can be masked.

    A sound experiment is also compared with the limits of its rig, if the plant file has them.

    Args:
        files: files or packaged names.
        changes: parameters that replace the declared ones: of an experiment's virtual system, or of a model.
        compiling: called before an experiment is compiled, which takes some ten seconds, to find out whether it fits.

    Returns:
        one result for each file, with every problem found; none are raised.
    """
    kinds = [(file, [kind for kind in catalogue.KINDS if str(file) in catalogue.names(kind)] or [""]) for file in files]
    return tuple(_check(file, kind, changes or {}, compiling) for file, every in kinds for kind in every)


def _check(file: str | Path, kind: str, changes: Mapping[str, float], compiling: Callable[[], None] | None) -> Checked:
    try:
        kind = kind or catalogue.kind_of(file)
        catalogue.check_changes(kind, changes)
        if kind == "model":
            load_model(file).with_parameters(**changes).validate()
        elif kind == "plant":
            registry.check_plant_file(file)
            Twin.load(file).validate()
        elif kind == "dictionary":
            effects.load(file)
        elif kind == "batch":
            batch_plan.load(file)
        else:
            wanted = Experiment.load(file, changes=changes)
            wanted.validate()
            return _fit(str(file), wanted, compiling)
    except DeclarationError as error:
        return Checked(str(file), kind or "file", error.problems)
    except MaskingError as error:
        known = error.problem if isinstance(error, ModelError) else None
        return Checked(str(file), kind or "file", (known or Problem(Place(str(file), 1, 1), "", str(error)),))
    return Checked(str(file), kind, ())


def _fit(file: str, wanted: Experiment, compiling: Callable[[], None] | None) -> Checked:
    """Result for a sound experiment: its fit to the limits of the actuators, where the plant file has these."""
    try:
        wanted.instruments.limits()
    except ModelError as error:
        return Checked(file, "experiment", (), unknown=str(error))
    if compiling is not None and not Motion(wanted).loop.is_compiled:
        compiling()
    is_predicted = wanted.has_observer and wanted.declaration.controller.regulate is None
    return Checked(file, "experiment", (), feasibility(wanted), prediction=predict(wanted) if is_predicted else None)
