"""Rerun the faults of the table, one after the other."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from masking.errors import PlantMismatchError
from masking.faults import files, operators, processes, records, sensors, simulations
from masking.faults.bench import Bench
from masking.faults.table import Fault, Finding, examine

_NOT_OFFERED: Final = (
    Fault(27, "trip in run 17 of a batch of 100", "cool down, zero check, retry, go on; no silent skip"),
)
FAULTS: Final = tuple(
    sorted(
        (
            *sensors.FAULTS,
            *processes.FAULTS,
            *records.FAULTS,
            *files.FAULTS,
            *operators.FAULTS,
            *simulations.FAULTS,
            *_NOT_OFFERED,
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
        PlantMismatchError: a number is none of the table.
    """
    wanted, known = tuple(numbers), {fault.number: fault for fault in FAULTS}
    for number in wanted:
        if number not in known:
            raise PlantMismatchError(f"there is no fault {number}; give numbers from 0 to {max(known)}")
    findings = []
    with tempfile.TemporaryDirectory(prefix="masking-faults-") as folder:
        bench = Bench(Path(folder), is_quick=is_quick)
        try:
            for fault in [known[number] for number in wanted] or FAULTS:
                findings.append(examine(fault, bench))
                if say is not None:
                    say(findings[-1])
        finally:
            bench.close()
    return tuple(findings)
