"""Timing of a run: histograms, quantiles and the worst tick of how late ticks began and how long they took."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from masking.numerics.arrays import Array
from masking.runs.realtime import RigRun

_PER_DECADE: Final = 5
_DECADES: Final = (-6, 1)  # 1 us to 10 s


def timing(run: RigRun, *, lockstep: bool) -> dict[str, Any]:
    """Return the timing of a run, for its manifest.

    `lateness` of ticks, where there is a clock; `controller`, what its step took; `work`, what the controller, the
    safety chain and the row of the record took together.

    Args:
        run: that has ended.
        lockstep: whether there was no clock.
    """
    parts = {} if lockstep else {"lateness": run.lateness}
    parts |= {"controller": run.durations, "work": run.work}
    return {name: histogram(values, run.index) for name, values in parts.items() if len(values)}


def histogram(values: Array, index: NDArray[np.int64]) -> dict[str, Any]:
    """Return how times are distributed.

    Args:
        values: (m,), s.
        index: tick of each (m,).

    Returns:
        `median`, `p99` and `max` in s, the tick `at` which that was, and the `counts` of the ticks below the first of
        the `edges`, between two, and from the last one on.
    """
    first, last = _DECADES
    edges = 10.0 ** np.linspace(first, last, (last - first) * _PER_DECADE + 1)
    counts = np.bincount(np.searchsorted(edges, values, side="right"), minlength=len(edges) + 1)
    median, p99 = np.quantile(values, [0.5, 0.99])
    worst = int(np.argmax(values))
    return {
        "unit": "s",
        "median": float(median),
        "p99": float(p99),
        "max": float(values[worst]),
        "at": int(index[worst]),
        "edges": edges.tolist(),
        "counts": counts.tolist(),
    }
