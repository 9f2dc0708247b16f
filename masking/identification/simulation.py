"""Simulation: a record beside what a twin makes of its commands, from the initial state that comes nearest to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from masking.errors import IntegrationError
from masking.identification.data import Data
from masking.kernels import Array
from masking.sensitivity import Sensitivity
from masking.twin import Twin

ROUNDS = 6  # Gauss-Newton steps for the initial state, at most
SETTLED = 1e-9  # part of the cost that a step must take off


@dataclass(frozen=True)
class Simulated:
    """What sensors read, and what they would read.

    Args:
        record: commands and readings.
        sensors: their names.
        units: of the readings.
        readings: simulated (m, sensors), from the best initial state.
    """

    record: Data
    sensors: tuple[str, ...]
    units: tuple[str, ...]
    readings: Array

    @property
    def times(self) -> Array:
        """Return the times of the samples, s (m,)."""
        return np.asarray(np.arange(len(self.record)) / self.record.rate)

    @property
    def residual(self) -> Array:
        """Return measured less simulated (m, sensors)."""
        return np.asarray(self.record.readings - self.readings)

    @property
    def chi(self) -> dict[str, float]:
        """Return the relative error of each sensor, by name. Source: Rijlaarsdam (2008), (4.12)."""
        return self._relative(np.sqrt((self.residual**2).sum(axis=0)))

    @property
    def floor(self) -> dict[str, float]:
        """Return the relative error that the noise of the record alone makes, by name."""
        return self._relative(self.record.noise * np.sqrt(len(self.record)))

    def _relative(self, sizes: Array) -> dict[str, float]:
        whole = np.maximum(np.sqrt((self.record.readings**2).sum(axis=0)), 1e-300)
        return dict(zip(self.sensors, map(float, sizes / whole), strict=True))


def simulate(twin: Twin, record: Data, names: Sequence[str] = ()) -> Simulated:
    """Simulate a record from the initial coordinates and velocities that reproduce it best; internal states at rest.

    Args:
        twin: the plant, with the values to simulate with.
        record: commands and readings.
        names: parameters that a fit had free: its compiled derivatives are then used again.

    Raises:
        IntegrationError: the motion is not finite from any initial state that was tried.
    """
    sensing = Sensitivity(twin, tuple(names))
    k, moving, theta = len(sensing.names), 2 * len(twin.model.coordinates), sensing.start()
    substeps, basis = twin.substeps(record.rate), sensing.basis(theta)
    size = np.maximum(np.abs(record.readings).max(axis=0), 1e-300)
    weights = np.maximum(record.noise, 1e-12 * size) ** -2.0
    start = y = twin.rest(np.zeros(moving // 2))
    least, own = np.inf, slice(k, k + moving)
    for _ in range(ROUNDS):
        try:
            told = sensing.normal_equations(
                basis, y, record.acting, record.readings, weights, rate=record.rate, substeps=substeps,
                between=record.between,
            )  # fmt: skip
        except IntegrationError:
            break
        cost = float(weights @ told.squares)
        if not cost < least * (1.0 - SETTLED):
            break
        start, least, y = y, cost, y.copy()
        y[:moving] += np.linalg.lstsq(told.matrix[own, own], told.gradient[own], rcond=1e-12)[0]
    readings = sensing.simulate(
        theta, start, record.acting, rate=record.rate, substeps=substeps, between=record.between
    )
    plant = twin.declaration.sensors
    units = tuple("" if plant[name].unit == "1" else plant[name].unit for name in twin.sensors)
    return Simulated(record, twin.sensors, units, readings)
