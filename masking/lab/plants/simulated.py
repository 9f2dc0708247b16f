"""The twin of a rig behind the interface of a plant: it moves by one sample with each command that it is given."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import ModelError
from masking.lab.plants.interface import APPLIED, Settings
from masking.lab.plants.stepped import SteppedPlant


@final
class SimulatedPlant(SteppedPlant):
    """A twin that starts at rest and unpowered, and moves for one sample under each command.

    A command acts after the delay that the twin declares; `masking.lab.runs.simulated_run.run_twin` computes the same.
    `seed` is that of the sensors' noise. A ModelError where a sensor reads at once what is commanded, as the force of a
    component: nothing can answer it.
    """

    may_diverge = True

    def __init__(self, twin: Twin, seed: int = 0) -> None:
        if "sense" not in twin.kernels.meta["functions"]:
            raise ModelError(
                f"{twin.declaration.name}: its sensors read at once what is commanded, which no controller can answer; "
                "what its model is missing is found by 'masking discover', from a record"
            )
        super().__init__(twin.sensors, twin.actuators)
        self.twin, self.seed = twin, seed
        self._y = twin.unpowered()
        self._queue, self._acting = np.zeros((1, len(twin.actuators))), np.zeros(len(twin.actuators))

    def begin(self, settings: Settings) -> None:
        """Go to rest, for a number of samples per second."""
        twin = self.twin
        self._rate, values = settings.rate, twin.values()
        self._generator = np.random.default_rng(self.seed)
        self._y = twin.unpowered()
        self._late = twin.late(settings.rate)
        self._queue = np.zeros((1 + math.ceil(self._late.max(initial=0.0)), len(twin.actuators)))
        self._time, self._noise, self._readings = np.zeros(1), np.zeros(len(twin.sensors)), np.zeros(len(twin.sensors))
        step, substeps = np.array([1.0 / settings.rate]), np.array([twin.substeps(settings.rate)])
        sensed = (self._time, self._y, values, self._noise, self._readings)
        moved = (self._time, self._y, self._queue, self._late, values, step, substeps, self._acting)
        self._sense, self._move = twin.kernels.sense.bind(*sensed), twin.kernels.move.bind(*moved)

    def readings(self) -> Array:
        """Readings of a new tick, with noise of their own."""
        self._generator.standard_normal(out=self._noise)
        self._time[0] = self._tick / self._rate
        self._sense.call()
        return self._readings

    def step(self, command: Array) -> None:
        """Let the rig move by one sample, and this command (actuators,) act after the delay."""
        self._queue[-1] = command
        self._time[0] = self._tick * (1.0 / self._rate)
        self._move.call()

    def end(self) -> None:
        """Set the outputs to zero."""
        self._queue[:] = 0.0
        self._acting[:] = 0.0

    def telemetry(self) -> dict[str, float]:
        """Outputs that acted last and the twin's states, by name."""
        applied = {APPLIED + name: float(value) for name, value in zip(self.actuators, self._acting, strict=True)}
        return applied | {name: float(value) for name, value in zip(self.twin.state_names, self._y, strict=True)}
