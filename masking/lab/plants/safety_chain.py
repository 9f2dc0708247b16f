"""Safety chain: checks each reading and clamps each command of a run, by kernels of `numerics.safety_kernels`.

Its `Rules` come from `runs.safety_limits`; `runs.realtime` runs it beside a controller, `served_plant_guard` in a
server. In each tick: are the readings plausible, is the rig within its limits, does it answer; then, once the
controller has answered: is the command finite, clamped, not too fast, not too warm. The first cause trips the chain:
from then on every command is zero, or that of expiry where samples do not come, until a new chain is made for the next
run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from masking.compile.codegen.compiled_functions import Kernels, linked
from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import LARGEST, TIME
from masking.compile.numerics.kernel_arguments import Guarded, Watched
from masking.display.printed_result import Printed
from masking.errors import PlantMismatchError
from masking.lazy_imports import safety_kernels

OFF: Final = 8.0  # standard deviations of its noise that a reading may be off
BUCKETS: Final = 200  # of the time over which a power is a mean: it may exceed its limit by a part of 1/200
_LATE_IN_A_ROW: Final = 5
_HELD: Final = 0.045  # s that a reading may stay the same while it would change
_CUT: Final = 0.25  # s of commands that are cut for their mean power, or slowed
_LOST: Final = 4  # samples of silence that are borne


class Cause(IntEnum):
    """Why a chain trips; the numbers stay as they are, so that records can be compared."""

    SENSOR_NONFINITE = 1
    SENSOR_STUCK = 2
    SENSOR_JUMP = 3
    SENSOR_RANGE = 4
    POSITION_LIMIT = 5
    VELOCITY_LIMIT = 6
    THERMAL = 7
    CONTROLLER_NONFINITE = 8
    NO_RESPONSE = 9
    WRONG_SIGN = 10
    CONTROLLER_EXCEPTION = 11
    OVERRUN = 12
    COMM_LOST = 13
    PLANT_LOST = 14
    PLANT_ERROR = 15
    ESTOP = 16
    COMMANDS_NOT_TAKEN = 17
    UNATTENDED = 18
    COMMAND_RATE = 19


# Causes after which readings, actuators and the plant are trusted, so that a controlled stop may follow.
BORNE: Final = frozenset({
    Cause.POSITION_LIMIT, Cause.VELOCITY_LIMIT, Cause.CONTROLLER_NONFINITE, Cause.CONTROLLER_EXCEPTION,
    Cause.COMMAND_RATE, Cause.UNATTENDED,
})  # fmt: skip
_SAID: Final = {
    Cause.SENSOR_NONFINITE: "the reading of {channel} is {value}; look at its cable and at what converts it",
    Cause.SENSOR_STUCK: (
        "the reading of {channel} stays {value:.6g}{unit} to the last bit although the rig moves; "
        "look at the sensor and at what samples it"
    ),
    Cause.SENSOR_JUMP: (
        "the reading of {channel} changed by {value:.4g}{unit} in a sample, where {limit:.4g}{unit} is possible; "
        "look at its cable, or give the sensor a larger jump in the plant file"
    ),
    Cause.SENSOR_RANGE: (
        "the reading of {channel} is {value:.6g}{unit}, at or beyond the end of its range, {limit:.6g}{unit}; "
        "look at its cable and its supply"
    ),
    Cause.POSITION_LIMIT: (
        "{channel} is {value:.4g}{unit}, beyond its limit of {limit:.4g}{unit}; "
        "'masking check EXPERIMENT' says what the ideal motion needs"
    ),
    Cause.VELOCITY_LIMIT: (
        "the rate of {channel} is {value:.4g}{unit}, beyond its limit of {limit:.4g}{unit}; "
        "make the motion slower or smaller"
    ),
    Cause.THERMAL: (
        "the commands of {channel} ask for more than {limit:.4g} W of mean power; "
        "let it cool, and make the motion slower or smaller"
    ),
    Cause.CONTROLLER_NONFINITE: (
        "the controller's command for {channel} is {value}; look at its state and at the sensors of that tick"
    ),
    Cause.NO_RESPONSE: (
        "the rig does not answer {channel}: {value:.2f} of what the model says; "
        "look at its amplifier, its cable and its supply"
    ),
    Cause.WRONG_SIGN: (
        "the rig answers {channel} with the wrong sign: {value:.2f} of what the model says; "
        "look at its polarity and at that of the sensors"
    ),
    Cause.CONTROLLER_EXCEPTION: "the controller raised an error; its traceback is in the record",
    Cause.OVERRUN: (
        "{value:.4g} ticks were late or missed, where {limit:.4g} are borne; "
        "lower the rate, or take load off the machine"
    ),
    Cause.COMM_LOST: (
        "no sample came for {value:.0f} periods, where {limit:.0f} are borne; look at the line to the plant"
    ),
    Cause.PLANT_LOST: "the plant is lost; look at its power, its cable and its own record",
    Cause.PLANT_ERROR: "the plant failed; its error is in the record",
    Cause.ESTOP: "the emergency stop was pressed {channel}; release it once the rig is safe",
    Cause.COMMANDS_NOT_TAKEN: (
        "the plant puts out nothing on {channel} although {value:.4g}{unit} is commanded; "
        "look at what passes commands on to it"
    ),
    Cause.UNATTENDED: (
        "the operator's page was not heard of for {value:.1f} s, where {limit:.0f} s are borne; "
        "keep it open and visible, or run without --attended"
    ),
    Cause.COMMAND_RATE: (
        "the command for {channel} has to be slowed for too long: it asks for {value:.4g}{unit}/s, where "
        "{limit:.4g}{unit}/s are allowed; make the motion slower or smaller, or look for noise in the readings"
    ),
}


@dataclass(frozen=True, repr=False)
class Trip(Printed):
    """Why a chain tripped."""

    cause: Cause  # why
    channel: str  # the sensor, actuator or limited expression, or how an emergency stop was pressed; empty for none
    tick: int  # of the plant's clock
    value: float = 0.0  # that was found
    limit: float = 0.0  # that it passed
    detail: str = ""  # what there is besides, such as a traceback
    unit: str = "1"  # declared, of the value and the limit: of a reading, a command, or what is limited

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        said = _SAID[self.cause].format(channel=self.channel, value=self.value, limit=self.limit, unit=unit)
        said = said.replace(" ;", ";")
        return f"tick {self.tick}: {self.cause.name}: {said}"

    def as_dict(self) -> dict[str, Any]:
        """Trip as JSON can hold it; a value that is not finite as text."""
        value: float | str = self.value if np.isfinite(self.value) else str(self.value)
        entry = {"cause": self.cause.name, "number": int(self.cause), "channel": self.channel, "tick": self.tick}
        entry |= {"value": value, "limit": self.limit, "unit": self.unit}
        return entry | {"sentence": str(self), "detail": self.detail}


@dataclass(frozen=True, eq=False)
class ControlledStop:
    """How a run comes to rest before commands are zero."""

    samples: int  # that it takes at most
    damping: Array | None = None  # command per rate of the readings (actuators, sensors); None to hold the last command
    span: int = 0  # samples over which a rate is taken
    still: Array = field(default_factory=lambda: np.zeros(0))  # rate of each reading (sensors,) below which it is noise
    settled: int = 0  # samples in a row of such rates, after which the rig is at rest


@dataclass(frozen=True, eq=False)
class Rules:
    """What a chain holds a rig to, at one rate, in the units of the channels."""

    rate: float  # samples per second
    sensors: tuple[str, ...]  # their names
    actuators: tuple[str, ...]  # their names
    commands: Array  # table of limits of the actuators (actuators, 6), as `safety_tables` has its columns
    readings: Array  # table of the sensors (sensors, 8), as `masking.compile.numerics.safety_tables` has its columns
    motion: Array  # second derivative of each reading by readings and commands (sensors, sensors + actuators)
    limited: tuple[str, ...] = ()  # what is limited, in words, a rate as that of the expression
    units: tuple[tuple[str, ...], ...] = ((), (), ())  # declared, of the sensors, the actuators and what is limited
    # table of what is limited (limits, 4), as `masking.compile.numerics.safety_tables` has its columns
    limits: Array = field(default_factory=lambda: np.zeros((0, 4)))
    weights: Array = field(default_factory=lambda: np.zeros((0, 1)))  # of the readings in each (limits, sensors)
    # of the states of the controller's estimate in each (limits, states)
    estimated: Array = field(default_factory=lambda: np.zeros((0, 1)))
    half: int = 0  # samples of half the window in which a response is compared; 0 where none is
    delay: int = 0  # samples between a reading and the first effect of the command that answers it
    missed: float = 1.0  # largest share of the samples of a second that may be late or missed
    notes: tuple[str, ...] = ()  # what is not watched, a sentence each
    stop: ControlledStop | None = None  # None where a run ends at zero at once

    def unit(self, kind: int, at: int) -> str:
        """Unit of a sensor (kind 0), an actuator (1) or what is limited (2); 1 where it is not known."""
        return "".join(self.units[kind][at : at + 1]) or "1"

    @classmethod
    def of_commands(cls, largest: Array, sensors: Sequence[str], actuators: Sequence[str], rate: float) -> Rules:
        """Rules of a rig of which only the largest commands (actuators,) are known, positive numbers."""
        largest = np.array(largest, dtype=np.float64)
        if largest.shape != (len(actuators),) or not np.all(largest > 0.0) or not np.all(np.isfinite(largest)):
            names = ", ".join(actuators)
            raise PlantMismatchError(f"limits are {largest.tolist()}; give one positive number for each of {names}")
        commands = np.zeros((len(actuators), safety_tables.ACTUATOR_COLUMNS))
        commands[:, LARGEST], commands[:, TIME], commands[:, safety_tables.RATE] = largest, 1.0, np.inf
        motion = np.zeros((len(sensors), len(sensors) + len(actuators)))
        return cls(rate, tuple(sensors), tuple(actuators), commands, unknown(len(sensors)), motion)


def unknown(sensors: int) -> Array:
    """Table (sensors, 8) of sensors of which nothing is known: any finite reading is plausible."""
    table = np.zeros((sensors, safety_tables.SENSOR_COLUMNS))
    table[:, safety_tables.LEAST], table[:, [safety_tables.MOST, safety_tables.STEP]] = -np.inf, np.inf
    return table


@cache
def kernels() -> Kernels:
    """`watch` and `guard`, compiled once for all rigs; from the cache on disk where they are."""
    return linked("safety", lambda: {"watch": (safety_kernels.watch,), "guard": (safety_kernels.guard,)}, {}, (2, 64))


@final
class Chain:
    """The chain of one run: `watch` the readings of a tick, let the controller answer, and write what `guard` returns.

    `trip` is why it tripped; None while it has not. `estimate` is what the controller knows of the rig's states, which
    it changes in place; where rules need it.
    """

    def __init__(self, rules: Rules, estimate: Array | None = None) -> None:
        self.rules = rules
        self.trip: Trip | None = None
        sensed, channels, rate = len(rules.sensors), len(rules.actuators), rules.rate
        if max(sensed, channels) > 64:
            raise PlantMismatchError(f"{max(sensed, channels)} channels are more than the safety chain's 64")
        self._values, self._demanded, self.applied = np.zeros(sensed), np.zeros(channels), np.zeros(channels)
        self._before = np.zeros(channels)
        self._missed, self._found = np.zeros(1, dtype=np.int64), np.zeros(3)
        self._counts = np.zeros(safety_tables.COUNTS, dtype=np.int64)
        self._late = self._late_in_a_row = 0
        self._late_since, self._late_at = -math.inf, -math.inf
        h, settings = np.array([1.0 / rate]), self._settings()
        spans = max([2 * rules.half, *rules.readings[:, safety_tables.SPAN], *rules.limits[:, safety_tables.OVER]])
        past = np.zeros((int(spans) + rules.delay + 4, sensed))
        sent, seen = np.zeros((len(past), channels)), np.zeros((sensed, safety_tables.SEEN_COLUMNS))
        seen[:, safety_tables.FINEST] = np.inf
        known = np.zeros(rules.estimated.shape[1]) if estimate is None else estimate
        reaction, energy, counts = np.zeros((channels, 2)), np.zeros((channels, BUCKETS + 1)), self._counts
        self._limits = np.array(rules.limits, dtype=np.float64, order="C")
        watched = Watched(
            *(_whole(rules.readings), seen, _whole(rules.motion), past, sent, self._limits),
            *(_whole(rules.weights), _whole(rules.estimated), reaction, counts, settings, self._found),
        )
        guarded = Guarded(_whole(rules.commands), energy, sent, counts, settings, self._found)
        self._watch = kernels().watch.bind(self._missed, h, self._values, known, watched)
        self._guard = kernels().guard.bind(h, self._demanded, self.applied, guarded)

    def _settings(self) -> NDArray[np.int64]:
        rules, rate = self.rules, self.rules.rate
        settings = np.zeros(safety_tables.SETTINGS, dtype=np.int64)
        settings[[safety_tables.HALF, safety_tables.DELAY]] = rules.half, rules.delay
        settings[safety_tables.HELD], settings[safety_tables.SECOND_OF] = max(3, int(_HELD * rate)), max(1, round(rate))
        settings[safety_tables.CUTS] = max(1, round(_CUT * rate))
        settings[safety_tables.PER_BUCKET] = max(1, round(rules.commands[:, TIME].max(initial=1.0) * rate / BUCKETS))
        return settings

    @property
    def clamped(self) -> int:
        """How many commands were made smaller or slower."""
        return int(self._counts[safety_tables.CLAMPED])

    def watch(self, tick: int, values: Array, missed: int = 0) -> Trip | None:
        """Look at the readings (sensors,) of a tick, before which a number of samples were missed."""
        if self.trip is None:
            self._values[:] = values
            self._missed[0] = missed
            self._watch.call()
            if found := self._watch.results[0]:
                self._found_by(int(found), tick)
        return self.trip

    def guard(self, tick: int, demanded: Array) -> Array:
        """Command that may be written (actuators,): the same array each time, that of `stop` after a trip."""
        if self.trip is None:
            self._demanded[:], self._before[:] = demanded, self.applied
            self._guard.call()
            if found := self._guard.results[0]:
                self.applied[:] = self._before
                self._found_by(int(found), tick)
        return self.applied

    def stop(self, cause: Cause, tick: int, channel: str = "", *, value: float = 0.0, limit: float = 0.0,
             detail: str = "", unit: str = "1") -> Trip:  # fmt: skip
        """Trip for a cause that another one found; the first cause stays.

        Commands are zero from then on. Where it is the first, they are those of expiry if samples do not come, and the
        last ones if a controlled stop holds them.
        """
        is_first, held = self.trip is None, self.rules.stop is not None and self.rules.stop.damping is None
        if not (is_first and held and cause in BORNE):
            is_silent = is_first and cause is Cause.COMM_LOST
            self.applied[:] = self.rules.commands[:, safety_tables.EXPIRY] if is_silent else 0.0
        self.trip = made = self.trip or Trip(cause, channel, tick, value, limit, detail, unit)
        return made

    def release(self) -> Trip | None:
        """Watch on for a controlled stop, in which what is limited may be beyond its limit; return why it tripped."""
        first, self.trip = self.trip, None
        self._limits[:, safety_tables.BOUND] = np.inf
        return first

    def time(self, tick: int, *, is_late: bool, silence: float, missed: int, lost: int) -> None:
        """Look at the time of a tick that is late, or before which samples were missed; others need no look.

        Trips where five ticks in a row are late, where too many of a second are, and where the plant was silent:
        `silence` are the periods waited for it, and `lost` those of the `missed` samples that never came.
        """
        if silence > _LOST + 1.5 and lost > _LOST:
            self.stop(Cause.COMM_LOST, tick, value=silence, limit=_LOST)
        if is_late:
            self._late_in_a_row = self._late_in_a_row + 1 if tick - missed - 1 == self._late_at else 1
            self._late_at = tick
        if self._late_in_a_row >= _LATE_IN_A_ROW:
            self.stop(Cause.OVERRUN, tick, value=self._late_in_a_row, limit=_LATE_IN_A_ROW - 1)
        if tick - self._late_since >= self.rules.rate:
            self._late, self._late_since = 0, tick
        self._late += max(missed, int(is_late))
        most = self.rules.missed * self.rules.rate
        if self._late > most:
            self.stop(Cause.OVERRUN, tick, value=self._late, limit=most)

    def _found_by(self, number: int, tick: int) -> None:
        cause, at = Cause(number), int(self._found[0])
        kinds = (self.rules.sensors, self.rules.actuators, self.rules.limited)
        kind = 0 if cause <= Cause.SENSOR_RANGE else 2 if cause in {Cause.POSITION_LIMIT, Cause.VELOCITY_LIMIT} else 1
        value, limit = map(float, self._found[1:])
        self.stop(cause, tick, kinds[kind][at], value=value, limit=limit, unit=self.rules.unit(kind, at))


def _whole(table: Array) -> Array:
    return np.ascontiguousarray(table, dtype=np.float64)
