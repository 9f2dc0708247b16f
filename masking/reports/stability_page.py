"""Page of a study of stability: HTML that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

from pathlib import Path

from masking.analysis.stability.modes import phase
from masking.analysis.stability.study import Stability
from masking.reports import html, stability_figures


def save(found: Stability, folder: str | Path) -> None:
    """Write page, numbers and PNG files into a folder, made if need be; a `RecordError` where it cannot be."""
    html.save(
        Path(folder, "stability.html"),
        "stability",
        stability_figures.figures(found),
        found.as_dict(),
        names=found.coordinates,
        title=f"stability of {found.name}",
        result=found,
        certificate=found.certificate,
        phase=phase,
    )
