"""Shooting: the intervals of multiple shooting, and the integration steps between samples.

A record is simulated in intervals, each from an initial state of its own that is estimated.
Source: Bock (1983), Recent advances in parameter identification techniques for o.d.e., in Numerical Treatment of
Inverse Problems in Differential and Integral Equations, Birkhaeuser, for multiple shooting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from masking.discovery import fitting
from masking.discovery.fitting import Hypothesis
from masking.discovery.problem import EstimationProblem
from masking.discovery.screening import thinning
from masking.discovery.smoothing import linearised
from masking.errors import RecordError
from masking.numerics.arrays import Array


def interval(evidence: EstimationProblem, seconds: float | None) -> int:
    """Return the samples of a window, in whole blocks of the screening: as asked, or as the model needs; 0 for none.

    Raises:
        RecordError: the windows asked for are too short.
    """
    rate, count, rules = evidence.record.rate, len(evidence.record), evidence.rules
    if seconds is None:
        speeds = _speeds(evidence) * count / rate
        if not ((np.abs(speeds) < rules.settling_rates) | (speeds.real > 1.0)).any():
            return 0
        seconds = count / rate / rules.intervals
    elif not seconds * rate >= rules.fewest_samples:
        few = rules.fewest_samples
        raise RecordError(f"the shooting interval is {seconds:g} s; give {few / rate:g} s or more: {few} samples")
    if seconds * rate >= count:
        return 0
    _, block = thinning(evidence.rig, rate)
    samples = round(seconds * rate / block) * block
    return samples if samples < count else 0


def shorter(evidence: EstimationProblem) -> Iterator[float]:
    """Give horizons in s, the longest first, for a motion that comes out of step with its record."""
    speeds = np.abs(_speeds(evidence).imag)
    slowest = float(np.min(speeds[speeds > 0.0], initial=np.inf))
    rules, rate = evidence.rules, evidence.record.rate
    least, last = rules.fewest_samples / rate, len(evidence.record) / rate
    for seconds in (max(periods * 2.0 * np.pi / slowest, least) for periods in rules.interval_periods):
        if seconds < 0.5 * last:
            last = seconds
            yield seconds


def substeps(evidence: EstimationProblem) -> int:
    """Return how many integration steps between samples simulate the readings within their noise."""
    least = evidence.rules.stiff_steps if len(evidence.rig.twin.free) > 2 * len(evidence.rig.coordinates) else 1
    theta, most = evidence.prior.mean, max(least, evidence.substeps)
    start = fitting.first_states(evidence, theta)

    def simulated(number: int) -> Array:
        return replace(evidence, substeps=number).equations(theta, start).simulated

    steps, before = least, simulated(least)
    while steps < most:
        after = simulated(min(2 * steps, most))
        change = np.sqrt(((after - before) ** 2).mean(axis=0))
        if bool((change < evidence.rules.integration_error * evidence.sigma).all()):
            break
        steps, before = min(2 * steps, most), after
    return steps


def finer(evidence: EstimationProblem, found: Hypothesis) -> int:
    """Return how many steps simulate a law that was found: friction that turns round fast, a stop, a gap.

    Steps are enough where four times as many change the readings by no more than `law_error` of their noise.
    """
    if not found.slots:
        return evidence.substeps

    @cache
    def left(number: int) -> Array:
        fine = replace(evidence, substeps=number)
        return fitting.fit(fine, found.slots, theta=found.theta, start=found.start, frozen=True).residuals

    steps, most = evidence.substeps, evidence.rules.most_refinement * evidence.substeps
    while steps < most:
        change = np.sqrt(((left(4 * steps) - left(steps)) ** 2).mean(axis=0))
        if bool((change < evidence.rules.law_error * evidence.sigma).all()):
            break
        steps *= 2
    return steps


def _speeds(evidence: EstimationProblem) -> Array:
    return np.asarray(np.linalg.eigvals(linearised(evidence.rig, evidence.prior.mean)[0]))
