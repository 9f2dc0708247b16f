"""Measurement: a procedure on records, as numbers with their uncertainty: springs, actuators, friction.

Each function takes records as `Source` has them, chooses columns, does what its procedure does, and gives a
`Measurement`. Frequency responses are in `responses`.
Source: Rijlaarsdam (2008), section 4.2.3, Table B.4, appendices C.5 and C.6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
from scipy import special

from masking.analysis.synchronisation import period
from masking.compile.numerics.arrays import Array
from masking.display.printed_result import Printed
from masking.errors import RecordError
from masking.inference.procedures import friction as friction_procedure
from masking.inference.procedures.actuator_ratio import ActuatorRatio, actuator_ratio
from masking.inference.procedures.channel_names import Channel, Source, columns, refuse_not_positive
from masking.inference.procedures.friction import EquilibriumShift, LocatedFriction
from masking.inference.procedures.springs import SpringCurve, spring_curve
from masking.model.declaration.quantities import percent, quantity, with_deviation

FoundT = TypeVar("FoundT")

PLAIN = "displacement is in the unit of the sensor's reading; name the plant (--plant) for what the sensor measures"
LEVEL = 0.95  # of the intervals in sentences and figures
NO_SINE = 0.1  # of a command: it is a sine of swept gain where the other command leaves less unexplained
CURVE_POINTS = 200


@dataclass(frozen=True)
class Row:
    """One number: what it is, its value, its standard deviation (None where there is none) and its unit."""

    key: str
    label: str
    value: float
    std: float | None = None
    unit: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Number as JSON can hold it."""
        return {"value": _plain(self.value), "std": _plain(self.std), "unit": self.unit, "meaning": self.label}


@dataclass(frozen=True, repr=False)
class Measurement(Printed, Generic[FoundT]):
    """What a procedure found."""

    procedure: str  # its name, such as springs
    records: tuple[str, ...]  # that it was found from
    channels: Mapping[str, Channel]  # the columns that were used, by what they stand for
    found: FoundT  # what the procedure returned
    sentence: str  # the finding
    rows: tuple[Row, ...]  # the numbers
    # what is drawn, by name: equally long lists are columns of one table
    series: Mapping[str, Sequence[float] | Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what must be known to trust the numbers

    def as_dict(self) -> dict[str, Any]:
        """Measurement as JSON can hold it."""
        return {
            "procedure": self.procedure,
            "records": list(self.records),
            "columns": {what: {"column": c.column, "unit": c.unit} for what, c in self.channels.items()},
            "summary": self.sentence,
            "values": {row.key: row.as_dict() for row in self.rows},
            "series": {name: [_plain(float(x)) for x in values] for name, values in self.series.items()},
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        return "\n".join([self.sentence, *(f"note: {note}" for note in self.notes)])


@dataclass(frozen=True)
class Friction:
    """What saw-teeth and ramps show of friction; None for what the records do not tell."""

    shift: EquilibriumShift | None
    place: LocatedFriction | None


def springs(
    source: Source,
    *,
    input: str | None = None,
    sensor: str | None = None,
    order: int = 5,
    settle: float = 2.0,
    scale: float | None = None,
    force_scale: float | None = None,
) -> Measurement[SpringCurve]:
    """Measure the curve of a spring from a slow ramp of force, as Table B.4 has it.

    Args:
        source: the record of a ramp such as 0, +A, -A, 0.
        input: that pushes; the only one that moves by default.
        sensor: that shows the displacement of the spring; the only one by default.
        order: of the polynomial.
        settle: time at the start that is left out, s.
        scale: unit of displacement of the coefficients; by default the length of the plant's model, 1 without a plant.
        force_scale: unit of force of the coefficients; by default that of the plant's model, 1 without a plant.

    Raises:
        RecordError: a column is absent or not named, or the record is no slow ramp; see `spring_curve`.
        ModelError: a setting makes no sense.
    """
    force, x = source.one("input", input), source.displacement(sensor)
    curve = spring_curve(
        source.times, x.values, force.values, order=order, settle=settle,
        scale=source.scale(x.unit) if scale is None else scale,
        force_scale=source.scale(force.unit) if force_scale is None else force_scale,
    )  # fmt: skip
    at = 0.0 if curve.lowest < 0.0 < curve.highest else 0.5 * (curve.lowest + curve.highest)
    stiffness, sure = float(curve.stiffness(at)), stiffness_deviation(curve, at)
    slope = per(force.unit, x.unit)
    rows = [Row("stiffness", f"stiffness at {quantity(at, x.unit)}", stiffness, sure, slope)]
    rows += [
        Row(f"rho{j}", f"rho {j}, of (x / scale)^{j}", float(value), float(std))
        for j, (value, std) in enumerate(zip(curve.coefficients, np.sqrt(np.diag(curve.covariance)), strict=True))
    ]
    rows += [
        Row("scale", "unit of x of the coefficients", curve.scale, None, x.unit),
        Row("force_scale", "unit of force of the coefficients", curve.force_scale, None, force.unit),
        Row("half_gap", "half the gap between the ways up and down", curve.half_gap, None, force.unit),
        Row("friction", "part of it that is there as soon as the motion turns", curve.friction, None, force.unit),
        Row("hysteresis", "part of it that builds up after the turn", curve.hysteresis, None, force.unit),
        Row("width", "displacement between the ways at one force", curve.width, None, x.unit),
        Row("lowest", "least displacement", curve.lowest, None, x.unit),
        Row("highest", "largest displacement", curve.highest, None, x.unit),
        Row("residual", "force that is not explained, rms", curve.residual, None, force.unit),
    ]
    half = float(special.stdtrit(curve.freedom, 0.5 + LEVEL / 2.0)) * sure
    sentence = (
        f"The spring of {x.name} has a stiffness of {with_deviation(stiffness, half, slope)} at {quantity(at, x.unit)};"
        f" friction and hysteresis hold {quantity(curve.half_gap, force.unit)} against the motion"
    )
    grid = np.linspace(curve.lowest, curve.highest, CURVE_POINTS)
    series = {"displacement": grid, "force": curve.at(grid), "band": curve.band(grid, LEVEL)}
    notes = () if source.twin is not None else (PLAIN,)
    channels = {"force": force, "displacement": x}
    return Measurement("springs", (source.name,), channels, curve, sentence, tuple(rows), series, notes)


def stiffness_deviation(curve: SpringCurve, at: float) -> float:
    """Standard deviation of the stiffness at a displacement."""
    x, order = at / curve.scale, len(curve.coefficients) - 1
    row = np.array([0.0, *(j * x ** (j - 1) for j in range(1, order + 1))])
    return float(np.sqrt(max(row @ curve.covariance @ row, 0.0)) * curve.force_scale / curve.scale)


def actuators(
    source: Source,
    *,
    first: str | None = None,
    second: str | None = None,
    sensor: str | None = None,
    frequency: float | None = None,
    span: float = 0.3,
) -> Measurement[ActuatorRatio]:
    """Measure the gain at which two actuators in anti-phase leave no motion.

    The oscillator must be held, as it was in C.5: on a free rig its spring carries a part of its actuator's force to
    the beam, and the balance is another.

    Args:
        source: the record, with the gain swept slowly up and down through the balance.
        first: input that has the sine of constant size; by default the one of two whose size changes less.
        second: input that has the sine with the swept gain.
        sensor: that shows the motion of what both push; the only one by default.
        frequency: of the sine, Hz; by default that of the first input.
        span: readings with gains so near the balance are used.

    Raises:
        RecordError: a column is absent or not named, or the record does not show the balance; see `actuator_ratio`.
        ModelError: a setting makes no sense.
    """
    constant, swept = _pair(source, first, second)
    motion = source.displacement(sensor)
    times, a, b, _ = columns(times=source.times, first=constant.values, second=swept.values, motion=motion.values)
    f = 1.0 / period(times, a) if frequency is None else frequency
    gain = _gain(source.name, times, a, b, f)
    sign = 1.0 if np.median(gain) >= 0.0 else -1.0
    found = actuator_ratio(times, motion.values, sign * gain, frequency=f, span=span)
    low, high = found.interval(LEVEL)
    rows = (
        Row("ratio", f"{swept.name} per {constant.name} that leaves no motion", found.ratio, found.deviation),
        Row("sign", f"sign of {swept.name} against {constant.name}", sign),
        Row("frequency", "frequency of the sines", f, None, "Hz"),
        Row("residual", "amplitude that is left at the balance", found.residual, None, motion.unit),
        Row("readings", "readings near the balance, which the ratio rests on", float(found.used.sum())),
    )
    half = 0.5 * (high - low)
    weaker = found.ratio > 1.0
    much = f"{percent(found.ratio - 1.0)} weaker" if weaker else f"{percent(1.0 / found.ratio - 1.0)} stronger"
    sentence = (
        f"{swept.name} balances {constant.name} at a gain of {with_deviation(found.ratio, half, '')}: it is {much}"
    )
    series = {"gain": found.gains, "motion": np.abs(found.motion), "fitted": np.abs(found.fitted)}
    return Measurement(
        "actuators", (source.name,), {"first": constant, "second": swept, "motion": motion}, found, sentence, rows,
        series, ("the ratio is that of the actuators only if the oscillator was held: a free one shifts the balance",),
    )  # fmt: skip


def friction(
    *sources: Source, input: str | None = None, sensor: str | None = None, bins: int = 100
) -> Measurement[Friction]:
    """Measure how far friction shifts the equilibrium, and where over the displacement a friction element engages.

    The shift is taken from the first record that has saw-teeth; the place from the record that goes farthest.

    Args:
        sources: one or more records of saw-teeth of growing amplitude, of slow ramps, or of both.
        input: that pushes; the only one that moves by default.
        sensor: that shows the displacement; the only one by default.
        bins: over the travel, in which the gap between the ways up and down is taken.

    Raises:
        RecordError: a column is absent or not named, a record is too fast, or none shows anything; see
            `spring_curve`, `shift_of_equilibrium` and `locate_friction`.
        ModelError: a setting makes no sense.
    """
    if not sources:
        raise RecordError("give at least one record of saw-teeth or of a ramp")
    pairs = [(source, source.one("input", input), source.displacement(sensor)) for source in sources]
    for _, force, x in pairs[1:]:
        if (force.unit, x.unit) != (pairs[0][1].unit, pairs[0][2].unit):
            raise RecordError("the records have columns of different units; give records of one sensor and one input")
    for source, force, x in pairs:
        _refuse_fast(source, force, x)
    shift, place, notes, refused = None, None, [], []
    for source, force, x in pairs:
        try:
            shift = friction_procedure.shift_of_equilibrium(source.times, x.values, force.values)
            break
        except RecordError as error:
            refused.append(f"no shift of the equilibrium from {source.name}: {error}")
    farthest, pushed, moved = max(pairs, key=lambda pair: float(np.ptp(pair[2].values)))
    try:
        place = friction_procedure.locate_friction(farthest.times, moved.values, pushed.values, bins=bins)
    except RecordError as error:
        if shift is None:
            raise RecordError(f"{farthest.name}: {error}") from None
        notes.append(f"no place of friction from {farthest.name}: {error}")
    _, force, x = pairs[0]
    notes += refused if shift is None else []
    notes += [PLAIN] if sources[0].twin is None else []
    rows, texts, series = list[Row](), list[str](), dict[str, Array]()
    if shift is not None:
        rows, text = _of_shift(shift, force, x)
        texts.append(text)
        series |= {"travel": shift.travel, "shift": shift.shift}
    if place is not None:
        of_place, text = _of_place(place, force, x)
        rows, texts = [*rows, *of_place], [*texts, text]
        series |= {"displacement": place.displacement, "half_gap": place.half_gap, "fitted": place.fitted}
    sentence = "; ".join(texts)
    names = tuple(source.name for source in sources)
    return Measurement(
        "friction", names, {"force": pushed, "displacement": moved}, Friction(shift, place),
        sentence[0].upper() + sentence[1:], tuple(rows), series, tuple(notes),
    )  # fmt: skip


def _refuse_fast(source: Source, force: Channel, x: Channel) -> None:
    """Refuse a record in which inertia or damping would be taken for friction: it must show a spring."""
    try:
        spring_curve(source.times, x.values, force.values, settle=0.0)
    except RecordError as error:
        raise RecordError(f"{source.name}: {error}") from None


def _of_shift(shift: EquilibriumShift, force: Channel, x: Channel) -> tuple[list[Row], str]:
    (constant, growth), far = np.sqrt(np.diag(shift.covariance)), int(np.argmax(shift.travel))
    rows = [
        Row("constant", "shift of the equilibrium that any travel makes", shift.constant, float(constant), x.unit),
        Row("growth", "shift per travel: hysteresis", shift.growth, float(growth)),
        Row("friction", "dry friction that the constant part stands for", shift.friction, shift.friction_deviation,
            force.unit),
        Row("stiffness", "stiffness where the force is zero", shift.stiffness, None, per(force.unit, x.unit)),
        Row("largest_shift", "shift after the longest travel", float(shift.shift[far]), None, x.unit),
    ]  # fmt: skip
    moved, travel = quantity(shift.shift[far], x.unit), quantity(shift.travel[far], x.unit)
    return rows, f"the equilibrium shifts by {moved} after a travel of {travel}"


def _of_place(place: LocatedFriction, force: Channel, x: Channel) -> tuple[list[Row], str]:
    rows = [
        Row("is_found", "1 where a friction element is found, 0 where there is none", float(place.is_found)),
        Row("level", "friction elsewhere", place.level, None, force.unit),
        Row("viscous", "force per speed", place.viscous, None, per(f"{force.unit} s".strip(), x.unit)),
    ]
    if not place.is_found:
        ends = f"{quantity(place.displacement[0], x.unit)} and {quantity(place.displacement[-1], x.unit)}"
        return rows, f"no friction element engages between {ends}"
    rows += [
        Row("edge", "displacement at which it engages", place.edge, place.deviation, x.unit),
        Row("side", "1: beyond it upwards, -1: downwards", float(place.side)),
        Row("width", "over which it engages", place.width, None, x.unit),
        Row("step", "friction that it adds", place.step, place.step_deviation, force.unit),
    ]
    way = "above" if place.side > 0 else "below"
    return rows, f"{quantity(place.step, force.unit)} of friction engage {way} {quantity(place.edge, x.unit)}"


def _pair(source: Source, first: str | None, second: str | None) -> tuple[Channel, Channel]:
    if first is not None and second is not None:
        constant, swept = source.several("input", (first, second))
        return constant, swept
    moving = source.several("input", ())
    known = first or second
    others = tuple(c for c in moving if c.name != known)
    if known is not None and len(others) == 1:
        given = source.one("input", known)
        return (given, others[0]) if first is not None else (others[0], given)
    if known is not None or len(moving) != 2:
        raise RecordError(
            f"{source.name}: it has {len(moving)} inputs that move: {', '.join(c.name for c in moving)}; say which has "
            "the sine of constant size and which the swept gain, such as --first V3 --second V1"
        )
    constant, swept = sorted(moving, key=lambda c: _spread(c.values))
    return constant, swept


def _spread(values: Array) -> float:
    """How much the size of an oscillating column changes: the deviation of its rms over stretches, relative."""
    sizes = np.array([np.sqrt(np.mean(part**2)) for part in np.array_split(values - values.mean(), 12)])
    return float(sizes.std() / max(sizes.mean(), 1e-300))


def _gain(name: str, times: Array, a: Array, b: Array, frequency: float) -> Array:
    """G (samples,) of b = g a, where g is a straight line over each period; refuse what is no such pair."""
    refuse_not_positive(frequency=frequency)
    period = max(round(len(times) / max(float(times[-1] - times[0]) * frequency, 1.0)), 2)
    count = len(times) // period
    centres, levels, left = np.empty(count), np.empty(count), 0.0
    for i, part in enumerate(np.array_split(np.arange(len(times)), count)):
        t = times[part] - times[part].mean()
        rows = np.column_stack([a[part], t * a[part]])
        found, *_ = np.linalg.lstsq(rows, b[part], rcond=None)
        centres[i], levels[i] = times[part].mean(), found[0]
        left += float(np.sum((b[part] - rows @ found) ** 2))
    if left > NO_SINE**2 * float(np.sum(b**2)):
        raise RecordError(
            f"{name}: the second input is not the first with a gain that changes slowly: "
            f"{100 * np.sqrt(left / float(np.sum(b**2))):.0f} % of it is something else; give the two inputs that had "
            "the same sine, one of them with a swept gain (masking.lab.signals.opposed_sines makes them)"
        )
    return np.asarray(np.interp(times, centres, levels))


def per(above: str, below: str) -> str:
    """Unit of a ratio."""
    return f"{above or '1'}/{below}" if below else above


def _plain(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
