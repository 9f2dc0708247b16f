"""Pages: a discovery as one HTML page that needs no other file, and all its files."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np

from masking.discovery import latent_force
from masking.discovery.discovery import Discovery
from masking.discovery.localisation import where
from masking.discovery.verdict import probabilities
from masking.estimation.whiteness import DOUBTED
from masking.reports import discovery_files, discovery_text, html, quantities
from masking.reports.discovery_files import Files, Origin

if TYPE_CHECKING:
    from masking.reports import discovery_figures, style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)
    discovery_figures = lazy.load("masking.reports.discovery_figures", suppress_warning=True)

MOST_TRIED = 20
LEAST_SURE = 0.001  # probability: less is told as less than this
LEAST = 0.01  # share of a place that is told
LITTLE = 0.05  # of the power that a force could take out of the motion: less is not told
TITLES = {
    "none": "Nothing is missing",
    "parameter": "A parameter is off",
    "named": "What the model is missing",
    "ambiguous": "What the model may be missing",
    "unknown": "Something unknown is missing",
}


def save(found: Discovery, folder: str | Path, origin: Origin, *, lies: Path | None = None) -> Files:
    """Draw a discovery and write all its files into a folder; see `written.save`."""
    drawn = discovery_figures.plates(found)
    images = {plate.name: style.png(plate) for plate in drawn if plate.figure is not None}
    return discovery_files.save(
        found, folder, origin, page(found, drawn, images, origin, lies or Path(folder)), images, lies=lies
    )


def page(
    found: Discovery, drawn: Sequence[style.Plate], images: Mapping[str, bytes], origin: Origin, folder: Path
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
    after = {
        "gap": _gaps(found, names),
        "map": _where(found, names),
        "residual": _whiteness(found, names),
        "candidates": _tried(found),
    }
    before = {"candidates": _rivals(found)}
    sections = _what_helps(found)
    for plate in drawn:
        if before.get(plate.name):
            sections.append(html.section("What else it may be", before[plate.name]))
        picture = html.picture(plate.title, plate.caption, images.get(plate.name), names)
        sections.append(html.section(plate.title, picture + after.get(plate.name, "")))
    sections.append(html.section("Parameters of the model", _parameters(found, names)))
    sections.append(html.section("Provenance", _provenance(found, origin, folder)))
    lead = html.paragraph(f"{discovery_text.sentence(found)}.", "lead", names)
    told = discovery_text.whereabouts(found)
    if told:
        lead += html.paragraph(f"{'. '.join(told)}.", "changed", names)
    if discovery_text.beside(found):
        lead += html.paragraph(f"{discovery_text.beside(found)}.", "card", names)
    title = TITLES["named" if found.verdict == "ambiguous" and not discovery_text.is_open(found) else found.verdict]
    return html.document(title, lead, _tiles(found, names), sections)


def _tiles(found: Discovery, names: set[str]) -> list[str]:
    tiles = []
    for one in found.effects[:3] if found.verdict != "unknown" else ():
        sure = discovery_text.probability(found, one)
        told = quantities.percent(sure) if sure > LEAST_SURE else f"< {quantities.percent(LEAST_SURE)}"
        tiles.append(html.tile(discovery_text.labelled(found, one.name, one.on), told, "probability", names=names))
    floor, after, worst = found.gap.validation_floor, found.gap.validation[1], discovery_text.worst(found)
    if found.effects:
        before, how = discovery_text.without(found)
        label = f"error in {worst} {'as declared' if how == 'as declared' else 'without it'}"
        tiles.append(html.tile(label, quantities.percent(before[worst]), "unseen", names=names))
    tiles.append(
        html.tile(
            f"error in {worst}" + " with it" * bool(found.effects),
            quantities.percent(after[worst]),
            f"noise {quantities.percent(floor[worst])}",
            is_wrong=after[worst] > found.evidence.rules.validation_noise_floor * floor[worst],
            names=names,
        )
    )
    return tiles


def _what_helps(found: Discovery) -> list[str]:
    """Say what each cause is, its values, where it comes from and what helps."""
    if not discovery_text.offered(found):
        return []
    rows = []
    for one in discovery_text.offered(found):
        units = discovery_text.units(found, one)
        for name, (value, std) in one.parameters.items():
            effect = found.twin.dictionary.get(one.name)
            if effect is None:
                meaning = f"declared {quantities.number(float(found.rig.start[found.rig.names.index(name)]), 5)}"
            else:
                meaning = effect.parameters[name].meaning if name in effect.parameters else "delay"
            rows.append(
                (
                    discovery_text.labelled(found, one.name, one.on),
                    name,
                    quantities.with_deviation(value, std, units.get(name, "")),
                    meaning,
                )
            )
    body = html.table(("what", "parameter", "value", "meaning"), rows)
    cards = [
        (name, f"{meaning} Usual causes: {cause}." if cause else meaning, f"{remedy}." if remedy else "")
        for name, meaning, cause, remedy in discovery_text.remedies(found)
    ]
    if cards:
        body += html.table(("effect", "meaning", "what helps"), cards)
    return [html.section("What was found", body)]


def _gaps(found: Discovery, names: set[str]) -> str:
    gap, share, own = found.gap, latent_force.energies(found), discovery_figures.own_gap(found)
    rows = [
        (name, what, *(quantities.percent(part[name]) for part in parts), share_of if what == "record" else "")
        for name in found.twin.sensors
        for share_of in (quantities.percent(share[name]) if sum(share.values()) else "",)
        for what, parts in (
            ("record", (gap.train[0], own, gap.train[1], gap.floor)),
            ("unseen", (gap.validation[0], found.gap.adjusted, gap.validation[1], gap.validation_floor)),
        )
    ]
    head = ("sensor", "data", "as declared", "adjusted alone", "with what was found", "noise alone", "share of the gap")
    return html.table(head, rows, range(2, 7), names)


def _where(found: Discovery, names: set[str]) -> str:
    """Tabulate the forces that are lacking at each place, and what is lacking on the sides of actuators and sensors."""
    lacking = discovery_text.subject(found)
    seen = [place for place in lacking.places if place.share > LEAST]
    if not seen:
        return html.paragraph("No force beyond its deviation is lacking anywhere.", "missing")
    rows = []
    for place in sorted(seen, key=lambda place: -place.explained):
        parts, portrait = place.portrait.parts, place.portrait
        told = (
            [quantities.percent(part) for part in (parts.displacement, parts.rate, parts.both, parts.neither)]
            if parts is not None
            else [""] * 4
        )
        odd = "" if parts is None or parts.odd is None else quantities.percent(parts.odd)
        loss = quantities.power(abs(portrait.loss), place.units)
        taken = f"{'-' if portrait.loss < 0.0 else ''}{loss}" if abs(portrait.taken) > LITTLE else "little"
        regions = discovery_text.regions(place) if parts is not None else []
        at = discovery_text.listed(regions) if regions else ""
        rows.append((place.name, quantities.percent(place.share), *told, odd, taken, at))
    head = ("place", "share", "displacement", "rate", "both together", "neither", "odd", "takes out", "where")
    said = (
        "What a force at each place alone would make of all that is lacking; which parts of its energy follow the "
        "displacement and the rate there, found on four fifths of the record and held against the rest; how much of "
        "that turns round with both (odd, as friction and cubic springs do; the rest is even, as a quadratic spring); "
        "and the power that it takes out of the motion. "
    )
    for what, those, of in (
        ("command", lacking.actuators, "what is lacking"),
        ("reading", lacking.sensors, "what the simulation leaves of it"),
    ):
        if those:
            each = discovery_text.listed([f"{quantities.percent(part)} ({name})" for name, part in those.items()])
            said += f"A function of a {what} would make {each} of {of}. "
    harmonics = lacking.best.harmonics
    if harmonics is not None and harmonics.only_odd:
        said += (
            f"The commands repeat themselves with odd multiples of {harmonics.base:.4g} Hz only; of the force at "
            f"{lacking.best.name}, {quantities.percent(harmonics.even)} is at even multiples and "
            f"{quantities.percent(harmonics.odd)} at odd ones that were not excited."
        )
    return html.table(head, rows, range(1, 8), names) + html.paragraph(said, "missing", names)


def _whiteness(found: Discovery, names: set[str]) -> str:
    """Tabulate whether the residuals of each sensor are white, before and after."""
    rows = []
    for name, pair in where(found).whiteness.items():
        for what, one in zip(("adjusted alone", "with what was found"), pair, strict=True):
            if one is not None:
                p = f"{one.p:.3f}" if one.p > 5e-4 else "< 0.001"
                rows.append((name, what, discovery_text.white(one), p, quantities.percent(one.beyond)))
    head = ("sensor", "model", "residual", "p if white", "beyond noise")
    said = (
        "Ljung and Box's test of correlations over 0.1 s on data that were not used, with that of an even spectrum; "
        f"where p is below {DOUBTED:g}, the frequency at which the residual is furthest above white noise; and the "
        "part of its mean square that is beyond noise."
    )
    return html.table(head, rows, (3, 4), names) + html.paragraph(said, "missing")


def _rivals(found: Discovery) -> str:
    """Tabulate the explanations that were fitted in full, with their probabilities."""
    rivals, heat = found.rivals, found.temperature
    if len(rivals) < 2 or not found.effects:
        return ""
    rows: dict[str, tuple[float, str, str]] = {}
    sure = probabilities([rival.score(heat) for rival in rivals])
    for rival, probability in zip(rivals, sure, strict=True):
        first, *more = rival.names
        told = " and ".join(
            [discovery_text.labelled(found, *first), *(discovery_text.spoken(found, *name) for name in more)]
        )
        deviations = np.sqrt(heat) * rival.hypothesis.deviations[len(found.rig.names) :]
        values, used = [], 0
        for slot in rival.hypothesis.slots:
            for name, i in zip(slot.names, slot.free, strict=True):
                values.append(f"{name} = {quantities.with_deviation(slot.values[i], float(deviations[used]), '')}")
                used += 1
        worse = quantities.number(rival.score(heat) - rivals[0].score(heat), 4)
        if told in rows:  # a delay of the only actuator is that of all of them
            rows[told] = (rows[told][0] + float(probability), *rows[told][1:])
        else:
            rows[told] = float(probability), worse, ", ".join(values)
    cells = [(told, f"{p:.3f}" if p > 5e-4 else "< 0.001", worse, values) for told, (p, worse, values) in rows.items()]
    head = ("explanation", "probability", "worse by", "value")
    told = (
        "Each was fitted in full, with the model's parameters free within what is believed of them. 'Worse by' is the "
        "difference of -2 log likelihood, with what each parameter must pay (Schwarz). Values in coherent units."
    )
    return html.table(head, cells, (1, 2)) + html.paragraph(told, "missing")


def _tried(found: Discovery) -> str:
    rows = [
        (discovery_text.labelled(found, effect, at), f"{100.0 * part:.3g} %", _paid(paid))
        for effect, at, part, paid in discovery_figures.tried(found)[:MOST_TRIED]
    ]
    head = ("candidate", "would close of the gap", "of what would count")
    return html.table(head, rows, (1, 2)) if rows else ""


def _signed(part: float) -> str:
    return f"{'-' if part < 0.0 else '+'}{quantities.number(100.0 * abs(part), 2)} %"


def _paid(part: float) -> str:
    most = discovery_figures.MOST_PAID
    return f"{100.0 * part:.3g} %" if 100.0 * part <= most else f"> {most:.0f} %"


def _parameters(found: Discovery, names: set[str]) -> str:
    """Tabulate the model's parameters as declared and as found beside the causes."""
    known = found.twin.base.parameters
    rows = []
    for (name, value, std), start in zip(discovery_files.refitted(found), found.rig.start, strict=True):
        change = _signed(value / start - 1.0) if start else ""
        told = quantities.with_deviation(value, std, "")
        rows.append(
            (
                name,
                quantities.number(float(start), 6),
                told,
                change,
                quantities.pretty(known[name].unit),
                known[name].meaning,
            )
        )
    head = ("parameter", "declared", "found", "change", "unit", "meaning")
    said = "They were free within what is believed of them, so that a small error of one is not taken for an effect."
    return html.table(head, rows, (1, 2, 3), names) + html.paragraph(said, "missing")


def _provenance(found: Discovery, origin: Origin, folder: Path) -> str:
    files = discovery_files.paths(found, folder)
    record, judge = found.record, found.judge
    rows: list[tuple[str, object]] = [(what, f"{path}, SHA-256 {sha}") for what, (path, sha) in origin.records.items()]
    rows += [
        ("samples", f"{len(record)} to find, {len(judge)} to judge by, {record.rate:g} Hz"),
        ("rig", found.twin.declaration.name),
        ("model", ", ".join(found.twin.base.files) or found.twin.declaration.model),
        *[("own effects", file) for one in found.twin.declaration.dictionaries for file in one.files],
        ("written", ", ".join(str(p) for p in (files.model, files.plant, files.numbers) if p)),
        ("versions", ", ".join([f"python {platform.python_version()}", *map(_version, ("masking", "numpy", "numba"))])),
    ]
    return html.provenance(rows)


def _version(library: str) -> str:
    return f"{library} {importlib.metadata.version(library)}"


def summary(found: Discovery, files: Files | None) -> str:
    """Say in a few lines for the terminal what was found, and what was written."""
    lines = [f"{discovery_text.sentence(found)}."]
    if discovery_text.beside(found):
        lines.append(f"{discovery_text.beside(found)}.")
    lines += [f"{told}." for told in discovery_text.whereabouts(found)]
    gap = found.gap
    head = ("error on unseen data", *found.twin.sensors)
    table = [head]
    for what, part in (
        ("as declared", gap.validation[0]),
        ("parameters adjusted alone", found.gap.adjusted),
        ("with what was found", gap.validation[1]),
        ("noise alone", gap.validation_floor),
    ):
        if what == "with what was found" and not found.effects:
            continue
        table.append((what, *(quantities.percent(part[name]) for name in found.twin.sensors)))
    widths = [max(len(row[i]) for row in table) for i in range(len(head))]
    lines += ["  " + "  ".join(f"{cell:{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    for one in discovery_text.offered(found):
        effect = found.twin.dictionary.get(one.name)
        if effect is not None and (effect.cause or effect.remedy):
            told = [effect.cause or effect.meaning, *([f"what helps: {effect.remedy}"] if effect.remedy else [])]
            lines.append(f"{discovery_text.titled(one.name)}: {'; '.join(told)}")
    if files is not None:
        told = [str(path) for path in (files.model, files.plant, files.numbers) if path]
        lines += [f"written: {', '.join(told)}", f"page: {files.page}"]
    return "\n".join(lines)
