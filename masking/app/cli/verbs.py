"""Verbs over files: declarations, experiments and models, recordings, and models held against records of a rig."""

from __future__ import annotations

import contextlib
import inspect
import json
import sys
import time
from functools import partial

from masking.app.cli.terminal import raise_interrupts, say_compiling
from masking.app.cli.verb import Call, Verb, verb
from masking.app.workflows.settings_keywords import Parameter, parameters
from masking.errors import MaskingError

_EXPERIMENT = {"name_or_path": "EXPERIMENT"}
_EXPLAIN = {"explain": "print every hypothesis that was looked at, what suggested it, and why it was not taken"}
_PROCEDURES = {
    "springs": "The curve of a spring from a slow ramp of force up and down, such as 60 s: Table B.4.",
    "actuators": "The gain at which two actuators balance, from sines against each other with a swept gain: appendix "
    "C.5. The oscillator must be held: on a free rig its spring carries a part of the force, and the balance goes "
    "astray.",
    "friction": "The shift of the equilibrium by friction, from saw-teeth, and the displacement at which it engages, "
    "from a ramp: appendix C.6.2.",
    "response": "Frequency response from periods of a multisine, and distortion if lines are left free.",
}


@verb(note="Exit status: 0 sound, 1 sound but an experiment does not fit the limits of its rig, 2 problems.",
      metavars={"files": "FILE"})  # fmt: skip
def _check(call: Call) -> int:
    """Check declarations: each problem with its place, and whether an experiment fits its rig."""
    results = call.do(compiling=say_compiling)
    call.answer(results, "\n".join(map(str, results)))
    fits = all(result.feasibility is None or result.feasibility.fits for result in results)
    return 2 if any(result.problems for result in results) else 0 if fits else 1


@verb(doing="compiling", metavars={"model": "MODEL"}, interrupted="masking: the page has ended")
def _play(call: Call) -> int:
    """Show a model on a local page: sliders of its parameters and initial values, and its motion. Ctrl+C ends it."""
    raise_interrupts()
    with call.do() as page:
        call.answer(page, page)
        sys.stdout.flush()
        while True:
            time.sleep(1.0)


@verb("model.declaration.json_schema:json_schema")
def _schema(call: Call) -> int:
    """Print the JSON Schema of a kind of declaration, for editors."""
    print(json.dumps(call.do(), indent=2))
    return 0


@verb(out="results/{name_or_path}", doing="running", metavars=_EXPERIMENT)
def _run(call: Call) -> int:
    """Run an experiment, save its recording and write its report; exit status 1 where chi is above 1."""
    from masking.reports import run_report

    before = ""  # when the recording was made that is there
    with contextlib.suppress(OSError, ValueError, KeyError):
        before = str(json.loads((call.out / "manifest.json").read_text(encoding="utf-8"))["created"])
    try:
        recording = call.do(compiling=say_compiling)
    except MaskingError:
        if before and "overwrite" in call.written:
            print(f"{call.out} still holds the run of {before}", file=sys.stderr)
        raise
    content = {
        "masking_error": recording.manifest["masking_error"],
        "limits_used": run_report.limits_used(recording),
        "warnings": run_report.warnings(recording),
        "recording": call.out,
        "report": call.out / run_report.PAGE,
    }
    replaced = f" (replaces the run of {before})" if before else ""
    call.answer(content, f"{recording}\nreport: {content['report']}{replaced}")
    return int(bool(run_report.strayed(recording)))


@verb()
def _recover(call: Call) -> int:
    """Make the recording of a run on a rig that was killed; exit status 1 where its rows were damaged."""
    made = call.do()
    call.answer(made, made)
    return int(bool(made.damages))


@verb(doing="drawing", metavars={"out": "FILE"})
def _animate(call: Call) -> int:
    """Animate a recording: the rig beside its virtual system, in a page, a picture or a film."""
    file = call.do()
    return call.answer({"animation": file}, f"animation: {file}")


@verb(out="results/{first}_{second}", page="comparison.html", metavars={"first": "RUN", "second": "RUN"})
def _compare(call: Call) -> int:
    """Compare two runs on one page: their motion, what was declared otherwise, and what came out of it."""
    from masking.app.workflows.output_folders import beside

    names = [beside(call.written[run]).resolve().name for run in ("first", "second")]
    return call.answered(call.written.get("out") or f"results/{'_'.join(names)}")


@verb(out="results/identified", doing="fitting", metavars={"records": "RECORD"})
def _identify(call: Call) -> int:
    """Fit parameters of a plant to recordings of it."""
    found = call.do()
    files = {"model": "model.yaml", "plant": "plant.yaml", "page": "fit.html"}
    paths = {name: str(call.out / file) for name, file in files.items()}
    text = f"{found}\nwritten: {paths['model']}, {paths['plant']}\npage: {paths['page']}"
    return call.answer({**found.as_dict(), **paths}, text)


def _measure(call: Call) -> int:
    procedure = call.verb.name
    found, page = call.do(procedure), call.out / f"{procedure}.html"
    content = {**found.as_dict(), "page": page, "numbers": page.with_suffix(".json")}
    del content["series"]  # which the file has
    return call.answer(content, f"{found}\npage: {page}")


@verb(out="results/discovered", doing="reading the record", numbers="discovery.json", flags=_EXPLAIN)
def _discover(call: Call) -> int:
    """Find the physical effect that the model of a rig lacks, from a record, and add it."""
    from masking.reports import discovery_files, discovery_page

    found = call.do()
    said = [discovery_page.summary(found, discovery_files.paths(found, call.out))]
    if "explain" in call.written:
        said.insert(0, discovery_page.trace_text(found))
    return call.answer(found, "\n".join(said))


def _of_procedure(name: str, known: dict[str, Parameter]) -> dict[str, Parameter]:
    """Parameters of `measure` that a procedure has, with its own defaults."""
    from masking.app.workflows.measure import PROCEDURES

    settings = {n: p for n, p in parameters(PROCEDURES[name]).items() if p.kind is inspect.Parameter.KEYWORD_ONLY}
    return {n: known[n] for n in ("records", "plant", "out", "overwrite")} | settings


_MEASURES = tuple(
    Verb(name, text, "app.workflows.measure:measure", _measure, select=partial(_of_procedure, name),
         out=f"results/{name}", doing="measuring", metavars={"records": "RECORD"})
    for name, text in _PROCEDURES.items()
)  # fmt: skip
VERBS = (
    Verb(
        "list",
        "List the packaged models, plants, experiments and dictionaries of effects.",
        "model.declaration.catalogue:catalogue",
    ),
    Verb("show", "Show a model, a plant, an experiment or physical effects.", metavars={"name_or_path": "NAME"}),
    _check,
    _play,
    _schema,
    _run,
    Verb("report", "Write the report of a recording, or one page of any result.", "app.workflows.run:report"),
    _recover,
    _animate,
    _compare,
    Verb(
        "sweep",
        "Run an experiment many times with other values, and measure each run.",
        out="results/{experiment}_sweep",
        page="sweep.html",
        doing="running",
        interrupted="masking: interrupted; {out} has the finished runs, the same command makes the others",
        note="If a sweep is interrupted, the same command makes the runs that are missing.",
    ),
    Verb(
        "stability",
        "Find the equilibria and modes of a model or an experiment, and what its energy proves of all its motions.",
        out="results/{name_or_path}_stability",
        page="stability.html",
        numbers="stability.json",
        doing="deriving",
        metavars={"name_or_path": "MODEL_OR_EXPERIMENT"},
    ),
    Verb("export", "Write a controller, a rig or a model as C or as an FMU.", metavars=_EXPERIMENT),
    Verb(
        "simulate",
        "Simulate a record with a model: measured against simulated.",
        out="results/simulated",
        page="simulation.html",
        numbers="simulation.json",
        doing="simulating",
    ),
    _identify,
    Verb("measure", "Do one procedure of the identification on a record made for it.", verbs=_MEASURES),
    _discover,
    Verb(
        "refine",
        "Find what the controller's model of an experiment lacks, and run it without and with that.",
        out="results/{name_or_path}_refined",
        numbers="refine.json",
        doing="reading the record",
        metavars=_EXPERIMENT,
    ),
)
