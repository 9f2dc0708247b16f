"""Pages of measurements, fits and simulations: HTML that needs no other file, figures, and numbers as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

MOST_TILES = 3
# Title of a page, and beginnings of the names of numbers on top of it; the first number of each is shown.
_PAGES = {
    "springs": ("Spring curve", ("stiffness", "half_gap", "width")),
    "actuators": ("Balance of two actuators", ("ratio", "residual")),
    "friction": ("Friction", ("edge", "step", "largest_shift", "friction")),
    "response": ("Frequency response", ("peak_", "even_", "odd_")),
}


def save(measured: Measurement[Any], folder: str | Path) -> None:
    """Write page, numbers and PNG files, named after the procedure; a `RecordError` where they cannot be."""
    name = measured.procedure
    title, keys = _PAGES[name]
    first = [next((row for row in measured.rows if row.key.startswith(key)), None) for key in keys]
    channels = [(what, channel.label) for what, channel in measured.channels.items()]
    html.save(
        Path(folder, f"{name}.html"),
        "procedure",
        procedure_figures.figures(measured),
        measured.as_dict(),
        title=title,
        result=measured,
        tiles=[_tile(row) for row in first if row is not None],
        remarks=measured.notes,
        origin_title="Records and columns",
        origin=[("records", ", ".join(measured.records)), *channels],
    )


def save_fit(found: Fit | KalmanFit, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `fit.html` with the finding, and a fit's figures into a folder that has `fit.json`; errors as of `save`."""
    content = found.as_dict()
    chi = content["chi"]
    html.save(
        Path(folder, "fit.html"),
        "fit",
        figures,
        names=found.names,
        title="Fit",
        tiles=_fitted(found) or _errors(chi["train"]),
        sentence=sentence,
        parameters=content["parameters"],
        errors={"error chi": chi["train"], "validation error": chi["validation"], "noise floor": content["floor"]},
        remarks=found.remarks,
    )


def save_simulation(made: Simulated, figures: Sequence[CaptionedFigure], sentence: str, folder: str | Path) -> None:
    """Write `simulation.html` with the finding, `simulation.json` and figures into a folder; errors as of `save`."""
    html.save(
        Path(folder, "simulation.html"),
        "fit",
        figures,
        {"record": made.record.name, "chi": made.chi, "floor": made.floor, "notes": made.record.notes},
        names=made.sensors,
        title="Simulation",
        tiles=_errors(made.chi),
        sentence=sentence,
        parameters={},
        errors={"error chi": made.chi, "noise floor": made.floor},
        remarks=made.record.notes,
    )


def _tile(row: Row) -> Tile:
    """Number with its unit and deviation; small lengths, voltages and forces with a prefix."""
    by, unit = figure_parts.shown(row.unit, [row.value])
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    deviation = "" if row.std is None else f" ± {number(by * row.std, 2)}"
    return Tile(row.label, number(by * row.value, 4), unit + deviation)


def _fitted(found: Fit | KalmanFit) -> list[Tile]:
    """First parameters, with their deviations and units."""
    made = []
    for name, one in list(found.parameters().items())[:MOST_TILES]:
        deviation = "" if one["std"] is None else f"± {number(one['std'], 2)}"
        made.append(Tile(name, number(one["value"], 7), f"{deviation} {one.get('unit', '')}".strip()))
    return made


def _errors(chi: Mapping[str, float]) -> list[Tile]:
    """Errors of the first sensors."""
    return [Tile(f"error of {name}", percent(part)) for name, part in list(chi.items())[:MOST_TILES]]
