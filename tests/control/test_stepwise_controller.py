"""A controller in a loop of one's own: the loops of the package to the last bit, and masking as scipy integrates it."""

import gc
import threading
import tracemalloc
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking
from masking.compile.codegen.machine_code import RESULTS
from masking.control.stepwise_controller import LawStep, SampledStep
from masking.errors import CommandError, PlantMismatchError, SingularityError
from masking.lab.plants.interface import Settings
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs.simulated_run import joined, sampled_chunks
from tests.control.test_sampled_controller import LAMBDA, LENGTH, OMEGA, START, free, ideal

AFTER = 400  # samples from the release on


@cache
def clocks():
    return masking.Experiment.load("huygens_rig").changed(duration=AFTER / 1000.0 / 0.1596424)


@cache
def continuous():
    return masking.Experiment.load("duffing").controller()


def own_loop(step, samples, experiment=None, given=lambda values: values):
    """A loop as a user writes it; the commands of each sample."""
    experiment = experiment or clocks()
    plant = SimulatedPlant(experiment.twin, experiment.declaration.seed)
    plant.configure(Settings(step.rate))
    plant.activate()
    rows = []
    for _ in range(samples):
        sample = plant.read()
        commands = step(given(sample.values))
        plant.write(sample.index, commands)
        rows.append([*commands, *step.estimate, *step.demanded, *step.power])
    plant.deactivate()
    return np.array(rows)


def test_a_loop_of_ones_own_is_the_packaged_run_to_the_last_bit():
    step, recording = clocks().controller(), clocks().run()
    before = -step.index
    rows = own_loop(step, before + AFTER)
    assert step.index == AFTER
    for i, name in enumerate(step.actuators):
        assert recording[f"input.{name}"][:AFTER].tolist() == rows[before:, i].tolist()
        assert recording[f"demanded.{name}"][:AFTER].tolist() == rows[before:, -6 + i].tolist()
        assert recording[f"power.{name}"][:AFTER].tolist() == rows[before:, -3 + i].tolist()
    assert np.abs(rows[before:, :3]).max() > 1e-3


def test_after_a_reset_all_is_repeated():
    step = clocks().controller()
    first = own_loop(step, 300)
    step.reset()
    assert step.index < 0
    assert not step.applied.any()
    assert own_loop(step, 300, given=list).tolist() == first.tolist()
    state, index = step.state.copy(), step.index
    ahead = [step(np.full(3, 0.01)).copy() for _ in range(5)]
    step.state[:], step.index = state, index
    assert np.array_equal([step([0.01, 0.01, 0.01]).copy() for _ in range(5)], ahead)


def test_two_loops_run_side_by_side_in_threads():
    alone, found = own_loop(clocks().controller(), 300), {}

    def loop(name, step):
        found[name] = own_loop(step, 300)

    threads = [threading.Thread(target=loop, args=(i, clocks().controller())) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[0].tolist() == found[1].tolist() == alone.tolist()


@pytest.mark.parametrize("kind", [list, np.array])
def test_a_call_allocates_nothing(kind):
    step, readings = clocks().controller(), kind([0.01, -0.01, 0.02])
    law, state = continuous(), kind([0.001, 0.0, 0.002, 0.0, 0.01, 0.0])
    for _ in range(10):
        step(readings)
        law(0.0, state)
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(1000):
        step(readings)
        law(0.0, state)
    after, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 200  # a counter and the like: a number each, however many calls
    assert peak - before < 1000


@pytest.mark.parametrize(
    ("readings", "said"),
    [
        ([0.0, 0.0], r"got shape \(2,\); give \(3,\), one reading for each of s1, s2, s3"),
        (np.zeros(4), r"got shape \(4,\); give \(3,\)"),
        (np.zeros((1, 3)), r"got shape \(1, 3\); give \(3,\)"),
        (0.0, r"got shape \(\); give \(3,\)"),
        (["a", "b", "c"], r"got \['a', 'b', 'c'\], which are not numbers; give \(3,\)"),
        ({"s1": 0.0, "s2": 0.0, "s3": 0.0}, "which are not numbers"),
    ],
)
def test_readings_of_another_shape_are_named(readings, said):
    step = clocks().controller()
    with pytest.raises(PlantMismatchError, match=said):
        step(readings)
    with pytest.raises(PlantMismatchError, match=said):
        step.reset(readings)
    assert np.isfinite(step([0.0, 0.0, 0.0])).all()


def test_a_state_of_another_shape_is_named():
    with pytest.raises(PlantMismatchError, match=r"give \(6,\), one state for each of x1, x2, x3, x1', x2', x3'"):
        continuous()(0.0, np.zeros(3))


def test_after_commands_that_are_not_finite_they_are_zero_until_a_reset():
    step = clocks().controller()
    readings = [0.01, -0.01, 0.02]
    first = step(readings).copy()
    step.index = 7  # no longer at rest
    with pytest.raises(CommandError, match="command of V1, V2, V3 is no longer finite, at sample 7; look at what it"):
        step([0.0, np.nan, 0.0])
    assert not step.applied.any()
    with pytest.raises(CommandError, match="the controller stopped at sample 7; call reset to begin again"):
        step(readings)
    step.reset()
    assert step(readings).tolist() == first.tolist()


def test_a_law_stops_where_its_matrix_is_singular():
    bent = {"expressions": {"x1": "x1 - x1**3/three", "x2": "x2", "x3": "x3"}, "parameters": {"three": 3.0}}
    step = masking.Experiment.load("duffing").changed(transform=bent).controller()
    state = np.array([0.5 * LENGTH, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = step(0.0, state).copy()
    state[0] = 1.5 * LENGTH  # the slope 1 - x1**2 has changed its sign
    with pytest.raises(SingularityError, match=r"became singular at t = 0.25 \(x1 = 0.0075, .*choose a transform"):
        step(0.25, state)
    assert not step.applied.any()
    step.reset()
    state[0] = 0.5 * LENGTH
    assert step(0.0, state).tolist() == found.tolist()


def test_the_law_drives_the_rig_as_the_virtual_system_moves():
    """The rig (4.4)-(4.6) and the Duffing oscillators (7.5)-(7.7) are those of `test_sampled`, by scipy."""
    step, times = continuous(), np.linspace(0.0, 20.0, 50)
    assert isinstance(step, LawStep)
    assert step.actuators == ("u1", "u2", "u3")

    def rate(t, y):
        return [*y[3:], *(free(y[:3], y[3:]) + LAMBDA @ step(t, y))]

    start = [*(LENGTH * START), 0.0, 0.0, 0.0]
    found = solve_ivp(rate, (0.0, times[-1] / OMEGA), start, "DOP853", t_eval=times / OMEGA, rtol=1e-11, atol=1e-16)
    np.testing.assert_allclose(found.y[:3].T / LENGTH, ideal(times), rtol=0, atol=1e-8)


def test_the_law_gives_the_inputs_of_the_packaged_loop_to_the_last_bit():
    experiment = masking.Experiment.load("duffing_sampled")
    step, start = experiment.controller(), np.array([*(LENGTH * START), 0.0, 0.0, 0.0])
    run = joined(sampled_chunks(experiment.loop, start, rate=4000.0, duration=0.2))
    for t, state, inputs in zip(run.times, run.rig, run.inputs, strict=True):
        step(t, state)
        assert step.inputs.tolist() == inputs.tolist()
    assert np.abs(run.inputs).max() > 0.01


def test_arrays_that_machine_code_cannot_read_are_not_bound():
    kernels = masking.load_model("duffing").kernels
    arrays = [np.zeros(1), *[np.zeros(3)] * 2, np.zeros(0), np.ones(8), np.zeros(3)]
    bound = kernels.accelerations.bind(*arrays)
    assert len(bound.results) == RESULTS
    with pytest.raises(TypeError, match="t must be an array, not float"):
        kernels.accelerations.bind(0.0, *arrays[1:])
    with pytest.raises(TypeError, match="q must be a C-contiguous float64 array of dimension 1, not float32"):
        kernels.accelerations.bind(arrays[0], np.zeros(3, dtype=np.float32), *arrays[2:])


def test_an_experiment_gives_the_step_that_fits_it():
    assert isinstance(clocks().controller(), SampledStep)
    assert clocks().controller() is not clocks().controller()
