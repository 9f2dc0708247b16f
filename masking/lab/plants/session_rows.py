"""What happened in the session of a served plant, a row for each sample, and the recording that is made of it."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.lab.plants.interface import Plant, Sample, Telling
from masking.lab.records.recording import Recording
from masking.lab.records.tick_times import timing

CHUNK: Final = 4096  # rows
_FIXED: Final = ("t", "tick", "wall", "late", "fresh", "latched")


@final
class SessionRows:
    """The rows of a session, in chunks made ahead so that no tick waits for memory."""

    def __init__(self, plant: Plant) -> None:
        self.names = [*_FIXED, *(f"sensor.{name}" for name in plant.sensors)]
        self.inputs = slice(len(self.names), len(self.names) + len(plant.actuators))
        self.names += [f"input.{name}" for name in plant.actuators]
        self.telemetry = tuple(plant.telemetry()) if isinstance(plant, Telling) else ()
        self.names += [f"plant.{name}" for name in self.telemetry]
        self.sensors = slice(len(_FIXED), self.inputs.start)
        self.count = 0
        self.is_open = False
        self.chunks = [self.chunk(), self.chunk()]

    def chunk(self) -> Array:
        """Make room for more rows."""
        return np.full((CHUNK, len(self.names)), np.nan)

    @property
    def row(self) -> Array:
        """The last row that was begun."""
        row: Array = self.chunks[(self.count - 1) // CHUNK][(self.count - 1) % CHUNK]
        return row

    def begin(self, sample: Sample, rate: float, wall: float, late: float) -> None:
        """Begin the row of a sample."""
        if self.count == len(self.chunks) * CHUNK:
            self.chunks.append(self.chunk())
        self.count += 1
        self.is_open = True
        row = self.row
        row[:4] = sample.index / rate, sample.index, wall, late
        row[self.sensors] = sample.values

    def finish(self, plant: Plant, command: Array, *, fresh: bool, latched: bool) -> None:
        """Complete the row: the command (actuators,) that held, the plant's telemetry, and what happened."""
        row = self.row
        row[4:6] = fresh, latched
        row[self.inputs] = command
        if isinstance(plant, Telling):
            values = plant.telemetry()
            row[self.inputs.stop :] = [values[name] for name in self.telemetry]
        self.is_open = False

    def recording(self, manifest: Mapping[str, Any]) -> Recording:
        """Rows; what is not finite is 0 there, and 1 in `nonfinite.<column>`."""
        columns = dict(zip(self.names, np.concatenate(self.chunks)[: self.count].T, strict=True))
        for name, column in list(columns.items()):
            finite = np.isfinite(column)
            if not finite.all():
                columns[name] = np.where(finite, column, 0.0)
                columns[f"nonfinite.{name}"] = np.where(finite, 0.0, 1.0)
        created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        head = {"name": "a plant's own record", "created": created}
        clock = {"lateness": columns["late"]} if manifest["clock"] == "real" else {}
        return Recording(columns, {**head, **manifest, "timing": timing(columns["tick"].astype(np.int64), **clock)})
