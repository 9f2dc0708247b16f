"""Ring: the last rows of a running loop in memory that other processes read, such as the one that records them.

The loop writes a row in about a microsecond and waits for nobody. Readers come and go; one that is too slow learns how
many rows it missed, and never gets a row of which a part is newer. The rows outlive the process that wrote them.

    "MASKRING"  rows  width  bytes of text  process  count  closed      each 8 bytes, little-endian
    text        JSON: columns, units, rate, and what else the writer says of them
    rows        float64, row n at n modulo the number of rows

`count` is raised after a row is whole. Processors that show stores in another order, as ARM may, are not tested.
"""

from __future__ import annotations

import json
import mmap
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RecordError
from masking.lab.records import named_files

MAGIC: Final = int.from_bytes(b"MASKRING", "little")
ROWS: Final = 1 << 14
_HEAD: Final = 7  # integers before the text
_MAGIC, _ROWS, _WIDTH, _TEXT, _PROCESS, _COUNT, _CLOSED = range(_HEAD)
_SHARED: Final = Path("/dev/shm")  # noqa: S108  (files that are in memory alone; the names are random ones, mode 0600)
MEMORY: Final = _SHARED if os.access(_SHARED, os.W_OK) else Path(tempfile.gettempdir())


def shared_file(ending: str) -> tuple[int, Path]:
    """Make an empty file in memory that processes of the same user share; return its descriptor and its path."""
    handle, name = tempfile.mkstemp(prefix="masking-", suffix=ending, dir=MEMORY)
    return handle, Path(name)


def _sizes(memory: mmap.mmap) -> np.ndarray:
    return np.frombuffer(memory, dtype="<i8", count=_HEAD)


def _table(memory: mmap.mmap, head: np.ndarray) -> Array:
    rows, width = int(head[_ROWS]), int(head[_WIDTH])
    begin = 8 * _HEAD + int(head[_TEXT])
    if rows < 1 or width < 1 or rows & (rows - 1):
        raise ValueError("its sizes are none")
    return np.frombuffer(memory, dtype="<f8", count=rows * width, offset=begin).reshape(rows, width)


def cells(table: Array) -> memoryview[float]:
    """Numbers of a table (rows, columns) in a row, as what is read and written fastest."""
    return table.data.cast("B").cast("d")


@final
class Ring:
    """The side that writes; it keeps at least a number of rows, of which there are `rate` per second.

    `units` are those of columns that have one, by name, and `more` is what else a reader should know, as JSON can hold
    it.
    """

    def __init__(
        self,
        columns: Sequence[str],
        rate: float,
        units: Mapping[str, str] | None = None,
        rows: int = ROWS,
        **more: object,
    ) -> None:
        text = json.dumps({"columns": list(columns), "rate": rate, "units": dict(units or {}), **more}).encode()
        text += b" " * (-len(text) % 8)
        rows = 1 << max(rows - 1, 1).bit_length()
        handle, self.path = shared_file(".ring")
        with os.fdopen(handle, "r+b") as file:
            file.truncate(8 * (_HEAD + rows * len(columns)) + len(text))
            self._memory = mmap.mmap(file.fileno(), 0)
        head = _sizes(self._memory)
        head[:] = MAGIC, rows, len(columns), len(text), os.getpid(), 0, 0
        self._memory[8 * _HEAD : 8 * _HEAD + len(text)] = text
        table, self._mask, self._width, self.count = _table(self._memory, head), rows - 1, len(columns), 0
        table[:] = 0.0  # its pages are there before the first row
        self._head, self._cells = head.data, cells(table)

    def put(self, *parts: memoryview[float]) -> None:
        """Add a row (columns,), in one part or several; measured: 0.2 us and 0.1 us a part."""
        at = (self.count & self._mask) * self._width
        for part in parts:
            end = at + len(part)
            self._cells[at:end] = part
            at = end
        self.count += 1
        self._head[_COUNT] = self.count

    def close(self, *, remove: bool = True) -> None:
        """Readers that no row follows; remove the name, unless a reader does so. Open rings keep their rows."""
        self._head[_CLOSED] = 1
        if remove:
            self.path.unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class Rows:
    """What a reader got at once."""

    first: int  # number of the first row; rows count from 0
    table: Array  # (rows, columns)
    missed: int  # rows before these that were overwritten before they were read


@final
class RingReader:
    """A side that reads, from the oldest row that is still there; a RecordError where the file is no ring."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with named_files.opened(self.path) as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            self._head = _sizes(self._memory)
            if int(self._head[_MAGIC]) != MAGIC:
                raise ValueError("it does not begin as one")
            self._table = _table(self._memory, self._head)
            self.facts: dict[str, Any] = json.loads(self._memory[8 * _HEAD : 8 * _HEAD + int(self._head[_TEXT])])
            self.columns = tuple(map(str, self.facts["columns"]))
            self.rate, self.units = float(self.facts["rate"]), dict(self.facts["units"])
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise RecordError(f"{self.path}: no ring of rows ({error}); name one that a loop writes") from error
        self.next = 0

    @property
    def process(self) -> int:
        """Number of the process that writes."""
        return int(self._head[_PROCESS])

    @property
    def count(self) -> int:
        """Rows that have been written."""
        return int(self._head[_COUNT])

    @property
    def is_closed(self) -> bool:
        """Whether the writer said that no row follows; one that was killed says nothing."""
        return bool(self._head[_CLOSED])

    def take(self, most: int | None = None) -> Rows:
        """Rows since the last call, at most a number of them, without waiting."""
        size = len(self._table)
        until = self.count
        first = max(self.next, until - size + 1)
        until = until if most is None else min(until, first + most)
        table = self._table[np.arange(first, until) & (size - 1)]
        # What the writer has begun to overwrite meanwhile is not whole.
        whole = min(max(first, self.count - size + 1), until)
        found = Rows(whole, table[whole - first :], whole - self.next)
        self.next = until
        return found

    def last(self, most: int) -> Rows:
        """Newest rows, at most a number of them, and go on after them."""
        self.next = max(self.next, self.count - most)
        return self.take()
