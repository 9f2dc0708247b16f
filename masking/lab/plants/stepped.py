"""SteppedPlant: a plant that is simulated; it moves by one sample with each command that it is given."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import CommandError, PlantError
from masking.lab.plants.interface import APPLIED, LifeCycle, Sample, Settings, check_command


class SteppedPlant(ABC):
    """A plant's rules, so that an adapter has to begin, step, read and end; a command acts in its tick, and holds."""

    owns_clock = False
    may_diverge = False  # whether readings that are not finite are passed on
    sensors: tuple[str, ...]
    actuators: tuple[str, ...]

    def __init__(self, sensors: tuple[str, ...], actuators: tuple[str, ...]) -> None:
        self.sensors, self.actuators = sensors, actuators
        self._life = LifeCycle()
        self._applied, self._values = np.zeros(len(actuators)), np.zeros(len(sensors))
        self._tick, self._is_moved = 0, True

    @abstractmethod
    def begin(self, settings: Settings) -> None:
        """Go to the start, for a number of samples per second."""

    @abstractmethod
    def step(self, command: Array) -> None:
        """Move by one sample under a command (actuators,)."""

    @abstractmethod
    def readings(self) -> Array:
        """What the sensors show at a new tick (sensors,)."""

    @abstractmethod
    def end(self) -> None:
        """Give back what `begin` took, if anything."""

    def configure(self, settings: Settings) -> None:
        """Go back to the start, for a number of samples per second."""
        self._life.configure()
        self.deactivate()
        self.begin(settings)
        self._tick, self._is_moved = -1, False
        self._life.configure()

    def activate(self) -> None:
        """Enable the outputs, at zero."""
        self._life.activate()

    def read(self) -> Sample:
        """Sample after the last command, or the same again where no command came."""
        self._life.need_active("read")
        if self._tick < 0 or self._is_moved:
            self._tick += 1
            self._is_moved = False
            self._values[:] = self.readings()
        if not (self.may_diverge or np.isfinite(self._values).all()):
            name = self.sensors[int(np.argmin(np.isfinite(self._values)))]
            raise PlantError(f"sample {self._tick}: {name} is not finite; the simulation is unstable: step it faster")
        return Sample(self._tick, self._values.copy())

    def write(self, index: int, command: Array) -> None:
        """Move by one sample under this command (actuators,)."""
        self._life.need_active("write")
        check_command(command, self.actuators)
        if self._tick < 0:
            raise CommandError("write: there is no sample to answer yet; call read first")
        del index  # the simulation waits for its command
        self._applied[:] = command
        self.step(self._applied)
        self._is_moved = True

    def deactivate(self) -> None:
        """Set the outputs to zero and end the simulation."""
        self._life.deactivate()
        self._applied[:] = 0.0
        with contextlib.suppress(Exception):  # whatever the other program raises on its way out
            self.end()

    def telemetry(self) -> dict[str, float]:
        """Outputs in force."""
        return {APPLIED + name: float(value) for name, value in zip(self.actuators, self._applied, strict=True)}
