"""One answer as a line of numbers, the table of many lines, and what differs between two states of the package."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from masking.inference.discovery.discovery_result import Discovery
from masking.reports.text import listed

SURE = 0.9  # probability from which an answer is confident
LEFT_OPEN = ("unknown", "ambiguous")
MORE = 0.02  # by which an error of the adjusted model may exceed that of the declared one, as chance
CHANGED = 0.05  # of a share of the gap: what differs
QUANTITIES = ("right", "right_class", "confident_wrong", "verdict", "causes", "unit")

Key = tuple[str, str]  # name and place


@dataclass(frozen=True)
class Judgement:
    """Whether an answer is right, has a name of the right class, and says with confidence what is not so.

    `false` are names or units that are plainly false.
    """

    right: bool
    right_class: bool
    confident_wrong: bool
    false: tuple[str, ...] = ()


@dataclass(frozen=True)
class Line:
    """One problem and its answer; errors are relative to the readings, on unseen data, of one sensor.

    Args:
        suite, name, truth: of the problem.
        verdict: of discovery; `refused` or `traceback` where there is none, with `error`.
        causes: name and place of each.
        unit: what is said of the unit of a channel.
        law: place of the law without a name, if there is one.
        none: probability of none of the names.
        probability: of the least sure cause.
        right, right_class, confident_wrong, false: as `Judgement`.
        sensor: the one whose declared error is largest over its noise.
        declared, adjusted, named, found, floor: its errors: as declared, with adjusted parameters, with the names, with
            what is written (the law without a name where there is one), and of the noise alone.
        share: part of its gap that what is written closes.
        over_noise: largest error of a sensor over its noise, with what is written.
        is_adjusted_worse: whether adjusted parameters alone leave more than declared ones, over all sensors.
        move: what suggested the explanation.
        moves: of the search, that suggested something.
        interval: shooting interval in s; None for the whole record.
        seconds: processor time.
        error: message of what was refused, or the end of a traceback.
    """

    suite: str
    name: str
    truth: str
    verdict: str
    causes: tuple[Key, ...] = ()
    unit: str = ""
    law: str = ""
    none: float = 0.0
    probability: float | None = None
    right: bool = False
    right_class: bool = False
    confident_wrong: bool = False
    false: tuple[str, ...] = ()
    sensor: str = ""
    declared: float | None = None
    adjusted: float | None = None
    named: float | None = None
    found: float | None = None
    floor: float | None = None
    share: float | None = None
    over_noise: float | None = None
    is_adjusted_worse: bool = False
    move: str = ""
    moves: tuple[str, ...] = ()
    interval: float | None = None
    seconds: float = 0.0
    error: str = ""

    @property
    def key(self) -> Key:
        """Suite and name."""
        return self.suite, self.name

    @property
    def status(self) -> str:
        """How it counts: right, unknown (left open) or wrong."""
        return "right" if self.right else "unknown" if self.verdict in LEFT_OPEN else "wrong"

    @property
    def said(self) -> str:
        """The answer in words."""
        words = [f"{name} at {on}" if on else name for name, on in self.causes]
        words += [f"law in {self.law}"] if self.law else []
        words += [f"unit: {self.unit}"] if self.unit else []
        return f"{self.verdict}: {' + '.join(words)}" if words else self.verdict


def share(declared: float, found: float, floor: float) -> float | None:
    """Return the part of a gap that is closed, in rms beyond the noise; None where there is no gap."""
    gap, left = (math.sqrt(max(error**2 - floor**2, 0.0)) for error in (declared, found))
    return 1.0 - left / gap if gap > 0.0 else None


def exceeds(errors: Mapping[str, float], others: Mapping[str, float], floor: Mapping[str, float]) -> bool:
    """Return whether errors exceed others by more than chance, over all sensors in units of their noise."""

    def total(every: Mapping[str, float]) -> float:
        return math.sqrt(sum((every[name] / max(floor[name], 1e-300)) ** 2 for name in floor))

    return total(errors) > total(others) * (1.0 + MORE)


def causes(found: Discovery) -> tuple[Key, ...]:
    """Return name and place of each cause."""
    return tuple((one.name, one.on) for one in found.effects)


def answered(line: Line, found: Discovery, judgement: Judgement) -> Line:
    """Return the line of a problem with its answer."""
    errors = found.simulation_error
    floor, (declared, named) = errors.validation_noise_floor, errors.validation
    written = named if found.law is None else found.law.error[1]
    over = {name: declared[name] / max(floor[name], 1e-300) for name in floor}
    worst = max(over, key=lambda name: over[name])
    return replace(
        line,
        verdict=found.verdict,
        causes=causes(found),
        unit="" if found.unit is None else f"{listed(found.unit.names)} in {found.unit.unit}",
        law="" if found.law is None else found.law.place,
        none=found.none_of_these,
        probability=found.least_sure.probability if found.effects else None,
        **asdict(judgement),
        sensor=worst,
        declared=declared[worst],
        adjusted=errors.adjusted[worst],
        named=named[worst],
        found=written[worst],
        floor=floor[worst],
        share=share(declared[worst], written[worst], floor[worst]),
        over_noise=max(written[name] / max(floor[name], 1e-300) for name in floor),
        is_adjusted_worse=exceeds(errors.adjusted, declared, floor),
        move=found.explanation.move,
        interval=found.shooting_interval,
    )


def read(path: Path) -> dict[Key, Line]:
    """Return the lines in a file by suite and name; one that was cut off is left out."""
    found: dict[Key, Line] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            line = Line(**json.loads(text))
        except json.JSONDecodeError:
            continue
        line = replace(
            line, causes=tuple((name, on) for name, on in line.causes), false=tuple(line.false), moves=tuple(line.moves)
        )
        found[line.key] = line
    return found


def table(lines: Iterable[Line]) -> list[str]:
    """Return the lines of a table for readers, one a problem, and a summary of each suite."""
    rows = [*lines]
    head = "| suite | problem | hidden | said | p | none | share | declared | adjusted | found | floor | s | |"
    shown = [head, "|---" * 13 + "|"]
    for one in rows:
        marks = [one.status, *(["CONFIDENT"] if one.confident_wrong else []), *(f"FALSE: {name}" for name in one.false)]
        marks += ["adjusted is worse"] if one.is_adjusted_worse else []
        cells = (
            one.suite, one.name, one.truth, one.error or one.said, number(one.probability), number(one.none),
            number(one.share), *map(percent, (one.declared, one.adjusted, one.found, one.floor)), f"{one.seconds:.0f}",
            ", ".join(marks),
        )  # fmt: skip
        shown.append(f"| {' | '.join(cells)} |")
    shown += [
        "",
        "| suite | problems | right | class | unknown | wrong | confident wrong | plainly false | adjusted is worse "
        "| share, median | s, median | s, 95 % |",
        "|---" * 12 + "|",
    ]
    for suite in dict.fromkeys(one.suite for one in rows):
        shown.append(summary(suite, [one for one in rows if one.suite == suite]))
    return shown


def summary(suite: str, lines: Sequence[Line]) -> str:
    """Return the row of a suite."""
    counts = [sum(one.status == status for one in lines) for status in ("right", "unknown", "wrong")]
    shares = [one.share for one in lines if one.share is not None]
    cells = [
        suite, len(lines), counts[0], sum(one.right_class for one in lines), *counts[1:],
        sum(one.confident_wrong for one in lines), sum(bool(one.false) for one in lines),
        sum(one.is_adjusted_worse for one in lines), number(float(np.median(shares)) if shares else None),
        *(f"{value:.0f}" for value in np.quantile([one.seconds for one in lines], (0.5, 0.95))),
    ]  # fmt: skip
    return f"| {' | '.join(map(str, cells))} |"


def differences(lines: Mapping[tuple[str, str], Line], others: Mapping[tuple[str, str], Line]) -> list[str]:
    """Return a row for each problem in both whose answer differs: what was said before, and now."""
    shown = ["| suite | problem | before | after | share before | share after | s before | s after |", "|---" * 8 + "|"]
    for key in [key for key in others if key in lines]:
        before, after = others[key], lines[key]
        shares = [math.inf if one.share is None else one.share for one in (before, after)]
        is_same = all(getattr(before, name) == getattr(after, name) for name in QUANTITIES)
        if is_same and (shares[0] == shares[1] or abs(shares[0] - shares[1]) <= CHANGED):
            continue
        said = [f"{one.status}, {one.error or one.said}" for one in (before, after)]
        cells = (*key, *said, *(number(one.share) for one in (before, after)), f"{before.seconds:.0f}")
        shown.append(f"| {' | '.join(cells)} | {after.seconds:.0f} |")
    return shown


def number(value: float | None) -> str:
    """Return a number in words, nothing where there is none."""
    return "" if value is None else f"{value:.2f}"


def percent(value: float | None) -> str:
    """Return an error in words, nothing where there is none."""
    return "" if value is None else f"{100.0 * value:.2g} %"
