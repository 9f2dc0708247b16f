"""Richer laws: those in which a law is nested, and the same with more parameters, begun from its values."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.explanation import Explanation, Job, ended
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.one_more_cause import in_steps
from masking.inference.discovery.verdict import Key

# Levels of a law that has two, in parts of that of a law with one, which lies between them.
LEVELS = tuple((part * high, high) for high in (1.0, 1.1, 1.3, 1.5) for part in (0.4, 0.6, 0.8))
FASTER = (1.0, 8.0)  # times what is tried of a law's motion: where a place sticks, it slides faster than by its rms


def richer_laws(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with a law that sticks in the place of a simpler one, where it begins better than it ended.

    A simpler law is one of the explanation, or of the best of others with as many causes that do nearly as much.
    """
    if ground.is_noise(now.cost):
        return []
    least, jobs = ground.nearly(now.cost, ground.base.cost), list[Job]()
    alike = [one for one in table if one.kind == "effects" and len(one.names) == len(now.names) and one.cost < least]
    seen = set[Key]()
    for one in (now, *sorted(alike, key=lambda one: one.cost)):
        for i, key in enumerate(one.names):
            if key not in seen:
                jobs += _richer(ground, one, i, table)
        seen |= {*one.names}
    return ground.noted("a richer law from the values of a simpler one", jobs, now.cost)


def _richer(ground: Ground, now: Explanation, i: int, table: Sequence[Explanation]) -> Iterator[Job]:
    """Fits with each richer law in the place of one cause, and with more of its own parameters estimated."""
    known, (effect, at), (names, others) = now.hypothesis, now.names[i], now.without(i)
    begun, same = known.instances[i], [one for one in table if {*one.names} == {*now.names}]
    for one in ground.every:
        if (
            one.key == (effect, at)
            and {*one.free} > {*begun.free}
            and not any(other.cost <= now.cost and _freed(other, one.key) >= {*one.free} for other in same)
        ):  # such a fit ended where it is no better
            yield ground.refit((*names, one.key), (*others, replace(begun, free=one.free)), now)
        if one.at == at and one.sticks and one.factors and effect in one.entry.nested and one.key not in names:
            starts = _starts(one, known.instances[i])
            every = [(*others, in_steps(ground.problem, start, one)) for start in starts]
            costs = [fitting.cost(ground.problem, begun, known.theta, known.start) for begun in every]
            if costs and min(costs) < ended(table, (*names, one.key)):
                yield ground.refit((*names, one.key), every[int(np.argmin(costs))], now)


def _freed(explanation: Explanation, key: Key) -> set[int]:
    """Which parameters of a cause an explanation estimates."""
    return {*explanation.hypothesis.instances[explanation.names.index(key)].free}


def _starts(candidate: Candidate, simple: EffectInstance) -> Iterator[EffectInstance]:
    """Instances from which a fit may start, with levels like that of the simpler law."""
    level = simple.estimated[0]
    others = [i for i in candidate.free if i not in candidate.factors]
    for instance, faster in itertools.product(candidate.instances, FASTER if others else FASTER[:1]):
        moved = instance.with_values(others, [faster * instance.values[i] for i in others])
        for parts in LEVELS if len(candidate.factors) > 1 else ((1.0,),):
            levels = (parts[min(i, len(parts) - 1)] * level for i in range(len(candidate.factors)))
            yield moved.with_values(candidate.factors, levels)
