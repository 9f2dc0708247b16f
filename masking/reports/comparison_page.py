"""Page of a comparison: both runs over one another, and the tables of what differs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import numpy as np

from masking.display.symbols import tex
from masking.reports import html, style
from masking.reports.panels import Line, Panel, drawn
from masking.reports.run_comparison import Comparison, symbols_in
from masking.reports.run_figures import symmetric, time_label, trace
from masking.reports.run_study import Study
from masking.reports.style import COLOURS, CaptionedFigure

PAGE: Final = "comparison.html"
_MOST_ROWS: Final = 6
_MOST_DECLARED: Final = 60  # rows of the table of declarations
_PERIODS: Final = 6  # of the enlarged ends
TWO: Final = (COLOURS[0], COLOURS[1])


def save(compared: Comparison, folder: Path) -> Path:
    """Write page, picture and JSON into a folder; return the page. A `RecordError` says that one cannot be written."""
    more = len(compared.declarations) - _MOST_DECLARED
    html.save(
        folder / PAGE,
        "comparison",
        [figure(compared)],
        compared.as_dict(),
        title=f"Runs {compared.names[0]} and {compared.names[1]}",
        names=symbols_in(compared),
        compared=compared,
        most=_MOST_DECLARED,
        remarks=[f"{more} more values of the declarations differ."] if more > 0 else [],
    )
    return folder / PAGE


def figure(compared: Comparison) -> CaptionedFigure:
    """Coordinates that both runs have, over one another, and the ends of the first of them."""
    names, title = compared.common[:_MOST_ROWS], "Motion"
    if not names:
        return style.absent("comparison", title, "the runs have no coordinate in common")
    a, b = compared.studies
    ends = min(a.tau[0], b.tau[0]), max(a.tau[-1], b.tau[-1])
    rows = []
    for name in names:
        lines = [part for one, colour in zip((a, b), TWO, strict=True) for part in trace(one, one.motion(name), colour)]
        label = style.with_unit(tex(name), a.unit(f"{a.prefix}.{name}"))
        rows.append([Panel(lines, label, time_label(a), ends, symmetric([one.motion(name) for one in (a, b)]))])
    heights, zoomed = [1.15] * len(names), ""
    if all(math.isfinite(s.period) and s.tau[-1] - s.tau[0] > 2.5 * _PERIODS * s.period for s in (a, b)):
        rows.append([_zoom((a, b), names[0], is_last=is_last) for is_last in (False, True)])
        heights.append(1.9)
        zoomed = f" Below: {names[0]} in the first and in the last {_PERIODS} periods."
    caption = f"The coordinates that both runs have, the second over the first.{zoomed}"
    keys = [Line([], [], colour, 2.2, name) for name, colour in zip(compared.names, TWO, strict=True)]
    return drawn(CaptionedFigure("comparison", title, caption), rows, heights, keys=keys)


def _zoom(studies: tuple[Study, Study], name: str, *, is_last: bool) -> Panel:
    span = _PERIODS * studies[0].period
    begin = min(one.tau[-1] for one in studies) - span if is_last else max(one.tau[0] for one in studies)
    lines = []
    for one, colour in zip(studies, TWO, strict=True):
        part = (one.tau >= begin) & (one.tau <= begin + span)
        lines.append(Line(one.tau[part], one.motion(name)[part], colour, 1.5))
    reach = symmetric([np.asarray(line.y) for line in lines])
    words = f"{tex(name)}, {'last' if is_last else 'first'} {_PERIODS} periods"
    return Panel(lines, "", time_label(studies[0]), (begin, begin + span), reach, title=words)
