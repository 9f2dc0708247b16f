"""Shooting: the intervals of multiple shooting, and the integration steps between samples.

A record is simulated in intervals, each from an initial state of its own that is estimated.
Source: Bock (1983), Recent advances in parameter identification techniques for o.d.e., in Numerical Treatment of
Inverse Problems in Differential and Integral Equations, Birkhaeuser, for multiple shooting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RecordError
from masking.inference.discovery import fitting
from masking.inference.discovery.augmented_model import EffectInstance
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.motion_features import Thinning
from masking.inference.discovery.smoothing import modes, smooth
from masking.inference.estimation.simulation import refined
from masking.model.declaration.couplings import driven_states

SHORTEST = 3e-3  # of the travel: the shortest displacement with which a friction that builds up begins to be fitted


def interval(problem: EstimationProblem, seconds: float | None) -> int:
    """Samples of a shooting interval, in whole blocks of a screen; 0 for none. One too short is a RecordError."""
    rate, count, rules = problem.record.rate, len(problem.record), problem.rules
    if seconds is None:
        speeds = modes(problem.rig, problem.prior.mean) * count / rate
        if not ((np.abs(speeds) < rules.settling_rates) | (speeds.real > 1.0)).any():
            return 0
        seconds = max(count / rules.intervals, rules.fewest_samples) / rate  # shorter ones follow any motion
    elif not seconds * rate >= rules.fewest_samples - 0.5:
        few = rules.fewest_samples
        raise RecordError(f"the shooting interval is {seconds:g} s; give {few / rate:g} s or more: {few} samples")
    if seconds * rate >= count:
        return 0
    block = Thinning.of(problem).readings
    samples = round(seconds * rate / block) * block
    return samples if samples < count else 0


def shorter(problem: EstimationProblem) -> Iterator[float]:
    """Shooting intervals in s, the longest first, for a motion that loses phase with its record."""
    speeds = np.abs(modes(problem.rig, problem.prior.mean).imag)
    slowest = float(np.min(speeds[speeds > 0.0], initial=np.inf))
    rules, rate = problem.rules, problem.record.rate
    least, last = rules.fewest_samples / rate, len(problem.record) / rate
    for seconds in (max(periods * 2.0 * np.pi / slowest, least) for periods in rules.interval_periods):
        if seconds < 0.5 * last:
            last = seconds
            yield seconds


def substeps(problem: EstimationProblem) -> int:
    """How many integration steps between samples simulate the readings within their noise."""
    least = problem.rules.stiff_steps if driven_states(problem.rig.twin.base) else 1
    theta = problem.prior.mean
    start = problem.first_states(theta)

    def simulated(number: int) -> Array:
        return replace(problem, substeps=number).equations(theta, start).simulated

    allowed = problem.rules.integration_error * problem.sigma
    least = refined(simulated, least, max(least, problem.substeps), allowed, ahead=2)
    return min(max(least, _moved(problem, start)), problem.rules.most_refinement * least)


def _moved(problem: EstimationProblem, start: Array) -> int:
    """Steps in which a bench moves no further than the shortest displacement over which friction builds up.

    A component has no motion of its own that takes steps; with longer ones, the states of friction diverge.
    """
    if not problem.rig.twin.is_fed:
        return 1
    motion = smooth(problem, problem.prior.mean, start)
    travel, rate = (np.abs(table).max(axis=0, initial=0.0) for table in (motion.displacement, motion.rate))
    parts = rate * problem.dt / np.maximum(SHORTEST * travel, 1e-300)
    return int(np.ceil(parts[travel > 0.0].max(initial=1.0)))


def finer(problem: EstimationProblem, found: Hypothesis, least: int) -> int:
    """How many steps simulate what was found: friction that turns round fast, a stop, a gap, a fast vibration.

    Steps are enough where four times as many change the readings by no more than `law_error` of their noise, or of what
    the law leaves where that is more: costs are compared in parts of it. The steps of the problem are tried first; the
    least are those of the model alone.
    """

    def begun(number: int) -> tuple[EstimationProblem, list[EffectInstance]]:
        fine = replace(problem, substeps=number)
        return fine, [*map(fine.in_steps, found.instances)]

    def simulated(number: int) -> Array:
        fine, instances = begun(number)
        return fine.equations(found.theta, found.start, instances, fitting.estimated(instances), frozen=True).simulated

    def residuals(number: int) -> Array:  # initial states that suit the steps may make up for them
        fine, instances = begun(number)
        return fitting.fit(fine, instances, theta=found.theta, start=found.start, frozen=True).residuals

    rules, left = problem.rules, np.maximum(problem.sigma, np.sqrt((found.residuals**2).mean(axis=0)))
    most, allowed = rules.most_refinement * least, rules.law_error * left
    enough = refined(simulated, problem.substeps, most, allowed, ahead=4)
    return enough if enough == problem.substeps else refined(residuals, problem.substeps, most, allowed, ahead=4)
