"""Parted motion: why a run moved far from the wanted motion, where the wanted system itself has a part in that."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from masking.analysis.stability.attractors import parting
from masking.compile.numerics.arrays import Array
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment

FAR: Final = 0.3  # masking error from which on it is asked for
_FEWEST: Final = 100  # rows that say something


def noted(experiment: Experiment, recording: Recording) -> Recording:
    """Recording whose manifest says under `parting` why its motion parted from the wanted one, where that is known.

    It is asked where the masking error is large, all inputs of the virtual system are expressions, nothing else is
    regulated, and the recording is in memory.
    """
    chi = recording.manifest["masking_error"]
    given = any(source.expression is None for source in experiment.declaration.inputs.values())
    is_other = given or experiment.declaration.controller.regulate is not None
    if is_other or recording.is_on_disk or len(recording) < _FEWEST or not max(chi.values(), default=0.0) > FAR:
        return recording
    virtual = experiment.virtual
    names = [*virtual.coordinates, *(f"{name}'" for name in virtual.coordinates), *virtual.states]

    def states(kind: str) -> Array:
        columns = [recording[f"{kind}.{name}"] * virtual.shown[name].size for name in names]
        return np.ascontiguousarray(np.column_stack(columns))

    found = parting(virtual, recording.t / experiment.time_scale, states("virtual"), states("ideal"))
    entry = found.as_dict({name: virtual.shown[name].size for name in virtual.coordinates})
    return replace(recording, manifest={**recording.manifest, "parting": entry}) if entry else recording
