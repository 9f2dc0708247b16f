"""Columns of the recording of a run, with their units and meanings, and what its manifest says of all its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from masking.analysis.masking_error import ErrorSum
from masking.compile.numerics.arrays import Array
from masking.lab.runs.passive_coordinates import Passive
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

    def add(self, name: str, values: Array, unit: str, meaning: str) -> None:
        """Add one column (m,), with its unit, and its meaning in words."""
        self.columns[name] = np.ascontiguousarray(values)
        self.units[name] = {"unit": unit, "meaning": meaning}

    def add_motion(self, times: Array, rig: Array, virtual: Array, ideal: Array) -> Columns:
        """Add time, and coordinates, velocities and internal states of the rig, the virtual system and the ideal.

        The states (m, .) are those that are computed: of the rig in SI units, of the others in the virtual system's.
        """
        self.add("t", times, "s", "time")
        motions = ("rig", self.plant, rig), ("virtual", self.virtual, virtual), ("ideal", self.virtual, ideal)
        for prefix, model, states in motions:
            declared = model.declaration
            meanings = {n: c.meaning for n, c in declared.coordinates.items()}
            meanings = {**meanings, **{f"{name}'": f"rate of {name}" for name in meanings}}
            meanings |= {name: state.meaning for name, state in declared.states.items()}
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

    def add_channels(self, group: str, values: Array) -> Columns:
        """Add values (m, channels) of a group of `channels`."""
        for i, (name, (unit, meaning)) in enumerate(channels(self.assembly)[group].items()):
            self.add(f"{group}.{name}", values[:, i], unit, meaning)
        return self


def channels(assembly: Assembly) -> dict[str, dict[str, tuple[str, str]]]:
    """Unit and meaning of each channel of a plant, by its name, in groups.

    `sensor` are readings, `input` commands that were applied, `demanded` commands before limits, and `power` the mean
    power of each actuator.
    """
    ports = assembly.plant.actuators or assembly.plant_model.inputs
    return {
        "sensor": {name: (sensor.unit, sensor.meaning) for name, sensor in assembly.plant.sensors.items()},
        "input": {name: (port.unit, port.meaning) for name, port in ports.items()},
        "demanded": {name: (port.unit, f"demanded of {name}") for name, port in ports.items()},
        "power": {name: ("W", f"mean power of {name}") for name in ports},
    }


@final
class Summary:
    """Numbers of a run that need all of its rows, but not all at once.

    `first` is the first row of the virtual coordinates, by name, `last` the last time in s, and `passive` what the
    passive coordinates did, for the manifest; None where there are none. They are the first of those given, of the
    plant or of the controller's model, whose rig has its columns.
    """

    def __init__(self, virtual: Sequence[str], passive: Sequence[Passive | None]) -> None:
        self._errors, self._passive = {name: ErrorSum() for name in virtual}, passive
        self.first, self.last = dict[str, float](), 0.0
        self.passive: dict[str, Any] | None = None

    def add(self, columns: Mapping[str, Array]) -> None:
        """Add a chunk of rows: the columns of the recording (m,), by name."""
        self.first = self.first or {name: float(columns[f"virtual.{name}"][0]) for name in self._errors}
        self.last = float(columns["t"][-1])
        for name, errors in self._errors.items():
            errors.add(columns[f"virtual.{name}"], columns[f"ideal.{name}"])
        for passive in filter(None, self._passive):
            if not columns.keys() >= {f"rig.{name}" for name in passive.plant.coordinates}:
                continue
            entry = passive.entry(columns)
            self.passive = entry if self.passive is None else Passive.merged(self.passive, entry)
            break

    @property
    def masking_error(self) -> dict[str, float]:
        """Masking error of each virtual coordinate."""
        return {name: errors.value for name, errors in self._errors.items()}
