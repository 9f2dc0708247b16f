"""RemotePlant: a plant in another process or on another machine, at the end of a line; it owns the clock."""

from __future__ import annotations

import secrets
import time
from abc import ABC, abstractmethod
from collections import Counter
from typing import NoReturn

from masking.compile.numerics.arrays import Array
from masking.errors import EmergencyStopError, PlantLostError, PlantRefusedError, SamplesLostError, WireError
from masking.lab.plants import wire
from masking.lab.plants.authentication import AuthenticatedLine, Key
from masking.lab.plants.interface import LifeCycle, Sample, Settings, check_command
from masking.lab.plants.transport import Line
from masking.lab.plants.wire import Frame, Kind

TRY = 0.25  # seconds before a request is sent again
LOCKSTEP_TIMEOUT = 5.0  # seconds; a plant in lockstep answers when it is ready
WATCHDOGS, PERIODS = 1.5, 3.0  # times of the watchdog, and at least samples, of silence after which a plant is lost
HELD = 4  # samples in a row that may be missing
_LARGEST = 2**62  # indices, which are int64 in a run


class RemotePlant(ABC):
    """The plant that `masking.lab.plants.serve` serves, or that a program of another make serves in the same frames.

    The controller gets the newest sample: where several wait, because it was held up, all but the last are skipped.
    The plant checks, on its own clock, the age of the sample that a command answers. `counters` counts the frames
    that were refused, by cause, those `skipped`, and those that never came, `lost`, from one configuration to the next.
    Where more than 4 in a row did not come, or the index jumps by that, the plant is lost.

    Args:
        address: of the plant.
        timeout: seconds of silence after which a running plant is lost; by default 1.5 times that of the watchdog, and
            at least 3 samples.
        patience: seconds to wait for a plant that is still starting or saving its last record.
        key: that the plant has, too, where its server asks for one.
    """

    def __init__(
        self, address: str, *, timeout: float | None = None, patience: float = 3.0, key: Key | None = None
    ) -> None:
        self.sensors: tuple[str, ...] = ()
        self.actuators: tuple[str, ...] = ()
        self.owns_clock = True
        self.counters: Counter[str] = Counter()
        self._address = address
        self._timeout, self._patience, self._key = timeout, patience, key
        self._silence = 0.0
        self._life = LifeCycle()
        self._line: Line | None = None
        self._session = 0
        self._last = -1
        self._lockstep = False
        self._first: Frame | None = None  # came in answer to the start

    @abstractmethod
    def open_line(self) -> Line:
        """Line to the plant; OSError where it cannot be reached."""

    def remedy(self) -> str:
        """Remedy where no plant answers."""
        key = " --key FILE" if self._key is not None else ""
        return f"start it with 'masking rig serve PLANT --address {self._address}{key}', or correct the address"

    def configure(self, settings: Settings) -> None:
        """Open a session and learn the names of the channels.

        A PlantLostError where nobody answers; a PlantRefusedError where the plant is taken, does not accept these
        settings, or has another key; a PlantMismatchError where what answers does not name its channels.
        """
        self._life.configure()
        self.deactivate()
        self._session, self._last, self._lockstep = secrets.randbits(64), -1, settings.lockstep
        self._first, self._period = None, 1.0 / settings.rate
        silence = WATCHDOGS * settings.watchdog if self._timeout is None else self._timeout
        self._silence = LOCKSTEP_TIMEOUT if settings.lockstep else max(silence, PERIODS / settings.rate)
        self.counters.clear()
        try:
            line = self.open_line()
            self._line = line if self._key is None else AuthenticatedLine(line, self._key)
            answer = self._ask(wire.settings_text(settings))
            if answer.kind is Kind.REFUSE:
                raise PlantRefusedError(f"{self._address} refuses: {answer.said}")
            self.sensors, self.actuators = wire.read_channels(answer.text)
        except OSError as error:
            self._close()
            message = f"{self._address} cannot be reached ({error}); look at its name and what leads there"
            raise PlantLostError(message) from error
        except Exception:
            self._close()
            raise
        self._life.configure()

    def activate(self) -> None:
        """Start the plant's clock; its first sample waits to be read."""
        self._life.activate()
        give_up = time.monotonic() + max(self._silence, self._patience)
        while time.monotonic() < give_up:
            self._send(Kind.START)
            again = time.monotonic() + TRY
            while (frame := self._receive(again - time.monotonic())) is not None:
                if frame.kind in (Kind.SENSORS, Kind.STOP):
                    self._first = frame
                    return
                if frame.kind is not Kind.ACCEPT:  # to a hello that was sent twice
                    self.counters["unexpected"] += 1
        self._lost(f"did not start within {max(self._silence, self._patience):g} s")

    def read(self) -> Sample:
        """Wait for the next sample and return the newest; in lockstep the one that follows the last command.

        A PlantLostError where none came in time, too many are missing, or the plant ended the session, and says why; an
        EmergencyStopError where that of the plant is pressed.
        """
        self._life.need_active("read")
        newest, began = None, time.monotonic()
        deadline = began + self._silence
        while (frame := self._following(0.0 if newest else deadline - time.monotonic())) is not None:
            if frame.kind is Kind.STOP:
                silent = 0 if newest or self._lockstep else int((time.monotonic() - began) / self._period)
                if silent > HELD + 1:  # of the samples before that, none arrived
                    self.counters["lost"] += silent - 1
                    said = f"sent no sample for {silent} periods, more than {HELD}, and ended the session: {frame.said}"
                    self._lost(said, kind=SamplesLostError)
                kind = EmergencyStopError if frame.text.startswith(wire.EMERGENCY) else PlantLostError
                raise kind(f"the plant at {self._address} ended the session: {frame.said}")
            if not self._is_next(frame):
                continue
            self._need_successor(frame.index)
            self.counters["skipped"] += newest is not None
            newest, self._last = frame, frame.index
            if self._lockstep:
                break
        if newest is None:
            self._lost(f"sent no sample for {self._silence:g} s")
        return Sample(newest.index, newest.values)

    def write(self, index: int, command: Array) -> None:
        """Send the command (actuators,) that answers the sample `index`."""
        self._life.need_active("write")
        check_command(command, self.actuators)
        self._send(Kind.COMMAND, index, command)

    def trip(self, cause: str) -> None:
        """Let the plant know that the run tripped, upon which its outputs go to zero until that is acknowledged."""
        self._part(Kind.STOP, cause)

    def deactivate(self) -> None:
        """Say good-bye, upon which the plant's outputs go to zero."""
        self._part(Kind.BYE)
        self._close()
        self._life.deactivate()

    def _ask(self, text: str) -> Frame:
        """Send a hello until it is answered."""
        give_up = time.monotonic() + self._patience
        while time.monotonic() < give_up:
            again = time.monotonic() + TRY
            try:
                self._send(Kind.HELLO, text=text)
                while (frame := self._receive(again - time.monotonic())) is not None:
                    if frame.kind in (Kind.ACCEPT, Kind.REFUSE):
                        return frame
                    self.counters["unexpected"] += 1
            except PlantLostError:  # nobody listens there yet
                time.sleep(max(0.0, min(again, give_up) - time.monotonic()))
        if self.counters["unauthenticated"]:
            remedy = "give both sides the same --key FILE"
            raise PlantRefusedError(f"{self._address} answers, but not with this key; {remedy}")
        raise PlantLostError(f"no plant answers at {self._address}; {self.remedy()}")

    def _following(self, wait: float) -> Frame | None:
        """Answer to the start, else the next frame within a number of seconds."""
        first, self._first = self._first, None
        return first or self._receive(wait)

    def _is_next(self, frame: Frame) -> bool:
        """Whether a frame is a sample newer than the last, else count why not."""
        if frame.kind is not Kind.SENSORS:
            cause = "unexpected"
        elif len(frame.values) != len(self.sensors):
            cause = "wrong size"
        elif frame.index <= self._last:
            cause = "duplicate" if frame.index == self._last else "reordered"
        else:
            return True
        self.counters[cause] += 1
        return False

    def _need_successor(self, index: int) -> None:
        """Count the samples that are missing before an index; too many are a `PlantLostError`."""
        missing = index - self._last - 1 if self._last >= 0 else 0
        if index >= _LARGEST:
            self._lost(f"has sample {index}, which is no number of a sample")
        if missing:
            self.counters["lost"] += missing
        if missing > HELD:
            said = f"went from sample {self._last} to {index}: {missing} in a row are lost, more than {HELD}"
            self._lost(said, kind=SamplesLostError)

    def _receive(self, wait: float) -> Frame | None:
        """Next sound frame of this session, or None if none comes within a number of seconds."""
        until = time.monotonic() + wait
        gone: ConnectionError | None = None  # the socket reports it before the plant's last words
        while self._open.waits(0.0 if gone else max(0.0, until - time.monotonic())):
            try:
                frame = wire.decode(self._open.receive())
            except WireError as error:
                self.counters[error.cause] += 1
            except BlockingIOError:  # what waited was no frame
                continue
            except ConnectionError as error:
                if gone is not None:  # nothing was behind the first
                    break
                gone = error
            else:
                if frame.session == self._session:
                    return frame
                self.counters["other session"] += 1
        if gone is not None:
            self._lost("is gone", gone)
        return None

    def _send(self, kind: Kind, index: int = 0, values: Array = wire.NO_VALUES, *, text: str = "") -> None:
        frame = wire.encode(kind, self._session, index, values=values, text=text)
        try:
            self._open.send(frame)
        except ConnectionError as error:
            if not self._open.waits(0.0):  # else what the plant said last is still to be read
                self._lost("is gone", error)
            self.counters["unsent"] += 1
        except BlockingIOError:  # the line is full; the next command is fresher
            self.counters["unsent"] += 1

    def _part(self, kind: Kind, text: str = "") -> None:
        if self._line is not None:
            try:
                self._line.send(wire.encode(kind, self._session, text=text[: wire.LONGEST_TEXT]))
            except OSError:
                self.counters["unsent"] += 1  # the plant's own watchdog does it

    @property
    def _open(self) -> Line:
        assert self._line is not None  # noqa: S101  # the life cycle sees to it
        return self._line

    def _lost(self, what: str, error: Exception | None = None, kind: type[PlantLostError] = PlantLostError) -> NoReturn:
        remedy = "look at its own output and record, then start it again with 'masking rig serve PLANT'"
        raise kind(f"the plant at {self._address} {what}; {remedy}") from error

    def _close(self) -> None:
        if self._line is not None:
            self._line.close()
        self._line = None
