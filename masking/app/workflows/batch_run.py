"""Run of a batch: a process of its own for each try, so that what ends it ends one try alone.

    python -m masking.app.workflows.batch_run HANDLE

It is given an open file with the try, as the batch has read it: what becomes of files meanwhile changes nothing. It
looks whether the rig is at rest and where its sensors were before the first run, runs, saves the recording, and prints
what became of it as a line of JSON. It ends in order when the process that started it is gone.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import EmergencyStopError, MaskingError, PlantError, PlantLostError, PlantRefusedError, RecordError
from masking.lab.plants import adapters
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.safety_chain import Cause
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import stream, stream_reader
from masking.lab.records.child_process import end_with_parent
from masking.lab.records.recording import Recording
from masking.lab.runs import batch_plan, rig_run, safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.realtime import Hooks, run_rig
from masking.lab.runs.self_test import part_moved
from masking.lab.runs.stopping import FAILED, INTERRUPTED, TRIPPED

_LOST: Final = (Cause.PLANT_LOST, Cause.COMM_LOST)
_LOOKED: Final = 0.25  # s that sensors are looked at
_STILL: Final = 0.01  # of a limit, within which a rig that is at rest may move
_OFF: Final = 8.0  # standard deviations of noise that no motion is


@dataclass(frozen=True)
class Try:
    """All that a try is made of."""

    experiment: Experiment  # with the values of its run
    folder: Path  # of the recording
    address: str | None  # of the plant; None for the twin
    key: Key | None  # of the plant's server
    lockstep: bool
    drift: float  # of a limit, that the sensors' zeros may have moved
    patience: float  # s until the rig is at rest
    zero: Mapping[str, float]  # readings at rest before the first run; empty in the first


def main(arguments: list[str] | None = None) -> int:
    """Run a try; return the exit status."""
    end_with_parent()
    with os.fdopen(int((sys.argv[1:] if arguments is None else arguments)[0]), "rb") as file:
        wanted: Try = pickle.load(file)  # noqa: S301  (a file without a name, that its parent wrote)
    began = time.monotonic()
    try:
        with Operator() as operator:
            found = outcome(wanted, partial(_plant, wanted), operator)
    except PlantLostError as error:
        is_there = stream.is_in(wanted.folder)
        found = {"end": FAILED if is_there else batch_plan.UNREACHABLE, "why": str(error)}
    except PlantRefusedError as error:
        found = {"end": batch_plan.UNREACHABLE, "why": str(error)}
    except (MaskingError, OSError) as error:  # the latter where a disk or the memory is full
        found = {"end": FAILED, "why": str(error)}
    print(json.dumps(found | {"seconds": round(time.monotonic() - began, 3)}), flush=True)
    return 0


def _plant(wanted: Try) -> Plant:
    made, address = wanted.experiment, wanted.address
    return adapters.connect(address, wanted.key) if address else SimulatedPlant(made.twin, made.declaration.seed)


def outcome(wanted: Try, plant: Callable[[], Plant], operator: Operator) -> dict[str, Any]:
    """Make a try on a plant, of which each call gives one, and save its recording; return what became of it.

    A MaskingError where nothing was recorded: a PlantError where the rig does not rest or the plant is lost or refuses.
    """
    made, folder, lockstep = wanted.experiment, wanted.folder, wanted.lockstep or wanted.address is None
    kept: list[Recording] = []
    operator.trip = None
    try:
        zero = _at_rest(wanted, plant(), lockstep=lockstep, operator=operator)
        settings = rig_run.RunSettings(
            lockstep=lockstep, acknowledge=True, keep=kept.append, stream=folder, operator=operator
        )
        kept.append(rig_run.run(made, plant(), settings))
    except MaskingError as error:
        if kept and isinstance(error, PlantError):
            return _saved(made, kept[0], folder) | {"why": str(error), "zero": zero}
        if isinstance(error, EmergencyStopError):
            return {"end": TRIPPED, "why": str(error), "cause": Cause.ESTOP.name}
        if kept or operator.trip is None or operator.trip.cause in _LOST:
            raise
        return {"end": TRIPPED, "why": str(operator.trip), "cause": operator.trip.cause.name}  # before the release
    return _saved(made, kept[0], folder) | {"zero": zero}


def _saved(experiment: Experiment, recording: Recording, folder: Path) -> dict[str, Any]:
    """Save a recording; return the facts of it, with the energy of all ticks, the homing included."""
    recording.save(folder, overwrite=True)
    with contextlib.suppress(RecordError):
        found = stream_reader.read(folder)
        table, columns = found.table, list(found.manifest["columns"])
        inputs = table[:, [columns.index(f"input.{name}") for name in experiment.instruments.actuators]]
        spent = {"energy": batch_plan.energy(experiment, inputs, experiment.sampled.rate)}
        stream.remove(folder)
        return facts(experiment, recording) | spent
    return facts(experiment, recording)


def facts(experiment: Experiment, recording: Recording) -> dict[str, Any]:
    """How a recording ended, its masking errors, and the energy of its rows, in J."""
    rig, times = recording.manifest["rig"], recording.t
    rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else experiment.sampled.rate
    spent = batch_plan.energy(experiment, recording.array("input"), rate)
    trip = rig.get("trip")
    found = {"end": rig["end"], "chi": recording.manifest["masking_error"], "energy": spent}
    return found | ({} if trip is None else {"why": trip["sentence"], "cause": trip["cause"]})


def _at_rest(wanted: Try, plant: Plant, *, lockstep: bool, operator: Operator) -> dict[str, float]:
    """Wait until a rig is at rest, and return its readings; refuse one that moves, or a sensor whose zero has moved."""
    made, first, drift, patience = wanted.experiment, wanted.zero, wanted.drift, wanted.patience
    rate, twin = made.sampled.rate, made.twin
    held = safety_limits.without_model(safety_limits.rules(made.instruments, rate, twin))
    many, read, noise = max(2, round(_LOOKED * rate)), list[Array](), twin.noise()
    still = np.array([noise.get(name, 0.0) for name in twin.sensors])

    def step(_: int, readings: Array) -> Array:
        read.append(readings.copy())
        return np.zeros(len(plant.actuators))

    def is_still() -> bool:
        if len(read) < many or len(read) % many:
            return False
        last = np.array(read[-many:])
        beyond = np.maximum(np.abs(last - last.mean(axis=0)) - _OFF * still, 0.0)
        return part_moved(held, np.stack([beyond.max(axis=0), np.zeros(len(still))])) < _STILL

    ran = run_rig(
        step, plant, Settings(rate, lockstep=lockstep, acknowledge=True), samples=many + round(patience * rate),
        limits=held, hooks=Hooks(stop=is_still, look=operator.look),
    )  # fmt: skip
    if ran.trip is not None:
        operator.trip = ran.trip
        raise PlantError(f"before the run: {ran.trip}")
    if ran.reason == INTERRUPTED:
        raise MaskingError("the run was interrupted before it began")
    if not is_still():
        raise PlantError(f"the rig did not come to rest within {patience:g} s; look at what moves it")
    zero = dict(zip(plant.sensors, np.mean(read[-many:], axis=0).tolist(), strict=True))
    if first:
        off = np.array([[zero[name] - first[name] for name in plant.sensors], np.zeros(len(zero))])
        moved = part_moved(held, off)
        if moved > drift:
            raise PlantError(
                f"the sensors at rest have moved by {moved:.2g} of a limit since the first run, more than {drift:g}; "
                "look at their zeros, then start the same again"
            )
    return zero


if __name__ == "__main__":
    sys.exit(main())
