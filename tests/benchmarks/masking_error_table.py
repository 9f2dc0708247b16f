"""Masking error on the imperfect rig: `python -m tests.benchmarks.masking_error_table`.

Every virtual system with a packaged experiment, on the full twin of the rig for as long as in its figure, by the
thesis' way (the linear model, differences of positions) and by a disturbance observer that knows the measured springs.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator

from masking.errors import MaskingError
from masking.lab.records.recording import Recording
from masking.lab.runs.experiment import Experiment

SYSTEMS = (
    "duffing", "duffing_enoc", "discs", "discs_eccentric", "discs_enoc", "huygens", "setup_identical", "setup_undamped",
)  # fmt: skip
WAYS = {
    "thesis": {"rate": "1 kHz", "observer": "differences"},
    "disturbance": {"rate": "1 kHz", "observer": "disturbance", "model": "setup_springs"},
}


def experiment(name: str, way: str) -> Experiment:
    """Return a packaged experiment on the full twin, controlled in one of the ways."""
    return Experiment.load(name, plant="tue_rig").changed(controller=WAYS[way], record=None)


def _limited(found: Experiment, run: Recording) -> float:
    """Return the part of the samples in which an actuator is asked for more than it can give."""
    names = found.twin.actuators
    over = [abs(run[f"demanded.{n}"] - run[f"input.{n}"]) > 1e-12 for n in names]
    return float(sum(over).astype(bool).mean())


def rows() -> Iterator[str]:
    """Yield the lines of a Markdown table."""
    yield "| system | duration | way | chi of each coordinate | largest command, V | limited, part of the time | s |"
    yield "|---|---|---|---|---|---|---|"
    for name in SYSTEMS:
        for way in WAYS:
            clock = time.perf_counter()
            found = experiment(name, way)
            head = f"| {name} | {found.declaration.duration:g} | {way} |"
            try:
                run = found.run()
            except MaskingError as error:
                yield f"{head} {error} | | | {time.perf_counter() - clock:.0f} |"
                continue
            chi = ", ".join(f"{c} {value:.3g}" for c, value in run.manifest["masking_error"].items())
            largest = max(abs(run[f"demanded.{n}"]).max() for n in found.twin.actuators)
            yield f"{head} {chi} | {largest:.3g} | {_limited(found, run):.3g} | {time.perf_counter() - clock:.0f} |"


def main() -> None:
    """Print the table as it comes."""
    clock = time.perf_counter()
    with tempfile.TemporaryDirectory() as cache:
        os.environ.setdefault("MASKING_CACHE", cache)
        for row in rows():
            print(row, flush=True)
    print(f"measured in {time.perf_counter() - clock:.0f} s, compilation included", file=sys.stderr)


if __name__ == "__main__":
    main()
