"""Steps of a rig that learns what it is, each of which follows from what the journal has of those before.

Self-test, sensors and springs at rest, excitation, discovery; then what parts the two likeliest causes, or another
excitation, until the residual is at the noise floor or the hours are used up. Each step is a line of the journal once
it is taken, so that started again after a crash they come to the same end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar, final

import numpy as np

from masking.app.workflows import calibration_excitation as excitation
from masking.app.workflows import learned_rig
from masking.app.workflows.batch_run import Try, outcome
from masking.app.workflows.discover import discover
from masking.app.workflows.rig_settings import RigLearning
from masking.compile.numerics.arrays import Array
from masking.errors import (
    HoursUsedError,
    IntegrationError,
    MaskingError,
    PlantError,
    PlantLostError,
    PlantRefusedError,
    SingularityError,
)
from masking.inference.estimation.identification_data import Data
from masking.inference.procedures.calibration_findings import reached
from masking.inference.procedures.channel_names import Source
from masking.inference.procedures.measurement import springs
from masking.lab import signals
from masking.lab.plants.interface import Plant
from masking.lab.records import stream
from masking.lab.records.journal import Journal
from masking.lab.records.recording import Recording
from masking.lab.runs import batch_plan
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.operator_link import Operator
from masking.lab.runs.self_test import SIZE, self_test
from masking.lab.runs.stopping import FAILED, INTERRUPTED
from masking.model.declaration.quantities import percent
from masking.reports import learning_page

COMMANDS: Final = "commands.npy"
STEPS: Final = "steps"  # folder of what each step leaves
REST: Final = 5.0  # s of sensors at rest
RAMP: Final = 60.0  # s of a slow push
_LARGEST: Final = 0.4  # of the largest command: a pulse of the self-test
PULSES: Final = 2.0  # s that a self-test takes for each actuator
PATIENCE: Final = 60.0  # s that a plant is waited for
_AGAIN: Final = 1.0  # s between tries to reach it
MORE: Final = {"record", "experiment"}  # steps that follow a discovery
_TRIES: Final = 2  # of a run of the experiment that trips or fails
_PARTED: Final = 3  # experiments at most to part the same causes
_LESS: Final = 0.9  # of the error before: what is found is worth another round

T = TypeVar("T")


@final
@dataclass
class Learner:
    """Takes one step after the other; what is known between two of them is in the journal alone."""

    plant: str
    make: Callable[[], Plant]
    settings: RigLearning
    folder: Path
    journal: Journal
    first: Mapping[str, Any]  # entry of the journal, which it begins with once a step is done
    rig: excitation.Rig
    operator: Operator
    experiment: Experiment | None
    costs: Mapping[str, float]  # s of the rig that each step takes
    patience: float  # s that the plant is waited for

    @property
    def rows(self) -> list[dict[str, Any]]:
        """Steps that are done."""
        return self.journal.entries[1:]

    @property
    def current(self) -> str:
        """Plant file of what the rig is taken for."""
        found = [row["plant"] for row in self.rows if "plant" in row]
        return str(self.folder / found[-1]) if found else self.plant

    def work(self) -> None:
        """Take the steps that are not taken yet."""
        steps: Mapping[str, Callable[[Path], dict[str, Any]]] = {
            "self-test": self._self_test, "rest": self._rest, "springs": self._springs, "before": self._masked,
            "excitation": self._excite, "discovery": self._discover, "experiment": self._part, "record": self._record,
            "after": self._masked,
        }  # fmt: skip
        name = self.rows[-1]["next"] if self.rows else "self-test"
        while name:
            place = self.folder / STEPS / f"{len(self.rows) + 1:02}-{name}"
            if self.settings.tell:
                self.settings.tell(name, min(0.9, 0.1 * len(self.rows)))
            before, began = self.rig.now, time.monotonic()
            later = self.costs["after"] if name in MORE else 0.0
            self.rig.until = before + self.left - later
            try:
                row = steps[name](place)
            except HoursUsedError as error:
                if name not in MORE:
                    raise HoursUsedError(f"{name}: {error}; start the same with more --hours to go on") from error
                row = {"assumed": self._taken_for, "measured": str(error), "next": "", "why": self._is_over}
            used = 0.0 if name == "discovery" else round(self.rig.now - before, 3)
            row = {"seconds": used} | row | {"wall": round(time.monotonic() - began, 1)}
            if row["next"] in MORE and self.costs[row["next"]] > self.left - used - self.costs["after"]:
                row |= {"next": "", "why": self._is_over}
            if not row["next"] and name in {"discovery", *MORE}:
                written = self.folder / row["plant"] if "plant" in row else Path(self.current)
                notes = learned_rig.write(self.folder, written, self.rig.rate)
                use = [] if self.experiment else ["an experiment with 'plant: plant.yaml' takes this over"]
                row |= {"next": "after" if self.experiment else "", "carried": "; ".join([*use, *notes])}
            if not self.journal.entries:
                self.journal.add(event="learn", **self.first)
            self.journal.add(event="end", step=name, **row)
            self.rig.say(f"{name}: {learning_page.said(row)}")
            name = row["next"]

    @property
    def left(self) -> float:
        """Seconds of the rig that the steps that are done leave."""
        return 3600.0 * self.settings.hours - float(sum(row["seconds"] for row in self.rows))

    @property
    def _is_over(self) -> str:
        return f"the budget of {self.settings.hours:g} h is used up"

    def _reached(self, call: Callable[[], T]) -> T:
        """What a call gives once the plant is reached, which is waited for."""
        until = None
        while True:
            try:
                found = call()
                self.patience = PATIENCE  # it was there
                return found
            except (PlantLostError, PlantRefusedError) as error:
                until = time.monotonic() + self.patience if until is None else until
                if time.monotonic() >= until:
                    raise
                self.rig.say(f"the plant is waited for: {error}")
                time.sleep(_AGAIN)

    def _named(self, path: Path) -> str:
        """Path as the journal has it."""
        return str(path.relative_to(self.folder))

    def _self_test(self, place: Path) -> dict[str, Any]:
        """Pulse each actuator, with larger pulses where no answer stands out of the noise."""
        del place
        size, rig = SIZE, self.rig
        pulsed = partial(self_test, rig.twin, rig.plant, lockstep=rig.lockstep, acknowledge=rig.acknowledge)
        while True:
            found = self._reached(partial(pulsed, size=size, look=rig.look))
            rig.used += self.costs["self-test"]
            clear = {one.actuator for one in found.answers if one.is_clear}
            is_over = self.costs["self-test"] > rig.until - rig.now
            if len(clear) == len(rig.twin.actuators) or size >= _LARGEST or not found.answers or is_over:
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
        found = self._recorded(np.zeros((round(REST * self.rig.rate), len(self.rig.limits))), place)
        twin, said, known = self.rig.twin, list[str](), self.rig.twin.noise()
        for name in twin.sensors:
            column, unit = found[f"sensor.{name}"], twin.declaration.sensors[name].unit
            noise = float(np.std(np.diff(column)) / np.sqrt(2.0))
            said.append(f"{name}: noise {noise:.2g} {unit}, zero {column.mean():.2g} {unit}")
        declared = ", ".join(f"noise of {name} {value:.2g}" for name, value in known.items())
        return {"assumed": declared or "noise is not declared", "measured": "; ".join(said), "next": "springs"}

    def _springs(self, place: Path) -> dict[str, Any]:
        """Push slowly with one actuator after the other: the stiffness that the sensor shows which moves most."""
        rig, said = self.rig, list[str]()
        ramp = signals.ramp(1.0, duration=RAMP, rate=rig.rate).values
        for i, name in enumerate(rig.twin.actuators if rig.holding is None else ()):
            pushed = ramp * (np.arange(len(rig.limits)) == i)
            made = self._recorded(rig.first_size(pushed) * rig.limits * pushed, place / name)
            most = max(rig.twin.sensors, key=lambda sensor: float(np.ptp(made[f"sensor.{sensor}"])))
            try:
                measured = springs(Source(name, made, rig.twin), input=name, sensor=most).sentence
            except MaskingError as error:
                measured = str(error)
            said.append(f"{name}: {measured}")
        after = "before" if self.experiment else "excitation"
        held = "; ".join(said) or "nothing holds it, so that no force stays"
        return {"assumed": "springs of the plant file", "measured": held, "next": after}

    def _masked(self, place: Path) -> dict[str, Any]:
        """Run the experiment, with what is known of the rig by now."""
        is_last = place.name.endswith("after")
        assert self.experiment is not None  # noqa: S101  # only then is there such a step
        made = learned_rig.refined(self.experiment, self.folder) if is_last else self.experiment
        batch_plan.write(made, self.folder if is_last else place)
        wanted = Try(made, place, "", None, self.rig.lockstep, 1.0, PATIENCE, {})
        found: dict[str, Any] = {"end": "not run", "why": self._is_over}
        for number in range(_TRIES):
            try:
                if number:
                    self._reached(partial(self.rig.rest, self.rig.cooling(found.get("cause"))))
                if self.costs["after"] > self.rig.until - self.rig.now:
                    break
                stream.remove(place)  # of a run that a crash or a trip has cut off
                found = self._reached(partial(outcome, wanted, self.make, self.operator))
            except (PlantLostError, PlantRefusedError):  # nothing is known of the run: it is made by the next start
                raise
            except HoursUsedError:
                break
            except (PlantError, SingularityError, IntegrationError) as error:
                found = {"end": FAILED, "why": str(error)}
            self.rig.used += self.costs["after"]
            if found["end"] == INTERRUPTED or found.get("cause") in batch_plan.PEOPLE:
                raise MaskingError(f"the run was stopped by a person; start the same again to go on with {self.folder}")
            if found["end"] in batch_plan.PLANNED:
                break
        chi = max((x for x in found.get("chi", {}).values() if np.isfinite(x)), default=None)
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
            "records": [self._named(place / name) for name in ("fit", "unseen")], "size": made.size, "next": "discovery"
        }  # fmt: skip

    def _moved(self, record: Data, how: str) -> dict[str, Any]:
        parts = [f"{percent(far / most)} of {what}" for what, (far, most) in reached(self.rig.twin, record).items()]
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
            np.save(place / COMMANDS, experiment.commands)
            return row | {"next": "experiment"}
        written = learned_rig.adopted(found, place, [self.folder / record, self.folder / unseen], self.current)
        row |= {"plant": self._named(written)} if written else {}
        is_open = not found.closed and found.verdict not in {"none", "ambiguous"}
        return row | {"next": "record" if is_open and written and row["after"] < _LESS * row["before"] else ""}

    def _part(self, place: Path) -> dict[str, Any]:
        """Make the experiment that parts the two likeliest causes."""
        commands = np.load(self.folder / STEPS / f"{len(self.rows):02}-discovery" / COMMANDS)
        return self._followed(commands, place, "the experiment that parts the likeliest two")

    def _record(self, place: Path) -> dict[str, Any]:
        """Excite the rig by other phases."""
        size = next(row["size"] for row in self.rows if "size" in row)
        made = self.rig.waves(3 + len(self.rows), self.settings.seconds)
        return self._followed(size * self.rig.limits * made, place, "other phases")

    def _followed(self, commands: Array, place: Path, how: str) -> dict[str, Any]:
        record = Data.of(self._recorded(commands, place), self.rig.twin, place.name)
        unseen = next(row["records"][1] for row in self.rows if "records" in row)
        return self._moved(record, how) | {"records": [self._named(place), unseen], "next": "discovery"}
