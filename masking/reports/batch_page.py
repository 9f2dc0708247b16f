"""Page of a batch: a row for each run, made or not."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from masking.reports import html
from masking.reports.text import aligned
from masking.runs.batch import Progress

PAGE: Final = "batch.html"
TABLE: Final = "batch.csv"


def rows(runs: Sequence[Progress]) -> list[dict[str, Any]]:
    """Return for each run its settings, how it ended, after how many tries, and what it took."""
    found = []
    for one in runs:
        last = one.ends[-1] if one.ends else {}
        trips = [end["cause"] for end in one.ends if "cause" in end]
        chi = max(last.get("chi", {}).values(), default=None)
        row: dict[str, Any] = {"run": one.run.number, **one.run.settings}
        row |= {"end": (one.left_out and "not made") or last.get("end", "not made"), "tries": one.tries}
        row |= {"trips": " ".join(trips), "chi": chi}
        row |= {"seconds": sum(end.get("seconds", 0.0) for end in one.ends)}
        row |= {"energy": sum(end.get("energy", 0.0) for end in one.ends)}
        found.append(row | {"why": one.left_out or ("" if one.is_done else last.get("why", ""))})
    return found


def text(name: str, runs: Sequence[Progress], why: str) -> str:
    """Return the runs as a table of text, with a sentence before it."""
    head, table = _shown(runs)
    return "\n".join([sentence(name, runs, why), *aligned([head, *table])])


def sentence(name: str, runs: Sequence[Progress], why: str) -> str:
    """Return how many runs ended as planned, and why others did not."""
    done, more = sum(one.is_done for one in runs), sum(one.tries > 1 for one in runs)
    said = f"{name}: {done} of {len(runs)} runs ended as planned, {more} after more than one try"
    failed = len(runs) - done - sum(bool(one.left_out) for one in runs)
    said += f"; {failed} failed" if failed else ""
    return f"{said}; the others were not made: {why}." if why else f"{said}."


def _shown(runs: Sequence[Progress]) -> tuple[list[str], list[list[str]]]:
    """Return the head of the table, and its rows, with numbers as people read them."""
    found = rows(runs)
    head = [*found[0]] if found else []
    return head, [[_cell(value) for value in row.values()] for row in found]


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def save(name: str, runs: Sequence[Progress], why: str, numbers: Mapping[str, Any], folder: Path) -> Path:
    """Write `batch.html`, `batch.csv` and `batch.json` into a folder; return the page.

    Raises:
        RecordError: a file cannot be written.
    """
    found, page, written = rows(runs), folder / PAGE, io.StringIO()
    table = csv.DictWriter(written, [*found[0]] if found else [])
    table.writeheader()
    table.writerows(found)
    html.write({folder / TABLE: written.getvalue()})
    head, shown = _shown(runs)
    html.save(
        page,
        "batch",
        [],
        numbers,
        title=name,
        tiles=(),
        names={},
        lead=sentence(name, runs, why),
        head=head,
        rows=shown,
    )
    return page
