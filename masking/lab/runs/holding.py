"""Holding controller: springs and dampers for those motions of a rig that no spring of its own holds.

A shaft, or a mass on a guide, that is pushed by signals whose force has a mean momentum, or that meets friction, moves
away without bound. In each tick a force of -M (w^2 x + 2 w v) acts on the free motions, x from where they began:

    u = u_wanted - B^+ P (w^2 (q - q_0) + 2 w q'),    P: projection onto the motions slower than a period

so that what is commanded stays known, and a rig that its springs hold is commanded as wanted.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.control.known_instruments import Instruments

_FREQUENCY: Final = 1.0  # Hz, of what is held, at most
_STRONG: Final = 0.5  # of the frequency at which the largest command holds the stroke
_LAG: Final = 0.1  # rad by which a speed is late, at the frequency of what is held; twice that of the delay
_EXACT: Final = 1e-6  # relative, of what the sensors determine


@final
class Holding:
    """Commands beside those that are wanted, for a rig that begins at rest, tick after tick."""

    def __init__(self, stiffness: Array, damping: Array, span: int) -> None:
        self._stiffness, self._damping = stiffness, damping  # (actuators, sensors), per reading and per change of it
        self._first: Array | None = None
        self._past: deque[Array] = deque(maxlen=span + 1)

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
        span = max(1, round(_LAG * rate / frequency))
        by_reading = -pushing @ np.linalg.pinv(sensing)
        return cls(frequency**2 * by_reading, 2.0 * frequency * rate / span * by_reading, span)

    def step(self, readings: Array) -> Array:
        """Commands (actuators,) that answer the readings (sensors,) of a tick."""
        self._first = readings.copy() if self._first is None else self._first
        self._past.append(readings.copy())
        change = readings - self._past[0] if len(self._past) == self._past.maxlen else np.zeros_like(readings)
        answer: Array = self._stiffness @ (readings - self._first) + self._damping @ change
        return answer

    def reset(self) -> None:
        """Begin again, with the next readings."""
        self._first = None
        self._past.clear()
