"""Bounds on what files unpack to, checked before they are unpacked: some kilobytes may stand for terabytes."""

from __future__ import annotations

import zlib
from pathlib import Path

from masking.errors import RecordError

SMALL = 2**28  # bytes that every file may unpack to
RATIO = 32  # times its own size that a larger one may unpack to; measured records: 1 to 10


def limit(file: Path) -> int:
    """How many bytes a file may unpack to."""
    return max(SMALL, RATIO * file.stat().st_size)


def check(file: Path, size: int) -> None:
    """Refuse a packed file that unpacks to more bytes than `limit`, in all as float64."""
    if size > limit(file):
        raise RecordError(
            f"{file}: it unpacks to {size / 2**20:.0f} MiB, {size / max(1, file.stat().st_size):.0f} times its size: "
            f"more than {SMALL // 2**20} MiB and {RATIO} times are refused; cut it, or save it without compression"
        )


def inflated(data: bytes, most: int) -> int:
    """How many bytes data of zlib unpack to; one more than `most` where there are more."""
    return len(zlib.decompressobj().decompress(data, most + 1))
