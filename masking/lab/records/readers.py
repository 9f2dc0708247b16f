"""Formats: records that other programs wrote, as recordings, beside our own folders.

A table needs numbers in columns and a clock in seconds under the name `t`, or clocks of its channels; columns may be
renamed, and a clock that is missing is made of the time between samples. A part of a long record is a record, too:
`record.csv@10:20`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from masking.display.characters import visible_line
from masking.errors import RecordError, nearest
from masking.lab.records import clock, column_units, columns_on_disk, loggers, matlab_5, numpy_files, time_base
from masking.lab.records.column_units import SECONDS, Asked
from masking.lab.records.nested_data import first_line, parsed, vectors, without_doubles
from masking.lab.records.record_form import Names, TextForm
from masking.lab.records.recording import MANIFEST, TABLE, Recording
from masking.lab.records.text_table import TextTable
from masking.lab.records.time_base import CLOCK, Channels, Resampling
from masking.lab.records.time_slice import Part, exists
from masking.lazy_imports import hdf5, parquet
from masking.lazy_imports import io as scipy_io

Column = NDArray[np.float64]
PREFIXES = ("input", "sensor")
_EPOCH = {1e17: "ns", 1e14: "us", 1e11: "ms"}  # instants since 1970 from which on they are no longer in larger units
_NEXT = re.compile(r",(?=[^,=]*=)")  # a comma behind which another name follows, such as in t=time,q=Force, kN
_LARGEST_JSON = 2**27  # bytes; in memory they are some ten times as many
_TEXT = {".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm"}
_LOGGERS = {".tdms", ".mf4", ".mcap"}
_KNOWN = "a folder of a recording, or a .parquet, .csv, .lvm, .mat, .h5, .npz, .json, .tdms, .mf4 or .mcap file"


def read(
    path: str | Path,
    names: Names | None = None,
    dt: float | None = None,
    needed: Collection[str] = (),
    form: TextForm = TextForm(),  # noqa: B008  (frozen)
    *,
    resampling: Resampling | None = None,
) -> Recording:
    """Read a record, or a part of one.

    Args:
        path: a folder of a recording, or a file of a table, MATLAB, HDF5, numpy, JSON or a data logger; behind it,
            `@10:20` takes what lies from 10 s to 20 s of its clock, `@10:` the rest of it; times stay as they are.
        names: the columns of the file by the names that they get, such as `{"t": "time", "u1": "V1"}`; vectors in
            groups, structures, cells and matrices have their path, such as `{"u1": "multisine/V1", "y1": "y/1"}`, and
            `run/*/1` joins all that it fits, in the order of the file. For a text without a line of names: the names
            of all its columns, in order. A column may be given with its unit, `{"t": "time:ms", "y1": "speed:rpm"}`;
            one that stands in its name, `time [ms]`, or below it is read there. The clock is converted to s, and other
            columns keep their units in `Recording.units`. A column that has a clock of its own is given with it, as
            `{"y1": "slow/y@slow/time:ms"}`; channels of data loggers have theirs.
        dt: time between samples in s, for a table without a clock.
        needed: channels that must be finite, such as `u1`, which is read from `input.u1` or `u1`; other columns that
            are not finite, or of another length than these, are left out.
        form: the lines above the numbers of a text, and its encoding.
        resampling: how columns on several clocks, or on one that is not steady, are put on a steady one; their samples
            that are not numbers are missing then. By default they are refused.

    Raises:
        RecordError: there is no such file or column, it holds no table of numbers, it has no clock, several, or one in
            a unit that is none or in doubt, columns that are needed differ in length, or the part is none of the
            record.
    """
    part = Part.of(path)
    file = _existing(part.file)
    if dt is not None and not (np.isfinite(dt) and dt > 0.0):
        raise RecordError(f"{file}: the time between samples is {dt:g} s; give a positive number of seconds")
    given = dict(names) if isinstance(names, Mapping) else {}
    heading = tuple(names) if names and not isinstance(names, Mapping) else ()
    if file.suffix.lower() not in _TEXT and (heading or form != TextForm()):
        option = "--columns" if heading else "--header-rows and --encoding"
        raise RecordError(f"{file}: its columns have names; rename them, such as --map t=time, in place of {option}")
    table = TextTable.opened(file, heading, form) if file.suffix.lower() in _TEXT else None
    is_timed = dt is None and CLOCK not in given
    held, text = (Channels(table.columns()), None) if table else _columns(file, part if is_timed else None)
    asked, columns, own = _by_names(file, held, given, table.units if table else _declared(text), is_timed=dt is None)
    if dt is not None:
        columns.pop(CLOCK, None)
    wanted = {CLOCK, *needed, *given, *(f"{prefix}.{name}" for prefix in PREFIXES for name in needed)}
    own = {name: times for name, times in own.items() if name in columns and name in wanted}
    if own and resampling is None:
        columns |= time_base.joined(part, {n: c for n, c in columns.items() if n in wanted}, own, None)[0]
    if resampling is None or dt is not None:
        columns = _of_one_length(file, columns, wanted, given)
    if dt is not None:
        length, own = max((len(c) for c in columns.values()), default=0), {}
        columns[CLOCK] = np.arange(length, dtype=np.float64) * np.float64(dt)
    if CLOCK not in columns and not own:
        raise RecordError(
            f"{file}: there is no column t; name the clock, such as --map t={_clock(columns)}, or give the time "
            f"between samples, such as --dt 0.001{_above(table)}"
        )
    notes: tuple[str, ...] = ()
    if resampling is not None:
        columns, notes = time_base.joined(part, {n: c for n, c in columns.items() if n in wanted}, own, resampling)
    else:
        columns = _of_part(part, table, columns, wanted, asked)
    units = {one.name: {"unit": one.unit, "column": one.column} for one in asked}
    is_in_s = dt is not None or text is not None or bool(held.clocks) or bool(units.get(CLOCK, {}).get("unit"))
    units[CLOCK] = {"unit": "s" if is_in_s else "", "column": units.get(CLOCK, {}).get("column", CLOCK)}
    try:
        made = (
            Recording(columns, {"name": visible_line(file.stem), "columns": units})
            if text is None
            else _own(file, columns, units)
        )
    except RecordError as error:
        is_rising = dt is not None or bool((np.diff(columns[CLOCK]) > 0.0).all())
        remedy = "" if is_rising else "; if samples are equally far apart, leave the clock out and give --dt"
        raise RecordError(f"{part.name}: {error}{remedy}") from error
    return replace(made, notes=(*made.notes, *notes)) if notes else made


def _existing(file: Path) -> Path:
    """File of a record, or of the table in its folder; a RecordError where there is none."""
    if exists(file) and file.is_dir():
        file /= TABLE
    if not exists(file):
        raise RecordError(f"{file}: no such record; give {_KNOWN}")
    if not file.is_file():
        raise RecordError(f"{file}: it is no regular file; give {_KNOWN}")
    return file


def digest(path: str | Path) -> str:
    """SHA-256 of a record's file, in hexadecimal digits; of the whole file where the record is a part."""
    file = Part.of(path).file
    with (file / TABLE if file.is_dir() else file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mapping(text: str) -> dict[str, str]:
    """Read `t=time,u1=V1` as the columns of a file by the names that they get; refuse what is written otherwise."""
    found: dict[str, str] = {}
    for part in filter(None, (part.strip(" ,") for part in _NEXT.split(text))):
        name, equals, column = (word.strip() for word in part.partition("="))
        if not (name and equals and column):
            raise RecordError(f"'{part}' does not rename a column; write it as in --map t=time,u1=V1,y1=V2")
        if name in found:
            raise RecordError(f"--map gives the name {name} twice, to {found[name]} and {column}")
        found[name] = column
    return found


def _of_part(
    part: Part, table: TextTable | None, columns: dict[str, Column], wanted: Collection[str], asked: Collection[Asked]
) -> dict[str, Column]:
    """Samples of a part of a record, of columns that are wanted, which must be numbers, or are."""
    chosen = part.samples(columns[CLOCK])
    if table is not None:
        cells = {one.column: columns[one.name] for one in asked if one.name in wanted & columns.keys()}
        table.check(part, cells, chosen, columns[CLOCK])
    columns = columns if chosen.all() else {n: c[chosen] for n, c in columns.items()}
    time_base.check_there(part, {n: c for n, c in columns.items() if n in wanted})
    return {n: c for n, c in columns.items() if n in wanted or np.isfinite(c).all()}


def _columns(file: Path, part: Part | None) -> tuple[Channels, bytes | None]:
    """Columns of a file that is no text, with clocks of their own, and the manifest of one of our own.

    `part` is that of a long record, which is read with what lies around it; None where its clock is not its own.
    """
    kind = file.suffix.lower()
    if kind == ".parquet":
        found, text = parquet.read(file) if part is None else columns_on_disk.read(file)
        if not isinstance(found, columns_on_disk.StoredColumns) or part is None:
            return Channels(dict(found)), text
        (first, last), rows = (found.spans[0][0], found.spans[-1][-1]), found.rows
        return Channels(found.around(*part.within(first, last, (last - first) / max(1, rows - 1)))), text
    if kind in _LOGGERS:
        return _shown(file, loggers.read(file)), None
    if kind in _NESTED:
        return _shown(file, Channels(_NESTED[kind](file))), None
    raise RecordError(f"{file}: '{kind}' files are not read; give {_KNOWN}")


def _shown(file: Path, held: Channels) -> Channels:
    """Channels under names that can be shown; a RecordError where two of them are alike then."""
    names = {name: visible_line(name) for name in held.columns}
    if repeated := [name for name, count in Counter(names.values()).items() if count > 1]:
        raise RecordError(f"{file}: column '{repeated[0]}' appears more than once")
    columns = {shown: held.columns[name] for name, shown in names.items()}
    return Channels(columns, {visible_line(name): times for name, times in held.clocks.items()})


def _own(file: Path, columns: dict[str, Column], units: Mapping[str, Mapping[str, str]]) -> Recording:
    """Recording of our own with columns that may have been renamed, and have the units that they are said to have."""
    kept = Recording.load(file.parent if (file.parent / MANIFEST).exists() and file.name == TABLE else file)
    entries = kept.manifest.get("columns") or {}
    described = {name: {**entries.get(one["column"], {}), **one} for name, one in units.items()}
    return Recording(columns, {**kept.manifest, "columns": {**entries, **described}}, kept.notes)


def _declared(manifest: bytes | None) -> dict[str, str]:
    """Units of the columns of a recording of our own, but for its clock, by its manifest."""
    with contextlib.suppress(ValueError, RecursionError, AttributeError):
        entries = json.loads(manifest or b"{}").get("columns") or {}
        return {name: str(entry.get("unit") or "") for name, entry in entries.items() if name != CLOCK}
    return {}


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


def _by_names(
    file: Path, held: Channels, given: Mapping[str, str], units: Mapping[str, str], *, is_timed: bool
) -> tuple[list[Asked], dict[str, Column], dict[str, Column]]:
    """Columns of a file by the names that they get, how these were asked for, and clocks of their own, in s."""
    parted = {name: _parted(held.columns, path) for name, path in given.items()}
    asked = column_units.named(held.columns, {name: column for name, (column, _) in parted.items()}, units)

    def times(one: Asked) -> Column:
        second = _seconds(file, one, held.columns)
        return clock.running_on(_named(file, held.columns, one.column)) * second

    clocks = {one.name: times(one) for one in asked if one.name == CLOCK and is_timed}
    columns = {one.name: clocks.get(one.name, _named(file, held.columns, one.column)) for one in asked}
    own = {one.name: held.clocks[one.column] for one in asked if one.column in held.clocks}
    for name, (_, at) in parted.items():
        if at:
            own[name] = times(column_units.named(held.columns, {CLOCK: at}, units)[0])
    return asked, columns, own


def _parted(columns: Mapping[str, Column], path: str) -> tuple[str, str]:
    """Path of a column and that of its clock, as in `slow/y@slow/time`; the clock is empty where none is given."""
    column, at, times = path.rpartition("@")
    return (path, "") if path in columns or not at else (column, times)


def _seconds(file: Path, clock: Asked, columns: Mapping[str, Column]) -> float:
    """Seconds in the unit of a clock; a RecordError where it is none of time, or none is known and it is hardly s."""
    if clock.unit:
        if clock.unit not in SECONDS:
            known = ", ".join(SECONDS)
            raise RecordError(
                f"{file}: the clock is given in '{clock.unit}'; give one of {known}: --map t={clock.column}:ms"
            )
        return SECONDS[clock.unit]
    hint, what = column_units.hinted(clock.column), f"the name of the clock, {clock.column},"
    if hint not in SECONDS or hint == "s":
        first = next((abs(float(time)) for time in columns.get(clock.column, ()) if np.isfinite(time)), 0.0)
        hint, what = (
            next((unit for least, unit in _EPOCH.items() if first >= least), ""),
            f"its first time, {first:.9g},",
        )
    if hint:
        raise RecordError(
            f"{file}: {what} lets its unit be {hint}; say which it is: --map t={clock.column}:{hint}, or "
            f"--map t={clock.column}:s"
        )
    return 1.0


def _above(table: TextTable | None) -> str:
    """What else to do where names of a text were found in the wrong line."""
    if table is None or table.header.start < 2:
        return ""
    return f"; if its names stand elsewhere than above line {table.header.start}, give --header-rows and --columns"


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
}
