"""Views of a record: the model without causes, fitted and as declared, its motion, and screens of these."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.candidates import Candidate
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.motion_features import Kept
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.screening import Score, Screen
from masking.inference.discovery.smoothing import Motion, smooth

FAR = 10.0  # deviations of its prior by which no parameter is off: it then stands for what is missing


@dataclass(frozen=True)
class View:
    """The model without causes as a fit of it, the motion smoothed with that, and what candidates do along it."""

    hypothesis: Hypothesis
    motion: Motion
    kept: Kept = field(default_factory=Kept)


def views(problem: EstimationProblem, fit: Hypothesis, motion: Motion, far: float = FAR) -> tuple[View, ...]:
    """Model as it was fitted, and as it is declared where a parameter of the fit is more than `far` deviations off.

    Parameters of the fit then stand for what is missing, and what is not seen of its motion is wrong by as much. Where
    the record cannot be followed with the declared ones, the motion is that of the fit.
    """
    off = np.abs(fit.theta - problem.prior.mean) / problem.prior.deviation
    found = [View(fit, motion)]
    if (off > far).any():
        with suppress(IntegrationError):
            declared = fitting.fit(problem, theta=problem.prior.mean, frozen=True)
            found.append(View(declared, motion))
            found[1] = View(declared, smooth(problem, declared.theta, declared.start))
    return tuple(found)


@dataclass(frozen=True)
class Ground:
    """What every step of a search looks at: the model fitted within its priors, views of it, and candidates.

    The second view, if any, is of the model as it is declared.
    """

    base: Explanation
    views: Sequence[View]
    every: Sequence[Candidate]

    @property
    def declared(self) -> Hypothesis | None:
        """Model as it is declared, where the fit is far from it."""
        return self.views[1].hypothesis if len(self.views) > 1 else None

    @property
    def motion(self) -> Motion:
        """Motion that is smoothed with the parameters of the fit."""
        return self.views[0].motion

    def screen(
        self, problem: EstimationProblem, looked_at: Hypothesis, found: Sequence[EffectInstance], *, taken: bool = False
    ) -> Screen:
        """Screen of a fit along the motion of the nearest view, with what effects explain taken out.

        These are in the fit already where they are `taken`.
        """

        def distance(view: View) -> float:
            off = (view.hypothesis.theta - looked_at.theta) / problem.prior.deviation
            return float(off @ off)

        near = min(self.views, key=distance)
        return Screen(problem, looked_at, near.motion, found, taken=taken, kept=near.kept)

    def screened(self, problem: EstimationProblem, now: Explanation) -> tuple[Screen, list[Score]]:
        """Screen in which a candidate takes most, of the model or of what is found, and the scores.

        Of the fit and of the model as declared, each candidate has the score in the screen of which it takes more.
        """
        instances, size = now.hypothesis.instances, problem.record.readings.size
        screens = [self.screen(problem, view.hypothesis, instances) for view in self.views]
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
