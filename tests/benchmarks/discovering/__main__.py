"""`python -m tests.benchmarks.discovering`: run the suite, print one line a record, write the page and its pictures."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from tqdm import tqdm

from tests.benchmarks import mujoco_records
from tests.benchmarks.discovering import page, running, scoring, sindy, suite, summary


def main() -> None:
    """Run what has not been run, then tell all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="about 30 records instead of more than a thousand")
    parser.add_argument("--first", type=int, metavar="N", help="only the first N records of each line of the suite")
    parser.add_argument("--only", default="", metavar="TEXT", help="only records with this text in their names")
    parser.add_argument("--page", action="store_true", help="run nothing: write the page of what has been run")
    parser.add_argument("--out", type=Path, default=Path("results/bench-discovery"), metavar="FOLDER")
    chosen = parser.parse_args()
    size: suite.Size = "quick" if chosen.quick else "full"
    if not sindy.version():
        print("PySINDy is not installed here: its columns stay empty", file=sys.stderr)
    print("drawing what is hidden ...", file=sys.stderr, flush=True)
    cases = running.every_case(suite.SUITES[size], chosen.out)
    if not mujoco_records.version():
        print("MuJoCo is not installed here: its records are left out", file=sys.stderr)
        cases = [case for case in cases if case.family != "mujoco"]
    if chosen.first is not None:
        seen: dict[tuple[str, float, str], int] = {}
        few = []
        for case in cases:
            line = (case.family, case.noise, case.damping)
            seen[line] = seen.get(line, 0) + 1
            few += [case] if seen[line] <= chosen.first else []
        cases = few
    cases = [case for case in cases if chosen.only in case.name]
    path, digests = chosen.out / "outcomes.jsonl", running.sources()
    if not chosen.page:
        kept = suite.read(path)
        wanted = [key for case in cases for key in running.keys(case, digests).values()]
        with tqdm(total=len(wanted), initial=sum(key in kept for key in wanted), unit="run", smoothing=0.05) as bar:
            for case, outcome in running.run(cases, path, digests):
                result = summary.Result.of(case, outcome)
                bar.write(line_of(result))
                bar.update()
    outcomes = suite.read(path)
    results = {
        tool: [
            summary.Result.of(case, outcomes[key])
            for case in cases
            if (key := running.keys(case, digests).get(tool, "")) in outcomes
        ]
        for tool in running.TOOLS
    }
    for row in summary.bars(results["masking"], results["pysindy"]):
        print(row.text())
    written = page.write(chosen.out, results["masking"], results["pysindy"], len(cases), digests)
    print(f"\nwritten to {written}")


def line_of(result: summary.Result) -> str:
    """Say in one line how a record went."""
    left = "" if result.left is None else f"gap/noise {result.left:.3f}"
    mark = "ok " if result.score.right else "BAD"
    tool = "" if result.tool == "masking" else f"[{result.tool}] "
    return f"{mark} {tool}{result.case.name}: {scoring.shortened(str(result.answer))} {left} {result.seconds:.0f} s"


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        main()
    except KeyboardInterrupt:
        print("\ninterrupted: what was done is kept; start again to go on", file=sys.stderr)
        sys.exit(130)
