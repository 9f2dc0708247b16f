"""Multisines: sums of sines with any lines, and the two numbers that tell how well they use a measurement."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lab.signals.signal_arguments import positive, real, row
from masking.lazy_imports import fft

TURN = 2.0 * math.pi
# Samples for each period of the highest line where a peak is looked for. The curvature of a multisine is at most
# (2 pi f)^2 times its peak (Bernstein), so that the highest sample is then within 0.5 % of the peak.
DENSITY = 32
FOLLOWED = 0.99  # of the highest sample: maxima above are followed to their top; twice what Bernstein asks for
NEWTON_STEPS = 6
# Lines are taken as harmonics of one period where the ratios to the lowest one are fractions with denominators up to
# this, to this relative error, a thousand times what rounding does.
LARGEST_DENOMINATOR = 1000
RATIO_ERROR = 1e-12
BASE_ERROR = 1e-9  # of a line that is given as a multiple of a base
HIGHEST_HARMONIC = 1_000_000  # 32 million samples of a period
MOST_POINTS = 50_000_000  # samples times lines of a record: 2500 s of 25 lines to 25 Hz


@dataclass(frozen=True, eq=False, repr=False)
class Multisine:
    """A sum of sines.

        v(t) = sum_k A_k cos(2 pi f_k t + phi_k)

    Source: (4.9).

    Args:
        frequencies: of the lines, Hz, all different and above 0 (lines,).
        amplitudes: one for each line or one for all, above 0, in the unit of the signal (lines,).
        phases: one for each line or one for all, rad (lines,).
        base: the frequency of which all lines are multiples, Hz; found from the ratios of the lines where it is None.

    Raises:
        ModelError: two lines are equal, a number is not finite or not above 0, or a line is no multiple of `base`.
    """

    frequencies: Array
    amplitudes: Array
    phases: Array
    base: float | None = None

    def __init__(
        self, frequencies: ArrayLike, amplitudes: ArrayLike = 1.0, phases: ArrayLike = 0.0, base: float | None = None
    ) -> None:
        lines = row("frequencies", frequencies)
        _different(lines)
        sizes = row("amplitudes", amplitudes, len(lines))
        for what, unit, values in (("frequency", " Hz", lines), ("amplitude", "", sizes)):
            bad = np.flatnonzero(values <= 0.0)
            if len(bad):
                message = f"the {what} of line {bad[0]} (they count from 0) is {values[bad[0]]:g}{unit}"
                raise ModelError(f"{message}; give numbers above 0; a line without power is left out")
        if base is not None:
            positive("base", base, "Hz")
            with np.errstate(over="ignore"):
                multiples = lines / base
            highest = int(np.argmax(multiples))
            if multiples[highest] > HIGHEST_HARMONIC:
                message = f"line {lines[highest]:.9g} Hz is {multiples[highest]:.3g} times the base {base:.9g} Hz"
                raise ModelError(f"{message}, at most {HIGHEST_HARMONIC} are allowed; give a higher base, or none")
            off = np.abs(multiples - np.round(multiples)) / np.maximum(multiples, 1.0)
            worst = int(np.argmax(off))
            if off[worst] > BASE_ERROR or multiples.min() < 0.5:
                worst = worst if off[worst] > BASE_ERROR else int(np.argmin(multiples))
                message = f"line {lines[worst]:.9g} Hz is {multiples[worst]:.9g} times the base {base:.9g} Hz"
                raise ModelError(f"{message}; give lines that are whole multiples of it, or no base")
            _different(np.round(multiples), "multiples of the base", "")
        object.__setattr__(self, "frequencies", lines)
        object.__setattr__(self, "amplitudes", sizes)
        object.__setattr__(self, "phases", row("phases", phases, len(lines)))
        object.__setattr__(self, "base", base)

    @classmethod
    def harmonic(
        cls, harmonics: ArrayLike, period: float, amplitudes: ArrayLike = 1.0, phases: ArrayLike = 0.0
    ) -> Multisine:
        """Multisine of harmonics of one period.

        Args:
            harmonics: whole numbers from 1, all different (lines,).
            period: s.
            amplitudes: as in `Multisine`.
            phases: as in `Multisine`.

        Raises:
            ModelError: a harmonic is no whole number above 0, or as `Multisine` does.
        """
        numbers, base = row("harmonics", harmonics), 1.0 / positive("period", period, "s")
        bad = np.flatnonzero((numbers < 1) | (numbers != np.round(numbers)))
        if len(bad):
            raise ModelError(f"harmonic {numbers[bad[0]]:g} is no whole number from 1; give such as 1, 2, 3")
        _different(numbers, "harmonics", "")
        return cls(numbers * base, amplitudes, phases, base)

    def __repr__(self) -> str:
        period = f"period {self.period:g} s" if self.period else "no period"
        return f"<Multisine of {len(self.frequencies)} lines to {self.frequencies.max():g} Hz, {period}>"

    def with_phases(self, phases: ArrayLike) -> Multisine:
        """Multisine with the same lines and amplitudes and other phases, rad (lines,)."""
        return Multisine(self.frequencies, self.amplitudes, phases, self.base)

    def scaled(self, factor: float) -> Multisine:
        """Multisine with all amplitudes multiplied by a factor above 0."""
        factor = positive("factor", factor)
        return Multisine(self.frequencies, factor * self.amplitudes, self.phases, self.base)

    def within(self, lowest: float, highest: float) -> Multisine:
        """Part of the multisine whose lines lie from `lowest` to `highest`, Hz, both ends included.

        Raises:
            ModelError: no line lies there.
        """
        kept = (self.frequencies >= real("lowest", lowest)) & (self.frequencies <= real("highest", highest))
        if not kept.any():
            first, last = self.frequencies.min(), self.frequencies.max()
            raise ModelError(f"no line lies from {lowest:g} to {highest:g} Hz; the lines are {first:g} to {last:g} Hz")
        return Multisine(self.frequencies[kept], self.amplitudes[kept], self.phases[kept], self.base)

    @cached_property
    def harmonics(self) -> tuple[int, ...] | None:
        """Each line's multiple of the base (lines,); None where no period of up to a million harmonics holds them."""
        if self.base is not None:
            found = [round(f / self.base) for f in self.frequencies]
        else:
            lowest = float(self.frequencies.min())
            if self.frequencies.max() > HIGHEST_HARMONIC * lowest:
                return None
            ratios = [Fraction(f / lowest).limit_denominator(LARGEST_DENOMINATOR) for f in self.frequencies]
            exact = np.array(list(map(float, ratios)))
            if (np.abs(exact - self.frequencies / lowest) > RATIO_ERROR * exact).any():
                return None
            common = math.lcm(*(ratio.denominator for ratio in ratios))
            found = [int(ratio * common) for ratio in ratios]
        divisor = math.gcd(*found)
        return tuple(h // divisor for h in found) if max(found) // divisor <= HIGHEST_HARMONIC else None

    @property
    def period(self) -> float | None:
        """The shortest time after which the signal repeats itself, s; None where there is none."""
        if self.harmonics is None:
            return None
        highest = int(np.argmax(self.frequencies))
        return float(self.harmonics[highest] / self.frequencies[highest])

    def sample(self, times: ArrayLike) -> Array:
        """Signal at times in s, in its unit and the shape of `times`."""
        return self.derivative(times, 0)

    def derivative(self, times: ArrayLike, order: int = 1) -> Array:
        """Derivative of the signal at times in s, its unit per s^order, in the shape of `times`."""
        t = np.asarray(times, dtype=np.float64)
        found = np.zeros_like(t)
        for f, a, phase in zip(self.frequencies, self.amplitudes, self.phases, strict=True):
            w = TURN * f
            found += a * w**order * np.cos(w * t + (phase + 0.25 * TURN * order))
        return found

    def rms(self, duration: float | None = None) -> float:
        """Root mean square over the record from 0 to `duration` s, or over one period (or all time).

            rms^2 = sum_k A_k^2 / 2                                     over a period, or over all time (Parseval)
            rms^2 = sum_kl A_k A_l / (2 T) int_0^T cos(a_k - a_l) + cos(a_k + a_l) dt         over a record of T,

        with a_k = 2 pi f_k t + phi_k; the integral is taken in closed form.
        """
        largest = float(self.amplitudes.max())  # keeps the squares of very small and very large numbers within range
        sizes = self.amplitudes / largest
        if duration is None:
            return largest * math.sqrt(float(sizes @ sizes) / 2.0)
        half = math.pi * positive("duration", duration, "s")
        total = 0.0
        for sign in (-1.0, 1.0):
            turned = half * (self.frequencies[:, None] + sign * self.frequencies)
            phases = self.phases[:, None] + sign * self.phases
            means = np.sinc(turned / math.pi) * np.cos(turned + phases)
            total += 0.5 * float(sizes @ means @ sizes)
        return largest * math.sqrt(max(total, 0.0))

    def peak(self, duration: float | None = None) -> float:
        """Largest |v(t)| over one period, or over the record from 0 to `duration` s, both ends included.

        The samples, 32 for each period of the highest line, that come near the largest are followed to the top between
        them by Newton's method, so that the peak is exact to rounding.

        Raises:
            ModelError: the lines have no common period and no duration was given, or the record is too long.
        """
        values, step = self._samples(duration)
        sizes = np.abs(values)
        before, after = np.roll(sizes, 1), np.roll(sizes, -1)
        if duration is not None:
            before[0] = after[-1] = 0.0  # a record does not go on where it began
        tops = (sizes >= before) & (sizes >= after) & (sizes >= FOLLOWED * sizes.max())
        found = step * np.flatnonzero(tops)
        last = math.inf if duration is None else duration
        start, low = found.copy(), (0.0 if duration is not None else -math.inf)
        for _ in range(NEWTON_STEPS):
            slope, curvature = self.derivative(found, 1), self.derivative(found, 2)
            with np.errstate(divide="ignore", invalid="ignore"):
                moved = np.where(curvature != 0.0, found - slope / curvature, found)
            found = np.clip(moved, np.maximum(start - step, low), np.minimum(start + step, last))
        return float(max(sizes.max(), np.abs(self.sample(found)).max()))

    def _samples(self, duration: float | None) -> tuple[Array, float]:
        """Samples of one period or of a record, and the time between them."""
        highest = float(self.frequencies.max())
        if duration is None:
            harmonics = periodic(self)
            size = fft.next_fast_len(DENSITY * max(harmonics), real=True)
            return wave(harmonics, self.amplitudes * np.exp(1j * self.phases), size), float(self.period or 0.0) / size
        duration = positive("duration", duration, "s")
        size = math.ceil(DENSITY * highest * duration) + 1
        check_size(size, len(self.frequencies), duration)
        times = np.linspace(0.0, duration, max(size, DENSITY))
        return self.sample(times), float(times[1])


def wave(harmonics: Sequence[int], amplitudes: np.ndarray, size: int) -> Array:
    """Samples of one period of Re sum_k c_k exp(i h_k theta) (size,), for harmonics h_k and complex c_k (lines,)."""
    spectrum = np.zeros(size // 2 + 1, dtype=np.complex128)
    spectrum[list(harmonics)] = 0.5 * size * amplitudes
    return np.asarray(fft.irfft(spectrum, size), dtype=np.float64)


def periodic(signal: Multisine) -> tuple[int, ...]:
    """Harmonics of a multisine; a ModelError where its lines have no common period."""
    if signal.harmonics is None:
        raise ModelError(
            f"the lines have no common period with harmonics up to {HIGHEST_HARMONIC}; give the duration of the "
            "record, the base of which the lines are multiples, or lines from Multisine.harmonic"
        )
    return signal.harmonics


def check_size(samples: int, lines: int, duration: float, most: int = MOST_POINTS) -> None:
    """Refuse a record, of a duration in s, whose samples times lines are more than can be looked at."""
    if samples * lines > most:
        raise ModelError(
            f"a record of {duration:g} s with {lines} lines takes {samples * lines:.3g} values, at most {most:.3g} are "
            f"looked at; take {duration * most / (samples * lines):.3g} s or less, or lines that share a period"
        )


def schroeder_phases(amplitudes: ArrayLike) -> Array:
    """Phases that spread the power of neighbouring lines over the period, rad (lines,).

        phi_k = -2 pi sum_(j < k) (k - j) A_j^2 / sum_j A_j^2

    A start for a search, with a crest factor of about 1.7 for a flat spectrum.
    Source: Schroeder, IEEE Trans. Information Theory 16 (1970), 85-89.

    Args:
        amplitudes: of the lines in the order of their frequencies (lines,).
    """
    power = row("amplitudes", amplitudes) ** 2
    before = np.concatenate([[0.0], np.cumsum(power / power.sum())[:-1]])
    return np.asarray(-TURN * np.cumsum(before), dtype=np.float64)


def crest_factor(signal: Multisine, duration: float | None = None, band: tuple[float, float] | None = None) -> float:
    """Crest factor, the largest |v| over the root mean square in the band of interest.

        Cr(v) = max_(t in T) |v(t)| / ||v||_2

    Source: (4.7).

    Args:
        signal: any multisine.
        duration: T is the record from 0 to this time, s; T is one period where it is None.
        band: lowest and highest frequency whose lines count as useful, Hz; None for all of them.

    Raises:
        ModelError: the lines have no common period and no duration was given, or no line lies in the band.
    """
    useful = signal if band is None else signal.within(*band)
    return signal.peak(duration) / useful.rms(duration)


def time_factor(signal: Multisine, duration: float | None = None, band: tuple[float, float] | None = None) -> float:
    """Time factor: how many times longer than with one sine of the same peak a measurement must be.

        T_f(v) = max_(k in F) Cr^2(v) V_rms^2 / (2 |V_k|^2),  |V_k| = A_k / sqrt(2), the rms of line k

    One for a single sine; N Cr^2 / 2 for N lines of equal amplitude. Source: (4.8).

    Args:
        signal: any multisine.
        duration: as in `crest_factor`.
        band: F, lowest and highest frequency, Hz; None for all lines.

    Raises:
        ModelError: as `crest_factor` does.
    """
    useful = signal if band is None else signal.within(*band)
    return (signal.peak(duration) / float(useful.amplitudes.min())) ** 2


def _different(values: Array, what: str = "lines", unit: str = " Hz") -> None:
    ordered = np.sort(values)
    same = np.flatnonzero(np.diff(ordered) == 0.0)
    if len(same):
        raise ModelError(f"two {what} are equal: {ordered[same[0]]:.9g}{unit}; give each once, with its amplitude")
