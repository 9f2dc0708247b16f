"""Candidates: every effect of the dictionary at every place where it may sit, with values from which fits start.

Some parameters of an effect are factors of its force; the others shape it, and its entry says from which values of them
a fit starts in a record.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.places import is_of_one
from masking.model.effects import DELAY, Effect, Span, Trial

GROWTH = 1.6  # of a delay that is tried over the one before
SEEN = 0.05  # of the largest value, that readings or commands of both signs have at least
SHORTEST, LONGEST = 4.0, 3.0  # samples, and times of the motion, that the longest delay which is tried reaches at least


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
