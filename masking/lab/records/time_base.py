"""Time base: channels of one record that have clocks of their own, on one clock.

Channels on one clock stay as they are. Those on several are refused, or resampled where that is asked for. A command
that is held keeps its hold: it has its mean over each new sample, so that its impulse is kept. Everything else goes
through its samples in cubics, each from four of them; where these are too unevenly apart for that, in straight lines.
Samples that are missing are left out, and holes are refused.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from masking.errors import DeclarationError, Problem, RecordError
from masking.lab.records import clock
from masking.lab.records.noise_estimate import white_noise
from masking.lab.records.time_slice import Part

Column = NDArray[np.float64]
CLOCK = "t"
_HERTZ = {"": 1.0, "Hz": 1.0, "kHz": 1e3, "mHz": 1e-3}
_RATE = re.compile(r"\s*([0-9.eE+-]+)\s*(" + "|".join(filter(None, _HERTZ)) + r")?\s*")
_SAME = 1e-3  # of a period: clocks that differ by no more are one
_ON = 1e-6  # of a period: an instant so near to a sample is at it
_HOLE = 5.0  # times the median step: from here on samples are missing
_UNEVEN = 8.0  # ratio of neighbouring steps from which straight lines are drawn
_STEADY = 0.05  # by which most steps of a steady clock differ at most
_LOST = 0.02  # of the deviation of a channel, above its noise: what may be lost without a word
_SLOWEST = 1e-9  # Hz
LARGEST_MADE = 2**32  # bytes of a record that is put on a clock
_SLOWER = 0.99  # times the rate: a lower one loses something


@dataclass(frozen=True)
class Channels:
    """Columns of a file by their paths, and the clocks of their own that some have, in s, by the same paths."""

    columns: dict[str, Column]
    clocks: Mapping[str, Column] = field(default_factory=dict)


@dataclass(frozen=True)
class Resampling:
    """Samples per second of a record that is put on one clock.

    `held` are the channels that act until the next, `turns` those that start again after a turn, in their unit.
    """

    rate: float
    held: Collection[str] = ()
    turns: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, rate: float | str | None, held: Collection[str] = (), turns: Mapping[str, float] | None = None
    ) -> Resampling | None:
        """Read a rate, such as 200, "200 Hz" or "1 kHz"; None for none, and a DeclarationError for anything else."""
        if rate is None:
            return None
        found = _RATE.fullmatch(str(rate))
        try:
            value = float(found[1]) * _HERTZ[found[2] or ""] if found else np.nan
        except ValueError:
            value = np.nan
        if not (_SLOWEST <= value < np.inf):
            remedy = "give samples per second, such as 200, '200 Hz' or '1 kHz'"
            raise DeclarationError(Problem(None, "resample", f"'{rate}' is no rate", remedy))
        return cls(value, held, turns or {})


@dataclass(frozen=True)
class _Channel:
    """Samples of one channel that are there, at their times in s (samples,), with its name in messages."""

    label: str
    times: Column
    values: Column
    is_held: bool = False

    @property
    def step(self) -> float:
        return float(np.median(np.diff(self.times)))


def joined(
    part: Part, columns: Mapping[str, Column], own: Mapping[str, Column], resampling: Resampling | None
) -> tuple[dict[str, Column], tuple[str, ...]]:
    """Columns on one clock `t`, and notes in words.

    Args:
        part: of the file, which is all that is resampled.
        columns: by their names (samples,), with `t`, in s, unless each has a clock of its own.
        own: clocks in s, by the names of columns; that of `t` is the one that its samples were taken on.
        resampling: how those on several clocks are resampled; None to refuse these.

    Raises:
        RecordError: the clocks differ, or a channel that is resampled has a hole, or they share no time.
    """
    channels = {name: column for name, column in columns.items() if name != CLOCK}
    clocks = {name: own[name] for name in channels if name in own}
    base = own.get(CLOCK, columns.get(CLOCK, next(iter(clocks.values()), None)))
    if base is None:
        return dict(columns), ()
    if resampling is None:
        for name, times in clocks.items():
            if not _are_one(base, times):
                raise _two_clocks(part, name, times, next((n for n in clocks if clocks[n] is base), CLOCK), base)
        return {CLOCK: columns.get(CLOCK, base), **channels}, ()
    found = dict[str, _Channel]()
    notes = list[str]()
    for name, values in channels.items():
        times = clocks.get(name, columns.get(CLOCK, base))
        if len(times) != len(values):
            raise RecordError(
                f"{part.name}: {name} has {len(values)} samples, and its clock {len(times)}; give the clock that it "
                f"was sampled on behind its column: --map {name}=COLUMN@CLOCK"
            )
        is_there = np.isfinite(times) & np.isfinite(values)
        there = going_on(values[is_there], resampling.turns.get(name, 0.0))
        found[name] = _within(part, _Channel(name, times[is_there], there, name in resampling.held))
        missing = int(np.count_nonzero(np.isfinite(times) & ~is_there))
        if missing:
            what = "1 sample is" if missing == 1 else f"{missing} samples are"
            notes.append(
                f"{what} missing in {name}, of {len(values)}; what was asked for between others is interpolated"
            )
    if not found:
        return {CLOCK: columns.get(CLOCK, base)}, ()
    made = _resampled(part, found, resampling)
    notes += [note for name, one in found.items() for note in _lost(one, made[CLOCK], made[name], resampling.rate)]
    return made, tuple(notes)


def going_on(values: Column, turn: float) -> Column:
    """Readings that start again after each turn, as they go on, the first nearest to 0; as they are without."""
    if not turn:
        return values
    made = np.unwrap(values, period=turn)
    return np.asarray(made - turn * np.rint(made[0] / turn))


def check_there(part: Part, columns: Mapping[str, Column]) -> None:
    """Refuse, by a RecordError, missing samples: those of columns with `t` (samples,) that are not numbers."""
    times = columns[CLOCK]
    for name, values in columns.items():
        missing = np.flatnonzero(np.isfinite(times) & ~np.isfinite(values))
        if len(missing):
            ends = [0, *missing.tolist(), *(missing + 1).tolist(), len(times)]
            sound = clock.longest(times, sorted({*ends}), part.name)
            what = "a sample is" if len(missing) == 1 else f"{len(missing)} samples are"
            raise RecordError(
                f"{part.name}: {what} missing in {name}, the first at t = {times[missing[0]]:.9g} s: no number, or "
                f"marked as invalid; use one part{sound}, or give --resample, which bridges single ones"
            )


def _are_one(first: Column, second: Column) -> bool:
    if first is second:
        return True
    if len(first) != len(second) or len(first) < 2:
        return len(first) == len(second)
    far = max(_SAME * float(np.median(np.diff(first))), 4e-16 * float(np.abs(first).max()))
    return bool((np.abs(first - second) <= far).all())


def _two_clocks(part: Part, name: str, times: Column, other: str, base: Column) -> RecordError:
    rates = [(len(one) - 1) / float(one[-1] - one[0]) if len(one) > 1 else 0.0 for one in (base, times)]
    said = [
        f"{what} has {len(one)} samples from {one[0]:.9g} s on at {rate:.6g} Hz"
        for what, one, rate in zip((other, name), (base, times), rates, strict=True)
    ]
    return RecordError(
        f"{part.name}: two clocks: {said[0]}, {said[1]}; interpolate them at one rate, such as --resample "
        f"{max(rates):.6g} (in Python, resample={max(rates):.6g}), or name channels on one clock"
    )


def _within(part: Part, channel: _Channel) -> _Channel:
    """Samples that a part of the record needs, of a clock that increases without holes."""
    times, values = channel.times, channel.values
    if len(times) < 2:
        raise RecordError(f"{part.name}: {channel.label} has {len(times)} samples; give a longer record")
    if (back := np.flatnonzero(np.diff(times) <= 0.0)).size:
        raise RecordError(
            f"{part.name}: the time of {channel.label} does not increase after {times[back[0]]:.9g} s; if its samples "
            "are regular, leave the clock out and give --dt"
        )
    low, high = part.limits
    first = max(0, int(np.searchsorted(times, low, "right")) - 2)
    last = int(np.searchsorted(times, high, "left")) + 2
    channel = _Channel(channel.label, times[first:last], values[first:last], channel.is_held)
    steps = np.diff(channel.times)
    if len(steps) < 2:
        raise part.empty(float(times[0]), float(times[-1]), float(np.median(np.diff(times))))
    slow, fast = np.quantile(steps, [0.9, 0.1])
    holes, near = np.flatnonzero(steps > _HOLE * channel.step), _SAME * channel.step
    outside = [channel.times[holes + 1] <= low + near, channel.times[holes] >= high - near]
    if any(before_or_after.any() for before_or_after in outside):  # neighbours of the part that are not needed
        kept = slice(*(int(x) for x in (max([0, *(holes[outside[0]] + 1)]), min([len(steps), *holes[outside[1]]]) + 1)))
        return _within(part, _Channel(channel.label, channel.times[kept], channel.values[kept], channel.is_held))
    if holes.size and not (channel.is_held and slow > (1.0 + _STEADY) * fast):
        at, others = int(holes[0]), len(holes) - 1
        more = f", and {others} more hole{'s' * (others > 1)}" if others else ""
        sound = clock.longest(channel.times, [0, *(int(i) + 1 for i in holes), len(channel.times)], part.name)
        raise RecordError(
            f"{part.name}: {channel.label} has no sample from {channel.times[at]:.9g} s to "
            f"{channel.times[at + 1]:.9g} s, {steps[at] / channel.step:.3g} times its usual step{more}; a hole is not "
            f"interpolated: use one part{sound}"
        )
    return channel


def _resampled(part: Part, channels: Mapping[str, _Channel], resampling: Resampling) -> dict[str, Column]:
    """Channels at one rate, over the time that all of them have; on samples of the first that is held, if any is."""
    period, (low, high) = 1.0 / resampling.rate, part.limits
    near = _ON * period
    start = max(low, *(float(one.times[0]) for one in channels.values()))
    ends = [float(one.times[-1]) + (one.step - period if one.is_held else 0.0) for one in channels.values()]
    first = min(channels.values(), key=lambda one: not one.is_held)
    at = min(int(np.searchsorted(first.times, start - near)), len(first.times) - 1)
    origin = max(float(first.times[at]), start)
    span = (min(high - near, *ends) - origin) / period
    if (size := 8.0 * span * (len(channels) + 1)) > LARGEST_MADE:
        raise RecordError(
            f"{part.name}: at {resampling.rate:.6g} Hz it has {span:.3g} samples, {size / 2**30:.3g} GiB, more than "
            f"{LARGEST_MADE // 2**30} GiB; give a lower rate, or a part of the record"
        )
    count = int(np.floor(span + _ON)) + 1
    if count < 2:
        spans = ", ".join(f"{n} from {c.times[0]:.9g} s to {c.times[-1]:.9g} s" for n, c in channels.items())
        raise RecordError(f"{part.name}: its channels share no time: {spans}; name channels of one run")
    grid = np.arange(count, dtype=np.float64) * np.float64(period)
    made = {
        name: (_means if one.is_held else _through)(one.times - origin, one.values, grid)
        for name, one in channels.items()
    }
    return {CLOCK: origin + grid, **made}


def _means(times: Column, values: Column, grid: Column) -> Column:
    """Mean of held values, each of which acts until the next, from each instant of an even grid to the next."""
    period = float(grid[1] - grid[0])
    edges = np.append(grid, grid[-1] + period)
    before = np.searchsorted(times, edges[:-1] + _ON * period, "right") - 1
    until = np.searchsorted(times, edges[1:] - _ON * period, "right") - 1
    sums = np.concatenate([[0.0], np.cumsum(np.diff(times) * values[:-1])])
    inside = np.clip(np.searchsorted(times, edges, "right") - 1, 0, len(times) - 1)
    impulse = np.diff(sums[inside] + (edges - times[inside]) * values[inside])
    return np.where(before == until, values[before], impulse / period)


def _through(times: Column, values: Column, grid: Column) -> Column:
    """Cubics through samples, whose slope at each is that of the parabola through it and its neighbours.

    Source: Catmull and Rom, in Barnhill and Riesenfeld, Computer Aided Geometric Design (1974), 317-326.
    """
    steps = np.diff(times)
    secants = np.diff(values) / steps
    at = np.clip(np.searchsorted(times, grid, "right") - 1, 0, len(steps) - 1)
    x = np.clip((grid - times[at]) / steps[at], 0.0, 1.0)
    made = values[at] + x * (values[at + 1] - values[at])
    before, after = steps[:-1], steps[1:]
    slopes = (secants[:-1] * after + secants[1:] * before) / (before + after)
    slopes = np.concatenate([[2.0 * secants[0] - slopes[0]], slopes, [2.0 * secants[-1] - slopes[-1]]])
    is_even = np.maximum(before, after) <= _UNEVEN * np.minimum(before, after)
    is_even = np.concatenate([is_even[:1], is_even, is_even[-1:]])
    bend = steps[at] * x * (1.0 - x)
    bend = bend * ((slopes[at] - secants[at]) * (1.0 - x) - (slopes[at + 1] - secants[at]) * x)
    return np.asarray(made + np.where(is_even[at] & is_even[at + 1], bend, 0.0))


def _lost(channel: _Channel, grid: Column, made: Column, rate: float) -> list[str]:
    """What a lower rate loses of a channel, in words, where that is more than its noise."""
    if rate >= _SLOWER / channel.step:
        return []
    kept = (channel.times >= grid[0]) & (channel.times <= grid[-1])
    times, values = channel.times[kept], channel.values[kept]
    if channel.is_held:
        back = made[np.clip(np.searchsorted(grid, times + _ON / rate, "right") - 1, 0, len(made) - 1)]
    else:
        back = _through(grid, made, times)
    size, noise = float(values.std()), 0.0 if channel.is_held else float(white_noise(values[:, None])[0])
    lost = float(np.sqrt(((back - values) ** 2).mean()))
    if lost**2 <= (_LOST * size) ** 2 + (2.0 * noise) ** 2:
        return []
    return [
        f"resampling {channel.label} from {1.0 / channel.step:.4g} to {rate:.4g} Hz loses {100.0 * lost / size:.2g} % "
        f"of its variation, which is faster than half of that rate; a higher one keeps it"
    ]
