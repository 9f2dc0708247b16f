"""Remedies: changes of an experiment that give its controller what its rig has, and what else costs less error.

Each is a change of one key of a file. Whether it helps is not known here: the error budget runs the changed experiment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from masking.control.known_instruments import gain_factor
from masking.errors import MaskingError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.feasibility import feasibility
from masking.lab.runs.varied_experiment import parameter
from masking.model.declaration import schema
from masking.model.declaration.quantities import number
from masking.model.effects import SATURATION

SAMPLING: Final = "sampling"
PARAMETERS: Final = "parameters"  # of the controller's model that differ from the rig's
_FASTER: Final = (2, 5, 10)  # times the rate that are tried
_REST: Final = 2.0  # s in which offsets are measured
_DIGITS: Final = 6
_EXACT: Final = 1e-9  # of a matrix of a linear model


@dataclass(frozen=True)
class Remedy:
    """One change, in words that name the key and the file, and what makes the experiment with it."""

    words: str
    made: Callable[[], Experiment]  # which raises a MaskingError where the change is refused


def remedies(experiment: Experiment, cause: str, effects: Iterable[str], known: bool) -> Iterator[Remedy]:
    """Changes that may help against a cause, the first the one that gives the controller what it does not have.

    `effects` are those of the cause, as the plant file names them; `known` says that the controller's model holds them.
    What the controller has already is not proposed.
    """
    if experiment.observer_settings.kind in {"differences", "kalman"}:
        yield _controller(experiment, "observer.kind", "disturbance")
    if cause == PARAMETERS:
        yield with_rig_parameters(experiment)
    uses = experiment.assembly.plant.effects
    names = {name: experiment.twin.dictionary[uses[name].effect] for name in effects if name in uses}
    kinds = {entry.name for entry in names.values()}
    if "sensor_offset" in kinds and experiment.sampled.has_model and experiment.declaration.controller.rest is None:
        yield _controller(experiment, "rest", _REST, "s")
    held = experiment.declaration.controller.effects
    unknown = [name for name, entry in names.items() if entry.is_held_by_controller and name not in held]
    if unknown and not known:
        yield _controller(experiment, "effects", _effects(experiment, dict.fromkeys(unknown, True)))
    pairs = zip(experiment.twin.effects, experiment.assumed.effects, strict=True)
    other = {
        e.path.partition(".")[2] for e, taken in pairs if (e.parameters, e.enabled) != (taken.parameters, taken.enabled)
    }
    if wrong := other & names.keys():
        as_they_are = {n: True for n in wrong if names[n].is_held_by_controller}
        left = {n: x for n, x in _effects(experiment, {}).items() if n not in wrong}
        yield _controller(experiment, "effects", {**left, **as_they_are})
    if "actuator_gain" in kinds:
        yield from _gains(experiment, names)
    if cause == SATURATION:
        yield from _smaller(experiment)
    if cause == SAMPLING or any(e.deviation or e.where == "loop" for e in names.values()):
        rate = experiment.declaration.controller.rate or 0.0
        now, *faster = (_rate(times * rate) for times in (1, *_FASTER))
        yield from (_controller(experiment, "rate", value, before=now) for value in faster)


def with_rig_parameters(experiment: Experiment) -> Remedy:
    """Controller whose model has the rig's parameters, as far as it names them."""
    own, rig = experiment.declaration.controller.parameters, experiment.twin
    exact = {name: rig.parameter_value(name) for name in differing_parameters(experiment)}
    return _controller(experiment, "parameters", {**own, **exact})


def differing_parameters(experiment: Experiment) -> tuple[str, ...]:
    """Parameters whose values the controller takes otherwise than its rig has them, where it takes the rig's model."""
    settings, rig = experiment.declaration.controller, experiment.twin
    given = {} if settings.model else settings.parameters
    return tuple(n for n, x in given.items() if n in rig.base.parameters and rig.parameter_value(n) != x)


def _controller(
    experiment: Experiment,
    key: str,
    value: Any,  # noqa: ANN401  # as a YAML file gives it
    unit: str = "",
    before: str | None = None,
) -> Remedy:
    """Experiment with another value of a key of its controller, such as `observer.bandwidth`."""
    settings = experiment.declaration.controller.model_dump(mode="json", exclude_defaults=True)
    outer, _, inner = key.partition(".")
    given = settings.get(outer) if not inner else (settings.get(outer) or {}).get(inner)
    changed = {**(settings.get(outer) or {}), inner: value} if inner else value
    words = f"controller.{key}: {_shown(value, unit)} in {_file(experiment.declaration)}"
    if given is not None and not isinstance(given, Mapping):
        words += f", in place of {before or _shown(given, unit)}"
    return Remedy(words, partial(experiment.changed, controller={**settings, outer: changed}))


def _effects(experiment: Experiment, more: Mapping[str, object]) -> dict[str, object]:
    given = experiment.declaration.controller.effects
    return {**{n: x.model_dump(mode="json", exclude_defaults=True) for n, x in given.items()}, **more}


def _gains(experiment: Experiment, names: Mapping[str, Any]) -> Iterator[Remedy]:
    """Parameter of the controller's model that scales an actuator."""
    twin = experiment.twin
    placed = [e for e in twin.effects if e.path.partition(".")[2] in names and e.enabled]
    weak = {e.at: gain_factor(twin, e) - 1.0 for e in placed if e.kind == "actuator_gain"}
    if weak and (values := _scaling(experiment, weak)):
        own = experiment.declaration.controller.parameters
        yield _controller(experiment, "parameters", {**own, **values})


def _scaling(experiment: Experiment, errors: Mapping[str, float]) -> dict[str, float]:
    """Parameters of the controller's model that scale actuators by 1 + e, by their errors, and change nothing else."""
    known, found, declared = experiment.instruments, dict[str, float](), partial(parameter, experiment.law.model)
    model, allocation = known.model, known.allocation
    dynamics, driven = known.linear()
    for actuator, error in errors.items():
        row = allocation[:, known.actuators.index(actuator)]
        wanted = driven * (1.0 + error * (row != 0.0))
        for name in experiment.assembly.controller_model.parameters.keys() - found.keys():
            if not model.parameter_values().get(name):
                continue
            changed = model.with_parameters(**{name: declared(name)[0] * (1.0 + error)})
            other, scaled = replace(known, model=changed).linear()
            size = np.abs(driven).max() or 1.0
            if np.allclose(other, dynamics, rtol=_EXACT) and np.abs(scaled - wanted).max() <= _EXACT * size:
                found[name] = float(f"{declared(name)[0] * (1.0 + error):.6g}")
                break
    return found if len(found) == len(errors) else {}


def _smaller(experiment: Experiment) -> Iterator[Remedy]:
    """Slower or smaller motions, as far as the wanted motion itself passes a limit."""
    try:
        tried = feasibility(experiment).remedies
    except MaskingError:
        return
    where = _file(experiment.declaration)
    for one in tried:
        if one.shown is not None and one.what == "time_scale":
            scale = float(f"{one.shown * experiment.time_scale:.4g}")
            yield Remedy(f"time_scale: {scale:g} in {where}", partial(experiment.changed, time_scale=scale))
        elif one.shown is not None and one.what == "initial":
            names = experiment.virtual.coordinates
            start = dict(zip(names, (one.shown * experiment.virtual_start).tolist(), strict=False))
            shown = {name: float(f"{x / experiment.virtual.shown[name].size:.4g}") for name, x in start.items()}
            given = {**experiment.declaration.initial, **shown}
            yield Remedy(f"initial: {_shown(shown)} in {where}", partial(experiment.changed, initial=given))


def _rate(hertz: float) -> str:
    return f"{number(hertz / 1e3, _DIGITS)} kHz" if hertz >= 1e3 else f"{number(hertz, _DIGITS)} Hz"


def _file(declaration: schema.Declaration) -> str:
    return Path(next(iter(declaration.files), declaration.name)).name


def _shown(value: object, unit: str = "") -> str:
    """Value as YAML has it, on one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{name}: {_shown(x)}' for name, x in value.items())}}}"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{number(value, _DIGITS) if isinstance(value, int | float) else value} {unit}".rstrip()
