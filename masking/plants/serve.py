"""Serve a plant to a controller in another process: its clock, its watchdog, and its own record of what happened.

Any plant that does not own its clock can be served. Between sessions it is unconfigured and its outputs are zero; each
session begins from its configured start. At tick k the newest valid command that has arrived answers sample k - 1, or
else the last one holds; the plant advances under it, and sample k goes out. The outputs go to zero and stay there until
a controller opens a new session

* when no valid command came for the time of the watchdog, counted in ticks from the first command on, or, in lockstep,
  for `patience` seconds;
* when the controller says so, the plant fails, or the server is stopped.

A tick that is late by more than a period moves all that follow: the plant stood still meanwhile, and no tick is caught
up. The missed ones are counted.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from masking.errors import MaskingError, PlantMismatchError, RecordError, WireError
from masking.numerics.arrays import Array
from masking.plants import adapters, wire
from masking.plants.interface import Plant, Sample, Settings, Telling
from masking.plants.lines import Hub, Peer
from masking.plants.machine import POLL, Deadlines, Stop, asked_to_stop, undisturbed
from masking.plants.wire import Frame, Kind
from masking.records.recording import Recording

Clock = Literal["real", "lockstep"]

RESERVED: Final = 10.0  # seconds that a controller may take from configure to activate
SILENT_START: Final = 10.0  # seconds of the plant's clock until the first command; the outputs are zero meanwhile
MOST: Final = 1000  # frames that are looked at in one tick
CHUNK: Final = 4096  # rows
_FIXED: Final = ("t", "tick", "wall", "late", "fresh", "latched")


def serve(
    plant: Plant,
    address: str,
    *,
    clock: Clock = "real",
    record: str | Path | None = None,
    stop_after: int | None = None,
    stop: Stop | None = None,
    ready: Callable[[str], None] | None = None,
    tell: Callable[[str], None] | None = None,
    patience: float = 5.0,
    after_latch: float = 1.0,
) -> tuple[Path, ...]:
    """Serve a plant until asked to stop; SIGINT, SIGTERM and SIGHUP end it with the record saved.

    Args:
        plant: any that does not own its clock.
        address: `udp://host:port`, where port 0 takes a free one; `serial:pty`, a pseudo terminal; or a serial port.
        clock: "real" ticks at the rate that the controller asks for; "lockstep" waits for each command.
        record: folder in which each session is saved as a recording of its own, `session-1` and so on: the first number
            that is free. Columns: t (s) and tick of the plant's clock, wall (s since the first sample), late (s), fresh
            (1 where a command answered in time), latched, `sensor.<name>`, `input.<name>` (in force from this sample to
            the next) and `plant.<name>` (the plant's telemetry at the end of that time).
        stop_after: number of sessions.
        stop: looked at each tick.
        ready: called with the address once it can be reached.
        tell: called with what an operator should know; by default it goes to standard error.
        patience: seconds to wait for a command in lockstep.
        after_latch: seconds that are still recorded after the watchdog stopped a session.

    Returns:
        folders of the recordings.

    Raises:
        PlantMismatchError: the plant owns its clock, or the address is wrong or taken.
    """
    if plant.owns_clock:
        raise PlantMismatchError("this plant owns its clock; serve one that does not, or run it directly")
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(contextlib.closing(adapters.listen(address)))
        asked = stack.enter_context(asked_to_stop())
        stack.callback(plant.deactivate)
        server = _Server(
            plant,
            line,
            clock,
            stop=lambda: asked() or (stop is not None and stop()),
            tell=tell or _to_stderr,
            patience=patience,
            after_latch=after_latch,
        )
        if ready is not None:
            ready(line.address)
        return server.run(Path(record) if record is not None else None, stop_after)


@final
class _Session:
    """What is known of one controller: who it is, its last command, and how it went."""

    def __init__(self, number: int, address: Peer, settings: Settings, plant: Plant) -> None:
        self.number, self.address, self.settings = number, address, settings
        self.command: Array = np.zeros(len(plant.actuators))
        self.answered = -1  # index of the newest sample that a command answered
        self.fresh = False  # a command arrived since the last tick
        self.silent = 0  # ticks since a command arrived
        self.patience = max(1, math.ceil(settings.watchdog * settings.rate - 1e-9))  # of the watchdog, ticks
        self.latch: dict[str, Any] | None = None
        self.end = ""
        self.counters: Counter[str] = Counter()
        self.rows = _Rows(plant)

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
        self.counters[cause] += 1

    def watch(self, tick: int) -> None:
        """Count the ticks without a command; latch the outputs at zero when they are too many."""
        self.silent = 0 if self.fresh else self.silent + 1
        if self.latch is not None:
            return
        if self.answered >= 0 and self.silent >= self.patience:
            self.trip(tick, f"no valid command for {self.settings.watchdog * 1e3:g} ms")
        elif self.answered < 0 and self.silent >= SILENT_START * self.settings.rate:
            self.trip(tick, f"no command for {SILENT_START:g} s after the start")

    def trip(self, tick: int, cause: str) -> None:
        """Set the outputs to zero for the rest of the session."""
        self.command[:] = 0.0
        self.latch = {"cause": cause, "tick": tick}


@final
class _Server:
    """One plant at the end of its lines."""

    def __init__(
        self,
        plant: Plant,
        line: Hub,
        clock: Clock,
        *,
        stop: Stop,
        tell: Callable[[str], None],
        patience: float,
        after_latch: float,
    ) -> None:
        self.plant, self.line, self.clock, self.stop, self.tell = plant, line, clock, stop, tell
        self.patience, self.after_latch = patience, after_latch
        self.pending: tuple[Frame, Peer] | None = None  # a hello that ended a latched session
        self.reported: set[str] = set()

    def run(self, record: Path | None, stop_after: int | None) -> tuple[Path, ...]:
        """Hold one session after another; return the folders that they were saved in."""
        folders: list[Path] = []
        held = 0
        while held != stop_after and (session := self.next_session()) is not None:
            held += 1
            real = self.clock == "real"
            try:
                with undisturbed(priority=real) as note:
                    self.tell_once(note)
                    self.hold(session)
            except Exception as error:  # whatever a plant raises ends its session, not the server
                session.end = f"the plant failed: {type(error).__name__}: {error}"
            self.reply(session, Kind.STOP, session.end)
            session.rows.close(session, self.plant)
            if record is not None and session.rows.count:
                try:
                    folders.append(session.rows.recording(session, self.clock).save(_free_folder(record)))
                except RecordError as error:
                    self.tell(f"the record of this session is lost: {error}")
            if session.end != "bye":
                self.tell(f"session ended: {session.end}")
        return tuple(folders)

    def next_session(self) -> _Session | None:
        """Wait until a controller opens a session and starts it; None where the server is stopped first."""
        session, until = None, math.inf
        while not self.stop():
            if time.monotonic() > until:
                session, until = None, math.inf
                self.plant.deactivate()
            for frame, address in self.arrived(POLL):
                if frame.kind is Kind.HELLO:
                    opened = self.open(frame, address, session)
                    if opened is not session:
                        session, until = opened, time.monotonic() + RESERVED
                elif session is not None and (frame.session, address) == (session.number, session.address):
                    if frame.kind is Kind.START:
                        return session
                    if frame.kind is Kind.BYE:
                        session, until = None, math.inf
                        self.plant.deactivate()
                elif frame.kind is Kind.COMMAND:
                    self.send(frame.session, address, Kind.STOP, text="this session is over; open a new one")
        return None

    def open(self, frame: Frame, address: Peer, session: _Session | None) -> _Session | None:
        """Answer a hello; return the session that then holds the plant."""
        if session is None:
            try:
                settings = wire.read_settings(frame.text)
                if settings.lockstep != (self.clock == "lockstep"):
                    wanted = "lockstep" if settings.lockstep else "real"
                    mend = "start both in lockstep, or both without"
                    message = f"its clock is '{self.clock}', the controller wants '{wanted}'; {mend}"
                    raise PlantMismatchError(message)
                self.plant.configure(settings)
                session = _Session(frame.session, address, settings, self.plant)
            except Exception as error:  # whatever a plant raises refuses this controller; the server waits for another
                self.plant.deactivate()
                text = str(error) if isinstance(error, MaskingError) else f"{type(error).__name__}: {error}"
                self.send(frame.session, address, Kind.REFUSE, text=text)
                return None
        if (frame.session, address) == (session.number, session.address):
            self.reply(session, Kind.ACCEPT, wire.channels_text(self.plant.sensors, self.plant.actuators))
        else:
            holder = ":".join(map(str, session.address))
            text = f"a controller at {holder} has this plant; stop that one first"
            self.send(frame.session, address, Kind.REFUSE, text=text)
            session.counters["refused controllers"] += 1
        return session

    def hold(self, session: _Session) -> None:
        """Run a session from its first sample to its end."""
        rate = session.settings.rate
        try:
            self.plant.activate()
            self.advance(session, rate)
        finally:
            self.plant.deactivate()

    def advance(self, session: _Session, rate: float) -> None:
        """Advance an active plant from its first sample to the end of the session."""
        sample = self.plant.read()
        deadlines, began, late = Deadlines(rate), time.monotonic(), 0.0
        over = math.inf  # the tick at which a latched session ends
        while True:
            session.rows.begin(sample, rate, time.monotonic() - began, late)
            if session.latch is None:
                self.send(session.number, session.address, Kind.SENSORS, sample.index, values=sample.values)
            else:
                self.reply(session, Kind.STOP, session.latch["cause"])
            session.fresh = False
            if self.clock == "real":
                late = deadlines.wait(self.stop)
                self.listen(session, sample.index, 0.0)
                session.watch(sample.index)
            else:
                self.await_answer(session, sample.index)
            session.counters["overruns"] = deadlines.missed
            if session.latch is not None:
                over = min(over, sample.index + self.after_latch * rate if self.clock == "real" else sample.index)
                if sample.index >= over and not session.end:
                    session.end = session.latch["cause"]
            if self.stop():
                session.end = session.end or "the server was stopped"
            if session.end:
                return
            self.plant.write(sample.index, session.command)
            advanced = self.plant.read()
            session.rows.finish(session, self.plant)
            sample = advanced

    def await_answer(self, session: _Session, tick: int) -> None:
        """Wait for the command that answers a sample; latch where none comes."""
        until = time.monotonic() + self.patience
        while not (session.fresh or session.end or self.stop()):
            if time.monotonic() > until:
                session.trip(tick, f"no command for {self.patience:g} s in lockstep")
                return
            self.listen(session, tick, POLL)

    def listen(self, session: _Session, tick: int, wait: float) -> None:
        """Take in what has arrived by a tick, or else arrives within a number of seconds."""
        for frame, address in self.arrived(wait, session.counters):
            if frame.kind is Kind.HELLO:
                if session.latch is not None and frame.session != session.number:
                    self.pending = (frame, address)
                    session.end = session.latch["cause"]
                    return
                self.open(frame, address, session)
            elif (frame.session, address) != (session.number, session.address):
                session.counters["other session"] += 1
            elif frame.kind is Kind.COMMAND:
                session.take(frame, tick)
                if session.fresh and self.clock == "lockstep":
                    return  # what follows belongs to the next sample
            elif frame.kind in (Kind.BYE, Kind.STOP):
                session.end = "bye" if frame.kind is Kind.BYE else f"stopped: {frame.text}"
                return  # what follows belongs to the next session
            elif frame.kind is not Kind.START:  # which was sent twice
                session.counters["unexpected"] += 1

    def arrived(self, wait: float, counters: Counter[str] | None = None) -> Iterator[tuple[Frame, Peer]]:
        """Give every sound frame that waits to be read; wait at most a number of seconds for the first."""
        if self.pending is not None:
            hello, self.pending = self.pending, None
            yield hello
        for _ in range(MOST):
            try:
                if not self.line.waits(wait):
                    return
                wait = 0.0
                received, address = self.line.receive()
                yield wire.decode(received), address
            except WireError as error:
                if counters is not None:
                    counters[error.cause] += 1
            except OSError:  # an earlier answer could not be delivered
                wait = 0.0

    def reply(self, session: _Session, kind: Kind, text: str) -> None:
        """Send a text to the session's controller."""
        self.send(session.number, session.address, kind, text=text)

    def send(
        self,
        number: int,
        address: Peer,
        kind: Kind,
        index: int = 0,
        *,
        values: Array = wire.NO_VALUES,
        text: str = "",
    ) -> None:
        """Send a frame; one that cannot go out is dropped, as the net might."""
        frame = wire.encode(kind, number, index, values=values, text=text)
        with contextlib.suppress(OSError):
            self.line.send(frame, address)

    def tell_once(self, note: str) -> None:
        """Report what was not reported before."""
        if note and note not in self.reported:
            self.reported.add(note)
            self.tell(note)


@final
class _Rows:
    """What happened in a session, a row for each sample, in chunks made ahead so that no tick waits for memory."""

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

    def finish(self, session: _Session, plant: Plant) -> None:
        """Complete the row with the command that held after the sample, and with what the plant reports of it."""
        row = self.row
        row[4:6] = session.fresh, session.latch is not None
        row[self.inputs] = session.command
        if isinstance(plant, Telling):
            values = plant.telemetry()
            row[self.inputs.stop :] = [values[name] for name in self.telemetry]
        self.is_open = False

    def close(self, session: _Session, plant: Plant) -> None:
        """Complete the last row: the outputs are zero after it."""
        session.command[:], session.fresh = 0.0, False
        if self.is_open:
            with contextlib.suppress(Exception):  # what a plant that failed cannot tell stays unknown
                self.finish(session, plant)

    def recording(self, session: _Session, clock: Clock) -> Recording:
        """Return the rows and what the session was; what is not finite is 0 there, and 1 in `nonfinite.<column>`."""
        table = np.concatenate(self.chunks)[: self.count]
        columns = dict(zip(self.names, table.T, strict=True))
        for name, column in list(columns.items()):
            finite = np.isfinite(column)
            if not finite.all():
                columns[name] = np.where(finite, column, 0.0)
                columns[f"nonfinite.{name}"] = np.where(finite, 0.0, 1.0)
        settings = session.settings
        manifest = {
            "name": "a plant's own record",
            "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "clock": clock,
            "rate": settings.rate,
            "watchdog": settings.watchdog,
            "end": session.end,
            "latch": session.latch,
            "counters": dict(session.counters),
        }
        return Recording(columns, manifest)


def _free_folder(record: Path) -> Path:
    """Return the first folder `session-1` and so on that is not there yet."""
    number = 1
    while (folder := record / f"session-{number}").exists():
        number += 1
    return folder


def _to_stderr(text: str) -> None:
    print(f"masking: {text}", file=sys.stderr, flush=True)
