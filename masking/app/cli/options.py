"""What a verb of the command line is, and options that several have."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from masking.app.cli.progress import raise_interrupts
from masking.app.workflows.choices import HOLDS

RECORD = "folder of a recording, or a parquet, csv, mat, h5, npz or json file; FILE@10:20 is its part from 10 s to 20 s"
NAMED = "a YAML file, or a name that 'masking list' shows"


@dataclass(frozen=True)
class Verb:
    """A verb of the command line.

    Args:
        name: as it is typed.
        add: adds its options to its parser, or the verbs of a group; called if the verb is asked for, since it may load
            packages.
        act: does it, and returns the exit status; None for a group.
        text: its help; by default the docstring of `act`, or of `add` for a group.
    """

    name: str
    add: Callable[[argparse.ArgumentParser], None]
    act: Callable[[argparse.Namespace], int] | None = None
    text: str = ""


def add_verb(
    found: argparse._SubParsersAction[argparse.ArgumentParser], verb: Verb, *, is_asked_for: bool = True
) -> None:
    """Add a verb to a parser, with its options if it is asked for.

    Args:
        found: verbs of the parser.
        verb: to add.
        is_asked_for: whether the command line names it.
    """
    text = (verb.text or (verb.act or verb.add).__doc__ or verb.name).removesuffix(".")
    first, more = text[0], text[1:]
    sub = found.add_parser(verb.name, help=f"{first.lower()}{more}", description=f"{first.upper()}{more}.")
    if is_asked_for:
        verb.add(sub)
        if verb.act is not None:
            sub.set_defaults(verb=verb.act)


def add_json(sub: argparse.ArgumentParser, *, after: str = "") -> None:
    """Add `--json`, which takes a file if it stands after the named argument."""
    if after:
        text = f"print JSON, or write it to a file; give it after {after}"
        sub.add_argument("--json", metavar="FILE", nargs="?", const=True, default=False, help=text)
    else:
        sub.add_argument("--json", action="store_true", help="print JSON")


def add_out(sub: argparse.ArgumentParser, default: str) -> None:
    """Add `--out`, with what its help says of the default, and `--overwrite`."""
    sub.add_argument("--out", metavar="DIR", help=f"where to save (default: {default})")
    sub.add_argument("--overwrite", action="store_true", help="replace an earlier result in that folder")


def answer(wanted: bool | str, content: object, text: object) -> int:
    """Print what a verb found, and return the exit status 0.

    Args:
        wanted: value of `--json`: whether to print JSON in place of the text, or the file that it is written to.
        content: as JSON can hold it, or JSON already.
        text: for people.
    """
    from masking.display.json_text import json_text

    numbers = content if isinstance(content, str) else json_text(content)
    if wanted is True:
        print(numbers, end="")
        return 0
    if wanted:
        Path(wanted).write_text(numbers, encoding="utf-8")
    print(text)
    return 0


def prepare(wanted: bool | str, out: Path) -> None:
    """Refuse folders that cannot be written, of results and of JSON, before any work; let signals interrupt."""
    from masking.app.workflows.output_folders import check_folder

    check_folder(out)
    if isinstance(wanted, str):
        check_folder(Path(wanted).parent)
    raise_interrupts()


def add_of_tables(sub: argparse.ArgumentParser) -> None:
    """Add the options of records that other programs wrote, and of the inputs between their samples."""
    text = (
        "hold of the inputs between samples: zero-order for commands, first-order for measured inputs, band-limited "
        "for inputs measured behind an anti-alias filter (default: zero-order; first-order for a measured motion)"
    )
    sub.add_argument("--hold", choices=HOLDS, help=text)
    text = "rename columns: NAME=COLUMN, with commas; in groups, structures or matrices V1=GROUP/COLUMN"
    sub.add_argument("--map", metavar="t=time,V1=u", default="", help=text)
    text = "names of the columns of a text without a line of names, in order"
    sub.add_argument("--columns", metavar="t,V1,s1", default="", help=text)
    sub.add_argument("--dt", metavar="SECONDS", type=float, help="time between samples, for a record without a clock")


def columns(chosen: argparse.Namespace) -> dict[str, str] | tuple[str, ...]:
    """Columns by the names that they get, or the names of all columns of a text that has none.

    Raises:
        RecordError: both are given, or a part of --map has no equals sign.
    """
    from masking.errors import RecordError
    from masking.lab.records import readers

    if chosen.map and chosen.columns:
        raise RecordError("--map renames columns and --columns names those that have no names; give one of them")
    return names(chosen.columns) or readers.mapping(chosen.map)


def settings_of_fit(chosen: argparse.Namespace) -> dict[str, Any]:
    """Settings that verbs that fit to records have in common."""
    return {
        "plant": chosen.plant,
        "validation": chosen.validate,
        "parameters": names(chosen.parameters),
        "shooting_interval": chosen.shooting_interval,
        "hold": chosen.hold,
        "columns": columns(chosen),
        "dt": chosen.dt,
    }


def names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
