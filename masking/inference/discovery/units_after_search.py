"""Units after a search: what was found may stand for another unit or sign of a channel than is declared.

A law that the model lacks may hide that. So a unit is suspected where what was found needs a gain or a parameter that
is several times what is declared, or is unknown, and readings and simulation are of one size in another unit: the
record is searched in that one as well.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError
from masking.inference.discovery import continuation, fitting
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.verdict import Key
from masking.inference.estimation import unit_check
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.unit_check import FAR, STEPS, UnitDoubt
from masking.model.effects import GAINS_AND_ZEROS

GAINS = {name for name in GAINS_AND_ZEROS if name.endswith("gain")}
LIKE = 1.2  # times the factor between units, up to which a gain is like it: a law may be mistaken for the rest


def doubted(problem: EstimationProblem) -> UnitDoubt | None:
    """Unit that is probably another than declared, before a search; None where none is."""
    return unit_check.doubted(problem.rig.twin, problem.record, partial(_residuals, problem))


def suspected(problem: EstimationProblem, found: Hypothesis) -> UnitDoubt | None:
    """Unit that makes readings and simulation one size, which they are not in the declared one; or None.

    A law may change the size of a motion by itself: a gain that is as large as a factor between units counts, too. What
    explains the record in the declared unit is known; the problem is simulated whole.
    """
    twin, record = problem.rig.twin, problem.record
    otherwise, compare = far_off(problem, found), unit_check.comparison(record, partial(_residuals, problem))
    every = (replace(one, otherwise=otherwise) for one in unit_check.others(twin, record) if one.kind != "clock")
    before, size = compare(record)
    tried = [*unit_check.tried(twin, record, every, compare, before)]
    best, least = unit_check.best_of(tried)
    return best if best and FAR * least < size else next((one for one, _ in tried if is_gain(one)), None)


def is_gain(doubt: UnitDoubt) -> bool:
    """Whether a record needs a gain of the one channel that is about the factor of its unit."""
    gains = {on: times for (_, on), times in doubt.otherwise if on and times}
    known = gains if doubt.kind == "actuator" else {on: 1.0 / times for on, times in gains.items()}
    by = known.get(doubt.names[0], 0.0) / doubt.factor if len(doubt.names) == 1 else 0.0
    return 1.0 / LIKE < by < LIKE


def far_off(problem: EstimationProblem, found: Hypothesis) -> tuple[tuple[Key, float], ...]:
    """Gains (effect, place) and parameters (name, '') that are several times what is declared, and how many."""
    prior, names = problem.prior, problem.rig.names
    pairs = [((one.effect, one.at), 1.0 + one.values[0]) for one in found.instances if one.effect in GAINS]
    for name, value, mean, deviation in zip(names, found.theta, prior.mean, prior.deviation, strict=False):
        if mean and abs(value - mean) > problem.rules.chance_deviations * deviation:
            pairs.append(((name, ""), float(value / mean)))
    return tuple((key, times) for key, times in pairs if not 1.0 / FAR < times < FAR)


def converted(doubt: UnitDoubt, problem: EstimationProblem) -> EstimationProblem:
    """Problem with the channels in the declared unit."""
    twin, sigma = problem.rig.twin, problem.sigma.copy()
    if doubt.kind == "sensor":
        sigma[[twin.sensors.index(name) for name in doubt.names]] *= abs(doubt.factor)
    record = doubt.of(twin, problem.record)
    steps = _steps(problem, record) if doubt.kind == "clock" else problem.substeps
    return replace(problem, record=record, sigma=sigma, substeps=steps)


def _steps(problem: EstimationProblem, record: Data) -> int:
    return min(max(1, problem.rig.twin.substeps(record.rate) // 2), STEPS)


def _residuals(problem: EstimationProblem, record: Data) -> Array | None:
    """Residuals of the model as declared along a record, its initial state fitted; None if its motion is not finite."""
    mean = problem.prior.mean
    here = replace(
        problem, record=record, sigma=np.maximum(record.readings.std(axis=0), 1e-300), substeps=_steps(problem, record)
    )
    try:
        begun = fitting.Begun((), mean, here.first_states(mean))
    except IntegrationError:
        return None
    made = fitting.solved(here, begun, rounds=continuation.ROUNDS, frozen=True)
    return None if made is None else made.residuals
