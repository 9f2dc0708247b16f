"""What a MATLAB file of version 5 to 7.2 says of itself, checked before scipy reads it: scipy trusts it.

The kinds of numbers are checked since scipy ends the process at an unknown one, and the size since a compressed element
of some kilobytes may stand for gigabytes.

Source: MathWorks, MAT-File Format, "Level 5 MAT-Files".
"""

from __future__ import annotations

import math
import mmap
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from masking.lab.records import unpacked_size

HEADER = 128  # bytes
_MATRIX, _PACKED = 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # kinds of elements that hold numbers
_TEXTS = frozenset({16, 17, 18})
_DEEPEST = 50  # structures and cells in one another
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
    total, at, most = 0, HEADER, unpacked_size.limit(file)
    with file.open("rb") as stream:
        memory = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
    order = _ORDERS.get(bytes(memory[HEADER - 4 : HEADER]))
    while order and at + 8 <= len(memory):
        kind, size = _pair(memory, at, order)
        stop = _before(at + 8 + size, len(memory))
        element: memoryview | bytes = memory[at:stop]
        if kind == _PACKED:
            unpacking = zlib.decompressobj()
            element = unpacking.decompress(element[8:], most - total + 1)
            unpacked_size.check(file, total + len(element))
            if not unpacking.eof:
                raise ValueError("a compressed element is cut off")
        walk = _Walk(element, order)
        walk.array(0, len(element), 0)
        total += max(walk.size, len(element) if kind == _PACKED else 0)
        unpacked_size.check(file, total)
        at = stop


def _pair(data: memoryview | bytes, at: int, order: Order) -> tuple[int, int]:
    _before(at + 8, len(data))
    return int.from_bytes(data[at : at + 4], order), int.from_bytes(data[at + 4 : at + 8], order)


def _before(stop: int, end: int) -> int:
    if stop > end:
        raise ValueError("it is cut off")
    return stop


class _Walk:
    """Looks at the elements of one array and of those in it; `size` is that of its numbers as float64 in bytes."""

    def __init__(self, data: memoryview | bytes, order: Order) -> None:
        self.data, self.order, self.size = data, order, 0

    def array(self, at: int, end: int, depth: int) -> int:
        """Look at the array that begins at a byte, and ends before another; return where it ends."""
        kind, size = _pair(self.data, at, self.order)
        if kind != _MATRIX:
            raise ValueError(f"an element is of the kind {kind}, where an array must be")
        if depth > _DEEPEST:
            raise ValueError(f"arrays are more than {_DEEPEST} deep in one another")
        at, stop = at + 8, _before(at + 8 + size, end)
        if not size:  # an empty cell
            return stop
        at, flags = self._part(at, stop, frozenset({6}))
        number = int.from_bytes(flags[:4], self.order) & 255
        if number not in _CELLS | _ARRAYS:  # functions and objects, which scipy does not read or leaves out
            return stop
        at, dimensions = self._part(at, stop, frozenset({5}))
        counts = [int.from_bytes(dimensions[i : i + 4], self.order, signed=True) for i in range(0, len(dimensions), 4)]
        if min(counts, default=-1) < 0:
            raise ValueError("an array has no size")
        self.size += 8 * math.prod(counts) if number in _NUMERIC else 0
        at, _ = self._part(at, stop, frozenset({1, 2, 16}))
        for _ in range({2: 2, 3: 3}.get(number, 0)):  # names of fields, and of the class
            at, _ = self._part(at, stop, frozenset({1, 2, 5, 16}))
        kinds = _NUMBERS | (_TEXTS if number == 4 else frozenset())
        while at < stop:
            at = self.array(at, stop, depth + 1) if number in _CELLS else self._part(at, stop, kinds)[0]
        return stop

    def _part(self, at: int, end: int, kinds: frozenset[int]) -> tuple[int, memoryview | bytes]:
        """Look at an element that holds no others; return where it ends, and its data."""
        kind, size = _pair(self.data, at, self.order)
        begin, stop = at + 8, min(at + 8 + size + -size % 8, end)
        is_small = kind >> 16 != 0  # a small element has its data in its tag
        if is_small:
            kind, size, begin, stop = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if begin + size > end:
            raise ValueError("an element is longer than the array that it is in")
        if kind not in kinds or (is_small and size > 4):
            raise ValueError(f"an element is of the unknown kind {kind}")
        return stop, self.data[begin : begin + size]
