"""Report of a recording: one self-contained HTML page with its figures, and a few lines for the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking.records.recording import Recording
from masking.reports import html, run_text
from masking.reports.run_facts import input_uses, masking_errors, study
from masking.reports.run_page import PAGE, page

if TYPE_CHECKING:
    from masking.reports import run_figures
else:
    run_figures = lazy.load("masking.reports.run_figures", suppress_warning=True)


@dataclass(frozen=True, slots=True)
class Report:
    """The files that were written, the page and its figures as PNG files, and the summary for the terminal."""

    path: Path
    figures: tuple[Path, ...]
    summary: str


def report(recording: Recording, folder: str | Path) -> Report:
    """Write `report.html`, which needs no other file, and its figures as PNG files into a folder, made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    folder, facts = Path(folder), study(recording)
    figures = run_figures.figures(facts)
    images = html.images(figures, folder)
    html.write({**images, folder / PAGE: page(facts, figures, folder)})
    return Report(folder / PAGE, tuple(images), run_text.summary(facts))


def summary(recording: Recording) -> str:
    """Return at most fourteen lines of plain text on a recording."""
    return run_text.summary(study(recording))


def warnings(recording: Recording) -> list[str]:
    """Return sentences on what limits the validity of the result; empty if all is well."""
    return run_text.warnings(recording, input_uses(recording), masking_errors(recording))


def limits_used(recording: Recording) -> dict[str, float]:
    """Return the part of its limit that each input used at its peak; inputs without a limit are left out."""
    return {use.name: use.used for use in input_uses(recording) if use.used is not None}
