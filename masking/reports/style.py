"""Drawing: the parts that every figure of a report is made of, in one style.

Drawn through matplotlib's objects, without pyplot, so that nothing global is read or changed.
Colours are Okabe and Ito's, distinguishable with any colour vision; what is ideal is always a thin dark dashed line.
"""

from __future__ import annotations

import functools
import io
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

from masking.reports.text import GREEK

Series = NDArray[np.float64]

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
INK: Final = "#1b1f24"
MUTED: Final = "#5b6470"
GRID: Final = "#dfe3e8"
LIMIT: Final = "#B22222"
DPI = 160
WIDTH = 9.0  # inches, all figures
LEFT, RIGHT, BOTTOM, GAP = 0.95, 0.22, 0.55, 0.24  # inches
LEGEND, NOTE, BARE = 0.52, 0.32, 0.14  # inches above the first axes: for a legend, a line of text, nothing
BELOW = 0.24  # inches below a heading, for a legend
_LINE, _LINES = 90, 3  # of a heading: letters in a line, and lines at most
SIZE = 9.5  # points
DASHED: Final = (0, (4, 3))
BAND: Final = 0.22  # opacity
BINS: Final = 700  # across a whole record: about one for every two pixels


@dataclass(frozen=True)
class CaptionedFigure:
    """One figure with its words; `figure` is None if there is nothing to draw, and `caption` then says why."""

    name: str
    title: str
    caption: str
    figure: Figure | None

    @functools.cached_property
    def png(self) -> bytes | None:
        """Return the content of a PNG file, drawn once; None if there is no figure."""
        if self.figure is None:
            return None
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", metadata={"Title": self.title})
        return stream.getvalue()


def absent(name: str, title: str, why: str) -> CaptionedFigure:
    """Return the caption of a figure that cannot be drawn, which says why.

    Args:
        name: of the figure's file.
        title: of the figure.
        why: reason, without a full stop.
    """
    return CaptionedFigure(name, title, f"Not shown: {why}.", None)


def symbol(name: str) -> str:
    """Typeset a declared name for a figure: letters with a number become a symbol with an index."""
    match = re.fullmatch(r"([A-Za-z]+)_?(\d*)", name)
    letters, index = match.groups() if match else ("", "")
    if letters in GREEK or len(letters) == 1:
        letter = rf"\{letters}" if letters in GREEK else letters
        return rf"${letter}_{{{index}}}$" if index else f"${letter}$"
    return rf"$\mathit{{{letters}}}_{{{index}}}$" if index else name.replace("$", r"\$")


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


def dress(axes: Axes) -> None:
    """Give axes the style of the house: two thin spines, a light grid, few ticks."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(MUTED)
        axes.spines[side].set_linewidth(0.8)
    axes.tick_params(colors=INK, labelsize=SIZE - 1, width=0.8, length=3, color=MUTED)
    axes.grid(visible=True, color=GRID, lw=0.6)
    axes.set_axisbelow(True)
    axes.xaxis.label.set(color=INK, fontsize=SIZE)
    axes.yaxis.label.set(color=INK, fontsize=SIZE)
    axes.xaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
    formatter = ScalarFormatter(useMathText=True)
    formatter.set_powerlimits((-3, 4))
    axes.yaxis.set_major_formatter(formatter)
    axes.yaxis.get_offset_text().set(fontsize=SIZE - 1.5, color=MUTED)


def with_unit(text: str, unit: str) -> str:
    """Return a label with its unit in brackets, where there is one."""
    return f"{text} ({unit})" if unit else text


def envelope(tau: Series, series: Series, bins: int) -> tuple[Series, Series, Series]:
    """Give (middle, least, greatest) of each of at most `bins` stretches of equally many samples.

    Args:
        tau: times (m,).
        series: samples (m,).
        bins: number of stretches, at most.
    """
    starts = np.unique(np.linspace(0, len(tau), max(1, min(bins, len(tau))), endpoint=False).astype(int))
    last = np.append(starts[1:], len(tau)) - 1
    middle = (tau[starts] + tau[last]) / 2
    middle[0], middle[-1] = tau[0], tau[-1]
    return middle, np.minimum.reduceat(series, starts), np.maximum.reduceat(series, starts)


def thin(tau: Series, series: Series, bins: int = BINS) -> tuple[Series, Series]:
    """Keep the ends and, of each stretch, the least and the greatest sample in their order: a line looks the same.

    Args:
        tau: times (m,).
        series: samples (m,).
        bins: number of stretches.
    """
    if len(tau) <= 4 * bins:
        return tau, series
    length = len(tau) // bins
    body = series[: length * bins].reshape(bins, length)
    offset = np.arange(bins) * length
    extremes: Callable[..., NDArray[np.intp]] = np.concatenate
    rest = np.arange(length * bins, len(tau))
    keep = np.unique(extremes([[0], offset + body.argmin(1), offset + body.argmax(1), rest, [len(tau) - 1]]))
    return tau[keep], series[keep]
