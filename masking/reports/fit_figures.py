"""Figures of a fit: records beside their simulation, residuals and their spectra, and estimates over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from matplotlib.figure import Figure

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.estimation.fit import Fit
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.innovations import KalmanFit
from masking.inference.estimation.simulation import Simulated, simulate
from masking.model.declaration.quantities import percent, quantity
from masking.model.declaration.units import pretty
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.style import BAND, COLOURS, DASHED, INK, LIMIT, MUTED, SIZE, CaptionedFigure
from masking.reports.text import aligned

_WIDTHS: Final = (3.1, 1.75, 1.75)  # inches: readings, what is left of them, its spectrum
_WHOLE: Final = (7.1,)  # inches
_HALVES: Final = (4.1, 3.2)  # inches: the whole record, and a part of it
_BEYOND = 2.5  # times half the range of what is measured: from there on, what is simulated is cut off
_PERIODS = 8  # of the strongest line that are shown
_LEAST_SHOWN = 50  # samples
_MORE = 1.2  # times the noise: from here on a residual is more than that
_MOST_SENSORS = 6
_MOST_PARAMETERS = 24
_TITLE = 0.22  # inches above axes for the value of a parameter
_SETTLED = 0.15  # of the record: after that, a band sets the range of its axis
# What a record is to the values that it is simulated with, and the names and titles of its figure.
Which = Literal["fitted", "validation", ""]
_FIGURES: Final[dict[Which, tuple[str, str]]] = {
    "fitted": ("fit", "The fit"),
    "validation": ("validation", "The fit on the validation record"),
    "": ("simulation", "The record and its simulation, enlarged"),
}


@dataclass(frozen=True)
class Line:
    """A line over time: its label, values of each sensor (m, sensors), colour and width in points."""

    label: str
    values: Array
    colour: str
    width: float = 0.8
    is_dashed: bool = False


def figures(found: Fit | KalmanFit, train: Sequence[Data], unseen: Sequence[Data]) -> tuple[list[CaptionedFigure], str]:
    """Figures of a fit and what they say; without a record whose simulation is not finite.

    Args:
        found: the fit.
        train: records that were fitted, of which the first is drawn.
        unseen: validation records, of which the first is drawn.
    """
    drawn, sentence = [], "The simulation with the fitted values is not finite"
    records: list[tuple[Data, Which]] = [(train[0], "fitted"), *((record, "validation") for record in unseen[:1])]
    for record, which in records:
        try:
            made = simulate(found.twin, record.under(found.twin), found.names)
        except IntegrationError:
            continue
        drawn.append(fit(made, which))
        sentence = verdict(made, which)
    if isinstance(found, KalmanFit) and found.names:
        drawn.append(estimates(found))
    return drawn, sentence


def overview(made: Simulated) -> CaptionedFigure:
    """Draw a whole record, its simulation and the residual."""
    lines = [
        Line("measured", made.record.readings, COLOURS[0]),
        Line("simulated", made.readings, INK),
        Line("residual", made.residual, COLOURS[1]),
    ]
    figure = _over_time(made, lines, [(0.0, made.times[-1])], verdict(made, ""))
    more = parts.first_of(len(made.sensors[:_MOST_SENSORS]), len(made.sensors), "sensors")
    anew = " in each interval" if made.shooting_interval else ""
    caption = (
        f"{made.record.name}: measured, simulated from the initial state that fits best{anew}, and the residual.{more}"
    )
    return CaptionedFigure("overview", "The whole record", caption, figure)


def comparison(before: Simulated, after: Simulated, labels: tuple[str, str], heading: str) -> CaptionedFigure:
    """Draw a record beside two simulations of it: the whole, and enlarged where the first is furthest off.

    Args:
        before: the record and a simulation of it.
        after: another simulation.
        labels: of these.
        heading: what is to be seen.
    """
    lines = [
        Line("measured", after.record.readings, COLOURS[0], 2.2),
        Line(labels[0], before.readings, COLOURS[1], 1.0),
        Line(labels[1], after.readings, INK, 1.0, is_dashed=True),
    ]
    seconds, whole = _span(after), float(after.times[-1])
    scale = np.maximum(np.abs(before.residual).max(axis=0), 1e-300)
    error = ((before.residual / scale) ** 2).sum(axis=1)
    sums = np.concatenate([[0.0], np.cumsum(error)])
    count = min(max(1, round(seconds * after.record.rate)), len(error))
    start = float(np.argmax(sums[count:] - sums[:-count])) / after.record.rate
    figure = _over_time(after, lines, [(0.0, whole), (start, min(start + seconds, whole))], heading)
    more = parts.first_of(len(after.sensors[:_MOST_SENSORS]), len(after.sensors), "sensors")
    caption = (
        f"{after.record.name}: measured, and simulated from the initial state that fits best, {labels[0]} and "
        f"{labels[1]}; right, {seconds:.3g} s of it, where the first is furthest off. What is far beyond the measured "
        f"motion is cut off.{more}"
    )
    return CaptionedFigure("comparison", "Measured, before and after", caption, figure)


def _over_time(made: Simulated, lines: Sequence[Line], spans: Sequence[tuple[float, float]], heading: str) -> Figure:
    """Draw lines of each sensor over spans of time in s, the readings and the last line without a part cut off."""
    names = made.sensors[:_MOST_SENSORS]
    widths = _WHOLE if len(spans) == 1 else _HALVES
    figure, rows = style.panels(len(names), 1.35, widths, heading=heading)
    for i, (name, row) in enumerate(zip(names, rows, strict=True)):
        by, unit = parts.shown(pretty(made.units[i]), made.record.readings[:, i])
        for axes, (first, last) in zip(row, spans, strict=True):
            part = (made.times >= first) & (made.times <= last)
            for line in lines:
                values = by * line.values[part, i]
                axes.plot(*style.thin(made.times[part], values), color=line.colour, lw=line.width,
                          ls=DASHED if line.is_dashed else "-")  # fmt: skip
            axes.set_xlim(first, last)
            kept = by * np.concatenate([lines[0].values[part, i], lines[-1].values[part, i]])
            middle, reach = 0.5 * (kept.max() + kept.min()), _BEYOND * 0.5 * float(np.ptp(kept)) or 1.0
            low, high = axes.get_ylim()
            axes.set_ylim(max(low, middle - reach), min(high, middle + reach))
            parts.ticks(axes, 4)
        row[0].set_ylabel(style.with_unit(style.symbol(name), unit))
    for axes in rows[-1]:
        axes.set_xlabel("time (s)")
    keys = [parts.line_key(line.label, line.colour, line.width + 0.4, dashed=line.is_dashed) for line in lines]
    parts.legend(figure, rows[0][-1], keys)
    return figure


def fit(made: Simulated, which: Which) -> CaptionedFigure:
    """Draw a record beside its simulation.

    Args:
        made: the record and its simulation.
        which: whether its values were fitted to this record, validated on it, or neither.
    """
    names = made.sensors[:_MOST_SENSORS]
    sentence = verdict(made, which)
    figure, rows = style.panels(len(names), 1.35, _WIDTHS, heading=sentence)
    seconds = _span(made)
    part = made.times <= seconds
    for i, (name, (motion, rest, spectrum)) in enumerate(zip(names, rows, strict=True)):
        unit = pretty(made.units[i])
        t, measured = made.times[part], made.record.readings[part, i]
        by, y_unit = parts.shown(unit, measured)
        motion.plot(*style.thin(t, by * measured), color=COLOURS[0], lw=1.8)
        motion.plot(*style.thin(t, by * made.readings[part, i]), color=INK, lw=0.9, ls=DASHED)
        motion.set_ylabel(style.with_unit(style.symbol(name), y_unit))
        left = made.residual[part, i]
        by, y_unit = parts.shown(unit, left)
        rest.plot(*style.thin(t, by * left, 300), color=COLOURS[1], lw=0.7)
        parts.noise_band(rest, 1.96 * by * made.record.noise[i])
        rest.set_ylabel(style.with_unit("residual", y_unit))
        for axes in (motion, rest):
            axes.set_xlim(0.0, seconds)
            axes.margins(y=0.08)
            parts.ticks(axes, 4)
        for values, colour, width in (
            (made.record.readings[:, i], COLOURS[0], 1.2),
            (made.residual[:, i], COLOURS[1], 1.0),
        ):
            f, density = parts.spectral_density(values, made.record.rate)
            spectrum.plot(f, density, color=colour, lw=width)
        parts.noise_level(spectrum, made.record.noise[i], made.record.rate)
        parts.logarithmic(spectrum)
        spectrum.set_xlim(f[0], f[-1])
        spectrum.set_ylabel(f"{unit or '1'}/√Hz")
    rows[-1][0].set_xlabel("time (s)")
    rows[-1][1].set_xlabel("time (s)")
    rows[-1][2].set_xlabel("frequency (Hz)")
    parts.legend(figure, rows[0][0], [
        parts.line_key("measured", COLOURS[0]),
        parts.line_key("residual", COLOURS[1], 1.4),
        parts.line_key("simulated; noise floor of the residual", INK, 1, dashed=True),
    ])  # fmt: skip
    caption = (
        f"{made.record.name}: left, its first {seconds:.3g} s and the simulation; in the middle the residual, with "
        "the lines that hold 95 % of the noise; right, spectra of the whole record. A residual above the noise is an "
        "effect that the model does not have."
    )
    name, title = _FIGURES[which]
    return CaptionedFigure(name, title, caption, figure)


def estimates(found: KalmanFit) -> CaptionedFigure:
    """Draw the estimates of a filter over time, with the band of two standard deviations."""
    names = found.names[:_MOST_PARAMETERS]
    columns = 1 if len(names) <= 3 else 2
    widths = (7.83,) if columns == 1 else (3.45, 3.45)
    count = -(-len(names) // columns)
    last = " and ".join(names) if len(names) <= 2 else f"{len(found.names)} parameters"
    chi = max(found.chi.values())
    error = f"with an error of {percent(chi)} or less" if np.isfinite(chi) else "but the simulation is not finite"
    sentence = f"One pass of {found.times[-1]:.3g} s estimates {last}; the final values reproduce the record {error}"
    figure, rows = style.panels(max(count, 1), 1.15, widths, style.BELOW + _TITLE, sentence)
    cells = [axes for row in rows for axes in row]
    known = found.twin.model.declaration.parameters
    for i, (name, axes) in enumerate(zip(names, cells, strict=False)):
        t, value, half = found.times, found.trajectory[:, i], 2.0 * found.deviations[:, i]
        few = slice(None, None, max(1, len(t) // 1500))
        axes.fill_between(t[few], (value - half)[few], (value + half)[few], color=COLOURS[0], alpha=BAND, lw=0)
        axes.plot(*style.thin(t, value), color=COLOURS[0], lw=1.2)
        axes.axhline(found.values[i], color=INK, lw=0.9, ls=DASHED)
        late = t >= _SETTLED * t[-1]
        low = min(float(value.min()), float((value - half)[late].min()))
        high = max(float(value.max()), float((value + half)[late].max()))
        pad = 0.08 * (high - low) or 1.0
        axes.set(xlim=(t[0], t[-1]), ylim=(low - pad, high + pad))
        parts.ticks(axes, 4)
        unit = known[name].unit if name in known else ""
        axes.set_ylabel(style.with_unit(style.symbol(name), pretty(unit)))
        axes.set_title(f"{found.values[i]:.5g} ± {2.0 * found.std[i]:.2g}", loc="left", fontsize=SIZE - 1,
                       color=LIMIT if not np.isfinite(found.values[i]) else MUTED, pad=2)  # fmt: skip
    for axes in cells[len(names) :]:
        axes.set_visible(False)
    for axes in cells[max(len(names) - columns, 0) : len(names)]:
        axes.set_xlabel("time (s)")
    parts.legend(figure, cells[0], [
        parts.line_key("estimate, ± 2 standard deviations", COLOURS[0]),
        parts.line_key("final value", INK, 1, dashed=True),
    ], _TITLE)  # fmt: skip
    more = parts.first_of(len(names), len(found.names), "parameters")
    caption = (
        "The estimate of each parameter after each sample, and two standard deviations of it, which hold if the noise "
        f"is what the filter assumes; above each, the final value.{more}"
    )
    return CaptionedFigure("estimates", "Estimates over time", caption, figure)


def _span(made: Simulated) -> float:
    """Seconds at the start that hold a few periods of the strongest line of any sensor."""
    whole, strongest = made.times[-1], 0.0
    for values in made.record.readings.T:
        spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values))))[1:]
        strongest = max(strongest, (1 + int(np.argmax(spectrum))) / (len(values) / made.record.rate))
    return float(min(whole, max(_LEAST_SHOWN / made.record.rate, _PERIODS / max(strongest, 1e-300))))


def verdict(made: Simulated, which: Which) -> str:
    """Say in a sentence whether the residual of a record is above the noise floor."""
    chi, floor, record = made.chi, made.floor, f"{which} record".lstrip()
    if made.shooting_interval:
        record += f", simulated in intervals of {quantity(made.shooting_interval, 's')},"
    more = [name for name in chi if chi[name] > _MORE * floor[name]]
    if not more:
        sensors = ", ".join(f"{name} {percent(chi[name])}" for name in chi)
        return f"In the {record} the residual is hardly above the noise floor: {sensors} of the readings"
    sensors = ", ".join(f"{name} {percent(chi[name])} ({percent(floor[name])})" for name in more)
    return f"In the {record} the residual is above the noise floor (in brackets), as part of the readings: {sensors}"


def summary(made: Simulated) -> str:
    """Verdict of a simulation, and a table of its errors, for the terminal."""
    errors = (("error chi", made.chi), ("noise floor", made.floor))
    rows = [("", *made.sensors), *((what, *(percent(part[name]) for name in made.sensors)) for what, part in errors)]
    return "\n".join([f"{verdict(made, '')}.", *aligned(rows)])
