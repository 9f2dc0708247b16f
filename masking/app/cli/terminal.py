"""Standard output and standard error of the command line: what comes from outside is printed, and acts on nothing.

File names, headers of records, declarations, answers of plants and texts of exceptions all reach a terminal here. There
is a bar on standard error for what takes more than a second, and an interrupt is raised.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Any, TextIO, final

from masking.display.characters import visible, visible_line
from masking.lab.plants.operating_system import signal_main_thread

APART = 10.0  # s between lines of progress in a file or a pipe
INTERRUPTED = 130  # exit status
NOTHING_SAVED = "masking: interrupted; nothing was saved"
_LATER = 0.02  # s, after which an interrupt tries again
_FORM = "{desc} {percentage:3.0f}% {bar}"


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


class Bar:
    """A bar with a word for what is done, called with the part done; no bar where standard error cannot be written."""

    def __init__(self, text: str) -> None:
        import tqdm

        self._written, self._most = time.monotonic(), 0.0
        self._bar = tqdm.tqdm(
            file=raw(sys.stderr), total=1.0, desc=text, delay=1.0, leave=False, disable=None, bar_format=_FORM
        )

    def __call__(self, part: float) -> None:
        """Show the part done."""
        self._bar.update(part - self._bar.n)

    def tell(self, text: str, part: float) -> None:
        """Show what is done, and the part done, which never goes back; without a terminal, every `APART` s at most."""
        self._most = max(self._most, part)
        if self._bar.disable:
            now = time.monotonic()
            if now - self._written > APART:
                self._written = now
                with contextlib.suppress(OSError):
                    print(f"{self._most:4.0%}  {text}", file=sys.stderr, flush=True)
            return
        self._bar.set_description(visible_line(text), refresh=False)
        self(self._most)

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        with contextlib.suppress(OSError), self._bar.external_write_mode(file=raw(sys.stderr)):
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def say_compiling() -> None:
    """Print why nothing happens for a while."""
    print("compiling; this takes some ten seconds, once for each system", file=sys.stderr)


def end_at_interrupts() -> None:
    """Let an interrupt end the process with a line while packages are loading, which may catch what is raised."""

    def end(number: int, frame: FrameType | None) -> None:
        os.write(2, f"{NOTHING_SAVED}\n".encode())
        os._exit(INTERRUPTED)

    signal.signal(signal.SIGINT, end)


def raise_interrupts() -> None:
    """Let an interrupt be raised from here on: until now nothing was lost by ending the process."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, _raise_between_imports)


def _raise_between_imports(number: int, frame: FrameType | None) -> None:
    """Raise an interrupt, once no package is loading: what is raised inside of that may come out as another error."""
    at = frame
    while at is not None:
        if at.f_code.co_filename.startswith("<frozen importlib"):
            # A signal to the timer's thread would not end what the main one waits for.
            again = threading.Timer(_LATER, signal_main_thread, [number])
            again.daemon = True
            again.start()
            return
        at = at.f_back
    raise KeyboardInterrupt
