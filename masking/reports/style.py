"""Drawing: the parts that every figure of a report is made of, in one style.

Colours, axes and typeset names are those of `masking.display`.
"""

from __future__ import annotations

import functools
import io
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from masking.display.axes import DASHED, DPI, SIZE, dress, with_unit
from masking.display.palette import COLOURS, GRID, INK, LIMIT, MUTED
from masking.display.symbols import tex as symbol
from masking.display.thinning import BINS, Series, envelope, thin

__all__ = [
    "BAND", "BARE", "BELOW", "BINS", "BOTTOM", "COLOURS", "DASHED", "DPI", "GAP", "GRID", "INK", "LEFT", "LEGEND",
    "LIMIT", "MUTED", "NOTE", "RIGHT", "SIZE", "WIDTH", "CaptionedFigure", "Series", "absent", "dress", "envelope",
    "panels", "sheet", "symbol", "thin", "with_unit",
]  # fmt: skip

WIDTH = 9.0  # inches, all figures
LEFT, RIGHT, BOTTOM, GAP = 0.95, 0.22, 0.55, 0.24  # inches
LEGEND, NOTE, BARE = 0.52, 0.32, 0.14  # inches above the first axes: for a legend, a line of text, nothing
BELOW = 0.24  # inches below a heading, for a legend
_LINE, _LINES = 90, 3  # of a heading: letters in a line, and lines at most
BAND: Final = 0.22  # opacity


@dataclass(frozen=True)
class CaptionedFigure:
    """One figure with its words; `figure` is None if there is nothing to draw, and `caption` then says why."""

    name: str
    title: str
    caption: str
    figure: Figure | None

    @functools.cached_property
    def png(self) -> bytes | None:
        """Content of a PNG file, drawn once; None if there is no figure."""
        if self.figure is None:
            return None
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", metadata={"Title": self.title})
        return stream.getvalue()


def absent(name: str, title: str, why: str) -> CaptionedFigure:
    """Caption of a figure that cannot be drawn, which says why.

    Args:
        name: of the figure's file.
        title: of the figure.
        why: reason, without a full stop.
    """
    return CaptionedFigure(name, title, f"Not shown: {why}.", None)


def sheet(
    heights: Sequence[float], *, zooms: bool = False, top: float | None = None, heading: str = ""
) -> tuple[Figure, list[Axes]]:
    """Make a figure of stacked axes.

    Args:
        heights: of the axes, in inches.
        zooms: whether the last row is two axes side by side.
        top: room above and below the heading, in inches; by default for a legend.
        heading: the finding, written on top.

    Returns:
        the figure, and its axes from above.
    """
    full, gaps = WIDTH - LEFT - RIGHT, [GAP] * (len(heights) - 1)
    widths: list[tuple[float, ...]] = [(full,)] * len(heights)
    if zooms:
        widths[-1], gaps[-1] = ((full - 0.6) / 2,) * 2, 0.85  # room for the tick labels above and the titles below
    figure, grid = _grid(heights, widths, gaps, top, heading)
    rows = [axes for row in grid for axes in row]
    for axes in (rows[:-2] if zooms else rows)[:-1]:
        axes.tick_params(labelbottom=False)
    figure.align_ylabels(rows[:-1] if zooms else rows)
    return figure, rows


def panels(
    count: int, height: float, widths: Sequence[float], top: float | None = None, heading: str = ""
) -> tuple[Figure, list[list[Axes]]]:
    """Make a figure of rows of axes side by side.

    Args:
        count: number of rows.
        height: of each, in inches.
        widths: of the columns, in inches; the rest of the figure's width is shared out between them.
        top: room above and below the heading, in inches; by default for a legend.
        heading: the finding, written on top.

    Returns:
        the figure, and the axes of each row.
    """
    figure, rows = _grid([height] * count, [widths] * count, [0.62] * (count - 1), top, heading)
    for column in zip(*rows, strict=True):
        figure.align_ylabels(column)
    return figure, rows


def _grid(
    heights: Sequence[float],
    widths: Sequence[Sequence[float]],
    gaps: Sequence[float],
    top: float | None,
    heading: str,
) -> tuple[Figure, list[list[Axes]]]:
    """Make a figure of rows of axes with given heights, widths in each row, and gaps between rows, in inches."""
    # A number and its unit stay together.
    kept = re.sub(r"(?<=[\d±]) (?=[\w%°±])", "\N{NO-BREAK SPACE}", heading.replace("$", r"\$"))
    lines = textwrap.wrap(kept, _LINE, max_lines=_LINES, placeholder=" …")
    room = 0.2 + 0.2 * len(lines) + (BELOW if top is None else top) if lines else LEGEND if top is None else top
    total = room + sum(heights) + sum(gaps) + BOTTOM
    figure, rows, y = Figure(figsize=(WIDTH, total), dpi=DPI, facecolor="white"), [], total - room
    for height, row, gap in zip(heights, widths, [*gaps, 0.0], strict=True):
        y -= height
        between = (WIDTH - LEFT - RIGHT - sum(row)) / max(1, len(row) - 1)
        lefts = [LEFT + sum(row[:i]) + i * between for i in range(len(row))]
        boxes = [(x / WIDTH, y / total, width / WIDTH, height / total) for x, width in zip(lefts, row, strict=True)]
        rows.append([figure.add_axes(box) for box in boxes])
        y -= gap
        for axes in rows[-1]:
            dress(axes)
    figure.text(LEFT / WIDTH, 1.0 - 0.12 / total, "\n".join(lines), fontsize=SIZE + 1.5, color=INK, va="top", ha="left",
                linespacing=1.25)  # fmt: skip
    return figure, rows
