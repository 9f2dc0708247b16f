"""Run a controller on a plant, one tick after the other, and leave the plant at zero whatever happens.

In each tick: read the sensors, step the controller, refuse what is not finite, clamp to the limits, write.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from masking.errors import CommandError, PlantLostError, PlantMismatchError
from masking.numerics.arrays import Array
from masking.plants.interface import Counting, Plant, Settings
from masking.plants.machine import Deadlines, Stop, asked_to_stop, undisturbed
from masking.runs.stopping import FAILED, FINISHED, INTERRUPTED, LOST, REFUSED, STOPPED

Step = Callable[[int, Array], Array]


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
        reason: why it ended, one of `masking.runs.stopping.REASONS`.
        counters: ticks that were `late` and `clamped`, periods `missed`, and what the plant counted.
        note: what the machine did not permit, such as real-time priority; empty where there is nothing to say.
    """

    times: Array
    wall: Array
    index: NDArray[np.int64]
    sensors: Array
    demanded: Array
    applied: Array
    late: NDArray[np.bool_]
    durations: Array
    reason: str
    counters: Mapping[str, int]
    note: str = ""


def run_rig(
    step: Step,
    plant: Plant,
    *,
    rate: float,
    samples: int,
    limits: Array,
    watchdog: float = 0.02,
    lockstep: bool = False,
    acknowledge: bool = False,
    accept: Callable[[Plant], None] | None = None,
    on_tick: Callable[[int], None] | None = None,
    stop: Stop | None = None,
    on_end: Callable[[RigRun], None] | None = None,
) -> RigRun:
    """Configure and activate a plant, run a controller on it, and deactivate it on every way out.

    SIGINT, SIGTERM and SIGHUP end the run in order. Where the plant does not own the clock, ticks are kept here.

    Args:
        step: takes the tick of a sample and its sensors (sensors,), and returns the command (actuators,).
        plant: any plant that is not active.
        rate: Hz.
        samples: ticks.
        limits: (actuators,), largest magnitude of each command, positive.
        watchdog: seconds without a command after which the plant goes to zero by itself.
        lockstep: run as fast as both sides can, each waiting for the other.
        acknowledge: why the plant tripped in the last run was looked at.
        accept: called with the configured plant before it is activated; raises what it refuses the plant with.
        on_tick: called with the row after each tick, within the tick's time.
        stop: looked at before each tick.
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
            rows = _Rows(samples, plant, _checked(limits, plant))
            note = way_out.enter_context(undisturbed(priority=not lockstep))
            way_out.callback(plant.deactivate)  # first of all on the way out
            plant.activate()
            reason = _loop(step, plant, rows, settings, on_tick=on_tick, stop=stop, asked=asked)
    except BaseException as error:
        if on_end is not None and rows is not None:
            reason = LOST if isinstance(error, PlantLostError) else FAILED
            reason = REFUSED if isinstance(error, CommandError) else reason
            on_end(rows.run(rate, reason, plant, note))
        raise
    run = rows.run(rate, reason, plant, note)
    if on_end is not None:
        on_end(run)
    return run


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
    rows: _Rows,
    settings: Settings,
    *,
    on_tick: Callable[[int], None] | None,
    stop: Stop | None,
    asked: Stop,
) -> str:
    """Run tick after tick; return why it ended."""
    keeps_time = not (plant.owns_clock or settings.lockstep)
    deadlines = Deadlines(settings.rate)
    for row in range(rows.samples):
        if keeps_time and row:
            deadlines.wait(asked)
        if asked():
            return INTERRUPTED
        if stop is not None and stop():
            return STOPPED
        sample = plant.read()
        began = time.perf_counter()
        rows.begin(sample.index, sample.values, began, deadlines.missed)
        try:
            demanded = step(sample.index, sample.values)
            rows.durations[row] = time.perf_counter() - began
            command = rows.limited(demanded, plant.actuators)
        except CommandError:
            plant.write(sample.index, rows.applied[row])  # still zero
            raise
        plant.write(sample.index, command)
        if on_tick is not None:
            on_tick(row)
    return FINISHED


def _checked(limits: Array, plant: Plant) -> Array:
    limits = np.array(limits, dtype=np.float64)
    if limits.shape != (len(plant.actuators),) or not np.all(limits > 0.0) or not np.all(np.isfinite(limits)):
        names = ", ".join(plant.actuators)
        raise PlantMismatchError(f"limits are {limits.tolist()}; give one positive number for each of {names}")
    return limits


@final
class _Rows:
    """The rows of a run, made ahead and filled tick by tick.

    Args:
        samples: number of rows.
        plant: a configured plant.
        limits: (actuators,).
    """

    def __init__(self, samples: int, plant: Plant, limits: Array) -> None:
        if samples < 1:
            raise PlantMismatchError(f"samples is {samples}; give at least 1")
        self.samples, self.count, self.limits, self._below = samples, 0, limits, -limits
        self.clamped = self.missed = self.gaps = 0
        # Filled, so that their pages are there before the first tick.
        self.wall, self.durations = np.full(samples, 0.0), np.full(samples, 0.0)
        self.index, self.late = np.full(samples, 0, dtype=np.int64), np.full(samples, False)
        self.sensors = np.full((samples, len(plant.sensors)), 0.0)
        self.demanded = np.full((samples, len(limits)), 0.0)
        self.applied = np.full((samples, len(limits)), 0.0)
        self._finite = np.full(len(limits), True)

    def begin(self, index: int, values: Array, wall: float, missed: int) -> None:
        """Begin the next row with a sample: its values (sensors,), s of the wall clock, periods missed so far."""
        row = self.count
        self.count += 1
        self.wall[row], self.index[row], self.sensors[row] = wall, index, values
        gap = index - int(self.index[row - 1]) - 1 if row else 0
        self.late[row] = gap > 0 or missed > self.missed
        self.gaps += max(0, gap)
        self.missed = missed

    def limited(self, demanded: Array, actuators: tuple[str, ...]) -> Array:
        """Return the command (actuators,) within the limits, and keep it in the row that was begun.

        Raises:
            CommandError: it is not one finite number for each actuator.
        """
        row = self.count - 1
        if np.shape(demanded) != self.limits.shape:
            message = f"tick {self.index[row]}: the controller returned shape {np.shape(demanded)}"
            raise CommandError(f"{message}; return {self.limits.shape}, one number for each actuator")
        self.demanded[row] = demanded
        if not np.isfinite(self.demanded[row], out=self._finite).all():
            channel = int(np.argmin(self._finite))
            message = f"tick {self.index[row]}: the controller's command for {actuators[channel]} is"
            mend = "look at its state and at the sensors of that tick"
            raise CommandError(f"{message} {self.demanded[row, channel]}; {mend}")
        applied: Array = self.applied[row]
        np.maximum(self.demanded[row], self._below, out=applied)
        np.minimum(applied, self.limits, out=applied)
        self.clamped += not np.array_equal(applied, self.demanded[row])
        return applied

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
            reason=reason,
            counters={**counted, **own, "clamped": self.clamped},
            note=note,
        )
