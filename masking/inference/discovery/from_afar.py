"""From afar: laws that the smoothed motion does not show, fitted along the motion of the model that lacks them.

Along a motion that sticks no law has the force that holds it. To first order along a wrong motion any law may look
best, with a shape that is far from its own. So where the fits of what a screen puts first leave much, every law that
sticks or has a shape is fitted in a few rounds from each of its starts, and those that come nearest to the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from masking.inference.discovery import continuation, fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.explanation import Explanation, fitted
from masking.inference.discovery.fitting import Begun, Hypothesis
from masking.inference.discovery.ground import Ground
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import Score
from masking.inference.discovery.verdict import Key


def from_afar(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with the laws that come nearest from any of their starts; beside the model without causes alone."""
    least = min(one.cost for one in table)
    seen = None if now.names or ground.is_near(least) else ground.screened(now)
    if seen is None:
        return []
    problem = ground.problem.apart(ground.rules.afar)
    starts = [(score, one) for score in seen[1] for one in _starts(ground, score)]
    made = fitted([partial(_begun, problem, now.hypothesis, one) for _, one in starts], np.inf, problem.work)
    ended = ((score, one) for (score, _), one in zip(starts, made, strict=True) if one is not None)
    best = dict[Key, Hypothesis]()
    for score, one in sorted(ended, key=lambda pair: pair[1].cost):
        best.setdefault(score.candidate.key, one)
    near = [*best.items()][: ground.rules.few_fits]
    jobs = [ground.refit((key,), one.instances, replace(now, hypothesis=one)) for key, one in near]
    return ground.noted("nearest of all laws and starts", jobs, least)


def _starts(ground: Ground, score: Score) -> Sequence[EffectInstance]:
    """Instances of a candidate from which it is fitted; of one that sticks, with the level that the screen gives."""
    candidate = score.candidate
    if candidate.sticks and not candidate.entry.nested:
        every = [score.instance] if candidate.factors else candidate.instances
        return [ground.problem.in_steps(one, sticks=True) for one in every]
    is_shaped = bool(candidate.factors) and candidate.has_shape and not candidate.sticks
    return candidate.instances if is_shaped else ()


def _begun(problem: EstimationProblem, known: Hypothesis, one: EffectInstance, rival: float) -> Hypothesis | None:
    """Fit in a few rounds from the parameters and initial states of the model alone, whatever its rival."""
    return fitting.solved(problem, Begun((one,), known.theta, known.start), rounds=continuation.ROUNDS)
