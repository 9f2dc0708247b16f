"""Guard of a served plant: `plants.serve` passes each command through it, and none past it, whoever the controller is.

It is a `safety_chain.Chain` of the plant file's limits, which `runs.safety_limits` makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import final

import numpy as np
from numpy.typing import NDArray

from masking.compile.numerics import safety_tables
from masking.compile.numerics.arrays import Array
from masking.errors import PlantMismatchError, nearest
from masking.lab.plants.controlled_stop import Braking, follows
from masking.lab.plants.interface import Plant, Sample, Settings
from masking.lab.plants.safety_chain import Chain, Rules


@final
class PlantLimits:
    """Holds a plant to the limits of a plant file by a safety chain of its own.

    `rules` gives what it is held to at a number of samples per second; of channels that it has, in any order.
    """

    def __init__(self, rules: Callable[[float], Rules]) -> None:
        self._rules = rules
        self._chain: Chain | None = None
        self._braking: Braking | None = None
        self._stopping, self._until = "", 0  # why, and the tick at which a controlled stop ends
        self._last = -1
        self._sensors, self._actuators = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)

    @property
    def counters(self) -> Mapping[str, int]:
        """How many commands were `clamped` since `begin`, if any."""
        clamped = self._chain.clamped if self._chain is not None else 0
        return {"clamped": clamped} if clamped else {}

    def begin(self, plant: Plant, settings: Settings) -> None:
        """Begin a session with a plant that is configured; a PlantMismatchError where it lacks a limited channel."""
        rules = self._rules(settings.rate)
        self._sensors = _places("sensor", rules.sensors, plant.sensors)
        self._actuators = _places("actuator", rules.actuators, plant.actuators)
        self._chain, self._last, self._stopping = Chain(rules), -1, ""
        self._braking = None if rules.stop is None else Braking(self._chain, rules.stop)

    def expire(self, command: Array) -> None:
        """Make a command (actuators,) what the plant puts out once its controller is silent for its watchdog's time."""
        if self._chain is not None:
            command[self._actuators] = self._chain.rules.commands[:, safety_tables.EXPIRY]

    def check(self, sample: Sample, command: Array) -> str:
        """Look at the readings, and make a command (actuators,) what the chain leaves of it.

        Returns why the plant must stop, as a sentence, upon which the command is not written; empty where it need not.
        A controlled stop of the plant file comes first: meanwhile its commands replace those that are given.
        """
        chain, missed = self._chain, max(0, sample.index - self._last - 1) if self._last >= 0 else 0
        assert chain is not None  # noqa: S101  # a session begins before its commands are checked
        self._last, read = sample.index, sample.values[self._sensors]
        if chain.watch(sample.index, read, missed) is None:
            wanted = command[self._actuators]
            if self._stopping and self._braking is not None:
                wanted = self._braking.step(sample.index, read)
            command[self._actuators] = chain.guard(sample.index, wanted)
        return self._cause(chain, sample.index, read, command)

    def _cause(self, chain: Chain, tick: int, read: Array, command: Array) -> str:
        """Why the plant must stop, once a controlled stop is over where there is one."""
        if self._braking is None:
            return str(chain.trip) if chain.trip is not None else ""
        if self._stopping:
            return self._stopping if chain.trip is not None or self._braking.is_over or tick >= self._until else ""
        self._braking.see(tick, read)
        if chain.trip is None or not follows(chain):
            return str(chain.trip) if chain.trip is not None else ""
        command[self._actuators] = chain.applied
        self._stopping, self._until = str(chain.release()), tick + self._braking.samples
        return ""


def _places(kind: str, wanted: tuple[str, ...], there: tuple[str, ...]) -> NDArray[np.intp]:
    """Where channels are among those of a plant."""
    for name in wanted:
        if name not in there:
            message = f"the limits are those of a plant with the {kind} {name}, which this one does not have"
            raise PlantMismatchError(f"{message}; {nearest(name, there)}")
    return np.array([there.index(name) for name in wanted], dtype=np.intp)
