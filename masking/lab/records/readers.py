"""Formats: records that other programs wrote, as recordings, beside our own folders.

A table needs numbers in columns and a clock in seconds under the name `t`; columns may be renamed, and a clock that is
missing is made of the time between samples. A part of a long record is a record, too: `record.csv@10:20`.
"""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError, nearest
from masking.lab.records import columns_on_disk, loggers, matlab_5, numpy_files, text_table
from masking.lab.records.input_hold import Names
from masking.lab.records.nested_data import first_line, parsed, vectors, without_doubles
from masking.lab.records.recording import MANIFEST, TABLE, Recording
from masking.lab.records.time_slice import Part, exists

if TYPE_CHECKING:
    from scipy import io as scipy_io

    from masking.lab.records import hdf5, parquet
else:
    hdf5 = lazy.load("masking.lab.records.hdf5", suppress_warning=True)
    parquet = lazy.load("masking.lab.records.parquet", suppress_warning=True)
    scipy_io = lazy.load("scipy.io", suppress_warning=True)

Column = NDArray[np.float64]
CLOCK = "t"
PREFIXES = ("input", "sensor")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_UNIT = re.compile(r"(.*\S)?\s*[\[(]\s*(" + "|".join(SECONDS) + r")\s*[\])]\s*")  # in a column's name: time [ms]
_LARGEST_JSON = 2**27  # bytes; in memory they are some ten times as many
_TEXT = {".csv", ".txt", ".tsv", ".dat"}
_KNOWN = "a folder of a recording, or a .parquet, .csv, .mat, .h5, .npz, .json, .tdms, .mf4 or .mcap file"


def read(
    path: str | Path, names: Names | None = None, dt: float | None = None, needed: Collection[str] = ()
) -> Recording:
    """Read a record, or a part of one.

    Args:
        path: a folder of a recording, or a file of a table, MATLAB, HDF5, numpy, JSON or a data logger; behind it,
            `@10:20` takes what lies from 10 s to 20 s of its clock, `@10:` the rest of it; times stay as they are.
        names: the columns of the file by the names that they get, such as `{"t": "time", "u1": "V1"}`; vectors in
            groups, structures, cells and matrices have their path, such as `{"u1": "multisine/V1", "y1": "y/1"}`, and
            `run/*/1` joins all that it fits, in the order of the file. For a text without a line of names: the names
            of all its columns, in order. The clock may be given with its unit, `{"t": "time:ms"}`; one that stands in a
            column's name, `time [ms]`, is read there.
        dt: time between samples in s, for a table without a clock.
        needed: channels that must be finite, such as `u1`, which is read from `input.u1` or `u1`; other columns that
            are not finite, or of another length than these, are left out.

    Raises:
        RecordError: there is no such file or column, it holds no table of numbers, it has no clock, columns that are
            needed differ in length, or the part is none of the record.
    """
    part = Part.of(path)
    file = part.file
    if exists(file) and file.is_dir():
        file /= TABLE
    if not exists(file):
        raise RecordError(f"{file}: no such record; give {_KNOWN}")
    if not file.is_file():
        raise RecordError(f"{file}: it is no regular file; give {_KNOWN}")
    if dt is not None and not (np.isfinite(dt) and dt > 0.0):
        raise RecordError(f"{file}: the time between samples is {dt:g} s; give a positive number of seconds")
    heading = tuple(names) if names and not isinstance(names, Mapping) else ()
    is_timed = dt is None and not (isinstance(names, Mapping) and CLOCK in names)
    columns, text = _columns(file, heading, part if is_timed else None)
    names, second = _timed(file, columns, names if isinstance(names, Mapping) else {})
    columns = _renamed(file, columns, names)
    if second != 1.0 and CLOCK in columns:
        columns[CLOCK] = columns[CLOCK] * second
    if dt is not None:
        columns.pop(CLOCK, None)
    wanted = {CLOCK, *needed, *names, *(f"{prefix}.{name}" for prefix in PREFIXES for name in needed)}
    columns = _of_one_length(file, columns, wanted, names)
    if dt is not None:
        length = max((len(c) for c in columns.values()), default=0)
        columns[CLOCK] = np.arange(length, dtype=np.float64) * np.float64(dt)
    if CLOCK not in columns:
        raise RecordError(
            f"{file}: there is no column t; name the clock, such as --map t={_clock(columns)}, or give the time "
            "between samples, such as --dt 0.001"
        )
    chosen = part.samples(columns[CLOCK])
    if file.suffix.lower() in _TEXT:
        wanted_cells = {names.get(n, n): c for n, c in columns.items() if n in wanted}
        text_table.check_cells(part, heading, wanted_cells, chosen, columns[CLOCK])
    columns = columns if chosen.all() else {n: c[chosen] for n, c in columns.items()}
    columns = {n: c for n, c in columns.items() if n in wanted or np.isfinite(c).all()}
    try:
        return Recording(columns, {"name": file.stem}) if text is None else _own(file, columns)
    except RecordError as error:
        raise RecordError(f"{part.name}: {error}") from error


def digest(path: str | Path) -> str:
    """SHA-256 of a record's file, in hexadecimal digits; of the whole file where the record is a part."""
    file = Part.of(path).file
    with (file / TABLE if file.is_dir() else file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mapping(text: str) -> dict[str, str]:
    """Read `t=time,u1=V1` as the columns of a file by the names that they get; refuse what is written otherwise."""
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, column = (word.strip() for word in part.partition("="))
        if not (name and equals and column):
            raise RecordError(f"'{part}' does not rename a column; write it as in --map t=time,u1=V1,y1=V2")
        if name in found:
            raise RecordError(f"--map gives the name {name} twice, to {found[name]} and {column}")
        found[name] = column
    return found


def _columns(file: Path, heading: Sequence[str], part: Part | None) -> tuple[dict[str, Column], bytes | None]:
    """Columns of a file, and the manifest of one of our own.

    `heading` are the names of the columns of a text that has none. `part` is that of a long record, which is read with
    what lies around it; None where its clock is not its own.
    """
    kind = file.suffix.lower()
    if heading and kind not in _TEXT:
        raise RecordError(f"{file}: its columns have names; rename them, such as --map t=time, in place of --columns")
    if kind == ".parquet":
        found, text = parquet.read(file) if part is None else columns_on_disk.read(file)
        if not isinstance(found, columns_on_disk.StoredColumns) or part is None:
            return dict(found), text
        (first, last), rows = (found.spans[0][0], found.spans[-1][-1]), found.rows
        return found.around(*part.within(first, last, (last - first) / max(1, rows - 1))), text
    if kind in _TEXT:
        return text_table.read(file, heading), None
    if kind in _NESTED:
        return _NESTED[kind](file), None
    raise RecordError(f"{file}: '{kind}' files are not read; give {_KNOWN}")


def _own(file: Path, columns: dict[str, Column]) -> Recording:
    """Recording of our own with columns that may have been renamed."""
    kept = Recording.load(file.parent if (file.parent / MANIFEST).exists() and file.name == TABLE else file)
    return Recording(columns, kept.manifest, kept.notes)


def _mat(file: Path) -> dict[str, Column]:
    """Read the vectors of a MATLAB file; one of version 7.3, and some of other programs, are HDF5."""
    try:
        matlab_5.check(file)
        with warnings.catch_warnings(action="ignore"):
            held = scipy_io.loadmat(file, simplify_cells=True)
    except NotImplementedError:
        return hdf5.read(file)
    except RecordError:
        raise
    except Exception as error:  # scipy raises what its parser meets, zlib.error and struct.error among them
        if hdf5.is_hdf5(file):
            return hdf5.read(file)
        raise RecordError(f"{file}: the MATLAB file cannot be read ({first_line(error)})") from error
    return _nested(file, {name: value for name, value in held.items() if not name.startswith("__")})


def _hdf5(file: Path) -> dict[str, Column]:
    return hdf5.read(file)  # h5py loads here, and only here


def _json(file: Path) -> dict[str, Column]:
    """Read lists of numbers, or a list of samples that are objects with the same keys."""
    if file.stat().st_size > _LARGEST_JSON:
        raise RecordError(f"{file}: the JSON file has more than {_LARGEST_JSON} bytes; give a .parquet file")
    with parsed(file, "the JSON file"):
        held = json.loads(file.read_text(encoding="utf-8-sig"), object_pairs_hook=without_doubles)
    if isinstance(held, list) and held and all(isinstance(sample, dict) for sample in held):
        held = {name: [sample.get(name) for sample in held] for name in dict.fromkeys(n for one in held for n in one)}
    return _nested(file, held)


def _nested(file: Path, held: object) -> dict[str, Column]:
    with parsed(file, "it"):
        found = dict(vectors("", held))
    if not found:
        raise RecordError(f"{file}: it holds no vectors of numbers")
    return found


def _timed(file: Path, columns: Mapping[str, Column], names: Mapping[str, str]) -> tuple[dict[str, str], float]:
    """Names of columns by those that they get, with that of the clock, and the seconds in a unit of it."""
    inferred = next((n for n in columns if (found := _UNIT.fullmatch(n)) and found[1] == CLOCK), CLOCK)
    name = names.get(CLOCK, CLOCK if CLOCK in columns else inferred)
    column, colon, unit = name.rpartition(":")
    if name in columns or not colon:
        in_name = _UNIT.fullmatch(name)
        column, unit = name, in_name[2] if in_name else "s"
    elif unit not in SECONDS:
        raise RecordError(f"{file}: the clock is given in '{unit}'; give one of {', '.join(SECONDS)}: t={column}:ms")
    is_renamed = CLOCK in names or (column != CLOCK and column in columns)
    return {**names, **({CLOCK: column} if is_renamed else {})}, SECONDS[unit]


def _renamed(file: Path, columns: Mapping[str, Column], names: Mapping[str, str]) -> dict[str, Column]:
    found = {name: _named(file, columns, column) for name, column in names.items()}
    taken = {*names.values(), *names}
    return found | {name: column for name, column in columns.items() if name not in taken}


def _named(file: Path, columns: Mapping[str, Column], name: str) -> Column:
    """Column, or where a path has asterisks, the columns that it fits, one behind the other."""
    if name in columns:
        return columns[name]
    pattern = re.escape(name).replace(r"\*", "[^/]*")
    parts = [column for path, column in columns.items() if "*" in name and re.fullmatch(pattern, path)]
    if not parts:
        raise RecordError(f"{file}: there is no column {name}; {nearest(name, list(columns))}")
    return np.concatenate(parts)


def _of_one_length(
    file: Path, columns: Mapping[str, Column], wanted: Collection[str], names: Mapping[str, str]
) -> dict[str, Column]:
    """Leave out columns of another length than those that are wanted, or than the longest where none is."""
    lengths = {name: len(column) for name, column in columns.items() if name in wanted}
    if len({*lengths.values()}) > 1:
        listed = ", ".join(
            f"{name} ({names[name]}) has {count}" if name in names else f"{name} has {count}"
            for name, count in lengths.items()
        )
        raise RecordError(f"{file}: columns of different lengths: {listed} samples; give those of one run, with --map")
    length = max(lengths.values() or map(len, columns.values()), default=0)
    return {name: column for name, column in columns.items() if len(column) == length}


def _clock(columns: Mapping[str, Column]) -> str:
    """Column that is probably the clock."""
    rising = [n for n, c in columns.items() if len(c) > 1 and bool((np.diff(c) > 0.0).all())]
    return next((n for n in ("time", "Time", "t_s", *rising) if n in columns), "time")


_NESTED: Mapping[str, Callable[[Path], dict[str, Column]]] = {
    ".mat": _mat,
    ".npz": lambda file: _nested(file, numpy_files.read(file)),
    ".json": _json,
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
    **dict.fromkeys((".tdms", ".mf4", ".mcap"), loggers.read),
}
