"""Attractors: where motions settle, and what holds of two motions of one model that have parted.

A motion is followed on by the model from where it ends, for some times its length, and so is a neighbour of it: what
both come to is an equilibrium or a periodic motion that attracts. Where the wanted motion comes to neither and its
largest Lyapunov exponent is positive, motions part whatever moves them, e-fold in 1/lambda: what can be compared then
is how often each value is taken (Kolmogorov and Smirnov), and the exponent along the motion.
Source: Ott (2002), Chaos in Dynamical Systems, chapters 1, 2 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from masking.analysis.stability.lyapunov_exponent import INTERVALS, exponent_along
from masking.compile.numerics.arrays import Array
from masking.errors import MaskingError
from masking.model.modelling.model import Model

_FURTHER: Final = 9  # times the length of the record, after which a motion that attracts has been reached
_MOST_STEPS: Final = 1_000_000  # of a motion that is followed, some seconds
_PARTS: Final = 1000  # of a record, whose first shows how many steps it takes
_MOST_ROWS: Final = 20_000  # of a motion that is looked at
_TOLERANCE: Final = 1e-9  # local relative error of integration
_ASIDE: Final = 0.01  # of the size of each state: how far aside a neighbour begins
_SAME: Final = 1e-3  # of the size of the record: two motions are one
_TIMED: Final = 1e-3  # relative: two periods are one
_STILL: Final = 1e-5  # of the size of the record: what moves less is at rest
_AWAY, _NEAR = 0.5, 0.3  # of the range: a motion has left where it is, and may have come back between two rows
_REPEATS: Final = 1e-3  # of the range, by which a period differs from the next at most
_REACHED: Final = 0.15  # of the size of the motion: the record ends on an attractor
_PARTED: Final = 0.5  # of the root of the mean square of each state, from which on two motions have parted
_ALIKE: Final = 0.1  # distance of two distributions that are taken to be one in any case
_TIMES: Final = 2.0  # that of the wanted motion over the same time, in which a distribution is alike
_EXPONENT: Final = 0.3  # of an exponent, by which another is alike in any case
_SURE: Final = 3.0  # standard errors
_MOST_STATES: Final = 24  # of a model whose variational equations are compiled within seconds

Kind = Literal["rest", "periodic"]


@dataclass(frozen=True)
class Attractor:
    """An equilibrium or a periodic motion, in the units of the model."""

    kind: Kind
    middle: dict[str, float]  # middle of the range of each coordinate, or its position at rest
    amplitude: dict[str, float]  # half the range of each coordinate; 0 at rest
    period: float  # 0 at rest

    def shown(self, sizes: Mapping[str, float]) -> Attractor:
        """The same in units of these sizes, by coordinate."""
        middle, amplitude = ({n: x / sizes[n] for n, x in part.items()} for part in (self.middle, self.amplitude))
        return replace(self, middle=middle, amplitude=amplitude)

    def is_near(self, other: Attractor, off: float) -> bool:
        """Whether another has the same period, and places that are off by so much at most."""
        pairs = [(a[n], b[n]) for a, b in ((self.middle, other.middle), (self.amplitude, other.amplitude)) for n in a]
        is_timed = abs(self.period - other.period) <= _TIMED * self.period
        return self.kind == other.kind and is_timed and all(abs(a - b) <= off for a, b in pairs)


@dataclass(frozen=True)
class Chaos:
    """Two motions of one chaotic system; times are those of the model."""

    exponent: float  # largest Lyapunov exponent of the wanted motion
    error: float  # its standard error
    along: float  # the exponent along the motion that was made
    time: float  # at which the motions have parted; that of the end where they have not
    first: float  # difference at first, of the rms of each state
    predicted: float  # time in which that grows to what parts them
    distribution: float  # largest distance between how often values were taken and how often the system takes them
    wanted: float  # that distance of the wanted motion over the same time
    is_alike: bool  # whether distribution and exponent are those of the wanted system


@dataclass(frozen=True)
class Parting:
    """Why a motion that was made is far from the wanted one of the same model; the first that is known, or none."""

    chaos: Chaos | None = None
    wanted: Attractor | None = None  # where the wanted motion settles
    reached: Attractor | None = None  # where the motion that was made settled
    is_same: bool = False  # whether that is the same periodic motion, on which they differ in phase

    def as_dict(self, sizes: Mapping[str, float]) -> dict[str, Any]:
        """Parting as JSON can hold it, with coordinates in units of these sizes."""
        if self.chaos is not None:
            return {"chaos": asdict(self.chaos)}
        if self.wanted is None or self.reached is None:
            return {}
        ends = {"wanted": self.wanted, "reached": self.reached}
        return {**{name: asdict(end.shown(sizes)) for name, end in ends.items()}, "is_same": self.is_same}


def parting(model: Model, times: Array, made: Array, wanted: Array) -> Parting:
    """Compare a motion that was made with the wanted one of a model, from the same beginning.

    Args:
        model: without delays, events and inputs that are not constant; it may hold the time.
        times: in the model's units of time (m,), evenly spaced.
        made: states in the model's units (m, 2 n + k).
        wanted: those of the wanted motion.

    Returns:
        what is known; nothing where the model has delays or events, the motion cannot be followed on, or takes too many
        steps for that, or comes to neither an attractor nor chaos, which is looked for in models of few states.
    """
    try:
        model.check_ordinary("an attractor")
        if _FURTHER * _steps(model, times, wanted) > _MOST_STEPS:
            return Parting()
        size = float(np.abs(wanted).max())
        end, reached = (_settled(model, times, motion, wanted) for motion in (wanted, made))
        if end is None and reached is None and made.shape[1] <= _MOST_STATES:
            return Parting(_chaos(model, times, made, wanted))
        if end is None or reached is None or not _is_on(made, reached, model):
            return Parting()
        is_same = end.is_near(reached, 10.0 * _SAME * size)
        return Parting() if is_same and end.kind == "rest" else Parting(None, end, reached, is_same)
    except MaskingError:  # of a model with delays or events, and of motions that cannot be followed
        return Parting()


def _steps(model: Model, times: Array, wanted: Array) -> float:
    """Steps that the motion of a record takes, by those of its first thousandth."""
    part = times[0] + np.array([0.0, (times[-1] - times[0]) / _PARTS])
    u, p = np.zeros(len(model.inputs)), model.values()
    return _PARTS * float(model.kernels.integrate(part, wanted[0], u, p, tolerance=_TOLERANCE).steps)


def _settled(model: Model, times: Array, motion: Array, wanted: Array) -> Attractor | None:
    """Attractor that a motion comes to, and a neighbour with it; None where they come to none."""
    sizes = np.abs(wanted).max(axis=0)
    aside, size = motion[-1] + _ASIDE * np.where(sizes > 0.0, sizes, 1.0), float(sizes.max())
    end, beside = (_end(model, _followed(model, times, state), size) for state in (motion[-1], aside))
    return end if end and beside and end.is_near(beside, _SAME * size) else None


def _followed(model: Model, times: Array, state: Array, *, whole: bool = False) -> tuple[Array, Array]:
    """Times and states of a motion that goes on from its end: its last part, as long as the record, or the whole."""
    length = float(times[-1] - times[0])
    rows = min(len(times) * (_FURTHER if whole else 1), _MOST_ROWS)
    instants = times[-1] + length * np.linspace(0.0 if whole else _FURTHER - 1.0, _FURTHER, rows + 1)[1:]
    at = np.concatenate([times[-1:], instants])
    u = np.zeros(len(model.inputs))
    states = model.kernels.integrate(at, state, u, model.values(), tolerance=_TOLERANCE).states
    return instants, states[1:, : len(state)]


def _end(model: Model, motion: tuple[Array, Array], size: float) -> Attractor | None:
    """What the last part of a motion repeats; None where it neither rests nor repeats."""
    (times, states), n = motion, len(model.coordinates)
    low, high = states.min(axis=0), states.max(axis=0)
    if not np.isfinite(states).all():
        return None
    still = (high - low).max() <= _STILL * size
    period = 0.0 if still else _period(times, states)
    if period is None:
        return None
    places = zip(model.coordinates, 0.5 * (low + high)[:n], 0.5 * (high - low)[:n], strict=True)
    found = {name: (float(middle), 0.0 if still else float(half)) for name, middle, half in places}
    middles, halves = ({name: pair[i] for name, pair in found.items()} for i in (0, 1))
    return Attractor("rest" if still else "periodic", middles, halves, period)


def _period(times: Array, states: Array) -> float | None:
    """Shortest time after which states (m, .) are what they were; None for none within half of the record."""
    step, half = float(times[1] - times[0]), len(times) // 2
    ranges = np.ptp(states, axis=0)
    scaled = states / np.where(ranges > _REPEATS * ranges.max(), ranges, np.inf)
    rates = np.gradient(scaled, step, axis=0)
    away = np.abs(scaled - scaled[-1]).max(axis=1)[::-1]
    beside = np.pad(away, 1, constant_values=np.inf)
    nearest = (away < _NEAR) & (away <= beside[:-2]) & (away < beside[2:]) & (np.maximum.accumulate(away) > _AWAY)
    for rows in np.flatnonzero(nearest[:half]):
        gap, rate = scaled[-rows:] - scaled[-2 * rows : -rows], rates[-rows:]
        late = float(np.sum(gap * rate) / np.sum(rate**2))
        if np.abs(gap - late * rate).max() <= _REPEATS + (step * np.abs(rates).max()) ** 2:
            return float(rows * step - late)
    return None


def _is_on(motion: Array, end: Attractor, model: Model) -> bool:
    """Whether the last part of a motion that was made moves as its attractor does."""
    last = motion[len(motion) - len(motion) // 5 :, : len(model.coordinates)]
    size = max(*end.amplitude.values(), *(abs(x) for x in end.middle.values()), 1e-300)
    low, high = last.min(axis=0), last.max(axis=0)
    own = zip(end.middle.values(), end.amplitude.values(), 0.5 * (low + high), 0.5 * (high - low), strict=True)
    return all(max(abs(m - a), abs(h - b)) <= _REACHED * size for m, h, a, b in own)


def _chaos(model: Model, times: Array, made: Array, wanted: Array) -> Chaos | None:
    """How chaotic motions parted, and whether they are of one kind; None where the wanted one is not chaotic."""
    length = float(times[-1] - times[0])
    instants = np.linspace(times[0], times[0] + _FURTHER * length, INTERVALS + 1)
    found = exponent_along(model, instants, wanted[:1], tolerance=_TOLERANCE)
    if not found.is_chaotic:
        return None
    sizes = np.sqrt(np.mean((wanted - wanted.mean(axis=0)) ** 2, axis=0))
    moving = sizes > 0.0
    apart = (np.abs(made - wanted)[:, moving] / sizes[moving]).max(axis=1)
    beyond = np.flatnonzero(apart > _PARTED)
    time = float(times[beyond[0]] if len(beyond) else times[-1])
    fold = max(2, int(np.searchsorted(times - times[0], 1.0 / found.value)))
    first = max(float(np.median(apart[:fold])), np.finfo(float).tiny)
    every = max(1, (len(times) - 1) // INTERVALS)
    along = exponent_along(model, times[::every], made[::every], tolerance=_TOLERANCE)
    _, typical = _followed(model, times, wanted[-1], whole=True)
    distance, own = (max(_distances(one[len(one) // 2 :], typical)) for one in (made, wanted))
    predicted = max(0.0, math.log(_PARTED / first)) / found.value
    off = max(_EXPONENT * found.value, _SURE * math.hypot(found.error, along.error))
    is_alike = abs(along.value - found.value) <= off and distance <= max(_ALIKE, _TIMES * own)
    return Chaos(found.value, found.error, along.value, time, first, predicted, distance, own, is_alike)


def _distances(first: Array, second: Array) -> Iterator[float]:
    """Largest difference of the parts of the time in which each state is below any value (Kolmogorov-Smirnov)."""
    for a, b in zip(first.T, second.T, strict=True):
        at = np.sort(np.concatenate([a, b]))
        one, other = (np.searchsorted(np.sort(x), at, side="right") / len(x) for x in (a, b))
        yield float(np.abs(one - other).max())
