"""Page of a sweep: its outcome in a sentence, its pictures, and the runs that failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.lab.records.table_chunks import Columns
from masking.reports import html, sweep_figures
from masking.reports.text import listed

PAGE: Final = "sweep.html"
_SHOWN: Final = 20  # failures
_NAMED: Final = 4  # of what varies, that the sentence names


def sentence(facts: Mapping[str, Any], columns: Columns) -> str:
    """Number of runs and their outcome in a sentence."""
    done, failed = len(columns["run"]), sum(bool(text) for text in columns["error"])
    of_all = f" of {facts['rows']}" if done < facts["rows"] else ""
    said = f"{facts['name']}: {done}{of_all} runs"
    over = [one["name"] for one in facts["over"]]
    said += f" over {listed(over) if len(over) <= _NAMED else f'{len(over)} quantities'}" if over else ""
    if failed:  # with the commonest reason, up to the place where it differs
        causes = [str(text).partition(",")[0].partition(" at t =")[0] for text in columns["error"] if text]
        said += f", {failed} failed ({Counter(causes).most_common(1)[0][0]})"
    found = [
        words
        for name in facts["measures"]
        if (words := _words(name, columns[name], facts.get("units", {}).get(name, "")))
    ]
    return f"{said}; {'; '.join(found)}." if found else f"{said}."


def counts(column: Sequence[Any]) -> dict[str, int]:
    """How many runs have each word of a column, the commonest first."""
    return dict(Counter(text for text in column if text).most_common())


def _words(name: str, column: Any, unit: str) -> str:  # noqa: ANN401  # a column of any kind
    if isinstance(column, np.ndarray):
        finite = column[np.isfinite(column)]
        if not len(finite):
            return ""
        low, middle, high = np.quantile(finite, (0.0, 0.5, 1.0))
        if not high > low:
            return f"{name} {low:.4g} {unit}".rstrip()
        return f"{name} {low:.4g} to {high:.4g} {unit}".rstrip() + f", median {middle:.4g}"
    if column and isinstance(column[0], str):
        return f"{name} " + ", ".join(f"{kind} {count}" for kind, count in counts(column).items())
    return ""


def save(facts: Mapping[str, Any], columns: Columns, said: str, folder: Path) -> Path:
    """Write page and pictures, a sentence on top, into a folder; a `RecordError` says that one cannot be written."""
    failures = [(str(run), text) for run, text in zip(columns["run"], columns["error"], strict=True) if text]
    html.save(
        folder / PAGE,
        "sweep",
        sweep_figures.figures(facts, columns),
        title=f"sweep of {facts['name']}",
        names=[*(name for one in facts["over"] for name in one["name"].split(",")), *facts["measures"]],
        lead=said,
        runs=len(columns["run"]),
        failures=failures,
        most=_SHOWN,
    )
    return folder / PAGE
