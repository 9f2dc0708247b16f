"""Least squares: minima that are known in closed form or that scipy finds, bounds, priors, and blocks eliminated."""

import numpy as np
import pytest
from scipy import linalg, optimize

from masking.compile.numerics.least_squares import (
    NO_BOUNDS,
    Box,
    Damping,
    Linearised,
    Patience,
    System,
    minimise,
    minimise_residuals,
)
from masking.errors import IntegrationError

DAMPING = Damping(1e-3, least=1e-12, most=1e12)
SETTINGS = {"rounds": 100, "tolerance": lambda at: 1e-14 * max(at.cost, 1e-300)}


def problem(residuals, jacobian):
    """Return the linearised problem of residuals r = measured - model, whose derivatives are -J."""

    def linearised(x):
        r, j = residuals(x), jacobian(x)
        return Linearised(float(r @ r), System(j.T @ j, j.T @ r), r)

    return linearised


def rosenbrock(x):
    return -np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def slopes(x):
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def test_the_valley_of_rosenbrock_is_followed_to_its_end():
    found = minimise(problem(rosenbrock, slopes), np.array([-1.2, 1.0]), NO_BOUNDS, DAMPING, **SETTINGS)
    np.testing.assert_allclose(found.x, [1.0, 1.0], rtol=1e-9)
    assert found.converged
    assert found.rounds < 60


def test_a_minimum_beyond_a_bound_ends_at_the_bound():
    box = Box(np.array([-2.0, -2.0]), np.array([0.5, 2.0]))
    found = minimise(problem(rosenbrock, slopes), np.array([-1.2, 1.0]), box, DAMPING, **SETTINGS)
    scipy = optimize.least_squares(rosenbrock, [-1.2, 1.0], bounds=([-2.0, -2.0], [0.5, 2.0]), xtol=1e-14)
    assert found.x[0] == pytest.approx(scipy.x[0], abs=1e-6)
    assert found.at.cost == pytest.approx(2.0 * scipy.cost, rel=1e-3)


def test_residuals_alone_lead_to_the_minimum_that_scipy_finds():
    box = Box(np.array([-2.0, -2.0]), np.array([0.5, 2.0]))
    found = minimise_residuals(rosenbrock, np.array([-1.2, 1.0]), box, sizes=np.ones(2), rounds=100)
    scipy = optimize.least_squares(rosenbrock, [-1.2, 1.0], bounds=([-2.0, -2.0], [0.5, 2.0]), xtol=1e-14)
    assert found.at.cost == pytest.approx(2.0 * scipy.cost, rel=1e-3)
    free = minimise_residuals(rosenbrock, np.array([-1.2, 1.0]), NO_BOUNDS, sizes=np.ones(2), rounds=100)
    np.testing.assert_allclose(free.x, [1.0, 1.0], rtol=1e-6)


def test_a_direction_in_which_the_cost_hardly_bends_is_followed_to_its_minimum():
    """A ratio is known a million times better than its parts, as that of mass and stiffness is from a free motion."""
    j, y = np.array([[1e6, -1e6], [1.0, 0.0], [0.0, 1.0]]), np.array([0.0, 1.0, 1.0])
    settings = {"rounds": 10, "tolerance": lambda at: 1e-4}
    found = minimise(
        problem(lambda x: y - j @ x, lambda _: j), np.full(2, 1.5), NO_BOUNDS, Damping(1e-6, 1e-13, 1e8), **settings
    )
    np.testing.assert_allclose(found.x, 1.0, atol=0.02)  # a gram matrix of condition 1e12


def test_a_linear_problem_takes_one_step():
    rng = np.random.default_rng(1)
    size = np.array([1.0, 1e-6, 1e6, 1.0])
    j, y = rng.standard_normal((50, 4)) * size, rng.standard_normal(50)
    found = minimise(
        problem(lambda x: y - j @ x, lambda _: j), np.zeros(4), NO_BOUNDS, Damping(0.0, least=0.0, most=1.0), **SETTINGS
    )
    np.testing.assert_allclose(found.x, np.linalg.lstsq(j / size, y, rcond=None)[0] / size, rtol=1e-9)
    assert found.rounds <= 3


def test_a_prior_is_a_measurement_of_the_unknowns_and_the_covariance_that_of_both():
    rng = np.random.default_rng(2)
    j, y, mean, deviation = rng.standard_normal((20, 3)), rng.standard_normal(20), np.ones(3), np.array([0.1, 2.0, 1.0])
    dense = System(j.T @ j, j.T @ y).with_prior(mean, deviation)
    stacked = np.vstack([j, np.diag(1.0 / deviation)])
    expected = np.linalg.lstsq(stacked, np.concatenate([y, mean / deviation]), rcond=None)[0]
    np.testing.assert_allclose(dense.step(0.0)[0], expected, rtol=1e-10)
    np.testing.assert_allclose(dense.covariance(), linalg.inv(stacked.T @ stacked), rtol=1e-10)


def test_unknowns_that_are_fixed_stay():
    rng = np.random.default_rng(3)
    j, y = rng.standard_normal((20, 3)), rng.standard_normal(20)
    step, _ = System(j.T @ j, j.T @ y, np.array([False, True, False])).step(0.0)
    assert step[1] == 0.0
    np.testing.assert_allclose(step[[0, 2]], np.linalg.lstsq(j[:, [0, 2]], y, rcond=None)[0], rtol=1e-10)


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_blocks_are_eliminated_without_changing_the_step(damping):
    rng = np.random.default_rng(4)
    k, b, count = 3, 2, 5
    whole, gradient = np.zeros((k + b * count,) * 2), np.zeros(k + b * count)
    for i in range(count):
        j, y = rng.standard_normal((30, k + b)), rng.standard_normal(30)
        own = np.r_[0:k, k + i * b : k + (i + 1) * b]
        whole[np.ix_(own, own)] += j.T @ j
        gradient[own] += j.T @ y
    fixed = np.arange(len(gradient)) == 1
    for known in (None, fixed):
        condensed = System(whole, gradient, known, shared=k, block=b)
        for found, expected in zip(condensed.step(damping), System(whole, gradient, known).step(damping), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    inverse = linalg.inv(whole)[:k, :k]
    np.testing.assert_allclose(condensed.information(), linalg.inv(inverse), rtol=1e-9)
    np.testing.assert_allclose(condensed.covariance(), inverse, rtol=1e-9)


def test_a_step_goes_part_of_the_way_to_a_bound_and_doubles_at_most_what_is_positive():
    box = Box(np.array([0.0, 0.0, -np.inf]), np.array([1.0, np.inf, np.inf]), np.array([False, True, True]))
    np.testing.assert_allclose(box.after(np.array([0.5, 1.0, 1.0, 1.0]), np.full(4, 9.0)), [0.85, 2.0, 10.0, 10.0])
    np.testing.assert_allclose(box.after(np.array([0.5, 1.0, 1.0, 1.0]), np.full(4, -9.0)), [0.15, 0.3, -8.0, -8.0])


def test_a_step_to_where_the_problem_has_no_value_is_made_shorter():
    def root(x):
        if x[0] < 0.0:
            raise IntegrationError("no motion")
        return np.sqrt(x) - 0.1

    found = minimise(
        problem(lambda x: -root(x), lambda x: np.diag(0.5 / np.sqrt(x))), np.array([4.0]), NO_BOUNDS, DAMPING,
        **SETTINGS,
    )  # fmt: skip
    assert found.x[0] == pytest.approx(0.01, rel=1e-6)


def test_a_step_to_where_derivatives_are_not_finite_is_made_shorter():
    def slope(x):
        return np.diag(np.where(x > 0.2, 0.5 / np.sqrt(np.abs(x)), np.inf))

    made = problem(lambda x: 0.5 - np.sqrt(np.abs(x)), slope)  # the first full step goes from 4 to -2
    assert minimise(made, np.array([4.0]), NO_BOUNDS, DAMPING, **SETTINGS).x[0] == pytest.approx(0.25, rel=1e-6)
    with pytest.raises(IntegrationError, match="derivatives of the motion by the parameters"):
        minimise(made, np.array([0.1]), NO_BOUNDS, DAMPING, **SETTINGS)


def test_a_fit_without_hope_is_given_up():
    """Rosenbrock's function is 24.2 at (-1.2, 1): what a step of the linear problem takes."""
    steps = []

    def is_hopeless(now, tried, expected):
        steps.append((now, tried, expected))
        return now < 4.5

    found = minimise(
        problem(rosenbrock, slopes), np.array([-1.2, 1.0]), NO_BOUNDS, DAMPING,
        patience=Patience(is_hopeless=is_hopeless), **SETTINGS,
    )  # fmt: skip
    assert 0.0 < found.at.cost < 4.5
    assert steps[0][0] == pytest.approx(24.2) and steps[0][2] == pytest.approx(24.2)


@pytest.mark.parametrize(("least", "left"), [(0.0, 0.0), (30.0, 24.2)])
def test_a_fit_that_is_expected_to_gain_too_little_is_given_up(least, left):
    """Rosenbrock's function is 24.2 at (-1.2, 1), which is all that a step can take."""
    found = minimise(
        problem(rosenbrock, slopes),
        np.array([-1.2, 1.0]),
        NO_BOUNDS,
        DAMPING,
        patience=Patience(lambda _: least),
        **SETTINGS,
    )
    assert found.at.cost == pytest.approx(left, abs=1e-9)
