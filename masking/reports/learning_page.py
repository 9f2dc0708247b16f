"""Page of a rig that has learned what it is: a row for each step, and one page of the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from masking.display.json_text import plain
from masking.inference.discovery.discovery_result import Discovery
from masking.model.declaration.quantities import number, percent
from masking.reports import batch_page, discovery_files, discovery_text, one_page
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.text import capital, listed

STEM: Final = "learning"
PAGE: Final = f"{STEM}.html"
MOST: Final = 1e9  # times the noise that an error is said to be
_COLUMNS: Final = {
    "step": "step",
    "assumed": "assumed",
    "measured": "measured",
    "before": "error/noise",
    "after": "after",
    "cause": "cause",
    "odds": "probabilities",
    "seconds": "s",
}
Row = Mapping[str, Any]


def facts(found: Discovery) -> dict[str, Any]:
    """What a discovery says in a row: errors over the noise before and after, the causes, and their odds."""
    error, floor = found.simulation_error, found.simulation_error.validation_noise_floor
    left = error.validation.after if found.law is None else found.law.error[1]
    before, after = (
        min(MOST, max(part[n] / max(floor[n], 1e-300) for n in floor)) for part in (error.validation.before, left)
    )
    causes = [text for _, text in discovery_files.written(found)]
    if found.verdict == "ambiguous":
        causes = [" or ".join(discovery_text.possible_causes(found))]
    adjusted, nothing = discovery_text.adjustments(found), "no cause of it is found"
    measured = "leaves no more than noise, which is not white" if found.is_at_noise_floor else "leaves more than noise"
    if found.closed:
        measured, nothing = "explains all", "nothing is missing"
    sure = {name: part for one in found.effects for name, part in discovery_text.probabilities(found, one).items()}
    sure = sure or {"no cause": found.weights[0]}
    return {
        "assumed": found.twin.declaration.name,
        "measured": measured,
        "before": float(before),
        "after": float(after),
        "cause": "; ".join(filter(None, (listed(causes) if causes else nothing, adjusted))),
        "odds": ", ".join(f"{name} {percent(part)}" for name, part in sure.items()),
        "verdict": found.verdict,
        "closed": found.closed,
    }


def said(row: Row) -> str:
    """A step in a sentence."""
    parts = [str(row.get(name, "")) for name in ("measured", "cause", "odds", "why", "carried")]
    if row.get("chi") is not None:
        parts.insert(1, f"masking error {number(row['chi'], 2)}")
    if "before" in row:
        parts.append(f"error over noise {number(row['before'], 3)} before, {number(row['after'], 3)} after")
    return "; ".join(filter(None, parts))


def masked(rows: Sequence[Row]) -> list[Row]:
    """Steps that ran the experiment: before and after."""
    return [row for row in rows if row["step"] in {"before", "after"}]


def sentence(name: str, rows: Sequence[Row]) -> str:
    """What was found, what it changed, and what it took."""
    found = [row for row in rows if row["step"] == "discovery"]
    causes = [row["cause"] for row in found if "plant" in row or row is found[-1]]
    parts = [f"{name}: {'; then '.join(dict.fromkeys(causes))}"]
    parts.append(f"error over noise {number(found[0]['before'], 3)} before, {number(found[-1]['after'], 3)} after")
    chi = ["none" if row.get("chi") is None else number(row["chi"], 2) for row in masked(rows)]
    if len(chi) > 1:
        parts.append(f"masking error {chi[0]} before, {chi[1]} after")
    runs = sum(row["step"] not in {"discovery"} for row in rows)
    spent = sum(row["seconds"] for row in rows)
    ends = [row["why"] for row in rows if row["step"] == "discovery" and "why" in row]
    ends += [row["carried"] for row in rows if row.get("carried")]
    return "; ".join([*parts, *ends, f"{number(spent / 3600.0, 2)} h of the rig in {runs} steps"]) + "."


def _cells(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows of the table; the masking error stands where a gap does."""
    made = []
    for row in rows:
        error = f"masking error {number(row['chi'], 3)}" if row.get("chi") is not None else ""
        measured = "; ".join(filter(None, (row.get("measured"), error, row.get("why"))))
        made.append({shown: row.get(name) for name, shown in _COLUMNS.items()} | {_COLUMNS["measured"]: measured})
    return made


def text(sentence_of: str, rows: Sequence[Row], files: Mapping[str, Any]) -> str:
    """What was found as text, a line for each step, and where the files lie."""
    lines = [capital(sentence_of), *(f"  {row['step']}: {said(row)}" for row in rows)]
    written = [f"{name}: {files[name]}" for name in ("plant", "experiment", "page") if name in files]
    return "\n".join([*lines, *written])


def save(sentence_of: str, rows: Sequence[Row], numbers: Mapping[str, Any], folder: Path) -> Path:
    """Write `learning.html`, `learning.csv` and `learning.json` into a folder; return the page.

    Raises a `RecordError` where a file cannot be written.
    """
    found = [row for row in rows if row["step"] == "discovery"]
    tiles = [
        Tile("error over noise before", number(found[0]["before"], 3)),
        Tile("after", number(found[-1]["after"], 3)),
    ]
    tiles += [Tile(f"masking error {row['step']}", number(row["chi"], 3)) for row in masked(rows) if row.get("chi")]
    sections = {
        one_page.FOUND: [capital(sentence_of)],
        one_page.SURE: [f"{capital(row['odds'])}." for row in found],
        "Steps": [f"{capital(row['step'])}: {said(row)}." for row in rows],
        one_page.NEXT: [f"{capital(row[name])}." for row in rows for name in ("why", "carried") if row.get(name)],
    }
    sheet = Sheet(
        title=f"What {numbers['name']} has learned",
        subject=[str(folder)],
        tiles=tiles,
        sections={heading: lines for heading, lines in sections.items() if lines},
        page=PAGE,
    )
    content = {**numbers, "sheet": plain(sheet)}
    return batch_page.save(
        str(numbers["name"]), capital(sentence_of), _cells(rows), content, folder, stem=STEM, what="Steps"
    )
