"""Directed places: whether forces that follow something else than the motion they act on are worth a search.

They are more than all other places together. So the model without causes is screened with them first, to first order.
"""

from __future__ import annotations

from masking.discovery.candidates import candidates
from masking.discovery.fitting import Hypothesis
from masking.discovery.problem import EstimationProblem
from masking.discovery.screening import Screen
from masking.discovery.smoothing import smooth
from masking.discovery.spans import spans


def places(problem: EstimationProblem) -> set[str]:
    """Return the names of the directed places that a problem has open."""
    return {place.name for place in problem.rig.places if place.directed}


def are_worth_a_search(problem: EstimationProblem, base: Hypothesis) -> bool:
    """Return whether a cause at a directed place scores about as much as the best of the others.

    Args:
        problem: the record and the rig, whose directed places are open.
        base: the model without causes, fitted.

    Raises:
        IntegrationError: the motion is not finite.
    """
    motion, opened = smooth(problem, base.theta, base.start), places(problem)
    every = list(candidates(problem.rig, spans(problem, motion), problem.dt))
    best = {True: 0.0, False: 0.0}
    for score in Screen(problem, base, motion, ()).scores(every):
        at = score.candidate.at in opened
        best[at] = max(best[at], score.gain)
    return best[True] > problem.rules.directed_fraction * best[False]
