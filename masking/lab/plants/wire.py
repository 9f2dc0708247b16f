"""Frames: what a plant and its controller say to each other.

One frame is one datagram, or on a stream of bytes what stands between two zeros (`to_stream`), little-endian:

    bytes   0-3    magic "MSKG"
            4      version of this layout
            5      kind
            6-7    zero
            8-15   session: a number that the controller draws for each run
            16-23  index: the sample that the frame holds or answers
            24-31  time of sending, ns of the sender's monotonic clock; comparable on one machine only
            32-35  count of float64 values, or of bytes of text
            36-    payload
            last 4 CRC-32 of all before

A frame that is wrong in any part is refused whole with a `WireError`, whose `cause` the receiver counts. Where both
sides hold a key, a tag follows each frame (`masking.lab.plants.authentication`).

On a stream a frame is written without zeros, by consistent overhead byte stuffing, and ends in one, so that a receiver
that lost bytes finds the next frame. Source: Cheshire and Baker (1999), IEEE/ACM Transactions on Networking 7(2).
"""

from __future__ import annotations

import json
import struct
import time
import zlib
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any, Final, final
from urllib.parse import urlsplit

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.characters import visible_line
from masking.errors import PlantError, PlantMismatchError, WireError
from masking.lab.plants.interface import Settings

MAGIC: Final = b"MSKG"
VERSION: Final = 1
LARGEST: Final = 60_000  # bytes of a payload that a datagram can carry
LARGEST_DATAGRAM: Final = 65_535  # bytes that are received
_RUN: Final = 254  # bytes other than zero that one byte of a stream can count
_HEADER: Final = struct.Struct("<4sBBHQQQI")
_CHECK: Final = struct.Struct("<I")
SMALLEST: Final = _HEADER.size + _CHECK.size  # bytes of a frame
LONGEST_TEXT: Final = 2000  # characters of a reason
EMERGENCY: Final = "the emergency stop of the plant is pressed"  # so begins the reason of such a STOP
NO_VALUES: Final[Array] = np.empty(0)
_U64: Final = 2**64


class Kind(IntEnum):
    """What a frame is: the third row carries values, the others text."""

    HELLO, ACCEPT, REFUSE, STOP = 1, 2, 3, 4  # settings; channel names; a reason; a reason
    START, BYE = 5, 6  # nothing
    SENSORS, COMMAND = 7, 8
    CHALLENGE = 9  # a nonce; only where frames have tags


TEXTUAL: Final = frozenset({*Kind} - {Kind.SENSORS, Kind.COMMAND})


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame that was received whole."""

    kind: Kind  # what it is
    session: int  # number of the session, below 2**64
    index: int  # sample that it holds or answers, below 2**64
    sent: int  # ns of the sender's monotonic clock
    values: Array  # (count,); empty in a frame of text
    text: str  # empty in a frame of values

    @property
    def said(self) -> str:
        """Its text for people, in one line."""
        return visible_line(self.text)


def encode(kind: Kind, session: int, index: int = 0, *, values: Array = NO_VALUES, text: str = "") -> bytes:
    """Write a frame of `values` (count,) or of `text`, as its kind says; a PlantError if it is too large."""
    payload = text.encode() if kind in TEXTUAL else np.asarray(values, dtype="<f8").tobytes()
    count = len(payload) if kind in TEXTUAL else len(values)
    if len(payload) > LARGEST:
        raise PlantError(f"a frame of {len(payload)} bytes does not fit into a datagram; use fewer channels")
    body = _HEADER.pack(MAGIC, VERSION, kind, 0, session % _U64, index, time.monotonic_ns(), count) + payload
    return body + _CHECK.pack(zlib.crc32(body))


def decode(datagram: bytes) -> Frame:
    """Read a frame; a WireError where it is not exactly one sound frame of this version, or a command is not finite."""
    size = len(datagram) - SMALLEST
    if size < 0 or datagram[:4] != MAGIC:
        raise WireError("foreign", "no frame of ours")
    _, version, number, reserved, session, index, sent, count = _HEADER.unpack_from(datagram)
    body = memoryview(datagram)[: -_CHECK.size]
    if _CHECK.unpack_from(datagram, len(body))[0] != zlib.crc32(body):
        raise WireError("corrupt", "the check sum is wrong")
    if version != VERSION:
        raise WireError("version", f"layout {version}; this program speaks {VERSION}: bring both sides up to date")
    try:
        kind = Kind(number)
    except ValueError:
        raise WireError("malformed", f"kind {number} is unknown") from None
    if reserved or size != (count if kind in TEXTUAL else 8 * count):
        raise WireError("malformed", f"{size} bytes do not hold {count} items")
    if kind in TEXTUAL:
        try:
            text = str(body[_HEADER.size :], "utf-8")
        except UnicodeDecodeError:
            raise WireError("malformed", "the text is not UTF-8") from None
        return Frame(kind, session, index, sent, NO_VALUES, text)
    values = np.frombuffer(body, "<f8", count, _HEADER.size).astype(np.float64)
    if kind is Kind.COMMAND and not np.isfinite(values).all():
        raise WireError("nonfinite", "a command is not finite")
    return Frame(kind, session, index, sent, values, "")


def kind_of(frame: bytes) -> int:
    """Kind of a frame of at least `SMALLEST` bytes; the rest is not looked at."""
    return frame[5]


def session_of(frame: bytes) -> int:
    """Number of the session of a frame of at least `SMALLEST` bytes; the rest is not looked at."""
    return int.from_bytes(frame[8:16], "little")


def to_stream(frame: bytes) -> bytes:
    """Write a frame for a stream of bytes: without zeros, and a zero behind it."""
    found, parts = bytearray(), frame.split(b"\0")
    for number, part in enumerate(parts):
        runs = [part[i : i + _RUN] for i in range(0, len(part), _RUN)]
        if not runs or (len(runs[-1]) == _RUN and number < len(parts) - 1):  # a full run has no zero behind it
            runs.append(b"")
        for run in runs:
            found.append(len(run) + 1)
            found += run
    return bytes(found) + b"\0"


@final
class Splitter:
    """Finds frames in a stream of bytes; what is none comes out as it is, and `decode` refuses it."""

    def __init__(self) -> None:
        self._part = bytearray()

    def feed(self, received: bytes) -> list[bytes]:
        """Take the next bytes; return the frames that they complete."""
        *whole, rest = received.split(b"\0")
        found = []
        for part in whole:
            self._part += part
            if self._part:
                found.append(_from_stream(bytes(self._part)))
            self._part.clear()
        self._part += rest
        if len(self._part) > LARGEST_DATAGRAM:  # no frame is that long
            self._part.clear()
        return found


def _from_stream(stuffed: bytes) -> bytes:
    found, at = bytearray(), 0
    while at < len(stuffed):
        length = stuffed[at]
        found += stuffed[at + 1 : at + length]
        at += length
        if length <= _RUN and at < len(stuffed):
            found.append(0)
    return bytes(found)


def settings_text(settings: Settings) -> str:
    """Write settings as the text of a hello."""
    return json.dumps(asdict(settings))


def read_settings(text: str) -> Settings:
    """Read the text of a hello, which holds exactly the settings, each in its range."""
    content = _object(text)
    if set(content) | {"acknowledge"} != set(Settings.__slots__):  # which not every controller knows
        raise PlantMismatchError(f"a hello holds {', '.join(Settings.__slots__)}; got {text}")
    return Settings(**content)


def channels_text(sensors: tuple[str, ...], actuators: tuple[str, ...]) -> str:
    """Write the names of a plant's channels as the text of an accept."""
    return json.dumps({"sensors": sensors, "actuators": actuators})


def read_channels(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Read the text of an accept: the names of sensors and of actuators, two lists of different names."""
    content = _object(text)
    for kind in ("sensors", "actuators"):
        given: Any = content.get(kind)
        are_names = isinstance(given, list) and given and all(isinstance(name, str) and name for name in given)
        if not are_names or len(set(given)) != len(given):
            remedy = "it must give a list of different names"
            raise PlantMismatchError(f"the plant does not name its {kind}: {text}; {remedy}")
    return tuple(content["sensors"]), tuple(content["actuators"])


def parse_address(address: str) -> tuple[str, int]:
    """Split `udp://host:port`; a PlantMismatchError where an address is written otherwise."""
    try:
        parts = urlsplit(address)
        if parts.scheme == "udp" and parts.hostname and parts.port is not None and not parts.path:
            return parts.hostname, parts.port
    except ValueError:  # a port that is no number, or too large
        pass
    raise PlantMismatchError(f"'{address}' is no address of a plant; write it as udp://127.0.0.1:5005")


def _object(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise PlantMismatchError(f"the other side does not speak this language: {text!r}")
    return content


def _refuse(constant: str) -> float:
    raise ValueError(constant)
