"""Coverage: which displacements and rates a record has at a place, and how well a law without a name is known there."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result
from masking.inference.discovery.force_decomposition import CELLS

BINS = 10  # of the range of displacements, and of that of speeds


@dataclass(frozen=True)
class Widest:
    """The part of a range in which a law is known least."""

    of: str  # 'displacement' or 'speed'
    low: float  # the ends of the part
    high: float
    band: float  # two standard deviations of the law there, rms, over the rms of the law along the motion
    is_end: bool  # whether the part is at an end of the range, where the motion turns or is fastest


@dataclass(frozen=True)
class Coverage(Result):
    """Where a record moves a place, and how well a law without a name is known there."""

    # displacement and rate: the least and the largest of the record
    displacement: tuple[float, float]
    rate: tuple[float, float]
    size: float  # rms of the law along the motion
    band: float  # two standard deviations of it, rms along the motion, over that size
    widest: Widest  # the part of the range in which it is known least
    sides: tuple[str, ...]  # what the law is of: displacement `d`, rate `v`, or both
    visited: float  # part of the rectangle of displacements and rates that the motion visits; 1 of a law of one of them
    json_names = ("displacement", "rate", "size", "band", "widest", "visited")

    @classmethod
    def of(cls, x: Array, rate: Array, force: Array, deviation: Array, sides: Collection[str]) -> Coverage:
        """Coverage of a motion: displacement, rate, and force of the law there with its standard deviation (m,)."""
        size = max(float(np.sqrt((force**2).mean())), 1e-300)
        every = (("d", "displacement", x), ("v", "speed", np.abs(rate)))
        seen = [(name, values) for side, name, values in every if side in sides]
        parts = [part for name, values in seen for part in _parts(name, values, deviation / size)]
        ends = [(float(values.min()), float(values.max())) for values in (x, rate)]
        visited = _visited(x, rate) if len({*sides} & {"d", "v"}) > 1 else 1.0
        band = 2.0 * float(np.sqrt((deviation**2).mean())) / size
        return cls(ends[0], ends[1], size, band, max(parts, key=lambda part: part.band), tuple(sorted(sides)), visited)


def _parts(of: str, values: Array, relative: Array) -> list[Widest]:
    """Parts of a range that the motion visits, each with the band of the law there."""
    edges = np.linspace(float(values.min()), float(values.max()), BINS + 1)
    at = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    ends = {BINS - 1} if of == "speed" else {0, BINS - 1}
    bands = {i: 2.0 * float(np.sqrt((relative[at == i] ** 2).mean())) for i in np.unique(at).tolist()}
    return [Widest(of, float(edges[i]), float(edges[i + 1]), band, i in ends) for i, band in bands.items()]


def _visited(x: Array, rate: Array) -> float:
    edges = (np.linspace(values.min(), values.max(), CELLS + 1)[1:-1] for values in (x, rate))
    across, along = (np.searchsorted(edge, values) for edge, values in zip(edges, (x, rate), strict=True))
    return len(np.unique(across * CELLS + along)) / CELLS**2
