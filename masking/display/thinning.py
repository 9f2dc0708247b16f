"""Series with fewer samples that look the same when they are drawn: in memory, and from a long recording on disk."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

Series = NDArray[np.float64]

BINS: Final = 700  # across a whole record: about one for every two pixels


def envelope(tau: Series, series: Series, bins: int) -> tuple[Series, Series, Series]:
    """Middle, least and greatest of each of at most `bins` stretches of equally many samples (m,) at times `tau`."""
    starts = np.unique(np.linspace(0, len(tau), max(1, min(bins, len(tau))), endpoint=False).astype(int))
    last = np.append(starts[1:], len(tau)) - 1
    middle = (tau[starts] + tau[last]) / 2
    middle[0], middle[-1] = tau[0], tau[-1]
    return middle, np.minimum.reduceat(series, starts), np.maximum.reduceat(series, starts)


def thin(tau: Series, series: Series, bins: int = BINS) -> tuple[Series, Series]:
    """Series (m,) with its ends and, of each of `bins` stretches, the least and the greatest sample in their order."""
    if len(tau) <= 4 * bins:
        return tau, series
    length = len(tau) // bins
    kept = _extremes(series[: length * bins].reshape(bins, length)) + length * np.arange(bins)[:, None]
    keep = np.unique(np.concatenate([[0], kept.ravel(), np.arange(length * bins, len(tau)), [len(tau) - 1]]))
    return tau[keep], series[keep]


def _extremes(stretches: Series) -> NDArray[np.intp]:
    """Places (k, 2) of the least and the greatest sample of stretches (k, m), in their order."""
    return np.sort(np.column_stack([stretches.argmin(axis=1), stretches.argmax(axis=1)]), axis=1)


def step_for(samples: int, most: int) -> int:
    """Power of two, of which one sample is kept so that at most a number of them are."""
    return 1 << max(0, -(-samples // most) - 1).bit_length()


def thinned(chunks: Iterable[Mapping[str, Series]], step: int, sampled: Collection[str]) -> dict[str, Series]:
    """Columns with two samples of each stretch of 2 `step`: the first and the middle one, at their times.

    Columns that are not sampled have the least and the greatest of the stretch there, in the order in which they come;
    the clock is sampled. Chunks are columns by name, one stretch of time after the other.
    """
    parts, rest = list[dict[str, Series]](), dict[str, Series]()
    for chunk in chunks:
        whole = {name: np.concatenate([rest[name], column]) if rest else column for name, column in chunk.items()}
        length = len(next(iter(whole.values()))) // (2 * step) * 2 * step
        parts.append({name: _kept(column[:length], step, name in sampled) for name, column in whole.items()})
        rest = {name: column[length:].copy() for name, column in whole.items()}
    if rest and len(next(iter(rest.values()))):
        parts.append({name: _last(column, step, name in sampled) for name, column in rest.items()})
    # Column by column, so that a long record is not in memory twice.
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in [*parts[0]]}


def _kept(column: Series, step: int, is_sampled: bool) -> Series:
    if is_sampled:
        return column[::step].copy()
    stretches = column.reshape(-1, 2 * step)
    return np.take_along_axis(stretches, _extremes(stretches), axis=1).ravel()


def _last(column: Series, step: int, is_sampled: bool) -> Series:
    """Samples kept of too few for a stretch; the largest, where that is a single one."""
    if is_sampled:
        return column[::step].copy()
    return column[_extremes(column[None])[0]] if len(column) > step else column[[np.abs(column).argmax()]]
