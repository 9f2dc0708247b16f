"""Sensitivities of a twin's readings, against exact solutions and central differences."""

import subprocess
import sys

import numpy as np
import pytest
from scipy import linalg, signal

from masking.app.workflows import discovery_inputs
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, ModelError
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import Sensitivity
from masking.model.declaration import schema

RATE = 1000.0
NAMES = ("w1", "z1", "w2", "z2", "w3", "z3", "c1", "c2", "c3", "mu1", "mu2")


def commands(samples, seed=0, size=0.02):
    """Return three sums of sines (samples, 3), V."""
    generator = np.random.default_rng(seed)
    t = np.arange(samples) / RATE
    lines = 2 * np.pi * np.linspace(0.4, 8.0, 12)
    return size * np.array([np.sin(lines * t[:, None] + generator.uniform(0, 7, 12)).sum(axis=1) for _ in range(3)]).T


@pytest.fixture(scope="module")
def linear():
    return Sensitivity(Twin.load("linear_rig"), NAMES)


@pytest.mark.parametrize(("value", "bounds"), [(0.0, (0.0, None)), (0.5, (None, 0.5)), (0.0, (0.0, 0.0))])
def test_a_parameter_may_be_at_its_bound(value, bounds, tmp_path):
    """Of x'' = f - k*x - c*x', for which a difference beyond the bounds would be refused."""
    path, text = tmp_path / "mass.yaml", ", ".join("null" if b is None else str(b) for b in bounds)
    path.write_text(
        "name: mass\ncoordinates: {x: {}}\ninputs: {f: {}}\nparameters: {c: {value: "
        f"{value}, bounds: [{text}]}}, k: 100}}\nequations: {{\"x''\": f - k*x - c*x'}}\n"
    )
    found = Sensitivity(discovery_inputs.rig(path, None), ("c", "k"))
    p, columns = found.basis(found.start())
    slopes = np.zeros((len(p), 2))
    slopes[list(found.affected)] = columns
    rows = [int(np.flatnonzero(p == at)[0]) for at in (value, 100.0)]
    np.testing.assert_allclose(slopes[rows], [[bounds != (0.0, 0.0), 0.0], [0.0, 1.0]], atol=1e-9)


def test_sensors_that_round_are_simulated_as_they_are_before_that():
    """The twin keeps what it declares; rounded readings lie half a step from what is simulated, and no more."""
    twin = Twin.load("tue_rig")
    sensing, step = Sensitivity(twin, ()), 20 / 65536
    start = twin.rest(np.array([1.23456e-3, -2e-3, 5e-4]))
    simulated = sensing.sensed(start)[0]
    rounded = np.empty(3)
    twin.kernels.sense(0.0, start, twin.values(), np.zeros(3), rounded)
    np.testing.assert_allclose(rounded, step * np.round(simulated / step), rtol=0, atol=1e-12)
    assert (np.abs(rounded - simulated) > 1e-6).all()
    assert sensing.twin_at(np.empty(0)).noise() == twin.noise()
    assert [effect.enabled for effect in sensing.twin.effects] == [effect.enabled for effect in twin.effects]


def test_readings_are_those_of_the_exact_solution(linear):
    """The set-up's linear equations under held commands, stepped by a matrix exponential."""
    w, z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
    c, mu = np.array([20.9218, 23.2465, 1.2589]), np.array([0.0411, 0.0578])
    flow = np.zeros((9, 9))
    flow[:3, 3:6] = np.eye(3)
    for i in (0, 1):
        row = np.zeros(6)
        row[[i, 2, 3 + i, 5]] = -(w[i] ** 2), w[i] ** 2, -2 * z[i] * w[i], 2 * z[i] * w[i]
        flow[3 + i, :6] = row
        flow[5, :6] -= mu[i] * row
    flow[5, [2, 5]] -= w[2] ** 2, 2 * z[2] * w[2]
    flow[3:6, 6:] = np.array([[1, 0, 0], [0, 1, 0], [-mu[0], -mu[1], 1]]) @ np.diag(c)  # Newton's third law
    step, u = linalg.expm(flow / RATE), commands(3000)
    y, expected = np.zeros(6), []
    for command in u:
        expected.append(200.0 * np.array([y[0] - y[2], y[1] - y[2], y[2]]))
        y = step[:6, :6] @ y + step[:6, 6:] @ command
    found = linear.simulate(linear.start(), np.zeros(6), u, rate=RATE, substeps=2)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * np.abs(expected).max())


# Inputs that go in straight lines between samples.


@pytest.fixture(scope="module")
def oscillator():
    """A mass on a spring with 9.9 samples in a period, driven through a lag; its parameters are w, z and c."""
    model = {
        "name": "oscillator",
        "coordinates": {"x": {}},
        "inputs": {"u": {}},
        "parameters": {"w": {"value": 6.3}, "z": {"value": 0.05}, "c": {"value": 40.0}},
        "equations": {"x''": "-w**2*x - 2*z*w*x' + c*u"},
    }
    plant = {
        "name": "rig",
        "model": "oscillator",
        "actuators": {"V": {"unit": "1"}},
        "allocation": {"u": "V"},
        "sensors": {"s": {"measures": "x", "gain": 2.0, "unit": "1"}},
        "effects": {"lag": {"effect": "actuator_lag", "at": "V", "parameters": {"tau": 0.1}}},
    }
    twin = Twin(schema.PlantDeclaration.model_validate(plant), schema.ModelDeclaration.model_validate(model))
    return Sensitivity(twin, ("w", "z", "c", "lag_tau"))


OSCILLATOR = {"rate": 9.9 * 6.3 / (2 * np.pi)}


def first_order_hold(theta, start, u):
    """Return the oscillator's exact readings (m, 1) under inputs in straight lines, from scipy."""
    w, z, c, tau = theta
    a = [[0.0, 1.0, 0.0], [-(w**2), -2 * z * w, c], [0.0, 0.0, -1.0 / tau]]
    system = (a, [[0.0], [0.0], [1.0 / tau]], [[2.0, 0.0, 0.0]], [[0.0]])
    return signal.lsim(system, u, np.arange(len(u)) / OSCILLATOR["rate"], start, interp=True)[1][:, None]


def test_straight_commands_are_a_first_order_hold(oscillator):
    """Against the exact solution: within 1e-9, and 16 times closer with steps of half the length."""
    theta, start = oscillator.start(), np.array([0.3, -1.0, 0.2])
    u = np.random.default_rng(0).standard_normal((400, 1))
    exact = first_order_hold(theta, start, u)
    off = [
        np.abs(oscillator.simulate(theta, start, u, substeps=n, hold="first-order", **OSCILLATOR) - exact).max()
        for n in (4, 8, 16, 128)
    ]
    assert off[-1] < 1e-9 * np.abs(exact).max()
    np.testing.assert_allclose(np.log2(np.divide(off[:2], off[1:3])), 4.0, atol=0.3)
    held = oscillator.simulate(theta, start, u, substeps=64, **OSCILLATOR)
    assert np.abs(held - exact).max() > 0.1 * np.abs(exact).max()


def test_a_hold_that_is_not_known_is_refused(oscillator):
    u = np.zeros((10, 1))
    with pytest.raises(ModelError, match="hold is 'linear': give 'zero-order' for commands that act until the next"):
        oscillator.simulate(oscillator.start(), np.zeros(3), u, rate=1.0, substeps=1, hold="linear")


def by_differences(sensitivity, theta, start, u, hold):
    """Return the derivatives of all readings (m, sensors, k + states) by central differences."""
    columns = []
    for i in range(len(theta) + len(start)):
        at = []
        for sign in (1, -1):
            values, state = theta.copy(), start.copy()
            step = 1e-5 * (abs(theta[i]) or 1.0) if i < len(theta) else 1e-7
            (values if i < len(theta) else state)[i if i < len(theta) else i - len(theta)] += sign * step
            at.append(sensitivity.simulate(values, state, u, rate=RATE, substeps=2, hold=hold))
        columns.append((at[0] - at[1]) / (2 * step))
    return np.moveaxis(np.array(columns), 0, -1)


@pytest.fixture(scope="module")
def full():
    """The full twin without what has no derivative: the steps of its converter and its stop."""
    changes = {name: schema.EffectChange(enabled=False) for name in ("steps", "red_stop", "red_friction")}
    twin = Twin.load("tue_rig").changed({**changes, "strong_gain": schema.EffectChange(enabled=True)})
    return Sensitivity(twin, ("w1", "z1", "mu2", "friction1_fc", "hysteresis3_k", "strong_gain_V1_e", "offset_s2_e0"))


@pytest.mark.parametrize("hold", ["zero-order", "first-order"])
@pytest.mark.parametrize("which", ["linear", "full"])
def test_normal_equations_are_those_of_differences(which, hold, request):
    found = request.getfixturevalue(which)
    theta, u, weights = found.start(), commands(600), np.array([1.0, 4.0, 0.25])
    start = found.twin.rest(np.array([1e-3, -5e-4, 2e-4]))
    settings = {"rate": RATE, "substeps": 2, "hold": hold}
    readings = found.simulate(theta * 1.02, start, u, **settings)
    record = Data("made up", RATE, u, readings, hold=hold)
    told = found.normal_equations(found.basis(theta), start, record, weights, 2)
    jacobian = by_differences(found, theta, start, u, hold)
    residuals = readings - found.simulate(theta, start, u, **settings)
    matrix = np.einsum("mok,o,mol->kl", jacobian, weights, jacobian)
    gradient = np.einsum("mok,o,mo->k", jacobian, weights, residuals)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    np.testing.assert_allclose(told.matrix / scale / scale[:, None], matrix / scale / scale[:, None], rtol=0, atol=1e-4)
    np.testing.assert_allclose(
        told.gradient / scale, gradient / scale, rtol=0, atol=1e-4 * np.abs(gradient / scale).max()
    )
    np.testing.assert_allclose(told.squares, (residuals**2).sum(axis=0), rtol=1e-9)


def test_a_parameter_acts_on_all_that_is_declared_by_it(full):
    """The twin's friction stands for the damping of its beam: 2 z3 w3 of the model is taken away by an effect."""
    twin, z3 = full.twin.with_parameters({"z3": 0.08}), full.twin.model.value("z3")
    assert twin.model.value("damping3_c") == pytest.approx(full.twin.model.value("damping3_c") * 0.08 / z3)


def test_effects_at_one_place_are_changed_there_alone(full):
    twin = full.twin.with_parameters({"strong_gain_V1_e": 0.5})
    assert twin.parameter_value("strong_gain_V1_e") == 0.5
    assert twin.parameter_value("strong_gain_V3_e") == 0.03


def test_an_unknown_parameter_is_refused():
    with pytest.raises(ModelError, match="linear rig has no parameter 'w9'; did you mean 'w"):
        Sensitivity(Twin.load("linear_rig"), ("w9",))


def test_a_motion_that_is_not_finite_is_refused(linear):
    """Steps of a second are far too long for an integrator of motions of 14 rad/s."""
    u, weights = commands(3000), np.ones(3)
    with pytest.raises(IntegrationError, match="no longer finite"):
        linear.simulate(linear.start(), np.zeros(6), u, rate=1.0, substeps=1)
    with pytest.raises(IntegrationError, match="no longer finite"):
        linear.normal_equations(linear.basis(linear.start()), np.zeros(6), Data("slow", 1.0, u, u), weights, 1)


def test_kernels_that_are_on_disk_are_loaded_without_numba():
    code = (
        "import sys; from masking.inference.estimation.sensitivity import Sensitivity\n"
        "from masking.control.rig.twin import Twin\n"
        "twin = Twin.load('linear_rig'); Sensitivity(twin, twin.equation_parameters()).kernels.normal.prepare()\n"
        "print('numba.core.dispatcher' in sys.modules)"
    )
    ended = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(2)]
    assert ended[-1].stdout == "False\n"
