"""Fragments of HTML for notebooks: a card with a title, tables, small lines. They take the colours around them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from markupsafe import Markup

from masking.display.palette import COLOURS, RULE
from masking.display.thinning import Series, envelope

_CARD: Final = Markup(
    "<div style=\"font:14px/1.5 system-ui,-apple-system,'Segoe UI',sans-serif;max-width:60rem\">"
    '<div style="font-size:1.1em;font-weight:600">{}</div><div style="opacity:.75;margin-bottom:.4em">{}</div>{}</div>'
)
_TABLE: Final = Markup(
    '<table style="border-collapse:collapse;margin:.4em 0;font-variant-numeric:tabular-nums">'
    "<thead><tr>{}</tr></thead><tbody>{}</tbody></table>"
)
_HEAD: Final = Markup('<th style="text-align:{};font-weight:500;opacity:.7;padding:.1em 1.4em .1em 0">{}</th>')
_CELL: Final = Markup('<td style="text-align:{};padding:.1em 1.4em .1em 0;border-top:1px solid {}">{}</td>')
_LINE: Final = Markup(
    '<svg width="{0}" height="{1}" viewBox="0 0 {0} {1}" style="display:block">'
    '<polygon points="{2}" fill="{3}" stroke="{3}" stroke-width="1" stroke-linejoin="round"/></svg>'
)
_WIDTH, _HEIGHT = 160, 20  # pixels of a small line


def card(title: str, subtitle: str, *parts: Markup) -> str:
    """Title, a line below it such as its size, and parts."""
    return str(_CARD.format(title, subtitle, Markup().join(parts)))


def table(head: Sequence[str], rows: Iterable[Sequence[object]], numbers: Sequence[int] = ()) -> Markup:
    """Table of cells, escaped unless they are markup; `numbers` are columns set to the right; nothing without rows."""
    rows = [*rows]
    sides = ["right" if i in numbers else "left" for i in range(len(head))]
    body = [Markup().join(_CELL.format(side, RULE, x) for side, x in zip(sides, row, strict=True)) for row in rows]
    titles = Markup().join(_HEAD.format(side, text) for side, text in zip(sides, head, strict=True))
    return _TABLE.format(titles, Markup().join(Markup("<tr>{}</tr>").format(row) for row in body)) if rows else Markup()


def line(series: Series) -> Markup:
    """Equally spaced samples (m,) as a small picture of their envelope."""
    x, low, high = envelope(np.arange(len(series), dtype=float), series, _WIDTH)
    least, most = float(series.min()), float(series.max())
    size = (most - least) or 1.0
    across = 1 + (_WIDTH - 2) * x / max(1.0, float(x[-1]))
    around = [(across, high), (across[::-1], low[::-1])]
    points = [
        f"{a:.1f},{_HEIGHT - 2 - (_HEIGHT - 4) * (b - least) / size:.1f}"
        for part, values in around
        for a, b in zip(part, values, strict=True)
    ]
    return _LINE.format(_WIDTH, _HEIGHT, " ".join(points), COLOURS[0])
