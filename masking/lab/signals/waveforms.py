"""The excitations with which a rig is identified; each function gives the samples of one signal.

All of them take the rate in Hz, the name of the channel and its unit. `Excitation.within` refuses a signal that passes
the limit of a channel.
"""

from __future__ import annotations

import math

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lab.signals.excitation import Excitation
from masking.lab.signals.multisines import TURN, Multisine
from masking.lab.signals.signal_arguments import below_nyquist, count, names, positive, real, samples

LEAST_SAMPLES = 8  # of a step, a slope or a period, for its shape to be seen
WHOLE = 1e-9  # a period is a whole number of samples to this part of a sample and of the period


def multisine(
    signal: Multisine,
    *,
    rate: float,
    periods: int | None = None,
    duration: float | None = None,
    channel: str = "u",
    unit: str = "V",
) -> Excitation:
    """Samples of a multisine over whole periods, or over a duration.

    Args:
        signal: its amplitudes are in `unit`.
        rate: Hz, above twice the highest line.
        periods: how many; each must be a whole number of samples, so that no line leaks into another. Give this or
            `duration`.
        duration: s.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a line is not below half the rate, a period is no whole number of samples, or both or none of
            `periods` and `duration` are given.
    """
    rate = positive("rate", rate, "Hz")
    below_nyquist("the highest line,", float(signal.frequencies.max()), rate)
    if (periods is None) == (duration is None):
        raise ModelError(f"periods is {periods} and duration is {duration}; give one of the two")
    if periods is not None:
        size = count("periods", periods) * _whole_period(signal, rate)
    else:
        size = samples("a multisine", positive("duration", duration, "s"), rate, 1)
    lines = {name: getattr(signal, name).tolist() for name in ("frequencies", "amplitudes", "phases")}
    meta = {**lines, "period": signal.period, "periods": periods}
    return Excitation("multisine", rate, signal.sample(np.arange(size) / rate)[:, None], (channel,), (unit,), meta)


def steps(
    amplitude: float, *, number: int, hold: float, rate: float, channel: str = "u", unit: str = "V"
) -> Excitation:
    """Steps of growing amplitude, to either side of zero and back.

        0, A/n, 0, -A/n, 0, 2A/n, 0, -2A/n, ..., A, 0, -A, 0       each held for `hold` seconds

    Source: the step signal with increasing amplitude of section 4.2.2, Figure 4.4.

    Args:
        amplitude: A, of the last steps, in `unit`.
        number: n, of amplitudes.
        hold: s, at least 8 samples.
        rate: Hz.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a number is not above 0 or a step is too short for the rate.
    """
    amplitude, rate = positive("amplitude", amplitude, unit), positive("rate", rate, "Hz")
    held = samples("a step", positive("hold", hold, "s"), rate, LEAST_SAMPLES)
    sizes = amplitude * np.arange(1, count("number", number) + 1) / number
    levels = np.concatenate([[0.0], *([a, 0.0, -a, 0.0] for a in sizes)])
    meta = {"amplitude": amplitude, "number": number, "hold": hold}
    return Excitation("steps", rate, np.repeat(levels, held)[:, None], (channel,), (unit,), meta)


def ramp(amplitude: float, *, duration: float = 60.0, rate: float, channel: str = "u", unit: str = "V") -> Excitation:
    """Slow ramp from zero up to the amplitude, down to its negative, and up to zero.

    Slow enough, the force is that of the spring, once on the way up and once on the way down.
    Source: section 4.2, nonlinear stiffness, (4.14), and appendix C.6.2: 60 s.

    Args:
        amplitude: in `unit`.
        duration: of the whole, s.
        rate: Hz.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a number is not above 0 or the ramp is too short for the rate.
    """
    amplitude, rate = positive("amplitude", amplitude, unit), positive("rate", rate, "Hz")
    size = samples("a ramp", positive("duration", duration, "s"), rate, LEAST_SAMPLES)
    values = amplitude * _triangle(np.arange(size) / (rate * duration))
    meta = {"amplitude": amplitude, "duration": duration}
    return Excitation("ramp", rate, values[:, None], (channel,), (unit,), meta)


def sawtooth(
    amplitude: float, *, number: int, period: float, rate: float, channel: str = "u", unit: str = "V"
) -> Excitation:
    """Saw-teeth of growing amplitude: n periods of a triangle, of amplitudes A/n, 2A/n, ..., A.

    Each goes from zero up, down, and up to zero: the shift of the equilibrium over the travel separates hysteresis from
    dry friction. Source: appendix C.6.2.

    Args:
        amplitude: A, of the last saw-tooth, in `unit`.
        number: n, of saw-teeth.
        period: of each, s, at least 8 samples.
        rate: Hz.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a number is not above 0 or a period is too short for the rate.
    """
    amplitude, rate = positive("amplitude", amplitude, unit), positive("rate", rate, "Hz")
    number, period = count("number", number), positive("period", period, "s")
    samples("a saw-tooth", period, rate, LEAST_SAMPLES)
    turns = np.arange(round(number * period * rate)) / (rate * period)
    sizes = amplitude * np.minimum(np.floor(turns) + 1.0, number) / number
    meta = {"amplitude": amplitude, "number": number, "period": period}
    return Excitation("sawtooth", rate, (sizes * _triangle(turns))[:, None], (channel,), (unit,), meta)


def opposed_sines(
    amplitude: float,
    *,
    frequency: float,
    duration: float,
    rate: float,
    channels: tuple[str, str],
    gain: tuple[float, float] = (0.0, 2.0),
    unit: str = "V",
) -> Excitation:
    """Sine on one channel, and on another the same in anti-phase with a gain that is swept.

        v_a(t) = A sin(2 pi f t),   v_b(t) = -g(t) v_a(t),   g(t) from the first to the last gain in a straight line

    Where the motion is smallest, g is the strength of the first actuator over that of the second.
    Source: appendix C.5, with g from 0 to 2.

    Args:
        amplitude: A, in `unit`.
        frequency: f, Hz.
        duration: s, at least one period.
        rate: Hz, above twice the frequency.
        channels: names of the two channels.
        gain: first and last g; negative where the second actuator pushes the other way by itself, as those of the
            oscillators do on the beam in (4.3).
        unit: of both channels.

    Raises:
        ModelError: a number is not above 0 or not finite, or the rate or the duration is too small.
    """
    amplitude, rate = positive("amplitude", amplitude, unit), positive("rate", rate, "Hz")
    frequency, duration = positive("frequency", frequency, "Hz"), positive("duration", duration, "s")
    below_nyquist("the sine,", frequency, rate)
    if duration * frequency < 1.0:
        raise ModelError(f"{duration:g} s hold no period of {frequency:g} Hz; take {1 / frequency:g} s or more")
    names("channel", channels)
    if isinstance(channels, str) or len(channels) != 2:
        raise ModelError(f"the channels are {channels!r}; give two names, such as ('V3', 'V1')")
    first, last = real("first gain", gain[0]), real("last gain", gain[1])
    times = np.arange(samples("opposed sines", duration, rate, 3)) / rate
    sine = amplitude * np.sin(TURN * frequency * times)
    swept = first + (last - first) * times / duration
    meta = {"amplitude": amplitude, "frequency": frequency, "gain": [first, last]}
    return Excitation("opposed_sines", rate, np.column_stack([sine, -swept * sine]), channels, (unit, unit), meta)


def linear_chirp(
    amplitude: float, *, first: float, last: float, duration: float, rate: float, channel: str = "u", unit: str = "V"
) -> Excitation:
    """Sine whose frequency goes from the first to the last in a straight line.

        v(t) = A sin(2 pi (f0 t + (f1 - f0) t^2 / (2 T)))

    Args:
        amplitude: A, in `unit`.
        first: f0, Hz, above 0.
        last: f1, Hz, above 0; below f0 for a chirp downwards.
        duration: T, s.
        rate: Hz, above twice the higher frequency.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a number is not above 0, or the rate is too low.
    """
    times = _sweep_times(first, last, duration, rate)
    turns = first * times + (last - first) * times**2 / (2.0 * duration)
    values = positive("amplitude", amplitude, unit) * np.sin(TURN * turns)
    meta = {"amplitude": amplitude, "first": first, "last": last, "duration": duration}
    return Excitation("linear_chirp", rate, values[:, None], (channel,), (unit,), meta)


def logarithmic_chirp(
    amplitude: float, *, first: float, last: float, duration: float, rate: float, channel: str = "u", unit: str = "V"
) -> Excitation:
    """Sine whose frequency is multiplied by the same factor in equal times.

        v(t) = A sin(2 pi f0 T / r (exp(r t / T) - 1)),   r = log(f1 / f0)

    Args:
        amplitude: A, in `unit`.
        first: f0, Hz, above 0.
        last: f1, Hz, above 0; below f0 for a chirp downwards.
        duration: T, s.
        rate: Hz, above twice the higher frequency.
        channel: name of the channel.
        unit: of the channel.

    Raises:
        ModelError: a number is not above 0, or the rate is too low.
    """
    times = _sweep_times(first, last, duration, rate)
    ratio = math.log(last / first)
    turns = first * (times if ratio == 0.0 else duration / ratio * np.expm1(ratio * times / duration))
    values = positive("amplitude", amplitude, unit) * np.sin(TURN * turns)
    meta = {"amplitude": amplitude, "first": first, "last": last, "duration": duration}
    return Excitation("logarithmic_chirp", rate, values[:, None], (channel,), (unit,), meta)


def _whole_period(signal: Multisine, rate: float) -> int:
    """Samples of one period; refuse one that is no whole number of them."""
    period = signal.period
    if period is None:
        raise ModelError("the lines have no common period; give a duration instead of periods")
    exact = period * rate
    size = round(exact)
    if abs(exact - size) > WHOLE * max(1.0, exact):
        near = max(size, 1)
        raise ModelError(
            f"a period of {period:.9g} s is {exact:.6g} samples at {rate:g} Hz, no whole number; take a period of "
            f"{near / rate:.9g} s, a rate of {near / period:.9g} Hz, or a duration instead of periods"
        )
    return size


def _sweep_times(first: float, last: float, duration: float, rate: float) -> Array:
    rate, duration = positive("rate", rate, "Hz"), positive("duration", duration, "s")
    highest = max(positive("first frequency", first, "Hz"), positive("last frequency", last, "Hz"))
    below_nyquist("the chirp's", highest, rate)
    return np.arange(samples("a chirp", duration, rate, LEAST_SAMPLES)) / rate


def _triangle(turns: Array) -> Array:
    """Triangle of period 1 and amplitude 1 that rises from zero at 0."""
    part = np.mod(turns + 0.25, 1.0)
    return 1.0 - np.abs(4.0 * part - 2.0)
