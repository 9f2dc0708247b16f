"""Page of a comparison: both runs over one another, and the tables of what differs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from matplotlib.axes import Axes

from masking.display.symbols import tex
from masking.reports import figure_parts as parts
from masking.reports import html, run_figures, style
from masking.reports.run_comparison import Comparison, Measure, symbols_in
from masking.reports.run_study import Study
from masking.reports.style import COLOURS, SIZE, CaptionedFigure

PAGE: Final = "comparison.html"
_MOST_ROWS: Final = 6
_MOST_DECLARED: Final = 60  # rows of the table of declarations
_PERIODS: Final = 6  # of the enlarged ends
TWO: Final = (COLOURS[0], COLOURS[1])


def save(compared: Comparison, folder: Path) -> Path:
    """Write `comparison.html`, its picture and `comparison.json` into a folder; return the page.

    Raises:
        RecordError: a file cannot be written.
    """
    head = ("", *compared.names, "change")
    declared = compared.declarations
    cut = len(declared) - _MOST_DECLARED
    notes = [f"{cut} more values of the declarations differ."] if cut > 0 else []
    page = folder / PAGE
    html.save(
        page,
        "comparison",
        [figure(compared)],
        compared.as_dict(),
        title=f"Runs {compared.names[0]} and {compared.names[1]}",
        tiles=(),
        names=symbols_in(compared),
        lead=compared.sentence,
        head=head,
        parameters=[row.row for row in compared.parameters],
        declared=[row.row[:3] for row in declared[:_MOST_DECLARED]],
        measures=_rows(compared.measures),
        remarks=notes,
    )
    return page


def _rows(measures: list[Measure]) -> list[tuple[str, str, str, str]]:
    return [row.row for row in sorted(measures, key=lambda row: not row.differs)]


def figure(compared: Comparison) -> CaptionedFigure:
    """Draw the coordinates that both runs have, over one another, and the ends of the first of them."""
    names, title = compared.common[:_MOST_ROWS], "Motion"
    if not names:
        return style.absent("comparison", title, "the runs have no coordinate in common")
    a, b = compared.studies
    has_zoom = all(math.isfinite(s.period) and s.tau[-1] - s.tau[0] > 2.5 * _PERIODS * s.period for s in (a, b))
    drawn, rows = style.sheet([1.15] * len(names) + [1.9] * has_zoom, zooms=has_zoom)
    for name, axes in zip(names, rows, strict=False):
        for one, colour in zip((a, b), TWO, strict=True):
            run_figures.trace(axes, one, one.motion(name), colour)
        run_figures.symmetric(axes, [one.motion(name) for one in (a, b)])
        axes.set_xlim(min(a.tau[0], b.tau[0]), max(a.tau[-1], b.tau[-1]))
        axes.set_ylabel(style.with_unit(tex(name), a.unit(f"{a.prefix}.{name}")))
    run_figures.time_label(rows[len(names) - 1], a)
    if has_zoom:
        for axes, is_last in zip(rows[len(names) :], (False, True), strict=True):
            _zoom(axes, (a, b), names[0], is_last=is_last)
    parts.legend(drawn, None, [parts.line_key(n, c, 2.2) for n, c in zip(compared.names, TWO, strict=True)])
    caption = "The coordinates that both runs have, the second over the first."
    zoomed = f" Below: {names[0]} in the first and in the last {_PERIODS} periods." if has_zoom else ""
    return CaptionedFigure("comparison", title, f"{caption}{zoomed}", drawn)


def _zoom(axes: Axes, studies: tuple[Study, Study], name: str, *, is_last: bool) -> None:
    span = _PERIODS * studies[0].period
    begin = min(one.tau[-1] for one in studies) - span if is_last else max(one.tau[0] for one in studies)
    shown = []
    for one, colour in zip(studies, TWO, strict=True):
        part = (one.tau >= begin) & (one.tau <= begin + span)
        axes.plot(*style.thin(one.tau[part], one.motion(name)[part]), color=colour, lw=1.5)
        shown.append(one.motion(name)[part])
    run_figures.symmetric(axes, shown)
    axes.set_xlim(begin, begin + span)
    words = f"{tex(name)}, {'last' if is_last else 'first'} {_PERIODS} periods"
    axes.set_title(words, loc="left", fontsize=SIZE, color=style.MUTED)
    run_figures.time_label(axes, studies[0])
