"""Channels: which columns of a record a procedure is about, and the unit that they are in.

A record has commands as `input.<name>` and readings as `sensor.<name>`, or plain columns with these names. With a
plant, readings become what the sensor measures, such as a displacement; without one they stay in its own unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import RecordError, nearest
from masking.lab.records import clock
from masking.lab.records.recording import Recording
from masking.model.declaration import units
from masking.model.modelling.scales import Units

STILL = 1e-12  # of its largest value: a command that changes by less does not move
OPTIONS = {"input": "--input", "sensor": "--sensor"}  # of the command line, by which a channel of each kind is named


@dataclass(frozen=True)
class Channel:
    """One column of a record, such as `input.V1` of the input V1.

    The unit of its values (samples,) is "" if neither the record nor the plant declares it.
    """

    name: str
    column: str
    unit: str
    values: Array

    @property
    def label(self) -> str:
        """Column with its unit, such as `input.V1 [V]`."""
        return f"{self.column} [{self.unit}]" if self.unit else self.column


@dataclass(frozen=True)
class Source:
    """A record to measure on: its name for messages, what it holds, and the plant that it is of, if given."""

    name: str
    recording: Recording
    twin: Twin | None = None

    @property
    def times(self) -> Array:
        """Times of the samples, s (samples,)."""
        return np.asarray(self.recording.t, dtype=np.float64)

    def rate(self) -> float:
        """Samples per second; a RecordError where the clock is not steady."""
        return clock.rate(self.times, self.name)

    def choices(self, kind: str) -> tuple[str, ...]:
        """Names of a kind, input or sensor: those with its prefix, or every column where there is none."""
        plain = (c for c in self.recording.columns if c != "t" and not c.startswith(("input.", "sensor.")))
        return self.recording.names(kind) or tuple(plain)

    def one(self, kind: str, wanted: str | None) -> Channel:
        """Channel of a kind that is named, or the only one there is; of inputs, the only one that moves.

        Raises:
            RecordError: there is no such channel, or none is named where there are several; names the choices.
        """
        names = self._moving(kind) if wanted is None else [wanted]
        if len(names) != 1:
            what = f"{len(names)} inputs that move" if kind == "input" else f"{len(names)} sensors"
            raise RecordError(
                f"{self.name}: it has {what}: {', '.join(names)}; say which one is meant, such as "
                f"{OPTIONS[kind]} {names[0]}"
            )
        return self._channel(kind, names[0])

    def several(self, kind: str, wanted: Sequence[str]) -> tuple[Channel, ...]:
        """Channels of a kind that are named; all where none is, of inputs all that move.

        Raises:
            RecordError: there is no such channel, or one is named twice.
        """
        twice = sorted({name for name in wanted if list(wanted).count(name) > 1})
        if twice:
            raise RecordError(f"the {kind} {twice[0]} is named twice; give each once")
        return tuple(self._channel(kind, name) for name in wanted or self._moving(kind))

    def displacement(self, wanted: str | None) -> Channel:
        """Displacement that a sensor measures if the plant is given, as `measured`; otherwise its reading."""
        return self.measured(self.one("sensor", wanted))

    def measured(self, reading: Channel) -> Channel:
        """What a sensor measures: its reading over its gain, if the plant is given; a RecordError if that lacks it.

        A coordinate, its rate or a state is in the unit that the model declares, all else in SI units.
        """
        if self.twin is None:
            return reading
        sensors = self.twin.declaration.sensors
        if reading.name not in sensors:
            remedy = nearest(reading.name, sensors)
            raise RecordError(
                f"{self.name}: {self.twin.declaration.name} has no sensor '{reading.name}' ({remedy}); give the plant "
                "that was recorded, or none to stay in the unit of the reading"
            )
        sensor = sensors[reading.name]
        gain = sensor.gain.value * units.factor_of(sensor.gain.unit) / units.factor_of(sensor.unit)
        pairs = zip(units.dimension_of(sensor.unit), units.dimension_of(sensor.gain.unit), strict=True)
        dimension = tuple(a - b for a, b in pairs)
        known = self.twin.model.shown.get(sensor.measures.text.strip())
        is_known = known is not None and units.dimension_of(known.unit) == dimension
        unit, size = known if known is not None and is_known else (units.describe(dimension), 1.0)
        return Channel(reading.name, reading.column, "" if unit == "1" else unit, reading.values / gain / size)

    def scale(self, unit: str) -> float:
        """Size of 1 in the scales of the plant's model, in a unit, such as 5e-3 for m; 1 without any scale."""
        if self.twin is None or not unit:
            return 1.0
        overrides = {n: v for n, v in self.twin.declaration.parameters.items() if n in self.twin.base.parameters}
        return Units.of(self.twin.base).size(unit, overrides) / units.factor_of(unit)

    def _moving(self, kind: str) -> list[str]:
        """Names to choose from: of inputs those that are not constant."""
        names = self.choices(kind)
        if kind == "input":
            columns = {n: np.asarray(self.recording[self._column(kind, n)]) for n in names}
            names = tuple(n for n, x in columns.items() if np.ptp(x) > STILL * np.abs(x).max())
        if not names:
            listed = ", ".join(c for c in self.recording.columns if c != "t") or "none but t"
            what = "no input that moves" if kind == "input" else "no column of a sensor"
            raise RecordError(f"{self.name}: it has {what}; its columns are {listed}")
        return list(names)

    def _column(self, kind: str, name: str) -> str:
        return next((c for c in (f"{kind}.{name}", name) if c in self.recording.columns), "")

    def _channel(self, kind: str, name: str) -> Channel:
        column = self._column(kind, name)
        if not column:
            choices = self.choices(kind)
            raise RecordError(
                f"{self.name}: there is no {kind} '{name}'; its {kind}s are {', '.join(choices) or 'none'}; "
                f"{nearest(name, choices)}"
            )
        columns = self.recording.manifest.get("columns")
        entry = columns.get(column) if isinstance(columns, dict) else None
        unit = str(entry.get("unit", "")) if isinstance(entry, dict) else ""
        if not unit and self.twin is not None:
            plant = self.twin.declaration
            ports = {"input": plant.actuators or self.twin.base.inputs, "sensor": plant.sensors}[kind]
            unit = ports[column.split(".")[-1]].unit if column.split(".")[-1] in ports else ""
        return Channel(
            name.removeprefix(f"{kind}."), column, "" if unit == "1" else unit,
            np.asarray(self.recording[column], dtype=np.float64),
        )  # fmt: skip
