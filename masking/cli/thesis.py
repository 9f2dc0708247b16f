"""The verb thesis: the source document's figures and tables, computed again."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable

from masking import verbs
from masking.cli.progress import Bar, raise_interrupts


def add(verb: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the verb."""
    sub = verb(_thesis, "thesis", "compute the figures and tables of the source document again, beside its numbers")
    sub.add_argument(
        "--only", metavar="NUMBER", help="a figure, table or slip, such as 7.2 or 'Table 4.2'; printed only"
    )
    sub.add_argument("--out", metavar="DIR", help="where to write thesis.md and its pictures (default: docs)")


def _thesis(chosen: argparse.Namespace) -> int:
    raise_interrupts()
    out = chosen.out if chosen.only is not None else chosen.out or "docs"
    with Bar("computing") as bar:
        told = verbs.thesis(only=chosen.only, out=out, tell=bar.tell)
    if chosen.json:
        print(json.dumps(told.as_dict(), indent=2, ensure_ascii=False))
        return 0
    print(told)
    return 0
