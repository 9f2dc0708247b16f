"""Averaging: means over samples of motions and readings, which a screen compares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.smoothing import modes
from masking.lab.records.noise import bandwidth

FEWEST = 200  # means of a record that are compared at least, however short it is
BEYOND = 2.0  # times the frequency at which readings fall below their noise: means over many samples show more


@dataclass(frozen=True)
class Thinning:
    """Samples over which means are taken: of motions a multiple of the stride, of readings a multiple of that.

    Of a stride, a law in an element looks at the middle.
    """

    motion: int
    readings: int
    stride: int = 1

    @classmethod
    def of(cls, problem: EstimationProblem) -> Thinning:
        """Thinning that keeps what a record shows."""
        rig, record, rate = problem.rig, problem.record, problem.record.rate
        own = np.abs(modes(rig, rig.start).imag).max(initial=0.0) / (2.0 * np.pi)
        seen = min(problem.rules.screened_frequency, BEYOND * rate * bandwidth(record.readings))
        highest = max(seen, 2.0 * float(own), 0.5 * FEWEST * rate / len(record))
        motion = max(1, int(rate / (6.0 * highest)))
        stride = max(1, motion // 2)
        motion -= motion % stride
        return cls(motion, motion * max(1, int(rate / (2.0 * highest) / motion)), stride)


def middles(samples: Array, stride: int) -> Array:
    """Middle of every `stride` samples of a table (m, c): a sample, or the mean of two."""
    cut = samples[: len(samples) // stride * stride]
    return np.asarray(0.5 * (cut[(stride - 1) // 2 :: stride] + cut[stride // 2 :: stride]))


def thinned(table: Array, thin: int) -> Array:
    """Means over `thin` samples of a table (m, c)."""
    cut = table[: len(table) // thin * thin]
    total = cut[0::thin].copy()
    for i in range(1, thin):  # measured: of few columns a sixth of the time of a mean over an axis
        total += cut[i::thin]
    return np.asarray(np.ascontiguousarray(total / thin))
