"""Batch: the runs that a plan asks for, always the same in the same order, and what is known of each from a journal."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from masking.declaration import registry
from masking.declaration.schema import BatchDeclaration
from masking.errors import DeclarationError, Problem, RecordError
from masking.runs.experiment import Experiment
from masking.runs.stopping import FINISHED, INTERRUPTED, SYNCHRONISED, TRIPPED

PLANNED: Final = (FINISHED, SYNCHRONISED)
UNREACHABLE: Final = "unreachable"
CUT_OFF: Final = "cut off"
FREE: Final = (INTERRUPTED, UNREACHABLE, CUT_OFF)  # ends of tries that are no fault of the run
MOST: Final = 1_000_000  # runs


@dataclass(frozen=True)
class Run:
    """A run of a batch.

    Args:
        number: from 1.
        settings: values of the experiment that it varies, by name, such as `parameters.k`.
    """

    number: int
    settings: Mapping[str, float]


def load(plan: str | Path) -> tuple[BatchDeclaration, Experiment, tuple[Run, ...]]:
    """Load a plan; return it with its experiment and its runs, of which the first and the last value are checked.

    Raises:
        DeclarationError: the plan, its experiment, or a value that it gives that is wrong; lists every problem.
    """
    declared = registry.load_batch(plan)
    problems = list(_problems(declared))
    if problems:
        raise DeclarationError(problems)
    reference = registry.refer(declared, "experiment")
    experiment = Experiment(registry.assemble(registry.load_experiment(declared.experiment, reference)))
    values = list(itertools.product(*declared.vary.values()))
    settings = [dict(zip(declared.vary, one, strict=True)) for _ in range(declared.repeats) for one in values]
    runs = tuple(Run(number, one) for number, one in enumerate(settings, 1))
    for name, given in declared.vary.items():
        for i, value in enumerate(given):
            try:
                changed(experiment, {name: value})
            except DeclarationError as error:
                place = declared.place(f"vary.{name}.{i}") or declared.key_place(f"vary.{name}")
                message, mend = error.problems[0].message, error.problems[0].mend
                raise DeclarationError(Problem(place, f"vary.{name}", message, mend)) from error
    return declared, experiment, runs


def _problems(plan: BatchDeclaration) -> Iterator[Problem]:
    """Yield what is wrong with the numbers of a plan."""
    if plan.repeats < 1:
        yield Problem(plan.place("repeats"), "repeats", "must be at least 1, not 0")
    if plan.cool < 0.0:
        yield Problem(plan.place("cool"), "cool", f"must be at least 0, not {plan.cool:g}", "give seconds")
    many = plan.repeats
    for name, values in plan.vary.items():
        many *= len(values)
        if not values:
            yield Problem(plan.key_place(f"vary.{name}"), f"vary.{name}", "has no values", "list some, or leave it out")
    if many > MOST:
        yield Problem(plan.key_place("vary"), "vary", f"asks for {many} runs; at most {MOST} are allowed")


def changed(experiment: Experiment, settings: Mapping[str, float]) -> Experiment:
    """Return an experiment with some of its values replaced, such as `parameters.k` or `seed`.

    Raises:
        DeclarationError: as for a file.
    """
    whole, sections = experiment.declaration.canonical(), dict[str, Any]()
    for name, value in settings.items():
        section, _, key = name.partition(".")
        if key:
            sections[section] = {**sections.get(section, whole.get(section, {})), key: value}
        else:
            sections[section] = value
    return experiment.changed(**sections) if sections else experiment


@dataclass
class Progress:
    """What a journal tells of a run.

    Args:
        run: the run.
        ends: how its tries ended, in order; each is an entry of the journal.
        open: the try that has begun and not ended; 0 where there is none.
        tries: that have begun.
        left_out: why it was not made; empty where it was.
    """

    run: Run
    ends: list[dict[str, Any]] = field(default_factory=list)
    open: int = 0
    tries: int = 0
    left_out: str = ""

    @property
    def is_done(self) -> bool:
        """Tell whether it ended as planned."""
        return bool(self.ends) and self.ends[-1]["end"] in PLANNED

    @property
    def counted(self) -> int:
        """Return how many tries failed by themselves."""
        return sum(end["end"] not in {*FREE, *PLANNED} for end in self.ends)


def identity(plan: BatchDeclaration, experiment: Experiment, runs: Sequence[Run]) -> str:
    """Return a hash of all that makes the runs what they are."""
    content = [plan.canonical(), experiment.declaration.canonical(), [dict(run.settings) for run in runs]]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def progress(runs: Sequence[Run], entries: Sequence[Mapping[str, Any]]) -> list[Progress]:
    """Return what the entries of a journal tell of each run."""
    found = [Progress(run) for run in runs]
    for entry in entries:
        if entry["event"] == "begin":
            one = found[entry["run"] - 1]
            one.open = one.tries = entry["try"]
        elif entry["event"] == "end":
            one = found[entry["run"] - 1]
            one.ends.append(dict(entry))
            one.open = 0
    return found


def begin(entries: Sequence[Mapping[str, Any]], wanted: str, folder: Path) -> bool:
    """Tell whether a journal is that of these runs; False where it is empty.

    Raises:
        RecordError: it is that of others.
    """
    if not entries:
        return False
    if entries[0].get("plan") != wanted:
        raise RecordError(
            f"{folder} holds a batch of another plan, or its experiment has changed; name another folder with --out"
        )
    return True


def used(found: Sequence[Progress]) -> dict[str, float]:
    """Return the time in s, the trips, and the energy in J that all tries took together."""
    ends = [end for one in found for end in one.ends]
    return {
        "time": sum(end.get("seconds", 0.0) for end in ends),
        "trips": sum(end["end"] == TRIPPED for end in ends),
        "energy": sum(end.get("energy", 0.0) for end in ends),
    }
