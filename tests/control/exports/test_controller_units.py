"""Exported C against the compiled kernels that they were made from, over every packaged experiment."""

import graphlib
import math
import re
import subprocess
from functools import cache

import numpy as np
import pytest

import masking
from masking.control.exports.c_unit import CUnit
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.control.exports.rig_units import model_unit, twin_unit
from masking.control.rig.twin import Twin
from masking.control.stepwise_controller import SampledStep
from masking.errors import DeclarationError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import catalogue
from masking.model.modelling.model import load_model
from tests.benchmarks.learning import CART_RUN, RIGS, written
from tests.support.compiled_unit import GCC, STRICT, CompiledUnit


def can_be_a_law(experiment):
    """Tell whether its control law alone is exported: it is given the states, and no past."""
    return not experiment.has_observer and not len(experiment.virtual.delays())


needs_gcc = pytest.mark.skipif(GCC is None, reason="there is no gcc")
LAWS = [name for name in catalogue.names("experiment") if can_be_a_law(Experiment.load(name))]
EXACT = 1e-12
MATHEMATICS = {"acos", "asin", "atan", "atan2", "ceil", "copysign", "cos", "cosh", "exp", "expm1", "fabs", "floor"}
MATHEMATICS |= {"fmod", "log", "log1p", "pow", "sin", "sinh", "sqrt", "tan", "tanh"}  # of math.h
RIG = {"rate": "1 kHz", "model": "setup_springs"}
SAMPLED = {
    "as declared": {},
    "kalman, without homing": {"controller": {**RIG, "observer": "kalman"}},
    "differences": {"controller": {**RIG, "observer": "differences", "homing": 3}},
}


@cache
def sampled(name):
    experiment = Experiment.load("huygens_rig")
    return experiment.changed(**SAMPLED[name]) if SAMPLED[name] else experiment


def around_a_twin(experiment, step, init, samples, *, others=(), missed=()):
    """Run a controller around the twin from its first sample on.

    Args:
        experiment: of the controller.
        step: takes the sample and its readings, and returns commands.
        init: takes the first readings.
        samples: their number.
        others: units that see the same readings, and whose commands are compared.
        missed: samples that no controller sees.

    Returns:
        States of the twin, commands, and the commands of the others.
    """
    made, twin = experiment.sampled, experiment.twin
    h, p, generator = 1.0 / made.rate, twin.values(), np.random.default_rng(experiment.declaration.seed)
    y = twin.unpowered() if made.homing else twin.rest(made.end)
    readings, substeps, late = np.empty(len(twin.sensors)), twin.substeps(made.rate), twin.late(made.rate)
    twin.kernels.sense(-made.before * h, y, p, generator.standard_normal(len(readings)), readings)
    init(readings)
    for unit in others:
        unit.init(readings)
    queue, acting = np.tile(made.begin(readings).holding, (1 + math.ceil(late.max()), 1)), np.empty(3)
    states, rows = [], []
    for index in range(-made.before, samples - made.before):
        states.append(y.copy())
        if index + made.before not in missed:
            queue[-1] = step(index, readings)
            if index + made.before - 1 in missed:
                for unit in others:
                    unit.miss(readings)
            rows.append([queue[-1].copy(), *(unit.step(readings) for unit in others)])
        twin.kernels.move(index * h, y, queue, late, p, h, substeps, acting)
        twin.kernels.sense((index + 1) * h, y, p, generator.standard_normal(len(readings)), readings)
    commands, *compared = np.array(rows).transpose(1, 0, 2)
    return np.array(states), commands, compared


def by_kernel(experiment, samples, read=lambda readings: readings, **settings):
    """Run the compiled controller around the twin; `read` changes what it sees."""
    step = SampledStep(experiment.sampled)
    return around_a_twin(
        experiment,
        lambda index, readings: step(read(readings), index),
        lambda readings: step.reset(read(readings)),
        samples,
        **settings,
    )


def by_unit(experiment, unit, samples):
    """Run an exported controller around the twin."""
    return around_a_twin(experiment, lambda _, readings: unit.step(readings), unit.init, samples)


@needs_gcc
@pytest.mark.parametrize("name", SAMPLED)
def test_a_sampled_controller_in_c_gives_the_commands_of_the_kernel(name, tmp_path):
    experiment = sampled(name)
    unit = CompiledUnit(tmp_path, sampled_unit(experiment.sampled, "controller", 0.02))
    # Past the release; a sample is missed before it, and one after it.
    samples = experiment.sampled.before + 1500
    _, ours, (exported,) = by_kernel(experiment, samples, others=[unit], missed={900, samples - 700})
    largest = np.max(np.abs(ours))
    assert largest > 1e-3
    assert np.max(np.abs(exported - ours)) <= EXACT * largest
    assert unit.status == 0


@needs_gcc
def test_a_controller_that_knows_a_drift_in_c_gives_the_commands_of_the_kernel(tmp_path):
    *_, path = written(RIGS["spring"], tmp_path)
    run = CART_RUN["controller"] | {"rest": 1, "effects": {"drift": True}}
    experiment = Experiment.load(path, plant=str(tmp_path / "true.yaml")).changed(controller=run)
    unit = CompiledUnit(tmp_path, sampled_unit(experiment.sampled, "controller", 0.02))
    _, ours, (exported,) = by_kernel(experiment, experiment.sampled.before + 1500, others=[unit], missed={300})
    assert np.max(np.abs(exported - ours)) <= EXACT * np.max(np.abs(ours))
    assert np.max(np.abs(ours[-1500:])) > 1e-3
    assert unit.status == 0


@needs_gcc
@pytest.mark.parametrize("homing", [None, 1])
def test_a_controller_with_a_force_from_a_file_has_it_as_a_table(homing, tmp_path):
    controller = {"rate": "500 Hz", "observer": "disturbance", "homing": homing}
    experiment = Experiment.load("cart_reference").changed(controller=controller)
    made = sampled_unit(experiment.sampled, "controller", 0.02)
    unit = CompiledUnit(tmp_path, made)
    _, ours, (exported,) = by_kernel(experiment, experiment.sampled.before + 1500, others=[unit], missed={300})
    assert np.max(np.abs(ours[-1500:])) > 1e-3
    assert np.max(np.abs(exported - ours)) <= EXACT * np.max(np.abs(ours))


@needs_gcc
@pytest.mark.parametrize("name", ["coil_van_der_pol", "storey_in_building", "magnet_van_der_pol"])
def test_a_controller_of_a_rig_with_actuator_dynamics_in_c_gives_the_commands_of_the_kernel(name, tmp_path):
    experiment = Experiment.load(name)
    unit = CompiledUnit(tmp_path, sampled_unit(experiment.sampled, "controller", 0.02))
    _, ours, (exported,) = by_kernel(experiment, experiment.sampled.before + 4000, others=[unit], missed={300})
    assert np.max(np.abs(exported - ours)) <= EXACT * np.max(np.abs(ours))
    assert np.ptp(ours[-1500:]) > 0.1 * np.max(np.abs(ours))
    assert unit.status == 0


@needs_gcc
def test_the_loop_of_a_controller_in_float_differs_by_what_rounding_does(tmp_path):
    # Friction and hysteresis of the rig magnify it: readings that change by half a unit in the last place do as much.
    ulp, generator = float(np.finfo(np.float32).eps), np.random.default_rng(4)
    experiment = sampled("as declared")
    found = sampled_unit(experiment.sampled, "controller", 0.02)
    samples = experiment.sampled.before + 3000
    ours, *_ = by_kernel(experiment, samples)
    changed, *_ = by_kernel(experiment, samples, read=lambda y: y * (1.0 + 0.5 * ulp * generator.standard_normal(3)))
    double, *_ = by_unit(experiment, CompiledUnit(tmp_path, found), samples)
    single, *_ = by_unit(experiment, CompiledUnit(tmp_path, found, "float"), samples)
    assert np.array_equal(double, ours)
    assert 1e-8 < np.max(np.abs(single - ours)[:, :3]) <= 10.0 * np.max(np.abs(changed - ours)[:, :3])


@needs_gcc
@pytest.mark.parametrize("name", LAWS)
def test_a_control_law_in_c_gives_the_inputs_of_the_kernel(name, tmp_path):
    experiment = Experiment.load(name)
    loop = experiment.loop
    unit = CompiledUnit(tmp_path, law_unit(loop, name, None))
    n, p, u = len(loop.plant.coordinates), loop.values(), np.empty(len(loop.plant.inputs))
    generator = np.random.default_rng(2)
    sizes = np.concatenate([loop.controller.lengths, loop.controller.lengths / experiment.time_scale])
    sizes = np.append(sizes, np.ones(len(loop.internal)))
    unit.init()
    for t in range(50):
        states = sizes * generator.uniform(-0.5, 0.5, len(sizes))
        loop.kernels.step(float(t), states[:n], states[n:], u, p)
        assert np.max(np.abs(unit.step(float(t), states) - u)) <= EXACT * np.max(np.abs(u))
        assert unit.status == 0


@needs_gcc
@pytest.mark.parametrize("name", catalogue.names("plant"))
def test_a_rig_in_c_reads_what_the_twin_reads(name, tmp_path):
    twin, rate = Twin.load(name), 1000.0
    unit = CompiledUnit(tmp_path, twin_unit(twin, name, rate))
    unit.init()
    y, p, late, h = twin.unpowered(), twin.values(), twin.late(rate), 1.0 / rate
    queue, acting = np.zeros((1 + math.ceil(late.max()), len(twin.actuators))), np.zeros(len(twin.actuators))
    substeps = twin.substeps(rate)
    generator, readings, worst, largest = np.random.default_rng(3), np.empty(len(twin.sensors)), 0.0, 0.0
    for tick in range(2000):
        noise, queue[-1] = generator.standard_normal(len(readings)), generator.uniform(-0.3, 0.3, len(acting))
        twin.kernels.sense(tick * h, y, p, noise, readings)
        worst, largest = max(worst, np.max(np.abs(unit.read(noise) - readings))), max(largest, np.max(np.abs(readings)))
        unit.step(queue[-1])
        twin.kernels.move(tick * h, y, queue, late, p, h, substeps, acting)
    assert worst <= EXACT * largest


@needs_gcc
@pytest.mark.parametrize("name", ["duffing", "huygens", "huygens_lagrangian"])
def test_a_model_in_c_moves_as_the_model(name, tmp_path):
    model = load_model(name)
    model = model.dimensionless() if model.declaration.scales else model
    rate, count = 100.0, 1000
    found = model_unit(model, name, rate)
    unit = CompiledUnit(tmp_path, found)
    inputs = np.zeros(len(model.inputs))
    ours = model.simulate(np.arange(count + 1) / rate, tolerance=1e-12).states
    unit.init()
    rows = []
    for _ in range(count):
        unit.step(inputs)
        rows.append(unit.read() if found.operations["read"].arguments[0] == "readings" else unit.read(inputs))
    if not model.outputs:
        assert np.max(np.abs(np.array(rows) - ours[1:])) <= 1e-7 * np.max(np.abs(ours))
    assert np.all(np.isfinite(rows))


@needs_gcc
def test_commands_are_zero_once_a_controller_has_stopped(tmp_path):
    made = sampled("kalman, without homing").sampled
    unit = CompiledUnit(tmp_path, sampled_unit(made, "controller", 0.01))
    unit.init(np.zeros(3))
    unit.step(np.array([0.0, np.nan, 0.0]))
    assert unit.status == 3
    assert np.all(unit.step(np.zeros(3)) == 0.0)
    assert unit.status == 3
    unit.init(np.zeros(3))
    assert [unit.watch() is not None and unit.status for _ in range(12)] == [0] * 10 + [7, 7]
    assert np.all(unit.step(np.zeros(3)) == 0.0)
    assert unit.status == 7
    unit.init(np.zeros(3))
    unit.step(np.zeros(3))
    assert unit.status == 0


def test_the_source_in_c_has_no_heap_no_io_and_no_state_outside_of_its_struct():
    text = CUnit(sampled_unit(sampled("as declared").sampled, "controller", 0.02), "float").source()
    assert {part.split(">")[0] for part in text.split("#include <")[1:]} == {"math.h"}
    assert not [word for word in ("malloc", "printf", "double", "goto") if word in text]
    outside = [line for line in text.splitlines() if line.startswith("static") and line.endswith("{") and "=" in line]
    assert all(line.startswith("static const float ") for line in outside)


def of_kind(name, kind):
    """Return the unit that a name is exported as."""
    if kind == "plant":
        return twin_unit(Twin.load(name), name, 1000.0)
    if kind == "model":
        return model_unit(load_model(name).dimensionless(), name, 1000.0)
    experiment = Experiment.load(name)
    return sampled_unit(experiment.sampled, name, 0.02) if kind == "sampled" else law_unit(experiment.loop, name, None)


@needs_gcc
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "sampled") for name in ("cart_felt_observer", "cart_reference", "escapements_rig", "two_carts")),
        *((name, "sampled") for name in ("delayed_oscillators_rig", "huygens_rig")),
        *(("pendula", "law"), ("tue_rig", "plant"), ("duffing_si", "model")),
    ],
)
def test_the_calls_that_gcc_finds_in_the_source_have_no_cycle_and_lead_to_mathematics_alone(name, kind, tmp_path):
    unit = of_kind(name, kind)
    text = CUnit(unit, "double")
    (tmp_path / f"{unit.name}.h").write_text(text.header())
    (tmp_path / "unit.c").write_text(text.source())
    made = ["-O0", "-c", "-fcallgraph-info=su", "-Werror=vla", "-Walloca", "unit.c"]
    subprocess.run([GCC, *STRICT, *made], check=True, cwd=tmp_path)
    graph = (tmp_path / "unit.ci").read_text()
    ours = dict(re.findall(r'^node: \{ title: "(\S+?)" (.*)', graph, re.M))
    calls = {title: set() for title in ours}
    for caller, callee in re.findall(r'^edge: \{ sourcename: "(\S+?)" targetname: "(\S+?)"', graph, re.M):
        calls[caller].add(callee)
    order = tuple(graphlib.TopologicalSorter(calls).static_order())  # raises CycleError where a function calls itself
    outside = {title for title in order if "shape : ellipse" in ours[title]}
    assert outside <= MATHEMATICS
    assert {f"{unit.name}_{operation}" for operation in unit.operations} <= set(order) - outside
    stacks = [re.search(r"\d+ bytes \((\S+)\)", ours[title]) for title in set(order) - outside]
    assert {stack[1] for stack in stacks} <= {"static", "dynamic,bounded"}  # the latter for arguments of calls


def test_a_constant_beyond_float_is_refused():
    model = load_model("duffing").with_parameters(w3=1e39)
    with pytest.raises(ModelError, match=r"values holds 1e\+39, beyond float; export with double"):
        CUnit(model_unit(model, "duffing", 100.0), "float").source()


def test_the_verb_writes_files_and_says_what_they_are(tmp_path):
    found = masking.export("duffing", to="c", real="float", out=tmp_path / "c")
    assert {file.name for file in found.files} >= {"duffing.h", "duffing.c"}
    assert found.kind == "law"
    assert "no observer" in str(found)
    assert found.as_dict()["files"] == [str(file) for file in found.files]


@needs_gcc
@pytest.mark.parametrize(
    ("name", "kind", "line"),
    [
        ("duffing", "experiment", "0 1e-3 0 0 0 0 0"),
        ("tue_rig", "plant", "0 0 0 0 0 0"),
        ("duffing", "model", "0"),
        ("huygens_rig", "experiment", "0 0 0"),
    ],
)
def test_the_example_on_linux_answers_lines_with_lines(name, kind, line, tmp_path):
    rate = 1000.0 if kind == "plant" else None
    found = masking.export(name, to="c", kind=kind, rate=rate, out=tmp_path)
    sources = [file for file in found.files if file.suffix == ".c" and "cortex" not in file.name]
    subprocess.run([GCC, *STRICT, "-O2", *sources, "-o", tmp_path / "example", "-lm"], check=True)
    shown = subprocess.run([tmp_path / "example"], input=f"{line}\n" * 3, capture_output=True, text=True, check=True)
    numbers = np.array([row.split() for row in shown.stdout.splitlines()], dtype=float)
    assert len(numbers) == 3
    assert np.all(np.isfinite(numbers))
    if name == "duffing" and kind == "experiment":
        loop, u = Experiment.load(name).loop, np.empty(3)
        loop.kernels.step(0.0, np.array([1e-3, 0.0, 0.0]), np.zeros(3), u, loop.values())
        assert np.allclose(numbers, u, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("duffing", {"to": "java"}, "--to: there is no to 'java'; allowed: c, fmu"),
        ("duffing", {"to": "c", "real": "half"}, "--real: there is no real 'half'; allowed: double, float"),
        ("duffing", {"to": "fmu", "real": "float"}, "--real: float is for C; fmu has double; leave --real out"),
        ("duffing", {"to": "c", "rate": 10.0}, "--rate: a controller has the rate that is declared"),
        ("tue_rig", {"to": "c", "rate": -1.0}, "--rate: -1 is no positive number"),
        ("tue_rig", {"to": "c", "plant": "ideal"}, "--plant: a plant runs on no plant; name an experiment"),
        ("tue_rig", {"to": "c", "changes": {"w1": 1.0}}, "--set: values of a plant stand in its file"),
        ("tue_rog", {"to": "c"}, "did you mean 'tue_rig'?"),
    ],
)
def test_what_cannot_be_exported_is_refused_with_a_way_out(name, settings, text, tmp_path):
    with pytest.raises(DeclarationError) as error:
        masking.export(name, out=tmp_path, **settings)
    assert text in str(error.value)
    assert not list(tmp_path.iterdir())
