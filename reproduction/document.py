"""The comparison with the source document as Markdown, with its pictures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from masking.errors import RecordError
from reproduction.cache import cached, is_cached
from reproduction.comparison import Entry, Value, Verdict, repeated
from reproduction.contents import CHAPTERS, ENTRIES, chosen

PICTURES = Path("pictures") / "thesis"
WORKERS = 2
Repeats = Mapping[tuple[str, str], str]  # by entry and row: the entry that has the number first
_VERDICTS: Final[tuple[Verdict, ...]] = ("agrees", "in kind", "explained", "unexplained", "given", "ours only")
_HEADS: Final = ("agree", "in kind", "explained", "unexplained", "given", "ours only", "repeated", "on the twin")
_MARKS: Final = {"unexplained": "**unexplained**", "ours only": ""}
_INTRODUCTION = """# The source document, computed again

Every figure and table of chapters 4, 5, 7, 8 and 9, and those of appendices B and C that show numbers, of D.J.
Rijlaarsdam, *Huygens Synchronization in Various Dynamical Systems - Experimental Results*, TU Eindhoven, DCT 2008.049,
and of its ENOC 2008 paper: the document's number, ours and their ratio. `python -m reproduction` writes this page and
its pictures; `python -m reproduction --only 7.2` computes and prints a part of it.

Models are the packaged ones. *On the ideal rig* means masked on a rig that its controller knows exactly, *on the twin*
masked on `tue_rig`: measured springs, friction, hysteresis, wrong damping and gains, noise, offsets, delay. The
document's experiments were done on a rig whose friction, hysteresis and noise it does not print, so that the twin's are
assumptions: experiments are to be compared in kind.

A row falls into one class:

- *agrees*: within 2 % of the document's number and of the independent one, or within 20 % where that is below 1e-3 and
  printed to one digit; within less where the row prints less. *Independent* numbers were computed outside this project,
  with scipy's DOP853 at a relative tolerance of 1e-9.
- *in kind*: within a tolerance above that, 5 to 50 %, which the row prints.
- *explained*, **unexplained**: it differs; an explanation is below the table.
- *given*: made from the document's number, by a fit or as it is, so that it shows nothing by agreeing, as it does,
  within 2 %. What was fitted and is further off is explained, or not.
- *ours only*, without a mark: the document has no such number.

A number that stands in two tables counts in the first, and the second refers to it. *Twin* marks an experiment on the
twin: its noise and friction are ours, and no second implementation recomputes it. Every other row that is not given is
recomputed in `tests/second_implementation` with numpy and scipy alone, and `test_second_implementation.py`
compares it with this page; a masking error on the ideal rig must be zero but for rounding. Ratios are ours over the
document's, or over the independent number where the document has none.
"""


@dataclass(frozen=True)
class Reproduction:
    """Entries by number, and the page that was written; None where none was."""

    entries: Mapping[str, Entry]
    page: Path | None = None

    def __str__(self) -> str:
        if self.page is None:
            return "\n".join(section(entry, pictured=False) for entry in self.entries.values()).rstrip()
        return f"{_sentence(self.entries)}\npage: {self.page}"

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
                    "within": v.within,
                    "twin": v.twin,
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
    shown = [entries[number] for chapter in CHAPTERS.values() for number in chapter if number in entries]
    repeats = repeated(shown)
    parts = [_INTRODUCTION, "## In short\n", f"{_sentence(entries)}\n", _summary(shown, repeats)]
    for title, chapter in CHAPTERS.items():
        sections = [section(entries[number], repeats) for number in chapter if number in entries]
        if sections:
            parts += [f"## {title}\n", *sections]
    return "\n".join(parts).rstrip() + "\n"


def section(entry: Entry, repeats: Repeats = MappingProxyType({}), *, pictured: bool = True) -> str:
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
                _mark(v, repeats.get((entry.number, v.what))),
            )
            for v in entry.values
        ]
        lines.append(_table(("", "document", "independent", "ours", "ratio", ""), rows))
    own = [v for v in entry.values if (entry.number, v.what) not in repeats]
    lines += [f"{reason}\n" for reason in _reasons(own)]
    lines += [f"{text}\n" for text in entry.words]
    if entry.picture and pictured:
        lines.append(f"![{entry.title}]({(PICTURES / f'{entry.stem}.png').as_posix()})\n")
        if entry.caption:
            lines.append(f"*{entry.caption}*\n")
    return "\n".join(lines)


def counts(entries: Iterable[Entry], repeats: Repeats = MappingProxyType({})) -> dict[str, int]:
    """Return the number of values with each verdict, of those that repeat one, and of those on the twin."""
    values = [(v, (entry.number, v.what) in repeats) for entry in entries for v in entry.values]
    found = Counter(v.verdict for v, is_repeated in values if not is_repeated)
    further = {"repeated": sum(r for _, r in values), "twin": sum(v.twin and not r for v, r in values)}
    return {str(verdict): found[verdict] for verdict in _VERDICTS} | further


def _summary(entries: Sequence[Entry], repeats: Repeats) -> str:
    rows = [(e.number, e.title, *(str(n or "") for n in counts([e], repeats).values())) for e in entries]
    rows.append(("**all**", "", *(f"**{n}**" for n in counts(entries, repeats).values())))
    return _table(("", "", *_HEADS), rows)


def _sentence(entries: Mapping[str, Entry]) -> str:
    found = counts(entries.values(), repeated(entries.values()))
    return (
        f"{len(entries)} figures, tables and errata: {found['agrees']} numbers agree, {found['in kind']} in kind, "
        f"{found['explained']} differ and are explained, {found['unexplained']} differ unexplained, {found['given']} "
        f"are given, {found['ours only']} have nothing beside them; {found['twin']} of these are experiments on the "
        "twin."
    )


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


def _mark(value: Value, first: str | None) -> str:
    """Return the class of a number, with its tolerance where that is declared, or where it stands first."""
    if first is not None:
        return f"see {first}"
    mark = _MARKS.get(value.verdict, value.verdict)
    if value.within and value.verdict in {"agrees", "in kind"}:
        mark += f" ({100.0 * value.within:g} %)"
    return ", ".join(part for part in (mark, "twin" if value.twin else "") if part)


def _ratio(value: Value) -> str:
    return "" if math.isnan(value.ratio) else f"{value.ratio:.3g}"


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _made(number: str) -> Entry:
    return cached(number, ENTRIES[number])
