"""The steady Kalman design: noise over a sample, the Riccati equation, and states that readings do not determine."""

import numpy as np
import pytest
from scipy import linalg

from masking.compile.numerics.steady_kalman import discretised, steady_filter


def test_noise_over_a_sample_is_that_of_an_integrated_random_walk():
    h, q = 0.02, 3.0
    step, noise = discretised(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, q]), h)
    np.testing.assert_allclose(step, [[1.0, h], [0.0, 1.0]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(noise, q * np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]]), rtol=1e-12)


@pytest.mark.parametrize("decay", [1e-3, 10.0, 1e7])
def test_noise_of_a_state_that_decays_at_any_rate_is_the_closed_form(decay):
    step, noise = discretised(np.array([[-decay, 0.0], [0.0, 0.0]]), np.array([2.0, 3.0]), 0.01)
    expected = np.diag([2.0 * -np.expm1(-2.0 * decay * 0.01) / (2.0 * decay), 0.03])
    np.testing.assert_allclose(noise, expected, rtol=1e-10, atol=1e-300)
    np.testing.assert_allclose(step, np.diag([np.exp(-decay * 0.01), 1.0]), rtol=1e-10, atol=1e-300)


def test_the_covariances_are_scipys():
    rng = np.random.default_rng(5)
    step, reading = rng.normal(size=(4, 4)) / 2.0, rng.normal(size=(2, 4))
    noise = np.diag([0.1, 1.0, 0.0, 2.0])
    found = steady_filter(step, noise, reading)
    predicted = linalg.solve_discrete_are(step.T, reading.T, noise, np.eye(2))
    np.testing.assert_allclose(found.predicted, predicted, rtol=1e-9, atol=1e-12)
    corrected = np.linalg.inv(np.linalg.inv(predicted) + reading.T @ reading)
    np.testing.assert_allclose(found.corrected, corrected, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(found.gain, corrected @ reading.T, rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(found.innovation, reading @ predicted @ reading.T + np.eye(2), rtol=1e-9)


def test_a_walk_that_no_reading_determines_is_refused():
    with pytest.raises(ValueError, match="does not settle"):
        steady_filter(np.eye(2), np.eye(2), np.array([[1.0, 0.0]]))
