"""Steady Kalman filter of a linear system that is driven by white noise and read at equal times.

Source: Gelb (ed.), Applied Optimal Estimation (1974), chapter 4; Van Loan, IEEE Trans. Autom. Control 23 (1978),
395-404, for the noise over a sample; Chu, Fan, Lin and Wang, Int. J. Control 77 (2004), 767-788, for the Riccati
equation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.lazy_imports import linalg

MOST_SIZE = 1e300  # of a flow over a sample
MOST_DOUBLINGS = 60  # of the samples that are covered
SETTLED = 1e-15  # relative change of the covariance by the last doubling


@dataclass(frozen=True)
class SteadyFilter:
    """A steady Kalman filter in which readings have unit variance."""

    gain: Array  # correction of the state per unit of reading (n, sensors)
    predicted: Array  # covariance of the state before a reading (n, n)
    corrected: Array  # covariance of the state after it (n, n)
    innovation: Array  # covariance of what a reading adds (sensors, sensors)


def discretised(flow: Array, density: Array, period: float) -> tuple[Array, Array]:
    """Transition over a sample of a period (n, n), and the covariance of the noise over it (n, n).

    Of dx/dt = `flow` x + white noise (n, n), with the density of the noise of each state, per unit of time (n,).
    """
    n = len(flow)
    size = min(max(1.0, float(np.linalg.norm(flow, 1)) * period), MOST_SIZE)  # 1 of what is no number
    halvings = math.ceil(math.log2(size))
    block = np.block([[-flow, np.diag(density)], [np.zeros((n, n)), flow.T]])
    with np.errstate(over="ignore", invalid="ignore"):  # of what grows fast, a step is infinite
        exponential = linalg.expm(block * period / 2.0**halvings)  # of what decays fast, the inverse would be infinite
        step = exponential[n:, n:].T
        noise = step @ exponential[:n, n:]
        for _ in range(halvings):
            step, noise = step @ step, noise + step @ noise @ step.T
    return step, 0.5 * (noise + noise.T)


def steady_filter(step: Array, noise: Array, reading: Array) -> SteadyFilter:
    """Steady Kalman filter of a transition over a sample (n, n), with the covariance of the noise over it (n, n).

    `reading` (sensors, n) gives readings of unit variance per unit of state. Raises a `ValueError` where they do not
    determine the state: its covariance grows from sample to sample.
    """
    predicted = _predicted(step, reading, noise)
    innovation = reading @ predicted @ reading.T + np.eye(len(reading))
    gain = np.asarray(np.linalg.solve(innovation, reading @ predicted).T, dtype=np.float64)
    return SteadyFilter(gain, predicted, predicted - gain @ reading @ predicted, innovation)


def _predicted(step: Array, reading: Array, noise: Array) -> Array:
    """Solution P of P = F (P^-1 + C^T C)^-1 F^T + Q.

    Structure-preserving doubling: each round covers twice as many samples as the one before. The matrix pencil of other
    methods has a multiple eigenvalue near 1 if the bandwidth is far below the rate, so near that they cannot tell its
    halves apart.
    """
    one, a, g, p = np.eye(len(step)), step.T, reading.T @ reading, noise
    for _ in range(MOST_DOUBLINGS):
        solved = np.linalg.solve(one + g @ p, np.hstack([a, g @ a.T]))
        onward, more = solved[:, : len(a)], solved[:, len(a) :]
        added = a.T @ p @ onward
        p = p + 0.5 * (added + added.T)
        more = a @ more
        g, a = g + 0.5 * (more + more.T), a @ onward
        if np.abs(added).max() <= SETTLED * np.abs(p).max():
            return p
    raise ValueError("the covariance of the state does not settle")
