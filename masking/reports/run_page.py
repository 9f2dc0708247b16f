"""Page: a study as one HTML page that needs no other file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import lazy_loader as lazy

from masking.reports import html, run_tables
from masking.reports.run_facts import Parameter, Study, parameters, percent
from masking.reports.run_tables import symbols
from masking.reports.run_text import STEADY, change, cut, declared, exceeded, headline, length, number, pi, warnings

if TYPE_CHECKING:
    from masking.reports import style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)

PAGE: Final = "report.html"


def page(facts: Study, plates: Sequence[style.Plate], images: Mapping[str, bytes], folder: Path) -> str:
    """Write the page.

    Args:
        facts: what is told.
        plates: the figures with their words.
        images: PNG of each plate that has a figure, by its name.
        folder: where the page will be.
    """
    name = str(facts.recording.manifest.get("name") or "Recording")
    made = {
        "synchronisation": run_tables.phases,
        "inputs": run_tables.inputs,
        "masking_error": run_tables.masking_error,
        "budget": run_tables.budget,
    }
    sections, notes, names = [], list(facts.recording.notes), symbols(facts)
    for plate in plates:
        table = made[plate.name](facts) if plate.name in made else ""
        image = html.picture(plate.title, plate.caption, images.get(plate.name), names)
        if plate.figure is None and not table:
            notes.append(f"{plate.title}. {plate.caption}")
        else:
            sections.append(html.section(plate.title, image + table))
    found = parameters(facts.recording)
    if found:
        sections.append(html.section("Parameters of the virtual system", run_tables.virtual_parameters(facts, found)))
    else:
        notes.append("Parameters. Not shown: the record does not carry those of a virtual system.")
    if notes:
        items = "".join(f"<li>{html.prose(note, names)}</li>" for note in notes)
        sections.append(html.section("Notes", f'<ul class="missing">{items}</ul>'))
    written = [*(f"{image}.png" for image in images), PAGE]
    sections.append(html.section("Provenance", run_tables.provenance(facts, written, folder)))
    lead = _lead(facts, [parameter for parameter in found if parameter.is_changed])
    return html.document(name, lead, _tiles(facts), sections)


def _lead(facts: Study, changed: Sequence[Parameter]) -> str:
    """Say what happened, with cards for the warnings: a limit exceeded comes right after the first sentence."""
    first, *more = headline(facts)
    limits, rest = exceeded(facts.inputs) or cut(facts.inputs), " ".join(more)
    found = warnings(facts.recording, facts.inputs, facts.chi)
    parts = [("lead", first), ("card wrong", limits), ("lead", rest)] if limits else [("lead", f"{first} {rest}")]
    if changed:
        words = ", ".join(f"{change(parameter)}{declared(parameter)}" for parameter in changed)
        parts.append(("changed", f"Changed: {words}."))
    parts += [("card", text) for text in found if text != limits]
    return "\n".join(html.paragraph(text.strip(), kind, symbols(facts)) for kind, text in parts if text)


def _tiles(facts: Study) -> list[str]:
    tiles = [("recorded", *length(facts), False)]
    if facts.worst is not None:
        tiles.append((f"masking error chi, worst ({facts.worst})", number(facts.chi[facts.worst], 2), "", False))
    if facts.pairs:
        pair = facts.pairs[0]
        label = f"phase of {pair.first} against {pair.second}"
        tiles.append((label, pi(pair.end), "" if pair.steady_end >= STEADY else "not fixed", False))
    used = [use for use in facts.inputs if use.used is not None]
    if used:
        most = max(used, key=lambda use: use.demand / (use.limit or math.inf))
        what = "demand against a limit" if most.is_cut else "use of a limit"
        part = most.demand / (most.limit or math.inf) if most.is_cut else most.used
        tiles.append((f"largest {what} ({most.name})", percent(part), "", most.is_exceeded or most.is_cut))
    return [
        html.tile(label, value, unit, is_wrong=is_wrong, names=symbols(facts)) for label, value, unit, is_wrong in tiles
    ]
