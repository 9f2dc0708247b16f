"""Report of a recording: one self-contained HTML page with its figures, and a few lines for the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import lazy_loader as lazy

from masking.lab.records.recording import MANIFEST, TABLE, Recording
from masking.model.declaration.quantities import number, percent
from masking.reports import html, run_text
from masking.reports.html import Tile
from masking.reports.run_study import (
    BudgetRow,
    InputUse,
    Parameter,
    Study,
    parameters,
)

if TYPE_CHECKING:
    from masking.reports import run_figures
else:
    run_figures = lazy.load("masking.reports.run_figures", suppress_warning=True)

PAGE: Final = "report.html"
_SOURCE = "Rijlaarsdam (2008)"
_HELPS = 0.98  # of chi: what a cause must bring it down to, for its remedy to be shown
_MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True, slots=True)
class Report:
    """The files that were written, the page and its figures as PNG files, and the summary for the terminal."""

    path: Path
    figures: tuple[Path, ...]
    summary: str


def report(recording: Recording, folder: str | Path) -> Report:
    """Write `report.html`, which needs no other file, and its figures as PNG files into a folder, made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    folder, facts = Path(folder), Study(recording)
    found, figures = parameters(recording), run_figures.figures(facts)
    tables = {"synchronisation": _phases(facts), "inputs": _inputs(facts), "masking_error": _errors(facts)}
    shown = [one for one in figures if one.figure is not None or tables.get(one.name)]
    # A figure that has neither a picture nor a table becomes a note.
    notes = [*recording.notes, *(f"{one.title}. {one.caption}" for one in figures if one not in shown)]
    if not found:
        notes.append("Parameters. Not shown: the record does not carry those of a virtual system.")
    images = [folder / f"{one.name}.png" for one in figures if one.figure is not None]
    is_scaled = any(parameter.scaled is not None for parameter in found)
    declared = recording.manifest.get("declarations")
    html.save(
        folder / PAGE,
        "run",
        figures,
        names={*facts.coordinates, *(use.name for use in facts.inputs)},
        title=str(recording.manifest.get("name") or "Recording"),
        lead=_lead(facts, [parameter for parameter in found if parameter.is_changed]),
        tiles=list(_tiles(facts)),
        shown=shown,
        phases=tables["synchronisation"],
        inputs=tables["inputs"],
        input_head=_input_head(facts.inputs),
        errors=tables["masking_error"],
        source=_SOURCE,
        budget=_budget(facts),
        budget_head=["run", *(facts.budget.whole.chi if facts.budget else ()), "rms", "change", "what helps"],
        parameters=[_parameter(one, is_scaled=is_scaled) for one in found],
        is_scaled=is_scaled,
        remarks=notes,
        origin=_provenance(facts, [*(path.name for path in images), PAGE], folder),
        declarations=json.dumps(declared, indent=2, ensure_ascii=False, default=str) if declared else "",
    )
    return Report(folder / PAGE, tuple(images), run_text.summary(facts))


def summary(recording: Recording) -> str:
    """Return at most fourteen lines of plain text on a recording."""
    return run_text.summary(Study(recording))


def warnings(recording: Recording) -> list[str]:
    """Sentences on what limits the validity of the result; empty if all is well."""
    facts = Study(recording)
    return run_text.warnings(recording, facts.inputs, facts.chi)


def limits_used(recording: Recording) -> dict[str, float]:
    """Part of its limit that each input used at its peak; inputs without a limit are left out."""
    return {use.name: use.used for use in Study(recording).inputs if use.used is not None}


def _lead(facts: Study, changed: Sequence[Parameter]) -> list[tuple[str, str]]:
    """Say what happened, with cards for the warnings: a limit exceeded comes right after the first sentence."""
    first, *more = run_text.headline(facts)
    limits, rest = run_text.exceeded(facts.inputs) or run_text.cut(facts.inputs), " ".join(more)
    parts = [("lead", first), ("card wrong", limits), ("lead", rest)] if limits else [("lead", f"{first} {rest}")]
    if changed:
        words = ", ".join(f"{run_text.change(parameter)}{run_text.declared(parameter)}" for parameter in changed)
        parts.append(("changed", f"Changed: {words}."))
    found = run_text.warnings(facts.recording, facts.inputs, facts.chi)
    parts += [("card", text) for text in found if text != limits]
    return [(kind, text.strip()) for kind, text in parts]


def _tiles(facts: Study) -> Iterator[Tile]:
    yield Tile("recorded", *run_text.length(facts))
    if facts.worst is not None:
        yield Tile(f"masking error chi, worst ({facts.worst})", number(facts.chi[facts.worst], 2))
    for pair in facts.pairs[:1]:
        label = f"phase of {pair.first} against {pair.second}"
        yield Tile(label, run_text.pi(pair.end), "" if pair.steady_end >= run_text.STEADY else "not fixed")
    used = [use for use in facts.inputs if use.used is not None]
    if used:
        most = max(used, key=lambda use: use.demand / (use.limit or math.inf))
        what = "demand against a limit" if most.is_cut else "use of a limit"
        part = most.demand / (most.limit or math.inf) if most.is_cut else most.used or 0.0
        yield Tile(f"largest {what} ({most.name})", percent(part), "", most.is_exceeded or most.is_cut)


def _phases(facts: Study) -> list[tuple[str, str]]:
    """Phases and the synchronisation that they mean: (measure, value)."""
    rows = []
    for pair in facts.pairs:
        what = f"phase of {pair.first} against {pair.second}, from start to end"
        fixed = "" if pair.steady_end >= run_text.STEADY else ", not fixed"
        rows.append((what, f"{run_text.pi(pair.start)} to {run_text.pi(pair.end)}{fixed}"))
    rows += [("at the end", str(pair.verdict)) for pair in facts.pairs if pair.verdict is not None]
    if facts.sum_peak is not None:
        start, end = facts.sum_ends
        rows.append((f"peak of {run_text.sum_name(facts)}, from start to end", f"{number(start)} to {number(end)}"))
    fit = facts.anti_phase
    if fit is not None:
        a, b = facts.oscillators
        held = f"|{a}(τ) - alpha {b}(τ + T/2)| <= eps over the last fifth; {_SOURCE}, definition 5.3"
        found = f"alpha = {fit.alpha:.4f}, eps = {number(fit.eps)}, T = {fit.period:.5g}"
        rows.append((held, found if fit.alpha > 0 else "not in anti-phase: no alpha > 0 fits"))
    return rows


def _input_head(uses: Sequence[InputUse]) -> list[str]:
    head = ["input", "meaning", "peak", "rms", "limit", "used"]
    head += ["demanded"] * any(use.is_cut for use in uses)
    return head + ["mean power, peak"] * any(use.power is not None for use in uses)


def _inputs(facts: Study) -> list[list[str]]:
    """How much of each input was used, demanded and turned into heat, in the columns of `_input_head`."""
    rows, head = [], _input_head(facts.inputs)
    for use in facts.inputs:
        meaning = facts.recording.manifest.get("columns", {}).get(f"input.{use.name}", {}).get("meaning", "")
        limit = "none declared" if use.limit is None else f"{use.limit:g} {use.unit}".rstrip()
        used = "" if use.used is None else percent(use.used)
        row = [
            use.name,
            meaning,
            run_text.with_unit(use.peak, use.unit),
            run_text.with_unit(use.rms, use.unit),
            limit,
            used,
        ]
        if "demanded" in head:
            row.append(run_text.with_unit(use.demand, use.unit))
        if "mean power, peak" in head:
            most = "" if use.most_power is None else f" of {use.most_power:g}"
            row.append("" if use.power is None else f"{number(use.power)}{most} W")
        rows.append(row)
    return rows


def _errors(facts: Study) -> list[tuple[str, str, str, str]]:
    """Chi and the largest error of each coordinate: (name, meaning, chi, largest error)."""
    rows = []
    for name, chi in facts.chi.items():
        unit = facts.unit(f"virtual.{name}")
        error = number(facts.errors[name], 2) if name in facts.errors else ""
        rows.append((name, facts.meaning(name), number(chi, 3), f"{error} {unit}".strip()))
    return rows


def _budget(facts: Study) -> list[list[str]]:
    """Chi as it is and without each cause, the most worthwhile first; nothing if there is no budget."""
    if facts.budget is None:
        return []
    found, whole = facts.budget, facts.budget.whole

    def row(made: BudgetRow, change: str) -> list[str]:
        helps = made.remedy if made.rms <= _HELPS * whole.rms else ""
        words = "; ".join(text for text in (made.note, helps) if text)
        chi = [number(made.chi.get(name, math.nan), 2) for name in whole.chi]
        return [made.title, *chi, number(made.rms, 2), change, words]

    rows = [row(whole, "")]
    for made in (*sorted(found.rows, key=lambda made: made.rms), found.without_all):
        rows.append(row(made, "" if not whole.rms > 0.0 else _signed(made.rms / whole.rms - 1.0)))
    return rows


def _signed(part: float) -> str:
    """Relative change in percent, with its sign."""
    if not math.isfinite(part):
        return "diverges"
    text = f"{100 * part:+.0f}"
    return "0 %" if text in {"+0", "-0"} else f"{text.replace('-', _MINUS)} %"


def _parameter(one: Parameter, *, is_scaled: bool) -> list[str]:
    """Value that ran, in the declared unit; beside it that in the virtual system's scales, if any."""
    in_scales = one.scaled if one.scaled is not None else one.value
    value = f"{number(one.value, 7)}{run_text.declared(one)}"
    return [one.name, value, one.unit, *([number(in_scales, 7)] if is_scaled else []), one.meaning]


def _provenance(facts: Study, written: Sequence[str], folder: Path) -> list[tuple[str, object]]:
    """Where the record comes from; `written` are the files of the report."""
    manifest = facts.recording.manifest
    versions = manifest.get("versions") or {}
    scale = manifest.get("time_scale")
    return [
        ("plant", manifest.get("plant_name")),
        ("virtual system", manifest.get("virtual_name")),
        ("record", run_text.record_words(facts)),
        ("observer", run_text.observer(facts)),
        ("time", f"{number(scale, 7)} s of the rig per unit of virtual time" if scale else None),
        ("created", manifest.get("created")),
        ("commit", manifest.get("commit")),
        ("versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("time taken", ", ".join(run_text.timing(manifest))),
        ("energy drift", ", ".join(f"{name} {number(e)}" for name, e in (manifest.get("energy") or {}).items())),
        ("files", ", ".join([*(name for name in (TABLE, MANIFEST) if (folder / name).is_file()), *written])),
    ]
