"""Refinement: what a controller's model is missing, found from a record of its plant, and put into the control law.

The controller assumes a model. A record of the plant shows what that model lacks; with it, the block L cancels what the
rig really does, and the masking error falls. Effects in sensors and actuators are no part of that model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from masking.app.workflows import discovery_inputs
from masking.app.workflows.output_folders import own_folder
from masking.app.workflows.settings_keywords import with_fields_of
from masking.control.rig.twin import Twin
from masking.display.json_text import json_text
from masking.display.printed_result import Printed, aligned
from masking.errors import DeclarationError, IntegrationError, ModelError, Problem, SingularityError
from masking.inference.discovery.discovery_result import Discovery
from masking.inference.discovery.discovery_settings import DiscoverySettings
from masking.inference.discovery.discovery_stages import discover
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.search_state import Tell
from masking.lab.records.record_form import RecordForm
from masking.lab.records.recording import Recording
from masking.lab.runs.error_budget import in_full
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from masking.reports import discovery_files, discovery_page, html, one_page, run_report
from masking.reports.discovery_files import Files
from masking.reports.text import capital, listed

EXPERIMENT, NUMBERS, BEFORE, AFTER = "experiment.yaml", "refine.json", "before", "after"
WORTH = 0.9  # of the masking error before: above it, the run is called no better
_BEGIN, _FOUND = 0.1, 0.9  # parts done when the discovery begins and ends


@dataclass(frozen=True)
class Run:
    """One run of the experiment; None, and why, where it could not go on."""

    recording: Recording | None
    trouble: str = ""

    @property
    def chi(self) -> Mapping[str, float] | None:
        """Masking error of each virtual coordinate."""
        return None if self.recording is None else self.recording.manifest["masking_error"]

    @property
    def worst(self) -> float:
        """Largest chi; infinite where the run could not go on."""
        return max(self.chi.values()) if self.chi else float("inf")

    def as_dict(self, folder: Path | None) -> dict[str, Any]:
        """Run as JSON can hold it; `folder` holds its recording and its report."""
        kept = folder if self.recording is not None else None
        return {
            "masking_error": None if self.chi is None else dict(self.chi),
            "trouble": self.trouble,
            "recording": None if kept is None else str(kept),
            "report": None if kept is None else str(kept / "report.html"),
        }


@dataclass(frozen=True, repr=False)
class Refinement(Printed):
    """An experiment before and after its controller's model got what it lacked."""

    before: Run  # with the model as it was
    after: Run  # with what was found
    discovery: Discovery  # what was found
    experiment: Experiment  # with the extended model in its controller
    origin: discovery_files.Origin  # of the discovery
    folder: Path | None  # where all is saved; None where nothing is
    files: Files | None  # those of the discovery in that folder

    @property
    def sentence(self) -> str:
        """Change of the masking error, in a sentence."""
        found = self.discovery
        causes = [text for name, text in discovery_files.written(found) if _is_of_model(found, name)]
        sentence = f"With {listed([*causes, 'adjusted parameters'])} in the controller's model, "
        if self.after.recording is None:
            return f"{sentence}the run could not go on: {self.after.trouble}"
        after = f"{self.after.worst:.2g}"
        if self.before.recording is None:
            return f"{sentence}chi is at most {after}; without, the run could not go on: {self.before.trouble}."
        sentence += f"masking error chi went from {self.before.worst:.2g} to {after} in the worst coordinate"
        if self.after.worst <= WORTH * self.before.worst:
            return f"{sentence}."
        if self.experiment.observer_settings.kind == "differences":
            return f"{sentence}: no better; differences of positions are too rough for it, try 'observer: disturbance'."
        return f"{sentence}: no better, something else limits it; masking run --budget shows what."

    @property
    def uncompensated(self) -> tuple[str, ...]:
        """Sentence for each cause in sensors, actuators and the loop, which the control law does not compensate."""
        sentences = []
        for name, text in discovery_files.written(self.discovery):
            if _is_of_model(self.discovery, name):
                continue
            effect = self.discovery.dictionary[name]
            helps = "a controller predicts a delay of whole samples that the plant file declares"
            helps = effect.remedy if effect.where != "loop" else helps
            why = f"{capital(text)} is not compensated: it is no part of the controller's model"
            sentences.append(f"{why}; what helps: {helps}." if helps else f"{why}.")
        return tuple(sentences)

    def as_dict(self) -> dict[str, Any]:
        """Refinement and where its files lie, as JSON can hold it."""
        out, found, origin = self.folder, self.discovery, self.origin
        content = found.as_dict()
        if out is not None:
            content = discovery_files.as_dict(found, out, origin, discovery_page.sheet(found, origin, out))
        return {
            "sentence": self.sentence,
            "before": self.before.as_dict(None if out is None else out / BEFORE),
            "after": self.after.as_dict(None if out is None else out / AFTER),
            "uncompensated": [*self.uncompensated],
            "experiment": None if out is None else str(out / EXPERIMENT),
            "discovery": content,
        }

    @property
    def headline(self) -> str:
        """Its sentence."""
        return self.sentence

    def __str__(self) -> str:
        names = [*(self.after.chi or self.before.chi or {})]
        rows = [("masking error chi", *names)]
        for what, run in (("before", self.before), ("after", self.after)):
            rows.append((what, *(f"{run.chi[name]:.2g}" if run.chi else "-" for name in names)))
        lines = [discovery_page.summary(self.discovery, self.files), self.sentence, *self.uncompensated]
        lines += aligned(rows)
        if self.folder is not None:
            lines.append(f"experiment: {self.folder / EXPERIMENT}")
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class Refine(RecordForm, DiscoverySettings):
    """Settings of a discovery, and of the runs before and after.

    Args:
        record: folder of a recording of the experiment's plant, or a parquet, csv, mat, h5, npz or json file;
            `FILE@10:20` is its part from 10 s to 20 s.
        plant: a plant that replaces the declared one.
        out: folder to save the files of a discovery, both runs in `before/` and `after/`, each with its report,
            `experiment.yaml` and `refine.json` in, all of them or none; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        tell: called with the step under way, and the fraction done.
    """

    record: str | Path
    plant: str | None = None
    out: str | Path | None = None
    overwrite: bool = False
    tell: Tell | None = None


@with_fields_of(Refine)
def refine(name_or_path: str | Path, settings: Refine) -> Refinement:
    """Find what the controller's model of an experiment lacks, from a record, and run it without and with that.

    Args:
        name_or_path: an experiment file, or the name of a packaged experiment.
        settings: the fields of `Refine`.

    Raises:
        MaskingError: a declaration, a name, a setting or a record is wrong, or the experiment cannot be run.
    """
    out, tell = settings.out, settings.tell
    with own_folder(out, NUMBERS, EXPERIMENT, discovery_files.NUMBERS, overwrite=settings.overwrite):
        experiment = Experiment.load(name_or_path, plant=settings.plant)
        if experiment.declaration.plants and settings.plant is None:
            raise ModelError(
                f"{experiment.declaration.name} has several plants: refine each in an experiment of its own"
            )
        say = tell or (lambda text, part: None)
        twin = discovery_inputs.with_effects(assumed(experiment), settings.effects)
        if not twin.sensors:
            message, remedy = f"{twin.declaration.name} declares no sensors", "declare what the record holds of the rig"
            raise DeclarationError(Problem(None, "sensors", message, remedy))
        given = discovery_inputs.read(twin, settings.record, settings.validation, settings)
        own = replace(settings, parameters=discovery_inputs.parameters(twin, settings.parameters))
        say("running with the model as it is", 0.0)
        before = _run(experiment, lambda part: say("running with the model as it is", _BEGIN * part))
        found = discover(
            twin,
            given.record,
            given.validation,
            own,
            tell=lambda text, part: say(text, _BEGIN + (_FOUND - _BEGIN) * part),
        )
        # What sticks is stiffer than the samples of a controller.
        law = found.law and replace(found.law, explanation=_creeping(found.law.explanation))
        found = replace(found, explanation=_creeping(found.explanation), law=law)
        folder = None if out is None else Path(out)
        with html.staged(folder) as made:
            files = discovery_page.save(found, made, given.origin, lies=folder)
            better = refined(experiment, found, files, folder or made)
            after = _run(better, lambda part: say("running with what was found", _FOUND + (1.0 - _FOUND) * part))
            kept = None if folder is None else discovery_files.paths(found, folder)
            result = Refinement(before, after, found, better, given.origin, folder, kept)
            if folder is not None:
                _write(result, made, folder)
        return result


def assumed(experiment: Experiment) -> Twin:
    """Plant as the controller assumes it: its own model, and of the plant's effects those that it knows."""
    assembly, settings = experiment.assembly, experiment.declaration.controller
    base = assembly.controller_model
    known = {}
    for name, use in assembly.plant.effects.items():
        if experiment.twin.dictionary[use.effect].is_known_to_controller or name in settings.effects:
            change = experiment.assumed.changes.get(name)
            values: dict[str, Any] = {} if change is None else {"parameters": {**use.parameters, **change.parameters}}
            if change is not None and change.enabled is not None:
                values["enabled"] = change.enabled
            known[name] = use.model_copy(update=values)
    own = {} if settings.model else assembly.plant.parameters
    parameters = {n: v for n, v in {**own, **settings.parameters}.items() if n in base.parameters}
    changed = {"model": registry.name_from(base), "parameters": parameters, "effects": known}
    return Twin(assembly.plant.model_copy(update=changed), base)


def refined(experiment: Experiment, found: Discovery, files: Files, folder: Path) -> Experiment:
    """Experiment whose controller assumes what was found, in files that lie here now, and will lie in a folder."""
    settings = experiment.declaration.controller
    values = {name: value for name, value, *_ in discovery_files.refitted(found)}
    if files.model is None:  # all that was found are values
        controller = settings.model_copy(update={"parameters": {**settings.parameters, **values}})
        return experiment.changed(controller=controller.model_dump(mode="json", exclude_defaults=True))
    left = {n: v for n, v in found.twin.declaration.parameters.items() if n not in values}
    controller = settings.model_copy(update={"model": str(files.model), "parameters": left})
    made = experiment.changed(controller=controller.model_dump(mode="json", exclude_defaults=True))
    model = discovery_files.paths(found, folder).model
    controller = made.declaration.controller.model_copy(update={"model": str(model)})
    declaration = made.declaration.model_copy(update={"controller": controller})
    return replace(made, assembly=replace(made.assembly, experiment=declaration))


def _creeping(explained: Explanation) -> Explanation:
    return replace(explained, hypothesis=explained.hypothesis.creeping)


def _is_of_model(found: Discovery, name: str) -> bool:
    """Whether a cause sits in the equations of the rig: an effect of an element, or a parameter."""
    effect = found.dictionary.get(name)
    return effect is None or effect.where == "element"


def _run(experiment: Experiment, progress: Callable[[float], None]) -> Run:
    try:
        return Run(in_full(experiment).run(progress))  # else the two are of different lengths
    except (IntegrationError, SingularityError) as error:
        return Run(None, str(error))


def _write(result: Refinement, made: Path, folder: Path) -> None:
    """Write the runs with their reports, the experiment and the numbers into a folder that will be moved to another."""
    for name, run in ((BEFORE, result.before), (AFTER, result.after)):
        if run.recording is not None:
            run.recording.save(made / name)
            run_report.report(run.recording, made / name)
            one_page.remove(folder / name)
    content = yaml.safe_dump(_experiment(result, folder), sort_keys=False, width=118, allow_unicode=True)
    (made / EXPERIMENT).write_text(content, encoding="utf-8")
    (made / NUMBERS).write_text(json_text(result.as_dict()), encoding="utf-8")


def _experiment(result: Refinement, folder: Path) -> dict[str, Any]:
    """Content of the refined experiment's file, which names other files by their paths from its folder."""
    assembly = result.experiment.assembly
    made = registry.content_from(assembly, folder)
    if result.files is not None and result.files.model is not None:
        made["controller"]["model"] = result.files.model.relative_to(folder).as_posix()
    source = filter(None, (made.get("source"), result.origin.source(result.discovery).replace("discover", "refine", 1)))
    return {"name": made.pop("name"), "source": "; ".join(source), **made}
