"""Report of a calibration: one self-contained HTML page with its figures beside it.

Source of the numbers of the document that are set beside a calibration's: Rijlaarsdam (2008), Tables 4.3 and 4.5.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from masking.inference.procedures.calibration_findings import ALIKE, NAMES, PAGE, Calibration, Stage, reached
from masking.model.declaration.quantities import number, percent
from masking.model.declaration.units import pretty
from masking.reports import calibration_figures, html, one_page
from masking.reports.error_panel import NOISE
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.text import capital, listed

_LACKS = 1.5  # times the noise: an error from here on is reported as something that the model lacks
_MISSED = 1e-4  # of the samples of a record, from which missed ones are reported
_FAR = 3.0  # deviations by which a value is reported to differ from the plant file's
_STRONG = 0.95  # correlation from which a pair of parameters is reported
_PAIRS = 5  # of them, at most
# The real rig, by its linear model: multisine and steps (Table 4.3), free motion of the coupled system (Table 4.5).
_DOCUMENT: Final = (
    ("the document, Table 4.3", "multisine", "0.0649", "0.1025", "0.2267"),
    ("", "steps", "0.0666", "0.0628", "0.2796"),
    ("the document, Table 4.5", "free motion", "0.0545", "0.1307", "0.0869"),
)
_AUTHOR = "Rijlaarsdam"


def save(found: Calibration) -> None:
    """Write the page and its figures into the calibration's folder; a `RecordError` says that it cannot be written."""
    twin, figures = found.twin, calibration_figures.figures(found)
    fit, rows = found.best.fit, _parameters(found)
    before = np.array([_declared(found, name) for name in fit.names])
    has_document = _AUTHOR in (twin.declaration.source or "") and len(found.floor) == len(_DOCUMENT[0]) - 2
    limits = twin.declaration.limits.coordinates
    html.save(
        found.folder / PAGE,
        "calibration",
        figures,
        names={*twin.sensors, *twin.actuators, *found.best.fit.names, *twin.model.coordinates},
        title=f"Calibration: {twin.declaration.name}",
        result=found,
        sentence=sentence(found),
        spoken=_spoken,
        cautions=_cautions(found),
        lacks=_LACKS,
        document=list(_DOCUMENT) if has_document else [],
        alike=ALIKE,
        ports=twin.declaration.actuators or twin.base.inputs,
        reached=reached(twin, found.records.fit),
        units={what.text: (limit.unit, twin.size(limit.unit)) for what, limit in limits.items()},
        parameters=rows,
        differing=0 if fit.doubt else int((np.abs(fit.values - before) > _FAR * fit.std)[fit.std > 0.0].sum()),
        far=f"{_FAR:g}",
        has_marks=any(row[3].endswith("*") for row in rows),
        lumped=_lumped(found),
        parameter_notes=[*found.best.fit.remarks, *_pairs(found)],
        remarks=[f"{one.title}. {one.caption}" for one in figures if one.figure is None],
        records=NAMES,
        written=[PAGE, *(f"{one.name}.png" for one in figures if one.figure is not None)],
    )


def sheet(found: Calibration) -> Sheet:
    """What one page says of a calibration: the errors of the simplest model, and of the one that is written."""
    best = found.best
    models = {_spoken(stage): stage.fit.validation for stage in (found.stages[0], best)}
    sections = {one_page.FOUND: [sentence(found)], one_page.LIMITS: _cautions(found)}
    return Sheet(
        title=f"Calibration: {found.twin.declaration.name}",
        subject=[", ".join(found.twin.declaration.files)],
        tiles=[Tile(f"error in {name}, unseen", percent(chi)) for name, chi in best.fit.validation.items()],
        sections={heading: said for heading, said in sections.items() if said},
        errors=one_page.finite({**models, NOISE: found.unseen_floor}),
        errors_title="Simulation error, unseen record",
        page=PAGE,
    )


def sentence(found: Calibration) -> str:
    """Errors of the best model in the unseen record, beside the noise."""
    chi, floor = found.best.fit.validation, found.unseen_floor
    errors, noise = (listed([percent(part) for part in parts.values()]) for parts in (chi, floor))
    reads = "reads" if len(chi) == 1 else "read"
    return (
        f"{_spoken(found.best)} reproduces an unseen multisine to {errors} of what {listed(list(chi))} {reads}; the "
        f"noise floor is {noise}."
    )


def _cautions(found: Calibration) -> list[str]:
    """Sentences on what makes the result less than it could be; none where all is well."""
    fit = found.best.fit
    far = [name for name, chi in fit.validation.items() if chi > _LACKS * found.unseen_floor[name]]
    sentences = []
    if far:
        times = listed([f"{fit.validation[name] / found.unseen_floor[name]:.2g}" for name in far])
        sentences.append(
            f"In {listed(far)} the error is {times} times that of the noise: the model misses something that "
            "the rig does. The spectrum of the residual shows where; add an effect to the plant file, or try another "
            "--model."
        )
    missed = found.records.missed
    if max(missed.values()) > _MISSED * len(found.records.fit):
        counts = ", ".join(f"{count} in {name}" for name, count in missed.items())
        sentences.append(
            f"Samples were missed ({counts}) and are interpolated: errors and noise are larger than the rig's own. A "
            "computer with less else to do misses fewer."
        )
    sentences += [f"{capital(note)}." for note in fit.remarks]
    return sentences


def _parameters(found: Calibration) -> list[list[str]]:
    """Values and deviations beside those of the plant file."""
    fit, rows = found.best.fit, []
    model = fit.twin.model.declaration.parameters
    for name, value, std in zip(fit.names, fit.values, 0.0 * fit.std if fit.doubt else fit.std, strict=True):
        before, entry = _declared(found, name), model.get(name)
        part = f"{100.0 * (value / before - 1.0):+.2g} %" if np.isfinite(before) and before else ""
        by = abs(value - before) / std if std > 0.0 else np.nan
        mark = "*" * (name not in found.twin.parameter_names)
        numbers = [*_with_deviation(value, std), _plain(before) + mark, part, _plain(by, 2)]
        unit, meaning = (pretty(entry.unit), entry.meaning) if entry else ("", "")
        rows.append([name, *map(_minus, numbers), unit, meaning])
    return rows


def _lumped(found: Calibration) -> str:
    """Kinds of effects of the plant file that the fitted model does not name, so that values hold them."""
    fitted = {effect.path for effect in found.best.fit.twin.effects}
    kinds = {
        effect.entry.spoken
        for effect in found.twin.effects
        if effect.enabled and effect.entry.where == "element" and effect.path not in fitted
    }
    return listed(sorted(kinds)) if kinds else ""


def _declared(found: Calibration, name: str) -> float:
    """Parameter as the plant file has it, or else as the fitted model declares it; NaN if neither does."""
    if name in found.twin.parameter_names:
        return float(found.twin.parameter_value(name))
    declared = found.best.fit.twin.base.parameters.get(name)
    value = None if declared is None else declared.value
    return float(value) if isinstance(value, int | float) else np.nan


def _pairs(found: Calibration) -> list[str]:
    """Pairs of parameters that are hardest to separate."""
    fit = found.best.fit
    correlation = np.tril(fit.correlation, -1)
    order = np.argsort(-np.abs(correlation), axis=None)[:_PAIRS]
    strong = [(i, j) for i, j in zip(*np.unravel_index(order, correlation.shape), strict=True)]
    pairs = [f"{fit.names[j]} and {fit.names[i]} {correlation[i, j]:.3f}" for i, j in strong
            if abs(correlation[i, j]) > _STRONG]  # fmt: skip
    more = int((np.abs(correlation) > _STRONG).sum()) - len(pairs)
    rest = f", and {more} more pairs" if more > 0 else ""
    return [f"Correlations above {_STRONG:g}: {', '.join(pairs)}{rest}; these are known better together than by "
            "themselves."] if pairs else []  # fmt: skip


def _spoken(stage: Stage) -> str:
    """Name of a stage that can begin a sentence."""
    model = Path(stage.fit.twin.declaration.model).stem
    if not stage.name.startswith("with "):
        return model
    return f"{model} with {listed(stage.name.removeprefix('with ').split(', '))}".replace("_friction", " friction")


def _with_deviation(value: float, std: float) -> tuple[str, str]:
    """Value with as many digits as its deviation warrants, and the deviation with two."""
    if not (np.isfinite(std) and std > 0.0):
        return _plain(value), ""
    digits = max(0, int(np.floor(np.log10(max(abs(value), std)))) - int(np.floor(np.log10(std)))) + 2
    return number(value, digits) if abs(value) < 1e-4 else f"{value:#.{digits}g}".rstrip("."), number(std, 2)


def _plain(value: float, digits: int = 5) -> str:
    return number(value, digits) if np.isfinite(value) else ""


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}") if "e-" not in text else text
