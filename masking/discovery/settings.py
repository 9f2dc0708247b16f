"""Settings: how a record is simulated, and what is believed of the rig before it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from masking.discovery import fitting
from masking.discovery.augmented_model import OpenRig
from masking.discovery.fitting import Hypothesis
from masking.discovery.problem import Belief, Evidence
from masking.discovery.screening import thinning
from masking.discovery.smoothing import linearised
from masking.errors import RecordError
from masking.estimation.data import Data
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

TOLERANCE = 0.01  # relative standard deviation of a parameter that declares none
SIGNED = 3.0  # deviations from 0 from which a parameter keeps its sign
RESTLESS = 10.0  # eigenvalue times the length of a record: what is slower does not come to rest in it
SHARES = 20  # windows of a record of what does not come to rest
FEWEST = 200  # samples of a window
PERIODS = (4.0, 1.0)  # of the slowest oscillation: windows in which motion does not come out of step with its record
STIFF = 8  # steps between samples at least where forces act on states: friction stops these within a sample
UNSEEN = 0.1  # of the noise: what integration may add to the readings of the model as declared
FINE = 0.05  # of the noise: what integration may add with a law that was found
FINER = 16  # times as many steps at most
HELD_OUT = 0.3  # of a record, where no other is given to judge by


def believed(twin: Twin, rig: OpenRig, tolerance: float) -> Belief:
    """Return the declared values of the rig's parameters, how far they may be off, and what they cannot be."""
    declared = twin.model.declaration.parameters
    deviations = []
    for name, value in zip(rig.names, rig.start, strict=True):
        std = declared[name].std if name in declared else None
        deviations.append(std or tolerance * (abs(float(value)) or 1.0))
    mean, deviation, (low, high) = rig.start.copy(), np.array(deviations), rig.bounds
    low = np.where(mean > SIGNED * deviation, np.maximum(low, 0.0), low)
    high = np.where(mean < -SIGNED * deviation, np.minimum(high, 0.0), high)
    return Belief(mean, deviation, low, high)


def split(record: Data) -> tuple[Data, Data]:
    """Return the part of a record that is explained, and the last part, which judges."""
    seconds = len(record) / record.rate
    return record.first((1.0 - HELD_OUT) * seconds), record.windows(HELD_OUT * seconds)[-1]


def horizon(evidence: Evidence, seconds: float | None) -> int:
    """Return the samples of a window, in whole blocks of the screening: as asked, or as the model needs; 0 for none.

    Raises:
        RecordError: the windows asked for are too short.
    """
    rate, count = evidence.record.rate, len(evidence.record)
    if seconds is None:
        speeds = _speeds(evidence) * count / rate
        if not ((np.abs(speeds) < RESTLESS) | (speeds.real > 1.0)).any():
            return 0
        seconds = count / rate / SHARES
    elif not seconds * rate >= FEWEST:
        least = FEWEST / rate
        raise RecordError(
            f"the shooting interval is {seconds:g} s; give {least:g} s or more, which are {FEWEST} samples"
        )
    if seconds * rate >= count:
        return 0
    _, block = thinning(evidence.rig, rate)
    samples = round(seconds * rate / block) * block
    return samples if samples < count else 0


def shorter(evidence: Evidence) -> Iterator[float]:
    """Give horizons in s, the longest first, for a motion that comes out of step with its record."""
    speeds = np.abs(_speeds(evidence).imag)
    slowest = float(np.min(speeds[speeds > 0.0], initial=np.inf))
    least, last = FEWEST / evidence.record.rate, len(evidence.record) / evidence.record.rate
    for seconds in (max(periods * 2.0 * np.pi / slowest, least) for periods in PERIODS):
        if seconds < 0.5 * last:
            last = seconds
            yield seconds


def substeps(evidence: Evidence) -> int:
    """Return how many integration steps between samples simulate the readings within their noise."""
    least = STIFF if len(evidence.rig.twin.free) > 2 * len(evidence.rig.coordinates) else 1
    theta, most = evidence.belief.mean, max(least, evidence.substeps)
    start = fitting.first_states(evidence, theta)

    def simulated(number: int) -> Array:
        return replace(evidence, substeps=number).equations(theta, start).simulated

    steps, before = least, simulated(least)
    while steps < most:
        after = simulated(min(2 * steps, most))
        if bool((np.sqrt(((after - before) ** 2).mean(axis=0)) < UNSEEN * evidence.sigma).all()):
            break
        steps, before = min(2 * steps, most), after
    return steps


def finer(evidence: Evidence, found: Hypothesis) -> int:
    """Return how many steps simulate a law that was found: friction that turns round fast, a stop, a gap.

    Steps are enough where four times as many change the readings by no more than `FINE` of their noise.
    """
    if not found.slots:
        return evidence.substeps

    @cache
    def left(number: int) -> Array:
        fine = replace(evidence, substeps=number)
        return fitting.fit(fine, found.slots, theta=found.theta, start=found.start, frozen=True).residuals

    steps, most = evidence.substeps, FINER * evidence.substeps
    while steps < most:
        change = np.sqrt(((left(4 * steps) - left(steps)) ** 2).mean(axis=0))
        if bool((change < FINE * evidence.sigma).all()):
            break
        steps *= 2
    return steps


def _speeds(evidence: Evidence) -> Array:
    return np.asarray(np.linalg.eigvals(linearised(evidence.rig, evidence.belief.mean)[0]))
