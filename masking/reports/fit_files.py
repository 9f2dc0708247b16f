"""Written: a fit as files: the model with its values and their deviations, and the plant that has this model."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from masking.declaration import registry
from masking.estimation.fit import Fit
from masking.estimation.innovations import KalmanFit

_DIGITS = 10


def save(fit: Fit | KalmanFit, folder: str | Path) -> dict[str, Path]:
    """Write `model.yaml`, `plant.yaml` and `fit.json` into a folder; return their paths.

    The model extends the one that was fitted; the plant has it, and the fitted values of effects.
    """
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    texts = {
        "model": yaml.safe_dump(model(fit, out), sort_keys=False, width=110, allow_unicode=True),
        "plant": yaml.safe_dump(plant(fit, out), sort_keys=False, width=110, allow_unicode=True),
        "fit": json.dumps(fit.as_dict(), indent=2) + "\n",
    }
    paths = {kind: out / f"{kind}.{'json' if kind == 'fit' else 'yaml'}" for kind in texts}
    for kind, text in texts.items():
        paths[kind].write_text(text, encoding="utf-8")
    return paths


def model(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
    """Return the content of a model file that extends the fitted model."""
    twin = fit.twin
    own = [i for i, name in enumerate(fit.names) if name in twin.base.parameters]
    values = {
        fit.names[i]: {"value": _rounded(fit.values[i]), **({"std": _rounded(fit.std[i])} if fit.std[i] > 0.0 else {})}
        for i in own
    }
    return {
        "name": f"{twin.base.name}, identified",
        "extends": registry.name_from(twin.base, folder),
        "parameters": values,
    }


def plant(fit: Fit | KalmanFit, folder: Path) -> dict[str, Any]:
    """Return the content of a plant file with the fitted model, in the same folder, and the fitted effects."""
    twin = fit.twin
    made = twin.declaration.canonical() | {"name": f"{twin.declaration.name}, identified", "model": "model.yaml"}
    left = {n: v for n, v in made.pop("parameters", {}).items() if n in twin.base.parameters and n not in fit.names}
    made |= {"parameters": left} if left else {}  # those that were fitted are the model's now
    own = [registry.name_from(one, folder) for one in twin.declaration.dictionaries]
    made |= {"own_effects": own} if own else {}
    effects: dict[str, Any] = {}
    for effect in twin.effects:
        key = effect.path.removeprefix("effects.")
        before = made["effects"][key]
        given = dict(before.get("parameters", {}))
        fitted = {
            parameter: _rounded(fit.values[i])
            for i, name in enumerate(fit.names)
            for parameter in [name.removeprefix(f"{effect.label}_")]
            if name == f"{effect.label}_{parameter}" and name not in twin.base.parameters
        }
        entry = {**before, "parameters": {**given, **fitted}, "enabled": effect.enabled}
        if effect.at:
            entry["at"] = [effect.at]
        alike = key in effects and {**effects[key], "at": None} == {**entry, "at": None}
        if alike:
            effects[key]["at"] = [*effects[key]["at"], effect.at]
        else:
            effects[effect.label if key in effects else key] = entry
    return {**made, "effects": effects} if effects else made


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
