"""Directed places, whose forces follow something else than the motion they act on: whether they are worth a search.

They are more than all other places together. So the model without causes is screened with them first, to first order.
"""

from __future__ import annotations

import numpy as np

from masking.inference.discovery.candidates import candidates
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import Screen
from masking.inference.discovery.signal_ranges import spans
from masking.inference.discovery.smoothing import smooth


def are_worth_a_search(problem: EstimationProblem, base: Hypothesis) -> bool:
    """Whether a cause at a directed place scores most, or one of two between coordinates; errors as `smooth`."""
    motion = smooth(problem, base.theta, base.start)
    every = list(candidates(problem.rig, spans(problem, motion), problem.dt))
    part = {"coordinate": problem.rules.directed_fraction}
    wanted = {place.name: part.get(place.directed, 1.0) for place in problem.rig.places if place.directed}
    scores = Screen(problem, base, motion, ()).scores(every)
    most = max((score.gain for score in scores if score.candidate.at not in wanted), default=0.0)
    return any(score.gain > wanted.get(score.candidate.at, np.inf) * most for score in scores)
