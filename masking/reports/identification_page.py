"""Pages: a measurement or a fit as one HTML page that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy

from masking.errors import RecordError
from masking.procedures.measurement import Measurement, Row
from masking.reports import html as markup

if TYPE_CHECKING:
    from masking.estimation.fit import Fit
    from masking.estimation.innovations import KalmanFit
    from masking.reports import procedure_figures, style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)
    procedure_figures = lazy.load("masking.reports.procedure_figures", suppress_warning=True)

_TILES = 3  # numbers on top of the page of a fit
# Numbers on top of the page of a measurement: those of these names that it has, or begin with them.
_FIRST = {
    "springs": ("stiffness", "half_gap", "width"),
    "actuators": ("ratio", "residual"),
    "friction": ("edge", "step", "largest_shift", "friction"),
    "response": ("peak_", "even_", "odd_"),
}
_TITLES = {
    "springs": "Spring curve",
    "actuators": "Balance of two actuators",
    "friction": "Friction",
    "response": "Frequency response",
}


@dataclass(frozen=True)
class Written:
    """What was written of a measurement: the page, its numbers, and its figures as PNG files."""

    page: Path
    numbers: Path
    figures: tuple[Path, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the paths as JSON can hold them."""
        return {"page": str(self.page), "numbers": str(self.numbers), "figures": [str(f) for f in self.figures]}


def save(measured: Measurement[Any], folder: str | Path) -> Written:
    """Write `<procedure>.html`, `<procedure>.json` and PNG files into a folder, made if need be.

    All is drawn before anything is written.

    Raises:
        RecordError: the folder cannot be written.
    """
    out, name = Path(folder), measured.procedure
    plates = procedure_figures.plates(measured)
    images = {plate.name: style.png(plate) for plate in plates}
    text = json.dumps(measured.as_dict(), indent=2, ensure_ascii=False) + "\n"
    page = _page(measured, plates, images)
    written = Written(out / f"{name}.html", out / f"{name}.json", tuple(out / f"{image}.png" for image in images))
    contents = dict(zip(written.figures, images.values(), strict=True))
    contents |= {written.numbers: text.encode(), written.page: page.encode()}
    write(contents)
    return written


def save_fit(found: Fit | KalmanFit, plates: Sequence[style.Plate], sentence: str, folder: str | Path) -> Written:
    """Write `fit.html`, and the figures of a fit as PNG files, into a folder; `fit.json` is there already.

    Args:
        found: the fit.
        plates: its figures.
        sentence: the finding.
        folder: made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    out, told = Path(folder), found.as_dict()
    images = {plate.name: style.png(plate) for plate in plates}
    rows = [(name, _number(value["value"], 7), _number(value["std"], 2)) for name, value in told["parameters"].items()]
    head = ("parameter", "fitted", "standard deviation")
    sections = [markup.section("Parameters", markup.table(head, rows, numbers=(1, 2), names=found.names))]
    sections += [_drawn(plate, images) for plate in plates]
    errors = [
        (name, *(_number(x[name], 3) if name in x and x[name] is not None else "" for x in (
            told["chi"]["train"], told["chi"]["validation"], told["floor"]
        )))
        for name in told["floor"]
    ]  # fmt: skip
    columns = ("sensor", "error chi", "on unseen data", "of the noise alone")
    sections.append(markup.section("Errors", markup.table(columns, errors, numbers=(1, 2, 3))))
    sections += _notes(found.notes)
    tiles = [markup.tile(name, value, f"± {std}", names=found.names) for name, value, std in rows[:_TILES]]
    page = markup.document("Fit", markup.paragraph(f"{sentence}.", "lead", found.names), tiles, sections)
    files = Written(out / "fit.html", out / "fit.json", tuple(out / f"{name}.png" for name in images))
    write(dict(zip(files.figures, images.values(), strict=True)) | {files.page: page.encode()})
    return files


def write(contents: dict[Path, bytes]) -> None:
    """Write files, and their folder if need be.

    Raises:
        RecordError: they cannot be written.
    """
    for path, content in contents.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        except OSError as error:
            raise RecordError(f"{path} cannot be written: {error.strerror or error}; name another folder") from error


def _page(measured: Measurement[Any], plates: list[style.Plate], images: dict[str, bytes]) -> str:
    first = [
        next(row for row in measured.rows if row.key.startswith(key))
        for key in _FIRST[measured.procedure]
        if any(row.key.startswith(key) for row in measured.rows)
    ]
    sections = [
        markup.section(plate.title, markup.picture(plate.title, plate.caption, images[plate.name])) for plate in plates
    ]
    rows = [
        (row.label, _number(row.value), "" if row.std is None else _number(row.std, 2), row.unit)
        for row in measured.rows
    ]
    head = ("what", "value", "standard deviation", "unit")
    sections.append(markup.section("Numbers", markup.table(head, rows, numbers=(1, 2))))
    sections += _notes(measured.notes)
    used: list[tuple[str, object]] = [("records", ", ".join(measured.records))]
    used += [(what, channel.label) for what, channel in measured.channels.items()]
    sections.append(markup.section("Records and columns", markup.provenance(used)))
    lead = f'<p class="lead">{html.escape(measured.sentence)}.</p>'
    return markup.document(_TITLES[measured.procedure], lead, [_tile(row) for row in first], sections)


def _drawn(plate: style.Plate, images: dict[str, bytes]) -> str:
    return markup.section(plate.title, markup.picture(plate.title, plate.caption, images[plate.name]))


def _notes(notes: Sequence[str]) -> list[str]:
    items = "".join(f"<li>{markup.prose(note)}</li>" for note in notes)
    return [markup.section("Notes", f'<ul class="missing">{items}</ul>')] if notes else []


def _tile(row: Row) -> str:
    """Return a number with its unit and deviation; lengths, voltages and forces below 0.1 in thousandths."""
    by, unit = (1e3, f"m{row.unit}") if row.unit in {"m", "V", "N"} and abs(row.value) < 0.1 else (1.0, row.unit)
    if not row.unit and row.key.startswith(("even_", "odd_")):
        by, unit = 100.0, "%"
    return markup.tile(row.label, _number(by * row.value, 4), unit + _deviation(row.std, by))


def _deviation(std: float | None, by: float) -> str:
    return "" if std is None else f" ± {_number(by * std, 2)}"


def _number(value: float, digits: int = 5) -> str:
    return re.sub(r"e([+-])0*", lambda e: f"e{e[1].strip('+')}", f"{value:.{digits}g}")
