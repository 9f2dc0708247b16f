"""Report of a calibration: one self-contained HTML page with its figures beside it.

Source of the numbers of the document that are set beside a calibration's: Rijlaarsdam (2008), Tables 4.3 and 4.5.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from masking.display import palette
from masking.inference.procedures.calibration_findings import (
    ALIKE,
    NAMES,
    PAGE,
    Calibration,
    Curve,
    Stage,
    reached,
)
from masking.model.declaration.quantities import number, percent, quantity, with_deviation
from masking.model.declaration.units import pretty
from masking.reports import html, one_page, panels, style
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.panels import Band, Level, Line, Panel, Span, drawn, either_side
from masking.reports.style import COLOURS, GRID, INK, LIMIT, MUTED, CaptionedFigure
from masking.reports.text import capital, listed, short

_LACKS = 1.5  # times the noise: an error from here on is reported as something that the model lacks
_MISSED = 1e-4  # of the samples of a record, from which missed ones are reported
_FAR = 3.0  # deviations by which a value is reported to differ from the plant file's
_STRONG = 0.95  # correlation from which a pair of parameters is reported
_PAIRS = 5  # of them, at most
# The real rig, by its linear model: multisine and steps (Table 4.3), free motion of the coupled system (Table 4.5).
_DOCUMENT: Final = (
    ("the document, Table 4.3", "multisine", "0.0649", "0.1025", "0.2267"),
    ("", "steps", "0.0666", "0.0628", "0.2796"),
    ("the document, Table 4.5", "free motion", "0.0545", "0.1307", "0.0869"),
)
_AUTHOR = "Rijlaarsdam"
_MOST_ROWS = len(COLOURS)
_SHOWN = 10.0  # s of the unseen record in which single swings can be distinguished apart
_WINDOW = 0.5  # s over which a residual's rms is taken
_BINS_PER_DECADE = 14  # of a spectrum
_LETTERS = 40  # of the name of a stage
_FLOOR = 0.45  # times the noise: where an axis of residuals ends
_MILLI = 1e3


def save(found: Calibration) -> None:
    """Write the page and its figures into the calibration's folder; a `RecordError` says that it cannot be written."""
    twin, figures = found.twin, _figures(found)
    fit, rows = found.best.fit, _parameters(found)
    before = np.array([_declared(found, name) for name in fit.names])
    has_document = _AUTHOR in (twin.declaration.source or "") and len(found.floor) == len(_DOCUMENT[0]) - 2
    limits = twin.declaration.limits.coordinates
    html.save(
        found.folder / PAGE,
        "calibration",
        figures,
        names={*twin.sensors, *twin.actuators, *found.best.fit.names, *twin.model.coordinates},
        title=f"Calibration: {twin.declaration.name}",
        result=found,
        sentence=sentence(found),
        spoken=_spoken,
        cautions=_cautions(found),
        lacks=_LACKS,
        document=list(_DOCUMENT) if has_document else [],
        alike=ALIKE,
        ports=twin.declaration.actuators or twin.base.inputs,
        reached=reached(twin, found.records.fit),
        units={what.text: (limit.unit, twin.size(limit.unit)) for what, limit in limits.items()},
        parameters=rows,
        differing=0 if fit.doubt else int((np.abs(fit.values - before) > _FAR * fit.std)[fit.std > 0.0].sum()),
        far=f"{_FAR:g}",
        has_marks=any(row[2].endswith("*") for row in rows),
        lumped=_lumped(found),
        parameter_notes=[*found.best.fit.remarks, *_pairs(found)],
        remarks=[f"{one.title}. {one.caption}" for one in figures if one.figure is None],
        records=NAMES,
        written=[PAGE, *(f"{one.name}.png" for one in figures if one.figure is not None)],
    )


def sheet(found: Calibration) -> Sheet:
    """What one page says of a calibration: the errors of the simplest model, and of the one that is written."""
    best = found.best
    models = {_spoken(stage): stage.fit.validation for stage in (found.stages[0], best)}
    sections = {one_page.FOUND: [sentence(found)], one_page.LIMITS: _cautions(found)}
    return Sheet(
        title=f"Calibration: {found.twin.declaration.name}",
        subject=[", ".join(found.twin.declaration.files)],
        tiles=[Tile(f"error in {name}, unseen", percent(chi)) for name, chi in best.fit.validation.items()],
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite({**models, panels.NOISE: found.unseen_floor}),
        errors_title="Simulation error, unseen record",
        page=PAGE,
    )


def sentence(found: Calibration) -> str:
    """Errors of the best model in the unseen record, beside the noise."""
    chi, floor = found.best.fit.validation, found.unseen_floor
    errors, noise = (listed([percent(part) for part in parts.values()]) for parts in (chi, floor))
    reads = "reads" if len(chi) == 1 else "read"
    return (
        f"{_spoken(found.best)} reproduces an unseen multisine to {errors} of what {listed(list(chi))} {reads}; the "
        f"noise floor is {noise}."
    )


def _cautions(found: Calibration) -> list[str]:
    """Sentences on what makes the result less than it could be; none where all is well."""
    fit = found.best.fit
    far = [name for name, chi in fit.validation.items() if chi > _LACKS * found.unseen_floor[name]]
    sentences = []
    if far:
        times = listed([f"{fit.validation[name] / found.unseen_floor[name]:.2g}" for name in far])
        sentences.append(
            f"In {listed(far)} the error is {times} times that of the noise: the model misses something that "
            "the rig does. The spectrum of the residual shows where; add an effect to the plant file, or try another "
            "--model."
        )
    missed = found.records.missed
    if max(missed.values()) > _MISSED * len(found.records.fit):
        counts = ", ".join(f"{count} in {name}" for name, count in missed.items())
        sentences.append(
            f"Samples were missed ({counts}) and are interpolated: errors and noise are larger than the rig's own. A "
            "computer with less else to do misses fewer."
        )
    sentences += [f"{capital(note)}." for note in fit.remarks]
    return sentences


def _parameters(found: Calibration) -> list[list[str]]:
    """Values and deviations beside those of the plant file."""
    fit, rows = found.best.fit, []
    model = fit.twin.model.declaration.parameters
    for name, value, std in zip(fit.names, fit.values, 0.0 * fit.std if fit.doubt else fit.std, strict=True):
        before, entry = _declared(found, name), model.get(name)
        part = f"{100.0 * (value / before - 1.0):+.2g} %" if np.isfinite(before) and before else ""
        by = abs(value - before) / std if std > 0.0 else np.nan
        mark = "*" * (name not in found.twin.parameter_names)
        numbers = [with_deviation(value, std, ""), _plain(before) + mark, part, _plain(by, 2)]
        unit, meaning = (pretty(entry.unit), entry.meaning) if entry else ("", "")
        rows.append([name, *map(_minus, numbers), unit, meaning])
    return rows


def _lumped(found: Calibration) -> str:
    """Kinds of effects of the plant file that the fitted model does not name, so that values hold them."""
    fitted = {effect.path for effect in found.best.fit.twin.effects}
    kinds = {
        effect.entry.spoken
        for effect in found.twin.effects
        if effect.enabled and effect.entry.where == "element" and effect.path not in fitted
    }
    return listed(sorted(kinds)) if kinds else ""


def _declared(found: Calibration, name: str) -> float:
    """Parameter as the plant file has it, or else as the fitted model declares it; NaN if neither does."""
    if name in found.twin.parameter_names:
        return float(found.twin.parameter_value(name))
    declared = found.best.fit.twin.base.parameters.get(name)
    value = None if declared is None else declared.value
    return float(value) if isinstance(value, int | float) else np.nan


def _pairs(found: Calibration) -> list[str]:
    """Pairs of parameters that are hardest to separate."""
    fit = found.best.fit
    correlation = np.tril(fit.correlation, -1)
    order = np.argsort(-np.abs(correlation), axis=None)[:_PAIRS]
    strong = [(i, j) for i, j in zip(*np.unravel_index(order, correlation.shape), strict=True)]
    pairs = [f"{fit.names[j]} and {fit.names[i]} {correlation[i, j]:.3f}" for i, j in strong
            if abs(correlation[i, j]) > _STRONG]  # fmt: skip
    more = int((np.abs(correlation) > _STRONG).sum()) - len(pairs)
    rest = f", and {more} more pairs" if more > 0 else ""
    return [f"Correlations above {_STRONG:g}: {', '.join(pairs)}{rest}; these are known better together than by "
            "themselves."] if pairs else []  # fmt: skip


def _spoken(stage: Stage) -> str:
    """Name of a stage that can begin a sentence."""
    model = Path(stage.fit.twin.declaration.model).stem
    if not stage.name.startswith("with "):
        return model
    return f"{model} with {listed(stage.name.removeprefix('with ').split(', '))}".replace("_friction", " friction")


def _plain(value: float, digits: int = 5) -> str:
    return number(value, digits) if np.isfinite(value) else ""


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}") if "e-" not in text else text


def _figures(found: Calibration) -> list[CaptionedFigure]:
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
        noise, lines = record.noise[i], list[Line]()
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            sums = np.concatenate([[0.0], np.cumsum(left[:, i] ** 2)])
            rms = np.sqrt((sums[count:] - sums[:-count]) / count)
            t = np.linspace(0.5 * count, 0.5 * count + len(rms) - 1.0, len(rms)) / record.rate
            lines.append(Line(t, rms, colour, key=_named(stage)))
        highest = max(noise, *(float(np.max(line.y)) for line in lines))
        band = Span(_FLOOR * noise, noise, palette.NOISE, "noise", axis="y", opacity=1.0)
        rows.append([
            Panel([*lines, band], f"rms residual of {_reading(found, name)}", "time (s)",
                  (0.0, len(record) / record.rate), (_FLOOR * noise, 1.6 * highest), log="y",
                  note=f"noise {quantity(noise, _unit(found, name), 2)}")
        ])  # fmt: skip
    caption = (
        f"Residual of each model on the unseen record: the rms of measured less simulated over {_WINDOW:g} s. The grey "
        "band is white noise in the readings, estimated where their spectra are quietest; a line at its edge is at the "
        "noise floor."
    )
    return drawn(CaptionedFigure("residuals", "Residual of each model", caption), rows, 1.45)


def _spectra(found: Calibration) -> CaptionedFigure:
    record, rows = found.records.unseen, list[list[Panel]]()
    for i, name in enumerate(found.twin.sensors[:_MOST_ROWS]):
        level = panels.noise_density(record.noise[i], record.rate)
        f, whole = panels.spectral_density(record.readings[:, i], record.rate, 1, _BINS_PER_DECADE)
        lines = [Line(f, whole, MUTED, 1.0, "measured", opacity=0.75)]
        for colour, (stage, left) in zip(COLOURS, found.residuals.items(), strict=False):
            _, of = panels.spectral_density(left[:, i], record.rate, 1, _BINS_PER_DECADE)
            lines.append(Line(f, of, colour, key=_named(stage)))
        rows.append([
            Panel([*lines, Level(level, key="white noise"), Span(f[0], found.records.highest, GRID)],
                  f"{style.symbol(name)} ({_unit(found, name)}/√Hz)", "frequency (Hz)", (f[0], f[-1]),
                  (0.3 * level, 2.0 * float(whole.max())), log="xy",
                  title="" if rows else f"excited up to {found.records.highest:g} Hz")
        ])  # fmt: skip
    caption = (
        "Amplitude density of the unseen record (grey line) and of the residual of each model. The dashed line is the "
        "density of white noise as large as that of the readings; the band is where the rig was excited. A residual "
        "above the line there is an effect that the model does not have."
    )
    return drawn(CaptionedFigure("spectra", "Spectra of the residuals", caption), rows, 1.6)


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
            Panel([stems], f"amplitude (m{each.unit})", "frequency (Hz)", (0.0, 1.08 * found.records.highest),
                  (0.0, 1.25 * float(size.max())), ticks=3, note=f"{len(each.lines)} lines"),
        ])  # fmt: skip
    caption = (
        "One period of the multisine of each actuator in the record that was fitted, with phases for the least crest "
        "factor, and its lines, which no other actuator has; in the unseen record the lines are others."
    )
    return drawn(CaptionedFigure("excitation", "Excitation", caption), rows, 1.15, widths=(4.4, 2.6))


def _named(stage: str) -> str:
    """Name of a stage in a legend."""
    return short(stage.replace("_", " "), _LETTERS)


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
