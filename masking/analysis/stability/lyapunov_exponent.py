"""The largest Lyapunov exponent of a model, by its variational equations, which are compiled with it.

    y' = f(t, y),    w' = J(t, y) w,    lambda = lim log |w(t)| / t,    J = df/dy

The tangent vector w is brought back to length 1 after each interval, and the logarithms of its growth are summed up.
Source: Benettin, Galgani, Giorgilli and Strelcyn, Meccanica 15 (1980) 9; Sprott, Chaos and Time-Series Analysis
(2003), section 5.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from masking.analysis.stability.variational_equations import Variational
from masking.compile.numerics.arrays import Array
from masking.display.printed_result import Printed
from masking.errors import ModelError
from masking.model.modelling.model import Model

INTERVALS = 2000  # that the record is cut into where no length is given
_BATCHES = 20  # whose spread gives the error
_GROWTH = 10.0  # e-folds in the second half; the tangent of a regular motion grows by 2 there, as t does
_SURE = 3.0  # standard errors
_OFF = 0.3  # of the e-folds by which neighbours part, those by which an unbounded motion grows


@dataclass(frozen=True, repr=False)
class Exponent(Printed):
    """The largest Lyapunov exponent of one motion."""

    value: float  # mean of log |w| per unit of time, after the transient
    error: float  # standard error of the mean, from batches of the record
    growth: Array  # log |w| gained in each interval (m,), after the transient
    spread: float  # log |y| gained in the second half of the record, by the motion itself

    @property
    def _late(self) -> float:
        return float(np.sum(self.growth[len(self.growth) // 2 :]))

    @property
    def is_bounded(self) -> bool:
        """Whether the motion does not go off as its neighbours do."""
        return self.spread < max(1.0, _OFF * self._late)

    @property
    def is_chaotic(self) -> bool:
        """Whether nearby motions part exponentially: further than regular ones do, and surely, yet go nowhere."""
        return self._late > _GROWTH and self.value > _SURE * self.error and self.is_bounded

    def as_dict(self) -> dict[str, Any]:
        """Exponent as JSON can hold it."""
        return {"value": self.value, "error": self.error, "chaotic": self.is_chaotic, "bounded": self.is_bounded}

    def __str__(self) -> str:
        kind = "chaotic" if self.is_chaotic else "not chaotic" if self.is_bounded else "unbounded"
        return f"{kind}: the largest Lyapunov exponent is {self.value:.4g} +- {self.error:.2g}"


def largest_exponent(
    model: Model,
    duration: float,
    initial: Mapping[str, float] | None = None,
    *,
    transient: float = 0.0,
    interval: float | None = None,
    inputs: Array | None = None,
    tolerance: float = 1e-9,
    progress: Callable[[float], None] | None = None,
) -> Exponent:
    """Largest Lyapunov exponent of a motion of a model, with constant inputs.

    Args:
        model: any model; driven ones may hold the time `t`.
        duration: over which it is averaged, in s or in units of the time scale. The error falls with its root.
        initial: as for `Model.simulate`.
        transient: time before that, in which the motion reaches its attractor and w its direction.
        interval: time after which w is brought back to length 1; by default a 2000th of the duration.
        inputs: constant inputs (k,); zero where not given.
        tolerance: local relative error of the integrator.
        progress: called with the part done.

    Raises:
        ModelError: the model has no states, or a time is not positive.
        IntegrationError: the motion could not be integrated.
    """
    step = duration / INTERVALS if interval is None else interval
    if not (duration > 0.0 and transient >= 0.0 and 0.0 < step <= duration / _BATCHES):
        raise ModelError(
            f"a Lyapunov exponent over {duration:g}, after {transient:g}, in intervals of {step:g}: all must be "
            f"positive, and the duration at least {_BATCHES} intervals"
        )
    before = math.ceil(transient / step)
    times = np.arange(before + round(duration / step) + 1, dtype=np.float64) * step
    states = model.initial_state(initial or {})[None]
    return exponent_along(model, times, states, before=before, inputs=inputs, tolerance=tolerance, progress=progress)


def exponent_along(
    model: Model,
    times: Array,
    states: Array,
    *,
    before: int = 0,
    inputs: Array | None = None,
    tolerance: float = 1e-9,
    progress: Callable[[float], None] | None = None,
) -> Exponent:
    """Largest Lyapunov exponent of a model along a motion that something else makes, such as a rig.

    Args:
        model: as for `largest_exponent`, as the errors are.
        times: instants (m + 1,) at which w is brought back to length 1, evenly spaced.
        states: of the motion at these instants (m + 1, 2 n + k), in SI units or in the model's scales; of the first
            alone (1, 2 n + k), the motion is the model's own.
        before: intervals that are left out of the mean.
        inputs: constant inputs (k,); zero where not given.
        tolerance: local relative error of the integrator.
        progress: called with the part done.
    """
    made, y, count = Variational(model, directions=1), states[0], len(times) - 1
    # A direction that is none of the axes: it has a part in every direction, that of fastest growth included.
    w: Array = np.array([[1.0 + 0.1 * i] for i in range(made.size)]) / math.sqrt(made.size or 1)
    growth, sizes = np.empty(count), np.empty(count)
    for i in range(count):
        y = states[i] if len(states) > 1 else y
        y, w = made.along((float(times[i]), float(times[i + 1])), y, w, u=inputs, tolerance=tolerance)
        length = float(np.linalg.norm(w))
        growth[i] = math.log(length) if length > 0.0 else -math.inf
        sizes[i] = np.linalg.norm(y)
        w /= length or 1.0
        if progress is not None and i % 100 == 0:
            progress(i / count)
    kept, step = growth[before:], float(times[1] - times[0])
    rates = np.array([float(np.mean(part)) for part in np.array_split(kept, _BATCHES)]) / step
    error = float(np.std(rates, ddof=1) / math.sqrt(_BATCHES))
    quarter = np.array_split(np.maximum(sizes[before:], 1e-300), 4)
    spread = math.log(float(np.max(quarter[3])) / float(np.max(quarter[1])))
    return Exponent(float(np.mean(kept)) / step, error, kept, spread)
