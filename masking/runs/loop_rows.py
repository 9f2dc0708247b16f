"""Rows of a run as they go to disk while it goes on, the homing included, and the run that they were taken from."""

from __future__ import annotations

import contextlib
import itertools
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.control.sampled import SampledController
from masking.control.step import SampledStep
from masking.numerics.arrays import Array
from masking.records import stream
from masking.records.recorder import Recorder
from masking.runs import manifest
from masking.runs.experiment import Experiment
from masking.runs.offline import TwinRun
from masking.runs.realtime import Rows

_LOOP: Final = {
    "tick": {"unit": "1", "meaning": "tick of the plant's clock"},
    "index": {"unit": "1", "meaning": "sample, 0 at the release and negative in the homing"},
    "wall": {"unit": "s", "meaning": "time since the first sample, measured"},
    "late": {"unit": "1", "meaning": "1 where samples before were missed, or the tick began more than a period late"},
    "lateness": {"unit": "s", "meaning": "how late the tick began"},
    "duration": {"unit": "s", "meaning": "how long the controller took"},
    "answered": {"unit": "1", "meaning": "1 where the controller answered the sample"},
}


@dataclass(frozen=True)
class RowLayout:
    """What the numbers of a row are.

    Args:
        experiment: that runs.
    """

    experiment: Experiment

    @cached_property
    def groups(self) -> dict[str, dict[str, dict[str, str]]]:
        """Return unit and meaning of each column, by its name, in groups that lie side by side."""
        plant, sampled = self.experiment.assembly.plant, self.experiment.sampled
        sizes, model = sampled.sizes, sampled.instruments.model
        ports = plant.actuators or self.experiment.assembly.plant_model.inputs
        actuators = {name: ports[name] for name in sampled.instruments.actuators}
        coordinates = [*model.coordinates, *(f"{c}'" for c in model.coordinates)]
        states = [*coordinates, *(f"state {i}" for i in range(1, sizes.states - len(coordinates) + 1))]
        disturbed = model.coordinates[: sizes.coordinates] if sizes.order else ()
        lasting = sampled.feed.lasting(sampled.values())
        return {
            "loop": dict(_LOOP),
            "sensor": {f"sensor.{n}": {"unit": s.unit, "meaning": s.meaning} for n, s in plant.sensors.items()},
            "input": {f"input.{n}": {"unit": a.unit, "meaning": a.meaning} for n, a in actuators.items()},
            "demanded": {
                f"demanded.{n}": {"unit": a.unit, "meaning": f"demanded of {n}"} for n, a in actuators.items()
            },
            "power": {f"power.{n}": {"unit": "W", "meaning": f"mean power of {n}"} for n in actuators},
            "estimate": {f"estimate.{n}": {"unit": "SI", "meaning": f"estimate of {n}"} for n in states},
            "disturbance": {
                f"disturbance.{n}": {"unit": "SI", "meaning": f"acceleration of {n} that the model lacks"}
                for n in disturbed
            },
            "lasting": {
                f"lasting.{i}": {"unit": "SI", "meaning": "what lasted of a push at the release"}
                for i in range(lasting.size)
            },
        }

    @cached_property
    def columns(self) -> dict[str, dict[str, str]]:
        """Return unit and meaning of each column, by its name."""
        return {name: entry for group in self.groups.values() for name, entry in group.items()}

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Return where each group is in a row."""
        ends = [0, *itertools.accumulate(len(group) for group in self.groups.values())]
        return {name: slice(*pair) for name, pair in zip(self.groups, itertools.pairwise(ends), strict=True)}

    def run(self, table: Array, after: int) -> TwinRun:
        """Return the run that rows (rows, columns) were taken from: what `hardware.run` makes of its own.

        Args:
            table: since the first sample, or a part of it.
            after: samples from the release on.
        """
        rate, every = self.experiment.sampled.rate, self.experiment.every
        index, answered = (table[:, list(_LOOP).index(name)].astype(np.int64) for name in ("index", "answered"))
        kept = np.flatnonzero((answered > 0) & (index >= 0) & (index < after) & (index % every == 0))
        parts = {name: np.ascontiguousarray(table[kept, place]) for name, place in self.slices.items()}
        has_disturbances = self.experiment.sampled.sizes.order > 0
        return TwinRun(
            index[kept] / rate,
            parts["estimate"],
            parts["estimate"],
            parts["sensor"],
            parts["demanded"],
            parts["input"],
            parts["power"],
            parts["disturbance"] if has_disturbances else None,
            parts["lasting"][:1] if len(kept) else np.empty((1, parts["lasting"].shape[1])),
        )


def samples_after(experiment: Experiment, sampled: SampledController) -> int:
    """Return the samples from the release on to the planned end."""
    return int(np.floor(experiment.declaration.duration * experiment.time_scale * sampled.rate * (1.0 + 1e-12))) + 1


@final
class StreamedRows:
    """The rows of a run on their way to disk.

    Args:
        experiment: that runs.
        controller: that answers.
        folder: of the stream.
        spare: folder for the rest where that one is full.
        **more: what else the manifest says.

    Raises:
        RecordError: the folder holds a stream already, or cannot be written.
    """

    def __init__(
        self,
        experiment: Experiment,
        controller: SampledStep,
        folder: Path,
        spare: Path,
        **more: Any,  # noqa: ANN401
    ) -> None:
        self.layout, self._folder = RowLayout(experiment), folder
        declaration = experiment.declaration
        content = manifest.content(experiment.assembly, experiment.virtual, more)
        files = experiment.assembly.plant.files
        content["read_from"] = {
            "experiment": str(Path(next(iter(declaration.files), declaration.name)).absolute()),
            "plant": str(Path(next(iter(files), "")).absolute()) if files and not declaration.plants else None,
        }
        content = {name: value for name, value in content.items() if name not in {"rate", "format"}}
        self.recorder = Recorder(folder, self.layout.columns, controller.rate, spare, **content)
        self._row = np.zeros(len(self.layout.columns))
        sizes, state = controller.sampled.sizes, controller.state
        known = {
            "demanded": controller.demanded,
            "power": controller.power,
            "estimate": controller.estimate,
            "disturbance": state[sizes.states : sizes.states + sizes.coordinates] if sizes.order else None,
        }
        parts = {name: self._row[place].data for name, place in self.layout.slices.items()}
        # Memory to memory; measured: a third of the time of arrays.
        self._known = [(parts[name], source.data) for name, source in known.items() if source is not None]
        self._loop, self._sensors, self._applied = (parts[name] for name in ("loop", "sensor", "input"))
        self._lasting = self._row[self.layout.slices["lasting"]]

    def put(self, rows: Rows, first: int, lasting: Array) -> None:
        """Record the last row of a loop.

        Args:
            rows: of the loop.
            first: tick of the release.
            lasting: of pushes at the release (1, pushes).
        """
        k, loop = rows.count - 1, self._loop
        tick, taken = rows.index.item(k), rows.durations.item(k)
        loop[0], loop[1], loop[2] = tick, tick - first, rows.wall.item(k) - rows.wall.item(0)
        loop[3], loop[4], loop[5], loop[6] = rows.late.item(k), rows.lateness.item(k), taken, taken > 0.0
        self._sensors[:], self._applied[:] = rows.sensors[k].data, rows.applied[k].data
        if taken > 0.0:
            for target, source in self._known:
                target[:] = source
            if len(self._lasting):
                self._lasting[:] = lasting[0]
        self.recorder.ring.put(self._row)

    def end(self, *, keep: bool) -> None:
        """Record the last rows; remove the stream where it is not kept, and its folder if nothing else is there."""
        self.recorder.close()
        if not keep:
            stream.remove(self._folder)
            with contextlib.suppress(OSError):
                self._folder.rmdir()
