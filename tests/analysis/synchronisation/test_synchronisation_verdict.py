"""The verdict on a record of two oscillators: the digest's section 7, closed forms."""

import functools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from masking.analysis.synchronisation import (
    interpolate,
    period,
    synchronisation,
    synchronisation_time,
)
from masking.analysis.synchronisation.measures import Oscillation
from masking.errors import RecordError
from masking.model.modelling.model import load_model

T = np.arange(0.0, 400.0, 0.05)


@functools.cache
def motion(name, end):
    run = load_model(name).dimensionless().simulate(np.arange(0.0, end + 0.025, 0.05), tolerance=1e-12)
    return run.times, run.positions[:, 0], run.positions[:, 1]


def noisy(a, b, size, seed=1):
    rng = np.random.default_rng(seed)
    return [x + size * np.abs(x).max() * rng.standard_normal(len(x)) for x in (a, b)]


# The figures of the source document, against the digest's section 7.


def test_figure_5_1_identical_oscillators_end_in_anti_phase():
    t, a, b = motion("setup_identical", 1500.0)
    found = synchronisation(t, a, b)
    assert (found.kind, found.ratio, found.is_synchronised) == ("anti-phase", (1, 1), True)
    assert found.alpha == pytest.approx(1.0, rel=1e-4)
    assert abs(found.phase) == pytest.approx(0.9994 * np.pi, rel=1e-3)
    assert found.periods == pytest.approx((2 * np.pi, 2 * np.pi), rel=1e-5)
    # The digest's 1.0e-3 has T/2 rounded to whole samples, from which most of it comes (test_thesis).
    last, half = t >= 1200.0, 63
    assert np.abs(a[last][:-half] - found.alpha * b[last][half:]).max() == pytest.approx(1.0e-3, rel=0.05)
    assert found.eps < 1.0e-3


def test_figure_5_3_oscillators_that_differ_die_out_in_their_slowest_mode():
    # Its |xi1/xi2| = 3.064 and phase 0.973 pi: a = alpha b(t + T/2) fits best with 3.064 cos(0.027 pi) = 3.053.
    found = synchronisation(*motion("setup_undamped", 1200.0))
    assert found.kind == "anti-phase"
    assert found.alpha == pytest.approx(3.053, rel=0.05)
    assert abs(found.phase) == pytest.approx(0.973 * np.pi, rel=0.05)
    assert math.isnan(found.time)  # sin(0.027 pi) = 0.085 of the amplitude is more than the 0.05 asked for


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("setup_identical", 1500.0),
        ("setup_undamped", 1200.0),
        ("duffing", 2500.0),
        ("huygens", 400.0),
        ("discs_eccentric", 900.0),
    ],
)
def test_noise_changes_alpha_by_less_than_a_percent(name, end):
    t, a, b = motion(name, end)  # noise of 1e-2 of the largest motion, which at last is down to a tenth of it
    clean, found = synchronisation(t, a, b), synchronisation(t, *noisy(a, b, 1e-2))
    assert found.kind == clean.kind == "anti-phase"
    assert found.alpha == pytest.approx(clean.alpha, rel=0.01)
    assert abs(found.phase) == pytest.approx(abs(clean.phase), abs=0.01 * np.pi)


@pytest.mark.parametrize("name", ["setup_identical", "setup_undamped"])
def test_a_record_cut_within_a_period_and_one_that_drifts_tell_the_same(name):
    t, a, b = motion(name, 1200.0)
    whole = synchronisation(t, a, b)
    for cut in (0.7, 1.6, 2.9, 3.6, 5.5):
        kept = t <= t[-1] - cut
        found = synchronisation(t[kept], a[kept], b[kept])
        assert abs(math.remainder(found.phase - whole.phase, 2 * np.pi)) < 0.01 * np.pi
        assert found.alpha == pytest.approx(whole.alpha, rel=0.01)
    drifting = synchronisation(t, a + 0.3 * (t / t[-1]) ** 2, b - 0.1 * t / t[-1])
    assert drifting.alpha == pytest.approx(whole.alpha, rel=1e-3)
    assert drifting.phase == pytest.approx(whole.phase, abs=1e-3)


# Kinds of motion.


@settings(max_examples=40, deadline=None)
@given(st.floats(0.4, 2.5), st.floats(0.0, 6.3), st.floats(0.2, 5.0), st.sampled_from([0.0, 0.01, 0.1]))
def test_two_uncoupled_oscillators_are_never_synchronised(ratio, phase, size, noise):
    ratios = {n / m for n in range(1, 6) for m in range(1, 6)}
    assume(min(abs(ratio / r - 1) for r in ratios) > 2e-3)  # 0.8 rad over the record, and more of the multiples
    found = synchronisation(T, *noisy(np.cos(T), size * np.cos(ratio * T + phase), noise))
    assert not found.is_synchronised, str(found)


def test_two_uncoupled_oscillators_of_other_frequencies_are_not_synchronised_while_they_decay():
    decay = np.exp(-T / 300)
    assert not synchronisation(T, decay * np.cos(T), decay**2 * np.cos(1.004 * T)).is_synchronised


def test_noise_is_not_synchronised():
    rng = np.random.default_rng(3)
    kinds = [synchronisation(T[:3000], *rng.standard_normal((2, 3000))).kind for _ in range(50)]
    assert set(kinds) == {"not synchronised"}


@pytest.mark.parametrize(("n", "m"), [(1, 2), (2, 1), (2, 3), (3, 1), (5, 2)])
def test_locks_of_other_orders(n, m):
    # m periods of one last as long as n of the other, and n arg a - m arg b = n 0.4 - m 0.1.
    a, b = np.cos(m * T + 0.4), 0.3 * np.cos(n * T + 0.1)
    for motions in ((a, b), noisy(a, b, 0.01)):
        found = synchronisation(T, *motions)
        assert (found.kind, found.ratio) == ("locked", (n, m))
        assert found.phase == pytest.approx(math.remainder(0.4 * n - 0.1 * m, 2 * np.pi), abs=0.02)
        assert f"locked {n}:{m}" in str(found)


def test_a_driven_van_der_pol_oscillator_locks_one_to_two():
    """A van der Pol oscillator whose natural frequency is off by 1 %, driven at twice it through its stiffness."""
    drive = 2.0

    def rate(t, y):
        return y[1], 0.2 * (1 - y[0] ** 2) * y[1] - 0.98 * y[0] * (1 + 0.3 * np.cos(drive * t))

    t = np.arange(0.0, 600.0, 0.05)
    moved = solve_ivp(rate, (0, t[-1]), [0.5, 0.0], "DOP853", t, rtol=1e-9, atol=1e-9).y[0]
    found = synchronisation(t, moved, np.cos(drive * t))
    assert (found.kind, found.ratio) == ("locked", (2, 1))
    assert found.periods[0] == pytest.approx(2 * found.periods[1], rel=1e-4)


def test_in_phase_and_a_phase_between():
    found = synchronisation(T, 2 * np.cos(T), np.cos(T) + 3)
    assert (found.kind, found.time) == ("in-phase", 0.0)
    assert found.alpha == pytest.approx(2.0, rel=1e-4)
    assert found.eps < 1e-3
    found = synchronisation(T, np.cos(T), 0.5 * np.cos(T + 0.6))
    assert (found.kind, found.ratio) == ("locked", (1, 1))
    assert found.phase == pytest.approx(-0.6, abs=1e-3)
    assert found.alpha == pytest.approx(2.0, rel=1e-3)
    assert "locked -0.191 pi apart" in str(found)


def test_beats():
    apart = synchronisation(T, np.cos(T), np.cos(1.05 * T))
    assert apart.kind == "beating"
    assert apart.beat == pytest.approx(2 * np.pi / 0.05, rel=0.01)
    assert str(apart) == f"a and b beat with a period of {apart.beat:.4g}: they are not synchronised."
    exchange = synchronisation(T, np.cos(T) + np.cos(1.06 * T), np.cos(T) - np.cos(1.06 * T))
    assert exchange.kind == "beating"
    assert exchange.beat == pytest.approx(2 * np.pi / 0.06, rel=0.01)


def test_death_of_one_oscillator():
    found = synchronisation(T, *noisy(np.cos(T), np.cos(T) * np.exp(-T / 40), 0.01), names=("th1", "th2"))
    assert (found.kind, found.dead, str(found)) == ("death", "th2", "th2 has come to rest.")
    assert synchronisation(T, np.zeros(len(T)), np.cos(T)).dead == "a"
    assert synchronisation(T, *[np.cos(T) * np.exp(-T / 30)] * 2).dead == "each of them"


def test_a_small_one_that_has_always_been_small_is_not_dead():
    found = synchronisation(T, np.sin(T), -0.02 * np.sin(T))
    assert (found.kind, found.alpha) == ("anti-phase", pytest.approx(50.0, rel=1e-3))
    silent = synchronisation(T, np.sin(T), 1e-3 * np.random.default_rng(0).standard_normal(len(T)))
    assert silent.dead == "b"


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_frequencies_that_differ_a_little_are_no_lock_in_noise(noise):
    # 0.2 to 3 rad of turn over 500 units of time.
    rng = np.random.default_rng(11)
    for apart in np.linspace(0.2, 3.0, 25) / 500.0:
        t = np.linspace(0.0, 500.0, 8000)
        a, b = np.sin(t), np.sin((1.0 + apart) * t + rng.uniform(0.0, 6.0))
        found = synchronisation(t, *(x + noise * rng.standard_normal(len(t)) for x in (a, b)))
        assert not found.is_synchronised


@pytest.mark.parametrize("wrong", [{"eps": -1.0}, {"fraction": 0.0}, {"fraction": 2.0}])
def test_settings_out_of_range(wrong):
    with pytest.raises(RecordError, match="eps is positive, fraction above 0 and at most 1"):
        synchronisation(T, np.sin(T), np.sin(T), **wrong)


def test_the_time_of_definition_8_1():
    # |g| = |a + b| = 2 exp(-t/50) |cos t|, whose envelope falls to 0.05 of the amplitude of a at 50 ln(2/0.05).
    s = np.exp(-T / 50)
    found = synchronisation(T, np.cos(T) * s + np.sin(T), np.cos(T) * s - np.sin(T), eps=0.05)
    assert found.kind == "anti-phase"
    assert found.time == pytest.approx(50 * math.log(2 / 0.05), rel=0.01)
    assert synchronisation_time(T, 2 * s, 0.1) == pytest.approx(50 * math.log(2 / 0.1), rel=1e-4)
    assert synchronisation_time(T, s, 2.0) == 0.0
    assert math.isnan(synchronisation_time(T, np.ones(len(T)), 0.5))


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("drift", [0.0, 5.0, -40.0])
def test_period_amid_noise_and_drift(noise, drift):
    true, rng = 7.3, np.random.default_rng(2)
    a = np.cos(2 * np.pi * T / true + 1) + drift * (T / T[-1]) ** 2 + noise * rng.standard_normal(len(T))
    # Rife and Boorstyn's bound of the frequency is sqrt(24 / (snr N)) / record, a tenth of a period in 8000 samples.
    assert period(T, a) == pytest.approx(true, rel=1e-5 + 2e-3 * noise)
    # Four coefficients from 8000 samples: the rms of what is taken out too much is noise sqrt(4 / 8000) = 0.022 noise,
    # more where the window leaves few samples.
    wrong = Oscillation.of(a).series - (a - drift * (T / T[-1]) ** 2)
    assert np.sqrt(np.mean(wrong**2)) < 1e-3 + 0.1 * noise


@pytest.mark.parametrize("bad", ["short", "shape", "nan", "order"])
def test_a_record_that_cannot_be_judged(bad):
    t, a = T[:100].copy(), np.cos(T[:100])
    series = {"short": (t[:9], a[:9], a[:9]), "shape": (t, a, a[:50]), "nan": (t, a * np.nan, a), "order": (-t, a, a)}
    with pytest.raises(RecordError, match=r"16 samples|finite"):
        synchronisation(*series[bad])
    assert synchronisation(t, a, 2 * a).kind == "not synchronised"  # fewer than three periods


def test_eps_of_anti_phase_is_the_largest_residual_of_its_definition():
    t, a, b = motion("setup_identical", 1500.0)
    verdict = synchronisation(t, a, b)
    half = verdict.periods[0] / 2
    last = (t >= verdict.start) & (t + half <= t[-1])
    residual = a[last] - verdict.alpha * interpolate(t, b, t[last] + half)
    assert np.abs(residual).max() == pytest.approx(verdict.eps, rel=0.02)
