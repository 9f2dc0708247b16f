"""Thinned columns: a long recording with fewer samples, evenly in time, that looks the same when it is drawn."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.float64]
Columns = Mapping[str, Column]


def step_for(samples: int, most: int) -> int:
    """Power of two, of which one sample is kept so that at most a number of them are."""
    return 1 << max(0, -(-samples // most) - 1).bit_length()


def thinned(chunks: Iterable[Columns], step: int, sampled: Collection[str]) -> dict[str, Column]:
    """Keep two samples of each stretch of twice as many as `step`: the first and the middle one, at their times.

    Columns that are not sampled have the least and the greatest of the stretch there, in the order in which they come.

    Args:
        chunks: columns by name, one stretch of time after the other.
        step: samples from one that is kept to the next.
        sampled: names of the columns that are sampled, the clock among them.
    """
    parts, rest = list[dict[str, Column]](), dict[str, Column]()
    for chunk in chunks:
        whole = {name: np.concatenate([rest[name], column]) if rest else column for name, column in chunk.items()}
        length = len(next(iter(whole.values()))) // (2 * step) * 2 * step
        parts.append({name: _kept(column[:length], step, name in sampled) for name, column in whole.items()})
        rest = {name: column[length:].copy() for name, column in whole.items()}
    if rest and len(next(iter(rest.values()))):
        parts.append({name: _last(column, step, name in sampled) for name, column in rest.items()})
    # Column by column, so that a long record is not in memory twice.
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in [*parts[0]]}


def _kept(column: Column, step: int, is_sampled: bool) -> Column:
    if is_sampled:
        return column[::step].copy()
    stretches = column.reshape(-1, 2 * step)
    least, greatest = stretches.argmin(axis=1), stretches.argmax(axis=1)
    both = np.sort(np.column_stack([least, greatest]), axis=1)
    return np.ascontiguousarray(np.take_along_axis(stretches, both, axis=1).ravel())


def _last(column: Column, step: int, is_sampled: bool) -> Column:
    """Return what is kept of samples that are too few for a stretch; the largest, where that is a single one."""
    if is_sampled:
        return column[::step].copy()
    if len(column) <= step:
        return np.atleast_1d(column[np.abs(column).argmax()])
    return np.asarray(column[np.sort([column.argmin(), column.argmax()])])
