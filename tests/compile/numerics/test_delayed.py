"""Delays in models and virtual systems, against a second integrator of delay differential equations."""

from functools import cache

import numpy as np
import pytest

from masking.analysis.masking_error import masking_error
from masking.control.exports.controller_units import law_unit, sampled_unit
from masking.errors import DeclarationError, IntegrationError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.model.modelling.model import load_model
from tests.control.exports.test_controller_units import EXACT, by_kernel
from tests.support.compiled_unit import GCC, CompiledUnit

SECOND = 18.3157  # units of virtual time in a second of the rig
W, W3, MU, LEVEL, TAU = np.array([1.0, 1.15]), 0.8, 0.05, 0.4, (4.0, 3.0)


def oscillators(b, zeta, amplitude):
    """Return the slope of [x1, x2, x3, x1', x2', x3'] for given stretches of the springs in the past."""

    def slope(t, y, past):
        stretch, speed, beam = y[:2] - y[2], y[3:5] - y[5], y[2]
        past = np.array(past)
        force = W**2 * stretch + 2.0 * zeta * W * speed - b * past / (1.0 + (past / LEVEL) ** 4)
        drive = amplitude * np.sin(t)
        last = MU * force.sum() - W3**2 * beam - 2.0 * zeta * W3 * y[5]
        return np.concatenate([y[3:], drive - force, [last]])

    return slope


def by_steps(slope, y, step, count, *, delays, read):
    """Return the states of a delay differential equation: the classical Runge-Kutta method, Hermite's cubic between.

    Args:
        slope: of the time, the state, and what was read in the past.
        y: initial state, which holds at all times before.
        step: length of a step.
        count: of steps.
        delays: by which readings are late; multiples of the step.
        read: what of a state each delay sees.
    """
    late = [round(delay / step) for delay in delays]
    found, slopes = np.empty((count + 1, len(y))), np.empty((count + 1, len(y)))
    found[0] = y

    def past(k, is_halfway):
        then = []
        for i, n in enumerate(late):
            j = k - n
            if j < 0:
                state = found[0]
            elif is_halfway:
                state = 0.5 * (found[j] + found[j + 1]) + step / 8.0 * (slopes[j] - slopes[j + 1])
            else:
                state = found[j]
            then.append(read(state)[i])
        return then

    for k in range(count):
        now, t = found[k], k * step
        slopes[k] = a = slope(t, now, past(k, False))
        b = slope(t + 0.5 * step, now + 0.5 * step * a, past(k, True))
        c = slope(t + 0.5 * step, now + 0.5 * step * b, past(k, True))
        d = slope(t + step, now + step * c, past(k + 1, False))
        found[k + 1] = now + step / 6.0 * (a + 2.0 * (b + c) + d)
    return found


@cache
def truth(b, zeta, amplitude, step, end):
    slope = oscillators(b, zeta, amplitude)
    start = np.array([-0.4, 0.3, 0.0, 0.0, 0.0, 0.0])
    return by_steps(slope, start, step, round(end / step), delays=TAU, read=lambda y: y[:2] - y[2])


def test_a_delay_is_exact_to_the_order_of_the_integrator():
    times = np.linspace(0.0, 40.0, 401)
    model = load_model("delayed_oscillators").dimensionless()
    found = model.simulate(times, tolerance=1e-12).states[:, :6]
    coarse, fine = (np.max(np.abs(truth(0.6, 0.2, 0.35, h, 40.0)[:: round(0.1 / h)] - found)) for h in (0.02, 0.01))
    assert fine <= 2e-9
    assert 12.0 < coarse / fine < 20.0  # the second integrator's order 4, down to what is left of it


def test_a_linear_delay_has_the_solution_of_the_method_of_steps(tmp_path):
    # x'' = -x(t - 1) from x = 1, x' = 0: polynomials of degree 2, 4 and 6 on [0, 1], [1, 2] and [2, 3].
    (tmp_path / "steps.yaml").write_text("{name: s, coordinates: {x: {initial: 1}}, equations: {x'': '-delay(x, 1)'}}")
    times = np.linspace(0.0, 3.0, 31)
    found = load_model(tmp_path / "steps.yaml").simulate(times, tolerance=1e-12).states[:, 0]
    expected = sum(
        (-1.0) ** k * np.maximum(times - (k - 1), 0.0) ** (2 * k) / np.prod(np.arange(1.0, 2 * k + 1)) for k in range(5)
    )
    assert np.max(np.abs(found - expected)) <= 1e-12


@pytest.mark.parametrize(("b", "zeta", "amplitude"), [(0.6, 0.2, 0.35), (0.8, 0.1, 0.0)])
def test_delayed_oscillators_are_masked_on_the_ideal_rig_in_continuous_time(b, zeta, amplitude):
    values = {"b": b, "zeta": zeta, "F": amplitude}
    run = Experiment.load("delayed_oscillators").changed(parameters=values, duration=40).run()
    expected, times = truth(b, zeta, amplitude, 0.01, 40.0), run["t"] * SECOND
    for i, name in enumerate(("x1", "x2", "x3")):
        k = np.minimum((times / 0.01).astype(int), len(expected) - 2)
        x = times / 0.01 - k  # Hermite's cubic
        way, early, late = (
            (expected[k + 1] - expected[k])[:, i],
            0.01 * expected[k, 3 + i],
            0.01 * expected[k + 1, 3 + i],
        )
        square, cube = 3.0 * way - 2.0 * early - late, early + late - 2.0 * way
        found = expected[k, i] + x * (early + x * (square + x * cube))
        assert masking_error(run[f"virtual.{name}"], found) <= 1e-6
    assert max(run.manifest["masking_error"].values()) <= 1e-6


def test_delayed_oscillators_are_masked_by_a_sampled_controller_on_the_imperfect_rig():
    run = Experiment.load("delayed_oscillators_rig").run()
    assert max(run.manifest["masking_error"].values()) <= 0.03


def test_the_error_of_a_sampled_controller_on_a_known_rig_is_that_of_its_hold():
    effects = {"noise": {"enabled": False}, "delay": {"parameters": {"samples": 2}}}
    observer = {"kind": "kalman", "bandwidth": 20.0, "noise": 1e-4}
    made = Experiment.load("delayed_oscillators_rig").changed(
        plant="linear_rig", effects=effects, controller={"rate": "500 Hz", "observer": observer}, duration=40
    )
    assert max(made.run().manifest["masking_error"].values()) <= 1e-4


@pytest.mark.skipif(GCC is None, reason="there is no gcc")
def test_exported_controllers_carry_the_past(tmp_path):
    experiment = Experiment.load("delayed_oscillators_rig").changed(
        controller={"rate": "500 Hz", "model": "setup_springs"}
    )
    unit = sampled_unit(experiment.sampled, "delayed", 0.02)
    compiled = CompiledUnit(tmp_path, unit)
    samples = experiment.sampled.before + 400  # the longest delay is 110 samples
    _, ours, (found,) = by_kernel(experiment, samples, others=[compiled], missed={300})
    assert np.max(np.abs(found - ours)) <= EXACT * np.max(np.abs(ours))


@pytest.mark.parametrize(
    ("equation", "text"),
    [
        ("-x + delay(u, 1)", "without inputs, accelerations and further delays"),
        ("-x + delay(delay(x, 1), 1)", "without inputs, accelerations and further delays"),
        ("-x + delay(x, 0)", "a delay is a positive number"),
        ("-x + delay(x, 1 + x)", "a delay is a positive number, made of parameters alone"),
    ],
)
def test_what_no_delay_can_be_is_refused(tmp_path, equation, text):
    (tmp_path / "m.yaml").write_text(
        f"{{name: m, coordinates: {{x: {{initial: 1}}}}, inputs: {{u: force}}, equations: {{x'': 'u + {equation}'}}}}"
    )
    with pytest.raises(ModelError, match=text):
        load_model(tmp_path / "m.yaml").validate()


def test_what_does_not_take_delays_says_so(tmp_path):
    unbounded = tmp_path / "negative.yaml"
    unbounded.write_text(
        "{name: n, coordinates: {x: {initial: 1}}, parameters: {T: -1}, equations: {x'': '-delay(x, T)'}}"
    )
    (tmp_path / "rig.yaml").write_text("{name: r, model: delayed_oscillators, sensors: {}}")
    with pytest.raises(DeclarationError, match="model oscillators with delayed feedback has delays"):
        Experiment.load("duffing", plant=str(tmp_path / "rig.yaml"))
    (tmp_path / "energy.yaml").write_text("{name: e, extends: delayed_oscillators, energy: 'x1*delay(x1, 1)'}")
    with pytest.raises(DeclarationError, match="may not be delayed here"):
        load_model(tmp_path / "energy.yaml")
    with pytest.raises(ModelError, match="which the export of a control law that is given the states does not take"):
        law_unit(Experiment.load("delayed_oscillators").loop, "law", None)
    model = load_model("delayed_oscillators")
    for refused in (model.linearise, model.to_control):
        with pytest.raises(ModelError, match=r"has delays, which .* does not take"):
            refused()
    with pytest.raises(IntegrationError, match="forwards only"):
        model.dimensionless().simulate(np.array([1.0, 0.0]))
    with pytest.raises(ModelError, match="a delay is -1"):
        load_model(unbounded).simulate(np.array([0.0, 1.0]))
    exact = Experiment.load("delayed_oscillators").changed(controller={"rate": "4 kHz", "observer": "exact"})
    with pytest.raises(ModelError, match=r"has delays, which a controller with 'observer: exact' does not take"):
        exact.run()
    short = Experiment.load("delayed_oscillators_rig").changed(parameters={"tau1": 0.02})
    with pytest.raises(ModelError, match=r"shorter than the 0\.002 s between samples"):
        short.validate()
    (tmp_path / "units.yaml").write_text(
        "{name: m, coordinates: {x: {initial: 1, unit: m}}, parameters: {w: {value: 1, unit: rad/s}}, "
        "equations: {x'': '-w**2*delay(x, 1)'}}"
    )
    with pytest.raises(DeclarationError, match="the delay is a number without unit, and time is s"):
        load_model(tmp_path / "units.yaml").validate()
