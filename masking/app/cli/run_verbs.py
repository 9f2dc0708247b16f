"""Verbs of an experiment or a model, and of its recordings: run, report, recover, animate, compare, sweep, and more."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path

from masking.app.cli.progress import Bar, raise_interrupts, say_compiling
from masking.app.cli.verb import Call, verb
from masking.errors import MaskingError

_EITHER = {"name_or_path": "MODEL_OR_EXPERIMENT"}


@verb(out="results/{name_or_path}", metavars={"name_or_path": "EXPERIMENT"})
def _run(call: Call) -> int:
    """Run an experiment, save its recording and write its report; exit status 1 where chi is above 1."""
    from masking.app.workflows.output_folders import RUN, own_folder
    from masking.app.workflows.run import record, save
    from masking.lab.runs.experiment import Experiment
    from masking.reports import run_report

    written = call.written
    changes = dict(written.get("changes", ()))
    made = Experiment.load(written["name_or_path"], plant=written.get("plant"), changes=changes)
    out = call.out
    with own_folder(out, *RUN, overwrite=written.get("overwrite", False)):
        before = None  # when the recording was made that is there
        with contextlib.suppress(OSError, ValueError, KeyError):
            before = str(json.loads((out / "manifest.json").read_text(encoding="utf-8"))["created"])
        if not made.is_compiled:
            say_compiling()
        raise_interrupts()
        try:
            with Bar("running") as bar:
                recording = record(made, out, written.get("budget"), bar)
        except MaskingError:
            if before:
                print(f"{out} still holds the run of {before}", file=sys.stderr)
            raise
        page = save(recording, out)
    content = {
        "masking_error": recording.manifest["masking_error"],
        "limits_used": run_report.limits_used(recording),
        "warnings": run_report.warnings(recording),
        "recording": str(out),
        "report": str(page.path),
    }
    replaced = f" (replaces the run of {before})" if before else ""
    call.answer(content, f"{page}{replaced}")
    return int(bool(run_report.strayed(recording)))


@verb("app.workflows.run:report")
def _report(call: Call) -> int:
    """Write the report of a recording, or one page of any result."""
    made = call.do()
    content = {"report": str(made.path), "figures": [str(figure) for figure in made.figures]}
    return call.answer(content, made)


@verb()
def _recover(call: Call) -> int:
    """Make the recording of a run on a rig that was killed; exit status 1 where its rows were damaged."""
    made = call.do()
    call.answer(made.as_dict(), made)
    return int(bool(made.damages))


@verb(doing="drawing", metavars={"out": "FILE"})
def _animate(call: Call) -> int:
    """Animate a recording: the rig beside its virtual system, in a page, a picture or a film."""
    file = call.do()
    return call.answer({"animation": str(file)}, f"animation: {file}")


@verb(out="results/{first}_{second}", metavars={"first": "RUN", "second": "RUN"})
def _compare(call: Call) -> int:
    """Compare two runs on one page: their motion, what was declared otherwise, and what came out of it."""
    from masking.app.workflows.output_folders import beside
    from masking.reports.comparison_page import PAGE

    names = [beside(call.written[run]).resolve().name for run in ("first", "second")]
    out = Path(call.written.get("out") or f"results/{'_'.join(names)}")
    made = call.do(out=out)
    return call.answer({**made.as_dict(), "page": str(out / PAGE)}, f"{made}\npage: {out / PAGE}")


@verb(
    out="results/{experiment}_sweep",
    doing="running",
    interrupted="masking: interrupted; {out} has the finished runs, the same command makes the others",
    note="If a sweep is interrupted, the same command makes the runs that are missing.",
)
def _sweep(call: Call) -> int:
    """Run an experiment many times with other values, and measure each run."""
    found = call.do()
    return call.answer(found.as_dict(), f"{found}\npage: {call.out / 'sweep.html'}")


@verb(out="results/{name_or_path}_stability", doing="deriving", has_json_file=True, metavars=_EITHER)
def _stability(call: Call) -> int:
    """Find the equilibria and modes of a model or an experiment, and what its energy proves of all its motions."""
    found = call.do()
    numbers = (call.out / "stability.json").read_text(encoding="utf-8")
    return call.answer(numbers, f"{found}\npage: {call.out / 'stability.html'}")


@verb(metavars={"name_or_path": "EXPERIMENT"})
def _export(call: Call) -> int:
    """Write a controller, a rig or a model as C or as an FMU."""
    return call.answered()


VERBS = (_run, _report, _recover, _animate, _compare, _sweep, _stability, _export)
