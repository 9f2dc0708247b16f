"""Figures of a fit: records beside their simulation, residuals and their spectra, and estimates over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.fit import Fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.simulation import Simulated, simulate
from masking.model.declaration.quantities import percent
from masking.model.declaration.units import pretty
from masking.reports import panels, style
from masking.reports.panels import Band, Level, Line, Panel, drawn, either_side, spectrum
from masking.reports.style import COLOURS, INK, CaptionedFigure

_WIDTHS: Final = (3.1, 1.75, 1.75)  # of readings, what is left of them, its spectrum
_HALVES: Final = (4.1, 3.2)  # of the whole record, and a part of it
_BEYOND = 2.5  # times half the range of what is measured: from there on, what is simulated is cut off
_PERIODS = 8  # of the strongest line that are shown
_LEAST_SHOWN = 50  # samples
_MOST_SENSORS = 6
_MOST_PARAMETERS = 24
_SETTLED = 0.15  # of the record: after that, a band sets the range of its axis
# What a record is to the values that it is simulated with, and the names and titles of its figure.
Which = Literal["fitted", "validation", ""]
_FIGURES: Final[dict[Which, tuple[str, str]]] = {
    "fitted": ("fit", "The fit"),
    "validation": ("validation", "The fit on the validation record"),
    "": ("simulation", "The record and its simulation, enlarged"),
}


def figures(found: Fit | KalmanFit, train: Sequence[Data], unseen: Sequence[Data]) -> tuple[list[CaptionedFigure], str]:
    """Figures of a fit and their finding, of the first record of each kind; without one whose simulation diverges."""
    made_figures, sentence = [], "The simulation with the fitted values is not finite"
    records: list[tuple[Data, Which]] = [(train[0], "fitted"), *((record, "validation") for record in unseen[:1])]
    for record, which in records:
        try:
            made = simulate(found.twin, record.under(found.twin), found.names)
        except IntegrationError:
            continue
        made_figures.append(fit(made, which))
        sentence = made.verdict(which)
    if isinstance(found, KalmanFit) and found.names:
        made_figures.append(estimates(found))
    return made_figures, sentence


def overview(made: Simulated) -> CaptionedFigure:
    """Whole record, its simulation and the residual."""
    lines = [
        ("measured", made.record.readings, COLOURS[0], 0.8),
        ("simulated", made.readings, INK, 0.8),
        ("residual", made.residual, COLOURS[1], 0.8),
    ]
    anew = " in each interval" if made.shooting_interval else ""
    caption = (
        f"{made.record.name}: measured, simulated from the initial state that fits best{anew}, and the residual."
        f"{panels.first_of(_MOST_SENSORS, len(made.sensors), 'sensors')}"
    )
    words = CaptionedFigure("overview", "The whole record", caption)
    return _over_time(words, made, lines, [(0.0, float(made.times[-1]))], made.verdict())


def comparison(before: Simulated, after: Simulated, labels: tuple[str, str], heading: str) -> CaptionedFigure:
    """Record beside two simulations of it: the whole, and enlarged where the first is furthest off."""
    lines = [
        ("measured", after.record.readings, COLOURS[0], 2.2),
        (labels[0], before.readings, COLOURS[1], 1.0),
        (labels[1], after.readings, INK, 1.0),
    ]
    seconds, whole = _span(after), float(after.times[-1])
    scale = np.maximum(np.abs(before.residual).max(axis=0), 1e-300)
    error = ((before.residual / scale) ** 2).sum(axis=1)
    sums = np.concatenate([[0.0], np.cumsum(error)])
    count = min(max(1, round(seconds * after.record.rate)), len(error))
    start = float(np.argmax(sums[count:] - sums[:-count])) / after.record.rate
    caption = (
        f"{after.record.name}: measured, and simulated from the initial state that fits best, {labels[0]} and "
        f"{labels[1]}; right, {seconds:.3g} s of it, where the first is furthest off. What is far beyond the measured "
        f"motion is cut off.{panels.first_of(_MOST_SENSORS, len(after.sensors), 'sensors')}"
    )
    words = CaptionedFigure("comparison", "Measured, before and after", caption)
    return _over_time(words, after, lines, [(0.0, whole), (start, min(start + seconds, whole))], heading)


def _over_time(
    words: CaptionedFigure,
    made: Simulated,
    lines: Sequence[tuple[str, Array, str, float]],
    spans: Sequence[tuple[float, float]],
    heading: str,
) -> CaptionedFigure:
    """Lines of each sensor over spans of time in s, cut off far beyond the first and the last of them.

    Lines are label, values (m, sensors), colour and width; the last of three widths is dashed.
    """
    rows = []
    for i, name in enumerate(made.sensors[:_MOST_SENSORS]):
        by, unit = panels.shown(pretty(made.units[i]), made.record.readings[:, i])
        row = list[Panel]()
        for span in spans:
            part = (made.times >= span[0]) & (made.times <= span[1])
            drawn_lines = [
                Line(made.times[part], by * values[part, i], colour, width, key, len(spans) > 1 and colour == INK)
                for key, values, colour, width in lines
            ]  # fmt: skip
            kept = np.concatenate([drawn_lines[0].y, drawn_lines[-1].y])
            middle, reach = 0.5 * (kept.max() + kept.min()), _BEYOND * 0.5 * float(np.ptp(kept)) or 1.0
            every = np.concatenate([line.y for line in drawn_lines])
            pad = 0.05 * float(np.ptp(every))
            low, high = max(every.min() - pad, middle - reach), min(every.max() + pad, middle + reach)
            label = "" if row else style.with_unit(style.symbol(name), unit)
            row.append(Panel(drawn_lines, label, "time (s)", span, (low, high), ticks=4))
        rows.append(row)
    return drawn(words, rows, widths=_HALVES, heading=heading)


def fit(made: Simulated, which: Which) -> CaptionedFigure:
    """Record beside its simulation, whose values were fitted to it, validated on it, or neither."""
    seconds, rows = _span(made), []
    part = made.times <= seconds
    t = made.times[part]
    for i, name in enumerate(made.sensors[:_MOST_SENSORS]):
        unit, noise = pretty(made.units[i]), made.record.noise[i]
        measured, simulated, left = made.record.readings[:, i], made.readings[part, i], made.residual[:, i]
        (by, y_unit), (small, rest_unit) = panels.shown(unit, measured[part]), panels.shown(unit, left[part])
        motion = [
            Line(t, by * measured[part], COLOURS[0], 1.8, "measured"),
            Line(t, by * simulated, INK, 0.9, is_dashed=True),
        ]
        rest = [Line(t, small * left[part], COLOURS[1], 0.7, "residual", bins=300), *either_side(1.96 * small * noise)]
        signals = [(measured, COLOURS[0], 1.2), (left, COLOURS[1], 1.0)]
        rows.append([
            Panel(motion, style.with_unit(style.symbol(name), y_unit), "time (s)", (0.0, seconds), ticks=4),
            Panel(rest, style.with_unit("residual", rest_unit), "time (s)", (0.0, seconds), ticks=4),
            spectrum(signals, made.record.rate, noise, unit, "simulated; noise floor of the residual"),
        ])  # fmt: skip
    caption = (
        f"{made.record.name}: left, its first {seconds:.3g} s and the simulation; in the middle the residual, with "
        "the lines that hold 95 % of the noise; right, spectra of the whole record. A residual above the noise is an "
        "effect that the model does not have."
    )
    name, title = _FIGURES[which]
    words = CaptionedFigure(name, title, caption)
    return drawn(words, rows, widths=_WIDTHS, heading=made.verdict(which))


def estimates(found: KalmanFit) -> CaptionedFigure:
    """Estimates of a filter over time, with the band of two standard deviations."""
    names = found.names[:_MOST_PARAMETERS]
    columns = 1 if len(names) <= 3 else 2
    last = " and ".join(names) if len(names) <= 2 else f"{len(found.names)} parameters"
    chi = max(found.chi.values())
    error = f"with an error of {percent(chi)} or less" if np.isfinite(chi) else "but the simulation is not finite"
    sentence = f"One pass of {found.times[-1]:.3g} s estimates {last}; the final values reproduce the record {error}"
    each = [_estimate(found, i) for i in range(len(names))]
    rows = [each[i : i + columns] for i in range(0, len(each), columns)]
    rows[-1] += [Panel(finish=lambda axes: axes.set_visible(False))] * (columns - len(rows[-1]))
    caption = (
        "The estimate of each parameter after each sample, and two standard deviations of it, which hold if the noise "
        "is what the filter assumes; above each, the final value."
        f"{panels.first_of(len(names), len(found.names), 'parameters')}"
    )
    return drawn(CaptionedFigure("estimates", "Estimates over time", caption), rows, 1.15, heading=sentence)


def _estimate(found: KalmanFit, i: int) -> Panel:
    name, known = found.names[i], found.twin.model.declaration.parameters
    t, value, half = found.times, found.trajectory[:, i], 2.0 * found.deviations[:, i]
    few = slice(None, None, max(1, len(t) // 1500))
    shown = [
        Band(t[few], (value - half)[few], (value + half)[few], COLOURS[0]),
        Line(t, value, COLOURS[0], 1.2, "estimate, ± 2 standard deviations"),
        Level(found.values[i], key="final value"),
    ]
    late = t >= _SETTLED * t[-1]
    low, high = min(value.min(), (value - half)[late].min()), max(value.max(), (value + half)[late].max())
    pad = 0.08 * (high - low) or 1.0
    label = style.with_unit(style.symbol(name), pretty(known[name].unit if name in known else ""))
    final = f"{found.values[i]:.5g} ± {2.0 * found.std[i]:.2g}"
    return Panel(shown, label, "time (s)", (t[0], t[-1]), (low - pad, high + pad), ticks=4, title=final)


def _span(made: Simulated) -> float:
    """Seconds at the start that hold a few periods of the strongest line of any sensor."""
    whole, strongest = made.times[-1], 0.0
    for values in made.record.readings.T:
        spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))[1:]
        strongest = max(strongest, (1 + int(np.argmax(spectrum))) / (len(values) / made.record.rate))
    return float(min(whole, max(_LEAST_SHOWN / made.record.rate, _PERIODS / max(strongest, 1e-300))))
