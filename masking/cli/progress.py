"""Progress: a bar on standard error for what takes more than a second, and an interrupt that is raised."""

from __future__ import annotations

import signal
import sys
from types import TracebackType
from typing import TYPE_CHECKING

import lazy_loader as lazy

if TYPE_CHECKING:
    import tqdm
else:
    tqdm = lazy.load("tqdm")

INTERRUPTED = 130  # exit status
_FORM = "{desc} {percentage:3.0f}% {bar}"


class Bar:
    """A bar with a word for what is done; called with the part done."""

    def __init__(self, text: str) -> None:
        self._bar = tqdm.tqdm(total=1.0, desc=text, delay=1.0, leave=False, disable=None, bar_format=_FORM)

    def __call__(self, part: float) -> None:
        """Show the part done."""
        self._bar.update(part - self._bar.n)

    def tell(self, text: str, part: float) -> None:
        """Show what is done, and the part done; it never goes back."""
        self._bar.set_description(text, refresh=False)
        self(max(part, self._bar.n))

    def say(self, text: str) -> None:
        """Print a line above the bar."""
        with self._bar.external_write_mode(file=sys.stderr):
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Take the bar away."""
        self._bar.close()

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def raise_interrupts() -> None:
    """Let an interrupt be raised from here on: until now nothing was lost by ending the process."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
