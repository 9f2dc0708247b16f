"""Result of a search: the steps that it took, each with the explanations that were compared."""

from __future__ import annotations

from dataclasses import dataclass

from masking.discovery.explanation import Explanation
from masking.discovery.problem import EstimationProblem
from masking.discovery.screening import Score
from masking.discovery.smoothing import Motion


@dataclass(frozen=True)
class SearchResult:
    """What a search found: the steps that were taken, and the explanations of the last, best first.

    Args:
        base: the model, its parameters fitted within their priors.
        steps: the explanations that were compared in each step, the best first.
        motion: smoothed record.
        tried: what each candidate could take off at first, the best first.
        problem: the record, in the integration steps that the laws need; by default those of the model.
        passed_over: steps of which the last is the likeliest law, in the place of which a nested one was taken.
    """

    base: Explanation
    steps: tuple[tuple[Explanation, ...], ...]
    motion: Motion
    tried: tuple[Score, ...] = ()
    problem: EstimationProblem | None = None
    passed_over: tuple[tuple[Explanation, ...], ...] = ()
