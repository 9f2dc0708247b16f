"""`python -m tests.benchmarks.rules`: what each rule of discovery changes when it is halved or doubled.

Each record is searched once with rules that note what they decide (`watched`): a value by which every comparison would
have gone the same way gives the same answer, and is not run. With each of the others the record is searched again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import signal
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.app.workflows import discovery_inputs
from masking.app.workflows.discover import Discover
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import MaskingError
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.decision_rules import RULES, DecisionRules
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.discovery_stages import discover
from masking.inference.estimation.identification_data import Data
from tests.app.workflows.test_discover_components import MODELS
from tests.benchmarks import components
from tests.benchmarks.problems.drawn import drawn
from tests.benchmarks.watched import WatchedRules

FACTORS: Final = (0.5, 2.0)
ABOVE_ONE: Final = {"noise_floor", "slow_excess"}  # neutral at 1, not at 0
PARTS: Final = {"small_unexplained_fraction", "named_probability"}  # up to 1
MOST = 4.0  # s of processor time of a search that is repeated
LONG = 20.0  # s of processor time after which a search is ended
LATE = f"no answer within {LONG:g} s"
MOVED = 0.05  # of a probability, which is a change
Columns = Mapping[str, Array]


@dataclass(frozen=True)
class Case:
    """A record: what it is, and its model, plant (none if empty) and columns."""

    words: str
    made: Callable[[], tuple[str, str, Columns]]


def _problem(seed: int) -> Callable[[], tuple[str, str, Columns]]:
    def made() -> tuple[str, str, Columns]:
        found = drawn(seed)
        return found.model, found.plant, found.columns

    return made


def _damper(hidden: components.Law, **off: float) -> Callable[[], tuple[str, str, Columns]]:
    return lambda: (MODELS["damper"], "", components.component(hidden, 5.0, 1, **off))


def _flawed() -> tuple[str, str, Columns]:
    """Return a damper with friction, whose sensors have gains and zeros that are slightly off and read late."""
    model, plant, columns = _damper(_rubbing)()
    force, rate = columns["F"], columns["v"]
    flawed = {"d": columns["d"] + 1e-5, "v": 1.01 * rate, "F": np.roll(1.02 * force + 0.02 * force.std(), 1)}
    return model, plant, {name: column[1:] for name, column in {**columns, **flawed}.items()}


def _rubbing(d: Array, v: Array) -> Array:
    return np.asarray(0.4 * np.tanh(v / 1e-3))


CASES: Final[Mapping[str, Case]] = {
    "nothing": Case("a damper, nothing missing", _damper(lambda d, v: 0.0 * d)),
    "level": Case("a level, nothing missing", _problem(195)),
    "parameter": Case("a damper whose stiffness is 30 % off", _damper(lambda d, v: 0.0 * d, k=1300.0)),
    "friction": Case("a damper with dry friction", _damper(_rubbing)),
    "weak": Case("a damper with dry friction of seven times the noise", _damper(lambda d, v: 0.025 * _rubbing(d, v))),
    "two": Case("a damper with a hardening spring and dry friction", _damper(lambda d, v: 2e7 * d**3 + _rubbing(d, v))),
    "either": Case("a damper with a constant force, or an offset of its sensor", _damper(lambda d, v: 0.5 + 0.0 * d)),
    "near": Case(
        "a damper with friction that builds up over a short way",
        _damper(lambda d, v: 0.6 * components.dahl(d, 3e-5)),
    ),
    "law": Case("a damper with an exponential force", _damper(lambda d, v: 0.5 * np.exp(d / 2e-3))),
    "flawed": Case("a damper with dry friction and imperfect sensors", _flawed),
    "drag": Case("a mass with drag, under a force", _problem(28)),
    "decay": Case("a mass in free decay with friction, its sensor saturated", _problem(272)),
}


@dataclass(frozen=True)
class Answer:
    """What discovery says of a record.

    Args:
        record: its name.
        rule, factor: that was changed; empty and 1 for the rules as they are.
        verdict: of discovery, or the text of an error.
        causes: names and places.
        probability: of the last cause, or of none of the names.
        closed: whether the explanation is complete.
        work: steps of integration, weighted, of the search whose answer is given.
        seconds: of processor time.
        read: rules that were read.
        noted: `rule x factor` of each change that would have decided otherwise.
    """

    record: str
    rule: str
    factor: float
    verdict: str
    causes: Sequence[Sequence[str]] = ()
    probability: float = 0.0
    closed: bool = False
    work: float = 0.0
    seconds: float = 0.0
    read: Sequence[str] = ()
    noted: Sequence[str] = ()

    def changes(self, other: Answer) -> Iterator[str]:
        """Yield what is otherwise than in another answer."""
        if self.verdict == LATE:
            yield LATE
            return
        if self.verdict != other.verdict:
            yield "verdict"
        if sorted(map(tuple, self.causes)) != sorted(map(tuple, other.causes)):
            yield "causes"
        if self.verdict == other.verdict and abs(self.probability - other.probability) > MOVED:
            yield "probability"
        if self.closed != other.closed:
            yield "closed"
        if self.work != other.work:
            yield "work"


def changed(rule: str, factor: float) -> Any:
    """Return the value of a rule at a factor.

    A number of things is at least 1. What is neutral at 1 is scaled by its distance from 1; so is a part of a whole
    that would exceed it, and the lower one is then nearer to 1.
    """
    value = getattr(RULES, rule)
    if isinstance(value, tuple):
        return tuple(factor * one for one in value)
    if isinstance(value, int):
        return max(1, round(factor * value))
    return 1.0 + factor * (value - 1.0) if rule in ABOVE_ONE | PARTS else factor * value


@cache
def opened(name: str) -> tuple[Twin, Data, AugmentedModel]:
    """Return the rig of a record, the record, and the rig with its places open."""
    model, plant, columns = CASES[name].made()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "model.yaml").write_text(model, encoding="utf-8")
        (folder / "plant.yaml").write_text(plant, encoding="utf-8")
        np.savez(folder / "record.npz", **columns)  # type: ignore[arg-type]
        settings = Discover(model=folder / "model.yaml", plant=folder / "plant.yaml" if plant else None)
        twin = discovery_inputs.rig(settings.model, settings.plant)
        given = discovery_inputs.read(twin, folder / "record.npz", None, settings)
    return twin, given.record, AugmentedModel(twin, twin.equation_parameters())


def answer(name: str, rules: DecisionRules) -> Answer:
    """Return what discovery says of a record by given rules."""
    twin, record, rig = opened(name)
    _ = rig.kernels
    begin = time.process_time()
    made = Answer(name, "", 1.0, "")
    signal.signal(signal.SIGPROF, _end)
    signal.setitimer(signal.ITIMER_PROF, LONG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            found = discover(twin, record, None, Discover(rules=rules), rig=rig)
            made = _said(made, found)
    except MaskingError as error:
        made = replace(made, verdict=f"refused: {' '.join(str(error).split())}")
    except TimeoutError:
        made = replace(made, verdict=LATE)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return replace(made, seconds=round(time.process_time() - begin, 2))


def _end(number: int, frame: object) -> None:
    raise TimeoutError


def _said(made: Answer, found: Discovery) -> Answer:
    causes = [(one.name, one.on) for one in found.effects]
    if found.law is not None:
        causes.append((found.law.instance.entry.expression if found.law.form else "curves", found.law.place))
    probability = found.effects[-1].probability if found.effects else 1.0
    return replace(
        made,
        verdict=found.verdict,
        causes=causes,
        probability=found.none_of_these if found.verdict == "unknown" else probability,
        closed=found.closed,
        work=found.problem.work.done,
    )


def watched(name: str) -> Answer:
    """Return the answer by the rules as they are, with those that are read, and the changes that would matter."""
    others = {one.name: {factor: changed(one.name, factor) for factor in FACTORS} for one in fields(RULES)}
    rules = WatchedRules().watching(others)
    made = answer(name, rules)
    noted = sorted(label(rule, factor) for rule, factor in rules.watch["noted"])
    return replace(made, read=sorted(rules.watch["read"]), noted=noted)


def label(rule: str, factor: float) -> str:
    """Return what a change is called."""
    return f"{rule} x {factor:g}"


def measured(path: Path, names: Sequence[str], most: float) -> dict[tuple[str, str, float], Answer]:
    """Run what is not in a file yet, and return all answers by record, rule and factor.

    Args:
        path: of the file.
        names: of the records.
        most: s of processor time that a search may have taken to be repeated with other rules.
    """
    known = read(path)
    path.parent.mkdir(parents=True, exist_ok=True)

    def keep(made: Answer) -> None:
        known[made.record, made.rule, made.factor] = made
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(made)) + "\n")
        print(made.record, label(made.rule, made.factor), made.verdict, made.causes, f"{made.seconds:g} s", flush=True)

    for name in names:
        if (name, "", 1.0) not in known:
            keep(watched(name))
    usual = {name: known[name, "", 1.0] for name in names if known[name, "", 1.0].seconds <= most}
    cheapest = sorted(usual, key=lambda name: usual[name].seconds)
    for name, rule, factor in itertools.product(cheapest, (one.name for one in fields(RULES)), FACTORS):
        if label(rule, factor) in usual[name].noted and (name, rule, factor) not in known:
            made = answer(name, replace(RULES, **{rule: changed(rule, factor)}))
            keep(replace(made, rule=rule, factor=factor))
    return known


def read(path: Path) -> dict[tuple[str, str, float], Answer]:
    """Return the answers in a file by record, rule and factor."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    every = [Answer(**json.loads(line)) for line in lines]
    return {(one.record, one.rule, one.factor): one for one in every}


def answers(known: Mapping[tuple[str, str, float], Answer]) -> str:
    """Return the table of the records, with their answers by the rules as they are."""
    lines = ["| record | is | answer | searches with other rules |", "|---|---|---|---|"]
    for (name, rule, _), one in known.items():
        if not rule:
            causes = ", ".join(f"{cause} ({at})" if at else cause for cause, at in one.causes)
            again = sum(record == name for record, other, _ in known if other)
            said = f"{one.verdict}{f': {causes}' if causes else ''}, {one.probability:.2f}"
            lines.append(f"| {name} | {CASES[name].words} | {said} | {again} |")
    return "\n".join(lines)


def table(known: Mapping[tuple[str, str, float], Answer]) -> str:
    """Return the table of the rules, with what each changes."""
    lines = ["| rule | value | read in | x 0.5 | x 2 |", "|---|---|---|---|---|"]
    usual = {name: one for (name, rule, _), one in known.items() if not rule}
    for rule in (one.name for one in fields(RULES)):
        having = [name for name, one in usual.items() if rule in one.read]
        cells = [_cell(known, usual, rule, factor, having) for factor in FACTORS]
        lines.append(f"| `{rule}` | {_value(getattr(RULES, rule))} | {len(having)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(
    known: Mapping[tuple[str, str, float], Answer],
    usual: Mapping[str, Answer],
    rule: str,
    factor: float,
    having: Sequence[str],
) -> str:
    found: dict[str, list[str]] = {}
    for name in having:
        made = known.get((name, rule, factor))
        if made is None and label(rule, factor) in usual[name].noted:
            found.setdefault("not run", []).append(name)
        for what in made.changes(usual[name]) if made else ():
            found.setdefault(what, []).append(name)
    told = "; ".join(f"{what}: {', '.join(names)}" for what, names in found.items()) or ("no change" if having else "-")
    return f"{_value(changed(rule, factor))}: {told}"


def _value(value: Any) -> str:
    return ", ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"


def main() -> None:
    """Run what has not been run, and print the table of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("records", nargs="*", metavar="RECORD", help=f"of {', '.join(CASES)}; all by default")
    parser.add_argument("--out", type=Path, default=Path("results/bench-rules/answers.jsonl"), metavar="FILE")
    parser.add_argument("--most", type=float, default=MOST, metavar="S", help="no longer searches are repeated")
    chosen = parser.parse_args()
    known = measured(chosen.out, chosen.records or [*CASES], chosen.most)
    print(f"{answers(known)}\n\n{table(known)}")
    print(f"{sum(one.seconds for one in known.values()):.0f} s of processor time, {len(known)} searches")


if __name__ == "__main__":
    main()
