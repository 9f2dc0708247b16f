"""Assumed rig: a plant as its controller takes it, with those of its effects that the controller knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from masking.control.rig.twin import PlacedEffect, Twin
from masking.errors import DeclarationError, Problem
from masking.model.declaration import schema
from masking.model.declaration.expression import Expression
from masking.model.effects import Attachment, attach_all


def assumed(twin: Twin, experiment: schema.ExperimentDeclaration) -> Twin:
    """Plant as the controller of an experiment takes it.

    Noise, quantisation and delay are as the rig has them, where `controller.effects` says nothing else. A
    DeclarationError where that names an effect that no controller is designed with.
    """
    named, uses = experiment.controller.effects, twin.declaration.effects
    entries = {name: twin.dictionary[use.effect] for name, use in uses.items()}
    allowed = [name for name, entry in entries.items() if entry.is_known_to_controller or entry.is_held_by_controller]
    remedy = f"allowed: {', '.join(allowed) or 'none'}; others of sensors and actuators are corrected in the plant file"
    problems = []
    for name in named.keys() - set(allowed):
        path, message = f"controller.effects.{name}", f"a controller is not designed with {uses[name].effect}"
        problems.append(Problem(experiment.key_place(path), path, message, remedy))
    if problems:
        raise DeclarationError(problems)
    return twin.changed({**experiment.effects, **named})


def held(twin: Twin, experiment: schema.ExperimentDeclaration, where: str = "element") -> list[PlacedEffect]:
    """Effects at one kind of place of an assumed rig that `controller.effects` gives the controller."""
    named = {f"effects.{name}" for name in experiment.controller.effects}
    effects = (e for e in twin.effects if e.path in named and e.enabled and e.entry.is_held_by_controller)
    return [e for e in effects if e.entry.where == where]


def model(
    base: schema.ModelDeclaration, twin: Twin, experiment: schema.ExperimentDeclaration
) -> schema.ModelDeclaration:
    """Model of a controller with the effects that it holds of an assumed rig, as smooth laws of what sticks.

    A DeclarationError where the model has no such element, or holds the effect already.
    """
    for effect in held(twin, experiment):
        try:
            base = attach_all(base, [Attachment(effect.entry, effect.at, effect.label, _values(twin, effect))])
        except DeclarationError as error:
            path = f"controller.{effect.path}"
            place = experiment.key_place(path)
            raise DeclarationError([replace(one, place=place, path=path) for one in error.problems]) from error
    return base


def _values(twin: Twin, effect: PlacedEffect) -> Mapping[str, float]:
    """Parameters of an effect in coherent SI units; 0 of those that hold what sticks: samples are too far apart."""
    at = twin.model.parameter_values()
    given = {n: x.evaluate(at) if isinstance(x, Expression) else float(x) for n, x in effect.parameters.items()}
    return given | dict.fromkeys(effect.entry.by_step if effect.entry.at_zero else (), 0.0)
