"""What must hold where an experiment, its plant and its models meet, and how large its recording may be."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from masking.errors import Problem, nearest
from masking.model.declaration import driven_coordinates
from masking.model.declaration.couplings import is_commanded
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import (
    accelerations,
    beyond_ordinary,
    check_parameters,
    check_symbols,
    problem_at,
    strangers,
    unused,
    used,
    velocities,
)
from masking.model.declaration.schema import Declaration, ExperimentDeclaration, ModelDeclaration, PlantDeclaration

LARGEST_RECORDING = 2**31  # bytes of one that is in memory
LARGEST_ON_DISK = 2**36
_PROPOSED_DIVISORS = (1, 2, 4, 5, 10)


def check_plant(plant: PlantDeclaration, model: ModelDeclaration) -> list[Problem]:
    """List what in a plant does not fit its model."""
    problems = list(_overrides(plant, "parameters", plant.parameters, model))
    for what in beyond_ordinary(model):
        remedy = "only models that are simulated by themselves, and virtual systems, do"
        problems.append(problem_at(plant, "model", f"the model {model.name} has {what}", remedy))
    measurable = [*model.coordinates, *velocities(model.coordinates), *model.parameters]
    further = (*accelerations(model.coordinates), *model.states, *model.inputs, *model.outputs)
    seen = [*measurable, *(name for name in further if name not in measurable)]
    for name, sensor in plant.sensors.items():
        if sensor.gain.value == 0.0:
            problems.append(problem_at(plant, f"sensors.{name}.gain", "the gain is 0"))
        problems += check_symbols(sensor.measures, seen, model.coordinates)
        if sensor.range is not None and not sensor.range[0] < sensor.range[1]:
            message, remedy = f"the range is {list(sensor.range)}", "write [least, largest], such as [-10, 10]"
            problems.append(problem_at(plant, f"sensors.{name}.range", message, remedy))
    channels = plant.actuators or model.inputs
    owner = "an actuator of this plant" if plant.actuators else f"an input of {model.name}"
    problems += strangers(plant, "limits.inputs", plant.limits.inputs, channels, owner)
    for name, limit in plant.limits.inputs.items():
        path = f"limits.inputs.{name}"
        if abs(limit.expiry) > limit.max:
            message = f"expiry is {limit.expiry:g}, beyond the largest command, {limit.max:g}"
            problems.append(problem_at(plant, f"{path}.expiry", message, "write a number within it"))
    problems += [*check_allocation(plant, model), *_actuators(plant, model)]
    for expression in plant.limits.coordinates:
        problems += check_symbols(expression, measurable, model.coordinates)
    positions = [*model.coordinates, *model.parameters]
    for expression in plant.limits.velocities:  # the rate of an expression of coordinates
        problems += check_symbols(expression, positions, model.coordinates)
    if plant.limits.missed is not None and plant.limits.missed > 1.0:
        message = f"missed is a share of the samples, not {plant.limits.missed:g}"
        problems.append(problem_at(plant, "limits.missed", message, "write a number up to 1, such as 0.05"))
    return [*problems, *_unused(plant, model)]


def _unused(plant: PlantDeclaration, model: ModelDeclaration) -> Iterator[Problem]:
    """Find parameters of a model with inputs that neither the model nor its plant uses."""
    if not model.inputs:
        return
    values = (value for use in plant.effects.values() for value in use.parameters.values())
    given = [*plant.limits.coordinates, *plant.limits.velocities, *plant.allocation.values(), *values]
    every = [*given, *(sensor.measures for sensor in plant.sensors.values())]
    names = used(model).union(*(x.names for x in every if isinstance(x, Expression)))
    yield from unused(model, "parameters", names)


def check_allocation(plant: PlantDeclaration, model: ModelDeclaration) -> Iterator[Problem]:
    """Check that actuators are wired to every input of the model, and to nothing else."""
    if plant.allocation and not plant.actuators:
        message, remedy = "an allocation needs actuators", "declare them under actuators"
        yield problem_at(plant, "allocation", message, remedy, at_key=True)
        return
    yield from strangers(plant, "allocation", plant.allocation, model.inputs, f"an input of {model.name}")
    for expression in plant.allocation.values():
        yield from check_symbols(expression, [*plant.actuators, *model.parameters], ())
    for name in model.inputs if plant.actuators else ():
        if name not in plant.allocation:
            remedy = f"write what it gets of the actuators, such as '{name}: {next(iter(plant.actuators))}'"
            yield problem_at(plant, "allocation", f"nothing is allocated to the input {name}", remedy, at_key=True)


def _actuators(plant: PlantDeclaration, model: ModelDeclaration) -> Iterator[Problem]:
    """Check that actuators have names of their own, and that each is wired."""
    used = set().union(*(expression.names for expression in plant.allocation.values()))
    for name in plant.actuators:
        path = f"actuators.{name}"
        if name in model.parameters:
            message = f"the name '{name}' is already a parameter of {model.name}"
            yield problem_at(plant, path, message, "rename it", at_key=True)
        if plant.allocation and name not in used:
            message = f"the actuator '{name}' is wired to nothing"
            yield problem_at(plant, path, message, "remove it or wire it", at_key=True)


def check_experiment(
    experiment: ExperimentDeclaration,
    plant: PlantDeclaration,
    plant_model: ModelDeclaration,
    virtual_model: ModelDeclaration,
    controller_model: ModelDeclaration | None = None,
) -> list[Problem]:
    """List what does not fit where an experiment, its plant and its models meet.

    `controller_model` is that which `controller.model` names, if it names one.
    """
    problems = check_plant(plant, plant_model)
    problems += _overrides(experiment, "parameters", experiment.parameters, virtual_model)
    assumed = controller_model or plant_model
    problems += _overrides(experiment, "controller.parameters", experiment.controller.parameters, assumed)
    problems += _jumps(experiment, virtual_model, controller_model)
    problems += _initial(experiment, virtual_model, plant_model, assumed)
    problems += [*_effects(experiment, plant), *_sampling(experiment)]
    if experiment.controller.energy_balance is not None and not (virtual_model.energy or virtual_model.lagrangian):
        message = f"the model {virtual_model.name} has no energy to balance"
        remedy = "declare its energy or a lagrangian, or leave energy_balance out"
        problems.append(problem_at(experiment, "controller.energy_balance", message, remedy, at_key=True))
    problems += [*_record(experiment), *_stop(experiment, virtual_model)]
    problems += _transform(experiment, assumed, virtual_model, plant_model) if plant_model.coordinates else ()
    problems += _loop(experiment, plant, plant_model)
    if not virtual_model.coordinates:
        problems.append(problem_at(experiment, "virtual", f"the model {virtual_model.name} has no coordinates"))
    if not plant_model.inputs:
        problems.append(problem_at(experiment, "plant", f"the model {plant_model.name} of the plant has no inputs"))
    return problems


def _jumps(
    experiment: ExperimentDeclaration, virtual: ModelDeclaration, assumed: ModelDeclaration | None
) -> Iterator[Problem]:
    """Check that in an event only internal states jump, and in the virtual system alone."""
    remedy = "let internal states jump that make forces, or write a law of contact, as models/bouncing_ball.yaml"
    for name, event in virtual.events.items():
        if moved := ", ".join(state for state in event.jumps if state not in virtual.states):
            message = f"in the event '{name}' of {virtual.name}, {moved} jumps, and no force makes a rig jump"
            yield problem_at(experiment, "virtual", message, remedy)
    if experiment.controller.model is not None and assumed is not None:
        for what in beyond_ordinary(assumed):
            message, remedy = f"the model {assumed.name} has {what}", "take a model of the rig without"
            yield problem_at(experiment, "controller.model", message, remedy)


def recorded_rows(experiment: ExperimentDeclaration, time_scale: float, rows_per_unit: float) -> float:
    """Give the rows of an experiment's recording.

    `time_scale` is seconds of the rig per unit of virtual time, `rows_per_unit` the rows per unit of virtual time where
    neither a controller nor a record has a rate.
    """
    rate = experiment.record.rate if experiment.record else experiment.controller.rate
    return experiment.duration * (rows_per_unit if rate is None else time_scale * rate) + 1.0


def count_columns(rig: ModelDeclaration, virtual: ModelDeclaration) -> int:
    """Give the columns of a recording: time, positions and velocities of rig, virtual system and ideal, and inputs."""
    moving = len(rig.coordinates) + 2 * len(virtual.coordinates) + len(virtual.states)
    return 1 + 2 * moving + len(rig.inputs)


def check_size(
    experiment: ExperimentDeclaration, rows: float, columns: int, largest: float = LARGEST_RECORDING
) -> list[Problem]:
    """Refuse a duration whose recording, of 8 bytes a number, would be larger than `largest`, in bytes."""
    size = rows * columns * 8.0
    if size <= largest:
        return []
    message = f"{_short(experiment.duration)} units are {_short(rows)} rows, {_short(size / 2**30)} GiB"
    less = "lower record.rate" if experiment.record else "record less: 'record: {rate: ...}'"
    return [problem_at(experiment, "duration", message, f"shorten duration or {less}")]


def _short(number: float) -> str:
    """Write a number in two or three digits: 373, 5.5e10."""
    if number < 1000.0 or math.isinf(number):
        return f"{number:.3g}"
    digits, _, exponent = f"{number:.1e}".partition("e")
    return f"{digits.removesuffix('.0')}e{int(exponent)}"


def _loop(experiment: ExperimentDeclaration, plant: PlantDeclaration, rig: ModelDeclaration) -> Iterator[Problem]:
    """Check that a control loop can be closed around a rig: it moves, and is seen before it is commanded."""
    if not rig.coordinates:
        message = f"the model {rig.name} of the plant has no coordinates: there is no motion to close a loop around"
        remedy = "choose a rig; what such a model is missing is found by 'masking discover', from a record"
        yield problem_at(experiment, "plant", message, remedy)
    for name, sensor in plant.sensors.items():
        if rig.coordinates and is_commanded(rig, sensor.measures):
            message = f"the sensor {name} reads {sensor.measures}, which a command changes at once"
            remedy = "a controller reads before it commands; leave this sensor out of the plant"
            yield problem_at(plant, f"sensors.{name}", message, remedy)


def _record(experiment: ExperimentDeclaration) -> Iterator[Problem]:
    """Check that a recording takes whole samples of the controller."""
    rate = experiment.controller.rate
    if rate is None or experiment.record is None:
        return
    ratio = rate / experiment.record.rate
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        message = f"{_hertz(experiment.record.rate)} does not divide the controller's rate of {_hertz(rate)}"
        allowed = ", ".join(_hertz(rate / divisor) for divisor in _PROPOSED_DIVISORS)
        yield problem_at(experiment, "record.rate", message, f"allowed: {allowed}, ...")


def _stop(experiment: ExperimentDeclaration, model: ModelDeclaration) -> Iterator[Problem]:
    """Check that two coordinates of the virtual system can end a run."""
    wanted = experiment.stop
    if wanted is None:
        return
    for i, name in enumerate(wanted.of):
        if name not in model.coordinates:
            message = f"'{name}' is not a coordinate of {model.name}"
            yield problem_at(experiment, f"stop.of.{i}", message, nearest(name, model.coordinates))
    two = wanted.of or model.oscillators or tuple(model.coordinates)
    if (wanted.of and len(wanted.of) != 2) or len(two) < 2 or two[0] == two[1]:
        message = f"two coordinates synchronise, not {', '.join(two) or 'none'}"
        yield problem_at(experiment, "stop", message, "name two, such as 'of: [x1, x2]'", at_key=True)
    limits = {"eps": (wanted.eps < 1.0, "less than 1: it is a part of the amplitude")}
    limits["false_alarm"] = (wanted.false_alarm < 1.0, "less than 1: it is a probability")
    limits["memory"] = (wanted.memory >= 0.5, "at least 0.5 periods")
    for name, (is_allowed, words) in limits.items():
        if not is_allowed:
            yield problem_at(experiment, f"stop.{name}", f"must be {words}, not {getattr(wanted, name):g}")


def _hertz(rate: float) -> str:
    for unit, size in (("MHz", 1e6), ("kHz", 1e3)):
        if rate >= size:
            return f"{rate / size:.9g} {unit}"
    return f"{rate:.9g} Hz"


def _overrides(
    declaration: Declaration, section: str, overrides: Mapping[str, float], model: ModelDeclaration
) -> Iterator[Problem]:
    known = {name: value for name, value in overrides.items() if name in model.parameters}
    yield from strangers(declaration, section, overrides, model.parameters, f"a parameter of {model.name}")
    for problem in check_parameters(model, known):
        name = problem.path.split(".")[1] if "." in problem.path else ""
        path = f"{section}.{name}"
        yield replace(problem, place=declaration.place(path), path=path) if name in known else problem


def _effects(experiment: ExperimentDeclaration, plant: PlantDeclaration) -> Iterator[Problem]:
    for section, changes in (("effects", experiment.effects), ("controller.effects", experiment.controller.effects)):
        yield from strangers(experiment, section, changes, plant.effects, f"an effect of {plant.name}")


def _sampling(experiment: ExperimentDeclaration) -> Iterator[Problem]:
    """Check that what only a sampled controller has stands only with a rate."""
    settings = experiment.controller
    for name in ("observer", "homing", "effects", "rest", "energy_balance"):
        if settings.rate is None and getattr(settings, name):
            message = f"{name} is for a controller that runs at a rate"
            remedy = "write 'rate: 1 kHz', or leave it out"
            yield problem_at(experiment, f"controller.{name}", message, remedy, at_key=True)
    yield from _regulation(experiment)
    yield from _following(experiment)
    observer = settings.observer
    if observer is not None and observer.kind == "exact" and settings.homing is not None:
        message, remedy = "an exact observer places the rig where it starts", "leave homing out, or take an observer"
        yield problem_at(experiment, "controller.homing", message, remedy, at_key=True)
    if observer is not None and observer.order not in {1, 2}:
        message = f"{observer.order} is not an order of a disturbance"
        remedy = "allowed: 1 (a constant), 2 (a straight line)"
        yield problem_at(experiment, "controller.observer.order", message, remedy)
    if observer is not None and observer.at is not None and observer.kind != "disturbance":
        message = f"at says where a disturbance acts, and '{observer.kind}' estimates none"
        yield problem_at(experiment, "controller.observer.at", message, "take 'kind: disturbance', or leave it out")


def _following(experiment: ExperimentDeclaration) -> Iterator[Problem]:
    """Check that what needs an observer with a model, and homing, has these."""
    settings = experiment.controller
    has_model = settings.observer is None or settings.observer.kind in {"kalman", "disturbance"}
    for name in ("rest", "energy_balance"):
        if getattr(settings, name) is not None and not has_model:
            message = f"{name} needs an observer that follows a model"
            remedy = "take 'observer: disturbance', or leave it out"
            yield problem_at(experiment, f"controller.{name}", message, remedy, at_key=True)
    if settings.rest is not None and settings.homing is None:
        message = "offsets are measured before homing, and there is none"
        remedy = "write 'homing: 3', or leave rest out"
        yield problem_at(experiment, "controller.rest", message, remedy, at_key=True)


def _regulation(experiment: ExperimentDeclaration) -> Iterator[Problem]:
    """Check that something is regulated, and that its settings are about something that is."""
    wanted = experiment.controller.regulate
    if wanted is None:
        return
    if wanted.energy is None and wanted.phase is None:
        message, remedy = "nothing is regulated", "give 'energy: 0.02', 'phase: anti', or both; or leave it out"
        yield problem_at(experiment, "controller.regulate", message, remedy, at_key=True)
        return
    for name, needs, value in (("rate", "energy", wanted.energy), ("coupling", "phase", wanted.phase)):
        if value is None and name in wanted.model_fields_set:
            message, remedy = f"{name} has no effect without {needs}", f"give {needs}, or leave {name} out"
            yield problem_at(experiment, f"controller.regulate.{name}", message, remedy, at_key=True)


def _initial(
    experiment: ExperimentDeclaration, model: ModelDeclaration, plant: ModelDeclaration, assumed: ModelDeclaration
) -> Iterator[Problem]:
    free = driven_coordinates.passive(experiment.transform, [*assumed.coordinates], [*model.coordinates])
    free = (*free, *(name for name in plant.coordinates if name not in {*assumed.coordinates, *model.coordinates}))
    allowed = [*model.coordinates, *velocities(model.coordinates), *model.states, *free, *velocities(free)]
    for name in experiment.initial:
        if name not in allowed:
            what = ", nor an internal state" if model.states else ""
            what += f", nor a passive one of the rig ({', '.join(free)})" if free else ""
            message = f"'{name}' is not a coordinate of {model.name}, nor the velocity of one{what}"
            yield problem_at(experiment, f"initial.{name}", message, nearest(name, allowed), at_key=True)
        elif name.rstrip("'") in free and experiment.controller.homing is not None:
            message = f"{name.rstrip(chr(39))} is passive: homing cannot bring it to a value"
            remedy = "leave it out: it begins as homing leaves it; or leave homing out, in a simulation"
            yield problem_at(experiment, f"initial.{name}", message, remedy, at_key=True)
    for name, coordinate in model.coordinates.items():
        if coordinate.initial is None and name not in experiment.initial:
            message = f"no initial value for {name}"
            remedy = f"give initial.{name} here or coordinates.{name}.initial in {model.name}"
            yield problem_at(experiment, "initial", message, remedy, at_key=True)


def _transform(
    experiment: ExperimentDeclaration, rig: ModelDeclaration, virtual: ModelDeclaration, plant: ModelDeclaration
) -> Iterator[Problem]:
    transform, rows, columns = experiment.transform, len(virtual.coordinates), len(rig.coordinates)
    if rows > columns:
        message = f"{virtual.name} has {rows} coordinates and the rig {columns}"
        yield problem_at(experiment, "virtual", message, "a virtual system has at most as many as its rig")
        return
    if transform.kind == "identity" and driven_coordinates.selected([*rig.coordinates], [*virtual.coordinates]) is None:
        message = f"the identity takes rig coordinates by name, and the rig has {', '.join(rig.coordinates)}"
        remedy = f"say what {', '.join(virtual.coordinates)} are: 'transform: {{expressions: {{...}}}}', or a matrix"
        yield problem_at(experiment, "virtual", message, remedy)
    if transform.matrix is not None and transform.expressions is not None:
        yield problem_at(experiment, "transform", "a transform is a matrix or expressions, not both")
    used: set[str] = set()
    for entry in (*itertools.chain(*(transform.matrix or ())), *(transform.expressions or {}).values()):
        used |= entry.names
        allowed = [*transform.parameters, *(rig.coordinates if transform.matrix is None else ())]
        yield from check_symbols(entry, allowed, rig.coordinates, known=[*rig.coordinates])
    if transform.matrix is not None and [len(row) for row in transform.matrix] != [columns] * rows:
        yield problem_at(experiment, "transform.matrix", f"the matrix must have {rows} rows of {columns} entries")
    if transform.expressions is not None:
        for name in virtual.coordinates.keys() - transform.expressions.keys():
            yield problem_at(experiment, "transform.expressions", f"no expression for {name}", at_key=True)
        what = f"a coordinate of {virtual.name}"
        yield from strangers(experiment, "transform.expressions", transform.expressions, virtual.coordinates, what)
    for name in transform.parameters:
        path = f"transform.parameters.{name}"
        if name in rig.coordinates or name in plant.coordinates:
            yield problem_at(experiment, path, f"the name '{name}' is already a coordinate of the rig", at_key=True)
        if name not in used:
            message = f"the parameter '{name}' is not used"
            yield problem_at(experiment, path, message, "remove it or use it", at_key=True)
