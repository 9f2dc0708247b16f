"""Thinning: samples over which motions and readings are averaged before a screen compares them."""

from __future__ import annotations

import numpy as np

from masking.discovery.problem import EstimationProblem
from masking.discovery.smoothing import linearised
from masking.numerics import decompositions
from masking.numerics.arrays import Array

FEWEST = 200  # means of a record that are compared at least, however short it is


def thinning(problem: EstimationProblem) -> tuple[int, int]:
    """Return the samples over which motions, and over which readings are averaged."""
    rig, rate = problem.rig, problem.record.rate
    own = np.abs(decompositions.eigenvalues(linearised(rig, rig.start)[0]).imag).max(initial=0.0) / (2.0 * np.pi)
    highest = max(problem.rules.screened_frequency, 2.0 * float(own), 0.5 * FEWEST * rate / len(problem.record))
    thin = max(1, int(rate / (6.0 * highest)))
    return thin, thin * max(1, int(rate / (2.0 * highest) / thin))


def thinned(table: Array, thin: int) -> Array:
    """Return means over `thin` samples of a table (m, c)."""
    if thin == 1:
        return np.ascontiguousarray(table)
    cut = table[: len(table) // thin * thin]
    total = cut[0::thin].copy()
    for i in range(1, thin):
        total += cut[i::thin]
    found: Array = np.ascontiguousarray(total / thin)
    return found
