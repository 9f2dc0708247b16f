"""Scores of laws without a name, and of the probabilities of answers."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import masking
from masking.inference.discovery.closed_form import force
from masking.inference.discovery.discovery_result import Discovery
from tests.benchmarks.answers.reliability import bins
from tests.benchmarks.laws import records
from tests.benchmarks.laws.records import NAMES, Case, Rig

NOISE_TIMES, NEAR, SURE = 1.5, 0.05, 0.9


@dataclass(frozen=True)
class Outcome:
    """What discovery made of a case.

    Args:
        case: its name.
        law: hidden law.
        verdict, answer, on: of discovery; the answer is a name of the dictionary, or `none of these`.
        probability: of the answer.
        is_right: whether it is.
        none: probability of none of the names.
        left: residual over noise on unseen data, with the law or the names, of the worst sensor.
        form: largest error of the closed form in the travel, over the largest force; None where there is none.
        words: shapes of the closed form.
        seconds: that it took.
    """

    case: str
    law: str
    verdict: str
    answer: str
    on: str
    probability: float
    is_right: bool
    none: float
    left: float
    form: float | None
    words: str
    seconds: float

    def as_dict(self) -> dict[str, object]:
        """Return the outcome as JSON can hold it."""
        return asdict(self)


def cases(first: int, seeds: int) -> list[Case]:
    """Return a case of each law for each seed; every third rig has two masses."""
    return [Case(law, seed, 1 + (seed % 3 == 0)) for seed in range(first, first + seeds) for law in records.LAWS]


def outcome(case: Case) -> Outcome:
    """Return what discovery makes of a case."""
    rig, begun = Rig.of(case), time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "model.yaml").write_text(records.model(rig, case.seed))
        for seed, part in ((2 * case.seed, "train"), (2 * case.seed + 1, "unseen")):
            (folder / f"{part}.csv").write_text(records.table(records.record(rig, seed)))
        begun = time.perf_counter()
        found = masking.discover(
            folder / "train.csv", model=folder / "model.yaml", validation=folder / "unseen.csv", hold="first-order"
        )
    seconds, place = time.perf_counter() - begun, f"spring{case.masses}"
    answer, on, probability = _answer(found)
    known = NAMES.get(case.law, "none of these")
    is_right = answer == known and (on == place or answer == "none of these")
    after = found.simulation_error.validation[1] if found.law is None else found.law.error[1]
    floor = found.simulation_error.validation_noise_floor
    left = max(after[name] / floor[name] for name in floor)
    form, words = _form(found, rig)
    return Outcome(
        case.name,
        case.law,
        found.verdict,
        answer,
        on,
        probability,
        is_right,
        found.none_of_these,
        left,
        form,
        words,
        round(seconds, 1),
    )


def _answer(found: Discovery) -> tuple[str, str, float]:
    """Return the answer, its place and its probability."""
    if found.verdict == "unknown":
        return "none of these", found.law.place if found.law else "", found.none_of_these
    if not found.effects:
        return found.verdict, "", 1.0
    last = found.effects[-1]
    names = [one.name for one in found.effects]
    return " + ".join(names), last.on, last.probability


def _form(found: Discovery, rig: Rig) -> tuple[float | None, str]:
    """Return the largest error of the closed form along the record, over the largest force, and its shapes."""
    if found.law is None or found.law.form is None:
        return None, ""
    one, x, rate = found.law.form.instance, found.law.free.x, found.law.free.rate
    made = force(one, x, rate)
    truth = np.array([rig.hidden(d, v) for d, v in zip(x, rate, strict=True)])
    error = float(np.abs(made - truth).max() / np.abs(truth).max())
    return error, ", ".join(atom.name for atom, _, _ in found.law.form.formula.terms)


def brier(outcomes: Sequence[Outcome]) -> float:
    """Return the mean square of probability less truth, Brier (1950), Monthly Weather Review 78(1)."""
    return float(np.mean([(one.probability - one.is_right) ** 2 for one in outcomes]))


def reliability(outcomes: Sequence[Outcome]) -> list[tuple[float, float, int]]:
    """Return the mean probability, the part that is right, and the number of the answers in each bin."""
    pairs = [(one.probability, one.is_right) for one in outcomes]
    return [(one.said, one.right / one.count, one.count) for one in bins(pairs)]


def summary(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    """Return what is measured, with its value."""
    outside = [one for one in outcomes if one.law not in NAMES]
    inside = [one for one in outcomes if one.law in NAMES]
    unknown = [one for one in outside if one.answer == "none of these"]
    sure = [one for one in outcomes if one.probability >= SURE]

    def part(those: Sequence[bool]) -> str:
        return f"{100.0 * np.mean(those):.0f} % of {len(those)}" if len(those) else "-"

    wrong = [one not in unknown and one.probability >= SURE for one in outside]
    quantiles = [float(np.quantile([one.seconds for one in outcomes], q)) for q in (0.5, 0.95)] if outcomes else []
    return [
        ("not in the dictionary: confident wrong name", part(wrong)),
        ("  law leaves at most 1.5 times the noise", part([o in unknown and o.left <= NOISE_TIMES for o in outside])),
        ("  closed form within 5 % of the truth", part([o.form is not None and o.form <= NEAR for o in outside])),
        ("in the dictionary: named right", part([one.is_right for one in inside])),
        ("answers of 90 % and more that are right", part([one.is_right for one in sure])),
        ("Brier score", f"{brier(outcomes):.3f} of {len(outcomes)}" if outcomes else "-"),
        ("seconds: median, 95 %", ", ".join(f"{value:.0f}" for value in quantiles)),
    ]
