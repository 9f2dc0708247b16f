"""Pages of stability: one HTML page that needs no other file, its figures, and its numbers as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from masking.analysis.stability.study import Stability, phase, position_words
from masking.reports import html, stability_figures
from masking.reports.html import Tile


def save(found: Stability, folder: str | Path) -> None:
    """Write `stability.html`, `stability.json` and PNG files into a folder, made if need be.

    Raises:
        RecordError: the folder cannot be written.
    """
    certificate = found.certificate
    steps = [*(certificate.invariant.steps if certificate.invariant else ()), *certificate.reasons]
    html.save(
        Path(folder, "stability.html"),
        "stability",
        stability_figures.figures(found),
        found.as_dict(),
        names=found.coordinates,
        title=f"stability of {found.name}",
        tiles=list(_tiles(found)),
        certificate=certificate,
        steps=[*steps, *(f"Equilibrium {point}." for point in certificate.others or ())],
        basins=[f"{str(basin)[0].upper()}{str(basin)[1:]}." for basin in certificate.basins],
        equilibria=str(found.rest) if found.rest else found.reason,
        modes=list(_modes(found)),
    )


def _tiles(found: Stability) -> Iterator[Tile]:
    yield Tile("certificate", found.certificate.status)
    if found.rest is not None:
        yield Tile("equilibria", str(len(found.rest.points)), "" if found.rest.is_complete else "or more")
    if found.exponent is not None:
        yield Tile("largest Lyapunov exponent", f"{found.exponent.value:.4g}")
    if found.upsilon is not None and np.isfinite(found.upsilon):
        yield Tile("upsilon (8.13)", f"{found.upsilon:.4g}")
    if found.loop is not None:
        yield Tile("closed loop less virtual", f"{found.loop.distance:.1e}")


def _modes(found: Stability) -> Iterator[tuple[str, ...]]:
    """Yield each mode: equilibrium and verdict beside the first of each, real part, frequency, damping and shape."""
    for point, modes in found.points:
        for i, mode in enumerate(modes.modes):
            where = position_words(point) if i == 0 else ""
            verdict = (point.verdict + " (proved)" * point.is_unstable) if i == 0 else ""
            shape = ", ".join(f"{n} {abs(x):.3f} at {phase(x):.2f} pi" for n, x in mode.shape.items())
            cells = (f"{mode.eigenvalue.real:.6g}", f"{mode.frequency:.6g}", f"{mode.damping:.4g}")
            yield (where, verdict, *cells, shape)
