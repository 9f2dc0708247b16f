"""Measures of a run: the numbers of its report, each by its name, and each computed only if it is asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from masking.analysis.stability.basins import LABELS, end_of
from masking.compile.numerics.arrays import Array
from masking.errors import DeclarationError, Problem, nearest
from masking.lab.records.recording import Recording
from masking.model.declaration.units import pretty
from masking.reports.run_study import Study

Measured = float | str | Array  # a number, a word, or several numbers (k,)
_OfRun = Mapping[str, Callable[[Study], Measured]]
_FIFTH, _NEAR, _REST = 0.2, 0.1, 1e-3  # of the record, of the larger amplitude, of the largest displacement
WORDS: Final = ("verdict", "end")  # measures that are words
_LAST: Final = 0.5  # part of the record, at its end, whose maxima and crossings are taken


def _ends(a: Array, b: Array) -> list[str]:
    """Kind of motion in the last fifth of two oscillators (runs, m), as basins name it."""
    last = int((1.0 - _FIFTH) * (a.shape[1] - 1))
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    return [LABELS[i] for i in end_of(a[:, last:], b[:, last:], _NEAR, _REST * size)]


def _end(run: Study) -> str:
    a, b = [*run.motions.values()][:2]
    return _ends(a[None], b[None])[0]


def _peaks(run: Study) -> dict[str, float]:
    return {use.name: use.peak for use in run.inputs}


def _last(run: Study, name: str) -> Array:
    series = run.whole[f"{run.prefix}.{name}"]
    return series[int((1.0 - _LAST) * (len(series) - 1)) :]


def _maxima(run: Study, name: str) -> Array:
    """Maxima of a coordinate, each that of the parabola through its three largest samples."""
    x = _last(run, name)
    at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:])) + 1
    before, here, after = x[at - 1], x[at], x[at + 1]
    slope, bend = 0.5 * (after - before), after - 2.0 * here + before
    return np.asarray(here - 0.5 * slope**2 / bend)


def _section(run: Study, names: str) -> Array:
    """Coordinate or velocity where another crosses zero upwards, on the line between two samples."""
    x, y = (_last(run, name) for name in names.split("@"))
    at = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    part = y[at] / (y[at] - y[at + 1])
    return np.asarray(x[at] + part * (x[at + 1] - x[at]))


_WITH_TWO: Final[_OfRun] = {
    "alpha": lambda run: run.anti_phase.alpha if run.anti_phase else math.nan,
    "eps": lambda run: run.anti_phase.eps if run.anti_phase else math.nan,
    "tau_s": lambda run: run.verdict.time if run.verdict else math.nan,
    "phase": lambda run: abs(run.verdict.phase) if run.verdict else math.nan,
    "verdict": lambda run: run.verdict.kind if run.verdict else "unknown",
    "end": _end,
}
_OF_MANY: Final[Mapping[str, Callable[[Array, Array], list[str]]]] = {"end": _ends}
_ONLY_WITH_A_RIG: Final[_OfRun] = {
    "chi": lambda run: max(run.chi.values(), default=math.nan),
    "peak": lambda run: max(_peaks(run).values(), default=math.nan),
    "used": lambda run: max((use.used for use in run.inputs if use.used is not None), default=math.nan),
}
_MEASURES: Final[_OfRun] = {**_WITH_TWO, **_ONLY_WITH_A_RIG, "period": lambda run: run.period}
_OF_ONE: Final[Mapping[str, Callable[[Study, str], Measured]]] = {
    "chi": lambda run, name: run.chi[name],
    "peak": lambda run, name: _peaks(run)[name],
    "maxima": _maxima,
    "section": _section,
    "end": lambda run, name: float(_last(run, name)[-1]),
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


@dataclass(frozen=True)
class Measurable:
    """What runs have that can be measured, and the units of that."""

    oscillators: tuple[str, ...]
    states: Mapping[str, str]  # units of coordinates, velocities and internal states, by name
    inputs: Mapping[str, str] | None  # units of the inputs, by name; None for runs without a rig
    time: str  # unit

    @property
    def defaults(self) -> tuple[str, ...]:
        """Measures that are taken where none are named."""
        usual = ("alpha", "eps", "tau_s", "verdict") if len(self.oscillators) == 2 else ("period",)
        return tuple(name for name in (*usual, *_ONLY_WITH_A_RIG) if name not in self._refused)

    @cached_property
    def _refused(self) -> dict[str, str]:
        """Measures that these runs have not, and why."""
        found = dict[str, str]()
        if self.inputs is None:
            without = "the virtual system runs by itself, without a rig; leave --virtual out, or this measure"
            found |= dict.fromkeys(_ONLY_WITH_A_RIG, without)
        elif len({*self.inputs.values()}) > 1:
            units = ", ".join(f"{name} is in {unit}" for name, unit in self.inputs.items())
            found["peak"] = f"{units}: name one input, such as peak.{next(iter(self.inputs))}"
        first, *more = self.oscillators
        if not more:
            one = f"it compares two oscillators, and there is one, {first}"
            found |= dict.fromkeys(_WITH_TWO, one) | {"end": f"{one}; end.{first} is the value of {first} at the end"}
        elif len({self.states[name] for name in self.oscillators}) > 1:
            units = ", ".join(f"{name} is in {self.states[name]}" for name in self.oscillators)
            found |= dict.fromkeys(("alpha", "eps"), f"{units}: declare one unit for all oscillators")
        return found

    def check(self, names: Sequence[str]) -> None:
        """Refuse measures that the runs have not; a `DeclarationError` says why."""
        states = [*self.states]
        allowed = [name for name in _MEASURES if name not in self._refused]
        allowed += [f"{kind}.{n}" for kind in ("maxima", "end") for n in states]
        allowed += [f"section.{a}@{b}" for a in states for b in states if a != b]
        if self.inputs is not None:
            allowed += [f"peak.{n}" for n in self.inputs] + [f"chi.{n}" for n in states if not n.endswith("'")]
        for name in names:
            if name not in allowed:
                kind = name.partition(".")[0]
                of_rig = self._refused[kind] if self.inputs is None and kind in _ONLY_WITH_A_RIG else ""
                remedy = of_rig or self._refused.get(name) or nearest(name, allowed)
                raise DeclarationError(Problem(None, name, "is no measure of these runs", remedy))

    def unit(self, name: str) -> str:
        """Unit of a measure; "" where it has none."""
        kind, dot, of = name.partition(".")
        if kind in {"tau_s", "period"}:
            return self.time
        found = {"phase": "rad", "eps": self.states[self.oscillators[0]]}.get(name, "1")
        if kind == "peak":
            found = (self.inputs or {})[of or next(iter(self.inputs or {}))]
        elif dot and kind != "chi":
            found = self.states[of.partition("@")[0]]
        return "" if found == "1" else pretty(found)


def measure(recording: Recording, names: Sequence[str]) -> dict[str, Measured]:
    """Measures of a recording by name."""
    run, found = Study(recording), dict[str, Measured]()
    for name in names:
        kind, dot, of = name.partition(".")
        found[name] = _OF_ONE[kind](run, of) if dot else _MEASURES[name](run)
    return found


def measure_each(motions: Sequence[Array], names: Sequence[str]) -> dict[str, list[str]] | None:
    """Measures of many runs by name, if all can be taken together; motions of the oscillators are each (runs, m)."""
    if not all(name in _OF_MANY for name in names):
        return None
    return {name: _OF_MANY[name](*motions[:2]) for name in names}


def empty(name: str) -> Measured:
    """Value that stands for a measure of a run that failed."""
    kind = name.partition(".")[0]
    return "" if name in WORDS else np.empty(0) if kind in {"maxima", "section"} else math.nan
