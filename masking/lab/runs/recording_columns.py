"""Columns of the recording of a run, with their units and meanings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.model.declaration import instrument_declaration, schema
from masking.model.declaration.input_definitions import cell
from masking.model.declaration.registry import Assembly
from masking.model.modelling.model import Model


@dataclass
class Columns:
    """The columns of a recording, each in its declared unit, with its meaning, while they are gathered."""

    assembly: Assembly  # the declarations of the experiment
    plant: Model  # the model of the rig
    virtual: Model  # the virtual system
    columns: dict[str, Array] = field(default_factory=dict)
    units: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def _ports(self) -> Mapping[str, instrument_declaration.Actuator | schema.Input]:
        return self.assembly.plant.actuators or self.assembly.plant_model.inputs

    def add(self, name: str, values: Array, unit: str, meaning: str) -> None:
        """Add one column (m,), with its unit, and its meaning in words."""
        self.columns[name] = np.ascontiguousarray(values)
        self.units[name] = {"unit": unit, "meaning": meaning}

    def add_motion(self, times: Array, rig: Array, virtual: Array, ideal: Array) -> Columns:
        """Add time, and coordinates and velocities of the rig, the virtual system and the ideal.

        The states (m, .) are those that are computed: of the rig in SI units, of the others in the virtual system's.
        """
        self.add("t", times, "s", "time")
        motions = ("rig", self.plant, rig), ("virtual", self.virtual, virtual), ("ideal", self.virtual, ideal)
        for prefix, model, states in motions:
            declared = model.declaration
            meanings = {n: c.meaning for n, c in declared.coordinates.items()}
            meanings = {**meanings, **{f"{name}'": f"rate of {name}" for name in meanings}}
            meanings |= {name: state.meaning for name, state in declared.states.items() if prefix != "rig"}
            for i, (name, meaning) in enumerate(meanings.items()):
                unit, size = model.shown[name]
                self.add(f"{prefix}.{name}", states[:, i] / size, unit, meaning)
        return self

    def add_inputs(self, inputs: Mapping[str, Array]) -> Columns:
        """Add inputs of the virtual system that are no expressions (m,), as `virtual_input`."""
        for name, values in inputs.items():
            unit, size = self.virtual.shown_in(self.virtual.declaration.parameters[cell(name, "c0")].unit)
            self.add(f"virtual_input.{name}", values / size, unit, f"input {name} of the virtual system")
        return self

    def add_sensors(self, readings: Array) -> Columns:
        """Add the readings (m, sensors)."""
        for i, (name, sensor) in enumerate(self.assembly.plant.sensors.items()):
            self.add(f"sensor.{name}", readings[:, i], sensor.unit, sensor.meaning)
        return self

    def add_actuators(self, prefix: str, commands: Array) -> Columns:
        """Add commands (m, actuators) as `input`, what was applied, or as `demanded`, before limits."""
        for i, (name, port) in enumerate(self._ports.items()):
            meaning = port.meaning if prefix == "input" else f"demanded of {name}"
            self.add(f"{prefix}.{name}", commands[:, i], port.unit, meaning)
        return self

    def add_power(self, power: Array) -> Columns:
        """Add the mean power of each actuator (m, actuators), W."""
        for i, name in enumerate(self._ports):
            self.add(f"power.{name}", power[:, i], "W", f"mean power of {name}")
        return self
