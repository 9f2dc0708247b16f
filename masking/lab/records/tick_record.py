"""Record of ticks: the rows of a stream as a recording, read and written part by part, however many there are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import json_text
from masking.errors import RecordError
from masking.lab.records.columns_on_disk import CLOCK
from masking.lab.records.recording import FORMAT, writing
from masking.lab.records.stream_reader import Stream
from masking.lab.records.tick_times import timing
from masking.lazy_imports import parquet

TICK: Final = "tick"
_ROWS: Final = 1 << 16  # of a part


def save(found: Stream, folder: Path, facts: Mapping[str, Any], lateness: str | None = None) -> None:
    """Write the rows of a stream as the recording of a folder, in place of one that is there.

    What is not finite is 0 there, and 1 in `nonfinite.<column>`. The time is that of the ticks; where the plant's clock
    did not go on from each to the next, rows are as far apart as they should be. `facts` are the manifest, to which
    the timing is added: `lateness` is the column of how late ticks were, if there was a clock. A RecordError where it
    cannot be written, or there is no row.
    """
    if not len(found.numbers):
        raise RecordError(f"{found.folder}: its stream has no row")
    names, rate = [*found.manifest["columns"]], float(found.manifest["rate"])
    ticks = column(found.tables, names.index(TICK))
    clock = (ticks if np.all(np.diff(ticks) > 0.0) else found.numbers) / rate
    is_finite = np.all([np.isfinite(part).all(axis=0) for part in found.tables], axis=0)
    late = {} if lateness is None else {"lateness": np.nan_to_num(column(found.tables, names.index(lateness)))}
    manifest = {"columns": found.manifest["columns"], **facts, "rate": rate}
    if late:
        manifest["timing"] = timing(ticks.astype(np.int64), **late)
    text = json_text({"format": FORMAT, **manifest}).encode()
    units = {key: {name: str(one[key]) for name, one in manifest["columns"].items()} for key in ("unit", "meaning")}
    row = 0
    with writing(folder, overwrite=True) as (description, table), parquet.Writer(table) as writer:
        for part in _parts(found.tables):
            columns = {CLOCK: clock[row : row + len(part)]}
            for name, values, is_whole in zip(names, part.T, is_finite, strict=True):
                columns[name] = np.ascontiguousarray(values)
                if not is_whole:
                    columns[f"nonfinite.{name}"] = 1.0 - np.isfinite(values)
                    columns[name] = np.where(np.isfinite(values), values, 0.0)
            writer.add(columns, units)
            row += len(part)
        description.write(text)
        writer.close(text)


def column(tables: Sequence[Array], index: int) -> Array:
    """One column (rows,) of rows (rows, columns) in parts."""
    return np.concatenate([np.empty(0), *(table[:, index] for table in tables)])


def _parts(tables: Sequence[Array]) -> Iterator[Array]:
    """Rows in parts of a size that is written at once."""
    ends = zip(itertools.accumulate(map(len, tables)), tables, strict=True)
    for _, held in itertools.groupby(ends, lambda pair: (pair[0] - 1) // _ROWS):
        yield np.concatenate([table for _, table in held])
