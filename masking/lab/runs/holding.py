"""Holding controller: springs and dampers for those motions of a rig that no spring of its own holds.

A shaft, or a mass on a guide, that is pushed by signals whose force has a mean momentum, or that meets friction, moves
away without bound. In each tick a force of -M (w^2 x + 2 w v) acts on the free motions:

    u = u_wanted - B^+ P (w^2 (q - q_0) + 2 w q'),    P: projection onto the motions slower than a period

so that what is commanded stays known, and a rig that its springs hold is commanded as wanted. q_0 goes from where a run
begins to the middle of the limits, as 1 - exp(-w t / 4); what has no limit stays where it begins.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments
from masking.lab.plants.safety_chain import ControlledStop

_FREQUENCY: Final = 1.0  # Hz, of what is held, at most
_STRONG: Final = 0.5  # of the frequency at which the largest command holds the stroke
_LAG: Final = 0.1  # rad by which a speed is late, at the frequency of what is held; twice that of the delay
_EXACT: Final = 1e-6  # relative, of what the sensors determine
_SLOWLY: Final = 0.25  # of the frequency of what is held: how fast the place at which it is held goes to the middle
_BRAKE: Final = 4.0  # times the frequency of what is held: its damping in a controlled stop, twice the critical one
_BACK: Final = 5.0  # of the times in which that goes on by a factor e: within them it is there


@final
class Holding:
    """Commands beside those that are wanted, for a rig that begins at rest, tick after tick."""

    def __init__(self, frequency: float, by_reading: Array, back: Array, middle: Array, rate: float) -> None:
        self._span = max(1, round(_LAG * rate / frequency))
        self._rate, self._frequency, self._by_reading = rate, frequency, by_reading  # (actuators, sensors)
        self._back, self._middle = back, middle  # (sensors, sensors) and (sensors,), of what has limits
        self._place: Array | None = None
        self._past: deque[Array] = deque(maxlen=self._span + 1)

    @classmethod
    def of(cls, known: Instruments, rate: float, period: float) -> Holding | None:
        """Holding controller of a rig at a rate in Hz; None where springs hold each motion within a period in s.

        None, too, where the sensors do not read every coordinate, or no actuator pushes what is free.
        """
        n, dynamics_driven = len(known.model.coordinates), known.linear()
        sensing, driven = known.sensing()[:, :n], dynamics_driven[1] @ known.allocation
        if not n or np.linalg.matrix_rank(sensing) < n:
            return None
        squares, vectors = np.linalg.eig(dynamics_driven[0][n:, :n])
        is_free = squares.real > -((2.0 * math.pi / period) ** 2)
        free = np.real(vectors @ np.diag(is_free.astype(float)) @ np.linalg.pinv(vectors))
        pushing = np.linalg.pinv(driven) @ free
        if not is_free.any() or np.abs(driven @ pushing - free).max() > _EXACT:
            return None
        frequency = 2.0 * math.pi * _FREQUENCY
        pushed = np.abs(driven) @ known.limits()[:, LARGEST]
        for what, limit in known.plant.limits.coordinates.items():
            i = known.model.coordinates.index(what.text) if what.text in known.model.coordinates else -1
            if i >= 0 and np.abs(free[i]).max() > _EXACT * np.abs(free).max():
                far = limit.max * known.factors[limit.unit]
                frequency = min(frequency, _STRONG * math.sqrt(pushed[i] / far))
        if known.delay:
            frequency = min(frequency, _LAG * rate / known.delay)
        names = {what.text for what in known.plant.limits.coordinates}
        back = sensing @ np.diag([float(name in names) for name in known.model.coordinates]) @ np.linalg.pinv(sensing)
        return cls(frequency, -pushing @ np.linalg.pinv(sensing), back, known.readings(np.zeros(n)), rate)

    def step(self, readings: Array) -> Array:
        """Commands (actuators,) that answer the readings (sensors,) of a tick."""
        place = readings if self._place is None else self._place
        self._place = place + _SLOWLY * self._frequency / self._rate * (self._back @ (self._middle - place))
        self._past.append(readings.copy())
        return self._frequency**2 * self._by_reading @ (readings - place) + self._braking(readings)

    def _rates(self, readings: Array) -> Array:
        is_full = len(self._past) == self._past.maxlen
        return (readings - self._past[0]) * self._rate / self._span if is_full else np.zeros_like(readings)

    def _braking(self, readings: Array) -> Array:
        answer: Array = 2.0 * self._frequency * self._by_reading @ self._rates(readings)
        return answer

    def braked(self, readings: Array, largest: Array) -> Array:
        """Readings (sensors,) at which the rig would rest after `stop`, with the largest commands (actuators,)."""
        v, damping = self._rates(readings), _BRAKE * self._frequency
        a = np.abs(np.linalg.pinv(self._by_reading)) @ largest  # which is all that brakes above v = a / damping
        far = np.where(np.abs(v) * damping < a, np.abs(v) / damping, 0.5 * (v**2 / a + a / damping**2))
        return np.asarray(readings + np.sign(v) * far)

    def left(self, readings: Array) -> Array:
        """Size of the commands (actuators,) that would bring the rig to the middle and to rest, after a step."""
        off = self._frequency**2 * self._by_reading @ self._back @ (readings - self._middle)
        return np.abs(off) + np.abs(self._braking(readings))

    @property
    def seconds(self) -> float:
        """Time in which the rig is brought to the middle."""
        return _BACK / (_SLOWLY * self._frequency)

    def stop(self, seconds: float) -> ControlledStop:
        """Controlled stop of some seconds: the damping force that brings it to rest."""
        damping, samples = _BRAKE * self._frequency * self._by_reading, round(seconds * self._rate)
        return ControlledStop(samples, damping, self._span, np.zeros(damping.shape[1]), samples)

    def reset(self) -> None:
        """Begin again, with the next readings."""
        self._place = None
        self._past.clear()
