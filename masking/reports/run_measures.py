"""Measures of a run: the numbers of its report, each by its name, and each computed only if it is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from masking.analysis.stability.basins import LABELS, end_of
from masking.analysis.synchronisation import AntiPhase, Synchronisation, period
from masking.errors import DeclarationError, Problem, nearest
from masking.numerics.arrays import Array
from masking.records.recording import Recording
from masking.reports.long_record import drawn
from masking.reports.run_facts import anti_phase_of, input_uses, masking_errors, verdict_of, why_no_phase

Measured = float | str | Array  # a number, a word, or several numbers (k,)
_FIFTH, _NEAR, _REST = 0.2, 0.1, 1e-3  # of the record, of the larger amplitude, of the largest displacement
_LAST: Final = 0.5  # part of the record, at its end, whose maxima and crossings are taken


@dataclass(frozen=True)
class _Run:
    """What measures of one run share, each computed once."""

    whole: Recording

    @cached_property
    def recording(self) -> Recording:
        return drawn(self.whole)

    @cached_property
    def tau(self) -> Array:
        return self.recording.t / float(self.recording.manifest.get("time_scale") or 1.0)

    @cached_property
    def motions(self) -> dict[str, Array]:
        names = [str(name) for name in self.recording.manifest.get("oscillators") or ()]
        return {name: self.recording[f"virtual.{name}"] for name in names}

    @cached_property
    def periods(self) -> list[float]:
        return [period(self.tau, motion) for motion in self.motions.values()]

    @cached_property
    def period(self) -> float:
        return next((p for p in self.periods if math.isfinite(p)), math.nan)

    @cached_property
    def has_phase(self) -> bool:
        all_ = self.recording.array("virtual")
        return not why_no_phase(self.recording.manifest, self.motions, all_, self.periods)

    @cached_property
    def anti_phase(self) -> AntiPhase | None:
        return anti_phase_of(self.tau, self.motions, self.whole) if self.has_phase else None

    @cached_property
    def verdict(self) -> Synchronisation | None:
        names = [*self.motions][:2]
        return verdict_of(self.tau, self.motions, (names[0], names[1]), self.period) if self.has_phase else None

    @cached_property
    def end(self) -> str:
        """Return in which way the last fifth of two oscillators ends, as basins have it."""
        a, b = [*self.motions.values()][:2]
        last = int((1.0 - _FIFTH) * (len(a) - 1))
        size = max(float(np.abs(a).max()), float(np.abs(b).max()))
        return LABELS[end_of(a[last:], b[last:], _NEAR, _REST * size)]

    @cached_property
    def chi(self) -> dict[str, float]:
        return masking_errors(self.whole)

    def peak(self, name: str) -> float:
        return float(np.abs(self.recording[f"input.{name}"]).max())

    @cached_property
    def used(self) -> float:
        return max(
            (use.used for use in input_uses(self.whole, self.recording) if use.used is not None), default=math.nan
        )

    def last(self, name: str) -> Array:
        series = self.whole[f"virtual.{name}"]
        return series[int((1.0 - _LAST) * (len(series) - 1)) :]

    def maxima(self, name: str) -> Array:
        """Return the maxima of a coordinate, each that of the parabola through its three largest samples."""
        x = self.last(name)
        at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
        before, here, after = x[at - 1], x[at], x[at + 1]
        slope, bend = 0.5 * (after - before), after - 2.0 * here + before
        return np.asarray(here - 0.5 * slope**2 / bend)

    def section(self, name: str, crossed: str) -> Array:
        """Return a coordinate or velocity where another crosses zero upwards, on the line between two samples."""
        x, y = self.last(name), self.last(crossed)
        at = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
        part = y[at] / (y[at] - y[at + 1])
        return np.asarray(x[at] + part * (x[at + 1] - x[at]))


_WITH_TWO: Final[Mapping[str, Callable[[_Run], Measured]]] = {
    "alpha": lambda run: run.anti_phase.alpha if run.anti_phase else math.nan,
    "eps": lambda run: run.anti_phase.eps if run.anti_phase else math.nan,
    "tau_s": lambda run: run.verdict.time if run.verdict else math.nan,
    "phase": lambda run: abs(run.verdict.phase) if run.verdict else math.nan,
    "verdict": lambda run: run.verdict.kind if run.verdict else "unknown",
    "end": lambda run: run.end,
}
_ONLY_WITH_A_RIG: Final[Mapping[str, Callable[[_Run], Measured]]] = {
    "chi": lambda run: max(run.chi.values(), default=math.nan),
    "peak": lambda run: max(map(run.peak, run.recording.inputs), default=math.nan),
    "used": lambda run: run.used,
}
_MEASURES: Final[Mapping[str, Callable[[_Run], Measured]]] = {
    **_WITH_TWO,
    **_ONLY_WITH_A_RIG,
    "period": lambda run: run.period,
}
_OF_ONE: Final[Mapping[str, Callable[[_Run, str], Measured]]] = {
    "chi": lambda run, name: run.chi[name],
    "peak": lambda run, name: run.peak(name),
    "maxima": lambda run, name: run.maxima(name),
    "section": lambda run, name: run.section(*name.split("@")),
}
MEANINGS: Final = {
    "alpha": "ratio of the amplitudes of the oscillators in anti-phase (5.3)",
    "eps": "largest deviation from anti-phase at the end (5.3)",
    "tau_s": "time after which the oscillators are synchronised (8.1)",
    "phase": "phase difference at the end, without its sign",
    "verdict": "in which way the oscillators are synchronised at the end",
    "end": "at which motion the oscillators are in the last fifth of the run",
    "chi": "largest masking error",
    "peak": "largest input",
    "used": "largest input as a part of its limit",
    "period": "mean period of the first oscillator",
}


def defaults(oscillators: Sequence[str], *, has_rig: bool) -> tuple[str, ...]:
    """Return the measures that are taken where none are named."""
    two = ("alpha", "eps", "tau_s", "verdict") if len(oscillators) == 2 else ("period",)
    return (*two, *(_ONLY_WITH_A_RIG if has_rig else ()))


def check(
    names: Sequence[str], oscillators: Sequence[str], states: Sequence[str], inputs: Sequence[str], *, has_rig: bool
) -> None:
    """Refuse measures that a run has not.

    Args:
        names: of the measures.
        oscillators: of the virtual system.
        states: of the virtual system.
        inputs: of the rig.
        has_rig: whether a rig runs, or the virtual system by itself.

    Raises:
        DeclarationError: there is no measure of a name, or no rig for it.
    """
    allowed = [name for name in _MEASURES if has_rig or name not in _ONLY_WITH_A_RIG]
    allowed += [f"maxima.{n}" for n in states] + [f"section.{a}@{b}" for a in states for b in states if a != b]
    if has_rig:
        allowed += [f"peak.{n}" for n in inputs] + [f"chi.{n}" for n in states if not n.endswith("'")]
    if len(oscillators) < 2:
        allowed = [name for name in allowed if name not in _WITH_TWO]
    for name in names:
        if name not in allowed:
            mend = nearest(name, allowed)
            if name.partition(".")[0] in _ONLY_WITH_A_RIG and not has_rig:
                mend = "the virtual system runs by itself, without a rig; leave --virtual out, or this measure"
            raise DeclarationError(Problem(None, name, "is no measure of these runs", mend))


def measure(recording: Recording, names: Sequence[str]) -> dict[str, Measured]:
    """Return measures of a recording by name."""
    run, found = _Run(recording), dict[str, Measured]()
    for name in names:
        kind, dot, of = name.partition(".")
        found[name] = _OF_ONE[kind](run, of) if dot else _MEASURES[name](run)
    return found


def empty(name: str) -> Measured:
    """Return what stands for a measure of a run that failed."""
    kind = name.partition(".")[0]
    return "" if kind in {"verdict", "end"} else np.empty(0) if kind in {"maxima", "section"} else math.nan
