"""Content of a stream: all of it that is sound, of a run that was cut off too, and what is not."""

from __future__ import annotations

import mmap
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RecordError
from masking.lab.records import foreign_json, named_files
from masking.lab.records.stream import FORMAT, MANIFEST, ROWS, is_in, parts
from masking.lab.records.stream_pages import CHAIN, CONTENT, DATA, PART_HEAD, Page, hash_of, pages_of, part_head

if sys.platform != "win32":
    import fcntl


@dataclass(frozen=True)
class Written:
    """What the manifest of every stream says."""

    format: str
    columns: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Stream:
    """What a stream holds."""

    manifest: Mapping[str, Any]  # as it was written
    numbers: Array  # of the rows (rows,), rising; what lies between them is lost
    tables: tuple[Array, ...]  # (rows, columns), one behind the other; they stay on disk until they are used
    damages: tuple[str, ...]  # what was changed or is missing, a sentence each; what is here is not concerned
    # why it ends, as the last page says; None where that is missing, because the stream was cut off
    end: Mapping[str, Any] | None
    folder: Path  # that holds it

    @cached_property
    def table(self) -> Array:
        """All rows (rows, columns)."""
        return np.concatenate([np.empty((0, len(self.manifest["columns"]))), *self.tables])


def read(folder: str | Path) -> Stream:
    """Read a stream: of what was cut off all whole pages, of what was damaged all that is sound.

    A RecordError where the folder holds none, another process writes it, or what its columns are is not known any more.
    """
    return _Reader(Path(folder)).read()


class _Reader:
    """One reading of a stream."""

    def __init__(self, folder: Path) -> None:
        if not is_in(folder):
            raise RecordError(f"{folder} holds no stream of a run; name a folder with {MANIFEST} and {ROWS}")
        self.folder = folder
        try:
            self.content: bytes = named_files.content(folder / MANIFEST) if (folder / MANIFEST).exists() else b""
        except OSError as error:
            raise RecordError(f"{folder / MANIFEST} cannot be read: {error.strerror or error}") from error
        self.damages, self.first, self.tables = list[str](), list[int](), list[Array]()
        self.lost: list[tuple[str, int, int, int]] = []  # file, bytes, page, of what was changed
        self.repeated: list[Page] = []  # which stand there again
        self.end: Mapping[str, Any] | None = None
        self.next, self.sequence, self.is_proven = 0, 0, False
        self.chain: bytes | None = None

    def read(self) -> Stream:
        self.chain = hash_of(self.content)
        self._part(self.folder / ROWS, 0)
        if not self.is_proven and self.tables:
            self.damages.append(f"{MANIFEST} may have been changed, and its copy in {ROWS} was")
        for number, path in enumerate(parts(self.folder, self.content)[1:], 1):
            if path.exists():
                self._part(path, number)
        try:
            manifest = foreign_json.parsed(self.content, Written, MANIFEST)
            if manifest["format"] != FORMAT:
                raise RecordError(f"its format is {manifest['format']}")
        except RecordError as error:
            raise RecordError(f"{self.folder / MANIFEST} is damaged, and so is its copy ({error})") from error
        width = len(manifest["columns"])
        kept = [(first, table) for first, table in zip(self.first, self.tables, strict=True) if table.shape[1] == width]
        tables = [table for _, table in kept]
        numbers = [first + np.arange(len(table)) for first, table in kept]
        rows = np.concatenate([np.empty(0, dtype=np.int64), *numbers])
        return Stream(manifest, rows, tuple(tables), tuple(self.damages), self.end, self.folder)

    def _part(self, path: Path, number: int) -> None:
        try:
            with named_files.opened(path) as file:
                if os.fstat(file.fileno()).st_size < PART_HEAD:
                    return
                if sys.platform != "win32":
                    fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # open as long as one has its rows
                self._head(path, memory, number)
                for page in pages_of(memory, PART_HEAD, self.chain):
                    self._take(path, page, memory)
                self._tell(None)
                if self.repeated:
                    self.damages.append(
                        f"{path.name}: {len(self.repeated)} pages from byte {self.repeated[0].start} on "
                        "repeat earlier ones, and were left out"
                    )
                    self.repeated = []
                if sys.platform != "win32":
                    fcntl.flock(file, fcntl.LOCK_UN)  # which the mapped rows would keep
        except FileNotFoundError:
            return
        except BlockingIOError as error:
            raise RecordError(f"{path}: a run is being recorded into this stream; wait until it has ended") from error
        except OSError as error:
            raise RecordError(f"{path} cannot be read: {error.strerror or error}") from error

    def _head(self, path: Path, memory: mmap.mmap, number: int) -> None:
        """Look whether a part begins as one, behind what is known."""
        start = memory[PART_HEAD - CHAIN : PART_HEAD]
        if memory[: PART_HEAD - CHAIN] != part_head(number, start)[:-CHAIN]:
            self.damages.append(f"{path.name}: its first {PART_HEAD} bytes were changed")
        elif number == 0:
            self.is_proven = start == self.chain
        elif start != self.chain:
            self.damages.append(f"{path.name}: pages before this part are missing")

    def _take(self, path: Path, page: Page, memory: mmap.mmap) -> None:
        """Keep a sound page; note what is none."""
        if not page.is_sound:
            self.lost.append((path.name, page.start, page.stop, page.sequence))
            return
        if page.sequence < self.sequence:
            self.repeated.append(page)
            return
        self._tell(page)
        self.sequence, self.chain = page.sequence + 1, page.chain
        if page.kind == CONTENT:
            self.is_proven = True
            if page.payload != self.content:
                self.content = page.payload
                self.damages.append(f"{MANIFEST} was changed or is missing; its copy in {path.name} was used")
        elif page.kind == DATA:
            if not page.rows:  # a page of none says nothing
                return
            begin, size = page.stop - CHAIN - len(page.payload), len(page.payload) // 8
            self.first.append(page.first)
            self.tables.append(np.frombuffer(memory, "<f8", size, begin).reshape(page.rows, size // page.rows))
            self.next = page.first + page.rows
        else:
            self.end = foreign_json.parsed(page.payload, dict[str, Any], f"the last page of {path}")

    def _tell(self, page: Page | None) -> None:
        """Say what was changed or is missing before a sound page, or before the end of a part."""
        if self.lost:
            file, start = self.lost[0][:2]
            pages = [n for *_, n in self.lost if n >= 0] or [self.sequence]
            until = f"to {page.first - 1}" if page is not None and page.first > self.next else "on"
            where = f"page {pages[0]}" if len(set(pages)) == 1 else f"pages {min(pages)} to {max(pages)}"
            if page is not None and page.kind == DATA and page.first == self.next:
                rows = "no rows"
            else:
                rows = f"rows {self.next} {until}"
            self.damages.append(f"{file}: bytes {start} to {self.lost[-1][2] - 1} were changed ({where}, {rows})")
        elif page is not None and page.sequence != self.sequence:
            self.damages.append(f"pages {self.sequence} to {page.sequence - 1} are missing")
        self.lost = []
