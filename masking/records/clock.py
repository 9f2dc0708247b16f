"""Clock: the samples per second of a record, and what is wrong with one whose samples are not equally far apart.

Stamps that are rounded or jitter return to a line; a gap shifts all that follow by whole samples; a change of the rate
is a kink. The simplest of these that explains the stamps is reported; if none does, that they wander.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from masking.errors import RecordError
from masking.numerics.arrays import Array
from masking.records.time_slice import MARK, Part

_STEADY = 1e-3  # of a period: how far an instant may be from a steady clock
_LONG = 1.5  # periods: a step that may hold a gap
_FEW = 0.05  # of all steps: gaps that are more, and are spread evenly, are those of stamps that are rounded
_SEVERAL = 4  # gaps that may be spread evenly by chance
_MANY = 10  # gaps that a record is not cut at
_RUN = 10  # equal long steps in a row are another rate
_AROUND = 64  # samples on each side of a step that tell whether it shifts what follows
_NEAR = 0.25  # of a period: a shift so near to whole ones is a gap
_SHORT = 16  # steps of a stretch whose rate is not looked at
_SPREAD = 8.0  # deviations of the jitter that stamps are off at most
_CHANGES = 7  # of the rate: more are wandering
_FAR = 20.0  # periods that single stamps may come late


@dataclass(frozen=True)
class _Gap:
    """Samples that are missing after sample `at`."""

    at: int
    missing: int


def rate(t: Array, name: str) -> float:
    """Return the samples per second of a steady clock.

    Args:
        t: instants of the samples in s (samples,), which increase.
        name: of the record, for messages: its path where it is a file.

    Raises:
        RecordError: the record is too short, or its clock is not steady.
    """
    if len(t) < 4:
        raise RecordError(f"{name}: it has {len(t)} samples; give a longer record")
    steps = np.diff(t)
    if steps.min() <= 0.0:
        at = int(np.argmax(steps <= 0.0))
        raise RecordError(
            f"{name}: time goes back after t = {t[at]:.9g} s; give what is recorded from there on as a record of its "
            "own"
        )
    period = float(np.median(steps))
    if bool((np.abs(steps - period) <= _allowed(t, period)).all()):
        return (len(t) - 1) / float(t[-1] - t[0])
    raise RecordError(f"{name}: {_told(t, name)}")


def _allowed(t: Array, period: float) -> float:
    """Return how far a step may be from the period: a part of it, or what instants cannot resolve."""
    return max(_STEADY * period, 4e-16 * float(np.abs(t).max()))


def _told(t: Array, name: str) -> str:
    """Tell why samples are not equally far apart, and what to do about it."""
    gaps = _whole_gaps(t)
    if gaps:
        return _of_gaps(t, gaps, name)
    gaps = _gaps_in_jitter(t)
    whole = _without(t, gaps)
    bends = _bends(whole)
    if bends:
        return _of_rates(t, whole, bends, name)
    period, off = _line(whole)
    if np.abs(off).max() <= _FAR * period and np.median(np.abs(off)) <= 0.5 * period:
        if gaps:
            return _of_gaps(t, gaps, name)
        return (
            f"the time stamps are rounded or jitter by up to {np.abs(off).max():.2g} s; if the samples are regular, "
            f"leave the clock out and give --dt {period:.6g}; if not, resample the record to one rate"
        )
    steps, part = np.diff(t), max(1, len(t) // 10)
    rates = part / (t[part::part] - t[:-part:part])
    return (
        f"its clock is not steady: samples are from {steps.min():.4g} s to {steps.max():.4g} s apart, and the rate "
        f"goes from {rates.min():.5g} to {rates.max():.5g} Hz; resample the record to one rate"
    )


def _whole_gaps(t: Array) -> list[_Gap]:
    """Return the gaps of a clock that is steady but for these; none where there is another cause."""
    steps = np.diff(t)
    period = float(np.median(steps))
    count = np.rint(steps / period)
    if bool((count < 1.0).any()) or bool((np.abs(steps - count * period) > _allowed(t, period) * count).any()):
        return []
    long = np.flatnonzero(count > 1.0)
    _, off = _line(t)
    is_even = len(long) > max(_SEVERAL, _FEW * len(steps)) and np.abs(off).max() <= period
    if is_even or _longest_run(count) >= _RUN:
        return []
    return [_Gap(int(at), int(count[at]) - 1) for at in long]


def _longest_run(count: Array) -> int:
    """Return how many equal steps of more than one period are in a row at most."""
    ends = np.flatnonzero(np.diff(count)) + 1
    pieces = pairwise([0, *ends.tolist(), len(count)])
    return max((b - a for a, b in pieces if count[a] > 1.0), default=0)


def _gaps_in_jitter(t: Array) -> list[_Gap]:
    """Return the steps that shift all that follows by whole samples, of a clock whose stamps jitter."""
    found: list[_Gap] = []
    steps, whole = np.diff(t), t - t[0]
    long = np.flatnonzero(steps > _LONG * np.median(steps)).tolist()
    if len(long) > max(1.0, _FEW * len(steps)):
        return []
    for at in long:
        sides = steps[max(0, at - _SHORT) : at], steps[at + 1 : at + 1 + _SHORT]
        if steps[at] <= _LONG * max(float(np.median(side)) for side in sides if len(side)):
            continue  # another rate begins or ends here
        first, last = max(0, at - _AROUND + 1), min(len(t), at + 1 + _AROUND)
        index = np.arange(first, last)
        columns = np.stack([np.ones(len(index)), index - at, index > at], axis=1)
        since = whole[first:last] - whole[at]
        (start, period, shift), *_ = np.linalg.lstsq(columns, since, rcond=None)
        off = np.sqrt(np.mean((since - columns @ (start, period, shift)) ** 2))
        missing = round(float(shift / period))
        is_alike = abs(steps[at] / period - 1.0 - missing) < 3.0 * _NEAR
        if missing > 0 and max(abs(shift / period - missing), off / period) < _NEAR and is_alike:
            found.append(_Gap(at, missing))
            whole[at + 1 :] -= shift
    return found


def _without(t: Array, gaps: list[_Gap]) -> Array:
    """Return the instants as if nothing were missing."""
    steps = np.diff(t)
    for gap in gaps:
        steps[gap.at] /= gap.missing + 1
    return np.concatenate([[0.0], np.cumsum(steps)])


def _line(t: Array) -> tuple[float, Array]:
    """Return the time between samples of the steady clock that is nearest to instants, and how far they are off it."""
    index = np.arange(len(t)) - 0.5 * (len(t) - 1)
    since = t - t[0]
    period = float(index @ since / (index @ index))
    return period, since - since.mean() - period * index


def _bends(t: Array) -> list[int]:
    """Return the samples at which the rate changes; none where it does not, or too often to be listed.

    The line from the first stamp to the last is parted where it is furthest off, again and again (Douglas and Peucker
    1973), until all are as near as the jitter of stamps that are next to each other lets them be.
    """
    if len(t) < 2 * _SHORT:
        return []
    size = min(32, len(t) // 4)
    pieces = t[: len(t) // size * size].reshape(-1, size)
    jitter = float(np.median([np.sqrt(np.mean(_line(piece)[1] ** 2)) for piece in pieces]))
    period = float(t[-1] - t[0]) / (len(t) - 1)
    near = max(_SPREAD * jitter, _allowed(t, period))
    bends, open_ = list[int](), [(0, len(t) - 1)]
    while open_ and len(bends) <= 4 * _CHANGES:
        a, b = open_.pop()
        off = np.abs(t[a : b + 1] - np.interp(np.arange(a, b + 1), [a, b], [t[a], t[b]]))
        if off.max() > near and b - a >= 2 * _SHORT:
            at = a + int(np.argmax(off))
            bends.append(at)
            open_ += [(a, at), (at, b)]
    bends = _distinct(t, sorted(bends), near)
    ends = [0, *bends, len(t) - 1]
    left = max(float(np.abs(_line(t[a : b + 1])[1]).max()) for a, b in pairwise(ends))
    rates = np.array([_line(t[a : b + 1])[0] for a, b in pairwise(ends)])
    is_gradual = len(bends) > 2 and len({*np.sign(np.diff(rates)).tolist()}) == 1
    return [] if is_gradual or left > near or len(bends) > _CHANGES else bends


def _distinct(t: Array, bends: list[int], near: float) -> list[int]:
    """Leave out bends without which all stamps lie as near to lines."""
    for at in list(bends):
        index = bends.index(at)
        a, b = ([0, *bends][index], [*bends, len(t) - 1][index + 1])
        if np.abs(_line(t[a : b + 1])[1]).max() <= near / 2.0:
            bends.remove(at)
    return bends


def _of_rates(t: Array, whole: Array, bends: list[int], name: str) -> str:
    ends = [0, *bends, len(t)]
    rates = [1.0 / _line(whole[a : b + 1])[0] for a, b in pairwise(ends)]
    others = len(bends) - 1
    more = "" if not others else f", and {others} more time{'s' if others > 1 else ''}"
    return (
        f"the rate changes from {rates[0]:.5g} to {rates[1]:.5g} Hz at t = {t[bends[0]]:.9g} s{more}; use one part"
        f"{_such_as(t, ends, name)}"
    )


def _of_gaps(t: Array, gaps: list[_Gap], name: str) -> str:
    missing, others = gaps[0].missing, len(gaps) - 1
    more = "" if not others else f", and there {'are' if others > 1 else 'is'} {others} more gap{'s' * (others > 1)}"
    mend = "cut the record there, and" if others < _MANY else "resample the record to one rate, or"
    return (
        f"{missing} sample{'s are' if missing > 1 else ' is'} missing after t = {t[gaps[0].at]:.9g} s{more}; {mend} "
        f"use one part{_such_as(t, [0, *(gap.at + 1 for gap in gaps), len(t)], name)}"
    )


def _such_as(t: Array, ends: list[int], name: str) -> str:
    """Name the longest part of a file between some of its samples."""
    a, b = max(pairwise(ends), key=lambda part: part[1] - part[0])
    whole = Part.of(name)
    if not Path(whole.file).exists():
        return ""
    start, end = f"{t[a]:.9g}" if a > 0 else _time(whole.start), f"{t[b]:.9g}" if b < len(t) else _time(whole.end)
    return f", such as {whole.file}{MARK}{start}:{end}"


def _time(given: float | None) -> str:
    return "" if given is None else f"{given:.9g}"


__all__ = ["rate"]
