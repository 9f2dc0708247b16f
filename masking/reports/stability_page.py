"""Pages of stability: one HTML page that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np

from masking.analysis.stability.certificate import Certificate
from masking.analysis.stability.study import Stability, phase, position_words
from masking.errors import RecordError
from masking.reports import html

if TYPE_CHECKING:
    from masking.reports import stability_figures, style
else:
    style = lazy.load("masking.reports.style", suppress_warning=True)
    stability_figures = lazy.load("masking.reports.stability_figures", suppress_warning=True)

PAGE, NUMBERS = "stability.html", "stability.json"


@dataclass(frozen=True)
class Written:
    """What was written: the page, its numbers, and its figures as PNG files."""

    page: Path
    numbers: Path
    figures: tuple[Path, ...]


def save(found: Stability, folder: str | Path) -> Written:
    """Write `stability.html`, `stability.json` and PNG files into a folder, made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    out, drawn = Path(folder), stability_figures.plates(found)
    images = {plate.name: style.png(plate) for plate in drawn}
    numbers = json.dumps(found.as_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    written = Written(out / PAGE, out / NUMBERS, tuple(out / f"{name}.png" for name in images))
    contents = dict(zip(written.figures, images.values(), strict=True))
    contents |= {written.numbers: numbers.encode(), written.page: _page(found, drawn, images).encode()}
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path, content in contents.items():
            path.write_bytes(content)
    except OSError as error:
        raise RecordError(f"{out} cannot be written: {error.strerror or error}; name another folder") from error
    return written


def _page(found: Stability, drawn: Sequence[style.Plate], images: dict[str, bytes]) -> str:
    names = found.coordinates
    sections = [html.section("Energy certificate", _certificate(found.certificate, names))]
    for plate in drawn:
        sections.append(html.section(plate.title, html.picture(plate.title, plate.caption, images[plate.name], names)))
    rows = []
    for point, modes in found.points:
        for i, mode in enumerate(modes.modes):
            where = position_words(point) if i == 0 else ""
            verdict = (point.verdict + " (proved)" * point.is_unstable) if i == 0 else ""
            shape = ", ".join(f"{n} {abs(x):.3f} at {phase(x):.2f} pi" for n, x in mode.shape.items())
            cells = (f"{mode.eigenvalue.real:.6g}", f"{mode.frequency:.6g}", f"{mode.damping:.4g}")
            rows.append((where, verdict, *cells, shape))
    head = ("where", "verdict", "real part", "frequency", "damping ratio", "shape")
    sentence = str(found.rest) if found.rest else found.reason
    table = html.table(head, rows, numbers=(2, 3, 4), names=names) if rows else ""
    text = html.paragraph(f"{sentence[:1].upper()}{sentence[1:]}.", "lead", names)
    sections.append(html.section("Equilibria and modes", text + table))
    tiles = [html.tile("certificate", found.certificate.status)]
    if found.rest is not None:
        tiles.append(html.tile("equilibria", str(len(found.rest.points)), "" if found.rest.is_complete else "or more"))
    if found.exponent is not None:
        tiles.append(html.tile("largest Lyapunov exponent", f"{found.exponent.value:.4g}"))
    if found.upsilon is not None and np.isfinite(found.upsilon):
        tiles.append(html.tile("upsilon (8.13)", f"{found.upsilon:.4g}"))
    if found.loop is not None:
        tiles.append(html.tile("closed loop less virtual", f"{found.loop.distance:.1e}"))
    lead = html.paragraph(f"{_sentence(found.certificate.conclusion)}.", "lead", names)
    return html.document(f"stability of {found.name}", lead, tiles, sections)


def _certificate(told: Certificate, names: Sequence[str]) -> str:
    """Return the certificate as paragraphs: what is shown, under which hypotheses, and the argument."""
    parts = [f"{_sentence(told.status)}: {told.conclusion}."]
    if told.hypotheses:
        parts.append(f"For {', '.join(told.hypotheses)}.")
    if told.energy is not None:
        parts.append(f"V = {told.energy}.")
    if told.dissipation is not None:
        parts.append(f"V' = {told.dissipation.rate}: {told.dissipation.method} ({told.dissipation.status}).")
    if told.boundedness is not None:
        parts.append(f"{_sentence(told.boundedness.text)}.")
    steps = [*(told.invariant.steps if told.invariant else ()), *told.reasons]
    steps += [f"Equilibrium {point}." for point in told.others or ()]
    text = "\n".join(html.paragraph(part, "lead" if i == 0 else "changed", names) for i, part in enumerate(parts))
    items = "".join(f"<li>{html.prose(step, names)}</li>" for step in steps)
    return text + (f"<ol>{items}</ol>" if items else "")


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]
