"""Measures of synchronisation of two oscillations: phase difference, peak of their sum, anti-phase (definition 5.3).

Numbers of sections, figures, definitions and formulas are those of Rijlaarsdam (2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from masking import lazy_imports
from masking.errors import RecordError

Series = NDArray[np.float64]

_DEGREE = 5  # of interpolating splines: error 1e-5 of the amplitude at 20 samples a period
_CONTINUED_PERIODS = 8
_LEAST_PERIODS = 3
_TREND = 3  # degree of the drift that is separated from an oscillation
_REFITS = 5
_SETTLED = 1e-8  # relative change of a frequency after which another refit changes nothing
_ROUNDING = 1e-12
_NEWTON = 4  # steps, which square the error each
_NOTHING = 1e-9  # relative: the step after this one would change no bit
_BLOCK = 64  # samples whose turns are those of the first block, turned further


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
    """Phase of `a` minus phase of `b` in rad, followed continuously (unwrapped) from a first value in (-pi, pi].

        phi = arg(A conj(B)),    A = a + i H[a],    B = b + i H[b],    H the Hilbert transform

    Both ends are continued by a sinusoid fitted to the last two periods there, so that the phase is as accurate at the
    ends of the record as in its middle. Both oscillate about any constant, in any unit; times increase strictly.
    Source: section 5.3, Fig. 5.1 (b).

    Raises:
        RecordError: the record holds fewer than three periods.
    """
    grid, a, b = on_even_grid(t, a, b)
    signal, other = (Oscillation.of(x).analytic_signal() for x in (a, b))
    found: Series = np.unwrap(np.angle(signal * np.conj(other)))
    return found if grid is t else np.interp(t, grid, found)


def principal(phase: Series) -> Series:
    """Reduce an angle to [-pi/2, 3 pi/2): in-phase (0) and anti-phase (pi) both lie inside, away from the seam."""
    return np.mod(phase + np.pi / 2, 2 * np.pi) - np.pi / 2


def mean_phase(phase: Series) -> tuple[float, float]:
    """Circular mean of an angle, folded to [0, pi], and how constant it is (1: constant, 0: evenly spread)."""
    vector = complex(np.mean(np.exp(1j * phase)))
    return abs(float(np.angle(vector))), abs(vector)


def period(t: Series, a: Series) -> float:
    """Mean period of an oscillation; NaN for fewer than three periods.

        T = 2 pi / argmax |sum_k w_k x_k exp(-i omega t_k)|,    x: a about its drift,    w: Hann window

    The whole record is weighed at once, so that white noise of any sort hardly moves the maximum, and an amplitude that
    grows or decays does not.

    t: time, shape (samples,), evenly spaced; a: oscillation, same shape, any unit. Returns the unit of `t`.
    Source: Rife and Boorstyn, IEEE Trans. Information Theory 20 (1974) 591: the maximum likelihood for one line.
    """
    return Oscillation.of(a).period(float(t[-1] - t[0]))


def peak_sum(t: Series, a: Series, b: Series, window: float) -> Series:
    """Largest |a + b| over the `window` of time before each sample, that sample included.

    Source: section 5.1, the remark on definition 5.3: anti-phase with equal amplitudes is |a + b| <= eps.
    """
    return running_peak(t, np.abs(a + b), window)


def running_peak(t: Series, a: Series, window: float) -> Series:
    """Largest value of a series over the `window` of time before each sample, that sample included (samples,)."""
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
    """Fit definition 5.3 to the last `fraction` of a record of two oscillations about zero, of the same unit.

        g(t) = a(t) - alpha b(t + T/2),    alpha = argmin ||g||,    eps = max |g|

    T is the mean period of the larger of the two; `proportion` finds alpha. Source: (5.3).

    Raises:
        RecordError: that part holds fewer than three periods.
    """
    part = t >= t[-1] - fraction * (t[-1] - t[0])
    t, a, b = t[part], a[part], b[part]
    whole = period(*on_even_grid(t, a if a @ a >= b @ b else b))
    if not np.isfinite(whole):
        raise RecordError(f"the last {fraction:.0%} of the record holds fewer than three periods of oscillation")
    alpha, residual = proportion(t, a, b, whole / 2, whole)
    return AntiPhase(alpha, float(np.nanmax(np.abs(residual))), whole)


def proportion(t: Series, a: Series, b: Series, shift: float, period: float) -> tuple[float, Series]:
    """Fit one oscillation by a multiple of the other, shifted in time: alpha, and g (samples,).

        g(t) = a(t) - alpha b(t + shift),    alpha = <a z> / <b(t + shift) z>,    z = b(t + shift -+ T)

    For periodic motions that is argmin ||g||. Noise in b would make that too small, by its share of the power of b;
    z has the same motion and another noise (an instrumental variable). Alpha is NaN if b is at rest, and g is where
    b(t + shift) lies outside the record.

    Source: (5.3), where the shift is T/2; Soderstrom and Stoica, System Identification (1989), chapter 8.
    """
    at = t + shift
    inside = (at <= t[-1]) & (at >= t[0])
    shifted = interpolate(t, b, at[inside])
    other = np.where(at[inside] - period >= t[0], at[inside] - period, at[inside] + period)
    z = interpolate(t, b, np.clip(other, t[0], t[-1]))
    power = float(shifted @ z)
    alpha = float(a[inside] @ z) / power if power != 0.0 else float("nan")
    residual = np.full(len(t), np.nan)
    residual[inside] = a[inside] - alpha * shifted
    return alpha, residual


def synchronisation_time(t: Series, g: Series, eps: float) -> float:
    """First time after which |g| stays below eps; NaN where it does not.

    Here g vanishes in synchronisation, as the sum of two in anti-phase does; it is NaN where it is not known.
    Source: definition 8.1, (8.12).
    """
    known = np.isfinite(g)
    t, g = t[known], np.abs(g[known])
    outside = np.flatnonzero(g >= eps)
    if len(g) == 0 or (len(outside) and outside[-1] == len(g) - 1):
        return float("nan")
    if len(outside) == 0:
        return float(t[0])
    last = outside[-1]
    return float(t[last] + (g[last] - eps) / (g[last] - g[last + 1]) * (t[last + 1] - t[last]))


def interpolate(t: Series, a: Series, at: Series) -> Series:
    """Value of a smooth series between its samples: a spline of fifth degree, on any grid."""
    return np.asarray(lazy_imports.interpolate.make_interp_spline(t, a, min(_DEGREE, len(t) - 1))(at), dtype=np.float64)


def on_even_grid(t: Series, *series: Series) -> tuple[Series, ...]:
    """Times with even steps, and series there; those that were given where their times have even steps."""
    grid = np.linspace(t[0], t[-1], len(t))
    if np.allclose(grid, t, rtol=0.0, atol=1e-6 * (t[-1] - t[0]) / max(len(t) - 1, 1)):
        return t, *series
    return grid, *(interpolate(t, one, grid) for one in series)


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """An oscillation about its drift, a cubic polynomial that is fitted together with the oscillation."""

    series: Series  # evenly sampled, about the drift (samples,)
    cycles: float  # frequency of its largest line, in periods per record; 0 where it is at rest

    @classmethod
    def of(cls, a: Series) -> Oscillation:
        """Oscillation of an evenly sampled motion (samples,), any unit."""
        size, scale = len(a), float(np.abs(a).max(initial=0.0))
        if size <= 2 * (_TREND + 3):
            found = a - np.mean(a) if size else a
            return cls(found, _cycles(found))
        window = _window(size)
        basis: Series = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, size), _TREND).astype(np.float64)

        def fitted(columns: Series) -> Series:
            # Few columns, nearly orthogonal: normal equations lose nothing, and take a tenth of the time.
            weighted = columns * window[:, None]
            return np.asarray(np.linalg.lstsq(weighted.T @ columns, weighted.T @ a, rcond=None)[0], dtype=np.float64)

        found = a - basis @ fitted(basis)
        cycles = _cycles(found)
        for _ in range(_REFITS):  # by itself, the polynomial takes a part of few oscillations with it
            if cycles == 0.0:
                break
            before, angle = cycles, 2 * np.pi * cycles / size * np.arange(size)
            line = np.column_stack([basis, np.cos(angle), np.sin(angle)])
            found = a - basis @ fitted(line)[: _TREND + 1]
            cycles = _cycles(found)
            if abs(cycles - before) <= _SETTLED * cycles:
                break
        is_moving = np.sqrt(np.mean(found**2)) > _ROUNDING * scale
        return cls(found, cycles) if is_moving else cls(np.zeros(size), 0.0)

    def period(self, length: float) -> float:
        """Mean period for the time from the first sample to the last; NaN for fewer than three periods."""
        size, few = len(self.series), self.cycles < _LEAST_PERIODS - 0.5
        return float("nan") if few else length / (size - 1) * size / self.cycles

    def analytic_signal(self) -> NDArray[np.complex128]:
        """Complex signal whose real part is the oscillation and whose argument is its phase (samples,).

            A = a + i H[a],    H the Hilbert transform

        Raises:
            RecordError: it has fewer than three periods.
        """
        a, cycles = self.series, self.cycles
        quarter = round(len(a) / (4 * cycles)) if cycles > 0 else 0
        if cycles < _LEAST_PERIODS - 0.5 or quarter < 1:
            raise RecordError("the record holds fewer than three periods of oscillation")
        before, after = _continuation(a[::-1], quarter)[::-1], _continuation(a, quarter)
        extended = np.concatenate([before, a, after])
        # One-sided spectrum, as in Marple, IEEE Trans. Signal Processing 47 (1999) 2600. The continuation has faded to
        # zero at both ends, so that zeros may fill it up to a power of two.
        size = 1 << (len(extended) - 1).bit_length()
        spectrum = np.fft.fft(extended, size)
        spectrum[1 : size // 2] *= 2.0
        spectrum[size // 2 + 1 :] = 0.0
        signal = np.fft.ifft(spectrum)
        return signal[len(before) : len(before) + len(a)]


def _window(size: int) -> Series:
    return np.hanning(size + 2)[1:-1]


def _cycles(a: Series) -> float:
    """Frequency of the largest line of a series about zero, in periods per record; 0 where it is at rest."""
    size = len(a)
    if size < 4 or not np.any(a):
        return 0.0
    window = _window(size) * a
    spectrum = np.abs(np.fft.rfft(window))
    peak = int(np.argmax(spectrum[1:])) + 1
    rows = np.resize(window, (-(-size // _BLOCK), _BLOCK))
    rows.flat[size:] = 0.0
    k, first, omega = np.arange(_BLOCK), np.arange(len(rows)) * _BLOCK - (size - 1) / 2, 2 * np.pi * peak / size
    powers = k ** np.arange(3)[:, None]
    for _ in range(_NEWTON):
        turned = powers * np.exp(-1j * omega * k)
        c, c1, c2 = (rows @ turned.T).T * np.exp(-1j * omega * first)
        s, s1, s2 = c.sum(), first @ c + c1.sum(), first**2 @ c + 2.0 * first @ c1 + c2.sum()
        slope, curvature = (s.conjugate() * s1).imag, abs(s1) ** 2 - (s.conjugate() * s2).real
        if curvature >= 0.0:
            break
        step = min(max(slope / curvature, -np.pi / size), np.pi / size)
        omega -= float(step)
        if abs(step) <= _NOTHING * omega:
            break
    moved = omega * size / (2 * np.pi)
    return moved if abs(moved - peak) <= 1.0 else float(peak)


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
