"""What a rig has learned, as files: a plant file with its model, and an experiment whose controller has both."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from masking.app.workflows.identify import identify
from masking.control.known_instruments import corrected_sensors, gain_factor
from masking.control.rig.twin import PlacedEffect, Twin
from masking.errors import MaskingError
from masking.inference.discovery.discovery_result import Discovery
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry
from masking.reports import discovery_files, html, model_files

_BETTER: Final = 0.95  # of the error as declared: adjusted parameters are worth a file
_GAINS: Final = ("sensor_gain", "actuator_gain")
_DELAYS: Final = ("sensor_delay", "actuator_delay")
_NO_PART: Final = 1e-6  # of a sample: no delay


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


def write(folder: Path, plant: Path, rate: float) -> tuple[str, ...]:
    """Write a plant file into a folder, with what was found of instruments where a controller at a rate in Hz knows it.

    Gains are those of sensors and actuators. The dead time that all channels have is one of whole samples in the loop;
    what a channel has beside it stays an effect. Returns what of it a controller does not know, in words.
    """
    twin = Twin.load(str(plant))
    kinds = {*_GAINS, *_DELAYS} if plant.is_relative_to(folder) else set[str]()
    found = [one for one in twin.effects if one.enabled and one.kind in kinds]
    gone = {one.path.removeprefix("effects.") for one in found}
    effects = {n: use for n, use in twin.declaration.canonical().get("effects", {}).items() if n not in gone}
    factors = dict.fromkeys(twin.actuators, 1.0)
    for one in found:
        if one.kind == "actuator_gain":
            factors[one.at] *= gain_factor(twin, one)
    delays, notes = _delays(twin, [one for one in found if one.kind in _DELAYS], rate)
    effects |= delays
    if samples := kinds and twin.delay + sum(use["parameters"].get("samples", 0) for use in delays.values()):
        notes = (f"its delay of {samples} samples is that of a controller at {rate:g} Hz", *notes)
    changed = replace(twin, declaration=twin.declaration.model_copy(update={"sensors": corrected_sensors(twin, found)}))
    made = model_files.plant(changed, folder, {"model": registry.name_from(twin.base, folder)}, (), effects)
    if not effects:
        made.pop("effects", None)
    if any(factor != 1.0 for factor in factors.values()):
        if not made.get("actuators"):  # each input is one
            made["actuators"] = {name: one.model_dump(exclude_defaults=True) for name, one in twin.base.inputs.items()}
            made["allocation"] = {name: name for name in twin.base.inputs}
        wires: dict[str, Any] = made["allocation"]
        made["allocation"] = {name: _scaled(str(text), factors) for name, text in wires.items()}
    html.write({folder / discovery_files.PLANT: model_files.text(made)})
    return notes


def _delays(twin: Twin, found: Sequence[PlacedEffect], rate: float) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Effects that late channels are at a rate, and in words what of these a controller does not know."""
    late, common = dict[str, float](), 0.0
    for kind, names in zip(_DELAYS, (twin.sensors, twin.actuators), strict=True):
        own = {
            n: sum(twin.parameter_value(f"{x.label}_tau") for x in found if (x.kind, x.at) == (kind, n)) for n in names
        }
        least = min(own.values(), default=0.0)
        late |= {name: tau - least for name, tau in own.items()}
        common += rate * least
    samples, notes = round(common), list[str]()
    effects: dict[str, Any] = (
        {"delay_found": {"effect": "delay", "parameters": {"samples": samples}}} if samples else {}
    )
    if common < samples - discovery_files.WHOLE:
        notes.append(f"a delay of {common:.3g} samples is written as {samples}, since a controller knows whole samples")
    late |= {name: late[name] + max(0.0, common - samples) / rate for name in twin.actuators}
    for name, tau in late.items():
        if tau * rate > _NO_PART:
            kind = _DELAYS[name in twin.actuators]
            effects[f"late_{name}"] = {"effect": kind, "at": name, "parameters": {"tau": model_files.rounded(tau)}}
            notes.append(
                f"{name} is late by {1e3 * tau:.3g} ms more, which the plant file has and a controller does not know"
            )
    return effects, tuple(notes)


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
