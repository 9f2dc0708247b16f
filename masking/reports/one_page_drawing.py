"""Drawing of one page: A4 upright, with letters as large as its text allows, and the rest of a long text left out.

Every line is measured before it is drawn, so that no text leaves the page or its column.
"""

from __future__ import annotations

import bisect
import io
import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path

from masking.display.palette import INK, LIGHT, LIMIT, MUTED
from masking.display.symbols import in_figure
from masking.reports import html, panels, style
from masking.reports.html import Tile
from masking.reports.one_page import PAGE, PICTURE, Sheet
from masking.reports.panels import bars
from masking.reports.text import capital, short

_INCH = 72.0  # points
_WIDTH, _HEIGHT = 210.0 / 25.4, 297.0 / 25.4  # inches
_MARGIN, _FOOT = 0.7, 0.3  # inches
_TEXT = _WIDTH - 2.0 * _MARGIN
_PITCH = 1.36  # of lines, in sizes of their letters
_FIRST, _LAST, _STEP = 10.5, 7.0, 0.5  # points: sizes of letters that are tried
# Paragraphs of a section, and letters of each.
_CUTS = (60, 6000), (14, 700), (10, 450), (6, 300), (4, 200), (2, 120), (1, 50)
_NAME, _VALUES = 1.9, 1.5  # inches beside the errors at most: for names, and for values
_FEWEST_TILES, _MOST_TILES, _MOST_CHANNELS, _MOST_MODELS, _MOST_SECTIONS = 3, 5, 8, 5, 8
_ROW, _AXIS, _KEYS, _KEY = 0.27, 0.45, 0.3, 0.5  # inches: of a channel, below the errors, above them, of a mark above
_SMALL = style.SIZE - 1.0  # points, of names


def drawn(sheet: Sheet) -> Figure:
    """Figure of a page, which all fits on."""
    sizes = [_FIRST - i * _STEP for i in range(round((_FIRST - _LAST) / _STEP) + 1)]
    for size, cut in [*((size, _CUTS[0]) for size in sizes), *((_LAST, cut) for cut in _CUTS[1:])]:
        page = _Page(sheet, size, cut)
        if page.y >= _MARGIN + _FOOT:
            break
    return page.figure


def save(sheet: Sheet, folder: Path) -> tuple[Path, Path]:
    """Write a page as `one_page.pdf` and `one_page.png` into a folder, both or none; return their paths.

    The same sheet makes the same bytes. The PDF has its letters as text, with their outlines. Raises a `RecordError`
    where the folder cannot be written.
    """
    figure, contents = drawn(sheet), dict[str, bytes | str]()
    # Letters that are fitted to the points of a picture are wider than measured.
    with mpl.rc_context({"pdf.fonttype": 42, "text.hinting": "none"}):
        for name, more in ((PAGE, {"CreationDate": None}), (PICTURE, {})):
            stream = io.BytesIO()
            form, about = name.rpartition(".")[2], {"Title": sheet.title, **more}
            figure.savefig(stream, format=form, dpi=style.DPI, metadata=about)
            contents[name] = stream.getvalue()
    with html.staged(folder) as made:
        html.write({made / name: content for name, content in contents.items()})
    return folder / PAGE, folder / PICTURE


@cache
def _advance(letter: str, weight: str) -> float:
    """Width of a letter, in sizes of its font."""
    font = FontProperties(size=_INCH, weight=weight)
    return float(text_to_path.get_text_width_height_descent(letter, font, ismath=False)[0]) / _INCH


def _length(text: str, size: float, weight: str = "normal") -> float:
    """Length of a line in inches at most: letters that are set closer make it shorter."""
    return sum(_advance(letter, weight) for letter in text) * size / _INCH


def _most(text: str, fits: Callable[[int], bool]) -> int:
    """Number of letters up to which something fits, at least 1."""
    return max(1, bisect.bisect_left(range(1, len(text) + 1), 1, key=lambda letters: not fits(letters)))


def wrapped(text: str, width: float, size: float, weight: str = "normal") -> list[str]:
    """Lines of a text of at most a width in inches; words that are longer are parted."""
    kept = style.unparted(text)

    def lines(letters: int) -> list[str]:
        return textwrap.wrap(kept, letters, break_on_hyphens=False)

    return lines(_most(kept, lambda letters: all(_length(line, size, weight) <= width for line in lines(letters))))


def _fitting(text: str, width: float, size: float) -> str:
    """Text of one line, cut to a width in inches."""
    return short(text, _most(text, lambda letters: _length(short(text, letters), size) <= width))


class _Page:
    """Page that is written from above; `y` is where it goes on, in inches from below."""

    def __init__(self, sheet: Sheet, size: float, cut: tuple[int, int]) -> None:
        self.figure, self.size, self.cut = Figure(figsize=(_WIDTH, _HEIGHT), facecolor="white"), size, cut
        self.y, self.is_cut = _HEIGHT - _MARGIN, False
        self.write([capital(sheet.title)], 1.9 * size, weight="bold")
        self.write(sheet.subject, 0.8 * size, colour=MUTED)
        self._tiles(sheet.tiles)
        self.is_cut |= len(sheet.sections) > _MOST_SECTIONS
        for number, (heading, paragraphs) in enumerate([*sheet.sections.items()][:_MOST_SECTIONS]):
            self.y -= 0.9 * size / _INCH
            self.write([heading], 1.2 * size, weight="bold", colour=LIGHT["accent"])
            self.write(paragraphs, size)
            if number == 0 and sheet.errors:
                self._errors(sheet)
        below, self.y = self.y, _MARGIN + _LAST * _PITCH / _INCH
        more = f"Shortened to one page; {sheet.page} has all." if self.is_cut else f"{sheet.page} has more."
        self.write([more], _LAST, colour=MUTED)
        self.y = below

    def write(
        self, paragraphs: Iterable[str], size: float, *, left: float = _MARGIN, width: float = _TEXT, **look: str
    ) -> None:
        """Write paragraphs in a column, with a little room between them; `look` is their weight and colour."""
        weight, colour, every = look.get("weight", "normal"), look.get("colour", INK), [*paragraphs]
        most, letters = self.cut
        shown = [short(text, letters) for text in every[:most]]
        self.is_cut |= shown != every
        for number, text in enumerate(shown):
            self.y -= 0.25 * size / _INCH if number else 0.0
            for line in wrapped(text, width, size, weight):
                self.y -= size * _PITCH / _INCH
                place = left / _WIDTH, (self.y + 0.3 * size / _INCH) / _HEIGHT
                self.figure.text(*place, line, fontsize=size, weight=weight, color=colour, parse_math=False)

    def _tiles(self, tiles: Sequence[Tile]) -> None:
        """Write numbers side by side, each in a column of its own with a label above and a unit below."""
        shown, gap = tiles[:_MOST_TILES], 0.12
        self.is_cut |= len(tiles) > _MOST_TILES
        step = (_TEXT + gap) / max(_FEWEST_TILES, len(shown))
        top = lowest = self.y = self.y - 0.6 * self.size / _INCH
        for number, tile in enumerate(shown):
            self.y, left, width = top - 0.07, _MARGIN + number * step + gap, step - 2.5 * gap
            large = 1.7 * self.size
            large *= min(1.0, max(0.5, width / max(_length(tile.value, large, "bold"), 1e-9)))
            self.write([tile.label], 0.8 * self.size, left=left, width=width, colour=MUTED)
            colour = LIMIT if tile.is_wrong else INK
            self.write([tile.value], large, left=left, width=width, weight="bold", colour=colour)
            self.write([tile.unit] if tile.unit else [], 0.8 * self.size, left=left, width=width, colour=MUTED)
            lowest = min(lowest, self.y)
        self.y = lowest - 0.07
        for number, tile in enumerate(shown):
            x, edge = _MARGIN + number * step, LIMIT if tile.is_wrong else LIGHT["accent"]
            for width, colour in ((step - gap, LIGHT["tint"]), (0.03, edge)):
                corner, sides = (x / _WIDTH, self.y / _HEIGHT), (width / _WIDTH, (top - self.y) / _HEIGHT)
                self.figure.add_artist(Rectangle(corner, *sides, color=colour, lw=0, zorder=-1))

    def _errors(self, sheet: Sheet) -> None:
        """Draw the errors of each channel before and after, the first channels of many, with their legend above."""
        channels = list(dict.fromkeys(name for part in sheet.errors.values() for name in part))
        shown, models = channels[:_MOST_CHANNELS], list(sheet.errors)[:_MOST_MODELS]
        self.is_cut |= len(channels) > _MOST_CHANNELS or len(sheet.errors) > _MOST_MODELS
        whole = {model: {name: sheet.errors[model].get(name, math.inf) for name in shown} for model in models}
        ends = panels.error_reach(whole)
        if ends is None or whole.keys() <= {panels.NOISE}:
            return
        self.y -= 0.9 * self.size / _INCH
        self.write([sheet.errors_title], 1.2 * self.size, weight="bold", colour=LIGHT["accent"])
        names = [_fitting(name, _NAME, _SMALL) for name in shown]
        beside = max(_length(name, _SMALL) for name in names) + 0.15
        across = _TEXT - beside - _VALUES
        label = _fitting(sheet.errors_label, across, style.SIZE)
        drawing = panels.error_panel(whole, ends, label, by=100.0 if sheet.in_percent else 1.0, has_values=True)
        handles, room = list[Artist](), _TEXT - _KEY * len(whole)
        each = math.inf if sum(_length(model, _SMALL) for model in whole) <= room else room / len(whole)
        for part in drawing.parts if len(whole) > 1 else ():
            if part.key:
                handles.append(part.handle())
                handles[-1].set_label(in_figure(_fitting(part.key, each, _SMALL)))
        self.figure.legend(
            handles=handles, loc="upper left", ncols=max(1, len(handles)), frameon=False, borderaxespad=0, borderpad=0,
            bbox_to_anchor=(_MARGIN / _WIDTH, (self.y - 0.04) / _HEIGHT), fontsize=_SMALL, labelcolor=INK,
        )  # fmt: skip
        height = _ROW * len(shown)
        self.y -= (_KEYS if handles else 0.08) + height
        left = (_MARGIN + beside) / _WIDTH
        axes = self.figure.add_axes((left, self.y / _HEIGHT, across / _WIDTH, height / _HEIGHT))
        style.dress(axes)
        drawing.draw(axes)
        bars(axes, list(map(style.symbol, names)))
        self.y -= _AXIS
