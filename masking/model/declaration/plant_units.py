"""The units of a plant: its limits are in units of what they bound, and its sensors give what they say.

Nothing is converted: units of one dimension, such as V and mV, are not distinguished. A unit that is not written is not
checked, nor is anything against a model without units. Needs pint, so a run of what is compiled does not come here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from masking.errors import DeclarationError, Problem
from masking.model.declaration.dimensions import dimension_in, is_plain, symbol_dimensions, unit_problem
from masking.model.declaration.expression import Expression
from masking.model.declaration.instrument_declaration import Actuator, Limit, PowerLimit, Quantity, Sensor, Turn
from masking.model.declaration.model_checks import problem_at
from masking.model.declaration.schema import ExperimentDeclaration, ModelDeclaration, PlantDeclaration
from masking.model.declaration.units import Dimension, describe, dimension_of, factor_of, instead_of

_POWER = "W"
_Entry = Actuator | Limit | PowerLimit | Quantity | Sensor | Turn
_Symbols = Mapping[str, Dimension | None]


def check_plant_units(plant: PlantDeclaration, model: ModelDeclaration) -> list[Problem]:
    """List the units of a plant that do not go with those of its model, and those that are no units at all."""
    entries: dict[str, _Entry] = {
        **{f"limits.inputs.{name}": limit for name, limit in plant.limits.inputs.items()},
        **{f"limits.coordinates.{expression.text}": limit for expression, limit in plant.limits.coordinates.items()},
        **{f"limits.velocities.{expression.text}": limit for expression, limit in plant.limits.velocities.items()},
        **({"limits.power": plant.limits.power} if plant.limits.power else {}),
        **{f"actuators.{name}": actuator for name, actuator in plant.actuators.items()},
        **{f"sensors.{name}": sensor for name, sensor in plant.sensors.items()},
        **{f"sensors.{name}.gain": sensor.gain for name, sensor in plant.sensors.items()},
        **{f"sensors.{name}.wraps": sensor.wraps for name, sensor in plant.sensors.items() if sensor.wraps},
    }
    problems: list[Problem] = []
    for path, entry in entries.items():
        try:
            dimension_of(entry.unit)
        except DeclarationError as error:
            problems.append(unit_problem(plant, f"{path}.unit", error))
    if problems:
        return problems
    for name, sensor in plant.sensors.items():
        if sensor.wraps and dimension_of(sensor.wraps.unit) != dimension_of(sensor.unit):
            message = f"{name} is read in {sensor.unit}, and its turn is in {sensor.wraps.unit}"
            problems.append(problem_at(plant, f"sensors.{name}.wraps", message, "give it in a unit of the reading"))
    power = plant.limits.power
    if power and _is_written(power) and dimension_of(power.unit) != dimension_of(_POWER):
        problems.append(problem_at(plant, "limits.power.unit", f"a power is in {_POWER}, the limit in {power.unit}"))
    problems += _heating(plant, model)
    symbols = symbol_dimensions(model)
    if symbols is not None and not is_plain(model):
        # Sensors measure outputs, too.
        symbols = {name: dimension_in(o.expression, symbols) for name, o in model.outputs.items()} | symbols
        problems += _limits(plant, model, symbols)
        for name, sensor in plant.sensors.items():
            problems += _sensor(plant, model, symbols, name, sensor)
    return problems


def _heating(plant: PlantDeclaration, model: ModelDeclaration) -> Iterator[Problem]:
    """Check that a heating is a power per squared command."""
    power = plant.limits.power
    if power is None or power.heating is None:
        return
    found = dimension_of(power.heating.unit)
    for name, channel in (plant.actuators or model.inputs).items():
        made = tuple(a + 2 * b for a, b in zip(found, dimension_of(channel.unit), strict=True))
        if made != dimension_of(_POWER):
            wanted = _POWER if channel.unit == "1" else f"{_POWER}/({channel.unit})**2"
            message = f"a heating is a power per squared command of {name}: {wanted}, not {power.heating.unit}"
            yield problem_at(plant, "limits.power.heating", message)
            return


def _is_written(entry: _Entry) -> bool:
    return "unit" in entry.model_fields_set


def _limits(plant: PlantDeclaration, model: ModelDeclaration, symbols: _Symbols) -> Iterator[Problem]:
    for name, limit in plant.limits.inputs.items():
        channel = plant.actuators.get(name) or model.inputs.get(name)
        if channel and _is_written(limit) and dimension_of(limit.unit) != dimension_of(channel.unit):
            what = "actuator" if plant.actuators else "input"
            message = f"the {what} {name} is in {channel.unit}, the limit in {limit.unit}"
            yield problem_at(plant, f"limits.inputs.{name}.unit", message)
    second = dimension_of("s")
    for order, key in enumerate(("coordinates", "velocities")):
        for expression, limit in getattr(plant.limits, key).items():
            try:
                found = dimension_in(expression, symbols)
            except DeclarationError as error:
                yield from error.problems
                continue
            if found is None:
                continue
            unit = _unit_of(expression, found, model)
            if not _is_written(limit):  # it is in SI units, on what may be declared in others
                if not math.isclose(factor_of(unit), 1.0):
                    message = f"the limit of {limit.max:g} has no unit, and what it bounds is declared in {unit}"
                    remedy = f"write 'unit: {unit}', or the unit that the limit is in"
                    yield problem_at(plant, f"limits.{key}.{expression.text}", message, remedy)
                continue
            if dimension_of(limit.unit) != tuple(a - order * b for a, b in zip(found, second, strict=True)):
                what = f"the rate of {expression.text}" if order else expression.text
                message = f"{what} is in {unit}{order * '/s'}, the limit in {limit.unit}"
                yield problem_at(plant, f"limits.{key}.{expression.text}.unit", message)


def check_experiment_units(
    experiment: ExperimentDeclaration, plant: PlantDeclaration, rig: ModelDeclaration, virtual: ModelDeclaration
) -> list[Problem]:
    """List live inputs whose sensors measure in another dimension; those that are multiplied by a factor may.

    Numbers of a transform have the units that its terms need, so that it is not checked.
    """
    symbols = symbol_dimensions(rig)
    if symbols is None or is_plain(rig):
        return []
    problems = list[Problem]()
    for name, source in experiment.inputs.items() if not is_plain(virtual) else ():
        sensor = plant.sensors.get(source.sensor or "")
        if sensor is None or "factor" in source.model_fields_set:
            continue
        unit = virtual.inputs[name].unit
        try:
            measured = dimension_in(sensor.measures, symbols)
        except DeclarationError:  # of the plant, which is checked by itself
            continue
        if measured is not None and measured != dimension_of(unit):
            what = f"{source.sensor} measures {sensor.measures.text} in {_unit_of(sensor.measures, measured, rig)}"
            remedy = "give a factor, which multiplies what the sensor measures, or take another sensor"
            message = f"{what}, and the input {name} of {virtual.name} is in {unit}"
            problems.append(problem_at(experiment, f"inputs.{name}", message, remedy, at_key=True))
    return problems


def _sensor(
    plant: PlantDeclaration, model: ModelDeclaration, symbols: _Symbols, name: str, sensor: Sensor
) -> Iterator[Problem]:
    """Check that unit = gain * measures."""
    try:
        measured = dimension_in(sensor.measures, symbols)
    except DeclarationError as error:
        yield from error.problems
        return
    if measured is None or not _is_written(sensor):
        return
    gain = dimension_of(sensor.gain.unit)
    made = tuple(a + b for a, b in zip(gain, measured, strict=True))
    if made == dimension_of(sensor.unit):
        return
    unit = _unit_of(sensor.measures, measured, model)
    product = "*".join(part for part in (sensor.gain.unit, unit) if part != "1") or "1"
    shown = f"{sensor.gain.value:g}" + ("" if sensor.gain.unit == "1" else f" {sensor.gain.unit}")
    message = f"{shown} times {sensor.measures.text} [{unit}] is {product}, not {sensor.unit}"
    wanted = sensor.unit if unit == "1" else f"{sensor.unit}/{unit}" if unit.isalpha() else f"{sensor.unit}/({unit})"
    other = f"measure another quantity, give the gain in {wanted} with its value in that unit, or correct the unit"
    yield problem_at(plant, f"sensors.{name}", message, instead_of(sensor.unit, made) or other)


def _unit_of(expression: Expression, dimension: Dimension, model: ModelDeclaration) -> str:
    """Give the unit in which an expression is written: a declared one where it fits, else SI base units."""
    sections = (model.coordinates, model.states, model.inputs, model.parameters, model.outputs)
    declared = sorted(section[name].unit for name in expression.names for section in sections if name in section)
    candidates = (candidate for unit in declared for candidate in (unit, f"{unit}/s"))
    return next((one for one in candidates if dimension_of(one) == dimension), describe(dimension))
