"""Operator page: a loop's `Monitor` as a local page, with STOP and acknowledge."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Coroutine
from http import HTTPStatus
from typing import Any, Final, final

from masking.errors import OperatorError
from masking.lab.records.stop_switch import Presser, Switch
from masking.reports import html
from masking.reports.live_monitor import Monitor
from masking.reports.local_page import Answer, LocalPage

_LOOK, _PHASE = 0.04, 0.25  # s between looks at the rows, and at the phases
_TAKEN: Final = "; a page that shows a trip gives its port back once that is acknowledged"


@final
class OperatorPage(LocalPage):
    """The page of one loop, served from the construction on; a context that ends the service.

    Port 0 is a free one; an `OperatorError` says that another is taken. The switch is what STOP presses.
    """

    def __init__(self, monitor: Monitor, switch: Switch, port: int = 0) -> None:
        self.monitor, self.switch, self._phased = monitor, switch, 0.0
        self._begin(html.render("operator", facts=monitor.facts()), port, "--page", _TAKEN)

    def _hear(self) -> None:
        self.switch.see()

    def _work(self) -> tuple[Coroutine[Any, Any, None], ...]:
        return (self._watch(),)

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

    def _press(self, path: str) -> Answer:
        if path == "stop":
            self.switch.press(Presser.PAGE)
        elif path == "acknowledge":
            try:
                self.switch.acknowledge()
            except OperatorError as error:
                return Answer(HTTPStatus.CONFLICT, f"{error}\n".encode())
        else:
            return Answer(HTTPStatus.NOT_FOUND)
        return Answer(HTTPStatus.OK, b"{}", "application/json")
