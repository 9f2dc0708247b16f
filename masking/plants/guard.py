"""Guard: what stands between a controller's commands and a plant that is served, whoever the controller is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, final

import numpy as np

from masking.errors import PlantMismatchError, nearest
from masking.numerics.arrays import Array
from masking.plants.interface import Plant, Sample, Settings


class Guard(Protocol):
    """Looks at each sample and at the command that is about to be written; nothing goes to the plant past it.

    Attributes:
        counters: what it did, by name, since `begin`.
    """

    counters: Mapping[str, int]

    def begin(self, plant: Plant, settings: Settings) -> None:
        """Begin a session with a plant that is configured; a `PlantError` where it does not fit the plant."""

    def check(self, sample: Sample, command: Array) -> str:
        """Bring a command (actuators,) within the limits, in place.

        Returns:
            why the plant must stop, as a sentence; empty where it need not. The command is not written then.
        """
        ...


@final
class ActuatorLimits:
    """Clamps each command to the largest that its actuator bears.

    Args:
        largest: magnitude of the command of each actuator, in its unit; one that is not named has no limit.
    """

    def __init__(self, largest: Mapping[str, float]) -> None:
        self.largest = dict(largest)
        self.counters: Mapping[str, int] = {}
        self._clamped = 0
        self._above, self._below = np.empty(0), np.empty(0)

    def begin(self, plant: Plant, settings: Settings) -> None:
        """Put the limits into the order of the plant's actuators.

        Raises:
            PlantMismatchError: the plant does not have one of them.
        """
        del settings
        for name in self.largest:
            if name not in plant.actuators:
                mend = nearest(name, plant.actuators)
                raise PlantMismatchError(f"limits.inputs.{name}: the plant has no such actuator; {mend}")
        self._above = np.array([self.largest.get(name, np.inf) for name in plant.actuators])
        self._below = -self._above
        self.counters = {}
        self._clamped = 0

    def check(self, sample: Sample, command: Array) -> str:
        """Clamp a command (actuators,), which is finite."""
        del sample
        if (command > self._above).any() or (command < self._below).any():
            np.clip(command, self._below, self._above, out=command)
            self._clamped += 1
            self.counters = {"clamped": self._clamped}
        return ""
