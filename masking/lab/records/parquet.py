"""A table of numbers in a parquet file: written whole or not at all, read without pandas, whole or by groups of rows.

This module alone touches pyarrow, so that whoever only handles a recording in memory does not pay for loading it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, Self, final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from masking.display.characters import visible_line
from masking.errors import RecordError
from masking.lab.records import unpacked_size

Column = NDArray[np.float64]
MANIFEST_KEY = b"masking.manifest"
ROWS: Final = 2**16  # of a group of rows, what is read or written at once of a long table
_MAGIC = b"PAR1"  # the first bytes of every parquet file
# Dictionaries do not pay for real numbers: measured 11 times the time and 1.3 times the size.
_WRITTEN: Final[Mapping[str, Any]] = {"compression": "zstd", "use_dictionary": False, "write_page_checksum": True}


@final
class Writer:
    """A table that is written to a stream chunk by chunk, with a manifest in JSON, now or at its end; a context."""

    def __init__(self, stream: BinaryIO, manifest: bytes | None = None) -> None:
        self._stream, self._metadata = stream, {} if manifest is None else {MANIFEST_KEY: manifest}
        self._writer: Any = None  # of pyarrow

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.is_open = False  # after an error: else it would go on in a stream that is closed

    def add(self, columns: Mapping[str, Column], facts: Mapping[str, Mapping[str, str]]) -> None:
        """Write rows behind those that are there: the same contiguous columns (samples,) each time.

        `facts` are texts for the metadata of fields, such as their units, by key and column; the first ones count.
        """
        if self._writer is None:
            # Statistics of all columns of all groups: measured 8 MB of memory for each hour at 1 kHz.
            schema = _schema(columns, facts).with_metadata(self._metadata)
            self._writer = pq.ParquetWriter(self._stream, schema, write_statistics=["t"], **_WRITTEN)
        self._writer.write_table(_table(columns, self._writer.schema), row_group_size=ROWS)

    def close(self, manifest: bytes | None = None) -> None:
        """Write the end of the table, and the manifest where it was not known before."""
        self._writer.add_key_value_metadata({} if manifest is None else {MANIFEST_KEY: manifest})
        self._writer.close()


def _schema(names: Iterable[str], facts: Mapping[str, Mapping[str, str]]) -> pa.Schema:
    return pa.schema(
        pa.field(name, pa.float64(), metadata={key: texts[name] for key, texts in facts.items() if name in texts})
        for name in names
    )


def _table(columns: Mapping[str, Column], schema: pa.Schema) -> pa.Table:
    # From buffers: pa.array() would look whether its argument is a pandas object and import pandas for that (0.4 s).
    arrays = [pa.Array.from_buffers(pa.float64(), len(c), [None, pa.py_buffer(c)]) for c in columns.values()]
    return pa.Table.from_arrays(arrays, schema=schema)


@dataclass(frozen=True)
class Outline:
    """What a table holds, as its end says; no row is read for it."""

    path: Path  # of the file
    names: tuple[str, ...]  # of the columns
    edges: tuple[int, ...]  # number of the first row of each group, and behind them how many there are
    # first and last time of each group, as its statistics say; NaN where they do not
    spans: tuple[tuple[float, float], ...]
    manifest: bytes | None  # JSON; None where there is none
    metadata: Any  # of the file, so that it is read once
    version: tuple[int, int]  # of the file: time of its last change, in ns, and its size


def outline(path: Path) -> Outline:
    """Read what a parquet file holds, but no row of it; refuse what is no table of numbers."""
    with _reading(path) as file:
        _check_kinds(path, file.schema_arrow)
        found, names = file.metadata, tuple(file.schema_arrow.names)
        _check_names(path, names)
        groups = [found.row_group(i) for i in range(found.num_row_groups)]
        edges = np.cumsum([0, *(group.num_rows for group in groups)]).tolist()
        clock = names.index("t") if "t" in names else None
        spans = tuple(_range(group, clock) for group in groups)
        manifest = (found.metadata or {}).get(MANIFEST_KEY)
        return Outline(path, names, tuple(edges), spans, manifest, found, _version(path))


def _range(group: pq.RowGroupMetaData, column: int | None) -> tuple[float, float]:
    """Least and the greatest number of a column in a group, as its statistics say."""
    known = None if column is None else group.column(column).statistics
    if known is None or not known.has_min_max:
        return math.nan, math.nan
    return float(known.min) + 0.0, float(known.max) + 0.0  # a zero has a sign there


def groups(table: Outline, which: Sequence[int], names: Sequence[str]) -> Iterator[dict[str, Column]]:
    """Read columns of a table, one group of rows after the other; `which` are the numbers of the groups.

    A RecordError where it is damaged, or another file than it was.
    """
    if _version(table.path) != table.version:
        raise RecordError(f"{table.path}: the recording was replaced since it was loaded; load it anew")
    with _reading(table.path, table.metadata) as file:
        _check_size(table.path, file.metadata)
        for number in which:
            found = file.read_row_group(number, columns=[*names], use_threads=False)
            yield {name: _numbers(found.column(name)) for name in names}


def joined(table: Outline, which: Sequence[int]) -> dict[str, Column]:
    """Columns of some groups of rows, one behind the other; raises what `groups` does."""
    parts = [*groups(table, which, table.names)]
    return {name: np.concatenate([np.empty(0), *(part[name] for part in parts)]) for name in table.names}


def _version(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as error:
        raise RecordError(f"{path}: the recording cannot be read: {error.strerror or error}") from error
    return found.st_mtime_ns, found.st_size


def read(path: Path) -> tuple[dict[str, Column], bytes | None]:
    """Read every column of a parquet file as float64 (a null becomes NaN), and the manifest text if there is one.

    A RecordError where it cannot be read, or is no table of numbers.
    """
    table = outline(path)
    return joined(table, range(len(table.edges) - 1)), table.manifest


@contextmanager
def _reading(path: Path, metadata: Any = None) -> Iterator[pq.ParquetFile]:  # noqa: ANN401  # of pyarrow
    """Open a parquet file; what goes wrong with it while it is open is a RecordError in our words."""
    try:
        with path.open("rb") as stream:
            is_parquet = stream.read(len(_MAGIC)) == _MAGIC
    except OSError as error:
        raise RecordError(f"{path}: the recording cannot be read: {error.strerror or error}") from error
    if not is_parquet:
        raise RecordError(f"{path} is not a recording: it is no parquet file")
    try:
        with pq.ParquetFile(path, metadata=metadata, page_checksum_verification=True) as file:
            yield file
    except (pa.ArrowException, OSError, MemoryError, UnicodeError) as error:
        raise RecordError(f"{path} is not a recording: the parquet file is cut off or damaged") from error


def _check_names(path: Path, names: Sequence[str]) -> None:
    repeated = sorted(name for name, count in Counter(names).items() if count > 1)
    if repeated:
        raise RecordError(f"{path}: column '{repeated[0]}' appears more than once")
    for name in names:
        if name != visible_line(name):
            raise RecordError(f"{path}: the name of column '{visible_line(name)}' holds a control character; rename it")


def _check_kinds(path: Path, schema: pa.Schema) -> None:
    for one in schema:
        if not (pa.types.is_floating(one.type) or pa.types.is_integer(one.type)):
            raise RecordError(f"{path}: column '{one.name}' holds {one.type}, not numbers")


def _check_size(path: Path, metadata: pq.FileMetaData) -> None:
    parts = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    columns = [part.column(i) for part in parts for i in range(part.num_columns)]
    unpacked_size.check(path, sum(max(8 * one.num_values, one.total_uncompressed_size) for one in columns))


def _numbers(column: pa.ChunkedArray) -> Column:
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)  # large integers are rounded
    if column.null_count:
        column = column.fill_null(float("nan"))
    # From buffers for the reason given in `_table`.
    chunks = [chunk for chunk in column.chunks if len(chunk)]
    parts = [np.frombuffer(one.buffers()[1], np.float64, len(one), 8 * one.offset) for one in chunks]
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts])
