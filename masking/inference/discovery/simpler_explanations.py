"""Simpler explanations: special cases of a richer one, which begin from its values.

The dictionary says which effects are special cases of which (`nested`); `Explanation.score` says which wins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.explanation import Explanation, ended
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.one_more_cause import in_steps
from masking.inference.discovery.verdict import Key
from masking.model.effects import Effect


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
            one = in_steps(ground.problem, begun(candidate.instances[0], instance), candidate)
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
