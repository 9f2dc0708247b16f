"""Batch: the runs that a plan asks for, always the same in the same order, and what is known of each from a journal."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.compile.numerics.controller_sizes import HEATING
from masking.errors import DeclarationError, Problem, RecordError
from masking.lab.records import foreign_json
from masking.lab.runs import manifest
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.stopping import FINISHED, INTERRUPTED, SYNCHRONISED, TRIPPED
from masking.model.declaration import registry
from masking.model.declaration.schema import BatchDeclaration

PLANNED: Final = (FINISHED, SYNCHRONISED)
EXPERIMENT: Final = "experiment.yaml"
UNREACHABLE: Final = "unreachable"
CUT_OFF: Final = "cut off"
PEOPLE: Final = ("ESTOP", "UNATTENDED")  # causes after which nobody but a person goes on
FREE: Final = (INTERRUPTED, UNREACHABLE, CUT_OFF)  # ends of tries that are no fault of the run
MOST: Final = 1_000_000  # runs
COUNTED: Final = 10**15  # of which a number of runs is said
LONGEST: Final = 604_800.0  # s that a pause may take


@dataclass(frozen=True)
class _Entry:
    """What every entry of a journal says."""

    event: str


@dataclass(frozen=True)
class _Begin:
    """What the begin of a try says."""

    run: int


@dataclass(frozen=True)
class _Ended:
    """What the end of a try says."""

    run: int
    end: str
    seconds: float = 0.0
    energy: float = 0.0
    cause: str = ""


_EVENTS: Final = {"begin": _Begin, "end": _Ended}


@dataclass(frozen=True)
class Run:
    """A run of a batch."""

    number: int  # from 1
    settings: Mapping[str, float]  # values of the experiment that it varies, by name, such as `parameters.k`


def load(plan: str | Path) -> tuple[BatchDeclaration, Experiment, tuple[Run, ...]]:
    """Load a plan; return it with its experiment and its runs, each of whose values is checked.

    A DeclarationError lists every problem of the plan, its experiment, and the values that it gives.
    """
    declared = registry.load_batch(plan)
    problems = list(_problems(declared))
    if problems:
        raise DeclarationError(problems)
    reference = registry.refer(declared, "experiment")
    experiment = Experiment(registry.assemble(registry.load_experiment(declared.experiment, reference)))
    power = experiment.assembly.plant.limits.power
    if declared.budget.energy is not None and (power is None or power.heating is None):
        message, path = f"{experiment.assembly.plant.name} does not say how its commands heat", "budget.energy"
        raise DeclarationError(Problem(declared.key_place(path), path, message, "give limits.power.heating"))
    values = list(itertools.product(*declared.vary.values()))
    settings = [dict(zip(declared.vary, one, strict=True)) for _ in range(declared.repeats) for one in values]
    runs = tuple(Run(number, one) for number, one in enumerate(settings, 1))
    for name, given in declared.vary.items():
        for i, value in enumerate(given):
            try:
                changed(experiment, {name: value})
            except DeclarationError as error:
                place = declared.place(f"vary.{name}.{i}") or declared.key_place(f"vary.{name}")
                message, remedy = error.problems[0].message, error.problems[0].remedy
                raise DeclarationError(Problem(place, f"vary.{name}", message, remedy)) from error
    return declared, experiment, runs


def _problems(plan: BatchDeclaration) -> Iterator[Problem]:
    if plan.repeats < 1:
        yield Problem(plan.place("repeats"), "repeats", "must be at least 1, not 0")
    if plan.budget.trips == 0:
        remedy = "leave it out for any number; a run that tripped is made again only as 'retries' says"
        yield Problem(plan.place("budget.trips"), "budget.trips", "must be at least 1, not 0", remedy)
    for name, seconds in (("cool", plan.cool), ("patience", plan.patience)):
        if seconds < 0.0:
            yield Problem(plan.place(name), name, f"must be at least 0, not {seconds:g}", "give seconds")
        if seconds > LONGEST:
            yield Problem(plan.place(name), name, f"must be at most {LONGEST:g} s, a week, not {seconds:g}")
    many = plan.repeats
    for name, values in plan.vary.items():
        many *= len(values)
        if not values:
            yield Problem(plan.key_place(f"vary.{name}"), f"vary.{name}", "has no values", "list some, or leave it out")
    shown = many if many < COUNTED else "more than 10^15"
    if many > MOST:
        yield Problem(plan.key_place("vary"), "vary", f"asks for {shown} runs; at most {MOST} are allowed")


def changed(experiment: Experiment, settings: Mapping[str, float]) -> Experiment:
    """Experiment with some of its values replaced, such as `parameters.k` or `seed`, checked as those of a file."""
    whole, sections = experiment.declaration.canonical(), dict[str, Any]()
    for name, value in settings.items():
        section, _, key = name.partition(".")
        if key:
            sections[section] = {**sections.get(section, whole.get(section, {})), key: value}
        else:
            sections[section] = value
    return experiment.changed(**sections) if sections else experiment


def write(experiment: Experiment, folder: Path) -> Path:
    """Write the file of an experiment with replaced values into a folder, made if need be; return its path.

    A RecordError where it cannot be written.
    """
    path = folder / EXPERIMENT
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(registry.content_from(experiment.assembly, folder)), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{folder} cannot be written ({error}); make room, or name another folder") from error
    return path


def energy(experiment: Experiment, inputs: Array, rate: float) -> float:
    """Heat in J that commands turn into: the sum of `heating c^2 h`, 0 where the heating is not known.

    `inputs` are the commands in force (samples, actuators), in the actuators' units, at a number of samples per second.
    """
    return float(np.sum(experiment.instruments.limits()[:, HEATING] * inputs**2)) / rate


@dataclass
class Progress:
    """What a journal has of a run."""

    run: Run  # the run
    # how its tries ended, in order; each is an entry of the journal
    ends: list[dict[str, Any]] = field(default_factory=list)
    open: int = 0  # the try that has begun and not ended; 0 where there is none
    tries: int = 0  # that have begun
    left_out: str = ""  # why it was not made; empty where it was

    @property
    def is_done(self) -> bool:
        """Whether it ended as planned."""
        return bool(self.ends) and self.ends[-1]["end"] in PLANNED

    @property
    def counted(self) -> int:
        """How many tries failed by themselves."""
        return sum(end["end"] not in {*FREE, *PLANNED} for end in self.ends)


def identity(experiment: Experiment, runs: Sequence[Run]) -> str:
    """Hash of all that makes the runs what they are: the experiment with its files, and the settings.

    What a plan says of retries, cooling and budgets may be changed before it is gone on with.
    """
    declared = manifest.content(experiment.assembly, experiment.virtual, {})["declarations"]
    content = [declared, [dict(run.settings) for run in runs]]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def progress(runs: Sequence[Run], entries: Sequence[Mapping[str, Any]]) -> list[Progress]:
    """Progress of each run by the entries of a journal; a RecordError where one says something else than such do."""
    found = [Progress(run) for run in runs]
    for number, entry in enumerate(entries, 1):
        where = f"entry {number} of the journal"
        said = {name: value for name, value in entry.items() if name != "chi"}  # which may be no number
        foreign_json.check(said, _Entry, where)
        if (event := entry["event"]) not in _EVENTS:
            continue
        foreign_json.check(said, _EVENTS[event], where)
        if not 1 <= entry["run"] <= len(found):
            raise RecordError(f"{where}: run: must be from 1 to {len(found)}, not {entry['run']}")
        one = found[entry["run"] - 1]
        if event == "begin":
            one.open = one.tries = entry.get("try", one.tries + 1)
        else:
            one.ends.append(dict(entry))
            one.open = 0
    return found


def begin(entries: Sequence[Mapping[str, Any]], wanted: str, folder: Path) -> bool:
    """Whether a journal is that of these runs; False where it is empty. A RecordError where it is that of others."""
    if not entries:
        return False
    if entries[0].get("plan") != wanted:
        raise RecordError(
            f"{folder} holds a batch of other runs: what is varied, or the experiment, has changed; "
            "name another folder with --out"
        )
    return True


def used(found: Sequence[Progress]) -> dict[str, float]:
    """Time in s, the trips, and the energy in J that all tries took together."""
    ends = [end for one in found for end in one.ends]
    return {
        "time": sum(end.get("seconds", 0.0) for end in ends),
        "trips": sum(end["end"] == TRIPPED for end in ends),
        "energy": sum(end.get("energy", 0.0) for end in ends),
    }
