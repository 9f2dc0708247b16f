"""Stream: the rows of a run on disk while it goes on, in pages; one or two files, and a manifest beside them.

    stream.json   the manifest: columns with units, rate, what was declared; on disk before the first row
    stream.rows   the rows, as `masking.lab.records.stream_pages` says; the last page says why they end

Where the disk is full, the rest is a second part, in the folder `spare` of the manifest.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import json_text
from masking.errors import NO_PLACE, RecordError
from masking.lab.records import named_files, stream_pages
from masking.lab.records.stream_pages import CHAIN, CONTENT, DATA, END, PART_HEAD

if sys.platform != "win32":
    import fcntl

FORMAT: Final = "masking stream 1"
MANIFEST: Final = "stream.json"
ROWS: Final = "stream.rows"
_TAIL: Final = 1 << 23  # bytes from the end in which the last whole page is looked for
MEND: Final = "make a recording of it by 'masking recover {}'"


class NoSpaceError(RecordError):
    """No part of a stream can be written any more."""


def is_in(folder: str | Path) -> bool:
    """Whether a folder holds a stream."""
    return any((Path(folder) / name).exists() for name in (MANIFEST, ROWS))


def remove(folder: str | Path) -> None:
    """Remove the stream that a folder holds, if any, with all its parts; a RecordError where it is being written."""
    for path in parts(Path(folder)):
        if path.exists():
            os.close(_locked(path, os.O_RDWR))
            path.unlink(missing_ok=True)
    (Path(folder) / MANIFEST).unlink(missing_ok=True)


def begin(folder: str | Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of a stream into a folder, made if need be; it is on disk then.

    It has `columns`, in their order, `rate`, `spare` and `number`, a text that no other stream has. A RecordError where
    the folder holds a stream, or cannot be written.
    """
    folder = Path(folder)
    if is_in(folder):
        raise RecordError(f"{folder} holds the stream of a run that did not end in order; {MEND.format(folder)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / MANIFEST).open("xb") as file:
            file.write(json_text({**manifest, "format": FORMAT}).encode())
            file.flush()
            os.fsync(file.fileno())
        sync_folder(folder)
    except OSError as error:
        raise RecordError(f"{folder}: no stream can be written: {error.strerror or error}") from error


def sync_folder(folder: Path) -> None:
    """Bring the names of new files to disk too."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def parts(folder: Path, content: bytes | None = None) -> tuple[Path, ...]:
    """Where the parts of a stream are, or would be."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        manifest = json.loads(named_files.content(folder / MANIFEST) if content is None else content)
        number = str(manifest["number"])
        if number.isalnum():
            return folder / ROWS, Path(manifest["spare"]) / f"masking-{number}.rows"
    return (folder / ROWS,)


def _last_pages(file: int) -> list[stream_pages.Page]:
    """Sound pages near the end of a part."""
    size = os.fstat(file).st_size
    if size <= PART_HEAD:
        return []
    with mmap.mmap(file, 0, access=mmap.ACCESS_READ) as memory:  # a writer may cut off its end meanwhile
        pages = stream_pages.pages_of(memory, max(PART_HEAD, size - _TAIL), None)
        return [page for page in pages if page.is_sound]


def written(folder: str | Path) -> int:
    """How many rows are in the stream that a folder holds, as its last page says."""
    for path in reversed(parts(Path(folder))):
        with contextlib.suppress(OSError), named_files.opened(path) as file:
            if pages := _last_pages(file.fileno()):
                last = pages[-1]
                lost = int(json.loads(last.payload)["lost"]) if last.kind == END else 0
                return last.first + last.rows - lost
    return 0


def _locked(path: Path, flags: int) -> int:
    """Open a part for this process alone."""
    file = os.open(path, flags | os.O_APPEND | getattr(os, "O_CLOEXEC", 0), 0o600)
    if sys.platform != "win32":
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(file)
            message = f"{path}: another process records into this stream; wait until it has ended"
            raise RecordError(message) from error
    return file


@final
class StreamWriter:
    """The end of a stream, where pages are added; another process may have begun it in the folder.

    `next` is the number of the row that follows those that are there; `moved` is how many parts were full. All that
    adds to it raises a NoSpaceError where no part can be written any more; making it raises a RecordError where there
    is no manifest, or another process writes this stream.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder, self.next, self.moved = Path(folder), 0, 0
        try:
            self._content = named_files.content(self.folder / MANIFEST)
            self._width = len(json.loads(self._content)["columns"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise RecordError(f"{self.folder}: no manifest of a stream ({error})") from error
        self._sequence, self._chain, self._end = 0, stream_pages.hash_of(self._content), 0
        self._paths = parts(self.folder, self._content)
        self._file: int | None = None
        begun = [path for path in self._paths if path.exists()]
        self.moved = max(0, len(begun) - 1)
        if not begun or not self._go_on(begun[-1]):
            self._open()
            self._add(CONTENT, self._content)

    def append(self, first: int, table: Array) -> None:
        """Add a page of rows (rows, columns), of which `first` is the number of the first."""
        self._add(DATA, np.ascontiguousarray(table, dtype="<f8").tobytes(), first, len(table))
        self.next = first + len(table)

    def end(self, why: Mapping[str, Any]) -> None:
        """Add the last page, which says why the stream ends, bring all to disk, and close it."""
        self._add(END, json_text(why).encode(), self.next)
        self.sync()
        self.close()

    def sync(self) -> None:
        """Bring what was added to disk; where that fails, the next part follows."""
        if self._file is None or not hasattr(os, "fdatasync"):
            return
        try:
            os.fdatasync(self._file)
        except OSError as error:
            if error.errno not in NO_PLACE:
                raise
            self.moved += 1
            self._open()

    def close(self) -> None:
        """Close it as it is."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _add(self, kind: int, payload: bytes, first: int = 0, rows: int = 0) -> None:
        """Write a page; where this part is full, into the next one."""
        width = self._width if kind == DATA else 0
        page = stream_pages.page_bytes(self._chain, self._sequence, kind, payload, first=first, rows=rows, width=width)
        while not self._is_written(page):
            self.moved += 1
            self._open()
        self._sequence, self._chain = self._sequence + 1, page[-CHAIN:]

    def _is_written(self, data: bytes) -> bool:
        """Write all, or leave the part as it is."""
        file, rest = self._file, memoryview(data)
        assert file is not None  # noqa: S101  # there is a part as long as none has failed
        try:
            while rest:
                rest = rest[os.write(file, rest) :]
        except OSError as error:
            if error.errno not in NO_PLACE:
                raise
            with contextlib.suppress(OSError):
                os.ftruncate(file, self._end)
            return False
        self._end += len(data)
        return True

    def _open(self) -> None:
        """Begin the part that `moved` is at, or the next one that can be written."""
        self.close()
        for number in range(self.moved, len(self._paths)):
            self.moved = number
            try:
                path = self._paths[number]
                path.parent.mkdir(parents=True, exist_ok=True)
                self._file = _locked(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
                self._end = 0
                if self._is_written(stream_pages.part_head(number, self._chain)):
                    sync_folder(path.parent)
                    return
            except OSError as error:
                if error.errno not in NO_PLACE and number + 1 == len(self._paths):
                    raise NoSpaceError(f"{self._paths[number]} cannot be written: {error.strerror or error}") from error
            self.close()
        places = " and ".join(str(path.parent) for path in self._paths)
        raise NoSpaceError(f"{places} are full; make room, or name another second place with --spare")

    def _go_on(self, path: Path) -> bool:
        """Continue a part behind its last whole page; tell whether there is one."""
        file = _locked(path, os.O_RDWR)
        last = next((page for page in reversed(_last_pages(file)) if page.kind != END), None)
        if last is None:
            os.close(file)
            return False
        self._file, self._end, self._sequence, self._chain = file, last.stop, last.sequence + 1, last.chain
        self.next = last.first + last.rows
        os.ftruncate(file, self._end)
        return True
