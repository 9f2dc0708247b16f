"""One comparison: a figure, table or erratum of the source document, with its numbers and ours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

from masking.model.modelling.model import Model

Kind = Literal["figure", "table", "erratum", "open question"]
Verdict = Literal["agrees", "in kind", "explained", "unexplained", "given", "ours only"]

ILLEGIBLE: Final = "not legible in the text"
CLOSE: Final = 0.02  # relative
SMALL, COARSE = 1e-3, 0.2  # numbers below this are printed to one digit, which is so close
SAME: Final = 1e-3  # relative: two numbers of ours so close, beside the same printed one, are one number


@dataclass(frozen=True, slots=True)
class Value:
    """One number: as the document has it, as ours, and why they differ.

    Args:
        what: which number.
        ours: computed here.
        document: printed there; a text where it is not a number, "" where the document has none.
        where: it is printed.
        independent: the same, computed outside this project; NaN where it was not.
        within: relative difference up to which it agrees, in kind only where that is more than `CLOSE`, or `COARSE`
            for small numbers; None for these.
        why: they differ; "" where they agree, or where it is not known.
        given: whether ours was made from the document's number, by a fit or as it is, so that agreement shows nothing.
        twin: whether it is the result of an experiment on the twin, whose noise and friction are assumptions: it is not
            recomputed by a second implementation.
    """

    what: str
    ours: float
    document: float | str = ""
    where: str = ""
    independent: float = math.nan
    within: float | None = None
    why: str = ""
    given: bool = False
    twin: bool = False

    @property
    def ratio(self) -> float:
        """Return ours over the document's, over the independent one where the document has no number, else NaN."""
        reference = self.document if isinstance(self.document, float | int) else self.independent
        return self.ours / reference if reference else math.nan

    @property
    def references(self) -> tuple[float, ...]:
        """Return the numbers that it is compared with: the document's and the independent one, where there are such."""
        found = [float(x) for x in (self.document, self.independent) if isinstance(x, float | int)]
        return tuple(x for x in found if not math.isnan(x))

    @property
    def verdict(self) -> Verdict:
        """Return whether it agrees with every reference, and whether it is known why not."""
        if not self.references:
            return "ours only"
        if all(self._is_near(x, self.within) for x in self.references):
            if self.given and all(self._is_near(x, None) for x in self.references):
                return "given"
            if self.given:
                return "explained" if self.why else "unexplained"
            loose = self.within is not None and any(self.within > _closeness(x) for x in self.references)
            return "in kind" if loose else "agrees"
        return "explained" if self.why else "unexplained"

    def repeats(self, other: Value) -> bool:
        """Tell whether it is the same number as another, beside the same printed one."""
        mine, theirs = ((v.document, v.where, v.references[:1]) for v in (self, other))
        return bool(self.references) and mine == theirs and abs(self.ours - other.ours) <= SAME * abs(other.ours)

    def _is_near(self, reference: float, within: float | None) -> bool:
        allowed = within if within is not None else _closeness(reference)
        return abs(self.ours - reference) <= allowed * abs(reference)


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


def declared(model: Model, printed: Mapping[str, float], where: str) -> tuple[Value, ...]:
    """Return parameters of a model beside a table of the document.

    A parameter that is what its file declares, and what the table prints, was typed from it, and is given; one that its
    scales made of other numbers, or that differs, is compared.

    Args:
        model: whose parameters.
        printed: numbers of the table, by parameter.
        where: they are printed.
    """
    ours, typed = model.parameter_values(), replace(model, is_dimensionless=False).parameter_values()
    rows = (Value(name, ours[name], document=x, where=where) for name, x in printed.items())
    return tuple(replace(v, given=v.ours == typed[v.what]) for v in rows)


def experimental(*values: Value) -> tuple[Value, ...]:
    """Return rows as results of experiments on the twin."""
    return tuple(replace(value, twin=True) for value in values)


def repeated(entries: Iterable[Entry]) -> dict[tuple[str, str], str]:
    """Return the number of the first entry that has a number, by entry and name of each row that repeats it."""
    seen: list[tuple[str, Value]] = []
    found = {}
    for entry in entries:
        for value in entry.values:
            first = next((n for n, other in seen if n != entry.number and value.repeats(other)), None)
            if first is None:
                seen.append((entry.number, value))
            else:
                found[entry.number, value.what] = first
    return found


def _closeness(reference: float) -> float:
    return COARSE if abs(reference) < SMALL else CLOSE
