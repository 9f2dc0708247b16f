"""Axes in the style of the house, and figures that a notebook shows.

Drawn through matplotlib's objects, without pyplot, so that nothing global is read or changed.
"""

from __future__ import annotations

import io
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from masking.display.palette import GRID, INK, MUTED

DPI: Final = 160
SIZE: Final = 9.5  # points
DASHED: Final = (0, (4, 3))


class NotebookFigure(Figure):
    """A figure that a notebook shows as a picture, whether pyplot is loaded or not."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png")
        return stream.getvalue()


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
    """Label with its unit in brackets, where there is one."""
    return f"{text} ({unit})" if unit else text
