"""Session: one controller of a served plant, from its hello to its end: what it may, and a row for each sample."""

from __future__ import annotations

import contextlib
import datetime
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import PlantMismatchError
from masking.lab.plants.interface import Plant, Sample, Settings, Telling
from masking.lab.plants.transport import Peer
from masking.lab.plants.wire import Frame
from masking.lab.records.recording import Recording, with_finite
from masking.lab.records.tick_times import timing

SILENT_START: Final = 10.0  # seconds until the first command; the outputs are zero meanwhile
LONGEST_WATCHDOG: Final = 1.0  # s
RATES: Final = (1.0, 100_000.0)  # Hz
_CLOCK: Final = 0.05  # of the watchdog's time: what its clock may be early


@final
@dataclass(frozen=True, slots=True)
class Allowed:
    """What a served plant allows its controllers."""

    watchdog: float = LONGEST_WATCHDOG  # the longest watchdog, s
    rates: tuple[float, float] = RATES  # the lowest and the highest number of samples per second, Hz

    def __post_init__(self) -> None:
        low, high = self.rates
        if not 0.0 < self.watchdog < math.inf:
            raise PlantMismatchError(f"the longest watchdog is {self.watchdog:g} s; give a positive number of seconds")
        if not 0.0 < low <= high < math.inf:
            raise PlantMismatchError(f"rates from {low:g} to {high:g} Hz; give a lowest and a highest, both positive")

    def check(self, settings: Settings) -> None:
        """Refuse settings that are not allowed with a PlantMismatchError, which says how to allow them."""
        low, high = self.rates
        if not low <= settings.rate <= high:
            raise PlantMismatchError(
                f"rate is {settings.rate:g} Hz; this plant allows {low:g} to {high:g} Hz: change controller.rate, or "
                "serve with other --rates"
            )
        if not settings.lockstep and settings.watchdog > self.watchdog:
            raise PlantMismatchError(
                f"watchdog is {settings.watchdog:g} s; this plant allows at most {self.watchdog:g} s: ask for less, or "
                "serve with another --watchdog"
            )


@final
class Session:
    """What is known of one controller: the number that it drew, where it is, its last command, and how it went."""

    def __init__(self, number: int, address: Peer, settings: Settings, plant: Plant) -> None:
        self.number, self.address, self.settings = number, address, settings
        self.command: Array = np.zeros(len(plant.actuators))
        self.answered = -1  # index of the newest sample that a command answered
        self.fresh = False  # a command arrived since the last sample
        self.is_written = False  # the command is in force already, before the tick
        self.silent_from = math.inf  # instant of the oldest sample without an answer, s
        self.patience = max(1, math.ceil(settings.watchdog * settings.rate - 1e-9))  # of the watchdog, samples
        self.latch: dict[str, Any] | None = None
        self.end = ""
        self.acknowledged = ""  # why the session before was stopped
        self.counters: Counter[str] = Counter()
        self.rows = SessionRows(plant)
        self._early = min(0.5 / settings.rate, _CLOCK * settings.watchdog)

    def take(self, frame: Frame, tick: int) -> None:
        """Take over a command that is newer than the last and not too old, at a tick; else count why not."""
        if len(frame.values) != len(self.command):
            cause = "wrong size"
        elif frame.index <= self.answered:
            cause = "duplicate" if frame.index == self.answered else "reordered"
        elif frame.index > tick:
            cause = "ahead"
        elif tick - frame.index >= self.patience:
            cause = "stale"
        elif self.latch is not None:
            cause = "after latch"
        else:
            cause = "commands"
            self.command[:] = frame.values
            self.answered, self.fresh = frame.index, True
            self.silent_from = math.inf
        self.counters[cause] += 1

    def show(self, instant: float) -> None:
        """Begin to wait for the answer to a sample that was due at an instant, s of the monotonic clock."""
        self.fresh = self.is_written = False
        self.silent_from = min(self.silent_from, instant)

    def watch(self, tick: int, now: float) -> None:
        """Trip where samples were not answered for the time of the watchdog; now is s of the monotonic clock."""
        silent = now - self.silent_from + self._early
        if self.latch is not None:
            return
        if self.answered >= 0 and silent >= self.settings.watchdog:
            self.trip(tick, f"no valid command for {self.settings.watchdog * 1e3:g} ms")
        elif self.answered < 0 and silent >= SILENT_START:
            self.trip(tick, f"no command for {SILENT_START:g} s after the start")

    def watch_clock(self, tick: int, late: float) -> None:
        """Trip where the plant's clock stood still, by `late` s, for the watchdog's time: what waits is as old."""
        if self.latch is None and self.answered >= 0 and late >= self.settings.watchdog:
            self.trip(tick, f"the server was held up for {late * 1e3:.0f} ms, while the last command held")

    def trip(self, tick: int, cause: str) -> None:
        """Set the outputs to zero for the rest of the session; the first cause stays."""
        self.command[:] = 0.0
        if self.latch is None:
            self.latch = {"cause": cause, "tick": tick}

    def finish(self, plant: Plant) -> None:
        """Complete the row of the last sample."""
        self.rows.finish(plant, self.command, fresh=self.fresh, latched=self.latch is not None)

    def close(self, plant: Plant) -> None:
        """Complete the last row: the outputs are zero after it."""
        self.command[:], self.fresh = 0.0, False
        if self.rows.is_open:
            with contextlib.suppress(Exception):  # what a plant that failed cannot tell stays unknown
                self.finish(plant)

    def manifest(self, clock: str) -> dict[str, Any]:
        """Facts of the session, for the manifest of its record."""
        return {
            "clock": clock,
            "rate": self.settings.rate,
            "watchdog": self.settings.watchdog,
            "end": self.end,
            "latch": self.latch,
            **({"acknowledged": self.acknowledged} if self.acknowledged else {}),
            "counters": dict(self.counters),
        }


CHUNK: Final = 4096  # rows
_FIXED: Final = ("t", "tick", "wall", "late", "fresh", "latched")


@final
class SessionRows:
    """The rows of a session, in chunks made ahead so that no tick waits for memory."""

    def __init__(self, plant: Plant) -> None:
        self.names = [*_FIXED, *(f"sensor.{name}" for name in plant.sensors)]
        self.inputs = slice(len(self.names), len(self.names) + len(plant.actuators))
        self.names += [f"input.{name}" for name in plant.actuators]
        self.telemetry = tuple(plant.telemetry()) if isinstance(plant, Telling) else ()
        self.names += [f"plant.{name}" for name in self.telemetry]
        self.sensors = slice(len(_FIXED), self.inputs.start)
        self.count = 0
        self.is_open = False
        self.chunks = [self.chunk(), self.chunk()]

    def chunk(self) -> Array:
        """Make room for more rows."""
        return np.full((CHUNK, len(self.names)), np.nan)

    @property
    def row(self) -> Array:
        """The last row that was begun."""
        row: Array = self.chunks[(self.count - 1) // CHUNK][(self.count - 1) % CHUNK]
        return row

    def begin(self, sample: Sample, rate: float, wall: float, late: float) -> None:
        """Begin the row of a sample."""
        if self.count == len(self.chunks) * CHUNK:
            self.chunks.append(self.chunk())
        self.count += 1
        self.is_open = True
        row = self.row
        row[:4] = sample.index / rate, sample.index, wall, late
        row[self.sensors] = sample.values

    def finish(self, plant: Plant, command: Array, *, fresh: bool, latched: bool) -> None:
        """Complete the row: the command (actuators,) that held, the plant's telemetry, and what happened."""
        row = self.row
        row[4:6] = fresh, latched
        row[self.inputs] = command
        if isinstance(plant, Telling):
            values = plant.telemetry()
            row[self.inputs.stop :] = [values[name] for name in self.telemetry]
        self.is_open = False

    def recording(self, manifest: Mapping[str, Any]) -> Recording:
        """Rows; what is not finite is 0 there, and 1 in `nonfinite.<column>`."""
        columns = with_finite(dict(zip(self.names, np.concatenate(self.chunks)[: self.count].T, strict=True)))
        created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        head = {"name": "a plant's own record", "created": created}
        clock = {"lateness": columns["late"]} if manifest["clock"] == "real" else {}
        return Recording(columns, {**head, **manifest, "timing": timing(columns["tick"].astype(np.int64), **clock)})
