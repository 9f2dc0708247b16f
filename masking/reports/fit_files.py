"""Files of a fit: the model with its values and their deviations, and the plant that has this model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from masking.display.json_text import json_text
from masking.inference.estimation.extended_kalman import KalmanFit
from masking.inference.estimation.fit import Fit
from masking.model.declaration import registry
from masking.reports import html, model_files, one_page
from masking.reports.one_page import Sheet


def save(fit: Fit | KalmanFit, folder: str | Path, sheet: Sheet | None = None) -> dict[str, Path]:
    """Write `model.yaml`, `plant.yaml` and `fit.json`, with what one page says, into a folder; return their paths.

    The model extends the one that was fitted; the plant has it, and the fitted values of effects. Raises a
    `RecordError` where the folder cannot be written.
    """
    out = Path(folder)
    texts = {
        out / "model.yaml": model_files.text(model(fit, out)),
        out / "plant.yaml": model_files.text(plant(fit, out)),
        out / one_page.FIT: json_text(fit.as_dict() | {"sheet": sheet}),
    }
    html.write(texts)
    one_page.remove(out)
    return {path.stem: path for path in texts}


def model(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
    """Content of a model file that extends the fitted model."""
    base = fit.twin.base
    values = {
        name: model_files.parameter(value, 0.0 if fit.doubt else std)
        for name, value, std in zip(fit.names, fit.values, fit.std, strict=True)
        if name in base.parameters
    }
    heading = {"name": f"{base.name}, identified", "extends": registry.name_from(base, folder)}
    return {**heading, "parameters": values}


def plant(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
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
                values[name.removeprefix(prefix)] = model_files.rounded(value)
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
    return model_files.plant(twin, folder, heading, gone, effects)
