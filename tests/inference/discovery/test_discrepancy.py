"""The likelihood of residuals beyond noise, against its closed forms and what samples of known colour are worth."""

import numpy as np
import pytest
from scipy import optimize, signal

from masking.inference.discovery import discrepancy

COUNT = 8000
RNG = np.random.default_rng(46)
READINGS = signal.lfilter([1.0], [1.0, -0.98], RNG.standard_normal((COUNT, 1)), axis=0)  # slow, as readings are
NOISE = np.array([1e-3])


def white(seed):
    return NOISE * np.random.default_rng(seed).standard_normal((COUNT, 1))


@pytest.mark.parametrize("seed", range(20))
def test_white_noise_is_worth_all_its_samples(seed):
    assert discrepancy.independent(white(seed), READINGS, NOISE, 3.0)[0] == pytest.approx(COUNT, rel=0.05)


@pytest.mark.parametrize("size", [1.0, 3.0, 30.0])
def test_white_residuals_of_any_size_are_worth_all_their_samples(size):
    assert discrepancy.independent(size * white(1), READINGS, NOISE, 3.0)[0] == pytest.approx(COUNT, rel=0.1)


@pytest.mark.parametrize("pole", [0.5, 0.9])
def test_slow_residuals_are_worth_what_the_mean_of_them_varies(pole):
    """Of a first-order process, n = m (1 - a)/(1 + a) independent samples have as uncertain a mean.

    Source: Priestley (1981), Spectral Analysis and Time Series, section 5.3.2.
    """
    left = signal.lfilter([1.0], [1.0, -pole], 10.0 * white(2), axis=0)
    worth = discrepancy.independent(left, READINGS, NOISE, 3.0)[0]
    assert worth == pytest.approx(COUNT * (1.0 - pole) / (1.0 + pole), rel=0.3)


def test_the_likelihood_is_that_of_an_unknown_size_at_its_best():
    """-2 log L = n log s + m P/s, of which the best s >= 1 is found by scipy; up to constants of n alone."""
    samples = np.array([[120.0]])
    for squares in (10.0, 119.0, 121.0, 500.0, 1e6):

        def cost(size, squares=squares):
            return samples[0, 0] * np.log(size) + squares / size

        best = optimize.minimize_scalar(lambda log: cost(np.exp(log)), bounds=(0.0, 20.0), method="bounded").fun
        here = discrepancy.misfit(np.array([[squares]]), samples)
        assert here == pytest.approx(min(best, cost(1.0)), rel=1e-4)


def test_weights_are_the_slope_of_the_likelihood():
    samples, step = np.array([[120.0]]), 1e-3
    for squares in (10.0, 200.0, 1e4):
        ends = [discrepancy.misfit(np.array([[squares + sign * step]]), samples) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        assert discrepancy.weights(np.array([[squares]]), samples)[0, 0] == pytest.approx(slope, rel=1e-5)
