"""Stored columns: those of a long recording, which stay on disk and are read where they are asked for."""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError, nearest
from masking.lazy_imports import parquet

Column = NDArray[np.float64]
LARGE: Final = 2**28  # bytes in memory, from which on a recording stays on disk
CLOCK: Final = "t"


@final
class StoredColumns(Mapping[str, Column]):
    """Columns of a table on disk: each is read whole when it is asked for, and forgotten with its last user.

    A RecordError where the table has no clock, no rows, or a clock that goes back.
    """

    def __init__(self, table: parquet.Outline) -> None:
        self.table, self._kept = table, weakref.WeakValueDictionary[str, Column]()
        if CLOCK not in table.names:
            raise RecordError(f"{table.path}: the recording has no column '{CLOCK}'; {nearest(CLOCK, table.names)}")
        if not self.rows:
            raise RecordError(f"{table.path}: the recording has no samples")
        for number, ((_, last), (first, _)) in enumerate(pairwise(self.spans), 1):
            if not last < first:
                row = table.edges[number]
                words = f"column 't' must increase strictly: row {row} is {first:.9g} after {last:.9g}"
                raise RecordError(f"{table.path}: {words}")

    def __reduce__(self) -> tuple[Any, ...]:
        return StoredColumns, (self.table,)

    def __len__(self) -> int:
        return len(self.table.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.table.names)

    def __contains__(self, name: object) -> bool:
        return name in self.table.names

    def __getitem__(self, name: str) -> Column:
        """Read one column, shape (samples,)."""
        if name not in self.table.names:
            raise KeyError(name)
        found = self._kept.get(name)
        if found is None:
            found = np.empty(self.rows)
            for begin, part in zip(self.table.edges, self.chunks([name]), strict=False):
                found[begin : begin + len(part[name])] = part[name]
            found.flags.writeable = False
            self._kept[name] = found
        return found

    @property
    def rows(self) -> int:
        """How many samples there are."""
        return self.table.edges[-1]

    @property
    def spans(self) -> Sequence[tuple[float, float]]:
        """First and the last time of each group of rows."""
        if any(math.isnan(first) for first, _ in self.table.spans):  # another program wrote it, without statistics
            clocks = [part[CLOCK] for part in self.chunks([CLOCK])]
            return [(float(clock[0]), float(clock[-1])) for clock in clocks]
        return self.table.spans

    def chunks(self, names: Sequence[str] | None = None) -> Iterator[dict[str, Column]]:
        """Read columns, one group of rows after the other; all of them where none are named."""
        wanted = self.table.names if names is None else names
        found = parquet.groups(self.table, range(len(self.table.edges) - 1), wanted)
        for begin, part in zip(self.table.edges, found, strict=False):
            for name, column in part.items():
                finite = np.isfinite(column)
                if not finite.all():
                    row = int(np.argmin(finite))
                    raise RecordError(f"{self.table.path}: column '{name}' is {column[row]} in row {begin + row}")
            yield part

    def around(self, start: float, end: float) -> dict[str, Column]:
        """Read all groups of rows that have one between two times."""
        which = [number for number, (first, last) in enumerate(self.spans) if last >= start and first < end]
        return parquet.joined(self.table, which)


def read(path: Path) -> tuple[Mapping[str, Column], bytes | None]:
    """Columns of a parquet file, which stay on disk where they are large, and the manifest if there is one."""
    table = parquet.outline(path)
    if CLOCK not in table.names or 8 * table.edges[-1] * len(table.names) <= LARGE:
        return parquet.read(path)
    return StoredColumns(table), table.manifest
