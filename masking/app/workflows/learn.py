"""The verb rig learn: a rig that finds out by itself what it is, unattended and within its limits."""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.app.workflows import calibration_excitation as excitation
from masking.app.workflows import learning_steps
from masking.app.workflows.learning_steps import PULSES, RAMP, REST
from masking.app.workflows.output_folders import check_folder, refuse_earlier
from masking.app.workflows.rig_settings import RigLearning
from masking.app.workflows.settings_keywords import with_fields_of
from masking.control.rig.twin import Twin
from masking.display.printed_result import Printed
from masking.errors import DeclarationError, MaskingError, ModelError, RecordError
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.lab.plants import adapters
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.records import foreign_json
from masking.lab.records.journal import Journal
from masking.lab.records.owned_folder import OwnedFolder
from masking.lab.runs import batch_plan, manifest
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.operator_link import Operator
from masking.reports import learning_page
from masking.reports.discovery_files import PLANT

JOURNAL: Final = "learn.journal"
_ANOTHER: Final = "name another folder with --out (in Python, out=)"
RETRIES: Final = 3  # after a trip that is not by the motion


@dataclass(frozen=True)
class _Entry:
    """What every step of a journal says."""

    event: str
    step: str
    next: str
    seconds: float


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
        ModelError: the plant file has no limits to stay within or no sensors, or records are too short.
        DeclarationError: the experiment does not fit the plant file, or a file is wrong.
        RecordError: the hours are too few for one round, or the folder holds something else or cannot be written.
        PlantError: the self-test refuses the rig, or it is not reached, refuses, or has other channels.
        MaskingError: a person has stopped it, or the rig trips again and again.
    """
    twin, folder = Twin.load(plant), check_folder(settings.out)
    twin.validate()
    experiment = None if settings.experiment is None else _experiment(settings.experiment, plant)
    rate, say = experiment.sampled.rate if experiment else excitation.RATE, settings.say or (lambda text: None)
    driven = excitation.Rig(
        twin, rig(), rate, settings.lockstep, say, acknowledge=settings.acknowledge, retries=RETRIES
    )
    costs = _costs(driven, experiment, settings)
    known = _identity(twin, experiment, settings)
    with OwnedFolder(folder), contextlib.ExitStack() as way_out:
        if not (folder / JOURNAL).exists():
            refuse_earlier(
                folder, PLANT, batch_plan.EXPERIMENT, learning_page.PAGE, learning_steps.STEPS, remedy=_ANOTHER
            )
        journal, operator = way_out.enter_context(Journal(folder / JOURNAL)), way_out.enter_context(Operator())
        operator.switch.publish(name="learning", plant=twin.declaration.name, since=time.time())
        driven.look = operator.look
        driven.acknowledge |= bool(journal.entries)  # that of a trip after the first step
        if journal.entries and journal.entries[0].get("plan") != known:
            raise RecordError(
                f"{folder} holds what another rig has learned: the plant file, the experiment or the settings are "
                "others, or one of both is a twin; name another folder with --out"
            )
        patience = learning_steps.PATIENCE if journal.entries else 0.0
        first = {"plan": known, "name": twin.declaration.name}
        made = learning_steps.Learner(
            plant, rig, settings, folder, journal, first, driven, operator, experiment, costs, patience
        )
        for number, row in enumerate(made.rows, 2):
            foreign_json.check(row, _Entry, f"entry {number} of the journal")
        made.work()
        found = Learning(twin.declaration.name, tuple(made.rows), folder)
        learning_page.save(found.sentence, found.rows, found.as_dict(), folder)
        return found


def _costs(rig: excitation.Rig, experiment: Experiment | None, settings: RigLearning) -> dict[str, float]:
    """Seconds of the rig that each step takes; a RecordError where there are too few for one round.

    A ModelError where records are too short, and a DeclarationError where the tolerance is none.
    """
    excitation.check(rig.twin, settings.seconds)
    DiscoverySettings(tolerance=settings.tolerance)
    run, one, each = 0.0, settings.seconds + rig.beside, len(rig.twin.actuators)
    if experiment:
        run = experiment.sampled.before / experiment.sampled.rate + rig.beside
        run += experiment.declaration.duration * experiment.time_scale
    once = {"self-test": PULSES * each, "rest": REST, "springs": (RAMP + rig.beside) * each}
    once |= {"before": run, "excitation": 3.0 * one}
    needed = sum(once.values()) + run
    if not needed <= 3600.0 * settings.hours:
        raise RecordError(
            f"{settings.hours:g} h are too few for one round, which takes {needed:.0f} s of the rig: give "
            f"--hours {np.ceil(needed / 36.0) / 100.0:g} or more, or shorter records with --seconds"
        )
    return once | {"record": one, "experiment": one, "after": run}


def _identity(twin: Twin, experiment: Experiment | None, settings: RigLearning) -> str:
    """Hash of all that makes the steps what they are; the hours may be changed before it is gone on with."""
    content: list[Any] = [twin.declaration.canonical(), twin.base.canonical(), settings.seconds, settings.tolerance]
    content.append(settings.at is None)  # a twin, of which a rig must not take over what was found
    if experiment:
        content.append(manifest.content(experiment.assembly, experiment.virtual, {})["declarations"])
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def _experiment(name: str, plant: str) -> Experiment:
    """Experiment on the rig; a DeclarationError where a file is wrong, and a RecordError where it does not fit."""
    try:
        made = Experiment.load(name, plant=plant)
        made.validate()
        if not made.has_observer or made.declaration.controller.homing is None:
            raise ModelError("its controller needs a rate, an observer that reads sensors, and homing")
    except DeclarationError:
        raise
    except MaskingError as error:
        raise RecordError(f"the experiment {name} does not fit the rig {plant}: {error}") from error
    return made
