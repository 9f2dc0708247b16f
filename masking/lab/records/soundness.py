"""Soundness of a record: readings that wrap, are clipped, mark what is missing by a number, or stopped before its end.

Nothing is changed. What is suspected is said in words, with where it is and what to do about it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.lab.records import clock
from masking.lab.records.noise_estimate import white_noise

_AGAIN = 3  # times that something happens again and again
_JUMP, _STEP = 0.6, 0.25  # of the range: a step that a turn makes at least, and steps beside it at most
_ONE_SIZE = 0.03  # relative: sizes of jumps that are one
_FAST = 0.4  # of a turn between samples, from which turns may be miscounted
_AROUND = 4  # samples on either side of a jump that show how the reading moves
_FLAT = 3  # samples of one value in a row
_CUT = 3.0  # times the resolution: least step into a stretch that is clipped
_ROUNDED = 12.0  # resolutions that step times samples exceed there; 4 at the rounded top of a parabola
_ELSEWHERE = 0.05  # of the samples that are flat elsewhere at most
_FAR = 10.0  # times the range of all else: what is so far away is no reading
_RARE = 0.1  # of the samples: marks of what is missing at most
_TAIL = 0.02  # of the samples: a stop before the end at least
_FEWEST = 20  # samples of it
_QUIET = 6.0  # deviations of its noise that a reading at rest stays within
_LIVELY = 0.5  # of its deviation before: what goes on
_SUDDEN = 8  # samples before a stop
TURNS = {"rad": 2.0 * math.pi, "deg": 360.0, "degree": 360.0, "1": 2.0 * math.pi, "turn": 1.0}


@dataclass(frozen=True)
class Signals:
    """What a record holds: times in s (samples,), and channels by their names (samples,), in their units.

    `name` is that of the record, a path or a part of one.
    """

    name: str
    times: Array
    inputs: Mapping[str, Array]
    readings: Mapping[str, Array]
    units: Mapping[str, str]
    turns: Mapping[str, float] = field(default_factory=dict)  # of readings that wrap, which go on here


def doubts(signals: Signals) -> tuple[str, ...]:
    """What is suspected of a record, a sentence each; of each channel what is said first."""
    found = [*_stopped(signals)]
    if found:
        return tuple(found)
    for name, values in signals.readings.items():
        kinds = (_fast,) if name in signals.turns else (_marked, _wrapped, _clipped)
        found += [words for kind in kinds if (words := kind(signals, name, values))][:1]
    return tuple(found)


def turn_of(values: Array) -> float:
    """Size of the turn that a reading (samples,) jumps by again and again, or 0 where it does not.

    Before and after a jump it moves on, against the jump; nothing else in it is as large.
    """
    span = float(np.ptp(values))
    steps = np.diff(values)
    at = np.flatnonzero(np.abs(steps) >= _JUMP * span) if span > 0.0 else np.array([], dtype=int)
    at = at[(at >= _AROUND) & (at < len(steps) - _AROUND)]
    if len(at) < _AGAIN or len(at) > len(steps) // (2 * _FLAT):
        return 0.0
    beside = np.abs(np.stack([steps[at - 1], steps[at + 1]]))
    alone = at[(beside <= _STEP * span).all(axis=0)]
    if len(alone) < max(_AGAIN, 0.5 * len(at)):  # where it turns back at the seam, jumps follow one another
        return 0.0
    before = (values[alone] - values[alone - _AROUND]) / _AROUND
    after = (values[alone + 1 + _AROUND] - values[alone + 1]) / _AROUND
    is_near = (np.abs(before) <= _STEP * span) & (np.abs(after) <= _STEP * span)
    alone, before, after = alone[is_near], before[is_near], after[is_near]
    jumps = steps[alone] - 0.5 * (before + after)
    if len(alone) < _AGAIN:
        return 0.0
    size = float(np.median(np.abs(jumps)))
    is_one = np.abs(np.abs(jumps) - size) <= _ONE_SIZE * size
    moves_on = (before * jumps < 0.0) & (after * jumps < 0.0)
    is_turn = is_one.mean() >= 0.9 and moves_on.mean() >= 0.8 and span <= (1.0 + _ONE_SIZE) * size
    return size if is_turn else 0.0


def _fast(signals: Signals, name: str, values: Array) -> str:
    """Turning so fast that turns cannot be counted."""
    part = float(np.abs(np.diff(values)).max(initial=0.0)) / signals.turns[name]
    if part < _FAST:
        return ""
    return (
        f"{name} moves by up to {part:.2g} of a turn from one sample to the next: turns are counted by less than "
        "half of one; record it at a higher rate"
    )


def _wrapped(signals: Signals, name: str, values: Array) -> str:
    size = turn_of(values)
    if not size:
        return ""
    unit = signals.units.get(name, "1")
    whole = TURNS.get(unit, 0.0)
    is_whole = abs(size - whole) <= _ONE_SIZE * whole
    said = "360 deg" if is_whole else f"{size:.4g} {'' if unit == '1' else unit}".rstrip()
    at = signals.times[int(np.argmax(np.abs(np.diff(values)) >= _JUMP * size))]
    return (
        f"{name} jumps by {size:.4g} again and again, first at t = {at:.6g} s, as a reading that wraps does; if it "
        f"does, declare it in the plant: sensors: {{{name}: {{wraps: {said}}}}}"
    )


def _clipped(signals: Signals, name: str, values: Array) -> str:
    """Readings that stay at one extreme again and again, and come there too fast to be at a rounded top."""
    starts, lengths = _flats(values)
    span = float(np.ptp(values))
    if not len(starts) or not span:
        return ""
    held = values[starts]
    steps = np.abs(np.diff(values))
    resolution = float(steps[steps > 1e-12 * span].min(initial=span))
    for extreme in (values.max(), values.min()):
        flat = held == extreme
        inside = flat & (starts >= 2) & (starts + lengths < len(values) - 1)
        into = np.abs(values[starts[inside] - 1] - values[starts[inside] - 2])
        is_cut = (into >= _CUT * resolution) & (into * lengths[inside] > _ROUNDED * resolution)
        elsewhere = float(lengths[(held != values.max()) & (held != values.min())].sum())
        if np.count_nonzero(is_cut) >= _AGAIN and elsewhere <= _ELSEWHERE * len(values):
            cut = np.flatnonzero(inside)[is_cut]
            first, count = signals.times[starts[cut[0]]], int(lengths[flat].sum())
            unit = signals.units.get(name, "1").replace("1", "")
            ends = np.unique([0, *starts[flat], *(starts + lengths)[flat], len(values)]).tolist()
            return (
                f"{name} stays at {extreme:.6g} {unit}".rstrip() + f" in {np.count_nonzero(flat)} stretches, "
                f"{count} samples, first at t = {first:.6g} s: is it clipped there? Then make its range wider, or use "
                f"a part without{clock.longest(signals.times, ends, signals.name)}"
            )
    return ""


def _flats(values: Array) -> tuple[Array, Array]:
    """First samples and lengths of stretches in which a channel (samples,) has one value."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    starts = np.concatenate([[0], edges])
    lengths = np.diff(np.append(starts, len(values)))
    is_long = lengths >= _FLAT
    return starts[is_long], lengths[is_long]


def _marked(signals: Signals, name: str, values: Array) -> str:
    """Number far from all else that stands for what is missing."""
    for extreme in (values.max(), values.min()):
        rest = values[values != extreme]
        count = len(values) - len(rest)
        if not len(rest) or count > _RARE * len(values):
            continue
        away = np.abs(extreme - rest).min()
        if away > _FAR * max(float(np.ptp(rest)), 1e-300):
            at = np.flatnonzero(values == extreme)
            ends = np.unique([0, *at, *(at + 1), len(values)]).tolist()
            times = "once" if count == 1 else f"{count} times"
            return (
                f"{name} reads {extreme:.6g} {times}, first at t = {signals.times[at[0]]:.6g} s, far from all else: "
                f"if that stands for what is missing, leave the cells empty and give --resample, or use a part "
                f"without{clock.longest(signals.times, ends, signals.name)}"
            )
    return ""


def _stopped(signals: Signals) -> Iterator[str]:
    """All readings that rest from some time on until the end, or one that has one value there, while others go on."""
    count = len(signals.times)
    rest = {name: at for name, values in signals.readings.items() if (at := _rest(values))}
    is_rig = len(rest) == len(signals.readings)
    if not is_rig:
        rest = {n: at for n, at in rest.items() if not np.ptp(signals.readings[n][at:]) and _is_sudden(n, at, signals)}
    if not rest:
        return
    at = max(rest.values()) if is_rig else min(rest.values())
    others = {n: x for n, x in {**signals.readings, **signals.inputs}.items() if n not in rest}
    lively = [name for name, values in others.items() if values[at:].std() > _LIVELY * values[:at].std() > 0.0]
    if not lively:
        return
    part = clock.longest(signals.times, [0, at, count], signals.name) if 2 * at > count else ""
    stay, go = ("stay where they are" if len(rest) > 1 else "stays where it is"), "go" if len(lively) > 1 else "goes"
    yield (
        f"{' and '.join(rest)} {stay} from t = {signals.times[at]:.6g} s to the end, while {' and '.join(lively)} {go} "
        f"on: did {'the rig' if is_rig else 'the sensor'} stop there? Then use what was recorded before{part}"
    )


def _rest(values: Array) -> int:
    """First sample from which a channel stays within its noise until the end, as nowhere before; 0 for none."""
    count = len(values)
    least = max(_FEWEST, int(_TAIL * count))
    changes = np.flatnonzero(values != values[-1])
    at = int(changes[-1]) + 1 if len(changes) else 0
    if count - at < least < count:
        noise = float(white_noise(values[:, None])[0])
        off = np.flatnonzero(np.abs(values - np.median(values[-least:])) > _QUIET * noise)
        at = int(off[-1]) + 1 if len(off) else 0
    if at < 4 * _FEWEST or count - at < least:
        return 0
    block = min((count - at) // 2, at // 4)
    before = np.ptp(values[: at // block * block].reshape(-1, block), axis=1)
    sticks = (before <= 1.5 * np.ptp(values[at:]) + 1e-9 * np.ptp(values)).any()
    return 0 if sticks else at


def _is_sudden(name: str, at: int, signals: Signals) -> bool:
    """Whether a reading is in full motion when it stops."""
    steps = np.abs(np.diff(signals.readings[name][: at + 1]))
    return bool(steps[-_SUDDEN:].mean() >= 0.2 * np.sqrt((steps**2).mean()))
