"""Formats: records that other programs wrote, as recordings: parquet, csv and mat beside our own folders.

A table needs numbers in columns and a clock in seconds under the name `t`; columns may be renamed, and a clock that is
missing is made of the time between samples.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError, nearest
from masking.recording import MANIFEST, TABLE, Recording

if TYPE_CHECKING:
    from scipy import io as scipy_io

    from masking import parquet
else:
    parquet = lazy.load("masking.parquet", suppress_warning=True)
    scipy_io = lazy.load("scipy.io", suppress_warning=True)

Column = NDArray[np.float64]
CLOCK = "t"
PREFIXES = ("input", "sensor")
_TEXT = {".csv", ".txt", ".tsv", ".dat"}
_KNOWN = "a folder of a recording, or a .parquet, .csv or .mat file"


def read(
    path: str | Path,
    names: Mapping[str, str] | None = None,
    dt: float | None = None,
    needed: Collection[str] = (),
) -> Recording:
    """Read a record.

    Args:
        path: a folder of a recording, or a .parquet, .csv, .txt, .tsv, .dat or .mat file.
        names: the columns of the file by the names that they get, such as `{"t": "time", "u1": "V1"}`.
        dt: time between samples in s, for a table without a clock.
        needed: channels that must be finite, such as `u1`, which is read from `input.u1` or `u1`; other columns that
            are not finite are left out.

    Raises:
        RecordError: there is no such file or column, it holds no table of numbers, or it has no clock.
    """
    file = Path(path)
    if file.is_dir():
        file /= TABLE
    if not file.exists():
        raise RecordError(f"{file}: no such record; give {_KNOWN}")
    columns, text = _columns(file)
    columns = _renamed(file, columns, names or {})
    wanted = {CLOCK, *needed, *(names or ()), *(f"{prefix}.{name}" for prefix in PREFIXES for name in needed)}
    columns = {n: c for n, c in columns.items() if n in wanted or np.isfinite(c).all()}
    columns = _of_one_length(columns, wanted)
    if dt is not None:
        if not (np.isfinite(dt) and dt > 0.0):
            raise RecordError(f"{file}: the time between samples is {dt:g} s; give a positive number of seconds")
        length = max((len(c) for c in columns.values()), default=0)
        columns[CLOCK] = np.arange(length, dtype=np.float64) * np.float64(dt)
    if CLOCK not in columns:
        raise RecordError(
            f"{file}: there is no column t; name the clock, such as --map t={_clock(columns)}, or give the time "
            "between samples, such as --dt 0.001"
        )
    try:
        return Recording(columns, {"name": file.stem}) if text is None else _own(file, columns)
    except RecordError as error:
        raise RecordError(f"{file}: {error}") from error


def digest(path: str | Path) -> str:
    """Return the SHA-256 of a record's file, in hexadecimal digits."""
    file = Path(path)
    return hashlib.sha256((file / TABLE if file.is_dir() else file).read_bytes()).hexdigest()


def mapping(text: str) -> dict[str, str]:
    """Read `t=time,u1=V1` as the columns of a file by the names that they get.

    Raises:
        RecordError: a part has no equals sign, or a name is given twice.
    """
    found: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, column = (word.strip() for word in part.partition("="))
        if not (name and equals and column):
            raise RecordError(f"'{part}' does not rename a column; write it as in --map t=time,u1=V1,y1=V2")
        if name in found:
            raise RecordError(f"--map gives the name {name} twice, to {found[name]} and {column}")
        found[name] = column
    return found


def _columns(file: Path) -> tuple[dict[str, Column], bytes | None]:
    """Return the columns of a file, and the manifest of one of our own."""
    kind = file.suffix.lower()
    if kind == ".parquet":
        return parquet.read(file)
    if kind in _TEXT:
        return _text(file), None
    if kind == ".mat":
        return _mat(file), None
    raise RecordError(f"{file}: '{kind}' files are not read; give {_KNOWN}")


def _own(file: Path, columns: dict[str, Column]) -> Recording:
    """Return one of our own recordings with columns that may have been renamed."""
    kept = Recording.load(file.parent if (file.parent / MANIFEST).exists() and file.name == TABLE else file)
    return Recording(columns, kept.manifest, kept.notes)


def _text(file: Path) -> dict[str, Column]:
    """Read a table whose first line names its columns, between commas, semicolons, tabs or blanks."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise RecordError(f"{file}: the table cannot be read ({error})") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("%", "//"))]
    if not lines:
        raise RecordError(f"{file}: the table is empty")
    head = lines[0].lstrip("# ")
    separator = next((s for s in ("\t", ";", ",") if s in head), None)
    names = [n.strip() for n in (next(csv.reader([head], delimiter=separator)) if separator else head.split())]
    if all(_is_number(name) for name in names if name):
        raise RecordError(f"{file}: the first line holds numbers; let it name the columns, such as t,u1,y1")
    body = "\n".join(lines[1:])
    if separator == ";" and "," in body:  # decimal commas
        body = body.replace(",", ".")
    used = [i for i, name in enumerate(names) if name]
    try:
        table = np.genfromtxt(io.StringIO(body), delimiter=separator, usecols=used, ndmin=2)
    except ValueError as error:
        told = str(error).strip().splitlines()[-1].strip()
        raise RecordError(
            f"{file}: the lines do not hold one number for each of {len(names)} columns: {told}"
        ) from None
    repeated = sorted({names[i] for i in used if names.count(names[i]) > 1})
    if repeated:
        raise RecordError(f"{file}: column '{repeated[0]}' appears more than once")
    return {names[i]: np.ascontiguousarray(table[:, j]) for j, i in enumerate(used)}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _mat(file: Path) -> dict[str, Column]:
    """Read the vectors of a MATLAB file of version 7 or older."""
    try:
        held = scipy_io.loadmat(file)
    except NotImplementedError:
        raise RecordError(f"{file}: a MATLAB file of version 7.3; save it with -v7, or as csv") from None
    except (OSError, ValueError) as error:
        raise RecordError(f"{file}: the MATLAB file cannot be read ({error})") from error
    found = {}
    for name, value in held.items():
        array = np.asarray(value)
        if name.startswith("__") or array.dtype.kind not in "fiu" or array.size < 2 or array.size != max(array.shape):
            continue
        found[name] = np.ascontiguousarray(array.ravel(), dtype=np.float64)
    if not found:
        raise RecordError(f"{file}: it holds no vectors of numbers")
    return found


def _renamed(file: Path, columns: Mapping[str, Column], names: Mapping[str, str]) -> dict[str, Column]:
    for column in names.values():
        if column not in columns:
            raise RecordError(f"{file}: there is no column {column}; {nearest(column, list(columns))}")
    taken = {*names.values(), *names}
    rest = {name: column for name, column in columns.items() if name not in taken}
    return {name: columns[column] for name, column in names.items()} | rest


def _of_one_length(columns: dict[str, Column], wanted: Collection[str]) -> dict[str, Column]:
    """Leave out columns that are as long as no other that is wanted, such as settings in a MATLAB file."""
    lengths = {len(c) for n, c in columns.items() if n in wanted}
    return {n: c for n, c in columns.items() if n in wanted or len(lengths) != 1 or len(c) in lengths}


def _clock(columns: Mapping[str, Column]) -> str:
    """Return the column that is probably the clock."""
    rising = [n for n, c in columns.items() if len(c) > 1 and bool((np.diff(c) > 0.0).all())]
    return next((n for n in ("time", "Time", "t_s", *rising) if n in columns), "time")


__all__ = ["CLOCK", "digest", "mapping", "read"]
