"""Rig: an experiment on a plant that runs by itself, and a twin that stands in for such a plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from masking.declaration import registry
from masking.errors import ModelError, RecordError
from masking.experiment import Experiment
from masking.kernels import Array
from masking.loop import TwinRun
from masking.plants import serve as serving
from masking.plants.interface import Plant, Stop
from masking.plants.simulated import SimulatedPlant
from masking.plants.udp import UdpPlant
from masking.realtime import RigRun, run_rig
from masking.recording import Recording
from masking.sampled import Memory, SampledController
from masking.sampling import LARGEST
from masking.twin import Twin

# Kept beside the samples that are planned: an approach begins where the plant's clock stands.
WATCHDOG = 0.02


def connect(address: str) -> UdpPlant:
    """Return the plant at an address such as `udp://127.0.0.1:5005`."""
    return UdpPlant(address)


def serve(
    plant: str | Path,
    address: str,
    *,
    lockstep: bool = False,
    record: str | Path | None = None,
    seed: int = 0,
    sessions: int | None = None,
    ready: Callable[[str], None] | None = None,
    stop: Stop | None = None,
) -> tuple[Path, ...]:
    """Serve the twin of a plant to a controller in another process, until told to stop.

    Args:
        plant: a packaged plant, or a plant file.
        address: `udp://host:port`; port 0 takes a free one.
        lockstep: wait for each command, instead of a clock of its own.
        record: folder for the twin's own record of each session.
        seed: of the sensors' noise.
        sessions: how many to serve; None for any number.
        ready: called with the address once the twin can be reached.
        stop: looked at in each tick.

    Returns:
        the folders of the records.
    """
    declaration = registry.load_plant(plant)
    twin = Twin(declaration, registry.load_model(declaration.model, registry.refer(declaration, "model")))
    served = SimulatedPlant(twin, seed)
    return serving.serve(
        served,
        address,
        clock="lockstep" if lockstep else "real",
        record=record,
        stop_after=sessions,
        ready=ready,
        stop=stop,
    )


def run(
    experiment: Experiment,
    plant: Plant,
    *,
    lockstep: bool = False,
    watchdog: float = WATCHDOG,
    progress: Callable[[float], None] | None = None,
    stop: Stop | None = None,
) -> Recording:
    """Run an experiment on a plant, from rest through the approach to the end.

    Args:
        experiment: with a sampled controller, an observer and an approach.
        plant: any that is not active; its outputs are at zero on every way out.
        lockstep: run as fast as both sides can, each waiting for the other.
        watchdog: seconds without a command after which the plant goes to zero by itself.
        progress: called with the part done.
        stop: looked at before each tick.

    Returns:
        what the controller saw and did since the release; the rig's states are estimates.

    Raises:
        ModelError: the experiment does not run on sensors, or has no approach.
        RecordError: the run ended before the release.
        PlantError: the plant is lost, refuses, or has other channels.
    """
    _check(experiment)
    sampled = experiment.sampled
    before = round(sampled.approach * sampled.rate) + sampled.delay
    after = int(np.floor(experiment.declaration.duration * experiment.time_scale * sampled.rate * (1.0 + 1e-12))) + 1
    _prepare(sampled)
    keeper = _Keeper(sampled, before, before + after)
    ran = run_rig(
        keeper.step,
        plant,
        rate=sampled.rate,
        samples=before + after,
        limits=sampled.limits[:, LARGEST],
        watchdog=watchdog,
        lockstep=lockstep,
        on_tick=None if progress is None else _every(progress, before + after),
        stop=stop,
    )
    return experiment.record_rig(keeper.rows(ran), lockstep=lockstep, told=_told(ran))


def _check(experiment: Experiment) -> None:
    settings = experiment.declaration.controller
    if not experiment.has_observer:
        raise ModelError(
            "a rig is known by its sensors only: give controller.rate and controller.observer, such as "
            "'controller: {rate: 1 kHz, observer: disturbance, approach: 3}'"
        )
    if settings.approach is None:
        raise ModelError(
            "a rig cannot be placed in its initial state: write controller.approach, the seconds in which the "
            "controller brings it there, such as 'approach: 3'"
        )
    experiment.validate()


def _prepare(sampled: SampledController) -> None:
    """Compile and load everything before the plant is touched."""
    for name in ("control", "skip", "still", "transforms"):
        getattr(sampled.kernels, name).prepare()
    _ = sampled.gain


def _every(progress: Callable[[float], None], samples: int) -> Callable[[int], None]:
    """Return what tells the part done some hundred times, within the time of a tick."""
    step = max(1, samples // 100)

    def told(row: int) -> None:
        if row % step == 0:
            progress((row + 1) / samples)

    return told


def _told(ran: RigRun) -> dict[str, object]:
    """Return what the manifest tells of a run on a plant."""
    told: dict[str, object] = {"end": ran.reason, "counters": dict(ran.counters)}
    if ran.note:
        told["note"] = ran.note
    return told


@dataclass
class _Keeper:
    """A sampled controller with a row for each of its steps.

    Args:
        sampled: the controller.
        before: samples before the release.
        samples: samples in all.
    """

    sampled: SampledController
    before: int
    samples: int
    memory: Memory | None = None
    first: int = 0
    row: int = 0
    estimates: Array = field(init=False)
    demanded: Array = field(init=False)
    power: Array = field(init=False)
    index: Array = field(init=False)

    def __post_init__(self) -> None:
        sizes = self.sampled.sizes
        self.estimates = np.zeros((self.samples, sizes.states))
        self.demanded = np.zeros((self.samples, sizes.actuators))
        self.power = np.zeros((self.samples, sizes.actuators))
        self.index = np.zeros(self.samples)

    def step(self, tick: int, readings: Array) -> Array:
        """Return the commands (actuators,) that answer the readings (sensors,) of a tick of the plant."""
        if self.memory is None:
            self.memory, self.first = self.sampled.begin(readings), tick
        index = tick - self.first - self.before
        applied = self.memory.step(index, readings)
        row = self.row
        self.row += 1
        self.index[row] = index
        self.estimates[row] = self.memory.estimate
        self.demanded[row] = self.memory.demanded
        self.power[row] = self.memory.x[self.sampled.sizes.power]
        return applied

    def rows(self, ran: RigRun) -> TwinRun:
        """Return what happened since the release.

        Raises:
            RecordError: the run ended before it.
        """
        kept = np.flatnonzero(self.index[: self.row] >= 0)
        if not len(kept):
            raise RecordError(f"the run ended before the release ({ran.reason}): there is nothing to record")
        return TwinRun(
            self.index[kept] / self.sampled.rate,
            self.estimates[kept],
            self.estimates[kept],
            ran.sensors[kept],
            self.demanded[kept],
            ran.applied[kept],
            self.power[kept],
        )
