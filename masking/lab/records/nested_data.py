"""Vectors of numbers in nested data: structures, lists, cell arrays and matrices, each vector named by its path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError

Column = NDArray[np.float64]
MOST_COLUMNS = 64  # of a matrix; its longer side is time


def first_line(error: BaseException) -> str:
    """First line of an error's text, or its type."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


@contextmanager
def parsed(file: Path, what: str) -> Iterator[None]:
    """Turn whatever a parser raises at a file inside, such as struct.error, into a RecordError in our words."""
    try:
        yield
    except RecordError:
        raise
    except Exception as error:
        raise RecordError(f"{file}: {what} cannot be read ({first_line(error)})") from error


def vectors(path: str, held: object) -> Iterator[tuple[str, Column]]:
    """Vectors of numbers in some data as float64, by their paths, such as `run/u`.

    (n,), (1, n) and (n, 1) are vectors, with two numbers or more. The columns of a matrix that is not square, along its
    longer side, and the items of a list are numbered from 1: `run/y/1`. What holds no numbers is left out.
    """
    if isinstance(held, Mapping):
        for name, one in held.items():
            yield from vectors(f"{path}/{name}" if path else str(name), one)
        return
    if isinstance(held, list | tuple) and _is_row(held):
        held = np.array([np.nan if x is None else x for x in held], dtype=np.float64)
    array = held if isinstance(held, np.ndarray) else None
    if array is None or array.dtype.kind == "O":
        items = held if array is None else array.ravel().tolist()
        if isinstance(items, list | tuple):
            for number, one in enumerate(items, 1):
                yield from vectors(f"{path}/{number}".lstrip("/"), one)
    elif array.dtype.kind in "fiub" and array.size >= 2:
        yield from _columns(path, array)


def _is_row(items: list[object] | tuple[object, ...]) -> bool:
    return all(x is None or isinstance(x, float | int) for x in items) and any(x is not None for x in items)


def _columns(path: str, array: NDArray[np.generic]) -> Iterator[tuple[str, Column]]:
    array = np.squeeze(array)
    if array.ndim == 1:
        yield path or "1", np.ascontiguousarray(array, dtype=np.float64)
    elif array.ndim == 2 and min(array.shape) < max(array.shape) and min(array.shape) <= MOST_COLUMNS:
        rows = array if array.shape[0] < array.shape[1] else array.T
        for number, row in enumerate(rows, 1):
            yield f"{path}/{number}".lstrip("/"), np.ascontiguousarray(row, dtype=np.float64)


def without_doubles(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Object of JSON; a ValueError where a key stands in it twice."""
    held = dict(pairs)
    if len(held) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key '{next(n for n in names if names.count(n) > 1)}' stands twice in an object")
    return held
