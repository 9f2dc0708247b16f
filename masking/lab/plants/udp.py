"""UDP: a plant in another process or on another machine, a frame in each datagram."""

from __future__ import annotations

import ipaddress
import select
import socket
from typing import final

from masking.errors import PlantMismatchError
from masking.lab.plants import wire
from masking.lab.plants.authentication import Key
from masking.lab.plants.remote import RemotePlant
from masking.lab.plants.transport import Peer


@final
class UdpPlant(RemotePlant):
    """The plant that is served at `udp://host:port`."""

    def __init__(
        self, address: str, *, timeout: float | None = None, patience: float = 3.0, key: Key | None = None
    ) -> None:
        super().__init__(address, timeout=timeout, patience=patience, key=key)
        self._target = wire.parse_address(address)

    def open_line(self) -> UdpLine:
        """Line to the plant."""
        return UdpLine(self._target)

    @classmethod
    def listen(cls, address: str) -> UdpHub:
        """End at which a plant is served; port 0 takes a free one."""
        return UdpHub(address)


class _Datagrams:
    """A socket that is waited for."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def waits(self, seconds: float) -> bool:
        return bool(select.select([self._socket], [], [], seconds)[0])

    def close(self) -> None:
        self._socket.close()


@final
class UdpLine(_Datagrams):
    """The controller's end."""

    def __init__(self, target: tuple[str, int]) -> None:
        super().__init__()
        try:
            self._socket.connect(target)
        except OSError:
            self.close()
            raise

    def send(self, frame: bytes) -> None:
        """Send a frame."""
        self._socket.send(frame)

    def receive(self) -> bytes:
        """Datagram that waits; BlockingIOError where its own check sum is wrong."""
        return self._socket.recv(wire.LARGEST_DATAGRAM)


@final
class UdpHub(_Datagrams):
    """The plant's end."""

    def __init__(self, address: str) -> None:
        host, port = wire.parse_address(address)
        super().__init__()
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self.close()
            raise PlantMismatchError(f"{address} cannot be served ({error}); choose another host or port") from error
        bound, port = self._socket.getsockname()
        self.address, self.is_local = f"udp://{host}:{port}", ipaddress.ip_address(bound).is_loopback

    def send(self, frame: bytes, peer: Peer) -> None:
        """Send a frame to a controller."""
        self._socket.sendto(frame, peer)

    def receive(self) -> tuple[bytes, Peer]:
        """Datagram that waits, and where it came from."""
        return self._socket.recvfrom(wire.LARGEST_DATAGRAM)
