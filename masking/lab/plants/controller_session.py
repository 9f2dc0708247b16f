"""Session: one controller of a served plant, from its hello to its end: what it may, and a row for each sample."""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import PlantMismatchError, RecordError
from masking.lab.plants.interface import Plant, Sample, Settings, Telling
from masking.lab.plants.transport import Peer
from masking.lab.plants.wire import Frame
from masking.lab.records import stream, stream_reader, tick_record
from masking.lab.records.recorder import Recorder
from masking.lab.records.ring import cells

LATE: Final = "late"
FACTS: Final = ("name", "created", "clock", "watchdog")  # that the manifest of its stream has of a session
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

    def __init__(
        self, number: int, address: Peer, settings: Settings, actuators: int, rows: SessionRows | None
    ) -> None:
        self.number, self.address, self.settings = number, address, settings
        self.command: Array = np.zeros(actuators)
        self.expiry: Array = np.zeros(actuators)  # in force once the watchdog has expired
        self.answered = -1  # index of the newest sample that a command answered
        self.fresh = False  # a command arrived since the last sample
        self.is_written = False  # the command is in force already, before the tick
        self.silent_from = math.inf  # instant of the oldest sample without an answer, s
        self.patience = max(1, math.ceil(settings.watchdog * settings.rate - 1e-9))  # of the watchdog, samples
        self.latch: dict[str, Any] | None = None
        self.end = ""
        self.acknowledged = ""  # why the session before was stopped
        self.counters: Counter[str] = Counter()
        self.rows = rows  # None where nothing is recorded
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
            self.trip(tick, f"no valid command for {self.settings.watchdog * 1e3:g} ms", is_silent=True)
        elif self.answered < 0 and silent >= SILENT_START:
            self.trip(tick, f"no command for {SILENT_START:g} s after the start")

    def watch_clock(self, tick: int, late: float) -> None:
        """Trip where the plant's clock stood still, by `late` s, for the watchdog's time: what waits is as old."""
        if self.latch is None and self.answered >= 0 and late >= self.settings.watchdog:
            self.trip(
                tick, f"the server was held up for {late * 1e3:.0f} ms, while the last command held", is_silent=True
            )

    def trip(self, tick: int, cause: str, *, is_silent: bool = False) -> None:
        """Set the outputs to zero, or to `expiry` where the controller is silent; the first cause stays."""
        self.command[:] = self.expiry if is_silent and self.latch is None else 0.0
        if self.latch is None:
            self.latch = {"cause": cause, "tick": tick}

    def finish(self, plant: Plant) -> None:
        """Complete the row of the last sample."""
        if self.rows is not None:
            self.rows.finish(plant, self.command, fresh=self.fresh, latched=self.latch is not None)

    def close(self, plant: Plant) -> None:
        """Complete the last row: the outputs are zero after it."""
        self.command[:], self.fresh = 0.0, False
        if self.rows is not None and self.rows.is_open:
            try:
                self.finish(plant)
            except Exception:  # what a plant that failed cannot tell stays unknown
                self.rows.put()

    @property
    def outcome(self) -> dict[str, Any]:
        """How it ended, for the manifest of its record."""
        return {
            "end": self.end,
            "latch": self.latch,
            **({"acknowledged": self.acknowledged} if self.acknowledged else {}),
            "counters": dict(self.counters),
        }


_FIXED: Final = {
    "tick": ("1", "tick of the plant's clock"),
    "wall": ("s", "time since the first sample"),
    LATE: ("s", "how late the tick was"),
    "fresh": ("1", "1 where a command answered in time"),
    "latched": ("1", "1 once the session has tripped"),
}


@final
class SessionRows:
    """The rows of a session on their way to disk, in a folder of its own: a row for each sample, once it is complete.

    A RecordError where the folder cannot be written.
    """

    def __init__(self, plant: Plant, folder: Path, rate: float, **facts: object) -> None:
        self.folder, self.telemetry = folder, tuple(plant.telemetry()) if isinstance(plant, Telling) else ()
        groups = {"sensor": plant.sensors, "input": plant.actuators, "plant": self.telemetry}
        names = [f"{kind}.{name}" for kind, group in groups.items() for name in group]
        columns = {name: {"unit": unit, "meaning": meaning} for name, (unit, meaning) in _FIXED.items()}
        columns |= {name: {"unit": "", "meaning": ""} for name in names}
        self._sensors = slice(len(_FIXED), len(_FIXED) + len(plant.sensors))
        self._inputs = slice(self._sensors.stop, self._sensors.stop + len(plant.actuators))
        self._row: Array = np.full(len(columns), np.nan)
        self.is_open = False
        self.recorder = Recorder(folder, columns, rate, tempfile.gettempdir(), is_hurried=True, **facts)

    def begin(self, sample: Sample, wall: float, late: float) -> None:
        """Begin the row of a sample."""
        self.is_open, self._row[:] = True, np.nan
        self._row[:3] = sample.index, wall, late
        self._row[self._sensors] = sample.values

    def finish(self, plant: Plant, command: Array, *, fresh: bool, latched: bool) -> None:
        """Complete the row: the command (actuators,) that held, the plant's telemetry, and what happened."""
        self._row[3:5] = fresh, latched
        self._row[self._inputs] = command
        if isinstance(plant, Telling):
            values = plant.telemetry()
            self._row[self._inputs.stop :] = [values[name] for name in self.telemetry]
        self.put()

    def put(self) -> None:
        """Hand the row on as it is."""
        self.is_open = False
        self.recorder.ring.put(cells(self._row))

    def save(self, outcome: Mapping[str, Any], *, has_clock: bool) -> bool:
        """Make the recording of the folder, with the outcome, of all rows, if there are any; tell whether there are.

        A RecordError where it cannot be made: the stream stays.
        """
        if not self.recorder.ring.count:
            self.discard()
            return False
        self.recorder.close()
        found = stream_reader.read(self.folder)
        head = {name: found.manifest[name] for name in FACTS}
        note = {"recorder": self.recorder.as_dict()} if self.recorder.note else {}
        tick_record.save(found, self.folder, {**head, **outcome, **note}, LATE if has_clock else None)
        if not found.damages:
            stream.remove(self.folder)
        return True

    def discard(self) -> None:
        """Leave no record: the session was never started."""
        self.recorder.discard()
        with contextlib.suppress(OSError):  # where other sessions are
            self.folder.parent.rmdir()


def claimed(record: Path) -> Path:
    """New folder for a session, `session-1` or the first number that is free; a RecordError where none can be made."""
    number = 1
    while True:
        folder = record / f"session-{number}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            message = f"{record} cannot be written: {error.strerror or error}; name another folder"
            raise RecordError(message) from error
        else:
            return folder
