"""Pairs of causes: two laws that explain a residual together, where either alone takes little.

They share a place, or are one law in both directions between two coordinates. A free decay that dry friction and drag
damp looks linear to each of them: what is nearly constant at one amplitude takes from the declared damping what grows
with another. Of a gyroscopic force, either direction alone changes the energy, which both together keep. The scores of
pairs come from the products of what candidates do to the sensors, as single ones do.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import verdict
from masking.inference.discovery.explanation import Explanation, are_composite
from masking.inference.discovery.fitting import bounds
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.one_more_cause import Addition
from masking.inference.discovery.places import both_of
from masking.inference.discovery.screening import Score, Screen, best_factors


@dataclass(frozen=True)
class Pair:
    """Two laws: scores with the factors that fit best together, and what they could take off the cost."""

    scores: tuple[Score, Score]
    gain: float


def pairs(screen: Screen, scores: Sequence[Score]) -> list[Pair]:
    """Pairs of laws that may belong together, of single candidates with their best shapes, the best first."""
    found, groups = list[Pair](), dict[tuple[str, ...], list[Score]]()
    for score in scores:
        groups.setdefault(_group(score), []).append(score)
    for group, own in groups.items():
        if not group or len(own) < 2:
            continue
        made = screen.products([(score.candidate, score.instance) for score in own])
        for (first, i), (second, j) in itertools.combinations(zip(own, made.columns, strict=True), 2):
            if first.candidate.key == second.candidate.key:
                continue
            part = np.concatenate([i, j])
            gram, right = made.gram[np.ix_(part, part)], made.right[part]
            factors = best_factors(gram, right, made.squares[part])
            both = _with_factors(first, factors[: len(i)]), _with_factors(second, factors[len(i) :])
            if both[0] and both[1]:
                found.append(Pair((both[0], both[1]), float(2.0 * factors @ right - factors @ gram @ factors)))
    return sorted(found, key=lambda pair: -pair.gain)


def pairs_of_causes(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with two more causes that belong together."""
    rules = ground.rules
    alone = min(one.cost for one in table)
    if ground.is_noise(alone) or len(now.names) + 2 > rules.most_effects:
        return []
    seen = ground.screened(now)
    if seen is None:
        return []
    screen, scores = seen
    noise = float(ground.size // screen.every)
    left = rules.much_less * verdict.excess_cost(alone, ground.size)
    most = rules.fit_ratio * left / verdict.excess_cost(now.cost, ground.size) * (screen.total - noise)
    chosen = list[Pair]()
    for pair in pairs(screen, scores):
        names = (*now.names, *(score.candidate.key for score in pair.scores))
        if screen.total - pair.gain - noise > most or len(chosen) == rules.few_fits:
            break
        if len({*names}) == len(names) and not are_composite(names, ground.problem.rig, rules):
            chosen.append(pair)
    adding = Addition(ground, now, screen)
    return ground.noted("two causes at one place", [adding.job(pair.scores) for pair in chosen], alone)


def _group(score: Score) -> tuple[str, ...]:
    """Key that laws of a pair share: a place, or the law and its two coordinates; empty for other laws.

    At one place, laws that are linear, or in which a simpler one is nested, are left to a search step by step.
    """
    entry, at = score.candidate.entry, score.candidate.at
    if entry.directed == "coordinate":
        return score.candidate.effect, *sorted(both_of(at))
    is_element = score.instance.where == "element" and bool(score.candidate.factors)
    is_simple = is_element and not (entry.nested or entry.is_linear or entry.absorbed_by or entry.scaled)
    return (at,) if is_simple else ()


def _with_factors(score: Score, factors: Array) -> Score | None:
    """Score with other factors; None where they are beyond their bounds."""
    if (factors <= bounds([replace(score.instance, free=score.candidate.factors)]).low).any():
        return None
    return replace(score, instance=score.instance.with_values(score.candidate.factors, factors))
