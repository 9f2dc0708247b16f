"""The interface of a plant: what the controller does not own.

Every plant goes through three states, and each run through all of them:

    UNCONFIGURED --configure--> INACTIVE --activate--> ACTIVE (read, write) --deactivate--> UNCONFIGURED

so that no run begins from what another left behind. An adapter may keep a `LifeCycle` to enforce this order, and
`masking.plants.conformance.check` reports the rules that an adapter breaks.

Whoever runs a plant that does not own its clock keeps the time with `Deadlines`, `undisturbed` by what can be kept
away, until `asked_to_stop`.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, Protocol, final, runtime_checkable

import numpy as np

from masking.errors import CommandError, PlantMismatchError, PlantOrderError
from masking.numerics.arrays import Array

Stop = Callable[[], bool]

POLL: Final = 0.1  # seconds between looks at `stop` while nothing happens
PRIORITY: Final = 50
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_EARLY_NS: Final = 0 if sys.platform == "linux" else 500_000  # what time.sleep may be late where it is not exact
_LIBC: Final = ctypes.CDLL(None) if sys.platform == "linux" else None
_UNITS = {"rate": "samples per second", "watchdog": "seconds"}
_LARGEST = 1e6

APPLIED = "applied."
"""Telemetry named `applied.<actuator>` is the output in force; it is 0 in a plant that is not active."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a plant is configured with.

    Args:
        rate: samples per second, Hz, at most 1e6.
        watchdog: seconds of the plant's clock without a valid command after which its outputs go to zero and stay; at
            most 1e6.
        lockstep: the plant waits for the command that answers each sample; else its clock goes on without.
    """

    rate: float
    watchdog: float = 0.02
    lockstep: bool = False

    def __post_init__(self) -> None:
        for name, value in (("rate", self.rate), ("watchdog", self.watchdog)):
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= _LARGEST:
                message = f"{name} is {value!r}; give a positive number of {_UNITS[name]}, at most {_LARGEST:g}"
                raise PlantMismatchError(message)
        if not isinstance(self.lockstep, bool):
            raise PlantMismatchError(f"lockstep is {self.lockstep!r}; give true or false")


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """What the sensors showed at one tick.

    Args:
        index: tick of the plant's clock; it increases from sample to sample, by more than 1 where some were missed.
        values: (sensors,), in the plant's units.
    """

    index: int
    values: Array


class Plant(Protocol):
    """A plant, simulated or real.

    Attributes:
        sensors: names, in the order of the values of a sample; known once configured.
        actuators: names, in the order of a command; known once configured.
        owns_clock: the plant says when the next sample is due; else whoever runs it does, and each `write` followed
            by a `read` is one tick.
    """

    sensors: tuple[str, ...]
    actuators: tuple[str, ...]
    owns_clock: bool

    def configure(self, settings: Settings) -> None:
        """Go back to the declared start and take over the settings; refused while active."""

    def activate(self) -> None:
        """Enable the outputs, at zero."""

    def read(self) -> Sample:
        """Return the next sample, waiting for it, where the plant owns the clock; else the newest."""
        ...

    def write(self, index: int, command: Array) -> None:
        """Set the outputs to the command (actuators,) that answers the sample `index`; it holds until the next."""

    def deactivate(self) -> None:
        """Set the outputs to zero and end the run; legal in every state, any number of times; never raises."""


@runtime_checkable
class Telling(Protocol):
    """A plant that reports more than its sensors show, for its own record."""

    def telemetry(self) -> Mapping[str, float]:
        """Return finite numbers by name, the same names at each call; legal in every state once configured."""
        ...


@runtime_checkable
class Counting(Protocol):
    """A plant that counts what went wrong on the way to it."""

    counters: Mapping[str, int]


class State(StrEnum):
    """States of a plant."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"


@final
class LifeCycle:
    """The state that a plant is in; each method is a transition, or refuses it and says what to call first."""

    def __init__(self) -> None:
        self.state = State.UNCONFIGURED

    def configure(self) -> None:
        """Go to INACTIVE; refused while active."""
        if self.state is State.ACTIVE:
            raise PlantOrderError("configure: the plant is active; call deactivate first")
        self.state = State.INACTIVE

    def activate(self) -> None:
        """Go from INACTIVE to ACTIVE."""
        if self.state is not State.INACTIVE:
            mend = "call deactivate and configure first" if self.state is State.ACTIVE else "call configure first"
            raise PlantOrderError(f"activate: the plant is {self.state}; {mend}")
        self.state = State.ACTIVE

    def need_active(self, verb: str) -> None:
        """Refuse what only an active plant does."""
        if self.state is not State.ACTIVE:
            mend = "call activate first" if self.state is State.INACTIVE else "call configure and activate first"
            raise PlantOrderError(f"{verb}: the plant is {self.state}; {mend}")

    def deactivate(self) -> None:
        """Go to UNCONFIGURED from any state."""
        self.state = State.UNCONFIGURED


def check_command(command: Array, actuators: tuple[str, ...]) -> None:
    """Refuse a command that is not one finite number for each actuator, shape (actuators,).

    Raises:
        CommandError: it is not.
    """
    if np.shape(command) != (len(actuators),):
        names = ", ".join(actuators)
        message = f"the command has shape {np.shape(command)}; give ({len(actuators)},), one number for each of {names}"
        raise CommandError(message)
    for name, value in zip(actuators, command, strict=True):
        if not math.isfinite(value):
            raise CommandError(f"the command for {name} is {value}; give a finite number")


@final
class Deadlines:
    """Instants one period apart on the monotonic clock, from the construction on; a missed one is never made up for.

    `missed` counts the periods that were left out.

    Args:
        rate: Hz.
    """

    def __init__(self, rate: float) -> None:
        self.missed = 0
        self._period = 1e9 / rate
        self._start, self._tick = time.monotonic_ns(), 0

    def wait(self, stop: Stop) -> float:
        """Wait for the next instant, or until asked to stop; return how late it was missed or met, in seconds.

        Where it passed more than a period ago, it and those after it are left out up to the next one to come.
        """
        self._tick += 1
        late = time.monotonic_ns() - self._instant
        if late > self._period:
            left_out = int(late // self._period) + 1
            self._tick += left_out
            self.missed += left_out
        while (now := time.monotonic_ns()) < self._instant and not stop():
            _sleep_until(min(self._instant, now + int(POLL * 1e9)))
        return max(0, late, now - self._instant) * 1e-9

    @property
    def _instant(self) -> int:
        return self._start + int(self._tick * self._period)


def _sleep_until(instant: int) -> None:
    """Sleep until an instant, ns of the monotonic clock."""
    time.sleep(max(0, instant - time.monotonic_ns() - _EARLY_NS) * 1e-9)
    while time.monotonic_ns() < instant:
        pass


@contextlib.contextmanager
def undisturbed(*, priority: bool) -> Iterator[str]:
    """Keep the garbage collector, and with `priority` also other processes and swapping, away while inside.

    Gives a sentence about what was not permitted; empty where all was.
    """
    collected = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        if not (priority and sys.platform == "linux" and _LIBC is not None):
            yield ""
            return
        policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
        missing = []
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
        except OSError:
            missing.append("real-time priority (ulimit -r)")
        # What is in use stays in memory. Not MCL_FUTURE: under a limit it makes an allocation fail in mid-run. With
        # MCL_ONFAULT the unused parts of libraries are left alone; measured: 2.8 s without it where pyarrow is loaded.
        if _LIBC.mlockall(_MCL_CURRENT | _MCL_ONFAULT):
            missing.append("locked memory (ulimit -l)")
        try:
            yield f"not permitted here: {', '.join(missing)}; ticks may be late" if missing else ""
        finally:
            _LIBC.munlockall()
            os.sched_setscheduler(0, policy, parameters)
    finally:
        if collected:
            gc.enable()


@contextlib.contextmanager
def asked_to_stop() -> Iterator[Stop]:
    """Give a function that returns whether SIGINT, SIGTERM or SIGHUP came; they do nothing else while inside.

    A signal that is ignored, as under nohup, stays so. Outside the main thread no signal is looked at.
    """
    came: list[int] = []
    former: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                former[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in former.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
