"""Initial states: how a record begins by its first readings, a guess and the prior of what is estimated.

The first readings are described by a parabola. What it says of their values and rates is a normal prior of the initial
state: a coordinate that is read begins where it is read and as fast as readings change. The deviations are those of one
reading, or one difference of two, from the parabola, which is more than its error: a fit that the readings determine
is left alone, and a velocity that they hardly show, such as one that friction takes at once, does not go anywhere.
 Source: Gelb, Applied Optimal Estimation (1974), section 4.1, for the maximum a posteriori estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.inference.estimation.identification_data import Data

Reading = Callable[[Array, Array], tuple[Array, Array]]

ALLOWED = 2.0  # deviations of the prior within which a state that all readings determine is taken
FIRST_READINGS = 20  # the window: readings that tell how a record begins


@dataclass(frozen=True)
class InitialPrior:
    """Normal prior of an initial state y: `rows` @ y is `targets` within `deviations`."""

    rows: Array  # (r, states)
    targets: Array  # (r,)
    deviations: Array  # (r,)

    @property
    def information(self) -> Array:
        """Inverse covariance (states, states), of rank r at most."""
        return np.asarray((self.rows.T / self.deviations**2) @ self.rows)

    def allows(self, state: Array) -> bool:
        """Whether a state (states,) is within `ALLOWED` deviations, in the rms."""
        return bool(self.off(state)[0] <= ALLOWED**2 * len(self.targets))

    def without(self) -> InitialPrior:
        """The same where nothing is known."""
        return InitialPrior(self.rows[:0], self.targets[:0], self.deviations[:0])

    def off(self, state: Array) -> tuple[float, Array]:
        """Cost of a state (states,), and minus half its gradient (states,)."""
        off = (self.targets - self.rows @ state) / self.deviations
        return float(off @ off), np.asarray(self.rows.T @ (off / self.deviations))


def prior(reading: Reading, state: Array, record: Data, noise: Array, n: int) -> InitialPrior:
    """Prior of the initial state of a record by its first readings.

    Readings that coordinates alone make tell their velocities; readings that a command changes at once tell nothing.

    Args:
        reading: readings (sensors,) in a state and under commands, and their derivatives (sensors, states) by it.
        state: a state nearby (states,), at which readings are made linear.
        record: commands and readings.
        noise: standard deviation of each reading (sensors,).
        n: number of coordinates, which are the first states; their velocities are the next.
    """
    first, commands = record.readings[:FIRST_READINGS], record.acting[0]
    read, jacobian = reading(state, commands)
    if len(first) < 3:  # a parabola says nothing
        return InitialPrior(np.zeros((0, len(state))), np.zeros(0), np.ones(0))
    t = np.arange(len(first)) / record.rate
    curve = np.polynomial.polynomial.polyfit(t, first, 2)
    apart = first - np.polynomial.polynomial.polyval(t, curve).T
    varied = record.rate * np.diff(apart, axis=0)
    moved = np.zeros_like(jacobian)
    moved[:, n : 2 * n] = jacobian[:, :n]
    shown = jacobian.any(axis=1) & (reading(state, commands + 1.0)[0] == read)
    moving = shown & jacobian[:, :n].any(axis=1) & ~jacobian[:, n:].any(axis=1)
    values = curve[0] - read + jacobian @ state
    within = np.hypot(noise, np.abs(apart).max(axis=0))
    rates_within = np.hypot(np.sqrt(2.0) * record.rate * noise, np.abs(varied).max(axis=0))
    return InitialPrior(
        np.concatenate([jacobian[shown], moved[moving]]),
        np.concatenate([values[shown], curve[1, moving]]),
        np.concatenate([within[shown], rates_within[moving]]),
    )


def guessed_state(
    rest: Array, at_rest: tuple[Array, Array], free: Sequence[int], t: Array, readings: Array, *, n: int, degree: int
) -> Array:
    """Guess of a state (states,) from a polynomial through the readings around it.

    Args:
        rest: the state at rest (states,), in which the states that are not free stay.
        at_rest: readings there (sensors,), and their derivatives by the state (sensors, states).
        free: indices of the states that may begin anywhere.
        t: times of the readings, from the instant of the state, s (m,).
        readings: (m, sensors).
        n: number of coordinates, which are the first states; their velocities are the next.
        degree: of the polynomial.
    """
    y, (read, jacobian) = rest.copy(), at_rest
    value, *slope = np.polynomial.polynomial.polyfit(t, readings, min(degree, len(t) - 1))[:2]
    seen = [i for i in free if not n <= i < 2 * n]
    inverse = decompositions.inverse(jacobian[:, seen])
    y[seen] += inverse @ (value - read)
    if slope:
        y[n : 2 * n] = inverse[:n] @ slope[0]
    return y
