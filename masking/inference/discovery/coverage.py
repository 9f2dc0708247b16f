"""Coverage: which displacements and rates a record has at a place, and how well a law without a name is known there."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result
from masking.inference.discovery.force_decomposition import CELLS

BINS = 10  # of the range of displacements, and of that of speeds


class Widest(NamedTuple):
    """The part of a range in which a law is known least."""

    band: float  # two standard deviations of the law there, rms, over the rms of the law along the motion
    of: str  # 'displacement' or 'speed'
    # the ends of the part
    low: float
    high: float


@dataclass(frozen=True)
class Coverage(Result):
    """Where a record moves a place, and how well a law without a name is known there."""

    # displacement and rate: the least and the largest of the record
    displacement: tuple[float, float]
    rate: tuple[float, float]
    band: float  # two standard deviations of the law, rms along the motion, over the rms of the law there
    widest: Widest  # the part of the range in which it is known least
    sides: tuple[str, ...]  # what the law is of: displacement `d`, rate `v`, or both
    visited: float  # part of the rectangle of displacements and rates that the motion visits; 1 of a law of one of them
    json_names = ("displacement", "rate", "band", "widest", "visited")

    @classmethod
    def of(cls, x: Array, rate: Array, force: Array, deviation: Array, sides: Collection[str]) -> Coverage:
        """Coverage of a motion: displacement, rate, and force of the law there with its standard deviation (m,)."""
        squares = (2.0 * deviation / max(float(np.sqrt((force**2).mean())), 1e-300)) ** 2
        parts = []
        for side, name, values in (("d", "displacement", x), ("v", "speed", np.abs(rate))):
            many, edges = np.histogram(values, BINS)
            sums = np.histogram(values, BINS, weights=squares)[0]
            seen = zip(np.sqrt(sums / np.maximum(many, 1)), edges, edges[1:], strict=False)
            parts += [Widest(float(band), name, float(low), float(high)) for band, low, high in seen if side in sides]
        moved, moves = ((float(values.min()), float(values.max())) for values in (x, rate))
        cells = np.histogram2d(x, rate, CELLS)[0]
        visited = np.count_nonzero(cells) / cells.size if {*sides} >= {"d", "v"} else 1.0
        return cls(moved, moves, float(np.sqrt(squares.mean())), max(parts), tuple(sorted(sides)), visited)
