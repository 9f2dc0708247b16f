"""Motion columns: records of one motion as arrays (samples,), checked, and the turns of a force up and down."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError, RecordError
from masking.lab.records import clock

LEAST_SAMPLES = 200  # that are needed
TURNED, SWEPT = 0.02, 0.05  # of its range: a force turns where it comes back by this, in saw-teeth and in ramps
NOISE_FACTOR = 8.0  # standard deviations of its noise, which makes no turns: they are larger
COVERED = 0.85  # of the travel, which both directions must cover


def columns(**values: ArrayLike) -> tuple[Array, ...]:
    """Finite columns of one length, first a clock in equal steps; a RecordError for others, short or constant ones."""
    found = {}
    for name, value in values.items():
        try:
            column = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RecordError(f"{name} is no column of real numbers ({error})") from None
        if column.ndim == 2 and column.shape[1] == 1:
            column = column[:, 0]
        if column.ndim != 1:
            raise RecordError(f"{name} has shape {column.shape}; give one column (samples,)")
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            raise RecordError(
                f"{name} must be finite: sample {bad[0]} (counted from 0) is {column[bad[0]]}, {len(bad)} in all; take "
                "a stretch of the record without them, or record it again"
            )
        found[name] = column
    lengths = {name: len(column) for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise RecordError(f"the columns differ in length: {listed}; give all over the same samples")
    times, *others = found
    if lengths[times] < LEAST_SAMPLES:
        few = f"the record has {lengths[times]} samples, at least {LEAST_SAMPLES} are needed; record it longer"
        raise RecordError(few)
    clock.rate(found[times], "the record")
    for name in others:
        if np.ptp(found[name]) <= 1e-12 * np.abs(found[name]).max():
            raise RecordError(f"{name} is constant at {found[name][0]:.6g}; see that it is connected and excited")
    return tuple(found.values())


def probability(level: float) -> float:
    """Level of confidence; a ModelError where it is not between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise ModelError(f"the level is {level:g}; give a probability between 0 and 1, such as 0.95")
    return float(level)


def refuse_not_positive(**values: float) -> None:
    """Refuse settings that are not finite and above 0, by a ModelError."""
    for name, value in values.items():
        if not np.isfinite(value) or value <= 0.0:
            raise ModelError(f"{name} is {value!r}; give a finite number above 0")


def turns(values: Array, least: float) -> list[int]:
    """Samples at which a signal turns and comes back by `least`, the first and last sample included."""
    slopes = np.sign(np.diff(values))
    moving = np.flatnonzero(slopes)
    turned = moving[1:][slopes[moving[1:]] != slopes[moving[:-1]]]
    found, up = [0], 0
    for i in (*map(int, turned), len(values) - 1):
        change = values[i] - values[found[-1]]
        if up == 0:
            if abs(change) >= least:
                up = 1 if change > 0 else -1
                found.append(i)
        elif change * up > 0:
            found[-1] = i
        elif abs(change) >= least:
            up = -up
            found.append(i)
    return found


def part_of(force: Array, part: float) -> float:
    """Part of the range of a force, or more where its noise is larger.

    White noise of deviation s has second differences with a median size of 0.6745 sqrt(6) s.
    """
    noise = float(np.median(np.abs(np.diff(force, 2)))) / (0.6745 * np.sqrt(6.0))
    return float(max(part * np.ptp(force), NOISE_FACTOR * noise))


def directions(force: Array) -> Array:
    """1 where a force rises, -1 where it falls, 0 where it turns (samples,)."""
    found = np.zeros(len(force))
    at = turns(force, part_of(force, SWEPT))
    at[-1] = len(force) - 1
    for first, last in itertools.pairwise(at):
        found[first + 1 : last] = np.sign(force[last] - force[first])
    return found


def refuse_one_way(x: Array, direction: Array) -> None:
    """Refuse a record whose ways up and down do not both cover the travel, by a RecordError."""
    edges = np.linspace(x.min(), x.max(), 51)
    covered = [np.histogram(x[direction == sign], edges)[0] > 0 for sign in (1.0, -1.0)]
    part = float(np.mean(covered[0] & covered[1]))
    if part < COVERED:
        raise RecordError(
            f"the force goes both up and down over only {100 * part:.0f} % of the travel, so that friction cannot be "
            "distinguished from the spring; let the ramp go up and down over all of it, such as 0, +A, -A, 0"
        )
