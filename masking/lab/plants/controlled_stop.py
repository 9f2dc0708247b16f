"""Controlled stop: what is commanded between the end of a run and zero, since zero does not brake.

`runs.realtime` goes on with it in place of the controller, and `served_plant_guard` in place of whoever drives a served
plant, within the same limits and rates. Only sound readings brake: after a cause that distrusts sensors, actuators,
time or the plant, and after a second cause, commands are zero.
"""

from __future__ import annotations

from collections import deque
from typing import final

import numpy as np

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST
from masking.lab.plants.safety_chain import BORNE, Chain, ControlledStop


def follows(chain: Chain) -> bool:
    """Whether a controlled stop follows the end of a run, where a plant file has one."""
    return chain.rules.stop is not None and (chain.trip is None or chain.trip.cause in BORNE)


@final
class Braking:
    """Commands of a controlled stop, as a controller: the last ones, or a damping force; it sees samples before it.

    `samples` are those that it takes at most.
    """

    def __init__(self, chain: Chain, stop: ControlledStop) -> None:
        self._chain, self._stop, self._settled, self.samples = chain, stop, 0, stop.samples
        self._held: Array | None = None
        self._past: deque[tuple[int, Array]] = deque(maxlen=stop.span + 1)
        self._largest = chain.rules.commands[:, LARGEST]
        self._change = chain.rules.commands[:, safety_tables.RATE] / chain.rules.rate

    @property
    def is_over(self) -> bool:
        """Whether the rig has been at rest for long enough."""
        return self._settled > self._stop.settled

    def see(self, tick: int, readings: Array) -> None:
        """Keep the readings (sensors,) of a tick."""
        self._past.append((tick, readings.copy()))

    def step(self, tick: int, readings: Array) -> Array:
        """Command (actuators,) that answers the readings (sensors,) of a tick."""
        self.see(tick, readings)
        if self._held is None:
            self._held = self._chain.applied.copy()
        first, before = self._past[0]
        if self._stop.damping is None:
            return self._held
        if tick == first:
            return np.zeros_like(self._held)
        rates = (readings - before) * self._chain.rules.rate / (tick - first)
        self._settled = self._settled + 1 if np.all(np.abs(rates) <= self._stop.still) else 0
        wanted = self._stop.damping @ rates
        # All are made smaller by the same factor, so that the force stays one that brakes.
        wanted /= max(1.0, float((np.abs(wanted) / self._largest).max()))
        change = wanted - self._chain.applied
        steps = float((np.abs(change) / self._change).max())
        return wanted if steps <= 1.0 else self._chain.applied + change / steps
