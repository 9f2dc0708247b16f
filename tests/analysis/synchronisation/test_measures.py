"""Measures of synchronisation, against closed forms, scipy and the digest's section 7."""

import math

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from masking.analysis.synchronisation import (
    anti_phase,
    interpolate,
    mean_phase,
    peak_sum,
    period,
    phase_difference,
    principal,
    running_peak,
)
from masking.analysis.synchronisation.measures import Oscillation
from masking.errors import RecordError

T = np.arange(0.0, 40.3 * 2 * np.pi, 0.1)


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(0.0, 6.3), st.floats(0.1, 10.0), st.floats(-5.0, 5.0))
def test_phase_of_two_sines_is_right_up_to_both_ends(phase, start, amplitude, offset):
    found = phase_difference(T, np.cos(T + start + phase), amplitude * np.cos(T + start) + offset)
    assert np.abs(found - phase).max() < 0.03


def test_phase_of_a_slow_drift_from_in_phase_to_anti_phase():
    drift = np.pi * np.sin(np.pi / 2 * T / T[-1]) ** 2
    found = phase_difference(T, np.cos(T + drift / 2), 0.7 * np.cos(T - drift / 2))
    assert np.abs(found - drift).max() < 0.03


def test_phase_is_followed_beyond_pi():
    t = np.arange(0.0, 600.0, 0.05)
    found = phase_difference(t, np.cos(1.05 * t), np.cos(t))
    assert found[-1] == pytest.approx(0.05 * t[-1], abs=0.05)  # almost five turns


def test_phase_on_an_uneven_grid():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.02, 0.15, 4000))
    assert np.abs(phase_difference(t, np.cos(t), np.cos(t - 1.0)) - 1.0).max() < 0.03


def test_phase_is_antisymmetric_and_exact_for_opposite_signals():
    a, b = np.cos(T), np.cos(T - 0.4) + 0.1 * np.cos(2.3 * T)
    np.testing.assert_allclose(phase_difference(T, a, b), -phase_difference(T, b, a), atol=1e-12)
    np.testing.assert_allclose(np.abs(phase_difference(T, b, -2 * b)), np.pi, atol=1e-12)


@pytest.mark.parametrize("cycles", [3, 64])
def test_analytic_signal_is_scipys_where_the_record_is_periodic(cycles):
    t = np.arange(512) * 2 * np.pi * cycles / 512
    a = np.cos(t + 0.3)
    # scipy takes the record as one period of an endless signal, which here it is.
    np.testing.assert_allclose(Oscillation.of(a).analytic_signal(), scipy.signal.hilbert(a), atol=0.02)


@pytest.mark.parametrize(
    "a", [np.zeros(100), np.ones(100), np.cos(T[:80]), np.array([1.0, -1.0, 1.0]), np.array([1.0])]
)
def test_too_little_motion_for_a_phase(a):
    t = np.arange(float(len(a)))
    with pytest.raises(RecordError, match="fewer than three periods of oscillation"):
        phase_difference(t, a, a)
    assert math.isnan(period(t, a))


def test_principal_keeps_both_phases_off_the_seam():
    np.testing.assert_allclose(
        principal(np.array([0.0, np.pi, -np.pi, 2 * np.pi, -0.1])), [0, np.pi, np.pi, 0, -0.1], atol=1e-15
    )


def test_mean_phase_across_the_seam():
    angle, steady = mean_phase(np.array([np.pi - 0.1, np.pi + 0.1, -np.pi + 0.1, -np.pi - 0.1]))
    assert angle == pytest.approx(np.pi)
    assert steady == pytest.approx(np.cos(0.1))
    assert mean_phase(np.linspace(0, 2 * np.pi, 100, endpoint=False))[1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("true", [0.93, 2.0, 7.77])
def test_period(true):
    rng = np.random.default_rng(0)
    a = np.cos(2 * np.pi * T / true)
    assert period(T, a) == pytest.approx(true, rel=2e-4)
    assert period(T, a + 3 + 0.05 * rng.standard_normal(len(T))) == pytest.approx(true, rel=1e-3)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 60), st.floats(0.0, 20.0), st.integers(0, 2**32 - 1))
def test_running_peak_is_the_peak_over_the_window_before(samples, window, seed):
    rng = np.random.default_rng(seed)
    t, a = np.cumsum(rng.uniform(0.01, 1.0, samples)), rng.standard_normal(samples)
    plain = [a[: i + 1][t[: i + 1] >= t[i] - window].max() for i in range(samples)]
    np.testing.assert_array_equal(running_peak(t, a, window), plain)


def test_peak_sum_of_a_decaying_sum_is_its_envelope():
    s = 0.3 * np.exp(-T / 60)
    found = peak_sum(T, np.cos(T) + s * np.cos(1.3 * T), -np.cos(T), 2 * np.pi)
    inside = period(T, np.cos(T)) < T
    assert np.all(found[inside] >= 0.98 * s[inside])
    assert np.all(found[inside] <= s[inside] * np.exp(2 * np.pi / 60))


def test_interpolation_is_exact_for_quintics_and_of_sixth_order():
    t = np.sort(np.random.default_rng(2).uniform(0, 3, 30))
    at = np.linspace(t[0], t[-1], 200)
    quintic = np.polynomial.Polynomial([1, -2, 0.5, 0.3, -0.2, 0.05])
    np.testing.assert_allclose(interpolate(t, quintic(t), at), quintic(at), rtol=0, atol=1e-9)
    errors = []
    for step in (0.2, 0.1):
        grid = np.arange(0, 10, step)
        at = np.linspace(2, 8, 1001)
        errors.append(np.abs(interpolate(grid, np.sin(grid), at) - np.sin(at)).max())
    assert math.log2(errors[0] / errors[1]) == pytest.approx(6.0, abs=0.1)


def test_anti_phase_of_two_sines_with_harmonics():
    a = 1.5 * np.cos(1.02 * T) + 0.1 * np.cos(3.06 * T)
    b = np.cos(1.02 * T + np.pi) + 0.1 / 1.5 * np.cos(3.06 * T + np.pi)
    fit = anti_phase(T, a, b)
    assert fit.alpha == pytest.approx(1.5, rel=1e-3)
    assert fit.period == pytest.approx(2 * np.pi / 1.02, rel=1e-3)
    assert fit.eps < 0.02


def test_anti_phase_residual_of_a_phase_error():
    # cos(t) - alpha cos(t + d) has least norm for alpha = cos d, and then amplitude |sin d|.
    d = 0.09 * np.pi
    t = np.arange(0, 400 * np.pi, 0.05)
    fit = anti_phase(t, np.cos(t), np.cos(t - np.pi + d))
    assert fit.alpha == pytest.approx(np.cos(d), abs=2e-3)
    assert fit.eps == pytest.approx(np.sin(d), rel=1e-2)


def test_in_phase_motion_fits_no_positive_alpha():
    assert anti_phase(T, np.cos(T), np.cos(T)).alpha == pytest.approx(-1.0, abs=2e-3)


def test_anti_phase_needs_three_periods():
    with pytest.raises(RecordError, match="the last 20% of the record holds fewer than three periods"):
        anti_phase(T[:500], np.cos(T[:500]), np.cos(T[:500]))


def test_identical_undamped_set_up_of_the_digest():
    """Section 7, first entry: alpha = 1.0000, phase 0.9994 pi at 95 %, eps = 1.0e-3 by a shift of whole samples."""
    mu, w3, z3 = 0.04945, 9.7369 / 13.2929, 0.0409
    matrix = np.zeros((6, 6))
    matrix[:3, 3:] = np.eye(3)
    matrix[3:, :3] = [[-1, 0, 1], [0, -1, 1], [mu, mu, -2 * mu - w3**2]]
    matrix[5, 5] = -2 * z3 * w3
    values, vectors = np.linalg.eig(matrix)
    weights = np.linalg.solve(vectors, np.array([-1, -0.8, 0, 0, 0, 0], complex))
    tau = np.arange(0, 1500.025, 0.05)
    a, b, beam = ((np.exp(np.outer(tau, values)) * weights) @ vectors.T).real.T[:3]
    fit = anti_phase(tau, a, b)
    assert fit.alpha == pytest.approx(1.0, abs=5e-5)
    assert fit.period == pytest.approx(2 * np.pi, rel=1e-6)  # the beam is at rest: each oscillator moves by itself
    # In anti-phase with alpha = 1, g is the sum of the two, here at the start of the last fifth.
    assert fit.eps == pytest.approx(peak_sum(tau, a, b, 7.0)[np.searchsorted(tau, 1207)], rel=0.05)
    # T/2 rounded to 63 samples, as the digest took it, leaves the larger residual it states.
    last = tau >= 1200
    whole = a[last][:-63] - fit.alpha * b[last][63:]
    assert np.abs(whole).max() == pytest.approx(1.0e-3, rel=0.02)
    phase = phase_difference(tau, a, b)[int(0.95 * len(tau))]
    assert mean_phase(np.array([phase]))[0] == pytest.approx(0.9994 * np.pi, rel=5e-4)
    assert np.abs(beam[tau >= 1350]).max() <= 5.4e-6
