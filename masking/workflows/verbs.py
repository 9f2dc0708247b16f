"""The verbs of the command line as functions: list, show, check, run, report, identify, discover, stability ..."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.declaration import catalogue, strict_yaml
from masking.errors import (
    DeclarationError,
    MaskingError,
    ModelError,
    Place,
    Problem,
    RecordError,
    nearest,
)

if TYPE_CHECKING:
    from masking import effects
    from masking.analysis.stability import study as stabilities
    from masking.declaration import registry
    from masking.declaration import schema as schemas
    from masking.discovery import discovery as discoveries
    from masking.estimation import data, innovations, kalman
    from masking.estimation import fit as fits
    from masking.estimation.data import InputHold
    from masking.modelling import model
    from masking.procedures import channels, measurement, responses
    from masking.records import recording
    from masking.reports import fit_figures, fit_files, identification_page, run_report
    from masking.reports import stability_page as stability_pages
    from masking.reports.discovery_files import Files
    from masking.rig import twin
    from masking.runs import error_budget as budgets
    from masking.runs import experiment
    from masking.runs import feasibility as feasibilities
    from masking.workflows import describe
    from masking.workflows import discover as answers
    from masking.workflows import refine as refinements
    from masking.workflows import stability as assessment
else:  # each verb loads only what it needs
    assessment = lazy.load("masking.workflows.stability", suppress_warning=True)
    answers = lazy.load("masking.workflows.discover", suppress_warning=True)
    budgets = lazy.load("masking.runs.error_budget", suppress_warning=True)
    data = lazy.load("masking.estimation.data", suppress_warning=True)
    channels = lazy.load("masking.procedures.channels", suppress_warning=True)
    describe = lazy.load("masking.workflows.describe", suppress_warning=True)
    effects = lazy.load("masking.effects", suppress_warning=True)
    experiment = lazy.load("masking.runs.experiment", suppress_warning=True)
    feasibilities = lazy.load("masking.runs.feasibility", suppress_warning=True)
    fit_figures = lazy.load("masking.reports.fit_figures", suppress_warning=True)
    fits = lazy.load("masking.estimation.fit", suppress_warning=True)
    kalman = lazy.load("masking.estimation.kalman", suppress_warning=True)
    measurement = lazy.load("masking.procedures.measurement", suppress_warning=True)
    model = lazy.load("masking.modelling.model", suppress_warning=True)
    identification_page = lazy.load("masking.reports.identification_page", suppress_warning=True)
    recording = lazy.load("masking.records.recording", suppress_warning=True)
    refinements = lazy.load("masking.workflows.refine", suppress_warning=True)
    registry = lazy.load("masking.declaration.registry", suppress_warning=True)
    run_report = lazy.load("masking.reports.run_report", suppress_warning=True)
    responses = lazy.load("masking.procedures.responses", suppress_warning=True)
    schemas = lazy.load("masking.declaration.schema", suppress_warning=True)
    stability_pages = lazy.load("masking.reports.stability_page", suppress_warning=True)
    twin = lazy.load("masking.rig.twin", suppress_warning=True)
    fit_files = lazy.load("masking.reports.fit_files", suppress_warning=True)

KINDS = ("model", "plant", "experiment", "dictionary")
STUDIED = ("model", "experiment")  # those of `assessment.KINDS`
METHODS = ("least-squares", "kalman")
HOLDS = ("zero-order", "first-order", "band-limited")  # those of `data.InputHold`
TOLERANCE = 0.01  # relative standard deviation of a parameter that declares none, in a discovery
# Procedures of `measure`, and how many records each takes at most.
PROCEDURES: dict[str, int | None] = {"springs": 1, "actuators": 1, "friction": None, "response": None}


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
        kind: one of `KINDS`, or "file" if its keys do not say.
        problems: all that is wrong.
        feasibility: what a sound experiment asks of its rig; None for all else, and if that is unknown.
        unknown: why that is unknown.
    """

    file: str
    kind: str
    problems: tuple[Problem, ...]
    feasibility: feasibilities.Feasibility | None = None
    unknown: str = ""

    @property
    def exit_status(self) -> int:
        """Return 0 for what is sound, 1 for a sound experiment that does not fit its rig, 2 for problems."""
        if self.problems:
            return 2
        return 0 if self.feasibility is None or self.feasibility.fits else 1


def list() -> tuple[Entry, ...]:
    """Return the packaged models, plants, experiments and dictionaries of effects."""
    entries = []
    for kind in KINDS:
        for name in catalogue.names(kind):
            content = strict_yaml.load(catalogue.find(kind, name)).value
            title = content.get("name") if isinstance(content, dict) else None
            entries.append(Entry(kind, name, str(title.value) if title is not None else name))
    return tuple(entries)


def show(name_or_path: str | Path, kind: str | None = None) -> describe.Description:
    """Describe a model, a plant or an experiment: equations, parameters, blocks; or physical effects.

    Args:
        name_or_path: a packaged name, a file, or the name of an effect that comes with the package.
        kind: one of `KINDS`, where a name stands for more than one; by default the first of these.

    Raises:
        DeclarationError: there is no such declaration, or it is wrong.
    """
    if kind is None and name_or_path in effects.EFFECTS:
        return describe.effect(effects.EFFECTS[str(name_or_path)])
    kind = kind or catalogue.kind_of(name_or_path)
    if kind == "model":
        return describe.model(model.load_model(name_or_path))
    if kind == "plant":
        return describe.plant(registry.load_plant(name_or_path))
    if kind == "dictionary":
        return describe.dictionary(registry.load_dictionary(name_or_path))
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
        kind: one of `KINDS`.

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
        budget: whether to find out what limits the masking error, by further runs; None: where they take a few seconds.
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
        run_report.report(made, out)
    return made


def identify(
    *records: str | Path,
    plant: str | Path,
    model: str | Path | None = None,
    parameters: Sequence[str] = (),
    validation: Sequence[str | Path] = (),
    shooting_interval: float | None = None,
    method: str = "least-squares",
    square_root: bool = False,
    iterated: int = 1,
    hold: InputHold | None = None,
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
    out: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> fits.Fit | innovations.KalmanFit:
    """Fit parameters of a plant to recordings of it.

    Args:
        records: folders of recordings, or parquet, csv, mat or h5 files, with `input.*` and `sensor.*` of the plant, or
            parts of these, such as `record.csv@10:20`, which is what lies from 10 s to 20 s; one for a filter.
        plant: a plant file, or a packaged plant: sensors, actuators, allocation, delay, and what is to be fitted.
        model: a model that takes the place of the plant's own and of the effects in its elements.
        parameters: what to fit: parameters of the model, and of effects as `<effect>_<parameter>`; all that the
            equations of the model hold where none are given.
        validation: recordings that are not fitted, for validation.
        shooting_interval: length in s of the intervals of multiple shooting at first; not for a filter.
        method: 'least-squares', or 'kalman' for one pass of the extended Kalman filter with the settings of 4.2.2.
        square_root: let the filter carry a square root of its covariance.
        iterated: times that the filter makes the readings of a sample linear.
        hold: inputs between samples: 'zero-order' for commands, which act after the delay of the plant; 'first-order'
            for measured inputs; 'band-limited' for inputs measured behind an anti-alias filter.
        columns: of the files, by the names that they get, such as `{"t": "time", "V1": "u"}`.
        dt: time between samples in s, for a table without a clock.
        out: folder to save `model.yaml`, `plant.yaml`, `fit.json`, `fit.html` and its figures in: `fit.png`,
            `validation.png` where there is a validation, `estimates.png` of a filter; nothing is saved where none is
            given.
        progress: called with the part done.

    Raises:
        MaskingError: a declaration, a name, a setting or a recording is wrong; says what to do about it.
    """
    _check_method(method, records, shooting_interval, other=square_root or iterated != 1)
    if out is not None:
        check_folder(out)
    wanted = twin.Twin.load(plant) if model is None else twin.Twin.load(plant).as_model(model)
    wanted.validate()

    def read(paths: Sequence[str | Path]) -> tuple[data.Data, ...]:
        return tuple(data.Data.read(path, wanted, hold, columns, dt) for path in paths)

    names = parameters or wanted.equation_parameters()
    train, unseen = read(records), read(validation)
    found: fits.Fit | innovations.KalmanFit
    if method == "kalman":
        found = kalman.extended_kalman(
            wanted, train[0], names, validation=unseen, square_root=square_root, iterated=iterated, progress=progress
        )
    else:
        found = fits.fit(
            wanted, train, names, validation=unseen, shooting_interval=shooting_interval, progress=progress
        )
    if out is not None:
        figures, sentence = fit_figures.figures(found, train, unseen)
        fit_files.save(found, out)
        identification_page.save_fit(found, figures, sentence, out)
    return found


def discover(record: str | Path, **settings: Any) -> discoveries.Discovery:  # noqa: ANN401  # those of `discovered`
    """Find out which physical effect a model is missing, from a record of the rig; see `discovered`."""
    found, _ = discovered(record, **settings)
    return found


def discovered(
    record: str | Path,
    *,
    out: str | Path | None = None,
    **settings: Any,  # noqa: ANN401  # those of `answered.answered`
) -> tuple[discoveries.Discovery, Files | None]:
    """Find out which physical effect a model is missing, and write the model with it.

    Args:
        record: a folder of a recording, or a parquet, csv, mat or h5 file, with the channels of the plant; or a part
            of one, as for `identify`.
        out: folder to save in.
        settings: the others of `discovery.answered.answered`, and what it saves.

    Returns:
        what was found, and the files; None where nothing is saved.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong; says what to do about it.
    """
    if out is not None:
        check_folder(out)
    return answers.answered(record, out=out, **settings)


def refine(
    name_or_path: str | Path,
    *,
    record: str | Path,
    plant: str | None = None,
    out: str | Path | None = None,
    **settings: Any,  # noqa: ANN401  # those of `refinement.refine`
) -> refinements.Refinement:
    """Find out what the controller's model of an experiment is missing, and run it before and after.

    Args:
        name_or_path: an experiment file, or the name of a packaged experiment.
        record: a recording of its plant, as for `discover`.
        plant: a plant that replaces the declared one.
        out: folder to save in.
        settings: the others of `refinement.refine`, and what it saves.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong, or the experiment cannot be run.
    """
    if out is not None:
        check_folder(out)
    return refinements.refine(experiment.Experiment.load(name_or_path, plant=plant), record, out=out, **settings)


def measure(
    procedure: str,
    *records: str | Path,
    plant: str | Path | None = None,
    out: str | Path | None = None,
    **settings: Any,  # noqa: ANN401  # those of the procedure
) -> measurement.Measurement[Any]:
    """Do one procedure of the identification on recordings made for it.

    Args:
        procedure: 'springs', 'actuators', 'friction' or 'response'.
        records: folders of recordings, or parquet files, with `input.*` and `sensor.*`.
        plant: a plant file, or a packaged plant, whose sensors turn readings into what they measure, such as a
            displacement in m; without one, results are in the units of the readings.
        out: folder to save `<procedure>.html`, `<procedure>.json` and PNG files in; nothing is saved where none is
            given.
        settings: those of `measurement.springs`, `measurement.actuators`, `measurement.friction` or
            `responses.response`, such as `sensor="s1"`.

    Raises:
        MaskingError: there is no such procedure or setting, or a column, a plant or a recording is wrong.
    """
    if procedure not in PROCEDURES:
        message = f"there is no procedure '{procedure}'"
        raise DeclarationError(Problem(None, "", message, nearest(procedure, [*PROCEDURES])))
    function = responses.response if procedure == "response" else getattr(measurement, procedure)
    known = [n for n, p in inspect.signature(function).parameters.items() if p.kind is p.KEYWORD_ONLY]
    for name in settings:
        if name not in known:
            raise DeclarationError(Problem(None, name, f"{procedure} has no such setting", nearest(name, known)))
    most = PROCEDURES[procedure]
    if not records or (most is not None and len(records) > most):
        raise RecordError(f"{procedure} takes {'one record' if most else 'records'}; {len(records)} are given")
    if out is not None:
        check_folder(out)
    known_plant = None if plant is None else twin.Twin.load(plant)
    sources = [channels.Source(str(r), recording.Recording.load(Path(r)), known_plant) for r in records]
    found: measurement.Measurement[Any] = function(*sources, **settings)
    if out is not None:
        identification_page.save(found, out)
    return found


def stability(
    name_or_path: str | Path,
    *,
    out: str | Path | None = None,
    **settings: Any,  # noqa: ANN401  # those of `assessment.assess`
) -> stabilities.Stability:
    """Find the equilibria and modes of a system, and what its energy proves of all its motions.

    Args:
        name_or_path: a model, or an experiment, whose closed loop is looked at, too.
        out: folder to save `stability.html`, `stability.json` and figures in; nothing is saved where none is given.
        settings: the others of `assessment.assess`.

    Raises:
        MaskingError: a declaration, a name or a setting is wrong; says what to do about it.
    """
    if out is not None:
        check_folder(out)
    found = assessment.assess(name_or_path, **settings)
    if out is not None:
        stability_pages.save(found, out)
    return found


def report(record: str | Path, out: str | Path | None = None) -> run_report.Report:
    """Write the report of a recording: one HTML page and its figures.

    Args:
        record: the folder of a recording, or its parquet file.
        out: folder of the report; by default the recording's own.

    Raises:
        RecordError: there is no recording, or the report cannot be written.
    """
    path = Path(record)
    folder = Path(out) if out is not None else path if path.is_dir() else path.parent
    return run_report.report(recording.Recording.load(path), folder)


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


def _check_method(method: str, records: Sequence[str | Path], shooting_interval: float | None, *, other: bool) -> None:
    """Refuse a method that there is not, and settings of the other one."""
    if method not in METHODS:
        raise DeclarationError(Problem(None, "method", f"there is no method '{method}'", nearest(method, METHODS)))
    if not records:
        raise RecordError("give at least one recording to fit")
    if method == "kalman" and len(records) > 1:
        raise RecordError(
            f"the filter takes one record, {len(records)} are given; filter one after the other, or fit them together "
            "by least squares"
        )
    if method == "kalman" and shooting_interval is not None:
        raise DeclarationError(Problem(None, "shooting_interval", "a filter has none", "leave it out"))
    if method != "kalman" and other:
        message = "square roots and iterations are settings of the filter"
        raise DeclarationError(Problem(None, "method", message, "give the method kalman"))


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
        elif kind == "dictionary":
            effects.load(file)
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
        return Checked(file, "experiment", (), unknown=str(error))
    if compiling is not None and not feasibilities.Motion(wanted).loop.is_compiled:
        compiling()
    return Checked(file, "experiment", (), feasibilities.feasibility(wanted))
