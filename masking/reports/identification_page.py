"""Pages of a measurement or a fit: one HTML page that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from masking.inference.estimation.fit import Fit
from masking.inference.estimation.innovations import KalmanFit
from masking.inference.estimation.simulation import Simulated
from masking.inference.procedures.measurement import Measurement, Row
from masking.model.declaration.quantities import number, percent
from masking.reports import figure_parts, html, procedure_figures
from masking.reports.html import Tile
from masking.reports.style import CaptionedFigure

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


def save(measured: Measurement[Any], folder: str | Path) -> None:
    """Write `<procedure>.html`, `<procedure>.json` and PNG files into a folder, made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    name = measured.procedure
    first = [next((row for row in measured.rows if row.key.startswith(key)), None) for key in _FIRST[name]]
    html.save(
        Path(folder, f"{name}.html"),
        "procedure",
        procedure_figures.figures(measured),
        measured.as_dict(),
        title=_TITLES[name],
        sentence=measured.sentence,
        tiles=[_tile(row) for row in first if row is not None],
        values=[
            (row.label, number(row.value, 5), "" if row.std is None else number(row.std, 2), row.unit)
            for row in measured.rows
        ],
        remarks=measured.notes,
        origin_title="Records and columns",
        origin=[
            ("records", ", ".join(measured.records)),
            *((what, channel.label) for what, channel in measured.channels.items()),
        ],
    )


def save_fit(found: Fit | KalmanFit, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `fit.html`, and the figures of a fit as PNG files, into a folder; `fit.json` is there already.

    Args:
        found: the fit.
        figures: of it.
        sentence: the finding.
        folder: made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    content = found.as_dict()
    rows = [(name, number(x["value"], 7), number(x["std"], 2)) for name, x in content["parameters"].items()]
    errors = (content["chi"]["train"], content["chi"]["validation"], content["floor"])
    html.save(
        Path(folder, "fit.html"),
        "fit",
        figures,
        names=found.names,
        title="Fit",
        sentence=sentence,
        tiles=[Tile(name, value, f"± {std}") for name, value, std in rows[:_TILES]],
        parameters=rows,
        columns=("sensor", "error chi", "validation error", "noise floor"),
        errors=[
            (name, *(number(part[name], 3) if part.get(name) is not None else "" for part in errors))
            for name in content["floor"]
        ],
        remarks=found.notes,
    )


def save_simulation(made: Simulated, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `simulation.html`, `simulation.json` and the figures of a simulated record into a folder, made if need be.

    Args:
        made: the record and its simulation.
        figures: of it.
        sentence: the finding.
        folder: where to.

    Raises:
        RecordError: the folder cannot be written.
    """
    html.save(
        Path(folder, "simulation.html"),
        "fit",
        figures,
        {"record": made.record.name, "chi": made.chi, "floor": made.floor},
        names=made.sensors,
        title="Simulation",
        sentence=sentence,
        tiles=[Tile(f"error of {name}", percent(chi), "") for name, chi in list(made.chi.items())[:_TILES]],
        parameters=[],
        columns=("sensor", "error chi", "noise floor"),
        errors=[(name, number(chi, 3), number(made.floor[name], 3)) for name, chi in made.chi.items()],
        remarks=[],
    )


def _tile(row: Row) -> Tile:
    """Number with its unit and deviation; small lengths, voltages and forces with a prefix."""
    by, unit = figure_parts.shown(row.unit, [row.value])
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    deviation = "" if row.std is None else f" ± {number(by * row.std, 2)}"
    return Tile(row.label, number(by * row.value, 4), unit + deviation)
