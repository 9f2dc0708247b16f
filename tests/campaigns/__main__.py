"""`python -m tests.campaigns faults [--quick] [--json] [NUMBER ...]`: the faults of the table, or some of them.

`python -m tests.campaigns calls [--quick] [NUMBER]`: so many hostile calls of machine code, by default 100000.

The exit status is 1 where a criterion is not met, and 2 where a number is none of the table.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict

from masking.errors import PlantMismatchError
from tests.campaigns import hostile_calls, table
from tests.campaigns.rerun import rerun


def main(arguments: list[str] | None = None) -> int:
    """Produce faults, print what was expected and measured, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns", description=__doc__)
    parser.add_argument("campaign", choices=["faults", "calls"])
    parser.add_argument("numbers", metavar="NUMBER", type=int, nargs="*", help="0 is a run without (default: all)")
    parser.add_argument("--quick", action="store_true", help="an hour at rest is a minute, 1000 cuts are 100")
    parser.add_argument("--json", action="store_true", help="print JSON")
    chosen = parser.parse_args(arguments)
    if chosen.campaign == "calls":
        outcome = hostile_calls.run((chosen.numbers or [100_000])[0], seed=1, is_quick=chosen.quick)
        print(outcome.text())
        return int(bool(outcome.ended))
    began = time.monotonic()
    say = None if chosen.json else (lambda finding: print(f"fault {finding.number}", file=sys.stderr))
    try:
        findings = rerun(chosen.numbers, is_quick=chosen.quick, say=say)
    except PlantMismatchError as error:
        print(error, file=sys.stderr)
        return 2
    seconds = time.monotonic() - began
    rows = [asdict(finding) | {"passes": finding.passes} for finding in findings]
    print(json.dumps({"faults": rows, "seconds": round(seconds, 1)}) if chosen.json else table.text(findings, seconds))
    return int(not all(finding.passes for finding in findings))


if __name__ == "__main__":
    sys.exit(main())
