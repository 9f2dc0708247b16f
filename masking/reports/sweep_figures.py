"""Figures of a sweep: curves with bands, maps, bifurcation diagrams, and distributions of what was measured."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter

from masking.compile.numerics.arrays import Array
from masking.lab.records.table_chunks import Columns
from masking.reports import figure_parts as parts
from masking.reports import style
from masking.reports.run_measures import MEANINGS
from masking.reports.stability_figures import END_COLOURS, edges, is_geometric
from masking.reports.style import BAND, BARE, COLOURS, INK, LEGEND, MUTED, CaptionedFigure
from masking.reports.text import capital, share

_KINDS: Final = {
    **END_COLOURS, "locked": COLOURS[2], "beating": COLOURS[5], "death": MUTED,
    "not synchronised": COLOURS[3], "unknown": "#d9d9d9", "": "#ffffff",
}  # fmt: skip
_QUANTILES: Final = (0.1, 0.5, 0.9)
_BINS: Final = 40
_ROOM: Final = 0.19  # of the width of a figure, for words beside bars
_SAME: Final = 2e-3  # of a value: differences that no axis magnifies further


def figures(facts: Mapping[str, Any], columns: Columns) -> list[CaptionedFigure]:
    """Draw what a sweep measured over what it varied.

    Args:
        facts: of the sweep: `over`, `measures`.
        columns: of its rows.
    """
    grid = [one["name"] for one in facts["over"] if one["grid"] is not None and len(one["grid"]) > 1]
    factors = {one["name"] for one in facts["over"] if one["factor"]}
    units = {one["name"]: one.get("unit", "") for one in facts["over"]}
    labels = {
        name: f"{_label(name)} / declared" if name in factors else style.with_unit(_label(name), units[name])
        for name in grid
    }
    found = []
    for name in facts["measures"]:
        column = columns[name]
        if not isinstance(column, np.ndarray) and len(column) and not isinstance(column[0], str):
            found.append(_diagram(name, grid, labels, columns))
        elif len(grid) >= 2:
            found.append(_map(name, grid, labels, columns))
        elif len(grid) == 1:
            found.append(_curve(name, grid[0], labels, columns))
        else:
            found.append(_distribution(name, column))
    return found


def _over(axis: Any, values: Array) -> None:  # noqa: ANN401  # an axis of matplotlib
    """Make an axis logarithmic where the values of a grid (m,) are so."""
    if is_geometric(values):
        axis.axes.set(**{f"{axis.axis_name}scale": "log", f"{axis.axis_name}lim": edges(values)[[0, -1]]})
        parts.plain_numbers(axis)
        axis.set_minor_formatter(NullFormatter())


def _label(name: str) -> str:
    return ", ".join(style.symbol(one) for one in name.split(","))


def _measure(name: str) -> str:
    """Label of a measure: times are those of the virtual system."""
    of_time = "units of time" if name in {"tau_s", "period"} else ""
    return style.with_unit("τ$_s$" if name == "tau_s" else _label(name), "rad" if name == "phase" else of_time)


def _words(name: str) -> str:
    return MEANINGS.get(name, name)


def _numbers(column: Any) -> Array:  # noqa: ANN401  # a column of any kind
    """Column as numbers: of words, the place of each among `_KINDS`."""
    if isinstance(column, np.ndarray):
        return column.astype(float)
    return np.array([[*_KINDS].index(text) if text in _KINDS else math.nan for text in column])


def _diagram(name: str, grid: list[str], labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Draw several values of each run over what varies last: a bifurcation diagram."""
    at = np.asarray(columns[grid[-1]] if grid else columns["run"], dtype=float)
    rows, ways = columns[name], columns.get("way")
    figure, (axes,) = style.sheet([4.2], top=LEGEND if ways else BARE)
    for way, colour in zip(("up", "down") if ways else ("",), COLOURS, strict=False):
        chosen = [i for i in range(len(at)) if not ways or ways[i] == way]
        x = np.concatenate([np.full(len(rows[i]), at[i]) for i in chosen] or [np.empty(0)])
        y = np.concatenate([np.asarray(rows[i]) for i in chosen] or [np.empty(0)])
        axes.plot(x, y, ".", ms=1.8 if way != "down" else 0.9, color=colour, rasterized=True)
    if ways:
        parts.legend(figure, None, [parts.marker_key(way, c) for way, c in zip(("up", "down"), COLOURS, strict=False)])
    parts.ticks(axes)
    _over(axes.xaxis, np.unique(at))
    kind, _, of = name.partition(".")
    moved, _, crossed = of.partition("@")
    what = f"maxima of {style.symbol(moved)}" if kind == "maxima" else style.symbol(moved)
    where = f": {moved} where {crossed} crosses 0 upwards" if crossed else f" of {moved}"
    axes.set(xlabel=labels[grid[-1]] if grid else "run", ylabel=what)
    more = " Followed up and down: each run begins where the one before it ended." if ways else ""
    caption = f"{capital(kind)}{where}, over the second half of each run.{more}"
    return CaptionedFigure(f"diagram_{_file(name)}", "Bifurcation diagram", caption, figure)


def _curve(name: str, over: str, labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Draw a measure over one parameter: the middle, and a band where there are several runs at each value."""
    at, column = np.asarray(columns[over], dtype=float), columns[name]
    values = np.unique(at)
    figure, (axes,) = style.sheet([3.2], top=BARE if isinstance(column, np.ndarray) else LEGEND)
    if not isinstance(column, np.ndarray):
        _shares(figure, axes, at, values, [str(text) for text in column])
        axes.set(xlabel=labels[over], ylabel="share of the runs", ylim=(0.0, 1.0))
        _over(axes.xaxis, values)
        parts.ticks(axes)
        caption = f"{capital(_words(name))}, over {over}: the share of the runs."
        return CaptionedFigure(f"curve_{_file(name)}", f"{capital(name)} over {over}", caption, figure)
    with np.errstate(all="ignore"):
        groups = [column[at == value] for value in values]
        groups = [group[np.isfinite(group)] for group in groups]
        low, middle, high = np.array([np.quantile(g, _QUANTILES) if len(g) else [math.nan] * 3 for g in groups]).T
    axes.plot(values, middle, "o-" if len(values) < 30 else "-", ms=3, color=COLOURS[0], lw=1.6)
    has_band = max(map(len, groups)) > 1
    if has_band:
        axes.fill_between(values, low, high, color=COLOURS[0], alpha=BAND, lw=0)
    if _is_wide(middle):
        parts.logarithmic(axes, "y")
    else:
        parts.ticks(axes)
        axes.set_ylim(*_range(np.concatenate([low, high])))
        axes.ticklabel_format(axis="y", useOffset=False)
    axes.set(xlabel=labels[over], ylabel=_measure(name))
    _over(axes.xaxis, values)
    caption = f"{capital(_words(name))}, over {over}"
    caption += ": the median, and a band from 10 % to 90 % of the runs." if has_band else "."
    return CaptionedFigure(f"curve_{_file(name)}", f"{capital(name)} over {over}", caption, figure)


def _range(values: Array) -> tuple[float, float]:
    """Ends of an axis that shows values (m,), of which some may be none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    least = _SAME * float(np.abs(finite).max()) or 1.0
    room = 0.06 * float(np.ptp(finite)) + 0.5 * max(0.0, least - float(np.ptp(finite)))
    return float(finite.min()) - room, float(finite.max()) + room


def _is_wide(values: Array) -> bool:
    finite = values[np.isfinite(values)]
    return bool(len(finite)) and bool(finite.min() > 0.0) and bool(finite.max() > 300.0 * finite.min())


def _shares(figure: Any, axes: Any, at: Array, values: Array, words: list[str]) -> None:  # noqa: ANN401  # matplotlib's own
    kinds = [kind for kind in _KINDS if kind in words and kind]
    shares = [
        [np.mean([w == kind for w, a in zip(words, at, strict=True) if a == v]) for v in values] for kind in kinds
    ]
    cells = edges(values)
    steps = [[*of_kind, of_kind[-1]] for of_kind in shares]
    axes.stackplot(cells, steps, colors=[_KINDS[kind] for kind in kinds], step="post")
    axes.set_xlim(cells[[0, -1]])
    axes.grid(visible=False)
    parts.legend(figure, None, [Patch(facecolor=_KINDS[kind], label=kind) for kind in kinds])


def _map(name: str, grid: list[str], labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Draw a measure over two parameters: the median, or the commonest word."""
    x, y, column = np.asarray(columns[grid[0]]), np.asarray(columns[grid[1]]), columns[name]
    across, up = np.unique(x), np.unique(y)
    places = np.searchsorted(across, x) * len(up) + np.searchsorted(up, y)
    numbers, cells = _numbers(column), np.full(len(across) * len(up), np.nan)
    order = np.argsort(places, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(places[order])) + 1):
        of_cell = numbers[group][np.isfinite(numbers[group])]
        if len(of_cell):
            is_number = isinstance(column, np.ndarray)
            cells[places[group[0]]] = (
                np.median(of_cell) if is_number else Counter(of_cell.tolist()).most_common(1)[0][0]
            )
    is_word = not isinstance(column, np.ndarray)
    figure, (axes,) = style.sheet([4.8], top=LEGEND if is_word else BARE)
    table = cells.reshape(len(across), len(up)).T
    if is_word:
        chosen = [kind for kind in _KINDS if kind and kind in column]
        axes.pcolormesh(edges(across), edges(up), table, cmap=ListedColormap(list(_KINDS.values())), vmin=-0.5,
                        vmax=len(_KINDS) - 0.5, rasterized=True)  # fmt: skip
        runs = Counter(text for text in column if text)
        keys = [
            Patch(facecolor=_KINDS[k], edgecolor=MUTED, label=f"{k} {share(runs[k] / runs.total())}") for k in chosen
        ]
        parts.legend(figure, None, keys)
    else:
        drawn = axes.pcolormesh(edges(across), edges(up), table, cmap="viridis", rasterized=True)
        bar = figure.colorbar(drawn, ax=axes, pad=0.02)
        bar.set_label(_measure(name), color=INK)
    axes.grid(visible=False)
    axes.yaxis.set_major_locator(MaxNLocator(8, steps=[1, 2, 2.5, 5, 10]))
    axes.set(xlabel=labels[grid[0]], ylabel=labels[grid[1]])
    for axis, values in ((axes.xaxis, across), (axes.yaxis, up)):
        _over(axis, values)
    several = len(column) > len(across) * len(up)
    middle = (
        ": the commonest at each point; the legend has the share of each in all runs"
        if is_word
        else ": the median of the runs at each point"
    ) * several
    more = f", over all values of {' and '.join(grid[2:])}" if len(grid) > 2 else ""
    title = f"{capital(name)} over {grid[0]} and {grid[1]}"
    return CaptionedFigure(f"map_{_file(name)}", title, f"{capital(_words(name))}{middle}{more}.", figure)


def _distribution(name: str, column: Any) -> CaptionedFigure:  # noqa: ANN401  # a column of any kind
    """Draw how often each value or word came out."""
    title, file = f"Distribution of {name}", f"distribution_{_file(name)}"
    if isinstance(column, np.ndarray):
        finite = column[np.isfinite(column)]
        if not len(finite):
            return style.absent(file, title, "no run has a value")
        figure, (axes,) = style.sheet([2.6], top=BARE)
        axes.hist(finite, bins=min(_BINS, max(5, len(finite) // 10)), color=COLOURS[0])
        low, middle, high = np.quantile(finite, _QUANTILES)
        for value in (low, middle, high):
            axes.axvline(value, color=INK, lw=0.9, ls=style.DASHED)
        parts.ticks(axes)
        axes.set(xlabel=_measure(name), ylabel="runs", ylim=(0.0, None))
        caption = f"{capital(_words(name))}: median {middle:.4g}, from {low:.4g} to {high:.4g} in 80 % of the runs."
        return CaptionedFigure(file, title, caption, figure)
    counts = Counter(text for text in column if text)
    if not counts:
        return style.absent(file, title, "no run has a value")
    figure, (axes,) = style.sheet([0.5 + 0.3 * len(counts)], top=BARE)
    kinds, total = [*counts], sum(counts.values())
    shares, box = [counts[kind] / total for kind in kinds], axes.get_position()
    axes.set_position((_ROOM, box.y0, box.x1 - _ROOM, box.height))
    axes.barh(range(len(kinds)), shares, height=0.66, color=[_KINDS.get(kind, MUTED) for kind in kinds])
    axes.set_yticks(range(len(kinds)), kinds)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.set(xlabel="share of the runs", xlim=(0.0, 1.0), ylim=(len(kinds) - 0.4, -0.6))
    return CaptionedFigure(file, title, f"{capital(_words(name))}: the share of the runs.", figure)


def _file(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
