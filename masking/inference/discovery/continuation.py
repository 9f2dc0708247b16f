"""Continuation: a record in shooting intervals that grow, for a motion that loses phase with it.

The lengths are those of `growing_intervals`. Each fit takes parameters and initial states of the one before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.smoothing import modes
from masking.inference.estimation import growing_intervals

ROUNDS = 12  # steps of each fit but the last
LINE = 8  # part of an interval from which its initial state is guessed
PARTS = 20  # of a record, in each of which its phase is looked at
SEEN = 10.0  # deviations of the noise: where a motion is smaller, its phase is not seen


def stages(problem: EstimationProblem) -> Iterator[EstimationProblem]:
    """Problem in short intervals, the shortest first, without that of its own intervals."""
    for samples in growing_intervals.lengths(problem.record, problem.interval_samples):
        yield replace(problem, interval=samples)


def parts(stage: EstimationProblem) -> Iterator[EstimationProblem]:
    """Problem in parts of its record with as many intervals as are fitted at once."""
    record, count = stage.record, growing_intervals.MOST * stage.interval_samples
    for begin in range(0, len(record), count):
        yield replace(stage, record=record.part(begin, begin + count))


def loses_phase(problem: EstimationProblem, residuals: Array) -> bool:
    """Whether a simulated motion, with residuals (m, sensors), has lost phase with a record in a part of it."""
    readings = problem.record.readings - problem.record.readings.mean(axis=0)
    bounds = len(readings) * np.arange(min(PARTS, len(readings))) // min(PARTS, len(readings))
    squares, errors = (np.add.reduceat(table**2, bounds, axis=0) for table in (readings, residuals))
    is_seen = squares > np.diff(np.append(bounds, len(readings)))[:, None] * (SEEN * problem.sigma) ** 2
    return bool((is_seen & (errors > problem.rules.phase_loss**2 * squares)).any())


def rings(problem: EstimationProblem) -> bool:
    """Whether the rig at rest, as it is declared, rings for many periods, so that an error of phase adds up."""
    speeds = modes(problem.rig, problem.prior.mean)
    ringing = np.abs(speeds.imag) > 2.0 * np.pi * problem.rules.ringing_periods * -speeds.real
    return bool((ringing & (speeds.imag != 0.0)).any())


def grown(states: Array, before: EstimationProblem, after: EstimationProblem) -> Array:
    """Initial states of longer intervals (w, states): those of the shorter ones (v, states) that begin with them."""
    begins = np.arange(after.intervals) * after.interval_samples
    at = np.minimum(np.rint(begins / before.interval_samples).astype(int), len(states) - 1)
    return np.asarray(states[at])
