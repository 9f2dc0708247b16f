"""Arming: a plant whose file says `arm: operator` is driven only once its operator has said so at a terminal.

It stays armed until a session ends otherwise than in order; then it has to be armed again.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Final, final

WORD: Final = "arm"
HOW: Final = f"the operator arms it by the word '{WORD}' and Enter at the terminal of the process that has the plant"


@final
class Arming:
    """Whether the operator has armed a plant, by a line of a terminal; any other line disarms it.

    `is_armed` says whether it may be driven. `lines` are read by a thread of their own; once they end, nobody can arm
    the plant any more.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self._changed, self.is_armed, self._is_over = threading.Condition(), False, False
        threading.Thread(target=self._read, args=(lines,), daemon=True).start()

    def disarm(self) -> None:
        """Ask for the operator again."""
        self.is_armed = False

    def wait(self) -> bool:
        """Wait for the operator; tell whether the plant is armed, or nobody can arm it any more."""
        with self._changed:
            self._changed.wait_for(lambda: self.is_armed or self._is_over)
            return self.is_armed

    def _read(self, lines: Iterable[str]) -> None:
        try:
            for line in lines:
                self._set(is_armed=line.strip() == WORD)
        except (OSError, ValueError):  # the terminal has gone
            pass
        self._set(is_armed=self.is_armed, is_over=True)

    def _set(self, *, is_armed: bool, is_over: bool = False) -> None:
        with self._changed:
            self.is_armed, self._is_over = is_armed, is_over
            self._changed.notify_all()
