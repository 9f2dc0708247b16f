"""`python -m tests.benchmarks.problems`: random problems; what ends in a traceback, and how sure right answers are."""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

import masking
from masking.errors import MaskingError
from masking.inference.discovery.discovery_result import Discovery
from tests.benchmarks.laws.scoring import SURE, brier, reliability
from tests.benchmarks.problems.drawn import Problem, drawn

HELD_OUT = 0.3  # part of each record that is unseen
LONG = 180.0  # s that no answer may take
SAME = 0.02  # relative difference of errors that are the same


@dataclass(frozen=True)
class Outcome:
    """What discovery made of a problem.

    Args:
        seed: of the problem.
        words: what it is.
        truth: what is hidden, in words.
        answer: verdict and causes; what was refused, or the end of a traceback.
        kind: 'answer', 'refused' or 'traceback'.
        probability: of the answer; None where it says none.
        is_right: whether the answer is.
        none: probability of none of the names.
        before, after: relative error of the worst sensor on unseen data, over the noise.
        again: error of the written model when the estimation record is simulated again, over the stated one; None
            where nothing is written.
        seconds, processor: wall clock and processor time of the answer.
    """

    seed: int
    words: str
    truth: str
    answer: str
    kind: str = "answer"
    probability: float | None = None
    is_right: bool = False
    none: float = 0.0
    before: float = 0.0
    after: float = 0.0
    again: float | None = None
    seconds: float = 0.0
    processor: float = 0.0


def outcome(seed: int) -> Outcome:
    """Return what discovery makes of a problem."""
    problem = drawn(seed)
    truth = " + ".join(f"{name} at {places[0]}" for name, places in problem.truth) or "nothing"
    made = Outcome(seed, problem.words, truth, "")
    with tempfile.TemporaryDirectory() as name:
        folder, count = Path(name), len(problem.columns["t"])
        (folder / "model.yaml").write_text(problem.model)
        (folder / "plant.yaml").write_text(problem.plant)
        first = round((1.0 - HELD_OUT) * count)
        for part, rows in (("train", slice(first)), ("unseen", slice(first, None))):
            np.savez(folder / f"{part}.npz", **{key: column[rows] for key, column in problem.columns.items()})
        begin, used = time.perf_counter(), time.process_time()
        try:
            found = masking.discover(
                folder / "train.npz", plant=folder / "plant.yaml", validation=folder / "unseen.npz", out=folder / "out"
            )
        except MaskingError as error:
            made = replace(made, kind="refused", answer=" ".join(str(error).split()))
        except Exception:
            made = replace(made, kind="traceback", answer=" | ".join(traceback.format_exc().splitlines()[-5:]))
        else:
            made = _answered(made, problem, found)
        made = replace(
            made, seconds=round(time.perf_counter() - begin, 1), processor=round(time.process_time() - used, 1)
        )
        if made.kind == "answer" and (folder / "out" / "plant.yaml").exists():
            stated, part = found.simulation_error.estimation[1], found.problem
            if found.law is not None:
                stated, part = found.law.error[0], found.law.free.problem
            if not part.interval:  # errors in shooting intervals say nothing of the whole record
                try:
                    chi = masking.simulate(folder / "out" / "plant.yaml", folder / "train.npz").chi
                except MaskingError:
                    chi = dict.fromkeys(stated, math.inf)
                made = replace(made, again=max(chi[name] / stated[name] for name in stated))
    return made


def _answered(made: Outcome, problem: Problem, found: Discovery) -> Outcome:
    """Return an outcome with an answer."""
    named = [one for one in found.effects if one.name != "quantisation"]
    causes = [(one.name, one.on) for one in named if one.name in found.twin.dictionary]
    words = f"{found.verdict}: {' + '.join(f'{name} at {on}' for name, on in causes) or 'nothing'}"
    if found.law is not None:
        words += f"; law in {found.law.place}"
    is_open = found.verdict == "unknown"
    said = named[-1].probability if named else None
    floor = found.simulation_error.validation_noise_floor
    before, after = found.simulation_error.validation
    after = after if found.law is None else found.law.error[1]
    return replace(
        made,
        answer=words,
        probability=found.none_of_these if is_open else said,
        is_right=not problem.has_name if is_open else problem.is_right(causes),
        none=found.none_of_these,
        before=max(before[name] / floor[name] for name in floor),
        after=max(after[name] / floor[name] for name in floor),
    )


def summary(outcomes: Sequence[Outcome]) -> list[str]:
    """Return what is measured, in lines."""
    answers = [one for one in outcomes if one.kind == "answer"]
    said = [one for one in answers if one.probability is not None]
    sure = [one for one in said if one.probability >= SURE]
    again = [one.again for one in answers if one.again is not None]
    quantiles = np.quantile([one.processor for one in outcomes], (0.5, 0.95, 1.0))

    def share(those: Sequence[bool]) -> str:
        return f"{sum(those)} of {len(those)}"

    lines = [
        f"problems {len(outcomes)}: {sum(one.kind == 'traceback' for one in outcomes)} tracebacks, "
        f"{sum(one.kind == 'refused' for one in outcomes)} refused, "
        f"{sum(one.seconds > LONG for one in outcomes)} longer than {LONG:g} s",
        f"right answers: {share([one.is_right for one in answers])}",
        f"no worse than declared on unseen data: {share([one.after <= 1.02 * one.before for one in answers])}",
        f"simulated again as stated: {share([ratio <= 1.0 + SAME for ratio in again])}",
        f"answers of {100 * SURE:g} % and more that are right: {share([one.is_right for one in sure])}",
        f"Brier score: {brier(said):.3f} of {len(said)}",
        f"processor seconds, median, 95 %, most: {', '.join(f'{value:.0f}' for value in quantiles)}",
    ]
    return lines + [f"  said {mean:.2f}, right {right:.2f} ({many})" for mean, right, many in reliability(said)]


def main() -> None:
    """Run the problems that have not been run, and print what is measured over all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1, metavar="N", help="first seed")
    parser.add_argument("--count", type=int, default=20, metavar="N", help="number of problems")
    parser.add_argument("--out", type=Path, default=Path("results/bench-problems/outcomes.jsonl"), metavar="FILE")
    chosen = parser.parse_args()
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    known = read(chosen.out)
    for seed in range(chosen.first, chosen.first + chosen.count):
        if seed not in known:
            made = known[seed] = outcome(seed)
            with chosen.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(made)) + "\n")
            print(made, flush=True)
    print("\n".join(summary([*known.values()])))


def read(path: Path) -> dict[int, Outcome]:
    """Return the outcomes in a file by their seeds."""
    if not path.exists():
        return {}
    every = [Outcome(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {one.seed: one for one in every}


if __name__ == "__main__":
    main()
