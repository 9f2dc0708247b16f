"""Authentication: a key that both sides hold, and a tag on every frame, so that nobody else drives a plant.

A frame with a tag is a frame of `plants.wire` and the 16 bytes of its tag behind it: BLAKE2b of the frame under
a key of the session and of the direction. That key is derived from the shared one, the number of the session, which the
controller draws, and a nonce of the server, which is another one each time that the server is started:

    controller -> plant   HELLO, under the key without a nonce
    plant -> controller   CHALLENGE with the nonce, under the key without a nonce
    controller -> plant   HELLO again, under the key of the session, as all that follows both ways

So what was recorded in another session, with another server, or in the other direction has a wrong tag, and within a
session the index of a frame shows what was sent again. The server opens no session with a number that it has seen.

Keyed BLAKE2b does what HMAC does in one pass: it takes a quarter of the time of `hmac.digest` with SHA-256
(`python -m tests.benchmarks authentication`). Source: RFC 7693, section 2.9 for keys, and RFC 2104 for HMAC.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import stat
import sys
from pathlib import Path
from typing import Final, final

from masking.errors import PlantMismatchError, WireError
from masking.lab.plants import wire
from masking.lab.plants.transport import Hub, Line, Peer
from masking.lab.plants.wire import Kind

TAG: Final = 16  # bytes
SHORTEST: Final = 16  # bytes of a key
_LONGEST: Final = 4096
_KEPT: Final = 64  # sessions whose keys are kept; those of others are derived again
_FORWARD, _BACK = b"to the plant", b"to the controller"
_MAKE: Final = "make one with 'openssl rand -hex 32 > FILE; chmod 600 FILE', and give both sides the same"


@final
class Key:
    """A key of at least 16 bytes that a server and its controllers share, and nobody can guess; it is shown nowhere."""

    def __init__(self, secret: bytes) -> None:
        if not SHORTEST <= len(secret) <= _LONGEST:
            raise PlantMismatchError(f"a key of {len(secret)} bytes; it has {SHORTEST} to {_LONGEST}: {_MAKE}")
        self._shared = hashlib.blake2b(secret).digest()

    @classmethod
    def read(cls, path: str | Path) -> Key:
        """Read a key from a file that only its owner can use; white space around it is no part of it.

        A PlantMismatchError where the file cannot be read, others can read or write it, or it holds no key.
        """
        try:
            number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        except OSError as error:
            raise PlantMismatchError(f"the key {path} cannot be read ({error.strerror}); {_MAKE}") from error
        try:
            _check_owner(path, os.fstat(number))
            content = os.read(number, _LONGEST + 1).strip()
        finally:
            os.close(number)
        try:
            return cls(content)
        except PlantMismatchError as error:
            raise PlantMismatchError(f"{path}: {error}") from error

    def tags(self, session: int, nonce: bytes = b"") -> tuple[_Tags, _Tags]:
        """Tags of the frames of a session to the plant, and to the controller; no nonce before it is known."""
        about = session.to_bytes(8, "little") + nonce
        to_plant, to_controller = (hashlib.blake2b(way + about, key=self._shared).digest() for way in (_FORWARD, _BACK))
        return _Tags(to_plant), _Tags(to_controller)


def _check_owner(path: str | Path, status: os.stat_result) -> None:
    """Refuse what is no file, or a file that others can use."""
    if not stat.S_ISREG(status.st_mode):
        raise PlantMismatchError(f"the key {path} is no file; {_MAKE}")
    if sys.platform == "win32":  # which has no such modes
        return
    if status.st_mode & 0o077:
        mode = stat.S_IMODE(status.st_mode)
        raise PlantMismatchError(f"the key {path} has mode {mode:04o}, so that others can use it; 'chmod 600 {path}'")
    if status.st_uid not in {os.geteuid(), 0}:
        raise PlantMismatchError(f"the key {path} belongs to another user; take a file of your own")


@final
class _Tags:
    """The tags of the frames of a session in one direction."""

    def __init__(self, key: bytes) -> None:
        self._keyed = hashlib.blake2b(key=key, digest_size=TAG)

    def tag(self, frame: bytes) -> bytes:
        keyed = self._keyed.copy()
        keyed.update(frame)
        return keyed.digest()

    def add(self, frame: bytes) -> bytes:
        return frame + self.tag(frame)

    def is_on(self, tagged: bytes) -> bool:
        return hmac.compare_digest(self.tag(tagged[:-TAG]), tagged[-TAG:])


@final
class AuthenticatedLine:
    """The controller's end of a line whose frames have tags, by the key that the server has, too."""

    def __init__(self, line: Line, key: Key) -> None:
        self._line, self._key, self.waits, self.close = line, key, line.waits, line.close
        self._hello = b""
        self._session = -1
        self._first = self._tags = key.tags(0)

    def send(self, frame: bytes) -> None:
        """Send a frame."""
        is_hello = wire.kind_of(frame) == Kind.HELLO
        if is_hello:
            self._hello = frame
            if wire.session_of(frame) != self._session:
                self._session = wire.session_of(frame)
                self._first = self._tags = self._key.tags(self._session)
        self._line.send((self._first if is_hello else self._tags)[0].add(frame))

    def receive(self) -> bytes:
        """Frame that waits, without its tag; a challenge is answered, a BlockingIOError; a wrong tag is a WireError."""
        tagged = self._line.receive()
        if len(tagged) >= wire.SMALLEST + TAG:
            if self._tags[1].is_on(tagged):
                if wire.kind_of(tagged) != Kind.CHALLENGE:
                    return tagged[:-TAG]
            elif not self._first[1].is_on(tagged) or wire.kind_of(tagged) != Kind.CHALLENGE:
                raise _unauthenticated()
            frame = wire.decode(tagged[:-TAG])
            if frame.session == self._session:
                self._tags = self._key.tags(frame.session, frame.text.encode())
                self._line.send(self._tags[0].add(self._hello))
            raise BlockingIOError("it was a challenge")
        raise _unauthenticated()


@final
class AuthenticatedHub:
    """The plant's end of lines whose frames have tags, by the key that its controllers have, too."""

    def __init__(self, hub: Hub, key: Key) -> None:
        self._hub, self._key, self.waits, self.close = hub, key, hub.waits, hub.close
        self.address, self.is_local = hub.address, hub.is_local
        self._secret = secrets.token_bytes(32)
        self._known: dict[int, tuple[_Tags, _Tags]] = {}  # of sessions that a holder of the key has opened

    def send(self, frame: bytes, peer: Peer) -> None:
        """Send a frame; OSError where it cannot go out."""
        self._hub.send(self._tags(wire.session_of(frame))[1].add(frame), peer)

    def receive(self) -> tuple[bytes, Peer]:
        """Frame that waits, without its tag, and where it came from; a first hello is challenged.

        An OSError where there is none, or it was challenged; a WireError where its tag is wrong.
        """
        tagged, peer = self._hub.receive()
        if len(tagged) < wire.SMALLEST:
            raise _unauthenticated()
        session, is_hello = wire.session_of(tagged), wire.kind_of(tagged) == Kind.HELLO
        if len(tagged) >= wire.SMALLEST + TAG:
            tags = self._tags(session)
            if tags[0].is_on(tagged):
                if session not in self._known:
                    while len(self._known) >= _KEPT:
                        del self._known[next(iter(self._known))]
                    self._known[session] = tags
                return tagged[:-TAG], peer
            if is_hello and (first := self._key.tags(session))[0].is_on(tagged):
                challenge = wire.encode(Kind.CHALLENGE, session, text=self._nonce(session).decode())
                self._hub.send(first[1].add(challenge), peer)
                raise BlockingIOError("it was challenged")
        if is_hello:  # an answer that holds nothing, so that a user without the key knows what to do
            text = "its key is another one, or none was given; give the server's by --key FILE"
            self._hub.send(wire.encode(Kind.REFUSE, session, text=text), peer)
        raise _unauthenticated()

    def _tags(self, session: int) -> tuple[_Tags, _Tags]:
        return self._known.get(session) or self._key.tags(session, self._nonce(session))

    def _nonce(self, session: int) -> bytes:
        """Nonce of a session, which nobody can know before: the same for the same one, until a new start."""
        return hashlib.blake2b(session.to_bytes(8, "little"), key=self._secret, digest_size=16).hexdigest().encode()


def _unauthenticated() -> WireError:
    return WireError("unauthenticated", "its tag is wrong, or it has none")
