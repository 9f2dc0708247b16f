"""Report of a calibration: one self-contained HTML page with its figures beside it.

Source of the numbers of the document that are set beside a calibration's: Rijlaarsdam (2008), Tables 4.3 and 4.5.
"""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import lazy_loader as lazy
import numpy as np

from masking.errors import RecordError
from masking.procedures.calibration_findings import ALIKE, NAMES, PAGE, Calibration, Stage, reached
from masking.reports import html
from masking.reports.run_text import number

if TYPE_CHECKING:
    from masking.reports import calibration_figures, style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)
    calibration_figures = lazy.load("masking.reports.calibration_figures", suppress_warning=True)

_LACKS = 1.5  # times the noise: an error from here on is told as something that the model lacks
_MISSED = 1e-4  # of the samples of a record, from which on it is told that some were missed
_FAR = 3.0  # deviations by which a value is told to differ from the plant file's
_STRONG = 0.95  # correlation from which a pair of parameters is told
_PAIRS = 5  # of them, at most
# The real rig, by its linear model: multisine and steps (Table 4.3), free motion of the coupled system (Table 4.5).
_DOCUMENT: Final = (
    ("Table 4.3", "multisine", ("0.0649", "0.1025", "0.2267")),
    ("", "steps", ("0.0666", "0.0628", "0.2796")),
    ("Table 4.5", "free motion", ("0.0545", "0.1307", "0.0869")),
)
_AUTHOR = "Rijlaarsdam"
_LIBRARIES = ("masking", "numpy", "scipy", "numba", "sympy")


def write(found: Calibration) -> tuple[Path, ...]:
    """Write the page and its figures into the calibration's folder; return their paths, the page first.

    Raises:
        RecordError: the folder cannot be written.
    """
    plates = calibration_figures.plates(found)
    images = {plate.name: style.png(plate) for plate in plates if plate.figure is not None}
    text = _page(found, plates, images)
    try:
        found.folder.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            (found.folder / f"{name}.png").write_bytes(image)
        (found.folder / PAGE).write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{found.folder}: the report cannot be written: {error.strerror or error}") from error
    return (found.folder / PAGE, *(found.folder / f"{name}.png" for name in images))


def sentence(found: Calibration) -> str:
    """Say what happened."""
    chi, floor = found.best.fit.validation, found.unseen_floor
    errors, noise = (_listed([_percent(part) for part in parts.values()]) for parts in (chi, floor))
    reads = "reads" if len(chi) == 1 else "read"
    return (
        f"{_spoken(found.best)} reproduces an unseen multisine to {errors} of what {_listed(list(chi))} {reads}; the "
        f"noise alone makes {noise}."
    )


def _page(found: Calibration, plates: Sequence[style.Plate], images: dict[str, bytes]) -> str:
    symbols = {*found.twin.sensors, *found.twin.actuators, *found.best.fit.names, *found.twin.model.coordinates}
    tables = {"unseen": _chi(found, symbols), "excitation": _use(found, symbols)}
    sections, notes = [], []
    for plate in plates:
        if plate.name == "springs":
            sections.append(html.section("Parameters", _parameters(found, symbols)))
        if plate.figure is None:
            notes.append(f"{plate.title}. {plate.caption}")
            continue
        body = html.picture(plate.title, plate.caption, images[plate.name], symbols)
        sections.append(html.section(plate.title, body + tables.get(plate.name, "")))
    if notes:
        items = "".join(f"<li>{html.prose(note, symbols)}</li>" for note in notes)
        sections.append(html.section("Notes", f'<ul class="missing">{items}</ul>'))
    written = [PAGE, *(f"{name}.png" for name in images)]
    sections.append(html.section("Provenance", _provenance(found, written)))
    lead = [html.paragraph(sentence(found), "lead", symbols)]
    lead += [html.paragraph(text, "card", symbols) for text in _cautions(found)]
    name = f"Calibration: {found.twin.declaration.name}"
    return html.document(name, "\n".join(lead), _tiles(found, symbols), sections)


def _cautions(found: Calibration) -> list[str]:
    """Say what makes the result less than it could be; nothing where all is well."""
    fit = found.best.fit
    far = [name for name, chi in fit.validation.items() if chi > _LACKS * found.unseen_floor[name]]
    told = []
    if far:
        times = _listed([f"{fit.validation[name] / found.unseen_floor[name]:.2g}" for name in far])
        told.append(
            f"In {_listed(far)} the error is {times} times that of the noise: the rig does something that the model "
            "lacks. The spectrum of what is left shows where; an effect in the plant file, or another --model, may "
            "be it."
        )
    missed = found.records.missed
    if max(missed.values()) > _MISSED * len(found.records.fit):
        counts = ", ".join(f"{count} in {name}" for name, count in missed.items())
        told.append(
            f"Samples were missed ({counts}) and are interpolated: errors and noise are larger than the rig's own. A "
            "computer with less else to do misses fewer."
        )
    told += [f"{note[0].upper()}{note[1:]}." for note in fit.notes]
    return told


def _tiles(found: Calibration, symbols: set[str]) -> list[str]:
    fit = found.best.fit
    tiles = [
        html.tile(
            f"error in {name}, unseen",
            _percent(chi),
            f"noise {_percent(found.unseen_floor[name])}",
            is_wrong=chi > _LACKS * found.unseen_floor[name],
            names=symbols,
        )
        for name, chi in list(fit.validation.items())[:3]
    ]
    return [*tiles, html.tile("fitted", str(len(fit.names)), "parameters")]


def _chi(found: Calibration, symbols: set[str]) -> str:
    """Tabulate the errors in the form of Tables 4.3 and 4.5, and the document's own in the same columns."""
    names = list(found.floor)
    rows = []
    for stage in found.stages:
        told = f"{_spoken(stage)}, {len(stage.fit.names)} parameters" + ": written" * (stage is found.best)
        rows += [
            [told, "fitted", *(_digits(chi) for chi in stage.fit.chi.values())],
            ["", "unseen", *(_digits(chi) for chi in stage.fit.validation.values())],
        ]
    rows.append(["noise alone", "fitted", *(_digits(chi) for chi in found.floor.values())])
    rows.append(["", "unseen", *(_digits(chi) for chi in found.unseen_floor.values())])
    words = (
        "chi = ||measured - simulated|| / ||measured|| (4.12), by sensor. The model that is written is the simplest "
        f"whose largest error in the unseen record is within {100.0 * ALIKE:g} % of the least."
    )
    if _AUTHOR in (found.twin.declaration.source or "") and len(names) == len(_DOCUMENT[0][2]):
        rows += [[f"the document, {table}" if table else "", what, *chi] for table, what, chi in _DOCUMENT]
        words += (
            " The document's own numbers are of the real rig, of other records with other amplitudes, and of its "
            "linear model: oscillator 1, oscillator 2 and the beam."
        )
    head = ["model", "record", *names]
    return html.table(head, rows, range(2, len(head)), symbols) + html.paragraph(words, "missing", symbols)


def _parameters(found: Calibration, symbols: set[str]) -> str:
    """Tabulate values and deviations beside what the plant file said, and what must be known to trust them."""
    fit = found.best.fit
    declared, model = found.twin, fit.twin.model.declaration.parameters
    rows, strays = [], 0
    for name, value, std in zip(fit.names, fit.values, fit.std, strict=True):
        entry = model.get(name)
        known = name in declared.parameter_names
        before = declared.parameter_value(name) if known else _start(found, name)
        part = f"{100.0 * (value / before - 1.0):+.2g} %" if np.isfinite(before) and before else ""
        by = abs(value - before) / std if std > 0.0 else np.nan
        strays += bool(by > _FAR)
        numbers = [*_with_deviation(value, std), _plain(before) + "*" * (not known), part, _plain(by, 2)]
        unit, meaning = (entry.unit, entry.meaning) if entry else ("", "")
        rows.append([name, *map(_minus, numbers), "" if unit == "1" else unit.replace("**2", "²"), meaning])
    head = ["parameter", "value", "std", "plant file", "difference", "in std", "unit", "meaning"]
    made = html.table(head, rows, range(1, 6), symbols)
    words = [f"{strays} of {len(rows)} values differ from the plant file's by more than {_FAR:g} of their deviations."]
    if any(row[3].endswith("*") for row in rows):
        words.append("* is said by the model that was fitted; the plant file has no such parameter.")
    fitted = {effect.path for effect in fit.twin.effects}
    lacking = {
        effect.kind
        for effect in declared.effects
        if effect.enabled and effect.entry.where == "element" and effect.path not in fitted
    }
    if lacking:
        kinds = _listed(sorted(lacking)).replace("_", " ")
        words.append(f"What the plant file declares as {kinds} is in the values: the fitted model does not name it.")
    made += html.paragraph(" ".join(words), "missing", symbols)
    items = [*fit.notes, *_pairs(found)]
    listed = "".join(f"<li>{html.prose(item, symbols)}</li>" for item in items)
    return made + (f'<ul class="missing">{listed}</ul>' if items else "")


def _start(found: Calibration, name: str) -> float:
    """Return what the fitted model says of a parameter that the plant's own has not."""
    declared = found.best.fit.twin.base.parameters.get(name)
    value = None if declared is None else declared.value
    return float(value) if isinstance(value, int | float) else np.nan


def _pairs(found: Calibration) -> list[str]:
    """Name the parameters that are told apart worst."""
    fit = found.best.fit
    correlation = np.tril(fit.correlation, -1)
    order = np.argsort(-np.abs(correlation), axis=None)[:_PAIRS]
    strong = [(i, j) for i, j in zip(*np.unravel_index(order, correlation.shape), strict=True)]
    told = [f"{fit.names[j]} and {fit.names[i]} {correlation[i, j]:.3f}" for i, j in strong
            if abs(correlation[i, j]) > _STRONG]  # fmt: skip
    more = int((np.abs(correlation) > _STRONG).sum()) - len(told)
    rest = f", and {more} more pairs" if more > 0 else ""
    return [f"Correlations above {_STRONG:g}: {', '.join(told)}{rest}; these are known better together than by "
            "themselves."] if told else []  # fmt: skip


def _use(found: Calibration, symbols: set[str]) -> str:
    """Tabulate how much of the limits was used."""
    ports = found.twin.declaration.actuators or found.twin.base.inputs
    rows = [
        [
            each.name,
            ports[each.name].meaning,
            f"{each.peak:.3g} {each.unit}",
            f"{each.limit:.3g} {each.unit}",
            _percent(each.peak / each.limit),
            f"{each.peak / each.rms:.2f}",
            f"{len(each.lines)}, {each.lines.min():.2f} to {each.lines.max():.2f} Hz",
        ]
        for each in found.excited
    ]
    head = ["actuator", "meaning", "peak", "limit", "used", "crest factor", "lines"]
    made = html.table(head, rows, range(2, 6), symbols)
    far_and_limit = reached(found.twin, found.records.fit)
    if not far_and_limit:
        return made
    limits = found.twin.declaration.limits.coordinates
    units = {what.text: (limit.unit, found.twin.size(limit.unit)) for what, limit in limits.items()}
    rows = [
        [what, *(f"{x / units[what][1]:.3g} {units[what][0]}" for x in (far, most)), _percent(far / most)]
        for what, (far, most) in far_and_limit.items()
    ]
    return made + html.table(["coordinate", "reached", "limit", "used"], rows, range(1, 4), symbols)


def _provenance(found: Calibration, written: Sequence[str]) -> str:
    twin, record = found.twin.declaration, found.records.fit
    every = f"{len(record) / record.rate:g} s at {record.rate:g} Hz each"
    return html.provenance(
        [
            ("rig", twin.name),
            ("plant file", ", ".join(map(str, twin.files))),
            ("model files", ", ".join(map(str, found.best.fit.twin.base.files))),
            ("records", f"{', '.join(NAMES)}; {every}, in {found.folder / 'records'}"),
            ("missed samples", ", ".join(f"{name}: {count}" for name, count in found.records.missed.items())),
            ("written", ", ".join(["model.yaml", "plant.yaml", "fit.json", "calibration.json", *written])),
            ("rounds of the fits", ", ".join(f"{stage.name}: {stage.fit.rounds}" for stage in found.stages)),
            ("versions", ", ".join([f"python {platform.python_version()}", *map(_version, _LIBRARIES)])),
        ]
    )


def _version(library: str) -> str:
    return f"{library} {importlib.metadata.version(library)}"


# ---- words


def _spoken(stage: Stage) -> str:
    """Name a stage so that it can begin a sentence."""
    model = Path(stage.fit.twin.declaration.model).stem
    if not stage.name.startswith("with "):
        return model
    return f"{model} with {_listed(stage.name.removeprefix('with ').split(', '))}".replace("_friction", " friction")


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _percent(part: float) -> str:
    return f"{100.0 * part:.2g}\N{NO-BREAK SPACE}%"


def _digits(chi: float) -> str:
    return f"{chi:.4f}" if chi >= 0.01 else f"{chi:.5f}"


def _with_deviation(value: float, std: float) -> tuple[str, str]:
    """Write a value with as many digits as its deviation tells, and the deviation with two."""
    if not (np.isfinite(std) and std > 0.0):
        return _plain(value), ""
    digits = max(0, int(np.floor(np.log10(max(abs(value), std)))) - int(np.floor(np.log10(std)))) + 2
    return number(value, digits) if abs(value) < 1e-4 else f"{value:#.{digits}g}".rstrip("."), number(std, 2)


def _plain(value: float, digits: int = 5) -> str:
    return number(value, digits) if np.isfinite(value) else ""


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}") if "e-" not in text else text
