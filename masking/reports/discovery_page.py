"""Page of a discovery: HTML that needs no other file, all its files, and a summary and its trace for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from masking.display.printed_result import aligned
from masking.inference.discovery import latent_force
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.explanation import in_both
from masking.inference.discovery.trace import Line
from masking.inference.discovery.verdict import noise_threshold
from masking.inference.estimation.whiteness import DOUBTED
from masking.model.declaration.quantities import number, percent, with_deviation
from masking.reports import (
    discovery_figures,
    discovery_files,
    discovery_text,
    html,
    one_page,
    place_text,
)
from masking.reports.discovery_figures import VALIDATION
from masking.reports.discovery_files import Files, Origin
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.style import CaptionedFigure
from masking.reports.text import capital, listed, probability_text

MOST_TRIED = 20
MOST_TILES = 3  # of causes
LEAST_SURE = 0.001  # probability: less is shown as less than this
LEAST = 0.01  # share of a place that is shown
TITLES = {
    "none": "Nothing is missing",
    "parameter": "A parameter is off",
    "named": "What the model is missing",
    "ambiguous": "What the model may be missing",
    "unknown": "Something unknown is missing",
}
TRACE_HEAD = ("explanation", "suggested by", "behind", "error over noise", "why not")
MOST_TRACED = 20  # hypotheses of each reading that are shown


def save(found: Discovery, folder: str | Path, origin: Origin, *, lies: Path | None = None) -> Files:
    """Draw a discovery and write all its files into a folder; see `discovery_files.save`."""
    figures = discovery_figures.figures(found)
    there = lies or Path(folder)
    text, said = page(found, figures, origin, there), sheet(found, origin, there)
    return discovery_files.save(found, folder, origin, text, figures, lies=lies, sheet=said)


def page(found: Discovery, figures: Sequence[CaptionedFigure], origin: Origin, folder: Path) -> str:
    """Page of a discovery whose files will lie in a folder; of figures without a picture it shows the caption."""
    places = (place for place in discovery_text.model_error(found).places.values() if place.share > LEAST)
    return html.render(
        "discovery",
        names={*found.twin.sensors, *found.twin.actuators, *found.twin.model.coordinates, *found.rig.names},
        title=_title(found),
        found=found,
        words=discovery_text,
        place_words=place_text,
        tiles=tiles(found),
        figures=figures,
        errors=discovery_figures.errors(found),
        energies=latent_force.energies(found),
        located=sorted(places, key=lambda place: -place.explained),
        doubted=DOUBTED,
        tried=discovery_figures.tried(found)[:MOST_TRIED],
        rivals=_rivals(found),
        trace=trace(found),
        trace_head=TRACE_HEAD,
        refitted=discovery_files.refitted(found),
        known=found.written_rig.twin.base.parameters,
        records=origin.records,
        files=discovery_files.paths(found, folder),
    )


def _rivals(found: Discovery) -> list[tuple[str, str, str, str]]:
    """Explanations that were fitted in full: explanation, probability, worse by, values."""
    rivals = found.rivals
    if len(rivals) < 2 or not found.effects:
        return []
    rows: dict[str, tuple[float, str, str]] = {}
    scores = in_both(rivals)
    for rival, score, probability in zip(rivals, scores, found.weights, strict=True):
        if not rival.names:
            rows["None"] = probability, number(score - scores[0], 4), ""
            continue
        first, *more = rival.names
        others = [discovery_text.cause_name(found, *name) for name in more]
        causes = " and ".join([discovery_text.cause_label(found, *first), *others])
        if causes in rows:  # a delay of the only actuator is that of all of them
            rows[causes] = (rows[causes][0] + probability, *rows[causes][1:])
            continue
        deviations = iter(rival.hypothesis.deviations[len(found.rig.start) :])
        values = [
            f"{name} = {with_deviation(instance.values[i], float(next(deviations)), '')}"
            for instance in rival.hypothesis.instances
            for name, i in zip(instance.names, instance.free, strict=True)
        ]
        rows[causes] = probability, number(score - scores[0], 4), ", ".join(values)
    none = found.none_of_these
    every = [(causes, probability_text((1.0 - none) * p), worse, values) for causes, (p, worse, values) in rows.items()]
    return [*every, ("None of these", probability_text(none), "", "")]


def summary(found: Discovery, files: Files | None = None) -> str:
    """Finding and files, if there are any, in a few lines for the terminal."""
    said = [discovery_text.sentence(found), discovery_text.unexplained(found), *discovery_text.weights(found)]
    said += [discovery_text.probability_sentence(found), *discovery_text.location(found)]
    lines = [f"{sentence}." for sentence in (*said, discovery_text.intervals(found)) if sentence]
    table = [("validation error", *found.twin.sensors)]
    for label, part in discovery_figures.by_model(found, VALIDATION).items():
        table.append((label, *(percent(part[name]) for name in found.twin.sensors)))
    lines += aligned(table)
    lines += advice(found)
    if files is not None:
        lines += [files.written, f"page: {files.page}"]
    return "\n".join(lines)


def sheet(found: Discovery, origin: Origin, folder: Path) -> Sheet:
    """What one page says of a discovery whose files will lie in a folder."""
    files = discovery_files.paths(found, folder)
    sure = [*discovery_text.weights(found), discovery_text.probability_sentence(found)]
    what = [discovery_text.finding(found), discovery_text.unexplained(found), discovery_text.intervals(found)]
    every = {
        one_page.FOUND: what,
        one_page.WHERE: discovery_text.location(found),
        one_page.SURE: sure,
        one_page.NEXT: discovery_text.deciding(found),
    }
    sections = {heading: [f"{text}." for text in said if text] for heading, said in every.items()}
    sections[one_page.NEXT] += [f"{capital(text)}." for text in advice(found)]
    return Sheet(
        title=_title(found),
        subject=[found.twin.declaration.name, origin.source(found), files.written],
        tiles=tiles(found),
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite(discovery_figures.by_model(found, VALIDATION)),
        errors_title=f"Simulation error, {VALIDATION}",
        page=files.page.name,
    )


def _title(found: Discovery) -> str:
    is_named = found.verdict == "ambiguous" and not discovery_text.is_open(found)
    return TITLES["named" if is_named else found.verdict]


def advice(found: Discovery) -> list[str]:
    """Usual cause of each effect that is reported, and what helps against it, where they are known."""
    lines = []
    for name in dict.fromkeys(one.name for one in discovery_text.reported(found)):
        effect = found.twin.dictionary.get(name)
        if effect is not None and (effect.cause or effect.remedy):
            said = [effect.cause or effect.meaning, *([f"what helps: {effect.remedy}"] if effect.remedy else [])]
            lines.append(f"{effect.spoken}: {'; '.join(said)}")
    return lines


def tiles(found: Discovery) -> list[Tile]:
    """Causes with their probabilities, and the error on unseen data of the worst sensor, without and with them."""
    made, name = [], discovery_text.worst_sensor(found)
    for one in found.effects[:MOST_TILES] if found.verdict != "unknown" else ():
        part = discovery_text.probabilities(found, one)[discovery_text.cause_name(found, one.name, one.on)]
        sure = percent(part) if part > LEAST_SURE else f"< {percent(LEAST_SURE)}"
        made.append(Tile(discovery_text.cause_label(found, one.name, one.on), sure, "probability"))
    has_finding = bool(found.effects or found.law)
    if has_finding:
        before, model = discovery_text.without_finding(found)
        what = f"error in {name} {'as declared' if model == 'as declared' else 'without it'}"
        made.append(Tile(what, percent(before[name]), "validation"))
    *_, after, floor = (part[name] for part in discovery_figures.errors(found)[VALIDATION])
    most = noise_threshold(len(found.validation_record), found.problem.rules)
    what = f"error in {name}{' with it' * has_finding}"
    return [*made, Tile(what, percent(after), f"noise {percent(floor)}", after > most * floor)]


def trace(found: Discovery) -> list[tuple[str, list[tuple[str, ...]]]]:
    """Each reading of the record with its hypotheses, the likeliest first; the answer and the model alone are shown."""
    made, lines = dict[str, list[tuple[str, ...]]](), [*found.problem.trace.lines()]
    answer = next((line.behind for line in lines if _is_taken(found, line)), 0.0)
    for line in lines:
        part = made.setdefault(line.tried.reading, [])
        if len(part) < MOST_TRACED or not line.tried.names or _is_taken(found, line):
            one, why = line.tried, _why(found, line, answer)
            causes = listed([discovery_text.cause_name(found, *name) for name in one.names]) or "no cause"
            part.append((causes, one.move, number(line.behind, 3), number(one.over_noise, 3), why))
    return [*made.items()]


def trace_text(found: Discovery) -> str:
    """Table for the terminal."""
    lines = list[str]()
    for reading, part in trace(found):
        lines += [f"Hypotheses in the record, {reading}:", *aligned([TRACE_HEAD, *part])]
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
