"""Least squares: the Levenberg-Marquardt method on normal equations, with a normal prior and bounds.

A problem is linearised at values x of its unknowns; each step solves (J^T W J + damping diag(J^T W J)) s = J^T W r.
Source: Nocedal and Wright, Numerical Optimization (2006), section 10.3; Marquardt, SIAM J. Appl. Math. 11 (1963),
431-441, for the scaling; Bock (1981) for the condensing of the initial states of shooting intervals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError, IntegrationError, ModelError

SINGULAR = 1e-13  # of the largest singular value of the scaled matrix: what is smaller is rounding
TOWARDS = 0.7  # of the way to a bound that a step may go: values stay inside
HELD = 1e-9  # of a step: a bound that takes more of it determines it
GROWTH = 2.0  # times its size that a positive value may take in a step
DIFFERENCE = 1e-5  # of the size of an unknown: differences of residuals are then right to 1e-10 of their size
SMALL = 1e-8  # of the cost: a smaller reduction ends a fit whose derivatives are differences


@dataclass(frozen=True)
class System:
    """Normal equations that a damped step can be found from."""

    matrix: Array  # J^T W J (n, n)
    gradient: Array  # J^T W r (n,), of the residuals r
    fixed: NDArray[np.bool_] | None = None  # unknowns that are not estimated (n,); none by default
    resistance: Array | None = None  # what a step adds to the diagonal of the matrix (n,); nothing by default
    # unknowns (s) that alone connect the others, which are in blocks and all estimated; all by default
    shared: int | None = None
    block: int = 1  # unknowns in each block

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite: those of a motion that runs away are not."""
        return bool(np.isfinite(self.matrix).all() and np.isfinite(self.gradient).all())

    def with_prior(self, off: Array, deviation: Array) -> System:
        """Equations with a normal prior: mean less value (n,), and its deviation (n,), infinite where there is none."""
        weights = deviation**-2.0
        return replace(self, matrix=self.matrix + np.diag(weights), gradient=self.gradient + off * weights)

    def step(self, damping: float, held: Array | None = None) -> tuple[Array, float]:
        """Step of all unknowns (n,), and the reduction of the cost that it should give.

        `damping` is relative to the diagonal; `held` (b,) are steps of the first unknowns that bounds determine, not a
        number where they do not.
        """
        step = np.full(len(self.gradient), np.nan)
        if held is not None:
            step[: len(held)] = held
        if self.fixed is not None:
            step[self.fixed] = 0.0
        free = np.flatnonzero(np.isnan(step))
        step[free] = 0.0
        right = (self.gradient - self.matrix @ step)[free]
        matrix = self.matrix if self.resistance is None else self.matrix + np.diag(self.resistance)
        shared = None if self.shared is None else int((free < self.shared).sum())
        step[free] = _scaled_solution(matrix[np.ix_(free, free)], right, damping, shared, self.block)
        return step, float(self.gradient @ step)

    def covariance(self) -> Array:
        """Covariance of the shared unknowns (s, s), infinite where the equations cannot be inverted."""
        scale = _scale(self.matrix)[: self.shared]
        try:
            scaled = self.information() / np.outer(scale, scale)
            inverse = decompositions.inverse(scaled, SINGULAR, hermitian=True)
        except IntegrationError:
            return np.full((len(scale), len(scale)), np.inf)
        with np.errstate(over="ignore"):  # of an unknown that changes nothing but the last bits
            return np.asarray(inverse / scale[:, None] / scale)

    def information(self) -> Array:
        """Information on the shared unknowns (s, s) if the others are unknown: the Schur complement."""
        if self.shared is None:
            return self.matrix
        scale = _scale(self.matrix)
        scaled, right = self.matrix / np.outer(scale, scale), np.zeros(len(scale))
        shared = scale[: self.shared]
        return _condensed(scaled, right, self.shared, self.block)[0] * np.outer(shared, shared)


T = TypeVar("T")


@dataclass(frozen=True)
class Linearised(Generic[T]):
    """A problem at values of its unknowns: the cost, the normal equations, and by-products of these.

    Making it raises an `IntegrationError` where the equations are not finite.
    """

    cost: float
    equations: System
    extra: T

    def __post_init__(self) -> None:
        if not self.equations.is_finite:
            raise IntegrationError("the derivatives of the motion by the parameters or initial states are not finite")


@dataclass(frozen=True)
class Box:
    """Bounds of the first unknowns; the others have none."""

    # low, high: least and largest values (b,); infinite if there is none
    low: Array
    high: Array
    # whether a value that is positive by its bounds may at most double in a step (b,)
    growing: NDArray[np.bool_] | bool = False

    def after(self, x: Array, step: Array) -> Array:
        """Values (n,) after a step that goes at most `TOWARDS` of the way to a bound, never away from it."""
        farther, count = x + step, len(self.low)
        x = x[:count]
        least = np.where(np.isfinite(self.low), x - TOWARDS * np.maximum(x - self.low, 0.0), -np.inf)
        most = np.where(np.isfinite(self.high), x + TOWARDS * np.maximum(self.high - x, 0.0), np.inf)
        doubled = np.where(self.growing & (self.low >= 0.0) & (x > 0.0), GROWTH * x, np.inf)
        farther[:count] = np.minimum(np.clip(farther[:count], least, most), doubled)
        return farther

    def held(self, step: Array, taken: Array) -> Array | None:
        """Steps of the first unknowns that bounds determine (b,), not a number for others; None if none are.

        `step` is that without bounds (n,), `taken` that within them (n,).
        """
        count = len(self.low)
        is_held = np.abs(taken - step)[:count] > HELD * np.abs(step[:count])
        return np.where(is_held, taken[:count], np.nan) if is_held.any() else None


NO_BOUNDS = Box(np.empty(0), np.empty(0))


@dataclass(frozen=True)
class Damping:
    """Damping of a step, relative to the diagonal of the matrix, and how it goes on.

    It falls tenfold after a success that follows a success. After steps in vain it rises 10, 100, 1000 ... times: a
    step that is far too long is soon far shorter.
    """

    value: float  # of the next step
    least: float  # that it falls to
    most: float  # beyond which no shorter step is tried
    vain: int = 0  # steps in vain in a row

    def after(self, *, success: bool) -> Damping:
        """Damping of the next step."""
        if not success:
            return replace(self, value=self.value * 10.0 ** (self.vain + 1), vain=self.vain + 1)
        return replace(self, value=self.value if self.vain else max(self.value / 10.0, self.least), vain=0)


@dataclass(frozen=True)
class Patience:
    """Rule by which a fit is abandoned."""

    # reduction of a cost that is expected of a step without damping; below it the method gives up
    least: Callable[[float], float] = lambda cost: -np.inf
    # whether to give up, from the cost, that of the step that was tried, infinite if it failed, and the reduction that
    # is expected of a step without damping
    is_hopeless: Callable[[float, float, float], bool] = lambda cost, tried, expected: False


@dataclass(frozen=True)
class Minimum(Generic[T]):
    """Where the method ended: values (n,), the problem there, rounds, and whether it stopped by itself."""

    x: Array
    at: Linearised[T]
    rounds: int
    converged: bool


def minimise(
    linearise: Callable[[Array], Linearised[T]],
    x: Array,
    box: Box,
    damping: Damping,
    *,
    rounds: int,
    tolerance: Callable[[Linearised[T]], float],
    patience: Patience | None = None,
    progress: Callable[[float], None] | None = None,
) -> Minimum[T]:
    """Minimise a sum of squares by the Levenberg-Marquardt method.

    Args:
        linearise: gives the problem at values of the unknowns; raises if it has none there.
        x: values to begin from (n,).
        box: bounds.
        damping: to begin with.
        rounds: most steps that are tried.
        tolerance: reduction of the cost below which the method stops, at a linearised problem.
        patience: when to give up before; never by default.
        progress: called with the part done.

    Raises:
        IntegrationError: the problem has no value at x.
    """

    def attempted(values: Array) -> Linearised[T]:
        try:
            return linearise(values)
        except (IntegrationError, ModelError, DeclarationError):
            return replace(at, cost=np.inf)

    at, number, is_last = linearise(x), 0, False
    for number in range(1, rounds + 1):
        if progress is not None:
            progress((number - 1) / rounds)
        whole = at.equations.step(damping.least)[1] if patience is not None else np.inf
        is_vain = patience is not None and whole < patience.least(at.cost)
        step, gain = at.equations.step(damping.value)
        enough = tolerance(at)
        if gain < enough and damping.value > damping.least and not is_last:
            # A direction in which the cost hardly bends is damped, however far its minimum is.
            damping, is_last = replace(damping, value=damping.least), True
            step, gain = at.equations.step(damping.value)
        if gain < enough or is_vain:
            return Minimum(x, at, number, converged=True)
        farther = box.after(x, step)
        tried = attempted(farther)
        held = None if tried.cost < at.cost else box.held(step, farther - x)
        if held is not None:  # the others take the step that suits what bounds leave of these
            step, gain = at.equations.step(damping.value, held)
            if gain < enough:
                return Minimum(x, at, number, converged=True)
            farther = box.after(x, step)
            tried = attempted(farther)
        if patience is not None and patience.is_hopeless(at.cost, tried.cost, whole):
            return Minimum(x, at, number, converged=True)
        success = tried.cost < at.cost
        damping = damping.after(success=success)
        if success:
            taken, x, at = at.cost - tried.cost, farther, tried
            if taken < enough and (is_last or damping.value <= damping.least):
                return Minimum(x, at, number, converged=True)
        elif damping.value > damping.most:
            return Minimum(x, at, number, converged=True)
    return Minimum(x, at, number, converged=False)


def minimise_residuals(
    residuals: Callable[[Array], Array], x: Array, box: Box, *, sizes: Array, rounds: int = 30
) -> Minimum[Array]:
    """Minimum of a sum of squares whose derivatives are differences; the residuals come along.

    `residuals` gives them (r,) at values of the unknowns (n,), from `x` on; `sizes` (n,) are those of changes of the
    unknowns, over a small part of which differences are taken; `rounds` is how many steps are tried at most.
    """
    steps = DIFFERENCE * sizes

    def linearise(values: Array) -> Linearised[Array]:
        left = residuals(values)
        ahead, behind = ([residuals(values + sign * h) for h in np.diag(steps)] for sign in (1.0, -1.0))
        jacobian = (np.array(behind) - np.array(ahead)).T / (2.0 * steps)  # of the model: residuals fall as it grows
        return Linearised(float(left @ left), System(jacobian.T @ jacobian, jacobian.T @ left), left)

    return minimise(linearise, x, box, Damping(1e-3, 1e-12, 1e10), rounds=rounds, tolerance=lambda at: SMALL * at.cost)


def _scale(matrix: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diag(matrix), 1e-300)))


def _scaled_solution(matrix: Array, right: Array, damping: float, shared: int | None = None, block: int = 1) -> Array:
    """Damped solution (n,) with a diagonal scaled to 1; blocks after shared unknowns are condensed."""
    if not len(right):
        return right
    scale = _scale(matrix)
    scaled, sides = matrix / np.outer(scale, scale) + damping * np.eye(len(right)), right / scale
    if shared is None:
        return decompositions.least_squares(scaled, sides, SINGULAR) / scale
    condensed, left, others = _condensed(scaled, sides, shared, block)
    first = decompositions.least_squares(condensed, left, SINGULAR)
    return np.concatenate([first, (others[..., -1] - others[..., :-1] @ first).ravel()]) / scale


def _condensed(matrix: Array, right: Array, shared: int, block: int) -> tuple[Array, Array, Array]:
    """Equations of the shared unknowns alone: their matrix (s, s) and right side (s,).

    The last of what is returned (w, b, s + 1) are, of each block with unknowns x = d - C y for the shared ones y, C
    and d. Source: Bock (1981).
    """
    count = (len(right) - shared) // block
    each, cross = np.arange(count), matrix[shared:, :shared].reshape(count, block, shared)
    squares = matrix[shared:, shared:].reshape(count, block, count, block)[each, :, each]
    sides = np.concatenate([cross, right[shared:].reshape(count, block, 1)], axis=2)
    others = decompositions.inverse(squares, SINGULAR, hermitian=True) @ sides
    taken = np.tensordot(cross, others, axes=([0, 1], [0, 1]))
    return matrix[:shared, :shared] - taken[:, :-1], right[:shared] - taken[:, -1], others
