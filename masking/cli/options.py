"""How a verb is added to the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from masking.workflows import verbs

Verb = Callable[[argparse.Namespace], int]
# Adds a verb by its function, its name and a text; returns its parser.
Add = Callable[[Verb, str, str], argparse.ArgumentParser]

# What a record may be.
RECORD = "the folder of a recording, or a parquet, csv, mat or h5 file; FILE@10:20 is its part from 10 s to 20 s"


def add_to(found: argparse._SubParsersAction[argparse.ArgumentParser], *flags: tuple[str, str]) -> Add:
    """Return what adds verbs with `--json` and further flags, each with its help."""

    def add(verb: Verb, name: str, text: str) -> argparse.ArgumentParser:
        sub = found.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        sub.add_argument("--json", action="store_true", help="print JSON")
        for flag, words in flags:
            sub.add_argument(flag, action="store_true", help=words)
        sub.set_defaults(verb=verb)
        return sub

    return add


def add_of_tables(sub: argparse.ArgumentParser) -> None:
    """Add what is said of records that other programs wrote, and of how inputs go between their samples."""
    text = (
        "hold of the inputs between samples: zero-order for commands, first-order for measured inputs, band-limited "
        "for inputs measured behind an anti-alias filter (default: zero-order; first-order for a measured motion)"
    )
    sub.add_argument("--hold", choices=verbs.HOLDS, help=text)
    text = "rename columns: NAME=COLUMN, with commas; in groups of an HDF5 file V1=GROUP/COLUMN"
    sub.add_argument("--map", metavar="t=time,V1=u", default="", help=text)
    sub.add_argument("--dt", metavar="SECONDS", type=float, help="time between samples, for a record without a clock")


def names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
