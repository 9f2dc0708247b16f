"""Report: a recording told in one self-contained HTML page with its figures, and in a few lines for the terminal."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Final

import lazy_loader as lazy
import numpy as np

from masking.errors import RecordError
from masking.recording import MANIFEST, TABLE, Recording
from masking.study import (
    InputUse,
    Parameter,
    PhasePair,
    Study,
    fidelities,
    input_uses,
    parameters,
    percent,
    study,
)

if TYPE_CHECKING:
    from masking import figures
else:
    figures = lazy.load("masking.figures", suppress_warning=True)

PAGE: Final = "report.html"
_TEMPLATE = Path(__file__).with_name("report_template.html")
_SUMMARY_LINES = 14
_TRUE, _ROUGH = 0.01, 0.3  # chi up to which the rig moved as, or roughly as, the virtual system
_SOURCE = "Rijlaarsdam (2008)"
_OWNED = frozenset({"the", "a", "an", "my", "our", "your", "his", "her", "its", "their", "this", "that"})
_WORDY = frozenset({"meaning", "measure", "value"})  # columns of words, which may run over several lines
_MUCH = 1.1  # times its limit: from here on an input is told in multiples, below in percent
_NEAR = 0.1  # of pi: how near to 0 or pi counts as in-phase or anti-phase
_GREEK = {"chi": "<var>&chi;</var>", "pi": "&pi;", "alpha": "<var>&alpha;</var>", "eps": "<var>&epsilon;</var>"}
_NO_PHASE = "no fixed phase"
_STEADY = 0.7  # length of the mean unit vector below which a phase is not locked


@dataclass(frozen=True, slots=True)
class Report:
    """What was written: the page, its figures as separate PNG files, and the summary for the terminal."""

    path: Path
    figures: tuple[Path, ...]
    summary: str


def report(recording: Recording, folder: str | Path) -> Report:
    """Write `report.html`, which needs no other file, and its figures as PNG files into `folder`, made if need be."""
    folder, facts = Path(folder), study(recording)
    plates = figures.plates(facts)
    images = {plate.name: _png(plate) for plate in plates if plate.figure is not None}
    page = _page(facts, plates, images, folder)
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            written.append(folder / f"{name}.png")
            written[-1].write_bytes(image)
        (folder / PAGE).write_text(page, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{folder}: the report cannot be written: {error.strerror or error}") from error
    return Report(folder / PAGE, tuple(written), _summary(facts))


def summary(recording: Recording) -> str:
    """Tell a recording in at most fourteen lines of plain text."""
    return _summary(study(recording))


def warnings(recording: Recording) -> list[str]:
    """Say in plain sentences what makes the result not hold as it stands; nothing where all is well."""
    return _warnings(recording, input_uses(recording), fidelities(recording))


def limits_used(recording: Recording) -> dict[str, float]:
    """Give the part of its limit that each input used at its peak; inputs without a limit are left out."""
    return {use.name: use.used for use in input_uses(recording) if use.used is not None}


# ---- words


def _warnings(recording: Recording, uses: Iterable[InputUse], chi: Mapping[str, float]) -> list[str]:
    manifest, found = recording.manifest, []
    exceeded = _exceeded(uses)
    if exceeded:
        found.append(exceeded)
    rate = manifest.get("rate")
    if manifest.get("mode") == "sampled" and rate and any(part > _TRUE for part in chi.values()):
        late = 0.5 / float(rate)
        late_words = f"{_number(late)} s" if late >= 1.0 else f"{_number(1e3 * late)} ms"
        found.append(
            f"Sampled at {_rate(rate)}, inputs act half a sample ({late_words}) late on average; 'rate: continuous' "
            "shows the error that is not due to sampling, and a higher controller.rate lowers it."
        )
    return found


def _exceeded(uses: Iterable[InputUse]) -> str:
    """Say which inputs went beyond their limits; nothing where none did."""
    told = []
    for use in uses:
        if use.is_exceeded and use.used is not None:
            peak, limit = (f"{_number(value)} {use.unit}".rstrip() for value in (use.peak, use.limit))
            over = f"{_number(use.used)} times" if use.used >= _MUCH else f"{percent(use.used - 1)} above"
            told.append(f"{use.name} needs {peak}, {over} its limit of {limit}")
    return f"Not possible on this rig: {'; '.join(told)}." if told else ""


def _rig(name: str) -> str:
    """Put an article before a plant's name, where the name does not bring its own."""
    first = name.lower().partition(" ")[0]
    name = name if first in _OWNED or first.endswith(("'s", "\u2019s")) else f"the {name}"
    return name[0].upper() + name[1:]


def _headline(facts: Study) -> list[str]:
    """Sentences that say what happened; what is beyond a limit would happen."""
    manifest = facts.recording.manifest
    plant = _rig(str(manifest.get("plant_name") or "").strip() or "rig")
    possible = not _exceeded(facts.inputs)
    virtual = str(manifest.get("virtual_name") or "its virtual system")
    length = f"over {_duration(facts)}"
    worst = facts.worst
    still = bool(facts.coordinates) and not any(np.any(facts.motion(name)) for name in facts.coordinates)
    if still and not any(facts.chi.values()):
        return [f"{plant} stood still {length}."]
    if worst is None:
        sentences = [f"{plant} was recorded {length}."]
    else:
        chi = facts.chi[worst]
        size = f"= {_number(chi, 2)}" if len(facts.chi) == 1 or chi == 0 else f"<= {_number(chi, 2)} in each coordinate"
        how = "as" if chi <= _TRUE else "roughly as"
        verb = f"moved {how}" if possible else f"would move {how}"
        if not chi <= _ROUGH:
            verb = "did not move as" if possible else "would not move as"
        sentences = [f"{plant} {verb} {virtual}: fidelity chi {size} {length}."]
    if still:
        sentences.append("Nothing moved.")
    sentences += [_phase_sentence(pair) for pair in facts.pairs[:1]]
    if len(facts.oscillators) > 2 and facts.sum_peak is not None:
        start, end = facts.sum_ends
        sentences.append(f"The peak of {_sum_name(facts)} went from {_number(start)} to {_number(end)}.")
    return sentences


def _phase_sentence(pair: PhasePair) -> str:
    who = f"{pair.first} and {pair.second}"
    start, end = _state(pair.start, pair.steady_start), _state(pair.end, pair.steady_end)
    if start == end and "pi" in end:
        return f"{who} stayed {end}."
    if start == end == _NO_PHASE:
        return f"{who} kept {_NO_PHASE}."
    if start == end:
        return f"{who} stayed {'in ' * (end == 'anti-phase')}{end} (from {_pi(pair.start)} to {_pi(pair.end)})."
    where = {"in-phase", "anti-phase"}
    told = [s if s not in where else f"{s} ({_pi(p)})" for s, p in ((start, pair.start), (end, pair.end))]
    return f"{who} went from {told[0]} to {told[1]}."


def _state(phase: float, steady: float) -> str:
    if steady < _STEADY:
        return _NO_PHASE
    if phase <= _NEAR * math.pi:
        return "in-phase"
    return "anti-phase" if phase >= (1 - _NEAR) * math.pi else f"{_pi(phase)} apart"


def _summary(facts: Study) -> str:
    manifest = facts.recording.manifest
    rows: list[tuple[str, str]] = []
    changed = [_change(p) for p in parameters(facts.recording) if p.is_changed]
    if changed:
        rows.append(("changed", ", ".join(changed)))
    if facts.chi:
        rows.append(("fidelity", "  ".join(f"{name} {_number(chi, 2)}" for name, chi in facts.chi.items())))
    if facts.anti_phase is not None and facts.anti_phase.alpha > 0:
        fit = facts.anti_phase
        rows.append(("anti-phase", f"alpha = {fit.alpha:.4f}, eps = {_number(fit.eps)} over the last fifth"))
    if facts.sum_peak is not None:
        start, end = facts.sum_ends
        rows.append(("peak sum", f"{_sum_name(facts)} from {_number(start)} to {_number(end)}"))
    elif len(facts.oscillators) > 1:
        rows.append(("phase", f"not given: {facts.no_phase}"))
    if facts.inputs:
        rows.append(("inputs", "  ".join(_use_words(use) for use in facts.inputs)))
    energy = manifest.get("energy") or {}
    if "virtual" in energy:
        rows.append(("energy", f"drift of the virtual system {_number(energy['virtual'])}"))
    rows.append(("record", _record_words(facts)))
    if manifest.get("timing"):
        rows.append(("time", "  ".join(_timing(manifest))))
    first, *more = _headline(facts)
    said = [first, *_warnings(facts.recording, facts.inputs, facts.chi), *more]
    lines = said + [f"  {name:<11}{_short(text)}" for name, text in rows]
    return "\n".join(lines[:_SUMMARY_LINES])


def _timing(manifest: Mapping[str, Any]) -> list[str]:
    """Say how long each stage took, compilation first."""
    stages = dict(manifest.get("timing") or {})
    ordered = sorted(stages, key=lambda stage: stage != "compilation")
    return [f"{stage} {_number(stages[stage])} s" for stage in ordered]


def _change(parameter: Parameter) -> str:
    return f"{parameter.name} = {_number(parameter.value, 7)} {parameter.unit}".rstrip()


def _declared(parameter: Parameter) -> str:
    """Say in brackets what was declared, where that is not what the value shows."""
    if parameter.is_changed:
        return f" (declared {_number(parameter.declared, 7)})"
    is_computed = isinstance(parameter.declared, str) and isinstance(parameter.value, float)
    return f" (= {parameter.declared})" if is_computed else ""


def _record_words(facts: Study) -> str:
    manifest, t = facts.recording.manifest, facts.recording.t
    unit = facts.unit("t")
    words = f"{len(t)} samples, {_number(t[-1] - t[0])} {unit}".rstrip() + " of the rig"
    if manifest.get("rate"):
        words += f", {manifest.get('mode') or 'sampled'} at {_rate(manifest['rate'])}"
    elif manifest.get("mode"):
        words += f", {manifest['mode']}"
    return words + (f", seed {manifest['seed']}" if manifest.get("seed") is not None else "")


def _use_words(use: InputUse) -> str:
    if use.used is None:
        return f"{use.name} peak {_number(use.peak)} {use.unit}".rstrip()
    return f"{use.name} {percent(use.used)} of {use.limit:g} {use.unit}".rstrip()


def _sum_name(facts: Study) -> str:
    names = facts.oscillators
    return f"|{' + '.join(names if len(names) <= 3 else (names[0], '...', names[-1]))}|"


def _duration(facts: Study) -> str:
    return " ".join(_length(facts))


def _length(facts: Study) -> tuple[str, str]:
    """Give the length of the record and its unit."""
    unit = "units of time" if facts.recording.manifest.get("time_scale") else facts.unit("t")
    return _number(facts.tau[-1] - facts.tau[0], 6), unit or "units of time"


def _rate(rate: Any) -> str:  # noqa: ANN401  # a number of the manifest
    return f"{_number(float(rate) / 1e3)} kHz" if float(rate) >= 1e3 else f"{_number(rate)} Hz"


def _number(value: Any, digits: int = 3) -> str:  # noqa: ANN401  # a number, or one that JSON keeps as text ("inf")
    try:
        text = f"{float(value):.{digits}g}"
    except (TypeError, ValueError):
        return str(value)
    mantissa, e, exponent = text.partition("e")
    if e and 0 <= int(exponent) < 7:  # 2.5e+03 reads better as 2500
        return f"{float(text):.0f}"
    return f"{mantissa}e{int(exponent)}" if e else text


def _pi(phase: float) -> str:
    return f"{phase / math.pi:.3f} pi"


def _short(text: str, most: int = 100) -> str:
    return text if len(text) <= most else text[: most - 3].rstrip() + "..."


# ---- the page


def _png(plate: figures.Plate) -> bytes:
    stream = io.BytesIO()
    if plate.figure is not None:
        plate.figure.savefig(stream, format="png", metadata={"Title": plate.title})
    return stream.getvalue()


def _page(facts: Study, plates: Sequence[figures.Plate], images: Mapping[str, bytes], folder: Path) -> str:
    name = str(facts.recording.manifest.get("name") or "Recording")
    tables = {"synchronisation": _phase_table, "inputs": _input_table, "fidelity": _fidelity_table}
    sections, notes = [], list(facts.recording.notes)
    for plate in plates:
        table = tables[plate.name](facts) if plate.name in tables else ""
        if plate.figure is None and not table:
            notes.append(f"{plate.title}. {plate.caption}")
        else:
            sections.append(_section(plate.title, _figure(facts, plate, images.get(plate.name)) + table))
    found = parameters(facts.recording)
    if found:
        sections.append(_section("Parameters of the virtual system", _parameters(facts, found)))
    else:
        notes.append("Parameters. Not shown: the record does not carry those of a virtual system.")
    if notes:
        items = "".join(f"<li>{_prose(facts, note)}</li>" for note in notes)
        sections.append(_section("Notes", f'<ul class="missing">{items}</ul>'))
    sections.append(_section("Provenance", _provenance(facts, [*(f"{image}.png" for image in images), PAGE], folder)))
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=html.escape(name),
        heading=html.escape(name[0].upper() + name[1:]),
        lead=_lead(facts, [parameter for parameter in found if parameter.is_changed]),
        tiles="\n".join(_tiles(facts)),
        sections="\n".join(sections),
    )


def _lead(facts: Study, changed: Sequence[Parameter]) -> str:
    """Say what happened, with cards for the warnings: a limit exceeded comes right after the first sentence."""
    first, *more = _headline(facts)
    limits, rest = _exceeded(facts.inputs), " ".join(more)
    found = _warnings(facts.recording, facts.inputs, facts.chi)
    parts = [("lead", first), ("card wrong", limits), ("lead", rest)] if limits else [("lead", f"{first} {rest}")]
    if changed:
        words = ", ".join(f"{_change(parameter)}{_declared(parameter)}" for parameter in changed)
        parts.append(("changed", f"Changed: {words}."))
    parts += [("card", text) for text in found if text != limits]
    return "\n".join(f'<p class="{kind}">{_prose(facts, text.strip())}</p>' for kind, text in parts if text)


def _tiles(facts: Study) -> list[str]:
    length, unit = _length(facts)
    tiles = [("recorded", length, unit, "")]
    if facts.worst is not None:
        tiles.append((f"fidelity chi, worst ({facts.worst})", _number(facts.chi[facts.worst], 2), "", ""))
    if facts.pairs:
        pair = facts.pairs[0]
        label = f"phase of {pair.first} against {pair.second}"
        tiles.append((label, _pi(pair.end), "" if pair.steady_end >= _STEADY else "not fixed", ""))
    used = [use for use in facts.inputs if use.used is not None]
    if used:
        most = max(used, key=lambda use: use.used or 0.0)
        kind = ' class="wrong"' if most.is_exceeded else ""
        tiles.append((f"largest use of a limit ({most.name})", percent(most.used), "", kind))
    return [
        f"<div{kind}><dt>{_prose(facts, label)}</dt><dd>{_prose(facts, value)}"
        + (f" <small>{_prose(facts, unit)}</small>" if unit else "")
        + "</dd></div>"
        for label, value, unit, kind in tiles
    ]


def _section(title: str, body: str) -> str:
    return f"<section>\n<h2>{html.escape(title)}</h2>\n{body}\n</section>"


def _figure(facts: Study, plate: figures.Plate, image: bytes | None) -> str:
    caption = _prose(facts, plate.caption)
    if image is None:
        return f'<p class="missing">{caption}</p>'
    data = base64.b64encode(image).decode("ascii")
    alt = html.escape(f"{plate.title}. {plate.caption}", quote=True)
    return (
        f'<figure>\n<img alt="{alt}" src="data:image/png;base64,{data}">\n<figcaption>{caption}</figcaption>\n</figure>'
    )


def _phase_table(facts: Study) -> str:
    rows = [
        (
            f"phase of {pair.first} against {pair.second}, from start to end",
            f"{_pi(pair.start)} to {_pi(pair.end)}" + ("" if pair.steady_end >= _STEADY else ", not fixed"),
        )
        for pair in facts.pairs
    ]
    if facts.sum_peak is not None:
        start, end = facts.sum_ends
        rows.append((f"peak of {_sum_name(facts)}, from start to end", f"{_number(start)} to {_number(end)}"))
    fit = facts.anti_phase
    if fit is not None:
        a, b = facts.oscillators
        held = f"|{a}(τ) - alpha {b}(τ + T/2)| <= eps over the last fifth; {_SOURCE}, definition 5.3"
        if fit.alpha > 0:
            rows.append((held, f"alpha = {fit.alpha:.4f}, eps = {_number(fit.eps)}, T = {fit.period:.5g}"))
        else:
            rows.append((held, "not in anti-phase: no alpha > 0 fits"))
    return _table(facts, ("measure", "value"), rows, numbers=()) if rows else ""


def _input_table(facts: Study) -> str:
    rows = []
    for use in facts.inputs:
        meaning = facts.recording.manifest.get("columns", {}).get(f"input.{use.name}", {}).get("meaning", "")
        limit = "none declared" if use.limit is None else f"{use.limit:g} {use.unit}".rstrip()
        peak, rms = (f"{_number(value)} {use.unit}".rstrip() for value in (use.peak, use.rms))
        rows.append((use.name, meaning, peak, rms, limit, percent(use.used)))
    head = ("input", "meaning", "peak", "rms", "limit", "used")
    return _table(facts, head, rows, numbers=(2, 3, 4, 5)) if rows else ""


def _fidelity_table(facts: Study) -> str:
    rows = []
    for name, chi in facts.chi.items():
        ideal, unit = facts.ideal(name), facts.unit(f"virtual.{name}")
        error = "" if ideal is None else _number(np.abs(facts.motion(name) - ideal).max(), 2)
        rows.append((name, facts.meaning(name), _number(chi, 3), f"{error} {unit}".strip()))
    if not rows:
        return ""
    words = f"chi = ||virtual - ideal|| / ||ideal||, the relative rms error over the record; {_SOURCE}, (4.12)."
    table = _table(facts, ("coordinate", "meaning", "chi", "largest error"), rows, numbers=(2, 3))
    return f'{table}<p class="missing">{_prose(facts, words)}</p>'


def _parameters(facts: Study, found: Sequence[Parameter]) -> str:
    """Tabulate the values that ran, in the declared units; beside them those in the virtual system's scales, if any."""
    scaled = any(parameter.scaled is not None for parameter in found)
    rows = []
    for p in found:
        in_scales = p.scaled if p.scaled is not None else p.value
        rows.append([p.name, f"{_number(p.value, 7)}{_declared(p)}", p.unit, _number(in_scales, 7), p.meaning])
    head = ["parameter", "value", "unit", "in its scales", "meaning"]
    if not scaled:
        head, rows = [text for text in head if text != "in its scales"], [row[:3] + row[4:] for row in rows]
    return _table(facts, head, rows, numbers=(1, 3) if scaled else (1,))


def _provenance(facts: Study, written: Iterable[str], folder: Path) -> str:
    manifest = facts.recording.manifest
    versions = manifest.get("versions") or {}
    rows = [
        ("plant", manifest.get("plant_name")),
        ("virtual system", manifest.get("virtual_name")),
        ("record", _record_words(facts)),
        ("time", f"{_number(manifest['time_scale'], 7)} s of the rig per unit of virtual time"
         if manifest.get("time_scale") else None),
        ("created", manifest.get("created")),
        ("commit", manifest.get("commit")),
        ("versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("time taken", ", ".join(_timing(manifest))),
        ("energy drift", ", ".join(f"{name} {_number(e)}" for name, e in (manifest.get("energy") or {}).items())),
        ("files", ", ".join([*(name for name in (TABLE, MANIFEST) if (folder / name).is_file()), *written])),
    ]  # fmt: skip
    body = "".join(
        f'<tr><th scope="row">{name}</th><td class="w">{html.escape(str(value))}</td></tr>'
        for name, value in rows
        if value
    )
    declarations = manifest.get("declarations")
    text = html.escape(json.dumps(declarations, indent=2, ensure_ascii=False, default=str))
    details = f"<details><summary>All declarations</summary><pre>{text}</pre></details>" if declarations else ""
    return f'<div class="scroll"><table><tbody>{body}</tbody></table></div>{details}'


def _table(facts: Study, head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int]) -> str:
    kinds = [' class="n"' if i in numbers else ' class="t"' if text in _WORDY else "" for i, text in enumerate(head)]
    top = "".join(f"<th{kind}>{_prose(facts, text)}</th>" for kind, text in zip(kinds, head, strict=True))
    body = "".join(
        "<tr>"
        + "".join(f"<td{k}>{_prose(facts, str(cell))}</td>" for k, cell in zip(kinds, row, strict=True))
        + "</tr>"
        for row in rows
    )
    return f'<div class="scroll" tabindex="0"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _prose(facts: Study, text: str) -> str:
    """Escape a text for the page and typeset the symbols, powers of ten and Greek letters in it."""
    names = {*facts.coordinates, *(use.name for use in facts.inputs)}

    def typeset(match: re.Match[str]) -> str:
        word = match.group()
        if word in names:
            letters, index = re.fullmatch(r"(.*?)_?(\d*)", word).groups()  # type: ignore[union-attr]  # matches any word
            letters, index = (letters, index) if letters else (word, "")
            letters = f"&{letters};" if letters in figures.GREEK else letters
            return f"<var>{letters}</var>" + (f"<sub>{index}</sub>" if index else "")
        return _GREEK.get(word, word)

    escaped = re.sub(r"(?<![&\w])[A-Za-z_]\w*", typeset, html.escape(text))
    escaped = re.sub(r"(?<=\d)e(-?)(\d+)\b", _power_of_ten, escaped)
    return escaped.replace("&lt;=", "&le;").replace(" - ", " &minus; ")


def _power_of_ten(match: re.Match[str]) -> str:
    return f" &middot; 10<sup>{'&minus;' if match[1] else ''}{match[2]}</sup>"
