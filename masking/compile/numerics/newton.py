"""Newton's method for a root of a few equations, and slopes by differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RootError

STEP: Final = 1e-5  # of a difference quotient, relative to a length
CONVERGED: Final = 1e-12  # of a length: the last step of a search for an equilibrium
MOST_ROUNDS: Final = 50


class Root(NamedTuple):
    """A root (n,), and the slope (m, n) from which its last step was taken."""

    at: Array
    slope: Array


def root(
    system: Callable[[Array], tuple[Array, Array]],
    start: Array,
    *,
    error: float | Callable[[Array], float] = 0.0,
    lengths: Array | float = 1.0,
    last: float | None = None,
    longest: float = math.inf,
    singular: float | None = None,
    rounds: int = MOST_ROUNDS,
) -> Root:
    """Root that Newton's method reaches from a start; each step is the shortest that solves the linearised equations.

    Args:
        system: residual (m,) and its slope (m, n) of unknowns (n,).
        start: unknowns (n,).
        error: largest residual of a root; may depend on the unknowns.
        lengths: a size of each unknown (n,), the unit of the length of a step.
        last: length of a step that ends at a root whatever the residual.
        longest: length of a step; longer ones are shortened.
        singular: singular values of the slope below this part of the largest are taken as 0; by default those that
            rounding makes.
        rounds: most steps.

    Raises:
        RootError: the steps do not end, or reach what is not finite.
    """
    x = np.array(start, dtype=float)
    for _ in range(rounds):
        value, slope = system(x)
        if not (np.isfinite(value).all() and np.isfinite(slope).all()):
            break
        if np.abs(value).max(initial=0.0) <= (error(x) if callable(error) else error):
            return Root(x, slope)
        step = np.linalg.lstsq(slope, -value, rcond=singular)[0]
        length = float(np.max(np.abs(step) / lengths))
        x = x + step * min(1.0, longest / length) if length > 0.0 else x
        if last is not None and length <= last:
            return Root(x, slope)
    largest = float(np.max(np.abs(value)))
    raise RootError(f"Newton's method ended at {x.tolist()}, where the residual is {largest:.3g}")


def jacobian(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Slope (m, n) of a function (m,) at (n,), by central differences with steps (n,) on both sides."""
    shifts = np.diag(steps)
    columns = [(function(at + d) - function(at - d)) / (2.0 * step) for d, step in zip(shifts, steps, strict=True)]
    return np.array(columns).T


def equilibrium(accelerations: Callable[[Array], Array], lengths: Array) -> Array:
    """Coordinates (n,) whose accelerations at rest (n,) are 0, that Newton's method reaches from 0.

    `lengths` are sizes of the coordinates (n,). Raises a `RootError` if it reaches none.
    """

    def system(q: Array) -> tuple[Array, Array]:
        return accelerations(q), jacobian(accelerations, q, STEP * lengths)

    return root(system, np.zeros(len(lengths)), lengths=lengths, last=CONVERGED).at
