"""Words that all reports share: lists, beginnings of sentences, shares, short forms."""

from __future__ import annotations

from collections.abc import Sequence

from masking.model.declaration.quantities import percent


def listed(words: Sequence[str], between: str = ", ") -> str:
    """Write several words as a list: a, b and c."""
    return words[0] if len(words) == 1 else f"{between.join(words[:-1])} and {words[-1]}"


def alternatives(words: Sequence[str]) -> str:
    """Write several words of which one holds: either a, b or c."""
    return words[0] if len(words) == 1 else f"either {', '.join(words[:-1])} or {words[-1]}"


def capital(text: str) -> str:
    """Text that begins a sentence."""
    return f"{text[:1].upper()}{text[1:]}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table for the terminal, its columns as wide as their widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def much(part: float) -> str:
    """Write how much of something: all, nothing, or a part in percent."""
    return "all" if part >= 0.995 else percent(part) if part >= 0.005 else "nothing"


def share(part: float) -> str:
    """Write a share in percent, to at most two digits after the point: 100 % is all, and 0 % none."""
    smaller = round(100.0 * min(part, 1.0 - part), 9)
    if 0.0 < smaller < 0.01:
        return "< 0.01 %" if part < 0.5 else "> 99.99 %"
    return f"{round(100.0 * part, (smaller < 1.0) + (smaller < 10.0)):g} %"


def short(text: str, most: int) -> str:
    """Text cut to a number of letters, an ellipsis for the rest."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip(' ,')}…"
