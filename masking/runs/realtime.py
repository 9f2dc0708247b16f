"""Run a controller on a plant, one tick after the other, and leave the plant at zero whatever happens.

In each tick: read the sensors, look whether they are plausible and the rig within its limits, step the controller,
refuse what is not finite, clamp to the limits, write. What is between reading and writing is the chain of
`masking.plants.safety`: no command reaches the plant but through it.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from masking.errors import (
    CommandError,
    EmergencyStopError,
    PlantError,
    PlantLostError,
    PlantMismatchError,
    SamplesLostError,
)
from masking.numerics.arrays import Array
from masking.plants.interface import APPLIED, Counting, Plant, Settings, Telling
from masking.plants.machine import Deadlines, Stop, asked_to_stop, undisturbed
from masking.plants.safety import Cause, Chain, Rules, Trip
from masking.runs.stopping import FAILED, FINISHED, INTERRUPTED, LOST, STOPPED, TRIPPED

Step = Callable[[int, Array], Array]
_LOOKED_AFTER = 0.05  # s between looks at what a plant puts out
_LARGEST = 2**53  # a tick that a float holds
_IDLE = 2  # looks in a row at which it may put out nothing although it is commanded to


@dataclass(frozen=True, eq=False)
class RigRun:
    """What happened in a run, a row for each tick.

    Args:
        times: (m,), seconds of the plant's clock: index / rate.
        wall: (m,), seconds since the first tick, measured.
        index: (m,), ticks of the plant's clock.
        sensors: (m, sensors).
        demanded: (m, actuators), what the controller returned, also where that is not finite.
        applied: (m, actuators), what was written after the clamp.
        late: (m,), True where samples before this one were missed, or the tick began more than a period late.
        durations: (m,), seconds that the controller's step took.
        lateness: (m,), seconds that ticks began late; on a plant's own clock, after a period since the one before.
        work: (m,), seconds that the controller, the safety chain and the row of the record took together.
        reason: why it ended, one of `masking.runs.stopping.REASONS`.
        counters: ticks that were `late` and `clamped`, periods `missed`, and what the plant counted.
        note: what the machine did not permit, such as real-time priority; empty where there is nothing to say.
        trip: why the safety chain tripped; None where it did not.
    """

    times: Array
    wall: Array
    index: NDArray[np.int64]
    sensors: Array
    demanded: Array
    applied: Array
    late: NDArray[np.bool_]
    durations: Array
    lateness: Array
    work: Array
    reason: str
    counters: Mapping[str, int]
    note: str = ""
    trip: Trip | None = None


def run_rig(
    step: Step,
    plant: Plant,
    *,
    rate: float,
    samples: int,
    limits: Array | Rules,
    watchdog: float = 0.02,
    lockstep: bool = False,
    acknowledge: bool = False,
    accept: Callable[[Plant], None] | None = None,
    on_tick: Callable[[int], None] | None = None,
    on_row: Callable[[Rows], None] | None = None,
    stop: Stop | None = None,
    emergency: Stop | None = None,
    look: Callable[[Chain, int], None] | None = None,
    estimate: Array | None = None,
    on_end: Callable[[RigRun], None] | None = None,
) -> RigRun:
    """Configure and activate a plant, run a controller on it, and deactivate it on every way out.

    SIGINT, SIGTERM and SIGHUP end the run in order. Where the plant does not own the clock, ticks are kept here.

    Args:
        step: takes the tick of a sample and its sensors (sensors,), and returns the command (actuators,).
        plant: any plant that is not active.
        rate: Hz.
        samples: ticks.
        limits: what the rig is held to; or (actuators,), the largest magnitude of each command, positive.
        watchdog: seconds without a command after which the plant goes to zero by itself.
        lockstep: run as fast as both sides can, each waiting for the other.
        acknowledge: why the plant tripped in the last run was looked at.
        accept: called with the configured plant before it is activated; raises what it refuses the plant with.
        on_tick: called with the row after each tick, within the tick's time.
        on_row: called once for each row, with those that there are, as soon as its command was written.
        stop: looked at before each tick.
        emergency: likewise; the run then trips.
        look: called with the safety chain, which it may stop, and the tick of each sample.
        estimate: what the controller knows of the rig's states, changed in place; for rules that need it.
        on_end: called with what was recorded once the plant is at zero, also before an error is raised.

    Raises:
        CommandError: the controller returned something else than one finite number for each actuator.
        PlantError: the plant is lost, refuses, or has other channels.
        Exception: what the controller raised.
    """
    settings = Settings(rate, watchdog, lockstep, acknowledge)
    rows, reason, note = None, FAILED, ""
    try:
        with asked_to_stop() as asked, contextlib.ExitStack() as way_out:
            way_out.callback(plant.deactivate)
            plant.configure(settings)
            if accept is not None:
                accept(plant)
            if not isinstance(limits, Rules):
                limits = Rules.of_commands(limits, plant.sensors, plant.actuators, rate)
            rows = Rows(samples, plant, Chain(limits, estimate), on_row)
            note = way_out.enter_context(undisturbed(priority=not lockstep))
            way_out.callback(plant.deactivate)  # first of all on the way out
            plant.activate()
            reason = _loop(step, plant, rows, settings, on_tick=on_tick, stop=stop, emergency=emergency, look=look,
                           asked=asked)  # fmt: skip
    except BaseException as error:
        if rows is not None:
            rows.tell()
        if on_end is not None and rows is not None:
            on_end(rows.run(rate, _reason(error, rows), plant, note))
        raise
    run = rows.run(rate, reason, plant, note)
    if on_end is not None:
        on_end(run)
    return run


def _reason(error: BaseException, rows: Rows) -> str:
    """Return why a run ended in an error, and let the chain know."""
    tick, text = int(rows.index[max(0, rows.count - 1)]), f"{type(error).__name__}: {error}"
    if isinstance(error, PlantLostError):
        cause = Cause.COMM_LOST if isinstance(error, SamplesLostError) else Cause.PLANT_LOST
        rows.chain.stop(cause, tick, detail=text)
        return LOST
    if isinstance(error, EmergencyStopError):
        rows.chain.stop(Cause.ESTOP, tick, "at the plant", detail=text)
    if rows.chain.trip is None and isinstance(error, PlantError):
        rows.chain.stop(Cause.PLANT_ERROR, tick, detail=text)
    return TRIPPED if rows.chain.trip is not None else FAILED


def check_channels(plant: Plant, sensors: Sequence[str], actuators: Sequence[str], whose: str, mend: str) -> None:
    """Refuse a plant whose channels are not those wanted, in their order.

    Args:
        plant: configured.
        sensors: the names that are wanted.
        actuators: likewise.
        whose: who wants them, such as "the experiment is for linear_rig".
        mend: what to do about it.

    Raises:
        PlantMismatchError: names both.
    """
    for kind, theirs, ours in (("sensors", plant.sensors, sensors), ("actuators", plant.actuators, actuators)):
        if tuple(theirs) != tuple(ours):
            raise PlantMismatchError(
                f"the plant's {kind} are {', '.join(theirs)}; {whose}, whose {kind} are {', '.join(ours)}, in this "
                f"order: {mend}"
            )


def every(progress: Callable[[float], None], samples: int) -> Callable[[int], None]:
    """Return a function that reports the fraction done about a hundred times, within the time of a tick."""
    step = max(1, samples // 100)

    def report(row: int) -> None:
        if row % step == 0:
            progress((row + 1) / samples)

    return report


def _loop(
    step: Step,
    plant: Plant,
    rows: Rows,
    settings: Settings,
    *,
    on_tick: Callable[[int], None] | None,
    stop: Stop | None,
    emergency: Stop | None,
    look: Callable[[Chain, int], None] | None,
    asked: Stop,
) -> str:
    """Run tick after tick; return why it ended."""
    keeps_time = not (plant.owns_clock or settings.lockstep)
    deadlines, chain = Deadlines(settings.rate), rows.chain
    taken = _Taken(plant, chain, settings.rate) if isinstance(plant, Telling) else None
    counters = plant.counters if isinstance(plant, Counting) else {}
    ended, skipped = time.perf_counter(), 0
    for row in range(rows.samples):
        lateness = deadlines.wait(asked) if keeps_time and row else 0.0 if settings.lockstep else None
        if asked():
            return INTERRUPTED
        if stop is not None and stop():
            return STOPPED
        sample = plant.read()
        began = time.perf_counter()
        missed = rows.begin(sample.index, sample.values, began, deadlines.missed, lateness)
        is_late, silence = bool(rows.late[row]) and not settings.lockstep, (began - ended) * settings.rate
        before, skipped = skipped, counters.get("skipped", 0)  # they came, and waited for this process
        chain.time(
            sample.index,
            is_late=is_late,
            silence=0.0 if settings.lockstep else silence,
            missed=missed,
            lost=missed - (skipped - before),
        )
        if emergency is not None and emergency():
            chain.stop(Cause.ESTOP, sample.index)
        if look is not None:
            look(chain, sample.index)
        if chain.watch(sample.index, rows.sensors[row], missed) is None:
            _answer(step, plant, rows, sample.index, began)
        command = rows.guarded(sample.index)
        answered = time.perf_counter()
        plant.write(sample.index, command)
        ended = time.perf_counter()
        rows.tell()
        rows.work[row] = answered - began + (time.perf_counter() - ended)
        if taken is not None:
            taken.look(sample.index, rows.applied[row])
        if chain.trip is not None:
            return TRIPPED
        if on_tick is not None:
            on_tick(row)
    return FINISHED


def _answer(step: Step, plant: Plant, rows: Rows, tick: int, began: float) -> None:
    """Let the controller answer a tick; what it raises comes through once zero was written.

    Raises:
        CommandError: it returned something else than one number for each actuator.
        Exception: what the controller raised.
    """
    row = rows.count - 1
    try:
        demanded = step(tick, rows.sensors[row])
        rows.durations[row] = time.perf_counter() - began
        rows.demand(demanded)
    except BaseException as error:
        cause = Cause.CONTROLLER_NONFINITE if isinstance(error, CommandError) else Cause.CONTROLLER_EXCEPTION
        rows.chain.stop(cause, tick, ", ".join(plant.actuators), value=np.nan, detail=traceback.format_exc())
        with contextlib.suppress(PlantError):
            plant.write(tick, rows.chain.applied)
        raise


@final
class _Taken:
    """Whether a plant that reports its outputs takes the commands that it is given.

    Args:
        plant: the plant.
        chain: which trips where it does not.
        rate: samples per second.
    """

    def __init__(self, plant: Telling, chain: Chain, rate: float) -> None:
        self._plant, self._chain, self._every, self._row = plant, chain, max(2, round(rate * _LOOKED_AFTER)), 0
        self._least = np.full(len(chain.applied), np.inf)
        self._idle = np.zeros(len(chain.applied), dtype=np.int64)

    def look(self, tick: int, written: Array) -> None:
        """Look at what was written (actuators,), and now and then at what is put out."""
        np.minimum(self._least, np.abs(written), out=self._least)
        self._row += 1
        if self._row % self._every:
            return
        told, names = self._plant.telemetry(), self._chain.rules.actuators
        for i, name in enumerate(names):
            is_idle = self._least[i] > 0.0 and told.get(APPLIED + name, np.nan) == 0.0
            self._idle[i] = self._idle[i] + 1 if is_idle else 0
            if self._idle[i] > _IDLE:
                self._chain.stop(Cause.COMMANDS_NOT_TAKEN, tick, name, value=float(written[i]))
        self._least[:] = np.inf


@final
class Rows:
    """The rows of a run, made ahead and filled tick by tick.

    Args:
        samples: number of rows.
        plant: a configured plant.
        chain: of the run.
        on_row: called with this once for each row.
    """

    def __init__(self, samples: int, plant: Plant, chain: Chain, on_row: Callable[[Rows], None] | None = None) -> None:
        if samples < 1:
            raise PlantMismatchError(f"samples is {samples}; give at least 1")
        self.samples, self.count, self.chain, self.rate = samples, 0, chain, chain.rules.rate
        self.missed = self.gaps = self._told = 0
        self._on_row = on_row
        # Filled, so that their pages are there before the first tick.
        self.wall, self.durations = np.full(samples, 0.0), np.full(samples, 0.0)
        self.lateness, self.work = np.full(samples, 0.0), np.full(samples, 0.0)
        self.index, self.late = np.full(samples, 0, dtype=np.int64), np.full(samples, False)
        self.sensors = np.full((samples, len(plant.sensors)), 0.0)
        self.demanded = np.full((samples, len(plant.actuators)), 0.0)
        self.applied = np.full((samples, len(plant.actuators)), 0.0)

    def begin(self, index: int, values: Array, wall: float, missed: int, lateness: float | None = None) -> int:
        """Begin the next row with a sample.

        Args:
            index: tick of the plant's clock.
            values: (sensors,).
            wall: s of the wall clock.
            missed: periods missed so far.
            lateness: s that the tick began late, where it is this side that keeps the time.

        Returns:
            the samples that were missed before this one.
        """
        row = self.count
        self.count += 1
        index = min(index, _LARGEST)
        self.wall[row], self.index[row], self.sensors[row] = wall, index, values
        gap = index - int(self.index[row - 1]) - 1 if row else 0
        if lateness is not None:
            self.lateness[row] = lateness
        elif row:
            self.lateness[row] = max(0.0, wall - self.wall[row - 1] - (gap + 1) / self.rate)
        self.late[row] = gap > 0 or missed > self.missed
        self.gaps += max(0, gap)
        self.missed = missed
        return max(0, gap)

    def demand(self, demanded: Array) -> None:
        """Keep what the controller answered in the row that was begun.

        Raises:
            CommandError: it is not one number for each actuator.
        """
        row = self.count - 1
        if np.shape(demanded) != self.chain.applied.shape:
            message = f"tick {self.index[row]}: the controller returned shape {np.shape(demanded)}"
            raise CommandError(f"{message}; return {self.chain.applied.shape}, one number for each actuator")
        self.demanded[row] = demanded

    def guarded(self, tick: int) -> Array:
        """Return what may be written in the row that was begun, and keep it there."""
        row = self.count - 1
        applied: Array = self.applied[row]
        applied[:] = self.chain.guard(tick, self.demanded[row])
        return applied

    def tell(self) -> None:
        """Let the last row be recorded, if it was not yet."""
        if self._told < self.count:
            self._told = self.count
            if self._on_row is not None:
                self._on_row(self)

    def run(self, rate: float, reason: str, plant: Plant, note: str) -> RigRun:
        """Return the rows that were begun; the applied command of one that was not completed is zero."""
        rows = slice(0, self.count)
        counted = dict(plant.counters) if isinstance(plant, Counting) else {}
        own = {"late": int(np.count_nonzero(self.late[rows])), "missed": self.missed + self.gaps}
        return RigRun(
            times=self.index[rows] / rate,
            wall=self.wall[rows] - self.wall[0],
            index=self.index[rows],
            sensors=self.sensors[rows],
            demanded=self.demanded[rows],
            applied=self.applied[rows],
            late=self.late[rows],
            durations=self.durations[rows],
            lateness=self.lateness[rows],
            work=self.work[rows],
            reason=reason,
            counters={**counted, **own, "clamped": self.chain.clamped},
            note=note,
            trip=self.chain.trip,
        )
