"""Local page: a page over HTTP for browsers on this machine alone.

The address has a random token: who does not know it gets nothing, so that other users and pages from elsewhere cannot
press a button, nor read. A name that is made to lead here, by DNS rebinding, is refused by its Host header.

One thread answers all connections and waits for none of them; another one does what takes time, so that a button waits
for no look. A request must be whole within `_DEADLINE`. There is always a place for whoever shows the token: where all
are taken, a new connection gets that of the oldest one that has not shown it.
"""

from __future__ import annotations

import asyncio
import hmac
import http.client
import io
import secrets
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, Self

from masking.errors import OperatorError

HOST: Final = "127.0.0.1"
_DEADLINE: Final = 1.0  # s from the first byte of a request to its last; a stranger's first byte comes as soon
_PATIENCE: Final = 5.0  # s that a client may take to read an answer
_CONNECTIONS: Final = 512
_WAITING: Final = 4096  # connections that wait to be accepted
_HEAD: Final = 16_384  # bytes of a request without its content
_LONGEST: Final = 1024  # bytes of a request's content
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors {frames}"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
NOBODY: Final = "'none'"
_Task = asyncio.Task[None]


@dataclass(frozen=True)
class Answer:
    """Answer to a request."""

    status: HTTPStatus
    content: bytes = b"there is nothing here\n"
    kind: str = "text/plain; charset=utf-8"

    def encoded(self, frames: str, *, is_last: bool) -> bytes:
        """Bytes to send; behind the last answer the connection is closed. `frames` may frame it."""
        policy = {"Content-Security-Policy": _HEADERS["Content-Security-Policy"].format(frames=frames)}
        policy |= {"X-Frame-Options": "DENY"} if frames == NOBODY else {}
        fields = {**_HEADERS, **policy, "Content-Type": self.kind, "Content-Length": str(len(self.content))}
        fields |= {"Connection": "close"} if is_last else {}
        lines = [f"HTTP/1.1 {self.status.value} {self.status.phrase}", *(f"{name}: {fields[name]}" for name in fields)]
        return "\r\n".join([*lines, "", ""]).encode() + self.content


@dataclass(frozen=True)
class _Request:
    """A request without its content; `refused` is the status of one that cannot be answered, 0 for any other."""

    method: str = ""
    token: str = ""
    path: str = ""  # behind the token
    query: str = ""
    host: str = ""
    origin: str | None = None
    length: int = 0  # bytes of its content
    is_last: bool = True  # the connection is closed behind its answer
    refused: int = 0

    @classmethod
    def of(cls, head: bytes) -> _Request:
        line, _, rest = head.partition(b"\r\n")
        words = line.decode("latin-1").split(" ")
        if len(words) != 3 or not words[2].startswith("HTTP/1."):
            return cls(refused=HTTPStatus.BAD_REQUEST)
        try:
            headers = http.client.parse_headers(io.BytesIO(rest))
        except http.client.HTTPException:
            return cls(refused=HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        length = headers.get("Content-Length") or "0"
        if "Transfer-Encoding" in headers or not (length.isascii() and length.isdigit()):
            return cls(refused=HTTPStatus.BAD_REQUEST)
        if len(length) > 8 or int(length) > _LONGEST:
            return cls(refused=HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        path, _, query = words[1].partition("?")
        token, _, path = path.removeprefix("/").partition("/")
        is_last = words[2] == "HTTP/1.0" or headers.get("Connection", "").lower() == "close"
        host, origin = headers.get("Host", ""), headers.get("Origin")
        return cls(words[0], token, path, query, host, origin, int(length), is_last)


class LocalPage(ABC):
    """A page that is served from `_begin` on, and what it answers; a context that ends the service."""

    frames: str = NOBODY  # origins of pages that may frame it

    def _begin(self, page: str, port: int, option: str, more: str = "") -> None:
        """Serve a page of HTML at a port, 0 for a free one; an `OperatorError` says that another is taken, and more."""
        self.token = secrets.token_urlsafe(18)
        self._page = page.encode()
        try:
            self.listener = socket.create_server((HOST, port), backlog=_WAITING)
        except (OSError, OverflowError) as error:
            message = f"{option} {port}: this port cannot be had ({error}); name another, or none{more}"
            raise OperatorError(message) from error
        self.port = int(self.listener.getsockname()[1])
        self._names = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        self._origins = {None, *(f"http://{name}" for name in self._names)}
        self._rows = ThreadPoolExecutor(1)  # the thread for what takes time
        # Those that have not shown the token, the oldest first, and those that have, the one first that asked first.
        self._strangers, self._holders = dict[_Task, None](), dict[_Task, None]()
        self._runner, self._ended = asyncio.Runner(loop_factory=asyncio.new_event_loop), asyncio.Event()
        self._loop = self._runner.get_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def _run(self) -> None:
        with self._rows, self._runner:
            self._runner.run(self._serve())

    async def _serve(self) -> None:
        """Answer connections until the service ends."""
        tasks = [asyncio.create_task(work) for work in self._work()]
        async with await asyncio.start_server(self._converse, sock=self.listener, limit=_HEAD, backlog=_WAITING):
            await self._ended.wait()
        for task in (*tasks, *self._strangers, *self._holders):
            task.cancel()

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer the requests of a connection, and close it."""
        task, is_last = asyncio.current_task(), False
        assert task is not None  # noqa: S101  # each connection has one
        if len(self._strangers) + len(self._holders) >= _CONNECTIONS:
            oldest = next(iter(self._strangers or self._holders))
            self._forget(oldest)
            oldest.cancel()
        self._strangers[task] = None
        task.add_done_callback(self._forget)
        writer.transport.set_write_buffer_limits(0)  # an answer is sent once it is read
        try:
            while not is_last:
                request = await self._request(reader, task)
                answer = await self._answer(request)
                is_last = request.is_last or answer.status != HTTPStatus.OK
                writer.write(answer.encoded(self.frames, is_last=is_last))
                async with asyncio.timeout(_PATIENCE):
                    await writer.drain()
            writer.close()
        except (
            OSError,
            EOFError,
            asyncio.CancelledError,
        ):  # gone, too late, or another has its place
            writer.transport.abort()

    def _forget(self, task: _Task) -> None:
        self._strangers.pop(task, None)
        self._holders.pop(task, None)

    async def _request(self, reader: asyncio.StreamReader, task: _Task) -> _Request:
        """Next request; whoever has shown the token may take any time to begin one."""
        async with asyncio.timeout(None if task in self._holders else _DEADLINE) as limit:
            try:
                first = await reader.readexactly(1)
                limit.reschedule(self._loop.time() + _DEADLINE)
                request = _Request.of(first + await reader.readuntil(b"\r\n\r\n"))
            except asyncio.LimitOverrunError:
                return _Request(refused=HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
            if self._is_known(request):
                self._forget(task)
                self._holders[task] = None
            await reader.readexactly(request.length)
        return request

    def _is_known(self, request: _Request) -> bool:
        """Whether a request has the token and is for this host."""
        is_token = hmac.compare_digest(request.token.encode("utf-8", "replace"), self.token.encode())
        return is_token and request.host in self._names

    async def _answer(self, request: _Request) -> Answer:
        if request.refused:
            return Answer(HTTPStatus(request.refused))
        if request.method == "POST":
            allowed = self._is_known(request) and request.origin in self._origins
            return self._press(request.path) if allowed else Answer(HTTPStatus.FORBIDDEN)
        if request.method != "GET":
            return Answer(HTTPStatus.NOT_IMPLEMENTED)
        if self._is_known(request) and request.path == "":
            return Answer(HTTPStatus.OK, self._page, "text/html; charset=utf-8")
        if self._is_known(request) and request.path == "data":
            self._hear()
            content = await self._loop.run_in_executor(self._rows, self._data, request.query)
            return Answer(HTTPStatus.OK, content, "application/json")
        return Answer(HTTPStatus.NOT_FOUND)

    @abstractmethod
    def _data(self, query: str) -> bytes:
        """JSON that the page asks for, made in the thread for what takes time."""

    def _hear(self) -> None:  # noqa: B027  # of a page that anybody may leave
        """Note at once that somebody looks at the page."""

    def _press(self, path: str) -> Answer:
        """Do what a button says."""
        return Answer(HTTPStatus.NOT_FOUND)

    def _work(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """What goes on beside the answers until the service ends."""
        return ()
