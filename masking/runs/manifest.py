"""Manifest of a run: what was declared, on which files, with which result."""

from __future__ import annotations

import datetime
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from masking.declaration import registry
from masking.modelling.model import Model

LIBRARIES = ("masking", "numpy", "numba", "sympy")


def content(assembly: registry.Assembly, virtual: Model, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest of a run.

    Args:
        assembly: what was declared.
        virtual: the virtual system, as it was integrated.
        entries: what the run adds.
    """
    declaration, rate = assembly.experiment, assembly.experiment.controller.rate
    files = {**declaration.files, **assembly.plant.files}
    for model in (assembly.plant_model, assembly.virtual_model, assembly.believed_model):
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
            "controller_model": assembly.believed_model.canonical(),
        },
        "parameters": virtual.parameter_values(),
        "virtual_name": virtual.name,
        "plant_name": assembly.plant.name,
        "oscillators": list(virtual.oscillators),
        "mode": "continuous" if rate is None else "sampled",
        "rate": rate,
        **entries,
    }


def _commit(files: Mapping[str, str]) -> str | None:
    """Return the git commit of the folder that the experiment was read from, if it is in a repository."""
    folder = Path(next(iter(files))).resolve().parent if files else Path.cwd()
    try:
        found = subprocess.run(  # the user's own git, wherever it is
            ["git", "rev-parse", "HEAD"],  # noqa: S607
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=5,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None
