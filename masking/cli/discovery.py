"""The verb discover: what a model is missing, from a record of the rig."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking import verbs
from masking.cli.adding import names
from masking.cli.progress import Bar, raise_interrupts

if TYPE_CHECKING:
    from masking import formats
    from masking.discovery import pages
else:
    formats = lazy.load("masking.formats", suppress_warning=True)
    pages = lazy.load("masking.discovery.pages", suppress_warning=True)

NUMBERS = "discovery.json"


def add_discover(found: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the verb discover."""
    text = "find out which physical effect a model is missing, from a record of the rig, and add it"
    sub = found.add_parser("discover", help=text, description=f"{text[0].upper()}{text[1:]}.")
    sub.add_argument("record", metavar="RECORD", help="the folder of a recording, or a parquet, csv or mat file")
    sub.add_argument("--model", metavar="MODEL", help="what is believed of the rig: a name or a YAML file")
    text = "its sensors and actuators (default: the outputs or coordinates of the model, and its inputs)"
    sub.add_argument("--plant", metavar="PLANT", help=text)
    text = "another record, to judge by (default: the last part of the record)"
    sub.add_argument("--validate", metavar="RECORD", help=text)
    sub.add_argument("--parameters", metavar="A,B", default="", help="that may be off (default: all of the equations)")
    text = "relative standard deviation of a parameter that declares none (default: %(default)s)"
    sub.add_argument("--tolerance", metavar="PART", type=float, default=verbs.TOLERANCE, help=text)
    text = (
        "how inputs go from sample to sample: commands that are held, or inputs that were measured, in straight lines "
        "(default: %(default)s)"
    )
    sub.add_argument("--between", choices=verbs.BETWEEN, default=verbs.BETWEEN[0], help=text)
    sub.add_argument("--map", metavar="t=time,V1=u", default="", help="rename columns: NAME=COLUMN, with commas")
    sub.add_argument("--dt", metavar="SECONDS", type=float, help="time between samples, for a record without a clock")
    sub.add_argument("--out", metavar="DIR", help="where to save (default: results/discovered)")
    text = "print JSON, or write it to a file; give it after RECORD"
    sub.add_argument("--json", metavar="FILE", nargs="?", const=True, default=False, help=text)
    sub.set_defaults(verb=_discover)


def _discover(chosen: argparse.Namespace) -> int:
    out = Path(chosen.out or "results/discovered")
    if chosen.json and chosen.json is not True:
        verbs.check_folder(Path(chosen.json).parent)
    raise_interrupts()
    with Bar("reading the record") as bar:
        found, files = verbs.discovered(
            chosen.record,
            model=chosen.model,
            plant=chosen.plant,
            validation=chosen.validate,
            parameters=names(chosen.parameters),
            tolerance=chosen.tolerance,
            between=chosen.between,
            columns=formats.mapping(chosen.map),
            dt=chosen.dt,
            out=out,
            tell=bar.tell,
        )
    told = (out / NUMBERS).read_text(encoding="utf-8")
    if chosen.json is True:
        print(told, end="")
        return 0
    if chosen.json:
        Path(chosen.json).write_text(told, encoding="utf-8")
    print(pages.summary(found, files))
    return 0
