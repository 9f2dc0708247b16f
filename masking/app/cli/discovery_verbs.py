"""The verbs discover and refine: what the model of a rig lacks, from a record, and what masking gains by that."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from masking.app.cli.options import (
    NAMED,
    RECORD,
    Verb,
    add_json,
    add_of_tables,
    add_out,
    answer,
    prepare,
    settings_of_fit,
)
from masking.app.cli.progress import Bar
from masking.app.workflows.choices import TOLERANCE


def _add_discover(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("record", metavar="RECORD", help=RECORD)
    sub.add_argument("--model", metavar="MODEL", help="model of the rig: a name or a YAML file")
    text = "its sensors and actuators (default: the outputs or coordinates of the model, and its inputs)"
    sub.add_argument("--plant", metavar="PLANT", help=text)
    _add_settings(sub)
    add_out(sub, "results/discovered")
    add_json(sub, after="RECORD")


def _add_refine(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("experiment", metavar="EXPERIMENT", help=NAMED)
    sub.add_argument("--record", metavar="RECORD", required=True, help=f"of its plant: {RECORD}")
    sub.add_argument("--plant", metavar="PLANT", help="run on another plant: a name or a YAML file")
    _add_settings(sub)
    add_out(sub, "results/EXPERIMENT_refined")
    add_json(sub, after="EXPERIMENT")


def _add_settings(sub: argparse.ArgumentParser) -> None:
    """Add the fields of `DiscoverySettings`."""
    text = "validation record (default: the last 30 %% of RECORD)"
    sub.add_argument("--validate", metavar="RECORD", help=text)
    text = "parameters to re-fit (default: all that appear in the equations)"
    sub.add_argument("--parameters", metavar="A,B", default="", help=text)
    text = "prior standard deviation, relative to its value, of a parameter that declares none (default: %(default)s)"
    sub.add_argument("--tolerance", metavar="PART", type=float, default=TOLERANCE, help=text)
    text = (
        "multiple-shooting interval in s, each with its own initial state (default: the whole record in one interval, "
        "or a twentieth of it for a model that does not settle)"
    )
    sub.add_argument("--shooting-interval", metavar="SECONDS", type=float, help=text)
    text = "a dictionary of your own effects, which are tried, too: a YAML file or a name"
    sub.add_argument("--effects", metavar="FILE", help=text)
    add_of_tables(sub)


def _settings(chosen: argparse.Namespace) -> dict[str, Any]:
    """Fields of `DiscoverySettings`, the plant, and whether a result may be replaced."""
    given = {"tolerance": chosen.tolerance, "effects": chosen.effects, "overwrite": chosen.overwrite}
    return {**settings_of_fit(chosen), **given}


def _discover(chosen: argparse.Namespace) -> int:
    """Find the physical effect that the model of a rig lacks, from a record, and add it."""
    from masking.app.workflows.discover import discover
    from masking.reports import discovery_files, discovery_page

    out = Path(chosen.out or "results/discovered")
    prepare(chosen.json, out)
    with Bar("reading the record") as bar:
        found = discover(chosen.record, model=chosen.model, out=out, tell=bar.tell, **_settings(chosen))
    summary = discovery_page.summary(found, discovery_files.paths(found, out))
    return answer(chosen.json, (out / discovery_files.NUMBERS).read_text(encoding="utf-8"), summary)


def _refine(chosen: argparse.Namespace) -> int:
    """Find what the controller's model of an experiment lacks, and run it without and with that."""
    from masking.app.workflows.refine import refine

    out = Path(chosen.out or f"results/{Path(chosen.experiment).stem}_refined")
    prepare(chosen.json, out)
    with Bar("reading the record") as bar:
        found = refine(chosen.experiment, record=chosen.record, out=out, tell=bar.tell, **_settings(chosen))
    return answer(chosen.json, (out / "refine.json").read_text(encoding="utf-8"), found)


VERBS = (
    Verb("discover", _add_discover, _discover),
    Verb("refine", _add_refine, _refine),
)
