"""Operator page: a loop's `Monitor` over HTTP, for browsers on this machine alone, with STOP and acknowledge.

The address has a random token: who does not know it gets nothing, so that other users and pages from elsewhere cannot
press STOP, nor read. A name that is made to lead here, by DNS rebinding, is refused by its Host header.

One thread answers all connections and waits for none of them; another one looks at the rows, so that STOP waits for no
look. A request must be whole within `_DEADLINE`. There is always a place for whoever shows the token: where all are
taken, a new connection gets that of the oldest one that has not shown it.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http.client
import io
import json
import secrets
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final, final

from masking.errors import OperatorError
from masking.lab.records.stop_switch import Presser, Switch
from masking.reports import html
from masking.reports.live_monitor import Monitor

HOST: Final = "127.0.0.1"
_LOOK, _PHASE = 0.04, 0.25  # s between looks at the rows, and at the phases
_DEADLINE: Final = 1.0  # s from the first byte of a request to its last; a stranger's first byte comes as soon
_PATIENCE: Final = 5.0  # s that a client may take to read an answer
_CONNECTIONS: Final = 512
_WAITING: Final = 4096  # connections that wait to be accepted
_HEAD: Final = 16_384  # bytes of a request without its content
_LONGEST: Final = 1024  # bytes of a request's content
_CHUNK: Final = 65_536
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_Task = asyncio.Task[None]


@dataclass(frozen=True)
class _Answer:
    status: HTTPStatus
    content: bytes = b"there is nothing here\n"
    kind: str = "text/plain; charset=utf-8"

    def encoded(self, *, is_last: bool) -> bytes:
        """Bytes to send; behind the last answer the connection is closed."""
        fields = {**_HEADERS, "Content-Type": self.kind, "Content-Length": str(len(self.content))}
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


@final
class OperatorPage:
    """The page of one loop, served from the construction on; a context that ends the service.

    Port 0 is a free one; an `OperatorError` says that another is taken. The switch is what STOP presses.
    """

    def __init__(self, monitor: Monitor, switch: Switch, port: int = 0) -> None:
        self.monitor, self.switch = monitor, switch
        self.token = secrets.token_urlsafe(18)
        self._page = html.render("operator", facts=monitor.facts()).encode()
        try:
            self.listener = socket.create_server((HOST, port), backlog=_WAITING)
        except (OSError, OverflowError) as error:
            remedy = "name another, or none; a page that shows a trip gives its port back once that is acknowledged"
            raise OperatorError(f"--page {port}: this port cannot be had ({error}); {remedy}") from error
        self.listener.setblocking(False)
        self.port = int(self.listener.getsockname()[1])
        self._names = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        self._origins = {None, *(f"http://{name}" for name in self._names)}
        self._rows = ThreadPoolExecutor(1)  # the thread that uses the monitor
        self._phased = 0.0
        # Those that have not shown the token, the oldest first, and those that have, the one first that asked first.
        self._strangers, self._holders = dict[_Task, None](), dict[_Task, None]()
        self._runner, self._ended = asyncio.Runner(loop_factory=asyncio.new_event_loop), asyncio.Event()
        self._loop = self._runner.get_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> OperatorPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def _run(self) -> None:
        with self._rows, self.listener, self._runner:
            self._runner.run(self._serve())

    async def _serve(self) -> None:
        tasks = [asyncio.create_task(self._watch()), asyncio.create_task(self._accept())]
        await self._ended.wait()
        for task in tasks:
            task.cancel()

    async def _watch(self) -> None:
        """Look at the rows until the service ends."""
        while True:
            await asyncio.sleep(_LOOK)
            await self._loop.run_in_executor(self._rows, self._look)

    def _look(self) -> None:
        now = time.monotonic()
        self.monitor.look(now)
        if now - self._phased > _PHASE:
            self.monitor.look_at_phase()
            self._phased = now

    def _data(self, query: str) -> bytes:
        """State and the bins from a number on, as JSON."""
        digits = query.removeprefix("since=")
        number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 16 else 0
        return json.dumps(self.monitor.since(number, time.monotonic()), allow_nan=False).encode()

    async def _accept(self) -> None:
        """Accept connections until the service ends."""
        while True:
            if len(self._strangers) + len(self._holders) >= _CONNECTIONS:
                self._drop()
            try:
                connection, _ = await self._loop.sock_accept(self.listener)
            except OSError:  # such as too many open files
                self._drop()
                await asyncio.sleep(_LOOK)
                continue
            task = asyncio.create_task(self._converse(connection))
            self._strangers[task] = None
            task.add_done_callback(self._forget)
            await asyncio.sleep(0)  # others go on

    def _drop(self) -> None:
        task = next(iter(self._strangers or self._holders), None)
        if task is not None:
            self._forget(task)
            task.cancel()

    def _forget(self, task: _Task) -> None:
        self._strangers.pop(task, None)
        self._holders.pop(task, None)

    async def _converse(self, connection: socket.socket) -> None:
        """Answer the requests of a connection, and close it."""
        held, is_last = bytearray(), False
        with connection, contextlib.suppress(OSError):  # it has gone, or a deadline has passed
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while not is_last:
                request = await self._request(connection, held)
                answer = await self._answer(request)
                is_last = request.is_last or answer.status != HTTPStatus.OK
                async with asyncio.timeout(_PATIENCE):
                    await self._loop.sock_sendall(connection, answer.encoded(is_last=is_last))

    async def _request(self, connection: socket.socket, held: bytearray) -> _Request:
        """Next request, of which `held` has what came with the one before."""
        task = asyncio.current_task()
        assert task is not None  # noqa: S101  # each connection has one
        is_idle = task in self._holders and not held
        async with asyncio.timeout(None if is_idle else _DEADLINE) as limit:
            while (end := held.find(b"\r\n\r\n")) < 0:
                if len(held) > _HEAD:
                    return _Request(refused=HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
                held += await self._received(connection)
                if limit.when() is None:
                    limit.reschedule(self._loop.time() + _DEADLINE)
            request = _Request.of(bytes(held[: end + 4]))
            del held[: end + 4]
            if self._is_known(request):
                self._forget(task)
                self._holders[task] = None
            while len(held) < request.length:
                held += await self._received(connection)
            del held[: request.length]
        return request

    async def _received(self, connection: socket.socket) -> bytes:
        found = await self._loop.sock_recv(connection, _CHUNK)
        if not found:
            raise ConnectionError
        return found

    def _is_known(self, request: _Request) -> bool:
        """Whether a request has the token and is for this host."""
        is_token = hmac.compare_digest(request.token.encode("utf-8", "replace"), self.token.encode())
        return is_token and request.host in self._names

    async def _answer(self, request: _Request) -> _Answer:
        if request.refused:
            return _Answer(HTTPStatus(request.refused))
        if request.method == "POST":
            return self._press(request)
        if request.method != "GET":
            return _Answer(HTTPStatus.NOT_IMPLEMENTED)
        if self._is_known(request) and request.path == "":
            return _Answer(HTTPStatus.OK, self._page, "text/html; charset=utf-8")
        if self._is_known(request) and request.path == "data":
            self.switch.see()
            content = await self._loop.run_in_executor(self._rows, self._data, request.query)
            return _Answer(HTTPStatus.OK, content, "application/json")
        return _Answer(HTTPStatus.NOT_FOUND)

    def _press(self, request: _Request) -> _Answer:
        """Do what a button says."""
        if not self._is_known(request) or request.origin not in self._origins:
            return _Answer(HTTPStatus.FORBIDDEN)
        if request.path == "stop":
            self.switch.press(Presser.PAGE)
        elif request.path == "acknowledge":
            try:
                self.switch.acknowledge()
            except OperatorError as error:
                return _Answer(HTTPStatus.CONFLICT, f"{error}\n".encode())
        else:
            return _Answer(HTTPStatus.NOT_FOUND)
        return _Answer(HTTPStatus.OK, b"{}", "application/json")
