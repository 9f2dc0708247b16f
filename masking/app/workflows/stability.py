"""The verb stability: of a model, or of an experiment with its closed loop beside the virtual system."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from masking.analysis.stability.lyapunov_exponent import largest_exponent
from masking.analysis.stability.study import LoopModes, Stability, loop_modes, study
from masking.app.workflows.output_folders import own_folder
from masking.errors import DeclarationError, Problem
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import loop_state, rig_state
from masking.model.declaration import catalogue
from masking.model.modelling.model import load_model
from masking.reports import stability_page


def stability(
    name_or_path: str | Path,
    *,
    kind: Literal["model", "experiment"] | None = None,
    changes: Mapping[str, float] | None = None,
    box: Mapping[str, tuple[float, float]] | None = None,
    exponent: float | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    tell: Callable[[str, float], None] | None = None,
) -> Stability:
    """Find the equilibria and modes of a system, and what its energy proves of all its motions.

    Args:
        name_or_path: a model; or an experiment, whose virtual system is studied, with the eigenvalues of the closed
            loop beside it.
        kind: 'model' or 'experiment', where a name stands for both; by default the model.
        changes: parameters that replace the declared ones, in the declared units.
        box: where equilibria are looked for, and where what is not proved everywhere is, by coordinate and velocity
            (`x1'`), in the scales of the system, or in the declared units.
        exponent: time over which the largest Lyapunov exponent of the motion from the initial state is found, in the
            scales of the system, or in s; it is not where none is given.
        out: folder to save `stability.html`, `stability.json` and figures in; by default nothing is saved.
        overwrite: whether an earlier result in that folder may be replaced.
        tell: called with the step under way, and the fraction done.

    Raises:
        DeclarationError: a declaration is wrong, or of another kind.
        ModelError: the box names what is no coordinate or velocity, or no rig position gives the virtual equilibrium.
    """
    with own_folder(out, "stability.json", overwrite=overwrite):
        known = kind or catalogue.kind_of(name_or_path)
        if known not in {"model", "experiment"}:
            message = f"{name_or_path} is a {known}, which has no stability of its own"
            raise DeclarationError(Problem(None, "", message, "name a model or an experiment"))
        experiment = None if known == "model" else Experiment.load(name_or_path, changes=changes)
        if experiment is None:
            model = load_model(name_or_path).with_parameters(**(changes or {}))
            model = model.dimensionless() if model.declaration.scales else model
        else:
            model = experiment.virtual
        found, say = study(model, box), tell or (lambda text, part: None)
        if exponent is not None:
            motion = largest_exponent(model, exponent, progress=lambda part: say("following the motion", part))
            found = replace(found, exponent=motion)
        if experiment is not None and found.rest is not None and found.rest.points:
            say("compiling the closed loop", 0.5)
            found = replace(found, loop=_loop(experiment, found))
        if out is not None:
            stability_page.save(found, out)
        return found


def _loop(experiment: Experiment, found: Stability) -> LoopModes:
    """Eigenvalues of the closed loop at the virtual equilibrium that is nearest to 0."""
    loop, n = experiment.loop, len(experiment.plant.coordinates)
    point, modes = min(found.points, key=lambda x: max(map(abs, x[0].position.values())))
    virtual = np.array([*point.position.values(), *([0.0] * len(point.position))])
    beside = None if experiment.passive is None else experiment.passive.initial()
    state = loop_state(loop, virtual, rig_state(loop, virtual, passive=beside))
    lengths = np.ones(len(state))
    lengths[:n] = loop.match.lengths
    lengths[n : 2 * n] = loop.match.lengths / experiment.time_scale
    return loop_modes(loop, state, lengths, experiment.time_scale, modes.eigenvalues)
