"""Names typeset: letters in italics, a number as an index, Greek letters where a name is one."""

from __future__ import annotations

import re
from typing import Final

import markupsafe
from markupsafe import Markup

GREEK: Final = frozenset(
    {"alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda", "mu", "nu"}
    | {"xi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"}
)
_IN_A_FIGURE = re.compile(  # what `tex` makes, or any other dollar
    r"(\$(?:[A-Za-z]|\\(?:" + "|".join(sorted(GREEK)) + r")|\\mathit\{[A-Za-z]+\})(?:_\{[A-Za-z0-9]+\})?\$)|\$"
)
_SYMBOL = re.compile(r"([A-Za-z]{1,3}|" + "|".join(sorted(GREEK)) + r")(\d*|_\w+)")


def is_symbol(name: str) -> bool:
    """Whether a name is a symbol: a few letters or a Greek one, with or without an index; no English word."""
    return _SYMBOL.fullmatch(name) is not None


def markup(name: str) -> Markup:
    """Typeset a name for HTML where it is a symbol: letters in italics, a number as an index."""
    if not is_symbol(name):
        return markupsafe.escape(name)
    letters, index = split(name)
    letters = f"&{letters};" if letters in GREEK else letters
    return Markup(f"<var>{letters}</var>" + (f"<sub>{index}</sub>" if index else ""))  # noqa: S704  # letters and digits


def split(name: str) -> tuple[str, str]:
    """Letters and the index of a symbol; an index may be empty."""
    letters, index = re.fullmatch(r"(.*?)_?(\d*)", name).groups()  # type: ignore[union-attr]  # matches any word
    return (letters, index) if letters else (name, "")


def tex(name: str) -> str:
    """Typeset a declared name for a figure: letters with a number become a symbol with an index."""
    match = re.fullmatch(r"([A-Za-z]+)_?(\d*)", name)
    letters, index = match.groups() if match else ("", "")
    if letters in GREEK or len(letters) == 1:
        letter = rf"\{letters}" if letters in GREEK else letters
        return rf"${letter}_{{{index}}}$" if index else f"${letter}$"
    return rf"$\mathit{{{letters}}}_{{{index}}}$" if index else name


def in_figure(text: str) -> str:
    """Text as a figure draws it: symbols that `tex` made are typeset, and any other dollar is a dollar."""
    return _IN_A_FIGURE.sub(lambda match: match[1] or r"\$", text)
