"""Ideal: the virtual system of an experiment integrated by itself, in chunks whose state is handed on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.lab.runs.experiment_inputs import VirtualInputs
from masking.lab.runs.simulated_run import chunks
from masking.model.modelling import input_series
from masking.model.modelling.model import Model

Reached: TypeAlias = tuple[float, Array]  # time of the rig in s, and the state of the virtual system by itself then


@dataclass(frozen=True)
class Ideal:
    """The motion that a rig should have."""

    virtual: Model  # the virtual system
    inputs: VirtualInputs  # its inputs that are no expressions
    time_scale: float  # seconds of the rig per unit of virtual time
    tolerance: float  # local relative error of the integrator

    @property
    def needs_memory(self) -> str:
        """Reason against an integration in chunks; empty for none."""
        if any(source.is_live for source in self.inputs.experiment.inputs.values()):
            return "the inputs of its virtual system come from the run itself"
        meta = self.virtual.kernels.meta
        return "its virtual system jumps, or depends on its past" if meta.get("lags") or meta.get("events") else ""

    def along(self, times: Array, live: Mapping[str, Array], reached: Reached) -> tuple[Array, Reached]:
        """Its states (m, .) at times of the rig (m,) in s, from where it has got to, and where it is then.

        `live` are inputs that the run alone knows, by name (m,).
        """
        (begin, state), parts, virtual, kernels = reached, list[Array](), self.virtual, self.virtual.kernels
        schedule, starts = self.inputs.along(times / self.time_scale, live), chunks(kernels, len(times))
        for first in starts:
            part = times[first : first + starts.step]
            span = np.concatenate([[begin], part]) / self.time_scale
            u, p = np.zeros(len(virtual.inputs)), virtual.values()
            found = input_series.integrate(kernels, span, state, u, p, schedule=schedule, tolerance=self.tolerance)
            parts.append(found.states[1:])
            begin, state = float(part[-1]), found.states[-1, : len(state)].copy()
        return parts[0] if len(parts) == 1 else np.concatenate(parts), (begin, state)
