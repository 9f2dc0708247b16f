"""Figures of stability: eigenvalues, mode shapes, sweeps over a parameter, basins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from masking.analysis.stability.basins import LABELS, Basins
from masking.analysis.stability.study import Stability, position_words
from masking.compile.numerics.arrays import Array
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.style import BARE, COLOURS, INK, LEGEND, MUTED, SIZE, CaptionedFigure, Series
from masking.reports.text import share

_MOST = len(COLOURS)
END_COLOURS: Final = dict(zip(LABELS, (MUTED, COLOURS[0], COLOURS[1], COLOURS[3], "#ffffff"), strict=True))


def figures(found: Stability) -> list[CaptionedFigure]:
    """Draw every figure of a study of stability; none where no equilibrium is known."""
    return [_eigenvalues(found), _shapes(found)] if found.modes else []


def _eigenvalues(found: Stability) -> CaptionedFigure:
    figure, (axes,) = style.sheet([3.2], top=LEGEND)
    handles = []
    # Smaller ones are on top: equilibria that mirror each other have the same eigenvalues.
    for size, (point, modes), colour in zip(range(12, 0, -2), found.points[:_MOST], COLOURS, strict=False):
        axes.plot(modes.eigenvalues.real, modes.eigenvalues.imag, "o", ms=size, color=colour, mec="white", mew=0.6)
        handles.append(parts.marker_key(position_words(point), colour))
    if found.loop is not None:
        axes.plot(found.loop.eigenvalues.real, found.loop.eigenvalues.imag, "x", ms=7, color=INK, mew=1.2)
        handles.insert(0, parts.marker_key("closed loop", INK, "x", 7.0))
    axes.axvline(0.0, color=MUTED, lw=0.9)
    axes.set(xlabel="real part", ylabel="imaginary part")
    columns = 1 if len(found.coordinates) > 3 and len(handles) > 1 else 2
    figure.legend(handles=handles[: 2 * columns], loc="upper right", ncols=columns, frameon=False, fontsize=SIZE - 1.5)
    caption = "Eigenvalues at the equilibria: motion dies out to the left of the line, grows to the right of it."
    left = len(found.points) - _MOST
    more = f" {left} equilibria are not shown." if left > 0 else ""
    crosses = " Crosses are those of the closed loop, per unit of virtual time." if found.loop is not None else ""
    return CaptionedFigure("eigenvalues", "Eigenvalues", caption + crosses + more, figure)


def _shapes(found: Stability) -> CaptionedFigure:
    point, modes = found.points[0]
    if len(found.points) > 1:  # the one at rest at 0, where there is one
        point, modes = min(found.points, key=lambda x: max(map(abs, x[0].position.values())))
    shown = modes.modes[:_MOST]
    columns = min(3, len(shown))
    count = -(-len(shown) // columns)
    figure, rows = style.panels(count, 1.3, [2.2] * columns, LEGEND)
    at = np.arange(len(found.coordinates))
    for axes in [axes for row in rows for axes in row][len(shown) :]:
        axes.set_visible(False)
    for mode, axes in zip(shown, (axes for row in rows for axes in row), strict=False):
        shape = np.array([mode.shape[name] for name in found.coordinates])
        axes.bar(at - 0.19, shape.real, 0.36, color=COLOURS[0])
        axes.bar(at + 0.19, shape.imag, 0.36, color=COLOURS[1])
        axes.axhline(0.0, color=MUTED, lw=0.8)
        axes.set_ylim(-1.15, 1.15)
        axes.set_xticks(at, labels=map(style.symbol, found.coordinates))
        z = mode.eigenvalue
        text = f"{z.real:+.4f}" + (f" ± {mode.frequency:.4f}i" if mode.frequency else "")
        axes.set_title(text.replace("-", "\N{MINUS SIGN}"), loc="left", fontsize=SIZE - 1, color=MUTED)
    handles = [Patch(color=COLOURS[0], label="real part"), Patch(color=COLOURS[1], label="imaginary part")]
    parts.legend(figure, None, handles)
    caption = (
        f"Shapes of the modes near {position_words(point)}: complex amplitudes of the coordinates, the largest is 1. "
        "Above each is its eigenvalue."
    )
    return CaptionedFigure("modes", "Modes", caption, figure)


def sweep_figure(
    name: str, values: Array, curves: Mapping[str, tuple[Series, float]], words: tuple[str, str, str]
) -> CaptionedFigure:
    """Draw measures that are never negative over a parameter, one below the other.

    Args:
        name: of the parameter.
        values: of it (m,).
        curves: label, and measure (m,) with the value of the parameter that is marked, of each row.
        words: name of the figure, title and caption.
    """
    figure, rows = style.sheet([1.9] * len(curves), top=BARE + 0.12)
    for axes, (label, (series, marked)), colour in zip(rows, curves.items(), COLOURS, strict=False):
        axes.plot(values, series, color=colour, lw=1.6)
        at = (marked, float(np.interp(marked, values, series)))
        axes.plot(*at, "o", ms=6, color=INK)
        axes.annotate(f"{marked:.3g}", at, (0, 8), textcoords="offset points", fontsize=SIZE - 1)
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.set(ylabel=label, xlim=(values[0], values[-1]), ylim=(0.0, 1.08 * float(np.nanmax(series))))
    rows[-1].set_xlabel(style.symbol(name))
    return CaptionedFigure(*words, figure)


def basins_figure(found: Basins, words: tuple[str, str, str]) -> CaptionedFigure:
    """Draw where motion from each initial state ends.

    Args:
        found: the basins.
        words: name of the figure, title and caption.
    """
    figure, (axes,) = style.sheet([4.6], top=LEGEND)
    sides = [edges(found.first), edges(found.second)]
    axes.pcolormesh(
        *sides, found.ends.T, cmap=ListedColormap([*END_COLOURS.values()]), vmin=-0.5, vmax=len(LABELS) - 0.5
    )
    axes.grid(visible=False)
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]))
    axes.set(xlabel=f"initial {style.symbol(found.names[0])}", ylabel=f"initial {style.symbol(found.names[1])}")
    shares = found.shares()
    handles = [
        Patch(facecolor=colour, edgecolor=MUTED, label=f"{label} {share(shares[label])}")
        for label, colour in END_COLOURS.items()
        if shares[label] > 0.0
    ]
    parts.legend(figure, None, handles)
    return CaptionedFigure(*words, figure)


def edges(values: Sequence[float] | Array) -> Array:
    """Edges of cells around values (m + 1,): on a logarithmic axis where their ratios are all the same."""
    v = np.asarray(values, dtype=float)
    if is_geometric(v):
        return np.asarray(np.exp(_between(np.log(v))))
    return _between(v)


def is_geometric(values: Array) -> bool:
    """Whether values in rising order (m,) have one ratio, and no equal steps."""
    if len(values) < 3 or values[0] <= 0.0 or np.allclose(np.diff(values, 2), 0.0, atol=1e-9 * float(values[-1])):
        return False
    return bool(np.allclose(np.diff(np.log(values), 2), 0.0, atol=1e-9))


def _between(v: Array) -> Array:
    between = 0.5 * (v[1:] + v[:-1])
    return np.concatenate([[1.5 * v[0] - 0.5 * v[1]], between, [1.5 * v[-1] - 0.5 * v[-2]]])
