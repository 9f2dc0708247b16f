"""`python -m tests.benchmarks.laws`: laws that the dictionary has and has not, and how sure the answers are."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from tests.benchmarks.laws import scoring


def main() -> None:
    """Run the cases that have not been run, and print the scores of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1, metavar="N", help="first seed")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds of each law")
    parser.add_argument("--only", default="", metavar="TEXT", help="only cases with this text in their names")
    parser.add_argument("--out", type=Path, default=Path("results/bench-laws/outcomes.jsonl"), metavar="FILE")
    chosen = parser.parse_args()
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    cases = scoring.cases(chosen.first, chosen.seeds)
    known = read(chosen.out)
    for case in cases:
        if chosen.only in case.name and case.name not in known:
            made = known[case.name] = scoring.outcome(case)
            with chosen.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(made.as_dict()) + "\n")
            print(
                made.case,
                made.verdict,
                made.answer,
                f"{made.probability:.2f}",
                f"{made.left:.2f}",
                made.form,
                flush=True,
            )
    wanted = [known[case.name] for case in cases if case.name in known]
    for what, value in scoring.summary(wanted):
        print(f"{what:55s} {value}")
    for mean, right, many in scoring.reliability(wanted):
        print(f"  said {mean:.2f}, right {right:.2f} ({many})")


def read(path: Path) -> dict[str, scoring.Outcome]:
    """Return the outcomes in a file by the names of their cases."""
    if not path.exists():
        return {}
    every = [scoring.Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {one.case: one for one in every}


if __name__ == "__main__":
    main()
