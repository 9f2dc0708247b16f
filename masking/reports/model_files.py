"""Files of models: those of a fit, the model with its values and the plant that has it, and parts that others share."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from masking.control.rig.twin import Twin
from masking.display.json_text import json_text
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.fit import Fit
from masking.model.declaration import registry
from masking.reports import html, one_page
from masking.reports.one_page import Sheet

DIGITS = 10


def rounded(value: float, digits: int = DIGITS) -> float:
    """Value as it is written, with a number of significant digits."""
    return float(f"{value:.{digits}g}")


def parameter(value: float, std: float, digits: int = DIGITS) -> dict[str, float]:
    """Parameter as a file has it: value, and standard deviation, if that is not 0, in a number of digits."""
    return {"value": rounded(value)} | ({"std": rounded(std, digits)} if std > 0.0 else {})


def plant(
    twin: Twin, folder: Path, head: Mapping[str, str], fitted: Collection[str], effects: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Content of a plant file in a folder with a found model; `head` is its name, its model and its source, if any.

    `fitted` are parameters that are the model's or the effects' now, and that the plant no longer sets.
    """
    declared: dict[str, Any] = twin.declaration.canonical()
    made = {n: v for n, v in declared.items() if n not in {"effects", "own_effects"}} | dict(head)
    left = {n: v for n, v in made.pop("parameters", {}).items() if n not in fitted}
    own = [
        registry.name_from(one, folder)
        for one in twin.declaration.dictionaries
        if any(use["effect"] in one.dictionary for use in effects.values())
    ]
    sections = {"parameters": left, "own_effects": own, "effects": dict(effects)}
    return made | {name: content for name, content in sections.items() if content}


class _Entry(dict[str, Any]):
    """A mapping that is written in one line."""


class _Dumper(yaml.SafeDumper):
    """Writes entries of sections in a line each."""


_Dumper.add_representer(_Entry, lambda dumper, entry: dumper.represent_mapping("tag:yaml.org,2002:map", entry, True))


def text(content: Mapping[str, Any]) -> str:
    """Content of a file as YAML, each entry of a section in a line."""
    made = {
        section: {n: _Entry(e) if isinstance(e, dict) else e for n, e in entries.items()}
        if isinstance(entries, dict)
        else entries
        for section, entries in content.items()
    }
    return str(yaml.dump(made, Dumper=_Dumper, sort_keys=False, width=118, allow_unicode=True))


def save_fit(fit: Fit | KalmanFit, folder: str | Path, sheet: Sheet | None = None) -> dict[str, Path]:
    """Write `model.yaml`, `plant.yaml` and `fit.json`, with what one page says, into a folder; return their paths.

    The model extends the one that was fitted; the plant has it, and the fitted values of effects. Raises a
    `RecordError` where the folder cannot be written.
    """
    out = Path(folder)
    texts = {
        out / "model.yaml": text(_fitted_model(fit, out)),
        out / "plant.yaml": text(fitted_plant(fit, out)),
        out / one_page.FIT: json_text(fit.as_dict() | {"sheet": sheet}),
    }
    html.write(texts)
    one_page.remove(out)
    return {path.stem: path for path in texts}


def _fitted_model(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
    """Content of a model file that extends the fitted model."""
    base = fit.twin.base
    values = {
        name: parameter(value, 0.0 if fit.doubt else std)
        for name, value, std in zip(fit.names, fit.values, fit.std, strict=True)
        if name in base.parameters
    }
    heading = {"name": f"{base.name}, identified", "extends": registry.name_from(base, folder)}
    return {**heading, "parameters": values}


def fitted_plant(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
    """Content of a plant file with the fitted model, in the same folder, and the fitted effects."""
    twin = fit.twin
    declared = twin.declaration.canonical()
    effects: dict[str, Any] = {}
    for effect in twin.effects:
        key = effect.path.removeprefix("effects.")
        before = declared["effects"][key]
        prefix = f"{effect.label}_"
        values = dict(before.get("parameters", {}))
        for name, value in zip(fit.names, fit.values, strict=True):
            if name.startswith(prefix) and name not in twin.base.parameters:
                values[name.removeprefix(prefix)] = rounded(value)
        entry = {**before, "parameters": values, "enabled": effect.enabled}
        if effect.at:
            entry["at"] = [effect.at]
        if key in effects and {**effects[key], "at": None} == {**entry, "at": None}:
            effects[key]["at"] = [*effects[key]["at"], effect.at]
        else:
            effects[effect.label if key in effects else key] = entry
    # Parameters of effects stand in their entries now.
    gone = {*fit.names, *(name for name in declared.get("parameters", {}) if name not in twin.base.parameters)}
    heading = {"name": f"{twin.declaration.name}, identified", "model": "model.yaml"}
    return plant(twin, folder, heading, gone, effects)
