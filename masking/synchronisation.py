"""Measures of synchronisation of two oscillations: phase difference, peak of their sum, anti-phase (definition 5.3).

Numbers of sections, figures, definitions and formulas are those of Rijlaarsdam (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from masking.errors import RecordError

Series = NDArray[np.float64]

_NODES = 6  # of the interpolating polynomial: error 1e-5 of the amplitude at 20 samples a period
_CONTINUED_PERIODS = 8
_LEAST_PERIODS = 3


@dataclass(frozen=True, slots=True)
class AntiPhase:
    """How nearly two oscillations are in anti-phase (definition 5.3).

    |a(t) - alpha b(t + T/2)| <= eps held over the part of the record that was looked at. `alpha`: ratio of amplitudes,
    dimensionless, positive in anti-phase; `eps`: unit of the oscillations; `period`: T, unit of time.
    """

    alpha: float
    eps: float
    period: float


def phase_difference(t: Series, a: Series, b: Series) -> Series:
    """Phase of `a` minus phase of `b`, followed continuously (unwrapped), from their analytic signals.

        phi = arg(A conj(B)),    A = a + i H[a],    B = b + i H[b],    H the Hilbert transform

    t: time, shape (samples,), strictly increasing; a, b: oscillations about any constant, same shape, any unit.
    Returns radians, shape (samples,); the first value lies in (-pi, pi]. A record of fewer than three periods is a
    `RecordError`. Both ends are continued by a sinusoid fitted to the last two periods there, so that the ends of the
    record are as true as its middle. Source: section 5.3, Fig. 5.1 (b).
    """
    grid = np.linspace(t[0], t[-1], len(t))
    if np.allclose(grid, t, rtol=0.0, atol=1e-6 * (t[-1] - t[0]) / max(len(t) - 1, 1)):
        return _unwrapped(a, b)
    on_grid = _unwrapped(interpolate(t, a, grid), interpolate(t, b, grid))
    return np.interp(t, grid, on_grid)


def principal(phase: Series) -> Series:
    """Reduce an angle to [-pi/2, 3 pi/2): in-phase (0) and anti-phase (pi) both lie inside, away from the seam."""
    return np.mod(phase + np.pi / 2, 2 * np.pi) - np.pi / 2


def mean_phase(phase: Series) -> tuple[float, float]:
    """Circular mean of an angle, folded to [0, pi], and how constant it is (1: constant, 0: evenly spread)."""
    vector = complex(np.mean(np.exp(1j * phase)))
    return abs(float(np.angle(vector))), abs(vector)


def period(t: Series, a: Series) -> float:
    """Mean period of an oscillation, from the growth of its analytic signal's phase; NaN for fewer than three periods.

    t: time, shape (samples,), evenly spaced; a: oscillation, same shape, any unit. Returns the unit of `t`.
    """
    try:
        phase = np.unwrap(np.angle(analytic_signal(a)))
    except RecordError:
        return float("nan")
    centred = t - np.mean(t)
    slope = float(centred @ phase / (centred @ centred))
    return 2 * np.pi / slope if slope > 0 else float("nan")


def peak_sum(t: Series, a: Series, b: Series, window: float) -> Series:
    """Largest |a + b| over the `window` of time before each sample, that sample included.

    t: time, shape (samples,), strictly increasing; a, b: same shape and unit; window: unit of `t`. Shape (samples,).
    Source: section 5.1, the remark on definition 5.3: anti-phase with equal amplitudes is |a + b| <= eps.
    """
    return running_peak(t, np.abs(a + b), window)


def synchronisation_time(t: Series, a: Series, b: Series, eps: float = 1e-4) -> float:
    """First time after which |a + b| stays below eps; NaN where it does not until the end of the record.

    t: time, shape (samples,), strictly increasing; a, b: same shape and unit, that of eps. Between the last sample that
    is not below and the next, the time is interpolated. Source: definition 8.1, with eps = 1e-4.
    """
    size = np.abs(a + b)
    above = np.flatnonzero(size >= eps)
    if len(above) == 0:
        return float(t[0])
    i = int(above[-1])
    if i + 1 == len(t):
        return float("nan")
    return float(t[i] + (t[i + 1] - t[i]) * (size[i] - eps) / (size[i] - size[i + 1]))


def running_peak(t: Series, a: Series, window: float) -> Series:
    """Largest value of `a` over the `window` of time before each sample, that sample included; shape (samples,)."""
    last = np.arange(len(t))
    first = np.searchsorted(t, t - window, side="left")
    level = np.frexp(last - first + 1)[1] - 1  # the largest power of two that fits into the window
    peaks, block = np.empty_like(a), a
    # `block[i]` is the peak over a[i : i + 2**k]; any range is the union of two overlapping blocks.
    for k in range(int(level.max()) + 1):
        here = level == k
        peaks[here] = np.maximum(block[first[here]], block[last[here] - 2**k + 1])
        block = np.maximum(block[: -(2**k)], block[2**k :])
    return peaks


def anti_phase(t: Series, a: Series, b: Series, fraction: float = 0.2) -> AntiPhase:
    """Fit definition 5.3 to the last `fraction` of the record.

        g(t) = a(t) - alpha b(t + T/2),    alpha = argmin ||g||,    eps = max |g|

    t: time, shape (samples,), strictly increasing; a, b: oscillations about zero, same shape and unit. T is the mean
    period of the larger of the two. A part with fewer than three periods is a `RecordError`.
    Source: (5.3).
    """
    part = t >= t[-1] - fraction * (t[-1] - t[0])
    t, a, b = t[part], a[part], b[part]
    grid = np.linspace(t[0], t[-1], len(t))
    larger = a if a @ a >= b @ b else b
    whole = period(grid, interpolate(t, larger, grid))
    if not np.isfinite(whole):
        raise RecordError(f"the last {fraction:.0%} of the record holds fewer than three periods of oscillation")
    inside = t + whole / 2 <= t[-1]
    shifted = interpolate(t, b, t[inside] + whole / 2)
    power = float(shifted @ shifted)
    alpha = float(a[inside] @ shifted) / power if power > 0 else float("nan")
    return AntiPhase(alpha, float(np.max(np.abs(a[inside] - alpha * shifted))), whole)


def interpolate(t: Series, a: Series, at: Series) -> Series:
    """Value of a smooth series between its samples: the polynomial through the six nearest samples, on any grid."""
    nodes = min(_NODES, len(t))
    start = np.clip(np.searchsorted(t, at) - nodes // 2, 0, len(t) - nodes)
    abscissae = [t[start + k] for k in range(nodes)]
    value = np.zeros(len(at))
    for k, own in enumerate(abscissae):
        weight = np.ones(len(at))
        for other in abscissae[:k] + abscissae[k + 1 :]:
            weight *= (at - other) / (own - other)
        value += weight * a[start + k]
    return value


def analytic_signal(a: Series) -> NDArray[np.complex128]:
    """Complex signal whose real part is the oscillation about its mean and whose argument is its phase.

        A = a + i H[a],    H the Hilbert transform

    a: evenly sampled oscillation of at least three periods (else `RecordError`), shape (samples,), any unit.
    """
    # A Hann-weighted mean is hardly touched by the incomplete period at the ends.
    a = a - np.average(a, weights=np.hanning(len(a) + 2)[1:-1])
    cycles = int(np.argmax(np.abs(np.fft.rfft(a))[1:])) + 1 if len(a) > 1 else 0
    quarter = round(len(a) / (4 * max(cycles, 1)))
    if cycles < _LEAST_PERIODS or quarter < 1 or not np.any(a):
        raise RecordError("the record holds fewer than three periods of oscillation")
    before, after = _continuation(a[::-1], quarter)[::-1], _continuation(a, quarter)
    extended = np.concatenate([before, a, after])
    # One-sided spectrum, as in Marple, IEEE Trans. Signal Processing 47 (1999) 2600. The continuation has faded to zero
    # at both ends, so that zeros may fill it up to a power of two.
    size = 1 << (len(extended) - 1).bit_length()
    spectrum = np.fft.fft(extended, size)
    spectrum[1 : size // 2] *= 2.0
    spectrum[size // 2 + 1 :] = 0.0
    signal = np.fft.ifft(spectrum)
    return signal[len(before) : len(before) + len(a)]


def _unwrapped(a: Series, b: Series) -> Series:
    return np.unwrap(np.angle(analytic_signal(a) * np.conj(analytic_signal(b))))


def _continuation(a: Series, quarter: int) -> Series:
    """Continue an oscillation beyond its end and let it fade out over some periods.

    Any sinusoid obeys a[n + m] = c a[n] - a[n - m]; with m about a quarter of a period c is small and well determined,
    and odd harmonics are continued correctly too.
    """
    tail = a[-8 * quarter - 1 :]
    middle = tail[quarter:-quarter]
    power = float(middle @ middle)
    c = float(np.clip(middle @ (tail[2 * quarter :] + tail[: -2 * quarter]) / power, -1.9, 1.9)) if power > 0 else 0.0
    blocks = [a[-2 * quarter : -quarter], a[-quarter:]]
    for _ in range(4 * _CONTINUED_PERIODS):
        blocks.append(c * blocks[-1] - blocks[-2])
    series = np.concatenate(blocks[2:])
    fade: Series = np.cos(np.linspace(0, np.pi / 2, len(series))) ** 2
    return series * fade
