"""Variation: an experiment with other values of what a sweep names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from masking.control.rig.twin import PlacedEffect
from masking.errors import DeclarationError, Problem, nearest
from masking.lab.runs.experiment import Experiment
from masking.model.declaration.expression import Expression
from masking.model.declaration.units import combined
from masking.model.modelling.model import Model

_NUMBERS: Final = ("duration", "seed", "tolerance", "time_scale")  # of an experiment
_LIGHT: Final = {"parameters", "initial", "seed"}  # need no declaration to be read anew: a run checks their values
PLANT: Final = "plant"  # parameters of its model


@dataclass(frozen=True)
class Place:
    """Where a value stands."""

    path: tuple[str, ...]  # section of the experiment, keys in it; or `plant` and a parameter
    declared: float | Expression | None  # its value, in its unit; None where there is none
    unit: str = "1"  # in which it is declared, and given


def place(experiment: Experiment, name: str) -> Place:
    """Place behind a name of a sweep, in an experiment that varies.

    A name is a parameter, coordinate or velocity (`x1'`) of the virtual system; `EFFECT.PARAMETER` of the plant;
    `plant.PARAMETER` of its model; a number of the experiment, such as `duration`; or the path of one. A
    DeclarationError where it stands for nothing.
    """
    declaration, plant = experiment.declaration, experiment.assembly.plant
    virtual = Model(experiment.assembly.virtual_model, declaration.parameters)
    head, _, rest = name.partition(".")
    if name in virtual.parameters:
        return Place(("parameters", name), *parameter(virtual, name))
    if name in virtual.state_names:
        start, unit = _initial(virtual, name)
        return Place(("initial", name), declaration.initial.get(name, start), unit)
    if name in _NUMBERS:
        return Place((name,), getattr(declaration, name))
    if head == PLANT and rest in experiment.assembly.plant_model.parameters:
        own = {n: x for n, x in plant.parameters.items() if n in experiment.assembly.plant_model.parameters}
        return Place((PLANT, rest), *parameter(Model(experiment.assembly.plant_model, own), rest))
    effects = {effect.label: effect for effect in experiment.twin.effects} | {
        effect.path.removeprefix("effects."): effect for effect in experiment.twin.effects
    }
    label = head if head in effects else next((n for n in effects if head == PLANT and rest.startswith(f"{n}_")), "")
    if label:
        effect, key = effects[label], rest if head == label else rest.removeprefix(f"{label}_")
        if key in effect.entry.parameters:
            use = effect.path.removeprefix("effects.")
            value = effect.parameters.get(key, effect.entry.parameters[key].value)
            return Place(("effects", use, "parameters", key), value, _unit_of(experiment, effect, key))
    if rest and head in type(declaration).model_fields:
        return Place((head, *rest.split(".")), None)
    allowed = [*virtual.parameters, *virtual.state_names, *_NUMBERS]
    allowed += [f"{n}.{p}" for n, effect in effects.items() for p in effect.entry.parameters]
    allowed += [f"{PLANT}.{n}" for n in experiment.assembly.plant_model.parameters]
    message = f"{experiment.stem} has nothing called '{name}' to vary"
    raise DeclarationError(Problem(None, name, message, nearest(name, allowed)))


def _unit_of(experiment: Experiment, effect: PlacedEffect, key: str) -> str:
    """Unit of a parameter of an effect, by its place."""
    known = experiment.twin.model.declaration.parameters.get(f"{effect.label}_{key}")
    sensor, actuators = experiment.assembly.plant.sensors.get(effect.at), experiment.instruments.actuators
    letters = {"S": sensor.unit if sensor else "1"}
    letters["U"] = experiment.instruments.unit(effect.at) if effect.at in actuators else "1"
    return known.unit if known else combined(effect.entry.parameters[key].unit, letters)


def parameter(model: Model, name: str) -> tuple[float, str]:
    """Parameter in its declared unit, and that unit."""
    unit = model.declaration.parameters[name].unit
    return model.value(name) / model.units.conversions[unit].factor, unit


def _initial(model: Model, name: str) -> tuple[float | None, str]:
    """Initial value of a state in its declared unit, and that unit."""
    d, unit = model.declaration, model.shown[name].unit
    if (coordinate := d.coordinates.get(name.rstrip("'"))) is None:
        return d.states[name].initial, unit
    return (coordinate.initial_velocity if name.endswith("'") else coordinate.initial), unit


def varied(experiment: Experiment, settings: Sequence[tuple[Place, float, bool]]) -> Experiment:
    """Experiment with other values: each with its place, and whether the declared one is multiplied by it.

    The declaration of the experiment is sound; a DeclarationError as for a file where that of the result is not.
    """
    sections, parameters = dict[str, Any](), dict[str, float]()
    values = [(where.path, value(where, number, is_factor=by)) for where, number, by in settings]
    is_light = all(path[0] in _LIGHT and isinstance(one, float) for path, one in values)
    own = experiment.declaration
    whole: Mapping[str, Any] = {"parameters": own.parameters, "initial": own.initial} if is_light else own.canonical()
    for path, one in values:
        if path[0] == PLANT:
            parameters[path[1]] = float(one)
        elif len(path) == 1:
            sections[path[0]] = int(one) if path[0] == "seed" else one
        else:
            sections.setdefault(path[0], whole.get(path[0], {}))
            sections[path[0]] = _put(sections[path[0]], path[1:], one)
    if is_light:
        changed = own.model_copy(update=sections)
        return replace(experiment, assembly=replace(experiment.assembly, experiment=changed))
    made = experiment.changed(**sections) if sections else experiment
    return _with_plant(made, parameters) if parameters else made


def value(where: Place, number: float, *, is_factor: bool) -> float | str:
    """Value that a place gets: a number, or an expression for multiples of one, where there is a declared value."""
    if not is_factor:
        return float(number)
    if where.declared is None:
        name = ".".join(where.path)
        raise DeclarationError(Problem(None, name, "has no declared value to multiply", "give values without x:"))
    if isinstance(where.declared, Expression):
        return f"{float(number)!r}*({where.declared.text})"
    return float(number) * float(where.declared)


def _put(section: Mapping[str, Any], path: Sequence[str], one: float | str) -> dict[str, Any]:
    if len(path) == 1:
        return {**section, path[0]: one}
    inner = section.get(path[0], {})
    return {**section, path[0]: _put(inner if isinstance(inner, Mapping) else {}, path[1:], one)}


def _with_plant(experiment: Experiment, parameters: Mapping[str, float]) -> Experiment:
    """Experiment whose plant has other parameters, of which its controller knows nothing."""
    assembly, declaration = experiment.assembly, experiment.declaration
    names = () if declaration.controller.model else parameters
    known = {name: place(experiment, f"{PLANT}.{name}").declared for name in names}
    assumed = {n: x for n, x in known.items() if isinstance(x, float)} | dict(declaration.controller.parameters)
    controller = declaration.controller.model_copy(update={"parameters": assumed})
    changed = declaration.model_copy(update={"controller": controller})
    plant = assembly.plant.model_copy(update={"parameters": {**assembly.plant.parameters, **parameters}})
    return replace(experiment, assembly=replace(assembly, experiment=changed, plant=plant))
