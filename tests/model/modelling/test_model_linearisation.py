"""Models and closed loops as systems of python-control, and linear models of them."""

import control
import numpy as np
import pytest
import scipy.linalg

import masking
from masking.errors import ModelError

TIGHT = {"rtol": 1e-10, "atol": 1e-13}


def test_a_model_gives_the_same_trajectory_in_python_control():
    model = masking.load_model("duffing")
    times = np.linspace(0.0, 20.0, 101)
    response = control.input_output_response(
        model.to_control(), times, 0, model.initial_state({}), solve_ivp_kwargs=TIGHT
    )
    np.testing.assert_allclose(response.outputs.T, model.simulate(times).positions, atol=1e-8)


def test_a_closed_loop_gives_the_same_trajectory_in_python_control():
    experiment = masking.Experiment.load("duffing")
    model = experiment.virtual
    times = np.linspace(0.0, 1.0, 51)
    initial = [-3e-3, -2.5e-3, 0.0, 0.0, 0.0, 0.0]  # -0.6 and -0.5 of 5 mm
    system = experiment.loop.to_control()
    response = control.input_output_response(system, times, 0, initial, solve_ivp_kwargs=TIGHT)
    ideal = model.simulate(times / experiment.time_scale).positions
    np.testing.assert_allclose(response.outputs[:3].T, ideal, atol=1e-8)
    assert system.output_labels == ["x1", "x2", "x3", "u1", "u2", "u3"]


def test_the_linearised_set_up_is_the_matrix_of_4_4_to_4_6():
    model = masking.load_model("setup").dimensionless()
    w, z, mu = (0.944271, 1.055729, 0.732489), (0.3362, 0.4296, 0.0409), (0.0411, 0.0578)
    stiffness = np.array(
        [
            [w[0] ** 2, 0, -(w[0] ** 2)],
            [0, w[1] ** 2, -(w[1] ** 2)],
            [-mu[0] * w[0] ** 2, -mu[1] * w[1] ** 2, mu[0] * w[0] ** 2 + mu[1] * w[1] ** 2 + w[2] ** 2],
        ]
    )
    c = [2 * z[i] * w[i] for i in range(3)]
    damping = np.array(
        [[c[0], 0, -c[0]], [0, c[1], -c[1]], [-mu[0] * c[0], -mu[1] * c[1], mu[0] * c[0] + mu[1] * c[1] + c[2]]]
    )
    system = model.linearise()
    np.testing.assert_allclose(system.A[3:], -np.hstack([stiffness, damping]), atol=2e-6)
    np.testing.assert_allclose(np.diag(system.B[3:]), [9.945, 11.05, 0.5984], rtol=1e-3)  # Table 4.1, corrected
    np.testing.assert_array_equal(system.C, np.eye(3, 6))


def test_what_python_control_cannot_hold_is_refused(declared):
    alone = declared(coordinates={"x": {}}, equations={"x''": "-x - 0.1*x'"})
    with pytest.raises(ModelError, match="test has no inputs and one output, which python-control cannot hold"):
        alone.linearise()


def test_a_linear_model_follows_its_matrix_exponential():
    model = masking.load_model("setup").dimensionless()
    times = np.linspace(0.0, 10.0, 11)
    initial = {"x1": 0.004, "x2": -0.003, "x3": 0.001}  # m
    state = model.initial_state(initial)
    matrix = model.linearise().A
    expected = np.array([scipy.linalg.expm(matrix * t) @ state for t in times])
    np.testing.assert_allclose(model.simulate(times, initial).states, expected, atol=1e-9)


def test_linearisation_away_from_rest_is_the_derivative_there():
    model = masking.load_model("huygens")
    at = {"th1": 0.4, "th2": -0.3, "x": 0.1, "th1'": 0.5, "x'": -0.2}
    state = np.array([at.get(n, 0.0) for n in ("th1", "th2", "x", "th1'", "th2'", "x'")])

    def rate(y: np.ndarray) -> np.ndarray:
        out = np.empty(6)
        model.kernels.derivative(0.0, y, np.zeros(0), model.values(), out)
        return out

    step = 1e-6
    differences = [(rate(state + step * e) - rate(state - step * e)) / (2 * step) for e in np.eye(6)]
    np.testing.assert_allclose(model.linearise(at=at).A, np.array(differences).T, atol=1e-8)


def test_parameters_can_be_changed_in_python_control():
    model = masking.load_model("duffing")
    times = np.linspace(0.0, 5.0, 11)
    response = control.input_output_response(
        model.to_control(), times, 0, model.initial_state({}), params={"w3": 0.9}, solve_ivp_kwargs=TIGHT
    )
    changed = model.with_parameters(w3=0.9).simulate(times).positions
    np.testing.assert_allclose(response.outputs.T, changed, atol=1e-8)
    assert np.abs(changed - model.simulate(times).positions).max() > 0.01
