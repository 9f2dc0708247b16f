"""Work of a sweep: rows made by this process, or by others on this machine."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Final

from threadpoolctl import threadpool_limits

from masking import process_environment
from masking.app.workflows.sweep_runs import Plan
from masking.errors import MaskingError
from masking.lab.records.table_chunks import Columns

Made = tuple[int, int, Columns, float]  # first row, one more than the last, their columns, and the seconds that it took
Submit = Callable[[int, int], "Future[Made]"]

_SECONDS: Final = 2.0  # that a chunk takes, about
_MOST: Final = 2000  # rows of a chunk
_AHEAD: Final = 2  # chunks for each process

_plans: list[Plan] = []  # of this process, which keeps what a plan has compiled


def made(plan: Plan, first: int, last: int) -> Made:
    """Make some rows."""
    begun = time.perf_counter()
    with threadpool_limits(1):
        columns = plan.rows_of(first, last)
    return first, last, columns, time.perf_counter() - begun


def _begin(path: Path) -> None:
    """Begin a process that makes rows of the plan in a file, and that ends with the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one that started it says when to end
    parent = multiprocessing.parent_process()

    def end() -> None:
        if parent is not None:
            wait_for([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end, daemon=True).start()
    _plans[:] = [pickle.loads(path.read_bytes())]  # noqa: S301  (its parent wrote it)


def _made_here(first: int, last: int) -> Made:
    return made(_plans[0], first, last)


def work(plan: Plan, missing: Sequence[tuple[int, int]], *, workers: int) -> Iterator[Made]:
    """Make ranges of rows, each of whole chains, as chunks that take a second or two each.

    With one worker, this process makes them. Raises a `MaskingError` where another has ended.
    """
    if workers > 1:
        with _processes(plan, workers) as submit:
            yield from _together(plan, missing, submit, _AHEAD * workers)
        return
    sizes = _Sizes(plan.chain)
    for first, last in missing:
        at = first
        while at < last:
            one = made(plan, at, min(last, at + sizes.rows))
            sizes.learn(one[1] - at, one[3])
            yield one
            at = one[1]


class _Sizes:
    """How many rows a chunk has, by what the last ones took."""

    def __init__(self, chain: int) -> None:
        self.chain, self.rows = chain, chain

    def learn(self, rows: int, seconds: float) -> None:
        """Take note of a chunk."""
        wanted = min(_MOST, int(_SECONDS / max(seconds / rows, 1e-9)), 4 * self.rows)
        self.rows = max(1, wanted // self.chain) * self.chain


def _together(plan: Plan, missing: Sequence[tuple[int, int]], submit: Submit, ahead: int) -> Iterator[Made]:
    sizes, pending, left = _Sizes(plan.chain), set[Future[Made]](), [*missing]
    try:
        while left or pending:
            while left and len(pending) < ahead:
                first, last = left.pop(0)
                end = min(last, first + sizes.rows)
                if end < last:
                    left.insert(0, (end, last))
                pending.add(submit(first, end))
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                one = future.result()
                sizes.learn(one[1] - one[0], one[3])
                yield one
    except BrokenProcessPool:
        raise MaskingError(
            "a process of the sweep has ended, perhaps for want of memory. Finished runs are kept: start the same "
            "again, with fewer --workers. In a script of your own, call masking.sweep under "
            "'if __name__ == \"__main__\":'"
        ) from None


@contextmanager
def _processes(plan: Plan, workers: int) -> Iterator[Submit]:
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="masking-") as folder:  # measured: through a pipe, each waits for the last
        path = Path(folder) / "plan"
        path.write_bytes(pickle.dumps(plan))
        with process_environment.safe_start():  # of the process that looks after its locks
            pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(path,))

        def submit(first: int, last: int) -> Future[Made]:
            with _interrupts_later(), process_environment.safe_start():  # of the process that this may start
                return pool.submit(_made_here, first, last)

        try:
            yield submit
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Hold interrupts back while inside; processes that are started here never get any, not even while they load."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
