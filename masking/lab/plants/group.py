"""Several plants that one controller drives: they are read and written together, each over its own interface."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import PlantMismatchError
from masking.lab.plants import adapters, interface
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import APPLIED, Counting, Latching, LifeCycle, Plant, Sample, Settings, Telling


@final
class PlantGroup:
    """Several plants as one; the channel `s` of the plant `a` is `a_s`, as in an experiment with `plants`.

    Each sample has the readings of all, and each command goes to all. Plants that own a clock are waited for one after
    the other: their clocks are not synchronised, so that a reading may be a period older than that of another plant.
    In lockstep they keep in step. A sample that one of them missed counts as missed.

    Args:
        plants: by name, at least one.
    """

    def __init__(self, plants: Mapping[str, Plant]) -> None:
        self.plants = dict(plants)
        self.sensors, self.actuators = tuple[str, ...](), tuple[str, ...]()
        self.owns_clock = any(plant.owns_clock for plant in self.plants.values())
        self._life = LifeCycle()
        self._first, self._read = dict[str, int](), dict[str, int]()

    def configure(self, settings: Settings) -> None:
        """Configure each plant."""
        self._life.configure()
        for plant in self.plants.values():
            plant.configure(settings)
        self.sensors = tuple(f"{name}_{s}" for name, plant in self.plants.items() for s in plant.sensors)
        self.actuators = tuple(f"{name}_{a}" for name, plant in self.plants.items() for a in plant.actuators)
        self._first, self._read = {}, {}

    def activate(self) -> None:
        """Enable the outputs of each, at zero."""
        self._life.activate()
        for plant in self.plants.values():
            plant.activate()

    def read(self) -> Sample:
        """Next sample of all; its index counts from the first, and is that of the plant that is furthest."""
        self._life.need_active("read")
        values = []
        for name, plant in self.plants.items():
            sample = plant.read()
            interface.check_index(sample.index, self._read.get(name))
            self._first.setdefault(name, sample.index)
            self._read[name] = sample.index
            values.append(sample.values)
        return Sample(max(self._read[name] - first for name, first in self._first.items()), np.concatenate(values))

    def write(self, index: int, command: Array) -> None:
        """Give each plant its part of the command (actuators,), as the answer to its own last sample."""
        self._life.need_active("write")
        interface.check_command(command, self.actuators)
        first = 0
        for name, plant in self.plants.items():
            last = first + len(plant.actuators)
            plant.write(self._read.get(name, index), command[first:last])
            first = last

    def trip(self, cause: str) -> None:
        """Let each plant that keeps it know why the run tripped."""
        for plant in self.plants.values():
            if isinstance(plant, Latching):
                plant.trip(cause)

    def deactivate(self) -> None:
        """Set the outputs of all to zero."""
        self._life.deactivate()
        for plant in self.plants.values():
            plant.deactivate()

    @property
    def counters(self) -> dict[str, int]:
        """Sums of the counts of the plants."""
        counted: Counter[str] = Counter()
        for plant in self.plants.values():
            if isinstance(plant, Counting):
                counted.update(plant.counters)
        return dict(counted)

    def telemetry(self) -> dict[str, float]:
        """Telemetry of the plants, by the names of the group."""
        reported = {}
        for name, plant in self.plants.items():
            if isinstance(plant, Telling):
                for key, value in plant.telemetry().items():
                    head = APPLIED if key.startswith(APPLIED) else ""
                    reported[f"{head}{name}_{key.removeprefix(APPLIED)}"] = value
        return reported


def connect_each(addresses: Sequence[str], names: Sequence[str], key: Key | None = None) -> Plant:
    """Plant at an address, or the plants of an experiment together.

    There is one address, or `name=address` for each of the names; `key` is that which the servers of all have, too. A
    PlantMismatchError where they are others, or no adapter has them.
    """
    pairs = [address.partition("=") for address in addresses]
    found = {name: address for name, is_named, address in pairs if is_named}
    if not names and len(addresses) == 1:
        return adapters.connect(addresses[0], key)
    if not names:
        raise PlantMismatchError(f"--plant {', '.join(addresses)}: the experiment has one plant; give its address")
    if len(pairs) != len(names) or found.keys() != {*names}:
        wanted = " ".join(f"--plant {name}=ADDRESS" for name in names)
        raise PlantMismatchError(f"--plant {', '.join(addresses)}: the experiment has several plants; give {wanted}")
    return PlantGroup({name: adapters.connect(found[name], key) for name in names})
