"""Run on a rig: an experiment on a plant that runs by itself, and a twin that stands in for such a plant."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, final

from masking.compile.numerics.arrays import Array
from masking.control.known_instruments import Instruments
from masking.control.rig.twin import Twin
from masking.control.stepwise_controller import SampledStep
from masking.errors import MaskingError, ModelError, PlantRefusedError
from masking.lab.plants import adapters
from masking.lab.plants.address import scheme_of
from masking.lab.plants.arming import HOW, Arming
from masking.lab.plants.interface import Plant, Settings
from masking.lab.plants.operating_system import Stop
from masking.lab.plants.remote import RemotePlant
from masking.lab.plants.safety_chain import Chain
from masking.lab.plants.serve import Serving
from masking.lab.plants.serve import serve as serve_plant
from masking.lab.plants.served_plant_guard import PlantLimits
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.plants.trip_memory import TripMemory
from masking.lab.records import stream as streams
from masking.lab.records.recorder import Recorder
from masking.lab.records.recording import Recording
from masking.lab.records.tick_times import timing
from masking.lab.runs import safety_limits
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.loop_rows import RowLayout, known, recorder, samples_after
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.parted_motion import noted
from masking.lab.runs.realtime import Hooks, RigRun, Row, check_channels, every, run_rig
from masking.lab.runs.stopping import FINISHED, FULL, INTERRUPTED, STOPPED, SYNCHRONISED, StopCondition

WATCHDOG = 0.02
Watched = Callable[[int, float], bool]
_REMEDY = "run it on that plant, or write the plant that is there into it"


def serve(
    plant: str | Path,
    address: str,
    serving: Serving,
    *,
    seed: int = 0,
    limits: str | Path | None = None,
    ready: Callable[[str], None] | None = None,
    stop: Stop | None = None,
) -> tuple[Path, ...]:
    """Serve a plant to a controller in another process, until asked to stop.

    Args:
        plant: a packaged plant or a plant file, whose twin is served; or the address of a plant without a clock.
        address: `udp://host:port`, where port 0 takes a free one; `serial:pty`, a pseudo terminal; or a serial port.
        serving: how, but for its guard, its memory of trips, which a plant at an address has beyond this server, and
            its arming, by lines of standard input where the plant file says `arm: operator`.
        seed: of the noise of a twin's sensors.
        limits: a packaged plant or a plant file, whose limits every command is brought within; by default those of the
            plant, and none for an address.
        ready: called with the address once the plant can be reached.
        stop: looked at in each tick.

    Returns:
        the folders of the records.

    Raises:
        PlantMismatchError: the plant owns its clock, the address is wrong or taken, or a key is missing.
    """
    twin = None if scheme_of(str(plant)) else Twin.load(plant)
    limited = twin if limits is None else Twin.load(limits)
    guard = _guard(limited) if limited is not None else None
    if twin is None:
        served, serving = adapters.connect(str(plant)), replace(serving, trips=TripMemory(str(plant)))
    else:
        served = SimulatedPlant(twin, seed)
        settings = Settings(rate=1000.0)  # any rate does: this compiles what a controller would not wait for
        served.configure(settings)
        if guard is not None:
            guard.begin(served, settings)
        served.deactivate()
    arming = Arming(sys.stdin) if limited is not None and limited.declaration.arm else None
    return serve_plant(served, address, replace(serving, guard=guard, arming=arming), ready=ready, stop=stop)


def _guard(twin: Twin) -> PlantLimits:
    """What keeps a served plant within the limits of a plant file, as far as its sensors show them."""
    rules = partial(safety_limits.limits, Instruments.of(twin))
    Chain(rules(1000.0))  # loads what a controller would not wait for; any rate does
    return PlantLimits(rules)


@dataclass(frozen=True, eq=False)
class RunSettings:
    """How an experiment runs on a plant."""

    lockstep: bool = False  # run as fast as both sides can, each waiting for the other
    watchdog: float = WATCHDOG  # seconds without a command after which the plant goes to zero by itself
    acknowledge: bool = False  # why the plant tripped in the last run was looked at; it is refused without
    progress: Callable[[float], None] | None = None  # called with the part done
    stop: Stop | None = None  # looked at before each tick
    emergency: Stop | None = None  # likewise; the run then trips
    # called with what there is since the release where the run ends in an error, before it is raised
    keep: Callable[[Recording], None] | None = None
    # folder to which each row goes while the run goes on, the homing included; once the recording is saved,
    # `masking.lab.records.stream.remove` takes them away
    stream: str | Path | None = None
    spare: str | Path | None = None  # for the rest of the stream where its own is full; else that for temporary files
    operator: Operator | None = None  # who looks at the run, and may stop it
    # by whom a plant in this process is armed whose file says `arm: operator`; it is refused without
    arming: Callable[[], Arming] | None = None


REAL_TIME: Final = RunSettings()


def run(experiment: Experiment, plant: Plant, settings: RunSettings = REAL_TIME) -> Recording:
    """Run an experiment on a plant, from rest through the homing phase to the end.

    SIGINT, SIGTERM and SIGHUP end the run in order; what there is since the release is returned. The manifest's
    `rig.end` says why the run ended, with one of `masking.lab.runs.stopping.REASONS`.

    Args:
        experiment: with a sampled controller, an observer and a homing phase.
        plant: any that is not active; its outputs are at zero on every way out.
        settings: of the run.

    Returns:
        what the controller saw and did since the release; the rig's states are estimates.

    Raises:
        ModelError: the experiment does not run on sensors, or has no homing phase.
        PlantError: the plant is lost, refuses, or has other channels.
        RecordError: the folder holds a stream already, or cannot be written.
        MaskingError: the run was stopped before the release.
    """
    _check(experiment)
    run = _Run(experiment, settings)
    try:
        ran = run.on(plant)
    except BaseException:
        run.end_stream(keep=run.ended is not None and len(run.ended.index) > 0)
        if settings.keep is not None and run.ended is not None and run.keeper.is_released:
            settings.keep(run.recording(run.ended))
        raise
    is_released = run.keeper.is_released
    run.end_stream(keep=is_released or ran.reason not in {INTERRUPTED, STOPPED})
    if not is_released:
        why = f" ({ran.trip})" if ran.trip else ""
        is_kept = settings.stream is not None and streams.is_in(settings.stream)
        what = streams.MEND.format(settings.stream) if is_kept else "nothing was recorded"
        raise MaskingError(f"the run was {ran.reason} during homing, before the release{why}; {what}")
    return run.recording(ran)


@final
class _Run:
    """One run of an experiment.

    `keeper` is the controller on the ticks of the plant; `recorder` takes its rows to disk, None where none
    does; `ended` is what was recorded, once the plant is at zero.
    """

    def __init__(self, experiment: Experiment, settings: RunSettings) -> None:
        self.experiment, self.settings = experiment, settings
        sampled, condition = experiment.sampled, experiment.stop_condition
        for name in ("transform", "transforms"):  # before the plant is touched
            getattr(sampled.kernels, name).prepare()
        controller = SampledStep(sampled)
        watched = _watching(condition, experiment.every, controller) if condition else None
        self.after = samples_after(experiment, sampled)
        self.keeper = _Keeper(controller, sampled.before, self.after, watched)
        self.rules = safety_limits.rules(experiment.instruments, sampled.rate, experiment.twin, controller.estimate)
        self.ended: RigRun | None = None
        self.recorder: Recorder | None = None
        if settings.stream is not None:
            spare = Path(tempfile.gettempdir() if settings.spare is None else settings.spare)
            more = {"lockstep": settings.lockstep, "before": sampled.before}
            self.recorder = recorder(experiment, Path(settings.stream), spare, **more)

    def on(self, plant: Plant) -> RigRun:
        keeper, settings, operator = self.keeper, self.settings, self.settings.operator
        if operator is not None:
            operator.begin(self.experiment, keeper.controller, self.rules)
        samples = keeper.before + self.after
        puts: list[Callable[[Row], None]] = [] if self.recorder is None else [self.recorder.ring.put]
        puts += [] if operator is None or operator.put is None else [operator.put]
        own = Settings(keeper.controller.rate, settings.watchdog, settings.lockstep, settings.acknowledge)
        hooks = Hooks(
            accept=self._accept,
            on_tick=None if settings.progress is None else every(settings.progress, samples),
            on_row=puts,
            stop=self._is_over,
            emergency=settings.emergency,
            look=None if operator is None else operator.look,
            on_end=self._end,
        )
        state = known(keeper.controller, keeper.lasting)
        return run_rig(keeper.step, plant, own, samples=samples, limits=self.rules, hooks=hooks, known=state)

    def recording(self, ran: RigRun) -> Recording:
        """Recording of what there is since the release."""
        times = {"controller": ran.durations, "work": ran.work}
        times |= {} if self.settings.lockstep else {"lateness": ran.lateness}
        outcome = {
            "end": self.keeper.end(ran.reason, is_full=self._is_full),
            "counters": dict(ran.counters),
            "timing": timing(ran.index, **times),
            **({"note": ran.note} if ran.note else {}),
        }
        outcome |= {"unwatched": list(self.rules.notes)} if self.rules.notes else {}
        outcome |= {"trip": ran.trip.as_dict()} if ran.trip is not None else {}
        if self.recorder is not None and self.recorder.note:
            outcome |= {"recorder": self.recorder.as_dict()}
        layout = RowLayout(self.experiment)
        made = layout.recording(ran.table, self.after, lockstep=self.settings.lockstep, outcome=outcome)
        return noted(self.experiment, made)

    @property
    def _is_full(self) -> bool:
        return self.recorder is not None and self.recorder.is_full

    def end_stream(self, *, keep: bool) -> None:
        """Record the last rows; leave none where the stream is not kept."""
        if self.recorder is not None:
            (self.recorder.close if keep else self.recorder.discard)()

    def _is_over(self) -> bool:
        stop = self.settings.stop
        return self.keeper.is_over or self._is_full or (stop is not None and stop())

    def _accept(self, plant: Plant) -> None:
        declared, instruments = self.experiment.assembly.plant, self.experiment.instruments
        wanted = Path(next(iter(declared.files), declared.name)).stem
        if declared.arm and not isinstance(plant, RemotePlant):  # whose server asks
            arming = self.settings.arming
            if arming is None or not arming().wait():
                raise PlantRefusedError(f"{declared.name} is not armed: {HOW}")
        check_channels(plant, instruments.sensors, instruments.actuators, f"the experiment is for {wanted}", _REMEDY)

    def _end(self, ran: RigRun) -> None:
        self.ended = ran
        if self.settings.operator is not None:
            self.settings.operator.end(self.keeper.end(ran.reason, is_full=self._is_full), ran.trip)


def _check(experiment: Experiment) -> None:
    settings = experiment.declaration.controller
    if not experiment.has_observer:
        raise ModelError(
            "a rig is known by its sensors only: give controller.rate and controller.observer, such as "
            "'controller: {rate: 1 kHz, observer: disturbance, homing: 3}'"
        )
    if settings.homing is None:
        raise ModelError(
            "a rig cannot be placed in its initial state: write controller.homing, the seconds in which the "
            "controller brings it there, such as 'homing: 3'"
        )
    experiment.validate()


def _watching(condition: StopCondition, every: int, controller: SampledStep) -> Watched:
    """Function of a sample that was answered, and its time in s, which says whether the run has synchronised.

    It looks at one of `every` samples since the release, those that are recorded, as offline.
    """
    watch, (first, second) = condition.detector.begin(), condition.columns
    time, virtual, transform = controller.virtual()

    def step(index: int, t: float) -> bool:
        if index >= 0 and not index % every:
            time[0] = t
            transform.call()
            watch.step(virtual.item(first), virtual.item(second))
        return watch.is_synchronised

    return step


@final
class _Keeper:
    """A sampled controller on the ticks of a plant, and where it is in its run, `before` and `after` the release.

    `last` is the last sample that was answered; 0 is the release. `lasting` is what lasted of pushes at the release (1,
    pushes). `watched` ends the run before its time.
    """

    def __init__(self, controller: SampledStep, before: int, after: int, watched: Watched | None) -> None:
        self.controller, self.before, self.after, self.watched = controller, before, after, watched
        self.is_synchronised = False
        self.first, self.last = -1, -before - 1
        self.lasting = controller.sampled.feed.lasting(controller.parameters)

    @property
    def is_released(self) -> bool:
        return self.last >= 0

    @property
    def is_over(self) -> bool:
        """Whether the run has ended as planned: its time has passed, with whatever rows, or what ends it was found."""
        return self.last >= self.after - 1 or self.reason == SYNCHRONISED

    @property
    def reason(self) -> str:
        """Reason for a planned end."""
        return SYNCHRONISED if self.is_synchronised else FINISHED

    def end(self, reason: str, *, is_full: bool) -> str:
        """Reason for the end of the run, from that of its loop."""
        if reason in {STOPPED, FINISHED} and self.is_over:
            return self.reason
        return FULL if reason == STOPPED and is_full else reason

    def step(self, tick: int, readings: Array) -> Array:
        """Commands (actuators,) that answer the readings (sensors,) of a tick of the plant."""
        controller = self.controller
        if self.first < 0:
            self.first = tick
        index = tick - self.first - self.before
        if index >= 0 > self.last:
            self.lasting[:] = controller.sampled.feed.lasting(controller.parameters)
        applied = controller(readings, index)
        self.last = index
        if self.watched is not None:
            self.is_synchronised = self.watched(index, index / controller.rate)
        return applied
