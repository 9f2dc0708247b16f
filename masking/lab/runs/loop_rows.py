"""Rows of a run as they go to disk while it goes on, the homing included, and the run that they were taken from."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.sampled_controller import SampledController
from masking.control.stepwise_controller import SampledStep
from masking.lab.records.recorder import Recorder
from masking.lab.records.recording import Recording
from masking.lab.runs import manifest
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.realtime import ANSWERED, INDEX, LOOP, Known
from masking.lab.runs.recording_columns import channels
from masking.lab.runs.simulated_run import TwinRun, samples_until
from masking.lab.runs.stopping import SYNCHRONISED
from masking.model.declaration import registry


@dataclass(frozen=True)
class RowLayout:
    """What the numbers of a row are."""

    experiment: Experiment  # that runs

    @cached_property
    def groups(self) -> dict[str, dict[str, dict[str, str]]]:
        """Unit and meaning of each column, by its name, in groups that lie side by side."""
        known, sampled = channels(self.experiment.assembly), self.experiment.sampled
        sizes, model = sampled.sizes, sampled.instruments.model
        coordinates = [*model.coordinates, *(f"{c}'" for c in model.coordinates)]
        states = [*coordinates, *(f"state {i}" for i in range(1, sizes.states - len(coordinates) + 1))]
        disturbed = dict.fromkeys(model.coordinates * sizes.at_masses, "acceleration of {} that the model lacks")
        disturbed |= dict.fromkeys(model.inputs * sizes.at_inputs, "what adds to {}")
        pushes = range(sampled.feed.lasting(sampled.values()).size)
        found = {
            **{group: known[group] for group in ("sensor", "input", "power")},
            "estimate": {n: ("SI", f"estimate of {n}") for n in states},
            "disturbance": {n: ("SI", what.format(n)) for n, what in disturbed.items() if sizes.order},
            "demanded": known["demanded"],
            "lasting": {str(i): ("SI", "what lasted of a push at the release") for i in pushes},
        }
        return {"loop": dict(LOOP)} | {
            group: {f"{group}.{n}": {"unit": unit, "meaning": meaning} for n, (unit, meaning) in entries.items()}
            for group, entries in found.items()
        }

    @cached_property
    def columns(self) -> dict[str, dict[str, str]]:
        """Unit and meaning of each column, by its name."""
        return {name: entry for group in self.groups.values() for name, entry in group.items()}

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Where each group is in a row."""
        ends = [0, *itertools.accumulate(len(group) for group in self.groups.values())]
        return {name: slice(*pair) for name, pair in zip(self.groups, itertools.pairwise(ends), strict=True)}

    def run(self, table: Array, after: int) -> TwinRun:
        """Run since the release that rows (rows, columns) are of, `after` of them if all are there."""
        rate, every = self.experiment.sampled.rate, self.experiment.every
        index, answered = (table[:, i].astype(np.int64) for i in (INDEX, ANSWERED))
        kept = np.flatnonzero((answered > 0) & (index >= 0) & (index < after) & (index % every == 0))
        parts = {name: np.ascontiguousarray(table[kept, place]) for name, place in self.slices.items()}
        estimates, sensed = parts["estimate"], (parts["sensor"], parts["demanded"], parts["input"], parts["power"])
        lasting = parts["lasting"][:1] if len(kept) else np.empty((1, parts["lasting"].shape[1]))
        return TwinRun(index[kept] / rate, estimates, estimates, *sensed, parts["disturbance"], lasting)

    def recording(self, table: Array, after: int, *, lockstep: bool, outcome: Mapping[str, object]) -> Recording:
        """Recording of a run on a plant that runs by itself, of rows as `run` takes them.

        With `lockstep`, controller and plant waited for each other; `outcome` says how the run ended and what was
        counted, for the manifest.
        """
        columns, _ = self.experiment.columns(self.run(table, after))
        made = self.experiment.recording(columns, {}, is_stopped=outcome["end"] == SYNCHRONISED)
        made.manifest.update(mode="lockstep" if lockstep else "real time", states="estimated", rig=dict(outcome))
        return made


def samples_after(experiment: Experiment, sampled: SampledController) -> int:
    """Samples from the release on to the planned end."""
    return samples_until(experiment.declaration.duration * experiment.time_scale, sampled.rate)


def known(controller: SampledStep, lasting: Array) -> Known:
    """State of a controller in rows, in the order of `RowLayout`; `lasting` (1, pushes) is changed in place."""
    sizes, state = controller.sampled.sizes, controller.state
    states = sizes.states + (sizes.disturbed if sizes.order else 0)
    columns = controller.power, state[:states], controller.demanded, lasting[0]
    return Known(controller.estimate, columns, controller.sampled.before)


def recorder(experiment: Experiment, folder: Path, spare: Path, **more: object) -> Recorder:
    """Recorder of the rows of a run, as `RowLayout` has them.

    `spare` is the folder for the rest where that of the stream is full, and `more` what else the manifest says. A
    RecordError where the folder holds a stream already, or cannot be written.
    """
    content = manifest.content(experiment.assembly, experiment.virtual, {**more, "inputs": experiment.inputs.entry()})
    content["declarations"]["experiment"] = registry.canonical(experiment.declaration)
    content = {name: value for name, value in content.items() if name not in {"rate", "format"}}
    return Recorder(folder, RowLayout(experiment).columns, experiment.sampled.rate, spare, **content)
