"""Sticking laws and others that the smoothed motion does not show, fitted from the model as declared.

Along a motion that sticks no law has the force that holds it, and where a sensor reads the same for several values,
such as a magnitude, the motion that is smoothed from its readings is another one. Parameters that are fitted without
these laws go far to stand for them. So dry friction is fitted at each place from the declared parameters, and at the
place where it leaves least the other frictions that stick, from there; and at each sensor the laws that fold its range,
and at each state the bounds that hold it. Where all of these leave much, every law with a shape is fitted in a few
rounds from each of its starts, since to first order along a wrong motion any law may look best; those that come nearest
are fitted to the end.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import continuation, excluded_laws, fitting, verdict
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.explanation import Explanation, Job, fitted
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.verdict import Key

# Levels of a law that has two, in parts of that of dry friction, which lies between them.
LEVELS = tuple((part * high, high) for high in (1.0, 1.1, 1.3, 1.5) for part in (0.4, 0.6, 0.8))
FASTER = (1.0, 8.0)  # times what is tried of a law's motion: where a place sticks, it slides faster than by its rms
MUCH = 1e-3  # of what the model without a law leaves beyond noise
WORSE = 10.0  # times what another law leaves: with two levels, friction may leave far less than with one
SHOWN = 0.1  # of what the model without a law leaves, that dry friction takes at least where it is one of these
PART = 0.5  # of what a search may simulate, for the first laws; the others have as much
SHARE = 0.2  # of that, after which a law begins at no further start
NEAREST = 3  # laws that are fitted, those that come nearest
FITTED = 6  # starts of a law, those of least cost; from the others few fits end where the best one does

MOVE = "a law that sticks or folds, from the declared parameters"


def sticking_laws(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Fits of frictions that stick and of laws that fold the range of a sensor, where other fits leave much."""
    if now.names or not _leaves_much(ground, now, table):
        return []
    begun, sticking = now.hypothesis, [one for one in ground.every if one.sticks]
    ground = replace(ground, problem=ground.problem.apart(PART))
    bounds = [_job(ground.problem, one, one.instances, begun) for one in sticking if not one.factors]
    simple = [one for one in sticking if one.factors and not one.entry.nested]
    scores = ground.screen(begun).scores(simple)
    first = {score.candidate.at: score for score in reversed(scores)}.values()
    jobs = [_job(ground.problem, score.candidate, [score.instance], begun) for score in first]
    folding = [one for one in ground.every if any(excluded_laws.folds(ground.problem, at) for at in one.instances)]
    jobs += [_job(ground.problem, one, one.instances, begun) for one in folding]
    rival = min(one.cost for one in table)
    made = ground.noted(MOVE, [*jobs, *bounds], rival)
    best = min(made, key=lambda one: one.cost, default=now)
    least = min(WORSE * rival, (1.0 - SHOWN) * now.cost)
    if not made or best.cost > least or not _leaves_much(ground, now, made):
        return made
    (effect, at), level = best.names[-1], best.hypothesis.instances[-1].estimated[0]
    others = [one for one in sticking if one.factors and one.at == at and one.effect != effect]
    jobs = [_job(ground.problem, one, [*_starts(one, level)], best.hypothesis) for one in others]
    return made + ground.noted("another law that sticks", jobs, rival)


def _leaves_much(ground: Ground, now: Explanation, found: Sequence[Explanation]) -> bool:
    least = min(one.cost for one in (now, *found))
    left, excess = (verdict.excess_cost(cost, ground.size) for cost in (least, now.cost))
    return left > MUCH * excess and not ground.is_noise(least)


def nearest_laws(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Fits of the laws that come nearest in a few rounds from each of their starts, where other fits leave much.

    To first order along the motion of a model that lacks it, a law may look best with a shape that is far from its own.
    """
    if now.names or not _leaves_much(ground, now, table):
        return []
    begun, problem = now.hypothesis, ground.problem.apart(PART)
    others = [one for one in ground.every if one.factors and not one.sticks and one.has_shape]
    scores = {id(score.candidate): score.gain for score in ground.screened(now)[1]}
    likeliest = sorted(others, key=lambda one: -scores.get(id(one), 0.0))
    starts = [(candidate, one) for candidate in likeliest for one in candidate.instances]

    def begin(one: EffectInstance, rival: float) -> Hypothesis:
        made = fitting.solved(problem, Begun((one,), begun.theta, begun.start), rounds=continuation.ROUNDS)
        if made is None:
            raise IntegrationError("the simulated motion is no longer finite")
        return made

    made = fitted([partial(begin, one) for _, one in starts], np.inf, problem.work)
    ended = ((candidate, one) for (candidate, _), one in zip(starts, made, strict=True) if one is not None)
    best = dict[Key, Hypothesis]()
    for candidate, one in sorted(ended, key=lambda pair: pair[1].cost):
        best.setdefault(candidate.key, one)
    jobs = [ground.refit((key,), one.instances, replace(now, hypothesis=one)) for key, one in [*best.items()][:NEAREST]]
    return ground.noted("nearest of all laws and starts", jobs, min(one.cost for one in table))


def _starts(candidate: Candidate, level: float) -> Iterator[EffectInstance]:
    """Instances from which a fit may start, with levels like that of dry friction."""
    others = [i for i in candidate.free if i not in candidate.factors]
    for instance, faster in itertools.product(candidate.instances, FASTER if others else FASTER[:1]):
        moved = instance.with_values(others, [faster * instance.values[i] for i in others])
        for parts in LEVELS if len(candidate.factors) > 1 else ((1.0,),):
            levels = (parts[min(i, len(parts) - 1)] * level for i in range(len(candidate.factors)))
            yield moved.with_values(candidate.factors, levels)


def _job(problem: EstimationProblem, candidate: Candidate, starts: Sequence[EffectInstance], begun: Hypothesis) -> Job:
    """Best fit of a law from its best starts, from parameters and initial states of a hypothesis."""
    step, ready, own = problem.dt / problem.substeps, starts, replace(problem, work=problem.work.share(SHARE))
    if candidate.sticks:
        ready = [one.at_step(problem.rig.mobilities[one.at], step) for one in starts]

    def cost(instance: EffectInstance) -> float:
        return fitting.cost(own, (instance,), begun.theta, begun.start)

    def made(rival: float) -> Explanation:
        fits = list[Hypothesis]()
        for one in sorted(ready, key=cost)[:FITTED]:
            if fits and own.work.is_done:
                break
            least = min([rival, *(known.cost for known in fits)])  # a start that no longer comes near it is left
            with suppress(IntegrationError):
                fits.append(fitting.fit(own, (one,), theta=begun.theta, start=begun.start, rival=least))
        if not fits:
            raise IntegrationError("the simulated motion is no longer finite")
        return Explanation("effects", (candidate.key,), min(fits, key=lambda fit: fit.cost))

    return made
