"""Summary: the bars of the issue against what was measured, PySINDy beside, and who was taken for whom."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tests.benchmarks import hidden
from tests.benchmarks.discovering import scoring
from tests.benchmarks.discovering.scoring import Answer, Score

CLOSED = 1.1  # of the noise: a gap that is closed
SLOW, LARGE = 60.0, 2.0  # s and GiB
NAMING = ("named", "parameter", "ambiguous")
DIVERGED = float("inf")


@dataclass(frozen=True)
class Result:
    """One record with one tool: what was answered, how it scores, and how far the gap has closed.

    `left` is the gap of the worst sensor of the validation in units of its noise, `closed` the part of the gap beyond
    noise that is left, `grown` says whether the gap is larger than before; None where that is not known.
    """

    tool: str
    case: hidden.Case
    answer: Answer
    score: Score
    seconds: float
    memory: float = 0.0
    left: float | None = None
    share: float | None = None
    grown: bool | None = None
    terms: int = 0
    error: str = ""

    @classmethod
    def of(cls, case: hidden.Case, outcome: dict[str, Any]) -> Result:
        """Return the result in an outcome."""
        told, tool = outcome["answer"], outcome["tool"]
        if tool == "pysindy":
            answer = scoring.ranked(case, told["terms"], told["verdict"])
            before, after = told["simulation_error"]["before"], told["simulation_error"]["after"]
            size = None if before is None or after is None else max(after[n] / before[n] for n in before)
            grown = before is not None and (after is None or scoring.is_larger(before, after, before))
            share = DIVERGED if size is None else size
            return cls(
                tool, case, answer, scoring.judge(case, answer), outcome["seconds"],
                share=share, grown=grown, terms=len(told["terms"]),
            )  # fmt: skip
        answer = scoring.answer(told)
        if told["verdict"] == "failed":
            return cls(
                tool, case, answer, scoring.judge(case, answer), outcome["seconds"],
                memory=outcome["memory"], error=told["error"],
            )  # fmt: skip
        gap, floor = told["simulation_error"]["validation"], told["validation_noise_floor"]
        return cls(
            tool,
            case,
            answer,
            scoring.judge(case, answer),
            outcome["seconds"],
            outcome["memory"],
            scoring.left_over(gap["after"], floor),
            max(gap["after"][name] / gap["before"][name] for name in floor),
            scoring.is_larger(gap["before"], gap["after"], floor),
            len(answer.causes),
        )


@dataclass(frozen=True)
class Bar:
    """One bar: what must be reached, and what was; `hits` of `count`, or one measured value."""

    what: str
    aim: str
    measured: str
    verdict: str
    hits: int = 0
    count: int = 0
    share: float | None = None  # the aim, where it is a share
    at_most: bool = False
    theirs: str = ""
    their_hits: int = 0
    their_count: int = 0

    @property
    def interval(self) -> str:
        """Return the 95 % interval of a share."""
        if self.share is None or not self.count:
            return ""
        low, high = scoring.wilson(self.hits, self.count)
        return f"{percent(low)} to {percent(high)}"

    def text(self) -> str:
        """Return the bar as a line."""
        of = f"{self.hits} of {self.count}" if self.count else ""
        parts = (
            self.what.ljust(62),
            self.aim.ljust(12),
            self.measured.ljust(10),
            of.ljust(12),
            self.interval.ljust(20),
        )
        return "  ".join((*parts, self.verdict.ljust(12), self.theirs)).rstrip()


def percent(share: float) -> str:
    """Return a share in words."""
    return f"{100.0 * share:.3g} %"


Hit = Callable[[Result], bool]


def _share(
    what: str,
    ours: Sequence[Result],
    theirs: Sequence[Result],
    hit: Hit,
    aim: float,
    *,
    at_most: bool = False,
    their_hit: Hit | None = None,
) -> Bar:
    hits, count = sum(map(hit, ours)), len(ours)
    other, others = sum(map(their_hit or hit, theirs)), len(theirs)
    reached = hits <= aim * count if at_most else hits >= aim * count
    return Bar(
        what,
        f"{'<=' if at_most else '>='} {percent(aim)}",
        percent(hits / count) if count else "",
        ("reached" if reached else "short") if count else "not measured",
        hits,
        count,
        aim,
        at_most,
        f"{percent(other / others)} ({other} of {others})" if others else "",
        other,
        others,
    )


def _value(
    what: str, aim: str, value: float | None, text: str, *, reached: bool, theirs: str = "", count: int = 0
) -> Bar:
    verdict = "not measured" if value is None else "reached" if reached else "short"
    return Bar(what, aim, text if value is not None else "", verdict, count, count, theirs=theirs)


def _right(result: Result) -> bool:
    return result.score.right


def bars(ours: Sequence[Result], theirs: Sequence[Result]) -> list[Bar]:
    """Return the bars in the order of the issue."""

    def of(results: Sequence[Result], family: str, noise: float | None = None) -> list[Result]:
        return [r for r in results if r.case.family == family and (noise is None or r.case.noise == noise)]

    def right(what: str, family: str, aim: float, noise: float | None = None) -> Bar:
        return _share(what, of(ours, family, noise), of(theirs, family, noise), _right, aim)

    made = [
        right("hidden effect, noise 1e-4: right effect and place", "effect", 0.98, 1e-4),
        right("hidden effect, noise 1e-3", "effect", 0.97, 1e-3),
        right("hidden effect, noise 3e-3", "effect", 0.90, 3e-3),
        right("dirty record: right effect and place", "dirty", 0.85),
        right("dirty record without main effect: no confident name", "dirty_none", 0.95),
        right("no effect: verdict none", "none", 0.99),
        right("only a parameter wrong: that parameter named", "parameter", 0.97),
        right("two effects: both right", "two", 0.85),
        right("outside the dictionary: verdict unknown", "outside", 0.85),
        _share(
            "outside the dictionary: a confident wrong name",
            of(ours, "outside"), of(theirs, "outside"), lambda r: r.score.confidently_wrong, 0.05, at_most=True,
        ),
        right("made by MuJoCo: right effect and place", "mujoco", 0.97),
    ]  # fmt: skip
    named = [r for r in ours if r.case.family in ("effect", "two") and r.answer.verdict in NAMING]
    made.append(
        _share(
            f"named records: gap after at most {CLOSED:g} of the noise",
            named, (), lambda r: r.left is not None and r.left <= CLOSED, 0.95,
        )
    )  # fmt: skip
    known = [r for r in ours if r.grown is not None]
    their_known = [r for r in theirs if r.case.family in ("effect", "two")]
    made.append(_share("gap larger than before", known, their_known, lambda r: bool(r.grown), 0.0, at_most=True))
    made += _parameters(of(ours, "effect"))
    times = [r.seconds for r in ours]
    slowest = max(times, default=None)
    their_times = [r.seconds for r in theirs]
    made.append(
        _value(
            "time of one record, longest",
            f"<= {SLOW:g} s",
            slowest,
            f"{slowest or 0.0:.3g} s",
            reached=(slowest or 0.0) <= SLOW,
            theirs=f"{max(their_times):.3g} s" if their_times else "",
            count=len(times),
        )
    )
    most = max((r.memory for r in ours), default=None)
    made.append(
        _value("memory, at most", f"<= {LARGE:g} GiB", most, f"{most or 0.0:.3g} GiB", reached=(most or 0.0) <= LARGE)
    )
    return made


def _parameters(results: Sequence[Result]) -> list[Bar]:
    found = [p for r in results if r.score.right for p in scoring.parameters(r.case, r.answer)]
    errors = [p.error for p in found if p.error is not None]
    middle = statistics.median(errors) if errors else None
    covered = sum(p.covered for p in found)
    return [
        _value(
            "parameters of the effect: median relative error",
            "<= 2 %",
            middle,
            percent(middle or 0.0),
            reached=(middle or 0.0) <= 0.02,
            count=len(errors),
        ),
        Bar(
            "parameters of the effect: 95 % intervals that cover the truth",
            ">= 90 %",
            percent(covered / len(found)) if found else "",
            ("reached" if covered >= 0.9 * len(found) else "short") if found else "not measured",
            covered,
            len(found),
            0.9,
        ),
    ]


def facts(ours: Sequence[Result], theirs: Sequence[Result]) -> list[tuple[str, str, str]]:
    """Return what has no bar: what it is, ours, theirs."""
    rows = []

    def both(what: str, tell: Callable[[Sequence[Result]], str], families: Sequence[str]) -> None:
        parts = [[r for r in results if r.case.family in families] for results in (ours, theirs)]
        mine, other = (tell(part) if part else "" for part in parts)
        rows.append((what, mine, other))

    naming = ("effect", "dirty", "two")

    def median(values: Sequence[float | None], form: Callable[[float], str]) -> str:
        known = [value for value in values if value is not None]
        return form(statistics.median(known)) if known else ""

    both("validation gap after, for that before, median (effect)", lambda p: median([r.share for r in p], percent),
         ["effect"])  # fmt: skip
    both("validation gap after for the noise, median (effect)", lambda p: median([r.left for r in p], "{:.4g}".format),
         ["effect"])  # fmt: skip
    both("causes or terms added, median (effect)", lambda p: f"{statistics.median([r.terms for r in p]):g}", ["effect"])
    both("causes or terms added, median (dirty, no main effect)",
         lambda p: f"{statistics.median([r.terms for r in p]):g}", ["dirty_none"])  # fmt: skip
    both("right, or near kin in the right place, without reserve", lambda p: percent(sum(map(_kin, p)) / len(p)),
         naming)  # fmt: skip
    both("time of one record, median", lambda p: f"{statistics.median([r.seconds for r in p]):.3g} s", hidden.FAMILIES)
    hows = {how: [r for r in ours if r.score.right and r.score.how == how and r.case.family in naming]
            for how in ("exact", "equivalent", "on top", "kin")}  # fmt: skip
    words = {
        "exact": "right by the very effect and place",
        "equivalent": "right by an exact equivalent",
        "on top": "right on top of an ambiguous answer, with an experiment that tells",
        "kin": "near kin on top of an ambiguous answer, the truth among it, with an experiment that tells",
    }
    rows += [(words[how], str(len(found)), "") for how, found in hows.items()]
    return rows


def _kin(result: Result) -> bool:
    near = hidden.kin(result.case) | hidden.acceptable(result.case)
    return result.score.right or bool(result.answer.causes and result.answer.causes[0].key in near)


@dataclass(frozen=True)
class Confusion:
    """Counts of records: (true row, answered column) with the place right and with the place wrong."""

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    cells: dict[tuple[str, str], tuple[int, int]]

    def total(self, row: str) -> int:
        """Return how many records a row has."""
        return sum(sum(counts) for (r, _), counts in self.cells.items() if r == row)


OTHERS = ("parameter", "none", "unknown", "other terms", "failed")
EMPTY = "no main effect (dirty)"


def confusion(results: Sequence[Result]) -> Confusion:
    """Return who was taken for whom, by the cause on top; records with two effects are left out.

    An exact equivalent is counted as the effect that was hidden, in the right place. `unknown` is a column even where a
    nearest kin is named. Where nothing was hidden, no name is the right place.
    """
    order = ("effect", "outside", "parameter", "none", "dirty_none")
    cells: dict[tuple[str, str], tuple[int, int]] = {}
    groups: dict[str, str] = {}
    for result in results:
        case = result.case
        if case.family == "two":
            continue
        row = {"none": "none", "dirty_none": EMPTY}.get(case.asked, case.effect)
        groups[row] = "effect" if case.family == "dirty" else case.asked
        column, placed = _column(result)
        good, bad = cells.get((row, column), (0, 0))
        cells[row, column] = (good + placed, bad + (not placed))
    rows = sorted(groups, key=lambda row: (order.index(groups[row]), row))
    answered = {column for _, column in cells}
    names = [row for row in rows if groups[row] == "effect"]
    names += sorted(answered - set(names) - set(OTHERS))
    return Confusion(tuple(rows), (*names, *(one for one in OTHERS if one in answered or one == "none")), cells)


def _column(result: Result) -> tuple[str, bool]:
    """Return what a record was taken for, and whether in the right place."""
    case, told = result.case, result.answer
    if told.verdict in ("none", "unknown", "failed"):
        meant = {"none": ("none",), "dirty_none": ("none", "unknown"), "outside": ("unknown",)}
        return told.verdict, told.verdict in meant.get(case.asked, ())
    name, at = told.causes[0].key
    if (name, at) in hidden.acceptable(case):
        return ("stop" if case.family == "outside" else case.effect), True
    name = "other terms" if name == "terms" else name
    return name, at in {place for _, place in hidden.acceptable(case)}
