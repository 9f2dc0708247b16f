"""Initial states: a first guess from the readings, and their sizes."""

from __future__ import annotations

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.smoothing import fastest
from masking.inference.estimation.simulation import guessed_state


def first(problem: EstimationProblem, theta: Array, samples: int = 20) -> Array:
    """First guess of initial states (w, states), from straight lines through some samples of the first readings."""
    rig, record, acting = problem.rig, problem.record, problem.record.acting
    found = []
    for begin in range(0, len(record), problem.interval_samples):
        early = min(begin, max(len(record) - samples, 0))  # the line of a short last interval begins before it
        read = record.readings[early:][:samples]
        times = (np.arange(len(read)) + early - begin) / record.rate
        at_rest = rig.reading(theta, rig.rest, acting[begin])
        found.append(guessed_state(rig.rest, at_rest, rig.twin.free, times, read, n=len(rig.coordinates), degree=1))
    return np.array(found)


def sizes(problem: EstimationProblem) -> Array:
    """Sizes of states by the largest readings (states,); 0 of those that no sensor sees."""
    rig, mean, record = problem.rig, problem.prior.mean, problem.record
    n, (at_rest, jacobian) = len(rig.coordinates), rig.reading(mean, rig.rest, record.acting[0])
    found = np.abs(decompositions.inverse(jacobian)) @ np.abs(record.readings - at_rest).max(axis=0)
    found[n : 2 * n] = np.maximum(found[n : 2 * n], abs(fastest(rig, mean)) * found[:n])
    return np.asarray(found)
