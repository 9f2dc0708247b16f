"""Work of a sweep: rows made by this process, or by others on this machine."""

from __future__ import annotations

import ast
import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from types import ModuleType
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
_SCRIPT: Final = b"__main__"  # where a pickle has functions of the script that runs
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
            "again, with fewer --workers"
        ) from None


@contextmanager
def _processes(plan: Plan, workers: int) -> Iterator[Submit]:
    context, content = multiprocessing.get_context("spawn"), _pickled(plan)
    with tempfile.TemporaryDirectory(prefix="masking-") as folder:  # measured: through a pipe, each waits for the last
        path = Path(folder) / "plan"
        path.write_bytes(content)
        with process_environment.safe_start():  # of the process that looks after its locks
            pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(path,))

        def submit(first: int, last: int) -> Future[Made]:
            # of the process that this may start
            with _interrupts_later(), process_environment.safe_start(), _script(is_imported=_SCRIPT in content):
                return pool.submit(_made_here, first, last)

        try:
            yield submit
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _pickled(plan: Plan) -> bytes:
    """Plan for other processes; a `MaskingError` where these could not import its functions."""
    remedy = "write it into a module of its own and import it, or make the runs in this process, with workers=1"
    try:
        content = pickle.dumps(plan)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise MaskingError(f"other processes cannot import a function of this sweep ({error}); {remedy}") from None
    script = sys.modules["__main__"]
    file = str(getattr(script, "__file__", ""))
    if _SCRIPT in content and not Path(file).is_file():
        raise MaskingError(f"other processes cannot import a function of a notebook or a prompt; {remedy}")
    if _SCRIPT in content and _calls_when_imported(script, file):
        raise MaskingError(
            f"{file} begins a sweep when it is imported, as other processes do for its function; call masking.sweep "
            f"under 'if __name__ == \"__main__\":', or, of the function: {remedy}"
        )
    return content


def _calls_when_imported(script: ModuleType, file: str) -> bool:
    """Whether a statement of a script that runs now stands outside of `if __name__ == "__main__":`."""
    frames = (frame for frame, _ in traceback.walk_stack(None) if frame.f_globals is vars(script))
    lines = [frame.f_lineno for frame in frames if frame.f_code.co_name == "<module>"]
    with contextlib.suppress(OSError, SyntaxError, ValueError):  # its text is not to be had
        conditions = [one for one in ast.parse(Path(file).read_bytes()).body if isinstance(one, ast.If)]
        guards = [one for one in conditions if "__name__" in ast.unparse(one.test)]
        return any(not any(one.lineno <= line <= (one.end_lineno or 0) for one in guards) for line in lines)
    return False


@contextmanager
def _script(*, is_imported: bool) -> Iterator[None]:
    """Let processes that are started here import the script that runs, or nothing in place of it."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = (
        script if is_imported else ModuleType("__main__")
    )  # of which multiprocessing finds no file
    try:
        yield
    finally:
        sys.modules["__main__"] = script


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
