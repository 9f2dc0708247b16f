"""Serial: a plant behind a serial port or a USB cable, such as a microcontroller, frame after frame in a stream."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from collections import deque
from typing import Any, Final, TypeAlias, final

import serial

from masking.errors import PlantMismatchError
from masking.lab.plants import address as addresses
from masking.lab.plants.authentication import Key
from masking.lab.plants.remote import RemotePlant
from masking.lab.plants.transport import Peer
from masking.lab.plants.wire import Splitter, to_stream

FORM: Final = "serial:///dev/ttyACM0?baud=115200"
PTY: Final = "pty"  # the place of a pseudo terminal that the server makes
BAUD: Final = 115_200
PATIENCE: Final = 6.0  # s, in which a board that restarts when its port is opened has begun
_BLOCK: Final = 65_536  # bytes that are read at once
_APART: Final = 5e-4  # s between looks at a port that cannot be waited for


@final
class SerialPlant(RemotePlant):
    """The plant behind a serial port, `serial:///dev/ttyACM0?baud=115200` or `serial:COM3`."""

    def __init__(
        self, address: str, *, timeout: float | None = None, patience: float = PATIENCE, key: Key | None = None
    ) -> None:
        super().__init__(address, timeout=timeout, patience=patience, key=key)
        self._where = addresses.parse(address, ("baud",), FORM)
        self._baud = round(self._where.number("baud", BAUD))

    def open_line(self) -> SerialLine:
        """Line to the plant."""
        return SerialLine(_opened(self._where.place, self._baud))

    def remedy(self) -> str:
        """Remedy where no plant answers."""
        return "look at its cable, its baud rate, and the program on the board"

    @classmethod
    def listen(cls, address: str) -> SerialHub:
        """End at which a plant is served: a port, or with `serial:pty` a new pseudo terminal."""
        return SerialHub(address)


class SerialLine:
    """Frames over a port, which gives and takes bytes without waiting; an OSError of it says that the plant is gone."""

    def __init__(self, port: Port) -> None:
        self._port, self._splitter, self._rest = port, Splitter(), b""
        self._frames: deque[bytes] = deque()
        self._end: OSError | None = None

    def send(self, frame: bytes) -> None:
        """Send a frame, whole or not at all; BlockingIOError where the one before is still under way."""
        try:
            if self._rest:
                self._rest = self._rest[self._port.write(self._rest) :]
            if self._rest:
                raise BlockingIOError("the line is full")
            data = to_stream(frame)
            self._rest = data[self._port.write(data) :]
        except BlockingIOError:
            raise
        except OSError as error:
            raise ConnectionResetError(str(error)) from error

    def waits(self, seconds: float) -> bool:
        """Whether a frame or the end of the line waits to be read, or comes within a time."""
        until = time.monotonic() + seconds
        try:
            while not self._frames and self._port.waits(max(0.0, until - time.monotonic())):
                self._frames += self._splitter.feed(self._port.read())
        except OSError as error:
            self._end = error
        return bool(self._frames or self._end)

    def receive(self) -> bytes:
        """Frame that waits; the end of the line comes after all of them."""
        if not self.waits(0.0):
            raise BlockingIOError("there is no whole frame")
        if not self._frames:
            raise ConnectionResetError(str(self._end)) from self._end
        return self._frames.popleft()

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(OSError):
            self._port.close()


@final
class SerialHub:
    """The plant's end of a serial line, which has one controller."""

    is_local = True

    def __init__(self, address: str) -> None:
        where = addresses.parse(address, ("baud",), "serial:pty or " + FORM)
        try:
            if where.place == PTY:
                port: Port = _PseudoTerminal()
            else:
                port = _opened(where.place, round(where.number("baud", BAUD)))
        except OSError as error:
            raise PlantMismatchError(f"{address} cannot be served ({error}); choose another port") from error
        self.address = f"serial://{port.name}" if isinstance(port, _PseudoTerminal) else address
        self._line, self._peer = SerialLine(port), (self.address,)
        self.waits, self.close = self._line.waits, self._line.close

    def send(self, frame: bytes, peer: Peer) -> None:
        """Send a frame."""
        del peer  # there is one
        self._line.send(frame)

    def receive(self) -> tuple[bytes, Peer]:
        """Frame that waits."""
        return self._line.receive(), self._peer


class _Descriptor:
    """A file descriptor that does not block."""

    def __init__(self, number: int) -> None:
        self._number = number
        os.set_blocking(number, False)

    def waits(self, seconds: float) -> bool:
        return bool(select.select([self._number], [], [], seconds)[0])

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._number, _BLOCK)
            if not data:
                raise ConnectionResetError("the port is closed")
            return data
        return b""

    def write(self, data: bytes) -> int:
        with contextlib.suppress(BlockingIOError):
            return os.write(self._number, data)
        return 0

    def close(self) -> None:
        os.close(self._number)


@final
class _SerialPort(_Descriptor):
    """A port of pyserial, where ports are file descriptors."""

    def __init__(self, port: Any) -> None:  # noqa: ANN401  # pyserial has no types
        super().__init__(port.fileno())
        self._port = port

    def close(self) -> None:
        self._port.close()


@final
class _PseudoTerminal(_Descriptor):
    """A new pseudo terminal, at `name`; it stays while controllers come and go."""

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise PlantMismatchError("Windows has no pseudo terminals; serve at a port, or at udp://127.0.0.1:5005")
        import tty  # noqa: PLC0415  # not there on Windows

        number, self._other = os.openpty()
        tty.setraw(self._other)
        self.name = os.ttyname(self._other)
        super().__init__(number)

    def close(self) -> None:
        os.close(self._other)
        super().close()


@final
class _PolledPort:
    """A port of pyserial where it is no file descriptor, as on Windows; not tested."""

    def __init__(self, port: Any) -> None:  # noqa: ANN401  # pyserial has no types
        self._port = port

    def waits(self, seconds: float) -> bool:
        until = time.monotonic() + seconds
        while not self._port.in_waiting and time.monotonic() < until:
            time.sleep(_APART)
        return bool(self._port.in_waiting)

    def read(self) -> bytes:
        return bytes(self._port.read(self._port.in_waiting))

    def write(self, data: bytes) -> int:
        return int(self._port.write(data))

    def close(self) -> None:
        self._port.close()


Port: TypeAlias = _SerialPort | _PseudoTerminal | _PolledPort


def _opened(place: str, baud: int) -> Port:
    """Open a port; OSError where it is not there or taken."""
    try:
        port = serial.Serial(place, baud, timeout=0, write_timeout=0, exclusive=True)
    except ValueError as error:
        raise OSError(str(error)) from error
    return _PolledPort(port) if sys.platform == "win32" else _SerialPort(port)
