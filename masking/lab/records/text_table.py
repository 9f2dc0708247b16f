"""Tables of numbers as text: between commas, semicolons, tabs or blanks, with a name for each column.

A cell is a decimal number, an instant on a wall clock in a column of these, or it is missing, whatever else Python or
another program takes for a number, such as `1_000`, `0x10` or `1 000`. A line has as many cells as there are names, or
the file is refused with its line. A comma in a number is a decimal one where it cannot stand for thousands.
"""

from __future__ import annotations

import io
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.lab.records import labview_text, text_encoding, text_header, wall_clock
from masking.lab.records.decimals import decimal_commas, is_decimal, is_number
from masking.lab.records.record_form import TextForm
from masking.lab.records.text_header import REMARKS, Header, shown
from masking.lab.records.time_slice import Part

Column = NDArray[np.float64]
_NEITHER = re.compile(r"[^-+0-9eE.,;\t\n ]")  # in a table of decimal numbers
_REMARKS = REMARKS[:2]


@dataclass(frozen=True)
class TextTable:
    """A text whose header is found."""

    file: Path
    header: Header

    @classmethod
    def opened(cls, file: Path, heading: Sequence[str], form: TextForm) -> TextTable:
        """Read a text and its header: the names of its columns, or those that are given.

        A RecordError where it is no table, or a name stands twice.
        """
        text = text_encoding.text(file, form.encoding)
        if text.startswith(labview_text.MARK):
            return cls(file, labview_text.header(file, text))
        made = cls(file, text_header.header(file, text, heading, form.header_rows))
        repeated = sorted(name for name, count in Counter(made.header.names).items() if name and count > 1)
        if repeated:
            raise RecordError(
                f"{file}: column '{repeated[0]}' appears more than once; rename one there, or name all columns with "
                f"--header-rows {made.header.start - 1} and --columns"
            )
        return made

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column that has one beside its name."""
        return {name: unit for name, unit in zip(self.header.names, self.header.units, strict=False) if name and unit}

    def columns(self) -> dict[str, Column]:
        """Columns of numbers (samples,) by their names; missing numbers are NaN.

        A RecordError where a line has more or fewer cells than there are names.
        """
        header, found = self.header, self._decimals()
        if found is None:
            found = self._cells()
        if header.clock is not None:
            start, step = header.clock
            found[:, 0] = start + step * found[:, 0]
        return {name: np.ascontiguousarray(found[:, i]) for i, name in enumerate(header.names) if name}

    def check(self, part: Part, columns: Mapping[str, Column], chosen: NDArray[np.bool_], clock: Column) -> None:
        """Refuse what is no number where one must be, with its line in the file, such as a sample of a part.

        `columns` must be finite there, and have their names in the file; `chosen` says of each sample whether it is in
        the part, and `clock` has its time in s (samples,).
        """
        wrong = {name: np.flatnonzero(chosen & ~np.isfinite(values)) for name, values in columns.items()}
        first = min(((int(rows[0]), name) for name, rows in wrong.items() if len(rows)), default=None)
        if first is None:
            return
        row, name = first[0], next(n for n, rows in wrong.items() if len(rows) and rows[0] == first[0])
        number, cells = self._rows[row]
        column = self.header.names.index(name)
        count = len(np.unique(np.concatenate([*wrong.values()])))
        at = f" (t = {clock[row]:.9g} s)" if np.isfinite(clock[row]) else ""
        rest = f", and {count - 1} more line{'s' * (count > 2)} so" if count > 1 else ""
        remedy = "take the line out, or put numbers there"
        if column in self.header.stamps:
            remedy = f"write instants as {wall_clock.EXAMPLE}, or leave them out and give --dt"
        elif row == 0:
            remedy = (
                f"take the line out, put numbers there, or say with --header-rows {number} that it is no row of numbers"
            )
        elif at:
            remedy = f"put numbers there, or use a part without, such as {part.file}@:{clock[row]:.9g}"
        what = f"'{shown(cells[column])}'" if cells[column] else "nothing"
        kind = "no finite number" if math.isinf(self._number(cells[column])) else "not a number"
        raise RecordError(f"{part.name}: line {number} holds {what} in column '{name}'{at}, {kind}{rest}; {remedy}")

    @cached_property
    def _is_comma(self) -> bool:
        """Whether commas in numbers are decimal commas; a RecordError where they may stand for thousands."""
        header = self.header
        found, grouped = decimal_commas(header.body, header.separator)
        if grouped is not None:
            line = header.start + header.body[: grouped.start()].count("\n")
            raise RecordError(
                f"{self.file}: line {line} holds '{grouped[0]}': its comma may be a decimal one or stand for "
                "thousands; put semicolons between the cells if it is a decimal one, or take the commas out"
            )
        return found

    def _decimals(self) -> Column | None:
        """Read a body that holds nothing but decimal numbers, fast; None if it may hold something else."""
        header, body = self.header, self.header.body
        if _NEITHER.search(body) or header.stamps:
            return None
        if not all(header.names):
            return None
        if header.separator:
            body = re.sub(rf"{header.separator}+[ ]*$", "", body, flags=re.MULTILINE)
        if self._is_comma:
            if "." in body:
                return None
            body = body.replace(",", ".")
        if not body.strip():
            return None
        try:
            found = np.loadtxt(io.StringIO(body), delimiter=header.separator, ndmin=2, comments=None)
        except ValueError:
            return None
        return found if found.shape[1] == len(header.names) and np.isfinite(found).all() else None

    def _cells(self) -> Column:
        """Numbers and instants of a body, cell by cell (samples, columns)."""
        rows, header = [cells for _, cells in self._rows], self.header
        found = np.empty((len(rows), len(header.names)))
        for i in range(len(header.names)):
            column = [cells[i] for cells in rows]
            found[:, i] = wall_clock.seconds(column) if i in header.stamps else [*map(self._number, column)]
        return found

    @cached_property
    def _rows(self) -> list[tuple[int, list[str]]]:
        """Cells of each line of the body without blanks around them, with its number.

        A RecordError where a line has more or fewer cells than there are names, a quote is not closed, or numbers have
        decimal points as well as decimal commas.
        """
        made = []
        marks: dict[str, tuple[int, str]] = {}
        for number, line in enumerate(self.header.body.split("\n"), self.header.start):
            if not line.strip() or line.lstrip().startswith(_REMARKS):
                continue
            cells = self._row(number, line)
            if cells is None:
                continue
            self._check_count(number, cells)
            for cell in cells[: len(self.header.names)] if self._is_comma else ():
                for mark in ".,":
                    if mark in cell and is_decimal(cell.replace(",", ".")):
                        marks.setdefault(mark, (number, cell))
            if len(marks) > 1:
                (first, point), (second, comma) = marks["."], marks[","]
                raise RecordError(
                    f"{self.file}: line {first} holds '{shown(point)}' and line {second} holds '{shown(comma)}'; write "
                    "all numbers with a decimal point, or all with a decimal comma"
                )
            made.append((number, cells[: len(self.header.names)]))
        return made

    def _check_count(self, number: int, cells: list[str]) -> None:
        """Refuse a line with more or fewer cells than names; empty ones at its end do not count."""
        names = self.header.names
        wanted = len(names)
        while len(cells) > wanted and not cells[-1]:
            cells.pop()
        if len(cells) > wanted:
            raise RecordError(
                f"{self.file}: line {number} has {len(cells)} cells, but {wanted} columns have a name: "
                f"'{shown(cells[wanted])}' is in none; are there decimal commas, or names missing? --header-rows "
                f"{self.header.start - 1} and --columns name all columns"
            )
        if len(cells) < wanted:
            raise RecordError(
                f"{self.file}: line {number} has {len(cells)} cell{'s' * (len(cells) != 1)}, but {wanted} columns have "
                f"a name: '{shown(names[len(cells)])}' has none; is it cut off, or is another separator used there? If "
                f"the names are others, --header-rows {self.header.start - 1} and --columns give them"
            )

    def _row(self, number: int, line: str) -> list[str] | None:
        """Cells of a line, without a remark behind `#`; None if it is all remark.

        Other programs write `#N/A` or `#NUM!` into a cell, which is no remark.
        """
        whole, remark = self._split(number, line), line.find("#")
        if remark < 0:
            return whole
        if not line[:remark].strip():
            has_numbers = len(whole) == len(self.header.names) > 1 and any(is_number(cell) for cell in whole[1:])
            is_cell = has_numbers and not is_number(whole[0].lstrip("# ")) and line[remark + 1 : remark + 2].strip()
            return whole if is_cell else None
        before = self._split(number, line[:remark])
        return before if len(before) == len(self.header.names) and before[-1] else whole

    def _split(self, number: int, line: str) -> list[str]:
        row = text_header.cells(line, self.header.separator)
        if row is None:
            raise RecordError(f"{self.file}: line {number}: a quote is not closed in it; a cell is on one line")
        return row

    def _number(self, cell: str) -> float:
        """Number in a cell; NaN if there is none."""
        text = cell.replace(",", ".") if self._is_comma else cell
        return float(text) if is_decimal(text) else math.nan
