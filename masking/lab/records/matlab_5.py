"""What a MATLAB file of version 5 to 7.2 says of itself, checked before scipy reads it: scipy trusts it.

The kinds of numbers are checked since scipy ends the process at an unknown one, and the size since a compressed element
of some kilobytes may stand for gigabytes.

Source: MathWorks, MAT-File Format, "Level 5 MAT-Files".
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO, Literal

from masking.lab.records import unpacked_size

HEADER = 128  # bytes
_MATRIX, _PACKED = 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # kinds of elements that hold numbers
_TEXTS = frozenset({16, 17, 18})
_DEEPEST = 50  # structures and cells in one another
_PIECE = 2**20
_CELLS = frozenset({1, 2, 3})  # classes of arrays that hold arrays
_ARRAYS = frozenset(range(4, 16))  # classes of arrays of numbers, text, or a sparse matrix
_NUMERIC = frozenset(range(6, 16))

Order = Literal["little", "big"]
_ORDERS: Mapping[bytes, Order] = {b"\x00\x01IM": "little", b"\x01\x00MI": "big"}  # of version 5


def check(file: Path) -> None:
    """Refuse a file whose arrays are of unknown kinds, too deep in one another, or too large once they are unpacked.

    A file of another version is not looked at. A RecordError where it unpacks to too much, a ValueError or zlib.error
    where it is damaged.
    """
    total, start = 0, HEADER
    length = file.stat().st_size
    with file.open("rb") as stream:
        order = _ORDERS.get(stream.read(HEADER)[-4:])
        while order and start + 8 <= length:
            stream.seek(start)
            kind, size = _pair(stream.read(8), order)
            if start + 8 + size > length:
                raise ValueError("it is cut off")
            source = _Unpacked(file, stream, size, total) if kind == _PACKED else None
            if source is None:
                stream.seek(start)
            walk = _Walk(source.read if source else stream.read, order)
            walk.element(0)
            total += max(walk.size, source.finish() if source else 0)
            unpacked_size.check(file, total)
            start += 8 + size


def _pair(data: bytes, order: Order) -> tuple[int, int]:
    if len(data) < 8:
        raise ValueError("it is cut off")
    return int.from_bytes(data[:4], order), int.from_bytes(data[4:8], order)


class _Unpacked:
    """A compressed element, unpacked in pieces; `before` is what others of the file have unpacked to, in bytes."""

    def __init__(self, file: Path, stream: BinaryIO, size: int, before: int) -> None:
        self.file, self.stream, self.left, self.before = file, stream, size, before
        self.unpacking, self.held, self.size = zlib.decompressobj(), b"", 0

    def read(self, count: int) -> bytes:
        """Next bytes, fewer at the end."""
        made = bytearray()
        while len(made) < count and (self.held or self._next()):
            taken = self.held[: count - len(made)]
            made += taken
            self.held = self.held[len(taken) :]
        return bytes(made)

    def finish(self) -> int:
        """Number of all bytes, unpacked to the checksum at their end."""
        while self._next():
            pass
        if not self.unpacking.eof:
            raise ValueError("a compressed element is cut off")
        return self.size

    def _next(self) -> bool:
        while not self.unpacking.eof:
            rest = self.unpacking.unconsumed_tail
            if not rest:
                rest = self.stream.read(min(self.left, _PIECE))
                self.left -= len(rest)
            self.held = self.unpacking.decompress(rest, _PIECE)
            self.size += len(self.held)
            unpacked_size.check(self.file, self.before + self.size)
            if self.held:
                return True
            if not rest:
                return False
        return False


class _Walk:
    """Reads the elements of one array and of those in it; `size` is that of its numbers as float64 in bytes."""

    def __init__(self, read: Callable[[int], bytes], order: Order) -> None:
        self.read, self.order, self.size = read, order, 0

    def element(self, depth: int) -> int:
        """Read an array; return its length with its tag."""
        kind, size = _pair(self.read(8), self.order)
        if kind != _MATRIX:
            raise ValueError(f"an element is of the kind {kind}, where an array must be")
        if depth > _DEEPEST:
            raise ValueError(f"arrays are more than {_DEEPEST} deep in one another")
        if not size:  # an empty cell
            return 8
        done, (_, flags) = self._part(size, frozenset({6}))
        number = int.from_bytes(flags[:4], self.order) & 255
        if number not in _CELLS | _ARRAYS:  # functions and objects, which scipy does not read or leaves out
            self._skip(size - done)
            return 8 + size
        length, (_, dimensions) = self._part(size - done, frozenset({5}))
        done += length
        counts = [int.from_bytes(dimensions[i : i + 4], self.order, signed=True) for i in range(0, len(dimensions), 4)]
        if min(counts, default=-1) < 0:
            raise ValueError("an array has no size")
        self.size += 8 * math.prod(counts) if number in _NUMERIC else 0
        done += self._part(size - done, frozenset({1, 2, 16}))[0]
        if number in _CELLS:
            for _ in range({1: 0, 2: 2, 3: 3}[number]):  # names of fields, and of the class
                done += self._part(size - done, frozenset({1, 2, 5, 16}))[0]
        while done < size:
            kinds = _NUMBERS | (_TEXTS if number == 4 else frozenset())
            done += self.element(depth + 1) if number in _CELLS else self._part(size - done, kinds, keep=0)[0]
        if done != size:
            raise ValueError("an array is longer than its parts")
        return 8 + size

    def _part(self, most: int, kinds: frozenset[int], keep: int = 2**16) -> tuple[int, tuple[int, bytes]]:
        """Read an element that holds no others; return its length with its tag, and its kind and first bytes."""
        tag = self.read(8)
        kind, size = _pair(tag, self.order)
        if kind >> 16:  # a small element has its data in its tag
            kind, size = kind & 0xFFFF, kind >> 16
            length, data = 8, tag[4 : 4 + size]
        else:
            length = 8 + size + -size % 8
            if min(length, 8 + size) > most:
                raise ValueError("an element is longer than the array that it is in")
            length = min(length, most)
            data = self.read(min(size, keep))
            self._skip(length - 8 - len(data))
        if kind not in kinds or (size > 4 and length == 8):
            raise ValueError(f"an element is of the unknown kind {kind}")
        return length, (kind, data)

    def _skip(self, count: int) -> None:
        while count > 0:
            piece = len(self.read(min(count, _PIECE)))
            if not piece:
                raise ValueError("it is cut off")
            count -= piece
