"""The verbs of the command line as functions: list, show, check, schema, run, report."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.declaration import catalogue, strict_yaml
from masking.errors import DeclarationError, MaskingError, ModelError, Place, Problem, RecordError, nearest

if TYPE_CHECKING:
    from masking import budget as budgets
    from masking import describe, experiment, model, recording, reporting, twin
    from masking import feasibility as feasibilities
    from masking.declaration import registry
    from masking.declaration import schema as schemas
    from masking.identification import data, written
    from masking.identification import fit as fits
else:  # each verb loads only what it needs
    budgets = lazy.load("masking.budget", suppress_warning=True)
    data = lazy.load("masking.identification.data", suppress_warning=True)
    describe = lazy.load("masking.describe", suppress_warning=True)
    experiment = lazy.load("masking.experiment", suppress_warning=True)
    feasibilities = lazy.load("masking.feasibility", suppress_warning=True)
    fits = lazy.load("masking.identification.fit", suppress_warning=True)
    model = lazy.load("masking.model", suppress_warning=True)
    recording = lazy.load("masking.recording", suppress_warning=True)
    registry = lazy.load("masking.declaration.registry", suppress_warning=True)
    reporting = lazy.load("masking.reporting", suppress_warning=True)
    schemas = lazy.load("masking.declaration.schema", suppress_warning=True)
    twin = lazy.load("masking.twin", suppress_warning=True)
    written = lazy.load("masking.identification.written", suppress_warning=True)

KINDS = ("model", "plant", "experiment")


@dataclass(frozen=True)
class Entry:
    """A packaged declaration: its kind, the name to call it by, and what it is."""

    kind: str
    name: str
    title: str


@dataclass(frozen=True)
class Checked:
    """A file that was looked at, and all that is wrong with it.

    Args:
        file: as it was named.
        kind: model, plant or experiment, or "file" where it cannot be told.
        problems: all that is wrong.
        feasibility: what a sound experiment asks of its rig; None for all else, and where that cannot be told.
        untold: why that cannot be told.
    """

    file: str
    kind: str
    problems: tuple[Problem, ...]
    feasibility: feasibilities.Feasibility | None = None
    untold: str = ""

    @property
    def exit_status(self) -> int:
        """Return 0 for what is sound, 1 for a sound experiment that does not fit its rig, 2 for problems."""
        if self.problems:
            return 2
        return 0 if self.feasibility is None or self.feasibility.fits else 1


def list() -> tuple[Entry, ...]:
    """Return the packaged models, plants and experiments."""
    entries = []
    for kind in KINDS:
        for name in catalogue.names(kind):
            content = strict_yaml.load(catalogue.find(kind, name)).value
            title = content.get("name") if isinstance(content, dict) else None
            entries.append(Entry(kind, name, str(title.value) if title is not None else name))
    return tuple(entries)


def show(name_or_path: str | Path, kind: str | None = None) -> describe.Description:
    """Describe a model, a plant or an experiment: equations, parameters, blocks.

    Args:
        name_or_path: a packaged name, or a file.
        kind: model, plant or experiment, where a name stands for more than one; by default the first of these.

    Raises:
        DeclarationError: there is no such declaration, or it is wrong.
    """
    kind = kind or catalogue.kind_of(name_or_path)
    if kind == "model":
        return describe.model(model.load_model(name_or_path))
    if kind == "plant":
        return describe.plant(registry.load_plant(name_or_path))
    return describe.experiment(experiment.Experiment.load(name_or_path))


def check(*files: str | Path, compiling: Callable[[], None] | None = None) -> tuple[Checked, ...]:
    """Check declarations whole: spelling, schema, symbols, units, equations, and that an experiment can be masked.

    A sound experiment is also compared with the limits of its rig, where the plant file has them.

    Args:
        files: files or packaged names.
        compiling: called before an experiment is compiled, which takes some ten seconds, to find out whether it fits.

    Returns:
        one result for each file, with every problem found; none are raised.
    """
    return tuple(_check(file, kind, compiling) for file in files for kind in _kinds(file))


def schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of declaration, for editors.

    Args:
        kind: model, plant or experiment.

    Raises:
        DeclarationError: there is no such kind.
    """
    if kind not in KINDS:
        raise DeclarationError(Problem(None, "", f"there is no kind of declaration '{kind}'", nearest(kind, KINDS)))
    return schemas.json_schema(kind)


def run(
    name_or_path: str | Path,
    *,
    changes: Mapping[str, float] | None = None,
    plant: str | None = None,
    out: str | Path | None = None,
    budget: bool | None = None,
    progress: Callable[[float], None] | None = None,
) -> recording.Recording:
    """Run an experiment: the plant under the controller, and the virtual system by itself beside it.

    Args:
        name_or_path: an experiment file, or the name of a packaged experiment.
        changes: parameters of the virtual system that replace the declared ones.
        plant: a plant that replaces the declared one.
        out: folder to save the recording and its report in; nothing is saved where none is given.
        budget: whether to find out what limits the fidelity, by further runs; None: where they take a few seconds.
        progress: called with the part done.

    Raises:
        MaskingError: a declaration is wrong, the rig cannot be masked as asked, or the run could not go on.
    """
    wanted = experiment.Experiment.load(name_or_path, plant=plant, changes=changes)
    if out is not None:
        check_folder(out)
    made = budgets.run(wanted, budget, progress)
    if out is not None:
        made.save(Path(out))
        reporting.report(made, out)
    return made


def identify(
    *records: str | Path,
    plant: str | Path,
    model: str | Path | None = None,
    parameters: Sequence[str] = (),
    validation: Sequence[str | Path] = (),
    horizon: float | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> fits.Fit:
    """Fit parameters of a plant to recordings of it.

    Args:
        records: folders of recordings, or parquet files, with `input.*` and `sensor.*` of the plant.
        plant: a plant file, or a packaged plant: its sensors, actuators, wiring and delay, and what is to be fitted.
        model: a model that takes the place of the plant's own and of the effects in its elements.
        parameters: what to fit: parameters of the model, and of effects as `<effect>_<parameter>`; all that the
            equations of the model hold where none are given.
        validation: recordings that are not fitted, and judge the fit.
        horizon: seconds of the windows into which recordings are cut at first.
        out: folder to save `model.yaml`, `plant.yaml` and `fit.json` in; nothing is saved where none is given.
        progress: called with the part done.

    Raises:
        MaskingError: a declaration, a name or a recording is wrong; says what to do about it.
    """
    if not records:
        raise RecordError("give at least one recording to fit")
    if out is not None:
        check_folder(out)
    wanted = twin.Twin.load(plant) if model is None else twin.Twin.load(plant).as_model(model)
    wanted.validate()

    def read(paths: Sequence[str | Path]) -> tuple[data.Data, ...]:
        return tuple(data.Data.of(recording.Recording.load(Path(path)), wanted, str(path)) for path in paths)

    found = fits.fit(
        wanted, read(records), parameters or wanted.equation_parameters(), validation=read(validation), horizon=horizon,
        progress=progress,
    )  # fmt: skip
    if out is not None:
        written.save(found, out)
    return found


def report(record: str | Path, out: str | Path | None = None) -> reporting.Report:
    """Write the report of a recording: one HTML page and its figures.

    Args:
        record: the folder of a recording, or its parquet file.
        out: folder of the report; by default the recording's own.

    Raises:
        RecordError: there is no recording, or the report cannot be written.
    """
    path = Path(record)
    folder = Path(out) if out is not None else path if path.is_dir() else path.parent
    return reporting.report(recording.Recording.load(path), folder)


def check_folder(out: str | Path) -> None:
    """Refuse a folder that nothing can be written into, before anything is run.

    Raises:
        RecordError: it is a file, or it is or lies in a folder that may not be written.
    """
    path = Path(out)
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise RecordError(f"{existing} is a file; name a folder to save in")
    if not os.access(existing, os.W_OK):
        raise RecordError(f"{existing} may not be written; name another folder to save in")


def _kinds(file: str | Path) -> tuple[str, ...]:
    """Return every kind that a packaged name stands for; '' where the file itself must tell."""
    return tuple(kind for kind in KINDS if str(file) in catalogue.names(kind)) or ("",)


def _check(file: str | Path, kind: str, compiling: Callable[[], None] | None) -> Checked:
    try:
        kind = kind or catalogue.kind_of(file)
        if kind == "model":
            model.load_model(file).validate()
        elif kind == "plant":
            registry.check_plant_file(file)
            twin.Twin.load(file).validate()
        else:
            wanted = experiment.Experiment.load(file)
            wanted.validate()
            return _fit(str(file), wanted, compiling)
    except DeclarationError as error:
        return Checked(str(file), kind or "file", error.problems)
    except MaskingError as error:
        return Checked(str(file), kind or "file", (Problem(Place(str(file), 1, 1), "", str(error)),))
    return Checked(str(file), kind, ())


def _fit(file: str, wanted: experiment.Experiment, compiling: Callable[[], None] | None) -> Checked:
    """Find out whether a sound experiment fits its rig, where the plant file has the limits of its actuators."""
    try:
        wanted.instruments.limits()
    except ModelError as error:
        return Checked(file, "experiment", (), untold=str(error))
    if compiling is not None and not feasibilities.Motion(wanted).loop.is_compiled:
        compiling()
    return Checked(file, "experiment", (), feasibilities.feasibility(wanted))
