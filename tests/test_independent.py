"""The second generator against closed forms, and what discovery makes of some of its records."""

import math

import numpy as np
import pytest

from tests.benchmarks.independent.__main__ import judged
from tests.benchmarks.independent.cases import Case
from tests.benchmarks.independent.machine import Contact, Element, Machine, simulated

ONE = np.array([1.0])
K, W = 400.0, 20.0  # of a mass of 1


def moved(element, contacts=(), seconds=4.0):
    """Return the free motion from 1 of a mass of 1, at 200 Hz."""
    machine = Machine(ONE, [element], np.eye(1), contacts)
    return simulated(machine, np.zeros((round(200 * seconds), 1)), 200.0, start=ONE)


def spring(d, v, z, t):
    return K * d


def test_friction_lets_extremes_fall_until_it_holds_the_mass():
    level = 30.0  # extremes fall by 2 level/k = 0.15; within 0.075 the mass stays
    found = moved(Element(ONE, spring), [Contact(ONE, lambda d, v: level, level)])
    assert found.displacement[-1, 0] == pytest.approx((1.0 - 7 * 0.15) * (-1.0) ** 7, abs=1e-6)
    assert found.rate[-1, 0] == 0.0
    assert found.stuck[-1] == 1


def test_play_has_the_period_of_two_half_swings_and_two_gaps():
    half = 0.2
    found = moved(Element(ONE, lambda d, v, z, t: K * (d - min(max(d, -half), half))), seconds=1.0)
    period = 2.0 * math.pi / W + 4.0 * half / (W * (1.0 - half))
    assert np.interp(period, np.arange(200) / 200.0, found.displacement[:, 0]) == pytest.approx(1.0, abs=5e-3)


def test_a_relaxing_spring_decays_as_its_characteristic_polynomial_says():
    k, tau = 200.0, 0.05
    found = moved(Element(ONE, lambda d, v, z, t: K * d + k * z, rate=lambda d, v, z, t: v - z / tau), seconds=1.0)
    roots = np.roots([tau, 1.0, (K + k) * tau, K])
    # x = sum a_i exp(s_i t) with x = 1, x' = 0, x'' = -K at first
    a = np.linalg.solve(np.vander(roots, increasing=True).T, [1.0, 0.0, -K])
    expected = (a * np.exp(np.outer(np.arange(200) / 200.0, roots))).sum(axis=1).real
    np.testing.assert_allclose(found.displacement[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("effect", ["dry_friction", "play"])
def test_what_hides_in_a_short_record_is_named(effect):
    how, words = judged(Case(4, effect, rate=200.0, seconds=8.0))
    assert how == "strict", words


@pytest.mark.search
@pytest.mark.parametrize("effect", ["stop", "relaxation", "bilinear_spring", "delay", "maxwell_element"])
def test_what_hides_in_a_record_is_named(effect):
    how, words = judged(Case(2, effect))
    assert how == "strict", words
