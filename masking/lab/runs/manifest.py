"""Manifest of a run: what was declared, on which files, with which result."""

from __future__ import annotations

import datetime
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from masking import process_environment
from masking.compile.numerics.arrays import Array
from masking.control.known_instruments import Instruments
from masking.control.sampled_controller import SampledController
from masking.model.declaration import registry, schema
from masking.model.modelling.model import Model

LIBRARIES = ("masking", "numpy", "numba", "sympy")


def content(assembly: registry.Assembly, virtual: Model, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Manifest of a run: what was declared, the virtual system as it was integrated, and what the run adds."""
    declaration, rate = assembly.experiment, assembly.experiment.controller.rate
    files = {**declaration.files, **assembly.plant.files}
    for model in (assembly.plant_model, assembly.virtual_model, assembly.controller_model):
        files |= model.files
    return {
        "format": "masking recording 1",
        "name": declaration.name,
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "seed": declaration.seed,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}},
        "commit": _commit(files),
        "files": {Path(path).name: digest for path, digest in files.items()},
        "declarations": {
            "experiment": declaration.canonical(),
            "plant": assembly.plant.canonical(),
            "plant_model": assembly.plant_model.canonical(),
            "virtual": assembly.virtual_model.canonical(),
            "controller_model": assembly.controller_model.canonical(),
            **({"dictionaries": [one.canonical() for one in own]} if (own := assembly.plant.dictionaries) else {}),
        },
        "parameters": virtual.parameter_values(),
        "virtual_name": virtual.name,
        "plant_name": assembly.plant.name,
        "oscillators": list(virtual.oscillators),
        "mode": "continuous" if rate is None else "sampled",
        "rate": rate,
        **entries,
    }


def start(virtual: Model, wanted: Array, reached: Mapping[str, float]) -> dict[str, Any]:
    """Where homing should have brought the virtual coordinates, and where it did, by name, as the columns have it.

    `wanted` is a state of the virtual system.
    """
    aims = {name: float(x) / virtual.shown[name].size for name, x in zip(reached, wanted, strict=False)}
    return {"wanted": aims, "reached": dict(reached)}


def observer(sampled: SampledController, kind: str) -> dict[str, Any]:
    """Facts of the observer of a controller."""
    entry: dict[str, Any] = {"kind": kind, "delay": sampled.delay}
    if sampled.has_model:
        known = sampled.instruments
        plan = sampled.plan
        speeds = sampled.observer.bandwidths(plan)
        entry |= {"order": sampled.observer.order, "fastest": plan.fastest}
        entry["noise"] = dict(zip(known.sensors, plan.noise, strict=True))
        entry["bandwidth"] = dict(zip(known.model.coordinates, speeds, strict=True))
    return entry


def limits(plant: schema.PlantDeclaration, instruments: Instruments) -> dict[str, dict[str, Any]]:
    """Limit of each actuator in the unit of its commands, and its rate per s if there is one."""
    found = {}
    for name, limit in plant.limits.inputs.items():
        unit = instruments.unit(name) if name in instruments.actuators else limit.unit
        size = instruments.factors[limit.unit] / instruments.factors[unit]
        found[name] = {"max": limit.max * size, "unit": unit}
        found[name] |= {} if limit.rate is None else {"rate": limit.rate * size}
    return found


def _commit(files: Mapping[str, str]) -> str | None:
    """Git commit of the folder that the experiment was read from, if it is in a repository."""
    folder = Path(next(iter(files))).resolve().parent if files else Path.cwd()
    command = ["git", "rev-parse", "HEAD"]  # the user's own git, wherever it is
    made = process_environment.minimal()  # without variables that name another repository
    try:
        found = subprocess.run(  # noqa: S603
            command, cwd=folder, env=made, capture_output=True, text=True, check=False, timeout=5
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None
