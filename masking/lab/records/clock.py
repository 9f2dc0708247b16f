"""Clock: the samples per second of a record, and what is wrong with one whose samples are not equally far apart.

Instants over the number of the sample are a line. Where they lie on several lines, samples are missing between two that
are whole samples apart, and the rate changes between others; stamps that are rounded or jitter scatter about one line.
The simplest of these that explains the instants is reported, and that they wander if none does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RecordError
from masking.lab.records.time_slice import MARK, Part

_STEADY = 1e-3  # of a period: how far an instant may be from a steady clock
_EVEN = (4, 0.05)  # gaps, and of all steps: more, and spread evenly, are those of stamps that are rounded
_RUN = 10  # equal long steps in a row are another rate
_SHORT = 8  # samples of a line at least
_SURE = 80.0  # reduction of the squares, in those of the jitter, by which two lines explain instants and one does not
_SPREAD = 8.0  # deviations of the jitter that instants are off a line at most
_CHANGES = 7  # of the rate: more are wandering
_MANY = 10  # gaps that a record is not cut at
_WHOLE = 0.1  # of a period: gaps that are no nearer to a whole number of these are holes
_BITS = (16, 24, 32)  # of counters that start again
_TURNS = 5.0  # usual steps that stamps of such a counter are apart at most
_FAR = 20.0  # periods that single stamps may come late


@dataclass(frozen=True)
class _Break:
    """A first sample after missing ones, or, if none are missing, one from which on the rate is another, with both."""

    first: int
    missing: int
    rates: tuple[float, float] = (0.0, 0.0)
    periods: float = 0.0  # from the sample before


def rate(t: Array, name: str) -> float:
    """Samples per second of a steady clock: of instants in s (samples,), which increase.

    `name` is that of the record in messages, its path if it is a file. A RecordError where the record is too short, or
    its clock is not steady.
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
    if bool((np.abs(steps - np.median(steps)) <= _allowed(t)).all()):
        return (len(t) - 1) / float(t[-1] - t[0])
    raise RecordError(f"{name}: {_cause(t, name)}")


def _allowed(t: Array) -> float:
    return max(_STEADY * float(np.median(np.diff(t))), 4e-16 * float(np.abs(t).max()))


def _cause(t: Array, name: str) -> str:
    """Cause of unequal distances between samples, and its remedy."""
    breaks = _whole_gaps(t) or _breaks(t)
    changes, gaps = [b for b in breaks if not b.missing], [b for b in breaks if b.missing]
    part = longest(t, [0, *(b.first for b in breaks), len(t)], name)
    if changes:
        before, after = changes[0].rates
        others = len(changes) - 1
        more = f", and {others} more time{'s' * (others > 1)}" if others else ""
        at = f"{t[changes[0].first]:.9g}"
        return f"the rate changes from {before:.5g} to {after:.5g} Hz at t = {at} s{more}; use one part{part}"
    resample = "interpolate it at one rate, such as --resample {:.6g}"
    if gaps:
        others = len(gaps) - 1
        more = f", and there {'are' if others > 1 else 'is'} {others} more gap{'s' * (others > 1)}" if others else ""
        remedy = "cut the record there, and" if others < _MANY else f"{resample.format(_usual(t))}, or"
        return f"{_gap(t, gaps[0])} after t = {t[gaps[0].first - 1]:.9g} s{more}; {remedy} use one part{part}"
    period, off = _line(t)
    if np.abs(off).max() <= _FAR * period and np.median(np.abs(off)) <= 0.5 * period:
        return (
            f"the time stamps are rounded or jitter by up to {np.abs(off).max():.2g} s; if the samples are regular, "
            f"leave the clock out and give --dt {period:.6g}; if not, {resample.format(1.0 / period)}"
        )
    steps, count = np.diff(t), max(1, len(t) // 10)
    rates = count / (t[count::count] - t[:-count:count])
    return (
        f"its clock is not steady: samples are from {steps.min():.4g} s to {steps.max():.4g} s apart, and the rate "
        f"goes from {rates.min():.5g} to {rates.max():.5g} Hz; {resample.format(1.0 / period)}"
    )


def _usual(t: Array) -> float:
    """Samples per second, by the median of the steps."""
    return 1.0 / float(np.median(np.diff(t)))


def _gap(t: Array, gap: _Break) -> str:
    """What a clock (samples,) has in place of missing samples, in words: a hole need be no whole number of them."""
    if abs(gap.periods - round(gap.periods)) > _WHOLE:
        length = float(t[gap.first] - t[gap.first - 1])
        return f"there is a hole of {length:.4g} s, {gap.periods:.4g} sample periods,"
    return f"{gap.missing} samples are missing" if gap.missing > 1 else "1 sample is missing"


def running_on(counts: Array) -> Array:
    """Stamps of a counter of 16, 24 or 32 bits that starts again, as they would go on; all others as they are.

    A counter starts again where its stamps, whole numbers (samples,), fall, and a turn of it makes that a usual step.
    """
    steps = np.diff(counts)
    falls = np.flatnonzero(steps < 0.0)
    if not len(falls) or counts.min() < 0.0 or (counts != np.rint(counts)).any():
        return counts
    turn = next((2.0**bits for bits in _BITS if counts.max() < 2.0**bits), np.inf)
    usual = float(np.median(steps))
    if (steps[falls] + turn > _TURNS * usual).any() or (steps[falls] + turn <= 0.0).any():
        return counts
    return np.asarray(counts + turn * np.concatenate([[0], np.cumsum(steps < 0.0)]))


def _whole_gaps(t: Array) -> list[_Break]:
    """Gaps of a clock that is steady but for these; none if there is another cause."""
    steps = np.diff(t)
    period = float(np.median(steps))
    count = np.rint(steps / period)
    if bool((count < 1.0).any()) or bool((np.abs(steps - count * period) > _allowed(t) * count).any()):
        return []
    long = np.flatnonzero(count > 1.0)
    is_even = len(long) > max(_EVEN[0], _EVEN[1] * len(steps)) and np.abs(_line(t)[1]).max() <= period
    runs = np.split(count, np.flatnonzero(np.diff(count)) + 1)
    is_slower = any(len(run) >= _RUN and run[0] > 1.0 for run in runs)
    return [] if is_even or is_slower else [_Break(int(at) + 1, int(count[at]) - 1) for at in long]


def _line(t: Array) -> tuple[float, Array]:
    """Time between samples of the steady clock that is nearest to instants, and how far they are off it."""
    index = np.arange(len(t)) - 0.5 * (len(t) - 1)
    since = t - t[0]
    period = float(index @ since / (index @ index))
    return period, since - since.mean() - period * index


def _breaks(t: Array) -> list[_Break]:
    """Where instants go from one line to another; none if a few lines do not explain them.

    Parts are split in two again and again, and each split is found anew between its neighbours.
    Source: Scott and Knott, Biometrics 30 (1974), 507-512, for binary segmentation.
    """
    size = min(32, len(t) // 4)
    pieces = t[: len(t) // size * size].reshape(-1, size)
    jitter = float(np.quantile([np.sqrt(np.mean(_line(piece)[1] ** 2)) for piece in pieces], 0.9))
    noise = max(jitter, _allowed(t))
    splits, open_ = list[int](), [(0, len(t))]
    while open_:
        a, b = open_.pop()
        at = _split(t[a:b], noise)
        if at is not None and len(splits) == 4 * _CHANGES:
            return []
        if at is not None:
            splits.append(a + at)
            open_ += [(a, a + at), (a + at, b)]
    splits.sort()
    for number in 2 * [*range(len(splits))][::-1]:
        if number < len(splits):
            a, b = [0, *splits][number], [*splits, len(t)][number + 1]
            at = _split(t[a:b], noise, least=2)
            splits[number : number + 1] = [] if at is None else [a + at]
    ends = [0, *splits, len(t)]
    if max(float(np.abs(_line(t[a:b])[1]).max()) for a, b in pairwise(ends)) > _SPREAD * noise:
        return []
    found = [_kind(t[a:c], b - a, noise) for a, b, c in zip(ends, ends[1:], ends[2:], strict=False)]
    breaks = [replace(kind, first=a + kind.first) for a, kind in zip(ends, found, strict=False) if kind is not None]
    rates = [kind.rates[1] - kind.rates[0] for kind in breaks if not kind.missing]
    is_gradual = len(rates) > 2 and len({*np.sign(rates).tolist()}) == 1
    return [] if len(breaks) < len(found) or is_gradual or len(rates) > _CHANGES else breaks


def _split(t: Array, noise: float, least: int = _SHORT) -> int | None:
    """First sample of the second of two lines on which instants lie; None if one does as well."""
    count = len(t)
    if count < 2 * least:
        return None
    x, off = np.linspace(-1.0, 1.0, count), _line(t)[1]
    sums = np.cumsum([np.ones(count), x, x**2, off, x * off, off**2], axis=1)

    def squares(table: Array) -> Array:
        n, sx, sxx, sy, sxy, syy = table
        return np.asarray(syy - sy**2 / n - (sxy - sx * sy / n) ** 2 / (sxx - sx**2 / n))

    left = sums[:, least - 1 : count - least]
    at = least + int(np.argmin(squares(left) + squares(sums[:, -1:] - left)))
    less = float(off @ off) - sum(float(part @ part) for part in (_line(t[:at])[1], _line(t[at:])[1]))
    return at if less > _SURE * noise**2 else None


def _kind(t: Array, at: int, noise: float) -> _Break | None:
    """Kind of the break between two lines: missing samples, or a change of the rate where they meet; else None."""
    (before, off), (after, off_after) = _line(t[:at]), _line(t[at:])
    shift = float((t[at] - off_after[0]) - (t[at - 1] - off[-1])) / before - 1.0
    missing = max(0, round(shift))
    if _split(np.concatenate([t[:at], t[at:] - shift * before]), noise) is None:
        return _Break(at, missing, periods=shift + 1.0) if missing else None
    meet = at + round(shift * before / (before - after))
    return _Break(min(max(meet, 1), len(t) - 1), 0, (1.0 / before, 1.0 / after))


def longest(t: Array, ends: list[int], name: str) -> str:
    """Longest part of a file between some of its samples, in words: ", such as FILE@:10"; "" where there is no file."""
    a, b = max(pairwise(ends), key=lambda part: part[1] - part[0])
    whole = Part.of(name)
    if not Path(whole.file).exists():
        return ""
    start, end = (
        f"{t[at]:.9g}" if 0 < at < len(t) else "" if given is None else f"{given:.9g}"
        for at, given in ((a, whole.start), (b, whole.end))
    )
    return f", such as {whole.file}{MARK}{start}:{end}"
