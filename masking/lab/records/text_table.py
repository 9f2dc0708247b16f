"""Tables of numbers as text: between commas, semicolons, tabs or blanks, with a name for each column.

A cell is a decimal number or it is missing, whatever else Python or another program takes for a number, such as
`1_000`, `0x10` or `1 000`. A line has as many cells as there are names, or the file is refused with its line.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.lab.records.decimals import is_decimal, is_number
from masking.lab.records.time_slice import Part

Column = NDArray[np.float64]
LARGEST = 2**29  # bytes; what is read takes some times as much memory
_FORBIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f\x85\u2028\u2029]")
_NEITHER = re.compile(r"[^-+0-9eE.,;\t\n ]")  # in a table of decimal numbers
_REMARKS = ("%", "//")


@dataclass(frozen=True)
class _Table:
    names: Sequence[str]  # of its columns; an empty one is left out
    separator: str | None  # between cells; None for blanks
    start: int  # number of the first line of the body, from 1
    body: str  # the lines below the names


def read(file: Path, heading: Sequence[str]) -> dict[str, Column]:
    """Read a table; its first line names its columns, or a heading does. Missing numbers are NaN.

    A RecordError where it is no table, a line has more or fewer cells than there are names, or a name stands twice.
    """
    table = _table(file, heading)
    used = [i for i, name in enumerate(table.names) if name]
    repeated = sorted(name for name, count in Counter(table.names).items() if name and count > 1)
    if repeated:
        raise RecordError(f"{file}: column '{repeated[0]}' appears more than once")
    found = _of_decimals(table)
    if found is None:
        rows = [[_number(cell, table) for cell in cells] for _, cells in _rows(file, table)]
        found = np.array(rows, dtype=np.float64).reshape(len(rows), len(table.names))
    return {table.names[i]: np.ascontiguousarray(found[:, i]) for i in used}


def check_cells(
    part: Part, heading: Sequence[str], columns: Mapping[str, Column], chosen: NDArray[np.bool_], clock: Column
) -> None:
    """Refuse what is no number where one must be, with its line in the file, such as a sample of a part.

    `columns` must be finite there, and have their names in the file; `chosen` says of each sample whether it is in the
    part, and `clock` has its time in s (samples,); `heading` is as that of `read`.
    """
    wrong = {name: np.flatnonzero(chosen & ~np.isfinite(values)) for name, values in columns.items()}
    first = min(((int(rows[0]), name) for name, rows in wrong.items() if len(rows)), default=None)
    if first is None:
        return
    row, name = first[0], next(n for n, rows in wrong.items() if len(rows) and rows[0] == first[0])
    table = _table(part.file, heading)
    number, cells = _rows(part.file, table)[row]
    cell = cells[table.names.index(name)]
    count = len(np.unique(np.concatenate([*wrong.values()])))
    at = f" (t = {clock[row]:.9g} s)" if np.isfinite(clock[row]) else ""
    rest = f", and {count - 1} more line{'s' * (count > 2)} so" if count > 1 else ""
    remedy = "take the line out, or put numbers there"
    if row == 0:
        remedy = "take the line out, such as one of units, or put numbers there"
    elif at:
        remedy = f"put numbers there, or use a part without, such as {part.file}@:{clock[row]:.9g}"
    what = f"'{_shown(cell)}'" if cell else "nothing"
    kind = "no finite number" if math.isinf(_number(cell, table)) else "not a number"
    raise RecordError(f"{part.name}: line {number} holds {what} in column '{name}'{at}, {kind}{rest}; {remedy}")


def _text(file: Path) -> str:
    """Text of a file with a line feed at the end of each line."""
    try:
        if file.stat().st_size > LARGEST:
            raise RecordError(f"{file}: the table has more than {LARGEST} bytes; cut it, or give a .parquet file")
        data = file.read_bytes()
        if data[:2] in {b"\xff\xfe", b"\xfe\xff"}:
            raise RecordError(f"{file}: the table is in UTF-16; save it as UTF-8")
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line, column = _position(data[: error.start].decode())
        raise RecordError(
            f"{file}: the table cannot be read: line {line}, character {column} is not UTF-8; save it as UTF-8"
        ) from None
    except OSError as error:
        raise RecordError(f"{file}: the table cannot be read ({error.strerror})") from error
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if wrong := _FORBIDDEN.search(text):
        line, column = _position(text[: wrong.start()])
        raise RecordError(
            f"{file}: the table cannot be read: line {line}, character {column} is U+{ord(wrong[0]):04X}, which no "
            "text holds; is it damaged, or in UTF-16?"
        )
    return text


def _position(before: str) -> tuple[int, int]:
    return before.count("\n") + 1, len(before) - before.rfind("\n")


def _table(file: Path, heading: Sequence[str]) -> _Table:
    """Find the names of columns and what is between them."""
    text = _text(file)
    start, end, number = 0, 0, 0
    while start < len(text):
        end = text.find("\n", start) % (len(text) + 1)
        number += 1
        if (line := text[start:end].strip()) and not line.startswith(_REMARKS):
            break
        start = end + 1
    else:
        raise RecordError(f"{file}: the table is empty")
    head = text[start:end].lstrip("# ")
    separator = next((s for s in ("\t", ";", ",") if s in head), None)
    try:
        names = [name.strip() for name in _cells(head, separator)]
    except csv.Error:
        raise RecordError(f"{file}: line {number}: a quote is not closed") from None
    is_bare = all(is_number(name.replace(",", ".")) for name in names if name)
    if is_bare and not heading:
        remedy = f"name its {len(names)} columns, such as --columns t,u1,y1"
        raise RecordError(f"{file}: the first line holds numbers; {remedy}")
    if heading and not is_bare:
        raise RecordError(
            f"{file}: the first line names its columns, such as {_shown(names[0])}; rename them, such as "
            f"--map t={_shown(names[0])}, in place of --columns"
        )
    if heading and len(heading) != len(names):
        raise RecordError(f"{file}: {len(names)} columns have {len(heading)} names, {', '.join(heading)}; name each")
    if heading:
        return _Table(list(heading), separator, number, text[start:])
    return _Table(names, separator, number + 1, text[end + 1 :])


def _of_decimals(table: _Table) -> NDArray[np.float64] | None:
    """Read a body that holds nothing but decimal numbers, fast; None if it may hold something else."""
    body = table.body
    if _NEITHER.search(body) or not all(table.names) or not body.strip():
        return None
    if table.separator == ";" and "," in body:
        if "." in body:
            return None
        body = body.replace(",", ".")
    try:
        found = np.loadtxt(io.StringIO(body), delimiter=table.separator, ndmin=2, comments=None)
    except ValueError:
        return None
    return found if found.shape[1] == len(table.names) and np.isfinite(found).all() else None


def _rows(file: Path, table: _Table) -> list[tuple[int, list[str]]]:
    """Cells of each line of the body without blanks around them, with its number.

    A RecordError where a line has more or fewer cells than there are names, a quote is not closed, or numbers have
    decimal points as well as decimal commas.
    """
    made = []
    marks: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(table.body.split("\n"), table.start):
        if not line.strip() or line.lstrip().startswith(_REMARKS):
            continue
        try:
            cells = _row(line, table)
        except csv.Error:
            raise RecordError(f"{file}: line {number}: a quote is not closed in it; a cell is on one line") from None
        if cells is None:
            continue
        _check_count(file, number, cells, table)
        if table.separator == ";":
            for cell in cells[: len(table.names)]:
                for mark in ".,":
                    if mark in cell and is_decimal(cell.replace(",", ".")):
                        marks.setdefault(mark, (number, cell))
        if len(marks) > 1:
            (first, point), (second, comma) = marks["."], marks[","]
            raise RecordError(
                f"{file}: line {first} holds '{_shown(point)}' and line {second} holds '{_shown(comma)}'; write all "
                "numbers with a decimal point, or all with a decimal comma"
            )
        made.append((number, cells[: len(table.names)]))
    return made


def _check_count(file: Path, number: int, cells: list[str], table: _Table) -> None:
    """Refuse a line with more or fewer cells than names; empty ones at its end do not count."""
    wanted = len(table.names)
    while len(cells) > wanted and not cells[-1]:
        cells.pop()
    if len(cells) > wanted:
        raise RecordError(
            f"{file}: line {number} has {len(cells)} cells, but {wanted} columns have a name: "
            f"'{_shown(cells[wanted])}' is in none; are there decimal commas, or names missing?"
        )
    if len(cells) < wanted:
        raise RecordError(
            f"{file}: line {number} has {len(cells)} cell{'s' * (len(cells) != 1)}, but {wanted} columns have a name: "
            f"'{_shown(table.names[len(cells)])}' has none; is it cut off, or is another separator used there?"
        )


def _row(line: str, table: _Table) -> list[str] | None:
    """Cells of a line, without a remark behind `#`; None if it is all remark.

    Other programs write `#N/A` or `#NUM!` into a cell, which is no remark.
    """
    remark = line.find("#")
    whole = [cell.strip() for cell in _cells(line, table.separator)]
    if remark < 0:
        return whole
    if not line[:remark].strip():
        has_numbers = len(whole) == len(table.names) > 1 and any(is_number(cell) for cell in whole[1:])
        is_cell = has_numbers and not is_number(whole[0].lstrip("# ")) and line[remark + 1 : remark + 2].strip()
        return whole if is_cell else None
    before = [cell.strip() for cell in _cells(line[:remark], table.separator)]
    return before if len(before) == len(table.names) and before[-1] else whole


def _cells(line: str, separator: str | None) -> list[str]:
    if '"' not in line:
        return line.split(separator)
    blank = separator is None
    return next(csv.reader([" ".join(line.split()) if blank else line], delimiter=separator or " ", strict=True))


def _number(cell: str, table: _Table) -> float:
    """Number in a cell; NaN if there is none."""
    text = cell.replace(",", ".") if table.separator == ";" else cell
    return float(text) if is_decimal(text) else math.nan


def _shown(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:40]}..."
