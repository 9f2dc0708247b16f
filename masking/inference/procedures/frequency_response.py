"""Frequency response of a rig to periodic excitation, line by line, with its uncertainty.

A multisine that has settled repeats itself: what differs from period to period is noise, what differs from one
realisation of its random phases to the next is noise and nonlinear distortion, and what appears at lines that were not
excited is distortion, even or odd as the line is. No window is needed, as every period is whole.
Source: Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2012), chapters 2 to 4.

Arrays are (experiments, samples, channels). Spectra are those of peak amplitudes: A cos(2 pi f t + phi) gives
A exp(i phi) at f.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from masking.compile.numerics.arrays import Array, Complex
from masking.errors import ModelError, RecordError
from masking.inference.estimation.periodic_spectra import Indices, Spectra, by_period
from masking.inference.procedures.channel_names import probability

WORST_CONDITION = 1e6  # of the amplitudes of inputs at a line, up to which they can be distinguished
MOVING_PART = 1e-12  # of its largest value: a channel that changes by no more does not move
SILENT_PART = 1e-9  # of the largest amplitude: one that is no larger is rounding


@dataclass(frozen=True)
class FrequencyResponse:
    """A frequency response G with its uncertainty; the best linear approximation where the rig is not linear."""

    harmonics: Indices  # lines as multiples of the base (lines,)
    frequencies: Array  # of the lines, Hz (lines,)
    response: Complex  # G, output per input (lines, outputs, inputs)
    noise: Array  # variance E|G - E G|^2 that the differences between periods explain (lines, outputs, inputs)
    total: Array | None  # variance that realisations differ by, distortion included; None where there is one
    periods: int  # periods of each experiment
    realisations: int  # groups of experiments with phases of their own
    freedom: int  # complex degrees of freedom of `noise`

    @property
    def variance(self) -> Array:
        """Variance of the response: that over realisations, and over periods where there is only one."""
        return self.noise if self.total is None else self.total

    @property
    def distortion(self) -> Array | None:
        """Variance that nonlinear distortion adds to G in one realisation; None where there is only one.

        sigma_S^2 = R (sigma_BLA^2 - sigma_n^2), not below 0. Source: Pintelon and Schoukens (2012), (4-51).
        """
        return None if self.total is None else np.maximum(self.realisations * (self.total - self.noise), 0.0)

    def radius(self, level: float = 0.95) -> Array:
        """Radius around G of the circle that holds the true one with a probability (lines, outputs, inputs).

            r^2 = sigma^2 F(2, 2 m),   m complex degrees of freedom of the variance

        Source: Pintelon and Schoukens (2012), section 2.4.2 (sample variance of circular complex noise).
        A level that is not between 0 and 1 is a ModelError.
        """
        freedom = self.freedom if self.total is None else self.realisations - 1
        factor = float(special.fdtri(2, 2 * freedom, probability(level)))
        return np.asarray(np.sqrt(self.variance * factor))


@dataclass(frozen=True)
class Distortion:
    """What an odd multisine with detection lines shows of noise, even and odd distortion, for one output.

    Levels are squared peak amplitudes of the output, averaged over realisations; at a line without distortion the
    level of the output is that of the noise.
    """

    harmonics: Indices  # all lines up to the highest excited one (lines,)
    frequencies: Array  # Hz (lines,)
    excited: NDArray[np.bool_]  # True where the input was excited (lines,)
    level: Array  # mean squared amplitude of the output's mean over periods (lines,)
    noise: Array  # part of `level` that noise explains (lines,)
    response: FrequencyResponse  # best linear approximation at the excited lines

    @property
    def even(self) -> Indices:
        """Positions in `harmonics` of the even lines."""
        return np.flatnonzero(self.harmonics % 2 == 0)

    @property
    def odd(self) -> Indices:
        """Positions in `harmonics` of the odd lines that were not excited."""
        return np.flatnonzero((self.harmonics % 2 == 1) & ~self.excited)

    @property
    def distortion(self) -> Array:
        """Level of distortion at each line, NaN where it was excited: the level less that of noise, >= 0."""
        return np.asarray(np.where(self.excited, np.nan, np.maximum(self.level - self.noise, 0.0)))

    @property
    def shares(self) -> dict[str, float]:
        """Mean amplitudes (rms over lines) of `even`, `odd` and `noise`, as parts of those of the output.

        The output's is that of the excited lines.
        """
        signal = float(np.mean(self.level[self.excited]))
        beyond = self.level - self.noise
        sides = {"even": self.even, "odd": self.odd}
        parts = {name: max(float(np.mean(beyond[lines])), 0.0) for name, lines in sides.items()}
        return {name: float(np.sqrt(v / signal)) for name, v in (parts | {"noise": float(self.noise.mean())}).items()}


def spectra(inputs: Array, outputs: Array, *, period: float, rate: float, discard: int = 1) -> Spectra:
    """Spectra of the whole periods of a record, less those in which it settles.

    Args:
        inputs: what was commanded (experiments, samples, inputs), at least two periods more than `discard`.
        outputs: what was measured (experiments, samples, outputs).
        period: of the excitation, s; a whole number of samples.
        rate: samples per second.
        discard: periods at the start that are left out, in which the transient dies out.

    Raises:
        RecordError: values are not finite, periods are not whole or too few, or a channel does not move.
        ModelError: the period is not a whole number of samples, or a setting makes no sense.
    """
    length = _period_length(period, rate)
    if discard < 0:
        raise ModelError(f"discard is {discard!r}; give a whole number of periods, 0 or more")
    whole, rest = divmod(inputs.shape[1], length)
    if rest:
        raise RecordError(
            f"{inputs.shape[1]} samples are not whole periods of {length}: {rest} are left over; cut the record to "
            f"{whole * length} samples, or correct the period of {period:g} s"
        )
    if whole - discard < 2:
        raise RecordError(
            f"the record has {whole} periods, of which {discard} are discarded; at least 2 must remain to tell noise "
            f"from response: record {discard + 2} periods or more"
        )
    for what, values in (("input", inputs), ("output", outputs)):
        _refuse_not_finite(f"{what}s", values)
        _refuse_constant(what, values[:, discard * length :])
    return Spectra(float(rate), length, *(by_period(values, length, discard) for values in (inputs, outputs)))


def frequency_response(found: Spectra, harmonics: Indices | None = None) -> FrequencyResponse:
    """Estimate the frequency response from whole periods, with its variance over periods and realisations.

        G_r = Y_r U_r^-1,   Y_r (outputs, inputs), U_r (inputs, inputs) of the means over periods,   G = mean_r G_r

    With one input, every experiment is a realisation. With n inputs, n experiments one after the other make one: in
    them, the inputs must differ (such as orthogonal multisines: the same signals times the entries of a Hadamard or
    Fourier matrix). The noise of inputs and outputs, correlated or not, is propagated to first order:

        v = y - G u,   var G_ij = sum_e var(v_i) |(U^-1)_ej|^2

    Source: Pintelon and Schoukens (2012), sections 2.7 (periodic excitation, several inputs) and 4.3 (realisations).

    Args:
        found: the spectra of a record.
        harmonics: lines to look at, multiples of 1 / period (lines,); None for those that are excited.

    Raises:
        RecordError: there are too few experiments for the inputs, or these cannot be distinguished at a line.
    """
    lines = found.excited if harmonics is None else harmonics
    u, y = found.inputs[:, :, lines], found.outputs[:, :, lines]
    count, periods, inputs = len(u), found.periods, u.shape[3]
    if count % inputs:
        raise RecordError(
            f"{count} experiments for {inputs} inputs; record {inputs} in which the inputs differ for each realisation "
            "of the phases, or give each line to one input and use zippered_response"
        )
    groups = count // inputs
    each_u, each_y = (x.mean(axis=1).reshape(groups, inputs, len(lines), -1) for x in (u, y))
    matrix = each_u.transpose(0, 2, 3, 1)  # (realisations, lines, inputs, experiments)
    _refuse_silent(found, lines)
    _refuse_alike(matrix, lines, found.base)
    inverse = np.linalg.inv(matrix)
    each = each_y.transpose(0, 2, 3, 1) @ inverse  # (realisations, lines, outputs, inputs)
    response = each.mean(axis=0)
    # Each realisation is compared with its own response, so that distortion is not taken for noise.
    rest = y - np.einsum("bkoi,bpki->bpko", np.repeat(each, inputs, axis=0), u)
    spread = (_variance(rest) / periods).reshape(groups, inputs, len(lines), -1)
    noise = np.einsum("reko,rkej->koj", spread, np.abs(inverse) ** 2) / groups**2
    total = _variance(each[None])[0] / groups if groups > 1 else None
    freedom = count * (periods - 1)
    return FrequencyResponse(lines, np.asarray(lines * found.base), response, noise, total, periods, groups, freedom)


def zippered_response(found: Spectra) -> tuple[FrequencyResponse, ...]:
    """Estimate the response to each input (lines, outputs, 1) from lines that are excited by one input only.

    Every experiment is a realisation. Source: Pintelon and Schoukens (2012), section 2.7 (zippered multisines).

    Raises:
        RecordError: two inputs share a line.
    """
    moved = found.moved()
    shared = np.flatnonzero(moved.sum(axis=1) > 1)
    if len(shared):
        who = " and ".join(str(i) for i in np.flatnonzero(moved[shared[0]]))
        raise RecordError(
            f"the inputs {who} share the harmonic {shared[0]}, {shared[0] * found.base:.6g} Hz; give each line to one "
            "input, or as many experiments as inputs to frequency_response"
        )
    alone = (replace(found, inputs=found.inputs[..., [i]]) for i in range(moved.shape[1]))
    return tuple(frequency_response(each, np.flatnonzero(line)) for each, line in zip(alone, moved.T, strict=True))


def nonlinear_distortion(found: Spectra, harmonics: Indices | None = None) -> Distortion:
    """Split what an odd multisine makes into best linear approximation, even and odd distortion, and noise.

    An odd nonlinearity answers odd lines with odd lines only, an even one with even lines only. What the output has at
    the odd lines that were left out shows the odd distortion, at even lines the even one, and the differences between
    periods the noise. What the input itself has there is taken off through the response of the neighbouring lines.
    Source: Pintelon and Schoukens (2012), section 4.3.2 (robust and fast method).

    The spectra are of a record of one input and one output, each experiment a realisation. The harmonics are excited
    lines; None for those that have 1 % of the largest amplitude or more.

    Raises:
        RecordError: an even line is excited, or no odd line was left out.
    """
    excited = found.excited if harmonics is None else harmonics
    wrong = excited[excited % 2 == 0]
    if len(wrong):
        raise RecordError(
            f"the even harmonic {wrong[0]} is excited, {wrong[0] * found.base:.6g} Hz; even distortion shows only "
            "where even lines are left out: excite odd harmonics only"
        )
    lines = np.arange(1, excited.max() + 1)
    is_excited = np.isin(lines, excited)
    if not ((lines % 2 == 1) & ~is_excited).any():
        raise RecordError(
            f"every odd harmonic up to {excited.max()} is excited, so that odd distortion cannot be distinguished from "
            "the response; leave out some, such as one at random of every three"
        )
    response = frequency_response(found, excited)
    near = np.interp(lines, excited, response.response[:, 0, 0])
    rest = found.outputs[:, :, lines, 0] - np.where(is_excited, 0.0, near) * found.inputs[:, :, lines, 0]
    level = np.mean(np.abs(rest.mean(axis=1)) ** 2, axis=0)
    noise = np.mean(_variance(rest), axis=0) / found.periods
    return Distortion(lines, lines * found.base, is_excited, level, noise, response)


def _variance(values: Complex) -> Array:
    """E|x - E x|^2 over the second axis, without bias."""
    mean = values.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(np.abs(values - mean) ** 2, axis=1) / (values.shape[1] - 1))


def _period_length(period: float, rate: float) -> int:
    for what, value, unit in (("period", period, "s"), ("rate", rate, "Hz")):
        if not np.isfinite(value) or value <= 0.0:
            raise ModelError(f"the {what} is {value!r} {unit}; give a finite number above 0")
    length = round(period * rate)
    if length < 4 or abs(length - period * rate) > 1e-6 * length:
        raise ModelError(
            f"a period of {period:.9g} s at {rate:.9g} Hz is {period * rate:.9g} samples; choose them such that it is "
            f"a whole number of at least 4, such as a period of {max(length, 4) / rate:.9g} s"
        )
    return length


def _refuse_not_finite(what: str, values: Array) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        e, i, c = bad[0]
        raise RecordError(
            f"the {what} must be finite: {values[e, i, c]} in experiment {e}, sample {i}, channel {c} (counted from 0),"
            f" {len(bad)} in all; cut the record to whole periods without them, or record it again"
        )


def _refuse_constant(what: str, values: Array) -> None:
    still = np.flatnonzero(np.ptp(values, axis=1).max(axis=0) <= MOVING_PART * np.abs(values).max(axis=(0, 1)))
    if len(still):
        raise RecordError(
            f"{what} {still[0]} (counted from 0) is constant at {values[0, 0, still[0]] + 0.0:.6g} after the periods "
            "that are discarded; leave it out, or see that it is connected and excited"
        )


def _refuse_silent(found: Spectra, lines: Indices) -> None:
    mean = np.abs(found.inputs.mean(axis=1))
    noise = 3.0 * np.sqrt(_variance(found.inputs[:, :, lines]) / found.periods)
    least = np.maximum(noise, SILENT_PART * mean.max(axis=(0, 1)))
    bad = np.argwhere(~(mean[:, lines] > least).any(axis=0))
    if len(bad):
        line, which = lines[bad[0][0]], bad[0][1]
        raise RecordError(
            f"input {which} (counted from 0) is not excited at the harmonic {line}, {line * found.base:.6g} Hz: "
            "leave the harmonic out, or excite it"
        )


def _refuse_alike(matrix: Complex, lines: Indices, base: float) -> None:
    """Refuse inputs (realisations, lines, inputs, experiments) that cannot be distinguished at a line."""
    bad = np.flatnonzero(~(np.linalg.cond(matrix).max(axis=0) < WORST_CONDITION))
    if len(bad):
        line = lines[bad[0]]
        raise RecordError(
            f"the inputs cannot be distinguished at the harmonic {line}, {line * base:.6g} Hz: they are alike in all "
            "experiments of a realisation; use orthogonal multisines, or give each line to one input"
        )
