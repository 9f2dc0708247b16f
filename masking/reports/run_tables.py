"""Tables of the report: what a study shows, as HTML, with its symbols typeset."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from masking.records.recording import MANIFEST, TABLE
from masking.reports import html
from masking.reports.run_facts import BudgetRow, Parameter, Study, percent
from masking.reports.run_text import STEADY, declared, number, observer, pi, record_words, sum_name, timing

_SOURCE = "Rijlaarsdam (2008)"
_HELPS = 0.98  # of chi: what a cause must bring it down to, for its remedy to be told
_MINUS = "\N{MINUS SIGN}"


def phases(facts: Study) -> str:
    """Tabulate phases and the synchronisation that they mean; "" where there is none."""
    rows = [
        (
            f"phase of {pair.first} against {pair.second}, from start to end",
            f"{pi(pair.start)} to {pi(pair.end)}" + ("" if pair.steady_end >= STEADY else ", not fixed"),
        )
        for pair in facts.pairs
    ]
    rows += [("at the end", str(pair.verdict)) for pair in facts.pairs if pair.verdict is not None]
    if facts.sum_peak is not None:
        start, end = facts.sum_ends
        rows.append((f"peak of {sum_name(facts)}, from start to end", f"{number(start)} to {number(end)}"))
    fit = facts.anti_phase
    if fit is not None:
        a, b = facts.oscillators
        held = f"|{a}(τ) - alpha {b}(τ + T/2)| <= eps over the last fifth; {_SOURCE}, definition 5.3"
        if fit.alpha > 0:
            rows.append((held, f"alpha = {fit.alpha:.4f}, eps = {number(fit.eps)}, T = {fit.period:.5g}"))
        else:
            rows.append((held, "not in anti-phase: no alpha > 0 fits"))
    return _table(facts, ("measure", "value"), rows, numbers=()) if rows else ""


def inputs(facts: Study) -> str:
    """Tabulate how much of each input was used, demanded and turned into heat; "" where there is none."""
    rows = []
    is_cut = any(use.is_cut for use in facts.inputs)
    has_power = any(use.power is not None for use in facts.inputs)
    for use in facts.inputs:
        meaning = facts.recording.manifest.get("columns", {}).get(f"input.{use.name}", {}).get("meaning", "")
        limit = "none declared" if use.limit is None else f"{use.limit:g} {use.unit}".rstrip()
        peak, rms = (f"{number(value)} {use.unit}".rstrip() for value in (use.peak, use.rms))
        row = [use.name, meaning, peak, rms, limit, percent(use.used)]
        if is_cut:
            row.append(f"{number(use.demand)} {use.unit}".rstrip())
        if has_power:
            most = "" if use.most_power is None else f" of {use.most_power:g}"
            row.append("" if use.power is None else f"{number(use.power)}{most} W")
        rows.append(row)
    head = ["input", "meaning", "peak", "rms", "limit", "used"]
    head += ["demanded"] * is_cut + ["mean power, peak"] * has_power
    return _table(facts, head, rows, numbers=range(2, len(head))) if rows else ""


def masking_error(facts: Study) -> str:
    """Tabulate chi and the largest error of each coordinate; "" where there is nothing to compare with."""
    rows = []
    for name, chi in facts.chi.items():
        ideal, unit = facts.ideal(name), facts.unit(f"virtual.{name}")
        error = "" if ideal is None else number(np.abs(facts.motion(name) - ideal).max(), 2)
        rows.append((name, facts.meaning(name), number(chi, 3), f"{error} {unit}".strip()))
    if not rows:
        return ""
    words = f"chi = ||virtual - ideal|| / ||ideal||, the relative rms error over the record; {_SOURCE}, (4.12)."
    table = _table(facts, ("coordinate", "meaning", "chi", "largest error"), rows, numbers=(2, 3))
    return table + html.paragraph(words, "missing", symbols(facts))


def budget(facts: Study) -> str:
    """Tabulate chi as it is and without each cause, the most worthwhile first; "" where that was not found out."""
    if facts.budget is None:
        return ""
    found, whole = facts.budget, facts.budget.whole
    names = list(whole.chi)

    def row(made: BudgetRow, change: str) -> list[str]:
        helps = made.remedy if made.rms <= _HELPS * whole.rms else ""
        words = "; ".join(text for text in (made.note, helps) if text)
        chi = [number(made.chi.get(name, math.nan), 2) for name in names]
        return [made.title, *chi, number(made.rms, 2), change, words]

    rows = [row(whole, "")]
    for made in (*sorted(found.rows, key=lambda made: made.rms), found.without_all):
        change = "" if not whole.rms > 0.0 else _signed(made.rms / whole.rms - 1.0)
        rows.append(row(made, change))
    head = ["run", *names, "rms", "change", "what helps"]
    table = _table(facts, head, rows, numbers=range(1, len(names) + 3))
    words = "chi of each coordinate, and the root of their mean square, in further runs of the same twin."
    return table + html.paragraph(words, "missing", symbols(facts))


def _signed(part: float) -> str:
    """Write a relative change in percent, with its sign."""
    if not math.isfinite(part):
        return "diverges"
    text = f"{100 * part:+.0f}"
    return "0 %" if text in {"+0", "-0"} else f"{text.replace('-', _MINUS)} %"


def virtual_parameters(facts: Study, found: Sequence[Parameter]) -> str:
    """Tabulate the values that ran, in the declared units; beside them those in the virtual system's scales, if any."""
    scaled = any(parameter.scaled is not None for parameter in found)
    rows = []
    for p in found:
        in_scales = p.scaled if p.scaled is not None else p.value
        rows.append([p.name, f"{number(p.value, 7)}{declared(p)}", p.unit, number(in_scales, 7), p.meaning])
    head = ["parameter", "value", "unit", "in its scales", "meaning"]
    if not scaled:
        head, rows = [text for text in head if text != "in its scales"], [row[:3] + row[4:] for row in rows]
    return _table(facts, head, rows, numbers=(1, 3) if scaled else (1,))


def provenance(facts: Study, written: Iterable[str], folder: Path) -> str:
    """Tabulate where the record comes from, with all declarations; `written` are the files of the report."""
    manifest = facts.recording.manifest
    versions = manifest.get("versions") or {}
    rows = [
        ("plant", manifest.get("plant_name")),
        ("virtual system", manifest.get("virtual_name")),
        ("record", record_words(facts)),
        ("observer", observer(facts)),
        ("time", f"{number(manifest['time_scale'], 7)} s of the rig per unit of virtual time"
         if manifest.get("time_scale") else None),
        ("created", manifest.get("created")),
        ("commit", manifest.get("commit")),
        ("versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("time taken", ", ".join(timing(manifest))),
        ("energy drift", ", ".join(f"{name} {number(e)}" for name, e in (manifest.get("energy") or {}).items())),
        ("files", ", ".join([*(name for name in (TABLE, MANIFEST) if (folder / name).is_file()), *written])),
    ]  # fmt: skip
    declarations = manifest.get("declarations")
    text = json.dumps(declarations, indent=2, ensure_ascii=False, default=str)
    return html.provenance(rows) + (html.details("All declarations", text) if declarations else "")


def symbols(facts: Study) -> set[str]:
    """Return the names that are typeset as symbols wherever they stand in a text."""
    return {*facts.coordinates, *(use.name for use in facts.inputs)}


def _table(facts: Study, head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int]) -> str:
    return html.table(head, rows, numbers, symbols(facts))
