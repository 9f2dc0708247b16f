"""Vectors of numbers in an HDF5 file, which a MATLAB file of version 7.3 is, too; each is named by its path.

This module alone touches h5py, so that whoever reads no such file does not pay for loading it.
"""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError
from masking.records.nested import MOST_COLUMNS, vectors

# What MATLAB calls numbers. Text, tables and objects are kept as integers, too, with another class beside them.
_MATLAB = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
# What h5py raises for files that are cut off or damaged.
_DAMAGED = (OSError, RuntimeError, ValueError, TypeError, KeyError, UnicodeError, MemoryError)


def is_hdf5(file: Path) -> bool:
    """Tell whether a file has the signature of HDF5, whatever its name ends in."""
    return bool(h5py.is_hdf5(file))


def read(file: Path) -> dict[str, NDArray[np.float64]]:
    """Read every vector of numbers as float64, by its path in the file, such as `multisine/u`.

    Vectors and columns of matrices are as in `nested.vectors`. Scalars, texts, compounds and references are left out,
    and what only MATLAB understands.

    Raises:
        RecordError: it is no HDF5 file, is cut off or damaged, or holds no vectors.
    """
    found: dict[str, NDArray[np.float64]] = {}

    def visit(path: str, held: h5py.Group | h5py.Dataset) -> None:
        if isinstance(held, h5py.Dataset) and _has_vectors(path, held):
            found.update(vectors(path, held[()]))

    try:
        with h5py.File(file, "r") as opened:
            opened.visititems(visit)
    except _DAMAGED as error:
        raise RecordError(f"{file}: the HDF5 file cannot be read ({error})") from error
    if not found:
        raise RecordError(f"{file}: it holds no vectors of numbers")
    return found


def _has_vectors(path: str, held: h5py.Dataset) -> bool:
    if any(part.startswith("#") for part in path.split("/")):  # MATLAB's own: what cells and objects refer to
        return False
    sides = sorted(held.shape or ())
    if not held.size or held.size < 2 or held.size > sides[-1] * MOST_COLUMNS:
        return False
    try:
        kind = held.dtype.kind
    except TypeError:  # HDF5 has kinds of numbers that numpy lacks, such as bit fields
        return False
    return kind in "fiu" and _is_number_of_matlab(held)


def _is_number_of_matlab(held: h5py.Dataset) -> bool:
    """Tell whether MATLAB, where a file is its own, holds numbers here, and not one of its other kinds in integers."""
    if "MATLAB_empty" in held.attrs or "MATLAB_sparse" in held.parent.attrs:  # the shape; one part of a matrix
        return False
    known = held.attrs.get("MATLAB_class", b"double")
    return (known.decode() if isinstance(known, bytes) else str(known)) in _MATLAB
