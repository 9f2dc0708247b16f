"""Operator page: a loop's `Monitor` over HTTP, for browsers on this machine alone, with STOP and acknowledge.

The address has a random token: who does not know it gets nothing, so that other users and pages from elsewhere cannot
press STOP, nor read. A name that is made to lead here, by DNS rebinding, is refused by its Host header.
"""

from __future__ import annotations

import hmac
import json
import secrets
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final, final

from masking.errors import OperatorError
from masking.lab.records.stop_switch import Presser, Switch
from masking.reports import html
from masking.reports.live_monitor import Monitor

HOST: Final = "127.0.0.1"
GONE: Final = 3.0  # s without a request, after which nobody looks any more
_LOOK, _PHASE = 0.04, 0.25  # s between looks at the rows, and at the phases
_TIMEOUT: Final = 5.0  # s that a request may take
_CONNECTIONS: Final = 32
_LONGEST: Final = 1024  # bytes of a request's content
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


@final
class OperatorPage:
    """The page of one loop, served from the construction on; a context that ends the service.

    Port 0 is a free one; an `OperatorError` says that another is taken. The switch is what STOP presses.
    """

    def __init__(self, monitor: Monitor, switch: Switch, port: int = 0) -> None:
        self.monitor, self.switch = monitor, switch
        self.token = secrets.token_urlsafe(18)
        self._lock, self._ended, self._looked = threading.Lock(), threading.Event(), 0.0
        self._page = html.render("operator", facts=monitor.facts()).encode()
        try:
            self._server = _Server((HOST, port), self)
        except (OSError, OverflowError) as error:
            raise OperatorError(f"--page {port}: this port cannot be had ({error}); name another, or none") from error
        self.port = int(self._server.server_address[1])
        self._threads = [
            threading.Thread(target=self._watch, daemon=True),
            threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> OperatorPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    @property
    def is_looked_at(self) -> bool:
        """Whether a browser shows the page."""
        return self._looked > 0.0 and time.monotonic() - self._looked < GONE

    def _watch(self) -> None:
        """Read rows until the service ends."""
        phase = 0.0
        while not self._ended.wait(_LOOK):
            now = time.monotonic()
            with self._lock:
                self.monitor.look(now)
                if now - phase > _PHASE:
                    self.monitor.look_at_phase()
                    phase = now

    def get(self, path: str, query: str) -> tuple[str, bytes] | None:
        """Type and the content of a path behind the token; None where there is nothing."""
        if path == "":
            return "text/html; charset=utf-8", self._page
        if path == "data":
            digits = query.removeprefix("since=")
            number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 16 else 0
            self._looked = time.monotonic()
            self.switch.see()
            with self._lock:
                found = self.monitor.since(number, self._looked)
            return "application/json", json.dumps(found, allow_nan=False).encode()
        return None

    def post(self, path: str) -> bool:
        """Do what a button says; return whether there is such a button."""
        if path == "stop":
            self.switch.press(Presser.PAGE)
        elif path == "acknowledge":
            self.switch.acknowledge()
        else:
            return False
        return True


class _Server(ThreadingHTTPServer):
    """A server whose requests run in threads, at most `_CONNECTIONS` of them."""

    daemon_threads, block_on_close, request_queue_size = True, False, _CONNECTIONS
    allow_reuse_address = True

    def __init__(self, address: tuple[str, int], page: OperatorPage) -> None:
        super().__init__(address, _Handler)
        self.page, self._free = page, threading.Semaphore(_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ANN401
        """Say nothing of a client that has gone."""


class _Handler(BaseHTTPRequestHandler):
    """One connection: GET of the page and its data, POST of a button."""

    protocol_version, timeout = "HTTP/1.1", _TIMEOUT
    server_version, sys_version = "masking", ""
    disable_nagle_algorithm = True
    wbufsize = -1  # heads and content in one segment
    server: _Server

    def do_GET(self) -> None:
        """Answer with the page, or with data."""
        path = self._path()
        if path is None or (found := self.server.page.get(*path)) is None:
            self._refuse(404)
        else:
            self._answer(200, *found)

    def do_POST(self) -> None:
        """Do what a button says."""
        length = self.headers.get("Content-Length") or "0"
        if "Transfer-Encoding" in self.headers or not (length.isascii() and length.isdigit()):
            self._refuse(400)
        elif len(length) > 8 or int(length) > _LONGEST:
            self._refuse(413)
        else:
            self.rfile.read(int(length))
            path, origin = self._path(), self.headers.get("Origin")
            if path is None or origin not in {None, *(f"http://{name}" for name in self._names())}:
                self._refuse(403)
            elif self.server.page.post(path[0]):
                self._answer(200, "application/json", b"{}")
            else:
                self._refuse(404)

    def _names(self) -> set[str]:
        return {f"{name}:{self.server.page.port}" for name in (HOST, "localhost")}

    def _path(self) -> tuple[str, str] | None:
        """Path behind the token and the query; None without the token, or for another host."""
        if self.headers.get("Host", "") not in self._names():
            return None
        path, _, query = self.path.partition("?")
        token, _, rest = path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.server.page.token.encode()):
            return None
        return rest, query

    def _refuse(self, status: int) -> None:
        self.close_connection = True
        self._answer(status, "text/plain; charset=utf-8", b"there is nothing here\n")

    def _answer(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)
        self.wfile.flush()

    def log_message(self, format: str, *args: object) -> None:
        """Write no log."""
