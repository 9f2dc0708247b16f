"""Child process: a module of this package in an interpreter of its own, and a supervisor that replaces it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Collection, Sequence
from typing import Final, final

from masking import process_environment

_DIES_WITH_PARENT: Final = 1  # PR_SET_PDEATHSIG


@final
class Child:
    """A module of this package, run as `python -P -m` runs it, in a minimal environment; what it prints is read here.

    It inherits the files `handles`; with `is_apart` it has a session of its own, which no signal of the terminal
    reaches, and with `is_quiet` its errors are not shown there. With `nice` it runs behind others, as far as `nice(1)`
    says, and takes no real-time priority from this one. An OSError where no process can be started.
    """

    def __init__(
        self,
        module: str,
        arguments: Sequence[str],
        *,
        is_apart: bool = True,
        is_quiet: bool = False,
        nice: int | None = None,
        handles: Collection[int] = (),
    ) -> None:
        self._process = subprocess.Popen(  # noqa: S603  # this program itself
            [sys.executable, "-P", "-m", module, *arguments], env=process_environment.minimal(),
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if is_quiet else None, start_new_session=is_apart, pass_fds=handles, text=True,
        )  # fmt: skip
        self.pid = self._process.pid
        if nice is not None and sys.platform != "win32":
            with contextlib.suppress(OSError):  # it has ended already
                if sys.platform == "linux":
                    os.sched_setscheduler(self.pid, os.SCHED_OTHER, os.sched_param(0))
                os.setpriority(os.PRIO_PROCESS, self.pid, nice)

    @property
    def is_alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def line(self) -> str:
        """Next line that it prints, without its end; empty where it has ended."""
        assert self._process.stdout is not None  # noqa: S101  # a pipe
        return self._process.stdout.readline().rstrip("\n")

    def wait(self, limit: float | None = None) -> int:
        """Exit status, once it has ended, which may take `limit` s; its output is closed."""
        status = self._process.wait(limit)
        if self._process.stdout is not None:
            self._process.stdout.close()
        return status

    def output(self, limit: float) -> str:
        """All that it prints until it ends; an exception here, such as an interrupt, ends it as `end` does."""
        try:
            return self._process.communicate()[0]
        except BaseException:
            self.end(limit)
            raise

    def end(self, limit: float) -> int:
        """Ask it to end, kill it after `limit` s, and return its exit status."""
        self._process.send_signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.communicate(timeout=limit)
        self._process.kill()
        return self.wait()


@final
class Supervisor:
    """A thread that waits for the end of a child, which costs nothing else, and replaces one that failed.

    There are `most` children at most, the first among them, and none after the exit statuses `final`. `child` is the
    one that runs, or ended in order, and None once one has failed and is not replaced; `failures` are the exit statuses
    of those that failed.
    """

    def __init__(
        self, child: Child, start: Callable[[], Child], *, most: int, final: Collection[int], name: str
    ) -> None:
        self.child: Child | None = child
        self.failures: tuple[int, ...] = ()
        self._start, self._most, self._final = start, most, final
        self._thread = threading.Thread(target=self._attend, name=name, daemon=True)
        self._thread.start()

    def join(self, limit: float) -> None:
        """Wait for the end of the last child, `limit` s at most."""
        self._thread.join(limit)

    def _attend(self) -> None:
        while self.child is not None and (status := self.child.wait()) != 0:
            self.failures += (status,)
            is_replaced = status not in self._final and len(self.failures) < self._most
            try:
                self.child = self._start() if is_replaced else None
            except OSError:  # no process can be started
                self.child = None


def end_with_parent() -> None:
    """Be asked to end, by SIGTERM, once the process that started this one has ended; of Linux alone."""
    if sys.platform == "linux":
        parent = os.getppid()
        ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGTERM)
        if os.getppid() != parent:
            os.kill(os.getpid(), signal.SIGTERM)
