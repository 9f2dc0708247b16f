"""Trace of a discovery as a table: what was looked at, who suggested it, and why it was not taken."""

from __future__ import annotations

from masking.display.printed_result import aligned
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.trace import Line
from masking.model.declaration.quantities import number
from masking.reports import discovery_text
from masking.reports.text import listed

HEAD = ("explanation", "suggested by", "behind", "error over noise", "why not")
MOST = 20  # hypotheses of each reading that are shown


def rows(found: Discovery) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Each reading of the record with its hypotheses, the likeliest first; the answer and the model alone are shown."""
    made, lines = dict[str, list[tuple[str, ...]]](), [*found.problem.trace.lines()]
    answer = next((line.behind for line in lines if _is_taken(found, line)), 0.0)
    for line in lines:
        part = made.setdefault(line.tried.reading, [])
        if len(part) < MOST or not line.tried.names or _is_taken(found, line):
            one, why = line.tried, _why(found, line, answer)
            causes = listed([discovery_text.cause_name(found, *name) for name in one.names]) or "no cause"
            part.append((causes, one.move, number(line.behind, 3), number(one.over_noise, 3), why))
    return [*made.items()]


def table(found: Discovery) -> str:
    """Table for the terminal."""
    lines = list[str]()
    for reading, part in rows(found):
        lines += [f"Hypotheses in the record, {reading}:", *aligned([HEAD, *part])]
    return "\n".join([*lines, "behind: -2 log of the odds against the likeliest hypothesis of the same reading"])


def _is_taken(found: Discovery, line: Line) -> bool:
    is_here = line.tried.reading == found.problem.trace.reading
    return is_here and sorted(line.tried.names) == sorted(found.explanation.names)


def _why(found: Discovery, line: Line, answer: float) -> str:
    """Why a hypothesis was not taken, or that it was; the answer is `answer` behind."""
    if _is_taken(found, line):
        return "the answer"
    if line.why:
        return line.why
    if line.tried.reading != found.problem.trace.reading:
        return "another reading of the record is the answer"
    if line.behind > answer:
        return "less likely"
    return "the answer has fewer causes" if len(line.tried.names) > len(found.explanation.names) else ""
