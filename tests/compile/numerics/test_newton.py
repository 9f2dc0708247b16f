"""Newton's method: roots known in closed form, underdetermined and damped, and where a search without a root ended."""

import numpy as np
import pytest

from masking.compile.numerics.newton import equilibrium, jacobian, root
from masking.errors import RootError


def circle_and_line(x):
    """Residual and slope of |x|^2 = 2 and x1 = x2, whose roots are (1, 1) and (-1, -1)."""
    return np.array([x @ x - 2.0, x[0] - x[1]]), np.array([2.0 * x, [1.0, -1.0]])


def arctangent(x):
    """Residual and slope of arctan(x) = 0: from |x| > 1.392 undamped steps grow."""
    return np.arctan(x), np.diag(1.0 / (1.0 + x * x))


def test_roots_in_closed_form():
    for start, expected in (([2.0, 0.5], [1.0, 1.0]), ([-0.3, -3.0], [-1.0, -1.0])):
        found = root(circle_and_line, start, error=1e-14)
        np.testing.assert_allclose(found.at, expected, atol=1e-14)
        np.testing.assert_allclose(found.slope, circle_and_line(found.at)[1])


def test_fewer_equations_than_unknowns_move_as_little_as_they_can():
    found = root(lambda x: (np.array([x.sum() - 3.0]), np.ones((1, 3))), np.zeros(3), error=1e-14)
    np.testing.assert_allclose(found.at, 1.0)


def test_shortened_steps_reach_a_root_that_whole_steps_leave():
    with pytest.raises(RootError, match=r"Newton's method ended at \[.+\], where the residual is 1\.57"):
        root(arctangent, [3.0], error=1e-12, rounds=5)
    assert root(arctangent, [3.0], error=1e-12, longest=1.0).at == pytest.approx(0.0, abs=1e-12)


def test_error_may_depend_on_the_unknowns():
    found = root(lambda x: (x * x - 1e12, np.diag(2.0 * x)), [2e6], error=lambda x: 1e-12 * float(x[0] ** 2))
    assert found.at == pytest.approx(1e6, rel=1e-12)


def test_what_is_not_finite_ends_the_search():
    with pytest.raises(RootError, match=r"ended at \[2\.0\], where the residual is nan"):
        root(lambda x: (np.full(1, np.nan), np.eye(1)), [2.0])


def test_slope_by_central_differences_is_exact_for_a_square():
    at = np.array([1.0, -2.0])
    slope = jacobian(lambda x: np.array([x[0] ** 2, x[0] * x[1], x[1]]), at, np.array([0.5, 0.25]))
    np.testing.assert_allclose(slope, [[2.0, 0.0], [-2.0, 1.0], [0.0, 1.0]], atol=1e-15)


def test_equilibrium_of_a_hardening_spring():
    lengths = np.array([0.1])
    np.testing.assert_allclose(equilibrium(lambda q: 2.0 - q - q**3, lengths), 1.0, atol=1e-12)
    with pytest.raises(RootError):
        equilibrium(np.exp, lengths)
