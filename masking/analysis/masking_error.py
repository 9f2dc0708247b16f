"""Masking error: the relative distance between the virtual motion of a rig and the ideal motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def masking_error(measured: NDArray[np.float64], ideal: NDArray[np.float64]) -> float:
    """Relative root-mean-square error of one coordinate.

        chi = ||measured - ideal|| / ||ideal||          (2-norm over the samples)

    Dimensionless; 0 is perfect. If `ideal` never leaves zero, chi is 0 if `measured` does not either, else infinite.
    Source: (4.12), with the ideal motion as the reference.

    Args:
        measured: the coordinate as it moved (samples,), any unit.
        ideal: the same coordinate of the virtual system integrated by itself (samples,), same unit.

    Raises:
        ValueError: the shapes differ.
    """
    measured, ideal = np.asarray(measured, np.float64), np.asarray(ideal, np.float64)
    if measured.shape != ideal.shape or measured.ndim != 1:
        raise ValueError(f"one coordinate each, of equal length: got shapes {measured.shape} and {ideal.shape}")
    if not ideal.any():
        return math.inf if measured.any() else 0.0
    scale = np.abs(ideal).max()  # keeps the squares of very small and very large numbers within range
    return float(np.linalg.norm((measured - ideal) / scale) / np.linalg.norm(ideal / scale))
