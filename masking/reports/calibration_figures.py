"""Figures of a calibration: the unseen record, the residual of each model, springs, and the excitation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from masking.inference.procedures.calibration_findings import HIGHEST, Calibration, Curve, Excited
from masking.model.declaration.quantities import percent, quantity
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.style import COLOURS, DASHED, GRID, INK, LIMIT, MUTED, SIZE, CaptionedFigure
from masking.reports.text import short

_MOST_ROWS = len(COLOURS)
_SHOWN = 10.0  # s of the unseen record in which single swings can be distinguished apart
_WINDOW = 0.5  # s over which a residual's rms is taken
_BINS_PER_DECADE = 14  # of a spectrum
_WORDS = 1.72  # inches at the right for the names of lines
_LETTERS = 32  # of such a name
_APART = 0.16  # inches between these names
_FLOOR = 0.45  # times the noise: where an axis of residuals ends
_NOISE: Final = "#c9ced6"
_MILLI = 1e3


def figures(found: Calibration) -> list[CaptionedFigure]:
    """Draw every figure of the report, in its order."""
    return [_unseen(found), _residuals(found), _spectra(found), _springs(found), _excitation(found)]


def _unseen(found: Calibration) -> CaptionedFigure:
    record, best = found.records.unseen, found.best
    names = found.twin.sensors[:_MOST_ROWS]
    t = np.arange(len(record)) / record.rate
    end = len(record) / record.rate
    part = t >= end - _SHOWN
    model = record.readings - found.residuals[best.name]
    figure, rows = style.sheet([1.25] * len(names))
    for i, (name, axes) in enumerate(zip(names, rows, strict=True)):
        axes.plot(*style.thin(t[part], record.readings[part, i]), color=COLOURS[i], lw=2.6, alpha=0.45)
        axes.plot(*style.thin(t[part], model[part, i]), color=INK, lw=0.9, ls=DASHED)
        reach = 1.12 * float(np.abs(record.readings[part, i]).max())
        axes.set(xlim=(max(0.0, end - _SHOWN), end), ylim=(-reach, reach), ylabel=_reading(found, name))
        parts.note(axes, f"error {percent(best.fit.validation[name])}, noise alone {percent(found.unseen_floor[name])}")
    rows[-1].set_xlabel("time (s)")
    handles = [
        Line2D([], [], color=MUTED, lw=2.6, alpha=0.6, label="measured"),
        parts.line_key("simulated, fitted to another record", INK, 0.9, dashed=True),
    ]
    parts.legend(figure, None, handles)
    span = f"the last {_SHOWN:g} s of {end:g} s" if end > _SHOWN else "all of it"
    caption = (
        f"The record that was not fitted, {span}, and its simulation. "
        f"{_meanings(found, names)} The error is (4.12) of the source document, over the whole record."
    )
    return CaptionedFigure("unseen", "Measured and simulated", caption, figure)


def _residuals(found: Calibration) -> CaptionedFigure:
    record, names = found.records.unseen, found.twin.sensors[:_MOST_ROWS]
    count = max(1, round(_WINDOW * record.rate))
    figure, rows = style.sheet([1.45] * len(names), top=style.BARE)
    _narrow(rows)
    for i, (name, axes) in enumerate(zip(names, rows, strict=True)):
        noise = record.noise[i]
        ends, highest = [], noise
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            rms = _running_rms(left[:, i], count)
            t = np.linspace(0.5 * count, 0.5 * count + len(rms) - 1.0, len(rms)) / record.rate
            axes.plot(*style.thin(t, rms), color=colour, lw=1.4)
            ends.append((float(np.sqrt((left[:, i] ** 2).mean())), stage, colour))
            highest = max(highest, float(rms.max()))
        parts.logarithmic(axes, "y", 6)
        axes.set_ylim(_FLOOR * noise, 1.6 * highest)
        axes.axhspan(_FLOOR * noise, noise, color=_NOISE, lw=0, zorder=0)
        axes.set(xlim=(0.0, len(record) / record.rate), ylabel=f"rms residual of {_reading(found, name)}")
        _beside(axes, [*ends, (0.67 * noise, f"noise {quantity(noise, _unit(found, name), 2)}", MUTED)])
    rows[-1].set_xlabel("time (s)")
    caption = (
        f"Residual of each model on the unseen record: the rms of measured less simulated over {_WINDOW:g} s. The grey "
        "band is white noise in the readings, estimated where their spectra are quietest; a line at its edge is at the "
        "noise floor."
    )
    return CaptionedFigure("residuals", "Residual of each model", caption, figure)


def _spectra(found: Calibration) -> CaptionedFigure:
    record, names = found.records.unseen, found.twin.sensors[:_MOST_ROWS]
    figure, rows = style.sheet([1.6] * len(names), top=style.NOTE)
    _narrow(rows)
    for i, (name, axes) in enumerate(zip(names, rows, strict=True)):
        level = float(record.noise[i] * np.sqrt(2.0 / record.rate))
        f, whole = parts.spectral_density(record.readings[:, i], record.rate, 1, _BINS_PER_DECADE)
        axes.plot(f, whole, color=MUTED, lw=1.0, alpha=0.75)
        highest = float(whole.max())
        ends = [(float(whole[np.searchsorted(f, HIGHEST) - 1]), "measured", MUTED)]
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            f, of = parts.spectral_density(left[:, i], record.rate, 1, _BINS_PER_DECADE)
            axes.plot(f, of, color=colour, lw=1.4)
            ends.append((float(np.sqrt((of[f <= HIGHEST] ** 2).mean())), stage, colour))
        axes.axvspan(f[0], HIGHEST, color=GRID, alpha=0.45, lw=0, zorder=0)
        axes.axhline(level, color=INK, lw=0.9, ls=DASHED, zorder=3)
        parts.logarithmic(axes, "x", 8)
        parts.logarithmic(axes, "y", 6)
        axes.set_ylim(0.3 * level, 2.0 * highest)
        axes.set(xlim=(f[0], f[-1]), ylabel=f"{style.symbol(name)} ({_unit(found, name)}/√Hz)")
        _beside(axes, [*ends, (level, "white noise", INK)])
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    parts.note(rows[0], f"excited up to {HIGHEST:g} Hz", side="left")
    rows[-1].set_xlabel("frequency (Hz)")
    caption = (
        "Amplitude density of the unseen record (grey line) and of the residual of each model. The dashed line is the "
        "density of white noise as large as that of the readings; the band is where the rig was excited. A residual "
        "above the line there is an effect that the model does not have."
    )
    return CaptionedFigure("spectra", "Spectra of the residuals", caption, figure)


def _springs(found: Calibration) -> CaptionedFigure:
    curves, title = found.curves[:_MOST_ROWS], "Springs"
    if not curves:
        return style.absent("springs", title, "every spring of the best model is straight")
    figure, rows = style.panels(len(curves), 1.75, (3.35, 3.6))
    for colour, curve, (left, right) in zip(COLOURS, curves, rows, strict=False):
        by, x_unit = (_MILLI, "mm") if curve.measured == "m" else (1.0, curve.measured)
        x, unit = by * curve.displacement, curve.unit.replace("**2", "²")
        straight = np.asarray(np.polyval(np.polyfit(curve.displacement, curve.linear, 1), curve.displacement))
        for axes, of in ((left, np.zeros(len(x))), (right, straight)):
            axes.axvspan(by * curve.low, by * curve.high, color=GRID, alpha=0.45, lw=0, zorder=0)
            low, high = curve.force - of - 2.0 * curve.std, curve.force - of + 2.0 * curve.std
            axes.fill_between(x, low, high, color=colour, alpha=0.25, lw=0)
            axes.plot(x, curve.force - of, color=colour, lw=1.8)
            axes.plot(x, curve.declared - of, color=INK, lw=0.9, ls=DASHED)
            axes.plot(x, curve.linear - of, color=MUTED, lw=0.9)
            axes.set(xlim=(x[0], x[-1]))
        for axes in (left, right) if curve is curves[-1] else ():
            axes.set_xlabel(style.with_unit("displacement", x_unit))
        left.set_ylabel(f"{style.symbol(curve.element)} ({unit})")
        right.set_ylabel(f"less the line ({unit})")
        inside = (curve.displacement >= curve.low) & (curve.displacement <= curve.high)
        _range(right, curve, straight, inside)
        parts.note(left, curve.meaning, side="left")
    handles: list[Line2D | Patch] = [
        Patch(color=MUTED, alpha=0.4, lw=0, label="fitted, with 95 % band"),
        parts.line_key("the plant file said", INK, 0.9, dashed=True),
        parts.line_key(found.stages[0].name, MUTED, 0.9),
        Patch(color=GRID, alpha=0.6, lw=0, label="displacements in the record"),
    ]
    parts.legend(figure, None, handles)
    caption = (
        "Force of each spring of the best model at rest, per moving mass, over its displacement: left the whole, right "
        "less the straight line of the simplest model. The band is twice the standard deviation that follows from the "
        "covariance of the parameters; outside of the displacements in the record it is an extrapolation."
    )
    return CaptionedFigure("springs", title, caption, figure)


def _excitation(found: Calibration) -> CaptionedFigure:
    shown = found.excited[:_MOST_ROWS]
    figure, rows = style.panels(len(shown), 1.15, (4.4, 2.6), top=0.34)
    reach = 1.25 * max(each.peak for each in shown)
    for colour, each, (left, right) in zip(COLOURS, shown, rows, strict=False):
        left.plot(*style.thin(each.times, each.values), color=colour, lw=0.8)
        left.set(
            xlim=(0.0, each.times[-1]), ylim=(-reach, reach), ylabel=style.with_unit(style.symbol(each.name), each.unit)
        )
        if each.limit < reach:
            for level in (-each.limit, each.limit):
                left.axhline(level, color=LIMIT, lw=1.1, ls=(0, (6, 2)))
        parts.note(left, _use(each))
        at = each.amplitudes > 1e-3 * each.amplitudes.max()
        right.vlines(each.frequencies[at], 0.0, _MILLI * each.amplitudes[at], color=colour, lw=1.6)
        right.set(xlim=(0.0, 1.08 * HIGHEST), ylabel=f"amplitude (m{each.unit})")
        right.yaxis.set_major_locator(MaxNLocator(3))
        right.set_ylim(0.0, 1.25 * _MILLI * float(each.amplitudes.max()))
        parts.note(right, f"{len(each.lines)} lines")
    for axes, label in zip(rows[-1], ("time (s)", "frequency (Hz)"), strict=True):
        axes.set_xlabel(label)
    caption = (
        "One period of the multisine of each actuator in the record that was fitted, with phases for the least crest "
        "factor, and its lines, which no other actuator has; in the unseen record the lines are others."
    )
    return CaptionedFigure("excitation", "Excitation", caption, figure)


# ---- parts


def _use(each: Excited) -> str:
    part = percent(each.peak / each.limit)
    return f"peak {each.peak:.3g} {each.unit}, {part} of the limit; crest factor {each.peak / each.rms:.2f}"


def _running_rms(values: style.Series, count: int) -> style.Series:
    sums = np.concatenate([[0.0], np.cumsum(values**2)])
    found: style.Series = np.sqrt((sums[count:] - sums[:-count]) / count)
    return found


def _narrow(rows: Sequence[Axes]) -> None:
    """Leave room for words at the right."""
    for axes in rows:
        box = axes.get_position()
        axes.set_position((box.x0, box.y0, box.width - (_WORDS - style.RIGHT) / style.WIDTH, box.height))


def _beside(axes: Axes, ends: Sequence[tuple[float, str, str]]) -> None:
    """Write names at the right of a logarithmic axis, each near its level, none on another."""
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
        axes.annotate(words, (1.0, place / height), (6, 0), "axes fraction", "offset points", va="center",
                      fontsize=SIZE - 1.5, color=colour)  # fmt: skip


def _range(axes: Axes, curve: Curve, straight: style.Series, inside: NDArray[np.bool_]) -> None:
    """Set the range of y by the curves where the record has been."""
    drawn = np.concatenate([(c - straight)[inside] for c in (curve.force, curve.declared, curve.linear)])
    drawn = drawn[np.isfinite(drawn)]
    pad = 0.25 * float(np.ptp(drawn))
    axes.set_ylim(float(drawn.min()) - pad, float(drawn.max()) + pad)


def _unit(found: Calibration, sensor: str) -> str:
    return found.twin.declaration.sensors[sensor].unit


def _reading(found: Calibration, sensor: str) -> str:
    return style.with_unit(style.symbol(sensor), _unit(found, sensor))


def _meanings(found: Calibration, names: Sequence[str]) -> str:
    meanings = [f"{name}: {meaning}" for name in names if (meaning := found.twin.declaration.sensors[name].meaning)]
    return f"{'; '.join(meanings)}." if meanings else ""
