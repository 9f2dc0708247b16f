"""Ground: what all rounds of a search look at, and the screens that are made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from masking.discovery import fitting
from masking.discovery.augmented_model import EffectInstance
from masking.discovery.candidates import Candidate
from masking.discovery.explanation import Explanation
from masking.discovery.fitting import Hypothesis
from masking.discovery.problem import EstimationProblem
from masking.discovery.screening import Along, Score, Screen
from masking.discovery.smoothing import Motion

FAR = 10.0  # deviations of its prior by which no parameter is off: it then stands for what is missing


@dataclass(frozen=True)
class Ground:
    """What every step of a search looks at.

    Args:
        base: the model, its parameters fitted within their priors.
        declared: the model as declared, where the fit is far from it.
        motion: smoothed record.
        every: candidates.
        along: what they do along the motion.
    """

    base: Explanation
    declared: Hypothesis | None
    motion: Motion
    every: Sequence[Candidate]
    along: Along = field(default_factory=dict)

    def screen(
        self,
        problem: EstimationProblem,
        looked_at: Hypothesis,
        found: Sequence[EffectInstance],
        *,
        taken: bool = False,
    ) -> Screen:
        """Return a screen of a fit, with what effects that were found explain taken out.

        Args:
            problem: the record and the rig.
            looked_at: the fit.
            found: the effects.
            taken: whether these are in the fit already.
        """
        return Screen(problem, looked_at, self.motion, found, taken=taken, along=self.along)

    def screened(self, problem: EstimationProblem, now: Explanation) -> tuple[Screen, list[Score]]:
        """Return the screen in which a candidate takes most, of the model or of what is found, and the scores.

        Of the fit and of the model as declared, each candidate has the score in the screen of which it takes more.

        Args:
            problem: the record and the rig.
            now: what is found.
        """
        instances, size = now.hypothesis.instances, problem.record.readings.size
        looked_at = [one for one in (self.base.hypothesis, self.declared) if one is not None]
        screens = [self.screen(problem, one, instances) for one in looked_at]
        if now.cost < max(problem.rules.small_residual * size, screens[0].total):
            screens = [self.screen(problem, now.hypothesis, instances, taken=True)]
        scored = [(screen, screen.scores(self.every)) for screen in screens]
        screen, scores = max(scored, key=lambda pair: pair[1][0].gain / (pair[0].total or np.inf) if pair[1] else 0.0)
        best = {id(score.candidate): score for score in scores}
        for other, others in scored:
            for score in others:
                gain = screen.total * score.gain / (other.total or np.inf)
                if gain > best[id(score.candidate)].gain:
                    best[id(score.candidate)] = replace(score, gain=gain)
        return screen, sorted(best.values(), key=lambda score: -score.gain)


def far_off(problem: EstimationProblem, fit: Hypothesis) -> Hypothesis | None:
    """Return the model as declared, where a fit is far from it: its parameters then stand for what is missing.

    Args:
        problem: the record and the rig.
        fit: of the model within the priors of its parameters.
    """
    off = np.abs(fit.theta - problem.prior.mean) / problem.prior.deviation
    if not (off > FAR).any():
        return None
    return fitting.fit(problem, theta=problem.prior.mean, frozen=True)
