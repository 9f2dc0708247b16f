"""Masking: blocks L, D, G, T and the closed loop, on rigs of every kind.

The measure is chi = ||virtual - ideal|| / ||ideal|| per coordinate. In continuous time, on a rig that is what its model
says, the law is exact; 1e-6 leaves room for integration errors only.
"""

import re

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from masking.analysis.masking_error import masking_error
from masking.errors import ActuationError, SingularityError
from masking.lab.runs import simulated_run
from masking.lab.runs.experiment import Experiment
from masking.lab.runs.simulated_run import continuous_chunks, joined, rig_state, sampled_chunks
from masking.model.declaration import catalogue, registry
from masking.model.declaration.schema import ObserverSettings, Transform

EXACT = 1e-6
# What a volt of each actuator adds to x1'', x2'', x3'' (m/s**2/V): Table B.1, and Newton's third law between the
# oscillators and the beam.
LAMBDA = np.array([[20.9218, 0, 0], [0, 23.2465, 0], [-0.0411 * 20.9218, -0.0578 * 23.2465, 1.2589]])


def experiment(name, plant=None, **changes):
    """A packaged experiment with some of its settings replaced."""
    declaration = registry.load_experiment(name).model_copy(update=changes)
    return Experiment(registry.assemble(declaration, None if plant is None else str(plant)))


def chi(found):
    return found.run().manifest["masking_error"]


def assert_exact(found):
    for coordinate, value in chi(found).items():
        assert value <= EXACT, coordinate


def write(folder, **texts):
    """Write YAML texts by the names of their files, and load the experiment `run`."""
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)
    return Experiment.load(folder / "run.yaml")


# Every virtual system of the registry, over the length of its figure.

# Systems in another form: the experiment of the same system, the values with which they are that system, and a plant.
ANOTHER_FORM = {
    "duffing_si": ("duffing", {"w3": 0.5316 * 18.3157, "beta": 18.3157**2 / 0.005**2 / 3}, "setup_springs"),
    "huygens_lagrangian": ("huygens", {}, "setup_lagrangian"),
}
# What these have beside another system is 0 as declared.
DAMPING = {"e1": 0.002, "e2": 0.001}
DRIVEN = {
    "discs_driven": ("discs_eccentric", DAMPING),
    "duffing_driven": ("duffing", DAMPING),
    "setup_driven": ("setup_undamped", DAMPING),
    "setup_controlled": ("setup_identical", {"spring": 0.1, "of_sum": 0.05, "r": 0.02}),
}
ALONE = {
    "setup_oscillator",
    "van_der_pol",
    "cart",
    "cart_pendulum",
    "light_cart",
    "two_masses",
    "bouncing_ball",
    "stopped_mass",
    "relaxing_mass",
    "bristled_mass",
    "building",
    "cart_by_voltage",
    "magnet",
    "storey",
}  # no systems of the rig's three coordinates
VIRTUAL = [
    name
    for name in catalogue.names("model")
    if all(c.initial is not None for c in registry.load_model(name).coordinates.values())
    and name not in {*ANOTHER_FORM, *DRIVEN, *ALONE}
]


@pytest.mark.parametrize("name", VIRTUAL)
def test_ideal_rig_moves_as_each_virtual_system(name):
    assert_exact(experiment(name))


@pytest.mark.parametrize("name", DRIVEN)
def test_ideal_rig_moves_as_each_driven_system(name):
    other, values = DRIVEN[name]
    assert_exact(experiment(other, virtual=name, parameters=values))


@pytest.mark.parametrize("name", ANOTHER_FORM)
def test_other_plants_move_as_the_same_system_in_another_form(tmp_path, name):
    other, values, model = ANOTHER_FORM[name]
    plant = tmp_path / "rig.yaml"
    plant.write_text(f"name: rig\nmodel: {model}\n")
    reference = experiment(other).run()
    # Without scales, the rig's coordinates enter in metres; the virtual system's unit is 5 mm.
    unit = 1 if registry.load_model(model).scales else 200
    angle = unit * np.pi / 4 if other == "huygens" else unit
    diagonal = Transform.model_validate(
        {"matrix": [["k", 0, 0], [0, "k", 0], [0, 0, "l"]], "parameters": {"k": angle, "l": unit}}
    )
    found = experiment(other, plant, virtual=name, parameters=values, transform=diagonal)
    state = rig_state(found.loop, found.virtual.initial_state({}))
    times = found.time_scale * reference.t / experiment(other).time_scale
    chunks = continuous_chunks(found.loop, state, len(times), lambda i, j: times[i:j], tolerance=1e-10)
    run = joined(chunks)
    for i, coordinate in enumerate(found.virtual.coordinates):
        assert masking_error(run.virtual[:, i], reference[f"ideal.{coordinate}"]) <= EXACT


# The duffing oscillators on a rig in other coordinates, and at another pace.


RELATIVE = """
name: the rig in the coordinates that its sensors measure, (A.1), with a fourth actuator between the oscillators
coordinates: {q1: {unit: m}, q2: {unit: m}, q3: {unit: m}}
inputs: {u1: {unit: V}, u2: {unit: V}, u3: {unit: V}, u4: {unit: V}}
parameters:
  m1: {value: 0.0411, unit: kg}
  m2: {value: 0.0578, unit: kg}
  m3: {value: 1, unit: kg}
  k1: {value: 6.47552, unit: N/m}
  k2: {value: 11.383406, unit: N/m}
  k3: {value: 94.80722, unit: N/m}
  b: {value: 0.5, unit: N*s/m}
  kv: {value: 1.2589, unit: N/V}
lagrangian: >-
  (m1*(q1' + q3')**2 + m2*(q2' + q3')**2 + m3*q3'**2)/2 - (k1*q1**2 + k2*q2**2 + k3*q3**2)/2
dissipation: b*(q1'**2 + q2'**2 + q3'**2)/2
forces: {q1: kv*u1 + kv*u4, q2: kv*u2 - kv*u4, q3: kv*u3}
scales:
  time: {value: 1, unit: s}
  length: {value: 5, unit: mm}
  mass: {value: 1, unit: kg}
  voltage: {value: 1, unit: V}
"""


@pytest.fixture
def relative(tmp_path):
    return write(
        tmp_path,
        relative=RELATIVE,
        rig="{name: rig, model: relative.yaml}",
        run="""
            name: x = T q with the T of (A.1)
            plant: rig.yaml
            virtual: duffing
            transform: {matrix: [[1, 0, 1], [0, 1, 1], [0, 0, 1]]}
            duration: 2500
        """,
    )


def test_transform_by_a_matrix_that_is_not_diagonal(relative):
    assert_exact(relative)


def test_more_inputs_than_coordinates_share_by_least_norm(relative):
    run = relative.run()
    inputs = np.array([run[f"input.{name}"] for name in ("u1", "u2", "u3", "u4")])
    gains = block(relative.loop, "input_matrix", np.zeros(6), size=12).reshape(3, 4)
    # The least-norm solution has no part in the null space: pinv(B) B u = u.
    np.testing.assert_allclose(np.linalg.pinv(gains) @ gains @ inputs, inputs, atol=1e-12 * np.abs(inputs).max())
    assert np.abs(inputs).max(axis=1).min() > 0.0


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_another_pace(factor):
    base = experiment("duffing")
    found = experiment("duffing", time_scale=factor * base.time_scale)
    assert_exact(found)
    assert found.run()["t"][-1] == pytest.approx(factor * 2500 / 18.3157, rel=1e-12)


@hypothesis.settings(max_examples=10, deadline=None)
@given(
    st.fixed_dictionaries({name: st.floats(0.2, 3.0) for name in ("w1", "w2", "w3", "th1", "th2")}),
    # Light, damped coupling: heavy undamped oscillators are chaotic, and any error grows with time.
    st.fixed_dictionaries({"mu1": st.floats(0.0, 0.1), "mu2": st.floats(0.0, 0.1), "z3": st.floats(0.02, 1.0)}),
    st.fixed_dictionaries({name: st.floats(-1.0, 1.0) for name in ("x1", "x2", "x3", "x1'", "x2'", "x3'")}),
)
def test_any_duffing_oscillators_from_any_state_without_compiling_again(stiffness, other, initial):
    found = experiment("duffing", parameters={**stiffness, **other}, initial=initial, duration=50.0)
    assert found.loop.kernels.generated.path == experiment("duffing").loop.kernels.generated.path
    run = found.run()
    largest = max(np.abs(run[f"ideal.{c}"]).max() for c in ("x1", "x2", "x3"))
    for c in ("x1", "x2", "x3"):  # the error against the largest coordinate: a coordinate may stay near zero
        assert np.abs(run[f"virtual.{c}"] - run[f"ideal.{c}"]).max() <= EXACT * largest


# A controller that samples.


EXACT_STATE = ObserverSettings(kind="exact")


def sampled(rate, **changes):
    settings = registry.load_experiment("duffing").controller.model_copy(update={"rate": rate, "observer": EXACT_STATE})
    return experiment("duffing", controller=settings, **changes)


def test_sampled_chi_falls_with_the_rate_at_first_order():
    found = [chi(sampled(rate, duration=50.0))["x1"] for rate in (4e3, 8e3, 16e3, 32e3)]
    order = np.log2(np.divide(found[:-1], found[1:]))
    np.testing.assert_allclose(order, 1.0, atol=0.1)
    assert found[-1] < 0.01


def test_sampled_run_equals_one_written_out_in_numpy(monkeypatch):
    """(4.4)-(4.6), (6.1)-(6.3) and (7.5)-(7.7) in SI units by hand, integrated by scipy between the samples."""
    rate, steps = 200.0, 100
    w, z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
    mu = np.array([0.0411, 0.0578])
    length, omega, th, w3 = 0.005, 18.3157, 1 / 3, 0.5316

    def plant(y, u):
        x, v = y[:3], y[3:]
        force = w[:2] ** 2 * (x[:2] - x[2]) + 2 * z[:2] * w[:2] * (v[:2] - v[2])
        beam = mu @ force - w[2] ** 2 * x[2] - 2 * z[2] * w[2] * v[2]
        return np.concatenate([v, np.append(-force, beam) + LAMBDA @ u])

    def wanted(y):
        x, v = y[:3] / length, y[3:] / (length * omega)
        force = x[:2] - x[2] + th * (x[:2] - x[2]) ** 3
        beam = 0.0495 * force.sum() - w3**2 * x[2] - 2 * 0.0409 * w3 * v[2]
        return np.append(-force, beam) * length * omega**2

    y = np.array([-0.003, -0.0025, 0.0, 0.0, 0.0, 0.0])
    states, inputs = [], []
    for _ in range(steps + 1):
        u = np.linalg.solve(LAMBDA, wanted(y) - plant(y, np.zeros(3))[3:])
        states.append(y)
        inputs.append(u)
        y = solve_ivp(lambda _, y, u=u: plant(y, u), (0, 1 / rate), y, "DOP853", rtol=1e-12, atol=1e-16).y[:, -1]
    loop = experiment("duffing").loop
    monkeypatch.setattr(simulated_run, "_substeps", lambda *_: 10)
    run = joined(sampled_chunks(loop, states[0], rate=rate, duration=steps / rate))
    largest = np.abs(states).max(axis=0)
    np.testing.assert_allclose(run.rig / largest, states / largest, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.inputs, inputs, rtol=0, atol=1e-9 * np.abs(inputs).max())


def test_slow_sampling_still_integrates_the_plant_finely(monkeypatch):
    slow = sampled(200.0, duration=20.0)
    state = rig_state(slow.loop, slow.virtual.initial_state({}))
    run = joined(sampled_chunks(slow.loop, state, rate=200.0, duration=1.0)).rig
    monkeypatch.setattr(simulated_run, "_substeps", lambda *_: 100)
    finer = joined(sampled_chunks(slow.loop, state, rate=200.0, duration=1.0)).rig
    np.testing.assert_allclose(run, finer, rtol=0, atol=1e-7 * np.abs(finer).max())


# Each block alone.


@pytest.fixture(scope="module")
def identical():
    """The rig's own model with other parameters as the virtual system: all formulas of chapter 6 in one place."""
    return experiment("setup_identical")


@pytest.fixture(params=range(5))
def state(request):
    return np.random.default_rng(request.param).uniform(-1.0, 1.0, 6) * np.repeat([0.005, 0.05], 3)


def block(loop, name, state, size=3):
    out = np.empty(size)
    getattr(loop.kernels, name)(0.0, state[:3], state[3:], loop.values(), out)
    return out


def test_cancellation_solves_for_the_input_that_leaves_no_acceleration(identical, state):
    """(6.1): L = -Lambda^-1 f(xi, xi', 0); written out for the set-up."""
    w, z = np.array([12.5521, 14.0337, 9.7369]), np.array([0.3362, 0.4296, 0.0409])
    x, v = state[:3], state[3:]
    force = w[:2] ** 2 * (x[:2] - x[2]) + 2 * z[:2] * w[:2] * (v[:2] - v[2])
    free = np.append(-force, [0.0411, 0.0578] @ force - w[2] ** 2 * x[2] - 2 * z[2] * w[2] * v[2])
    by_hand = -np.linalg.solve(LAMBDA, free)
    np.testing.assert_allclose(block(identical.loop, "cancel", state), by_hand, rtol=1e-12, atol=1e-15)


def test_gain_is_the_inverse_of_lambda(identical, state):
    """(6.3): G = Lambda^-1, with the corrected lam = nu c / (l wbar^2) in the rig's scales."""
    drive, desired = block(identical.loop, "drive", state), block(identical.loop, "desired", state)
    scaled = np.array([[9.945, 0, 0], [0, 11.05, 0], [-0.0411 * 9.945, -0.0578 * 11.05, 0.5984]])
    np.testing.assert_allclose(desired, scaled @ drive / 0.42, rtol=2e-4)
    gains = block(identical.loop, "input_matrix", state, size=9).reshape(3, 3)
    np.testing.assert_allclose(gains, LAMBDA, rtol=1e-15)


def test_desired_dynamics_are_the_virtual_accelerations(identical, state):
    """(6.2): D = F(eta, eta'), with eta in units of 5 mm and time in units of 1/wbar."""
    eta, rate = state[:3] / 0.005, state[3:] / 0.005 / 13.2929
    np.testing.assert_allclose(block(identical.loop, "transform", state, size=6), [*eta, *rate], rtol=1e-12)
    expected = np.empty(3)
    identical.virtual.kernels.accelerations(0.0, eta, rate, np.zeros(3), identical.virtual.values(), expected)
    np.testing.assert_allclose(block(identical.loop, "desired", state), expected, rtol=1e-12)


def test_input_is_cancellation_plus_drive(identical, state):
    u = np.empty(3)
    identical.loop.kernels.step(0.0, state[:3], state[3:], u, identical.loop.values())
    both = block(identical.loop, "cancel", state) + block(identical.loop, "drive", state)
    np.testing.assert_allclose(u, both, rtol=1e-15)


# Rigs with fewer inputs than coordinates.


def without(name, *inputs):
    """The text of a packaged model without some inputs and their gains."""
    text = catalogue.files("model")[name].read_text()
    for number in (name[1:] for name in inputs):
        text = re.sub(rf"\n  [uc]{number}: .*", "", text)
        text = re.sub(rf"(mu{number}\*)?c{number}\*u{number}", "0", text)
    return text


# Without its own actuator the beam moves with every push on an oscillator: then no coordinate moves alone.
@pytest.mark.parametrize(
    ("inputs", "missed"),
    [(("u3",), ("x1", "x2", "x3")), (("u1", "u2"), ("x1", "x2")), (("u2", "u3"), ("x1", "x2", "x3"))],
)
def test_too_few_inputs_name_the_coordinates_that_cannot_be_masked(tmp_path, inputs, missed):
    found = write(
        tmp_path,
        weak=without("setup", *inputs),
        rig="{name: rig, model: weak.yaml}",
        run="{name: run, plant: rig.yaml, virtual: duffing, duration: 1}",
    )
    with pytest.raises(ActuationError) as error:
        found.run()
    assert error.value.coordinates == missed
    assert f"cannot accelerate {', '.join(missed)} independently" in str(error.value)


# Mechanisms: coupled mass matrix, input matrix that depends on the configuration, nonlinear transform.

MECHANISMS = {
    "cart with a pendulum, forces on cart and bob": """
        name: cart
        coordinates: {a: {unit: m}, b: {unit: rad}}
        inputs: {F: {unit: N}, P: {unit: N}}
        parameters:
          M: {value: 1.2, unit: kg}
          m: {value: 0.4, unit: kg}
          l: {value: 0.5, unit: m}
          g: {value: 9.81, unit: m/s**2}
        lagrangian: (M + m)*a'**2/2 + m*l*a'*b'*cos(b) + m*l**2*b'**2/2 + m*g*l*cos(b)
        forces: {a: F + P, b: P*l*cos(b)}
    """,
    "arm of two links, torques on both joints": """
        name: arm
        coordinates: {a: {unit: rad}, b: {unit: rad}}
        inputs: {F: {unit: N*m}, P: {unit: N*m}}
        parameters:
          m: {value: 0.8, unit: kg}
          l: {value: 0.3, unit: m}
          g: {value: 9.81, unit: m/s**2}
          d: {value: 0.05, unit: N*m*s}
        lagrangian: >-
          m*l**2*(a'**2 + (a' + b')**2/2 + a'*(a' + b')*cos(b)) + m*g*l*(2*cos(a) + cos(a + b))
        dissipation: d*(a'**2 + b'**2)/2
        forces: {a: F, b: P}
    """,
}
NONLINEAR = {
    "cart with a pendulum, forces on cart and bob": """
        y1: k*log(a/k + sqrt(1 + (a/k)**2))  # asinh
        y2: b + k*b**3 + a**2
    """,
    "arm of two links, torques on both joints": """
        # A rotation whose angle grows with the radius.
        y1: a*cos(k*(a**2 + b**2)) - b*sin(k*(a**2 + b**2))
        y2: a*sin(k*(a**2 + b**2)) + b*cos(k*(a**2 + b**2))
    """,
}
OSCILLATORS = """
    name: two linear oscillators
    coordinates: {y1: {initial: 0.8}, y2: {initial: -0.6}}
    parameters: {w: 1.3, z: 0.02, k: 0.4}
    equations:
      y1'': -w**2*y1 - 2*z*w*y1' - k*(y1 - y2)
      y2'': -4*w**2*y2 - k*(y2 - y1)
"""


@pytest.mark.parametrize("kind", MECHANISMS)
def test_mechanisms_move_as_linear_oscillators_under_nonlinear_transforms(tmp_path, kind):
    found = write(
        tmp_path,
        oscillators=OSCILLATORS,
        mechanism=MECHANISMS[kind],
        rig="{name: rig, model: mechanism.yaml}",
        run=f"""
            name: run
            plant: rig.yaml
            virtual: oscillators.yaml
            duration: 100
            transform:
              parameters: {{k: 0.5}}
              expressions: {NONLINEAR[kind].replace(chr(10), chr(10) + " " * 8)}
        """,
    )
    assert_exact(found)


# What cannot go well.

TURNING = """
    name: mass that is pushed through a lever
    coordinates: {x: displacement}
    inputs: {u: force on the lever}
    equations: {x'': -4*x + cos(x)*u}
"""
SPRING = "{name: spring, coordinates: {x: {initial: 0, initial_velocity: 2}}, equations: {x'': -x}}"


@pytest.mark.parametrize("rate", ["continuous", "1 kHz, observer: exact"])
def test_singular_decoupling_matrix_stops_the_run_where_it_is_met(tmp_path, rate):
    found = write(
        tmp_path,
        lever=TURNING,
        spring=SPRING,
        rig="{name: rig, model: lever.yaml}",
        run=f"{{name: run, plant: rig.yaml, virtual: spring.yaml, duration: 50, controller: {{rate: {rate}}}}}",
    )
    with pytest.raises(SingularityError, match="became singular at t = ") as error:
        found.run()
    # x = 2 sin t reaches pi/2, where cos x vanishes, at t = asin(pi/4) = 0.903.
    time, state = error.value.time, error.value.state
    if rate == "continuous":
        assert 0.0 <= np.arcsin(np.pi / 4) - time < 1e-4
        assert state == pytest.approx({"x": 2 * np.sin(time), "x'": 2 * np.cos(time)}, abs=1e-8)
    else:  # the first sample behind it; the held input makes the motion a little late
        assert time == pytest.approx(np.arcsin(np.pi / 4), abs=0.005)
        assert 0.0 <= state["x"] - np.pi / 2 < 0.001 * 2
        assert state["x'"] == pytest.approx(2 * np.cos(np.arcsin(np.pi / 4)), rel=0.1)


def test_controller_that_believes_other_parameters():
    errors, settings = [], registry.load_experiment("duffing").controller
    for w1 in (12.5521, 12.6, 13.5):
        believes = settings.model_copy(update={"parameters": {"w1": w1}})
        run = experiment("duffing", duration=200.0, controller=believes).run()
        assert all(np.isfinite(column).all() for column in run.columns.values())
        errors.append(run.manifest["masking_error"]["x1"])
    assert errors[0] <= EXACT
    assert 1e-3 < errors[1] < errors[2]
