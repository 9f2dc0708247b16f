"""Response: frequency responses and distortions against closed forms, and their intervals against seeded repeats."""

import numpy as np
import pytest
from scipy import signal

from masking.errors import ModelError, RecordError
from masking.inference.procedures import frequency_response as responses
from masking.inference.procedures.frequency_response import frequency_response, nonlinear_distortion, zippered_response

RATE, LENGTH = 100.0, 200
PERIOD = LENGTH / RATE
LINES = np.arange(1, 41)


def multisine(lines, seed, *, amplitude=1.0, periods=1):
    """One cosine of random phase per harmonic, over whole periods."""
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(lines))
    turn = 2.0 * np.pi * np.arange(LENGTH)[:, None] / LENGTH * np.asarray(lines)
    return np.tile(amplitude * np.cos(turn + phases).sum(axis=1), periods)


def spectra(u, y, **settings):
    """Spectra of experiments (experiments, samples, channels), of one of them, or of its only channel."""
    shaped = (x[None, :, None] if x.ndim == 1 else x[None] if x.ndim == 2 else x for x in (u, y))
    return responses.spectra(*shaped, **settings)


# A mechanical system of two masses, sampled: its transfer matrix at exp(i w / rate) is the truth.
A, B, C = (
    np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-90, 40, -3, 1], [40, -160, 1, -4.0]]),
    np.array([[0, 0], [0, 0], [20, 0], [5, 30.0]]),
    np.array([[1, 0, 0, 0], [-1, 1, 0, 0.0]]),
)
SYSTEM = signal.cont2discrete((A, B, C, np.zeros((2, 2))), 1.0 / RATE)[:4]


def truth(lines):
    z = np.exp(2j * np.pi * np.asarray(lines) / LENGTH)
    a, b, c, _ = SYSTEM
    return np.array([c @ np.linalg.solve(x * np.eye(4) - a, b) for x in z])


def answer(u):
    return signal.dlsim((*SYSTEM, 1.0 / RATE), u)[1]


def orthogonal(seeds, periods):
    """Two experiments for each realisation: the same multisines times the signs of a Hadamard matrix."""
    found = []
    for seed in seeds:
        first, second = (multisine(LINES, 2 * seed + i, periods=periods) for i in (0, 1))
        found += [np.column_stack([first, second]), np.column_stack([first, -second])]
    return np.array(found)


def test_the_response_of_two_inputs_is_the_closed_form():
    u = orthogonal([1, 2], 12)
    y = np.array([answer(each) for each in u])
    found = frequency_response(spectra(u, y, period=PERIOD, rate=RATE, discard=8))
    np.testing.assert_array_equal(found.harmonics, LINES)
    np.testing.assert_allclose(found.frequencies, LINES / PERIOD)
    np.testing.assert_allclose(found.response, truth(LINES), rtol=0, atol=1e-6 * np.abs(truth(LINES)).max())
    assert found.periods == 4
    assert found.realisations == 2
    assert found.radius().max() < 1e-5


def test_zippered_lines_give_each_column_in_one_experiment():
    u = np.column_stack([multisine(LINES[::2], 5, periods=12), multisine(LINES[1::2], 6, periods=12)])
    first, second = zippered_response(spectra(u, answer(u), period=PERIOD, rate=RATE, discard=9))
    np.testing.assert_array_equal(first.harmonics, LINES[::2])
    np.testing.assert_array_equal(second.harmonics, LINES[1::2])
    for column, found in enumerate((first, second)):
        expected = truth(found.harmonics)[:, :, [column]]
        np.testing.assert_allclose(found.response, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_spectra_are_of_peak_amplitudes():
    t = np.arange(3 * LENGTH) / RATE
    u = 0.3 + 0.7 * np.cos(2 * np.pi * 5 / PERIOD * t + 0.4)
    found = spectra(u, u, period=PERIOD, rate=RATE, discard=0)
    expected = np.zeros(LENGTH // 2 + 1, dtype=complex)
    expected[0], expected[5] = 0.3, 0.7 * np.exp(0.4j)
    np.testing.assert_allclose(found.inputs[0, :, :, 0], np.tile(expected, (3, 1)), atol=1e-14)


@pytest.mark.parametrize(("realisations", "periods"), [(1, 4), (1, 12), (5, 2)])
def test_intervals_hold_the_true_response_as_often_as_they_say(realisations, periods):
    """Noise at input and output, correlated by a common part; with realisations, their spread is taken."""
    generator = np.random.default_rng(11)
    u = np.array([multisine(LINES, s, periods=periods + 1) for s in range(realisations)])[:, :, None]
    clean = np.fft.irfft(np.fft.rfft(u[:, :LENGTH, 0]) * response_at(), LENGTH)
    y = np.tile(clean, (1, periods + 1))[:, :, None]
    inside, count = np.zeros(2), 0
    for _ in range(150):
        common = 0.05 * generator.standard_normal(u.shape)
        noisy_u = u + common
        noisy_y = y + 0.5 * common + 0.1 * generator.standard_normal(y.shape)
        found = frequency_response(spectra(noisy_u, noisy_y, period=PERIOD, rate=RATE), LINES)
        error = np.abs(found.response[:, 0, 0] - response_at()[LINES])
        inside += [np.sum(error <= found.radius(level)[:, 0, 0]) for level in (0.95, 0.5)]
        count += len(LINES)
    levels = np.array([0.95, 0.5])
    assert (np.abs(inside / count - levels) < 4 * np.sqrt(levels * (1 - levels) / count)).all()


def response_at():
    """A response that falls, at harmonics 0 to half the length."""
    return 1.0 / (1.0 + 0.1j * np.arange(LENGTH // 2 + 1))


def test_the_noise_of_two_inputs_is_what_repeats_show():
    generator = np.random.default_rng(3)
    periods = 5
    u = orthogonal([1], periods + 1)
    gains = np.array([[1.0, -0.5], [0.3, 2.0]])
    shape = np.array([[0.1, 0.0], [0.05, 0.2]])
    found = [
        frequency_response(
            spectra(u, u @ gains.T + generator.standard_normal(u.shape) @ shape.T, period=PERIOD, rate=RATE), LINES
        )
        for _ in range(200)
    ]
    spread = np.mean([np.abs(f.response - gains) ** 2 for f in found], axis=(0, 1))
    told = np.mean([f.noise for f in found], axis=(0, 1))
    np.testing.assert_allclose(told, spread, rtol=5 / np.sqrt(200 * len(LINES)))
    # White noise of variance s^2 in amplitudes of 1: 4 s^2 / (N periods), halved by the two experiments.
    expected = 4 * np.diag(shape @ shape.T) / (LENGTH * periods) / 2
    np.testing.assert_allclose(told, np.column_stack([expected, expected]), rtol=0.05)


# Distortion. The excited lines are odd, of every four one is left out.
ODD = np.array([k for k in range(1, 32, 2) if k not in {5, 13, 21, 29}])


def convolved(amplitudes, power):
    """The amplitudes of a power of a periodic signal, by convolution of its two-sided spectrum."""
    both = np.concatenate([0.5 * amplitudes[:0:-1].conj(), [amplitudes[0]], 0.5 * amplitudes[1:]])
    found = both
    for _ in range(power - 1):
        found = np.convolve(found, both)
    middle = len(found) // 2
    return np.concatenate([[found[middle]], 2 * found[middle + 1 :]])


@pytest.mark.parametrize(("square", "cube"), [(0.02, 0.0), (0.0, 0.01), (0.03, 0.004)])
def test_even_and_odd_distortion_are_those_of_square_and_cube(square, cube):
    u = multisine(ODD, 2, periods=4)
    found = nonlinear_distortion(spectra(u, u + square * u**2 + cube * u**3, period=PERIOD, rate=RATE))
    amplitudes = np.zeros(LENGTH // 2 + 1, dtype=complex)
    amplitudes[:] = 2.0 / LENGTH * np.fft.rfft(u[:LENGTH])
    lines = found.harmonics
    second, third = square * convolved(amplitudes, 2)[lines], cube * convolved(amplitudes, 3)[lines]
    np.testing.assert_array_equal(lines[found.odd], [5, 13, 21, 29])
    np.testing.assert_allclose(found.level[found.even], np.abs(second[found.even]) ** 2, rtol=1e-9, atol=1e-24)
    np.testing.assert_allclose(found.level[found.odd], np.abs(third[found.odd]) ** 2, rtol=1e-9, atol=1e-24)
    assert np.isnan(found.distortion[found.excited]).all()
    signal_rms = np.sqrt(np.mean(found.level[found.excited]))
    assert found.shares["even"] == pytest.approx(np.sqrt(np.mean(np.abs(second[found.even]) ** 2)) / signal_rms)
    assert found.shares["odd"] == pytest.approx(np.sqrt(np.mean(np.abs(third[found.odd]) ** 2)) / signal_rms, abs=1e-12)
    assert found.shares["noise"] < 1e-12


def test_noise_is_told_from_distortion():
    generator = np.random.default_rng(5)
    u = np.array([multisine(ODD, s, periods=21) for s in range(40)])
    noise = 0.2
    y = u + 0.03 * u**2 + noise * generator.standard_normal(u.shape)
    found = nonlinear_distortion(spectra(u[:, :, None], y[:, :, None], period=PERIOD, rate=RATE))
    expected = 4 * noise**2 / (LENGTH * 20)
    np.testing.assert_allclose(found.noise, expected, rtol=6 / np.sqrt(40 * 19))
    np.testing.assert_allclose(found.level[found.odd], expected, rtol=6 / np.sqrt(40))
    assert found.shares["even"] > 30 * found.shares["odd"]


def test_what_the_input_itself_has_at_detection_lines_is_no_distortion():
    """An actuator's own square, measured as input, goes through a linear rig: no distortion of the rig."""
    u = multisine(ODD, 2)
    u = np.tile(u + 0.05 * u**2, 4)
    found = nonlinear_distortion(spectra(u, 3.0 * u, period=PERIOD, rate=RATE), ODD)
    assert found.shares["even"] < 1e-12


def test_the_best_linear_approximation_of_a_cube():
    """With F lines of amplitude A and random phases, u + c u^3 is on average 1 + c A^2 (3 F / 2 - 3 / 4) at each line.

    The variance that distortion adds to it is part of the total, and is not there over periods.
    """
    cube, amplitude, realisations = 0.01, 0.7, 400
    u = np.array([multisine(ODD, s, amplitude=amplitude, periods=3) for s in range(realisations)])[:, :, None]
    found = frequency_response(spectra(u, u + cube * u**3, period=PERIOD, rate=RATE))
    expected = 1.0 + cube * amplitude**2 * (1.5 * len(ODD) - 0.75)
    error = np.abs(found.response[:, 0, 0] - expected)
    assert np.mean(error <= found.radius(0.99)[:, 0, 0]) > 0.9
    assert (error <= found.radius(1.0 - 1e-6)[:, 0, 0]).all()
    assert found.noise.max() < 1e-25
    np.testing.assert_allclose(found.distortion, realisations * found.total, rtol=1e-12)


# Refusals.


def refused(error, function=frequency_response, *, u=None, y=None, harmonics=None, **settings):
    u = multisine(LINES, 1, periods=4) if u is None else u
    with pytest.raises(error) as caught:
        found = spectra(u, u if y is None else y, **{"period": PERIOD, "rate": RATE, **settings})
        function(found) if harmonics is None else function(found, harmonics)
    return str(caught.value)


def test_a_record_that_cannot_be_used_is_refused_with_the_remedy():
    u = multisine(LINES, 1, periods=4)
    gap = u.copy()
    gap[[7, 9]] = np.nan
    assert "the outputs must be finite: nan in experiment 0, sample 7, channel 0 (counted from 0), 2 in all" in refused(
        RecordError, y=gap
    )
    assert "750 samples are not whole periods of 200: 150 are left over; cut the record to 600" in refused(
        RecordError, u=u[:750]
    )
    assert "2 periods, of which 1 are discarded; at least 2 must remain" in refused(RecordError, u=u[:400])
    assert "input 0 (counted from 0) is constant at 0.3" in refused(RecordError, u=0.3 + 0 * u, y=u)
    assert "output 0 (counted from 0) is constant at 0" in refused(RecordError, y=0 * u)


def test_settings_that_make_no_sense_are_refused():
    assert "200.5 samples; choose them such that it is a whole number" in refused(ModelError, period=2.005)
    assert "the rate is -1.0 Hz" in refused(ModelError, rate=-1.0)
    assert "discard is -1" in refused(ModelError, discard=-1)
    u = multisine(LINES, 1, periods=4)
    with pytest.raises(ModelError, match="the level is 1; give a probability"):
        frequency_response(spectra(u, u, period=PERIOD, rate=RATE)).radius(1.0)


def test_inputs_that_cannot_be_told_apart_are_refused():
    first, second = multisine(LINES, 1, periods=4), multisine(LINES, 2, periods=4)
    both = np.column_stack([first, second])
    assert "1 experiments for 2 inputs; record 2 in which the inputs differ" in refused(RecordError, u=both)
    assert "cannot be distinguished at the harmonic 1, 0.5 Hz" in refused(RecordError, u=np.array([both, both]))
    assert "the inputs 0 and 1 share the harmonic 1, 0.5 Hz" in refused(RecordError, zippered_response, u=both)
    silent = "input 0 (counted from 0) is not excited at the harmonic 60, 30 Hz"
    assert silent in refused(RecordError, harmonics=np.array([60]))
    noisy = first + 0.01 * np.random.default_rng(1).standard_normal(len(first))
    assert silent in refused(RecordError, u=noisy, harmonics=np.array([60]))


def test_a_multisine_without_detection_lines_is_refused():
    even, full = (multisine(lines, 1, periods=4) for lines in (LINES, np.arange(1, 40, 2)))
    assert "the even harmonic 2 is excited, 1 Hz" in refused(RecordError, nonlinear_distortion, u=even)
    assert "every odd harmonic up to 39 is excited" in refused(RecordError, nonlinear_distortion, u=full)
