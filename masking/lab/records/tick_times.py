"""Timing of the ticks of a run: histograms, quantiles and the worst of how late they began and how long they took."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from masking.compile.numerics.arrays import Array

_PER_DECADE: Final = 5
_DECADES: Final = (-6, 1)  # 1 us to 10 s


def timing(index: NDArray[np.int64], **parts: Array) -> dict[str, Any]:
    """Timing of the ticks (m,) of a run, for its manifest: times by name, s (m,).

    How late ticks began is `lateness`, where there was a clock; what the step of the controller took is `controller`;
    what it, the safety chain and the row of the record took together is `work`.
    """
    return {name: histogram(values, index) for name, values in parts.items() if len(values)}


def histogram(values: Array, index: NDArray[np.int64]) -> dict[str, Any]:
    """How times (m,), s, of ticks (m,) are distributed.

    `median`, `p99` and `max` in s, the tick `at` which that was, and the `counts` of the ticks below the first of the
    `edges`, between two, and from the last one on.
    """
    first, last = _DECADES
    edges = 10.0 ** np.linspace(first, last, (last - first) * _PER_DECADE + 1)
    counts = np.bincount(np.searchsorted(edges, values, side="right"), minlength=len(edges) + 1)
    median, p99 = np.quantile(values, [0.5, 0.99])
    worst = int(np.argmax(values))
    found = {"unit": "s", "median": float(median), "p99": float(p99), "max": float(values[worst])}
    return found | {"at": int(index[worst]), "edges": edges.tolist(), "counts": counts.tolist()}
