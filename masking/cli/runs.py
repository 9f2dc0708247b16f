"""Verbs that run an experiment and report what was recorded: run, report."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from masking.cli.declarations import say_compiling
from masking.cli.options import NAMED, Verb, add_json, add_out, answer
from masking.cli.progress import Bar, raise_interrupts
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
    sub.add_argument("--out", metavar="DIR", help="where to write (default: beside the recording)")


def _run(chosen: argparse.Namespace) -> int:
    """Run an experiment, save its recording and write its report."""
    from masking.reports import run_report
    from masking.runs import error_budget
    from masking.runs.experiment import Experiment
    from masking.workflows.outputs import check_folder

    changes = dict(change(text) for text in chosen.set)
    made = Experiment.load(chosen.experiment, plant=chosen.plant, changes=changes)
    out = Path(chosen.out or f"results/{made.stem}")
    check_folder(out)
    before = _created(out)
    if not made.is_compiled:
        say_compiling()
    raise_interrupts()
    try:
        with Bar("running") as bar:
            recording = error_budget.run(made, chosen.budget, bar)
    except MaskingError:
        if before:
            print(f"{out} still holds the run of {before}", file=sys.stderr)
        raise
    recording.save(out)
    written = run_report.report(recording, out)
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
    from masking.workflows.run import report

    written = report(chosen.record, chosen.out)
    content = {"report": str(written.path), "figures": [str(f) for f in written.figures]}
    return answer(chosen.json, content, f"{written.summary}\nreport: {written.path}")


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
)
