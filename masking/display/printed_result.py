"""A result as people read it: at the Python prompt, by `print`, and in a notebook."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final

from markupsafe import Markup

from masking.display.characters import visible, visible_line
from masking.lazy_imports import fragments

_TEXT: Final = Markup('<pre style="font:13px/1.45 ui-monospace,monospace;margin:0;overflow-x:auto">{}</pre>')


class Printed(ABC):
    """A result with a text for people, which its verb prints on the command line and `print` in Python.

    The Python prompt shows its headline, a notebook a card of the text. A dataclass takes `repr=False`.
    """

    @abstractmethod
    def __str__(self) -> str: ...

    @property
    def headline(self) -> str:
        """Result in a line: by default the first line of the text."""
        return str(self).partition("\n")[0]

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {visible_line(self.headline)}>"

    def _repr_html_(self) -> str:
        title, text = visible(self.headline), visible(str(self))
        rest = text.removeprefix(title).strip("\n")  # a headline that is no beginning stands above the whole text
        return fragments.card(title, "", *([_TEXT.format(rest)] if rest else []))


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table for the terminal, its columns as wide as their widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
