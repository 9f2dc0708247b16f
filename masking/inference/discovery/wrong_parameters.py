"""Wrong parameters: one or several that are far off, beyond the reach of a fit within their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import fitting, verdict
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem

MOVED = 3.0  # deviations of its prior from which a parameter is one of those that are off


def several(problem: EstimationProblem, now: Explanation, found: Sequence[Explanation]) -> list[Explanation]:
    """Fewest parameters that leave no more than noise once they are free.

    They are sought where one cause leaves more, or needs other parameters far from what is declared.
    """
    size, rules = problem.record.readings.size, problem.rules

    def made(indices: Sequence[int]) -> Explanation | None:
        if not indices:  # the fit within the priors ended elsewhere
            return None
        names = tuple((problem.rig.names[i], "") for i in indices)
        free = Explanation("parameter", names, now.hypothesis).with_prior(problem)
        try:
            found = Explanation("parameter", names, fitting.fit(free, rival=float(size)))
        except IntegrationError:
            return None
        problem.trace.tried.append(found.tried(problem.trace.reading, "several parameters off"))
        return found if verdict.reaches_noise(found.cost, size, rules) else None

    def far(one: Explanation) -> list[int]:
        """Parameters that moved far and are not free, the farthest first."""
        off = np.abs(one.hypothesis.theta - problem.prior.mean) / problem.prior.deviation
        names = [(name, "") for name in problem.rig.names]
        return [int(i) for i in np.argsort(-off[: len(names)]) if off[i] > MOVED and names[i] not in one.names]

    likeliest = min((now, *found), key=lambda one: one.cost)
    if verdict.reaches_noise(likeliest.cost, size, rules) and not far(likeliest):
        return []
    best = made(range(len(problem.rig.names)))
    if best is None:
        return []
    left = far(replace(best, names=()))
    best = made(left)
    for i in reversed(left):  # those that moved least may have stood for the others
        fewer = made([one for one in left if one != i])
        if fewer is not None and best is not None and fewer.score(best.hypothesis) < best.score(best.hypothesis):
            left.remove(i)
            best = fewer
    return [] if best is None else [best]


def scores(problem: EstimationProblem, known: Hypothesis) -> Array:
    """Reduction of the cost by setting each parameter of the model free, to first order (k,)."""
    prior = problem.prior
    pull = (known.theta - prior.mean) / prior.deviation
    variance = np.diag(known.covariance)[: len(pull)] / prior.deviation**2
    # The parameter's own prior term, and what the others give once it is gone.
    found: Array = pull**2 / np.maximum(1.0 - variance, 1e-12)
    return np.where(variance < 1.0 - 1e-9, found, 0.0)[: len(problem.rig.names)]
