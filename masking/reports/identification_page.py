"""Pages of measurements, fits and simulations: HTML that needs no other file, figures, and numbers as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from masking.control.rig.twin import Twin
from masking.errors import IntegrationError
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.fit import Fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import Simulated, noise_alone, relative, simulate
from masking.inference.procedures.measurement import Measurement, Row
from masking.model.declaration.quantities import number, percent, with_deviation
from masking.model.declaration.units import pretty
from masking.reports import html, one_page, panels, procedure_figures
from masking.reports.error_panel import NOISE
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.style import CaptionedFigure
from masking.reports.text import capital, listed, plural

MOST_TILES, FIT_PAGE = 3, "fit.html"
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
        Path(folder, FIT_PAGE),
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
    by, unit = panels.shown(row.unit, [row.value])
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    deviation = "" if row.std is None else f" ± {number(by * row.std, 2)}"
    return Tile(row.label, number(by * row.value, 4), unit + deviation)


def sheet(
    found: Fit | KalmanFit, declared: Twin, train: Sequence[Data], unseen: Sequence[Data], sentence: str
) -> Sheet:
    """What one page says of a fit: also the errors of the plant as declared, by a simulation of the unseen records.

    Where there are none of these, the errors are those in the fitted ones.
    """
    records, which = (unseen, "validation") if unseen else (train, "fitted")
    errors = {
        "as declared": _errors_of(declared, records, found.names),
        "fitted": found.validation or found.chi,
        NOISE: noise_alone(declared.sensors, records),
    }
    pairs = zip(found.names, found.values, found.std, strict=True)
    values = [
        f"{n} = {with_deviation(x, 0.0 if found.doubt else s, pretty(found.unit(n) or '1'))}" for n, x, s in pairs
    ]
    sections = {
        one_page.FOUND: [f"{sentence}."],
        "Parameters": [", ".join(values)] if len(values) > MOST_TILES else [],
        one_page.NOTES: [f"{capital(text)}." for text in found.remarks],
    }
    used = {"fitted": train, "validation": unseen}
    return Sheet(
        title=f"Fit of {declared.declaration.name}",
        subject=[f"{what}: {listed([one.name for one in each])}" for what, each in used.items() if each],
        tiles=_fitted(found) or _errors(found.chi),
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite(errors),
        errors_title=f"Simulation error, {which} {plural(len(records), 'record', 'records')}",
        page=FIT_PAGE,
    )


def _errors_of(twin: Twin, records: Sequence[Data], shared: Sequence[str]) -> dict[str, float]:
    """Relative error of each sensor over records, by name; infinite where the simulated motion is not finite."""
    try:
        residuals = [simulate(twin, record.under(twin), shared).residual for record in records]
    except IntegrationError:
        return dict.fromkeys(twin.sensors, math.inf)
    return relative(twin.sensors, records, np.sum([(one**2).sum(axis=0) for one in residuals], axis=0))


def _fitted(found: Fit | KalmanFit) -> list[Tile]:
    """First parameters, with their deviations and units."""
    made = []
    for name, one in list(found.parameters().items())[:MOST_TILES]:
        deviation = "" if one["std"] is None else f"± {number(one['std'], 2)}"
        made.append(Tile(name, number(one["value"], 7), f"{deviation} {pretty(one.get('unit', '1'))}".strip()))
    return made


def _errors(chi: Mapping[str, float]) -> list[Tile]:
    """Errors of the first sensors."""
    return [Tile(f"error of {name}", percent(part)) for name, part in list(chi.items())[:MOST_TILES]]
