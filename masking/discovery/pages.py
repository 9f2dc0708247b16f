"""Pages: a discovery as one HTML page that needs no other file, and all its files."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np

from masking import markup
from masking.discovery import forces, words, written
from masking.discovery.discover import Discovery
from masking.discovery.search import probabilities
from masking.discovery.written import Files, Origin
from masking.effects import EFFECTS

if TYPE_CHECKING:
    from masking import drawing
    from masking.discovery import plates
else:
    drawing = lazy.load("masking.drawing", suppress_warning=True)
    plates = lazy.load("masking.discovery.plates", suppress_warning=True)

MOST_TRIED = 20
TITLES = {
    "none": "Nothing is missing",
    "parameter": "A parameter is off",
    "named": "What the model is missing",
    "ambiguous": "What the model may be missing",
    "unknown": "Something unknown is missing",
}


def save(found: Discovery, folder: str | Path, origin: Origin, *, lies: Path | None = None) -> Files:
    """Draw a discovery and write all its files into a folder; see `written.save`."""
    drawn = plates.plates(found)
    images = {plate.name: drawing.png(plate) for plate in drawn if plate.figure is not None}
    return written.save(
        found, folder, origin, page(found, drawn, images, origin, lies or Path(folder)), images, lies=lies
    )


def page(
    found: Discovery, drawn: Sequence[drawing.Plate], images: Mapping[str, bytes], origin: Origin, folder: Path
) -> str:
    """Return the page of a discovery.

    Args:
        found: the discovery.
        drawn: its figures.
        images: these as PNG, by name; those that have none are told by their captions.
        origin: of the records.
        folder: where its files lie.
    """
    names = {*found.twin.sensors, *found.twin.actuators, *found.twin.model.coordinates, *found.rig.names}
    after = {"gap": _gaps(found, names), "candidates": _tried(found)}
    before = {"candidates": _rivals(found)}
    sections = _what_helps(found)
    for plate in drawn:
        if before.get(plate.name):
            sections.append(markup.section("What else it may be", before[plate.name]))
        picture = markup.picture(plate.title, plate.caption, images.get(plate.name), names)
        sections.append(markup.section(plate.title, picture + after.get(plate.name, "")))
    sections.append(markup.section("Parameters of the model", _parameters(found, names)))
    sections.append(markup.section("Provenance", _provenance(found, origin, folder)))
    lead = markup.paragraph(f"{words.sentence(found)}.", "lead", names)
    if found.effects and found.verdict != "unknown" and is_more_left(found):
        lead += markup.paragraph(f"Something else is left. {words.look(found)}.", "card", names)
    return markup.document(TITLES[found.verdict], lead, _tiles(found, names), sections)


def is_more_left(found: Discovery) -> bool:
    """Return whether more than noise is left of a sensor in the record that judges."""
    after, floor = found.gap.validation[1], found.gap.validation_floor
    return any(after[name] > words.CLOSED * floor[name] for name in floor)


def _tiles(found: Discovery, names: set[str]) -> list[str]:
    tiles = []
    for one in found.effects[:3] if found.verdict != "unknown" else ():
        tiles.append(markup.tile(_spoken(one.name, one.on), words.percent(one.probability), "probability", names=names))
    floor, after, worst = found.gap.validation_floor, found.gap.validation[1], words.worst(found)
    if found.effects:
        before = words.percent(found.adjusted_gap[worst])
        tiles.append(markup.tile(f"error in {worst} without it", before, "unseen", names=names))
    tiles.append(
        markup.tile(
            f"error in {worst}" + " with it" * bool(found.effects),
            words.percent(after[worst]),
            f"noise {words.percent(floor[worst])}",
            is_wrong=after[worst] > words.CLOSED * floor[worst],
            names=names,
        )
    )
    return tiles


def _spoken(name: str, on: str) -> str:
    return words.capital(words.spoken(name, on))


def _what_helps(found: Discovery) -> list[str]:
    """Say what each cause is, its values, where it comes from and what helps."""
    if not found.effects:
        return []
    rows = []
    for one in found.effects:
        units = words.units(found, one)
        for name, (value, std) in one.parameters.items():
            meaning = EFFECTS[one.name].parameters[name].meaning if one.name in EFFECTS and name != "tau" else ""
            if one.name not in EFFECTS:
                declared = float(found.rig.start[found.rig.names.index(name)])
                meaning = f"declared {words.number(declared, 5)}"
            elif not meaning:
                meaning = (
                    EFFECTS[one.name].parameters[name].meaning if name in EFFECTS[one.name].parameters else "delay"
                )
            rows.append(
                (_spoken(one.name, one.on), name, words.with_deviation(value, std, units.get(name, "")), meaning)
            )
    body = markup.table(("what", "parameter", "value", "meaning"), rows)
    cards = [
        (name, f"{meaning} Usual causes: {cause}.", f"{remedy}.")
        for name, meaning, cause, remedy in words.remedies(found)
    ]
    if cards:
        body += markup.table(("effect", "meaning", "what helps"), cards)
    if found.next_experiment is not None:
        body += markup.paragraph(f"{words.capital(str(found.next_experiment))}.", "card")
    return [markup.section("What was found", body)]


def _gaps(found: Discovery, names: set[str]) -> str:
    gap, share, own = found.gap, forces.energies(found), plates.own_gap(found)
    rows = [
        (name, what, *(words.percent(part[name]) for part in parts), share_of if what == "record" else "")
        for name in found.twin.sensors
        for share_of in (words.percent(share[name]) if sum(share.values()) else "",)
        for what, parts in (
            ("record", (gap.train[0], own, gap.train[1], gap.floor)),
            ("unseen", (gap.validation[0], found.adjusted_gap, gap.validation[1], gap.validation_floor)),
        )
    ]
    head = ("sensor", "data", "as declared", "adjusted alone", "with what was found", "noise alone", "share of the gap")
    return markup.table(head, rows, range(2, 7), names)


def _rivals(found: Discovery) -> str:
    """Tabulate the explanations that were fitted in full, with their probabilities."""
    rivals, heat = found.rivals, found.temperature
    if len(rivals) < 2 or not found.effects:
        return ""
    rows = []
    sure = probabilities(rivals, heat)
    for rival, probability in zip(rivals, sure, strict=True):
        told = " and ".join(words.spoken(*name) for name in rival.names)
        deviations = np.sqrt(heat) * rival.hypothesis.deviations[len(found.rig.names) :]
        values, used = [], 0
        for slot in rival.hypothesis.slots:
            for name, i in zip(slot.names, slot.free, strict=True):
                values.append(f"{name} = {words.with_deviation(slot.values[i], float(deviations[used]), '')}")
                used += 1
        p = f"{probability:.3f}" if probability > 5e-4 else "< 0.001"
        worse = words.number(rival.score(heat) - rivals[0].score(heat), 4)
        rows.append((words.capital(told), p, worse, ", ".join(values)))
    head = ("explanation", "probability", "worse by", "value")
    told = (
        "Each was fitted in full, with the model's parameters free within what is believed of them. 'Worse by' is the "
        "difference of -2 log likelihood, with what each parameter must pay (Schwarz). Values in coherent units."
    )
    return markup.table(head, rows, (1, 2)) + markup.paragraph(told, "missing")


def _tried(found: Discovery) -> str:
    rows = [
        (words.capital(words.spoken(effect, at)), f"{100.0 * part:.3g} %", f"{100.0 * paid:.3g} %")
        for effect, at, part, paid in plates.tried(found)[:MOST_TRIED]
    ]
    head = ("candidate", "would close of the gap", "of what would count")
    return markup.table(head, rows, (1, 2)) if rows else ""


def _parameters(found: Discovery, names: set[str]) -> str:
    """Tabulate the model's parameters as declared and as found beside the causes."""
    known = found.twin.base.parameters
    rows = []
    for (name, value, std), start in zip(written.refitted(found), found.rig.start, strict=True):
        change = f"{100.0 * (value / start - 1.0):+.2g} %" if start else ""
        told = words.with_deviation(value, std, "")
        rows.append(
            (name, words.number(float(start), 6), told, change, words.pretty(known[name].unit), known[name].meaning)
        )
    head = ("parameter", "declared", "found", "change", "unit", "meaning")
    said = "They were free within what is believed of them, so that a small error of one is not taken for an effect."
    return markup.table(head, rows, (1, 2, 3), names) + markup.paragraph(said, "missing")


def _provenance(found: Discovery, origin: Origin, folder: Path) -> str:
    files = written.paths(found, folder)
    record, judge = found.record, found.judge
    rows: list[tuple[str, object]] = [(what, f"{path}, SHA-256 {sha}") for what, (path, sha) in origin.records.items()]
    rows += [
        ("samples", f"{len(record)} to find, {len(judge)} to judge by, {record.rate:g} Hz"),
        ("rig", found.twin.declaration.name),
        ("model", ", ".join(found.twin.base.files) or found.twin.declaration.model),
        ("written", ", ".join(str(p) for p in (files.model, files.plant, files.numbers) if p)),
        ("versions", ", ".join([f"python {platform.python_version()}", *map(_version, ("masking", "numpy", "numba"))])),
    ]
    return markup.provenance(rows)


def _version(library: str) -> str:
    return f"{library} {importlib.metadata.version(library)}"


def summary(found: Discovery, files: Files | None) -> str:
    """Say in a few lines for the terminal what was found, and what was written."""
    lines = [f"{words.sentence(found)}."]
    if found.effects and found.verdict != "unknown" and is_more_left(found):
        lines.append(f"Something else is left. {words.look(found)}.")
    gap = found.gap
    head = ("error on unseen data", *found.twin.sensors)
    table = [head]
    for what, part in (
        ("as declared", gap.validation[0]),
        ("parameters adjusted alone", found.adjusted_gap),
        ("with what was found", gap.validation[1]),
        ("noise alone", gap.validation_floor),
    ):
        if what == "with what was found" and not found.effects:
            continue
        table.append((what, *(words.percent(part[name]) for name in found.twin.sensors)))
    widths = [max(len(row[i]) for row in table) for i in range(len(head))]
    lines += ["  " + "  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    for one in found.effects:
        if one.name in EFFECTS:
            lines.append(
                f"{one.name.replace('_', ' ')}: {EFFECTS[one.name].cause}; what helps: {EFFECTS[one.name].remedy}"
            )
    if files is not None:
        told = [str(path) for path in (files.model, files.plant, files.numbers) if path]
        lines += [f"written: {', '.join(told)}", f"page: {files.page}"]
    return "\n".join(lines)
