"""Verbs that hold a rig's model against records of it: simulate, identify, measure, discover, refine."""

from __future__ import annotations

import inspect
from functools import partial

from masking.app.cli.verb import Call, Verb, verb
from masking.app.workflows.settings_keywords import Parameter, parameters

_EXPERIMENT = {"name_or_path": "EXPERIMENT"}
_EXPLAIN = {"explain": "print every hypothesis that was looked at, what suggested it, and why it was not taken"}


@verb(out="results/identified", doing="fitting", metavars={"records": "RECORD"})
def _identify(call: Call) -> int:
    """Fit parameters of a plant to recordings of it."""
    found = call.do()
    files = {"model": "model.yaml", "plant": "plant.yaml", "page": "fit.html"}
    paths = {name: str(call.out / file) for name, file in files.items()}
    text = f"{found}\nwritten: {paths['model']}, {paths['plant']}\npage: {paths['page']}"
    return call.answer({**found.as_dict(), **paths}, text)


@verb(out="results/simulated", doing="simulating", has_json_file=True)
def _simulate(call: Call) -> int:
    """Simulate a record with a model: measured against simulated."""
    made, page = call.do(), call.out / "simulation.html"
    numbers = page.with_suffix(".json").read_text(encoding="utf-8")
    return call.answer(numbers, f"{made}\npage: {page}")


def _measure(call: Call) -> int:
    procedure = call.verb.name
    found, page = call.do(procedure), call.out / f"{procedure}.html"
    content = {**found.as_dict(), "page": str(page), "numbers": str(page.with_suffix(".json"))}
    del content["series"]  # which the file has
    return call.answer(content, f"{found}\npage: {page}")


@verb(out="results/discovered", doing="reading the record", has_json_file=True, flags=_EXPLAIN)
def _discover(call: Call) -> int:
    """Find the physical effect that the model of a rig lacks, from a record, and add it."""
    from masking.reports import discovery_files, discovery_page, discovery_trace

    found = call.do()
    numbers = (call.out / discovery_files.NUMBERS).read_text(encoding="utf-8")
    said = [discovery_page.summary(found, discovery_files.paths(found, call.out))]
    if "explain" in call.written:
        said.insert(0, discovery_trace.table(found))
    return call.answer(numbers, "\n".join(said))


@verb(out="results/{name_or_path}_refined", doing="reading the record", has_json_file=True, metavars=_EXPERIMENT)
def _refine(call: Call) -> int:
    """Find what the controller's model of an experiment lacks, and run it without and with that."""
    found = call.do()
    return call.answer((call.out / "refine.json").read_text(encoding="utf-8"), found)


def _of_procedure(name: str, known: dict[str, Parameter]) -> dict[str, Parameter]:
    """Parameters of `measure` that a procedure has, with its own defaults."""
    from masking.app.workflows.measure import PROCEDURES

    settings = {n: p for n, p in parameters(PROCEDURES[name]).items() if p.kind is inspect.Parameter.KEYWORD_ONLY}
    return {n: known[n] for n in ("records", "plant", "out", "overwrite")} | settings


_PROCEDURES = {
    "springs": "The curve of a spring from a slow ramp of force up and down, such as 60 s: Table B.4.",
    "actuators": "The gain at which two actuators balance, from sines against each other with a swept gain: appendix "
    "C.5. The oscillator must be held: on a free rig its spring carries a part of the force, and the balance goes "
    "astray.",
    "friction": "The shift of the equilibrium by friction, from saw-teeth, and the displacement at which it engages, "
    "from a ramp: appendix C.6.2.",
    "response": "Frequency response from periods of a multisine, and distortion if lines are left free.",
}


_MEASURE = Verb(
    "measure",
    "Do one procedure of the identification on a record made for it.",
    verbs=tuple(
        Verb(
            name,
            text,
            "app.workflows.measure:measure",
            _measure,
            select=partial(_of_procedure, name),
            out=f"results/{name}",
            doing="measuring",
            metavars={"records": "RECORD"},
        )
        for name, text in _PROCEDURES.items()
    ),
)
VERBS = (_simulate, _identify, _MEASURE, _discover, _refine)
