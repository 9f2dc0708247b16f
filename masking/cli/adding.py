"""How a verb is added to the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable

Verb = Callable[[argparse.Namespace], int]
# Adds a verb by its function, its name and a text; returns its parser.
Add = Callable[[Verb, str, str], argparse.ArgumentParser]


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


def names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    return tuple(name.strip() for name in text.split(",") if name.strip())
