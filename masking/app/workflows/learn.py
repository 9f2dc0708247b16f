"""The verb rig learn: a rig that finds out by itself what it is, step after step, until its records show no more.

Self-test, sensors at rest, excitation, discovery; then what parts the two likeliest causes, or another excitation,
until the residual is at the noise floor or the hours are used up. All that is known is in `learn.journal`: each step is
a line of it, from which the next one follows, so that started again after a crash it comes to the same end.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, TypeVar, final

import numpy as np

from masking.app.workflows import calibration_excitation as excitation
from masking.app.workflows import learned_rig
from masking.app.workflows.batch_run import Try, outcome
from masking.app.workflows.discover import discover
from masking.app.workflows.settings_keywords import with_fields_of
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.display.printed_result import Printed
from masking.errors import DeclarationError, MaskingError, PlantError, PlantLostError, PlantRefusedError, RecordError
from masking.inference.discovery.ground import Tell
from masking.inference.estimation.identification_data import Data
from masking.inference.procedures.calibration_findings import PERIOD, reached
from masking.lab.plants import adapters
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import foreign_json
from masking.lab.records.journal import Journal
from masking.lab.records.owned_folder import OwnedFolder
from masking.lab.records.recording import Recording
from masking.lab.runs import batch_plan, manifest
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.self_test import SIZE, self_test
from masking.lab.runs.stopping import FAILED, INTERRUPTED
from masking.reports import learning_page
from masking.reports.discovery_files import PLANT

JOURNAL: Final = "learn.journal"
TOLERANCE: Final = 0.05  # prior uncertainty of a parameter of a rig that nobody has calibrated
_REST: Final = 5.0  # s of sensors at rest
_LARGEST: Final = 0.4  # of the largest command: a pulse of the self-test
_PULSES: Final = 2.0  # s that a self-test takes for each actuator
_RETRIES: Final = 3  # after a trip that is not by the motion
_PATIENCE: Final = 60.0  # s that a plant is waited for
_AGAIN: Final = 1.0  # s between tries to reach it
_PARTED: Final = 3  # experiments at most to part the same causes
_LESS: Final = 0.9  # of the error before: what is found is worth another round

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class RigLearning:
    """How a rig learns what it is.

    Args:
        at: address of the rig, such as udp://127.0.0.1:5005 or serial:///dev/ttyACM0; by default the plant's twin.
        key: file of mode 0600 with a key that the server has, too.
        experiment: an experiment to run on the rig before and after, a YAML file or a name that 'masking list' shows.
        hours: of the rig's clock that it may take.
        seconds: length of each record.
        tolerance: relative standard deviation of a parameter that declares none, before anything is recorded.
        lockstep: each side waits for the other; no clock.
        out: folder of the records and of the result; one that holds the same, not yet finished, is gone on with.
        say: called with a sentence for each step.
        tell: called with the step under way, and the fraction done.
    """

    at: str | None = None
    key: str | None = None
    experiment: str | None = None
    hours: float = 1.0
    seconds: float = 2.0 * PERIOD
    tolerance: float = TOLERANCE
    lockstep: bool = False
    out: str | Path
    say: Callable[[str], None] | None = None
    tell: Tell | None = None


@dataclass(frozen=True, repr=False)
class Learning(Printed):
    """What a rig has learned: the steps, each as the journal has it, and the folder."""

    name: str
    rows: tuple[dict[str, Any], ...]
    folder: Path

    @property
    def sentence(self) -> str:
        """What was found, and what it changed."""
        return learning_page.sentence(self.name, self.rows)

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it."""
        files = {"plant": str(self.folder / PLANT), "page": str(self.folder / learning_page.PAGE)}
        files |= {"experiment": str(self.folder / batch_plan.EXPERIMENT)} if learning_page.masked(self.rows) else {}
        return {"name": self.name, "sentence": self.sentence, "steps": list(self.rows), **files}

    def __str__(self) -> str:
        return learning_page.text(self.sentence, self.rows, self.as_dict())


@with_fields_of(RigLearning)
def learn_at(plant: str, settings: RigLearning) -> Learning:
    """Let a rig at an address, or the twin of its plant file, learn what it is.

    Args:
        plant: the rig's plant file, or a packaged plant: what is known of it.
        settings: the fields of `RigLearning`.
    """
    twin, key = Twin.load(plant), None if settings.key is None else Key.read(settings.key)
    if settings.at is None:
        return learn(plant, partial(SimulatedPlant, twin), replace(settings, lockstep=True))
    return learn(plant, partial(adapters.connect, settings.at, key), settings)


def learn(plant: str, rig: Callable[[], Plant], settings: RigLearning) -> Learning:
    """Let a rig learn what it is.

    Args:
        plant: the rig's plant file, or a packaged plant.
        rig: each call gives the rig, which is not active.
        settings: all but its address and its key.

    Raises:
        ModelError: the plant file has no limits to stay within.
        DeclarationError: the experiment does not fit the plant file, or a file is wrong.
        RecordError: the hours are too few for one round, or the folder holds something else or cannot be written.
        PlantError: the self-test refuses the rig, or it is not reached, refuses, or has other channels.
        MaskingError: a person has stopped it, or the rig trips again and again.
    """
    twin, folder = Twin.load(plant), Path(settings.out)
    twin.validate()
    experiment = None if settings.experiment is None else _experiment(settings.experiment, plant)
    rate = experiment.sampled.rate if experiment else excitation.RATE
    with OwnedFolder(folder), Journal(folder / JOURNAL) as journal, Operator() as operator:
        driven = excitation.Rig(
            twin, rig(), rate, settings.lockstep, settings.say or (lambda text: None), acknowledge=True,
            retries=_RETRIES, look=operator.look,
        )  # fmt: skip
        made = _Learner(plant, rig, settings, folder, journal, driven, experiment)
        made.check()
        known = made.identity()
        if journal.entries and journal.entries[0].get("plan") != known:
            raise RecordError(
                f"{folder} holds what another rig has learned: the plant file, the experiment or the settings are "
                "others; name another folder with --out"
            )
        if not journal.entries:
            journal.add(event="learn", plan=known, name=twin.declaration.name)
        made.work()
        found = Learning(twin.declaration.name, tuple(made.rows), folder)
        learning_page.save(found.sentence, found.rows, found.as_dict(), folder)
        return found


def _experiment(name: str, plant: str) -> Experiment:
    """Experiment on the rig; a DeclarationError that it does not fit says why."""
    try:
        made = Experiment.load(name, plant=plant)
        made.validate()
        if not made.has_observer or made.declaration.controller.homing is None:
            raise MaskingError("its controller needs a rate, an observer that reads sensors, and homing")
    except DeclarationError as error:
        raise DeclarationError(
            [replace(p, message=f"{p.message} ({name} on {plant})") for p in error.problems]
        ) from error
    except MaskingError as error:
        raise RecordError(f"the experiment {name} does not fit the rig {plant}: {error}") from error
    return made


@dataclass(frozen=True)
class _Entry:
    """What every step of a journal says."""

    event: str
    step: str
    next: str
    seconds: float


@final
@dataclass
class _Learner:
    """Takes one step after the other; what is known between two of them is in the journal alone."""

    plant: str
    make: Callable[[], Plant]
    settings: RigLearning
    folder: Path
    journal: Journal
    rig: excitation.Rig
    experiment: Experiment | None

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Steps that are done."""
        return self.journal.entries[1:]

    @property
    def current(self) -> str:
        """Plant file of what the rig is taken for."""
        found = [row["plant"] for row in self.rows if "plant" in row]
        return str(self.folder / found[-1]) if found else self.plant

    @cached_property
    def costs(self) -> dict[str, float]:
        """Seconds of the rig that each step takes."""
        run = 0.0
        if self.experiment:
            controlled, duration = self.experiment.sampled, self.experiment.declaration.duration
            run = controlled.before / controlled.rate + duration * self.experiment.time_scale
        one, tested = self.settings.seconds + excitation.REST, _PULSES * len(self.rig.twin.actuators)
        return {"self-test": tested, "rest": _REST, "before": run, "excitation": 3.0 * one, "record": one} | {
            "experiment": one, "after": run, "discovery": 0.0,
        }  # fmt: skip

    def identity(self) -> str:
        """Hash of all that makes the steps what they are; the hours may be changed before it is gone on with."""
        twin, made, given = self.rig.twin, self.experiment, self.settings
        content: list[Any] = [twin.declaration.canonical(), twin.base.canonical(), given.seconds, given.tolerance]
        content.append(made and manifest.content(made.assembly, made.virtual, {})["declarations"])
        return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()

    def check(self) -> None:
        """Refuse what cannot be done before the rig moves."""
        if self.settings.seconds < PERIOD:
            raise RecordError(f"records of {self.settings.seconds:g} s are too short; give at least {PERIOD:g} s")
        needed = sum(self.costs[name] for name in ("self-test", "rest", "before", "excitation", "after"))
        if needed > 3600.0 * self.settings.hours:
            raise RecordError(
                f"{self.settings.hours:g} h are too few for one round, which takes {needed:.0f} s of the rig: give "
                f"--hours {np.ceil(needed / 36.0) / 100.0:g} or more, or shorter records with --seconds"
            )
        for number, row in enumerate(self.rows, 2):
            foreign_json.check(row, _Entry, f"entry {number} of the journal")

    def work(self) -> None:
        """Take the steps that are not taken yet."""
        steps: Mapping[str, Callable[[Path], dict[str, Any]]] = {
            "self-test": self._self_test, "rest": self._rest, "before": self._masked, "excitation": self._excite,
            "discovery": self._discover, "experiment": self._part, "record": self._record, "after": self._masked,
        }  # fmt: skip
        name = self.rows[-1]["next"] if self.rows else "self-test"
        while name:
            place = self.folder / "steps" / f"{len(self.rows) + 1:02}-{name}"
            if self.settings.tell:
                self.settings.tell(name, min(0.9, 0.1 * len(self.rows)))
            before, began = self.rig.used, time.monotonic()
            row = steps[name](place)
            row = {"seconds": round(self.rig.used - before, 3)} | row | {"wall": round(time.monotonic() - began, 1)}
            spent = sum(one["seconds"] for one in self.rows) + row["seconds"]
            if row["next"] in {"record", "experiment"}:
                left = 3600.0 * self.settings.hours - spent - self.costs["after"]
                if self.costs[row["next"]] > left:
                    row |= {"next": "", "why": f"the budget of {self.settings.hours:g} h is used up"}
            if not row["next"] and name in {"discovery", "record", "experiment"}:
                written = self.folder / row["plant"] if "plant" in row else Path(self.current)
                learned_rig.write(self.folder, written, self.rig.rate)
                row["next"] = "after" if self.experiment else ""
            self.journal.add(event="end", step=name, **row)
            self.rig.say(f"{name}: {learning_page.said(row)}")
            name = row["next"]

    def _reached(self, call: Callable[[], T]) -> T:
        """What a call gives once the plant is reached, which is waited for."""
        until = time.monotonic() + _PATIENCE
        while True:
            try:
                return call()
            except (PlantLostError, PlantRefusedError) as error:
                if time.monotonic() > until:
                    raise
                self.rig.say(f"the plant is waited for: {error}")
                time.sleep(_AGAIN)

    def _self_test(self, place: Path) -> dict[str, Any]:
        """Pulse each actuator, with larger pulses where no answer stands out of the noise."""
        del place
        size, rig = SIZE, self.rig
        while True:
            test = partial(self_test, rig.twin, rig.plant, size=size, lockstep=rig.lockstep, acknowledge=True)
            found = self._reached(test)
            rig.used += self.costs["self-test"]
            clear = {one.actuator for one in found.answers if one.is_clear}
            if len(clear) == len(rig.twin.actuators) or size >= _LARGEST or not found.answers:
                break
            size *= 2.0
        if not found.is_answered or len(clear) < len(rig.twin.actuators):
            found.check()
        gains = ", ".join(f"{one.actuator} -> {one.sensor} {one.gain:.2f}" for one in found.answers if one.is_clear)
        measured = f"answers of those of the plant file: {gains}"
        return {"assumed": "actuators and sensors as declared", "measured": measured, "next": "rest"}

    def _recorded(self, commands: Array, place: Path) -> Recording:
        made = self._reached(partial(self.rig.record, commands, {"what": place.name}))
        made.save(place, overwrite=True)
        return made

    def _rest(self, place: Path) -> dict[str, Any]:
        """Read the sensors at rest: noise and zeros."""
        found = self._recorded(np.zeros((round(_REST * self.rig.rate), len(self.rig.limits))), place)
        twin, said, known = self.rig.twin, list[str](), self.rig.twin.noise()
        for name in twin.sensors:
            column, unit = found[f"sensor.{name}"], twin.declaration.sensors[name].unit
            noise = float(np.std(np.diff(column)) / np.sqrt(2.0))
            said.append(f"{name}: noise {noise:.2g} {unit}, zero {column.mean():.2g} {unit}")
        declared = ", ".join(f"noise of {name} {value:.2g}" for name, value in known.items())
        after = "before" if self.experiment else "excitation"
        return {"assumed": declared or "noise is not declared", "measured": "; ".join(said), "next": after}

    def _masked(self, place: Path) -> dict[str, Any]:
        """Run the experiment, with what is known of the rig by now."""
        is_last = place.name.endswith("after")
        assert self.experiment is not None  # noqa: S101  # only then is there such a step
        made = learned_rig.refined(self.experiment, self.folder) if is_last else self.experiment
        batch_plan.write(made, self.folder if is_last else place)
        wanted = Try(made, place, "", None, self.rig.lockstep, 1.0, _PATIENCE, {})
        try:
            found = self._reached(partial(outcome, wanted, self.make))
        except PlantError as error:
            found = {"end": FAILED, "why": str(error)}
        except MaskingError as error:
            found = {"end": FAILED, "why": str(error)}
        if found["end"] == INTERRUPTED or found.get("cause") in batch_plan.PEOPLE:
            raise MaskingError(f"the run was stopped by a person; start the same again to go on with {self.folder}")
        chi = max(found.get("chi", {}).values(), default=None)
        self.rig.used += self.costs["after"]
        row: dict[str, Any] = {"assumed": self._taken_for, "measured": found["end"], "chi": chi}
        row |= {"why": found["why"]} if "why" in found else {}
        return row | {"next": "" if is_last else "excitation"}

    @property
    def _taken_for(self) -> str:
        return next((row["cause"] for row in reversed(self.rows) if "plant" in row), "the plant file")

    def _excite(self, place: Path) -> dict[str, Any]:
        """Make a small record, one to explain, and one for validation, which stay within the stroke."""
        make = partial(excitation.make, self.rig, place, seconds=self.settings.seconds, progress=lambda part: None)
        made = self._reached(make)
        return self._moved(made.unseen, f"up to {made.size:.2g} of the largest command") | {
            "records": [str((place / name).relative_to(self.folder)) for name in ("fit", "unseen")],
            "size": made.size,
            "next": "discovery",
        }

    def _moved(self, record: Data, how: str) -> dict[str, Any]:
        parts = [f"{far / most:.0%} of {what}" for what, (far, most) in reached(self.rig.twin, record).items()]
        held = "springs and dampers in the commands hold it; " if self.rig.holding else ""
        return {"assumed": f"{held}{how}", "measured": f"moved over {', '.join(parts) or 'its range'}"}

    def _discover(self, place: Path) -> dict[str, Any]:
        """Find what is missing in what the rig is taken for, and decide what is done next."""
        record, unseen = next(row["records"] for row in reversed(self.rows) if "records" in row)
        found = discover(
            str(self.folder / record), plant=self.current, validation=str(self.folder / unseen),
            tolerance=self.settings.tolerance, out=place, overwrite=True, tell=self.settings.tell,
        )  # fmt: skip
        row = learning_page.facts(found)
        experiment, parted = found.next_experiment, [one["step"] for one in self.rows].count("experiment")
        if found.verdict == "ambiguous" and experiment and experiment.separates and parted < _PARTED:
            np.save(place / "commands.npy", experiment.commands)
            return row | {"next": "experiment"}
        written = learned_rig.adopted(found, place, [self.folder / record, self.folder / unseen], self.current)
        row |= {"plant": str(written.relative_to(self.folder))} if written else {}
        is_open = not found.closed and found.verdict not in {"none", "ambiguous"}
        return row | {"next": "record" if is_open and written and row["after"] < _LESS * row["before"] else ""}

    def _part(self, place: Path) -> dict[str, Any]:
        """Make the experiment that parts the two likeliest causes."""
        commands = np.load(self.folder / "steps" / f"{len(self.rows):02}-discovery" / "commands.npy")
        return self._followed(self._recorded(commands, place), place, "the experiment that parts the likeliest two")

    def _record(self, place: Path) -> dict[str, Any]:
        """Excite the rig by other phases."""
        count, size = len(self.rig.limits), next(row["size"] for row in self.rows if "size" in row)
        made = excitation.waves(count, 3 + len(self.rows), self.settings.seconds, self.rig.rate)
        return self._followed(self._recorded(size * self.rig.limits * made, place), place, "other phases")

    def _followed(self, record: Recording, place: Path, how: str) -> dict[str, Any]:
        unseen = next(row["records"][1] for row in self.rows if "records" in row)
        return self._moved(Data.of(record, self.rig.twin, place.name), how) | {
            "records": [str(place.relative_to(self.folder)), unseen],
            "next": "discovery",
        }
