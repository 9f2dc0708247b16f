"""Study of a run: what a recording shows in numbers, which figures draw and texts describe."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from masking.analysis.masking_error import ErrorSum
from masking.analysis.synchronisation import (
    AntiPhase,
    Synchronisation,
    anti_phase,
    mean_phase,
    period,
    phase_difference,
    running_peak,
    synchronisation,
)
from masking.compile.numerics.arrays import Array
from masking.errors import MaskingError, RecordError
from masking.lab.records.recording import Recording
from masking.model.declaration import units
from masking.model.declaration.input_definitions import internals
from masking.reports.long_record import deviation, drawn

SUM_WINDOW_PERIODS = 3
_END = 0.05  # part of the record over which its last phase is stated
_ROWS = 64  # of a period, which tell as much as thousands
_LAST = 0.2  # part of the record over which alpha and eps are stated
_ROUNDING = 1e-9
_AT_REST = 1e-12  # of the largest coordinate: below this a coordinate has not moved


@dataclass(frozen=True, slots=True)
class PhasePair:
    """Phase of one oscillator minus that of another, in radians: the series, and its mean at first and at last.

    `start` and `end` are folded to [0, pi]; `steady_start`, `steady_end`: 1 for a constant phase, 0 for a spread one.
    `verdict` says in which way they are synchronised at last, None where the record is too short to tell.
    """

    first: str
    second: str
    series: Array
    start: float
    end: float
    steady_start: float
    steady_end: float
    verdict: Synchronisation | None = None


@dataclass(frozen=True, slots=True)
class InputUse:
    """How much of an input was used; `limit` is None where none is declared, `used` is peak / limit.

    `demanded` is the series before limits, None where it was not recorded; `saturated` is the part of the record in
    which the input was cut off at its limit, `throttled` the part in which its mean power held it below that. `power`
    is the largest mean power and `most_power` its limit, in W, None where there is none.
    """

    name: str
    series: Array
    unit: str
    peak: float
    rms: float
    limit: float | None
    used: float | None
    meaning: str = ""
    demanded: Array | None = None
    saturated: float = 0.0
    throttled: float = 0.0
    power: float | None = None
    most_power: float | None = None

    @property
    def is_exceeded(self) -> bool:
        """Whether the input went beyond its limit, by more than rounding."""
        return self.used is not None and self.used > 1.0 + _ROUNDING

    @property
    def is_cut(self) -> bool:
        """Whether less was applied than demanded."""
        return self.saturated + self.throttled > 0.0

    @property
    def demand(self) -> float:
        """Largest magnitude that was demanded."""
        return self.peak if self.demanded is None else float(np.abs(self.demanded).max())

    @property
    def demanded_part(self) -> float:
        """Largest magnitude that was demanded, as a part of the limit; 0 without one."""
        return self.demand / self.limit if self.limit else 0.0


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """The masking error of a further run without one cause: of each coordinate, and their rms.

    `remedy` is what helps, `note` what must be known to read the row; `remedied` is the rms with the remedy, None where
    it was not tried.
    """

    cause: str
    chi: dict[str, float]
    rms: float
    remedy: str
    note: str
    remedied: float | None = None

    @property
    def title(self) -> str:
        """Name of the run."""
        titles = {
            "": "as it is",
            "sampling": "sampled faster",
            "parameters": "with the rig's parameters",
            "all of these": "without all",
        }
        return titles.get(self.cause, f"without {self.cause}")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the virtual system as it ran; None or "" stands for what the record does not tell.

    `value` and `declared` are in `unit`, "" for none; `declared` is a text where the declaration holds an expression.
    `scaled` is the value in the scales of the virtual system, where those differ from its unit.
    """

    name: str
    value: float | str | None
    unit: str
    declared: float | str | None
    scaled: float | None
    is_changed: bool
    meaning: str


@dataclass(frozen=True)
class Study:
    """All that the figures, the tables and the summary say about one recording, worked out when it is asked for."""

    whole: Recording

    @cached_property
    def recording(self) -> Recording:
        """The recording, with fewer samples where it is on disk: inputs keep the extreme values of each stretch."""
        return drawn(self.whole)

    @cached_property
    def tau(self) -> Array:
        """Time of the virtual system (m,)."""
        return self.recording.t / self.time_scale

    @property
    def prefix(self) -> str:
        """Prefix of the motion that is looked at: "virtual", or "rig" for a record without a virtual system."""
        return "virtual" if self.recording.coordinates else "rig"

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The oscillators, then the other coordinates."""
        return self.oscillators + self.others

    @cached_property
    def oscillators(self) -> tuple[str, ...]:
        """The oscillators; all coordinates where none are declared."""
        declared = tuple(str(name) for name in self.recording.manifest.get("oscillators") or ())
        return declared or tuple(self.recording.names(self.prefix))

    @property
    def others(self) -> tuple[str, ...]:
        """Coordinates that are no oscillators."""
        return tuple(name for name in self.recording.names(self.prefix) if name not in self.oscillators)

    @cached_property
    def motions(self) -> dict[str, Array]:
        """Motion of each oscillator (m,), as part of its largest where units differ; an error for an absent one."""
        found = {name: self.motion(name) for name in self.oscillators}
        return {name: one / (np.abs(one).max() or 1.0) for name, one in found.items()} if self.no_sum else found

    @cached_property
    def no_sum(self) -> str:
        """Why the oscillators have no sum and no ratio of amplitudes, "" if they have."""
        units = {name: self.unit(f"{self.prefix}.{name}") or "1" for name in self.oscillators}
        for first, other in itertools.pairwise(units):
            if units[first] != units[other]:
                return f"{first} is in {units[first]}, {other} in {units[other]}; declare one unit for both"
        return ""

    @cached_property
    def periods(self) -> list[float]:
        """Mean period of each oscillator, in units of `tau`; NaN where it has none."""
        return [period(self.tau, motion) for motion in self.motions.values()]

    @property
    def period(self) -> float:
        """Mean period of the first oscillator that has one, else NaN."""
        return next((p for p in self.periods if math.isfinite(p)), math.nan)

    @cached_property
    def no_phase(self) -> str:
        """Why there is no phase difference, "" if there is."""
        motions = self.motions
        if not self.recording.manifest.get("oscillators"):
            return "the record does not say which coordinates are oscillators"
        if len(motions) < 2:
            return "there is only one oscillator"
        scale = float(np.abs(self.recording.array(self.prefix)).max())
        for name, motion in motions.items():
            if np.ptp(motion) <= _AT_REST * scale:
                return f"{name} does not move"
        for name, value in zip(motions, self.periods, strict=True):
            if not math.isfinite(value):
                return f"the record holds fewer than three periods of {name}"
        return ""

    @cached_property
    def chi(self) -> dict[str, float]:
        """Masking error by coordinate; that which the run stated where the ideal motion was not recorded."""
        stated, sums = self.recording.manifest.get("masking_error") or {}, self._error_sums
        return {n: sums[n].value if n in sums else float(stated[n]) for n in self._compared if n in {*sums, *stated}}

    @property
    def errors(self) -> dict[str, float]:
        """Largest distance from the ideal motion by coordinate."""
        return {name: one.largest for name, one in self._error_sums.items()}

    @property
    def _compared(self) -> tuple[str, ...]:
        return self.whole.coordinates or self.whole.names("rig")

    @cached_property
    def _error_sums(self) -> dict[str, ErrorSum]:
        sums = {n: ErrorSum() for n in self._compared if {f"ideal.{n}", f"virtual.{n}"} <= self.whole.columns.keys()}
        for chunk in self.whole.chunks([f"{kind}.{name}" for name in sums for kind in ("virtual", "ideal")]):
            for name, one in sums.items():
                one.add(chunk[f"virtual.{name}"], chunk[f"ideal.{name}"])
        return sums

    @cached_property
    def pairs(self) -> tuple[PhasePair, ...]:
        """Phases of the first oscillator and each other one."""
        return () if self.no_phase else tuple(self._pair(name) for name in self.oscillators[1:])

    @cached_property
    def sum_peak(self) -> Array | None:
        """Running peak of |sum of the oscillators| (m,)."""
        if self.no_phase or self.no_sum:
            return None
        total = np.asarray(sum(self.motions.values()))
        return running_peak(self.tau, np.abs(total), SUM_WINDOW_PERIODS * self.period)

    @cached_property
    def anti_phase(self) -> AntiPhase | None:
        """Fit of definition 5.3 to the end of two oscillations; None where it does not apply."""
        if self.no_phase or self.no_sum or len(self.oscillators) != 2:
            return None
        a, b = self.motions.values()
        try:
            found = anti_phase(self.tau, a, b)
        except RecordError:  # fewer than three periods in the last fifth: there is nothing to state
            return None
        if not self.whole.is_on_disk or not math.isfinite(found.alpha):
            return found
        first, last = self.whole.span
        first_name, second_name = (f"{self.prefix}.{name}" for name in self.oscillators)
        start = last - _LAST * (last - first)
        return replace(found, eps=deviation(self.whole, (first_name, second_name), found, start, self.time_scale))

    @cached_property
    def verdict(self) -> Synchronisation | None:
        """In which way the first two oscillators are synchronised at the end; None where the record does not say."""
        return None if self.no_phase else self._verdict(self.oscillators[1])

    @cached_property
    def inputs(self) -> tuple[InputUse, ...]:
        """How much of each input was used."""
        return tuple(_use(self.whole, name, self.recording) for name in self.whole.inputs)

    @property
    def most_used(self) -> InputUse | None:
        """Input that went furthest towards its limit, or beyond; None where no input has one."""
        used = [use for use in self.inputs if use.used is not None]
        return max(used, key=lambda use: use.demanded_part, default=None)

    @cached_property
    def budget(self) -> tuple[BudgetRow, ...]:
        """Error budget: the run as it is, without each cause, the most worthwhile first, and without all; or none."""
        content = nested(self.recording.manifest, "budget")
        if not content:
            return ()
        whole, *rows, without_all = map(_row, (content, *content["rows"], content["without_all"]))
        return whole, *sorted(rows, key=lambda row: row.rms), without_all

    def _verdict(self, second: str) -> Synchronisation | None:
        """Synchronisation of the first oscillator and another; None for too short a record."""
        tau, first, motions = self.tau, self.oscillators[0], self.motions
        rows = slice(None, None, max(1, int(self.period / _ROWS * (len(tau) - 1) / (tau[-1] - tau[0]))))
        a, b = motions[first][rows], motions[second][rows]
        try:
            return synchronisation(tau[rows], a, b, names=(first, second))
        except RecordError:
            return None

    def _pair(self, second: str) -> PhasePair:
        first = self.oscillators[0]
        head, tail = ends(self.tau, self.period)
        series = phase_difference(self.tau, self.motion(first), self.motion(second))
        (start, steady_start), (end, steady_end) = mean_phase(series[head]), mean_phase(series[tail])
        verdict = self.verdict if second == self.oscillators[1] else self._verdict(second)
        return PhasePair(first, second, series, start, end, steady_start, steady_end, verdict)

    def motion(self, coordinate: str) -> Array:
        """Coordinate as it moved (samples,)."""
        return self.recording[f"{self.prefix}.{coordinate}"]

    def ideal(self, coordinate: str) -> Array | None:
        """Coordinate of the virtual system by itself, where it was recorded."""
        return self.recording.columns.get(f"ideal.{coordinate}")

    @property
    def time_scale(self) -> float:
        """Seconds of the rig per unit of `tau`."""
        return float(self.recording.manifest.get("time_scale") or 1.0)

    @property
    def length(self) -> float:
        """Time from the first sample to the last, in units of `tau`."""
        first, last = self.whole.span
        return (last - first) / self.time_scale

    def between(self, start: float | None, end: float | None) -> Study:
        """Part between two times in units of `tau`, with all its samples."""
        limits = (None if at is None else at * self.time_scale for at in (start, end))
        return Study(self.whole.between(*limits))

    def unit(self, column: str) -> str:
        """Declared unit of a column; "" where it is dimensionless or not declared."""
        return self.recording.units.get(column, "")

    def meaning(self, coordinate: str) -> str:
        """Declared meaning of a coordinate, "" where there is none."""
        return str(nested(self.recording.manifest, "columns", f"{self.prefix}.{coordinate}").get("meaning") or "")

    @property
    def passive(self) -> tuple[str, ...]:
        """Coordinates of the rig that no virtual one stands for."""
        return tuple((self.recording.manifest.get("passive") or {}).get("coordinates") or ())

    @property
    def sum_ends(self) -> tuple[float, float]:
        """Peak of the sum over the first periods of the record, and over its last ones; NaN where there is no sum."""
        if self.sum_peak is None:
            return math.nan, math.nan
        head, _ = ends(self.tau, self.period)
        return float(self.sum_peak[head].max()), float(self.sum_peak[-1])

    @property
    def is_scaled(self) -> bool:
        """Whether `tau` is another time than that of the plant."""
        return self.time_scale != 1.0

    @property
    def worst(self) -> str | None:
        """Coordinate with the largest chi, None where there is nothing to compare with."""
        return max(self.chi, key=lambda name: self.chi[name]) if self.chi else None


def parameters(recording: Recording) -> tuple[Parameter, ...]:
    """Parameters of the virtual system with the values that ran, which may differ from the declared ones.

    Those that stand for points of its inputs are none of them.
    """
    manifest = recording.manifest
    declared = nested(manifest, "declarations", "virtual", "parameters")
    names = dict.fromkeys([*declared, *nested(manifest, "parameters")])
    of_inputs = internals(nested(manifest, "declarations", "experiment", "inputs"))
    return tuple(_parameter(manifest, name, declared.get(name)) for name in names if name not in of_inputs)


def ends(tau: Array, mean_period: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of the first three periods of the record and of its last twentieth (three periods if that is shorter)."""
    length = tau[-1] - tau[0]
    few = min(3 * mean_period, length / 2)
    return tau <= tau[0] + few, tau >= tau[-1] - max(few, _END * length)


def _use(recording: Recording, name: str, shown: Recording) -> InputUse:
    series = shown[f"input.{name}"]
    declared = nested(recording.manifest, "limits", name)
    limit = abs(float(declared["max"])) if declared.get("max") is not None else None
    peak = float(np.abs(series).max())
    column = nested(recording.manifest, "columns", f"input.{name}")
    unit = str(declared.get("unit") or column.get("unit") or "")
    demanded, power = shown.columns.get(f"demanded.{name}"), shown.columns.get(f"power.{name}")
    squares, saturated, throttled = 0.0, 0, 0
    kinds = ("input",) if demanded is None else ("input", "demanded")
    for chunk in recording.chunks([f"{kind}.{name}" for kind in kinds]):
        applied = chunk[f"input.{name}"]
        squares += float(np.sum(applied**2))
        if demanded is not None:
            cut = np.abs(chunk[f"demanded.{name}"] - applied) > _ROUNDING * max(peak, limit or 0.0)
            at_limit = np.abs(applied) >= (limit or 0.0) * (1.0 - _ROUNDING)
            saturated += int(np.count_nonzero(cut & at_limit))
            throttled += int(np.count_nonzero(cut & ~at_limit))
    most = nested(recording.manifest, "declarations", "plant", "limits", "power").get("value")
    return InputUse(
        name,
        series,
        "" if unit == "1" else unit,
        peak,
        math.sqrt(squares / len(recording)),
        limit,
        peak / limit if limit else None,
        str(column.get("meaning") or ""),
        demanded,
        saturated / len(recording),
        throttled / len(recording),
        None if power is None else float(power.max()),
        None if power is None or most is None else float(most),
    )


def _row(entry: Mapping[str, Any]) -> BudgetRow:
    cause, remedy, note = (str(entry.get(key, "")) for key in ("cause", "remedy", "note"))
    chi, remedied = {name: float(value) for name, value in entry["chi"].items()}, entry.get("remedied")
    return BudgetRow(cause, chi, float(entry["rms"]), remedy, note, None if remedied is None else float(remedied))


def _parameter(manifest: Mapping[str, Any], name: str, entry: Any) -> Parameter:  # noqa: ANN401  # JSON
    given: Mapping[str, Any] = entry if isinstance(entry, Mapping) else {"value": entry}
    unit, declared = str(given.get("unit") or "1"), _value(given.get("value"))
    change = _value(nested(manifest, "declarations", "experiment", "parameters").get(name))
    ran = _value(nested(manifest, "parameters").get(name))
    value, scaled = declared if change is None else change, None
    if isinstance(ran, float):
        if unit == "1":
            value = ran
        elif nested(manifest, "declarations", "virtual", "scales"):
            scaled = ran
        else:
            try:
                value = ran / units.factor_of(unit)
            except MaskingError:  # a record from elsewhere: the unit is not one that we know
                value, unit, declared = ran, f"SI unit of {unit}", None
    changed = isinstance(value, float) and declared is not None
    if changed and isinstance(declared, float):
        changed = not math.isclose(value, declared, rel_tol=_ROUNDING)  # type: ignore[arg-type]  # a float, see above
    elif changed:
        changed = change is not None  # else the value is what the declared expression gave
    return Parameter(name, value, "" if unit == "1" else unit, declared, scaled, changed, str(given.get("meaning", "")))


def _value(value: Any) -> float | str | None:  # noqa: ANN401  # a JSON value
    """Number, text of an expression, or None."""
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        return str(value)


def nested(manifest: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Mapping at a path of the manifest, empty where there is none."""
    node: Any = manifest
    for key in path:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else {}
