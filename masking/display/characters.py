"""Characters that a text may have: what a declaration and a record are refused for, and what is shown in its place.

A control character acts on a terminal and ends a text in other programs. One that turns the direction of writing makes
a line read as what it does not say. Half of a surrogate pair and a noncharacter are no characters, and no file holds
them.
"""

from __future__ import annotations

import re
from typing import Final

_CONTROLS: Final = r"\x00-\x08\x0b-\x1f\x7f-\x9f"  # all but the tab and the line feed
_LINES: Final = r"\u2028\u2029"
_DIRECTIONS: Final = r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # Unicode Standard Annex 9, Table 4 and marks
_NO_CHARACTERS: Final = (
    r"\ud800-\udfff\ufdd0-\ufdef\ufeff" + "".join(f"\\U{plane:04x}fffe\\U{plane:04x}ffff" for plane in range(17))
)  # fmt: skip
UNFIT: Final = re.compile(f"[{_CONTROLS}{_LINES}{_DIRECTIONS}{_NO_CHARACTERS}]")
_UNFIT_IN_A_LINE: Final = re.compile(f"[\\t\\n]|{UNFIT.pattern}")


def code_point(character: str) -> str:
    """Name of a character that cannot be shown: U+0007."""
    return f"U+{ord(character):04X}"


def visible(text: str) -> str:
    """Text of some lines for people, with the name of each character that no text may have in its place: <U+0007>."""
    return UNFIT.sub(_named, text)


def visible_line(text: str) -> str:
    """Text for people in one line, as `visible` gives it, with line feeds and tabs by name, too."""
    return _UNFIT_IN_A_LINE.sub(_named, text)


def json_escaped(text: str) -> str:
    r"""JSON with what no text may have as escapes, such as \u202e: the same content, fit to be shown."""
    return UNFIT.sub(lambda match: f"\\u{ord(match[0]):04x}" if ord(match[0]) < 0x10000 else _pair(match[0]), text)


def _named(match: re.Match[str]) -> str:
    return f"<{code_point(match[0])}>"


def _pair(character: str) -> str:
    """Escape in JSON of a character beyond the first plane: the two halves of its surrogate pair."""
    units = character.encode("utf-16-be")
    return "".join(f"\\u{int.from_bytes(units[i : i + 2], 'big'):04x}" for i in (0, 2))
