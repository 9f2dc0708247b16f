"""Virtual systems with internal states, masked: scipy integrates them with the equations typed out again."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from masking.analysis.masking_error import masking_error
from masking.control.exports.controller_units import sampled_unit
from masking.errors import DeclarationError
from masking.lab.plants.simulated import SimulatedPlant
from masking.lab.runs import rig_run
from masking.lab.runs.experiment import Experiment
from tests.control.exports.test_controller_units import EXACT, by_kernel
from tests.support.compiled_unit import GCC, CompiledUnit

P = {"w1": 1.0, "w2": 1.1, "w3": 0.8, "mu": 0.05, "zeta": 0.05, "alpha": 0.6, "A": 1.0, "beta": 3.0, "gamma": 1.5,
     "n": 1.5, "F": 0.05, "Om": 0.9}  # fmt: skip
SECOND = 18.3157  # units of virtual time in a second of the rig


def bouc_wen(t, y):
    """Return dy/dt of y = [x1, x2, x3, x1', x2', x3', z1, z2], Wen (1976)."""
    x, v, z = y[:3], y[3:6], y[6:]
    stretch, speed = x[:2] - x[2], v[:2] - v[2]
    force = np.array([P["w1"], P["w2"]]) ** 2 * (P["alpha"] * stretch + (1.0 - P["alpha"]) * z)
    beam = P["mu"] * force.sum() - P["w3"] ** 2 * x[2] - 2.0 * P["zeta"] * P["w3"] * v[2]
    dz = P["A"] * speed - np.abs(z) ** (P["n"] - 1.0) * (P["beta"] * np.abs(speed) * z)
    return np.concatenate(
        [v, -force, [beam + P["F"] * np.sin(P["Om"] * t)], dz - P["gamma"] * speed * np.abs(z) ** P["n"]]
    )


@cache
def truth(rows, end):
    times = np.linspace(0.0, end, rows)
    start = [-0.5, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    return times, solve_ivp(bouc_wen, (0.0, end), start, "DOP853", times, rtol=1e-11, atol=1e-13, max_step=0.05).y


@cache
def recorded(name, **changes):
    made = Experiment.load(name)
    return made.changed(duration=min(60, made.declaration.duration), **changes).run()


def test_bouc_wen_is_masked_on_the_ideal_rig_in_continuous_time():
    run = recorded("bouc_wen")
    times = run["t"] * SECOND
    _, expected = truth(6001, 60.0)
    found = [np.interp(times, np.linspace(0.0, 60.0, 6001), row) for row in expected]
    for i, name in ((0, "x1"), (1, "x2"), (2, "x3"), (6, "z1"), (7, "z2")):
        assert np.max(np.abs(run[f"ideal.{name}"] - found[i])) <= 2e-5  # of the interpolation
    assert max(run.manifest["masking_error"].values()) <= 1e-6
    for name in ("z1", "z2"):
        assert masking_error(run[f"virtual.{name}"], run[f"ideal.{name}"]) <= 1e-6


def test_the_ideal_motion_is_that_of_scipy():
    model = Experiment.load("bouc_wen").virtual
    times, expected = truth(6001, 60.0)
    assert np.max(np.abs(model.simulate(times, tolerance=1e-12).states.T - expected)) <= 1e-8


def test_bouc_wen_is_masked_by_a_sampled_controller_on_the_imperfect_rig():
    run = recorded("bouc_wen_rig")
    assert max(run.manifest["masking_error"].values()) <= 0.03
    for name in ("z1", "z2"):
        assert masking_error(run[f"virtual.{name}"], run[f"ideal.{name}"]) <= 0.03


def bristled(t, y):
    """Return dy/dt of y = [x, x', z], Canudas de Wit et al. (1995), in SI units."""
    x, v, z = y
    dz = v - 400.0 * abs(v) / (0.15 + 0.05 * np.exp(-((v / 0.02) ** 2))) * z
    return [v, 0.6 * np.sin(5.0 * t) - 64.0 * x - 400.0 * z - 8.0 * dz - 0.5 * v, dz]


@cache
def on_bristles(times):
    return solve_ivp(bristled, (0.0, times[-1]), [0.0] * 3, "Radau", times, rtol=1e-10, atol=1e-13, max_step=0.02).y


def test_the_friction_of_bristles_is_masked_in_continuous_time():
    made = Experiment.load("cart_bristles")
    run = made.changed(controller={"rate": "continuous"}, effects={"friction": False}).run()
    x, _, z = on_bristles(tuple(run.t))
    np.testing.assert_allclose(run["virtual.x"], x, atol=1e-6 * np.abs(x).max())
    np.testing.assert_allclose(run["virtual.z"], z, atol=1e-5 * np.abs(z).max())
    assert run.manifest["masking_error"]["x"] <= 1e-6
    sticks = np.abs(run["virtual.x'"]) < 1e-3
    assert np.abs(z[sticks]).max() > 0.15 / 400.0  # bent beyond what sliding does: it sticks at the reversals


def test_the_friction_of_bristles_is_masked_by_a_sampled_controller_on_the_imperfect_rig():
    run = recorded("cart_bristles")
    x, _, z = on_bristles(tuple(run.t))
    assert run.manifest["masking_error"]["x"] <= 0.03
    assert masking_error(run["virtual.x"], x) <= 0.03
    assert masking_error(run["virtual.z"], z) <= 0.1


def at_rate(rate, **changes):
    """Return the worst masking error on a rig that the controller knows, without noise, two samples late."""
    effects = {"noise": {"enabled": False}, "delay": {"parameters": {"samples": 2}}}
    observer = {"kind": "kalman", "bandwidth": 20.0, "noise": 1e-4}
    settings = {"controller": {"rate": f"{rate} Hz", "observer": observer}, "effects": effects, **changes}
    made = Experiment.load("bouc_wen_rig").changed(
        plant="linear_rig", duration=40, record={"rate": "250 Hz"}, **settings
    )
    return max(made.run().manifest["masking_error"].values())


def test_the_error_of_a_sampled_controller_falls_as_without_internal_states():
    errors = [at_rate(rate) for rate in (250, 500, 1000)]
    assert errors[1] <= 1e-3
    without = [at_rate(rate, virtual="duffing") for rate in (250, 1000)]
    assert errors[0] / errors[1] > 3.5
    assert errors[1] / errors[2] > 3.5
    assert errors[0] <= without[0]
    assert errors[2] <= without[1]


@pytest.mark.parametrize(("observer", "bar"), [("exact", 0.01), ("differences", 0.015)])
def test_observers_without_a_model_carry_internal_states(observer, bar):
    # At these rates, as in the source, a lag of half a sample, or of a whole one where velocities are differences.
    settings = {"plant": "ideal", "effects": {}, "duration": 20}
    made = Experiment.load("bouc_wen_rig").changed(controller={"rate": "4 kHz", "observer": observer}, **settings)
    assert max(made.run().manifest["masking_error"].values()) <= bar


def test_internal_states_begin_where_the_experiment_says():
    run = Experiment.load("bouc_wen").changed(initial={"z1": 0.2}, duration=5).run()
    assert run["virtual.z1"][0] == run["ideal.z1"][0] == 0.2
    assert run["virtual.z2"][0] == 0.0
    with pytest.raises(DeclarationError, match="'z3' is not a coordinate of hysteretic oscillators"):
        Experiment.load("bouc_wen").changed(initial={"z3": 0.2})


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_exported_controllers_carry_internal_states(tmp_path):
    experiment = Experiment.load("bouc_wen_rig").changed(controller={"rate": "500 Hz", "model": "setup_springs"})
    unit = sampled_unit(experiment.sampled, "hysteretic", 0.02)
    assert [channel.name for channel in unit.states][-2:] == ["virtual.z1", "virtual.z2"]
    compiled = CompiledUnit(tmp_path, unit)
    samples = experiment.sampled.before + 400
    _, ours, (found,) = by_kernel(experiment, samples, others=[compiled], missed={300})
    assert np.max(np.abs(found - ours)) <= EXACT * np.max(np.abs(ours))


@pytest.mark.parametrize("name", ["bouc_wen_rig", "delayed_oscillators_rig"])
def test_a_rig_in_lockstep_moves_as_the_loop_around_its_twin(name):
    experiment = Experiment.load(name).changed(duration=20)
    offline = experiment.run()
    found = rig_run.run(experiment, SimulatedPlant(experiment.twin), rig_run.RunSettings(lockstep=True))
    largest = max(np.max(np.abs(offline[f"input.V{i}"])) for i in (1, 2, 3))
    for i in (1, 2, 3):
        assert np.max(np.abs(found[f"input.V{i}"] - offline[f"input.V{i}"])) <= 1e-9 * largest
