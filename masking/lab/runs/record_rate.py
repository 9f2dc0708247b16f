"""Rate of a recording: its instants, and where none is declared, a rate that follows the virtual motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.newton import jacobian
from masking.lab.runs.simulated_run import samples_until
from masking.model.modelling.model import Model

FEWEST: Final = 10.0  # rows per unit of virtual time
PER_PERIOD: Final = 40.0  # rows in a period of the fastest oscillation
_STEP: Final = 1e-6  # of a size of each state, for differences


def instants(duration: float, samples: int, rate: float | None) -> tuple[int, Callable[[int, int], Array]]:
    """How many rows a recording in continuous time has, and what gives the times from one row to before another.

    Where no rate is declared, there are `samples` rows, evenly from its beginning to its end in s.
    """
    if rate is not None:
        return samples_until(duration, rate), lambda first, last: np.arange(float(first), last) / rate
    step = duration / (samples - 1)

    def evenly(first: int, last: int) -> Array:
        times = np.arange(float(first), last) * step
        if last == samples:
            times[-1] = duration
        return times

    return samples, evenly


def rows_per_unit(virtual: Model, initial: Array) -> float:
    """Rows per unit of virtual time that show each period of the oscillation that is `fastest`, and at least 10."""
    return max(FEWEST, PER_PERIOD * fastest(virtual, initial) / (2.0 * math.pi))


def fastest(virtual: Model, initial: Array) -> float:
    """Angular frequency of the fastest oscillation about the initial state (2 k,) and about rest; 0 without any."""
    return max(_fastest(virtual, state) for state in (initial, np.zeros(len(initial))))


def _fastest(virtual: Model, state: Array) -> float:
    """Largest angular frequency of the motion about a state; 0 where it has none."""
    size, p, u = len(state), virtual.values(), np.zeros(len(virtual.inputs))
    lengths = np.ones(size) if virtual.is_dimensionless else np.resize(virtual.lengths, size)
    past = np.zeros(virtual.kernels.meta["lags"])
    if len(past):  # what depends on the past is held as it is at the state
        virtual.kernels.lagged(0.0, np.concatenate([state, past]), p, past)

    def rate(y: Array) -> Array:
        out = np.empty(size)
        virtual.kernels.derivative(0.0, np.concatenate([y, past]), u, p, out)
        return out

    slope = jacobian(rate, state, _STEP * lengths)
    return float(np.abs(np.linalg.eigvals(slope).imag).max(initial=0.0)) if np.all(np.isfinite(slope)) else 0.0
