"""Stream: the rows of a run on disk while it goes on, in pages; one or two files, and a manifest beside them.

    stream.json   the manifest: columns with units, rate, what was declared; on disk before the first row
    stream.rows   "MASKSTRM"  part  hash of this head  start of the chain
                  pages: "MASKPAGE"  sequence  first row  rows  width  kind  bytes  hash of these
                         payload     float64, a row after the other; or JSON
                         chain       BLAKE2b of the chain before it, the page's head and its payload

All numbers are little-endian. The chain starts with the hash of the manifest, whose text is also the first page. A file
that is cut anywhere is read up to its last whole page; a byte that was changed, and a page that was removed or exchanged,
break the chain there, and the pages behind it are sound again. The last page says why the stream ends. Where the disk is
full, the rest is a second part, in the folder `spare` of the manifest.
"""

from __future__ import annotations

import contextlib
import errno
import json
import mmap
import os
import struct
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.errors import RecordError
from masking.numerics.arrays import Array
from masking.records.json_text import json_text

if sys.platform != "win32":
    import fcntl

FORMAT: Final = "masking stream 1"
MANIFEST: Final = "stream.json"
ROWS: Final = "stream.rows"
DATA, CONTENT, END = range(3)  # kinds of pages
_PART, _PAGE = b"MASKSTRM", b"MASKPAGE"
_HEAD: Final = struct.Struct("<8sQQIIII")
_CHAIN: Final = 16  # bytes of a hash of the chain
_CHECK: Final = 8  # bytes of the hash of a head
_PAGE_HEAD: Final = _HEAD.size + _CHECK
_PART_HEAD: Final = 16 + 2 * _CHAIN
_TAIL: Final = 1 << 23  # bytes from the end in which the last whole page is looked for
_FULL: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
MEND: Final = "make a recording of it by 'masking recover {}'"


class NoSpaceError(RecordError):
    """No part of a stream can be written any more."""


def _hash(*parts: bytes | memoryview, size: int = _CHAIN) -> bytes:
    made = blake2b(digest_size=size)
    for part in parts:
        made.update(part)
    return made.digest()


def _part_head(number: int, chain: bytes) -> bytes:
    head = _PART + struct.pack("<Q", number)
    return head + _hash(head, chain) + chain


def is_in(folder: str | Path) -> bool:
    """Tell whether a folder holds a stream."""
    return any((Path(folder) / name).exists() for name in (MANIFEST, ROWS))


def remove(folder: str | Path) -> None:
    """Remove the stream that a folder holds, if any, with all its parts."""
    for path in (*_parts(Path(folder)), Path(folder) / MANIFEST):
        path.unlink(missing_ok=True)


def begin(folder: str | Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest of a stream into a folder, made if need be; it is on disk then.

    Args:
        folder: that holds no stream.
        manifest: with `columns`, in their order, `rate`, `spare` and `number`, a text that no other stream has.

    Raises:
        RecordError: it holds one, or cannot be written.
    """
    folder = Path(folder)
    if is_in(folder):
        raise RecordError(f"{folder} holds the stream of a run that did not end in order; {MEND.format(folder)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / MANIFEST).open("xb") as file:
            file.write(json_text({"format": FORMAT, **manifest}).encode())
            file.flush()
            os.fsync(file.fileno())
        _sync_folder(folder)
    except OSError as error:
        raise RecordError(f"{folder}: no stream can be written: {error.strerror or error}") from error


def _sync_folder(folder: Path) -> None:
    """Bring the names of new files to disk too."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _parts(folder: Path, content: bytes | None = None) -> tuple[Path, ...]:
    """Return where the parts of a stream are, or would be."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        manifest = json.loads((folder / MANIFEST).read_bytes() if content is None else content)
        return (folder / ROWS, Path(manifest["spare"]) / f"masking-{manifest['number']}.rows")
    return (folder / ROWS,)


@final
class StreamWriter:
    """The end of a stream, where pages are added; another process may have begun it.

    Attributes:
        next: number of the row that follows those that are there.
        moved: how many parts were full.

    Args:
        folder: with the manifest of a stream.

    Raises:
        NoSpaceError: nothing can be written.
        RecordError: there is no manifest, or another process writes this stream.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder, self.next, self.moved = Path(folder), 0, 0
        try:
            self._content = (self.folder / MANIFEST).read_bytes()
            self._width = len(json.loads(self._content)["columns"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RecordError(f"{self.folder}: no manifest of a stream ({error})") from error
        self._sequence, self._chain, self._end = 0, _hash(self._content), 0
        self._paths = _parts(self.folder, self._content)
        self._file: int | None = None
        begun = [path for path in self._paths if path.exists()]
        self.moved = max(0, len(begun) - 1)
        if not begun or not self._go_on(begun[-1]):
            self._open()
            self._add(CONTENT, self._content)

    def append(self, first: int, table: Array) -> None:
        """Add a page of rows.

        Args:
            first: number of the first.
            table: (rows, columns).

        Raises:
            NoSpaceError: no part can be written any more.
        """
        self._add(DATA, np.ascontiguousarray(table, dtype="<f8").tobytes(), first, len(table))
        self.next = first + len(table)

    def end(self, why: Mapping[str, Any]) -> None:
        """Add the last page, which says why the stream ends, bring all to disk, and close it.

        Raises:
            NoSpaceError: no part can be written any more.
        """
        self._add(END, json_text(why).encode(), self.next)
        self.sync()
        self.close()

    def sync(self) -> None:
        """Bring what was added to disk."""
        if self._file is not None and hasattr(os, "fdatasync"):
            os.fdatasync(self._file)

    def close(self) -> None:
        """Close it as it is."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _add(self, kind: int, payload: bytes, first: int = 0, rows: int = 0) -> None:
        """Write a page; where this part is full, into the next one."""
        width = self._width if kind == DATA else 0
        head = _HEAD.pack(_PAGE, self._sequence, first, rows, width, kind, len(payload))
        chain = _hash(self._chain, head, payload)
        page = b"".join([head, _hash(head, size=_CHECK), payload, chain])
        while not self._is_written(page):
            self.moved += 1
            self._open()
        self._sequence, self._chain = self._sequence + 1, chain

    def _is_written(self, data: bytes) -> bool:
        """Write all, or leave the part as it is."""
        file, rest = self._file, memoryview(data)
        assert file is not None  # noqa: S101  # there is a part as long as none has failed
        try:
            while rest:
                rest = rest[os.write(file, rest) :]
        except OSError as error:
            if error.errno not in _FULL:
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
                self._file = self._locked(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
                self._end = 0
                if self._is_written(_part_head(number, self._chain)):
                    _sync_folder(path.parent)
                    return
            except OSError as error:
                if error.errno not in _FULL and number + 1 == len(self._paths):
                    raise NoSpaceError(f"{self._paths[number]} cannot be written: {error.strerror or error}") from error
            self.close()
        places = " and ".join(str(path.parent) for path in self._paths)
        raise NoSpaceError(f"{places} are full; make room, or name another second place with --spare")

    def _locked(self, path: Path, flags: int) -> int:
        """Open a part for this process alone."""
        file = os.open(path, flags | os.O_APPEND | getattr(os, "O_CLOEXEC", 0), 0o600)
        if sys.platform != "win32":
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(file)
                raise RecordError(
                    f"{path}: another process records into this stream; wait until it has ended"
                ) from error
        return file

    def _go_on(self, path: Path) -> bool:
        """Continue a part behind its last whole page; tell whether there is one."""
        file = self._locked(path, os.O_RDWR)
        size = os.fstat(file).st_size
        last = None
        if size > _PART_HEAD:
            with mmap.mmap(file, size, access=mmap.ACCESS_READ) as memory:
                for page in _pages(memory, max(_PART_HEAD, size - _TAIL), None):
                    last = page if page.is_sound and page.kind != END else last
        if last is None:
            os.close(file)
            return False
        self._file, self._end, self._sequence, self._chain = file, last.stop, last.sequence + 1, last.chain
        self.next = last.first + last.rows
        os.ftruncate(file, self._end)
        return True


@dataclass(frozen=True)
class _Page:
    """A page as it was found, or bytes that are none: those have no sequence.

    Args:
        start: where its first byte is.
        stop: behind its last byte.
        is_sound: whether it is what was written behind the page before it.
        sequence: number of the page, -1 for bytes that are no page.
        kind: what its payload is.
        first: number of its first row.
        rows: how many rows.
        payload: without its head.
        chain: behind it.
    """

    start: int
    stop: int
    is_sound: bool = False
    sequence: int = -1
    kind: int = -1
    first: int = 0
    rows: int = 0
    payload: bytes = b""
    chain: bytes = b""


def _pages(memory: mmap.mmap, at: int, chain: bytes | None) -> Iterator[_Page]:
    """Give page after page, and what is between them; a page that the end of the file cuts off is left out.

    Args:
        memory: of a part.
        at: where a page begins, or is looked for.
        chain: before it; None where it is that which stands there.
    """
    while at < len(memory):
        page = _page(memory, at, chain)
        if page is None:
            begin = _next_page(memory, at)
            if begin is None:
                if not _is_cut(memory, at):
                    yield _Page(at, len(memory))
                return
            if at != begin:
                yield _Page(at, begin)
            at, chain = begin, None
            continue
        yield page
        at, chain = page.stop, page.chain


def _has_head(memory: mmap.mmap, at: int) -> bool:
    head, check = memory[at : at + _HEAD.size], memory[at + _HEAD.size : at + _PAGE_HEAD]
    return head.startswith(_PAGE) and check == _hash(head, size=_CHECK)


def _next_page(memory: mmap.mmap, at: int) -> int | None:
    """Return where the next whole page begins behind a place."""
    while (at := memory.find(_PAGE, at + 1)) >= 0:
        if _page(memory, at, None) is not None:
            return at
    return None


def _is_cut(memory: mmap.mmap, at: int) -> bool:
    """Tell whether the last bytes are a page that was not written to its end."""
    rest = len(memory) - at
    if rest < _PAGE_HEAD:
        return memory[at : at + len(_PAGE)] == _PAGE[:rest]
    return _has_head(memory, at)


def _page(memory: mmap.mmap, at: int, chain: bytes | None) -> _Page | None:
    """Return the page at a place; None where there is none, or its end is missing."""
    if not _has_head(memory, at):
        return None
    head = memory[at : at + _HEAD.size]
    _, sequence, first, rows, width, kind, size = _HEAD.unpack(head)
    begin = at + _PAGE_HEAD
    stop = begin + size + _CHAIN
    if stop > len(memory) or (kind == DATA and size != 8 * rows * width):
        return None
    payload, found = memory[begin : begin + size], memory[begin + size : stop]
    before = {memory[at - _CHAIN : at], chain or b""}
    is_sound = any(_hash(one, head, payload) == found for one in before if one)
    made = found if is_sound else _hash(chain or memory[at - _CHAIN : at], head, payload)
    return _Page(at, stop, is_sound, sequence, kind, first, rows, payload, made)


@dataclass(frozen=True, eq=False)
class Stream:
    """What a stream holds.

    Args:
        manifest: as it was written.
        numbers: of the rows (rows,), rising; what lies between them is lost.
        table: (rows, columns).
        damages: what was changed or is missing, a sentence each; what is here is not concerned.
        end: why it ends, as the last page says; None where that is missing, because the stream was cut off.
        folder: that holds it.
    """

    manifest: Mapping[str, Any]
    numbers: Array
    table: Array
    damages: tuple[str, ...]
    end: Mapping[str, Any] | None
    folder: Path


def read(folder: str | Path) -> Stream:
    """Read a stream: of what was cut off all whole pages, of what was damaged all that is sound.

    Args:
        folder: that holds it.

    Raises:
        RecordError: it holds none, another process writes it, or what its columns are is not known any more.
    """
    return _Reader(Path(folder)).read()


class _Reader:
    """One reading of a stream."""

    def __init__(self, folder: Path) -> None:
        if not is_in(folder):
            raise RecordError(f"{folder} holds no stream of a run; name a folder with {MANIFEST} and {ROWS}")
        self.folder = folder
        try:
            self.content: bytes = (folder / MANIFEST).read_bytes() if (folder / MANIFEST).exists() else b""
        except OSError as error:
            raise RecordError(f"{folder / MANIFEST} cannot be read: {error.strerror or error}") from error
        self.damages, self.first, self.tables = list[str](), list[int](), list[Array]()
        self.lost: list[tuple[str, int, int, int]] = []  # file, bytes, page, of what was changed
        self.end: Mapping[str, Any] | None = None
        self.next, self.sequence, self.has_content = 0, 0, False
        self.chain: bytes | None = None

    def read(self) -> Stream:
        """Return what there is."""
        self.chain = _hash(self.content)
        self._part(self.folder / ROWS, 0)
        if not self.has_content and self.tables:
            self.damages.append(f"{MANIFEST} may have been changed: its copy was")
        for number, path in enumerate(_parts(self.folder, self.content)[1:], 1):
            if path.exists():
                self._part(path, number)
        try:
            manifest = json.loads(self.content)
            width = len(manifest["columns"])
            if manifest["format"] != FORMAT:
                raise ValueError(f"its format is {manifest['format']}")
        except (ValueError, KeyError, TypeError) as error:
            raise RecordError(f"{self.folder / MANIFEST} is damaged, and so is its copy ({error})") from error
        tables = [table for table in self.tables if table.shape[1] == width]
        numbers = [first + np.arange(len(t)) for first, t in zip(self.first, tables, strict=True)]
        return Stream(
            manifest,
            np.concatenate([np.empty(0, dtype=np.int64), *numbers]),
            np.concatenate([np.empty((0, width)), *tables]),
            tuple(self.damages),
            self.end,
            self.folder,
        )

    def _part(self, path: Path, number: int) -> None:
        """Read one part."""
        try:
            with path.open("rb") as file:
                if os.fstat(file.fileno()).st_size < _PART_HEAD:
                    return
                if sys.platform != "win32":
                    fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as memory:
                    self._head(path, memory, number)
                    for page in _pages(memory, _PART_HEAD, None):
                        self._take(path, page)
                    self._tell(None)
        except FileNotFoundError:
            return
        except BlockingIOError as error:
            raise RecordError(f"{path}: a run is being recorded into this stream; wait until it has ended") from error
        except OSError as error:
            raise RecordError(f"{path} cannot be read: {error.strerror or error}") from error

    def _head(self, path: Path, memory: mmap.mmap, number: int) -> None:
        """Look whether a part begins as one, behind what is known."""
        start = memory[_PART_HEAD - _CHAIN : _PART_HEAD]
        if memory[: _PART_HEAD - _CHAIN] != _part_head(number, start)[:-_CHAIN]:
            self.damages.append(f"{path.name}: its first {_PART_HEAD} bytes were changed")
        elif start != self.chain and number > 0:
            self.damages.append(f"{path.name}: pages before this part are missing")

    def _take(self, path: Path, page: _Page) -> None:
        """Keep a sound page; note what is none."""
        if not page.is_sound:
            self.lost.append((path.name, page.start, page.stop, page.sequence))
            return
        self._tell(page)
        self.sequence, self.chain = page.sequence + 1, page.chain
        if page.kind == CONTENT:
            self.has_content = True
            if page.payload != self.content:
                self.content = page.payload
                self.damages.append(f"{MANIFEST} was changed or is missing; its copy in {path.name} was used")
        elif page.kind == DATA:
            width = len(page.payload) // (8 * page.rows)
            self.first.append(page.first)
            self.tables.append(np.frombuffer(page.payload, dtype="<f8").reshape(page.rows, width))
            self.next = page.first + page.rows
        else:
            self.end = json.loads(page.payload)

    def _tell(self, page: _Page | None) -> None:
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
