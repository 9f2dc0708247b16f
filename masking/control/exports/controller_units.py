"""Controllers as units: a sampled one from readings to commands, and a control law from states to inputs."""

from __future__ import annotations

import math

import numpy as np

from masking.compile.codegen.generated_module import Module
from masking.compile.numerics.arrays import Array
from masking.control.closed_loop import ClosedLoop
from masking.control.closed_loop import module as module_of
from masking.control.exports import unit_kernels
from masking.control.exports.target_text import c_name
from masking.control.exports.unit import Channel, Operations, Unit, state_channels
from masking.control.sampled_controller import SampledController
from masking.model.declaration.units import coherent

INIT = "Begin, on a rig at rest, with its first readings."
STEP = "Answer readings with commands, once a period; zero once it has stopped."
MISS = "Step over a sample that was missed, with the readings of the next; call it before step."
NOT_HOMED = (
    "Without homing nothing brings the rig to the initial state: the masked motion begins where the rig rests, and it "
    "stays at rest unless an input moves it. With controller.homing: 3 the controller brings it there in 3 s."
)
LAW_NOTE = "Readings are states, and they and commands in SI units: this law has no observer, no limits, no watchdog."
WATCH = "Count a period, from a timer; without a step for too long, set the commands to zero until init."


def sampled_unit(sampled: SampledController, name: str, watchdog: float) -> Unit:
    """Sampled controller as a unit; `watchdog` s without a step set its commands to zero."""
    module, sizes, known = Module(name, {}), sampled.sizes, sampled.instruments
    sampled.add_to(module)
    period, a = 1.0 / sampled.rate, sizes.actuators
    operations = Operations(module, -sampled.before, period)
    constants = _begin(sampled, operations)
    arguments = "readings commands x p gain limits demanded applied work first counters"
    made = (unit_kernels.controller_step, "control", "instant", a, period)
    operations.add("step", STEP, arguments, *made, returns_status=True)
    memory = {
        "x": constants["memory0"].shape,
        "p": constants["values"].shape,
        "demanded": (a,),
        "applied": (a,),
        "first": (1,),
        "work": (sizes.work[0], max(sizes.work[1], len(known.sensors))),
    }
    if sampled.has_model:
        arguments = "readings x p blind limits applied unsent before work counters"
        operations.add("miss", MISS, arguments, unit_kernels.miss_with_model, "control", "instant", sizes, period)
        memory |= {"unsent": (a,), "before": (a,)}
        constants |= {"blind": np.zeros_like(sampled.gain)}
    else:
        arguments = "x p applied work counters limits"
        operations.add("miss", MISS, arguments, unit_kernels.miss_with_differences, "skip", "instant", period)
    patience = max(1, math.ceil(watchdog * sampled.rate - 1e-9))
    operations.add("watch", WATCH, "commands counters", unit_kernels.watchdog, a, patience, returns_status=True)
    sensors = [Channel(n, s.unit, f"measures {s.measures.text}") for n, s in known.plant.sensors.items()]
    ports = {"readings": tuple(sensors), "commands": tuple(Channel(n, known.unit(n)) for n in known.actuators)}
    constants |= {"gain": sampled.gain, "limits": sampled.limits}
    title = f"{known.plant.name}, masked as {sampled.controller.virtual.name}: sampled controller"
    notes = (
        f"The first step is sample {-sampled.before}; at sample 0 the rig is released.",
        f"Commands are within the limits; the watchdog allows {patience} periods without a step.",
        *(() if sampled.homing else (NOT_HOMED,)),
    )
    names = [*known.model.coordinates, *(f"{c}'" for c in known.model.coordinates), *known.model.declaration.states]
    names += [f"virtual.{name}" for name in sampled.controller.virtual.states]
    states = state_channels(names, known.model.declaration, "estimate")
    made_of = (module, ports, memory, constants, operations)
    return Unit(c_name(name), title, "controller", *made_of, period, notes, states)


def _begin(sampled: SampledController, operations: Operations) -> dict[str, Array]:
    """Add the beginning of a controller; its constants."""
    sizes, known = sampled.sizes, sampled.instruments
    begun = sampled.begin(known.readings(np.zeros(sizes.coordinates)))
    found = {"memory0": begun.x.copy(), "values": begun.p.copy()}
    common = "readings x p first counters applied"
    if sampled.rest:
        made = (unit_kernels.resting, "clear", len(begun.x), len(begun.p), sizes.actuators)
        found["holding"] = begun.holding
        operations.add("init", INIT, f"{common} memory0 values holding", *made)
    else:
        n, is_held = sizes.coordinates, not sampled.homing and sampled.has_model
        homing = len(begun.p) - len(sampled.feed.tail()) - (2 * n + 1) if sampled.homing else -1
        start = unit_kernels.Start(len(begun.x), len(begun.p), homing, 1.0 / sampled.rate, is_held)
        parts = ("clear", "measure", "still", "allocate", "wire", sizes, start)
        found["memory0"][:n] = found["memory0"][sizes.next][:n] = 0.0
        found |= {"inverse": np.ascontiguousarray(np.linalg.pinv(known.sensing()[:, :n])), "limits": sampled.limits}
        operations.add("init", INIT, f"{common} work memory0 values inverse limits", unit_kernels.beginning, *parts)
    return found


def law_unit(loop: ClosedLoop, name: str, rate: float | None) -> Unit:
    """Control law that is given the rig's states as a unit: it has no observer and no limits.

    Of the loop, only the controller is exported; `rate` are samples per second, where the law runs at one.
    """
    loop.controller.virtual.check_no_delays("the export of a control law that is given the states")
    module, controller = module_of(loop), loop.controller
    model = loop.plant
    names = [*model.coordinates, *(f"{c}'" for c in model.coordinates), *loop.internal]
    values = controller.values()
    operations = Operations(module, 0, None)
    operations.add("init", "Begin.", "p first counters values", unit_kernels.law_beginning, "clear", len(values))
    made = (unit_kernels.law_step, "step", len(names), len(model.coordinates), len(model.inputs))
    text = "Answer the rig's states at a time with its inputs; zero once it has stopped."
    operations.add("step", text, "time readings commands p first counters", *made, returns_status=True)
    inputs, notes = model.declaration.inputs, [LAW_NOTE]
    if controller.virtual.states:
        notes.append("Readings named virtual are internal states of the virtual system: the caller integrates them.")
    if controller.virtual.declaration.events:
        notes.append("At the events of the virtual system, the caller makes them jump.")
    title = f"{model.name}, masked as {controller.virtual.name}: control law of the states"
    ports = {"readings": state_channels(names, model.declaration, "state")}
    ports |= {"commands": tuple(Channel(n, coherent(inputs[n].unit)) for n in model.inputs)}
    made_of = (module, ports, {"p": values.shape, "first": (1,)}, {"values": values}, operations)
    return Unit(c_name(name), title, "law", *made_of, None if rate is None else 1.0 / rate, tuple(notes))
