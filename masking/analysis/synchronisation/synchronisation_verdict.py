"""Verdict: in which way the end of a record shows two oscillators to be synchronised, if at all."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from masking.analysis.synchronisation.measures import (
    Oscillation,
    Series,
    mean_phase,
    on_even_grid,
    period,
    proportion,
    synchronisation_time,
)
from masking.display.printed_result import Printed
from masking.errors import RecordError

Kind = Literal["in-phase", "anti-phase", "locked", "beating", "death", "not synchronised"]

_LEAST_PERIODS: Final = 5  # of the slower oscillator in the end that is looked at, where the record has as many
_LARGEST: Final = 5  # n and m of a lock
_ASIDE: Final = 0.02  # relative, how far n times one frequency may be from m times the other to be tried
NEAR: Final = 0.1 * math.pi  # how near to 0 or pi counts as in-phase or anti-phase
_AT_REST: Final = 0.03  # of the other's size: below this an oscillator has died, if it was larger before
_FADED: Final = 5.0  # times its rms at the end, what it has been at most; sqrt(2) is that of a steady one
_STEADY: Final = 0.9  # length of the mean unit vector of a phase that is locked
_TURN: Final = 0.1  # rad, by which a locked phase may drift over the end of the record
_PARTS: Final = 10  # of a record, in each of which a phase is averaged against noise
_STRAIGHT: Final = 0.1  # of its whole drift, what a phase that drifts all along may stray from a line
_SURE: Final = 3.0  # times its scatter: a smaller drift may be chance
_REGULAR: Final = 0.5  # rad, by which the phase of a regular oscillation deviates from a line
_SLOW: Final = 0.3  # of the mean frequency: a difference of two that is still heard as a beat
_DEPTH: Final = 0.3  # rms of the exchange of power, relative, in a beat
_SINGLE: Final = 0.5  # of the power of that exchange, in its largest line


@dataclass(frozen=True, repr=False, slots=True)
class Synchronisation(Printed):
    """What the end of a record shows of two oscillators a and b."""

    # 'in-phase', 'anti-phase', 'locked' (n:m, or 1:1 at another phase), 'beating', 'death' or 'not synchronised'
    kind: Kind
    names: tuple[str, str]  # of the two
    periods: tuple[float, float]  # of the two, unit of time; NaN where one does not oscillate
    ratio: tuple[int, int] = (0, 0)  # (n, m) of a lock: n phases of a advance as m of b do; (0, 0) for none
    phase: float = math.nan  # mean of n arg A - m arg B over the end, in (-pi, pi], rad; NaN without a lock
    steady: float = 0.0  # length of the mean unit vector of that, or of the plain difference: 1 constant, 0 spread
    alpha: float = math.nan  # ratio of the amplitudes, a = alpha b shifted by the phase (5.3); NaN without a lock
    # largest |a(t) - alpha b(t + shift)| over the end (definition 5.2), unit of a; NaN unless n = m
    eps: float = math.nan
    # first time after which that stays within `within` of the amplitude of a (definition 8.1), or the phase within as
    # many rad where n != m; NaN where it does not
    time: float = math.nan
    within: float = math.nan  # the part of the amplitude that was asked for
    beat: float = math.nan  # period of the beat, unit of time; NaN where there is none
    dead: str = ""  # name of the oscillator that has come to rest, "" where there is none
    start: float = math.nan  # where the end that was looked at begins

    @property
    def is_synchronised(self) -> bool:
        """Whether the two are locked to each other in any way."""
        return self.kind in {"in-phase", "anti-phase", "locked"}

    def __str__(self) -> str:
        a, b = self.names
        if self.kind == "death":
            return f"{self.dead} has come to rest."
        if self.kind == "beating":
            return f"{a} and {b} beat with a period of {self.beat:.4g}: they are not synchronised."
        if not self.is_synchronised:
            return f"{a} and {b} are not synchronised."
        n, m = self.ratio
        since = f", from t = {self.time:.5g} on to {self.within:g} of the amplitude" if math.isfinite(self.time) else ""
        if n != m:
            since = f", from t = {self.time:.5g} on to {self.within:g} rad" if since else ""
            return f"{a} and {b} are locked {n}:{m} (periods {self.periods[0]:.5g} and {self.periods[1]:.5g}){since}."
        how = f"locked {self.phase / math.pi:.3f} pi apart" if self.kind == "locked" else f"{self.kind}"
        at = "" if self.kind == "locked" else f" ({abs(self.phase) / math.pi:.3f} pi)"
        where = "in " * (self.kind == "anti-phase")
        fit = f"alpha = {self.alpha:.4f}, eps = {self.eps:.3g}, T = {self.periods[0]:.5g}"
        return f"{a} and {b} are {where}{how}{at}: {fit}{since}."


def synchronisation(
    t: Series, a: Series, b: Series, *, eps: float = 0.05, fraction: float = 0.2, names: tuple[str, str] = ("a", "b")
) -> Synchronisation:
    """Say in which way two oscillators are synchronised at the end of a record.

    They are locked n:m where n arg A - m arg B neither spreads nor drifts (Pikovsky, Rosenblum and Kurths,
    Synchronization (2001), section 3.2.4). A phase that drifts evenly over the whole record, by more than 0.1 rad and
    more than its noise makes, is no lock, however slowly.

    Args:
        t: time (samples,), strictly increasing, any unit.
        a: one motion (samples,), about any constant or slow drift, any unit.
        b: the other, likewise, same unit.
        eps: part of the amplitude for which `time` is given (definition 8.1).
        fraction: of the record, its end that is looked at; longer where that is less than five periods.
        names: of the two, for the sentence.

    Raises:
        RecordError: the series do not fit each other, are not finite or shorter than 16 samples; `eps` is not positive
            or `fraction` no part.
    """
    if not (eps > 0.0 and 0.0 < fraction <= 1.0):
        raise RecordError(f"eps is {eps:g} and fraction {fraction:g}; eps is positive, fraction above 0 and at most 1")
    t, a, b = _checked(t, a, b)
    tail = t >= t[-1] - fraction * (t[-1] - t[0])
    whole = (Oscillation.of(a), Oscillation.of(b))
    longest = max((p for p in (one.period(t[-1] - t[0]) for one in whole) if math.isfinite(p)), default=0.0)
    tail |= t >= t[-1] - _LEAST_PERIODS * longest
    start = float(t[tail][0])
    late = (Oscillation.of(a[tail]), Oscillation.of(b[tail]))
    sizes = [float(np.sqrt(np.mean(one.series**2))) for one in late]
    first, second = (one.period(t[-1] - start) for one in late)
    largest = max(float(np.ptp(a)), float(np.ptp(b)))
    nothing = Synchronisation("not synchronised", names, (first, second), start=start)
    if longest == 0.0:  # neither has three periods
        return nothing
    both, least = max(sizes) <= _AT_REST**2 * largest, int(sizes[1] < sizes[0])
    death = replace(nothing, kind="death", dead="each of them" if both else names[least])
    is_quiet = min(sizes) <= _AT_REST * max(sizes)
    # What has always been as small beside the other may be driven by it, or be in another unit.
    if both or (is_quiet and float(np.abs(whole[least].series).max()) > _FADED * min(sizes)):
        return death
    try:
        signals = (whole[0].analytic_signal(), whole[1].analytic_signal())
    except RecordError:  # fewer than three periods
        return death if is_quiet else nothing
    phases = tuple(_phase(t, x, length) for x, length in zip(signals, nothing.periods, strict=True))
    for n, m in _ratios(t, phases, tail):
        difference = n * phases[0] - m * phases[1]
        if _is_locked(t, difference, tail, (n, m)):
            found = replace(nothing, ratio=(n, m), steady=mean_phase(difference[tail])[1], within=eps)
            return _described((late[0].series, late[1].series), difference, found, _Record(t, signals, tail))
    if is_quiet:
        return death
    beat = _beat(t, signals)
    steady = mean_phase((phases[0] - phases[1])[tail])[1]
    kind: Kind = "beating" if math.isfinite(beat) else "not synchronised"
    return replace(nothing, kind=kind, steady=steady, beat=beat)


def _checked(t: Series, a: Series, b: Series) -> tuple[Series, ...]:
    """Series on an even grid."""
    t, a, b = (np.asarray(x, dtype=float) for x in (t, a, b))
    if t.ndim != 1 or a.shape != t.shape or b.shape != t.shape or len(t) < 16:
        raise RecordError(
            f"time and two motions have the shapes {t.shape}, {a.shape} and {b.shape}; give one row of at least 16 "
            "samples each, of equal length"
        )
    if not (np.all(np.isfinite(t)) and np.all(np.isfinite(a)) and np.all(np.isfinite(b)) and np.all(np.diff(t) > 0)):
        raise RecordError("times must increase and all values be finite; leave out the rows that are not")
    return on_even_grid(t, a, b)


@dataclass(frozen=True, slots=True)
class _Record:
    """Time and analytic signals of a whole record, and its end."""

    t: Series
    signals: tuple[NDArray[np.complex128], NDArray[np.complex128]]
    tail: NDArray[np.bool_]


def _ratios(t: Series, phases: tuple[Series, ...], tail: Series) -> list[tuple[int, int]]:
    """(n, m) without a common factor that could lock the oscillators, the lowest orders first."""
    rates = [abs(_line(t[tail], phase[tail])[0]) for phase in phases]
    pairs = [(n, m) for n, m in itertools.product(range(1, _LARGEST + 1), repeat=2) if math.gcd(n, m) == 1]
    near = [(n, m) for n, m in pairs if abs(n * rates[0] - m * rates[1]) <= _ASIDE * m * rates[1]]
    return sorted(near, key=lambda pair: (sum(pair), pair))


def _is_locked(t: Series, difference: Series, tail: Series, ratio: tuple[int, int]) -> bool:
    """Whether a difference of phases, n of one less m of the other, neither spreads nor drifts."""
    late, whole = _Turn.of(t[tail], difference[tail]), _Turn.of(t, difference)
    turns = late.is_sure and late.size > _TURN * max(ratio)
    # A phase that goes on evenly over the whole record is that of two frequencies.
    is_even = whole.is_sure and whole.size > _TURN and whole.stray <= _STRAIGHT * whole.size + whole.noise
    return not (mean_phase(difference[tail])[1] < _STEADY or turns or is_even)


@dataclass(frozen=True, slots=True)
class _Turn:
    """By how much a phase turns along a line, what its means over parts stray from that, and its noise there, rad."""

    size: float
    stray: float
    noise: float

    @classmethod
    def of(cls, t: Series, phase: Series) -> _Turn:
        """Look at a phase in parts, in each of which it is averaged."""
        parts = np.array_split(np.arange(len(t)), _PARTS)
        times, means = (np.array([np.mean(x[part]) for part in parts]) for x in (t, phase))
        slope, stray = _line(times, means)
        noise = float(np.median([np.std(phase[part] - slope * (t[part] - np.mean(t[part]))) for part in parts]))
        return cls(abs(slope) * float(t[-1] - t[0]), stray, noise)

    @property
    def is_sure(self) -> bool:
        return self.size > _SURE * self.stray


def _line(t: Series, phase: Series) -> tuple[float, float]:
    """Slope of the line that fits a phase best, and the rms of the residual."""
    centred = t - np.mean(t)
    slope = float(centred @ phase / (centred @ centred))
    return slope, float(np.std(phase - slope * centred))


def _described(
    ends: tuple[Series, Series], difference: Series, found: Synchronisation, record: _Record
) -> Synchronisation:
    """Verdict of a lock: phase, alpha, eps and the time from which on it holds; `ends` are motions at the end."""
    (n, m), tail, (signal_a, signal_b) = found.ratio, record.tail, record.signals
    phase, within = float(np.angle(np.mean(np.exp(1j * difference[tail])))), found.within
    (first, second), found = found.periods, replace(found, phase=phase)
    if n != m:
        alpha = float(np.std(ends[0]) / np.std(ends[1]))
        turned = np.exp(1j * (difference - phase))
        time = synchronisation_time(record.t, np.abs(np.angle(_averaged(turned, record.t, first))), within)
        return replace(found, kind="locked", alpha=alpha, time=time)
    kind: Kind = "in-phase" if abs(phase) <= NEAR else "anti-phase" if abs(phase) >= math.pi - NEAR else "locked"
    whole = first if np.std(ends[0]) >= np.std(ends[1]) else second
    turn = {"in-phase": 0.0, "anti-phase": math.pi, "locked": phase}[kind]
    alpha, g = proportion(record.t[tail], *ends, turn / (2 * math.pi) * whole, whole)
    # The envelope of g, which needs no sample beyond the end and averages over noise.
    line = np.exp(-2j * np.pi * record.t / whole)
    envelope = np.abs(_averaged((signal_a - alpha * signal_b * np.exp(1j * turn)) * line, record.t, whole))
    amplitude = float(np.mean(np.abs(signal_a[tail])))
    time = synchronisation_time(record.t, envelope, within * amplitude)
    return replace(found, kind=kind, alpha=alpha, eps=float(np.nanmax(np.abs(g))), time=time)


def _phase(t: Series, signal: NDArray[np.complex128], length: float) -> Series:
    """Unwrapped phase of an analytic signal, averaged over a period, where it has one, against noise."""
    if not math.isfinite(length):
        return np.asarray(np.unwrap(np.angle(signal)), dtype=np.float64)
    turn = 2 * np.pi * (t - t[0]) / length
    averaged = _averaged(signal * np.exp(-1j * turn), t, length)
    return np.asarray(np.unwrap(np.angle(averaged)) + turn, dtype=np.float64)


def _averaged(x: NDArray[np.complex128], t: Series, length: float) -> NDArray[np.complex128]:
    """Mean over a length of time around each sample, over less of it at both ends."""
    half = max(1, round(length / 2 * (len(x) - 1) / (t[-1] - t[0])))
    total = np.concatenate([[0.0], np.cumsum(x)])
    index = np.arange(len(x))
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(x))
    return np.asarray((total[last] - total[first]) / (last - first))


def _beat(t: Series, signals: tuple[NDArray[np.complex128], NDArray[np.complex128]]) -> float:
    """Period of the beat of two regular oscillations, NaN where there is none.

    Either each goes at its own, nearly equal, frequency, or they hand their power to and fro.
    """
    powers = [np.abs(x) ** 2 for x in signals]
    exchange = powers[0] / np.mean(powers[0]) - powers[1] / np.mean(powers[1])
    beat = period(t, exchange)
    if np.std(exchange) >= _DEPTH and math.isfinite(beat):
        line = np.exp(2j * np.pi * t / beat)
        part = 2.0 * abs(np.mean(exchange * np.conj(line))) ** 2 / np.mean(exchange**2)
        return beat if part >= _SINGLE else math.nan
    (rate_a, stray_a), (rate_b, stray_b) = (_line(t, np.unwrap(np.angle(x))) for x in signals)
    apart = abs(rate_a - rate_b)
    is_slow = apart <= _SLOW * 0.5 * (rate_a + rate_b) and apart * (t[-1] - t[0]) >= 2 * math.pi
    return 2 * math.pi / apart if is_slow and max(stray_a, stray_b) <= _REGULAR else math.nan
