"""Plots in the way of the document: transients of oscillators and beam, and their phase difference."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from masking.reports.style import COLOURS, INK, LEGEND, SIZE, Series, sheet, symbol, thin
from reproduction.motion import Motion

FLOOR = 1e-5  # of a logarithmic axis
PIXELS = 85  # per inch: the page stays small
BLUE, RED = COLOURS[0], COLOURS[1]  # the colours of the rig's oscillators


def transient(motion: Motion, title: str, *, time: str = r"$\tau$") -> bytes:
    """Draw the oscillators, the beam and the phase difference over time, as Fig. 5.1 does.

    Args:
        motion: what is drawn.
        title: of the picture.
        time: label of the time axis.

    Returns:
        content of a PNG file.
    """
    figure, (top, middle, bottom) = sheet([1.5, 0.9, 0.9], top=LEGEND)
    names = _symbols(motion)
    for series, colour in ((motion.a, BLUE), (motion.b, RED)):
        top.plot(*thin(motion.t, series), color=colour, lw=0.6, alpha=0.85)
    middle.plot(*thin(motion.t, motion.c), color=INK, lw=0.6)
    # The curve is broken where the phase passes the seam of its interval.
    phase = motion.phase / np.pi
    jumps = np.abs(np.diff(phase, prepend=phase[0])) > 1.0
    bottom.plot(motion.t, np.where(jumps, np.nan, phase), color=COLOURS[2], lw=1.0)
    bottom.axhline(1.0, color=INK, lw=0.8, ls="--")
    top.set_ylabel(f"{names[0]}, {names[1]}")
    middle.set_ylabel(names[2])
    bottom.set(ylabel=r"$\Delta\varphi\,/\,\pi$", xlabel=time, ylim=(-0.5, 1.5), yticks=(0.0, 0.5, 1.0, 1.5))
    for axes in (top, middle, bottom):
        axes.set_xlim(motion.t[0], motion.t[-1])
    return _png(figure, _handles(names, (BLUE, RED, INK)), title)


def sums(motions: Mapping[str, Motion], title: str, *, time: str = r"$\tau$") -> bytes:
    """Draw |a + b| of several motions over time on a logarithmic scale."""
    figure, (axes,) = sheet([2.4], top=LEGEND)
    for motion, colour in zip(motions.values(), COLOURS, strict=False):
        total = np.abs(motion.a + motion.b)
        axes.semilogy(*thin(motion.t, np.maximum(total, FLOOR)), color=colour, lw=0.6)
    one, other, _ = (name.strip("$") for name in _symbols(motion))
    axes.set(ylabel=f"$|{one} + {other}|$", xlabel=time, xlim=(motion.t[0], motion.t[-1]))
    return _png(figure, _handles(motions, COLOURS), title)


def steady(motion: Motion, seconds: float, title: str, *, time: str) -> bytes:
    """Draw the last seconds of oscillators and beam, as Fig. 5 of the paper does."""
    figure, (top, bottom) = sheet([1.5, 1.1], top=LEGEND)
    last = motion.t >= motion.t[-1] - seconds
    names = _symbols(motion)
    for axes, pairs in ((top, ((motion.a, BLUE), (motion.b, RED))), (bottom, ((motion.c, INK),))):
        for series, colour in pairs:
            axes.plot(motion.t[last], series[last], color=colour, lw=1.2)
        axes.set_xlim(motion.t[last][0], motion.t[-1])
    top.set_ylabel(f"{names[0]}, {names[1]}")
    bottom.set(ylabel=names[2], xlabel=time)
    return _png(figure, _handles(names, (BLUE, RED, INK)), title)


def curves(
    x: Series, rows: Sequence[tuple[str, Mapping[str, Series]]], label: str, title: str, *, height: float = 1.5
) -> bytes:
    """Draw rows of curves over one axis; each row is its label and its curves by name, one legend for all.

    Args:
        x: of all curves (m,).
        rows: label of the axis, and curves (m,) by name, of each row.
        label: of the horizontal axis.
        title: of the picture.
        height: of each row, inches.
    """
    figure, all_axes = sheet([height] * len(rows), top=LEGEND)
    named: dict[str, str] = {}
    for axes, (vertical, drawn) in zip(all_axes, rows, strict=True):
        for name, series in drawn.items():
            colour = named.setdefault(name, COLOURS[len(named) % len(COLOURS)])
            axes.plot(*thin(x, series), color=colour, lw=1.1, ls="--" if name.startswith("linear") else "-")
        axes.set(ylabel=vertical, xlim=(x[0], x[-1]))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        if all(np.nanmin(series) >= 0.0 for series in drawn.values()):
            axes.set_ylim(bottom=0.0)
    all_axes[-1].set_xlabel(label)
    return _png(figure, _handles(named, named.values()), title)


def lines(drawn: Sequence[tuple[Series, Series]], labels: tuple[str, str], title: str) -> bytes:
    """Draw curves without names, each of its own x and y (m,), which may return on themselves."""
    figure, (axes,) = sheet([2.6], top=LEGEND)
    for number, (x, y) in enumerate(drawn):
        axes.plot(x, y, color=COLOURS[number % len(COLOURS)], lw=0.9)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    return _png(figure, [], title)


def valley(x: Series, drawn: Mapping[str, Series], labels: tuple[str, str], title: str) -> bytes:
    """Draw curves that are scaled between 0 and 1 on a logarithmic scale, as Fig. 8.4 does.

    Args:
        x: of all curves (m,).
        drawn: curves (m,) by name.
        labels: of the axes.
        title: of the picture.
    """
    figure, (axes,) = sheet([2.8], top=LEGEND)
    for series, colour in zip(drawn.values(), COLOURS, strict=False):
        axes.semilogy(x, np.where(series > 0.0, series, np.nan), color=colour, lw=1.2)
    axes.set(xlabel=labels[0], ylabel=labels[1], xlim=(0.0, x[-1]), ylim=(1e-3, 1.2))
    return _png(figure, _handles(drawn, COLOURS), title)


def _symbols(motion: Motion) -> list[str]:
    """Return the names of a motion, typeset; th stands for theta."""
    return [symbol(re.sub(r"^th(?=\d)", "theta", name)) for name in motion.names]


def _handles(names: Iterable[str], colours: Iterable[str]) -> list[Line2D]:
    """Return the entries of a legend; colours that are left over have none."""
    return [Line2D([], [], color=c, label=n) for n, c in zip(names, colours, strict=False)]


def _png(figure: Figure, handles: list[Line2D], title: str) -> bytes:
    figure.legend(handles=handles, loc="upper right", ncols=len(handles), frameon=False, fontsize=SIZE - 1)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=PIXELS, metadata={"Title": title})
    return stream.getvalue()
