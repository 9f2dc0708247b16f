"""`python -m tests.benchmarks.answers [SUITE ...] --out FILE`: answers on every suite as JSON lines, and their table.

What is in the file is not run again. `--against` says which answers differ from those of another state. `--without`
leaves out a move of the search: what it changes is what the move is good for; of problems in which the move suggests
nothing `--against` has the answers. `--diagram` draws how often answers of each probability are right.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from masking.errors import MaskingError
from masking.inference.discovery import search
from masking.inference.discovery.explanation import Explanation
from tests.benchmarks.answers import reliability, scoring
from tests.benchmarks.answers.scoring import Line
from tests.benchmarks.answers.suites import SUITES, Problem

SUITES_HELP = f"of {', '.join(SUITES)}, all by default; second:240 and problems:500 are as many as that"


def suite(text: str) -> Iterator[Problem]:
    """Return the problems of a suite, as many as stand behind its name."""
    name, _, count = text.partition(":")
    return SUITES[name](*([int(count)] if count else []))


@contextmanager
def moving(moves: Iterable[search.Move]) -> Iterator[set[str]]:
    """Search with these moves alone, and give the set of those that suggest something."""
    every, active = search.MOVES, set[str]()

    def noted(move: search.Move, *given: Any) -> list[Explanation]:
        if made := move(*given):
            active.add(move.__name__)
        return made

    search.MOVES = tuple(partial(noted, move) for move in moves)
    try:
        yield active
    finally:
        search.MOVES = every


def run(problem: Problem, moves: Iterable[search.Move]) -> Line:
    """Return the answer to a problem that a search with some moves gives; what ends in an error is one, too."""
    with moving(moves) as active:
        line = answer(problem)
        return replace(line, moves=tuple(sorted(active)))


def answer(problem: Problem) -> Line:
    """Return the answer to a problem."""
    line, begin = Line(problem.suite, problem.name, problem.truth, ""), time.process_time()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            discover = problem.prepare(Path(folder))
            begin = time.process_time()
            found = discover()
            taken = time.process_time() - begin
            line = scoring.answered(line, found, problem.judge(found))
        except MaskingError as error:
            taken = time.process_time() - begin
            line = replace(line, verdict="refused", error=" ".join(str(error).split()))
        except Exception:
            taken = time.process_time() - begin
            line = replace(line, verdict="traceback", error=" / ".join(traceback.format_exc().splitlines()[-5:]))
    return replace(line, seconds=round(taken, 1))


def main() -> int:
    """Run what has not been run, and print the table of all that is in the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("suites", nargs="*", metavar="SUITE", help=SUITES_HELP)
    parser.add_argument("--only", default="", metavar="TEXT", help="only problems with this text in their names")
    parser.add_argument("--part", default="1/1", metavar="K/N", help="every Nth problem of a suite, from the Kth on")
    parser.add_argument("--seconds", type=float, metavar="S", help="begin no problem after so many seconds")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="of the answers, one JSON a line")
    parser.add_argument("--against", type=Path, metavar="FILE", help="answers of another state")
    parser.add_argument("--diagram", type=Path, metavar="FILE", help="of how often answers are right, a picture")
    parser.add_argument("--without", choices=[move.__name__ for move in search.MOVES], help="move that is left out")
    chosen = parser.parse_args()
    moves = [move for move in search.MOVES if move.__name__ != chosen.without]
    try:
        suites = [suite(text) for text in chosen.suites or SUITES]
    except (KeyError, TypeError, ValueError):
        parser.error(f"the suites are {SUITES_HELP}")
    k, n = map(int, chosen.part.split("/"))
    until = time.monotonic() + (chosen.seconds or float("inf"))
    known, others = scoring.read(chosen.out), scoring.read(chosen.against) if chosen.against else {}
    wanted = {}
    for problems in suites:
        for number, problem in enumerate(problems):
            if number % n != k - 1 or chosen.only not in problem.name:
                continue
            key = problem.suite, problem.name
            if problem.missing:
                print(f"{problem.suite} {problem.name}: left out, {problem.missing}", file=sys.stderr)
            elif key in known:
                wanted[key] = known[key]
            elif chosen.without and key in others and chosen.without not in others[key].moves:
                wanted[key] = others[key]
            elif time.monotonic() < until:
                wanted[key] = line = run(problem, moves)
                with chosen.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(line)) + "\n")
                print(f"{line.status:8s}{line.suite} {line.name}: {line.error or line.said}; {line.seconds:.0f} s",
                      file=sys.stderr, flush=True)  # fmt: skip
    print("\n".join([*scoring.table(wanted.values()), "", *reliability.table([*wanted.values()])]))
    if chosen.diagram is not None:
        reliability.diagram([*wanted.values()], chosen.diagram)
    if chosen.against is not None:
        print("\n".join(["", *scoring.differences(wanted, others)]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
