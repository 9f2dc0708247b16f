"""Header of a text: where its numbers begin, what stands between them, and the names and units above them.

The last lines of a text say what a row of numbers looks like: its separator, how many cells it has, and which of these
are numbers or instants. The first line like that begins the body. Above it, the nearest line with as many cells and
without numbers names the columns, or that above a row of units. What stands between the names and the body is a row
that is broken, and is refused with its line. All else above is a preamble, which is passed over.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from masking.errors import RecordError
from masking.lab.records import column_units, wall_clock
from masking.lab.records.decimals import is_number

SEPARATORS = ("\t", ";", ",", None)  # None for blanks
REMARKS = ("%", "//", "#")
_MARKS = "#%/ "
_SAMPLE = 64  # of the last lines, which say what a row looks like
_SAMPLE_SIZE = 2**16  # characters
_HEADER = 2000  # lines at most
_GAP = re.compile(r"\s{2,}|\t")
_WITH_UNIT = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")  # a name among blanks, with the unit behind it
_FIRST, _STEP = ("start", "increment")  # columns of a waveform whose clock is given by these two numbers


@dataclass(frozen=True)
class Header:
    """Names and units of the columns of a text, and its body."""

    names: Sequence[str]  # an empty one is left out
    separator: str | None
    start: int  # number of the first line of the body, from 1
    body: str
    units: Sequence[str] = ()  # as many as names, "" where none is known; none where there is no row of units
    stamps: frozenset[int] = frozenset()  # columns of instants on a wall clock
    clock: tuple[float, float] | None = None  # start in s and increment of the first column, which counts samples


@dataclass(frozen=True)
class _Shape:
    """What a row of the body looks like."""

    separator: str | None
    counts: tuple[int, int]  # least and largest number of cells: with and without empty ones at the end
    kinds: Sequence[str]  # of the cells: 'number', 'stamp', 'text', or '' where they are empty

    def fits(self, line: str) -> bool:
        """Whether a line is a row of the body."""
        row = cells(line, self.separator)
        if row is None or not self.counts[0] <= len(row) <= self.counts[1]:
            return False
        pairs = zip((_kind(cell, self.separator) for cell in row), self.kinds, strict=False)
        known = [(kind, wanted) for kind, wanted in pairs if kind]
        return any(kind != "text" for kind, _ in known) and all(wanted in {kind, "text", ""} for kind, wanted in known)

    def cells(self, line: str) -> list[str] | None:
        """Cells of a line of the header, if it has one for each column."""
        line = line.lstrip(_MARKS) if line.startswith(REMARKS) else line
        if self.counts[1] == 1 and any(s in line for s in SEPARATORS if s):
            return None
        order = sorted(SEPARATORS, key=lambda s: s is None or s != self.separator)  # blanks last, for `t, u, y`
        rows = [cells(line, s) for s in order]
        rows += [_GAP.split(line.strip()), _WITH_UNIT.findall(line)]
        return next(
            (row for row in map(_trimmed, filter(None, rows)) if self.counts[0] <= len(row) <= self.counts[1]), None
        )


@dataclass(frozen=True)
class _Line:
    """A line of a header that has a cell for each column."""

    index: int
    cells: list[str]
    is_remark: bool


def cells(line: str, separator: str | None) -> list[str] | None:
    """Cells of a line without blanks around them; None where a quote is not closed."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    plain = line.strip() if separator else " ".join(line.split())
    try:
        row = next(csv.reader([plain], delimiter=separator or " ", strict=True, skipinitialspace=True))
    except csv.Error:
        return None
    return [cell.strip() for cell in row]


def header(file: Path, text: str, heading: Sequence[str], rows: int | None) -> Header:
    """Find the header of a text.

    `heading` are the names of its columns, if they are given, and `rows` the number of lines above its numbers.
    A RecordError where there are no names, or too few or too many of them.
    """
    lines = text.split("\n", _HEADER)[:_HEADER]
    lines = lines if lines[-1] else lines[:-1]
    if not any(line.strip() and not line.strip().startswith(REMARKS[:2]) for line in lines):
        raise RecordError(f"{file}: the table is empty")
    if rows is not None and not 0 <= rows < len(lines):
        raise RecordError(f"{file}: --header-rows is {rows}; give the number of lines above the numbers, 0 or more")
    shape = _shape(text, lines)
    first = (
        rows if rows is not None else next((i for i, line in enumerate(lines) if shape and _is_row(shape, line)), None)
    )
    if shape is None or first is None:
        return _unknown(file, text, lines, heading)
    above = [i for i in range(first - 1, -1, -1) if lines[i].strip()]
    named, units, broken = _names(shape, lines, above, is_known=rows is not None)
    clock = _waveform(named.cells, lines[broken[-1]], shape) if named and broken else None
    if clock is not None:
        units = ["s", *map(column_units.bare, (shape.cells(lines[broken[-1]]) or [])[1:])]
        broken = []
    if broken and named is not None:
        first = min(broken)
    stamps = frozenset(i for i, kind in enumerate(shape.kinds) if kind == "stamp")
    names = list(heading)
    if not names and named is None:
        first, names = _other(file, shape, lines, above)
    names = names or list(named.cells if named else [])
    if heading and named is not None and rows is None and not named.is_remark:
        raise RecordError(
            f"{file}: line {named.index + 1} names its columns, such as {shown(named.cells[0])}; rename them, such as "
            f"--map t={shown(named.cells[0])}, in place of --columns, or say with --header-rows {first} that they are "
            "no names"
        )
    if heading and not shape.counts[0] <= len(heading) <= shape.counts[1]:
        many = shape.counts[0]
        raise RecordError(f"{file}: {many} columns have {len(heading)} names, {', '.join(heading)}; name each")
    body = text[sum(map(len, lines[:first])) + first :]
    return Header(names, shape.separator, first + 1, body, [] if heading else units, stamps, clock)


def shown(text: str) -> str:
    """Text in a message, cut off where it is long."""
    return text if len(text) <= 40 else f"{text[:40]}..."


def _trimmed(row: list[str]) -> list[str]:
    """Cells without empty ones at the end."""
    return row[: max((i for i, cell in enumerate(row, 1) if cell), default=0)]


def _kind(cell: str, separator: str | None) -> str:
    """What a cell of a body holds; '' for nothing."""
    if is_number(cell if separator == "," else cell.replace(",", ".")):
        return "number"
    return "" if not cell else "stamp" if wall_clock.is_stamp(cell) else "text"


def _is_row(shape: _Shape, line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(REMARKS) and shape.fits(line)


def _shape(text: str, lines: Sequence[str]) -> _Shape | None:
    """Shape of the rows of a body, by the last lines; None where no line has more numbers than texts."""
    last = text[-_SAMPLE_SIZE:].split("\n")
    last = last[1:] if len(text) > _SAMPLE_SIZE and len(last) > 1 else [*lines]
    sample = [line for line in last if line.strip() and not line.lstrip().startswith(REMARKS)][-_SAMPLE:]
    best, most = None, 0.0
    for separator in SEPARATORS:
        rows = [row for line in sample if separator is None or separator in line if (row := cells(line, separator))]
        table = [(row, [_kind(cell, separator) for cell in row]) for row in rows]
        score = sum(1.0 - kinds.count("text") / max(1, len(row) - kinds.count("")) for row, kinds in table)
        like = [pair for pair in table if sum(k in {"number", "stamp"} for k in pair[1]) > pair[1].count("text")]
        if like and score > most:
            best, most = _of_rows(separator, like), score
    return best


def _of_rows(separator: str | None, rows: Sequence[tuple[list[str], list[str]]]) -> _Shape:
    count = Counter(len(row) for row, _ in rows).most_common(1)[0][0]
    alike = [(row, kinds) for row, kinds in rows if len(row) == count]
    least = max(len(_trimmed(row)) for row, _ in alike)
    kinds = [
        Counter(k for k in column if k).most_common() for column in zip(*(kinds for _, kinds in alike), strict=True)
    ]
    return _Shape(separator, (least, count), [_usual(dict(column)) for column in kinds])


def _usual(counts: dict[str, int]) -> str:
    """Kind of most cells of a column; a text only where it is that of more than all others."""
    return max(counts, key=lambda kind: (counts[kind], kind != "text"), default="")


def _names(
    shape: _Shape, lines: Sequence[str], above: Sequence[int], *, is_known: bool
) -> tuple[_Line | None, list[str], list[int]]:
    """Line of names, the units below it, and lines between it and the body, nearest first.

    Plain lines are tried before remarks. `is_known` says that all lines above the body are header.
    """
    found = [_line(shape, lines, i) for i in above]
    for of_remarks in (False, True):
        rows = [one for one in found if one.is_remark == of_remarks]
        broken = list[int]()
        for at, one in enumerate(rows):
            texts = [cell for cell in one.cells if cell]
            kinds = {_kind(cell, shape.separator) for cell in texts}
            if "text" not in kinds or (kinds & {"number", "stamp"} and not is_known):
                broken += [] if of_remarks else [one.index]
                continue
            over = rows[at + 1] if at + 1 < len(rows) else None
            if over is not None and _has_text(over, shape) and all(map(column_units.is_unit, texts)):
                units = [column_units.bare(cell) for cell in one.cells]
                return over, units, broken
            return one, [], broken
        if not of_remarks and broken:
            nearest = rows[0]
            if _has_text(nearest, shape):  # names such as t, 1, 2
                return nearest, [], []
    return None, [], []


def _line(shape: _Shape, lines: Sequence[str], index: int) -> _Line:
    line = lines[index].strip()
    return _Line(index, shape.cells(line) or [], line.startswith(REMARKS))


def _has_text(line: _Line, shape: _Shape) -> bool:
    return any(_kind(cell, shape.separator) == "text" for cell in line.cells)


def _waveform(names: Sequence[str], line: str, shape: _Shape) -> tuple[float, float] | None:
    """Start and increment of a waveform that stand in a row below their names; None where there are none."""
    places = {name.lower(): i for i, name in enumerate(names)}
    row = shape.cells(line) or []
    if not {_FIRST, _STEP} <= places.keys() or max(places[_FIRST], places[_STEP]) >= len(row):
        return None
    given = [row[places[name]] for name in (_FIRST, _STEP)]
    return (float(given[0]), float(given[1])) if all(map(is_number, given)) else None


def _other(file: Path, shape: _Shape, lines: Sequence[str], above: Sequence[int]) -> tuple[int, list[str]]:
    """First line of a body below names that are too few or too many, and these; a RecordError where there are none."""
    for index in above:
        own = next((s for s in SEPARATORS if s and s in lines[index]), None)
        row = cells(lines[index], own if shape.counts[1] == 1 else shape.separator)
        if row is None:
            raise RecordError(f"{file}: line {index + 1}: a quote is not closed")
        if not lines[index].lstrip().startswith(REMARKS) and any(_kind(c, shape.separator) == "text" for c in row):
            return index + 1, _trimmed(row)
    many = shape.counts[0]
    example = ",".join(["t", "u1", *(f"y{i}" for i in range(1, many - 1))][:many])
    raise RecordError(f"{file}: the first line holds numbers; name its {many} columns, such as --columns {example}")


def _unknown(file: Path, text: str, lines: Sequence[str], heading: Sequence[str]) -> Header:
    """Header of a text without a row of numbers: its first line."""
    index = next(i for i, line in enumerate(lines) if line.strip() and not line.strip().startswith(REMARKS[:2]))
    line = lines[index].lstrip("# ")
    separator = next((s for s in SEPARATORS[:-1] if s and s in line), None)
    names = cells(line, separator)
    if names is None:
        raise RecordError(f"{file}: line {index + 1}: a quote is not closed")
    first = index if heading else index + 1
    return Header(list(heading) or names, separator, first + 1, text[sum(map(len, lines[:first])) + first :])
