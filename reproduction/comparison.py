"""One comparison: a figure, table or erratum of the source document, with its numbers and ours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

Kind = Literal["figure", "table", "erratum"]
Verdict = Literal["agrees", "explained", "unexplained", "given", "ours only"]

ILLEGIBLE: Final = "not legible in the text"
CLOSE: Final = 0.02  # relative
SMALL, COARSE = 1e-3, 0.2  # numbers below this are printed to one digit, which is so close


@dataclass(frozen=True, slots=True)
class Value:
    """One number: as the document has it, as ours, and why they differ.

    Args:
        what: which number.
        ours: computed here.
        document: printed there; a text where it is not a number, "" where the document has none.
        where: it is printed.
        independent: the same, computed outside this project; NaN where it was not.
        within: relative difference up to which it agrees; None for `CLOSE`, or `COARSE` for small numbers.
        why: they differ; "" where they agree, or where it is not known.
        given: whether ours was made from the document's number, by a fit or as it is, so that agreement shows nothing.
    """

    what: str
    ours: float
    document: float | str = ""
    where: str = ""
    independent: float = math.nan
    within: float | None = None
    why: str = ""
    given: bool = False

    @property
    def ratio(self) -> float:
        """Return ours over the document's, over the independent one where the document has no number, else NaN."""
        reference = self.document if isinstance(self.document, float | int) else self.independent
        return self.ours / reference if reference else math.nan

    @property
    def verdict(self) -> Verdict:
        """Return whether it agrees with every reference, and whether it is known why not."""
        references = [x for x in (self.document, self.independent) if isinstance(x, float | int) and x == x]  # noqa: PLR0124  # NaN
        if not references:
            return "ours only"
        if self.given:
            return "given"
        if all(self._is_near(float(x)) for x in references):
            return "agrees"
        return "explained" if self.why else "unexplained"

    def _is_near(self, reference: float) -> bool:
        within = self.within if self.within is not None else (COARSE if abs(reference) < SMALL else CLOSE)
        return abs(self.ours - reference) <= within * abs(reference)


@dataclass(frozen=True, slots=True)
class Entry:
    """One figure, table or erratum.

    Args:
        number: as the document has it, such as "Fig. 7.2".
        title: what it shows.
        kind: of entry.
        values: its numbers.
        words: what is to be said of it beside its numbers, in paragraphs.
        picture: content of a PNG file; empty where there is nothing to draw.
        caption: of the picture.
    """

    number: str
    title: str
    kind: Kind
    values: tuple[Value, ...]
    words: tuple[str, ...] = ()
    picture: bytes = b""
    caption: str = ""

    @property
    def stem(self) -> str:
        """Return the name of its picture, without ending."""
        kept = (c if c.isalnum() else "_" for c in self.number.lower())
        return "_".join(part for part in "".join(kept).split("_") if part)
