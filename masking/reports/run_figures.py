"""Figures of a study: displacements, other coordinates, synchronisation, inputs, masking error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from masking.analysis.synchronisation import principal, running_peak
from masking.model.declaration.quantities import percent
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.run_study import SUM_WINDOW_PERIODS, Study
from masking.reports.style import COLOURS, DASHED, INK, LIMIT, MUTED, SIZE, CaptionedFigure, Series

_ENVELOPE_PERIODS = 60  # from this many periods on single ones cannot be distinguished apart
_ZOOM_PERIODS = 6
_BAR, _WORDS, _VALUES = 0.27, 1.75, 0.98  # inches: height of a bar, room for words beside it and for its value
_WORSE = 1.02  # of chi: from here on a run is marked as worse
_SHOWN_DEMAND = 3.0  # times the limit: what is demanded beyond that is drawn there
_FEW = 20  # samples, up to which each is marked
_LEAST = 1e-300  # of what a logarithmic axis shows
_MOST_ROWS = len(COLOURS)


def figures(study: Study) -> list[CaptionedFigure]:
    """Draw every figure of the report, in its order."""
    wanted = {_budget: _has_observer(study), _passive: bool(study.passive)}
    return [draw(study) for draw in _FIGURES if wanted.get(draw, True)]


def _displacements(study: Study) -> CaptionedFigure:
    names, title = study.oscillators[:_MOST_ROWS], "Displacements"
    if not names:
        return style.absent("displacements", title, "the record holds no coordinates")
    zoom = bool(study.tau[-1] - study.tau[0] > 2.5 * _ZOOM_PERIODS * study.period)  # False for a NaN
    figure, rows = style.sheet([1.15] * len(names) + [1.9] * zoom, zooms=zoom)
    for name, axes, colour in zip(names, rows, COLOURS, strict=False):
        _motion(axes, study, name, colour)
    _same_range(rows[: len(names)], [study.unit(f"{study.prefix}.{name}") for name in names])
    time_label(rows[len(names) - 1], study)
    if zoom:
        span = _ZOOM_PERIODS * study.period
        first, last = study.whole.span
        head = study.between(None, first / study.time_scale + span)
        tail = study.between(last / study.time_scale - span, None)
        for axes, part, text in zip(rows[len(names) :], (head, tail), ("first", "last"), strict=True):
            for name, colour in zip(names, COLOURS, strict=False):
                _lines(axes, part, name, colour)
            symmetric(axes, [part.motion(name) for name in names])
            axes.set_xlim(part.tau[0], part.tau[-1])
            axes.set_title(f"{text} {_ZOOM_PERIODS} periods", loc="left", fontsize=SIZE, color=MUTED)
            time_label(axes, study)
    _legend(figure, study, [(style.symbol(name), colour) for name, colour in zip(names, COLOURS, strict=False)])
    more = parts.first_of(len(names), len(study.oscillators))
    return CaptionedFigure("displacements", title, _meanings(study, names) + more + _band_words(study), figure)


def _others(study: Study) -> CaptionedFigure:
    names, title = study.others[:_MOST_ROWS], "Other coordinates"
    if len(study.others) == 1 and study.meaning(study.others[0]):
        words = study.meaning(study.others[0])
        title = words[0].upper() + words[1:]
    if not names:
        return style.absent("others", title, "every coordinate is among the displacements")
    figure, rows = style.sheet([1.5 if len(names) == 1 else 1.15] * len(names))
    for name, axes in zip(names, rows, strict=True):
        _motion(axes, study, name, COLOURS[2])
    time_label(rows[-1], study)
    _legend(figure, study, [(style.symbol(name), COLOURS[2]) for name in names[:1]] if len(names) == 1 else [])
    return CaptionedFigure("others", title, _meanings(study, names) + _band_words(study), figure)


def _passive(study: Study) -> CaptionedFigure:
    names = study.passive[:_MOST_ROWS]
    figure, rows = style.sheet([1.5 if len(names) == 1 else 1.15] * len(names))
    for name, axes in zip(names, rows, strict=True):
        series = study.recording[f"rig.{name}"]
        trace(axes, study, series, COLOURS[3])
        symmetric(axes, [series])
        _whole_record(axes, study)
        axes.set_ylabel(style.with_unit(style.symbol(name), study.unit(f"rig.{name}")))
    time_label(rows[-1], study)
    words = str((study.recording.manifest.get("passive") or {}).get("words") or "")
    caption = f"What no virtual coordinate stands for, as the rig moved it. {words[:1].upper()}{words[1:]}."
    return CaptionedFigure("passive", "Passive coordinates", caption, figure)


def _synchronisation(study: Study) -> CaptionedFigure:
    title = "Synchronisation"
    if study.no_phase or study.sum_peak is None:
        return style.absent("synchronisation", title, study.no_phase)
    figure, (above, below) = style.sheet([1.7, 1.7], top=style.NOTE if len(study.pairs) > 1 else style.BARE)
    for pair, colour in zip(study.pairs, COLOURS if len(study.pairs) > 1 else (INK,), strict=False):
        tau, phase = style.thin(study.tau, principal(pair.series) / np.pi)
        jumps = np.flatnonzero(np.abs(np.diff(phase)) > 1) + 1
        label = f"{style.symbol(pair.first)} against {style.symbol(pair.second)}"
        above.plot(np.insert(tau, jumps, np.nan), np.insert(phase, jumps, np.nan), color=colour, lw=1.2, label=label)
    for level, text in ((0.0, "in-phase"), (1.0, "anti-phase")):
        above.axhline(level, color=MUTED, lw=0.8, ls=DASHED, zorder=1)
        above.annotate(text, (0.995, level), (0, 3), ("axes fraction", "data"), "offset points", ha="right",
                       fontsize=SIZE - 1, color=MUTED)  # fmt: skip
    above.set_ylim(-0.5, 1.5)
    above.set_yticks([-0.5, 0.0, 0.5, 1.0, 1.5], labels=["\N{MINUS SIGN}π/2", "0", "π/2", "π", "3π/2"])
    above.set_ylabel("phase difference (rad)")
    if len(study.pairs) > 1:
        above.legend(
            frameon=False,
            fontsize=SIZE - 1,
            ncols=len(study.pairs),
            borderaxespad=0.1,
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
        )
    total = _sum_text(study.oscillators)
    _log_peaks(below, study.tau, study.sum_peak, INK)
    below.set_ylabel(style.with_unit(f"peak |{total}|", study.unit(f"{study.prefix}.{study.oscillators[0]}")))
    for axes in (above, below):
        _whole_record(axes, study)
    time_label(below, study)
    caption = (
        "Above: phase difference from the analytic signals (Hilbert transform). "
        f"Below: largest |{' + '.join(_few(study.oscillators))}| over the {SUM_WINDOW_PERIODS} periods before."
    )
    return CaptionedFigure("synchronisation", title, caption, figure)


def _inputs(study: Study) -> CaptionedFigure:
    uses, title = study.inputs[:_MOST_ROWS], "Inputs against their limits"
    if not uses:
        return style.absent("inputs", title, "the record holds no inputs")
    figure, rows = style.sheet([1.15] * len(uses), top=style.NOTE)
    hidden = []
    for use, axes in zip(uses, rows, strict=True):
        reach = [use.series]
        if use.demanded is not None and use.is_cut:
            most = _SHOWN_DEMAND * (use.limit or use.peak)
            demanded = np.clip(use.demanded, -most, most)
            trace(axes, study, demanded, COLOURS[5], thin_line=True)
            reach.append(demanded)
        trace(axes, study, use.series, COLOURS[0])
        if use.limit is None:
            words = "no limit declared"
        else:
            words = f"peak {percent(use.used or 0.0)} of {use.limit:g} {use.unit}".rstrip()
            if use.is_cut:
                words = f"demanded {percent(use.demand / use.limit)}, applied {words.removeprefix('peak ')}"
            if use.used is not None and use.used >= 0.15:
                reach.append(np.array([use.limit]))
                for level in (-use.limit, use.limit):
                    axes.axhline(level, color=LIMIT, lw=1.1, ls=(0, (6, 2)))
            else:
                hidden.append(use.name)
        symmetric(axes, reach)
        _whole_record(axes, study)
        axes.set_ylabel(style.with_unit(style.symbol(use.name), use.unit))
        parts.note(axes, words, colour=LIMIT if use.is_exceeded or use.is_cut else MUTED)
    time_label(rows[-1], study)
    drawn = any(use.limit is not None and use.name not in hidden for use in uses)
    lines = "Dashed red lines are the limits. " if drawn else ""
    lines += "Thin orange lines are what was demanded. " if any(use.is_cut for use in uses) else ""
    far = f"The limits of {', '.join(hidden)} lie far outside the axes." if hidden else ""
    more = parts.first_of(len(uses), len(study.inputs))
    return CaptionedFigure("inputs", title, f"{lines}{far}{more}".strip() or "The inputs of the plant.", figure)


def _masking_error(study: Study) -> CaptionedFigure:
    title = "Masking error"
    compared = [(name, study.ideal(name)) for name in study.coordinates[:_MOST_ROWS]]
    errors = {n: np.abs(study.motion(n) - ideal) for n, ideal in compared if ideal is not None and n in study.chi}
    if not errors:
        return style.absent("masking_error", title, "the record holds no ideal motion to compare with")
    if not any(np.any(error) for error in errors.values()):
        return style.absent("masking_error", title, "virtual and ideal are equal in every digit recorded")
    figure, (axes,) = style.sheet([2.2], top=style.NOTE)
    for (name, error), colour in zip(errors.items(), COLOURS, strict=False):
        peaks = running_peak(study.tau, error, study.period) if math.isfinite(study.period) else error
        _log_peaks(axes, study.tau, peaks, colour, label=style.symbol(name))
    axes.legend(frameon=False, fontsize=SIZE, ncols=len(errors), loc="lower right", bbox_to_anchor=(1.0, 0.995))
    axes.set_ylabel(style.with_unit("|virtual \N{MINUS SIGN} ideal|", study.unit(f"virtual.{next(iter(errors))}")))
    _whole_record(axes, study)
    time_label(axes, study)
    caption = "Distance between the masked rig and the virtual system by itself, the largest over the period before."
    return CaptionedFigure("masking_error", title, caption, figure)


def _budget(study: Study) -> CaptionedFigure:
    title, found = "What limits the masking error", study.budget
    if found is None:
        return style.absent("budget", title, "it was not asked for; 'masking run --budget' finds it out")
    rows = [*sorted(found.rows, key=lambda row: row.rms), found.without_all]
    whole = found.whole.rms
    figure, (axes,) = style.sheet([_BAR * (len(rows) + 0.7)], top=style.NOTE)
    box = axes.get_position()
    axes.set_position((_WORDS / style.WIDTH, box.y0, 1.0 - (_WORDS + _VALUES) / style.WIDTH, box.height))
    largest = max((row.rms for row in rows if math.isfinite(row.rms)), default=whole)
    most = 1.08 * min(max(largest, whole), 2.0 * whole) if math.isfinite(whole) and whole > 0.0 else 1.0
    start = min(whole, most)
    for place, row in enumerate(rows):
        colour = COLOURS[0] if row.rms <= whole else COLOURS[1]
        axes.barh(place, min(row.rms, most) - start, left=start, height=0.56, color=colour, zorder=3)
        if row.rms > most:  # an arrow head: the bar goes on
            axes.plot(most, place, ">", color=colour, ms=10, mew=0, clip_on=False, zorder=3)
        is_worse = row.rms > _WORSE * whole
        axes.annotate(_two_digits(row.rms), (1.0, place), (14, 0), ("axes fraction", "data"), "offset points",
                      va="center", fontsize=SIZE - 0.5, color=COLOURS[1] if is_worse else INK)  # fmt: skip
    axes.axvline(start, color=INK, lw=1.1, ls=DASHED, zorder=4)
    axes.annotate(f"as it is: {_two_digits(whole)}", (start, 1.0), (0, 4), ("data", "axes fraction"), "offset points",
                  ha="center", fontsize=SIZE - 1, color=MUTED)  # fmt: skip
    axes.axhline(len(rows) - 1.5, color=MUTED, lw=0.8)
    axes.set(xlim=(0.0, most), ylim=(len(rows) - 0.4, -0.6))
    axes.set_yticks(range(len(rows)), labels=[row.title for row in rows])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("masking error χ, rms of the coordinates")
    caption = (
        f"{found.sentence} Each bar runs from the masking error of the run, the dashed line, to that of the same run "
        "without one cause: to the left, mending it helps."
    )
    return CaptionedFigure("budget", title, caption, figure)


def _two_digits(value: float) -> str:
    if not math.isfinite(value):
        return "diverges"
    mantissa, _, exponent = f"{value:#.2g}".partition("e")
    return rf"${mantissa}\cdot10^{{{int(exponent)}}}$" if exponent else mantissa


def _has_observer(study: Study) -> bool:
    return bool(study.recording.manifest.get("observer"))


_FIGURES: Final = (_displacements, _others, _passive, _synchronisation, _inputs, _masking_error, _budget)


# ---- parts of a figure


def _motion(axes: Axes, study: Study, name: str, colour: str) -> None:
    """Draw one coordinate over the whole record, as it moved and as it ideally moves."""
    trace(axes, study, study.motion(name), colour, study.ideal(name))
    ideal = study.ideal(name)
    symmetric(axes, [study.motion(name)] + ([ideal] if ideal is not None else []))
    _whole_record(axes, study)
    axes.set_ylabel(style.with_unit(style.symbol(name), study.unit(f"{study.prefix}.{name}")))


def trace(
    axes: Axes, study: Study, series: Series, colour: str, ideal: Series | None = None, *, thin_line: bool = False
) -> None:
    """Draw a series over the whole record, as a band from trough to crest where its periods are too many to be seen.

    Args:
        axes: to draw on.
        study: of the record.
        series: samples (m,).
        colour: of the line.
        ideal: drawn over it as a dashed line, if given.
        thin_line: whether the line is thin, without a filled band.
    """
    cycles = _cycles(study)
    if thin_line and cycles <= _ENVELOPE_PERIODS:
        axes.plot(*style.thin(study.tau, series), color=colour, lw=0.9)
        return
    if cycles > _ENVELOPE_PERIODS:
        bins = int(min(style.BINS / 2, cycles / 1.5))
        tau, low, high = style.envelope(study.tau, series, bins)
        if not thin_line:
            axes.fill_between(tau, low, high, color=colour, alpha=0.3, lw=0)
        axes.plot(tau, low, tau, high, color=colour, lw=0.9 if thin_line else 1.3)
        if ideal is not None:
            tau, low, high = style.envelope(study.tau, ideal, bins)
            axes.plot(tau, low, tau, high, color=INK, lw=0.9, ls=DASHED)
        return
    marker = "o" if len(series) <= _FEW else None
    axes.plot(*style.thin(study.tau, series), color=colour, lw=1.6, marker=marker, ms=4)
    if ideal is not None:
        axes.plot(*style.thin(study.tau, ideal), color=INK, lw=0.9, ls=DASHED)


def _cycles(study: Study) -> float:
    return float((study.tau[-1] - study.tau[0]) / study.period) if math.isfinite(study.period) else 0.0


def _band_words(study: Study) -> str:
    return " Each band runs from trough to crest." if _cycles(study) > _ENVELOPE_PERIODS else ""


def _lines(axes: Axes, study: Study, name: str, colour: str) -> None:
    axes.plot(*style.thin(study.tau, study.motion(name)), color=colour, lw=1.6)
    ideal = study.ideal(name)
    if ideal is not None:
        axes.plot(*style.thin(study.tau, ideal), color=INK, lw=0.9, ls=DASHED)


def _log_peaks(axes: Axes, tau: Series, values: Series, colour: str, label: str | None = None) -> None:
    """Draw the peak of each interval on a logarithmic axis; zeros, which it cannot show, are gaps."""
    middle, _, peak = style.envelope(tau, values, style.BINS // 2)
    axes.set_yscale("log")
    marker = "o" if len(values) <= _FEW else None
    axes.plot(middle, np.where(peak > 0, peak, np.nan), color=colour, lw=1.3, label=label, marker=marker, ms=4)
    shown = peak[peak > 0]
    if len(shown):
        low, high = axes.get_ylim() if axes.lines[1:] else (math.inf, 0.0)
        low, high = min(low, float(shown.min()) / 1.5), max(high, float(shown.max()) * 1.5)
        middle_decade = math.sqrt(low) * math.sqrt(high)
        axes.set_ylim(*_two_decades(min(low, middle_decade / 5), max(high, middle_decade * 5)))
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_locator(NullLocator())


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


def _legend(figure: Figure, study: Study, entries: Iterable[tuple[str, str]]) -> None:
    entries = list(entries)
    what = ", masked rig" if study.prefix == "virtual" else ", rig"
    words, ideal = (what, "ideal: virtual system by itself") if len(entries) <= 2 else ("", "ideal")
    handles = [parts.line_key(text + words, colour, 2.2) for text, colour in entries]
    if any(study.ideal(name) is not None for name in study.coordinates):
        handles.append(parts.line_key(ideal, INK, 1.1, dashed=True))
    parts.legend(figure, None, handles)


def symmetric(axes: Axes, all_series: Iterable[Series]) -> None:
    """Set the range of y about zero, or about the data where they lie far from it.

    Args:
        axes: to set.
        all_series: that are drawn on it.
    """
    low = min(float(series.min()) for series in all_series)
    high = max(float(series.max()) for series in all_series)
    reach = max(abs(low), abs(high))
    if high - low < 0.2 * reach:  # an offset with little motion about it
        pad = 0.1 * (high - low) or 0.1 * reach
        axes.set_ylim(low - pad, high + pad)
    else:
        axes.set_ylim(-1.12 * reach if reach else -1.0, 1.12 * reach if reach else 1.0)


def _same_range(rows: Sequence[Axes], units: Sequence[str]) -> None:
    """Give coordinates of one unit one range, so that their amplitudes can be compared."""
    if len(set(units)) == 1:
        low, high = zip(*(axes.get_ylim() for axes in rows), strict=True)
        for axes in rows:
            axes.set_ylim(min(low), max(high))


def _whole_record(axes: Axes, study: Study) -> None:
    first, last = study.tau[0], study.tau[-1]
    axes.set_xlim(first, last if last > first else first + 1.0)


def time_label(axes: Axes, study: Study) -> None:
    """Write below axes which time they show."""
    if study.is_scaled:
        axes.set_xlabel("virtual time τ")
    else:
        axes.set_xlabel(style.with_unit("time t", study.unit("t")))


def _meanings(study: Study, names: Iterable[str]) -> str:
    said = [f"{name}: {study.meaning(name)}" for name in names if study.meaning(name)]
    return "; ".join(said) + "." if said else "The coordinates over the whole record."


def _few(names: Sequence[str]) -> list[str]:
    return list(names) if len(names) <= 3 else [names[0], "…", names[-1]]


def _sum_text(names: Sequence[str]) -> str:
    return " + ".join(style.symbol(name) if name != "…" else name for name in _few(names))
