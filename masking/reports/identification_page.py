"""Pages of a measurement or a fit: one HTML page that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.declaration.quantities import number
from masking.procedures.measurement import Measurement, Row
from masking.reports import html
from masking.reports.html import Tile, Written

if TYPE_CHECKING:
    from masking.estimation.fit import Fit
    from masking.estimation.innovations import KalmanFit
    from masking.reports import procedure_figures, style
else:
    procedure_figures = lazy.load("masking.reports.procedure_figures", suppress_warning=True)

_TILES = 3  # numbers on top of the page of a fit
# Numbers on top of the page of a measurement: those of these names that it has, or begin with them.
_FIRST = {
    "springs": ("stiffness", "half_gap", "width"),
    "actuators": ("ratio", "residual"),
    "friction": ("edge", "step", "largest_shift", "friction"),
    "response": ("peak_", "even_", "odd_"),
}
_TITLES = {
    "springs": "Spring curve",
    "actuators": "Balance of two actuators",
    "friction": "Friction",
    "response": "Frequency response",
}


def save(measured: Measurement[Any], folder: str | Path) -> Written:
    """Write `<procedure>.html`, `<procedure>.json` and PNG files into a folder, made if need be.

    All is drawn before anything is written.

    Raises:
        RecordError: the folder cannot be written.
    """
    out, name = Path(folder), measured.procedure
    figures = procedure_figures.figures(measured)
    images = html.images(figures, out)
    first = [next((row for row in measured.rows if row.key.startswith(key)), None) for key in _FIRST[name]]
    page = html.render(
        "procedure",
        title=_TITLES[name],
        sentence=measured.sentence,
        tiles=[_tile(row) for row in first if row is not None],
        figures=figures,
        numbers=[
            (row.label, number(row.value, 5), "" if row.std is None else number(row.std, 2), row.unit)
            for row in measured.rows
        ],
        remarks=measured.notes,
        records=[
            ("records", ", ".join(measured.records)),
            *((what, channel.label) for what, channel in measured.channels.items()),
        ],
    )
    numbers = json.dumps(measured.as_dict(), indent=2, ensure_ascii=False) + "\n"
    written = Written(out / f"{name}.html", out / f"{name}.json", tuple(images))
    html.write({**images, written.numbers: numbers, written.page: page})
    return written


def save_fit(
    found: Fit | KalmanFit, figures: Sequence[style.CaptionedFigure], sentence: str, folder: str | Path
) -> Written:
    """Write `fit.html`, and the figures of a fit as PNG files, into a folder; `fit.json` is there already.

    Args:
        found: the fit.
        figures: of it.
        sentence: the finding.
        folder: made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    out, facts = Path(folder), found.as_dict()
    chi, floor, images = facts["chi"], facts["floor"], html.images(figures, out)
    rows = [(name, number(x["value"], 7), number(x["std"], 2)) for name, x in facts["parameters"].items()]
    each = [(name, [part.get(name) for part in (chi["train"], chi["validation"], floor)]) for name in floor]
    page = html.render(
        "fit",
        names=found.names,
        title="Fit",
        sentence=sentence,
        tiles=[Tile(name, value, f"± {std}") for name, value, std in rows[:_TILES]],
        parameters=rows,
        figures=figures,
        errors=[(name, *("" if x is None else number(x, 3) for x in parts)) for name, parts in each],
        remarks=found.notes,
    )
    files = Written(out / "fit.html", out / "fit.json", tuple(images))
    html.write({**images, files.page: page})
    return files


def _tile(row: Row) -> Tile:
    """Return a number with its unit and deviation; lengths, voltages and forces below 0.1 in thousandths."""
    by, unit = (1e3, f"m{row.unit}") if row.unit in {"m", "V", "N"} and abs(row.value) < 0.1 else (1.0, row.unit)
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    deviation = "" if row.std is None else f" ± {number(by * row.std, 2)}"
    return Tile(row.label, number(by * row.value, 4), unit + deviation)
