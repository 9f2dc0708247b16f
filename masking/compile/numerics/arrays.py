"""Array types that annotations name; shapes stand in the docstrings, with the letters of `docs/vocabulary.md`."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

# Arguments of kernels: C-contiguous arrays of one dimension and of two.
Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
IntVector = NDArray[np.int64]
IntMatrix = NDArray[np.int64]
Kernel = Callable[..., Any]
