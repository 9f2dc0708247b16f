"""One row per comparison, one table for all, and the clock that the comparisons share."""

from __future__ import annotations

import json
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

HEAD = ("what", "ours", "theirs", "ratio", "aim", "verdict")
WIDTHS = (72, 10, 10, 10, 10, 7)
PACKAGES = ("masking", "numba", "numpy", "scipy", "sympy", "heyoka", "casadi")
is_tiny = False  # whether it is only tried whether all runs


def few(count: int, least: int = 1) -> int:
    """Return how often something is done, which is seldom where it is only tried."""
    return min(count, least) if is_tiny else count


@dataclass(frozen=True)
class Row:
    """One line of the table: `ratio` is what the aim speaks of; `note` says how it was measured."""

    what: str
    ours: str = ""
    theirs: str = ""
    ratio: float | None = None
    unit: str = "x"
    aim: str = ""
    verdict: str = ""
    note: str = ""


def judged(what: str, ours: str, theirs: str, ratio: float, *, at_least: float, note: str = "") -> Row:
    """Give a row that aims at a ratio of at least so much."""
    verdict = "reached" if ratio >= at_least else "short"
    return Row(what, ours, theirs, ratio, "x", f">= {at_least:g} x", verdict, note)


def limited(what: str, ours: str, theirs: str, value: float, *, at_most: float, unit: str = "x", note: str = "") -> Row:
    """Give a row that aims at a ratio or a time of at most so much."""
    verdict = "reached" if value <= at_most else "short"
    return Row(what, ours, theirs, value, unit, f"<= {at_most:g} {unit}", verdict, note)


def told(what: str, ours: str, theirs: str = "", ratio: float | None = None, note: str = "") -> Row:
    """Give a row without an aim."""
    return Row(what, ours, theirs, ratio, note=note)


def missing(what: str, why: str) -> Row:
    """Give the row of something that could not be measured."""
    return Row(what, verdict=f"not measured: {why}")


def line(row: Row | None = None) -> str:
    """Print a row, or the names of the columns, its note in a line of its own."""
    ratio = "" if row is None or row.ratio is None else f"{row.ratio:.4g} {row.unit}"
    cells = HEAD if row is None else (row.what, row.ours, row.theirs, ratio, row.aim, row.verdict)
    note = f"\n    {row.note}" if row is not None and row.note else ""
    return "  ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=True)).rstrip() + note


def write(rows: Sequence[Row], path: Path) -> None:
    """Write rows and what they were measured on as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "machine": {"processor": processor(), "python": platform.python_version(), "system": platform.platform()},
        "versions": versions(),
        "rows": [asdict(row) for row in rows],
    }
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def versions() -> dict[str, str]:
    """Give the versions of all that is compared."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def processor() -> str:
    """Give the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def interleaved(
    contenders: Mapping[str, Callable[[], object]], rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[str, list[float]]:
    """Time contenders in turn, A B C A B C ..., so that a noisy machine disturbs all alike; seconds of each round.

    These are of the processor: other programs that keep it busy count as nothing.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            begin = clock()
            run()
            seconds[name].append(clock() - begin)
    return seconds


def ratio(seconds: Mapping[str, Sequence[float]], theirs: str, ours: str) -> float:
    """Give the median over rounds of their time in units of ours in the same round."""
    return statistics.median(t / o for t, o in zip(seconds[theirs], seconds[ours], strict=True))


def milliseconds(seconds: Sequence[float]) -> str:
    """Print the shortest time."""
    return f"{min(seconds) * 1e3:.4g} ms"
