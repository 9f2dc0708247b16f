"""Other laws in the place of causes that were found: others, which they may only resemble, simpler and richer ones.

Simpler and richer ones begin from their values. The dictionary says which effects are special cases of which
(`nested`), `Explanation.score` which wins.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.explanation import Explanation, Job, ended
from masking.inference.discovery.more_causes import ready
from masking.inference.discovery.search_state import Ground
from masking.inference.discovery.verdict import Key
from masking.model.effects import Effect

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
            every = [(*others, ground.problem.in_steps(start, sticks=True)) for start in starts]
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


def other_causes(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with another effect in the place of each but the last, which has been chosen beside the others."""
    found: list[Explanation] = []
    for i in range(len(now.names) - 1):
        names, others = now.without(i)
        ground.tell(f"trying others than {now.names[i][0]}", 0.9)
        try:
            screen = ground.screen(ground.base.hypothesis, others)
        except IntegrationError:
            continue
        most = ground.worth(screen, now.cost / screen.every)
        scores = [one for one in screen.scores(ground.every) if one.candidate.key not in now.names]
        chosen = [one for one in scores if screen.total - one.gain < most][: ground.rules.few_fits]
        jobs = [ground.refit((one.candidate.key, *names), (ready(ground.problem, one), *others), now) for one in chosen]
        found += ground.noted("another in the place of a cause", jobs, now.cost)
    return found


def simpler_explanations(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations without each cause, or with a simpler one in its place, where its values begin better than it ended.

    A law beside an element, together with others that take the element's own force away, is that law instead of it.
    """
    known, jobs = now.hypothesis, []
    for names, instances in _simpler(ground, now):
        least = ended(table, names)
        if names and (least == np.inf or fitting.cost(ground.problem, instances, known.theta, known.start) < least):
            jobs.append(ground.refit(names, instances, now))
    return ground.noted("a simpler one", jobs, now.cost)


def _simpler(ground: Ground, now: Explanation) -> Iterator[tuple[tuple[Key, ...], tuple[EffectInstance, ...]]]:
    for i in reversed(range(len(now.names))):
        yield now.without(i)
    for i, ((effect, at), instance) in enumerate(zip(now.names, now.hypothesis.instances, strict=True)):
        first = {one.effect: one for one in reversed(ground.every) if one.at == at and one.effect != effect}
        names, others = now.without(i)
        apart = [pair for pair in zip(names, others, strict=True) if pair[0][1] != at]
        for name, candidate in sorted(first.items()):
            one = ground.problem.in_steps(begun(candidate.instances[0], instance), sticks=candidate.sticks)
            if name in instance.entry.nested and candidate.key not in names:
                yield (*names, candidate.key), (*others, one)
            elif _is_instead(candidate.entry, instance.entry) and len(apart) < len(names):
                yield (*(key for key, _ in apart), candidate.key), (*(other for _, other in apart), one)


def _is_instead(effect: Effect, beside: Effect) -> bool:
    """Whether an effect is the law of another one, instead of the element and not beside it."""
    laws = [(one.expression, {name: state.rate for name, state in one.states.items()}) for one in (effect, beside)]
    return (effect.attaches, beside.attaches) == ("instead", "beside") and laws[0] == laws[1]


def begun(simple: EffectInstance, richer: EffectInstance) -> EffectInstance:
    """Simple law with the fitted values of a richer one, and its own for what that does not have.

    Factors without a namesake, as the one level of dry friction for the two of an asymmetric one, begin at the mean.
    """
    values = dict(zip(richer.names, richer.estimated, strict=True))
    levels = [values[name] for name in richer.entry.factors if name in values]
    starts = {name: float(np.mean(levels)) for name in simple.entry.factors if levels} | values
    shared = [i for i, name in zip(simple.free, simple.names, strict=True) if name in starts]
    return simple.with_values(shared, (starts[name] for name in simple.names if name in starts))
