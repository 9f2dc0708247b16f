"""Hostile records and declarations, each in a process with 1 GiB and 10 s: `python -m tests.benchmarks.hostile`.

    python -m tests.benchmarks.hostile [records | declarations] [--sample]

The exit status is 1 if anything is executed, read with wrong numbers, ends in a traceback, takes more than 10 s or
1 GiB, or is refused without its place.
"""

from __future__ import annotations

import argparse
import sys

from tests.hostile.judge import run, summary

KINDS = ("records", "declarations")


def main() -> int:
    """Run the corpus and print a line for each kind, and for each case in which something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kind", nargs="?", choices=KINDS)
    parser.add_argument("--sample", action="store_true", help="one case in seven")
    given = parser.parse_args()
    is_wrong = False
    for kind in KINDS if given.kind is None else (given.kind,):
        verdicts = run(kind, given.sample)
        is_wrong |= any(verdict.wrong for verdict in verdicts)
        print(f"{kind}: {summary(verdicts)}", flush=True)
    return int(is_wrong)


if __name__ == "__main__":
    sys.exit(main())
