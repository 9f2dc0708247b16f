"""`python -m tests.benchmarks`: measure all, print and write each row as it is made, to results/bench.json."""

from __future__ import annotations

import argparse
import os
import tempfile
from importlib import import_module
from pathlib import Path

from tests.benchmarks import table

PARTS = (
    "trajectory",
    "ensembles",
    "many",
    "sampled",
    "twin",
    "step",
    "loop",
    "authentication",
    "identification",
    "start",
)


def main() -> None:
    """Measure the chosen parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"what to measure, of {', '.join(PARTS)}; all by default"
    )
    parser.add_argument("--tiny", action="store_true", help="try whether all runs; times mean nothing")
    parser.add_argument("--json", type=Path, default=Path("results/bench.json"), metavar="FILE")
    chosen = parser.parse_args()
    parts = chosen.parts or PARTS
    if not set(parts) <= set(PARTS):
        parser.error(f"the parts are {', '.join(PARTS)}")
    table.is_tiny = chosen.tiny
    rows: list[table.Row] = []
    with tempfile.TemporaryDirectory() as cache:
        os.environ.setdefault("MASKING_CACHE", cache)
        print(table.line(), flush=True)
        for part in parts:
            for row in import_module(f"tests.benchmarks.{part}").rows():
                rows.append(row)
                print(table.line(row), flush=True)
                table.write(rows, chosen.json)
    print(f"\nwritten to {chosen.json}")


if __name__ == "__main__":
    main()
