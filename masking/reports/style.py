"""Style of every figure of a report: sizes, captions, and grids of axes.

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
from masking.display.symbols import in_figure
from masking.display.symbols import tex as symbol
from masking.display.thinning import BINS, Series, envelope, thin

__all__ = [
    "BAND", "BARE", "BELOW", "BINS", "BOTTOM", "COLOURS", "DASHED", "DPI", "GAP", "GRID", "INK", "LEFT", "LEGEND",
    "LIMIT", "MUTED", "NOTE", "RIGHT", "SIZE", "WIDTH", "CaptionedFigure", "Series", "absent", "dress", "envelope",
    "grid", "sheet", "symbol", "thin", "unparted", "with_unit",
]  # fmt: skip

WIDTH = 9.0  # inches, all figures
LEFT, RIGHT, BOTTOM, GAP = 0.95, 0.22, 0.55, 0.24  # inches
LEGEND, NOTE, BARE = 0.52, 0.32, 0.14  # inches above the first axes: for a legend, a line of text, nothing
BELOW = 0.24  # inches below a heading, for a legend
_LINE, _LINES = 90, 3  # of a heading: letters in a line, and lines at most
BAND: Final = 0.22  # opacity


@dataclass(frozen=True)
class CaptionedFigure:
    """Figure with its words; `figure` is None if there is nothing to draw, and `caption` then says why."""

    name: str
    title: str
    caption: str
    figure: Figure | None = None

    @functools.cached_property
    def png(self) -> bytes | None:
        """Content of a PNG file, drawn once; None if there is no figure."""
        if self.figure is None:
            return None
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", metadata={"Title": self.title})
        return stream.getvalue()


def unparted(text: str) -> str:
    """Text in which a number and its unit stay in one line, and so do odds."""
    return re.sub(r"(?<=[\d±]) (?=[\w%°±:])|(?<= :) (?=\d)", "\N{NO-BREAK SPACE}", text)


def absent(name: str, title: str, why: str) -> CaptionedFigure:
    """Caption of a figure that cannot be drawn, which says why, without a full stop."""
    return CaptionedFigure(name, title, f"Not shown: {why}.", None)


def sheet(heights: Sequence[float], *, top: float = LEGEND) -> tuple[Figure, list[Axes]]:
    """Figure of stacked axes with one axis of x, and these axes from above; heights and the room on top in inches."""
    figure, rows = grid(heights, [[WIDTH - LEFT - RIGHT]] * len(heights), [GAP] * (len(heights) - 1), top)
    stacked = [axes for (axes,) in rows]
    for axes in stacked[:-1]:
        axes.tick_params(labelbottom=False)
    figure.align_ylabels(stacked)
    return figure, stacked


def grid(
    heights: Sequence[float],
    widths: Sequence[Sequence[float]],
    gaps: Sequence[float],
    top: float,
    *,
    heading: str = "",
    left: float = LEFT,
    right: float = RIGHT,
) -> tuple[Figure, list[list[Axes]]]:
    """Figure of rows of axes, and the axes of each row, below a heading, the finding; lengths in inches.

    The axes of a row have widths and share out the rest of the figure's between them; `gaps` are between the rows,
    `top` above the first of them, `left` and `right` beside the axes.
    """
    lines = textwrap.wrap(unparted(in_figure(heading)), _LINE, max_lines=_LINES, placeholder=" …")
    room = 0.2 + 0.2 * len(lines) + top if lines else top
    total = room + sum(heights) + sum(gaps) + BOTTOM
    figure, rows, y = Figure(figsize=(WIDTH, total), dpi=DPI, facecolor="white"), [], total - room
    for height, row, gap in zip(heights, widths, [*gaps, 0.0], strict=True):
        y -= height
        between = (WIDTH - left - right - sum(row)) / max(1, len(row) - 1)
        lefts = [left + sum(row[:i]) + i * between for i in range(len(row))]
        boxes = [(x / WIDTH, y / total, width / WIDTH, height / total) for x, width in zip(lefts, row, strict=True)]
        rows.append([figure.add_axes(box) for box in boxes])
        y -= gap
        for axes in rows[-1]:
            dress(axes)
    figure.text(LEFT / WIDTH, 1.0 - 0.12 / total, "\n".join(lines), fontsize=SIZE + 1.5, color=INK, va="top", ha="left",
                linespacing=1.25)  # fmt: skip
    return figure, rows
