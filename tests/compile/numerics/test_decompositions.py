"""Decompositions: those of numpy where they exist, and one kind of error where they do not."""

import ast
from pathlib import Path

import numpy as np
import pytest

import masking
from masking.compile.numerics import decompositions as made
from masking.compile.numerics.least_squares import System
from masking.errors import IntegrationError

PACKAGE = Path(masking.__file__).parent
RAISING = {"svd", "eig", "eigh", "eigvals", "eigvalsh", "pinv", "lstsq", "inv"}
FUNCTIONS = {
    "svd": made.svd,
    "eigenvalues": made.eigenvalues,
    "symmetric": made.symmetric,
    "inverse": made.inverse,
    "least squares": lambda matrix: made.least_squares(matrix, np.ones(len(matrix))),
}


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_what_is_not_finite_is_an_error_of_ours(function, bad):
    with pytest.raises(IntegrationError, match="the equations are singular or no longer finite"):
        function(np.array([[1.0, 0.5], [0.5, bad]]))


def test_a_right_side_that_is_not_finite_is_an_error_of_ours():
    with pytest.raises(IntegrationError):
        made.least_squares(np.eye(2), np.array([1.0, np.nan]))


def test_a_singular_matrix_inside_is_an_error_of_ours():
    with pytest.raises(IntegrationError, match="Singular matrix"), made.decomposed():
        np.linalg.solve(np.ones((2, 2)), np.ones(2))


def test_singular_matrices_have_the_answers_of_least_norm():
    singular = np.array([[1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_allclose(made.inverse(singular, hermitian=True), singular / 25.0, atol=1e-15)
    np.testing.assert_allclose(made.least_squares(singular, np.array([1.0, 2.0])), [0.2, 0.4])
    np.testing.assert_allclose(made.symmetric(singular)[0], [0.0, 5.0], atol=1e-14)
    np.testing.assert_allclose(np.sort(made.eigenvalues(singular).real), [0.0, 5.0], atol=1e-14)
    np.testing.assert_allclose(made.svd(singular)[1], [5.0, 0.0], atol=1e-14)


def test_equations_that_cannot_be_inverted_have_an_infinite_covariance():
    """An unknown that nothing depends on but another's equation: scaled by its diagonal of 0, it overflows."""
    matrix = np.array([[1.0, 1e200], [1e200, 0.0]])
    with np.errstate(over="ignore"):
        assert np.isinf(System(matrix, np.zeros(2)).covariance()).all()


@pytest.mark.parametrize("function", FUNCTIONS.values(), ids=FUNCTIONS)
def test_numbers_hundreds_of_orders_of_magnitude_apart_end_in_a_result_or_in_our_error(function):
    generator = np.random.default_rng(0)
    for _ in range(200):
        half = generator.standard_normal((6, 6)) * 10.0 ** generator.uniform(-307.0, 307.0, (6, 6))
        with np.errstate(all="ignore"):
            try:
                function(half + half.T)
            except IntegrationError:
                continue


@pytest.mark.parametrize(
    "path", sorted(path for folder in ("discovery", "estimation") for path in (PACKAGE / folder).rglob("*.py"))
)
def test_discovery_and_estimation_decompose_by_nothing_else(path):
    calls = [node.func for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call)]
    direct = {f.attr for f in calls if isinstance(f, ast.Attribute) and ast.unparse(f.value).endswith("linalg")}
    assert not direct & RAISING
