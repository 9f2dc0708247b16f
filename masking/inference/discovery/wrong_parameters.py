"""Wrong parameters: one or several that are far off, beyond the reach of a fit within their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.inference.discovery import fitting
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.search_state import Ground


def wrong_parameters(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Explanations with one parameter of the model free: those that take most by it, to first order."""
    if now.names:
        return []
    rules, gains = ground.rules, scores(ground.problem, now.hypothesis)
    wrong = [int(i) for i in np.argsort(-gains)[: rules.few_fits] if gains[i] > rules.parameter_evidence]
    return ground.noted("a parameter off", [partial(_freed, ground.problem, now, [i]) for i in wrong], now.cost)


def several_parameters(ground: Ground, now: Explanation, table: Sequence[Explanation]) -> list[Explanation]:
    """Fewest parameters that leave no more than noise once they are free.

    They are sought where one cause leaves more, or needs other parameters far from what is declared.
    """
    likeliest = min(table, key=lambda one: one.cost)
    if now.names or (ground.is_noise(likeliest.cost) and not _far(ground.problem, likeliest)):
        return []

    def made(indices: Sequence[int]) -> Explanation | None:
        jobs = [partial(_freed, ground.problem, now, indices)] if indices else []
        found = ground.noted("several parameters off", jobs, float(ground.size))
        return next((one for one in found if ground.is_noise(one.cost)), None)

    best = made(range(len(ground.problem.rig.names)))
    if best is None:
        return []
    left = _far(ground.problem, replace(best, names=()))
    best = made(left)
    for i in reversed(left):  # those that moved least may have stood for the others
        fewer = made([one for one in left if one != i])
        if fewer is not None and best is not None and fewer.score(best.hypothesis) < best.score(best.hypothesis):
            left.remove(i)
            best = fewer
    return [] if best is None else [best]


def _freed(problem: EstimationProblem, now: Explanation, indices: Sequence[int], rival: float) -> Explanation:
    names = tuple((problem.rig.names[i], "") for i in indices)
    free = Explanation("parameter", names, now.hypothesis).with_prior(problem)
    if len(names) > 1:  # from the declared values: those of the fit may stand for each other
        return Explanation("parameter", names, fitting.fit(free, rival=rival))
    known = now.hypothesis
    return Explanation("parameter", names, fitting.fit(free, theta=known.theta, start=known.start, rival=rival))


def _far(problem: EstimationProblem, one: Explanation) -> list[int]:
    """Parameters that moved far and are not free, the farthest first."""
    off = np.abs(one.hypothesis.theta - problem.prior.mean) / problem.prior.deviation
    names = [(name, "") for name in problem.rig.names]
    return [
        int(i)
        for i in np.argsort(-off[: len(names)])
        if off[i] > problem.rules.chance_deviations and names[i] not in one.names
    ]


def scores(problem: EstimationProblem, known: Hypothesis) -> Array:
    """Reduction of the cost by setting each parameter of the model free, to first order (k,)."""
    prior = problem.prior
    pull = (known.theta - prior.mean) / prior.deviation
    variance = np.diag(known.covariance)[: len(pull)] / prior.deviation**2
    # The parameter's own prior term, and what the others give once it is gone.
    found: Array = pull**2 / np.maximum(1.0 - variance, 1e-12)
    return np.where(variance < 1.0 - 1e-9, found, 0.0)[: len(problem.rig.names)]
