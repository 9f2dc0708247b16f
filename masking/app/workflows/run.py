"""The verbs run and report: an experiment to its recording, and a recording to its report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from masking.app.workflows.output_folders import RUN, beside, own_folder
from masking.errors import ModelError, RecordError
from masking.lab.records import stream
from masking.lab.records.recording import TABLE, Recording
from masking.lab.runs import error_budget, long_run
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import Progress
from masking.lazy_imports import one_page_drawing
from masking.reports import animation, html, run_report
from masking.reports import one_page as sheets


def run(
    name_or_path: str | Path,
    *,
    changes: Mapping[str, float] | None = None,
    plant: str | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    budget: bool | None = None,
    progress: Progress | None = None,
    compiling: Callable[[], None] | None = None,
) -> Recording:
    """Run an experiment: the plant under the controller, and the virtual system by itself beside it.

    Args:
        name_or_path: an experiment file, or the name of a packaged experiment.
        changes: parameters of the virtual system that replace the declared ones.
        plant: a plant that replaces the declared one.
        out: folder to save the recording and its report in; by default nothing is saved.
        overwrite: whether an earlier run in that folder may be replaced.
        budget: whether to make an error budget, by further runs; by default if these take a few seconds.
        progress: called with the fraction done.
        compiling: called before an experiment is compiled, which takes some ten seconds.

    Raises:
        MaskingError: a declaration is wrong, the rig cannot be masked as asked, or the run could not go on.
    """
    wanted = Experiment.load(name_or_path, plant=plant, changes=changes)
    with own_folder(out, *RUN, overwrite=overwrite):
        if compiling is not None and not wanted.is_compiled:
            compiling()
        if out is None or not long_run.is_long(wanted):
            made = error_budget.run(wanted, budget, progress)
        elif budget:
            raise ModelError(
                f"{wanted.declaration.name}: the runs of a budget stay in memory, and this one is too long for that; "
                "make the budget of a shorter duration"
            )
        else:  # into its folder while it runs, in which it replaces an earlier one
            made = long_run.run(wanted, out, overwrite=True, progress=progress)
        if out is not None:
            save(made, Path(out))
    return replace(made, text=run_report.summary)


def save(recording: Recording, folder: Path) -> run_report.Report:
    """Save a recording with its report; an animation and one page of an earlier run in the folder, and a stream, go.

    Raises a `RecordError` where the folder, made if need be, cannot be written.
    """
    if recording.path != folder / TABLE:
        recording.save(folder, overwrite=True)
    with html.writing(folder):
        stream.remove(folder)
        (folder / animation.PAGE).unlink(missing_ok=True)
    sheets.remove(folder)
    return run_report.report(recording, folder)


def report(
    result: str | Path, out: str | Path | None = None, *, overwrite: bool = False, one_page: bool = False
) -> run_report.Report:
    """Write the report of a recording, one HTML page and its figures; or one page of any result, to print.

    Args:
        result: the folder of a recording, or its parquet file; with `one_page` that of a discovery, an identification
            or a calibration, too, or its JSON.
        out: folder of the report; by default the result's own.
        overwrite: whether an earlier report in another folder may be replaced.
        one_page: whether to write `one_page.pdf`, a sheet of A4, and the same as `one_page.png`: what was found, where,
            how sure it is, the error before and after, and what to do next.

    Raises:
        RecordError: there is no such result, or the report cannot be written, or would replace another one.
    """
    own = beside(result)
    folder, page = own if out is None else Path(out), sheets.PAGE if one_page else run_report.PAGE
    with own_folder(folder, page, overwrite=overwrite or folder.resolve() == own.resolve()):
        if not one_page:
            return run_report.report(Recording.load(result), folder)
        sheet = _sheet(Path(result))
        written, picture = one_page_drawing.save(sheet, folder)
        return run_report.Report(written, (picture,), sheet.title)


def _sheet(result: Path) -> sheets.Sheet:
    """What one page says of a result, which is the only one in its folder or a file."""
    kinds = (TABLE, *sheets.RESULTS)
    held = [name for name in kinds if (result / name).is_file()] if result.is_dir() else [result.name]
    if len(held) > 1:
        raise RecordError(
            f"{result} holds several results; name one of them: {', '.join(str(result / n) for n in held)}"
        )
    if not held or not result.exists():
        raise RecordError(f"{result} is no result; name a folder that holds {', '.join(kinds[:-1])} or {kinds[-1]}")
    file = result / held[0] if result.is_dir() else result
    if file.suffix == ".json":
        return sheets.read(file)
    return run_report.sheet(Recording.load(file), file.resolve().parent.name)
