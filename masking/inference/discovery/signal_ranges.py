"""Signal ranges of each place, sensor and actuator in a record, from which fits start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import signal

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.smoothing import Motion
from masking.model.effects import Span

REPLACED = (1.0, 0.3, 3.0)  # parts of an element's stiffness with which a law in its place begins
SLOWEST, FASTEST = 0.05, 0.4  # tones: in Hz, one period in 20 s; of the sampling rate, as the smoother rolls off
SAMPLED = 4.0  # samples in which the rms rate takes a place through the shortest pitch; bins of that
MOST_PITCHES = 1000.0  # within the travel
LINES = 4  # of a spectrum for each that the record or the travel has
OWN = 0.01  # of the strongest line of a motion: lines that are its own


def spans(problem: EstimationProblem, motion: Motion) -> dict[tuple[str, str], Span]:
    """Range of each place, sensor and actuator: of an element, sensor or actuator with a name."""
    rig, record = problem.rig, problem.record
    found, tones, of_motion = dict[tuple[str, str], Span](), _tones(problem, motion), time(motion)
    for place, x, rate in zip(rig.places, motion.displacement.T, motion.rate.T, strict=True):
        # Of a place whose rate alone is known, how far it goes to and fro, without what goes on and on.
        moved = x if place.element.displacement is not None else signal.detrend(np.cumsum(rate) * problem.dt)
        span = _span(moved, of_motion, float(np.sqrt((rate**2).mean())) or 1.0, tones)
        stiffnesses = tuple(part * (rig.stiffnesses.get(place.name, 0.0) or 1.0) for part in REPLACED)
        pitches = _pitches(problem, moved, rate, motion.forces)
        found["element", place.name] = replace(span, stiffnesses=stiffnesses, pitches=pitches)
    ports = {"sensor": (rig.twin.sensors, record.readings), "actuator": (rig.twin.actuators, record.commands)}
    for where, (names, table) in ports.items():
        for name, x in zip(names, table.T, strict=True):
            found[where, name] = _span(x, of_motion)
    return found


def _tones(problem: EstimationProblem, motion: Motion) -> tuple[float, ...]:
    """Frequencies in Hz at which the latent forces are strongest.

    In a free decay those are left out at which the motion itself is strong: a force there follows the motion.
    """
    rules, rate, many = problem.rules, problem.record.rate, LINES * len(motion.forces)
    power = _spectrum(motion.forces)
    if not problem.rig.twin.actuators and _decays(motion.displacement):
        moved = _spectrum(motion.displacement - motion.displacement.mean(axis=0))
        power = np.where(moved > OWN * moved.max(initial=0.0), 0.0, power)
    if not power.any():
        return ()
    frequencies = np.fft.rfftfreq(many, 1.0 / rate)
    power = np.where((frequencies > SLOWEST) & (frequencies < FASTEST * rate), power, 0.0)
    beside = 3 * LINES  # just beyond the main lobe of the window
    return tuple(float(frequencies[i]) for i in _strongest(power, beside, rules.tones))


def _pitches(problem: EstimationProblem, x: Array, rate: Array, forces: Array) -> tuple[float, ...]:
    """Displacements over which latent forces repeat (c,), beside what is linear in displacement and rate."""
    travel, passed = float(np.ptp(x)), float(np.sqrt((rate**2).mean())) * problem.dt
    if not (travel > 0.0 and passed > 0.0 and np.isfinite(forces).all()):
        return ()
    most = min(travel / (SAMPLED * passed), MOST_PITCHES)
    known = np.column_stack([np.ones(len(x)), (x - x.mean()) / travel, rate * problem.dt / passed])
    left = forces - known @ decompositions.least_squares(known, forces)
    many = 2 ** int(np.ceil(np.log2(SAMPLED * most + 2.0)))
    at = np.minimum((x - x.min()) / travel * many, many - 1).astype(np.int64)
    power = np.zeros(LINES * many // 2 + 1)
    for column in left.T[left.var(axis=0) > 0.0]:
        power += np.abs(np.fft.rfft(np.bincount(at, column, many), LINES * many)) ** 2 / column.var()
    cycles = np.arange(len(power)) / LINES
    power = np.where((cycles >= 1.0) & (cycles <= most), power, 0.0)
    return tuple(travel / float(cycles[i]) for i in _strongest(power, LINES, problem.rules.tones))


def _strongest(power: Array, width: int, most: int) -> list[int]:
    """Strongest lines of a spectrum, each with as many beside it taken out."""
    left, found = power.copy(), list[int]()
    while left.any() and len(found) < most:
        found.append(int(np.argmax(left)))
        left[max(0, found[-1] - width) : found[-1] + width + 1] = 0.0
    return found


def _spectrum(table: Array) -> Array:
    """Power of columns (m, c) together, each over its variance, in some lines for each of the record."""
    window, found = np.hanning(len(table))[:, None], table[:, table.var(axis=0) > 0.0]
    power = np.abs(np.fft.rfft(found * window, LINES * len(table), axis=0)) ** 2
    return np.asarray((power / found.var(axis=0)).sum(axis=1))


def _decays(moved: Array) -> bool:
    """Whether every place moves less than half as far in the last third of a record as in the first (m, c)."""
    first, *_, last = np.array_split(moved - moved.mean(axis=0), 3)
    return bool((last.std(axis=0) <= 0.5 * first.std(axis=0)).all())


def _span(x: Array, seconds: float, rate: float = 0.0, tones: tuple[float, ...] = ()) -> Span:
    return Span(float(x.min()), float(x.max()), float(np.abs(x).max()), rate, seconds, tones)


def time(motion: Motion) -> float:
    """Time of the motion of the rig in s, of a sine over 2 pi its period: the median of all places."""
    moved, rates = motion.displacement.std(axis=0), np.sqrt((motion.rate**2).mean(axis=0))
    moves = (moved > 0.0) & (rates > 0.0)
    return float(np.median(moved[moves] / rates[moves])) if moves.any() else 1.0
