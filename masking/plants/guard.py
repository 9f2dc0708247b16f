"""Guard: what stands between a controller's commands and a plant that is served, whoever the controller is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Protocol, final

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


OFF: Final = 8.0  # standard deviations of its noise that a reading may be off


@final
@dataclass(frozen=True, slots=True)
class Reach:
    """How far a coordinate may go, as a sensor of its own shows it.

    Args:
        what: the coordinate, or the expression of coordinates, that the sensor measures.
        largest: magnitude that it may have, in `unit`.
        unit: of that.
        gain: of the sensor, its unit per `unit`.
        noise: standard deviation of a reading, in the sensor's unit; 8 of them are no motion.
    """

    what: str
    largest: float
    unit: str
    gain: float
    noise: float = 0.0

    def passed(self, sensor: str, reading: float) -> str:
        """Say that a reading is beyond, as also where it is not a number; empty where it is not."""
        value = reading / self.gain
        if abs(value) <= self.largest + OFF * self.noise / abs(self.gain):
            return ""
        return f"{self.what} is {value:.4g} {self.unit} as {sensor} reads it, its limit is {self.largest:g} {self.unit}"


@final
class PlantLimits:
    """Clamps each command to the largest that its actuator bears, and trips where a reading shows a coordinate beyond.

    Args:
        inputs: magnitude of the command of each actuator, in its unit; one that is not named has no limit.
        reaches: by sensor, how far what it measures may go.
    """

    def __init__(self, inputs: Mapping[str, float], reaches: Mapping[str, Reach] | None = None) -> None:
        self.inputs, self.reaches = dict(inputs), dict(reaches or {})
        self.counters: Mapping[str, int] = {}
        self._clamped = 0
        self._above, self._below = np.empty(0), np.empty(0)
        self._watched: list[tuple[int, str, Reach]] = []

    def begin(self, plant: Plant, settings: Settings) -> None:
        """Put the limits into the order of the plant's channels.

        Raises:
            PlantMismatchError: the plant does not have one of them.
        """
        del settings
        for kind, names, there in (
            ("actuator", self.inputs, plant.actuators),
            ("sensor", self.reaches, plant.sensors),
        ):
            for name in names:
                if name not in there:
                    message = f"the limits are those of a plant with the {kind} {name}, which this one does not have"
                    raise PlantMismatchError(f"{message}; {nearest(name, there)}")
        self._above = np.array([self.inputs.get(name, np.inf) for name in plant.actuators])
        self._below = -self._above
        self._watched = [(plant.sensors.index(name), name, reach) for name, reach in self.reaches.items()]
        self.counters = {}
        self._clamped = 0

    def check(self, sample: Sample, command: Array) -> str:
        """Clamp a command (actuators,), which is finite; say which coordinate is beyond its limit."""
        for i, name, reach in self._watched:
            cause = reach.passed(name, float(sample.values[i]))
            if cause:
                return cause
        if (command > self._above).any() or (command < self._below).any():
            np.clip(command, self._below, self._above, out=command)
            self._clamped += 1
            self.counters = {"clamped": self._clamped}
        return ""
