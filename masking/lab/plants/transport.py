"""Lines: what carries frames between one plant and one controller, whatever it is made of.

A line loses frames where it must, and never repairs one: `plants.wire` sees what is broken, and what is missing
is the business of both sides.
"""

from __future__ import annotations

from typing import Protocol

Peer = tuple[str | int, ...]
"""Where a frame came from, as an answer needs it."""


class End(Protocol):
    """One end of lines."""

    def waits(self, seconds: float) -> bool:
        """Whether a frame waits to be read, or comes within a time."""
        ...

    def close(self) -> None:
        """Give the line back; never raises."""


class Line(End, Protocol):
    """The controller's end: a ConnectionError where the plant is gone, a BlockingIOError where nothing passes now."""

    def send(self, frame: bytes) -> None:
        """Send a frame."""

    def receive(self) -> bytes:
        """Frame that waits to be read."""
        ...


class Hub(End, Protocol):
    """The plant's end of the lines of any number of controllers."""

    address: str  # at which it is reached
    is_local: bool  # nobody reaches it but from this machine, or by a cable of its own

    def send(self, frame: bytes, peer: Peer) -> None:
        """Send a frame; OSError where it cannot go out."""

    def receive(self) -> tuple[bytes, Peer]:
        """Frame that waits to be read, and where it came from; OSError where there is none."""
        ...
