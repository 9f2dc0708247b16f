"""Rigs and models as units: they move by one period with each step."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping

import numpy as np

from masking.compile.codegen.compiled_functions import steps_between
from masking.compile.codegen.generated_module import Module
from masking.compile.numerics import runge_kutta
from masking.compile.numerics.arrays import Array
from masking.control.exports import unit_kernels
from masking.control.exports.target_text import c_name
from masking.control.exports.unit import Channel, Operations, Unit, state_channels
from masking.control.rig.twin import Twin
from masking.errors import DeclarationError
from masking.model.declaration.schema import Parameter
from masking.model.declaration.units import coherent
from masking.model.modelling import lowering
from masking.model.modelling.model import Model


def twin_unit(twin: Twin, name: str, rate: float) -> Unit:
    """Simulated rig as a unit, at rest and unpowered, that takes a number of samples per second."""
    module = Module(name, {})
    twin.add_to(module)
    state, values, late = twin.unpowered(), twin.values(), twin.late(rate)
    a, rows, period = len(twin.actuators), 1 + math.ceil(late.max(initial=0.0)), 1.0 / rate
    substeps = twin.substeps(rate)
    operations = Operations(module, 0, period)
    begin = (unit_kernels.rig_beginning, "clear", len(state), len(values), rows, a)
    operations.add("init", "Begin at rest, without power.", "y p queue acting counters state0 values", *begin)
    text = "Read the sensors; noise holds samples of mean 0 and deviation 1."
    arguments = "noise readings y p acting counters"
    operations.add("read", text, arguments, unit_kernels.rig_reading, "sense_under", "instant")
    step = (unit_kernels.rig_step, "move", "instant", a, substeps, period)
    arguments = "commands y p queue acting work counters late"
    operations.add("step", "Move by one period under commands.", arguments, *step)
    sensors, units = twin.declaration.sensors, twin.declaration.actuators or twin.base.inputs
    ports = {
        "commands": tuple(Channel(n, units[n].unit) for n in twin.actuators),
        "noise": tuple(Channel(f"noise_{n}", "1", "sample of mean 0 and deviation 1") for n in sensors),
        "readings": tuple(Channel(n, s.unit, f"measures {s.measures.text}") for n, s in sensors.items()),
    }
    memory = {"y": state.shape, "p": values.shape, "queue": (rows, a), "acting": (a,), "work": (5, len(state))}
    made_of = (module, ports, memory, {"state0": state, "values": values, "late": late}, operations)
    notes: tuple[str, ...] = (f"A period has {substeps} steps of the classical Runge-Kutta method.",)
    if twin.delay:
        notes += (f"The delay of {twin.delay} samples is {twin.delay * period:g} s.",)
    states = state_channels(twin.state_names, twin.model.declaration)
    parameters = _settable(
        values,
        {p: twin.parameter_value(p) for p in twin.parameter_names},
        lambda change: twin.with_parameters(change).values(),
        {p: twin.model.declaration.parameters[p] for p, own in twin.parameter_names.items() if own is None},
        is_dimensionless=False,
    )
    title = f"{twin.declaration.name}: simulated rig"
    return Unit(c_name(name), title, "plant", *made_of, period, notes, states, parameters)


def model_unit(model: Model, name: str, rate: float) -> Unit:
    """Model, in SI units or in its scales, as a unit, in its initial state.

    `rate` are steps per second, or per unit of the model's time.
    """
    model.check_ordinary("an exported model")
    module = lowering.module(model.equations)
    d, n, values, period = model.declaration, len(model.coordinates), model.values(), 1.0 / rate
    state = model.initial_state({})
    size, u = len(state), np.zeros(len(model.inputs))
    lengths = np.resize(model.lengths, size) if n else np.ones(size)
    substeps = steps_between(lambda y, out: model.kernels.derivative(0.0, y, u, values, out), state, lengths, rate)
    module.add_factory("advance", runge_kutta.steps_of_runge_kutta_4, "derivative", size, exported=False)
    operations = Operations(module, 0, period)
    begin = (unit_kernels.model_beginning, "clear", size, len(values))
    operations.add("init", "Begin in the initial state.", "y p counters state0 values", *begin)
    names = [*model.coordinates, *(f"{c}'" for c in model.coordinates), *d.states]
    if d.outputs:
        read = (unit_kernels.model_outputs, "outputs", "instant", n, size)
        operations.add("read", "Read the outputs now.", "inputs readings y p counters", *read)
    else:
        operations.add("read", "Read the outputs now.", "readings y", unit_kernels.model_states, size)
    step = (unit_kernels.model_step, "advance", "instant", substeps, period)
    operations.add("step", "Move by one period under inputs that are held.", "inputs y p work counters", *step)
    units = "scales" if model.is_dimensionless else "SI"
    outputs = [Channel(o, units) for o in d.outputs] or [Channel(c, units) for c in names]
    ports = {"inputs": tuple(Channel(i, x.unit) for i, x in d.inputs.items()), "readings": tuple(outputs)}
    memory = {"y": state.shape, "p": values.shape, "work": (5, size)}
    made_of = (module, ports, memory, {"state0": state, "values": values}, operations)
    notes = (f"A period has {substeps} step{'s' * (substeps != 1)} of the classical Runge-Kutta method.",)
    plain = tuple(Channel(c, units) for c in names)
    states = plain if model.is_dimensionless else state_channels(names, d)
    parameters = _settable(
        values,
        {p: float(x.value) for p, x in d.parameters.items() if isinstance(x.value, int | float)},
        lambda change: model.with_parameters(**change).values(),
        d.parameters,
        is_dimensionless=model.is_dimensionless,
    )
    return Unit(c_name(name), f"{model.name}: model", "model", *made_of, period, notes, states, parameters)


def _settable(
    values: Array,
    declared: Mapping[str, float],
    changed: Callable[[Mapping[str, float]], Array],
    known: Mapping[str, Parameter],
    *,
    is_dimensionless: bool,
) -> tuple[tuple[Channel, int], ...]:
    """Parameters that are one entry of the parameter array, on which no other entry depends, with its index.

    `declared` has their values, `changed` the array with others, and `known` the unit and the meaning of each.
    """
    found = list[tuple[Channel, int]]()
    for name, value in declared.items():
        for other in (1.01 * value or 0.01, 0.99 * value):
            with contextlib.suppress(DeclarationError):  # out of its bounds
                (places,) = np.nonzero(changed({name: other}) != values)
                if len(places) == 1:
                    one = known.get(name)
                    unit = "" if one is None or is_dimensionless else coherent(one.unit)
                    found.append((Channel(name, unit, one.meaning if one else ""), int(places[0])))
                break
    return tuple(found)
