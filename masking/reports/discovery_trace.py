"""Trace of a discovery as a table: what was looked at, who suggested it, and why it was not taken."""

from __future__ import annotations

from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.trace import Line
from masking.model.declaration.quantities import number
from masking.reports import discovery_text
from masking.reports.text import aligned, listed

HEAD = ("explanation", "suggested by", "behind", "error over noise", "why not")
EQUAL = 2.0  # difference of -2 log evidence that separates nothing


def rows(found: Discovery, most: int | None = None) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Each reading of the record with its hypotheses, the likeliest first, at most that many of each."""
    made = dict[str, list[tuple[str, ...]]]()
    for line in found.problem.trace.lines():
        part = made.setdefault(line.tried.reading, [])
        if most is None or len(part) < most or not line.tried.names or _is_taken(found, line):
            part.append(_row(found, line))
    return [*made.items()]


def table(found: Discovery, most: int | None = None) -> str:
    """Table for the terminal."""
    lines = list[str]()
    for reading, part in rows(found, most):
        lines += [f"The record {reading}:", *aligned([HEAD, *part])]
    behind = "behind: -2 log of the odds against the likeliest hypothesis of the same reading"
    return "\n".join([*lines, behind])


def _row(found: Discovery, line: Line) -> tuple[str, ...]:
    one = line.tried
    causes = listed([discovery_text.cause_name(found, *name) for name in one.names]) or "no cause"
    return causes, one.move, number(line.behind, 3), number(one.over_noise, 3), _why(found, line)


def _is_taken(found: Discovery, line: Line) -> bool:
    is_here = line.tried.reading == found.problem.trace.reading
    return is_here and sorted(line.tried.names) == sorted(found.explanation.names)


def _why(found: Discovery, line: Line) -> str:
    """Why a hypothesis was not taken, or that it was."""
    if _is_taken(found, line):
        return "the answer"
    if line.why:
        return f"not taken: {line.why}"
    if line.tried.reading != found.problem.trace.reading:
        return "another reading of the record is the answer"
    return "less likely" if line.behind > EQUAL else "replaced in a later step"
