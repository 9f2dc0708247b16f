"""Print what hides in the records: `python -m tests.benchmarks.hidden [own|light] [family] [seconds]`."""

from __future__ import annotations

import sys
from typing import get_args

from tests.benchmarks.hidden.cases import FAMILIES, Family, cases
from tests.benchmarks.hidden.generate import gaps
from tests.benchmarks.hidden.rig import Damping


def main(arguments: list[str]) -> None:
    """Print one line per case: effect, place, strength, parameters, chi of each reading, and what a fit leaves of it.

    The last three columns are the chi left once small changes of the eleven parameters have explained what they can.
    """
    dampings: tuple[Damping, ...] = get_args(Damping)
    damping: Damping = next((one for one in dampings if one in arguments), "own")
    family: Family = next((one for one in FAMILIES if one in arguments), "effect")
    seconds = next((float(one) for one in arguments if one.replace(".", "", 1).isdigit()), 20.0)
    made = cases(family, noise=1e-4, damping=damping, base_error=0.0, seconds=seconds)
    found, left = gaps(made, seconds), gaps(made, seconds, left=True)
    print(
        f"{'effect':22s} {'place':9s} {'strength':8s} {'chi s1':>7s} {'s2':>7s} {'s3':>7s} {'left s1':>8s} s2      s3"
    )
    for case, chi, rest in zip(made, found, left, strict=True):
        values = "  ".join(f"{name} {value:.4g}" for name, value in case.parameters.items())
        if case.second:
            values += f"  and {case.second.effect} at {case.second.at}"
        numbers = " ".join(f"{x:7.4f}" for x in (*chi, *rest))
        print(f"{case.effect or case.family:22s} {case.at:9s} {case.strength or '':8s} {numbers}  {values}")


if __name__ == "__main__":
    main(sys.argv[1:])
