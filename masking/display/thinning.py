"""Series with fewer samples that look the same when they are drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

Series = NDArray[np.float64]

BINS: Final = 700  # across a whole record: about one for every two pixels


def envelope(tau: Series, series: Series, bins: int) -> tuple[Series, Series, Series]:
    """Give (middle, least, greatest) of each of at most `bins` stretches of equally many samples.

    Args:
        tau: times (m,).
        series: samples (m,).
        bins: number of stretches, at most.
    """
    starts = np.unique(np.linspace(0, len(tau), max(1, min(bins, len(tau))), endpoint=False).astype(int))
    last = np.append(starts[1:], len(tau)) - 1
    middle = (tau[starts] + tau[last]) / 2
    middle[0], middle[-1] = tau[0], tau[-1]
    return middle, np.minimum.reduceat(series, starts), np.maximum.reduceat(series, starts)


def thin(tau: Series, series: Series, bins: int = BINS) -> tuple[Series, Series]:
    """Keep the ends and, of each stretch, the least and the greatest sample in their order: a line looks the same.

    Args:
        tau: times (m,).
        series: samples (m,).
        bins: number of stretches.
    """
    if len(tau) <= 4 * bins:
        return tau, series
    length = len(tau) // bins
    body = series[: length * bins].reshape(bins, length)
    offset = np.arange(bins) * length
    extremes: Callable[..., NDArray[np.intp]] = np.concatenate
    rest = np.arange(length * bins, len(tau))
    keep = np.unique(extremes([[0], offset + body.argmin(1), offset + body.argmax(1), rest, [len(tau) - 1]]))
    return tau[keep], series[keep]
