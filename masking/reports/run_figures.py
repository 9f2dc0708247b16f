"""Figures of a run: displacements, other coordinates, synchronisation, inputs, masking error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from masking.analysis.synchronisation import principal, running_peak
from masking.model.declaration.quantities import percent
from masking.reports import panels, style
from masking.reports.panels import Band, Level, Line, Panel, Part, Range, bars, drawn, either_side
from masking.reports.run_study import SUM_WINDOW_PERIODS, InputUse, Study
from masking.reports.style import COLOURS, DASHED, INK, LIMIT, MUTED, SIZE, CaptionedFigure, Series
from masking.reports.text import capital

_ENVELOPE_PERIODS = 60  # from this many periods on single ones cannot be distinguished apart
_ZOOM_PERIODS = 6
_BAR, _WORDS, _VALUES = 0.27, 1.75, 0.98  # inches: height of a bar, room for words beside it and for its value
_WORSE = 1.02  # of chi: from here on a run is marked as worse
_SHOWN_DEMAND = 3.0  # times the limit: what is demanded beyond that is drawn there
_NEAR_LIMIT = 0.15  # of its limit, from which an input's axis shows it
_FEW = 20  # samples, up to which each is marked
_LEAST = 1e-300  # of what a logarithmic axis shows
_MOST_ROWS = len(COLOURS)


def figures(study: Study) -> list[CaptionedFigure]:
    """Figures of the report, in its order."""
    wanted = {_budget: bool(study.recording.manifest.get("observer")), _passive: bool(study.passive)}
    return [draw(study) for draw in _FIGURES if wanted.get(draw, True)]


def _displacements(study: Study) -> CaptionedFigure:
    names, title = study.oscillators[:_MOST_ROWS], "Displacements"
    if not names:
        return style.absent("displacements", title, "the record holds no coordinates")
    units = {name: study.unit(f"{study.prefix}.{name}") for name in names}
    is_alike = len({*units.values()}) == 1
    reach = symmetric([series for name in names for series in _series(study, name)]) if is_alike else None
    rows = [[_motion(study, name, colour, reach)] for name, colour in zip(names, COLOURS, strict=False)]
    heights = [1.15] * len(names)
    if study.tau[-1] - study.tau[0] > 2.5 * _ZOOM_PERIODS * study.period:  # False for a NaN
        span = _ZOOM_PERIODS * study.period
        first, last = study.whole.span
        head = study.between(None, first / study.time_scale + span)
        tail = study.between(last / study.time_scale - span, None)
        for unit in dict.fromkeys(units.values()):
            alike = {n: c for n, c in zip(names, COLOURS, strict=False) if units[n] == unit}
            label = "" if is_alike else f"({unit or '1'})"
            rows.append([_zoom(part, alike, text, label) for part, text in ((head, "first"), (tail, "last"))])
            heights.append(1.9)
    more = panels.first_of(len(names), len(study.oscillators))
    words = CaptionedFigure("displacements", title, _meanings(study, names) + more + _band_words(study))
    return drawn(words, rows, heights, keys=_keys(study, names, COLOURS))


def _zoom(part: Study, colours: Mapping[str, str], which: str, label: str) -> Panel:
    """First or last periods of coordinates, each with its colour."""
    lines = []
    for name, colour in colours.items():
        lines.append(Line(part.tau, part.motion(name), colour, 1.6))
        ideal = part.ideal(name)
        lines += [] if ideal is None else [Line(part.tau, ideal, INK, 0.9, is_dashed=True)]
    ends, reach = (part.tau[0], part.tau[-1]), symmetric([part.motion(name) for name in colours])
    return Panel(lines, label, time_label(part), ends, reach, title=f"{which} {_ZOOM_PERIODS} periods")


def _others(study: Study) -> CaptionedFigure:
    names, title = study.others[:_MOST_ROWS], "Other coordinates"
    if len(study.others) == 1 and study.meaning(study.others[0]):
        title = capital(study.meaning(study.others[0]))
    if not names:
        return style.absent("others", title, "every coordinate is among the displacements")
    rows = [[_motion(study, name, COLOURS[2])] for name in names]
    caption = _meanings(study, names) + _band_words(study)
    keys = _keys(study, names if len(names) == 1 else (), (COLOURS[2],))
    return drawn(CaptionedFigure("others", title, caption), rows, 1.5 if len(names) == 1 else 1.15, keys=keys)


def _passive(study: Study) -> CaptionedFigure:
    names, rows = study.passive[:_MOST_ROWS], []
    for name in names:
        series = study.recording[f"rig.{name}"]
        label = style.with_unit(style.symbol(name), study.unit(f"rig.{name}"))
        rows.append([_over_record(study, trace(study, series, COLOURS[3]), label, symmetric([series]))])
    words = str((study.recording.manifest.get("passive") or {}).get("words") or "")
    caption = f"What no virtual coordinate stands for, as the rig moved it. {capital(words)}."
    height = 1.5 if len(names) == 1 else 1.15
    return drawn(CaptionedFigure("passive", "Passive coordinates", caption), rows, height)


def _synchronisation(study: Study) -> CaptionedFigure:
    title = "Synchronisation"
    if study.no_phase:
        return style.absent("synchronisation", title, study.no_phase)
    several = len(study.pairs) > 1
    phases: list[Part] = []
    for pair, colour in zip(study.pairs, COLOURS if several else (INK,), strict=False):
        tau, phase = style.thin(study.tau, principal(pair.series) / np.pi)
        jumps = np.flatnonzero(np.abs(np.diff(phase)) > 1) + 1
        key = f"{style.symbol(pair.first)} against {style.symbol(pair.second)}" if several else ""
        phases.append(Line(np.insert(tau, jumps, np.nan), np.insert(phase, jumps, np.nan), colour, 1.2, key, bins=0))

    def finish(axes: Axes) -> None:
        for level, text in ((0.0, "in-phase"), (1.0, "anti-phase")):
            axes.axhline(level, color=MUTED, lw=0.8, ls=DASHED, zorder=1)
            axes.annotate(text, (0.995, level), (0, 3), ("axes fraction", "data"), "offset points", ha="right",
                          fontsize=SIZE - 1, color=MUTED)  # fmt: skip
        axes.set_yticks([-0.5, 0.0, 0.5, 1.0, 1.5], labels=["\N{MINUS SIGN}π/2", "0", "π/2", "π", "3π/2"])

    above = _over_record(study, phases, "phase difference (rad)", (-0.5, 1.5), finish)
    caption = "Phase difference from the analytic signals (Hilbert transform)."
    if study.sum_peak is None:
        words = CaptionedFigure("synchronisation", title, f"{caption} Of the sum there is none: {study.no_sum}.")
        return drawn(words, [[above]], 1.7)
    total = " + ".join(style.symbol(name) if name != "…" else name for name in _few(study.oscillators))
    label = style.with_unit(f"peak |{total}|", study.unit(f"{study.prefix}.{study.oscillators[0]}"))
    below = f"Below: largest |{' + '.join(_few(study.oscillators))}| over the {SUM_WINDOW_PERIODS} periods before."
    caption = f"Above: {caption[0].lower()}{caption[1:]} {below}"
    rows = [[above], [_peaks(study, [(study.sum_peak, INK, "")], label)]]
    return drawn(CaptionedFigure("synchronisation", title, caption), rows, 1.7)


def _inputs(study: Study) -> CaptionedFigure:
    uses, title = study.inputs[:_MOST_ROWS], "Inputs against their limits"
    if not uses:
        return style.absent("inputs", title, "the record holds no inputs")
    hidden = [use.name for use in uses if use.limit is not None and not _is_near(use)]
    lines = "Dashed red lines are the limits. " if any(map(_is_near, uses)) else ""
    lines += "Thin orange lines are what was demanded. " if any(use.is_cut for use in uses) else ""
    far = f"The limits of {', '.join(hidden)} lie far outside the axes." if hidden else ""
    more = panels.first_of(len(uses), len(study.inputs))
    words = CaptionedFigure("inputs", title, f"{lines}{far}{more}".strip() or "The inputs of the plant.")
    return drawn(words, [[_input(study, use)] for use in uses], 1.15)


def _is_near(use: InputUse) -> bool:
    return use.used is not None and use.used >= _NEAR_LIMIT


def _input(study: Study, use: InputUse) -> Panel:
    shown, reach = trace(study, use.series, COLOURS[0]), [use.series]
    if use.demanded is not None and use.is_cut:
        most = _SHOWN_DEMAND * (use.limit or use.peak)
        demanded = np.clip(use.demanded, -most, most)
        shown = [*trace(study, demanded, COLOURS[5], thin_line=True), *shown]
        reach.append(demanded)
    words = "no limit declared"
    if use.limit is not None:
        words = f"peak {percent(use.used or 0.0)} of {use.limit:g} {use.unit}".rstrip()
        if use.is_cut:
            words = f"demanded {percent(use.demand / use.limit)}, applied {words.removeprefix('peak ')}"
        if _is_near(use):
            reach.append(np.array([use.limit]))
            shown += either_side(use.limit, colour=LIMIT, width=1.1)
    label = style.with_unit(style.symbol(use.name), use.unit)
    panel = _over_record(study, shown, label, symmetric(reach))
    return replace(panel, note=words, note_colour=LIMIT if use.is_exceeded or use.is_cut else MUTED)


def _masking_error(study: Study) -> CaptionedFigure:
    title = "Masking error"
    compared = [(name, study.ideal(name)) for name in study.coordinates[:_MOST_ROWS]]
    errors = {n: np.abs(study.motion(n) - ideal) for n, ideal in compared if ideal is not None and n in study.chi}
    if not errors:
        return style.absent("masking_error", title, "the record holds no ideal motion to compare with")
    if not any(np.any(error) for error in errors.values()):
        return style.absent("masking_error", title, "virtual and ideal are equal in every digit recorded")
    if math.isfinite(study.period):
        errors = {n: running_peak(study.tau, error, study.period) for n, error in errors.items()}
    units = {n: study.unit(f"virtual.{n}") for n in errors}
    common = units[next(iter(errors))] if len({*units.values()}) == 1 else ""
    keys = {
        n: style.symbol(n) if unit == common else f"{style.symbol(n)} in {unit or '1'}" for n, unit in units.items()
    }
    peaks = [(error, c, keys[n]) for (n, error), c in zip(errors.items(), COLOURS, strict=False)]
    label = style.with_unit("|virtual \N{MINUS SIGN} ideal|", common)
    caption = "Distance between the masked rig and the virtual system by itself, the largest over the period before."
    return drawn(CaptionedFigure("masking_error", title, caption), [[_peaks(study, peaks, label)]], 2.2)


def _budget(study: Study) -> CaptionedFigure:
    title, found = "What limits the masking error", study.budget
    if not found:
        return style.absent("budget", title, "it was not asked for; 'masking run --budget' finds it out")
    rows, whole = found[1:], found[0].rms
    largest = max((row.rms for row in rows if math.isfinite(row.rms)), default=whole)
    most = 1.08 * min(max(largest, whole), 2.0 * whole) if math.isfinite(whole) and whole > 0.0 else 1.0
    caption = (
        f"{study.recording.manifest['budget']['sentence']} Each bar runs from the masking error of the run, the dashed "
        "line, to that of the same run without one cause: to the left, correcting it helps."
    )
    start = min(whole, most)

    def finish(axes: Axes) -> None:
        for place, row in enumerate(rows):
            colour = COLOURS[0] if row.rms <= whole else COLOURS[1]
            axes.barh(place, min(row.rms, most) - start, left=start, height=0.56, color=colour, zorder=3)
            if row.rms > most:  # an arrow head: the bar goes on
                axes.plot(most, place, ">", color=colour, ms=10, mew=0, clip_on=False, zorder=3)
            is_worse = row.rms > _WORSE * whole
            axes.annotate(_two_digits(row.rms), (1.0, place), (14, 0), ("axes fraction", "data"), "offset points",
                          va="center", fontsize=SIZE - 0.5, color=COLOURS[1] if is_worse else INK)  # fmt: skip
        axes.annotate(f"as it is: {_two_digits(whole)}", (start, 1.0), (0, 4), ("data", "axes fraction"),
                      "offset points", ha="center", fontsize=SIZE - 1, color=MUTED)  # fmt: skip
        axes.axhline(len(rows) - 1.5, color=MUTED, lw=0.8)
        bars(axes, [row.title for row in rows])

    as_it_is, label = Level(start, width=1.1, axis="x"), "masking error χ, rms of the coordinates"
    panel = Panel([as_it_is], "", label, (0.0, most), finish=finish, note=" ")
    words = CaptionedFigure("budget", title, caption)
    return drawn(words, [[panel]], _BAR * (len(rows) + 0.7), left=_WORDS, right=_VALUES)


def _two_digits(value: float) -> str:
    if not math.isfinite(value):
        return "diverges"
    mantissa, _, exponent = f"{value:#.2g}".partition("e")
    return rf"${mantissa}\cdot10^{{{int(exponent)}}}$" if exponent else mantissa


_FIGURES: Final = (_displacements, _others, _passive, _synchronisation, _inputs, _masking_error, _budget)


# ---- parts of a figure


def _series(study: Study, name: str) -> list[Series]:
    """Coordinate as it moved, and as it ideally moves where that was recorded."""
    ideal = study.ideal(name)
    return [study.motion(name)] if ideal is None else [study.motion(name), ideal]


def _motion(study: Study, name: str, colour: str, reach: Range | None = None) -> Panel:
    """Coordinate over the whole record, as it moved and as it ideally moves."""
    label = style.with_unit(style.symbol(name), study.unit(f"{study.prefix}.{name}"))
    lines = trace(study, study.motion(name), colour, study.ideal(name))
    return _over_record(study, lines, label, reach or symmetric(_series(study, name)))


def _over_record(
    study: Study, content: Sequence[Part], label: str, reach: Range, finish: Callable[[Axes], None] | None = None
) -> Panel:
    first, last = study.tau[0], study.tau[-1]
    ends = (first, last if last > first else first + 1.0)
    return Panel(content, label, time_label(study), ends, reach, finish=finish)


def trace(
    study: Study, series: Series, colour: str, ideal: Series | None = None, *, thin_line: bool = False
) -> list[Part]:
    """Series (m,) over the whole record, as a band from trough to crest where its periods are too many to be seen.

    The ideal, if there is one, is drawn over it as a dashed line.
    """
    cycles = _cycles(study)
    if cycles <= _ENVELOPE_PERIODS:
        marker = "o" if len(series) <= _FEW and not thin_line else ""
        shown: list[Part] = [Line(study.tau, series, colour, 0.9 if thin_line else 1.6, marker=marker)]
        return shown + ([] if ideal is None else [Line(study.tau, ideal, INK, 0.9, is_dashed=True)])
    bins = int(min(style.BINS / 2, cycles / 1.5))
    tau, low, high = style.envelope(study.tau, series, bins)
    content: list[Part] = [] if thin_line else [Band(tau, low, high, colour, 0.3)]
    content += [Line(tau, edge, colour, 0.9 if thin_line else 1.3) for edge in (low, high)]
    if ideal is not None:
        tau, *edges = style.envelope(study.tau, ideal, bins)
        content += [Line(tau, edge, INK, 0.9, is_dashed=True) for edge in edges]
    return content


def _cycles(study: Study) -> float:
    return float((study.tau[-1] - study.tau[0]) / study.period) if math.isfinite(study.period) else 0.0


def _band_words(study: Study) -> str:
    return " Each band runs from trough to crest." if _cycles(study) > _ENVELOPE_PERIODS else ""


def _peaks(study: Study, series: Sequence[tuple[Series, str, str]], label: str) -> Panel:
    """Peak of each interval of series, with colours and keys, on a logarithmic axis; zeros are gaps."""
    lines = []
    for values, colour, key in series:
        middle, _, peak = style.envelope(study.tau, values, style.BINS // 2)
        marker = "o" if len(values) <= _FEW else ""
        lines.append(Line(middle, np.where(peak > 0, peak, np.nan), colour, 1.3, key, marker=marker))
    shown = np.concatenate([line.y for line in lines])
    shown = shown[np.isfinite(shown)]
    low, high = (float(shown.min()) / 1.5, float(shown.max()) * 1.5) if len(shown) else (0.1, 1.0)
    middle_decade = math.sqrt(low) * math.sqrt(high)
    reach = _two_decades(min(low, middle_decade / 5), max(high, middle_decade * 5))
    panel = _over_record(study, lines, label, reach, lambda axes: axes.yaxis.set_minor_locator(NullLocator()))
    return replace(panel, log="y")


def _two_decades(low: float, high: float) -> tuple[float, float]:
    """Widen the range of a logarithmic axis, to the nearer side, until it holds two powers of ten: two labels."""
    low, high = max(low, _LEAST), min(high, 1 / _LEAST)
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if last > first:
        return low, high
    below, above = 10.0 ** (last - (first == last)), 10.0 ** (first + (first == last))
    if first > last:  # no power of ten inside
        return below, above
    return (below, high) if low / below < above / high else (low, above)


def _keys(study: Study, names: Sequence[str], colours: Iterable[str]) -> list[Line]:
    what = ", masked rig" if study.prefix == "virtual" else ", rig"
    words, ideal = (what, "ideal: virtual system by itself") if len(names) <= 2 else ("", "ideal")
    keys = [Line([], [], c, 2.2, style.symbol(name) + words) for name, c in zip(names, colours, strict=False)]
    if any(study.ideal(name) is not None for name in study.coordinates):
        keys.append(Line([], [], INK, 1.1, ideal, is_dashed=True))
    return keys


def symmetric(series: Sequence[Series]) -> Range:
    """Range of an axis about zero, or about the data where they lie far from it."""
    low, high = min(float(one.min()) for one in series), max(float(one.max()) for one in series)
    reach = max(abs(low), abs(high))
    if high - low < 0.2 * reach:  # an offset with little motion about it
        pad = 0.1 * (high - low) or 0.1 * reach
        return low - pad, high + pad
    return (-1.12 * reach, 1.12 * reach) if reach else (-1.0, 1.0)


def time_label(study: Study) -> str:
    """Label of the axis of time."""
    return "virtual time τ" if study.is_scaled else style.with_unit("time t", study.unit("t"))


def _meanings(study: Study, names: Iterable[str]) -> str:
    said = [f"{name}: {study.meaning(name)}" for name in names if study.meaning(name)]
    return "; ".join(said) + "." if said else "The coordinates over the whole record."


def _few(names: Sequence[str]) -> list[str]:
    return list(names) if len(names) <= 3 else [names[0], "…", names[-1]]
