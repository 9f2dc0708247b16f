"""Panels: figures declared as lines, bands and limits on axes, and drawn by one function in one style.

    drawn(CaptionedFigure("motion", "Motion", "How it moved."), [[Panel([Line(t, x, COLOURS[0], key="x")], y="x (m)")]])

Heights, rooms, legends and labels follow from what the panels hold: what has a `key` stands in the legend.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from masking.compile.numerics.arrays import Array
from masking.display.palette import PAPER
from masking.display.symbols import in_figure
from masking.display.thinning import BINS, thin
from masking.model.declaration.quantities import number, percent
from masking.reports import style
from masking.reports.style import BAND, COLOURS, DASHED, GRID, INK, LIMIT, MUTED, RIGHT, SIZE, WIDTH, CaptionedFigure

Range = tuple[float, float]
Values = NDArray[Any] | Sequence[float]

_ROUND: Final = [1, 2, 2.5, 5, 10]  # steps of an axis
_MOST_LABELS: Final = 6  # of a logarithmic axis
_LETTERS, _BETWEEN = 130, 6  # of the keys that fit into a line of a legend, and the room of one's line
_KEY_LINE: Final = 0.2  # inches, of a further line of a legend
_TITLES: Final = 0.22  # inches above axes, for a line of words
_KEY_SIZE: Final = 6.0  # points, of a marker in a legend at most
_KEY: Final = 1.8  # least width in points of a full line in a legend, and 1 of a dashed line
_PREFIXES: Final = {1.0: "", 1e3: "m", 1e6: "µ", 1e9: "n"}  # of small values, by the factor
_LEAST: Final = 0.1  # of the largest value that is drawn, in its unit
Errors = Mapping[str, Mapping[str, float]]  # of each channel, by model
NOISE: Final = "noise floor"
_ROOM = 1.6  # of a logarithmic axis beside its first and last point
# How the errors of models are marked: of these, of the first of several others, and of any other.
_MARKS: Final[dict[str, dict[str, Any]]] = {
    "adjusted parameters": {"colour": COLOURS[1], "marker": "o", "size": 7, "order": 3},
    NOISE: {"colour": INK, "marker": "|", "size": 15, "order": 5},
}
_FIRST: Final[dict[str, Any]] = {"colour": PAPER, "marker": "o", "size": 6.5, "edge": MUTED}
_LAST: Final[dict[str, Any]] = {"colour": COLOURS[0], "marker": "o", "size": 7, "order": 4}


class Part(ABC):
    """Mark on axes; one with a `key` stands in the legend."""

    colour: str
    key: str
    opacity: float

    @abstractmethod
    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""

    def handle(self) -> Line2D | Patch:
        """Entry of the legend."""
        return Patch(color=self.colour, alpha=max(self.opacity, BAND), lw=0, label=in_figure(self.key))


@dataclass(frozen=True)
class Line(Part):
    """Line over x or points, each (m,); without numbers, only an entry of the legend.

    A width of 0 leaves points alone. Long lines are thinned to `bins` samples, or not at all for 0.
    """

    x: Values
    y: Values
    colour: str
    width: float = 1.4
    key: str = ""
    is_dashed: bool = False
    marker: str = ""
    size: float = 4.0
    edge: str = ""
    opacity: float = 1.0
    bins: int = BINS
    order: float = 2.0

    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""
        x, y = np.asarray(self.x, dtype=float), np.asarray(self.y, dtype=float)
        axes.plot(*(thin(x, y, self.bins) if self.width and self.bins else (x, y)), **self._style(self.width))

    def handle(self) -> Line2D:
        """Entry of the legend."""
        width = max(self.width, 1.0 if self.is_dashed else _KEY) if self.width else 0.0
        shown = replace(self, size=min(self.size, _KEY_SIZE) if self.marker in "os" else self.size)
        return Line2D([], [], label=in_figure(self.key), **shown._style(width))

    def _style(self, width: float) -> dict[str, Any]:
        line = (DASHED if self.is_dashed else "-") if width else ""
        edge = {"mec": self.edge, "mew": 1.0} if self.edge else {"mew": 0 if self.marker in "os^." else 1.4}
        points = {"marker": self.marker or None, "ms": self.size, **edge}
        return {"color": self.colour, "lw": width, "ls": line, "alpha": self.opacity, "zorder": self.order, **points}


@dataclass(frozen=True)
class Band(Part):
    """Filled space between two lines over x, each (m,)."""

    x: Values
    low: Values
    high: Values
    colour: str
    opacity: float = BAND
    key: str = ""
    order: float = 1.0

    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""
        fill = axes.fill_between(self.x, self.low, self.high, color=self.colour, alpha=self.opacity, lw=0)
        fill.set_zorder(self.order)


@dataclass(frozen=True)
class Span(Part):
    """Filled range of an axis, 'x' or 'y'."""

    low: float
    high: float
    colour: str
    key: str = ""
    axis: str = "x"
    opacity: float = 0.45

    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""
        fill = axes.axvspan if self.axis == "x" else axes.axhspan
        fill(self.low, self.high, color=self.colour, alpha=self.opacity, lw=0, zorder=0)


@dataclass(frozen=True)
class Level(Part):
    """Line across axes at a value of 'y' or 'x': a limit, a noise level, zero."""

    at: float
    colour: str = INK
    width: float = 0.9
    key: str = ""
    axis: str = "y"
    is_dashed: bool = True

    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""
        across = axes.axhline if self.axis == "y" else axes.axvline
        pattern = (0, (6, 2)) if self.colour == LIMIT else DASHED
        across(self.at, color=self.colour, lw=self.width, ls=pattern if self.is_dashed else "-", zorder=4)

    def handle(self) -> Line2D:
        """Entry of the legend."""
        return Line([], [], self.colour, self.width, self.key, is_dashed=self.is_dashed).handle()


def either_side(level: float, **style: Any) -> list[Level]:  # noqa: ANN401  # fields of a level
    """Lines between which noise or an input stays."""
    return [Level(-level, **style), Level(level, **style)]


@dataclass(frozen=True)
class Panel:
    """Axes: their marks, labels with units, and ranges.

    Of panels above each other with one range of x, only the last shows it. `ticks` are numbers on the axis of y, 0 for
    a few that are symmetric about zero; `title` stands above at the left, `note` at the right; `finish` is called with
    the axes at the end.
    """

    parts: Sequence[Part] = ()
    y: str = ""
    x: str = ""
    xlim: Range | None = None
    ylim: Range | None = None
    log: str = ""
    ticks: int = 0
    note: str = ""
    title: str = ""
    note_colour: str = MUTED
    finish: Callable[[Axes], None] | None = None

    def draw(self, axes: Axes) -> None:
        """Draw it on axes."""
        if self.ticks:  # first, since the range of an axis follows its numbers
            axes.yaxis.set_major_locator(MaxNLocator(self.ticks, steps=_ROUND))
        for part in self.parts:
            part.draw(axes)
        for name in self.log:
            axes.set(**{f"{name}scale": "log"})
            axis = {"x": axes.xaxis, "y": axes.yaxis}[name]
            axis.set_major_locator(LogLocator(numticks=_MOST_LABELS))
            axis.set_minor_formatter(NullFormatter())
        axes.set(xlabel=in_figure(self.x), ylabel=in_figure(self.y))
        if self.xlim is not None:
            axes.set_xlim(*self.xlim)
        if self.ylim is not None:
            axes.set_ylim(*self.ylim)
        axes.set_title(in_figure(self.note), loc="right", fontsize=SIZE - 1, color=self.note_colour, pad=3)
        axes.set_title(in_figure(self.title), loc="left", fontsize=SIZE - 1, color=MUTED, pad=3)
        if self.finish is not None:
            self.finish(axes)


def drawn(
    words: CaptionedFigure,
    rows: Sequence[Sequence[Panel]],
    heights: float | Sequence[float] = 1.35,
    *,
    widths: Sequence[float] = (),
    heading: str = "",
    keys: Sequence[Part] = (),
    left: float = style.LEFT,
    right: float = RIGHT,
) -> CaptionedFigure:
    """Figure of rows of panels with a heading, the finding, and a legend of all keys of the panels, after `keys`.

    Panels above each other that have one range of x have one axis of it. Heights, of all rows or of each, and the room
    beside the axes, `left` for labels and `right` for words, are in inches, widths of columns relative to each other.
    """
    every = [panel for row in rows for panel in row]
    parts: dict[str, Part] = {}
    for part in (*keys, *(part for panel in every for part in panel.parts)):
        parts.setdefault(part.key, part)
    parts.pop("", None)
    handles = [part.handle() for part in parts.values()]
    length = sum(len(key) + _BETWEEN for key in parts)
    columns = len(parts) if length <= _LETTERS else max(1, _LETTERS // (max(map(len, parts)) + _BETWEEN))
    lines = -(-len(parts) // max(1, columns))
    columns = -(-len(parts) // max(1, lines))
    has_words = [any(panel.note or panel.title for panel in row) for row in rows]
    above = _TITLES * has_words[0]
    if heading:
        top = (style.BELOW if handles else 0.06) + above
    else:
        top = style.LEGEND if handles else style.NOTE if above else style.BARE
    top += _KEY_LINE * max(0, lines - 1)
    joined = [_shares_range(upper, lower) for upper, lower in itertools.pairwise(rows)]
    gaps = [style.GAP if one else 0.62 + 0.1 * words for one, words in zip(joined, has_words[1:], strict=True)]
    each = [heights] * len(rows) if isinstance(heights, int | float) else [*heights]
    across = [_widths(row, widths, left, right) for row in rows]
    figure, grid = style.grid(each, across, gaps, top, heading=heading, left=left, right=right)
    for row, all_axes, is_joined in zip(rows, grid, [*joined, False], strict=True):
        for panel, axes in zip(row, all_axes, strict=True):
            panel.draw(axes)
            if is_joined:
                axes.tick_params(labelbottom=False)
                axes.set_xlabel("")
        for (a, b), axes in zip(itertools.pairwise(row), all_axes[1:], strict=True):
            if _shares_y(a, b):
                axes.tick_params(labelleft=False)
                axes.yaxis.get_offset_text().set_visible(False)
    for column in zip(*(row for row in grid if len(row) == len(grid[0])), strict=True):
        figure.align_ylabels(column)
    _legend(figure, grid[0][-1] if heading else None, handles, 0.04 + above, columns)
    return replace(words, figure=figure)


def _shares_range(upper: Sequence[Panel], lower: Sequence[Panel]) -> bool:
    same = len(upper) == len(lower)
    return same and all(a.xlim == b.xlim and a.x == b.x and a.x for a, b in zip(upper, lower, strict=True))


def _shares_y(left: Panel, right: Panel) -> bool:
    return not right.y and right.ylim is not None and left.ylim == right.ylim


def _widths(row: Sequence[Panel], shares: Sequence[float], left: float, right: float) -> list[float]:
    """Widths of the panels of a row in inches, with room for the labels of each but the first."""
    shares = shares if len(shares) == len(row) else [1.0] * len(row)
    between = [
        (0.95 if "y" in b.log else 0.78) if b.y else 0.2 if _shares_y(a, b) else 0.55
        for a, b in itertools.pairwise(row)
    ]
    whole = WIDTH - left - right - sum(between)
    return [whole * share / sum(shares) for share in shares]


def _legend(figure: Figure, below: Axes | None, handles: Sequence[Any], above: float, columns: int) -> None:
    """Put a legend at the right: some inches above axes, or at the top of the figure."""
    if not handles:
        return
    height, x = figure.get_size_inches()[1], 1.0 - RIGHT / WIDTH
    place: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (x, 1.0 - 0.09 / height)}
    if below is not None:
        place = {"loc": "lower right", "bbox_to_anchor": (x, below.get_position().y1 + above / height)}
    figure.legend(
        handles=list(handles), ncols=columns, frameon=False, fontsize=SIZE - 0.5, labelcolor=INK,
        borderaxespad=0, handlelength=1.8, columnspacing=1.4, **place,
    )  # fmt: skip


def spectrum(
    signals: Iterable[tuple[Array, str, float]], rate: float, noise: float | None, unit: str, key: str = ""
) -> Panel:
    """Amplitude densities over frequency, and that of white noise as a dashed line.

    Signals are values (m,), colour and width in points of each, sampled at a rate in Hz; `noise` is the standard
    deviation of the noise, None for no line, and `key` its entry in the legend.
    """
    lines = []
    for values, colour, width in signals:
        f, density = spectral_density(values, rate)
        lines.append(Line(f, density, colour, width))
    levels = [] if noise is None else [Level(noise_density(noise, rate), key=key)]
    ends = float(f[0]), float(f[-1])
    return Panel([*lines, *levels], f"{unit or '1'}/√Hz", "frequency (Hz)", ends, log="xy")


def plain_numbers(axis: Axis, unit: str = "", few: float = 60.0) -> None:
    """Give a logarithmic axis numbers without exponents, at 1, 2 and 5 if its ends have a ratio below `few`."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < few * low else (1.0,)))
    axis.set_major_formatter(StrMethodFormatter(f"{{x:g}}{unit}"))
    axis.set_minor_formatter(NullFormatter())


def bars(axes: Axes, names: Sequence[str]) -> None:
    """Name horizontal bars, the first on top."""
    axes.set(ylim=(len(names) - 0.4, -0.6))
    axes.set_yticks(range(len(names)), labels=[*map(in_figure, names)])
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)


def shown(unit: str, *values: Array | Sequence[float]) -> tuple[float, str]:
    """Factor and unit in which values of a unit are drawn together: small metres, volts and newtons in mm, µm or nm."""
    largest = max((float(np.abs(v).max()) for v in values if len(v)), default=0.0)
    if not largest or unit.partition("/")[0] not in {"m", "V", "N"}:
        return 1.0, unit
    by, prefix = next(((by, prefix) for by, prefix in _PREFIXES.items() if by * largest >= _LEAST), (1e9, "n"))
    return by, f"{prefix}{unit}"


def first_of(count: int, total: int, what: str = "") -> str:
    """Remark that only some are shown, of what is counted, in the plural; "" if all are."""
    return f" The first {count} of {total}{what and f' {what}'} are shown." if total > count else ""


def noise_density(deviation: float, rate: float) -> float:
    """Amplitude density of white noise of a standard deviation, sampled at a rate in Hz."""
    return float(deviation * np.sqrt(2.0 / rate))


def spectral_density(values: Array, rate: float, segments: int = 8, bins: int = 24) -> tuple[Array, Array]:
    """Frequencies in Hz, evenly over their logarithm, and the root of the power spectral density there (bins,).

    Of values (samples,), in their unit per root of Hz; `segments` overlap by half (Welch), and `bins` are per decade.
    """
    from scipy import signal  # noqa: PLC0415  # takes longer to load than all else here, and few figures need it

    length = min(max(2 * len(values) // (segments + 1), 16), len(values))
    f, power = signal.welch(values, rate, nperseg=length, detrend="constant")
    place = np.floor(bins * np.log10(f[1:] / f[1])).astype(int)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    counts = np.diff(np.append(first, len(place)))
    mean = [np.add.reduceat(column, first) / counts for column in (f[1:], power[1:])]
    return mean[0], np.sqrt(np.maximum(mean[1], 1e-300))


def error_panel(
    errors: Errors,
    ends: tuple[float, float],
    label: str,
    title: str = "",
    *,
    by: float = 100.0,
    has_values: bool = False,
) -> Panel:
    """Panel of errors, whose axis has ends and a label; those that are not positive are left out.

    They are shown times a factor, 100 in percent. With `has_values`, those of the first and of the last model stand at
    the right of the axes.
    """
    is_in_percent = by == 100.0

    def said(error: float) -> str:
        if not math.isfinite(error):
            return "not finite"
        return percent(error) if is_in_percent else number(error, 2)

    models = [name for name in errors if name != NOISE]
    channels = list(errors[models[0]])

    def finish(axes: Axes) -> None:
        bars(axes, [style.symbol(name) for name in channels])
        plain_numbers(axes.xaxis, " %" * is_in_percent)
        axes.xaxis.set_minor_locator(NullLocator())
        for i, name in enumerate(channels if has_values else ()):
            each = [errors[model][name] for model in dict.fromkeys((models[0], models[-1]))]
            axes.annotate(" → ".join(map(said, each)), (1.0, i), (6, 0), ("axes fraction", "data"),
                          textcoords="offset points", va="center", fontsize=SIZE - 1.0, color=INK)  # fmt: skip

    joined = []
    for i, name in enumerate(channels):
        *before, last = (by * errors[model][name] for model in models)
        joined += [Line([max(before), last], [i, i], GRID, 4.0, order=1)] if before else []
    dots = [
        Line([by * part[name] for name in channels], range(len(channels)), width=0.0, key=model,
             **_MARKS.get(model, _FIRST if model != models[-1] and model == models[0] else _LAST))
        for model, part in errors.items()
    ]  # fmt: skip
    first, last = ends
    return Panel([*joined, *dots], "", label, (by * first, by * last), log="x", title=title, finish=finish)


def error_reach(*sides: Errors) -> tuple[float, float] | None:
    """Ends of an axis on which all errors are; None where none is positive and finite."""
    every = [x for side in sides for part in side.values() for x in part.values() if 0.0 < x < math.inf]
    return (min(every) / _ROOM, max(every) * _ROOM) if every else None
