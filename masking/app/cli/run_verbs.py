"""Verbs that run an experiment and show what was recorded: run, report, recover, animate, compare."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from masking.app.cli.declaration_verbs import say_compiling
from masking.app.cli.options import NAMED, Verb, add_json, add_out, answer
from masking.app.cli.progress import Bar, raise_interrupts
from masking.errors import DeclarationError, MaskingError, Problem


def _add_run(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("experiment", metavar="EXPERIMENT", help=NAMED)
    sub.add_argument("--set", metavar="NAME=VALUE", action="append", default=[], help="change a virtual parameter")
    sub.add_argument("--plant", metavar="PLANT", help="run on another plant: a name or a YAML file")
    add_out(sub, "results/EXPERIMENT")
    sub.add_argument(
        "--budget",
        action=argparse.BooleanOptionalAction,
        help="rerun without each cause of the masking error (default: if this takes a few seconds)",
    )


def _add_report(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("record", metavar="RECORD", help="the folder of a recording")
    add_out(sub, "beside the recording")


def _run(chosen: argparse.Namespace) -> int:
    """Run an experiment, save its recording and write its report."""
    from masking.app.workflows.output_folders import RUN, check_folder
    from masking.app.workflows.run import record, save
    from masking.lab.runs.experiment import Experiment
    from masking.reports import run_report

    changes = dict(change(text) for text in chosen.set)
    made = Experiment.load(chosen.experiment, plant=chosen.plant, changes=changes)
    out = Path(chosen.out or f"results/{made.stem}")
    check_folder(out, *RUN, overwrite=chosen.overwrite)
    before = _created(out)
    if not made.is_compiled:
        say_compiling()
    raise_interrupts()
    try:
        with Bar("running") as bar:
            recording = record(made, out, chosen.budget, bar)
    except MaskingError:
        if before:
            print(f"{out} still holds the run of {before}", file=sys.stderr)
        raise
    written = save(recording, out)
    content = {
        "masking_error": recording.manifest["masking_error"],
        "limits_used": run_report.limits_used(recording),
        "warnings": run_report.warnings(recording),
        "recording": str(out),
        "report": str(written.path),
    }
    replaced = f" (replaces the run of {before})" if before else ""
    return answer(chosen.json, content, f"{written.summary}\nreport: {written.path}{replaced}")


def _created(folder: Path) -> str | None:
    """Return when the recording in a folder was made; None if there is none."""
    try:
        return str(json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["created"])
    except (OSError, ValueError, KeyError):
        return None


def _report(chosen: argparse.Namespace) -> int:
    """Write the report of a recording."""
    from masking.app.workflows.run import report

    written = report(chosen.record, chosen.out, overwrite=chosen.overwrite)
    content = {"report": str(written.path), "figures": [str(f) for f in written.figures]}
    return answer(chosen.json, content, f"{written.summary}\nreport: {written.path}")


def _add_recover(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("folder", metavar="FOLDER", help="that a run on a rig was to be saved in")
    add_out(sub, "FOLDER")


def _recover(chosen: argparse.Namespace) -> int:
    """Make the recording of a run on a rig that was killed; exit status 1 where its rows were damaged."""
    from masking.app.workflows.recover import recover

    made = recover(chosen.folder, out=chosen.out, overwrite=chosen.overwrite)
    answer(chosen.json, made.as_dict(), made)
    return int(bool(made.damages))


def _add_animate(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument(
        "record", metavar="RECORD", help="the folder of a recording; FOLDER@10:20 is its part from 10 s to 20 s"
    )
    text = "what to write: .html, .png or .svg for one instant, .gif or .mp4 (default: RECORD/animation.html)"
    sub.add_argument("--out", metavar="FILE", help=text)
    sub.add_argument("--overwrite", action="store_true", help="replace that file")
    sub.add_argument("--at", metavar="SECONDS", type=float, help="instant of a picture (default: the middle)")


def _animate(chosen: argparse.Namespace) -> int:
    """Animate a recording: the rig beside its virtual system, in a page, a picture or a film."""
    from masking.app.workflows.animate import animate

    with Bar("drawing") as bar:
        file = animate(chosen.record, out=chosen.out, overwrite=chosen.overwrite, at=chosen.at, progress=bar)
    return answer(chosen.json, {"animation": str(file)}, f"animation: {file}")


def _add_compare(sub: argparse.ArgumentParser) -> None:
    add_json(sub)
    sub.add_argument("first", metavar="RUN", help="the folder of a recording")
    sub.add_argument("second", metavar="RUN", help="the folder of another one")
    add_out(sub, "results/FIRST_SECOND")


def _compare(chosen: argparse.Namespace) -> int:
    """Compare two runs on one page: their motion, what was declared otherwise, and what came out of it."""
    from masking.app.workflows.compare import compare
    from masking.app.workflows.output_folders import beside
    from masking.reports.comparison_page import PAGE

    names = [beside(path).resolve().name for path in (chosen.first, chosen.second)]
    out = Path(chosen.out or f"results/{'_'.join(names)}")
    made = compare(chosen.first, chosen.second, out=out, overwrite=chosen.overwrite)
    return answer(chosen.json, {**made.as_dict(), "page": str(out / PAGE)}, f"{made}\npage: {out / PAGE}")


def change(text: str) -> tuple[str, float]:
    """Read one NAME=VALUE of the command line."""
    name, equals, value = text.partition("=")
    try:
        if not equals:
            raise ValueError(text)
        return name.strip(), float(value)
    except ValueError:
        message = f"'{text}' is not a change of a parameter"
        raise DeclarationError(Problem(None, "--set", message, "write it as in --set w3=0.6")) from None


VERBS = (
    Verb("run", _add_run, _run),
    Verb("report", _add_report, _report),
    Verb("recover", _add_recover, _recover),
    Verb("animate", _add_animate, _animate),
    Verb("compare", _add_compare, _compare),
)
