"""Verbs that look at declarations: list, show, check, play, schema."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict

from masking.app.cli.progress import raise_interrupts, say_compiling
from masking.app.cli.verb import Call, verb

_STATUS = "Exit status: 0 sound, 1 sound but an experiment does not fit the limits of its rig, 2 problems."


@verb("model.declaration.catalogue:catalogue")
def _list(call: Call) -> int:
    """List the packaged models, plants, experiments and dictionaries of effects."""
    entries = call.do()
    return call.answer([asdict(entry) for entry in entries], entries)


@verb(metavars={"name_or_path": "NAME"})
def _show(call: Call) -> int:
    """Show a model, a plant, an experiment or physical effects."""
    description = call.do()
    return call.answer(description.content, description)


@verb(metavars={"files": "FILE"}, note=_STATUS)
def _check(call: Call) -> int:
    """Check declarations: each problem with its place, and whether an experiment fits its rig."""
    results = call.do(compiling=say_compiling)
    call.answer([result.as_dict() for result in results], "\n".join(map(str, results)))
    fits = all(result.feasibility is None or result.feasibility.fits for result in results)
    return 2 if any(result.problems for result in results) else 0 if fits else 1


@verb(doing="compiling", metavars={"model": "MODEL"}, interrupted="masking: the page has ended")
def _play(call: Call) -> int:
    """Show a model on a local page: sliders of its parameters and initial values, and its motion. Ctrl+C ends it."""
    raise_interrupts()
    with call.do() as page:
        call.answer(page.as_dict(), page)
        sys.stdout.flush()
        while True:
            time.sleep(1.0)


@verb("model.declaration.json_schema:json_schema")
def _schema(call: Call) -> int:
    """Print the JSON Schema of a kind of declaration, for editors."""
    print(json.dumps(call.do(), indent=2))
    return 0


VERBS = (_list, _show, _check, _play, _schema)
