"""Detects during a run, at a fixed cost for each sample, that two oscillators have synchronised.

The phase of each oscillator is that of its Fourier coefficient over half a period. Where the oscillators have nothing
to do with each other, the difference of the phases is as likely to be one as another, so that it lies within delta of
what is wanted in k half periods in a row, by chance, with the probability (delta/pi)**k. In N half periods such a row
can begin N times at most. The false alarms of a run are therefore no more than

    N (delta/pi)**k <= rate

which says how many half periods it takes. That phases half a period apart have nothing to do with each other holds for
white noise and for broad resonances. A narrow resonance keeps its phase for 1/(2 pi zeta) periods, and so do two
oscillators of nearly the same frequency: `memory` says for how long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, final

from masking.errors import ModelError

PHASES: Final = {"in": 0.0, "anti": math.pi}  # rad, of a against b
_LEAST_SAMPLES: Final = 8  # of a period
_FORGETTING: Final = 1 / 64  # of the mean, for each half period: drift slower than some 30 periods is followed
_PULL: Final = 0.2  # part of a wrong frequency that is corrected in each half period
_RANGE: Final = 0.25  # relative, about the declared period, in which that of a is followed


@final
@dataclass(frozen=True)
class Detector:
    """When two oscillators count as synchronised, and how sure that is to be.

    In anti-phase they do where |a(t) - alpha b(t + T/2)| <= eps A for some alpha > 0 (definition 5.3), A the amplitude
    of a, so that the phase is within delta = asin(eps) of pi; likewise with another phase, such as 0.

    Raises:
        ModelError: a setting is out of its range.
    """

    period: float  # of the oscillators, s or any other unit, within 25 %, in which that of a is followed
    step: float  # time between samples, same unit
    eps: float = 0.05  # part of the amplitude, between 0 and 1
    phase: float = math.pi  # of a against b that is wanted, rad
    false_alarm: float = 1e-3  # probability that a run of oscillators that have nothing to do with each other is ended
    duration: float = 0.0  # of such a run, unit of `period`
    memory: float = 0.5  # periods after which such phases have nothing to do with what they were; noise: 1/2

    def __post_init__(self) -> None:
        allowed = {
            "period": (self.period, _LEAST_SAMPLES * self.step, math.inf, f"at least {_LEAST_SAMPLES} samples long"),
            "step": (self.step, 0.0, math.inf, "greater than 0"),
            "eps": (self.eps, 0.0, 1.0, "between 0 and 1"),
            "false_alarm": (self.false_alarm, 0.0, 1.0, "between 0 and 1"),
            "duration": (self.duration, 0.0, math.inf, "the length of a run, or 0"),
            "phase": (self.phase, -math.inf, math.inf, "an angle in rad"),
            "memory": (self.memory, 0.5, math.inf, "at least half a period"),
        }
        for name, (value, low, high, words) in allowed.items():
            is_open = name in {"step", "eps", "false_alarm"}
            if not (low < value < high if is_open else low <= value < high):
                raise ModelError(f"detector: {name} is {value:g}; it must be {words}")

    @property
    def tolerance(self) -> float:
        """Delta, how near the phase must be to what is wanted, rad."""
        return math.asin(self.eps)

    @property
    def chance(self) -> float:
        """Probability that the phase of a half period is near enough by chance."""
        return self.tolerance / math.pi

    @property
    def needed(self) -> int:
        """Half periods in a row that it takes."""
        halves = max(1.0, 2.0 * self.duration / self.period)
        # The small part keeps a quotient that is an integer from being rounded up by its last digit.
        independent = math.ceil(math.log(halves / self.false_alarm) / -math.log(self.chance) - 1e-9)
        return math.ceil(independent * 2.0 * self.memory - 1e-9)

    @property
    def delay(self) -> float:
        """Longest time from synchronisation to its detection, unit of `period`."""
        return (self.needed + 1) * self.period / 2.0 + self.step

    @property
    def resolution(self) -> float:
        """Relative difference of two frequencies up to which a beat may pass as synchronisation.

        Over the half periods that are needed, such a beat turns the phase by no more than 2 delta; a longer `memory`
        separates frequencies that are nearer to each other.
        """
        return 2.0 * self.tolerance / (math.pi * max(1, self.needed - 1))

    def begin(self) -> Watch:
        """Watch that has seen nothing yet."""
        return Watch(self)


@final
@dataclass
class Watch:
    """What a detector has seen so far.

    After a step, `is_synchronised` is whether it has been found, from then on; `phase` is the last phase of a minus
    that of b, rad, NaN before the first half period; `count` the half periods in a row that were near enough.
    """

    detector: Detector
    is_synchronised: bool = field(init=False, default=False)
    phase: float = field(init=False, default=math.nan)
    count: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        d = self.detector
        self._target, self._tolerance, self._needed = d.phase, d.tolerance, d.needed
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.is_synchronised, self.phase, self.count = False, math.nan, 0
        self._turn = 2.0 * math.pi * self.detector.step / self.detector.period
        self._slowest, self._fastest = self._turn / (1.0 + _RANGE), self._turn * (1.0 + _RANGE)
        self._real = self._imag = 0.0  # the coefficient of a before
        self._angle = self._mean_a = self._mean_b = 0.0
        self._half = 0
        self._before = (0.0, 0.0, 0.0)  # samples and sums of the half period before
        self._clear()

    def _clear(self) -> None:
        self._n = self._c = self._s = self._cc = self._cs = self._ss = 0.0
        self._a = self._ac = self._as = self._b = self._bc = self._bs = 0.0

    def step(self, a: float, b: float) -> bool:
        """Take one sample of each oscillator, about any constant, any unit; return whether they have synchronised.

        measured: 0.5 us a sample, and 3 us where a half period ends.
        """
        c, s = math.cos(self._angle), math.sin(self._angle)
        self._n += 1.0
        self._c += c
        self._s += s
        self._cc += c * c
        self._cs += c * s
        self._ss += s * s
        self._a += a
        self._ac += a * c
        self._as += a * s
        self._b += b
        self._bc += b * c
        self._bs += b * s
        self._angle += self._turn
        if self._angle >= math.pi:
            self._angle -= math.pi
            self._half_period()
        return self.is_synchronised

    def _half_period(self) -> None:
        """End a half period: find the phases in it, and count it if they are near enough."""
        n, a, b = self._before
        self._half += 1
        # An offset is taken out, that of a slow drift too; at first it is the mean so far.
        part = max(_FORGETTING, 1.0 / max(1, self._half - 1)) / (n + self._n)
        change_a, change_b = part * (a + self._a), part * (b + self._b)
        part *= n + self._n
        if math.isfinite(change_a + change_b):
            self._mean_a += change_a - part * self._mean_a
            self._mean_b += change_b - part * self._mean_b
        self._before = (self._n, self._a, self._b)
        real_a, imag_a = self._coefficient(self._ac, self._as, self._mean_a)
        real_b, imag_b = self._coefficient(self._bc, self._bs, self._mean_b)
        self._clear()
        self._follow(real_a, imag_a)
        real, imag = real_a * real_b + imag_a * imag_b, imag_a * real_b - real_a * imag_b
        moves = self._half > 1 and math.isfinite(real + imag) and (real != 0.0 or imag != 0.0)
        self.phase = math.atan2(imag, real) if moves else math.nan
        is_near = abs(math.remainder(self.phase - self._target, 2.0 * math.pi)) <= self._tolerance
        self.count = self.count + 1 if is_near else 0
        if self.count >= self._needed:
            self.is_synchronised = True

    def _follow(self, real: float, imag: float) -> None:
        """Follow the frequency of a, by which its phase has turned since the half period before."""
        turned = math.atan2(real * self._imag - imag * self._real, -(real * self._real + imag * self._imag))
        self._real, self._imag = real, imag
        if abs(turned) < math.pi / 2:  # also not where it is not a number
            turn = self._turn * (1.0 + _PULL * turned / math.pi)
            self._turn = min(max(turn, self._slowest), self._fastest)

    def _coefficient(self, ac: float, as_: float, mean: float) -> tuple[float, float]:
        """X and y of the least-squares fit x cos + y sin over the half period, up to a factor and turned."""
        ac, as_ = ac - mean * self._c, as_ - mean * self._s
        return ac * self._ss - as_ * self._cs, -(as_ * self._cc - ac * self._cs)
