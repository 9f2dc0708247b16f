"""Fitting: the rig with effects at some places, brought as near to its records as its parameters let it.

The parameters of the rig are held near their declared values by how far these may be off; the initial state of each
window of the record is estimated. Source: as `masking.estimation.fit`, with a normal prior.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from masking.discovery import laws
from masking.discovery.augmented_model import Equations, Slot
from masking.discovery.problem import Evidence
from masking.errors import IntegrationError
from masking.numerics.arrays import Array

MOST_ROUNDS = 40
MORE = 10.0  # times the damping after a step in vain, and so many times that after each further one
GROWTH = 2.0  # times what is positive may become in a round
HOPE, SLOW = 0.03, 6  # a fit ends that comes nearer to a better one by no more than this part so many times
CONVERGED = 0.02  # of the cost, divided by the tempering, that a step may still take off


@dataclass(frozen=True)
class Hypothesis:
    """The rig with effects, fitted.

    Args:
        slots: the effects with fitted values.
        theta: parameters of the rig (k,).
        start: initial state of each window (windows, states).
        cost: -2 log likelihood and belief, up to a constant: squared residuals over their variance.
        squares: of each sensor (sensors,).
        covariance: of rig's parameters and free parameters of the effects (k + f, k + f).
        residuals: of each sample (m, sensors).
    """

    slots: tuple[Slot, ...]
    theta: Array
    start: Array
    cost: float
    squares: Array
    covariance: Array
    residuals: Array

    @property
    def added(self) -> Array:
        """Return the free parameters of the effects (f,)."""
        return estimated(self.slots)

    @property
    def deviations(self) -> Array:
        """Return the standard deviations of rig's parameters and of those of the effects (k + f,)."""
        found: Array = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return found


def estimated(slots: Sequence[Slot]) -> Array:
    """Return the values of the estimated parameters of slots, one after the other (f,)."""
    return np.array([value for slot in slots for value in slot.estimated])


def fit(
    evidence: Evidence,
    slots: Sequence[Slot] = (),
    *,
    theta: Array | None = None,
    start: Array | None = None,
    rounds: int = MOST_ROUNDS,
    frozen: bool = False,
    rival: float = np.inf,
) -> Hypothesis:
    """Fit a rig with effects to a record.

    Args:
        evidence: the record and the rig.
        slots: effects with values to begin from.
        theta: parameters to begin from; those believed where none are given.
        start: initial states to begin from (windows, states); from the first readings where none are given.
        rounds: most rounds.
        frozen: whether only the initial state is estimated.
        rival: cost of another hypothesis; where this one does not come near it any more, it is left as it is.

    Raises:
        IntegrationError: the motion is not finite from where it begins.
    """
    x = evidence.belief.mean.copy() if theta is None else theta.copy()
    state = first_states(evidence, x) if start is None else start.copy()
    problem = _Problem(evidence, tuple(slots))
    return problem.solve(
        _Point(x, estimated(slots), np.zeros(len(problem.begins)), state), rounds, frozen=frozen, rival=rival
    )


def together(evidence: Evidence, other: Evidence, known: Hypothesis, rival: float = np.inf) -> Hypothesis:
    """Fit a hypothesis to its own record and to another one at once, from where the first has left it.

    Args:
        evidence: of its own record.
        other: of the other one, with its own initial states.
        known: the hypothesis, fitted to its own record.
        rival: as in `fit`.

    Returns:
        The hypothesis; its initial states are those of both, its residuals those of its own record.

    Raises:
        IntegrationError: the motion is not finite.
    """
    problem = _Problem(evidence, known.slots, (other,))
    start = np.concatenate([known.start, first_states(other, known.theta)])
    at = _Point(known.theta, known.added, np.zeros(len(problem.begins)), start)
    return problem.solve(at, MOST_ROUNDS, frozen=False, rival=rival)


def judged(evidence: Evidence, hypothesis: Hypothesis) -> Hypothesis:
    """Return a hypothesis on a record that judges: only its initial state is estimated."""
    return fit(evidence, hypothesis.slots, theta=hypothesis.theta, frozen=True)


def cost(evidence: Evidence, slots: Sequence[Slot], theta: Array, start: Array) -> float:
    """Return the cost of a hypothesis that is not fitted; infinite where its motion is not finite."""
    problem = _Problem(evidence, tuple(slots))
    at = _Point(theta, estimated(slots), np.zeros(len(problem.begins)), start)
    try:
        return problem.cost(problem.equations(at), at)
    except IntegrationError:
        return np.inf


def first_states(evidence: Evidence, theta: Array, samples: int = 20) -> Array:
    """Return a first guess of initial states (windows, states), from straight lines through the first readings."""
    rig, record = evidence.rig, evidence.record
    n, acting = len(rig.coordinates), record.acting
    seen = [i for i in rig.twin.free if not n <= i < 2 * n]
    found = np.tile(rig.rest, (evidence.windows, 1))
    for i, state in enumerate(found):
        begin = i * evidence.begin
        early = min(begin, max(len(record) - samples, 0))  # the line of a short last window begins before it
        read = record.readings[early:][:samples]
        times = (np.arange(len(read)) + early - begin) / record.rate
        slope, first = np.polynomial.polynomial.polyfit(times, read, 1)[::-1]
        told, sensing = rig.reading(theta, rig.rest, acting[begin])
        back = np.linalg.pinv(sensing[:, seen])
        state[seen] += back @ (first - told)
        state[n : 2 * n] = back[:n] @ slope
    return found


@dataclass(frozen=True)
class _Point:
    """Values of all that is estimated: the rig's parameters, the effects', where their states and the motion begin."""

    theta: Array
    added: Array
    inner: Array
    start: Array

    def moved(self, step: Array, low: Array, high: Array, free: Sequence[int]) -> _Point:
        """Return the point after a step, with parameters (k + f,) within their bounds."""
        k, f, s = len(self.theta), len(self.added), len(self.inner)
        start = self.start.copy()
        start[:, free] += step[k + f + s :].reshape(len(start), len(free))
        theta = within(self.theta, step[:k], low[:k], high[:k])
        added = restrained(self.added, step[k : k + f], low[k:], high[k:])
        return _Point(theta, added, self.inner + step[k + f : k + f + s], start)


@dataclass(frozen=True)
class _Problem:
    evidence: Evidence
    slots: tuple[Slot, ...]
    others: tuple[Evidence, ...] = ()

    @property
    def records(self) -> tuple[Evidence, ...]:
        """Return the evidence of each record."""
        return (self.evidence, *self.others)

    @cached_property
    def begins(self) -> Array:
        """Return how far from 0 the states of effects may begin, in one record after the other (s,)."""
        return np.tile([size for slot in self.slots for size in slot.begins], len(self.records))

    def solve(self, at: _Point, rounds: int, *, frozen: bool, rival: float) -> Hypothesis:
        k, f, s, free = len(at.theta), len(at.added), len(at.inner), [*self.evidence.rig.twin.free]
        held = np.zeros(k + f + s + len(at.start) * len(free), dtype=bool)
        held[: k + f], held[k + f : k + f + s] = frozen, self.begins == 0.0
        slow, damping, more = 0, 1e-6, MORE
        found = self.equations(at)
        cost = self.cost(found, at)
        low, high = self._bounds()
        for _ in range(rounds):
            matrix, gradient = self._with_belief(found, at)
            step, gain = _step(matrix, gradient, damping, held)
            enough = CONVERGED * self.evidence.tempering(self.evidence.record.readings - found.simulated)
            if gain < enough:
                break
            then = at.moved(step, low, high, free)
            try:
                tried = self.equations(then)
                new = self.cost(tried, then)
            except IntegrationError:
                new = np.inf
            slow = slow + 1 if cost > rival and cost - new < HOPE * (cost - rival) else 0
            if slow == SLOW:
                break
            if new < cost:
                at, found = then, tried
                taken, cost = cost - new, new
                damping, more = damping if more > MORE else max(damping / 10.0, 1e-9), MORE
                if taken < enough:
                    break
            else:
                damping, more = damping * more, MORE * more  # a step that is far too long is soon far shorter
                if damping > 1e8:
                    break
        matrix, _ = self._with_belief(found, at)
        left = iter(at.added)
        values = [slot.with_values(slot.free, itertools.islice(left, len(slot.free))) for slot in self.slots]
        return Hypothesis(
            tuple(values), at.theta, at.start, cost, found.squares, _covariance(matrix)[: k + f, : k + f],
            self.evidence.record.readings - found.simulated,
        )  # fmt: skip

    def equations(self, at: _Point) -> Equations:
        starts = np.cumsum([one.windows for one in self.records])[:-1]
        return _joined(
            [
                one.equations(at.theta, start, self.slots, at.added, inner=inner)
                for one, start, inner in zip(
                    self.records, np.split(at.start, starts), np.split(at.inner, len(self.records)), strict=True
                )
            ],
            len(at.theta) + len(at.added),
            len(at.inner) // len(self.records),
            [one.weights / self.evidence.weights for one in self.records],
        )

    def cost(self, found: Equations, at: _Point) -> float:
        off = (at.theta - self.evidence.belief.mean) / self.evidence.belief.deviation
        begun = at.inner[self.begins > 0.0] / self.begins[self.begins > 0.0]
        return float(found.squares @ self.evidence.weights + off @ off + begun @ begun)

    def _with_belief(self, found: Equations, at: _Point) -> tuple[Array, Array]:
        matrix, gradient = found.matrix.copy(), found.gradient.copy()
        k, first = len(at.theta), len(at.theta) + len(at.added)
        believed = np.zeros(len(matrix))
        believed[:k] = self.evidence.belief.deviation**-2.0
        believed[first : first + len(self.begins)] = np.where(self.begins > 0.0, self.begins, np.inf) ** -2.0
        matrix += np.diag(believed)
        gradient[:k] += (self.evidence.belief.mean - at.theta) * believed[:k]
        gradient[first : first + len(at.inner)] -= at.inner * believed[first : first + len(at.inner)]
        return matrix, gradient

    def _bounds(self) -> tuple[Array, Array]:
        pairs = [pair for slot in self.slots for pair in bounds(slot)]
        belief, low, high = self.evidence.belief, [a for a, _ in pairs], [b for _, b in pairs]
        return np.array([*belief.low, *low]), np.array([*belief.high, *high])


def _joined(parts: Sequence[Equations], shared: int, inner: int, weights: Sequence[Array]) -> Equations:
    """Return the equations of several records as those of one.

    Args:
        parts: of each record.
        shared: columns that all have, the first.
        inner: columns of states inside of effects, which come next; each record has its own.
        weights: of squared residuals, beside those of the first record (sensors,).
    """
    if len(parts) == 1:
        return parts[0]
    sizes = [len(part.gradient) - shared - inner for part in parts]
    ends = shared + inner * len(parts) + np.cumsum([0, *sizes])
    matrix, gradient = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    for i, part in enumerate(parts):
        first = shared + i * inner
        own = np.concatenate([np.arange(shared), np.arange(first, first + inner), np.arange(ends[i], ends[i + 1])])
        matrix[np.ix_(own, own)] += part.matrix
        gradient[own] += part.gradient
    squares = np.sum([part.squares * weight for part, weight in zip(parts, weights, strict=True)], axis=0)
    return Equations(matrix, gradient, squares, parts[0].simulated)


def within(values: Array, step: Array, low: Array, high: Array) -> Array:
    """Return values after a step that goes at most 0.7 of the way to a bound."""
    least = np.where(np.isfinite(low), values - 0.7 * np.abs(values - low), -np.inf)
    most = np.where(np.isfinite(high), values + 0.7 * np.abs(high - values), np.inf)
    found: Array = np.clip(values + step, least, most)
    return found


def restrained(values: Array, step: Array, low: Array, high: Array) -> Array:
    """Return values after a step within bounds that doubles at most what is positive."""
    most = np.where((low >= 0.0) & (values > 0.0), GROWTH * values, np.inf)
    return np.minimum(within(values, step, low, high), most)


def bounds(slot: Slot) -> list[tuple[float, float]]:
    """Return the least and largest value of each free parameter of a slot; infinite where there is none."""
    if slot.effect == laws.DELAY:
        return [(0.0, np.inf)]
    every = list(slot.entry.parameters.values())
    return [
        (-np.inf if low is None else low, np.inf if high is None else high)
        for low, high in (every[i].bounds for i in slot.free)
    ]


def _step(matrix: Array, gradient: Array, damping: float, held: NDArray[np.bool_]) -> tuple[Array, float]:
    """Return the step of Levenberg and Marquardt, and what it should take off the cost."""
    free = np.flatnonzero(~held)
    scale = np.sqrt(np.maximum(np.diag(matrix)[free], 1e-300))
    scaled = matrix[np.ix_(free, free)] / np.outer(scale, scale)
    right = gradient[free] / scale
    found = np.linalg.lstsq(scaled + damping * np.eye(len(free)), right, rcond=1e-13)[0]
    step = np.zeros(len(gradient))
    step[free] = found / scale
    return step, float(right @ found)


def _covariance(matrix: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    found: Array = np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True, rcond=1e-13) / np.outer(scale, scale)
    return found
