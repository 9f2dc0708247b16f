"""The verb compare: two runs on one page."""

from __future__ import annotations

from pathlib import Path

from masking.app.workflows.output_folders import beside, own_folder
from masking.lab.records.recording import Recording
from masking.reports import comparison_page
from masking.reports.comparison_page import Comparison


def compare(
    first: str | Path | Recording,
    second: str | Path | Recording,
    *,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Comparison:
    """Compare two runs: the motion of both over one another, what was declared otherwise, and what came out of it.

    Args:
        first: the folder of a recording, or its parquet file; in Python, a `Recording`, too.
        second: another one.
        out: folder to save `comparison.html`, its picture and `comparison.json` in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.

    Raises:
        RecordError: there is no such recording, or the page cannot be written.
    """
    with own_folder(out, comparison_page.PAGE, overwrite=overwrite):
        made = Comparison(_loaded(first), _loaded(second), names(first, second))
        if out is not None:
            comparison_page.save(made, Path(out))
        return made


def names(first: str | Path | Recording, second: str | Path | Recording) -> tuple[str, str]:
    """Names of two recordings: those of their folders, or their paths where these are equal."""
    if isinstance(first, Recording) or isinstance(second, Recording):
        a, b = (one.name if isinstance(one, Recording) else str(one) for one in (first, second))
        return (a, b) if a and b and a != b else ("first", "second")
    a, b = (beside(path).resolve().name for path in (first, second))
    return (a, b) if a != b else (str(first), str(second))


def _loaded(one: str | Path | Recording) -> Recording:
    return one if isinstance(one, Recording) else Recording.load(one)
