"""Observers: the gain is Kalman's, the bandwidth is where the poles are, and noise stays out of the commands."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, signal

from masking.control.observer import Differences, Kalman, Plan
from masking.errors import DeclarationError, ModelError
from masking.lab.runs.experiment import Experiment
from masking.model.declaration import registry, schema

control = pytest.importorskip("control")
# The set-up in SI units, table B.1.
W, Z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
C, MU = np.array([20.9218, 23.2465, 1.2589]), np.array([0.0411, 0.0578])
GAIN = 200.0  # V/m, 1 V for 5 mm


def setup_dynamics():
    """d [q, v] / dt per [q, v], (4.4)-(4.6) written out."""
    stiffness, damping = W**2, 2 * Z * W
    rows = [
        [-stiffness[0], 0, stiffness[0], -damping[0], 0, damping[0]],
        [0, -stiffness[1], stiffness[1], 0, -damping[1], damping[1]],
        [
            *(MU[0] * stiffness[0], MU[1] * stiffness[1], -MU @ stiffness[:2] - stiffness[2]),
            *(MU[0] * damping[0], MU[1] * damping[1], -MU @ damping[:2] - damping[2]),
        ],
    ]
    return np.vstack([np.hstack([np.zeros((3, 3)), np.eye(3)]), rows])


SENSING = GAIN * np.array([[1, 0, -1, 0, 0, 0], [0, 1, -1, 0, 0, 0], [0, 0, 1, 0, 0, 0]], dtype=float)
# Commands per acceleration, in parts of 0.42 V: the beam's actuator makes up for what the others push, mu_i x_i''.
COMMAND = np.array([[1 / C[0], 0, 0], [0, 1 / C[1], 0], [*MU / C[2], 1 / C[2]]]) / 0.42


def plan(*, noise=1e-4, period=1e-3, delay=1):
    return Plan(setup_dynamics(), SENSING, COMMAND, np.full(3, noise), period, delay)


@pytest.fixture(scope="module")
def linear_rig():
    settings = schema.ControllerSettings.model_validate({"rate": "1 kHz", "observer": "disturbance"})
    declaration = registry.load_experiment("duffing").model_copy(update={"controller": settings})
    return Experiment(registry.assemble(declaration, "linear_rig"))


def test_a_rig_is_planned_for_as_its_file_says(linear_rig):
    """Linearisation, sensors, allocation and limits of the packaged plant, against the formulas written out above."""
    found, by_hand = linear_rig.instruments.plan(1000.0, None), plan()
    np.testing.assert_allclose(found.dynamics, by_hand.dynamics, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.sensing, by_hand.sensing, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.command, by_hand.command, rtol=1e-9, atol=1e-12)
    assert (list(found.noise), found.period, found.delay) == ([1e-4] * 3, 1e-3, 1)


# The gain.


def discrete(order, bandwidth, given):
    """Step, process noise, readings of [q, v, d, d'] in units bandwidth^k of a length, integrated by quadrature."""
    n, h = 3, given.period
    size = (2 + order) * n
    flow = np.zeros((size, size))
    flow[: 2 * n, : 2 * n] = given.dynamics
    for k in range(order):
        flow[(1 + k) * n : (2 + k) * n, (2 + k) * n : (3 + k) * n] = np.eye(n)
    flow[2 * n : (1 + order) * n, :n] = 0.0
    # q1 is told by s1 + s3, q2 by s2 + s3, q3 by s3 alone.
    variance = (given.noise[0] / GAIN) ** 2 * np.array([2.0, 2.0, 1.0])
    driven = np.zeros((size, size))
    driven[-n:, -n:] = np.diag(variance * h * bandwidth ** (2 * (2 + order)))
    unit = np.concatenate([bandwidth**k for k in range(2 + order)]) * math.sqrt(variance[0])
    flow, driven = flow * unit / unit[:, None], driven / np.outer(unit, unit)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    noise = np.zeros((size, size))
    for node, weight in zip(0.5 * h * (nodes + 1.0), 0.5 * h * weights, strict=True):
        part = linalg.expm(flow * node)
        noise += weight * part @ driven @ part.T
    reading = np.hstack([given.sensing, np.zeros((3, order * n))]) * unit
    return linalg.expm(flow * h), noise, reading, unit


@pytest.mark.parametrize("order", [0, 1, 2])
def test_gain_is_that_of_a_riccati_recursion_and_of_python_control(order):
    given, bandwidth = plan(), np.array([200.0, 150.0, 90.0])
    step, noise, reading, unit = discrete(order, bandwidth, given)
    measured = np.diag(given.noise**2)
    covariance = np.eye(len(step))
    for _ in range(4000):
        steady = covariance @ reading.T @ np.linalg.inv(reading @ covariance @ reading.T + measured)
        rest = np.eye(len(step)) - steady @ reading
        covariance = step @ (rest @ covariance @ rest.T + steady @ measured @ steady.T) @ step.T + noise
    observer = Kalman(order, tuple(bandwidth))
    found = observer.gain(given, offset=0) / unit[:, None]
    scale = np.abs(steady).max()
    np.testing.assert_allclose(found, steady, rtol=0, atol=1e-8 * scale)
    predictor, *_ = control.dlqe(step, np.eye(len(step)), reading, noise, measured)
    np.testing.assert_allclose(step @ found, predictor, rtol=0, atol=1e-6 * scale)


def test_internal_states_are_not_corrected():
    found, without = Kalman(1).gain(plan(), offset=2), Kalman(1).gain(plan(), offset=0)
    np.testing.assert_array_equal(found[6:8], 0.0)
    np.testing.assert_array_equal(np.delete(found, [6, 7], axis=0), without)


def test_differences_take_positions_from_readings():
    """q3 = s3 / gain, q1 = (s1 + s3) / gain: the T of (A.1)."""
    expected = np.array([[1, 0, 1], [0, 1, 1], [0, 0, 1]]) / GAIN
    np.testing.assert_allclose(Differences().gain(plan(), 0), expected, atol=1e-17)
    assert np.isinf(Differences().bandwidths(plan())).all()


# Bandwidth.


def chain(order, period):
    """A free mass behind a sensor: 2, 3 or 4 integrators with the disturbance's."""
    return Plan(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]]), np.ones((1, 1)), np.ones(1), period, 0)


@pytest.mark.parametrize("rate", [1e3, 2e4, 1e5])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_gain_far_below_the_rate_is_exact(order, rate):
    """A free mass followed much slower than it is sampled: the limit of continuous time, known in closed form.

    The gain times the rate is then made of the coefficients of Butterworth's polynomial, w^k / h^-1 each.
    """
    bandwidth = 10.0
    gain = Kalman(order, bandwidth).gain(chain(order, 1.0 / rate), 0)[:, 0]
    poles = bandwidth * signal.buttap(2 + order)[1]
    expected = np.poly(poles).real[1:] / rate
    np.testing.assert_allclose(gain, expected, rtol=3.0 * bandwidth / rate)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_poles_lie_on_a_circle_of_the_bandwidth_in_butterworths_pattern(order):
    bandwidth, period = 20.0, 5e-4
    given = chain(order, period)
    gain = Kalman(order, bandwidth).gain(given, 0)
    size = 2 + order
    step = np.array(
        [[period ** (j - i) / math.factorial(max(j - i, 0)) * (j >= i) for j in range(size)] for i in range(size)]
    )
    error = (np.eye(size) - gain @ np.eye(1, size)) @ step
    poles = np.log(np.linalg.eigvals(error).astype(complex)) / period
    expected = bandwidth * signal.buttap(size)[1]
    found, expected = (sorted(p, key=lambda pole: round(pole.imag, 6)) for p in (poles, expected))
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02 * bandwidth)


@pytest.mark.parametrize(("delay", "period"), [(0, 1e-3), (1, 1e-3), (3, 1e-3), (1, 2.5e-4)])
def test_quiet_sensors_are_followed_as_fast_as_sampling_allows(delay, period):
    found = Kalman(2).bandwidths(plan(noise=1e-12, period=period, delay=delay))
    np.testing.assert_allclose(found, 0.7 / (period * (1 + delay)))
    np.testing.assert_array_equal(found, Kalman(2).bandwidths(plan(noise=0.0, period=period, delay=delay)))


def command_noise(given, order, chosen, *, samples=40_000):
    """Standard deviation of each command, in parts of its limit, due to each coordinate's estimate, on a rig at rest.

    The estimate is run on noise alone; what is cancelled is the model's acceleration and the
    disturbance where it will be half a sample after the delay.
    """
    step, _, reading, unit = discrete(order, chosen, given)
    gain = Kalman(order, tuple(chosen)).gain(given, 0) / unit[:, None]
    generator = np.random.default_rng(1)
    readings = generator.normal(0.0, given.noise, (samples, 3))
    poles, modes = np.linalg.eig((np.eye(len(step)) - gain @ reading) @ step)  # z_k = (1 - K C) F z_(k-1) + K noise_k
    driven = np.linalg.solve(modes, gain @ readings.T)
    moved = np.array([signal.lfilter([1.0], [1.0, -pole], row) for pole, row in zip(poles, driven, strict=True)])
    states = (modes @ moved).real.T[2000:] * unit
    lead = (given.delay + 0.5) * given.period
    cancelled = states[:, :6] @ given.dynamics[3:].T + states[:, 6:9]
    if order == 2:
        cancelled += lead * states[:, 9:]
    return np.abs(given.command) * cancelled.std(axis=0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("level", [1e-4, 1e-3])
def test_the_noise_of_a_command_is_two_percent_at_most(order, level):
    given = plan(noise=level)
    chosen = Kalman(order).bandwidths(given)
    noise = command_noise(given, order, chosen)
    assert noise.max() <= 0.02 * 1.1, noise
    lowered = chosen < given.fastest * (1 - 1e-9)
    if level == 1e-3:
        assert lowered.any()
    for i in np.flatnonzero(lowered):  # and not lower than it must be: one step of 1/0.9 further up it is too noisy
        faster = chosen.copy()
        faster[i] /= 0.9
        assert command_noise(given, order, faster)[:, i].max() > 0.02 * 0.9


def test_smaller_limits_make_a_slower_observer():
    """The noise of a d that is followed with bandwidth w grows as w^(5/2), so that half the limit takes w / 1.32."""
    given = plan(noise=1e-3)
    found = Kalman(2).bandwidths(given)
    halved = Kalman(2).bandwidths(replace(given, command=2.0 * given.command))
    assert (found < given.fastest).all()
    np.testing.assert_allclose(found / halved, 2**0.4, rtol=0.1)


def test_limits_of_the_plant_file_enter(linear_rig):
    instruments = linear_rig.instruments
    limits = instruments.plant.limits
    smaller = {name: limit.model_copy(update={"max": 0.5 * limit.max}) for name, limit in limits.inputs.items()}
    plant = instruments.plant.model_copy(update={"limits": limits.model_copy(update={"inputs": smaller})})
    given = replace(instruments, plant=plant).plan(1000.0, 1e-3)
    np.testing.assert_allclose(given.command, 2.0 * plan().command, rtol=1e-9, atol=1e-12)
    assert (Kalman(2).bandwidths(given) < Kalman(2).bandwidths(instruments.plan(1000.0, 1e-3))).all()


def test_a_chosen_bandwidth_overrides_the_rule():
    noisy = plan(noise=1.0)
    np.testing.assert_array_equal(Kalman(2, 300.0).bandwidths(noisy), [300.0] * 3)
    np.testing.assert_array_equal(Kalman(0, (100.0, 50.0, 25.0)).bandwidths(noisy), [100.0, 50.0, 25.0])


# Refusals, each with its remedy.


def test_a_bandwidth_faster_than_sampling_is_refused():
    message = (
        r"observer\.bandwidth 501 rad/s is faster than the sampling allows: at 1000 Hz and 1 sample of delay it is "
        r"at most 500 rad/s; lower it, or raise controller\.rate"
    )
    with pytest.raises(ModelError, match=message):
        Kalman(2, 501.0).bandwidths(plan())
    assert Kalman(2, 500.0).bandwidths(plan()).max() == 500.0


def test_noise_that_leaves_no_bandwidth_is_refused():
    message = r"too noisy for an observer: .* 2% of an actuator at any bandwidth; check the noise and the limits of the"
    for level in (1.0, 1e9):
        with pytest.raises(ModelError, match=message):
            Kalman(2).bandwidths(plan(noise=level))


@pytest.mark.parametrize("order", [-1, 3])
def test_an_order_that_is_none_is_refused(order):
    with pytest.raises(ModelError, match=rf"observer\.order {order}: allowed are 0, 1 \(a .*\) and 2 \(a line\)"):
        Kalman(order)


PLANT = {
    "name": "bare rig",
    "model": "setup",
    "sensors": {
        "s1": {"measures": "x1 - x3", "unit": "m"},
        "s2": {"measures": "x2 - x3", "unit": "m"},
        "s3": {"measures": "x3", "unit": "m"},
    },
    "limits": {"inputs": {name: {"max": 0.42, "unit": "V"} for name in ("u1", "u2", "u3")}},
}


def load(folder, *, observer="disturbance", rate="1 kHz", **parts):
    (folder / "rig.yaml").write_text(json.dumps({**PLANT, **parts}))
    run = {"name": "run", "plant": "rig.yaml", "virtual": "duffing", "duration": 1}
    run["controller"] = {"rate": rate, "observer": observer}
    (folder / "run.yaml").write_text(json.dumps(run))
    return Experiment.load(folder / "run.yaml")


def test_unknown_noise_is_refused_where_an_observer_needs_it(tmp_path):
    message = (
        r"bare rig: the noise of s1, s2, s3 is not known: declare an effect noise there in the plant file, or write "
        r"controller\.observer\.noise, in the sensors' units"
    )
    with pytest.raises(ModelError, match=message):
        load(tmp_path).validate()
    load(tmp_path, observer="differences").validate()
    found = load(tmp_path, observer={"kind": "disturbance", "noise": 5e-7})
    found.validate()
    np.testing.assert_array_equal(found.instruments.plan(1000.0, found.sampled.noise).noise, 5e-7)


def test_quantisation_counts_as_noise(tmp_path):
    """Rounding to a step has the standard deviation step / sqrt(12); what is switched off does not count."""
    effects = {
        "steps": {"effect": "quantisation", "at": ["s1", "s2", "s3"], "parameters": {"step": 3e-7}},
        "noise": {"effect": "noise", "at": ["s1"], "parameters": {"sigma": 4e-7}},
        "hum": {"effect": "noise", "at": ["s2"], "parameters": {"sigma": 1.0}, "enabled": False},
    }
    found = load(tmp_path, effects=effects).instruments.plan(1000.0, None).noise
    rounding = 3e-7 / math.sqrt(12.0)
    np.testing.assert_allclose(found, [math.hypot(rounding, 4e-7), rounding, rounding], rtol=1e-12)


def test_missing_limits_are_refused(tmp_path):
    limits = {"inputs": {"u1": {"max": 0.42, "unit": "V"}}}
    message = (
        r"bare rig: no largest command of u2, u3: write it under limits\.inputs, such as 'u2: \{max: 0\.42, unit: V\}'"
    )
    with pytest.raises(ModelError, match=message):
        load(tmp_path, observer={"kind": "disturbance", "noise": 5e-7}, limits=limits).validate()


@pytest.mark.parametrize(
    ("sensors", "have", "missed", "first"),
    [
        ({"s1": "x1 - x3", "s2": "x2 - x3"}, "s1, s2", "x1, x2, x3", "x1"),
        ({"s1": "x1", "s3": "x3"}, "s1, s3", "x2", "x2"),
        ({}, "none", "x1, x2, x3", "x1"),
    ],
)
def test_sensors_that_do_not_tell_a_coordinate_are_refused(tmp_path, sensors, have, missed, first):
    message = (
        rf"the sensors \({have}\) do not tell {missed} apart from the other coordinates; declare a sensor that "
        rf"measures {first}, or take 'observer: exact' in a simulation"
    )
    declared = {name: {"measures": text, "unit": "m"} for name, text in sensors.items()}
    with pytest.raises(ModelError, match=message):
        load(tmp_path, observer={"kind": "disturbance", "noise": 5e-7}, sensors=declared).validate()


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        (0, "must be a rate, not 0"),
        ("0 Hz", "the rate must be greater than 0 and finite, not 0"),
        ("-1 kHz", "the rate must be greater than 0 and finite, not -1"),
    ],
)
def test_a_rate_that_is_none_is_refused_with_its_place(tmp_path, rate, message):
    with pytest.raises(DeclarationError, match=rf"run\.yaml:1:\d+: controller\.rate: {message}"):
        load(tmp_path, rate=rate)
