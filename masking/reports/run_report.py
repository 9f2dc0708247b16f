"""Report: a recording told in one self-contained HTML page with its figures, and in a few lines for the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy

from masking.errors import RecordError
from masking.records.recording import Recording
from masking.reports import run_text
from masking.reports.run_facts import input_uses, masking_errors, study
from masking.reports.run_page import PAGE, page

if TYPE_CHECKING:
    from masking.reports import run_figures, style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)
    run_figures = lazy.load("masking.reports.run_figures", suppress_warning=True)


@dataclass(frozen=True, slots=True)
class Report:
    """What was written: the page, its figures as separate PNG files, and the summary for the terminal."""

    path: Path
    figures: tuple[Path, ...]
    summary: str


def report(recording: Recording, folder: str | Path) -> Report:
    """Write `report.html`, which needs no other file, and its figures as PNG files into `folder`, made if need be."""
    folder, facts = Path(folder), study(recording)
    plates = run_figures.plates(facts)
    images = {plate.name: style.png(plate) for plate in plates if plate.figure is not None}
    text = page(facts, plates, images, folder)
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            written.append(folder / f"{name}.png")
            written[-1].write_bytes(image)
        (folder / PAGE).write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{folder}: the report cannot be written: {error.strerror or error}") from error
    return Report(folder / PAGE, tuple(written), run_text.summary(facts))


def summary(recording: Recording) -> str:
    """Tell a recording in at most fourteen lines of plain text."""
    return run_text.summary(study(recording))


def warnings(recording: Recording) -> list[str]:
    """Say in plain sentences what makes the result not hold as it stands; nothing where all is well."""
    return run_text.warnings(recording, input_uses(recording), masking_errors(recording))


def limits_used(recording: Recording) -> dict[str, float]:
    """Give the part of its limit that each input used at its peak; inputs without a limit are left out."""
    return {use.name: use.used for use in input_uses(recording) if use.used is not None}
