"""Chunks of a table that grows: a folder of parquet files, each with the rows that its name says, whole or not there.

Each has the identity of its table in its metadata: rows of another one are refused.

Together they are one data set, which anything that reads parquet reads. What is on disk is what is done.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.lab.records import named_files
from masking.lab.records.file_replacement import replacing

Column: TypeAlias = NDArray[np.float64] | NDArray[np.int64] | Sequence[str] | Sequence[NDArray[np.float64]]
Columns: TypeAlias = dict[str, Column]

_NAME: Final = re.compile(r"rows-(\d+)-(\d+)\.parquet")
_PARTIAL: Final = ".rows-*.partial"  # what a process that was killed had begun
_IDENTITY: Final = b"masking.table"
_NUMBERS: Final = {np.dtype(np.float64): pa.float64(), np.dtype(np.int64): pa.int64()}


def path(folder: Path, first: int, last: int) -> Path:
    """File of the rows from `first` to before `last`."""
    return folder / f"rows-{first:09}-{last:09}.parquet"


def write(folder: Path, first: int, last: int, columns: Mapping[str, Column], identity: str) -> None:
    """Write the rows from `first` to before `last` into a folder, made if need be; then they are on disk for sure.

    A column has numbers, texts, or a row of numbers in each row. A RecordError where it cannot be written.
    """
    table = pa.table({name: _array(column) for name, column in columns.items()})
    table = table.replace_schema_metadata({_IDENTITY: identity})
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(path(folder, first, last)) as stream:
            pq.write_table(table, stream, compression="zstd", write_page_checksum=True)
    except OSError as error:
        raise RecordError(
            f"{folder} cannot be written ({error}); make room, then start the same again: finished runs are kept"
        ) from error


def _array(column: Column) -> pa.Array:
    """Column of arrow, from buffers: what takes Python objects would import pandas first."""
    if isinstance(column, np.ndarray):
        whole = np.ascontiguousarray(column)
        return pa.Array.from_buffers(_NUMBERS[whole.dtype], len(whole), [None, pa.py_buffer(whole)])
    if all(isinstance(one, str) for one in column):
        texts = [str(one).encode() for one in column]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        return pa.StringArray.from_buffers(len(texts), pa.py_buffer(ends), pa.py_buffer(b"".join(texts)))
    rows = [np.asarray(one, dtype=np.float64) for one in column]
    ends = np.cumsum([0, *map(len, rows)], dtype=np.int32)
    places = pa.Array.from_buffers(pa.int32(), len(ends), [None, pa.py_buffer(ends)])
    return pa.ListArray.from_arrays(places, _array(np.concatenate(rows)))


def done(folder: Path) -> list[tuple[int, int]]:
    """Ranges of rows that are on disk, in order: first row, and one more than the last."""
    found = [_NAME.fullmatch(file.name) for file in folder.glob("rows-*.parquet")]
    return sorted((int(match[1]), int(match[2])) for match in found if match)


def missing(ranges: Sequence[tuple[int, int]], first: int, last: int) -> list[tuple[int, int]]:
    """Ranges between two rows that are not among `ranges`."""
    covered = sorted((max(a, first), min(b, last)) for a, b in ranges if a < last and b > first)
    edges = [(first, first), *covered, (last, last)]
    reached, found = first, list[tuple[int, int]]()
    for (_, end), (begin, _) in pairwise(edges):
        reached = max(reached, end)
        if begin > reached:
            found.append((reached, begin))
    return found


def clear(folder: Path) -> None:
    """Remove what processes that were killed had begun."""
    for file in folder.glob(_PARTIAL):
        file.unlink(missing_ok=True)


def read(folder: Path, identity: str) -> Columns:
    """Read all rows of a folder, in order, each once.

    A RecordError where there are none, or a file is damaged or has another identity.
    """
    tables, reached = list[pa.Table](), 0
    for first, last in done(folder):
        if last <= reached:  # the same rows in chunks of another size
            continue
        try:
            place = path(folder, first, last)
            with named_files.opened(place) as stream, pq.ParquetFile(stream, page_checksum_verification=True) as file:
                table = file.read()  # pq.read_table would import pandas
        except (pa.ArrowException, OSError) as error:
            remedy = "remove it, then start the same sweep again"
            raise RecordError(f"{path(folder, first, last)} is cut off or damaged; {remedy}") from error
        if (table.schema.metadata or {}).get(_IDENTITY) != identity.encode():
            raise RecordError(f"{path(folder, first, last)} has rows of another sweep; remove it")
        tables.append(table.slice(max(0, reached - first)))
        reached = last
    if not tables:
        raise RecordError(f"{folder} holds no rows")
    return {name: _column([table.column(name) for table in tables]) for name in tables[0].column_names}


def _column(parts: Iterable[pa.ChunkedArray]) -> Column:
    chunks = [chunk for part in parts for chunk in part.chunks]
    kind = chunks[0].type
    if kind == pa.string():
        return [text for chunk in chunks for text in chunk.to_pylist()]
    if pa.types.is_list(kind):
        return [np.array(row, dtype=np.float64) for chunk in chunks for row in chunk.to_pylist()]
    return np.concatenate([np.from_dlpack(chunk) for chunk in chunks])  # to_numpy would import pandas
