"""What a hostile file is, and what must happen to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

SECRET = "hostile_secret_5f2c"  # noqa: S105  (stands in a file that no message may show)
T = np.arange(40) / 8.0
X = np.sin(3.0 * T) / 7.0
Y = np.cumsum(X) - 1e-3
COLUMNS = {"t": T, "x": X, "y": Y}


@dataclass(frozen=True)
class Refused:
    """The file is refused; all of these words are in the message."""

    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Read:
    """The file is read, with exactly these numbers."""

    columns: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Either:
    """The file is refused, or read with exactly these numbers; with any numbers where the format has no checksum."""

    columns: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordCase:
    """A record.

    Args:
        name: says what is hostile.
        make: writes it into a folder and returns what is read.
        wanted: what must happen.
        given: other arguments of `readers.read`.
        is_slow: whether it is left out of the sample.
    """

    name: str
    make: Callable[[Path], str | Path]
    wanted: Refused | Read | Either
    given: Mapping[str, Any] = field(default_factory=dict)
    is_slow: bool = False


def written(name: str, data: bytes | str) -> Callable[[Path], Path]:
    """Return what writes a file."""

    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    return make
