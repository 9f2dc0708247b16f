"""Periodic orbits by shooting, and whether they are stable: Floquet multipliers of the monodromy matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masking.analysis.stability.variational_equations import Variational
from masking.compile.numerics.arrays import Array, Complex
from masking.compile.numerics.newton import root
from masking.errors import IntegrationError, ModelError, RootError
from masking.model.modelling.model import Model

_MOST_STEPS = 30
_ERROR = 1e-10  # of the size of the orbit, in closing
_STILL = 1e-6  # of the size of a state: what moves less in a period is an equilibrium
_NEUTRAL = 1e-6  # from 1: a multiplier within this neither grows nor decays, to the accuracy of the integration


@dataclass(frozen=True)
class Orbit:
    """A periodic orbit."""

    state: Array  # y at its beginning (2 n + k,), in SI units or in the model's scales
    period: float  # T, in the same
    multipliers: Complex  # eigenvalues of the monodromy matrix Phi(T), the largest first; one of an orbit is always 1
    error: float  # |y(T) - y(0)|, of the size of the orbit

    @property
    def is_stable(self) -> bool | None:
        """Whether all multipliers but one 1 are inside the unit circle; None where others are on it."""
        size = np.sort(np.abs(self.multipliers))[::-1]
        if size[0] > 1.0 + _NEUTRAL:
            return False
        return None if np.sum(size > 1.0 - _NEUTRAL) > 1 else True

    @property
    def exponents(self) -> Array:
        """Floquet exponents: log |multiplier| / T, in 1/s or per unit of time."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.abs(self.multipliers)) / self.period, dtype=float)


def orbit(model: Model, state: Array, period: float, tolerance: float = 1e-12) -> Orbit:
    """Find a periodic orbit near a guess of y (2 n + k,) and T, by Newton's method on y(T; y0) = y0.

    The state and the period change as little as each step allows, so that one member of a family of orbits is found,
    near the guess. Multipliers are as true as Phi(T), whose error is some hundred times the tolerance of integration.

    Raises:
        ModelError: the equations hold the time, whose period cannot be changed.
        IntegrationError: no orbit is found near the guess.
    """
    if not model.is_autonomous:
        raise ModelError(
            f"the equations of {model.name} hold the time: orbits are looked for in autonomous models; make the drive "
            "two states of the model"
        )
    made = Variational(model)

    def size(x: Array) -> float:
        return max(float(np.max(np.abs(x[:-1]))), 1e-12)

    def gap(x: Array) -> tuple[Array, Array]:
        y, time, rate = x[:-1], float(x[-1]), np.empty(made.size)
        if not 0.2 * period < time < 5.0 * period:
            raise RootError(f"the period became {time:g}")
        end, phi = made.flow(y, time, tolerance)
        model.kernels.derivative(0.0, end, np.zeros(len(model.inputs)), model.values(), rate)
        if float(np.max(np.abs(rate))) * time < _STILL * size(x):
            raise RootError("the motion came to rest")
        return end - y, np.column_stack([phi - np.eye(made.size), rate])

    try:
        # Directions in which the orbit goes on to be one, such as along itself, are left as they are.
        x, _ = root(gap, np.append(state, period), error=lambda x: _ERROR * size(x), singular=1e-7, rounds=_MOST_STEPS)
    except RootError as error:
        raise IntegrationError(
            f"no periodic orbit of {model.name} is found near the period {period:g} (an equilibrium is none): give a "
            "state and a period nearer to one, such as the last state of a long simulation"
        ) from error
    end, phi = made.flow(x[:-1], float(x[-1]), tolerance)
    values = np.linalg.eigvals(phi)
    order = np.argsort(-np.abs(values))
    miss = float(np.max(np.abs(end - x[:-1])))
    return Orbit(x[:-1], float(x[-1]), np.asarray(values[order], dtype=np.complex128), miss / size(x))
