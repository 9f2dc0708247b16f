"""Damage on the way between a plant and whoever runs it: to readings, commands, and frames."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import EmergencyStopError, PlantError
from masking.lab.plants import wire
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant, Sample, Settings, Telling
from masking.lab.plants.remote import RemotePlant
from masking.lab.plants.udp import UdpLine
from masking.lab.plants.wire import Kind

_MAINS = 50.0  # Hz
Spoil = Callable[[bytes], list[bytes]]


@final
class Damaged:
    """A plant whose readings and commands are damaged on the way, as a file says that is read at each `configure`.

    The file holds a JSON object: `what` (`set`, `add`, `hold`, `scale` or `hum` readings; `command`, which scales
    commands; `stick`, which holds one at `value`; `index`, whose `value` is added to that of one sample; `fail`, where
    the plant raises an error; `press`, where its emergency stop is pressed), `channel`, `at` (the first tick of it) and
    `value`, as text where that is no finite number.

    Args:
        plant: any that reports its outputs.
        file: the damage; without it there is none.
    """

    owns_clock = False

    def __init__(self, plant: Plant, file: Path) -> None:
        self.plant, self.file = plant, file
        self.sensors, self.actuators = plant.sensors, plant.actuators
        self._chosen: Mapping[str, Any] = {}
        self._held, self._rate = 0.0, 1.0

    def configure(self, settings: Settings) -> None:
        """Configure the plant, and read what is to be damaged."""
        self._chosen, self._rate = json.loads(self.file.read_text()) if self.file.exists() else {}, settings.rate
        self.plant.configure(settings)

    def activate(self) -> None:
        """Activate the plant."""
        self.plant.activate()

    def _is_on(self, tick: int, *kinds: str) -> bool:
        return self._chosen.get("what") in kinds and tick >= int(self._chosen.get("at", 0))

    def read(self) -> Sample:
        """Return the sample with its damage.

        Raises:
            PlantError: that is the damage.
            EmergencyStopError: likewise.
        """
        sample = self.plant.read()
        values = sample.values.copy()
        channel, value = int(self._chosen.get("channel", 0)), float(self._chosen.get("value", 0.0))
        if self._is_on(sample.index, "press"):
            raise EmergencyStopError("the button at the bench")
        if self._is_on(sample.index, "fail"):
            raise PlantError("it failed in a step, as it was asked to")
        if self._is_on(sample.index, "hold"):
            values[channel] = self._held
        self._held = values[channel]
        if self._is_on(sample.index, "set"):
            values[channel] = value
        elif self._is_on(sample.index, "add"):
            values[channel] += value
        elif self._is_on(sample.index, "scale"):
            values[channel] *= value
        elif self._is_on(sample.index, "hum"):
            values[channel] += value * np.sin(2.0 * np.pi * _MAINS * sample.index / self._rate)
        if self._is_on(sample.index, "index") and sample.index == int(self._chosen["at"]):
            return Sample(sample.index + int(value), values)
        return Sample(sample.index, values)

    def write(self, index: int, command: Array) -> None:
        """Write the command with its damage."""
        reached = np.array(command)
        channel, value = int(self._chosen.get("channel", 0)), float(self._chosen.get("value", 0.0))
        if self._is_on(index, "command"):
            reached[channel] *= value
        elif self._is_on(index, "stick"):
            reached[channel] = value
        self.plant.write(index, reached)

    def deactivate(self) -> None:
        """Deactivate the plant."""
        self.plant.deactivate()

    def telemetry(self) -> Mapping[str, float]:
        """Return the plant's own."""
        return self.plant.telemetry() if isinstance(self.plant, Telling) else {}


@final
class DamagedPlant(RemotePlant):
    """A served plant behind a line that loses or spoils frames.

    Args:
        address: `udp://host:port`.
        lost: indices of samples that never arrive.
        spoil: gives frames that a receiver must not use beside a sound one; each sample and each command comes with
            those, and with a copy that has other values.
        key: of the server.
    """

    def __init__(
        self, address: str, *, lost: range = range(0), spoil: Spoil | None = None, key: Key | None = None
    ) -> None:
        super().__init__(address, timeout=None, patience=10.0, key=key)
        self._target = wire.parse_address(address)
        self.lost, self.spoil = lost, spoil

    def open_line(self) -> DamagedLine:
        """Return a line to the plant."""
        return DamagedLine(UdpLine(self._target), self.lost, self.spoil)


@final
class DamagedLine:
    """The controller's end of a line that loses or spoils frames."""

    def __init__(self, line: UdpLine, lost: range, spoil: Spoil | None) -> None:
        self.line, self.lost, self.spoil = line, lost, spoil
        self._waiting: deque[bytes] = deque()

    def waits(self, seconds: float) -> bool:
        """Tell whether a frame waits to be read, or comes within a time."""
        return bool(self._waiting) or self.line.waits(seconds)

    def receive(self) -> bytes:
        """Return a frame; BlockingIOError where it is lost."""
        if self._waiting:
            return self._waiting.popleft()
        received = self.line.receive()
        frame = wire.decode(received)
        if frame.kind is Kind.SENSORS and frame.index in self.lost:
            raise BlockingIOError
        if self.spoil and frame.kind is Kind.SENSORS:
            self._waiting.extend([*self.spoil(received), received, doubled(received)])
            return self._waiting.popleft()
        return received

    def send(self, frame: bytes) -> None:
        """Send a frame, after those that are spoiled."""
        if self.spoil and wire.decode(frame).kind is Kind.COMMAND:
            for each in (frame, doubled(frame), *self.spoil(frame)):
                self.line.send(each)
        else:
            self.line.send(frame)

    def close(self) -> None:
        """Close the line."""
        self.line.close()


def doubled(sound: bytes) -> bytes:
    """Return a frame of the same index with other values."""
    frame = wire.decode(sound)
    return wire.encode(frame.kind, frame.session, frame.index, values=frame.values + 3.0)


def spoiled(sound: bytes) -> list[bytes]:
    """Return what a receiver must not use beside a sound frame: older, of another session, and broken."""
    frame = wire.decode(sound)
    wrong = frame.values + 3.0
    return [
        *([wire.encode(frame.kind, frame.session, frame.index - 3, values=wrong)] if frame.index > 3 else []),
        wire.encode(frame.kind, frame.session ^ 1, frame.index + 1, values=wrong),
        sound[:-1] + bytes([sound[-1] ^ 0xFF]),
    ]
