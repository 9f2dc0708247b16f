"""Sampled controllers: hold, prediction, limits, homing and the compiled step, against numpy and closed forms.

The rig is the set-up without errors unless a test switches them on, so that what is seen is the controller's own.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import hypothesis
import numpy as np
import pytest
import sympy as sp
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg
from scipy.integrate import solve_ivp

from masking.compile.numerics import sampled_loop as sampling
from masking.compile.numerics.controller_sizes import Sizes
from masking.control.sampled_controller import SampledController
from masking.control.stepwise_controller import SampledStep
from masking.control.twin_loop import SampledLoop
from masking.errors import CommandError, ModelError, SingularityError
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import run_twin
from masking.model.declaration import catalogue, registry, schema
from tests.support.kernels import called

# The set-up in SI units (table B.1), the Duffing oscillators that it moves as (table 7.2), and their scales.
W, Z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
C, MU = np.array([20.9218, 23.2465, 1.2589]), np.array([0.0411, 0.0578])
LAMBDA = np.array([[C[0], 0, 0], [0, C[1], 0], [-MU[0] * C[0], -MU[1] * C[1], C[2]]])  # m/s**2/V
W3, TH, NU, Z3 = 0.5316, 1.0 / 3.0, 0.0495, 0.0409
LENGTH, OMEGA = 0.005, 18.3157
START = np.array([-0.6, -0.5, 0.0])
QUIET = {"noise": {"enabled": False}}


def duffing(eta, rate):
    """(7.5)-(7.7)."""
    d = eta[:2] - eta[2]
    force = d + TH * d**3
    return np.array([*-force, NU * force.sum() - W3**2 * eta[2] - 2 * Z3 * W3 * rate[2]])


def free(q, v):
    """Accelerations of the set-up without inputs, (4.4)-(4.6)."""
    force = W[:2] ** 2 * (q[:2] - q[2]) + 2 * Z[:2] * W[:2] * (v[:2] - v[2])
    return np.array([*-force, MU @ force - W[2] ** 2 * q[2] - 2 * Z[2] * W[2] * v[2]])


def wanted(q, v):
    return LENGTH * OMEGA**2 * duffing(q / LENGTH, v / (LENGTH * OMEGA))


@cache
def duffing_motion(eta, rate, end):
    return solve_ivp(
        lambda _, y: np.concatenate([y[3:], duffing(y[:3], y[3:])]),
        (0.0, end), [*eta, *rate], "DOP853", dense_output=True, rtol=1e-12, atol=1e-15,
    ).sol  # fmt: skip


def ideal(tau, eta=START, rate=(0.0, 0.0, 0.0)):
    """The Duffing oscillators by themselves, (m, 3)."""
    return duffing_motion(tuple(eta), tuple(rate), max(60.0, tau[-1]))(tau)[:3].T


def relative(found, reference):
    return float(np.linalg.norm(found - reference) / np.linalg.norm(reference))


def experiment(name="duffing", plant="linear_rig", *, controller=None, **changes):
    settings = {"rate": "1 kHz", "observer": {"kind": "disturbance", "noise": 1e-7}, **(controller or {})}
    return Experiment.load(name, plant=str(plant)).changed(controller=settings, record=None, **changes)


def run(found, seconds, *, sampled=None, every=1, seed=0):
    loop = SampledLoop(sampled, found.twin) if sampled else found.sampled_loop
    return run_twin(loop, loop.sampled.end, duration=seconds, seed=seed, every=every)


def chi(found):
    """Relative error of all coordinates together over a run."""
    return relative(found.states[:, :3] / LENGTH, ideal(found.times * OMEGA))


# Hold.


def input_accelerations(q, v):
    """Return the part of the wanted accelerations that the inputs must give."""
    return wanted(q, v) - free(q, v)


def without_delay(rate):
    return experiment(controller={"rate": f"{rate} Hz"}, effects={**QUIET, "delay": {"enabled": False}})


@cache
def quiet_run(rate):
    return run(without_delay(rate), 50.0 / OMEGA)


def test_held_output_errs_by_its_start_alone_to_second_order():
    """A rig under held inputs passes the samples of a smooth motion with other velocities than that motion.

    The difference is h^2/12 g' for inputs that accelerate by g. A rig that starts with the motion's own velocity
    therefore moves as the system that starts with a velocity larger by h^2/12 g', which is an error of second order;
    what is left against that system is of fourth order.
    """
    rates, plain, corrected = (500, 1000, 2000, 4000), [], []
    q, small = LENGTH * START, 1e-6
    a = wanted(q, np.zeros(3))
    slope = (input_accelerations(q, small * a) - input_accelerations(q, -small * a)) / (2 * small)
    for rate in rates:
        found = quiet_run(rate)
        tau, eta = found.times * OMEGA, found.states[:, :3] / LENGTH
        plain.append(relative(eta, ideal(tau)))
        corrected.append(relative(eta, ideal(tau, rate=slope / rate**2 / 12.0 / (LENGTH * OMEGA))))
    orders = np.log2(np.divide(plain[:-1], plain[1:])), np.log2(np.divide(corrected[:-1], corrected[1:]))
    np.testing.assert_allclose(orders[0], 2.0, atol=0.15)
    np.testing.assert_allclose(orders[1], 4.0, atol=0.1)
    assert plain[1] < 2e-5
    assert corrected[1] < 5e-8


def plain_hold(rate, seconds):
    """The law held without more, on the set-up stepped exactly, from its true state; (m, 3) in lengths."""
    jacobian = np.array([free(*np.split(x, 2)) for x in np.eye(6)]).T  # `free` is linear
    flow = np.zeros((9, 9))
    flow[:3, 3:6] = flow[3:6, 6:] = np.eye(3)
    flow[3:6, :6] = jacobian
    step = linalg.expm(flow / rate)
    x, states = np.concatenate([LENGTH * START, np.zeros(3)]), []
    for _ in range(int(seconds * rate) + 1):
        states.append(x[:3] / LENGTH)
        x = step[:6, :6] @ x + step[:6, 6:] @ input_accelerations(x[:3], x[3:])
    return np.array(states)


def test_held_output_is_a_thousand_times_truer_than_a_plain_one():
    plain = []
    for rate in (1000, 2000):
        found = plain_hold(rate, 50.0 / OMEGA)
        plain.append(relative(found, ideal(np.arange(len(found)) / rate * OMEGA)))
    assert np.log2(plain[0] / plain[1]) == pytest.approx(1.0, abs=0.1)
    assert chi(quiet_run(1000)) < 1e-3 * plain[0], plain


def test_internal_states_move_on_within_a_sample():
    """A hysteresis that the controller's model holds is cancelled as the rest is, to an error of second order.

    Held over a sample, its force would be late by half a sample, an error of first order.
    """
    found = []
    for rate in (1000, 2000):
        kept = {"hysteresis1", "hysteresis2", "hysteresis3", "delay"}
        effects = {name: name in kept for name in registry.load_plant("tue_rig").effects}
        made = experiment(plant="tue_rig", controller={"rate": f"{rate} Hz"}, effects=effects)
        declared = made.twin.attached
        switches = {n: p for n, p in declared.parameters.items() if n.endswith("_on")}
        values = {n: p.model_copy(update={"value": made.plant.value(n)}) for n, p in switches.items()}
        known = declared.model_copy(update={"parameters": {**declared.parameters, **values}})
        found.append(chi(run(Experiment(replace(made.assembly, controller_model=known)), 50.0 / OMEGA)))
    assert found[0] < 2e-5
    assert np.log2(found[0] / found[1]) == pytest.approx(2.0, abs=0.2)


# Delay.


@pytest.mark.parametrize("samples", [0, 1, 2, 3, 5])
def test_prediction_makes_up_for_delay(samples):
    found = experiment(effects={**QUIET, "delay": {"parameters": {"samples": samples}}})
    assert (found.twin.delay, found.sampled.delay) == (samples, samples)
    true = chi(run(found, 50.0 / OMEGA))
    assert true < 2e-5
    if samples:
        unaware = replace(found.sampled, instruments=replace(found.instruments, delay=0))
        assert chi(run(found, 50.0 / OMEGA, sampled=unaware)) > 100 * true


# Limits.


@cache
def limiter():
    return called(sampling.limiter(Sizes(1, 2, 1, 2, 0)))


finite = st.floats(-1e3, 1e3)
limits = st.fixed_dictionaries(
    {
        "largest": st.floats(1e-3, 10.0),
        "heating": st.just(0.0) | st.floats(1e-3, 100.0),
        "power": st.floats(1e-3, 100.0),
    }
)


@hypothesis.settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(finite, finite), min_size=1, max_size=30),
    st.tuples(limits, limits),
    st.floats(1e-4, 0.5),
    st.floats(1.0, 20.0),
)
def test_no_command_exceeds_its_limits_and_none_is_cut_needlessly(demands, rows, h, time):
    table = np.array([[row["largest"], row["heating"], row["power"], time] for row in rows])
    power, applied, reckoned, limit = np.zeros(2), np.empty(2), np.zeros(2), limiter()
    largest, heating, most = table[:, 0], table[:, 1], table[:, 2]
    for demanded in np.array(demands):
        limit(demanded, table, power, h, applied)
        # The mean power, P' = (r c^2 - P) / T, solved over h.
        kept = np.exp(-h / time)
        after = kept * reckoned + (1 - kept) * heating * applied**2
        heats = np.maximum((1 - kept) * heating, 1e-300)  # 0 where nothing heats: no bound
        bound = np.minimum(largest, np.sqrt((most - kept * reckoned) / heats))
        np.testing.assert_allclose(applied, np.clip(demanded, -bound, bound), rtol=1e-9)
        np.testing.assert_allclose(power, after, rtol=1e-9, atol=1e-12)
        assert (np.abs(applied) <= largest).all()
        assert (power <= most * (1 + 1e-12)).all()
        reckoned = after


def weak(folder, largest, heating):
    """Return the packaged rig with other limits."""
    (file,) = registry.load_plant("linear_rig").files
    text = Path(file).read_text()
    for old, new in (
        ("max: 0.42", f"max: {largest}"),
        ("value: 45.35, unit: W/V**2}", f"value: {heating}, unit: W/V**2}}, time: 1"),
    ):
        assert old in text
        text = text.replace(old, new)
    path = folder / "weak.yaml"
    path.write_text(text)
    return path


def test_nothing_winds_up_in_saturation(tmp_path):
    """A demand far beyond the limits: what is applied moves the model, so the estimate stays right throughout."""
    plant = weak(tmp_path, largest=0.012, heating=0.01)
    settings = {"observer": {"kind": "disturbance", "noise": 1e-7, "bandwidth": 250}}
    found = experiment(plant=plant, controller=settings, effects=QUIET, initial={"x1": -1.5, "x2": -1.2})
    made = run(found, 10.0)
    cut = np.abs(made.demanded - made.applied) > 1e-12
    last = np.flatnonzero(cut.any(axis=1)).max()
    assert cut.any(axis=1).mean() > 0.02
    assert np.abs(made.demanded).max() > 2.0 * 0.012
    assert np.abs(made.applied).max() <= 0.012
    assert last < 0.8 * len(made.times)
    error = np.abs(made.estimates - made.states)
    assert error[:, :3].max() < 1e-9 * LENGTH * 1e3, error[:, :3].max()
    assert error[:, 3:].max() < 1e-9 * LENGTH * OMEGA * 1e3, error[:, 3:].max()


def test_mean_power_stays_within_its_limit(tmp_path):
    """8 W where 0.42 V would be 200 W: the limit binds, and the mean power never passes it."""
    found = experiment(plant=weak(tmp_path, largest=0.42, heating=8 / 0.03**2), effects=QUIET, initial={"x1": -1.5})
    made = run(found, 10.0)
    assert (np.abs(made.demanded - made.applied) > 1e-9).any()
    assert made.power.max() <= 8.0 * (1 + 1e-12)
    assert made.power.max() > 7.9
    kept = np.exp(-1e-3)  # P' = (r c^2 - P) / (1 s), solved over a sample
    heated = kept * made.power[:-1] + (1.0 - kept) * 8 / 0.03**2 * made.applied[1:] ** 2
    np.testing.assert_allclose(made.power[1:], heated, rtol=1e-12)


# The compiled step, and a loop written out in Python around it.


def step_by_hand(readings, memory, sampled, h, delay):
    """One step of the controller in numpy; returns the memory, demanded and applied commands (V)."""
    gain, table = sampled.gain, sampled.limits
    size, m = 12, 3
    z, power, queue = memory[size + 3 : 2 * size + 3].copy(), memory[size : size + 3].copy(), memory[2 * size + 3 :]
    queue = queue.reshape(delay, m)

    def rate(y, u):
        return np.concatenate([y[3:6], free(y[:3], y[3:6]) + LAMBDA @ u])

    def predicted(z, u):
        d = z[6:9] + 0.5 * h * z[9:12]
        y, push = z[:6], np.concatenate([np.zeros(3), d])
        k1 = rate(y, u) + push
        k2 = rate(y + 0.5 * h * k1, u) + push
        k3 = rate(y + 0.5 * h * k2, u) + push
        k4 = rate(y + h * k3, u) + push
        return np.concatenate([y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), z[6:9] + h * z[9:12], z[9:12]])

    expected = 200.0 * np.array([z[0] - z[2], z[1] - z[2], z[2]])
    z = z + gain @ (readings - expected)
    now = z.copy()
    ahead = z.copy()
    for u in queue:
        ahead = predicted(ahead, u)
    q, v, d, slope = np.split(ahead, 4)

    def inputs(q, v, late):
        return np.linalg.solve(LAMBDA, wanted(q, v) - free(q, v) - d - late * slope)

    r0 = wanted(q, v)
    g0 = LAMBDA @ inputs(q, v, 0.0)
    g2 = LAMBDA @ inputs(q + h * v + 0.5 * h**2 * r0, v + h * r0, h)
    v = v + h / 12 * (g2 - g0)
    # The accelerations r0 on the way that is wanted, with r2 those at its end as first taken.
    r2 = wanted(q + h * ahead[3:6] + 0.5 * h**2 * r0, ahead[3:6] + h * r0)
    r0 = wanted(q, v)
    u0 = inputs(q, v, 0.0)
    middle = q + 0.5 * h * v + h**2 / 48 * (5 * r0 + r2), v + h / 8 * (3 * r0 + r2)
    u1, r1 = inputs(*middle, 0.5 * h), wanted(*middle)
    end = q + h * v + h**2 / 6 * (r0 + 2 * r1), v + h * r1
    u2, r2 = inputs(*end, h), wanted(*end)
    # The middle again, its velocity by all three accelerations.
    more = ahead[3:6] + h / 12 * LAMBDA @ (4 * u1 - 3 * u0 - u2) - v
    middle = q + 0.5 * h * v + h**2 / 48 * (5 * r0 + r2), v + 0.75 * more + h / 16 * (3 * r0 + 6 * r1 - r2)
    u1 = inputs(*middle, 0.5 * h)
    u = 4 / 3 * u1 - (u0 + u2) / 6
    demanded = u
    largest, heating, limit, time = table.T
    kept = np.exp(-h / time)
    free_power = np.maximum(0.0, limit - kept * power)
    most = np.minimum(largest, np.sqrt(free_power / ((1 - kept) * heating)))
    applied = np.clip(demanded, -most, most)
    power = kept * power + (1 - kept) * heating * applied**2
    queue = np.vstack([queue, applied])
    onward = predicted(now, queue[0])
    return np.concatenate([now, power, onward, queue[1:].ravel()]), demanded, applied


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_compiled_step_is_that_of_numpy(delay):
    found = experiment(effects={"delay": {"parameters": {"samples": delay}}})
    sampled, generator = found.sampled, np.random.default_rng(delay)
    step = SampledStep(sampled)
    step.reset(np.zeros(3))
    h = 1e-3
    limited = 0
    for index in range(40):
        scale = np.concatenate(
            [np.full(3, LENGTH), np.full(3, LENGTH * OMEGA), np.full(3, 0.1), np.full(3, 1.0)]
        ) * 10.0 ** generator.uniform(-2, 0.7)
        x = np.concatenate([
            scale * generator.normal(size=12), generator.uniform(0, 7.9, 3), scale * generator.normal(size=12),
            0.2 * generator.normal(size=3 * delay),
        ])  # fmt: skip
        z = x[15:18]
        readings = 200.0 * np.array([z[0] - z[2], z[1] - z[2], z[2]]) + 10.0 ** generator.uniform(-8, -4, 3)
        expected, demanded, applied = step_by_hand(readings, x, sampled, h, delay)
        step.state[:] = x
        given_out = step(readings, index)
        for a, b in ((step.state, expected), (step.demanded, demanded), (given_out, applied)):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())
        limited += (np.abs(demanded) > np.abs(applied)).any()
    assert 0 < limited < 40


def by_python(found, seconds, *, start, seed):
    """Run a sampled controller around a twin in Python, from before the release; rows from the first sample on."""
    sampled, twin, rate = found.sampled, found.twin, found.sampled.rate
    generator, p = np.random.default_rng(seed), found.twin.values()
    before = round(sampled.homing * rate) + sampled.delay
    y, readings, substeps = twin.rest(start), np.empty(3), twin.substeps(rate)
    noise = generator.standard_normal((before + int(seconds * rate * (1 + 1e-12)) + 1, 3))
    twin.kernels.sense(-before / rate, y, p, noise[0], readings)
    step = SampledStep(sampled)
    step.reset(readings)
    under_way = [step.applied.copy() for _ in range(twin.delay)]
    rows = {name: [] for name in ("state", "estimate", "reading", "demanded", "applied")}
    for index, xi in enumerate(noise, start=-before):
        twin.kernels.sense(index / rate, y, p, xi, readings)
        applied = step(readings, index).copy()
        parts = (y, step.estimate, readings, step.demanded, applied)
        for column, value in zip(rows.values(), parts, strict=True):
            column.append(value.copy())
        under_way.append(applied)
        twin.kernels.advance(index / rate, y, under_way.pop(0), p, 1 / rate, substeps)
    return before, {name: np.array(column) for name, column in rows.items()}


def test_compiled_loop_is_that_of_python():
    found = experiment(effects={"delay": {"parameters": {"samples": 2}}})
    made = run(found, 2.0, seed=5)
    before, rows = by_python(found, 2.0, start=found.sampled.end, seed=5)
    pairs = (
        (rows["state"], made.states), (rows["estimate"], made.estimates), (rows["reading"], made.readings),
        (rows["demanded"], made.demanded), (rows["applied"], made.applied),
    )  # fmt: skip
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours[before:], theirs, rtol=1e-12, atol=1e-13 * np.abs(theirs).max())


@pytest.mark.parametrize("plant", ["linear_rig", "tue_rig"])
def test_the_compiled_step_gets_the_declared_allocation_and_its_inverse(plant):
    written = yaml.safe_load(catalogue.files("plant")[plant].read_text())
    rows = sp.Matrix([sp.sympify(written["allocation"][name]) for name in ("u1", "u2", "u3")])
    declared = np.array(rows.jacobian(sp.symbols(["V1", "V2", "V3"])), dtype=float)
    found = experiment(plant=plant)
    sampled = SampledController(found.law, found.instruments, found.observer, 1000.0, None, 0.0, np.zeros(3))
    inverse, matrix = sampled.values()[-18:].reshape(2, 3, 3)
    np.testing.assert_allclose(inverse, np.linalg.inv(declared), atol=1e-12)
    np.testing.assert_allclose(matrix, declared, atol=1e-12)


def test_commands_that_are_not_finite_are_refused():
    step = SampledStep(experiment().sampled)
    step.reset(np.zeros(3))
    with pytest.raises(CommandError, match=r"the controller's command of V1, V2, V3 is no longer finite, at sample 7"):
        step(np.array([np.nan, 0.0, 0.0]), 7)


def test_a_model_with_other_coordinates_is_refused(tmp_path):
    (tmp_path / "other.yaml").write_text("{name: other, coordinates: {y: ''}, inputs: {f: ''}, equations: {y'': f}}")
    twin = experiment().twin
    other = replace(twin, base=registry.load_model(tmp_path / "other.yaml"), declaration=OTHER)
    with pytest.raises(ModelError, match=r"has the inputs u1, u2, u3, the plant other has f; both must have the"):
        SampledLoop(experiment().sampled, other)


OTHER = schema.PlantDeclaration.model_validate({"name": "other rig", "model": "other"})


# Homing, by a rig that moves at another pace through a transform that is not linear.


PACE = 1.25 / OMEGA  # seconds per unit of virtual time
BENT = {"x1": "x1 + 0.2*x1**2", "x2": "sinh(x2)", "x3": "x3 + 0.1*x1*x2"}
# The rig's coordinates, in lengths, at which these are -0.6, -0.5 and 0.
FIRST = (-1.0 + np.sqrt(1.0 - 0.8 * 0.6)) / 0.4
BENT_START = np.array([FIRST, np.arcsinh(-0.5), 0.1 * FIRST * np.arcsinh(0.5)])


def bent(q):
    x = q.T / LENGTH
    return np.array([x[0] + 0.2 * x[0] ** 2, np.sinh(x[1]), x[2] + 0.1 * x[0] * x[1]]).T


@pytest.fixture(scope="module")
def approached():
    made = {}
    transform = {"expressions": BENT}
    for name, effects, noise in (("quiet", QUIET, 1e-7), ("noisy", {}, 1e-4)):
        found = experiment(
            controller={"homing": 3.0, "observer": {"kind": "disturbance", "noise": noise}},
            effects=effects, transform=transform, time_scale=PACE,
        )  # fmt: skip
        made[name] = by_python(found, 4.0, start=np.zeros(3), seed=1)
    return made


@pytest.mark.parametrize(("kind", "near"), [("quiet", 1e-6), ("noisy", 1e-2)])
def test_homing_brings_the_rig_to_its_initial_state(approached, kind, near):
    before, rows = approached[kind]
    assert before == 3001
    np.testing.assert_allclose(rows["state"][before - 1, :3] / LENGTH, BENT_START, rtol=0, atol=near)
    np.testing.assert_allclose(rows["state"][before - 1, 3:] / (LENGTH * OMEGA), 0.0, atol=near)
    # It waits there at the end, so that a command that is late finds it where it was.
    np.testing.assert_allclose(rows["state"][before - 100 : before, :3] / LENGTH, [BENT_START] * 100, atol=near)


def test_homing_begins_and_goes_on_without_a_jump(approached):
    before, rows = approached["quiet"]
    jumps = np.abs(np.diff(rows["demanded"][: before - 1], axis=0, prepend=0.0)) / 0.42
    assert jumps.max() < 2e-3
    noisy = rows["demanded"], approached["noisy"][1]["demanded"]
    assert (
        np.abs(noisy[0][: before - 1] - noisy[1][: before - 1]).max() / 0.42 < 7 * 0.02
    )  # seven deviations of the rule's 2 %
    # At the release, inputs that held the rig let it go: J c du is the wanted acceleration (T is bent: J = dT/dx).
    jacobian = np.diag([1 + 0.4 * BENT_START[0], np.cosh(BENT_START[1]), 1.0])
    jacobian[2, :2] = 0.1 * BENT_START[1::-1]
    step = rows["demanded"][before - 1] - rows["demanded"][before - 2]
    c_step = LAMBDA @ step
    np.testing.assert_allclose(jacobian @ c_step * PACE**2 / LENGTH, duffing(START, np.zeros(3)), rtol=0, atol=0.01)


def test_observer_has_no_transient_at_the_release(approached):
    for kind in ("quiet", "noisy"):
        before, rows = approached[kind]
        error = np.abs(rows["estimate"] - rows["state"])
        settled, released = (
            error[before - 1500 : before - 100].max(axis=0),
            error[before - 5 : before + 500].max(axis=0),
        )
        floor = 1e-8 * np.array([LENGTH] * 3 + [LENGTH * OMEGA] * 3)
        assert (released <= 1.5 * settled + floor).all(), (kind, settled, released)


def test_bent_transform_at_another_pace_is_followed(approached):
    before, rows = approached["quiet"]
    release = before
    eta = bent(rows["state"][release:, :3])
    tau = np.arange(len(eta)) * 1e-3 / PACE
    assert relative(eta, ideal(tau)) < 3e-5
    eta = bent(approached["noisy"][1]["state"][release:, :3])
    assert relative(eta, ideal(tau)) < 5e-3


# Regulation.


def energy(eta, rate):
    d = eta[:, :2] - eta[:, 2:]
    own = rate[:, :2] ** 2 / 2 + d**2 / 2 + TH * d**4 / 4
    return NU * own.sum(axis=1) + rate[:, 2] ** 2 / 2 + W3**2 * eta[:, 2] ** 2 / 2


REGULATED = {"energy": 0.02, "rate": 0.1, "coupling": 0.1}


@pytest.mark.parametrize("level", [0.01, 0.04])
def test_regulation_holds_an_energy_in_anti_phase(level):
    """Friction would stop the rig; the beam's damping takes what is not in anti-phase."""
    found = experiment(controller={"regulate": {**REGULATED, "energy": level, "phase": "anti"}})
    made = run(found, 400.0 / OMEGA)
    last = made.times > 200.0 / OMEGA
    eta, rate = made.states[last, :3] / LENGTH, made.states[last, 3:6] / (LENGTH * OMEGA)
    np.testing.assert_allclose(energy(eta, rate), level, rtol=0.03)
    together, apart = (np.linalg.norm(eta[:, 0] + sign * eta[:, 1]) for sign in (1, -1))
    assert together < 0.01 * apart


def test_regulation_holds_an_energy_in_phase():
    """The wanted accelerations of the compiled law alone, integrated: in phase, the beam moves, and is driven."""
    found = experiment(controller={"regulate": {**REGULATED, "phase": "in"}})
    law, p = found.sampled.kernels.law, found.sampled.values()
    d, u, r, g = np.zeros(3), np.empty(3), np.empty(3), np.empty(3)

    def slope(y):
        law(0.0, 0.0, y, d, p, u, r, g)
        return np.concatenate([y[3:], r])

    y, h, states = np.concatenate([LENGTH * np.array([-0.6, 0.3, 0.0]), np.zeros(3)]), 0.1 / OMEGA, []
    for _ in range(6000):
        k1 = slope(y)
        k2 = slope(y + 0.5 * h * k1)
        k3 = slope(y + 0.5 * h * k2)
        y = y + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + slope(y + h * k3))
        states.append(y)
    last = np.array(states)[-1000:] / LENGTH
    together, apart = (np.linalg.norm(last[:, 0] + sign * last[:, 1]) for sign in (1, -1))
    assert apart < 0.01 * together
    held = energy(last[:, :3], last[:, 3:] / OMEGA)
    assert held.std() / held.mean() < 0.2
    assert held.mean() == pytest.approx(0.02, rel=0.3)


# Refusals.


def test_a_rate_too_low_for_the_rig_is_refused_with_one_that_does():
    """The fastest free motion of the set-up: 14.7 rad/s, that of oscillator 2 against the beam."""
    jacobian = np.array([free(*np.split(x, 2)) for x in np.eye(6)]).T
    fastest = np.abs(np.linalg.eigvals(np.vstack([np.eye(6)[3:], jacobian]))).max()
    remedy = (
        rf"controller.rate 5 Hz is too low for this rig: .* give at least {fastest:.3g} Hz, better ten times as much"
    )
    with pytest.raises(ModelError, match=remedy):
        experiment(controller={"rate": "5 Hz"}).validate()
    experiment(controller={"rate": f"{1.01 * fastest} Hz"}).validate()


def test_a_transform_that_becomes_singular_on_the_way_stops_the_run_with_the_state():
    folded = {"expressions": {"x1": "x1**2", "x2": "x2", "x3": "x3"}}
    with pytest.raises(SingularityError, match="choose a transform that is invertible") as error:
        run(experiment(transform=folded, initial={"x1": 0.3}), 1.0)
    assert abs(error.value.state["x1"]) < 0.1 * LENGTH
    assert set(error.value.state) >= {"x1", "x2", "x3", "x1'", "x2'", "x3'"}


@pytest.mark.parametrize("homing", [None, 2.0])
def test_a_moving_initial_state_is_refused_where_readings_are_all_that_is_known(homing):
    controller = {"rate": "1 kHz", "observer": "disturbance"} | ({} if homing is None else {"homing": homing})
    changed = Experiment.load("duffing", plant="tue_rig").changed(controller=controller, initial={"x1'": 0.01})
    with pytest.raises(
        ModelError, match="begins with a rig at rest, but the initial state moves: give no initial velo"
    ):
        changed.validate()


@pytest.mark.parametrize(("times", "level"), [(0.5, 0), (1.0, 0), (1.9, 1), (8.0, 3), (1000.0, 6)])
@pytest.mark.parametrize("drift", [0.0, 0.3])
def test_noise_and_offset_are_measured_at_rest(times, level, drift):
    """Of 4000 readings that are drawn, with seven levels of noise, each twice the one before, and a known drift."""
    kernel = called(sampling.stand_still(Sizes(1, 2, 1, 1, 2, offsets=2)))
    deviation, expected = np.array([0.01, 2.0]), np.array([1.0, -3.0])
    readings = np.random.default_rng(0).normal([1.2, 7.0], deviation * [times, 0.5], (4000, 2))
    sensors = ([e, d**-2, 0, 0, -1] for e, d in zip(expected, deviation, strict=True))
    standing = np.concatenate([[4.0, 0.002, 0.0], *sensors])
    for i, reading in enumerate(readings):
        shift = drift * np.array([1e-3 * i, 0.0])
        seen = expected + shift
        found = kernel(1e-3 * i, reading + shift, standing, seen, expected, 7)
    assert found == level
    np.testing.assert_allclose(standing[5::5], [0.2, 10.0], atol=0.1 * max(0.01 * times, 1.0))
    np.testing.assert_allclose(standing[7::5], [times**2, 0.25], rtol=0.2)
    np.testing.assert_allclose(seen, expected + shift + standing[5::5])
    assert kernel(5.0, readings[0] + 99.0, standing, expected.copy(), expected, 7) == level, "measured at rest alone"
