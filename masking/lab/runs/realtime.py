"""Run a controller on a plant, one tick after the other, and leave the plant at zero whatever happens.

In each tick: read the sensors, look whether they are plausible and the rig within its limits, step the controller,
refuse what is not finite, clamp to the limits, write. What is between reading and writing is the chain of
`masking.lab.plants.safety_chain`: no command reaches the plant but through it. It
says, too, how many late ticks end a run.
"""

from __future__ import annotations

import contextlib
import itertools
import struct
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from masking import errors
from masking.compile.numerics.arrays import Array
from masking.errors import CommandError, PlantError, PlantLostError, PlantMismatchError
from masking.lab.plants.controlled_stop import Braking, follows
from masking.lab.plants.interface import APPLIED, Counting, Latching, Plant, Sample, Settings, Telling, check_index
from masking.lab.plants.operating_system import Deadlines, Stop, asked_to_stop, undisturbed
from masking.lab.plants.safety_chain import Cause, Chain, Rules, Trip
from masking.lab.plants.zero_after_kill import LastWord
from masking.lab.records.ring import cells
from masking.lab.runs.stopping import FAILED, FINISHED, INTERRUPTED, LOST, STOPPED, TRIPPED

Step = Callable[[int, Array], Array]
Row: TypeAlias = "memoryview[float]"
Look = Callable[[Chain, int], None]
# The first columns of a row: unit and meaning of each, by its name.
LOOP: Final = {
    "tick": {"unit": "1", "meaning": "tick of the plant's clock"},
    "wall": {"unit": "s", "meaning": "time since the first sample, measured"},
    "answered": {"unit": "1", "meaning": "1 where the controller answered the sample"},
    "index": {"unit": "1", "meaning": "sample, 0 at the release and negative in the homing"},
    "late": {"unit": "1", "meaning": "1 where samples before were missed, or the tick began more than a period late"},
    "lateness": {"unit": "s", "meaning": "how late the tick began"},
    "duration": {"unit": "s", "meaning": "how long the controller took"},
}
TICK, WALL, ANSWERED, INDEX, LATE, LATENESS, DURATION = range(len(LOOP))
_pack = struct.Struct(f"{len(LOOP)}d").pack_into
_LOOKED_AFTER = 0.05  # s between looks at what a plant puts out
_LARGEST = 2**53  # a tick that a float holds
_IDLE = 2  # looks in a row at which it may put out nothing although it is commanded to


@dataclass(frozen=True, eq=False)
class RigRun:
    """What happened in a run, a row for each tick."""

    times: Array  # (m,), seconds of the plant's clock: index / rate
    wall: Array  # (m,), seconds since the first tick, measured
    index: NDArray[np.int64]  # (m,), ticks of the plant's clock
    sensors: Array  # (m, sensors)
    demanded: Array  # (m, actuators), what the controller returned, also where that is not finite
    applied: Array  # (m, actuators), what was written after the clamp
    # (m,), True where samples before this one were missed, or the tick began more than a period late
    late: NDArray[np.bool_]
    durations: Array  # (m,), seconds that the controller's step took
    lateness: Array  # (m,), seconds that ticks began late; on a plant's own clock, after a period since the one before
    work: Array  # (m,), seconds that the controller, the safety chain and the row of the record took together
    table: Array  # (m, columns), as `Rows` has it
    reason: str  # why it ended, one of `masking.lab.runs.stopping.REASONS`
    counters: Mapping[str, int]  # ticks that were `late` and `clamped`, periods `missed`, and what the plant counted
    note: str = ""  # what the machine did not permit, such as real-time priority; empty where there is nothing to say
    trip: Trip | None = None  # why the safety chain tripped; None where it did not


@dataclass(frozen=True)
class Hooks:
    """Functions that a run calls besides those of its controller and its plant; each may be left out."""

    # called with the configured plant before it is activated; raises what it refuses the plant with
    accept: Callable[[Plant], None] | None = None
    on_tick: Callable[[int], None] | None = None  # called with the row after each tick, within the tick's time
    # each called once with each row, as `Rows.table` has it, as soon as its command was written
    on_row: Sequence[Callable[[Row], None]] = ()
    stop: Stop | None = None  # looked at before each tick; the run ends where it is true
    emergency: Stop | None = None  # likewise; the run then trips
    # called with the safety chain, which it may stop, and the tick of each sample
    look: Look | None = None
    # called with the record once the plant is at zero, also before an error is raised
    on_end: Callable[[RigRun], None] | None = None


@dataclass(frozen=True, eq=False)
class Known:
    """State of a controller that a run looks at; the controller changes its arrays in place."""

    estimate: Array | None = None  # of the rig's states; for rules that need it
    columns: Sequence[Array] = ()  # of each row besides `LOOP`, sensors and commands: contiguous arrays of float64
    before: int = 0  # samples before the release


NO_HOOKS: Final = Hooks()
UNKNOWN: Final = Known()


def run_rig(
    step: Step,
    plant: Plant,
    settings: Settings,
    *,
    samples: int,
    limits: Array | Rules,
    hooks: Hooks = NO_HOOKS,
    known: Known = UNKNOWN,
) -> RigRun:
    """Configure and activate a plant, run a controller on it, and deactivate it on every way out.

    `step` takes the tick of a sample and its sensors (sensors,), and returns the command (actuators,). `limits` are
    what the rig is held to, or (actuators,), the largest magnitude of each command, positive. SIGINT, SIGTERM and
    SIGHUP end the run in order. Where the plant does not own the clock, ticks are kept here.

    A CommandError where the controller returned something else than one finite number for each actuator; a PlantError
    where the plant is lost, refuses, or has other channels; and what the controller raised.
    """
    rows, reason, note = None, FAILED, ""
    try:
        with asked_to_stop() as asked, contextlib.ExitStack() as way_out:
            word = way_out.enter_context(LastWord(plant))
            way_out.callback(plant.deactivate)
            plant.configure(settings)
            if hooks.accept is not None:
                hooks.accept(plant)
            if not isinstance(limits, Rules):
                limits = Rules.of_commands(limits, plant.sensors, plant.actuators, settings.rate)
            rows = Rows(samples, plant, Chain(limits, known.estimate), hooks.on_row, known)
            note = way_out.enter_context(undisturbed(priority=not settings.lockstep))
            way_out.enter_context(word.driving())
            way_out.push(partial(_leave, plant, rows, settings, hooks))  # first of all on the way out
            plant.activate()
            reason = _loop(step, plant, rows, settings, hooks=hooks, asked=asked)
    except BaseException as error:
        if rows is not None:
            rows.tell()
        if hooks.on_end is not None and rows is not None:
            hooks.on_end(rows.run(_reason(error, rows), plant, note))
        raise
    run = rows.run(reason if rows.chain.trip is None else TRIPPED, plant, note)
    if hooks.on_end is not None:
        hooks.on_end(run)
    return run


def _leave(plant: Plant, rows: Rows, settings: Settings, hooks: Hooks, *raised: object) -> None:
    """Leave a plant at zero, after a controlled stop if there is one, and let it know why the chain tripped."""
    error = raised[1]
    if isinstance(error, BaseException):
        _reason(error, rows)
    if rows.count and follows(rows.chain) and (error is None or rows.chain.trip is not None):
        _stop(plant, rows, settings, hooks)
    if rows.chain.trip is not None and isinstance(plant, Latching):
        with contextlib.suppress(Exception):  # whatever an adapter does, the plant is left
            plant.trip(str(rows.chain.trip))
    plant.deactivate()


def _stop(plant: Plant, rows: Rows, settings: Settings, hooks: Hooks) -> None:
    """Go on with a controlled stop in place of the controller; whatever comes between ends it."""
    first, stop, ended = rows.chain.release(), rows.chain.rules.stop, rows.count
    assert stop is not None  # noqa: S101  # `follows`
    braking = Braking(rows.chain, stop)
    for row in range(max(0, ended - stop.span - 1), ended):
        braking.see(int(rows.table[row, TICK]), rows.sensors[row])
    rows.samples, rows.is_run = ended + stop.samples, False
    own = Hooks(stop=lambda: braking.is_over, emergency=hooks.emergency, look=hooks.look)
    try:
        _loop(braking.step, plant, rows, settings, hooks=own, asked=lambda: False)
    except Exception as error:  # the plant is left at zero, and the record has why
        _reason(error, rows)
        rows.tell()
    rows.chain.trip = first or rows.chain.trip


def _reason(error: BaseException, rows: Rows) -> str:
    """Reason for the end of a run in an error, of which the chain learns."""
    tick, text = int(rows.table[max(0, rows.count - 1), TICK]), f"{type(error).__name__}: {error}"
    if isinstance(error, PlantLostError):
        cause = Cause.COMM_LOST if isinstance(error, errors.SamplesLostError) else Cause.PLANT_LOST
        rows.chain.stop(cause, tick, detail=text)
        return LOST
    if isinstance(error, errors.EmergencyStopError):
        rows.chain.stop(Cause.ESTOP, tick, "at the plant", detail=text)
    if rows.chain.trip is None and isinstance(error, PlantError):
        rows.chain.stop(Cause.PLANT_ERROR, tick, detail=text)
    return TRIPPED if rows.chain.trip is not None else FAILED


def check_channels(plant: Plant, sensors: Sequence[str], actuators: Sequence[str], whose: str, remedy: str) -> None:
    """Refuse a plant whose channels are not those wanted, in their order.

    `whose` says who wants them, such as "the experiment is for linear_rig", and `remedy` what to do about it.
    """
    for kind, theirs, ours in (("sensors", plant.sensors, sensors), ("actuators", plant.actuators, actuators)):
        if tuple(theirs) != tuple(ours):
            raise PlantMismatchError(
                f"the plant's {kind} are {', '.join(theirs)}; {whose}, whose {kind} are {', '.join(ours)}, in this "
                f"order: {remedy}"
            )


def every(progress: Callable[[float], None], samples: int) -> Callable[[int], None]:
    """Function that reports the fraction done about a hundred times, within the time of a tick."""
    step = max(1, samples // 100)

    def report(row: int) -> None:
        if row % step == 0:
            progress((row + 1) / samples)

    return report


def _loop(step: Step, plant: Plant, rows: Rows, settings: Settings, *, hooks: Hooks, asked: Stop) -> str:
    """Run tick after tick; return why it ended."""
    keeps_time = not (plant.owns_clock or settings.lockstep)
    deadlines = rows.deadlines = rows.deadlines or Deadlines(settings.rate)
    chain, stop, look, on_tick = rows.chain, hooks.stop, hooks.look, hooks.on_tick
    taken = _Taken(plant, chain, settings.rate) if isinstance(plant, Telling) else None
    counters = plant.counters if isinstance(plant, Counting) else {}
    ended, skipped = time.perf_counter(), 0
    for row in range(rows.count, rows.samples):
        lateness = deadlines.wait(asked) if keeps_time and row else 0.0 if settings.lockstep else None
        if asked():
            return INTERRUPTED
        if stop is not None and stop():
            return STOPPED
        sample = plant.read()
        began = time.perf_counter()
        missed = rows.begin(sample.index, sample.values, began, deadlines.missed, lateness)
        if missed or rows.is_late:
            before, skipped = skipped, counters.get("skipped", 0)  # they came, and waited for this process
            chain.time(
                sample.index,
                is_late=rows.is_late and not settings.lockstep,
                silence=0.0 if settings.lockstep else (began - ended) * settings.rate,
                missed=missed,
                lost=missed - (skipped - before),
            )
        if hooks.emergency is not None and hooks.emergency():
            chain.stop(Cause.ESTOP, sample.index)
        if look is not None:
            look(chain, sample.index)
        command = rows.applied[row]
        if chain.watch(sample.index, sample.values, missed) is None:
            _answer(step, plant, rows, sample, began)
        else:
            command[:] = chain.applied
        answered = time.perf_counter()
        plant.write(sample.index, command)
        ended = time.perf_counter()
        rows.tell()
        rows.work[row] = answered - began + (time.perf_counter() - ended)
        if taken is not None:
            taken.look(sample.index, command)
        if chain.trip is not None:
            return TRIPPED
        if on_tick is not None:
            on_tick(row)
    return FINISHED


def _answer(step: Step, plant: Plant, rows: Rows, sample: Sample, began: float) -> None:
    """Let the controller answer a sample; what it or `Rows.answer` raises comes through once zero was written."""
    tick = sample.index
    try:
        rows.answer(tick, step(tick, sample.values), time.perf_counter() - began)
    except BaseException as error:
        cause = Cause.CONTROLLER_NONFINITE if isinstance(error, CommandError) else Cause.CONTROLLER_EXCEPTION
        rows.chain.stop(cause, tick, ", ".join(plant.actuators), value=np.nan, detail=traceback.format_exc())
        rows.applied[rows.count - 1] = rows.chain.applied
        with contextlib.suppress(PlantError):
            plant.write(tick, rows.chain.applied)
        raise


@final
class _Taken:
    """Trips the chain where a plant that reports its outputs does not take the commands that it is given."""

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
        telemetry, names = self._plant.telemetry(), self._chain.rules.actuators
        for i, name in enumerate(names):
            is_idle = self._least[i] > 0.0 and telemetry.get(APPLIED + name, np.nan) == 0.0
            self._idle[i] = self._idle[i] + 1 if is_idle else 0
            if self._idle[i] > _IDLE:
                value, unit = float(written[i]), self._chain.rules.unit(1, i)
                self._chain.stop(Cause.COMMANDS_NOT_TAKEN, tick, name, value=value, unit=unit)
        self._least[:] = np.inf


@final
class Rows:
    """The rows of a run, made ahead and filled tick by tick.

    `table` (samples, columns) has `LOOP`, the sensors, the applied commands, and what the controller knows; `count` are
    the rows that were begun. `missed` are the periods that the clock of this side left out, `gaps` the samples of the
    plant's clock that were missed, and `is_late` says whether the last tick was. Each of `on_row` is called once with
    each row. In a controlled stop, behind the `samples` of a run, `is_run` is false, and no row is one that the
    controller answered.
    """

    def __init__(
        self, samples: int, plant: Plant, chain: Chain, on_row: Sequence[Callable[[Row], None]], known: Known
    ) -> None:
        if samples < 1:
            raise PlantMismatchError(f"samples is {samples}; give at least 1")
        self.samples, self.count, self.chain = samples, 0, chain
        self.is_run = True
        self.deadlines: Deadlines | None = None
        samples += 0 if chain.rules.stop is None else chain.rules.stop.samples
        self.rate, self.missed, self.gaps, self.is_late = chain.rules.rate, 0, 0, False
        self._before, self._last = known.before, 0
        self._first: int | None = None
        self._began = self._wall = 0.0
        self._on_row, self._shape = on_row, chain.applied.shape
        self._told = self._at = 0  # rows that were passed on; cells before the last row
        sensors, actuators = len(plant.sensors), len(plant.actuators)
        ends = list(itertools.accumulate([len(LOOP), sensors, actuators, *map(len, known.columns)]))
        self._width = ends[-1]
        # Filled, so that their pages are there before the first tick.
        self.table, self.work = np.full((samples, self._width), 0.0), np.full(samples, 0.0)
        self.demanded = np.full((samples, actuators), 0.0)
        self.sensors, self.applied = self.table[:, ends[0] : ends[1]], self.table[:, ends[1] : ends[2]]
        self._cells = cells(self.table)
        # Memory to memory; measured: a third of the time of arrays.
        parts = zip(ends[3:], known.columns, strict=True)
        self._known = [(end - len(part), end, part.data) for end, part in parts if len(part)]

    def begin(self, tick: int, values: Array, wall: float, missed: int, lateness: float | None = None) -> int:
        """Begin the next row with a sample (sensors,); return the samples that were missed before it.

        `wall` is s of the wall clock, and `missed` are the periods missed so far; `lateness` is how late the tick
        began, s, where it is this side that keeps the time. A PlantError, and no row, where the tick is not after the
        last one.
        """
        row, tick = self.count, min(tick, _LARGEST)
        check_index(tick, None if self._first is None else self._last)
        gap = 0 if self._first is None else tick - self._last - 1
        if self._first is None:
            self._first, self._began, lateness = tick, wall, lateness or 0.0
        if lateness is None:
            lateness = max(0.0, wall - self._wall - (gap + 1) / self.rate)
        self.is_late = gap > 0 or missed > self.missed
        self._last, self._wall, self.missed = tick, wall, missed
        self.gaps += gap
        self.count += 1
        self._at = at = row * self._width
        index = tick - self._first - self._before
        _pack(self._cells, 8 * at, tick, wall - self._began, 0.0, index, self.is_late, lateness, 0.0)  # as `LOOP`
        self.sensors[row] = values
        return gap

    def answer(self, tick: int, demanded: Array, duration: float) -> None:
        """Keep what the controller answered in the row that was begun, and what of it may be written.

        `demanded` is (actuators,); the controller took `duration` s. A CommandError where it is of another shape.
        """
        row, chain = self.count - 1, self.chain
        self._cells[self._at + ANSWERED], self._cells[self._at + DURATION] = float(self.is_run), duration
        shape = demanded.shape if type(demanded) is np.ndarray else np.shape(demanded)
        if shape != self._shape:
            message = f"tick {tick}: the controller returned shape {shape}"
            raise CommandError(f"{message}; return {self._shape}, one number for each actuator")
        self.demanded[row] = demanded
        self.applied[row] = chain.guard(tick, demanded)

    def tell(self) -> None:
        """Let the last row be recorded, if it was not yet."""
        if self._told < self.count:
            self._told, at = self.count, self._at
            for begin, end, known in self._known:
                self._cells[at + begin : at + end] = known
            row = self._cells[at : at + self._width]
            for take in self._on_row:
                take(row)

    def run(self, reason: str, plant: Plant, note: str) -> RigRun:
        """Rows that were begun; the applied command of one that was not completed is zero."""
        rows = slice(0, self.count)
        table = self.table[rows]
        counted = dict(plant.counters) if isinstance(plant, Counting) else {}
        own = {"late": int(np.count_nonzero(table[:, LATE])), "missed": self.missed + self.gaps}
        ticks = table[:, TICK].astype(np.int64)
        return RigRun(
            times=ticks / self.rate,
            wall=table[:, WALL],
            index=ticks,
            sensors=self.sensors[rows],
            demanded=self.demanded[rows],
            applied=self.applied[rows],
            late=table[:, LATE] > 0.0,
            durations=table[:, DURATION],
            lateness=table[:, LATENESS],
            work=self.work[rows],
            table=table,
            reason=reason,
            counters={**counted, **own, "clamped": self.chain.clamped},
            note=note,
            trip=self.chain.trip,
        )
