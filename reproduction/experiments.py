"""Experiments of the document, on the twin: over-compensated damping, and what differs between the oscillators."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from masking.analysis.synchronisation import AntiPhase, anti_phase, mean_phase, synchronisation_time
from masking.lab.runs.experiment import Experiment
from reproduction.comparison import Entry, Value, experimental
from reproduction.mismatch import Mismatch, mismatch
from reproduction.motion import Motion, on_twin, simulated, sustained
from reproduction.plots import transient

FITTED = " (fitted)"
ALPHA = 0.1  # relative, of alpha of (5.3)
LINEARISED = "the differences were found in the linearised system, whose frequencies do not change with the amplitude"


@dataclass(frozen=True)
class Printed:
    """What the document prints of an experiment.

    Args:
        number: of its figure.
        page: where the numbers are.
        alpha: ratio of the amplitudes (5.3).
        eps: (5.3).
        phase: final phase difference over pi.
        time: tau of approximate synchronisation; None where it prints none.
        duration: of the figure, tau.
    """

    number: str
    page: str
    alpha: float
    eps: float
    phase: float
    time: float | None
    duration: float

    @property
    def folded(self) -> float:
        """Return the phase difference over pi, folded to [0, 1], as ours is."""
        return min(self.phase, 2.0 - self.phase)

    @property
    def ratio(self) -> float:
        """Return the ratio of the amplitudes: with the shift by T/2, (5.3) gives alpha = ratio cos(phase - pi)."""
        return self.alpha / math.cos(math.pi * (1.0 - self.folded))

    @property
    def least_eps(self) -> float:
        """Return the least eps of (5.3) per amplitude of the first oscillator, with the shift by T/2."""
        return math.sin(math.pi * (1.0 - self.folded))


@dataclass(frozen=True)
class Ended:
    """How a motion ended: definition 5.3, phase over pi, from when on that stays within 0.1, and the amplitude."""

    fit: AntiPhase
    phase: float
    time: float
    amplitude: float

    @classmethod
    def of(cls, motion: Motion) -> Ended:
        """Look at the last fifth of a motion."""
        last = motion.t >= 0.8 * motion.t[-1]
        phase = mean_phase(motion.phase[last])[0] / np.pi  # folded to [0, 1]
        away = np.abs(np.angle(np.exp(1j * motion.phase)))  # from in phase
        time = synchronisation_time(motion.t, away - np.pi * phase, 0.1 * np.pi)
        return cls(anti_phase(motion.t, motion.a, motion.b), phase, time, float(np.abs(motion.a[last]).max()))


def experiment(
    printed: Printed,
    title: str,
    name: str,
    virtual: str,
    parameters: dict[str, float] | None = None,
    *,
    largest: float,
    words: tuple[str, ...] = (),
    extra: tuple[Value, ...] = (),
) -> Entry:
    """Return an experiment of the document on the twin, with oscillators that are alike and with some that differ.

    Args:
        printed: what the document prints of it.
        title: of the entry.
        name: of the packaged experiment whose transform and initial state it has.
        virtual: the driven model.
        parameters: of the driven model that replace the declared ones.
        largest: over-compensation with which the motion grows.
        words: further paragraphs.
        extra: further numbers.
    """
    base = on_twin(name, virtual=virtual, duration=printed.duration, parameters=parameters or {})
    e, alike = sustained(base, largest=largest)
    found = mismatch(base.virtual, printed.ratio, np.pi * printed.phase)
    plain = Ended.of(alike)
    if found is None:
        return Entry(
            printed.number,
            title,
            "figure",
            (*_compared(printed, plain, "alike"), *extra),
            words,
            transient(alike, title),
        )
    ideal = Ended.of(simulated(found.model, printed.duration))
    added, unlike = sustained(_changed(base, found), largest=largest, offsets=(found.e1, found.e2))
    rough = Ended.of(unlike)
    is_far = abs(ideal.fit.alpha / printed.alpha - 1.0) > ALPHA
    values = (
        *_compared(printed, rough, f"differing{FITTED}", LINEARISED if is_far else ""),
        *experimental(
            Value("alpha, oscillators alike, last fifth", plain.fit.alpha),
            Value("eps, oscillators alike, last fifth", plain.fit.eps),
            Value("phase / pi, oscillators alike, last fifth", plain.phase),
            Value("amplitude of the first at last, differing, on the twin", rough.amplitude),
            Value("common over-compensation for the twin, oscillators alike", e),
            Value("common over-compensation for the twin, differing, added", added),
        ),
        Value(
            "alpha, differing (fitted), the virtual system by itself",
            ideal.fit.alpha,
            printed.alpha,
            printed.page,
            within=ALPHA,
            why=LINEARISED,
            given=True,
        ),
        Value(
            "phase / pi, differing (fitted), the virtual system by itself",
            ideal.phase,
            printed.folded,
            printed.page,
            within=0.05,
            given=True,
        ),
        Value("difference in frequency, % to either side", 100.0 * found.frequency),
        Value("over-compensation e1", found.e1),
        Value("over-compensation e2", found.e2),
        Value("decay of the in-phase mode, alike and not driven", found.before),
        Value("decay of the in-phase mode, differing", found.decay),
        *extra,
    )
    in_phase = "Oscillators that are alike are still in phase at the end, so that alpha is negative. "
    text = (
        *((in_phase,) if plain.fit.alpha < 0.0 else ()),
        "The document explains unequal amplitudes by oscillators that are not identical. In the linearised system its "
        f"alpha and phase, a ratio of amplitudes of {printed.ratio:.3f}, are those of the anti-phase mode with "
        f"{found}. Such differences also make the in-phase mode decay at {found.decay:.4f} instead of "
        f"{found.before:.4f}: {found.decay / found.before:.1f} times as fast as without them, where the document "
        "suspects disturbances.",
        "alpha and phase were used to find the differences, which no number of the document confirms; eps and the "
        "time were not. The picture is of the twin with these differences and so much over-compensation, the same for "
        "both, that the motion neither dies nor grows.",
        *words,
    )
    return Entry(printed.number, title, "figure", values, text, transient(unlike, title))


def _compared(printed: Printed, ended: Ended, which: str, why: str = "") -> tuple[Value, ...]:
    where = printed.page
    least, is_given = printed.least_eps * ended.amplitude, which.endswith(FITTED)
    small = ""
    if least > 0.5 * printed.eps:
        small = (
            f"with the printed phase, (5.3) with a shift of half a period cannot be below {printed.least_eps:.3f} of "
            f"the amplitude, {least:.2g} here; the printed eps would belong to an amplitude of "
            f"{printed.eps / printed.least_eps:.2g}"
        )
    rows = [
        Value(
            f"alpha, {which}, on the twin",
            ended.fit.alpha,
            printed.alpha,
            where,
            within=ALPHA,
            why=why,
            given=is_given,
        ),
        Value(
            f"eps, {which.removesuffix(FITTED)}, on the twin", ended.fit.eps, printed.eps, where, within=0.5, why=small
        ),
        Value(f"phase / pi, {which}, on the twin", ended.phase, printed.folded, where, within=0.05, given=is_given),
    ]
    reached = math.isfinite(ended.time)
    read = "the document reads its time off the picture, without a tolerance" if reached else ""
    if printed.time is not None:
        rows.append(
            Value(
                f"tau from which the phase stays within 0.1 pi of its last, {which.removesuffix(FITTED)}, on the twin",
                ended.time,
                printed.time,
                where,
                within=0.2,
                why=read,
            )
        )
    return experimental(*rows)


def _changed(base: Experiment, found: Mismatch) -> Experiment:
    return base.changed(parameters={**base.declaration.parameters, **found.parameters})
