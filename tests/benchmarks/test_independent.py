"""The second generator against closed forms, and what discovery makes of some of its records."""

import math

import numpy as np
import pytest

from tests.benchmarks.answers.suites import discovered_second, judged_second
from tests.benchmarks.independent.cases import REAL, Case
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
    element = Element(ONE, lambda d, v, z, t: K * (d - min(max(d, -half), half)), edges=(-half, half))
    period = 2.0 * math.pi / W + 4.0 * half / (W * (1.0 - half))
    found = simulated(Machine(ONE, [element], np.eye(1)), np.zeros((101, 1)), 100.0 / period, start=ONE)
    assert found.displacement[100, 0] == pytest.approx(1.0, abs=1e-6)


def test_a_jump_of_damping_is_met_at_its_edge():
    """From rest at 1, a spring; below 0 a damper beside it: the minimum is that of a damped half swing."""
    damping = 10.0
    element = Element(ONE, lambda d, v, z, t: K * d + (damping * v if d < 0.0 else 0.0), edges=(0.0,))
    found = simulated(Machine(ONE, [element], np.eye(1)), np.zeros((4001, 1)), 20000.0, start=ONE)
    ratio = damping / (2.0 * W)
    angle = math.acos(ratio)
    assert found.displacement.min() == pytest.approx(-math.exp(-ratio * angle / math.sqrt(1.0 - ratio**2)), abs=1e-6)


def test_an_imperfect_rig_has_the_effect_of_a_good_one():
    good, real = Case(3, "bilinear_spring", rate=200.0, seconds=4.0), Case(3, "bilinear_spring", REAL, 200.0, 4.0)
    assert good.truth == real.truth
    np.testing.assert_array_equal(good.told[0], real.told[0])
    off = (real.told[1] - good.told[1]).std(axis=0) / good.told[1].std(axis=0)
    assert (off > 3e-3).all()
    assert (off < 0.3).all()
    steps = np.diff(np.unique(real.told[1][:, 0]))
    np.testing.assert_allclose(steps / steps.min(), np.round(steps / steps.min()), atol=1e-3)


def test_a_relaxing_spring_decays_as_its_characteristic_polynomial_says():
    k, tau = 200.0, 0.05
    found = moved(Element(ONE, lambda d, v, z, t: K * d + k * z, rate=lambda d, v, z, t: v - z / tau), seconds=1.0)
    roots = np.roots([tau, 1.0, (K + k) * tau, K])
    # x = sum a_i exp(s_i t) with x = 1, x' = 0, x'' = -K at first
    a = np.linalg.solve(np.vander(roots, increasing=True).T, [1.0, 0.0, -K])
    expected = (a * np.exp(np.outer(np.arange(200) / 200.0, roots))).sum(axis=1).real
    np.testing.assert_allclose(found.displacement[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("effect", [pytest.param("dry_friction", marks=pytest.mark.search), "play"])
def test_what_hides_in_a_short_record_is_named(effect, tmp_path):
    case = Case(4, effect, rate=200.0, seconds=8.0)
    found = discovered_second(case, tmp_path)()
    assert judged_second(case, found).right, found


@pytest.mark.search
@pytest.mark.parametrize("effect", ["stop", "relaxation", "bilinear_spring", "delay", "maxwell_element"])
def test_what_hides_in_a_record_is_named(effect, tmp_path):
    case = Case(2, effect)
    found = discovered_second(case, tmp_path)()
    assert judged_second(case, found).right, found


@pytest.mark.search
def test_friction_that_falls_with_the_rate_is_named_where_a_drag_leaves_less_than_dry_friction(tmp_path):
    case = Case(46_001, "stribeck_friction", rate=250.0)
    found = discovered_second(case, tmp_path)()
    assert judged_second(case, found).right, found
