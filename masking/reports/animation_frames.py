"""Frames of an animation: pictures of single instants, and films of many."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import animation as films
from matplotlib import rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch
from PIL import Image

from masking.display.axes import DASHED, DPI, SIZE, dress, with_unit
from masking.display.palette import COLOURS, GRID, INK, MUTED
from masking.display.symbols import in_figure, tex
from masking.errors import RecordError
from masking.reports.animation import PERIODS, Animation, Scene
from masking.reports.text import capital

FILMS: Final = (".gif", ".mp4")
_WIDTH, _TRACE, _HEAD, _FOOT = 9.0, 1.35, 0.62, 0.5  # inches
_MOST_HEIGHT: Final = 3.6  # inches, of a drawing
_RATE, _LONGEST = 20, 12.0  # frames per second, and seconds of a film
_FILM_DPI: Final = 100
_COLOURS_OF_GIF: Final = 64
_PROGRAM: Final = ("animation.ffmpeg_path", "animation.ffmpeg_args")
_TURNS: Final = 12  # of a spring, each half

Numbers = Sequence[float]


def picture(shown: Animation, t: float, file: Path) -> None:
    """Write the instant t, in s, as a PNG or SVG file, by its ending."""
    figure, draw = _sheet(shown)
    draw(t)
    figure.savefig(file)


def film(shown: Animation, file: Path, progress: Callable[[float], None]) -> None:
    """Write a film, of 12 s at most, in the format of its ending; a `RecordError` says that this needs ffmpeg."""
    # matplotlib reads settings in the current folder, too: they must not say which program it runs.
    with rc_context({name: rcParamsDefault[name] for name in _PROGRAM}):
        _film(shown, file, progress)


def _film(shown: Animation, file: Path, progress: Callable[[float], None]) -> None:
    writer = films.FFMpegWriter(fps=_RATE)
    if file.suffix != ".gif" and not writer.isAvailable():
        raise RecordError(f"{file}: an mp4 file needs ffmpeg, which is not installed; write a .gif or .html file")
    figure, draw = _sheet(shown)
    figure.set_dpi(_FILM_DPI)
    first, last = shown.recording.t[[0, -1]]
    count = max(2, int(_RATE * min(_LONGEST, (last - first) / shown.speed)))

    def drawn() -> Iterator[int]:
        for i in range(count):
            draw(min(last, first + shown.speed * i / _RATE))
            yield i
            progress((i + 1) / count)

    if file.suffix == ".gif":
        _save_gif(figure, drawn(), file)
        return
    with writer.saving(figure, str(file), dpi=_FILM_DPI):
        for _ in drawn():
            writer.grab_frame()


def _save_gif(figure: Figure, drawn: Iterator[int], file: Path) -> None:
    """Write a GIF file with the colours of its first frame, and without dithering: a quarter of the size."""
    canvas: Any = FigureCanvasAgg(figure)  # its methods have no types
    frames: list[Image.Image] = []
    palette: Image.Image | None = None
    for _ in drawn:
        canvas.draw()
        frame = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        palette = palette or frame.quantize(_COLOURS_OF_GIF)
        frames.append(frame.quantize(palette=palette, dither=Image.Dither.NONE))
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=round(1000 / _RATE), loop=0)


def _sheet(shown: Animation) -> tuple[Figure, Callable[[float], None]]:
    """Figure with axes for the scenes and the motion, and what draws an instant on it."""
    width = (_WIDTH - 0.4) / len(shown.scenes)
    heights = [(one.view[3] - one.view[2]) / (one.view[1] - one.view[0]) * width for one in shown.scenes]
    above = min(_MOST_HEIGHT, max(heights))
    total = _HEAD + above + 0.35 + _TRACE + _FOOT
    figure = Figure(figsize=(_WIDTH, total), dpi=DPI, facecolor="white")
    bottom = (_FOOT + _TRACE + 0.35) / total
    places = [((0.2 + i * width) / _WIDTH, bottom, 0.98 * width / _WIDTH, above / total) for i in range(len(heights))]
    scenes = [figure.add_axes(place) for place in places]
    trace = figure.add_axes((0.75 / _WIDTH, _FOOT / total, (_WIDTH - 1.0) / _WIDTH, _TRACE / total))
    head = 1.0 - 0.12 / total
    for (x, *_), scene in zip(places, shown.scenes, strict=True):
        words = f"{scene.what}{f'; motion magnified {scene.factor} times' if scene.factor != 1 else ''}"
        words += "; dashed: by itself" if scene.prefix == "virtual" else ""
        figure.text(
            x, head, in_figure(capital(scene.drawing.title)), fontsize=SIZE + 1, color=INK, va="top", weight="bold"
        )
        figure.text(x, head - 0.22 / total, in_figure(words), fontsize=SIZE - 1, color=MUTED, va="top")

    def draw(t: float) -> None:
        for scene, axes in zip(shown.scenes, scenes, strict=True):
            _draw_scene(axes, shown, scene, t)
        _draw_trace(trace, shown, t)

    return figure, draw


def _draw_scene(axes: Axes, shown: Animation, scene: Scene, t: float) -> None:
    axes.clear()
    axes.set_axis_off()
    axes.set(xlim=scene.view[:2], ylim=scene.view[2:], aspect="equal")
    drawing, size = scene.drawing, scene.view[1] - scene.view[0]
    for prefix in (scene.prefix, "ideal") if scene.prefix == "virtual" else (scene.prefix,):
        columns = shown.recording.columns
        names = [f"{prefix}.{name}" for name in drawing.coordinates]
        if not columns.keys() >= {*names}:  # the ideal motion was not recorded
            continue
        at = (float(np.interp(t, shown.recording.t, columns[name])) for name in names)
        q = [scene.factor * unit * x for unit, x in zip(scene.sizes, at, strict=True)]
        rows = drawing.numbers(t, q)
        for shape, numbers, colour in zip(drawing.shapes, rows, drawing.colours, strict=True):
            kind = shape.kinds[0]
            if prefix != "ideal":
                _SHAPES[kind](axes, numbers, colour, in_figure(shape.label), size)
            elif kind in _OUTLINES:
                _OUTLINES[kind](axes, numbers)


def _draw_trace(axes: Axes, shown: Animation, t: float) -> None:
    axes.clear()
    recording, main = shown.recording, shown.main
    dress(axes)
    first, last = recording.t[[0, -1]]
    span = min(PERIODS * shown.period, last - first)
    begin = min(max(first, t - 0.7 * span), last - span)
    rows = (recording.t >= begin) & (recording.t <= begin + span)
    units = [recording.units.get(f"{main.prefix}.{name}", "") for name in main.drawing.coordinates]
    common = units[0] if len(set(units)) == 1 else ""
    for name, unit, colour in zip(main.drawing.coordinates, units, COLOURS, strict=False):
        series = recording[f"{main.prefix}.{name}"]
        label = in_figure(with_unit(tex(name), "" if common else unit))
        axes.plot(recording.t[rows], series[rows], color=colour, lw=1.3, label=label)
        ideal = recording.columns.get(f"ideal.{name}")
        if ideal is not None:
            axes.plot(recording.t[rows], ideal[rows], color=INK, lw=0.8, ls=DASHED)
        axes.plot(t, np.interp(t, recording.t, series), "o", color=colour, ms=4)
    axes.axvline(t, color=MUTED, lw=0.9)
    motions = [recording[f"{main.prefix}.{name}"] for name in main.drawing.coordinates]
    most = float(np.abs(np.array(motions)).max()) or 1.0
    axes.set(xlim=(begin, begin + span), ylim=(-1.08 * most, 1.08 * most), xlabel="time (s)")
    axes.set_ylabel(in_figure(with_unit("motion", common)))
    axes.legend(frameon=False, fontsize=SIZE - 1, ncols=len(COLOURS), loc="lower right", bbox_to_anchor=(1.0, 0.97))


def _ground(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    start, way = np.array(n[:2]), np.array(n[2:]) - n[:2]
    length = float(np.hypot(*way)) or 1.0
    along = way / length
    right = np.array([along[1], -along[0]])
    step = 0.021 * size
    feet = [start + place * along for place in np.arange(0.8 * step, length, step)]
    hatching = [(a, a + step * (0.8 * right - 0.65 * along)) for a in feet]
    axes.add_collection(LineCollection(hatching, colors=GRID, lw=1.0))
    axes.plot([n[0], n[2]], [n[1], n[3]], color=colour, lw=1.3)


def _rod(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    axes.plot([n[0], n[2]], [n[1], n[3]], color=colour, lw=2.8, solid_capstyle="round")


def _spring(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    start, way = np.array(n[:2]), np.array(n[2:]) - n[:2]
    across = np.array([-way[1], way[0]]) / (float(np.hypot(*way)) or 1.0) * 0.016 * size
    turns = [(0.12 + 0.76 * (i + 0.5) / _TURNS, -1.0 if i % 2 else 1.0) for i in range(_TURNS)]
    points = [start + s * way + side * across for s, side in [(0.0, 0.0), (0.12, 0.0), *turns, (0.88, 0.0), (1.0, 0.0)]]
    axes.plot(*np.transpose(points), color=colour, lw=1.1, solid_joinstyle="round")


def _body(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    axes.add_patch(_box(n, fc="white", ec="none"))
    axes.add_patch(_box(n, fc=f"{colour}33", ec=colour, lw=1.5))
    axes.text(n[0], n[1], label, ha="center", va="center", fontsize=SIZE - 1, color=INK)


def _box(n: Numbers, **style: Any) -> FancyBboxPatch:  # noqa: ANN401  # matplotlib's own
    rounding = 0.08 * min(n[2], n[3])
    corner = (n[0] - n[2] / 2 + rounding, n[1] - n[3] / 2 + rounding)
    shape = f"round,pad={rounding},rounding_size={rounding}"
    return FancyBboxPatch(corner, n[2] - 2 * rounding, n[3] - 2 * rounding, boxstyle=shape, **style)


def _arm(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    x, y = n[0] + n[2] * np.sin(n[3]), n[1] - n[2] * np.cos(n[3])
    axes.plot([n[0], x], [n[1], y], color=colour, lw=1.8)
    axes.plot(n[0], n[1], "o", color=MUTED, ms=4)
    _circle(axes, (x, y), n[4], colour)
    axes.text(x, y, label, ha="center", va="center", fontsize=SIZE - 1, color=INK, zorder=6)


def _disc(axes: Axes, n: Numbers, colour: str, label: str, size: float) -> None:
    _circle(axes, (n[0], n[1]), n[2], colour)
    x, y = n[0] + n[2] * np.sin(n[3]), n[1] - n[2] * np.cos(n[3])
    axes.plot([n[0], x], [n[1], y], "o-", color=colour, lw=1.8, ms=5, zorder=6)
    axes.text(n[0], n[1] + n[2] / 2, label, ha="center", va="center", fontsize=SIZE - 1, color=INK, zorder=6)


def _circle(axes: Axes, centre: tuple[float, float], radius: float, colour: str) -> None:
    axes.add_patch(Circle(centre, radius, fc="white", ec="none", zorder=4))
    axes.add_patch(Circle(centre, radius, fc=f"{colour}33", ec=colour, lw=1.5, zorder=5))


def _dashed_body(axes: Axes, n: Numbers) -> None:
    axes.add_patch(_box(n, fc="none", ec=INK, lw=0.8, ls=DASHED, zorder=7))


def _dashed_arm(axes: Axes, n: Numbers) -> None:
    x, y = n[0] + n[2] * np.sin(n[3]), n[1] - n[2] * np.cos(n[3])
    part = 1.0 - n[4] / n[2]
    axes.plot([n[0], n[0] + part * (x - n[0])], [n[1], n[1] + part * (y - n[1])], color=INK, lw=0.8, ls=DASHED)
    axes.add_patch(Circle((x, y), n[4], fc="none", ec=INK, lw=0.8, ls=DASHED, zorder=7))


def _dashed_disc(axes: Axes, n: Numbers) -> None:
    spoke = [n[0], n[0] + n[2] * np.sin(n[3])], [n[1], n[1] - n[2] * np.cos(n[3])]
    axes.plot(*spoke, color=INK, lw=0.8, ls=DASHED, zorder=7)


_SHAPES: Final = {"ground": _ground, "rod": _rod, "spring": _spring, "body": _body, "arm": _arm, "disc": _disc}
_OUTLINES: Final = {"body": _dashed_body, "arm": _dashed_arm, "disc": _dashed_disc}
