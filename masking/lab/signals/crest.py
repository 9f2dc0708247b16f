"""The phases of a multisine for which its crest factor is smallest: the infinity-norm algorithm.

The crest factor is the limit of the norm

    ||v||_2p = (1/T int v^2p dt)^(1/2p),   p -> inf,

over the root mean square, which the phases do not change. The norm is minimised for p = 2, 4, 8, ..., each time from
where the one before led, by Newton's method with the damping of Levenberg and Marquardt. Of half the mean of v^2p,

    gradient_k   = p mean(v^(2p-1) v_k)                              v_k  = -A_k sin(w_k t + phi_k)
    Hessian_kl   = p (2p-1) mean(v^(2p-2) v_k v_l) + p delta_kl mean(v^(2p-1) v_kk),

and every mean is a Fourier coefficient of v^(2p-2) or v^(2p-1) at a line, or at a sum or a difference of two, so that
harmonics of one period take two FFTs a step.
Source: Guillaume, Schoukens, Pintelon and Kollar, IEEE Trans. Instrumentation and Measurement 40 (1991), 982-989;
Pintelon and Schoukens, System Identification (2001); (4.10), (4.11).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from masking.compile.numerics.arrays import Array, Complex
from masking.lab.signals.multisines import TURN, Multisine, check_size, crest_factor, periodic, schroeder_phases, wave
from masking.lab.signals.signal_arguments import count, positive
from masking.lazy_imports import fft, linalg

Progress = Callable[[float], object]

# Samples for each period of the highest line on which the norms are taken. Measured with 25 and 50 flat lines and 60
# starts, mean crest factor: 1.426 with 8 samples, 1.389 with 16, 1.378 with 32, 1.377 with 48.
DENSITY = 32
LEAST_SIZE = 256  # samples in all, where there are few lines
# Samples of a record that are summed at once, times the square of the lines, and the fewest and the most such samples:
# so few that a matrix product stays on one core. Measured with 25 lines on 2 busy cores: a product over a record takes
# 0.4 ms; with 4 times as many samples at once it takes 1 ms, and now and then 100 ms while its threads wait for each
# other.
BLOCK_WORK, LEAST_BLOCK, MOST_BLOCK = 40_000, 16, 256
MOST_STEPS = 100  # Newton steps for each p; about 6 are taken
SETTLED = 1e-5  # relative gain of a step below which the next p is turned to
FIRST_DAMPING, LEAST_DAMPING, STIFFER, SOFTER = 1e-3, 1e-9, 4.0, 0.2
MOST_TRIALS = 30
# Where the number of starts is left open, starts times (samples + lines^2) come near this, up to 400 starts. Measured:
# 4 s for 25 lines, 8 s for 50.
WORK, MOST_STARTS = 1_600_000, 400
MOST_VALUES = 20_000_000  # samples times lines of a record without a period, kept as complex numbers: 320 MB


class _Period:
    """One period of harmonics, by FFT: a multisine there, and the means over it that the norm needs."""

    def __init__(self, harmonics: tuple[int, ...]) -> None:
        self.harmonics = harmonics
        self.size = int(fft.next_fast_len(max(DENSITY * max(harmonics), LEAST_SIZE), real=True))
        h = np.array(harmonics)
        self._at, self._sums, self._differences = h, h[:, None] + h, h[:, None] - h

    def values(self, amplitudes: Complex) -> Array:
        return wave(self.harmonics, amplitudes, self.size)

    def means(self, weights: Array) -> Complex:
        return np.asarray(self._spectrum(weights)[self._at], dtype=np.complex128)

    def products(self, weights: Array) -> tuple[Complex, Complex]:
        """Means of weights exp(i (w_k - w_l) t) and of weights exp(i (w_k + w_l) t) (lines, lines)."""
        spectrum = self._spectrum(weights)
        differences = spectrum[np.abs(self._differences)]
        return np.where(self._differences < 0, differences.conj(), differences), spectrum[self._sums]

    def _spectrum(self, weights: Array) -> Complex:
        return np.asarray(np.conj(fft.rfft(weights)) / self.size, dtype=np.complex128)


class _Record:
    """A record from time zero, of lines that need not share a period, by sums over blocks of samples."""

    def __init__(self, frequencies: Array, duration: float) -> None:
        block = max(LEAST_BLOCK, min(MOST_BLOCK, BLOCK_WORK // len(frequencies) ** 2))
        blocks = math.ceil(max(DENSITY * float(frequencies.max()) * duration + 1, LEAST_SIZE) / block)
        self.size = blocks * block
        check_size(self.size, len(frequencies), duration, MOST_VALUES)
        times = np.linspace(0.0, duration, self.size)
        self._turns = np.exp(1j * TURN * np.outer(times, frequencies)).reshape(blocks, block, -1)

    def values(self, amplitudes: Complex) -> Array:
        return np.asarray((self._turns @ amplitudes).real.ravel(), dtype=np.float64)

    def means(self, weights: Array) -> Complex:
        weighted = weights.reshape(len(self._turns), 1, -1) @ self._turns
        return np.asarray(weighted.sum(axis=(0, 1)) / self.size, dtype=np.complex128)

    def products(self, weights: Array) -> tuple[Complex, Complex]:
        lines = self._turns.shape[-1]
        differences, sums = np.zeros((2, lines, lines), dtype=np.complex128)
        for turns, part in zip(self._turns, weights.reshape(len(self._turns), -1), strict=True):
            weighted = (part[:, None] * turns).T
            differences += weighted @ turns.conj()
            sums += weighted @ turns
        return differences / self.size, sums / self.size


@dataclass(frozen=True)
class Norm:
    """The logarithm of the 2p-norm of a multisine as a function of its phases."""

    lines: _Period | _Record  # where the multisine is looked at
    amplitudes: Array  # (lines,)
    power: int  # p

    @classmethod
    def of(cls, signal: Multisine, power: int, duration: float | None = None) -> Norm:
        """Norm of a multisine over the record from 0 to `duration` s; over one period where that is None."""
        return cls(_lines(signal, duration), signal.amplitudes, power)

    def __call__(self, phases: Array) -> float:
        """Log ||v||_2p for phases in rad (lines,)."""
        v = self.lines.values(self.amplitudes * np.exp(1j * phases))
        peak = float(np.abs(v).max())
        return math.log(peak) + math.log(float(np.mean((v / peak) ** (2 * self.power)))) / (2 * self.power)

    def derivatives(self, phases: Array) -> tuple[float, Array, Array]:
        """Log ||v||_2p, its gradient (lines,), and the Hessian of mean(v^2p) / (2p mean(v^2p)) (lines, lines).

        The Hessian of the logarithm is lower by 2p times the gradient's outer product, which is left out: that of the
        mean itself has the same minimum and is positive more often.
        """
        amplitudes = self.amplitudes * np.exp(1j * phases)
        v = self.lines.values(amplitudes)
        peak = float(np.abs(v).max())
        c, v = amplitudes / peak, v / peak  # |v| <= 1: its powers go to zero, never beyond all bounds
        weights = v ** (2 * self.power - 2)
        towards = c * self.lines.means(weights * v)
        differences, sums = self.lines.products(weights)
        total = float(np.mean(weights * v * v))
        # sin a sin b = (cos(a - b) - cos(a + b)) / 2
        curvature = 0.5 * np.real(np.outer(c, c.conj()) * differences - np.outer(c, c) * sums)
        hessian = (2 * self.power - 1) * curvature - np.diag(towards.real)
        return math.log(peak) + math.log(total) / (2 * self.power), -towards.imag / total, hessian / total


def minimise_crest(
    signal: Multisine,
    *,
    highest: int = 512,
    starts: int | None = None,
    seed: int = 0,
    duration: float | None = None,
    seconds: float | None = None,
    progress: Progress | None = None,
) -> Multisine:
    """Multisine with the phases for which its crest factor is smallest; its spectrum is untouched.

    The 2p-norm is minimised for p = 2, 4, 8, ... from several starts: the phases of Schroeder, those as given, then
    random ones; the result with the smallest crest factor is returned, and the signal as given where none is smaller.
    Source: Guillaume et al. (1991); (4.10), (4.11).

    Args:
        signal: lines and amplitudes, and phases for the second start.
        highest: p of the last norm, at least 2.
        starts: how many; where it is None, from 400 down to 2, fewer the more lines and samples there are.
        seed: of the random starts.
        duration: the crest factor is that of the record from 0 to this time, s; that of one period where it is None.
        seconds: no start is begun after this time; the result then depends on the speed of the machine.
        progress: called with the part done.

    Returns:
        The multisine with phases from 0 to 2 pi; the same for the same arguments where `seconds` is None.

    Raises:
        ModelError: the lines have no common period and no duration was given, the record is too long, or a number is
            out of range.
    """
    last = count("highest", highest, 2)
    began = time.monotonic()
    allowed = math.inf if seconds is None else positive("seconds", seconds, "s")
    generator = np.random.default_rng(count("seed", seed, 0))
    lines = _lines(signal, duration)
    size = len(signal.frequencies)
    if starts is None:
        starts = max(2, min(MOST_STARTS, WORK // (lines.size + size**2)))
    powers = [2**k for k in range(1, last.bit_length()) if 2**k < last] + [last]
    best, smallest = signal, crest_factor(signal, duration)
    for k in range(count("starts", starts)):
        if k and time.monotonic() - began > allowed:
            break
        phases = _start(k, signal, generator)
        for power in powers:
            phases = _minimise(Norm(lines, signal.amplitudes, power), phases)
        found = signal.with_phases(np.mod(phases, TURN))
        crest = crest_factor(found, duration)
        if crest < smallest:
            best, smallest = found, crest
        if progress is not None:
            progress(min(1.0, max((k + 1) / starts, (time.monotonic() - began) / allowed)))
    return best


def _lines(signal: Multisine, duration: float | None) -> _Period | _Record:
    if duration is None:
        return _Period(periodic(signal))
    return _Record(signal.frequencies, positive("duration", duration, "s"))


def _start(k: int, signal: Multisine, generator: np.random.Generator) -> Array:
    """Phases of start k, rad (lines,)."""
    if k == 1:
        return signal.phases
    if k > 1:
        return generator.uniform(0.0, TURN, len(signal.phases))
    order = np.argsort(signal.frequencies)
    found = np.empty(len(order))
    found[order] = schroeder_phases(signal.amplitudes[order])
    return found


def _minimise(norm: Norm, phases: Array) -> Array:
    """Phases at a minimum of a norm, from a start, rad (lines,)."""
    damping = FIRST_DAMPING
    for _ in range(MOST_STEPS):
        value, gradient, hessian = norm.derivatives(phases)
        unit = float(np.abs(np.diag(hessian)).mean())
        for _ in range(MOST_TRIALS):
            damped = hessian + damping * unit * np.eye(len(phases))
            try:
                factor = linalg.cho_factor(damped, overwrite_a=True, check_finite=False)
            except np.linalg.LinAlgError:  # not a minimum of its parabola
                damping *= STIFFER
                continue
            trial = phases - linalg.cho_solve(factor, gradient, check_finite=False)
            reached = norm(trial)
            if reached < value:
                break
            damping *= STIFFER
        else:
            return phases
        phases, damping = trial, max(damping * SOFTER, LEAST_DAMPING)
        if value - reached < SETTLED:
            return phases
    return phases
