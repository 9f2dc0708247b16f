"""Decompositions that end in a result or in an `IntegrationError`, whatever the matrix.

LAPACK gives up at numbers that are not finite, at singular matrices, and now and then at a finite one whose entries are
hundreds of orders of magnitude apart. What simulates a motion that runs away makes all three of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from masking.compile.numerics.arrays import Array, Complex
from masking.errors import IntegrationError


@contextmanager
def decomposed() -> Iterator[None]:
    """Raise an `IntegrationError` where a matrix is singular, not finite, or its decomposition does not converge."""
    try:
        yield
    except (np.linalg.LinAlgError, ValueError) as error:
        raise IntegrationError(f"the equations are singular or no longer finite ({error})") from error


def svd(matrix: Array) -> tuple[Array, Array, Array]:
    """Singular values: u (m, k), s (k,), v (k, n) of a matrix (m, n), k = min(m, n); fails as `decomposed` says."""
    with decomposed():
        return np.linalg.svd(np.asarray_chkfinite(matrix), full_matrices=False)


def eigenvalues(matrix: Array) -> Complex:
    """Eigenvalues (n,) of a matrix (n, n); fails as `decomposed` says."""
    with decomposed():
        return np.asarray(np.linalg.eigvals(np.asarray_chkfinite(matrix)), dtype=np.complex128)


def symmetric(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues (n,), rising, and eigenvectors (n, n) of a symmetric matrix (n, n); fails as `decomposed` says."""
    with decomposed():
        return np.linalg.eigh(np.asarray_chkfinite(matrix))


def inverse(matrix: Array, rcond: float | None = None, *, hermitian: bool = False) -> Array:
    """Pseudoinverse (n, m) of a real or complex matrix (m, n), symmetric if `hermitian`; fails as `decomposed` says.

    Singular values below the part `rcond` of the largest are taken as 0; by default those that rounding makes.
    """
    with decomposed():
        if rcond is None:
            return np.asarray(np.linalg.pinv(np.asarray_chkfinite(matrix), hermitian=hermitian))
        return np.asarray(np.linalg.pinv(np.asarray_chkfinite(matrix), rcond=rcond, hermitian=hermitian))


def least_squares(matrix: Array, right: Array, rcond: float | None = None) -> Array:
    """X (n, ...) of least norm that makes |matrix x - right| least, of (m, n) and (m, ...); fails as `decomposed` says.

    Singular values below the part `rcond` of the largest are taken as 0; by default those that rounding makes.
    """
    with decomposed():
        matrix, right = np.asarray_chkfinite(matrix), np.asarray_chkfinite(right)
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=rcond)[0])
