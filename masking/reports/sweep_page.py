"""Page of a sweep: its outcome in a sentence, its pictures, and the runs that failed.

Pictures are curves with bands, maps, bifurcation diagrams, and distributions of what was measured.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from masking.compile.numerics.arrays import Array
from masking.display.palette import PAPER, UNKNOWN
from masking.display.symbols import in_figure
from masking.lab.records.table_chunks import Columns
from masking.reports import html, style
from masking.reports.panels import Band, Level, Line, Panel, Span, bars, drawn, plain_numbers
from masking.reports.run_measures import MEANINGS
from masking.reports.stability_page import END_COLOURS, edges, is_geometric
from masking.reports.style import COLOURS, INK, MUTED, CaptionedFigure
from masking.reports.text import capital, listed, share

PAGE: Final = "sweep.html"
_SHOWN: Final = 20  # failures
_NAMED: Final = 4  # of what varies, that the sentence names
_KINDS: Final = {
    **END_COLOURS, "locked": COLOURS[2], "beating": COLOURS[5], "death": MUTED,
    "not synchronised": COLOURS[3], "unknown": UNKNOWN, "": PAPER,
}  # fmt: skip
_QUANTILES: Final = (0.1, 0.5, 0.9)
_BINS: Final = 40
_ROOM: Final = 1.71  # inches, for words beside bars
_SAME: Final = 2e-3  # of a value: differences that no axis magnifies further


def sentence(facts: Mapping[str, Any], columns: Columns) -> str:
    """Number of runs and their outcome in a sentence."""
    done, failed = len(columns["run"]), sum(bool(text) for text in columns["error"])
    of_all = f" of {facts['rows']}" if done < facts["rows"] else ""
    said = f"{facts['name']}: {done}{of_all} runs"
    over = [one["name"] for one in facts["over"]]
    said += f" over {listed(over) if len(over) <= _NAMED else f'{len(over)} quantities'}" if over else ""
    if failed:  # with the commonest reason, up to the place where it differs
        causes = [str(text).partition(",")[0].partition(" at t =")[0] for text in columns["error"] if text]
        said += f", {failed} failed ({Counter(causes).most_common(1)[0][0]})"
    found = [
        words
        for name in facts["measures"]
        if (words := _words(name, columns[name], facts.get("units", {}).get(name, "")))
    ]
    return f"{said}; {'; '.join(found)}." if found else f"{said}."


def counts(column: Sequence[Any]) -> dict[str, int]:
    """How many runs have each word of a column, the commonest first."""
    return dict(Counter(text for text in column if text).most_common())


def _words(name: str, column: Any, unit: str) -> str:  # noqa: ANN401  # a column of any kind
    if isinstance(column, np.ndarray):
        finite = column[np.isfinite(column)]
        if not len(finite):
            return ""
        low, middle, high = np.quantile(finite, (0.0, 0.5, 1.0))
        if not high > low:
            return f"{name} {low:.4g} {unit}".rstrip()
        return f"{name} {low:.4g} to {high:.4g} {unit}".rstrip() + f", median {middle:.4g}"
    if column and isinstance(column[0], str):
        return f"{name} " + ", ".join(f"{kind} {count}" for kind, count in counts(column).items())
    return ""


def save(facts: Mapping[str, Any], columns: Columns, said: str, folder: Path) -> Path:
    """Write page and pictures, a sentence on top, into a folder; a `RecordError` says that one cannot be written."""
    failures = [(str(run), text) for run, text in zip(columns["run"], columns["error"], strict=True) if text]
    html.save(
        folder / PAGE,
        "sweep",
        figures(facts, columns),
        title=f"sweep of {facts['name']}",
        names=[*(name for one in facts["over"] for name in one["name"].split(",")), *facts["measures"]],
        lead=said,
        runs=len(columns["run"]),
        failures=failures,
        most=_SHOWN,
    )
    return folder / PAGE


def figures(facts: Mapping[str, Any], columns: Columns) -> list[CaptionedFigure]:
    """Measures of a sweep over the parameters that it varied; of its facts, `over` and `measures` count."""
    grid = [one["name"] for one in facts["over"] if one["grid"] is not None and len(one["grid"]) > 1]
    factors = {one["name"] for one in facts["over"] if one["factor"]}
    units = {one["name"]: one.get("unit", "") for one in facts["over"]}
    labels = {n: f"{_label(n)} / declared" if n in factors else style.with_unit(_label(n), units[n]) for n in grid}
    found = []
    for name in facts["measures"]:
        column, label = columns[name], _measure(name, facts.get("units", {}).get(name, ""))
        if not isinstance(column, np.ndarray) and len(column) and not isinstance(column[0], str):
            found.append(_diagram(name, label, grid, labels, columns))
        elif len(grid) >= 2:
            found.append(_map(name, label, grid, labels, columns))
        elif len(grid) == 1:
            found.append(_curve(name, label, grid[0], labels, columns))
        else:
            found.append(_distribution(name, label, column))
    return found


def _geometric(axes: Axes, x: Array, y: Array | None = None) -> None:
    """Make axes logarithmic where the values of a grid (m,) are so."""
    for axis, values in ((axes.xaxis, x), (axes.yaxis, y)):
        if values is not None and is_geometric(values):
            axes.set(**{f"{axis.axis_name}scale": "log", f"{axis.axis_name}lim": edges(values)[[0, -1]]})
            plain_numbers(axis)


def _label(name: str) -> str:
    return ", ".join(style.symbol(one) for one in name.split(","))


def _measure(name: str, unit: str) -> str:
    """Label of a measure."""
    kind, _, of = name.partition(".")
    words = r"$\tau_{s}$" if name == "tau_s" else _label(name)
    if kind in {"maxima", "section"}:
        words = "maxima of " * (kind == "maxima") + style.symbol(of.partition("@")[0])
    return style.with_unit(words, unit)


def _numbers(column: Any) -> Array:  # noqa: ANN401  # a column of any kind
    """Column as numbers: of words, the place of each among `_KINDS`."""
    if isinstance(column, np.ndarray):
        return column.astype(float)
    return np.array([[*_KINDS].index(text) if text in _KINDS else math.nan for text in column])


def _diagram(name: str, label: str, grid: list[str], labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Several values of each run over what varies last: a bifurcation diagram."""
    at = np.asarray(columns[grid[-1]] if grid else columns["run"], dtype=float)
    rows, ways = columns[name], columns.get("way")
    clouds, keys = [], []
    for way, colour in zip(("up", "down") if ways else ("",), COLOURS, strict=False):
        chosen = [i for i in range(len(at)) if not ways or ways[i] == way]
        x = np.concatenate([np.full(len(rows[i]), at[i]) for i in chosen] or [np.empty(0)])
        y = np.concatenate([np.asarray(rows[i]) for i in chosen] or [np.empty(0)])
        clouds.append(Line(x, y, colour, 0.0, marker=".", size=1.8 if way != "down" else 0.9))
        keys += [Line([], [], colour, 0.0, way, marker="o", size=6)] if way else []
    kind, _, of = name.partition(".")
    moved, _, crossed = of.partition("@")
    where = f": {moved} where {crossed} crosses 0 upwards" if crossed else f" of {moved}"
    more = " Followed up and down: each run begins where the one before it ended." if ways else ""
    caption = f"{capital(kind)}{where}, over the second half of each run.{more}"
    finish = functools.partial(_geometric, x=np.unique(at))
    panel = Panel(clouds, label, labels[grid[-1]] if grid else "run", ticks=5, finish=finish)
    return drawn(CaptionedFigure(f"diagram_{_file(name)}", "Bifurcation diagram", caption), [[panel]], 4.2, keys=keys)


def _curve(name: str, label: str, over: str, labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Measure over one parameter: the middle, and a band where there are several runs at each value."""
    at, column = np.asarray(columns[over], dtype=float), columns[name]
    values = np.unique(at)
    finish = functools.partial(_geometric, x=values)
    title = f"{capital(name)} over {over}"
    words = CaptionedFigure(f"curve_{_file(name)}", title, f"{capital(MEANINGS.get(name, name))}, over {over}")
    if not isinstance(column, np.ndarray):
        texts = [str(text) for text in column]
        kinds = [kind for kind in _KINDS if kind in texts and kind]
        shown = functools.partial(_shares, at=at, values=values, words=texts)
        panel = Panel([], "share of the runs", labels[over], None, (0.0, 1.0), ticks=5, finish=shown)
        words = replace(words, caption=f"{words.caption}: the share of the runs.")
        return drawn(words, [[panel]], 3.2, keys=_keys(kinds))
    with np.errstate(all="ignore"):
        groups = [column[at == value] for value in values]
        groups = [group[np.isfinite(group)] for group in groups]
        low, middle, high = np.array([np.quantile(g, _QUANTILES) if len(g) else [math.nan] * 3 for g in groups]).T
    has_band = max(map(len, groups)) > 1
    curve = [
        Line(values, middle, COLOURS[0], 1.6, marker="o" if len(values) < 30 else "", size=3),
        *([Band(values, low, high, COLOURS[0])] if has_band else []),
    ]
    known = middle[np.isfinite(middle)]
    wide = bool(len(known) and known.min() > 0.0 and known.max() > 300.0 * known.min())
    reach = None if wide else _range(np.concatenate([low, high]))
    more = ": the median, and a band from 10 % to 90 % of the runs." if has_band else "."
    panel = Panel(curve, label, labels[over], None, reach, "y" * wide, ticks=5, finish=finish)
    return drawn(replace(words, caption=f"{words.caption}{more}"), [[panel]], 3.2)


def _range(values: Array) -> tuple[float, float]:
    """Ends of an axis that shows values (m,), of which some may be none."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, 1.0
    least = _SAME * float(np.abs(finite).max()) or 1.0
    room = 0.06 * float(np.ptp(finite)) + 0.5 * max(0.0, least - float(np.ptp(finite)))
    return float(finite.min()) - room, float(finite.max()) + room


def _shares(axes: Axes, at: Array, values: Array, words: list[str]) -> None:
    """Draw the share of each word among the runs at each value."""
    kinds = [kind for kind in _KINDS if kind in words and kind]
    runs = [[w for w, a in zip(words, at, strict=True) if a == value] for value in values]
    shares = [[of_value.count(kind) / len(of_value) for of_value in runs] for kind in kinds]
    cells = edges(values)
    steps = [[*of_kind, of_kind[-1]] for of_kind in shares]
    axes.stackplot(cells, steps, colors=[_KINDS[kind] for kind in kinds], step="post")
    axes.set(xlim=cells[[0, -1]], ylim=(0.0, 1.0))
    axes.grid(visible=False)
    _geometric(axes, values)


def _keys(kinds: Iterable[str], labels: Mapping[str, str] | None = None) -> list[Span]:
    return [Span(0.0, 0.0, _KINDS[kind], (labels or {}).get(kind, kind), opacity=1.0) for kind in kinds]


def _map(name: str, label: str, grid: list[str], labels: Mapping[str, str], columns: Columns) -> CaptionedFigure:
    """Measure over two parameters: the median, or the commonest word."""
    x, y, column = np.asarray(columns[grid[0]]), np.asarray(columns[grid[1]]), columns[name]
    is_word = not isinstance(column, np.ndarray)
    across, up = np.unique(x), np.unique(y)
    places = np.searchsorted(across, x) * len(up) + np.searchsorted(up, y)
    numbers, cells = _numbers(column), np.full(len(across) * len(up), np.nan)
    order = np.argsort(places, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(places[order])) + 1):
        of_cell = numbers[group][np.isfinite(numbers[group])]
        if len(of_cell):
            cells[places[group[0]]] = Counter(of_cell.tolist()).most_common(1)[0][0] if is_word else np.median(of_cell)
    table = edges(across), edges(up), cells.reshape(len(across), len(up)).T
    keys: list[Span] = []
    if is_word:
        runs = Counter(text for text in column if text)
        shares = {str(kind): f"{kind} {share(runs[kind] / runs.total())}" for kind in runs}
        keys = _keys([kind for kind in _KINDS if kind in runs], shares)

    def finish(axes: Axes) -> None:
        if is_word:
            colours = ListedColormap(list(_KINDS.values()))
            axes.pcolormesh(*table, cmap=colours, vmin=-0.5, vmax=len(_KINDS) - 0.5, rasterized=True)
        else:
            mesh = axes.pcolormesh(*table, cmap="viridis", rasterized=True)
            figure = axes.figure
            assert isinstance(figure, Figure)  # noqa: S101  # for the type checker: these axes lie in no sub-figure
            figure.colorbar(mesh, ax=axes, pad=0.02).set_label(in_figure(label), color=INK)
        axes.grid(visible=False)
        _geometric(axes, across, up)

    how = "the commonest at each point; the legend has the share of each in all runs"
    how = how if is_word else "the median of the runs at each point"
    several = f": {how}" if len(column) > len(across) * len(up) else ""
    more = f", over all values of {' and '.join(grid[2:])}" if len(grid) > 2 else ""
    title = f"{capital(name)} over {grid[0]} and {grid[1]}"
    words = CaptionedFigure(f"map_{_file(name)}", title, f"{capital(MEANINGS.get(name, name))}{several}{more}.")
    return drawn(words, [[Panel([], labels[grid[1]], labels[grid[0]], ticks=8, finish=finish)]], 4.8, keys=keys)


def _distribution(name: str, label: str, column: Any) -> CaptionedFigure:  # noqa: ANN401  # a column of any kind
    """Histogram of a measure, or the share of each word."""
    title, file = f"Distribution of {name}", f"distribution_{_file(name)}"
    if isinstance(column, np.ndarray):
        finite = column[np.isfinite(column)]
        if not len(finite):
            return style.absent(file, title, "no run has a value")
        low, middle, high = np.quantile(finite, _QUANTILES)

        def histogram(axes: Axes) -> None:
            axes.hist(finite, bins=min(_BINS, max(5, len(finite) // 10)), color=COLOURS[0])
            axes.set_ylim(0.0, None)

        levels = [Level(value, axis="x") for value in (low, middle, high)]
        what = capital(MEANINGS.get(name, name))
        caption = f"{what}: median {middle:.4g}, from {low:.4g} to {high:.4g} in 80 % of the runs."
        panel = Panel(levels, "runs", label, ticks=5, finish=histogram)
        return drawn(CaptionedFigure(file, title, caption), [[panel]], 2.6)
    counts = Counter(text for text in column if text)
    if not counts:
        return style.absent(file, title, "no run has a value")
    shares = [count / counts.total() for count in counts.values()]

    def words_as_bars(axes: Axes) -> None:
        axes.barh(range(len(shares)), shares, height=0.66, color=[_KINDS.get(kind, MUTED) for kind in counts])
        bars(axes, [*counts])

    words = CaptionedFigure(file, title, f"{capital(MEANINGS.get(name, name))}: the share of the runs.")
    panel = Panel([], "", "share of the runs", (0.0, 1.0), finish=words_as_bars)
    return drawn(words, [[panel]], 0.5 + 0.3 * len(counts), left=_ROOM)


def _file(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)
