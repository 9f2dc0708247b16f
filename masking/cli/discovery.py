"""The verbs discover and refine: what a model is missing, from a record of the rig, and what that makes of masking."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.cli.options import RECORD, add_of_tables, names
from masking.cli.progress import Bar, raise_interrupts
from masking.workflows import verbs

if TYPE_CHECKING:
    from masking.records import readers
    from masking.reports import discovery_page
else:
    readers = lazy.load("masking.records.readers", suppress_warning=True)
    discovery_page = lazy.load("masking.reports.discovery_page", suppress_warning=True)

NUMBERS = "discovery.json"


def add_discover(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb discover."""
    text = "find out which physical effect a model is missing, from a record of the rig, and add it"
    sub = found.add_parser("discover", help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.add_argument("record", metavar="RECORD", help=RECORD)
    sub.add_argument("--model", metavar="MODEL", help="model of the rig: a name or a YAML file")
    text = "its sensors and actuators (default: the outputs or coordinates of the model, and its inputs)"
    sub.add_argument("--plant", metavar="PLANT", help=text)
    _add_of_records(sub)
    sub.add_argument("--out", metavar="DIR", help="where to save (default: results/discovered)")
    text = "print JSON, or write it to a file; give it after RECORD"
    sub.add_argument("--json", metavar="FILE", nargs="?", const=True, default=False, help=text)
    sub.set_defaults(verb=_discover)


def add_refine(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb refine."""
    text = "find out what the controller's model of an experiment is missing, and run it before and after"
    sub = found.add_parser("refine", help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.add_argument("experiment", metavar="EXPERIMENT", help="a YAML file, or a name that 'masking list' shows")
    sub.add_argument("--record", metavar="RECORD", required=True, help=f"of its plant: {RECORD}")
    sub.add_argument("--plant", metavar="PLANT", help="run on another plant: a name or a YAML file")
    _add_of_records(sub)
    sub.add_argument("--out", metavar="DIR", help="where to save (default: results/EXPERIMENT_refined)")
    text = "print JSON, or write it to a file; give it after EXPERIMENT"
    sub.add_argument("--json", metavar="FILE", nargs="?", const=True, default=False, help=text)
    sub.set_defaults(verb=_refine)


def _add_of_records(sub: argparse.ArgumentParser) -> None:
    """Add what is said of records, and of the model that is held against them."""
    text = "another record, for validation (default: the last part of the record)"
    sub.add_argument("--validate", metavar="RECORD", help=text)
    sub.add_argument("--parameters", metavar="A,B", default="", help="that may be off (default: all of the equations)")
    text = "relative standard deviation of a parameter that declares none (default: %(default)s)"
    sub.add_argument("--tolerance", metavar="PART", type=float, default=verbs.TOLERANCE, help=text)
    text = (
        "length of the intervals of multiple shooting, each with an initial state of its own (default: the whole "
        "record, or shorter intervals if the model is not asymptotically stable)"
    )
    sub.add_argument("--shooting-interval", metavar="SECONDS", type=float, help=text)
    text = "a dictionary of effects of your own, which are tried, too: a YAML file or a name"
    sub.add_argument("--effects", metavar="FILE", help=text)
    add_of_tables(sub)


def _discover(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or "results/discovered")
    _prepare(chosen)
    with Bar("reading the record") as bar:
        found, files = verbs.discovered(chosen.record, model=chosen.model, out=out, tell=bar.tell, **_settings(chosen))
    return _tell(chosen.json, out / NUMBERS, lambda: discovery_page.summary(found, files))


def _refine(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or f"results/{Path(chosen.experiment).stem}_refined")
    _prepare(chosen)
    with Bar("reading the record") as bar:
        found = verbs.refine(chosen.experiment, record=chosen.record, out=out, tell=bar.tell, **_settings(chosen))
    return _tell(chosen.json, out / "refine.json", lambda: str(found))


def _prepare(chosen: argparse.Namespace) -> None:
    """Refuse a file for JSON that cannot be written, before any work, and let signals interrupt."""
    if chosen.json and chosen.json is not True:
        verbs.check_folder(Path(chosen.json).parent)
    raise_interrupts()


def _settings(chosen: argparse.Namespace) -> dict[str, Any]:
    """Return what is said of records, and of the model that is held against them."""
    return {
        "plant": chosen.plant,
        "validation": chosen.validate,
        "parameters": names(chosen.parameters),
        "tolerance": chosen.tolerance,
        "shooting_interval": chosen.shooting_interval,
        "hold": chosen.hold,
        "columns": readers.mapping(chosen.map),
        "dt": chosen.dt,
        "effects": chosen.effects,
    }


def _tell(wanted: str | bool, numbers: Path, summary: Callable[[], str]) -> int:
    """Print the numbers that were written as JSON, or a summary; write them to a further file where one is named."""
    text_of_numbers = numbers.read_text(encoding="utf-8")
    if wanted is True:
        print(text_of_numbers, end="")
        return 0
    if wanted:
        Path(wanted).write_text(text_of_numbers, encoding="utf-8")
    print(summary())
    return 0
