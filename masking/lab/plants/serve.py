"""Serve a plant to a controller in another process: its clock, its watchdog, and its own record of what happened.

Any plant that does not own its clock can be served. Between sessions it is unconfigured and its outputs are zero; each
session begins from its configured start. At tick k the newest valid command that has arrived answers sample k - 1, or
else the last one holds; what the guard makes of it is written, the plant advances under it, and sample k goes out. The
outputs go to zero and stay there until a controller opens a new session when the controller says so, when the server is
stopped, and when the plant trips:

* the controller says that its own safety chain tripped;
* from the first command on, no sample was answered for the time of the watchdog, on the wall's clock, also within a
  tick; in lockstep, no command came for `patience` seconds;
* the server itself was held up for that time, so that nobody watched what the outputs held;
* the guard says so, or the plant fails.

In the second and third case, the guard may have other values than zero, which hold until the session ends.

After a trip the next controller is refused until it acknowledges the cause (`Settings.acknowledge`).

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
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, final

from masking.compile.numerics.arrays import Array
from masking.errors import EmergencyStopError, MaskingError, PlantMismatchError, PlantRefusedError, WireError
from masking.lab.plants import adapters, wire
from masking.lab.plants.arming import HOW, Arming
from masking.lab.plants.authentication import AuthenticatedHub, Key
from masking.lab.plants.controller_session import Allowed, Session, SessionRows, claimed
from masking.lab.plants.interface import Plant, Sample, Settings, check_index
from masking.lab.plants.operating_system import POLL, Deadlines, Stop, asked_to_stop, undisturbed
from masking.lab.plants.served_plant_guard import PlantLimits
from masking.lab.plants.transport import Hub, Peer
from masking.lab.plants.trip_memory import TripMemory
from masking.lab.plants.wire import Frame, Kind
from masking.lab.plants.zero_after_kill import LastWord

Clock = Literal["real", "lockstep"]

RESERVED: Final = 10.0  # seconds that a controller may take from configure to activate
MOST: Final = 1000  # frames that are looked at in one tick
LOOK: Final = 0.005  # seconds between looks at the line and the watchdog in a tick that is longer
UNENDED: Final = "its server was killed while a controller drove it"
OVER: Final = "this session is over; open a new one"
REMEMBERED: Final = 100_000  # sessions whose numbers are not taken again


@dataclass(frozen=True, eq=False)
class Serving:
    """How a plant is served.

    A record has the columns t (s) and tick of the plant's clock, wall (s since the first sample), late (s), fresh (1
    where a command answered in time), latched, `sensor.<name>`, `input.<name>` (in force from this sample to the next)
    and `plant.<name>` (the plant's telemetry at the end of that time).
    """

    clock: Clock = "real"  # ticks at the rate that the controller asks for; "lockstep" waits for each command
    # folder in which each session is saved as a recording, `session-1` and so on: the first number that is free
    record: str | Path | None = None
    sessions: int | None = None  # number of them; None for any
    patience: float = 5.0  # seconds to wait for a command in lockstep
    after_latch: float = 1.0  # seconds that are still recorded after a trip
    allowed: Allowed = field(default_factory=Allowed)  # watchdogs and rates that controllers may ask for
    guard: PlantLimits | None = None  # what every command passes before it is written
    arming: Arming | None = None  # of a plant that its operator arms; None where it is armed at once
    trips: TripMemory = field(default_factory=TripMemory)
    key: Key | None = None  # that controllers must have; needed where other machines reach the address


def serve(
    plant: Plant,
    address: str,
    serving: Serving,
    *,
    stop: Stop | None = None,
    ready: Callable[[str], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Serve a plant until asked to stop; SIGINT, SIGTERM and SIGHUP end it with the record saved.

    Args:
        plant: any that does not own its clock.
        address: `udp://host:port`, where port 0 takes a free one; `serial:pty`, a pseudo terminal; or a serial port.
        serving: how.
        stop: looked at each tick.
        ready: called with the address once it can be reached.
        tell: called with what an operator should know; by default it goes to standard error.

    Returns:
        folders of the recordings.

    Raises:
        PlantMismatchError: the plant owns its clock, the address is wrong or taken, or other machines reach it and no
            key is given.
    """
    if plant.owns_clock:
        raise PlantMismatchError("this plant owns its clock; serve one that does not, or run it directly")
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(contextlib.closing(adapters.listen(address)))
        if serving.key is not None:
            line = AuthenticatedHub(line, serving.key)
        elif not line.is_local:
            raise PlantMismatchError(
                f"{address} is reached from other machines, which may drive the plant: give --key FILE, and the same "
                "to 'masking rig run'; or serve at udp://127.0.0.1:5005, which only this machine reaches"
            )
        word = stack.enter_context(LastWord(plant))
        asked = stack.enter_context(asked_to_stop())
        stack.callback(plant.deactivate)
        server = _Server(
            plant, word, line, serving, stop=lambda: asked() or (stop is not None and stop()), tell=tell or _to_stderr
        )
        if ready is not None:
            ready(line.address)
        return server.run()


@final
class _Server:
    """One plant at the end of its lines."""

    def __init__(
        self, plant: Plant, word: LastWord, line: Hub, serving: Serving, *, stop: Stop, tell: Callable[[str], None]
    ) -> None:
        self.word = word
        self.plant, self.line, self.serving, self.stop, self.tell = plant, line, serving, stop, tell
        self.guard = serving.guard
        self.is_real = serving.clock == "real"
        self.pending: tuple[Frame, Peer] | None = None  # a hello that ended a latched session
        self.over: dict[int, str] = {}  # what a hello is told whose number was taken before
        self.looked = 0.0  # instant of the last look at the line within a tick
        self.reported: set[str] = set()

    def run(self) -> tuple[Path, ...]:
        """Hold one session after another; return the folders that they were saved in."""
        folders, held = list[Path](), 0
        while held != self.serving.sessions and (session := self.next_session()) is not None:
            held += 1
            session.acknowledged, tripped = self.serving.trips.cause, ""
            self.keep(UNENDED)
            try:
                with undisturbed(priority=self.is_real) as note:
                    self.tell_once(note)
                    self.hold(session)
            except Exception as error:  # whatever a plant raises ends its session, not the server
                is_pressed = isinstance(error, EmergencyStopError)
                what = wire.EMERGENCY if is_pressed else f"the plant failed: {type(error).__name__}"
                session.end = tripped = f"{what}: {error}"
            tripped = tripped if session.latch is None else session.latch["cause"]
            self.keep(tripped)
            if tripped and self.serving.arming is not None:
                self.serving.arming.disarm()
            self.remember(session.number, OVER)
            self.reply(session, Kind.STOP, session.end)
            session.close(self.plant)
            if self.guard is not None:
                session.counters.update(self.guard.counters)
            if session.rows is not None:
                try:
                    if session.rows.save(session.outcome, has_clock=self.is_real):
                        folders.append(session.rows.folder)
                except MaskingError as error:
                    self.tell(f"the recording of this session is not made: {error}")
            if session.end != "bye":
                self.tell(f"session ended: {session.end}")
        return tuple(folders)

    def next_session(self) -> Session | None:
        """Wait until a controller opens a session and starts it; None where the server is stopped first."""
        session, until = None, math.inf
        while not self.stop():
            if time.monotonic() > until:
                self.release(session)
                session, until = None, math.inf
            for frame, address in self.arrived(POLL):
                if frame.kind is Kind.HELLO:
                    opened = self.open(frame, address, session)
                    if opened is not session:
                        session, until = opened, time.monotonic() + RESERVED
                elif session is not None and (frame.session, address) == (session.number, session.address):
                    if frame.kind is Kind.START:
                        return session
                    if frame.kind is Kind.BYE:
                        self.release(session)
                        session, until = None, math.inf
                elif frame.kind is Kind.COMMAND:
                    self.send(frame.session, address, Kind.STOP, text=OVER)
        self.release(session)
        return None

    def release(self, session: Session | None) -> None:
        """Give up a session that was opened and never started."""
        self.plant.deactivate()
        if session is not None:
            self.remember(session.number, OVER)
            if session.rows is not None:
                session.rows.discard()

    def open(self, frame: Frame, address: Peer, session: Session | None) -> Session | None:
        """Answer a hello; return the session that then holds the plant."""
        held = session is not None and frame.session == session.number
        refusal = "" if held else self.over.get(frame.session, "")
        if session is None and not refusal:
            try:
                session = self.opened(frame, address)
            except Exception as error:  # whatever a plant raises refuses this controller; the server waits for another
                self.plant.deactivate()
                refusal = str(error) if isinstance(error, MaskingError) else f"{type(error).__name__}: {error}"
        elif session is not None and (frame.session, address) != (session.number, session.address):
            refusal = f"a controller at {':'.join(map(str, session.address))} has this plant; stop that one first"
            session.counters["refused controllers"] += 1
        if session is not None and not refusal:
            self.reply(session, Kind.ACCEPT, wire.channels_text(self.plant.sensors, self.plant.actuators))
        else:
            self.send(frame.session, address, Kind.REFUSE, text=refusal)
            if not held:
                self.remember(frame.session, refusal)
        return session

    def opened(self, frame: Frame, address: Peer) -> Session:
        """Configure the plant as a hello asks, and return the session; a `MaskingError` where it may not have it."""
        settings = wire.read_settings(frame.text)
        if settings.lockstep == self.is_real:
            wanted = "lockstep" if settings.lockstep else "real"
            remedy = "start both in lockstep, or both without"
            raise PlantMismatchError(f"its clock is '{self.serving.clock}', the controller wants '{wanted}'; {remedy}")
        self.serving.allowed.check(settings)
        if self.serving.arming is not None and not self.serving.arming.is_armed:
            raise PlantRefusedError(f"it is not armed: {HOW}")
        tripped = self.serving.trips.cause
        if tripped and not settings.acknowledge:
            remedy = "look at the rig, then start once with --acknowledge"
            raise PlantRefusedError(f"it has tripped: {tripped}; {remedy}")
        self.plant.configure(settings)
        if self.guard is not None:
            self.guard.begin(self.plant, settings)
        rows = None
        if self.serving.record is not None:
            folder = claimed(Path(self.serving.record))
            rows = SessionRows(self.plant, folder, settings.rate, **_facts(settings, self.serving.clock))
        session = Session(frame.session, address, settings, len(self.plant.actuators), rows)
        if self.guard is not None:
            self.guard.expire(session.expiry)
        return session

    def keep(self, cause: str) -> None:
        """Keep why the plant was stopped, for the next server, too."""
        try:
            self.serving.trips.keep(cause)
        except MaskingError as error:
            self.tell(str(error))

    def remember(self, number: int, text: str) -> None:
        """Take no session of this number again, so that no hello counts twice; tell it why."""
        self.over[number] = text
        if len(self.over) > REMEMBERED:
            del self.over[next(iter(self.over))]

    def hold(self, session: Session) -> None:
        with self.word.driving():
            try:
                self.plant.activate()
                self.advance(session, session.settings.rate)
            finally:
                self.plant.deactivate()

    def advance(self, session: Session, rate: float) -> None:
        """Advance an active plant from its first sample to the end of the session."""
        sample = self.plant.read()
        deadlines, began, late = Deadlines(rate), time.monotonic(), 0.0
        instant, over = began, math.inf  # that of the sample, s; the tick at which a latched session ends
        while True:
            if session.rows is not None:
                session.rows.begin(sample, time.monotonic() - began, late)
            if session.latch is None:
                self.send(session.number, session.address, Kind.SENSORS, sample.index, values=sample.values)
            else:
                self.reply(session, Kind.STOP, session.latch["cause"])
            session.show(instant)
            if self.is_real:
                self.looked = time.monotonic()
                late = deadlines.wait(partial(self.look, session, sample), LOOK)
                instant = self.answers(session, sample, late)
            else:
                self.await_answer(session, sample.index)
            session.counters["overruns"] = deadlines.missed
            if session.latch is not None:
                over = min(over, sample.index + self.serving.after_latch * rate if self.is_real else sample.index)
                if sample.index >= over and not session.end:
                    session.end = session.latch["cause"]
            if self.stop():
                session.end = session.end or "the server was stopped"
            if session.end:
                return
            if not session.is_written:
                self.write(session, sample)
            advanced = self.plant.read()
            check_index(advanced.index, sample.index)
            session.finish(self.plant)
            sample = advanced

    def answers(self, session: Session, sample: Sample, late: float) -> float:
        """Take in the answers to a sample at the end of its tick, if they came in time.

        The end was missed or met `late` seconds late. Returns the instant at which the next sample is due, s of the
        monotonic clock.
        """
        now = time.monotonic()
        instant = now - late if late * session.settings.rate <= 1.0 else now
        session.watch_clock(sample.index, late)  # first: what waits to be read is as old
        self.listen(session, sample.index, 0.0)
        session.watch_clock(sample.index, time.monotonic() - instant)
        session.watch(sample.index, instant)
        return instant

    def look(self, session: Session, sample: Sample) -> bool:
        """Look within a tick at the line and the watchdog if it is time; tell whether the tick is cut short."""
        now = time.monotonic()
        if now - self.looked >= LOOK:
            session.watch_clock(sample.index, now - self.looked - LOOK)
            self.listen(session, sample.index, 0.0)
            session.watch(sample.index, now)
            self.looked = now
            if session.latch is not None and not session.is_written and not session.end:
                self.write(session, sample)
        return bool(session.end) or self.stop()

    def write(self, session: Session, sample: Sample) -> None:
        """Write the command that answers a sample, as the guard leaves it."""
        if self.guard is not None and session.latch is None:
            cause = self.guard.check(sample, session.command)
            if cause:
                session.trip(sample.index, cause)
        self.plant.write(sample.index, session.command)
        session.is_written = True

    def await_answer(self, session: Session, tick: int) -> None:
        """Wait for the command that answers a sample; latch where none comes."""
        until = time.monotonic() + self.serving.patience
        while not (session.fresh or session.end or self.stop()):
            if time.monotonic() > until:
                session.trip(tick, f"no command for {self.serving.patience:g} s in lockstep", is_silent=True)
                return
            self.listen(session, tick, POLL)

    def listen(self, session: Session, tick: int, wait: float) -> None:
        """Take in what has arrived by a tick, or else arrives within a number of seconds."""
        for frame, address in self.arrived(wait, session.counters):
            if frame.kind is Kind.HELLO:
                is_new = frame.session != session.number and frame.session not in self.over
                if session.latch is not None and is_new:
                    self.pending = (frame, address)
                    session.end = session.latch["cause"]
                    return
                self.open(frame, address, session)
            elif (frame.session, address) != (session.number, session.address):
                session.counters["other session"] += 1
            elif frame.kind is Kind.COMMAND:
                session.take(frame, tick)
                if session.fresh and not self.is_real:
                    return  # what follows belongs to the next sample
            elif frame.kind in (Kind.BYE, Kind.STOP):
                if frame.kind is Kind.STOP:
                    session.trip(tick, f"the controller stopped: {frame.said}")
                session.end = "bye" if session.latch is None else session.latch["cause"]
                return  # what follows belongs to the next session
            elif frame.kind is not Kind.START:  # which was sent twice
                session.counters["unexpected"] += 1

    def arrived(self, wait: float, counters: Counter[str] | None = None) -> Iterator[tuple[Frame, Peer]]:
        """Sound frames that wait to be read; the first may take a number of seconds to come."""
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

    def reply(self, session: Session, kind: Kind, text: str) -> None:
        self.send(session.number, session.address, kind, text=text)

    def send(
        self, number: int, address: Peer, kind: Kind, index: int = 0, *, values: Array = wire.NO_VALUES, text: str = ""
    ) -> None:
        """Send a frame; one that cannot go out is dropped, as the net might, and a text that quotes too much is cut."""
        frame = wire.encode(kind, number, index, values=values, text=text[: wire.LONGEST_TEXT])
        with contextlib.suppress(OSError):
            self.line.send(frame, address)

    def tell_once(self, note: str) -> None:
        if note and note not in self.reported:
            self.reported.add(note)
            self.tell(note)


def _facts(settings: Settings, clock: Clock) -> dict[str, Any]:
    """Facts of a session that are known when it begins, for the manifest of its stream."""
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"name": "a plant's own record", "created": created, "clock": clock, "watchdog": settings.watchdog}


def _to_stderr(text: str) -> None:
    print(f"masking: {text}", file=sys.stderr, flush=True)
