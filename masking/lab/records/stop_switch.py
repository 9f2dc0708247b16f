"""Stop switch: the emergency stop of a running loop, and the presence of its operator, in memory of all processes.

`runs.operator_link` makes it, looks at it in each tick, for less than a microsecond, and trips `plants.safety_chain`;
whoever has opened it presses it. It also holds the state of the loop as JSON, since rows of a `Ring` are numbers only.

    "MASKSTOP"  process  pressed  acknowledged  seen  versions begun  versions whole  bytes of text     each 8 bytes
    text        JSON

`pressed` is one of `Presser`; `seen` is when the operator's page was last heard of, in ns of the monotonic clock.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import sys
import time
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any, Final, final

from masking.errors import OperatorError, RecordError
from masking.lab.records.ring import MEMORY, shared_file

MAGIC: Final = int.from_bytes(b"MASKSTOP", "little")
ENDING: Final = ".switch"
_HEAD: Final = 8  # integers before the text
_MAGIC, _PROCESS, _PRESSED, _ACKNOWLEDGED, _SEEN, _BEGUN, _WHOLE, _TEXT = range(_HEAD)
_SIZE: Final = 1 << 14
_MOST: Final = _SIZE - 8 * _HEAD
_TRIES: Final = 100


def _shortened(value: Any, length: int) -> Any:  # noqa: ANN401  # trees of what JSON can hold
    """The same with texts of at most some characters."""
    if isinstance(value, dict):
        return {name: _shortened(each, length) for name, each in value.items()}
    return value[:length] if isinstance(value, str) else value


class Presser(IntEnum):
    """Who pressed a switch."""

    NOBODY = 0
    PAGE = 1
    COMMAND_LINE = 2
    FILE = 3


@final
class Switch:
    """A switch that another process made; `Switch.make` makes one. A RecordError where the file is none."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with self.path.open("r+b") as file:
                if sys.platform != "win32" and os.fstat(file.fileno()).st_uid != os.getuid():
                    raise ValueError("another user's")
                self._memory = mmap.mmap(file.fileno(), _SIZE)
        except (OSError, ValueError) as error:
            raise RecordError(f"{self.path}: no switch of a running loop ({error}); it ends with its loop") from error
        self._words = memoryview(self._memory)[: 8 * _HEAD].cast("q")
        if self._words[_MAGIC] != MAGIC:
            raise RecordError(f"{self.path}: no switch of a running loop; it does not begin as one")

    @classmethod
    def make(cls) -> Switch:
        """New switch, of this process, that nobody has pressed."""
        handle, path = shared_file(ENDING)
        with os.fdopen(handle, "r+b") as file:
            file.truncate(_SIZE)
            file.write(MAGIC.to_bytes(8, "little") + os.getpid().to_bytes(8, "little"))
        return cls(path)

    @property
    def process(self) -> int:
        """Number of the process that made it."""
        return self._words[_PROCESS]

    @property
    def pressed(self) -> int:
        """Who pressed it, a number of `Presser`; 0 while nobody has."""
        return self._words[_PRESSED]

    def press(self, presser: Presser) -> None:
        """Stop the loop; the first to press stays."""
        self._words[_PRESSED] = self._words[_PRESSED] or presser

    @property
    def is_acknowledged(self) -> bool:
        """Whether the operator has acknowledged why the loop tripped."""
        return bool(self._words[_ACKNOWLEDGED])

    @property
    def has_tripped(self) -> bool:
        """Whether the loop has said why it tripped."""
        return bool(self.published.get("trip"))

    def acknowledge(self) -> None:
        """Note that the operator has seen the cause of the trip. An OperatorError where nothing has tripped yet."""
        if not self.has_tripped:
            raise OperatorError("nothing has tripped: there is no cause yet that could be acknowledged")
        self._words[_ACKNOWLEDGED] = 1

    @property
    def seen(self) -> int:
        """When the operator's page was last heard of, ns of the monotonic clock; 0 where it never was."""
        return self._words[_SEEN]

    def see(self) -> None:
        """Note that the operator's page is there."""
        self._words[_SEEN] = time.monotonic_ns()

    @property
    def silence(self) -> float:
        """Seconds since the operator's page was last heard of; infinite where it never was."""
        seen = self._words[_SEEN]
        return (time.monotonic_ns() - seen) * 1e-9 if seen else float("inf")

    def publish(self, **facts: Any) -> None:  # noqa: ANN401
        """Write what the loop says of its state, as JSON can hold it, in place of what it said before.

        Where there is no room for everything, texts are shortened.
        """
        length = _MOST
        while len(text := json.dumps(_shortened(facts, length)).encode()) > _MOST:
            length //= 2
        self._words[_BEGUN] += 1
        self._memory[8 * _HEAD : 8 * _HEAD + len(text)] = text
        self._words[_TEXT] = len(text)
        self._words[_WHOLE] = self._words[_BEGUN]

    @property
    def published(self) -> dict[str, Any]:
        """What the loop said of its state last; empty where it said nothing."""
        for _ in range(_TRIES):
            whole = self._words[_WHOLE]
            text = self._memory[8 * _HEAD : 8 * _HEAD + self._words[_TEXT]]
            if self._words[_BEGUN] == whole:
                with contextlib.suppress(ValueError):
                    found = json.loads(text or b"{}")
                    return found if isinstance(found, dict) else {}
        return {}

    def remove(self) -> None:
        """Remove its name; processes that have opened it keep it."""
        self.path.unlink(missing_ok=True)


def is_running(process: int) -> bool:
    """Whether there is a process of a number."""
    if sys.platform == "win32":  # not tested; there a signal of 0 would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def switches() -> Iterator[Switch]:
    """Switches of the loops that this user runs on this machine; those of killed loops are removed."""
    for path in sorted(MEMORY.glob(f"masking-*{ENDING}")):
        with contextlib.suppress(RecordError):
            found = Switch(path)
            if is_running(found.process):
                yield found
            else:
                found.remove()
