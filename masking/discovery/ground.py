"""Ground of a search: the fitted model, the smoothed record and the candidates, to which every step comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from masking.discovery import fitting
from masking.discovery.candidates import Candidate
from masking.discovery.explanation import Explanation
from masking.discovery.problem import EstimationProblem
from masking.discovery.screening import Along, Score, Screen
from masking.discovery.smoothing import Motion, smooth
from masking.errors import IntegrationError

BEYOND = 10.0  # deviations of the prior, from which parameters stand for what is missing


@dataclass(frozen=True)
class Ground:
    """What every step of a search looks at.

    Args:
        base: the model, its parameters fitted within their priors.
        motion: smoothed record.
        every: candidates.
        problem: the record and the rig.
        along: what they do along the motion.
    """

    base: Explanation
    motion: Motion
    every: Sequence[Candidate]
    problem: EstimationProblem
    along: Along = field(default_factory=dict)

    @cached_property
    def declared(self) -> tuple[Screen, list[Score]] | None:
        """Return a screen of the model as declared and its scores; None where fitted parameters are near their prior.

        A strong effect takes them far beyond it; how the fitted model moves then tells little of what is missing.
        """
        problem, prior = self.problem, self.problem.prior
        if (np.abs(self.base.hypothesis.theta - prior.mean) < BEYOND * prior.deviation).all():
            return None
        try:
            known = fitting.fit(problem, theta=prior.mean, frozen=True)
            screen = Screen(problem, known, smooth(problem, known.theta, known.start))
        except IntegrationError:
            return None
        return screen, screen.scores(self.every)
