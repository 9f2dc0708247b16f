"""Settling: how long a simulated system takes to synchronise, by definition 8.1."""

from __future__ import annotations

import numpy as np

from masking.analysis.stability.modes import pair_of
from masking.analysis.synchronisation import synchronisation_time
from masking.errors import ModelError
from masking.model.modelling.model import Model

_SAMPLES_PER_RADIAN = 20.0


def settling_time(
    model: Model, *, eps: float = 1e-4, longest: float = 2e4, fastest: float = 2.0, tolerance: float = 1e-11
) -> float:
    """Tau_s from the declared initial state: the first time after which |a + b| stays below eps, of two oscillators.

    Times are in units of the model's time; NaN where |a + b| was not below eps, which is in SI units or in the model's
    scales, over the last half of the `longest` time that is simulated. `fastest`, the largest frequency of the motion
    in rad per unit of time, sets the sampling.

    Raises:
        ModelError: there are not two oscillators, or `longest` is not positive.
        IntegrationError: the integrator could not go on.
    """
    first, second = pair_of(model)
    if not longest > 0.0:
        raise ModelError(f"the longest time is {longest:g}; it must be positive")
    length = min(longest, 100.0)
    while True:
        times = np.linspace(0.0, length, round(length * fastest * _SAMPLES_PER_RADIAN) + 1)
        run = model.simulate(times, tolerance=tolerance)
        found = synchronisation_time(run.times, run[first] + run[second], eps)
        if found <= 0.5 * length:  # it has stayed below for as long again
            return found
        if length >= longest:
            return float("nan")
        length = min(2.0 * length, longest)
