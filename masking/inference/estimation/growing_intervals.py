"""Growing intervals: the lengths of shooting intervals in which a fit begins that loses phase over a whole record.

Over many periods the cost has a minimum for each number of whole periods by which the simulation is ahead or behind;
over one period it has one. So a fit begins in intervals of one period, and goes on in intervals four times as long.
Source: Bock (1983), Recent advances in parameter identification techniques for o.d.e., in Numerical Treatment of
Inverse Problems in Differential and Integral Equations, Birkhaeuser; Allgower and Georg (1990), Numerical Continuation
Methods, chapter 1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from masking.inference.estimation.identification_data import Data

GROWTH = 4  # times the length of the intervals before
MOST = 64  # intervals that are fitted at once
FEWEST = 20  # samples of an interval


def lengths(record: Data, longest: int, shortest: int | None = None) -> Iterator[int]:
    """Samples of intervals at most half as long as the longest, from one period on, or from fewer samples if given."""
    period = round(_period(record) * record.rate)
    samples = max(FEWEST, period if shortest is None else min(period, shortest))
    while 2 * samples <= longest:
        yield samples
        samples *= GROWTH


def windows(record: Data, samples: int) -> list[Data]:
    """The first of a record in as many intervals of about a number of samples as are fitted at once."""
    return record.part(0, min(len(record), MOST * samples)).windows(samples / record.rate)


def _period(record: Data) -> float:
    """Period of the strongest line of a record in s, of the sensor in which it is shortest."""
    readings = record.readings
    window = np.hanning(len(readings))[:, None]
    power = np.abs(np.fft.rfft((readings - readings.mean(axis=0)) * window, axis=0)) ** 2
    lines = 1 + power[1:].argmax(axis=0)
    return float(len(readings) / record.rate / lines.max())
