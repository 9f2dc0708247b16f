"""Candidates: every effect of the dictionary at every place where it may sit, with values from which fits start.

Some parameters of an effect are factors of its force; the others shape it, and its entry says from which values of them
a fit starts, by the ranges of the signals of a record.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.places import is_of_one
from masking.inference.discovery.smoothing import Motion
from masking.model.effects import DELAY, Effect, Span, Trial

GROWTH = 1.6  # of a delay that is tried over the one before
SEEN = 0.05  # of the largest value, that readings or commands of both signs have at least
SHORTEST, LONGEST = 4.0, 3.0  # samples, and times of the motion, that the longest delay which is tried reaches at least
REPLACED = (1.0, 0.3, 3.0)  # parts of an element's stiffness with which a law in its place begins
SLOWEST, FASTEST = 0.05, 0.4  # tones: in Hz, one period in 20 s; of the sampling rate, as the smoother rolls off
SAMPLED = 4.0  # samples in which the rms rate takes a place through the shortest pitch; bins of that
MOST_PITCHES = 1000.0  # within the travel
LINES = 4  # of a spectrum for each that the record or the travel has
OWN = 0.01  # of the strongest line of a motion: lines that are its own


@dataclass(frozen=True)
class Candidate:
    """An effect at a place, with the starts of its fit."""

    # effect and at: its name and the place
    effect: str
    at: str
    # factors and free: indices of the parameters that are factors, and of all that are estimated
    factors: tuple[int, ...]
    free: tuple[int, ...]
    instances: tuple[EffectInstance, ...]  # one for each start, with factors 0 or as the start has them
    sticks: bool = False  # whether it is fitted with the parameters that follow the step of integration

    @property
    def key(self) -> tuple[str, str]:
        """Effect and place."""
        return self.effect, self.at

    @property
    def entry(self) -> Effect:
        """Effect's entry in the dictionary."""
        return self.instances[0].entry

    @property
    def has_shape(self) -> bool:
        """Whether estimated parameters shape it, whose effect has a slope to follow."""
        return bool({*self.free} - {*self.factors}) and not self.entry.quantum


def candidates(rig: AugmentedModel, spans: Mapping[tuple[str, str], Span], period: float) -> Iterator[Candidate]:
    """Every candidate; spans are by element, sensor or actuator with a name, the period between samples is in s."""
    every = [effect for effect in rig.twin.dictionary.values() if effect.is_searched]
    for place in rig.places:
        # Inertias take the displacement as linear, and change no reading at once.
        straight = is_of_one(place.element.displacement, rig.coordinates) and not rig.twin.is_fed
        is_known = bool(place.declared or place.coordinate or place.directed)
        for effect in every:
            fits = effect.where == "element" and ((straight or not effect.is_inertia) if is_known else effect.joins)
            if fits and place.is_open and place.takes(effect):
                # What holds a contact follows how fast a force moves it; where the motion is given, none does.
                is_held = any("mobility" in text for text in effect.by_step.values())
                is_free = rig.mobilities[place.name] > 0.0 or not is_held
                holds = is_free and (place.has_rate or effect.is_flow)
                for trial in effect.ways:
                    if holds or not trial.sticks:
                        found = _candidate(effect, trial, place.name, spans["element", place.name])
                        yield from (_ready(rig, candidate, period) for candidate in found)
    commanded = tuple(name for name in rig.twin.actuators if name not in rig.twin.measured_actuators)
    for where, names in (("sensor", rig.twin.sensors), ("actuator", commanded)):
        for effect in [e for e in every if e.where == where]:
            # A small difference between the signs shows where both are read.
            is_of_signs = "abs(" in effect.expression and any(one.spread for one in effect.parameters.values())
            for name in [n for n in names if not is_of_signs or _has_both_signs(spans[where, n])]:
                for trial in effect.ways:
                    yield from _candidate(effect, trial, name, spans[where, name])
    # Delays that are tried, in s: from a sample to a few times the time of the motion.
    longest = max(LONGEST * next(iter(spans.values())).time / period, SHORTEST)
    times = [float(time) for time in period * GROWTH ** np.arange(1 + np.ceil(np.log(longest) / np.log(GROWTH)))]
    # Of a single actuator, the delay of all is its own.
    for at in ("", *commanded) if commanded == rig.twin.actuators and len(commanded) > 1 else commanded:
        instances = tuple(EffectInstance(DELAY.name, at, (time,), (0,)) for time in times)
        yield Candidate(DELAY.name, at, (), (0,), instances)


def _has_both_signs(span: Span) -> bool:
    return min(-span.low, span.high) > SEEN * span.size


def _ready(rig: AugmentedModel, candidate: Candidate, period: float) -> Candidate:
    """Candidate whose law has no smooth form with the parameters that follow the step, here a sample."""
    if not candidate.sticks or candidate.entry.at_zero:
        return candidate
    mobility = rig.mobilities[candidate.at]
    return replace(candidate, instances=tuple(one.at_step(mobility, period) for one in candidate.instances))


def _candidate(effect: Effect, trial: Trial, at: str, span: Span) -> Iterator[Candidate]:
    """Effect at a place as a trial fits it; nothing if the record has no start for it."""
    names = trial.factors or effect.factors
    factors = effect.indices(names)
    free = tuple(sorted((*factors, *effect.indices(trial.free))))
    usual = {name: parameter.value or 0.0 for name, parameter in effect.parameters.items()}
    starts = [{**usual, **dict.fromkeys(names, 0.0), **start} for start in trial.starts(span)]
    if starts:
        instances = tuple(EffectInstance(effect.name, at, tuple(start.values()), free, effect) for start in starts)
        yield Candidate(effect.name, at, factors, free, instances, trial.sticks)


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
