"""The comparison with the source document as Markdown, with its pictures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from masking.errors import RecordError
from reproduction.cache import cached, is_cached
from reproduction.comparison import Entry, Value, Verdict
from reproduction.contents import CHAPTERS, ENTRIES, chosen

PICTURES = Path("pictures") / "thesis"
WORKERS = 2
_VERDICTS: Final[tuple[Verdict, ...]] = ("agrees", "explained", "unexplained", "given", "ours only")
_MARKS: Final = {
    "agrees": "agrees",
    "explained": "explained",
    "unexplained": "**unexplained**",
    "given": "given",
    "ours only": "",
}
_INTRODUCTION = """# The source document, computed again

Every figure and table of chapters 4, 5, 7, 8 and 9 of D.J. Rijlaarsdam, *Huygens Synchronization in Various Dynamical
Systems - Experimental Results*, TU Eindhoven, DCT 2008.049, and of its ENOC 2008 paper: the document's number, ours and
their ratio. `python -m reproduction` writes this page and its pictures; `python -m reproduction --only 7.2` computes
and prints a part of it.

Models are the packaged ones. *On the ideal rig* means masked on a rig that its controller knows exactly, *on the twin*
masked on `tue_rig`: measured springs, friction, hysteresis, wrong damping and gains, noise, offsets, delay. The
document's experiments were done on a rig whose friction, hysteresis and noise it does not print, so that the twin's are
assumptions: experiments are to be compared in kind. *Independent* numbers were computed outside this project, with
scipy's DOP853 at a relative tolerance of 1e-9. A number *agrees* within 2 %, or within 20 % where it is below 1e-3 and
printed to one digit, unless its line says otherwise; where it does not, the difference is explained below its table,
or marked **unexplained**. *Given* is what was made from the document's number, by a fit or as it is, so that it shows
nothing by agreeing. Ratios are ours over the document's, or over the independent number where the document has
none.
"""


@dataclass(frozen=True)
class Reproduction:
    """Entries by number, and the page that was written; None where none was."""

    entries: Mapping[str, Entry]
    page: Path | None = None

    def __str__(self) -> str:
        if self.page is None:
            return "\n".join(section(entry, pictured=False) for entry in self.entries.values()).rstrip()
        found = counts(self.entries.values())
        return (
            f"{len(self.entries)} figures, tables and errata: {found['agrees']} numbers agree, {found['explained']} "
            f"differ and are explained, {found['unexplained']} differ unexplained, {found['given']} were made from the "
            f"document's, {found['ours only']} have nothing beside them\npage: {self.page}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return every number as JSON can hold it."""
        found = {}
        for number, entry in self.entries.items():
            values = [
                {
                    "what": v.what,
                    "document": v.document if v.document != "" else None,
                    "where": v.where,
                    "independent": _or_none(v.independent),
                    "ours": _or_none(v.ours),
                    "ratio": _or_none(v.ratio),
                    "verdict": v.verdict,
                    "why": v.why,
                }
                for v in entry.values
            ]
            found[number] = {"title": entry.title, "kind": entry.kind, "values": values, "words": list(entry.words)}
        return {"entries": found, "page": str(self.page) if self.page is not None else None}


def compare(
    *,
    only: str | None = None,
    out: str | Path | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Reproduction:
    """Compute figures and tables of the source document again, beside its numbers.

    Args:
        only: a figure, table or erratum, or a part of such numbers; all by default.
        out: folder to write `thesis.md` and its pictures in; nothing is written where none is given.
        progress: called with the number of the entry that is done, and the fraction done.

    Raises:
        MaskingError: there is no such entry, it cannot be computed, or the page cannot be written.
    """
    entries = computed(chosen(only), progress)
    return Reproduction(entries, write(entries, Path(out)) if out is not None else None)


def computed(numbers: Sequence[str], progress: Callable[[str, float], None] | None = None) -> dict[str, Entry]:
    """Return entries: cached ones from disk, the others computed in two processes.

    Args:
        numbers: of the entries.
        progress: called with the number of the entry that is done, and the fraction of all that is done.

    Returns:
        the entries by number, in the order of `numbers`.

    Raises:
        MaskingError: an entry could not be computed.
    """
    ready = [n for n in numbers if is_cached(n, ENTRIES[n])]
    missing = [n for n in numbers if n not in ready]
    made = {n: cached(n, ENTRIES[n]) for n in ready}

    def report(number: str) -> None:
        if progress is not None:
            progress(number, len(made) / len(numbers))

    if len(missing) < 2:
        for number in missing:
            made[number] = cached(number, ENTRIES[number])
            report(number)
    else:
        # The entries of a chapter share compiled functions: one process makes them, one after the other.
        waiting = [[n for n in chapter if n in missing] for chapter in CHAPTERS.values()]

        def lane(pool: ProcessPoolExecutor) -> None:
            while waiting:
                for number in waiting.pop(0):
                    made[number] = pool.submit(_made, number).result()
                    report(number)

        pools = [ProcessPoolExecutor(1, get_context("spawn")) for _ in range(WORKERS)]
        with ThreadPoolExecutor(WORKERS) as lanes:
            try:
                list(lanes.map(lane, pools))
            finally:
                waiting.clear()
                for pool in pools:
                    pool.shutdown(cancel_futures=True)
    return {n: made[n] for n in numbers}


def write(entries: Mapping[str, Entry], folder: Path) -> Path:
    """Write the page and its pictures into a folder, whole.

    Args:
        entries: all of them, by number.
        folder: of the page; pictures go into `pictures/thesis` below it.

    Returns:
        the page.

    Raises:
        RecordError: it cannot be written.
    """
    path = folder / "thesis.md"
    try:
        (folder / PICTURES).mkdir(parents=True, exist_ok=True)
        for entry in entries.values():
            if entry.picture:
                (folder / PICTURES / f"{entry.stem}.png").write_bytes(entry.picture)
        path.write_text(page(entries), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"cannot write {path}: {error.strerror}; name another folder with --out") from error
    return path


def page(entries: Mapping[str, Entry]) -> str:
    """Return the whole page as Markdown."""
    parts = [_INTRODUCTION, "## In short\n", _summary(entries)]
    for title, chapter in CHAPTERS.items():
        shown = [entries[number] for number in chapter if number in entries]
        if shown:
            parts += [f"## {title}\n", *(section(entry) for entry in shown)]
    return "\n".join(parts).rstrip() + "\n"


def section(entry: Entry, *, pictured: bool = True) -> str:
    """Return one entry as Markdown: its table, what explains differences, and its picture where it is wanted."""
    lines = [f"### {entry.number}: {entry.title}\n"]
    if entry.values:
        rows = [
            (
                v.what,
                _number(v.document) + (f" ({v.where})" if v.where and v.document != "" else ""),
                _number(v.independent),
                _number(v.ours) or "not reached",
                _ratio(v),
                _mark(v),
            )
            for v in entry.values
        ]
        lines.append(_table(("", "document", "independent", "ours", "ratio", ""), rows))
    lines += [f"{reason}\n" for reason in _reasons(entry.values)]
    lines += [f"{text}\n" for text in entry.words]
    if entry.picture and pictured:
        lines.append(f"![{entry.title}]({(PICTURES / f'{entry.stem}.png').as_posix()})\n")
        if entry.caption:
            lines.append(f"*{entry.caption}*\n")
    return "\n".join(lines)


def counts(entries: Iterable[Entry]) -> dict[str, int]:
    """Return the number of values with each verdict."""
    found = Counter(value.verdict for entry in entries for value in entry.values)
    return {str(verdict): found[verdict] for verdict in _VERDICTS}


def _summary(entries: Mapping[str, Entry]) -> str:
    rows = []
    for entry in entries.values():
        found = counts([entry])
        rows.append((entry.number, entry.title, *(str(found[v] or "") for v in _VERDICTS)))
    whole = counts(entries.values())
    rows.append(("**all**", "", *(f"**{whole[v]}**" for v in _VERDICTS)))
    return _table(("", "", "agree", "explained", "unexplained", "given", "ours only"), rows)


def _reasons(values: Sequence[Value]) -> list[str]:
    """Return why numbers differ, each reason once with the numbers it is for."""
    found: dict[str, list[str]] = {}
    for value in values:
        if value.verdict == "explained":
            found.setdefault(value.why, []).append(value.what)
    return [f"*{'; '.join(whats)}*: {why}." for why, whats in found.items()]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _number(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return "" if math.isnan(value) else f"{value:.4g}"


def _mark(value: Value) -> str:
    """Return whether a number agrees, and to what, where that is declared."""
    tolerance = f" to {100.0 * value.within:g} %" if value.within and value.verdict == "agrees" else ""
    return _MARKS[value.verdict] + tolerance


def _ratio(value: Value) -> str:
    return "" if math.isnan(value.ratio) else f"{value.ratio:.3g}"


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _made(number: str) -> Entry:
    return cached(number, ENTRIES[number])
