"""Growth along a motion: whether the passive coordinates of a rig return to the wanted motion, or part from it.

Motions of a closed loop with the same virtual coordinates, whose passive ones begin a little apart, are integrated
beside each other: their differences are the small motions. Where the virtual motion comes back to itself, the passive
motion that repeats with it is found by shooting, and its small motions are followed over a period (Floquet); else they
are followed over the run.
Source: Nayfeh and Mook (1979), Nonlinear Oscillations, section 5.2; Benettin and others (1980), Meccanica 15, 9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np

from masking.analysis.stability.transverse import mean_growth, orthonormal
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.newton import STEP, jacobian, root
from masking.control.closed_loop import ClosedLoop
from masking.control.zero_dynamics import ZeroDynamics, rates_of
from masking.errors import MaskingError, ModelError
from masking.lab.runs.simulated_run import Run, complete, loop_state, rig_state
from masking.model.modelling.input_series import Schedule, integrate

_TOLERANCE: Final = 1e-12  # local relative error of integration: differences of motions are divided by small steps
_PHASES: Final = 64  # of a period, at which it is compared with the next
_REPEATS: Final = 1e-3  # of the range of each virtual state, by which a period differs from the next at most
_AWAY, _NEAR = 0.5, 0.3  # of that range: a motion has left its end, and may have come back to it between two rows
_MOST_RETURNS: Final = 20  # that are looked at
_CLOSED: Final = 1e-8  # of the size of each passive state, in closing
_MOST_ROUNDS: Final = 12  # of shooting
_PIECES: Final = 50  # of a run, after each of which small motions are made orthonormal again
_MOST_DIRECTIONS: Final = 4  # of small motions that are followed over a run, as the fastest is asked for


@dataclass(frozen=True)
class Growth:
    """Small motions of the passive coordinates along the ideal motion of a closed loop."""

    loop: ClosedLoop
    run: Run  # ideal motion, with the states of the loop as those of the rig
    schedule: Schedule | None  # parameters that change on the way

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the passive coordinates."""
        names, places, n = self.loop.plant.state_names, self._places, len(self.loop.plant.coordinates)
        return tuple(names[i] for i in ([i for i in places if i < n] or places))

    @property
    def zero_dynamics(self) -> ZeroDynamics:
        """Growth per period where the motion repeats, else over the run.

        Raises a `ModelError` where it is unknown.
        """
        if self.loop.kernels.meta.get("lags"):
            raise self._unknown("delays of the virtual system are not followed")
        returned = next(filter(None, map(self._repeated, self._returns()[:_MOST_RETURNS])), None)
        if returned is None:
            return self._over_run("not periodic")
        begin, period, state, virtual = returned
        flow, start = self._flow((begin, begin + period), state, virtual), state[self._places] / self._sizes
        eye = np.eye(len(start))
        try:
            closed = root(
                lambda x: (flow(x) - x, _slope(flow, x, eye) - eye),
                start,
                error=_CLOSED,
                longest=1.0,
                rounds=_MOST_ROUNDS,
            )
        except MaskingError:
            return self._over_run(f"period {period:.4g} s, with which {', '.join(self.names)} does not repeat")
        about = f"along the wanted motion (period {period:.4g} s)"
        return ZeroDynamics(self.names, np.empty(0), closed.slope + eye, about, period=period)

    def _unknown(self, why: str) -> ModelError:
        names = ", ".join(self.names)
        return ModelError(f"{names} passive, zero dynamics unknown along the wanted motion: {why}")

    def _over_run(self, how: str) -> ZeroDynamics:
        """Mean growth over the run, as far as it can be followed."""
        times, every = self.run.times, max(1, (len(self.run.times) - 1) // _PIECES)
        size, logs = len(self._sizes), list[Array]()
        # Directions that are none of the axes: the fastest growth has a part in them.
        frame, _ = orthonormal(np.random.default_rng(0).standard_normal((size, min(size, _MOST_DIRECTIONS))))
        for a, b in pairwise(range(0, len(times), every)):
            state = self.run.rig[a]
            flow = self._flow((times[a], times[b]), state, self.run.virtual[a])
            try:
                grown = _slope(flow, state[self._places] / self._sizes, frame)
            except MaskingError:
                break
            if not np.isfinite(grown).all():
                break
            frame, lengths = orthonormal(grown)
            logs.append(lengths)
        if not logs:
            raise self._unknown("no motion near it can be followed")
        step = float(times[every] - times[0])
        growths, spread = mean_growth(np.array(logs), step)
        span = len(logs) * step
        about = f"along the wanted motion ({how}, over {span:.4g} s)"
        return ZeroDynamics(self.names, np.empty(0), np.diag(growths), about, spread=max(spread, 1.0 / span))

    @cached_property
    def _ranges(self) -> Array:
        """Range of each virtual state over the last half of the run (.,); infinite where it stays."""
        late = self.run.virtual[len(self.run.times) // 2 :]
        ranges = np.ptp(late, axis=0)
        return np.where(ranges > _TOLERANCE * np.abs(late).max(axis=0), ranges, np.inf)

    def _returns(self) -> Array:
        """Times after which the virtual motion may have come back to where it is at the end, the shortest first."""
        away = (np.abs(self.run.virtual - self.run.virtual[-1]) / self._ranges).max(axis=1)[::-1]
        beside = np.pad(away, 1, constant_values=np.inf)
        nearest = (away < _NEAR) & (away <= beside[:-2]) & (away < beside[2:]) & (np.maximum.accumulate(away) > _AWAY)
        return np.asarray((self.run.times[-1] - self.run.times[::-1])[nearest])

    def _repeated(self, period: float) -> tuple[float, float, Array, Array] | None:
        """Begin, period, state and virtual state of a motion that repeats; None where it does not.

        The period is refined until the motion comes nearest to that of the period before.
        """
        k, loop, run = len(self.loop.controller.virtual.coordinates), self.loop, self.run
        row = max(0, int(np.searchsorted(run.times, run.times[-1] - 2.0 * period)) - 1)
        phases = np.arange(_PHASES) / _PHASES
        for _ in range(8):
            times = run.times[row] + period * np.concatenate([phases, 1.0 + phases])
            try:
                states = self._integrate(times, run.rig[row])
            except MaskingError:
                return None
            virtual = complete(loop, times, states, loop.values(), self.schedule).virtual
            gap = (virtual[_PHASES:] - virtual[:_PHASES]) / self._ranges
            rate = virtual[_PHASES:, k : 2 * k] / loop.controller.time_scale / self._ranges[:k]
            change = -float(np.sum(gap[:, :k] * rate) / (np.sum(rate**2) or np.inf))
            if abs(change) <= _TOLERANCE * period:
                break
            period += change
            if not 0.0 < period < 1.5 * run.times[-1]:
                return None
        is_closed = np.abs(gap).max() <= _REPEATS
        return (float(times[0]), period, states[0], virtual[0]) if is_closed else None

    def _integrate(self, times: Array, state: Array) -> Array:
        """States of the loop (m, .) at times (m,), from that at the first."""
        loop, u = self.loop, np.zeros(len(self.loop.plant.inputs))
        own = state[: 2 * len(loop.plant.coordinates) + len(loop.internal)]
        return integrate(
            loop.kernels, times, own, u, loop.values(), schedule=self.schedule, tolerance=_TOLERANCE
        ).states

    @property
    def _places(self) -> list[int]:
        """Where passive coordinates, their rates and the rig's internal states are among those of the loop (r,).

        Of a rig whose inputs act through dynamics of their own, they are the states that the virtual coordinates do not
        determine.
        """
        if not self.loop.controller.is_direct:
            return [*self.loop.controller.remainder]
        n, free = len(self.loop.plant.coordinates), self.loop.match.mapping.passive
        return [*free, *(n + i for i in free), *range(2 * n, 2 * n + len(self.loop.plant.states))]

    def _placed(self, near: Array, virtual: Array, passive: Array) -> Array:
        """State of the loop with given virtual and passive states (r,), near another."""
        n, there = len(self.loop.plant.coordinates), near.copy()
        there[self._places] = passive
        free = [*(i for i in self.loop.match.mapping.passive), *(n + i for i in self.loop.match.mapping.passive)]
        rig = rig_state(self.loop, virtual, there[free], there[:n])
        return loop_state(self.loop, virtual, rig, there[2 * n : 2 * n + len(self.loop.plant.states)])

    @cached_property
    def _sizes(self) -> Array:
        """Size of each passive state (r,), SI units: of rates, those of oscillations about the begin by a length."""
        loop, state, n = self.loop, self.run.rig[0], len(self.loop.plant.coordinates)
        places, slowest = np.array(self._places, dtype=int), 1.0 / float(np.ptp(self.run.times))
        swinging = [i for i in places if i < n and n + i in places]
        lengths, inside = loop.plant.lengths[swinging], np.isin(places, swinging)
        p, u, out = loop.values(), np.zeros(len(loop.plant.inputs)), np.empty(len(state))

        def accelerations(z: Array) -> Array:
            passive = state[places]
            passive[inside] = z
            at = self._placed(state, self.run.virtual[0], passive)
            loop.kernels.derivative(float(self.run.times[0]), at, u, p, out)
            return np.asarray(out[[n + i for i in swinging]], dtype=np.float64)

        stiffness = jacobian(accelerations, state[swinging], STEP * lengths)
        largest = np.abs(self.run.rig).max(axis=0)
        sizes = np.where(largest > 0.0, largest, 1.0)
        sizes[: 2 * n] = np.concatenate([loop.plant.lengths, loop.plant.lengths * slowest])
        sizes[[n + i for i in swinging]] = rates_of(stiffness, lengths, slowest)
        return np.asarray(sizes[places], dtype=np.float64)

    def _flow(self, span: tuple[float, float], state: Array, virtual: Array) -> Callable[[Array], Array]:
        """What passive states (r,), in units of their sizes, have become after a span from a state of the loop."""

        def flow(x: Array) -> Array:
            states = self._integrate(np.array(span), self._placed(state, virtual, x * self._sizes))
            return states[-1, self._places] / self._sizes

        return flow


def _slope(flow: Callable[[Array], Array], x: Array, directions: Array) -> Array:
    """Slope of a flow at x (r,) along directions (r, k)."""
    steps = np.full(directions.shape[1], STEP * max(1.0, float(np.abs(x).max())))
    return jacobian(lambda parts: flow(x + directions @ parts), np.zeros(len(steps)), steps)
