"""The verb compare: two runs on one page."""

from __future__ import annotations

from pathlib import Path

from masking.app.workflows.output_folders import beside, own_folder
from masking.lab.records.recording import Recording
from masking.reports import comparison_page
from masking.reports.run_comparison import Comparison


def compare(
    first: str | Path, second: str | Path, *, out: str | Path | None = None, overwrite: bool = False
) -> Comparison:
    """Compare two runs: the motion of both over one another, what was declared otherwise, and what came out of it.

    Args:
        first: the folder of a recording, or its parquet file.
        second: another one.
        out: folder to save `comparison.html`, its picture and `comparison.json` in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.

    Raises:
        RecordError: there is no such recording, or the page cannot be written.
    """
    with own_folder(out, comparison_page.PAGE, overwrite=overwrite):
        made = Comparison(Recording.load(first), Recording.load(second), names(first, second))
        if out is not None:
            comparison_page.save(made, Path(out))
        return made


def names(first: str | Path, second: str | Path) -> tuple[str, str]:
    """Names of two recordings: those of their folders, or their paths where these are equal."""
    a, b = (beside(path).resolve().name for path in (first, second))
    return (a, b) if a != b else (str(first), str(second))
