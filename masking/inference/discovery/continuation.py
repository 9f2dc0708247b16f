"""Continuation: a record in shooting intervals that grow, for a motion that loses phase with it.

Over many periods the cost has a minimum for each number of whole periods by which the simulation is ahead or behind;
over one period it has one. So a fit begins in intervals of one period. Each further one takes parameters and initial
states of the one before, in intervals four times as long, until they are as long as those of the problem.
Source: Bock (1983), Recent advances in parameter identification techniques for o.d.e., in Numerical Treatment of
Inverse Problems in Differential and Integral Equations, Birkhaeuser; Allgower and Georg (1990), Numerical Continuation
Methods, chapter 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.smoothing import modes

GROWTH = 4  # times the length of the intervals before
MOST = 64  # intervals that are fitted at once
FEWEST = 20  # samples of an interval
ROUNDS = 12  # steps of each fit but the last
LINE = 8  # part of an interval from which its initial state is guessed
PARTS = 20  # of a record, in each of which its phase is looked at
SEEN = 10.0  # deviations of the noise: where a motion is smaller, its phase is not seen


def stages(problem: EstimationProblem) -> Iterator[EstimationProblem]:
    """Problem in short intervals, the shortest first, without that of its own intervals."""
    samples = max(FEWEST, round(_period(problem) * problem.record.rate))
    while 2 * samples <= problem.interval_samples:
        yield replace(problem, interval=samples)
        samples *= GROWTH


def parts(stage: EstimationProblem) -> Iterator[EstimationProblem]:
    """Problem in parts of its record with as many intervals as are fitted at once."""
    record, count = stage.record, MOST * stage.interval_samples
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


def _period(problem: EstimationProblem) -> float:
    """Period of the strongest line of a record in s, of the sensor in which it is shortest."""
    readings = problem.record.readings
    window = np.hanning(len(readings))[:, None]
    power = np.abs(np.fft.rfft((readings - readings.mean(axis=0)) * window, axis=0)) ** 2
    lines = 1 + power[1:].argmax(axis=0)
    return float(len(readings) / problem.record.rate / lines.max())
