"""Bounds on what files unpack to, checked before they are unpacked: some kilobytes may stand for terabytes."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path

from masking.errors import RecordError

SMALL = 2**28  # bytes that every file may unpack to
RATIO = 32  # times its own size that a larger one may unpack to; measured records: 1 to 10
_PIECE = 2**20


def limit(file: Path) -> int:
    """Return how many bytes a file may unpack to."""
    return max(SMALL, RATIO * file.stat().st_size)


def check(file: Path, size: int) -> None:
    """Refuse a file that unpacks to too much.

    Args:
        file: packed.
        size: of all that it holds as float64, in bytes.

    Raises:
        RecordError: it is larger than `limit`.
    """
    if size > limit(file):
        raise RecordError(
            f"{file}: it unpacks to {size / 2**20:.0f} MiB, {size / max(1, file.stat().st_size):.0f} times its size: "
            f"more than {SMALL // 2**20} MiB and {RATIO} times are refused; cut it, or save it without compression"
        )


def inflated(data: bytes, most: int) -> int:
    """Return how many bytes data of zlib unpack to, in little memory; no more than one piece beyond `most`.

    Raises:
        zlib.error: they are damaged.
    """
    return sum(map(len, _pieces(data, most)))


def first_inflated(data: bytes, size: int) -> bytes:
    """Return the first bytes that data of zlib unpack to.

    Raises:
        zlib.error: they are damaged.
    """
    return zlib.decompressobj().decompress(data, size)


def _pieces(data: bytes, most: int) -> Iterator[bytes]:
    unpacking, rest, size = zlib.decompressobj(), data, 0
    while size <= most and not unpacking.eof:
        piece = unpacking.decompress(rest, _PIECE)
        rest, size = unpacking.unconsumed_tail, size + len(piece)
        if not piece and not rest:
            return
        yield piece


def matlab_5(file: Path) -> int:
    """Return how many bytes of float64 a MATLAB file of version 5 to 7.2 unpacks to; 0 for one of another version.

    MATLAB keeps doubles that are small integers as bytes: an array is as large as its dimensions say.

    Raises:
        zlib.error: it is damaged.
    """
    most, total = limit(file), 0
    with file.open("rb") as stream:
        order = {b"IM": "little", b"MI": "big"}.get(stream.read(128)[126:128])
        while order and len(tag := stream.read(8)) == 8 and total <= most:
            kind, size = (int.from_bytes(tag[i : i + 4], order) for i in (0, 4))  # type: ignore[arg-type]
            if size > most:
                raise zlib.error("an element is longer than the file")
            data = stream.read(size)
            is_packed = kind == 15  # miCOMPRESSED
            start = first_inflated(data, 256) if is_packed else tag + data[:256]
            total += max(inflated(data, most) if is_packed else size, _matlab_numbers(start, order))
    return total


def _matlab_numbers(start: bytes, order: str) -> int:
    """Return the size of an array of numbers as float64, from its first bytes: flags and dimensions; 0 of others."""
    numbers = [int.from_bytes(start[i : i + 4], order) for i in range(0, len(start) - 3, 4)]  # type: ignore[arg-type]
    if len(numbers) < 8 or not 6 <= numbers[4] & 255 <= 15:
        return 0
    return 8 * math.prod(numbers[8 : 8 + min(numbers[7], 128) // 4])
