"""Instruments: what a controller knows of a rig's sensors, actuators and limits, and of how late its commands act."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import HEATING, LARGEST, POWER, TIME
from masking.compile.numerics.newton import STEP, equilibrium, jacobian
from masking.control.input_curves import Branch, InputCurves
from masking.control.observer import Plan, check_followed, check_rate, check_sensing, unseen
from masking.control.rig.allocation import allocation
from masking.control.rig.sensor_errors import SensorError
from masking.control.rig.twin import PlacedEffect, Twin
from masking.errors import ActuationError, ModelError, RootError
from masking.model.declaration import schema
from masking.model.declaration.instrument_declaration import Sensor
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Instruments:
    """Sensors, actuators and limits of a rig, as its plant file declares them to the controller."""

    plant: schema.PlantDeclaration  # the content of the plant file
    model: Model  # the controller's model of the rig, in SI units
    factors: Mapping[str, float]  # size in SI units of each unit that the plant file uses
    # standard deviation of a reading of each sensor for which it is known, in the sensor's unit
    noise: Mapping[str, float]
    delay: int  # samples between a reading and the first effect of the command that answers it
    # slope (k, n) of what the controller drives by the coordinates at rest; by default it drives each
    driven: Array | None = None
    per_unit: Array | float = 1.0  # input per unit of what it does (m,)
    errors: tuple[SensorError, ...] = ()  # of sensors that are known, in the order in which a reading passes them

    def __post_init__(self) -> None:
        wrapping = [name for name, sensor in self.plant.sensors.items() if sensor.wraps]
        if wrapping:
            raise ModelError(
                f"{self.plant.name}: readings of {', '.join(wrapping)} wrap, and a controller follows readings that go "
                "on: count the turns where they are read, and declare the sensor without wraps for runs"
            )

    @classmethod
    def of(cls, twin: Twin) -> Instruments:
        """Instruments of a twin, whose model the controller has."""
        return cls(twin.declaration, twin.model, twin.kernels.meta["factors"], twin.noise(), twin.delay)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Channels that are commanded; the model's inputs where none are declared."""
        return tuple(self.plant.actuators or self.model.inputs)

    @property
    def units(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Units of the sensors, and of the actuators."""
        return tuple(x.unit for x in self.plant.sensors.values()), tuple(map(self.unit, self.actuators))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the sensors."""
        return tuple(self.plant.sensors)

    @cached_property
    def allocation(self) -> Array:
        """Allocation: input per unit of each command (inputs, actuators)."""
        return allocation(self.plant, self.model.declaration, self.model.parameter_values())

    @cached_property
    def allocation_inverse(self) -> Array:
        """Commands of least norm for each input (actuators, inputs).

        An ActuationError where the actuators cannot give each input independently of the others.
        """
        found = np.asarray(np.linalg.pinv(self.allocation), dtype=np.float64)
        missed = np.abs(np.diag(self.allocation @ found) - 1.0) > 1e-8
        if missed.any():
            names = [name for name, is_missed in zip(self.model.inputs, missed, strict=True) if is_missed]
            raise ActuationError(
                f"{self.plant.name}: the actuators ({', '.join(self.actuators)}) cannot give {', '.join(names)} "
                "independently of the other inputs; change the allocation, or add an actuator",
                names,
            )
        return found

    def gains(self) -> Array:
        """Readings per SI unit of what each sensor measures (sensors,)."""
        declared = self.plant.sensors.values()
        return np.array([s.gain.value * self.factors[s.gain.unit] / self.factors[s.unit] for s in declared])

    def limits(self) -> Array:
        """Limits of the actuators (actuators, 4), as `masking.compile.numerics.sampled_loop` reads them.

        A ModelError where an actuator has no largest command.
        """
        declared = self.plant.limits
        missing = [name for name in self.actuators if name not in declared.inputs]
        if missing:
            raise ModelError(
                f"{self.plant.name}: no largest command of {', '.join(missing)}: write it under limits.inputs, such as "
                f"'{missing[0]}: {{max: 0.42, unit: V}}'"
            )
        table = np.zeros((len(self.actuators), 4))
        for i, name in enumerate(self.actuators):
            size = self.factors[self.unit(name)]
            table[i, LARGEST] = declared.inputs[name].max * self.factors[declared.inputs[name].unit] / size
            table[i, TIME] = 1.0
            if declared.power is not None and declared.power.heating is not None:
                power, heating = declared.power, declared.power.heating
                table[i, POWER] = power.value * self.factors[power.unit]
                table[i, HEATING] = heating.value * self.factors[heating.unit] * size**2
                table[i, TIME] = power.time
        return table

    def unit(self, actuator: str) -> str:
        """Unit of an actuator."""
        return (self.plant.actuators or self.model.declaration.inputs)[actuator].unit

    def plan(self, rate: float, noise: float | None) -> Plan:
        """Plan of an observer: the model linearised at rest, the sensors and their noise, one for all if given.

        A ModelError where the sensors do not tell every coordinate, their noise is not known, or the rate is too low.
        """
        n = len(self.model.coordinates)
        dynamics, driven = self.linear()
        check_rate(rate, dynamics)
        sensing = self.sensing()
        passive = () if self.driven is None else np.flatnonzero(~self.driven.any(axis=0))
        hidden = tuple(i for i in unseen(sensing[:, :n]) if i in passive)
        seen = [i for i in range(n) if i not in hidden]
        check_sensing(sensing[:, seen], [self.model.coordinates[i] for i in seen], self.sensors)
        check_followed(dynamics, hidden, self.model.coordinates)
        levels = self.levels(sensing, noise)
        slope = np.eye(n) if self.driven is None else self.driven
        command = (
            self.allocation_inverse
            * self.per_unit
            @ np.linalg.pinv(slope @ driven)
            @ slope
            / self.limits()[:, [LARGEST]]
        )
        return Plan(dynamics, sensing, command, levels, 1.0 / rate, self.delay, hidden)

    def levels(self, sensing: Array, noise: float | None) -> Array:
        """Standard deviation of each reading (sensors,), one for all if given; `sensing` is as `sensing` gives it.

        A ModelError where that of a sensor which reads the rig is not known.
        """
        weighed = [name for name, row in zip(self.sensors, sensing, strict=True) if row.any()]
        unknown = [name for name in weighed if noise is None and name not in self.noise]
        if unknown:
            raise ModelError(
                f"{self.plant.name}: the noise of {', '.join(unknown)} is not known: declare an effect noise there in "
                "the plant file, or write controller.observer.noise, in the sensors' units"
            )
        return np.array([self.noise.get(name, 0.0) if noise is None else noise for name in self.sensors])

    def linear(self) -> tuple[Array, Array]:
        """D [q, v]/dt per [q, v] (2 n, 2 n), and accelerations per input (n, inputs), of the model at its place.

        Damping is that of velocities at which the model passes rest in oscillations of a unit of length: the slope of
        dry friction at rest is that of its smoothed sign, far beyond its mean over a motion.
        """
        model, n = self.model, len(self.model.coordinates)
        p, internal, place = model.values(), np.zeros(len(model.declaration.states)), self.model.first_place

        def slope(q: Array, v: Array, u: Array) -> Array:
            out = np.empty(2 * n + len(internal))
            model.kernels.derivative(0.0, np.concatenate([q, v, internal]), u, p, out)
            return out[: 2 * n]

        still, off = np.zeros(n), np.zeros(len(model.inputs))
        by_place = jacobian(lambda q: slope(q, still, off), place, STEP * model.lengths)
        fastest = float(np.sqrt(np.abs(np.linalg.eigvals(by_place[n:])).max())) or 1.0
        by_rate = jacobian(lambda v: slope(place, v, off), still, fastest * model.lengths)
        driven = jacobian(lambda u: slope(place, still, u), off, np.ones(len(off)))
        return np.hstack([by_place, by_rate]), driven[n:]

    def sensing(self) -> Array:
        """Readings per unit of [q, v] (sensors, 2 n) at rest at the model's place."""
        names = [*self.model.coordinates, *(f"{c}'" for c in self.model.coordinates)]
        steps = STEP * np.tile(self.model.lengths, 2)
        found = np.empty((len(self.sensors), len(names)))
        place = dict(zip(names, [*self.model.first_place, *np.zeros(len(self.model.coordinates))], strict=True))
        values = self.model.parameter_values() | place
        for i, (name, step) in enumerate(zip(names, steps, strict=True)):
            up, down = (self._readings(values | {name: place[name] + by}) for by in (step, -step))
            found[:, i] = (up - down) / (2.0 * step)
        return found

    def positions(self, readings: Array, near: Array | None = None) -> Array:
        """Coordinates (n,) at which a rig at rest would give readings (sensors,), by Newton's method.

        What no sensor reads stays as it is `near` (n,), by default at the model's place.
        """
        inverse = np.linalg.pinv(self.sensing()[:, : len(self.model.coordinates)])
        q = self.model.first_place if near is None else near
        for _ in range(20):
            q = q + inverse @ (readings - self.readings(q))
        return q

    def readings(self, q: Array) -> Array:
        """Readings (sensors,) of a rig at rest at coordinates (n,)."""
        names = self.model.coordinates
        at = self.model.parameter_values() | {f"{c}'": 0.0 for c in names} | dict(zip(names, q, strict=True))
        return self._readings(at)

    def _readings(self, values: Mapping[str, float]) -> Array:
        pairs = zip(self.gains(), self.plant.sensors.values(), strict=True)
        found = {name: gain * self.measured(s, values) for name, (gain, s) in zip(self.sensors, pairs, strict=True)}
        for error in self.errors:
            found[error.sensor] = error.reading(found[error.sensor])
        return np.array(list(found.values()))

    def measured(self, sensor: Sensor, values: Mapping[str, float]) -> float:
        """Measured value of a rig at rest, in SI units; outputs are those without further forces."""
        model = self.model
        still = dict(zip(model.states, model.first_internal, strict=True)) | {f"{c}''": 0.0 for c in model.coordinates}
        still |= {"t": 0.0, **dict.fromkeys(model.inputs, 0.0)}
        at = still | {**values}
        outputs = {n: o.expression for n, o in model.declaration.outputs.items() if n in sensor.measures.names}
        pending = dict(model.declaration.definitions) if outputs else {}
        while ready := [n for n, x in pending.items() if not x.names & pending.keys()]:
            at |= {name: pending.pop(name).evaluate(at) for name in ready}
        return sensor.measures.evaluate({n: x.evaluate(at) for n, x in outputs.items()} | at)

    def rest(self) -> Array:
        """Coordinates (n,) at which the model rests without inputs; a ModelError where there are none near 0."""
        model, n = self.model, len(self.model.coordinates)
        inputs, p = np.zeros(len(model.inputs)), model.values()
        internal = model.first_internal
        out = np.empty(2 * n + len(internal))

        def accelerations(q: Array) -> Array:
            model.kernels.derivative(0.0, np.concatenate([q, np.zeros(n), internal]), inputs, p, out)
            return out[n : 2 * n].copy()

        try:
            return equilibrium(accelerations, model.lengths)
        except RootError as error:
            raise ModelError(
                f"{model.name} does not rest near its zero without inputs, where controller.rest measures the sensors' "
                "offsets; leave rest out"
            ) from error


def gain_factor(twin: Twin, error: PlacedEffect) -> float:
    """Factor 1 + e by which a channel of a twin gives more than is declared, by an effect that is a gain error."""
    return 1.0 + twin.parameter_value(f"{error.label}_e")


def corrected_sensors(twin: Twin, errors: Iterable[PlacedEffect]) -> dict[str, Sensor]:
    """Sensors of a twin's plant file, with the gains that they have by the gain errors among effects."""
    sensors = dict(twin.declaration.sensors)
    for one in errors:
        if one.kind == "sensor_gain":
            gain = sensors[one.at].gain
            exact = gain.model_copy(update={"value": gain.value * gain_factor(twin, one)})
            sensors[one.at] = sensors[one.at].model_copy(update={"gain": exact})
    return sensors


def branches(twin: Twin, model: Model) -> tuple[Branch, ...]:
    """Branch of the curve of each input of a model that acts nonlinearly, within the limits of a rig; often none.

    A ModelError where a limit is not known, or the curve turns within it.
    """
    curves = InputCurves(model)
    if not curves.names:
        return ()
    known = Instruments(twin.declaration, model, twin.kernels.meta["factors"], {}, 0)
    return curves.branches(np.abs(known.allocation) @ known.limits()[:, LARGEST])
