"""Rerun the faults of the table, one after the other."""

from __future__ import annotations

import contextlib
import platform
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from masking.errors import PlantMismatchError
from tests.campaigns import batches, files, operators, processes, records, sensors, simulations
from tests.campaigns.bench import Bench
from tests.campaigns.table import Fault, Finding, examine

FAULTS: Final = tuple(
    sorted(
        (
            *batches.FAULTS,
            *sensors.FAULTS,
            *processes.FAULTS,
            *records.FAULTS,
            *files.FAULTS,
            *operators.FAULTS,
            *simulations.FAULTS,
        ),
        key=lambda fault: fault.number,
    )
)


def rerun(
    numbers: Iterable[int] = (), *, is_quick: bool = False, say: Callable[[Finding], None] | None = None
) -> tuple[Finding, ...]:
    """Produce faults on the served twin of a packaged rig, and evaluate each by the plant's own record.

    Args:
        numbers: of the table, where 0 is a run without a fault; all by default.
        is_quick: leave out what takes long: an hour of rest is then a minute, and 1000 cuts are 100.
        say: called with each finding.

    Raises:
        PlantMismatchError: a number is none of the table, or the system is not Linux.
    """
    if sys.platform != "linux":
        raise PlantMismatchError(
            f"{platform.system()} has no limits and signals of processes by which faults are produced; run it on Linux"
        )
    wanted, known = tuple(numbers), {fault.number: fault for fault in FAULTS}
    for number in wanted:
        if number not in known:
            raise PlantMismatchError(f"there is no fault {number}; give numbers from 0 to {max(known)}")
    chosen = [known[number] for number in wanted] or [*FAULTS]
    apart = [fault for fault in chosen if not fault.in_real_time]
    findings: dict[int, Finding] = {}
    with tempfile.TemporaryDirectory(prefix="masking-faults-") as folder, contextlib.ExitStack() as way_out:
        made = threading.local()

        def found(fault: Fault) -> None:
            if not hasattr(made, "bench"):
                made.bench = Bench(Path(folder) / threading.current_thread().name, is_quick=is_quick)
                way_out.callback(made.bench.close)
            findings[fault.number] = examine(fault, made.bench)
            if say is not None:
                say(findings[fault.number])

        if apart:
            found(apart.pop(0))  # what is loaded at first use is loaded here: it must not be by two threads at once
        # In lockstep, two at a time do not disturb one another; in real time they would.
        with ThreadPoolExecutor(2) as pool:
            for one in [pool.submit(found, fault) for fault in sorted(apart, key=lambda fault: not fault.is_long)]:
                one.result()
        for fault in chosen:
            if fault.in_real_time:
                found(fault)
    return tuple(findings[fault.number] for fault in chosen)
