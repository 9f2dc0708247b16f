"""Simulation: a record beside what a twin makes of its commands, from the initial state that comes nearest to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from masking.errors import IntegrationError
from masking.estimation.data import Data
from masking.estimation.sensitivity import NormalEquations, Sensitivity
from masking.numerics.arrays import Array
from masking.rig.twin import Twin

FIRST_READINGS = 20  # readings that the initial state is guessed from
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
        return relative(self.sensors, [self.record], (self.residual**2).sum(axis=0))

    @property
    def floor(self) -> dict[str, float]:
        """Return the relative error that the noise of the record alone makes, by name."""
        return noise_alone(self.sensors, [self.record])


def relative(sensors: Sequence[str], records: Sequence[Data], squares: Array) -> dict[str, float]:
    """Return the root of sums of squares (sensors,) in parts of the readings' in records, by name."""
    whole = np.sum([np.sum(record.readings**2, axis=0) for record in records], axis=0)
    return dict(zip(sensors, map(float, np.sqrt(squares / np.maximum(whole, 1e-300))), strict=True))


def noise_alone(sensors: Sequence[str], records: Sequence[Data]) -> dict[str, float]:
    """Return the relative error that the noise of records alone makes, by name."""
    return relative(sensors, records, np.sum([len(record) * record.noise**2 for record in records], axis=0))


def judged(sensing: Sensitivity, theta: Array, unseen: Sequence[Data], weights: Array) -> dict[str, float]:
    """Return the relative error of each sensor over records that were not fitted, by name.

    Args:
        sensing: the twin, with the parameters that were fitted.
        theta: their values (k,), in declared units.
        unseen: the records; the initial state of each is estimated.
        weights: of squared residuals of each sensor (sensors,).

    Raises:
        IntegrationError: the motion is not finite.
    """
    squares = np.zeros(len(weights))
    for record in unseen:
        found = nearest(sensing, theta, record, weights)
        if found is None:
            raise IntegrationError(f"the simulated motion is no longer finite in {record.name}")
        squares += found[1].squares
    return relative(sensing.twin.sensors, unseen, squares)


def simulate(twin: Twin, record: Data, shared: Sequence[str] = ()) -> Simulated:
    """Simulate a record from the initial state that reproduces it best; internal states of effects are at rest.

    Args:
        twin: the plant, with the values to simulate with.
        record: commands and readings.
        shared: parameters that a fit had free: its compiled functions are then used again.

    Raises:
        IntegrationError: the motion is not finite from any initial state that was tried.
    """
    sensing = Sensitivity(twin, (), tuple(shared))
    size = np.maximum(np.abs(record.readings).max(axis=0), 1e-300)
    weights = np.maximum(record.noise, 1e-12 * size) ** -2.0
    found = nearest(sensing, sensing.start(), record, weights)
    if found is None:
        raise IntegrationError(f"the simulated motion is no longer finite in {record.name}")
    plant = twin.declaration.sensors
    units = tuple("" if plant[name].unit == "1" else plant[name].unit for name in twin.sensors)
    return Simulated(record, twin.sensors, units, found[1].simulated)


def nearest(sensing: Sensitivity, theta: Array, record: Data, weights: Array) -> tuple[Array, NormalEquations] | None:
    """Return the initial state (states,) from which a record is reproduced best, and what is simulated from there.

    Internal states of effects begin at rest. None where the motion is not finite.

    Args:
        sensing: the twin.
        theta: values of its parameters (k,), in declared units.
        record: commands and readings.
        weights: of squared residuals of each sensor (sensors,).
    """
    k, free = len(theta), np.array(sensing.twin.free, dtype=int)
    substeps, basis, own = sensing.twin.substeps(record.rate), sensing.basis(theta), np.ix_(k + free, k + free)
    y, best, least = first_start(sensing, record), None, np.inf
    for _ in range(ROUNDS):
        try:
            found_so_far = sensing.normal_equations(
                basis, y, record.acting, record.readings, weights, rate=record.rate, substeps=substeps,
                hold=record.hold,
            )  # fmt: skip
        except IntegrationError:
            break
        cost = float(weights @ found_so_far.squares)
        if not cost < least * (1.0 - SETTLED):
            break
        best, least, y = (y, found_so_far), cost, y.copy()
        y[free] += np.linalg.lstsq(found_so_far.matrix[own], found_so_far.gradient[k + free], rcond=1e-12)[0]
    return best


def first_start(sensing: Sensitivity, record: Data) -> Array:
    """Return a guess of the initial state (states,): coordinates and velocities by a parabola through first readings.

    Internal states that may begin anywhere are found beside the coordinates; the others are at rest.
    """
    n, count = len(sensing.twin.model.coordinates), min(FIRST_READINGS, len(record))
    y = sensing.twin.rest(np.zeros(n))
    read, jacobian = sensing.sensed(y, record.acting[0])
    t = np.arange(count) / record.rate
    found = np.polyfit(t, record.readings[:count] - read, min(2, count - 1))
    seen = [i for i in sensing.twin.free if not n <= i < 2 * n]
    inverse = np.linalg.pinv(jacobian[:, seen])
    y[seen] += inverse @ found[-1]
    if count > 1:
        y[n : 2 * n] = inverse[:n] @ found[-2]
    return y
