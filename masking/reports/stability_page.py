"""Page of a study of stability, its figures, and figures of sweeps over a parameter and of basins."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from masking.analysis.stability.basins import LABELS, Basins
from masking.analysis.stability.modes import Mode, phase
from masking.analysis.stability.study import Stability
from masking.compile.numerics.arrays import Array
from masking.display.palette import PAPER
from masking.reports import html, style
from masking.reports.panels import Level, Line, Panel, Span, drawn
from masking.reports.style import COLOURS, INK, MUTED, SIZE, CaptionedFigure, Series
from masking.reports.text import share

_MOST = len(COLOURS)
_NAMED = 4  # points in a legend
END_COLOURS: Final = dict(zip(LABELS, (MUTED, COLOURS[0], COLOURS[1], COLOURS[3], PAPER), strict=True))


def figures(found: Stability) -> list[CaptionedFigure]:
    """Figures of a study of stability; none where no equilibrium is known."""
    return [_eigenvalues(found), _shapes(found)] if found.modes else []


def _eigenvalues(found: Stability) -> CaptionedFigure:
    points = list[Line]()
    if found.loop is not None:
        z = found.loop.eigenvalues
        points.append(Line(z.real, z.imag, INK, 0.0, "closed loop", marker="x", size=7, order=3))
    # Smaller ones are on top: equilibria that mirror each other have the same eigenvalues.
    for size, (point, modes), colour in zip(range(12, 0, -2), found.points[:_MOST], COLOURS, strict=False):
        z = modes.eigenvalues
        points.append(Line(z.real, z.imag, colour, 0.0, point.words, marker="o", size=size, edge=PAPER))
    points = [replace(point, key=point.key if i < _NAMED else "") for i, point in enumerate(points)]
    axis = Level(0.0, MUTED, axis="x", is_dashed=False)
    caption = "Eigenvalues at the equilibria: motion dies out to the left of the line, grows to the right of it."
    left = len(found.points) - _MOST
    more = f" {left} equilibria are not shown." if left > 0 else ""
    crosses = " Crosses are those of the closed loop, per unit of virtual time." if found.loop is not None else ""
    words = CaptionedFigure("eigenvalues", "Eigenvalues", caption + crosses + more)
    return drawn(words, [[Panel([axis, *points], "imaginary part", "real part")]], 3.2)


def _shapes(found: Stability) -> CaptionedFigure:
    point, modes = found.points[0]
    if len(found.points) > 1:  # the one at rest at 0, where there is one
        point, modes = min(found.points, key=lambda x: max(map(abs, x[0].position.values())))
    shown = modes.modes[:_MOST]
    columns = min(3, len(shown))
    panels = [_shape(found, mode) for mode in shown]
    panels += [Panel(finish=lambda axes: axes.set_visible(False))] * (-len(panels) % columns)
    caption = (
        f"Shapes of the modes near {point.words}: complex amplitudes of the coordinates, the largest is 1. "
        "Above each is its eigenvalue."
    )
    parts = zip(COLOURS, ("real", "imaginary"), strict=False)
    keys = [Span(0.0, 0.0, colour, f"{part} part", opacity=1.0) for colour, part in parts]
    rows = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    return drawn(CaptionedFigure("modes", "Modes", caption), rows, 1.3, keys=keys)


def _shape(found: Stability, mode: Mode) -> Panel:
    """Complex amplitudes of the coordinates as bars."""
    shape, at = np.array([mode.shape[name] for name in found.coordinates]), np.arange(len(found.coordinates))

    def finish(axes: Axes) -> None:
        axes.bar(at - 0.19, shape.real, 0.36, color=COLOURS[0])
        axes.bar(at + 0.19, shape.imag, 0.36, color=COLOURS[1])
        axes.set_xticks(at, labels=map(style.symbol, found.coordinates))

    z = mode.eigenvalue
    text = f"{z.real:+.4f}" + (f" ± {mode.frequency:.4f}i" if mode.frequency else "")
    zero = Level(0.0, MUTED, 0.8, is_dashed=False)
    return Panel([zero], ylim=(-1.15, 1.15), title=text.replace("-", "\N{MINUS SIGN}"), finish=finish)


def sweep_figure(
    name: str, values: Array, curves: Mapping[str, tuple[Series, float]], words: tuple[str, str, str]
) -> CaptionedFigure:
    """Measures that are never negative over a parameter (m,), one below the other, as in examples/12_stability.py.

    Of each row, `curves` has the label, the measure (m,) and the value of the parameter that is marked; `words` are the
    name of the figure, title and caption.
    """
    rows, ends = [], (values[0], values[-1])
    for (label, (series, marked)), colour in zip(curves.items(), COLOURS, strict=False):
        at = (marked, float(np.interp(marked, values, series)))
        lines = [Line(values, series, colour, 1.6), Line([at[0]], [at[1]], INK, 0.0, marker="o", size=6)]
        reach = (0.0, 1.08 * float(np.nanmax(series)))
        finish = functools.partial(_marked, at=at)
        rows.append([Panel(lines, label, style.symbol(name), ends, reach, ticks=4, finish=finish)])
    return drawn(CaptionedFigure(*words), rows, 1.9)


def _marked(axes: Axes, at: tuple[float, float]) -> None:
    axes.annotate(f"{at[0]:.3g}", at, (0, 8), textcoords="offset points", fontsize=SIZE - 1)


def basins_figure(found: Basins, words: tuple[str, str, str]) -> CaptionedFigure:
    """Ends of the motions from each initial state, as in examples/12_stability.py; words as for `sweep_figure`."""

    def finish(axes: Axes) -> None:
        cells = edges(found.first), edges(found.second), found.ends.T
        colours = ListedColormap([*END_COLOURS.values()])
        axes.pcolormesh(*cells, cmap=colours, vmin=-0.5, vmax=len(LABELS) - 0.5)
        axes.grid(visible=False)

    shares = {label: f"{label} {share(part)}" for label, part in found.shares().items() if part > 0.0}
    keys = [Span(0.0, 0.0, END_COLOURS[label], words, opacity=1.0) for label, words in shares.items()]
    first, second = (f"initial {style.symbol(name)}" for name in found.names)
    return drawn(CaptionedFigure(*words), [[Panel([], second, first, ticks=8, finish=finish)]], 4.6, keys=keys)


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


def save(found: Stability, folder: str | Path) -> None:
    """Write page, numbers and PNG files into a folder, made if need be; a `RecordError` where it cannot be."""
    html.save(
        Path(folder, "stability.html"),
        "stability",
        figures(found),
        found.as_dict(),
        names=found.coordinates,
        title=f"stability of {found.name}",
        result=found,
        certificate=found.certificate,
        phase=phase,
    )
