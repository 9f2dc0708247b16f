"""Parts of figures that several reports share: headings, legends, notes, axes, and spectra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import lazy_loader as lazy
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from masking.compile.numerics.arrays import Array
from masking.reports.style import DASHED, INK, MUTED, RIGHT, SIZE, WIDTH

if TYPE_CHECKING:
    from scipy import signal
else:
    signal = lazy.load("scipy.signal", suppress_warning=True)


PREFIXES = {1.0: "", 1e3: "m", 1e6: "µ", 1e9: "n"}  # of small values, by the factor
LEAST = 0.1  # of the largest value that is drawn, in its unit


def legend(figure: Figure, axes: Axes | None, handles: Sequence[Any], above: float = 0.04) -> None:
    """Put a legend at the right in a row: a number of inches above axes, or at the top of the figure.

    Args:
        figure: that has the axes.
        axes: below the legend; None for the top of the figure.
        handles: lines and markers with their labels.
        above: distance from the axes in inches.
    """
    if not handles:
        return
    height, x = figure.get_size_inches()[1], 1.0 - RIGHT / WIDTH
    place: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (x, 1.0 - 0.09 / height)}
    if axes is not None:
        place = {"loc": "lower right", "bbox_to_anchor": (x, axes.get_position().y1 + above / height)}
    figure.legend(
        handles=list(handles), ncols=len(handles), frameon=False, fontsize=SIZE - 0.5, labelcolor=INK,
        borderaxespad=0, handlelength=1.8, columnspacing=1.4, **place,
    )  # fmt: skip


def line_key(label: str, colour: str, width: float = 2.0, *, dashed: bool = False) -> Line2D:
    """Line of a legend.

    Args:
        label: text of the entry.
        colour: of the line.
        width: of the line in points.
        dashed: whether the line is dashed.
    """
    return Line2D([], [], color=colour, lw=width, ls=DASHED if dashed else "-", label=label)


def marker_key(label: str, colour: str, shape: str = "o", size: float = 6.0, **style: Any) -> Line2D:  # noqa: ANN401  # matplotlib's own
    """Marker of a legend.

    Args:
        label: text of the entry.
        colour: of the marker.
        shape: matplotlib's letter of the marker.
        size: in points.
        style: further properties of the marker.
    """
    return Line2D([], [], color=colour, marker=shape, ls="", ms=size, label=label, **style)


def note(axes: Axes, text: str, *, side: Literal["left", "right"] = "right", colour: str = MUTED) -> None:
    """Write a few words above axes, at the left or at the right.

    Args:
        axes: below the words.
        text: the words.
        side: 'left' or 'right'.
        colour: of the words.
    """
    axes.set_title(text, loc=side, fontsize=SIZE - 1, color=colour, pad=3)


def ticks(axes: Axes, count: int = 5) -> None:
    """Give an axis that is not symmetric about zero a few round numbers."""
    axes.yaxis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))


def logarithmic(axes: Axes, which: str = "xy", count: int = 5) -> None:
    """Make axes logarithmic, with a few numbers.

    Args:
        axes: to change.
        which: 'x', 'y' or both.
        count: numbers on an axis, at most.
    """
    for name in which:
        axes.set(**{f"{name}scale": "log"})
        axis = {"x": axes.xaxis, "y": axes.yaxis}[name]
        axis.set_major_locator(LogLocator(numticks=count))
        axis.set_minor_formatter(NullFormatter())


def plain_numbers(axis: Axis, unit: str = "", few: float = 60.0) -> None:
    """Give a logarithmic axis numbers without exponents, at 1, 2 and 5 if its ends have a ratio below `few`.

    Args:
        axis: to change.
        unit: written behind each number.
        few: ratio of the ends below which there are numbers between the powers of ten.
    """
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < few * low else (1.0,)))
    axis.set_major_formatter(StrMethodFormatter(f"{{x:g}}{unit}"))


def noise_band(axes: Axes, level: float) -> None:
    """Draw the two lines between which noise stays."""
    for side in (-level, level):
        axes.axhline(side, color=INK, lw=0.9, ls=DASHED, zorder=4)


def noise_level(spectrum: Axes, deviation: float, rate: float) -> float:
    """Draw the amplitude density of white noise of a standard deviation, sampled at a rate in Hz, and return it.

    Args:
        spectrum: axes of the spectrum.
        deviation: standard deviation of the noise.
        rate: sampling rate in Hz.
    """
    level = float(deviation * np.sqrt(2.0 / rate))
    spectrum.axhline(level, color=INK, lw=0.9, ls=DASHED, zorder=4)
    return level


def shown(unit: str, *values: Array | Sequence[float]) -> tuple[float, str]:
    """Factor and unit in which values are drawn: small metres, volts and newtons in mm, µm or nm.

    Args:
        unit: of the values, as it is shown.
        values: those that are drawn together.
    """
    largest = max((float(np.abs(v).max()) for v in values if len(v)), default=0.0)
    if not largest or unit.partition("/")[0] not in {"m", "V", "N"}:
        return 1.0, unit
    by, prefix = next(((by, prefix) for by, prefix in PREFIXES.items() if by * largest >= LEAST), (1e9, "n"))
    return by, f"{prefix}{unit}"


def first_of(count: int, total: int, what: str = "") -> str:
    """Say that only some are shown; "" if all are.

    Args:
        count: number that are shown.
        total: number of all.
        what: what is counted, in the plural.
    """
    return f" The first {count} of {total}{what and f' {what}'} are shown." if total > count else ""


def spectral_density(values: Array, rate: float, segments: int = 8, bins: int = 24) -> tuple[Array, Array]:
    """Frequencies, evenly over their logarithm, and the root of the power spectral density there.

    Args:
        values: (samples,).
        rate: in Hz.
        segments: that the record is cut into, half of each in the next (Welch).
        bins: per decade.

    Returns:
        frequencies in Hz (bins,), and the density in units of the values per root of Hz (bins,).
    """
    length = min(max(2 * len(values) // (segments + 1), 16), len(values))
    f, power = signal.welch(values, rate, nperseg=length, detrend="constant")
    place = np.floor(bins * np.log10(f[1:] / f[1])).astype(int)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    counts = np.diff(np.append(first, len(place)))
    mean = [np.add.reduceat(column, first) / counts for column in (f[1:], power[1:])]
    return mean[0], np.sqrt(np.maximum(mean[1], 1e-300))
