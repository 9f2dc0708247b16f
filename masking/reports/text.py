"""Words that all reports share: lists, beginnings of sentences, shares, short forms."""

from __future__ import annotations

from collections.abc import Sequence

from masking.model.declaration.quantities import number, percent


def listed(words: Sequence[str], between: str = ", ") -> str:
    """Several words as a list: a, b and c; '' for none."""
    return f"{between.join(words[:-1])} and {words[-1]}" if len(words) > 1 else "".join(words)


def alternatives(words: Sequence[str]) -> str:
    """Several words of which one holds: either a, b or c."""
    return words[0] if len(words) == 1 else f"either {', '.join(words[:-1])} or {words[-1]}"


def plural(count: int, single: str, several: str) -> str:
    """Word that agrees with a number of things."""
    return single if count == 1 else several


def capital(text: str) -> str:
    """Text that begins a sentence."""
    return f"{text[:1].upper()}{text[1:]}"


def much(part: float) -> str:
    """Part of something: all, nothing, or a percentage."""
    return "all" if part >= 0.995 else percent(part) if part >= 0.005 else "nothing"


def share(part: float) -> str:
    """Share in percent, to at most two digits after the point: 100 % is all, and 0 % none."""
    smaller = round(100.0 * min(part, 1.0 - part), 9)
    if 0.0 < smaller < 0.01:
        return "< 0.01 %" if part < 0.5 else "> 99.99 %"
    return f"{round(100.0 * part, (smaller < 1.0) + (smaller < 10.0)):g} %"


def short(text: str, most: int) -> str:
    """Text cut to a number of letters, an ellipsis for the rest."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip(' ,')}…"


def probability_text(p: float) -> str:
    """Probability with three digits after the point."""
    return f"{p:.3f}" if p > 5e-4 else "< 0.001"


def signed(part: float) -> str:
    """Relative change in percent, with its sign."""
    return f"{'-' if part < 0.0 else '+'}{number(100.0 * abs(part), 2)} %"


def capped(part: float) -> str:
    """Part in percent; one above ten times the whole is only said to be more."""
    return "> 1000 %" if part > 10.0 else percent(part, 3)
