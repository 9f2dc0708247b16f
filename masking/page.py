"""Page: a study as one HTML page that needs no other file."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Final

import lazy_loader as lazy

from masking import tables
from masking.study import Parameter, Study, parameters, percent
from masking.tables import prose
from masking.wording import STEADY, change, cut, declared, exceeded, headline, length, number, pi, warnings

if TYPE_CHECKING:
    from masking import figures
else:
    figures = lazy.load("masking.figures", suppress_warning=True)

PAGE: Final = "report.html"
_TEMPLATE = Path(__file__).with_name("report_template.html")


def png(plate: figures.Plate) -> bytes:
    """Give a figure as the content of a PNG file."""
    stream = io.BytesIO()
    if plate.figure is not None:
        plate.figure.savefig(stream, format="png", metadata={"Title": plate.title})
    return stream.getvalue()


def page(facts: Study, plates: Sequence[figures.Plate], images: Mapping[str, bytes], folder: Path) -> str:
    """Write the page.

    Args:
        facts: what is told.
        plates: the figures with their words.
        images: PNG of each plate that has a figure, by its name.
        folder: where the page will be.
    """
    name = str(facts.recording.manifest.get("name") or "Recording")
    made = {
        "synchronisation": tables.phases,
        "inputs": tables.inputs,
        "fidelity": tables.fidelity,
        "budget": tables.budget,
    }
    sections, notes = [], list(facts.recording.notes)
    for plate in plates:
        table = made[plate.name](facts) if plate.name in made else ""
        if plate.figure is None and not table:
            notes.append(f"{plate.title}. {plate.caption}")
        else:
            sections.append(_section(plate.title, _figure(facts, plate, images.get(plate.name)) + table))
    found = parameters(facts.recording)
    if found:
        sections.append(_section("Parameters of the virtual system", tables.virtual_parameters(facts, found)))
    else:
        notes.append("Parameters. Not shown: the record does not carry those of a virtual system.")
    if notes:
        items = "".join(f"<li>{prose(facts, note)}</li>" for note in notes)
        sections.append(_section("Notes", f'<ul class="missing">{items}</ul>'))
    written = [*(f"{image}.png" for image in images), PAGE]
    sections.append(_section("Provenance", tables.provenance(facts, written, folder)))
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=html.escape(name),
        heading=html.escape(name[0].upper() + name[1:]),
        lead=_lead(facts, [parameter for parameter in found if parameter.is_changed]),
        tiles="\n".join(_tiles(facts)),
        sections="\n".join(sections),
    )


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
    return "\n".join(f'<p class="{kind}">{prose(facts, text.strip())}</p>' for kind, text in parts if text)


def _tiles(facts: Study) -> list[str]:
    tiles = [("recorded", *length(facts), "")]
    if facts.worst is not None:
        tiles.append((f"fidelity chi, worst ({facts.worst})", number(facts.chi[facts.worst], 2), "", ""))
    if facts.pairs:
        pair = facts.pairs[0]
        label = f"phase of {pair.first} against {pair.second}"
        tiles.append((label, pi(pair.end), "" if pair.steady_end >= STEADY else "not fixed", ""))
    used = [use for use in facts.inputs if use.used is not None]
    if used:
        most = max(used, key=lambda use: use.demand / (use.limit or math.inf))
        kind = ' class="wrong"' if most.is_exceeded or most.is_cut else ""
        what = "demand against a limit" if most.is_cut else "use of a limit"
        part = most.demand / (most.limit or math.inf) if most.is_cut else most.used
        tiles.append((f"largest {what} ({most.name})", percent(part), "", kind))
    return [
        f"<div{kind}><dt>{prose(facts, label)}</dt><dd>{prose(facts, value)}"
        + (f" <small>{prose(facts, unit)}</small>" if unit else "")
        + "</dd></div>"
        for label, value, unit, kind in tiles
    ]


def _section(title: str, body: str) -> str:
    return f"<section>\n<h2>{html.escape(title)}</h2>\n{body}\n</section>"


def _figure(facts: Study, plate: figures.Plate, image: bytes | None) -> str:
    caption = prose(facts, plate.caption)
    if image is None:
        return f'<p class="missing">{caption}</p>'
    data = base64.b64encode(image).decode("ascii")
    alt = html.escape(f"{plate.title}. {plate.caption}", quote=True)
    return (
        f'<figure>\n<img alt="{alt}" src="data:image/png;base64,{data}">\n<figcaption>{caption}</figcaption>\n</figure>'
    )
