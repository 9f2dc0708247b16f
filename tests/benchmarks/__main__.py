"""`python -m tests.benchmarks`: measure all, print one table, write results/bench.json."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from importlib import import_module
from pathlib import Path

from tests.benchmarks import table

PARTS = ("trajectory", "ensembles", "sampled", "twin", "step", "loop", "authentication", "identification", "start")


def main() -> None:
    """Measure the chosen parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"what to measure, of {', '.join(PARTS)}; all by default"
    )
    parser.add_argument("--json", type=Path, default=Path("results/bench.json"), metavar="FILE")
    chosen = parser.parse_args()
    parts = chosen.parts or PARTS
    if not set(parts) <= set(PARTS):
        parser.error(f"the parts are {', '.join(PARTS)}")
    rows: list[table.Row] = []
    with tempfile.TemporaryDirectory() as cache:
        os.environ.setdefault("MASKING_CACHE", cache)
        for part in parts:
            print(f"measuring: {part} ...", file=sys.stderr, flush=True)
            rows += import_module(f"tests.benchmarks.{part}").rows()
    print(table.text(rows))
    table.write(rows, chosen.json)
    print(f"\nwritten to {chosen.json}")


if __name__ == "__main__":
    main()
