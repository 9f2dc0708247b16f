"""Report of a recording: one self-contained HTML page with its figures, and a few lines for the terminal."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from masking.display.printed_result import Printed
from masking.lab.records.recording import MANIFEST, TABLE, Recording
from masking.lazy_imports import run_figures
from masking.model.declaration.quantities import number, percent
from masking.reports import html, one_page, run_text
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.run_study import Parameter, Study, parameters
from masking.reports.text import capital

PAGE: Final = "report.html"
_SOURCE = "Rijlaarsdam (2008)"


@dataclass(frozen=True, repr=False, slots=True)
class Report(Printed):
    """Path of the page, its figures as PNG files, and the summary for the terminal."""

    path: Path
    figures: tuple[Path, ...]
    summary: str

    def __str__(self) -> str:
        return f"{self.summary}\nreport: {self.path}"

    def as_dict(self) -> dict[str, Any]:
        """Its files as JSON can hold them."""
        return {"report": str(self.path), "figures": [str(figure) for figure in self.figures]}


def report(recording: Recording, folder: str | Path) -> Report:
    """Write `report.html`, which needs no other file, and its figures as PNG files into a folder, made if need be.

    Raises a `RecordError` where the folder cannot be written.
    """
    folder, study = Path(folder), Study(recording)
    virtual, figures = parameters(recording), run_figures.figures(study)
    tables = {"synchronisation": not study.no_phase, "inputs": bool(study.inputs), "masking_error": bool(study.chi)}
    shown = [one for one in figures if one.figure is not None or tables.get(one.name)]
    # A figure that has neither a picture nor a table becomes a note.
    notes = [*recording.notes, *(f"{one.title}. {one.caption}" for one in figures if one not in shown)]
    if not virtual:
        notes.append("Parameters. Not shown: the record does not carry those of a virtual system.")
    images = [folder / f"{one.name}.png" for one in figures if one.figure is not None]
    records = [name for name in (TABLE, MANIFEST) if (folder / name).is_file()]
    declared = recording.manifest.get("declarations")
    html.save(
        folder / PAGE,
        "run",
        figures,
        names={*study.coordinates, *(use.name for use in study.inputs)},
        title=str(recording.manifest.get("name") or "Recording"),
        study=study,
        words=run_text,
        tiles=_tiles(study),
        lead=_lead(study, virtual),
        shown=shown,
        source=_SOURCE,
        parameters=virtual,
        remarks=notes,
        files=[*records, *(path.name for path in images), PAGE],
        declarations=json.dumps(declared, indent=2, ensure_ascii=False, default=str) if declared else "",
    )
    return Report(folder / PAGE, tuple(images), run_text.summary(study))


def sheet(recording: Recording, what: str) -> Sheet:
    """What one page says of a recording; `what` is its name where the manifest has none.

    The errors are those of the run, and those of the run without all causes of the error budget, if there is one.
    """
    study, manifest = Study(recording), recording.manifest
    changed = [text for kind, text in _lead(study, parameters(recording)) if kind == "changed"]
    errors, budget = {"masking error": study.chi}, study.budget
    helps = list[str]()
    if budget:
        whole, *rows, without_all = budget
        errors = {row.title: row.chi for row in (whole, without_all)}
        better = [row for row in rows if row.rms < whole.rms]
        helps = [f"{capital(row.title)}: {'; '.join(run_text.worth(row, whole))}." for row in better]
    sections = {
        one_page.FOUND: [" ".join(run_text.headline(study)), *changed],
        one_page.LIMITS: run_text.warnings(study),
        one_page.NEXT: helps,
        one_page.NOTES: list(recording.notes),
    }
    made = f"{run_text.record_words(study)}; {manifest.get('created') or 'its date is not recorded'}"
    return Sheet(
        title=str(manifest.get("name") or what),
        subject=[made],
        tiles=_tiles(study),
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite(errors),
        errors_title="Masking error",
        errors_label="chi",
        in_percent=False,
        page=PAGE,
    )


def summary(recording: Recording) -> str:
    """At most fourteen lines of plain text on a recording."""
    return run_text.summary(Study(recording))


def warnings(recording: Recording) -> list[str]:
    """Sentences on what limits the validity of the result; empty if all is well."""
    return run_text.warnings(Study(recording))


def strayed(recording: Recording) -> str:
    """Sentence on a masking error above 1; empty where there is none."""
    return run_text.strayed(Study(recording))


def limits_used(recording: Recording) -> dict[str, float]:
    """Part of its limit that each input used at its peak; inputs without a limit are left out."""
    return {use.name: use.used for use in Study(recording).inputs if use.used is not None}


def _lead(study: Study, virtual: Sequence[Parameter]) -> list[tuple[str, str]]:
    """Headline, with cards for the warnings: a limit exceeded comes right after the first sentence."""
    first, *more = run_text.headline(study)
    limits, rest = run_text.exceeded(study.inputs) or run_text.cut(study.inputs), " ".join(more)
    parts = [("lead", first), ("card wrong", limits), ("lead", rest)] if limits else [("lead", f"{first} {rest}")]
    changed = [f"{run_text.change(one)}{run_text.declared(one)}" for one in virtual if one.is_changed]
    parts += [("changed", f"Changed: {', '.join(changed)}.")] if changed else []
    parts += [("card", text) for text in run_text.warnings(study) if text != limits]
    return [(kind, text.strip()) for kind, text in parts]


def _tiles(study: Study) -> list[Tile]:
    """Length, worst masking error, phase of the first two oscillators, and largest use of a limit."""
    made, use = [Tile("recorded", *run_text.length(study))], study.most_used
    if study.worst is not None:
        made.append(Tile(f"masking error chi, worst ({study.worst})", number(study.chi[study.worst], 2)))
    for pair in study.pairs[:1]:
        what = f"phase of {pair.first} against {pair.second}"
        made.append(Tile(what, run_text.pi(pair.end), run_text.locking(pair)))
    if use is not None and use.used is not None:
        what = f"largest {'demand against' if use.is_cut else 'use of'} a limit ({use.name})"
        part = use.demanded_part if use.is_cut else use.used
        made.append(Tile(what, percent(part), "", use.is_exceeded or use.is_cut))
    return made
