"""Operator of a running loop: a process beside it that shows its rows, as a page, as datagrams, or as both.

`attend` starts the process with the files of the loop's ring and switch; it prints one line of JSON: the address of the
`page`, or an `error`. It ends with the loop; a page that is still looked at stays, so that the operator sees how the
loop ended, until the browser has gone for `GONE`. The cause of a trip stays on a page that was looked at until it is
acknowledged, or the browser has gone for `UNREAD`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from masking.errors import MaskingError, OperatorError
from masking.lab.records.child_process import Child
from masking.lab.records.datagrams import Datagrams
from masking.lab.records.ring import RingReader
from masking.lab.records.stop_switch import Switch, is_running
from masking.reports.operator_page import Monitor, OperatorPage

GONE: Final = 3.0  # s without a request of the page, after which nobody looks any more
UNREAD: Final = 300.0  # the same of a page that has been looked at, after a trip; hidden pages ask once a minute
_LOOK: Final = 0.02  # s between looks at the rows


@dataclass
class Attendant:
    """The process beside a loop, and the address of its page, empty where there is none."""

    page: str
    process: Child

    def wait(self) -> None:
        """Wait until a trip is acknowledged on the page, or nobody looks at it any more."""
        self.process.wait()


def attend(ring: Path, switch: Path, page: int | None = None, stream: str | None = None) -> Attendant:
    """Start a process beside a loop with these files of its rows and its switch.

    `page` is the port of a page on this machine, 0 for a free one, `stream` the `host:port` that gets the rows as JSON
    over UDP. Raises an `OperatorError` where the port is taken, or the address is none.
    """
    options = [] if page is None else ["--page", str(page)]
    options += [] if stream is None else ["--stream", stream]
    process = Child(
        "masking.app.workflows.operator_process", [str(ring), str(switch), *options], is_quiet=True, nice=10
    )
    answer = json.loads(process.line() or '{"error": "the process of the operator page did not start"}')
    if "error" in answer:
        process.wait()
        raise OperatorError(answer["error"])
    return Attendant(answer["page"] or "", process)


def main(arguments: Sequence[str] | None = None) -> int:
    """Attend a loop until it ends; return the exit status."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("ring")
    parser.add_argument("switch")
    parser.add_argument("--page", type=int, metavar="PORT")
    parser.add_argument("--stream", metavar="HOST:PORT")
    chosen = parser.parse_args(arguments)
    # This process outlives what ends a terminal.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with contextlib.ExitStack() as way_out:
            reader, switch = RingReader(chosen.ring), Switch(chosen.switch)
            page = datagrams = None
            if chosen.stream is not None:
                datagrams = Datagrams(RingReader(chosen.ring), chosen.stream)
                way_out.callback(datagrams.close)
            if chosen.page is not None:
                monitor = Monitor(RingReader(chosen.ring), switch)
                page = way_out.enter_context(OperatorPage(monitor, switch, chosen.page))
            print(json.dumps({"page": None if page is None else page.address}), flush=True)
            _attend(reader, switch, page, datagrams)
    except MaskingError as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 2
    return 0


def _attend(reader: RingReader, switch: Switch, page: OperatorPage | None, datagrams: Datagrams | None) -> None:
    """Stay until the loop has ended, and nobody looks at the page any more."""
    ended = None
    while True:
        is_over = reader.is_closed or not is_running(reader.process)
        if datagrams is not None:
            datagrams.send()
        if is_over:
            now = time.monotonic()
            ended = now if ended is None else ended
            if not reader.is_closed:  # killed: it removes no names
                reader.path.unlink(missing_ok=True)
                switch.remove()
            patience = UNREAD if switch.has_tripped and switch.seen else GONE
            is_awaited = page is not None and min(switch.silence, now - ended) < patience
            if not is_awaited or switch.is_acknowledged:
                return
        time.sleep(_LOOK)


if __name__ == "__main__":
    raise SystemExit(main())
