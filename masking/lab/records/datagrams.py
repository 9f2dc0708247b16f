"""Rows of a running loop as JSON in UDP datagrams, as plotting programs take them, PlotJuggler for one.

A datagram is one flat object: `timestamp` in s, then a number for each column that is finite.
"""

from __future__ import annotations

import json
import math
import socket
from typing import Final, final

from masking.errors import OperatorError
from masking.lab.records.ring import RingReader

MOST: Final = 1000.0  # datagrams per second
_SUCH: Final = "give the host and the port of the program that listens, such as 127.0.0.1:9870"


@final
class Datagrams:
    """Datagrams of the rows of a ring, whose reader only these use, to `host:port`, whether anybody listens or not.

    An OperatorError where this is no address.
    """

    def __init__(self, reader: RingReader, address: str) -> None:
        host, port = split(address)
        try:
            family, kind, protocol, _, to = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket, self._to = socket.socket(family, kind, protocol), to
        except OSError as error:
            raise OperatorError(f"--stream {address}: cannot be reached ({error}); {_SUCH}") from error
        self._socket.setblocking(False)
        self._reader, self._every = reader, math.ceil(reader.rate / MOST)
        self._time = reader.columns.index("index") if "index" in reader.columns else None

    def send(self) -> int:
        """Send the rows since the last call, one of as many as make `MOST` a second; return how many datagrams were."""
        taken, sent = self._reader.take(), 0
        for number in range(-taken.first % self._every, len(taken.table), self._every):
            row = taken.table[number].tolist()
            tick = taken.first + number if self._time is None else row[self._time]
            found = {name: value for name, value in zip(self._reader.columns, row, strict=True) if math.isfinite(value)}
            content = {"timestamp": tick / self._reader.rate, **found}
            try:
                self._socket.sendto(json.dumps(content, separators=(",", ":")).encode(), self._to)
            except OSError:  # nobody listens, or the line is full
                continue
            sent += 1
        return sent

    def close(self) -> None:
        """End the service."""
        self._socket.close()


def split(address: str) -> tuple[str, int]:
    """Host and the port of an address; an OperatorError where it has none."""
    host, colon, port = address.rpartition(":")
    if not colon or not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
        raise OperatorError(f"--stream {address}: this is no host and port; {_SUCH}")
    return host.removeprefix("[").removesuffix("]"), int(port)
