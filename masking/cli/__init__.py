"""The command line: one sub-command for each verb, each a few lines over `masking.workflows`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking.cli.progress import end_at_interrupts

if TYPE_CHECKING:
    from masking.cli import parser
else:
    parser = lazy.load("masking.cli.parser", suppress_warning=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status, see `parser.main`."""
    if arguments is None:  # in a process of its own
        end_at_interrupts()
    return parser.main(arguments)


__all__ = ["main"]
