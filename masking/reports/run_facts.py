"""Study: what a recording shows, in numbers; the figures draw it and the report words it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import lazy_loader as lazy
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
from masking.declaration.virtual_inputs import internals
from masking.errors import MaskingError, RecordError
from masking.numerics.arrays import Array
from masking.records.recording import Recording
from masking.reports.long_record import deviation, drawn

if TYPE_CHECKING:
    from masking.declaration import units
else:  # only a table of parameters with units needs it
    units = lazy.load("masking.declaration.units", suppress_warning=True)

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
    demanded: Array | None = None
    saturated: float = 0.0
    throttled: float = 0.0
    power: float | None = None
    most_power: float | None = None

    @property
    def is_exceeded(self) -> bool:
        """Tell whether the input went beyond its limit, by more than rounding."""
        return self.used is not None and self.used > 1.0 + _ROUNDING

    @property
    def is_cut(self) -> bool:
        """Tell whether less was applied than demanded."""
        return self.saturated + self.throttled > 0.0

    @property
    def demand(self) -> float:
        """Return the largest magnitude that was demanded."""
        return self.peak if self.demanded is None else float(np.abs(self.demanded).max())


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """The masking error of a further run without one cause: of each coordinate, and their rms.

    `remedy` is what helps on a rig, `note` what must be known to read the row.
    """

    cause: str
    chi: dict[str, float]
    rms: float
    remedy: str
    note: str

    @property
    def title(self) -> str:
        """Say which run it is."""
        titles = {"": "as it is", "sampling": "sampled faster", "all of these": "without all"}
        return titles.get(self.cause, f"without {self.cause}")


@dataclass(frozen=True, slots=True)
class Budget:
    """The error budget: chi of the run as it is, without each cause, and without all; `sentence` sums it up."""

    sentence: str
    whole: BudgetRow
    rows: tuple[BudgetRow, ...]
    without_all: BudgetRow


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


@dataclass(frozen=True, slots=True)
class Study:
    """Everything the figures, the tables and the summary say about one recording.

    `recording` has fewer samples than `whole` where that is on disk: motions are sampled, and inputs keep the least and
    the greatest value of each stretch. `prefix` is "virtual", or "rig" for a record without a virtual system. `chi` is
    the masking error by coordinate, and `errors` the largest distance from the ideal motion.
    `period` is the mean period of the first oscillator that has one (in units of `tau`), else NaN. `sum_peak` is
    the running peak of |sum of the oscillators|. `no_phase` says why there is no phase difference, "" if there is.
    """

    recording: Recording
    whole: Recording
    tau: Array
    prefix: str
    oscillators: tuple[str, ...]
    others: tuple[str, ...]
    chi: dict[str, float]
    errors: dict[str, float]
    period: float
    pairs: tuple[PhasePair, ...]
    sum_peak: Array | None
    anti_phase: AntiPhase | None
    inputs: tuple[InputUse, ...]
    no_phase: str
    budget: Budget | None

    def motion(self, coordinate: str) -> Array:
        """Give the coordinate as it moved, shape (samples,)."""
        return self.recording[f"{self.prefix}.{coordinate}"]

    def ideal(self, coordinate: str) -> Array | None:
        """Give the coordinate of the virtual system by itself, where it was recorded."""
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
        """Give what lies between two times in units of `tau`, with all its samples, for a picture of it."""
        limits = (None if at is None else at * self.time_scale for at in (start, end))
        part = self.whole.between(*limits)
        return replace(self, recording=part, whole=part, tau=part.t / self.time_scale)

    def unit(self, column: str) -> str:
        """Give the declared unit of a column; "" where it is dimensionless or not declared."""
        return self.recording.units.get(column, "")

    def meaning(self, coordinate: str) -> str:
        """Give the declared meaning of a coordinate, "" where there is none."""
        return str(_entry(self.recording.manifest, "columns", f"{self.prefix}.{coordinate}").get("meaning") or "")

    @property
    def passive(self) -> tuple[str, ...]:
        """Coordinates of the rig that no virtual one stands for."""
        return tuple((self.recording.manifest.get("passive") or {}).get("coordinates") or ())

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The oscillators, then the other coordinates."""
        return self.oscillators + self.others

    @property
    def sum_ends(self) -> tuple[float, float]:
        """Peak of the sum over the first periods of the record, and over its last ones; NaN where there is no sum."""
        if self.sum_peak is None:
            return math.nan, math.nan
        head, _ = ends(self.tau, self.period)
        return float(self.sum_peak[head].max()), float(self.sum_peak[-1])

    @property
    def is_scaled(self) -> bool:
        """Tell whether `tau` is another time than that of the plant."""
        return self.time_scale != 1.0

    @property
    def worst(self) -> str | None:
        """Coordinate with the largest chi, None where there is nothing to compare with."""
        return max(self.chi, key=lambda name: self.chi[name]) if self.chi else None


def study(recording: Recording) -> Study:
    """Work out what a recording shows."""
    whole, recording = recording, drawn(recording)
    manifest = recording.manifest
    prefix = "virtual" if recording.coordinates else "rig"
    names = recording.names(prefix)
    oscillators = tuple(str(name) for name in manifest.get("oscillators") or ())
    for name in oscillators:
        recording[f"{prefix}.{name}"]  # a clear error for an oscillator that was not recorded
    others = tuple(name for name in names if name not in oscillators)
    if not oscillators:
        oscillators, others = others, ()

    tau = recording.t / float(manifest.get("time_scale") or 1.0)
    motions = {name: recording[f"{prefix}.{name}"] for name in oscillators}
    periods = [period(tau, motion) for motion in motions.values()]
    mean_period = next((p for p in periods if math.isfinite(p)), math.nan)
    reason = why_no_phase(manifest, motions, recording.array(prefix) if names else np.zeros((1, 1)), periods)
    # The sum is a measure of synchronisation also where the oscillators are too many or too still to have one phase.
    total = sum(motions.values()) if len(motions) > 1 and manifest.get("oscillators") else None
    sums = _error_sums(whole)
    return Study(
        recording=recording,
        whole=whole,
        tau=tau,
        prefix=prefix,
        oscillators=oscillators,
        others=others,
        chi=masking_errors(whole, sums),
        errors={name: one.largest for name, one in sums.items()},
        period=mean_period,
        pairs=() if reason else _pairs(tau, motions, mean_period),
        sum_peak=None
        if reason or total is None
        else running_peak(tau, np.abs(total), SUM_WINDOW_PERIODS * mean_period),
        anti_phase=None if reason else anti_phase_of(tau, motions, whole, prefix),
        inputs=input_uses(whole, recording),
        no_phase=reason,
        budget=_budget(recording),
    )


def input_uses(recording: Recording, shown: Recording | None = None) -> tuple[InputUse, ...]:
    """Tell how much of each input was used; `shown` is what is drawn of the recording, if that is known."""
    shown = shown or drawn(recording)
    return tuple(_use(recording, name, shown) for name in recording.inputs)


def _error_sums(recording: Recording) -> dict[str, ErrorSum]:
    names = recording.coordinates or recording.names("rig")
    sums = {n: ErrorSum() for n in names if {f"ideal.{n}", f"virtual.{n}"} <= recording.columns.keys()}
    for chunk in recording.chunks([f"{kind}.{name}" for name in sums for kind in ("virtual", "ideal")]):
        for name, one in sums.items():
            one.add(chunk[f"virtual.{name}"], chunk[f"ideal.{name}"])
    return sums


def masking_errors(recording: Recording, sums: Mapping[str, ErrorSum] | None = None) -> dict[str, float]:
    """Masking error from the columns; what the run itself stated stands in where the ideal motion was not recorded."""
    stated, sums = recording.manifest.get("masking_error") or {}, sums or _error_sums(recording)
    names = recording.coordinates or recording.names("rig")
    return {n: sums[n].value if n in sums else float(stated[n]) for n in names if n in sums or n in stated}


def parameters(recording: Recording) -> tuple[Parameter, ...]:
    """Give the parameters of the virtual system with the values that ran, which may differ from the declared ones.

    Those that stand for points of its inputs are none of them.
    """
    manifest = recording.manifest
    declared = _entry(manifest, "declarations", "virtual", "parameters")
    names = dict.fromkeys([*declared, *_entry(manifest, "parameters")])
    of_inputs = internals(_entry(manifest, "declarations", "experiment", "inputs"))
    return tuple(_parameter(manifest, name, declared.get(name)) for name in names if name not in of_inputs)


def ends(tau: Array, mean_period: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks of the first three periods of the record and of its last twentieth (three periods if that is shorter)."""
    length = tau[-1] - tau[0]
    few = min(3 * mean_period, length / 2)
    return tau <= tau[0] + few, tau >= tau[-1] - max(few, _END * length)


def why_no_phase(manifest: Mapping[str, Any], motions: Mapping[str, Array], all_: Array, periods: list[float]) -> str:
    """Say why a phase difference cannot be given; "" where it can."""
    if not manifest.get("oscillators"):
        return "the record does not say which coordinates are oscillators"
    if len(motions) < 2:
        return "there is only one oscillator"
    scale = float(np.abs(all_).max())
    for name, motion in motions.items():
        if np.ptp(motion) <= _AT_REST * scale:
            return f"{name} does not move"
    for name, value in zip(motions, periods, strict=True):
        if not math.isfinite(value):
            return f"the record holds fewer than three periods of {name}"
    return ""


def _pairs(tau: Array, motions: Mapping[str, Array], mean_period: float) -> tuple[PhasePair, ...]:
    first, *rest = motions
    head, tail = ends(tau, mean_period)
    pairs = []
    for name in rest:
        series = phase_difference(tau, motions[first], motions[name])
        (start, steady_start), (end, steady_end) = mean_phase(series[head]), mean_phase(series[tail])
        verdict = verdict_of(tau, motions, (first, name), mean_period)
        pairs.append(PhasePair(first, name, series, start, end, steady_start, steady_end, verdict))
    return tuple(pairs)


def verdict_of(
    tau: Array, motions: Mapping[str, Array], names: tuple[str, str], mean_period: float
) -> Synchronisation | None:
    """Say in which way two oscillators are synchronised at the end; None where the record is too short to tell."""
    rows = slice(None, None, max(1, int(mean_period / _ROWS * (len(tau) - 1) / (tau[-1] - tau[0]))))
    try:
        return synchronisation(tau[rows], motions[names[0]][rows], motions[names[1]][rows], names=names)
    except RecordError:
        return None


def anti_phase_of(
    tau: Array, motions: Mapping[str, Array], whole: Recording | None = None, prefix: str = "virtual"
) -> AntiPhase | None:
    """Fit definition 5.3 to the end of two oscillations; None where it does not apply.

    Args:
        tau: times (m,).
        motions: by name (m,).
        whole: the recording that they are of, in which eps is looked for if it is on disk.
        prefix: of their columns.
    """
    if len(motions) != 2:
        return None
    a, b = motions.values()
    try:
        found = anti_phase(tau, a, b)
    except RecordError:  # fewer than three periods in the last fifth: there is nothing to state
        return None
    if whole is None or not whole.is_on_disk or not math.isfinite(found.alpha):
        return found
    first, last = whole.span
    first_name, second_name = (f"{prefix}.{name}" for name in motions)
    scale = float(whole.manifest.get("time_scale") or 1.0)
    eps = deviation(whole, (first_name, second_name), found, last - _LAST * (last - first), scale)
    return replace(found, eps=eps)


def _use(recording: Recording, name: str, shown: Recording) -> InputUse:
    series = shown[f"input.{name}"]
    declared = _entry(recording.manifest, "limits", name)
    limit = abs(float(declared["max"])) if declared.get("max") is not None else None
    peak = float(np.abs(series).max())
    unit = str(declared.get("unit") or _entry(recording.manifest, "columns", f"input.{name}").get("unit") or "")
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
    most = _entry(recording.manifest, "declarations", "plant", "limits", "power").get("value")
    return InputUse(
        name,
        series,
        "" if unit == "1" else unit,
        peak,
        math.sqrt(squares / len(recording)),
        limit,
        peak / limit if limit else None,
        demanded,
        saturated / len(recording),
        throttled / len(recording),
        None if power is None else float(power.max()),
        None if power is None or most is None else float(most),
    )


def _budget(recording: Recording) -> Budget | None:
    content = _entry(recording.manifest, "budget")
    if not content:
        return None
    entries = (content, *content["rows"], content["without_all"])
    whole, *rows, without_all = (
        BudgetRow(
            str(entry.get("cause", "")),
            {name: float(value) for name, value in entry["chi"].items()},
            float(entry["rms"]),
            str(entry.get("remedy", "")),
            str(entry.get("note", "")),
        )
        for entry in entries
    )
    return Budget(str(content["sentence"]), whole, tuple(rows), without_all)


def _parameter(manifest: Mapping[str, Any], name: str, entry: Any) -> Parameter:  # noqa: ANN401  # JSON
    fields: Mapping[str, Any] = entry if isinstance(entry, Mapping) else {"value": entry}
    unit, declared = str(fields.get("unit") or "1"), _value(fields.get("value"))
    change = _value(_entry(manifest, "declarations", "experiment", "parameters").get(name))
    ran = _value(_entry(manifest, "parameters").get(name))
    value, scaled = declared if change is None else change, None
    if isinstance(ran, float):
        if unit == "1":
            value = ran
        elif _entry(manifest, "declarations", "virtual", "scales"):
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
    return Parameter(
        name, value, "" if unit == "1" else unit, declared, scaled, changed, str(fields.get("meaning", ""))
    )


def _value(value: Any) -> float | str | None:  # noqa: ANN401  # a JSON value
    """Give a number, the text of an expression, or None."""
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        return str(value)


def _entry(manifest: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Give the mapping at a path of the manifest, an empty one where there is none."""
    node: Any = manifest
    for key in path:
        node = node.get(key) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else {}
