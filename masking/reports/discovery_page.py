"""Pages: a discovery as one HTML page that needs no other file, and all its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from masking.inference.discovery import latent_force
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.localisation import LatentForces
from masking.inference.discovery.verdict import noise_threshold, probabilities
from masking.inference.estimation.whiteness import DOUBTED
from masking.model.declaration.quantities import number, percent, with_deviation
from masking.model.declaration.units import pretty
from masking.reports import discovery_figures, discovery_files, discovery_text, html, place_text
from masking.reports.discovery_files import Files, Origin
from masking.reports.html import Tile
from masking.reports.style import CaptionedFigure
from masking.reports.text import aligned, listed

MOST_TRIED = 20
LEAST_SURE = 0.001  # probability: less is shown as less than this
LEAST = 0.01  # share of a place that is shown
LITTLE = 0.05  # of the power that a force could take out of the motion: less is not shown
TITLES = {
    "none": "Nothing is missing",
    "parameter": "A parameter is off",
    "named": "What the model is missing",
    "ambiguous": "What the model may be missing",
    "unknown": "Something unknown is missing",
}


def save(found: Discovery, folder: str | Path, origin: Origin, *, lies: Path | None = None) -> Files:
    """Draw a discovery and write all its files into a folder; see `discovery_files.save`.

    Args:
        found: the discovery.
        folder: where to write.
        origin: of the records.
        lies: the folder to which all will be moved, if that is another.
    """
    figures = discovery_figures.figures(found)
    text = page(found, figures, origin, lies or Path(folder))
    return discovery_files.save(found, folder, origin, text, figures, lies=lies)


def page(found: Discovery, figures: Sequence[CaptionedFigure], origin: Origin, folder: Path) -> str:
    """Page of a discovery.

    Args:
        found: the discovery.
        figures: of it; of those without a picture the page shows the caption.
        origin: of the records.
        folder: where its files will lie.
    """
    open_ended = found.verdict == "ambiguous" and not discovery_text.is_open(found)
    localised = discovery_text.subject(found)
    lead = [("lead", [discovery_text.sentence(found)]), ("changed", discovery_text.whereabouts(found))]
    lead.append(("card", [*filter(None, (discovery_text.beside(found), discovery_text.intervals(found)))]))
    return html.render(
        "discovery",
        names={*found.twin.sensors, *found.twin.actuators, *found.twin.model.coordinates, *found.rig.names},
        title=TITLES["named" if open_ended else found.verdict],
        lead=[(kind, f"{'. '.join(said)}.") for kind, said in lead if any(said)],
        tiles=list(_tiles(found)),
        causes=list(_causes(found)),
        remedies=[
            (name, f"{meaning} Usual causes: {cause}." if cause else meaning, f"{remedy}." if remedy else "")
            for name, meaning, cause, remedy in discovery_text.remedies(found)
        ],
        figures=figures,
        gaps=list(_gaps(found)),
        places=list(_places(localised)),
        sides=_sides(localised),
        whiteness=list(_whiteness(found)),
        doubted=f"{DOUBTED:g}",
        tried=[
            (discovery_text.labelled(found, effect, at), percent(part, 3), _paid(paid))
            for effect, at, part, paid in discovery_figures.tried(found)[:MOST_TRIED]
        ],
        rivals=_rivals(found),
        parameters=list(_parameters(found)),
        origin=_provenance(found, origin, folder),
    )


def _tiles(found: Discovery) -> Iterator[Tile]:
    for one in found.effects[:3] if found.verdict != "unknown" else ():
        sure = discovery_text.likely(found, one)[discovery_text.spoken(found, one.name, one.on)]
        probability = percent(sure) if sure > LEAST_SURE else f"< {percent(LEAST_SURE)}"
        yield Tile(discovery_text.labelled(found, one.name, one.on), probability, "probability")
    errors, worst = found.simulation_error, discovery_text.worst(found)
    floor = errors.validation_noise_floor
    after = errors.validation[1] if found.law is None else found.law.error[1]
    if found.effects or found.law:
        before, how = discovery_text.without(found)
        label = f"error in {worst} {'as declared' if how == 'as declared' else 'without it'}"
        yield Tile(label, percent(before[worst]), "validation")
    label = f"error in {worst}" + " with it" * bool(found.effects or found.law)
    most = noise_threshold(len(found.validation_record), found.problem.rules)
    yield Tile(label, percent(after[worst]), f"noise {percent(floor[worst])}", after[worst] > most * floor[worst])


def _causes(found: Discovery) -> Iterator[tuple[str, ...]]:
    """Yield each parameter of each cause: cause, parameter, value, meaning."""
    for one in discovery_text.offered(found):
        units = discovery_text.units(found, one)
        for name, (value, std) in one.parameters.items():
            effect = found.twin.dictionary.get(one.name)
            if effect is None:
                meaning = f"declared {number(float(found.rig.start[found.rig.names.index(name)]), 5)}"
            else:
                meaning = effect.parameters[name].meaning if name in effect.parameters else effect.spoken
            label = discovery_text.labelled(found, one.name, one.on)
            yield label, name, with_deviation(value, std, units.get(name, "")), meaning


def _gaps(found: Discovery) -> Iterator[tuple[str, ...]]:
    """Yield the errors of each sensor on each record."""
    share, sides = latent_force.energies(found), discovery_figures.errors(found)
    for name in found.twin.sensors:
        part_of = percent(share[name]) if sum(share.values()) else ""
        yield name, "fitted", *(percent(part[name]) for part in sides["record"]), part_of
        yield name, "validation", *(percent(part[name]) for part in sides["validation record"]), ""


def _places(latent: LatentForces) -> Iterator[tuple[str, ...]]:
    """Yield the force at each place: its share, what it follows, the power that it takes out, and where it sits."""
    seen = [place for place in latent.places if place.share > LEAST]
    for place in sorted(seen, key=lambda place: -place.explained):
        parts, force = place.decomposition.parts, place.decomposition
        energy, odd, at = [""] * 4, "", ""
        if parts is not None:
            energy = [percent(part) for part in (parts.displacement, parts.rate, parts.both, parts.neither)]
            odd = "" if parts.odd is None else percent(parts.odd)
            regions = place_text.regions(place)
            at = listed(regions) if regions else ""
        size = place_text.loss(place) or f"{percent(abs(force.taken))} of the most"
        loss = f"{'-' if force.loss < 0.0 else ''}{size}" if abs(force.taken) > LITTLE else "little"
        yield place.name, percent(place.share), *energy, odd, loss, at


def _sides(latent: LatentForces) -> str:
    """Say how much functions of commands and readings would explain, and which harmonics the force has."""
    said = ""
    for what, those, of in (
        ("command", latent.actuators, "the model error"),
        ("reading", latent.sensors, "its residual"),
    ):
        if those:
            each = listed([f"{percent(part)} ({name})" for name, part in those.items()])
            said += f"A function of a {what} would explain {each} of {of}. "
    harmonics = latent.best.harmonics
    if harmonics is not None and harmonics.only_odd:
        said += (
            f"The commands repeat themselves with odd multiples of {harmonics.base:.4g} Hz only; of the force at "
            f"{latent.best.name}, {percent(harmonics.even)} is at even multiples and "
            f"{percent(harmonics.odd)} at odd ones that were not excited."
        )
    return said


def _whiteness(found: Discovery) -> Iterator[tuple[str, ...]]:
    """Yield whether the residuals of each sensor are white, before and after."""
    for name, pair in found.localisation.whiteness.items():
        for what, one in zip(("adjusted", "with the finding"), pair, strict=True):
            if one is not None:
                yield name, what, place_text.white(one), _probability(one.p), percent(one.beyond)


def _probability(p: float) -> str:
    return f"{p:.3f}" if p > 5e-4 else "< 0.001"


def _rivals(found: Discovery) -> list[tuple[str, str, str, str]]:
    """Explanations that were fitted in full: explanation, probability, worse by, values."""
    rivals, tempering = found.rivals, found.tempering
    if len(rivals) < 2 or not found.effects:
        return []
    rows: dict[str, tuple[float, str, str]] = {}
    sure = map(float, probabilities([rival.score(tempering) for rival in rivals]))
    for rival, probability in zip(rivals, sure, strict=True):
        first, *more = rival.names
        causes = " and ".join(
            [discovery_text.labelled(found, *first), *(discovery_text.spoken(found, *name) for name in more)]
        )
        if causes in rows:  # a delay of the only actuator is that of all of them
            rows[causes] = (rows[causes][0] + probability, *rows[causes][1:])
            continue
        deviations = iter(np.sqrt(tempering) * rival.hypothesis.deviations[len(found.rig.start) :])
        values = [
            f"{name} = {with_deviation(instance.values[i], float(next(deviations)), '')}"
            for instance in rival.hypothesis.instances
            for name, i in zip(instance.names, instance.free, strict=True)
        ]
        rows[causes] = probability, number(rival.score(tempering) - rivals[0].score(tempering), 4), ", ".join(values)
    none = found.none_of_these
    every = [(causes, _probability((1.0 - none) * p), worse, values) for causes, (p, worse, values) in rows.items()]
    return [*every, ("None of these", _probability(none), "", "")]


def _signed(part: float) -> str:
    return f"{'-' if part < 0.0 else '+'}{number(100.0 * abs(part), 2)} %"


def _paid(part: float) -> str:
    most = discovery_figures.MOST_PAID
    return percent(part, 3) if 100.0 * part <= most else f"> {most:.0f} %"


def _parameters(found: Discovery) -> Iterator[tuple[str, ...]]:
    """Yield the model's parameters as declared and as found beside the causes."""
    known = found.written_rig.twin.base.parameters
    for name, value, std, declared in discovery_files.refitted(found):
        change = _signed(value / declared - 1.0) if declared else ""
        estimate = with_deviation(value, std, "")
        yield name, number(declared, 6), estimate, change, pretty(known[name].unit), known[name].meaning


def _provenance(found: Discovery, origin: Origin, folder: Path) -> list[tuple[str, object]]:
    files = discovery_files.paths(found, folder)
    record, validation = found.record, found.validation_record
    return [
        *((what, f"{path}, SHA-256 {sha}") for what, (path, sha) in origin.records.items()),
        ("samples", f"{len(record)} to find, {len(validation)} to validate, {record.rate:g} Hz"),
        ("rig", found.twin.declaration.name),
        ("model", ", ".join(found.twin.base.files) or found.twin.declaration.model),
        *(("own effects", file) for one in found.twin.declaration.dictionaries for file in one.files),
        ("written", ", ".join(str(p) for p in (files.model, files.plant, files.numbers) if p)),
        ("versions", html.versions("masking", "numpy", "numba")),
    ]


def summary(found: Discovery, files: Files | None) -> str:
    """Say in a few lines for the terminal what was found, and what was written."""
    lines = [f"{discovery_text.sentence(found)}."]
    if discovery_text.beside(found):
        lines.append(f"{discovery_text.beside(found)}.")
    further = (discovery_text.sureness(found), *discovery_text.whereabouts(found), discovery_text.intervals(found))
    lines += [f"{sentence}." for sentence in further if sentence]
    table = [("validation error", *found.twin.sensors)]
    what = ("as declared", "adjusted parameters", "with the finding", "noise floor")
    for label, part in zip(what, discovery_figures.errors(found)["validation record"], strict=True):
        if found.effects or found.law or label != "with the finding":
            table.append((label, *(percent(part[name]) for name in found.twin.sensors)))
    lines += aligned(table)
    for name in dict.fromkeys(one.name for one in discovery_text.offered(found)):
        effect = found.twin.dictionary.get(name)
        if effect is not None and (effect.cause or effect.remedy):
            advice = [effect.cause or effect.meaning, *([f"what helps: {effect.remedy}"] if effect.remedy else [])]
            lines.append(f"{effect.spoken}: {'; '.join(advice)}")
    if files is not None:
        written = [str(path) for path in (files.model, files.plant, files.numbers) if path]
        lines += [f"written: {', '.join(written)}", f"page: {files.page}"]
    return "\n".join(lines)
