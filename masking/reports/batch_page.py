"""Page of a table: a row for each run of a batch, made or not, or for each step of another work."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from masking.display.printed_result import aligned
from masking.reports import html

BATCH: Final = "batch"


def text(sentence: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Runs as a table of text, with a sentence before it."""
    return "\n".join([sentence, *aligned([[*rows[0]], *_shown(rows)])])


def _shown(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    return [[_cell(value) for value in row.values()] for row in rows]


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def save(
    name: str,
    sentence: str,
    rows: Sequence[Mapping[str, Any]],
    numbers: Mapping[str, Any],
    folder: Path,
    *,
    stem: str = BATCH,
    what: str = "Runs",
) -> Path:
    """Write a page, its table and its numbers into a folder, as `batch.html`, `.csv` and `.json`; return the page.

    There is one row at least, all with the same columns; `what` they are is the heading. Raises a `RecordError` where a
    file cannot be written.
    """
    page, written = folder / f"{stem}.html", io.StringIO()
    table = csv.DictWriter(written, [*rows[0]])
    table.writeheader()
    table.writerows(rows)
    html.write({page.with_suffix(".csv"): written.getvalue()})
    html.save(page, "batch", [], numbers, title=name, lead=sentence, head=[*rows[0]], rows=_shown(rows), what=what)
    return page
