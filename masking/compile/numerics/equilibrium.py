"""The equilibrium of a rig from its accelerations at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from masking.compile.numerics.arrays import Array

STEP = 1e-5  # of a difference quotient, relative to a length
CONVERGED = 1e-12  # of a length
MOST_ROUNDS = 50


def equilibrium(accelerations: Callable[[Array], Array], lengths: Array) -> Array | None:
    """Coordinates (n,) without accelerations that Newton's method reaches from 0; None where it fails.

    Args:
        accelerations: of coordinates (n,) at rest (n,).
        lengths: a size of each coordinate (n,).
    """
    q = np.zeros(len(lengths))
    for _ in range(MOST_ROUNDS):
        steps = np.diag(STEP * lengths)
        slope = np.array([(accelerations(q + d) - accelerations(q - d)) / (2.0 * d.sum()) for d in steps]).T
        now = accelerations(q)
        if not (np.isfinite(slope).all() and np.isfinite(now).all()):
            return None
        change = np.linalg.lstsq(slope, now, rcond=None)[0] if len(q) else q
        q = q - change
        if np.all(np.abs(change) <= CONVERGED * lengths):
            return q
    return None
