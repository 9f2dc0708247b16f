"""The virtual system with the inputs that an experiment gives it: each is a definition of time and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from masking.errors import Problem, nearest
from masking.model.declaration import dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.input_source import InputSource
from masking.model.declaration.model_checks import check_symbols, problem_at, strangers
from masking.model.declaration.schema import ExperimentDeclaration, ModelDeclaration, Parameter, PlantDeclaration

# Coefficients of the polynomial that an input is between two instants, and the first of the two.
CELLS: Final = ("c0", "c1", "c2", "c3", "at")


def check_inputs(
    experiment: ExperimentDeclaration, plant: PlantDeclaration, rig: ModelDeclaration, virtual: ModelDeclaration
) -> Iterator[Problem]:
    """Yield what is wrong with the sources of the inputs of a virtual system; one that has none is wrong, too.

    The plant's sensors may be sources, and `rig` is its model; the virtual system is as it was declared.
    """
    missing = [name for name in virtual.inputs if name not in experiment.inputs]
    if missing:
        shown = ", ".join(f"{name}: 0" for name in missing)
        message = f"{virtual.name} has inputs that are not given: {', '.join(missing)}"
        remedy = f"say where each comes from under inputs, a number at least: 'inputs: {{{shown}}}'"
        at_inputs = bool(experiment.inputs)
        yield problem_at(experiment, "inputs" if at_inputs else "virtual", message, remedy, at_key=at_inputs)
    yield from strangers(experiment, "inputs", experiment.inputs, virtual.inputs, f"an input of {virtual.name}")
    for name, source in experiment.inputs.items():
        path = f"inputs.{name}"
        for part, message, remedy in source.problems():
            yield problem_at(experiment, f"{path}.{part}" if part else path, message, remedy, at_key=True)
        if source.expression is not None:
            yield from check_symbols(source.expression, ["t", *virtual.parameters], ())
        if source.sensor is not None and source.sensor not in plant.sensors:
            message = f"'{source.sensor}' is not a sensor of {plant.name}"
            yield problem_at(experiment, f"{path}.sensor", message, nearest(source.sensor, plant.sensors))
        if source.push is not None and source.push not in rig.coordinates:
            message = f"'{source.push}' is not a coordinate of {rig.name}"
            yield problem_at(experiment, f"{path}.push", message, nearest(source.push, rig.coordinates))
        yield from _live(experiment, name, source)

    live = [name for name, source in experiment.inputs.items() if source.is_live]
    if experiment.controller.external == "felt" and not live:
        message = f"external forces are to be felt, and no input of {virtual.name} takes them"
        remedy = "give one of its inputs from a force sensor, such as 'F: {sensor: force}', or 'F: {push: x, above: 1}'"
        yield problem_at(experiment, "controller.external", message, remedy, at_key=True)
    pushes = [name for name in live if experiment.inputs[name].push is not None]
    if experiment.controller.external == "rejected" and pushes:
        message = f"a push is rejected where external forces are not felt, and {pushes[0]} is to feel it"
        remedy = "write 'controller: {external: felt}'"
        yield problem_at(experiment, f"inputs.{pushes[0]}", message, remedy, at_key=True)


def _live(experiment: ExperimentDeclaration, name: str, source: InputSource) -> Iterator[Problem]:
    """Check that what is known in the run alone has a controller that reads sensors."""
    settings, path = experiment.controller, f"inputs.{name}"
    kind = None if settings.observer is None else settings.observer.kind
    if source.is_live and (settings.rate is None or kind == "exact"):
        message = f"a {source.kinds[0]} is known to a controller that reads sensors"
        remedy = "write 'controller: {rate: 500 Hz, observer: disturbance}'"
        yield problem_at(experiment, path, message, remedy, at_key=True)
    elif source.push is not None and kind not in {None, "disturbance"}:
        message = "a push is what a disturbance observer finds"
        remedy = "write 'observer: disturbance', or take a force sensor"
        yield problem_at(experiment, path, message, remedy, at_key=True)


def cell(name: str, part: str) -> str:
    """Name of the parameter that holds a part, one of `CELLS`, of an input."""
    return f"{name}_{part}"


def internals(sources: Iterable[str]) -> set[str]:
    """Names of the parameters that stand for inputs in a virtual system, given those that have sources."""
    return {cell(name, part) for name in sources for part in (*CELLS, "time", "unit")}


def with_inputs(model: ModelDeclaration, sources: Mapping[str, InputSource]) -> ModelDeclaration:
    """Virtual system whose given inputs are definitions: expressions of the time, or polynomials of it.

    What is known point by point, or in the run, is c0 + c1 (t - at) + c2 (t - at)^2 + c3 (t - at)^3 between two
    instants, with parameters that the run sets. An expression of numbers and t is in the declared unit of the input,
    with t in the model's unit of time; one that holds parameters of the model has their units.
    """
    given = {name: source for name, source in sources.items() if name in model.inputs}
    if not given:
        return model
    parameters, definitions = dict(model.parameters), dict(model.definitions)
    is_plain = dimensions.is_plain(model)
    for name, source in given.items():
        unit = model.inputs[name].unit
        if source.expression is None:
            above = unit if unit == "1" else f"({unit})"
            units = ["1"] * len(CELLS) if is_plain else [unit, *(f"{above}/s**{power}" for power in (1, 2, 3)), "s"]
            for part, its in zip(CELLS, units, strict=True):
                meaning = f"of the input {name}, set by the run"
                parameters[cell(name, part)] = Parameter(value=0.0, unit=its, meaning=meaning)
            since = f"(t - {cell(name, 'at')})"
            nested = f"{cell(name, 'c2')} + {since}*{cell(name, 'c3')}"
            text = f"{cell(name, 'c0')} + {since}*({cell(name, 'c1')} + {since}*({nested}))"
            definitions[name] = Expression(text, path=f"definitions.{name}")
            continue
        text = source.expression.text
        if is_plain or source.expression.names & model.parameters.keys():
            definitions[name] = source.expression
            continue
        if "t" in source.expression.names:
            scale = model.scales.get("time")
            value, its = (1.0, "s") if scale is None else (scale.value, scale.unit)
            parameters[f"{name}_time"] = Parameter(value=value, unit=its, meaning=f"unit of time of the input {name}")
            text = source.expression.renamed({"t": f"(t/{name}_time)"})
        parameters[f"{name}_unit"] = Parameter(value=1.0, unit=unit, meaning=f"unit of the input {name}")
        definitions[name] = Expression(f"{name}_unit*({text})", source.expression.place, source.expression.path)
    inputs = {name: entry for name, entry in model.inputs.items() if name not in given}
    return model.model_copy(update={"inputs": inputs, "parameters": parameters, "definitions": definitions})
