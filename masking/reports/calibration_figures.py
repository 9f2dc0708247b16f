"""Figures of a calibration: the unseen record, the residual of each model, springs, and the excitation."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from masking.display.palette import NOISE
from masking.display.symbols import in_figure
from masking.inference.procedures.calibration_findings import HIGHEST, Calibration, Curve
from masking.model.declaration.quantities import percent, quantity
from masking.reports import panels as parts
from masking.reports import style
from masking.reports.panels import Band, Level, Line, Panel, Span, drawn, either_side
from masking.reports.style import COLOURS, GRID, INK, LIMIT, MUTED, SIZE, CaptionedFigure
from masking.reports.text import short

_MOST_ROWS = len(COLOURS)
_SHOWN = 10.0  # s of the unseen record in which single swings can be distinguished apart
_WINDOW = 0.5  # s over which a residual's rms is taken
_BINS_PER_DECADE = 14  # of a spectrum
_WORDS = 1.72  # inches at the right for the names of lines
_LETTERS = 32  # of such a name
_APART = 0.16  # inches between these names
_FLOOR = 0.45  # times the noise: where an axis of residuals ends
_MILLI = 1e3


def figures(found: Calibration) -> list[CaptionedFigure]:
    """Figures of the report, in its order."""
    return [_unseen(found), _residuals(found), _spectra(found), _springs(found), _excitation(found)]


def _unseen(found: Calibration) -> CaptionedFigure:
    record, best = found.records.unseen, found.best
    names = found.twin.sensors[:_MOST_ROWS]
    t, end = np.arange(len(record)) / record.rate, len(record) / record.rate
    part = t >= end - _SHOWN
    model = record.readings - found.residuals[best.name]
    rows = []
    for i, (name, colour) in enumerate(zip(names, COLOURS, strict=False)):
        lines = [
            Line(t[part], record.readings[part, i], colour, 2.6, opacity=0.45),
            Line(t[part], model[part, i], INK, 0.9, "simulated, fitted to another record", is_dashed=True),
        ]
        reach = 1.12 * float(np.abs(record.readings[part, i]).max())
        errors = f"error {percent(best.fit.validation[name])}, noise alone {percent(found.unseen_floor[name])}"
        ends = (max(0.0, end - _SHOWN), end)
        rows.append([Panel(lines, _reading(found, name), "time (s)", ends, (-reach, reach), note=errors)])
    span = f"the last {_SHOWN:g} s of {end:g} s" if end > _SHOWN else "all of it"
    meanings = [f"{name}: {meaning}" for name in names if (meaning := found.twin.declaration.sensors[name].meaning)]
    caption = (
        f"The record that was not fitted, {span}, and its simulation. {'; '.join(meanings)}{'.' * bool(meanings)} The "
        "error is (4.12) of the source document, over the whole record."
    )
    words = CaptionedFigure("unseen", "Measured and simulated", caption)
    return drawn(words, rows, 1.25, keys=[Line([], [], MUTED, 2.6, "measured", opacity=0.6)])


def _residuals(found: Calibration) -> CaptionedFigure:
    record = found.records.unseen
    count = max(1, round(_WINDOW * record.rate))
    rows = list[list[Panel]]()
    for i, name in enumerate(found.twin.sensors[:_MOST_ROWS]):
        noise, ends = record.noise[i], list[tuple[float, str, str]]()
        lines = list[Line]()
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            sums = np.concatenate([[0.0], np.cumsum(left[:, i] ** 2)])
            rms = np.sqrt((sums[count:] - sums[:-count]) / count)
            t = np.linspace(0.5 * count, 0.5 * count + len(rms) - 1.0, len(rms)) / record.rate
            lines.append(Line(t, rms, colour))
            ends.append((float(np.sqrt((left[:, i] ** 2).mean())), stage, colour))
        ends.append((0.67 * noise, f"noise {quantity(noise, _unit(found, name), 2)}", MUTED))
        highest = max(noise, *(float(np.max(line.y)) for line in lines))
        band = Span(_FLOOR * noise, noise, NOISE, axis="y", opacity=1.0)
        rows.append([
            Panel([band, *lines], f"rms residual of {_reading(found, name)}", "time (s)",
                  (0.0, len(record) / record.rate), (_FLOOR * noise, 1.6 * highest), log="y",
                  finish=functools.partial(_beside, ends=ends))
        ])  # fmt: skip
    caption = (
        f"Residual of each model on the unseen record: the rms of measured less simulated over {_WINDOW:g} s. The grey "
        "band is white noise in the readings, estimated where their spectra are quietest; a line at its edge is at the "
        "noise floor."
    )
    return drawn(CaptionedFigure("residuals", "Residual of each model", caption), rows, 1.45, right=_WORDS)


def _spectra(found: Calibration) -> CaptionedFigure:
    record, rows = found.records.unseen, list[list[Panel]]()
    for i, name in enumerate(found.twin.sensors[:_MOST_ROWS]):
        level = parts.noise_density(record.noise[i], record.rate)
        f, whole = parts.spectral_density(record.readings[:, i], record.rate, 1, _BINS_PER_DECADE)
        lines = [Line(f, whole, MUTED, 1.0, opacity=0.75)]
        ends = [(float(whole[np.searchsorted(f, HIGHEST) - 1]), "measured", MUTED), (level, "white noise", INK)]
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            _, of = parts.spectral_density(left[:, i], record.rate, 1, _BINS_PER_DECADE)
            lines.append(Line(f, of, colour))
            ends.append((float(np.sqrt((of[f <= HIGHEST] ** 2).mean())), stage, colour))
        rows.append([
            Panel([Span(f[0], HIGHEST, GRID), *lines, Level(level)],
                  f"{style.symbol(name)} ({_unit(found, name)}/√Hz)", "frequency (Hz)", (f[0], f[-1]),
                  (0.3 * level, 2.0 * float(whole.max())), log="xy", finish=functools.partial(_beside, ends=ends),
                  title="" if rows else f"excited up to {HIGHEST:g} Hz")
        ])  # fmt: skip
    caption = (
        "Amplitude density of the unseen record (grey line) and of the residual of each model. The dashed line is the "
        "density of white noise as large as that of the readings; the band is where the rig was excited. A residual "
        "above the line there is an effect that the model does not have."
    )
    return drawn(CaptionedFigure("spectra", "Spectra of the residuals", caption), rows, 1.6, right=_WORDS)


def _springs(found: Calibration) -> CaptionedFigure:
    curves, title = found.curves[:_MOST_ROWS], "Springs"
    if not curves:
        return style.absent("springs", title, "every spring of the best model is straight")
    simplest, rows = found.stages[0].name, []
    for colour, curve in zip(COLOURS, curves, strict=False):
        by, x_unit = (_MILLI, "mm") if curve.measured == "m" else (1.0, curve.measured)
        x, unit = by * curve.displacement, curve.unit.replace("**2", "²")
        straight = np.asarray(np.polyval(np.polyfit(curve.displacement, curve.linear, 1), curve.displacement))
        row = list[Panel]()
        for of, label in ((np.zeros(len(x)), style.symbol(curve.element)), (straight, "less the line")):
            force = curve.force - of
            content = [
                Span(by * curve.low, by * curve.high, GRID, "displacements in the record"),
                Band(x, force - 2.0 * curve.std, force + 2.0 * curve.std, colour, 0.25),
                Line(x, force, colour, 1.8),
                Line(x, curve.declared - of, INK, 0.9, "the plant file said", is_dashed=True),
                Line(x, curve.linear - of, MUTED, 0.9, simplest),
            ]
            across = style.with_unit("displacement", x_unit) if curve is curves[-1] else ""
            range_of_y = _range(curve, straight) if row else None
            title_of = "" if row else curve.meaning
            row.append(Panel(content, f"{label} ({unit})", across, (x[0], x[-1]), range_of_y, title=title_of))
        rows.append(row)
    caption = (
        "Force of each spring of the best model at rest, per moving mass, over its displacement: left the whole, right "
        "less the straight line of the simplest model. The band is twice the standard deviation that follows from the "
        "covariance of the parameters; outside of the displacements in the record it is an extrapolation."
    )
    band = Band([], [], [], MUTED, 0.4, "fitted, with 95 % band")
    return drawn(CaptionedFigure("springs", title, caption), rows, 1.75, keys=[band])


def _excitation(found: Calibration) -> CaptionedFigure:
    shown, rows = found.excited[:_MOST_ROWS], []
    reach = 1.25 * max(each.peak for each in shown)
    for colour, each in zip(COLOURS, shown, strict=False):
        limits = either_side(each.limit, colour=LIMIT, width=1.1) if each.limit < reach else []
        at = each.amplitudes > 1e-3 * each.amplitudes.max()
        f, size = each.frequencies[at], _MILLI * each.amplitudes[at]
        stems = Line(np.repeat(f, 3), np.column_stack([0.0 * f, size, np.nan * f]).ravel(), colour, 1.6)
        part = percent(each.peak / each.limit)
        use = f"peak {each.peak:.3g} {each.unit}, {part} of the limit; crest factor {each.peak / each.rms:.2f}"
        rows.append([
            Panel([Line(each.times, each.values, colour, 0.8), *limits],
                  style.with_unit(style.symbol(each.name), each.unit), "time (s)", (0.0, each.times[-1]),
                  (-reach, reach), note=use),
            Panel([stems], f"amplitude (m{each.unit})", "frequency (Hz)", (0.0, 1.08 * HIGHEST),
                  (0.0, 1.25 * float(size.max())), ticks=3, note=f"{len(each.lines)} lines"),
        ])  # fmt: skip
    caption = (
        "One period of the multisine of each actuator in the record that was fitted, with phases for the least crest "
        "factor, and its lines, which no other actuator has; in the unseen record the lines are others."
    )
    return drawn(CaptionedFigure("excitation", "Excitation", caption), rows, 1.15, widths=(4.4, 2.6))


def _beside(axes: Axes, ends: Sequence[tuple[float, str, str]]) -> None:
    """Name levels at the right of a logarithmic axis, each near its level, none on another."""
    figure = axes.figure
    assert isinstance(figure, Figure)  # noqa: S101  # for the type checker: these axes lie in no sub-figure
    height = float(figure.get_size_inches()[1] * axes.get_position().height)
    low, high = np.log(axes.get_ylim())
    order = sorted(ends)
    y = np.array([height * (np.log(max(level, 1e-300)) - low) / (high - low) for level, _, _ in order])
    y = np.clip(y, 0.0, height)
    for _ in range(50):  # push neighbours apart until none touch
        gap = np.diff(y)
        close = np.flatnonzero(gap < _APART - 1e-9)
        if not len(close):
            break
        for i in close:
            lift = 0.5 * (_APART - (y[i + 1] - y[i]))
            y[i], y[i + 1] = y[i] - lift, y[i + 1] + lift
    for place, (_, text, colour) in zip(y, order, strict=True):
        words = short(text.replace("_", " "), _LETTERS)
        axes.annotate(in_figure(words), (1.0, place / height), (6, 0), "axes fraction", "offset points", va="center",
                      fontsize=SIZE - 1.5, color=colour)  # fmt: skip


def _range(curve: Curve, straight: style.Series) -> tuple[float, float]:
    """Range of the curves less a straight line, where the record has been."""
    inside = (curve.displacement >= curve.low) & (curve.displacement <= curve.high)
    values = np.concatenate([(c - straight)[inside] for c in (curve.force, curve.declared, curve.linear)])
    values = values[np.isfinite(values)]
    pad = 0.25 * float(np.ptp(values))
    return float(values.min()) - pad, float(values.max()) + pad


def _unit(found: Calibration, sensor: str) -> str:
    return found.twin.declaration.sensors[sensor].unit


def _reading(found: Calibration, sensor: str) -> str:
    return style.with_unit(style.symbol(sensor), _unit(found, sensor))
