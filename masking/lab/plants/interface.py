"""The interface of a plant: what the controller does not own.

Every plant goes through three states, and each run through all of them:

    UNCONFIGURED --configure--> INACTIVE --activate--> ACTIVE (read, write) --deactivate--> UNCONFIGURED

so that no run begins from what another left behind. An adapter may keep a `LifeCycle` to enforce this order, and
`masking.lab.plants.conformance.check` reports the rules that an adapter breaks.

Whoever runs a plant that does not own its clock keeps the time with `masking.lab.plants.operating_system`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, final, runtime_checkable

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import CommandError, PlantError, PlantMismatchError, PlantOrderError

_UNITS = {"rate": "samples per second", "watchdog": "seconds"}
_LARGEST = 1e6

APPLIED = "applied."
"""Telemetry named `applied.<actuator>` is the output in force; it is 0 in a plant that is not active."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a plant is configured with."""

    rate: float  # samples per second, Hz, at most 1e6
    # seconds, at most 1e6, in which a sample must be answered; else the plant's outputs go to zero and stay there
    watchdog: float = 0.02
    lockstep: bool = False  # the plant waits for the command that answers each sample; else its clock goes on without
    # whoever starts the run has looked at why the plant stopped the last one; without, a plant that has tripped refuses
    acknowledge: bool = False

    def __post_init__(self) -> None:
        for name, value in (("rate", self.rate), ("watchdog", self.watchdog)):
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= _LARGEST:
                message = f"{name} is {value!r}; give a positive number of {_UNITS[name]}, at most {_LARGEST:g}"
                raise PlantMismatchError(message)
        for name, answer in (("lockstep", self.lockstep), ("acknowledge", self.acknowledge)):
            if not isinstance(answer, bool):
                raise PlantMismatchError(f"{name} is {answer!r}; give true or false")


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """What the sensors showed at one tick."""

    index: int  # tick of the plant's clock; it increases from sample to sample, by more than 1 where some were missed
    values: Array  # (sensors,), in the plant's units


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
        """Next sample, waiting for it, where the plant owns the clock; else the newest."""
        ...

    def write(self, index: int, command: Array) -> None:
        """Set the outputs to the command (actuators,) that answers the sample `index`; it holds until the next."""

    def deactivate(self) -> None:
        """Set the outputs to zero and end the run; legal in every state, any number of times; never raises."""


@runtime_checkable
class Telling(Protocol):
    """A plant that reports more than its sensors show, for its own record."""

    def telemetry(self) -> Mapping[str, float]:
        """Finite numbers by name, the same names at each call; legal in every state once configured."""
        ...


@runtime_checkable
class Counting(Protocol):
    """A plant that counts what went wrong on the way to it."""

    counters: Mapping[str, int]


@runtime_checkable
class Latching(Protocol):
    """A plant that refuses to start after a run that tripped, until somebody acknowledges why."""

    def trip(self, cause: str) -> None:
        """Keep why the run tripped; legal in every state, and never raises. `deactivate` follows."""


@runtime_checkable
class Holding(Protocol):
    """A plant in this process whose outputs stay as they are where the process is killed: another one puts them back.

    Attributes:
        address: by which another process connects it.
    """

    address: str

    def rest(self) -> None:
        """Set the outputs to zero at once, whichever process drove them; legal in every state, and may raise."""


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
            remedy = "call deactivate and configure first" if self.state is State.ACTIVE else "call configure first"
            raise PlantOrderError(f"activate: the plant is {self.state}; {remedy}")
        self.state = State.ACTIVE

    def need_active(self, verb: str) -> None:
        """Refuse what only an active plant does."""
        if self.state is not State.ACTIVE:
            remedy = "call activate first" if self.state is State.INACTIVE else "call configure and activate first"
            raise PlantOrderError(f"{verb}: the plant is {self.state}; {remedy}")

    def deactivate(self) -> None:
        """Go to UNCONFIGURED from any state."""
        self.state = State.UNCONFIGURED


def check_index(index: int, last: int | None) -> None:
    """Refuse the index of a sample that is not larger than that of the last one, None at first, with a PlantError."""
    if last is not None and index <= last:
        raise PlantError(
            f"the plant gave sample {index} after sample {last}: a clock that stands still or goes back is none; "
            "'masking rig check ADDRESS' tries what its adapter must do"
        )


def check_command(command: Array, actuators: tuple[str, ...]) -> None:
    """Refuse what is not one finite number for each actuator, shape (actuators,), with a CommandError."""
    if np.shape(command) != (len(actuators),):
        names = ", ".join(actuators)
        message = f"the command has shape {np.shape(command)}; give ({len(actuators)},), one number for each of {names}"
        raise CommandError(message)
    for name, value in zip(actuators, command, strict=True):
        if not math.isfinite(value):
            raise CommandError(f"the command for {name} is {value}; give a finite number")
