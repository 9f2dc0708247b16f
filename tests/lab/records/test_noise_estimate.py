"""Noise in readings: white noise is found exactly, whatever moves beside it."""

import numpy as np
import pytest
from scipy import signal

from masking.app.workflows import discovery_inputs
from masking.inference.discovery.readings import noise_of
from masking.inference.estimation.identification_data import Data
from masking.lab.records.noise_estimate import bandwidth, rounding_steps, white_noise

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


@pytest.mark.parametrize("frequency", [0.003, 0.02, 0.1, 0.3])
def test_motion_ends_where_its_highest_line_is(frequency):
    """To a band above it, of 64 lines or a third of an octave."""
    t = np.arange(COUNT)
    columns = [np.sin(2 * np.pi * 0.5 * frequency * t), 0.5 * np.sin(2 * np.pi * frequency * t), 0.0 * t]
    found = bandwidth(white() + 10.0 * np.stack(columns, axis=1))
    assert frequency < found < max(1.3 * frequency, frequency + 65.0 / (COUNT / 4))


def test_motion_that_decays_counts_where_it_is():
    t = np.arange(COUNT)
    decay = 30.0 * np.exp(-t / 1000.0) * np.sin(2 * np.pi * 0.05 * t)
    assert 0.05 < bandwidth(white(columns=1) + decay[:, None]) < 0.07


def test_noise_alone_has_no_motion():
    assert [bandwidth(white(seed=seed)) for seed in range(20)].count(0.0) >= 19


def test_each_column_is_by_itself():
    readings = white(columns=4) * np.array([1.0, 1e-6, 0.0, 1e3])
    np.testing.assert_allclose(white_noise(readings), [1.0, 1e-6, 0.0, 1e3], rtol=0.05)


def test_without_noise_there_is_hardly_any():
    t = np.arange(COUNT)[:, None]
    assert white_noise(np.sin(t / 30.0) + np.exp(-t / 3000.0)) < 1e-9


def test_a_few_readings_have_none():
    assert white_noise(np.ones((3, 2))).tolist() == [0.0, 0.0]


DAMPER = """
name: damper on a test bench
inputs: {{d: {{unit: m}}, v: {{unit: m/s}}}}
parameters: {{k: {{value: {k}, unit: N/m}}, c: {{value: {c}, unit: N*s/m}}}}
outputs: {{F: {{expression: k*d + c*v, unit: N}}}}
elements: {{strut: {{displacement: d, rate: v, unit: N, acts: {{F: 1}}}}}}
"""


def bench(seed=0, inside=0.02, outside=0.5):
    """Return motion and force of a damper of 100 N/m and 20 N s/m, with noise in the rate and in the force."""
    rng, t = np.random.default_rng(seed), np.arange(COUNT) / 1000.0
    d = 0.1 * np.sin(9.0 * t) + 0.03 * np.sin(23.0 * t + 1.0)
    v = np.gradient(d) * 1000.0
    measured = v + inside * rng.standard_normal(COUNT)
    return np.column_stack([d, measured]), (100.0 * d + 20.0 * v + outside * rng.standard_normal(COUNT))[:, None]


@pytest.mark.parametrize(("k", "c"), [(100, 20), (1000, 2), (1, 500)])
def test_the_noise_of_a_record_is_the_same_from_whatever_model_one_starts(tmp_path, k, c):
    """That of the rate, 0.02 m/s, makes 0.4 N in a force of 20 N s/m."""
    (tmp_path / "damper.yaml").write_text(DAMPER.format(k=k, c=c))
    twin, (inputs_, force) = discovery_inputs.rig(tmp_path / "damper.yaml", None), bench()
    found = noise_of(twin, Data("bench", 1000.0, inputs_, force, hold="first-order"))
    assert found == pytest.approx(np.hypot(0.5, 0.4), rel=0.03)


def test_readings_that_were_interpolated_between_fewer_have_noise(tmp_path):
    """Seven of ten third differences of these are 0."""
    (tmp_path / "damper.yaml").write_text(DAMPER.format(k=100, c=20))
    twin, (inputs_, force) = discovery_inputs.rig(tmp_path / "damper.yaml", None), bench(inside=0.0)
    t = np.arange(COUNT)
    coarse = np.interp(t, t[::10], force[::10, 0])[:, None]
    found = noise_of(twin, Data("bench", 1000.0, inputs_, coarse, hold="first-order"))
    assert found == pytest.approx(0.5, rel=0.05)


def test_a_rate_that_jumps_now_and_then_has_the_noise_of_its_other_readings(tmp_path):
    (tmp_path / "damper.yaml").write_text(DAMPER.format(k=100, c=20).replace("c*v", "c*v + 0*d"))
    twin, (inputs_, _) = discovery_inputs.rig(tmp_path / "damper.yaml", None), bench(inside=0.0)
    saw = np.abs(np.arange(COUNT) % 100 - 50.0)[:, None] + 0.01 * np.random.default_rng(5).standard_normal((COUNT, 1))
    found = noise_of(twin, Data("bench", 1000.0, inputs_, saw, hold="first-order"))
    assert found == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize(
    ("readings", "step"),
    [
        (np.round(np.sin(np.arange(500.0)) / 0.004) * 0.004, 0.004),  # as many values as readings
        (np.round(np.sin(np.arange(5000.0) / 30.0) / 0.02) * 0.02 - np.pi, 0.02),  # not multiples of it
        (np.round(np.sin(np.arange(5000.0) / 30.0) * 30.0) * 0.9 / 1.8 * 2.0 + 1e-14 * np.arange(5000.0), 1.0),
        (np.sin(np.arange(5000.0) / 30.0) + 1e-3 * white(5000, 1)[:, 0], 0.0),
        (np.ones(500), 0.0),
    ],
)
def test_rounding_is_seen_whatever_the_offset_and_the_number_of_values(readings, step):
    found = rounding_steps(readings[:, None])
    assert found == pytest.approx(step, rel=1e-3)


def test_one_quiet_band_does_not_make_the_noise():
    """Of 2000 records of 1500 readings, a band of 64 lines is by chance 40 % below the others in some."""
    assert white_noise(white(1500, 2000)).min() > 0.85
