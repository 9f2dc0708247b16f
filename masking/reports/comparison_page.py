"""Comparison of two runs: both over one another, and the tables of what differs in declarations and measures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.display.printed_result import Printed, aligned
from masking.display.symbols import is_symbol, tex
from masking.lab.records.recording import Recording
from masking.model.declaration.quantities import number, percent
from masking.reports import html, run_text, style
from masking.reports.panels import Line, Panel, drawn
from masking.reports.run_figures import symmetric, time_label, trace
from masking.reports.run_study import PhasePair, Study, parameters
from masking.reports.style import COLOURS, CaptionedFigure
from masking.reports.text import listed

_SECTIONS: Final = ("experiment", "plant", "plant_model", "virtual", "controller_model")
_WORDS: Final = frozenset({"name", "source", "description", "meaning", "label", "drawing"})  # which move nothing
_SAME: Final = 1e-9  # relative difference of two numbers that count as equal
ABSENT: Final = "\N{EN DASH}"
_NAMED: Final = 4  # differences in a sentence
PAGE: Final = "comparison.html"
_MOST_ROWS: Final = 6
_MOST_DECLARED: Final = 60  # rows of the table of declarations
_PERIODS: Final = 6  # of the enlarged ends
TWO: Final = (COLOURS[0], COLOURS[1])


@dataclass(frozen=True)
class Measure:
    """One number, or one finding, of both runs; `change` is relative, NaN where that makes no sense."""

    name: str
    first: float | str | None
    second: float | str | None

    @property
    def change(self) -> float:
        """Relative change from the first to the second."""
        a, b = self.first, self.second
        is_number = isinstance(a, float) and isinstance(b, float)
        return b / a - 1.0 if is_number and a and math.isfinite(a) and math.isfinite(b) else math.nan  # type: ignore[operator,arg-type]

    @property
    def differs(self) -> bool:
        """Whether the runs differ in it."""
        a, b = self.first, self.second
        are_numbers = isinstance(a, float) and isinstance(b, float)
        return not math.isclose(a, b, rel_tol=_SAME) if are_numbers else a != b  # type: ignore[arg-type]

    @property
    def row(self) -> tuple[str, str, str, str]:
        """Name, both values and the change in percent as text."""
        sign = "+" if self.change > 0.0 else "\N{MINUS SIGN}"
        change = f"{sign}{percent(abs(self.change))}" if abs(self.change) > _SAME else ""
        return self.name, _text(self.first), _text(self.second), change


@dataclass(frozen=True, repr=False)
class Comparison(Printed):
    """Two runs side by side."""

    # first, second: the recordings
    first: Recording
    second: Recording
    names: tuple[str, str]  # of the runs

    @cached_property
    def studies(self) -> tuple[Study, Study]:
        """Study of each."""
        return Study(self.first), Study(self.second)

    @property
    def common(self) -> tuple[str, ...]:
        """Coordinates that both have."""
        a, b = self.studies
        return tuple(name for name in a.coordinates if name in b.coordinates)

    @cached_property
    def parameters(self) -> list[Measure]:
        """Parameters of the virtual systems that differ, in their declared units."""
        a, b = ({one.name: one for one in parameters(recording)} for recording in (self.first, self.second))
        rows = []
        for name in dict.fromkeys([*a, *b]):
            unit = (a.get(name) or b[name]).unit
            values = [each[name].value if name in each else None for each in (a, b)]
            rows.append(Measure(f"{name} ({unit})" if unit else name, *values))
        return [row for row in rows if row.differs]

    @cached_property
    def declarations(self) -> list[Measure]:
        """Values of the declarations that differ, by their paths; names and descriptions left out."""
        a, b = (dict(_flat(recording.manifest.get("declarations") or {})) for recording in (self.first, self.second))
        rows = [Measure(path, a.get(path), b.get(path)) for path in dict.fromkeys([*a, *b])]
        return [row for row in rows if row.differs]

    @cached_property
    def measures(self) -> list[Measure]:
        """Measures of both: masking errors, synchronisation, inputs, length."""
        a, b = (dict(_measures(one)) for one in self.studies)
        return [Measure(name, a.get(name), b.get(name)) for name in dict.fromkeys([*a, *b])]

    @property
    def sentence(self) -> str:
        """Differences between the runs in a sentence."""
        systems = [str(one.manifest.get("virtual_name") or "unknown") for one in (self.first, self.second)]
        if systems[0] != systems[1]:
            what = f"The virtual systems are {listed(systems)}."
        elif self.parameters:
            said = [f"{row.name} = {_text(row.first)} and {_text(row.second)}" for row in self.parameters]
            what = f"Parameters of the virtual system that differ: {_few(said)}."
        elif self.declarations:
            what = f"The declarations differ in {_few([row.name for row in self.declarations])}."
        else:
            what = "No parameter differs."
        return what if any(row.differs for row in self.measures) else f"{what} The results are equal."

    def as_dict(self) -> dict[str, Any]:
        """Comparison as JSON can hold it."""

        def listing(rows: list[Measure]) -> dict[str, dict[str, Any]]:
            return {row.name: dict(zip(self.names, (row.first, row.second), strict=True)) for row in rows}

        return {
            "runs": list(self.names),
            "parameters": listing(self.parameters),
            "declarations": listing(self.declarations),
            "measures": listing(self.measures),
        }

    def __str__(self) -> str:
        head = ("", *self.names, "change")
        tables = [[head, *(row.row for row in rows)] for rows in (self.parameters, self.measures) if rows]
        return "\n".join([self.sentence, *(line for table in tables for line in aligned(table))])


def _measures(facts: Study) -> Iterator[tuple[str, float | str]]:
    for name, chi in facts.chi.items():
        yield f"masking error chi of {name}", chi
    for pair in facts.pairs:
        yield from _of_pair(pair)
    for use in facts.inputs:
        unit = f" ({use.unit})" if use.unit else ""
        yield f"peak of {use.name}{unit}", use.peak
    for name in facts.coordinates:
        unit = facts.unit(f"{facts.prefix}.{name}")
        yield f"rms of {name}{f' ({unit})' if unit else ''}", float(np.sqrt(np.mean(facts.motion(name) ** 2)))
    yield f"length ({run_text.length(facts)[1]})", float(facts.tau[-1] - facts.tau[0])


def _of_pair(pair: PhasePair) -> Iterator[tuple[str, float | str]]:
    of = f"of {pair.first} and {pair.second}"
    yield f"phase {of} at the end (pi)", pair.end / math.pi
    found = pair.verdict
    if found is not None:
        yield f"verdict {of}", found.kind
        numbers = {"alpha": found.alpha, "eps": found.eps, "tau_s": found.time}
        yield from ((f"{name} {of}", value) for name, value in numbers.items() if math.isfinite(value))


def _flat(node: Mapping[str, Any] | list[Any], path: str = "") -> Iterator[tuple[str, float | str]]:
    """Leaves of nested mappings and lists with their paths."""
    items = node.items() if isinstance(node, Mapping) else enumerate(node)
    for key, value in items:
        if key in _WORDS or (not path and key not in _SECTIONS):
            continue
        below = f"{path}.{key}" if path else str(key)
        if isinstance(value, Mapping | list):
            yield from _flat(value, below)
        else:
            yield below, float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _few(said: list[str]) -> str:
    return listed([*said[:_NAMED], *([f"{len(said) - _NAMED} more"] if len(said) > _NAMED else [])])


def _text(value: float | str | None) -> str:
    return ABSENT if value is None else value if isinstance(value, str) else number(value, 4)


def symbols_in(compared: Comparison) -> set[str]:
    """Names in a comparison that are typeset as symbols."""
    names = {*compared.first.manifest.get("parameters", {}), *compared.second.manifest.get("parameters", {})}
    names |= {name for one in compared.studies for name in (*one.coordinates, *(use.name for use in one.inputs))}
    return {name for name in names if is_symbol(name)}


def save(compared: Comparison, folder: Path) -> Path:
    """Write page, picture and JSON into a folder; return the page. A `RecordError` says that one cannot be written."""
    more = len(compared.declarations) - _MOST_DECLARED
    html.save(
        folder / PAGE,
        "comparison",
        [figure(compared)],
        compared.as_dict(),
        title=f"Runs {compared.names[0]} and {compared.names[1]}",
        names=symbols_in(compared),
        compared=compared,
        most=_MOST_DECLARED,
        remarks=[f"{more} more values of the declarations differ."] if more > 0 else [],
    )
    return folder / PAGE


def figure(compared: Comparison) -> CaptionedFigure:
    """Coordinates that both runs have, over one another, and the ends of the first of them."""
    names, title = compared.common[:_MOST_ROWS], "Motion"
    if not names:
        return style.absent("comparison", title, "the runs have no coordinate in common")
    a, b = compared.studies
    ends = min(a.tau[0], b.tau[0]), max(a.tau[-1], b.tau[-1])
    rows = []
    for name in names:
        lines = [part for one, colour in zip((a, b), TWO, strict=True) for part in trace(one, one.motion(name), colour)]
        label = style.with_unit(tex(name), a.unit(f"{a.prefix}.{name}"))
        rows.append([Panel(lines, label, time_label(a), ends, symmetric([one.motion(name) for one in (a, b)]))])
    heights, zoomed = [1.15] * len(names), ""
    if all(math.isfinite(s.period) and s.tau[-1] - s.tau[0] > 2.5 * _PERIODS * s.period for s in (a, b)):
        rows.append([_zoom((a, b), names[0], is_last=is_last) for is_last in (False, True)])
        heights.append(1.9)
        zoomed = f" Below: {names[0]} in the first and in the last {_PERIODS} periods."
    caption = f"The coordinates that both runs have, the second over the first.{zoomed}"
    keys = [Line([], [], colour, 2.2, name) for name, colour in zip(compared.names, TWO, strict=True)]
    return drawn(CaptionedFigure("comparison", title, caption), rows, heights, keys=keys)


def _zoom(studies: tuple[Study, Study], name: str, *, is_last: bool) -> Panel:
    span = _PERIODS * studies[0].period
    begin = min(one.tau[-1] for one in studies) - span if is_last else max(one.tau[0] for one in studies)
    lines = []
    for one, colour in zip(studies, TWO, strict=True):
        part = (one.tau >= begin) & (one.tau <= begin + span)
        lines.append(Line(one.tau[part], one.motion(name)[part], colour, 1.5))
    reach = symmetric([np.asarray(line.y) for line in lines])
    words = f"{tex(name)}, {'last' if is_last else 'first'} {_PERIODS} periods"
    return Panel(lines, "", time_label(studies[0]), (begin, begin + span), reach, title=words)
