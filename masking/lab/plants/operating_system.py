"""Time, priority and signals to end that `runs.realtime` and `plants.serve` ask of the operating system.

It decides nothing: late ticks go to `safety_chain.Chain.time`, the operator's stop comes by `records.stop_switch`.
Linux is tested. Windows and macOS are not tested: there a wait ends in a short loop, since a sleep may be late.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, final

Stop = Callable[[], bool]

POLL: Final = 0.1  # seconds between looks at `stop` while nothing happens
PRIORITY: Final = 50
STOPPING: Final = tuple(  # Windows has no SIGHUP, and SIGBREAK is only there
    number
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if isinstance(number := getattr(signal, name, None), signal.Signals)
)
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_HIGH_PRIORITY_CLASS: Final = 0x80
_EARLY_NS: Final = 0 if sys.platform == "linux" else 500_000  # what time.sleep may be late where it is not exact


@final
class Deadlines:
    """Instants 1 / rate apart on the monotonic clock, from now on; `missed` are those left out, never made up for."""

    def __init__(self, rate: float) -> None:
        self.missed = 0
        self._period = 1e9 / rate
        self._start, self._tick = time.monotonic_ns(), 0

    def wait(self, stop: Stop, every: float = POLL) -> float:
        """Wait for the next instant, or until asked to stop; return how late it was missed or met, in seconds.

        Where it passed more than a period ago, it and those after it are left out up to the next one to come. `stop` is
        looked at once, and then every `every` seconds while there is time.
        """
        self._tick += 1
        late = time.monotonic_ns() - self._instant
        if late > self._period:
            left_out = int(late // self._period) + 1
            self._tick += left_out
            self.missed += left_out
        while (now := time.monotonic_ns()) < self._instant and not stop():
            until = min(self._instant, now + int(every * 1e9))
            time.sleep(max(0, until - time.monotonic_ns() - _EARLY_NS) * 1e-9)
            while time.monotonic_ns() < until:
                pass
        return max(0, late, now - self._instant) * 1e-9

    @property
    def _instant(self) -> int:
        return self._start + int(self._tick * self._period)


@contextlib.contextmanager
def undisturbed(*, priority: bool) -> Iterator[str]:
    """Keep the garbage collector, and with `priority` also other processes and swapping, away while inside.

    Gives a sentence about what was not permitted; empty where all was.
    """
    missing = list[str]()
    with contextlib.ExitStack() as way_out:
        if gc.isenabled():
            gc.disable()  # without a collection before, which takes seconds in a large process
            way_out.callback(gc.enable)
        if sys.platform == "linux" and priority:
            library = ctypes.CDLL(None)
            way_out.callback(os.sched_setscheduler, 0, os.sched_getscheduler(0), os.sched_getparam(0))
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
            except OSError:
                missing.append("real-time priority (ulimit -r)")
            # What is in use stays in memory. Not MCL_FUTURE: under a limit it makes an allocation fail in mid-run. With
            # MCL_ONFAULT the unused parts of libraries are left alone; measured: 2.8 s without it where pyarrow is
            # loaded.
            if library.mlockall(_MCL_CURRENT | _MCL_ONFAULT):
                missing.append("locked memory (ulimit -l)")
            way_out.callback(library.munlockall)
        elif sys.platform == "win32" and priority:  # not tested
            kernel = ctypes.windll.kernel32
            process = kernel.GetCurrentProcess()
            way_out.callback(kernel.SetPriorityClass, process, kernel.GetPriorityClass(process))
            if not kernel.SetPriorityClass(process, _HIGH_PRIORITY_CLASS):
                missing.append("high priority")
        elif priority:
            missing.append("real-time priority on this system")
        yield f"not permitted here: {', '.join(missing)}; ticks may be late" if missing else ""


@contextlib.contextmanager
def asked_to_stop() -> Iterator[Stop]:
    """Function that says whether a signal of `STOPPING` came; they do nothing else while inside.

    A signal that is ignored, as under nohup, stays so. Outside the main thread no signal is looked at.
    """
    came: list[int] = []
    former: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in STOPPING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                former[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in former.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def signal_main_thread(number: int) -> None:
    """Send a signal to the main thread, so that it ends what that waits for, where the system can do so."""
    if sys.platform == "win32":  # not tested
        _thread.interrupt_main(number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)
