"""Noise in readings: white noise is found exactly, whatever moves beside it."""

import numpy as np
import pytest
from scipy import signal

from masking.records.noise import white_noise

COUNT = 20_000


def white(count=COUNT, columns=3, seed=0):
    return np.random.default_rng(seed).standard_normal((count, columns))


@pytest.mark.parametrize("count", [200, 256, 1000, 5003, 60_000])
def test_noise_alone_is_found_whole(count):
    """In the mean over 50 columns, and in each of them as sure as its samples allow."""
    found = white_noise(0.3 * white(count, 50) + 7.0)
    assert found.mean() == pytest.approx(0.3, rel=0.02)
    assert found.std() < 0.3 * 1.6 / np.sqrt(count)


@pytest.mark.parametrize("samples", [200.0, 20.0, 10.0, 5.0, 2.1])
def test_a_sine_is_no_noise(samples):
    """Of 2.1 to 200 samples in a period, 1000 times as large as the noise."""
    sine = 1000.0 * np.sin(2 * np.pi * np.arange(COUNT) / samples + 0.3)
    np.testing.assert_allclose(white_noise(white() + sine[:, None]), 1.0, rtol=0.05)


def test_motion_with_a_broad_spectrum_is_no_noise():
    """Random motion below 0.2 of the rate, a drift, and a line beside half the rate."""
    t = np.arange(COUNT)
    filtered = signal.sosfilt(signal.butter(8, 0.4, output="sos"), 50.0 * white(columns=1, seed=1), axis=0)
    motion = filtered + (1e-6 * t**2 + 3.0 * np.cos(0.98 * np.pi * t))[:, None]
    np.testing.assert_allclose(white_noise(white() + motion), 1.0, rtol=0.1)


@pytest.mark.parametrize("pole", [0.5, 0.9])
def test_of_coloured_noise_it_is_what_the_quietest_bands_hold(pole):
    """Noise e_t + pole x_(t-1) has a density of 1 / (1 + pole) at half the rate and nowhere less."""
    least = 1.0 / (1.0 + pole)
    found = white_noise(signal.lfilter([1.0], [1.0, -pole], white(), axis=0))
    assert (found > 0.95 * least).all()
    assert (found < 1.15 * least).all()


def test_each_column_is_by_itself():
    readings = white(columns=4) * np.array([1.0, 1e-6, 0.0, 1e3])
    np.testing.assert_allclose(white_noise(readings), [1.0, 1e-6, 0.0, 1e3], rtol=0.05)


def test_without_noise_there_is_hardly_any():
    t = np.arange(COUNT)[:, None]
    assert white_noise(np.sin(t / 30.0) + np.exp(-t / 3000.0)) < 1e-9


def test_a_few_readings_have_none():
    assert white_noise(np.ones((3, 2))).tolist() == [0.0, 0.0]
