"""What a rig has learned, as files: a plant file with its model, and an experiment whose controller has both."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from masking.app.workflows.identify import identify
from masking.control.rig.twin import PlacedEffect, Twin
from masking.errors import MaskingError
from masking.inference.discovery.discovery_result import Discovery
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from masking.reports import discovery_files, html, model_files

_BETTER: Final = 0.95  # of the error as declared: adjusted parameters are worth a file
_GAINS: Final = ("sensor_gain", "actuator_gain")
_DELAYS: Final = ("sensor_delay", "actuator_delay")


def adopted(found: Discovery, folder: Path, records: Sequence[Path], plant: str) -> Path | None:
    """Plant file of what was found in a folder; None where the plant file it was searched with stays.

    Where no cause is missing and adjusted parameters leave less, these are fitted to the record.
    """
    files, (before, after) = discovery_files.paths(found, folder), found.simulation_error.validation
    if files.plant is not None:
        return files.plant
    if max(after.values()) > _BETTER * max(before.values()):
        return None
    record, unseen = map(str, records)
    try:
        identify(record, plant=plant, validation=[unseen], out=folder / "fit", overwrite=True)
    except MaskingError:
        return None
    return folder / "fit" / discovery_files.PLANT


def write(folder: Path, plant: Path, rate: float) -> Path:
    """Write a plant file into a folder, with what was found of instruments where a controller at a rate in Hz knows it.

    Gains are those of sensors and actuators, and a dead time that all of them have is one of whole samples in the loop.
    """
    twin, found = Twin.load(str(plant)), list[PlacedEffect]()
    known = {name: {"gain": 1.0, "delay": 0.0} for name in (*twin.sensors, *twin.actuators)}
    for one in twin.effects if plant.is_relative_to(folder) else ():
        if one.kind in _GAINS and one.enabled:
            found.append(one)
            known[one.at]["gain"] *= 1.0 + twin.parameter_value(f"{one.label}_e")
        elif one.kind in _DELAYS and one.enabled:
            found.append(one)
            known[one.at]["delay"] += twin.parameter_value(f"{one.label}_tau")
    gone = {one.path.removeprefix("effects.") for one in found}
    effects = {n: use for n, use in twin.declaration.canonical().get("effects", {}).items() if n not in gone}
    common = sum(min((known[n]["delay"] for n in those), default=0.0) for those in (twin.sensors, twin.actuators))
    if samples := round(common * rate):
        effects["delay_found"] = {"effect": "delay", "parameters": {"samples": samples}}
    made = model_files.plant(twin, folder, {"model": registry.name_from(twin.base, folder)}, (), effects)
    if not effects:
        made.pop("effects", None)
    for name in twin.sensors:
        gain = made["sensors"][name]["gain"]
        made["sensors"][name]["gain"] = gain | {"value": model_files.rounded(gain["value"] * known[name]["gain"])}
    factors = {name: known[name]["gain"] for name in twin.actuators if known[name]["gain"] != 1.0}
    if factors:
        if not made.get("actuators"):  # each input is one
            made["actuators"] = {name: one.model_dump(exclude_defaults=True) for name, one in twin.base.inputs.items()}
            made["allocation"] = {name: name for name in twin.base.inputs}
        wires: dict[str, Any] = made["allocation"]
        made["allocation"] = {name: _scaled(str(text), factors) for name, text in wires.items()}
    path = folder / discovery_files.PLANT
    html.write({path: model_files.text(made)})
    return path


def _scaled(text: str, factors: dict[str, float]) -> str:
    """Expression in which each command is multiplied by what its actuator does more."""

    def replaced(match: re.Match[str]) -> str:
        name = match.group()
        return f"({model_files.rounded(factors[name])}*{name})" if name in factors else name

    return re.sub(r"[A-Za-z_]\w*", replaced, text)


def refined(experiment: Experiment, folder: Path) -> Experiment:
    """Experiment on the plant file in a folder, whose controller has its model and the errors of its sensors."""
    made = Experiment(registry.assemble(experiment.declaration, str(folder / discovery_files.PLANT)))
    settings = made.declaration.controller.model_dump(mode="json", exclude_defaults=True)
    kept = {name: x for name, x in settings.items() if name not in {"model", "parameters"}}
    wrong = [e for e in made.twin.effects if e.entry.where == "sensor" and e.entry.is_held_by_controller and e.enabled]
    known = {e.path.removeprefix("effects."): True for e in wrong}
    return made.changed(controller={**kept, "effects": {**kept.get("effects", {}), **known}} if known else kept)
