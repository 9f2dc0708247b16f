"""Signals: crest and time factors, the phases of a small crest factor, the shapes of excitations, and their files."""

import csv
import itertools
import math
import time

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, optimize, signal

from masking.errors import MaskingError, ModelError, RecordError
from masking.lab import signals
from masking.lab.records import readers
from masking.lab.records.recording import Recording
from masking.lab.signals import Excitation, Multisine, crest_factor, minimise_crest, schroeder_phases, time_factor
from masking.lab.signals.crest import Norm

# Table B.2 of the source, in units of pi: the document's optimum for 25 flat lines, by the infinity norm to p = 10.
TABLE_B2 = [
    *(1.5706, 0.1425, 1.2977, 1.7042, 1.4277, 1.8201, 1.0641, 0.0000, 0.7113, 0.6608, 0.6606, 1.4765, 1.7126),
    *(1.8925, 1.5232, 0.8378, 1.9196, 1.9680, 0.0724, 1.2242, 0.1689, 0.0000, 1.3600, 0.1597, 0.6171),
]
# Table B.3, for 50 lines, to p = 2.
TABLE_B3 = [
    *(0.5160, 1.0146, 1.2792, 0.1630, 0.2704, 0.6175, 1.8581, 0.4419, 1.4532, 0.3311, 2.9592, 0.8852, 1.2443),
    *(1.6920, 1.3122, 1.5676, 0.7970, 0.4583, 0.0768, 0.1754, 2.0268, 0.1898, 1.3690, 0.5438, 1.6525, 0.7727),
    *(0.3312, 0.1863, 1.2465, 0.9476, 0.3167, 1.2186, 1.5124, 1.1894, 0.7794, 0.3178, 0.8564, 0.7474, 1.0013),
    *(1.0380, 0.0072, 0.6064, 0.8849, 1.7063, 0.9052, 0.5380, 0.8555, 1.7034, 1.8075, 0.4661),
]
# The smallest peak of two equal lines f and 2f, where cos x = (sqrt 33 - 1) / 8: that of sin x + sin 2x.
COSINE = (math.sqrt(33.0) - 1.0) / 8.0
TWO_LINES = math.sqrt(1.0 - COSINE**2) * (1.0 + 2.0 * COSINE)


def flat(lines, phases=0.0, period=1.0):
    return Multisine.harmonic(np.arange(1, lines + 1), period, phases=phases)


def source_multisine(phases):
    """The document's signal: lines linearly spaced between 0.01 and 25 Hz."""
    lines = np.linspace(0.01, 25.0, len(phases))
    return Multisine(lines, 1.0, np.pi * np.array(phases)), 1.0 / (lines[1] - lines[0])


# --- crest and time factor


@pytest.mark.parametrize("phase", [0.0, 0.3, 2.0])
def test_one_sine(phase):
    one = Multisine([0.7], 3.0, phase)
    assert one.period == pytest.approx(1.0 / 0.7, rel=1e-15)
    assert one.peak() == pytest.approx(3.0, rel=1e-14)
    assert crest_factor(one) == pytest.approx(math.sqrt(2.0), rel=1e-14)
    assert time_factor(one) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("lines", [2, 7, 40])
def test_lines_in_phase_add_up(lines):
    """At zero all N cosines are 1: the crest factor is N / sqrt(N / 2), the time factor N^2."""
    assert crest_factor(flat(lines)) == pytest.approx(math.sqrt(2.0 * lines), rel=1e-13)
    assert time_factor(flat(lines)) == pytest.approx(lines**2, rel=1e-13)


def test_two_lines():
    """f and 2f as sines: a closed form; f and sqrt(2) f come as near in phase as one waits: 2."""
    assert crest_factor(flat(2, -np.pi / 2)) == pytest.approx(TWO_LINES, rel=1e-13)
    apart = Multisine([1.0, math.sqrt(2.0)], 1.0, [0.0, 1.0])
    assert apart.period is None
    assert crest_factor(apart, 2000.0) == pytest.approx(2.0, abs=1e-3)


def test_the_band_of_interest_counts_for_the_rms_and_all_lines_for_the_peak():
    wide = Multisine([1.0, 2.0, 3.0], [1.0, 2.0, 0.5])
    assert crest_factor(wide, band=(1.0, 2.0)) == pytest.approx(3.5 / math.sqrt(2.5), rel=1e-13)
    assert time_factor(wide, band=(1.0, 2.0)) == pytest.approx(3.5**2, rel=1e-13)
    assert time_factor(wide) == pytest.approx(3.5**2 / 0.25, rel=1e-13)


@pytest.mark.parametrize("lines", [25, 50, 100, 300])
def test_phases_of_schroeder(lines):
    """Schroeder (1970): -pi n (n - 1) / N for a flat spectrum, with a crest factor of about 1.7."""
    n = np.arange(1, lines + 1)
    phases = schroeder_phases(np.ones(lines))
    np.testing.assert_allclose(phases, -np.pi * n * (n - 1) / lines, rtol=1e-12, atol=1e-12)
    assert 1.6 < crest_factor(flat(lines, phases)) < 1.8


def test_rms_by_parseval_and_by_quadrature():
    made = Multisine([0.5, 1.25, 3.0], [1.0, 0.3, 2.0], [0.1, 2.0, -1.0])
    assert made.period == 4.0
    assert made.harmonics == (2, 5, 12)
    grid = made.sample(np.arange(64) / 16.0)
    assert made.rms() == pytest.approx(math.sqrt(np.mean(grid**2)), rel=1e-14)
    for duration in (0.2, 1.7, 4.0, 31.0):
        mean, _ = integrate.quad(lambda t: float(made.sample(t)) ** 2, 0.0, duration, limit=500, epsabs=1e-10)
        assert made.rms(duration) == pytest.approx(math.sqrt(mean / duration), rel=1e-9)


@pytest.mark.parametrize("duration", [None, 0.013, 0.7, 3.1])
def test_a_peak_is_that_of_a_million_samples(duration):
    made = flat(23, np.random.default_rng(5).uniform(0, 6, 23))
    dense = np.abs(made.sample(np.linspace(0.0, duration or 1.0, 1_000_001))).max()
    assert dense <= made.peak(duration) * (1 + 1e-14)
    assert made.peak(duration) == pytest.approx(dense, rel=1e-7)


def test_a_derivative_is_the_slope():
    made, t, h = flat(5, [1.0, 2.0, 3.0, 4.0, 5.0]), np.linspace(0.0, 1.0, 11), 1e-6
    slope = (made.sample(t + h) - made.sample(t - h)) / (2 * h)
    np.testing.assert_allclose(made.derivative(t), slope, rtol=1e-6, atol=1e-5)
    bend = (made.derivative(t + h) - made.derivative(t - h)) / (2 * h)
    np.testing.assert_allclose(made.derivative(t, 2), bend, rtol=1e-6, atol=1e-3)


def test_a_period_is_found_from_the_lines():
    assert Multisine([0.3, 0.7]).period == pytest.approx(10.0, rel=1e-15)
    assert Multisine(np.linspace(0.01, 25.0, 25)).period == pytest.approx(800.0, rel=1e-12)  # 0.00125 Hz divides all
    assert Multisine([2.0, 3.0], base=0.5).period == 1.0
    assert Multisine([1.0, math.pi]).period is None
    assert flat(3, period=7.0).harmonics == (1, 2, 3)


# --- what the document prints


def test_table_b2_has_its_crest_factor_over_one_beat_only():
    """Section 4.2.1 says 1.4838 for Table B.2.

    The lines 0.01 + k 1.04125 Hz are no harmonics of a period below 800 s. Over the beat of 0.96 s, sampled a thousand
    times, the printed phases give the printed number; the peak between the samples, at the end of the beat, gives 1.50;
    the record of 200 s gives 2.66.
    """
    made, beat = source_multisine(TABLE_B2)
    assert beat == pytest.approx(0.9604, abs=1e-4)
    samples = made.sample(beat * np.arange(1000) / 1000)
    assert np.abs(samples).max() / math.sqrt(np.mean(samples**2)) == pytest.approx(1.4838, abs=2e-4)
    assert crest_factor(made, beat) == pytest.approx(1.5014, abs=2e-4)
    assert crest_factor(made, 200.0) == pytest.approx(2.66, abs=5e-3)
    # The printed time factor of 200 is the length of the record: (4.8) gives 25 * 1.4838^2 / 2 = 27.5 for the printed
    # crest factor, and 88.3 over the record.
    assert time_factor(made, beat) == pytest.approx(27.5, abs=0.5)
    assert time_factor(made, 200.0) == pytest.approx(88.3, abs=0.1)


def test_table_b3_stopped_early():
    """Table B.3, to p = 2: 1.69 over one beat of 1.96 s, no better than Schroeder's phases; 2.50 over 200 s."""
    made, beat = source_multisine(TABLE_B3)
    assert crest_factor(made, beat) == pytest.approx(1.69, abs=5e-3)
    assert crest_factor(made, 200.0) == pytest.approx(2.50, abs=5e-3)


def test_the_documents_lines_are_improved_over_one_beat():
    made, beat = source_multisine(TABLE_B2)
    better = minimise_crest(made, duration=beat, starts=10)
    assert crest_factor(better, beat) < 1.42
    assert np.array_equal(better.frequencies, made.frequencies)


# --- the search for phases


@pytest.mark.parametrize("duration", [None, 0.83], ids=["period", "record"])
@pytest.mark.parametrize("power", [2, 5, 64])
def test_derivatives_of_the_norm_against_finite_differences(duration, power):
    generator = np.random.default_rng(power)
    made = Multisine.harmonic([1, 2, 5, 9], 1.0, [1.0, 0.5, 2.0, 1.0])
    norm, phases, h = Norm.of(made, power, duration), generator.uniform(0, 6, 4), 1e-5
    value, gradient, hessian = norm.derivatives(phases)
    assert value == pytest.approx(norm(phases), rel=1e-13)
    moves = h * np.eye(4)
    numeric = [(norm(phases + move) - norm(phases - move)) / (2 * h) for move in moves]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-8)
    bent = [(norm.derivatives(phases + m)[1] - norm.derivatives(phases - m)[1]) / (2 * h) for m in moves]
    np.testing.assert_allclose(hessian - 2 * power * np.outer(gradient, gradient), bent, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("power", [2, 4])
def test_a_norm_is_the_integral(power):
    """(4.11), by quadrature; p -> inf gives the peak."""
    made = flat(4, [0.3, 1.0, 5.0, 2.0])
    mean, _ = integrate.quad(lambda t: float(made.sample(t)) ** (2 * power), 0.0, 1.0, epsabs=1e-10)
    assert Norm.of(made, power)(made.phases) == pytest.approx(math.log(mean) / (2 * power), abs=1e-10)
    assert math.exp(Norm.of(made, 4096)(made.phases)) == pytest.approx(made.peak(), rel=2e-3)


def test_a_minimum_is_one_for_another_optimiser():
    """From where the search ends at p = 8, scipy's BFGS finds nothing lower."""
    found = minimise_crest(flat(12), highest=8, starts=3)
    norm = Norm.of(found, 8)
    other = optimize.minimize(norm, found.phases, jac=lambda x: norm.derivatives(x)[1], method="BFGS")
    assert norm(found.phases) - other.fun < 2e-5


def test_two_lines_reach_their_closed_form():
    found = crest_factor(minimise_crest(flat(2), starts=5))
    assert TWO_LINES - 1e-12 <= found < TWO_LINES + 1e-4


@pytest.mark.parametrize(("lines", "bar"), [(25, 1.40), (50, 1.45)])
def test_flat_lines_reach_a_small_crest_factor_in_time(lines, bar):
    """The document reached 1.4838 with 25 lines and, with 50, stopped at p = 2."""
    began = time.process_time()
    found = minimise_crest(flat(lines), starts=100)
    assert crest_factor(found) <= bar
    assert time.process_time() - began < 10.0
    dense = np.abs(found.sample(np.linspace(0.0, 1.0, 200_001))).max()
    assert dense / math.sqrt(lines / 2) <= bar


@pytest.mark.parametrize("duration", [None, 1.3])
def test_the_spectrum_is_untouched(duration):
    given_phases = Multisine.harmonic([9, 1, 4, 6], 1.0, [0.2, 1.0, 0.5, 2.0], [1.0, 2.0, 3.0, 4.0])
    found = minimise_crest(given_phases, starts=3, duration=duration)
    spectrum = np.abs(np.fft.rfft(found.sample(np.arange(64) / 64))) / 32
    expected = np.zeros(33)
    expected[[9, 1, 4, 6]] = [0.2, 1.0, 0.5, 2.0]
    np.testing.assert_allclose(spectrum, expected, atol=1e-13)
    assert crest_factor(found, duration) <= crest_factor(given_phases, duration)
    assert ((found.phases >= 0) & (found.phases < 2 * np.pi)).all()


def test_a_search_is_the_same_each_time_and_tells_how_far_it_is():
    parts = []
    first, second = (minimise_crest(flat(10), starts=4, seed=7, progress=parts.append) for _ in range(2))
    assert np.array_equal(first.phases, second.phases)
    assert parts == [0.25, 0.5, 0.75, 1.0] * 2
    assert not np.array_equal(first.phases, minimise_crest(flat(10), starts=4, seed=8).phases)


def test_one_start_is_enough_to_leave_phases_that_are_equal():
    """Where all phases are zero the gradient is zero too, at a maximum."""
    assert crest_factor(minimise_crest(flat(25), starts=1)) < 1.5


def test_a_search_ends_in_time_and_never_makes_worse():
    best = minimise_crest(flat(10), starts=30)
    again = minimise_crest(best, starts=10**9, seconds=0.2)
    assert crest_factor(again) <= crest_factor(best)


# --- shapes


def test_samples_of_a_multisine_over_whole_periods():
    made = signals.multisine(flat(10, period=2.0), rate=100.0, periods=3, channel="V1").within({"V1": 10.0})
    assert (len(made), made.duration, made.channels, made.units) == (600, 6.0, ("V1",), ("V",))
    np.testing.assert_allclose(made["V1"][:200], made["V1"][400:], atol=1e-11)
    spectrum = np.abs(np.fft.rfft(made["V1"])) / 300
    np.testing.assert_allclose(spectrum[3:31:3], 1.0, rtol=1e-11)
    assert np.delete(spectrum, np.arange(3, 31, 3)).max() < 1e-11
    assert len(signals.multisine(Multisine([1.0, math.pi]), rate=100.0, duration=1.5)) == 150


def test_steps():
    made = signals.steps(0.3, number=3, hold=0.1, rate=100.0)
    levels = made["u"].reshape(-1, 10)
    assert (levels == levels[:, :1]).all()
    np.testing.assert_allclose(levels[:, 0], [0, 0.1, 0, -0.1, 0, 0.2, 0, -0.2, 0, 0.3, 0, -0.3, 0], rtol=1e-15)


def test_ramp():
    made = signals.ramp(0.4, rate=10.0)
    assert made.duration == 60.0
    np.testing.assert_allclose(
        made["u"], np.interp(made.times, [0, 15, 45, 60], [0, 0.4, -0.4, 0]), rtol=1e-12, atol=1e-13
    )


def test_sawtooth():
    made = signals.sawtooth(0.4, number=4, period=2.0, rate=100.0)
    teeth = made["u"].reshape(4, 200)
    theirs = signal.sawtooth(2 * np.pi * (np.arange(200) / 200 + 0.25), width=0.5)
    for k, tooth in enumerate(teeth, start=1):
        np.testing.assert_allclose(tooth, 0.1 * k * theirs, atol=1e-13)


def test_opposed_sines_cancel_where_the_gain_is_the_ratio_of_strengths():
    """C.5: the beam's actuator against the blue one, weaker by 1.078."""
    made = signals.opposed_sines(0.1, frequency=1.0, duration=100.0, rate=50.0, channels=("V3", "V1"))
    nett = (made["V3"] + made["V1"] / 1.078).reshape(-1, 50)
    strength = np.sqrt(np.mean(nett**2, axis=1))
    middle = 0.5 + np.argmin(strength)
    assert 2.0 * middle / 100.0 == pytest.approx(1.078, abs=0.02)
    assert strength.min() < 0.02 * strength.max()
    asked = {"frequency": 1.0, "duration": 100.0, "rate": 50.0, "channels": ("V3", "V1")}
    wired = signals.opposed_sines(0.1, **asked, gain=(0.0, -2.0))
    assert np.array_equal(wired["V1"], -made["V1"])


@pytest.mark.parametrize(("first", "last"), [(0.1, 20.0), (20.0, 0.1), (3.0, 3.0)])
def test_chirps_are_those_of_scipy(first, last):
    asked = {"first": first, "last": last, "duration": 10.0, "rate": 200.0}
    for method, made in (
        ("linear", signals.linear_chirp(0.5, **asked)),
        ("logarithmic", signals.logarithmic_chirp(0.5, **asked)),
    ):
        theirs = 0.5 * signal.chirp(made.times, first, 10.0, last, method=method, phi=-90)
        np.testing.assert_allclose(made["u"], theirs, atol=1e-10)


# --- limits and files


def test_a_limit_is_never_passed_and_never_cut():
    asked = {"frequency": 1.0, "duration": 10.0, "rate": 100.0, "channels": ("V3", "V1")}
    with pytest.raises(ModelError) as caught:
        signals.opposed_sines(0.3, **asked).within({"V3": 0.42, "V1": 0.42})
    assert str(caught.value) == (
        "opposed_sines: V1 passes its limit of 0.42 V first at t = 7.22 s (sample 722) and reaches 0.585 V at "
        "t = 9.75 s; scale the signal by 0.71794 or less, or change the limit"
    )
    made = signals.opposed_sines(0.3, **asked)
    fits = made.scaled(0.71794).within({"V3": 0.42, "V1": 0.42})
    assert max(fits.peaks.values()) <= 0.42
    assert fits.meta["scale"] == 0.71794
    np.testing.assert_allclose(fits.values, 0.71794 * made.values, rtol=1e-15)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "ramp: no limit of V1; give one in V, such as V1: 0.3"),
        ({"V1": 1.0, "v1": 1.0}, "ramp has no channel 'v1'; did you mean 'V1'?"),
        ({"V1": 0.0}, "limit of V1 is 0 V; give a number above 0"),
    ],
)
def test_limits_are_complete(limits, message):
    with pytest.raises(ModelError) as caught:
        signals.ramp(0.3, rate=10.0, channel="V1").within(limits)
    assert str(caught.value) == message


@pytest.mark.parametrize("ending", ["csv", "parquet"])
@pytest.mark.parametrize("rate", [1000.0, 3.0, 44100.0])
def test_files_come_back(tmp_path, ending, rate):
    values = np.random.default_rng(1).normal(size=(50, 2)) * [1.0, 1e-9]
    made = Excitation("noise", rate, values, ("V1", "V2"), ("V", "mA"), {"seed": 1})
    path = made.save(tmp_path / "deep" / f"noise.{ending}")
    back = readers.read(path)
    assert (len(back), back.inputs or back.names()[1:]) == (50, ("V1", "V2"))
    assert [back.units[name] for name in back.names()] == ["s", "V", "mA"]
    assert np.column_stack([back[name] for name in back.names()[1:]]).tobytes() == made.values.tobytes()
    assert back.t.tobytes() == made.times.tobytes()
    assert back.manifest.get("meta", {}) == ({"seed": 1} if ending == "parquet" else {})
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_other_programs_read_the_files(tmp_path):
    made = signals.steps(0.3, number=2, hold=0.1, rate=100.0, channel="V1")
    path = made.save(tmp_path / "steps.csv")
    assert path.read_text().splitlines()[:2] == ["t [s],V1 [V]", "0.0,0.0"]
    np.testing.assert_array_equal(np.loadtxt(path, delimiter=",", skiprows=1)[:, 1], made["V1"])
    path = made.save(tmp_path / "steps.parquet")
    assert pq.read_table(path).column("input.V1").to_pylist() == made["V1"].tolist()
    recording = Recording.load(path)
    assert recording.inputs == ("V1",)
    assert recording.manifest["columns"]["input.V1"]["unit"] == "V"
    assert recording.manifest["meta"] == {"amplitude": 0.3, "number": 2, "hold": 0.1}


def test_bad_files_are_refused_and_leave_nothing(tmp_path):
    made = signals.ramp(0.3, rate=10.0)
    with pytest.raises(RecordError, match=r"written to \.csv or \.parquet, not to '\.xls'"):
        made.save(tmp_path / "ramp.xls")
    odd = Excitation("odd", 1.0, np.ones((3, 1)), ("u",), ("V",), {"what": object()})
    with pytest.raises(RecordError, match=r"'meta\.what' is of type object, which JSON cannot hold"):
        odd.save(tmp_path / "odd.parquet")
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot be written"):
        made.save(tmp_path / "file" / "ramp.csv")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]


# --- bad input


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Multisine([]), "the frequencies have shape (0,); give one number or a list of numbers"),
        (lambda: Multisine(["a"]), "the frequencies are not real numbers (could not convert string to float: 'a')"),
        (lambda: Multisine([1, 2, 1]), "two lines are equal: 1 Hz; give each once, with its amplitude"),
        (
            lambda: Multisine([1, -2]),
            "the frequency of line 1 (they count from 0) is -2 Hz; give numbers above 0; a line without power is left "
            "out",
        ),
        (
            lambda: Multisine([1, 2], [1, 0]),
            "the amplitude of line 1 (they count from 0) is 0; give numbers above 0; a line without power is left out",
        ),
        (lambda: Multisine([1, 2, 3], [1, 2]), "2 amplitudes for 3 lines; give one for each line, or one for all"),
        (
            lambda: Multisine([1, 2], 1, [0, np.nan]),
            "number 1 of the phases (they count from 0) is nan; give finite numbers",
        ),
        (
            lambda: Multisine([1.0, 2.5], base=1.0),
            "line 2.5 Hz is 2.5 times the base 1 Hz; give lines that are whole multiples of it, or no base",
        ),
        (
            lambda: Multisine([1.0, 2.0], base=1e-7),
            "line 2 Hz is 2e+07 times the base 1e-07 Hz, at most 1000000 are allowed; give a higher base, or none",
        ),
        (lambda: Multisine([1e-12], base=1.0), "line 1e-12 Hz is 1e-12 times the base 1 Hz; give lines that are whole"),
        (lambda: Multisine.harmonic([1, 2.5], 1.0), "harmonic 2.5 is no whole number from 1; give such as 1, 2, 3"),
        (lambda: Multisine.harmonic([1, 1], 1.0), "two harmonics are equal: 1; give each once, with its amplitude"),
        (lambda: Multisine.harmonic([1], 0), "period is 0 s; give a number above 0"),
        (lambda: flat(3).within(4, 5), "no line lies from 4 to 5 Hz; the lines are 1 to 3 Hz"),
        (
            lambda: crest_factor(Multisine([1.0, math.pi])),
            "the lines have no common period with harmonics up to 1000000; give the duration of the record, the base "
            "of which the lines are multiples, or lines from Multisine.harmonic",
        ),
        (lambda: crest_factor(flat(3), -1.0), "duration is -1 s; give a number above 0"),
        (
            lambda: crest_factor(flat(100), 1e7),
            "a record of 1e+07 s with 100 lines takes 3.2e+12 values, at most 5e+07 are looked at; take 156 s or "
            "less, or lines that share a period",
        ),
        (lambda: minimise_crest(flat(3), highest=1), "highest is 1; give a whole number of at least 2"),
        (lambda: minimise_crest(flat(3), starts=0), "starts is 0; give a whole number of at least 1"),
        (
            lambda: signals.multisine(flat(50), rate=100.0, periods=1),
            "the highest line, 50 Hz is not below half the rate 100 Hz; take a rate above 100 Hz, or leave out what "
            "lies at or above 50 Hz",
        ),
        (
            lambda: signals.multisine(flat(5, period=0.9604), rate=100.0, periods=1),
            "a period of 0.9604 s is 96.04 samples at 100 Hz, no whole number; take a period of 0.96 s, a rate of "
            "99.9583507 Hz, or a duration instead of periods",
        ),
        (
            lambda: signals.multisine(Multisine([1.0, math.pi]), rate=100.0, periods=1),
            "the lines have no common period; give a duration instead of periods",
        ),
        (
            lambda: signals.multisine(flat(5), rate=100.0),
            "periods is None and duration is None; give one of the two",
        ),
        (
            lambda: signals.sawtooth(1.0, number=3, period=0.05, rate=100.0),
            "a saw-tooth of 0.05 s has 5 samples at 100 Hz, at least 8 are needed; take 0.08 s or more, or a rate of "
            "160 Hz or more",
        ),
        (
            lambda: signals.steps(1.0, number=2.0, hold=1, rate=100.0),
            "number is 2.0; give a whole number of at least 1",
        ),
        (lambda: signals.ramp(True, rate=100.0), "amplitude is True; give a finite number"),
        (lambda: signals.ramp(1.0, rate=100.0, channel=" "), "channel ' ' is not a name; give a text without brackets"),
        (
            lambda: signals.opposed_sines(1.0, frequency=0.1, duration=5.0, rate=100.0, channels=("a", "b")),
            "5 s hold no period of 0.1 Hz; take 10 s or more",
        ),
        (
            lambda: signals.opposed_sines(1.0, frequency=1.0, duration=5.0, rate=100.0, channels=("a", "a")),
            "channel 'a' appears more than once; give each channel a name of its own",
        ),
        (
            lambda: signals.linear_chirp(1.0, first=1.0, last=50.0, duration=5.0, rate=100.0),
            "the chirp's 50 Hz is not below half the rate 100 Hz; take a rate above 100 Hz, or leave out what lies at "
            "or above 50 Hz",
        ),
        (
            lambda: Excitation("x", 1.0, np.ones((3, 2)), ("a",), ("V",)),
            "x: values of shape (3, 2) for 1 channel; give an array (samples, 1) with at least one sample",
        ),
        (
            lambda: Excitation("x", 1.0, np.ones((3, 2)), ("a", "b"), ("V",)),
            "x: 1 units for 2 channels; give one for each, or one for all",
        ),
        (
            lambda: Excitation("x", 1.0, np.ones((3, 1)), ("a",), ("[V]",)),
            "x: the units are ('[V]',); give texts without brackets, such as 'V'",
        ),
        (
            lambda: Excitation("x", 1.0, [["a"]], ("a",), ("V",)),
            "x: the values are not real numbers (could not convert string to float: 'a'); give an array",
        ),
    ],
)
def test_bad_input_is_refused_with_the_remedy(call, message):
    with pytest.raises(ModelError) as caught:
        call()
    assert str(caught.value).startswith(message)


SHAPES = {
    "steps": (signals.steps, {"amplitude": 1.0, "number": 2, "hold": 1.0, "rate": 100.0}),
    "ramp": (signals.ramp, {"amplitude": 1.0, "duration": 1.0, "rate": 100.0}),
    "sawtooth": (signals.sawtooth, {"amplitude": 1.0, "number": 2, "period": 1.0, "rate": 100.0}),
    "opposed_sines": (
        lambda **k: signals.opposed_sines(**k, channels=("a", "b")),
        {"amplitude": 1.0, "frequency": 5.0, "duration": 1.0, "rate": 100.0},
    ),
    "linear_chirp": (
        signals.linear_chirp,
        {"amplitude": 1.0, "first": 1.0, "last": 5.0, "duration": 1.0, "rate": 100.0},
    ),
    "logarithmic_chirp": (
        signals.logarithmic_chirp,
        {"amplitude": 1.0, "first": 1.0, "last": 5.0, "duration": 1.0, "rate": 100.0},
    ),
    "multisine": (
        lambda **k: signals.multisine(flat(3), **k),
        {"duration": 1.0, "rate": 100.0},
    ),
}
EACH_NUMBER = [(shape, name) for shape, (_, asked) in SHAPES.items() for name in asked]


@pytest.mark.parametrize(("shape", "name"), EACH_NUMBER, ids=lambda x: x)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "1", None, True])
def test_each_number_of_each_shape_is_checked(shape, name, value):
    make, asked = SHAPES[shape]
    assert np.isfinite(make(**asked).values).all()
    with pytest.raises(ModelError, match="give"):
        make(**{**asked, name: value})


NUMBERS = st.floats(width=32) | st.integers(-3, 40)


@settings(max_examples=150, deadline=None)
@given(
    lines=st.lists(NUMBERS, max_size=5),
    amplitudes=NUMBERS | st.lists(NUMBERS, max_size=5),
    phases=NUMBERS | st.lists(NUMBERS, max_size=5),
    base=st.none() | NUMBERS,
)
def test_a_multisine_is_valid_or_refused(lines, amplitudes, phases, base):
    try:
        made = Multisine(lines, amplitudes, phases, base)
    except MaskingError as error:
        assert ";" in str(error)
        return
    assert len(made.amplitudes) == len(made.phases) == len(set(made.frequencies.tolist())) == len(lines)
    assert made.frequencies.min() > 0
    assert made.amplitudes.min() > 0
    assert np.isfinite(made.phases).all()
    assert 0.0 < made.rms() <= made.amplitudes.sum()
    if made.harmonics is not None:
        np.testing.assert_allclose(np.array(made.harmonics) / made.period, made.frequencies, rtol=1e-8)


@settings(max_examples=60, deadline=None)
@given(
    channels=st.lists(st.text(min_size=1, max_size=5), min_size=1, max_size=3),
    unit=st.text(max_size=4),
    rate=st.floats(1e-3, 1e6),
)
def test_an_excitation_is_refused_or_comes_back(tmp_path_factory, channels, unit, rate):
    try:
        made = Excitation("x", rate, np.ones((4, len(channels))), tuple(channels), (unit,) * len(channels))
        folder = tmp_path_factory.mktemp("x")
        back = Recording.load(made.save(folder / "x.parquet"))
        assert back.names() == ("t", *(f"input.{name}" for name in made.channels))
        assert [back.manifest["columns"][name]["unit"] for name in back.names()[1:]] == [*made.units]
        with made.save(folder / "x.csv").open(newline="") as file:
            head, *rows = csv.reader(file)
        assert head == ["t [s]", *(f"{name} [{unit}]" for name in made.channels)]
        assert [[*map(float, row)] for row in rows] == np.column_stack([made.times, made.values]).tolist()
    except MaskingError as error:
        assert "give" in str(error)


@settings(max_examples=60, deadline=None)
@given(
    harmonics=st.lists(st.integers(1, 40), min_size=1, max_size=6, unique=True),
    data=st.data(),
    delay=st.floats(0.0, 1.0),
    factor=st.floats(1e-3, 1e3),
)
def test_laws_of_the_crest_factor(harmonics, data, delay, factor):
    """rms <= peak <= sum of amplitudes; neither a delay nor a factor changes the crest factor."""
    phases = data.draw(st.lists(st.floats(0.0, 6.3), min_size=len(harmonics), max_size=len(harmonics)))
    made = Multisine.harmonic(harmonics, 1.0, np.arange(1.0, len(harmonics) + 1.0), phases)
    crest = crest_factor(made)
    assert 1.0 <= crest <= made.amplitudes.sum() / made.rms() * (1 + 1e-12)
    assert crest_factor(made.scaled(factor)) == pytest.approx(crest, rel=1e-11)
    assert crest_factor(made.with_phases(made.phases + 2 * np.pi * delay * made.frequencies)) == pytest.approx(
        crest, rel=1e-9
    )
    assert crest_factor(made, 1.0) == pytest.approx(crest, rel=1e-9)


def test_names_of_the_package_are_there():
    assert all(hasattr(signals, name) for name in signals.__all__)
    assert [a for a, b in itertools.pairwise(signals.__all__) if a > b] == []
