"""Freer shapes: further parameters of the shape of a law, or one that creeps where it stuck."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from masking.inference.discovery import verdict
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.ground import Ground


def freer_shapes(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations in which further parameters of the shape of an effect are free, as a trial of it has them."""
    if ground.is_noise(now.cost) and not verdict.is_excess(now.cost, ground.size, ground.rules):
        return []
    jobs = []
    for i, instance in enumerate(now.hypothesis.instances):
        before, after = now.hypothesis.instances[:i], now.hypothesis.instances[i + 1 :]
        for other in ground.every:
            more = tuple(sorted({*other.free} - {*instance.free}))
            one = instance if other.sticks == instance.sticks else instance.creeping
            is_same = other.key == now.names[i] and other.sticks == one.sticks
            if is_same and {*instance.free} < {*other.free} and not {*more} & {*other.factors}:
                wider = replace(one, free=other.free)
                for start in dict.fromkeys(tuple(each.values[j] for j in more) for each in other.instances):
                    jobs.append(ground.refit(now.names, (*before, wider.with_values(more, start), *after), now))
    return ground.noted("a freer shape", jobs, now.cost)
