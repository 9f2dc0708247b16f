"""Standard output and standard error of the command line: what comes from outside is printed, and acts on nothing.

File names, headers of records, declarations, answers of plants and texts of exceptions all reach a terminal here.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import Any, TextIO, final

from masking.display.characters import visible


@final
class PrintableStream:
    """A text stream that writes visible text alone; in all else it is the stream behind it, `raw`."""

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str) -> int:
        """Write a text; a character that no text may have, or that the encoding lacks, is written by its name."""
        encoding = self.raw.encoding or "utf-8"
        self.raw.write(visible(text).encode(encoding, "backslashreplace").decode(encoding))
        return len(text)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # of the stream
        return getattr(self.raw, name)


@contextlib.contextmanager
def printable() -> Iterator[None]:
    """Context in which everything that this process prints is visible text."""
    out: Any = PrintableStream(sys.stdout)
    error: Any = PrintableStream(sys.stderr)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        yield


def raw(stream: TextIO) -> TextIO:
    """Stream behind a printable one, for a bar that moves the cursor."""
    return stream.raw if isinstance(stream, PrintableStream) else stream
