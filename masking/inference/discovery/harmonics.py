"""Harmonics of a force: its parts at even and at odd multiples of a base that were not excited.

Under periodic commands that hold odd multiples of a base only, a force that turns round with the motion has odd ones
only, and one that does not has even ones. This needs no displacement, and sees what has a memory, too.
Source: Pintelon and Schoukens, System Identification (2012), section 3.4; de Cheveigne and Kawahara (2002), J. Acoust.
Soc. Am. 111(4), 1917-1930, for the difference function that a period is found by.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result

ALIKE = 1e-6  # of twice the variance: commands that differ by less a period later repeat themselves
APART = 0.1  # of it: commands have changed since
EXCITED = 0.01  # of the largest amplitude of a command, from which a line counts as excited
LEAST = 3  # periods: one to settle, and two to estimate the noise
FEWEST_CYCLES = 3  # in a record, of a motion that has a frequency
NEAR, LEAKAGE = 0.1, 2  # part of a frequency, and lines on either side by leakage, that are near it
ONE = 0.7  # of the energy of a rate: a motion with more near one frequency has that
LONGEST = 0.75  # of a record: a longer period repeats too little to be found


@dataclass(frozen=True)
class Harmonics(Result):
    """Parts of the mean square of a force under periodic commands, less its noise; the first period is left out."""

    base: float  # frequency of the first multiple in Hz
    periods: int  # that are used
    only_odd: bool  # whether odd multiples alone are excited: `even` is then what does not turn round with the motion
    # excited, even, odd: parts at excited multiples, and at others that are even, 0 included, or odd; sum 1
    excited: float
    even: float
    odd: float


@dataclass(frozen=True)
class Periods:
    """Periodic commands: how many samples a period has, and the commands (m, actuators) at a rate in Hz."""

    length: int
    commands: Array
    rate: float

    @classmethod
    def of(cls, commands: Array, rate: float) -> Periods | None:
        """Periods of commands (m, actuators); None where these do not repeat themselves exactly."""
        moving = commands[:, np.ptp(commands, axis=0) > 0.0]
        length = period(moving) if moving.size else None
        return None if length is None else cls(length, moving, rate)

    @cached_property
    def whole(self) -> int:
        """Number of samples of whole periods."""
        return len(self.commands) // self.length * self.length

    @cached_property
    def excited(self) -> NDArray[np.bool_]:
        """Which multiples of the base are excited (lines,)."""
        size = np.abs(np.fft.rfft(self.commands[: self.length], axis=0))
        size[0] = 0.0
        return np.asarray((size >= EXCITED * size.max(axis=0)).any(axis=1))

    def harmonics(self, force: Array) -> Harmonics | None:
        """Harmonics of a force (m,); None under three periods, or where they are no more than noise."""
        if self.whole < LEAST * self.length:
            return None
        kept = force[self.length : self.whole].reshape(-1, self.length)
        spectra = np.fft.rfft(kept, axis=1)
        mean, many = spectra.mean(axis=0), len(kept)
        noise = (np.abs(spectra - mean) ** 2).sum(axis=0) / (many - 1) / many
        power = np.abs(mean) ** 2 - noise
        power[0] *= 0.5  # a constant is on one line, a sine on two, of which one is here
        lines = np.arange(len(power))
        even = ~self.excited & (lines % 2 == 0)
        parts = np.array([max(float(power[side].sum()), 0.0) for side in (self.excited, even, ~self.excited & ~even)])
        whole = float(parts.sum())
        if not whole > 0.0:
            return None
        only_odd = not self.excited[::2].any()
        return Harmonics(self.rate / self.length, many, only_odd, *(float(part / whole) for part in parts))


def cycle(rate: Array, sampling: float) -> float | None:
    """Frequency of a motion in Hz, where most of the energy of its rate (m,) is near one; None of others."""
    power = np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate)))) ** 2
    power[0] = 0.0
    at, lines = int(np.argmax(power)), np.arange(len(power))
    near = np.abs(lines - at) <= max(NEAR * at, LEAKAGE)
    if at < FEWEST_CYCLES or not float(power[near].sum()) > ONE * float(power.sum()) > 0.0:
        return None
    return float((lines * power)[near].sum() / power[near].sum() * sampling / len(rate))


def period(commands: Array) -> int | None:
    """After how many samples commands (m, actuators) repeat themselves; None where they do not."""
    scaled = (commands - commands.mean(axis=0)) / commands.std(axis=0)
    m, size = len(scaled), (scaled**2).sum(axis=1)
    length = 1 << (2 * m - 1).bit_length()
    same = np.fft.irfft((np.abs(np.fft.rfft(scaled, length, axis=0)) ** 2).sum(axis=1), length)[: int(LONGEST * m)]
    lags, sums = np.arange(len(same)), np.concatenate([[0.0], np.cumsum(size)])
    # The sum of squared differences of all samples that are so far apart.
    apart = (sums[m - lags] + sums[m] - sums[lags] - 2.0 * same) / (m - lags) / (2.0 * commands.shape[1])
    changed = np.flatnonzero(apart > APART)
    alike = np.flatnonzero(apart < ALIKE)
    alike = alike[alike > changed[0]] if len(changed) else alike[:0]
    if not len(alike):
        return None
    near = alike[: np.argmax(np.append(np.diff(alike) > 1, True)) + 1]
    return int(near[np.argmin(apart[near])])
