"""Masking error: the relative distance between the virtual motion of a rig and the ideal motion."""

from __future__ import annotations

import math
from typing import final

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
    whole = ErrorSum()
    whole.add(measured, ideal)
    return whole.value


@final
class ErrorSum:
    """Masking error of one coordinate whose motion comes in chunks; `largest` is that so far, in the motion's unit."""

    def __init__(self) -> None:
        self._scale, self._error, self._size, self.largest = 0.0, 0.0, 0.0, 0.0

    def add(self, measured: NDArray[np.float64], ideal: NDArray[np.float64]) -> None:
        """Add a chunk; the arguments, and a ValueError, are those of `masking_error`."""
        measured, ideal = np.asarray(measured, np.float64), np.asarray(ideal, np.float64)
        if measured.shape != ideal.shape or measured.ndim != 1:
            raise ValueError(f"one coordinate each, of equal length: got shapes {measured.shape} and {ideal.shape}")
        error = measured - ideal
        # The scale keeps the squares of very small and very large numbers within range.
        scale = float(np.abs(ideal).max(initial=0.0)) or float(np.abs(measured).max(initial=0.0))
        if scale == 0.0:
            return
        self.largest = max(self.largest, float(np.abs(error).max()))
        if scale > self._scale:
            before, self._scale = self._scale / scale, scale
            self._error, self._size = self._error * before, self._size * before
        self._error = math.hypot(self._error, float(np.linalg.norm(error / self._scale)))
        self._size = math.hypot(self._size, float(np.linalg.norm(ideal / self._scale)))

    @property
    def value(self) -> float:
        """Masking error of all chunks together."""
        if self._size == 0.0:
            return math.inf if self._error > 0.0 else 0.0
        return self._error / self._size
