"""The suites: measured sets, the quick records of the first generator, the second generator, and random problems."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

import masking
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.discovery_stages import discover
from masking.reports.text import listed
from tests.benchmarks import hidden, measured, mujoco_records
from tests.benchmarks.answers.scoring import SURE, Judgement, causes
from tests.benchmarks.discovering import running, suite
from tests.benchmarks.discovering import scoring as strict
from tests.benchmarks.independent import cases as independent
from tests.benchmarks.problems import drawn
from tests.benchmarks.problems.__main__ import HELD_OUT

FRESH = 46_001  # first seed of the second generator and of the random problems: nothing was tried on these
IMPERFECT = 10_000  # from which on seeds are of imperfect rigs
RATE = 250.0  # samples per second of a machine, whose modes are up to 13 Hz; twice as many take twice as long to make


@dataclass(frozen=True)
class Problem:
    """A problem: its suite, name and truth in words.

    Args:
        suite, name, truth: what it is.
        prepare: writes its files into a folder, and returns what looks for the answer.
        judge: judges that.
        missing: why it cannot be run here; empty where it can.
    """

    suite: str
    name: str
    truth: str
    prepare: Callable[[Path], Callable[[], Discovery]]
    judge: Callable[[Discovery], Judgement]
    missing: str = ""


def of_measured() -> Iterator[Problem]:
    """Give the measured sets."""
    missing = "" if measured.DATA.exists() else f"the measurements are not at {measured.DATA}"
    for name, truth in measured.SETS.items():
        yield Problem(
            "measured", name, truth.cause, partial(measured.discovered, name), partial(judged_measured, truth), missing
        )


def judged_measured(truth: measured.Truth, found: Discovery) -> Judgement:
    """Judge by the main cause: it is named, and nothing that the rig cannot have is.

    What is only nearest, of an unknown cause, is no plain falsehood; another unit is one with any verdict.
    """
    names = {name for name, _ in causes(found)}
    false = sorted((names & measured.FALSE) - truth.right - truth.beside) if found.verdict != "unknown" else []
    false += [f"unit of {listed(found.unit.names)}"] if found.unit is not None else []
    has_class = bool(names & truth.right)
    right = has_class and found.verdict in ("named", "ambiguous") and not false
    return Judgement(right, has_class, not right and is_confident(found), tuple(false))


def is_confident(found: Discovery) -> bool:
    """Return whether a name is given with confidence."""
    said = found.least_sure.probability if found.effects else 0.0
    return found.verdict in ("named", "parameter") and said >= SURE


def of_quick() -> Iterator[Problem]:
    """Give the records of `make bench-discovery OPTIONS=--quick`."""
    missing = "" if mujoco_records.version() else "MuJoCo is not installed"
    for line in suite.QUICK:
        if line.family == "mujoco" and missing:
            yield Problem("quick", "mujoco", "", lambda _: lambda: None, lambda _: None, missing)
            continue
        made = suite.cases(line)
        records = cache(partial(_generated, line.family, tuple(made)))
        for case in made:
            truth = " + ".join(f"{one.effect} at {one.at}" for one in case.hidden) or case.asked
            yield Problem("quick", case.name, truth, partial(_quick, case, records), partial(judged_quick, case))


def _generated(family: str, made: tuple[hidden.Case, ...]) -> dict[str, tuple[hidden.Record, hidden.Record]]:
    """Return the records of cases by name, all at once: making one takes as long as making ten."""
    generate = mujoco_records.generate if family == "mujoco" else hidden.generate
    return {case.name: (training, validation) for case, training, validation in generate([*made])}


def _quick(
    case: hidden.Case, records: Callable[[], dict[str, tuple[hidden.Record, hidden.Record]]], _: Path
) -> Callable[[], Discovery]:
    twin, opened = running.rig(case.damping)
    _ = opened.kernels  # compiled before the clock runs
    training, validation = records()[case.name]
    given = running.data(training, "training"), running.data(validation, "validation")
    return lambda: discover(twin, *given, rig=opened)


def judged_quick(case: hidden.Case, found: Discovery) -> Judgement:
    """Judge as `discovering.scoring` does; near kin at the right place is of the right class."""
    told = strict.answer(found.as_dict())
    score, near = strict.judge(case, told), hidden.kin(case) | hidden.acceptable(case)
    return Judgement(score.right, score.right or bool(near & {*told.keys}), score.confidently_wrong)


def of_second(count: int = 24) -> Iterator[Problem]:
    """Give machines of the second generator, 24 a round: all effects, four in imperfect rigs, five laws, three without.

    The laws are not in the dictionary. No round has the seeds of another.
    """
    effects, laws = independent.EFFECTS, independent.OUTSIDE
    made: list[independent.Case] = []
    for i in itertools.count():
        if len(made) >= count:
            break
        four, five = ([every[(n * i + j) % len(every)] for j in range(n)] for every, n in ((effects, 4), (laws, 5)))
        made += [independent.Case(FRESH + i, effect, rate=RATE) for effect in (*effects, *five)]
        made += [independent.Case(FRESH + IMPERFECT + i, effect, independent.REAL, RATE) for effect in four]
        made += [independent.Case(FRESH + 3 * i + j, independent.NOTHING, rate=RATE) for j in range(3)]
    for case in made[:count]:
        kind = "imperfect" if case.quality is independent.REAL else "good"
        truth = case.effect if case.effect == independent.NOTHING else " at ".join(case.truth)
        name = f"{case.effect.replace(' ', '_')}-{kind}-{case.seed}"
        yield Problem("second", name, truth, partial(discovered_second, case), partial(judged_second, case))


def discovered_second(case: independent.Case, folder: Path) -> Callable[[], Discovery]:
    """Write the files of a machine into a folder, and return what discovers what hides in it."""
    u, x = case.told
    model, record = folder / "model.yaml", folder / "record.npz"
    model.write_text(case.rig.model())
    np.savez(record, **case.rig.columns(case.times, u, x))
    return lambda: masking.discover(record, model=model, tolerance=case.quality.off)


def judged_second(case: independent.Case, found: Discovery) -> Judgement:
    """Judge by the class of the law at its place; imperfections that are there may be named beside it."""
    beside = {*independent.IMPERFECT} if case.quality is independent.REAL else set()
    told = [one for one in causes(found) if one[0] not in beside - {case.effect} and one[0] != "quantisation"]
    name, place = case.truth
    if name == independent.NOTHING or name in independent.OUTSIDE:
        right = found.verdict == "none" if name == independent.NOTHING else found.verdict == "unknown"
        return Judgement(right, right, not right and is_confident(found))
    at = {place, f"x{place[-1]}"} if place == f"spring{case.rig.size}" else {place}  # of the last, from the ground
    hits = [one for one in told if one[0] in independent.LIKE[name] and one[1] in at]
    right = len(told) == 1 and bool(hits) and found.verdict in ("named", "ambiguous")
    return Judgement(right, bool(hits), not right and is_confident(found))


def of_problems(count: int = 16) -> Iterator[Problem]:
    """Give random problems."""
    for seed in range(FRESH, FRESH + count):
        made = drawn.drawn(seed)
        truth = " + ".join(f"{name} at {places[0]}" for name, places in made.truth) or "nothing"
        yield Problem("problems", str(seed), truth, partial(_drawn, made), partial(judged_problem, made))


def _drawn(made: drawn.Problem, folder: Path) -> Callable[[], Discovery]:
    (folder / "model.yaml").write_text(made.model)
    (folder / "plant.yaml").write_text(made.plant)
    first = round((1.0 - HELD_OUT) * len(made.columns["t"]))
    for part, rows in (("train", slice(first)), ("unseen", slice(first, None))):
        np.savez(folder / f"{part}.npz", **{key: column[rows] for key, column in made.columns.items()})
    files = folder / "train.npz", folder / "unseen.npz"
    return lambda: masking.discover(files[0], plant=folder / "plant.yaml", validation=files[1])


def judged_problem(made: drawn.Problem, found: Discovery) -> Judgement:
    """Judge by each hidden law; one that the dictionary has not is `unknown`."""
    told = [one for one in causes(found) if one[0] in found.twin.dictionary and one[0] != "quantisation"]
    is_open = found.verdict == "unknown"
    right = not made.has_name if is_open else made.is_right(told)
    near = any(one[0] in drawn.CLASSES.get(name, ()) and one[1] in at for name, at in made.truth for one in told)
    return Judgement(right, right or near, not right and is_confident(found))


SUITES: Mapping[str, Callable[..., Iterator[Problem]]] = {
    "measured": of_measured,
    "quick": of_quick,
    "second": of_second,
    "problems": of_problems,
}
