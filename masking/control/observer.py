"""Observers: how a sampled controller knows the rig's state from its sensors.

Two siblings: `Differences` of the positions, the way of the thesis, and `Kalman`, which follows a model. With an order
it is a disturbance observer, which estimates beside the state the accelerations that the model lacks.

The gain of the latter is that of the steady Kalman filter of the model, linearised at rest, in which the last
derivative that is estimated (the velocity, or that of the disturbance) is driven by white noise. A coordinate that is
measured with variance R, and whose k-th derivative is driven by white noise of density Q, is followed with the
bandwidth w = (Q / R)^(1 / 2k): the filter's poles lie on a circle of this radius. So a bandwidth is chosen, and Q
follows.
Source: Gelb (ed.), Applied Optimal Estimation (1974), chapter 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.steady_kalman import discretised, steady_filter
from masking.errors import ModelError
from masking.lazy_imports import linalg

# A command that is late by a sample for each of delay and hold turns the phase of a signal at the bandwidth by 0.7
# radian (40 degrees) where the bandwidth is this part of the rate over the samples of lateness.
FASTEST_PART = 0.7
# Beyond this part, an observer is refused: it would estimate faster than it reads.
REFUSED_PART = 1.0
# The noise of a command that the observer's noise makes, as a part of the actuator's largest command.
NOISE_PART = 0.02
# A bandwidth that makes too much noise is lowered by this factor until it does not.
LOWERED = 0.9
SLOWEST = 1e-3  # of the fastest bandwidth
SMALL = 1e-9  # of the fastest motion: what rounding makes
# Of what a largest command makes of a reading: where sensors tell inputs from forces, they are trusted no further than
# the model may be off. measured: a current that is known to 0.3 mA made a coil unstable whose parameters are 5 % off.
DOUBT = 1e-3


class _Late:
    """Times of a controller that acts some samples after it reads."""

    period: float
    delay: int

    @property
    def fastest(self) -> float:
        """Largest bandwidth that the rule chooses, rad/s: 0.7 of the rate over (1 + delay) samples."""
        return FASTEST_PART / self.late

    @property
    def late(self) -> float:
        """Samples of delay and hold, s."""
        return self.period * (1 + self.delay)


@dataclass(frozen=True)
class Plan(_Late):
    """What an observer is designed for."""

    dynamics: Array  # (2 n, 2 n), d [q, v] / dt = dynamics [q, v] of the model at rest
    sensing: Array  # (sensors, 2 n), readings per unit of [q, v]
    command: Array  # (actuators, n), commands per unit of acceleration, in parts of their largest value
    noise: Array  # standard deviation of each reading (sensors,)
    period: float  # time between samples, s
    delay: int  # samples between a reading and the first effect of the command that answers it
    # coordinates without a sensor that the controller does not drive: the model alone follows them
    unseen: tuple[int, ...] = ()

    @property
    def seen(self) -> list[int]:
        """Coordinates that the sensors tell."""
        return [i for i in range(self.coordinates) if i not in self.unseen]

    def of_seen(self) -> Plan:
        """Plan for the coordinates that the sensors tell, as if the others rested."""
        seen, n = self.seen, self.coordinates
        both = [*seen, *(n + i for i in seen)]
        dynamics, sensing = self.dynamics[np.ix_(both, both)], self.sensing[:, both]
        return replace(self, dynamics=dynamics, sensing=sensing, command=self.command[:, seen], unseen=())

    @property
    def coordinates(self) -> int:
        """Number n of coordinates."""
        return len(self.dynamics) // 2

    def command_noise(self, order: int, bandwidths: Array) -> Array:
        """Most noise in a command from the estimate of each coordinate, in parts of its limit (n,)."""
        n, noise = self.coordinates, _steady(self, order, bandwidths).noise(self.noise)
        late = (self.delay + 0.5) * self.period
        # What is cancelled: the model's own accelerations, and the disturbance where it will be when the command acts.
        cancelled = np.hstack([self.dynamics[n:], *(late**k * np.eye(n) for k in range(order))])
        spread = np.sqrt(np.maximum(np.diag(cancelled @ noise @ cancelled.T), 0.0))
        return np.asarray((np.abs(self.command) * spread).max(axis=0))


@dataclass(frozen=True)
class WholePlan(_Late):
    """What an observer of a rig whose inputs act through dynamics of their own is designed for: the model at rest.

    A disturbance adds to its inputs, where it changes as slowly as what it stands for, and with enough sensors to its
    accelerations, too, which stand first (d,).
    """

    dynamics: Array  # d [q, v, s] / dt = dynamics [q, v, s] (states, states)
    driven: Array  # the same per unit of each disturbance (states, d)
    sensing: Array  # readings per unit of [q, v, s] and then of each disturbance (sensors, states + d)
    command: Array  # commands per unit of [q, v, s] (actuators, states), in parts of their largest value
    against: tuple[Array, Array]  # commands per unit of each disturbance and of its rate (actuators, d), likewise
    noise: Array  # standard deviation of each reading (sensors,)
    period: float  # time between samples, s
    delay: int  # samples between a reading and the first effect of the command that answers it
    coordinates: int  # number n of coordinates
    has_forces: bool  # whether a disturbance adds to the accelerations, too

    def steady(self, order: int, bandwidth: float) -> _Steady:
        """Steady filter in which the last derivative of the disturbance is driven by white noise.

        Its density is such that what it makes of the readings is as large as their noise at the bandwidth.
        """
        many, inputs, order = len(self.dynamics), self.driven.shape[1], max(order, 1)
        size = many + order * inputs
        flow = np.zeros((size, size))
        flow[:many, :many], flow[:many, many : many + inputs] = self.dynamics, self.driven
        flow[many : size - inputs, many + inputs :] = np.eye((order - 1) * inputs)
        moved = np.linalg.solve(1j * bandwidth * np.eye(many) - self.dynamics, self.driven)
        seen = self.sensing[:, :many] @ moved + self.sensing[:, many:]
        deviation = _deviations(self.noise)
        if self.has_forces:  # what the largest commands make of the readings is not known any better
            parts = np.linalg.norm(self.against[0], axis=0)
            largest = np.divide(1.0, parts, out=np.zeros_like(parts), where=parts > 0.0)  # 0 without limits
            deviation = np.maximum(deviation, DOUBT * (np.abs(seen) * largest).max(axis=1))
        least = 1.0 / np.maximum(np.linalg.norm(seen / deviation[:, None], axis=0), 1e-300)
        driven = np.concatenate([np.zeros(size - inputs), (least * bandwidth**order) ** 2 * self.period])
        unit = np.concatenate([np.abs(moved) @ least, *(least * bandwidth**k for k in range(order))])
        try:
            return _Steady.of(flow, driven, self.sensing, self.period, (np.maximum(unit, 1e-300), deviation))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ModelError(
                f"the sensors do not tell the state of the rig and what disturbs its inputs ({error})"
            ) from error

    def command_noise(self, order: int, bandwidths: Array) -> Array:
        """Most noise in a command, in parts of its limit, for each coordinate, which have one bandwidth (n,)."""
        noise, order = self.steady(order, float(bandwidths[0])).noise(self.noise), max(order, 1)
        late = (self.delay + 0.5) * self.period
        known, rate = self.against
        by = np.hstack([self.command, *(late**k * known + k * late ** (k - 1) * rate for k in range(order))])
        return np.full(self.coordinates, np.sqrt(max(float(np.diag(by @ noise @ by.T).max()), 0.0)))


@dataclass(frozen=True)
class Differences:
    """Positions as the sensors tell them, velocities as their differences; nothing is predicted."""

    order = 0
    at = None

    def gain(self, plan: Plan | WholePlan, offset: int) -> Array:
        """Coordinates per unit of reading (n, sensors); a ModelError where one has no sensor."""
        del offset
        if isinstance(plan, WholePlan):
            raise ModelError(
                "differences do not tell the internal states through which the inputs act; take 'observer: disturbance'"
            )
        if plan.unseen:
            raise ModelError(
                "differences need a sensor for every coordinate, passive ones included; declare one, or take "
                "'observer: disturbance', which follows what is passive by the model"
            )
        return np.asarray(np.linalg.pinv(plan.sensing[:, : plan.coordinates]), dtype=np.float64)

    def bandwidths(self, plan: Plan | WholePlan) -> Array:
        """Infinite bandwidths (n,): nothing is filtered."""
        return np.full(plan.coordinates, np.inf)


@dataclass(frozen=True)
class Kalman:
    """State of a model, and with an order also its unknown acceleration, corrected by the readings.

    Args:
        order: how the unknown acceleration (the disturbance) continues: 0 for none, 1 as a constant, 2 as a line.
        bandwidth: rad/s, one or one for each coordinate; chosen by the rule of `bandwidths` where it is None.
        at: where a disturbance acts on a rig whose inputs act through dynamics of their own, "inputs" or "masses", too.

    Raises:
        ModelError: there is no such order.
    """

    order: int = 0
    bandwidth: float | tuple[float, ...] | None = None
    at: str | None = None

    def __post_init__(self) -> None:
        if self.order not in {0, 1, 2}:
            raise ModelError(f"observer.order {self.order}: allowed are 0, 1 (a constant disturbance) and 2 (a line)")

    def gain(self, plan: Plan | WholePlan, offset: int) -> Array:
        """Steady Kalman gain (2 n + offset + order d, sensors): correction of [q, v, s, d, ...] per unit of reading.

        Of the `offset` internal states s, those of a rig whose inputs act through them are corrected.
        """
        if isinstance(plan, WholePlan):
            gain, own = plan.steady(self.order, float(self.bandwidths(plan)[0])).correction, len(plan.dynamics)
            others = np.zeros((2 * plan.coordinates + offset - own, len(plan.sensing)))
            return np.concatenate([gain[:own], others, gain[own : own + self.order * plan.driven.shape[1]]])
        seen, n, sensors = plan.seen, plan.coordinates, len(plan.sensing)
        found = _steady(plan.of_seen(), self.order, self.bandwidths(plan)[seen])
        steady = np.zeros((2 + self.order, n, sensors))
        steady[:, seen] = found.correction.reshape(2 + self.order, len(seen), sensors)
        return np.concatenate([*steady[:2], np.zeros((offset, sensors)), *steady[2:]])

    def bandwidths(self, plan: Plan | WholePlan) -> Array:
        """Bandwidth for each coordinate, rad/s (n,); 0 for one without a sensor.

        The rule: as fast as the sampling allows, 0.7 rate / (1 + delay), so that the phase that is lost at the
        bandwidth stays within 40 degrees; then lower, coordinate by coordinate, until the noise of the readings makes
        no more noise in a command than 2 % of its largest value. A chosen bandwidth overrides the rule. A ModelError
        where that is faster than the sampling allows, or the noise is too large for any.
        """
        if self.bandwidth is not None:
            refused, fast = REFUSED_PART / plan.late, float(np.max(self.bandwidth))
            if fast > refused:
                raise ModelError(
                    f"observer.bandwidth {fast:g} rad/s is faster than the sampling allows: at {1.0 / plan.period:g} "
                    f"Hz and {plan.delay} sample{'s' * (plan.delay != 1)} of delay it is at most {refused:g} rad/s; "
                    "lower it, or raise controller.rate"
                )
            return np.broadcast_to(np.asarray(self.bandwidth, dtype=float), (plan.coordinates,)).copy()
        if isinstance(plan, Plan) and plan.unseen:
            found = np.zeros(plan.coordinates)
            found[plan.seen] = self.bandwidths(plan.of_seen())
            return found
        found = np.full(plan.coordinates, plan.fastest)
        if not plan.noise.any():
            return found
        while found.min() > SLOWEST * plan.fastest:
            noisy = plan.command_noise(self.order, found) > NOISE_PART
            if not noisy.any():
                return found
            found = np.where(noisy, LOWERED * found, found)
        raise ModelError(
            "the sensors are too noisy for an observer: their noise alone would use "
            f"{NOISE_PART:.0%} of an actuator at any bandwidth; check the noise and the limits of the plant"
        )


Observer = Differences | Kalman


@dataclass(frozen=True)
class _Steady:
    """A steady filter in units in which all is of order one: its gain, and how its error goes from sample to sample."""

    gain: Array
    error: Array
    unit: Array
    deviation: Array

    @classmethod
    def of(cls, flow: Array, driven: Array, sensing: Array, period: float, sizes: tuple[Array, Array]) -> _Steady:
        """Filter of a flow driven by white noise of some density, by readings of its first states.

        `sizes` are the units of the states, and the deviations of the readings. A ValueError where these do not
        determine the state.
        """
        unit, deviation = sizes
        step, noise = discretised(flow, driven, period)
        reading = np.hstack([sensing, np.zeros((len(sensing), len(flow) - sensing.shape[1]))])
        scaled_step = step * unit / unit[:, None]
        scaled_reading = reading * unit / deviation[:, None]
        gain = steady_filter(scaled_step, noise / np.outer(unit, unit), scaled_reading).gain
        return cls(gain, (np.eye(len(flow)) - gain @ scaled_reading) @ scaled_step, unit, deviation)

    @property
    def correction(self) -> Array:
        """Correction of the state per unit of reading (states, sensors)."""
        return self.gain * self.unit[:, None] / self.deviation

    def noise(self, levels: Array) -> Array:
        """Covariance of the state (states, states) that noise of the readings makes, by its deviations (sensors,)."""
        driven = self.gain @ np.diag((levels / self.deviation) ** 2) @ self.gain.T
        return np.asarray(linalg.solve_discrete_lyapunov(self.error, driven) * np.outer(self.unit, self.unit))


def _steady(plan: Plan, order: int, bandwidth: Array) -> _Steady:
    n, h = plan.coordinates, plan.period
    size = (2 + order) * n
    flow = np.zeros((size, size))
    flow[: 2 * n, : 2 * n] = plan.dynamics
    flow[n : size - n, 2 * n :] = np.eye(order * n)
    inverse = np.linalg.pinv(plan.sensing[:, :n])
    variance = _deviations(plan.noise) ** 2
    measured = np.diag(inverse @ np.diag(variance) @ inverse.T)
    # A discrete measurement of variance R at each sample is a continuous one of density R h.
    density = bandwidth ** (2 * (2 + order)) * measured * h
    driven = np.concatenate([np.zeros(size - n), density])
    # In units in which readings and coordinates are of order one, so that the equation is well scaled.
    unit = np.concatenate([bandwidth**k * np.sqrt(measured) for k in range(2 + order)])
    return _Steady.of(flow, driven, plan.sensing, h, (unit, np.sqrt(variance)))


def _deviations(noise: Array) -> Array:
    """Deviations of readings (sensors,); a sensor without noise counts as nearly without."""
    return np.where(noise > 0.0, noise, 1e-3 * max(float(noise.max()), 1e-9))


def check_rate(rate: float, dynamics: Array) -> None:
    """Refuse a rate at which the rig moves on by more than a radian from one sample to the next.

    `dynamics` (2 n, 2 n): d [q, v] / dt = dynamics [q, v] of the model at rest. A ModelError says which rate would do.
    """
    fastest = float(np.abs(np.linalg.eigvals(dynamics)).max())
    if rate < fastest:
        raise ModelError(
            f"controller.rate {rate:g} Hz is too low for this rig: its fastest free motion, {fastest:.3g} rad/s, would "
            f"be sampled less than once in a radian; give at least {fastest:.3g} Hz, better ten times "
            "as much"
        )


def unseen(sensing: Array) -> tuple[int, ...]:
    """Coordinates that no reading depends on, by readings per unit of each (sensors, n)."""
    return tuple(int(i) for i in np.flatnonzero(~sensing.any(axis=0)))


def check_followed(dynamics: Array, hidden: Sequence[int], coordinates: Sequence[str]) -> None:
    """Refuse coordinates that only the model follows, and that do not come to rest by themselves.

    `dynamics` (2 n, 2 n): d [q, v] / dt = dynamics [q, v] of the model at rest; `hidden` are those without a sensor.
    """
    both = [*hidden, *(len(coordinates) + i for i in hidden)]
    if hidden and np.linalg.eigvals(dynamics[np.ix_(both, both)]).real.max() >= 0.0:
        names = ", ".join(coordinates[i] for i in hidden)
        raise ModelError(
            f"no sensor measures {names}, and in the model it does not come to rest by itself: where it is cannot be "
            "known; declare a sensor that measures it"
        )


def check_told(dynamics: Array, sensing: Array, states: Sequence[str], sensors: Sequence[str]) -> None:
    """Refuse sensors that do not tell a motion that does not come to rest by itself, by the test of Hautus.

    `dynamics` (states, states): d y / dt = dynamics y of the model at rest, `sensing` (sensors, states) readings per
    unit of y; the states are named after coordinates, in which a motion is named.
    """
    balanced, scale = linalg.matrix_balance(dynamics, permute=False)
    seen = sensing @ scale
    seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), 1e-300)
    speeds = np.linalg.eigvals(balanced)
    size = max(float(np.abs(speeds).max()), 1e-300)
    for speed in speeds[speeds.real >= -SMALL * size]:
        tested = np.vstack([(balanced - speed * np.eye(len(balanced))) / size, seen])
        _, parts, motions = np.linalg.svd(tested)
        if parts[-1] <= SMALL:
            moved = np.abs(motions[-1])
            names = dict.fromkeys(n.rstrip("'") for n, x in zip(states, moved, strict=True) if x > 0.01 * moved.max())
            raise ModelError(
                f"the sensors ({', '.join(sensors)}) do not tell {', '.join(names)}, and in the model it does not come "
                "to rest by itself: where it is cannot be known; declare a sensor that measures it"
            )


def check_sensing(sensing: Array, coordinates: Sequence[str], sensors: Sequence[str]) -> None:
    """Refuse sensors that do not tell every coordinate, by readings per unit of each (sensors, n)."""
    observed = np.linalg.pinv(sensing) @ sensing if len(sensing) else np.zeros((len(coordinates),) * 2)
    missed = [name for i, name in enumerate(coordinates) if abs(observed[i, i] - 1.0) > 1e-8]
    if missed:
        have = ", ".join(sensors) or "none"
        raise ModelError(
            f"the sensors ({have}) do not tell {', '.join(missed)} apart from the other coordinates; declare a sensor "
            f"that measures {missed[0]}, or take 'observer: exact' in a simulation"
        )
