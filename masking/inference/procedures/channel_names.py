"""Names of channels: the columns of a record that a procedure is about, their units, and what they must be like.

A record has commands as `input.<name>` and readings as `sensor.<name>`, or plain columns with these names. With a
plant, readings become what the sensor measures, such as a displacement; without one they stay in its own unit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import ModelError, RecordError, nearest
from masking.lab.records import clock
from masking.lab.records.recording import Recording
from masking.model.declaration import units
from masking.model.modelling.scales import Units

STILL = 1e-12  # of its largest value: a command that changes by less does not move
OPTIONS = {"input": "--input", "sensor": "--sensor"}  # of the command line, by which a channel of each kind is named
LEAST_SAMPLES = 200  # that are needed
TURNED, SWEPT = 0.02, 0.05  # of its range: a force turns where it comes back by this, in saw-teeth and in ramps
NOISE_FACTOR = 8.0  # standard deviations of its noise, which makes no turns: they are larger
COVERED = 0.85  # of the travel, which both directions must cover


@dataclass(frozen=True)
class Channel:
    """One column of a record, such as `input.V1` of the input V1.

    The unit of its values (samples,) is "" if neither the record nor the plant declares it.
    """

    name: str
    column: str
    unit: str
    values: Array

    @property
    def label(self) -> str:
        """Column with its unit, such as `input.V1 [V]`."""
        return f"{self.column} [{self.unit}]" if self.unit else self.column


@dataclass(frozen=True)
class Source:
    """A record to measure on: its name for messages, what it holds, and the plant that it is of, if given."""

    name: str
    recording: Recording
    twin: Twin | None = None

    @property
    def times(self) -> Array:
        """Times of the samples, s (samples,)."""
        return np.asarray(self.recording.t, dtype=np.float64)

    def rate(self) -> float:
        """Samples per second; a RecordError where the clock is not steady."""
        return clock.rate(self.times, self.name)

    def choices(self, kind: str) -> tuple[str, ...]:
        """Names of a kind, input or sensor: those with its prefix, or every column where there is none."""
        plain = (c for c in self.recording.columns if c != "t" and not c.startswith(("input.", "sensor.")))
        return self.recording.names(kind) or tuple(plain)

    def one(self, kind: str, wanted: str | None) -> Channel:
        """Channel of a kind that is named, or the only one there is; of inputs, the only one that moves.

        Raises:
            RecordError: there is no such channel, or none is named where there are several; names the choices.
        """
        names = self._moving(kind) if wanted is None else [wanted]
        if len(names) != 1:
            what = f"{len(names)} inputs that move" if kind == "input" else f"{len(names)} sensors"
            raise RecordError(
                f"{self.name}: it has {what}: {', '.join(names)}; say which one is meant, such as "
                f"{OPTIONS[kind]} {names[0]}"
            )
        return self._channel(kind, names[0])

    def several(self, kind: str, wanted: Sequence[str]) -> tuple[Channel, ...]:
        """Channels of a kind that are named; all where none is, of inputs all that move.

        Raises:
            RecordError: there is no such channel, or one is named twice.
        """
        twice = sorted({name for name in wanted if list(wanted).count(name) > 1})
        if twice:
            raise RecordError(f"the {kind} {twice[0]} is named twice; give each once")
        return tuple(self._channel(kind, name) for name in wanted or self._moving(kind))

    def displacement(self, wanted: str | None) -> Channel:
        """Displacement that a sensor measures if the plant is given, as `measured`; otherwise its reading."""
        return self.measured(self.one("sensor", wanted))

    def measured(self, reading: Channel) -> Channel:
        """What a sensor measures: its reading over its gain, if the plant is given; a RecordError if that lacks it.

        A coordinate, its rate or a state is in the unit that the model declares, all else in SI units.
        """
        if self.twin is None:
            return reading
        sensors = self.twin.declaration.sensors
        if reading.name not in sensors:
            remedy = nearest(reading.name, sensors)
            raise RecordError(
                f"{self.name}: {self.twin.declaration.name} has no sensor '{reading.name}' ({remedy}); give the plant "
                "that was recorded, or none to stay in the unit of the reading"
            )
        sensor = sensors[reading.name]
        gain = sensor.gain.value * units.factor_of(sensor.gain.unit) / units.factor_of(sensor.unit)
        pairs = zip(units.dimension_of(sensor.unit), units.dimension_of(sensor.gain.unit), strict=True)
        dimension = tuple(a - b for a, b in pairs)
        known = self.twin.model.shown.get(sensor.measures.text.strip())
        is_known = known is not None and units.dimension_of(known.unit) == dimension
        unit, size = known if known is not None and is_known else (units.describe(dimension), 1.0)
        return Channel(reading.name, reading.column, "" if unit == "1" else unit, reading.values / gain / size)

    def scale(self, unit: str) -> float:
        """Size of 1 in the scales of the plant's model, in a unit, such as 5e-3 for m; 1 without any scale."""
        if self.twin is None or not unit:
            return 1.0
        overrides = {n: v for n, v in self.twin.declaration.parameters.items() if n in self.twin.base.parameters}
        return Units.of(self.twin.base).size(unit, overrides) / units.factor_of(unit)

    def _moving(self, kind: str) -> list[str]:
        """Names to choose from: of inputs those that are not constant."""
        names = self.choices(kind)
        if kind == "input":
            columns = {n: np.asarray(self.recording[self._column(kind, n)]) for n in names}
            names = tuple(n for n, x in columns.items() if np.ptp(x) > STILL * np.abs(x).max())
        if not names:
            listed = ", ".join(c for c in self.recording.columns if c != "t") or "none but t"
            what = "no input that moves" if kind == "input" else "no column of a sensor"
            raise RecordError(f"{self.name}: it has {what}; its columns are {listed}")
        return list(names)

    def _column(self, kind: str, name: str) -> str:
        return next((c for c in (f"{kind}.{name}", name) if c in self.recording.columns), "")

    def _channel(self, kind: str, name: str) -> Channel:
        column = self._column(kind, name)
        if not column:
            choices = self.choices(kind)
            raise RecordError(
                f"{self.name}: there is no {kind} '{name}'; its {kind}s are {', '.join(choices) or 'none'}; "
                f"{nearest(name, choices)}"
            )
        columns = self.recording.manifest.get("columns")
        entry = columns.get(column) if isinstance(columns, dict) else None
        unit = str(entry.get("unit", "")) if isinstance(entry, dict) else ""
        if not unit and self.twin is not None:
            plant = self.twin.declaration
            ports = {"input": plant.actuators or self.twin.base.inputs, "sensor": plant.sensors}[kind]
            unit = ports[column.split(".")[-1]].unit if column.split(".")[-1] in ports else ""
        return Channel(
            name.removeprefix(f"{kind}."), column, "" if unit == "1" else unit,
            np.asarray(self.recording[column], dtype=np.float64),
        )  # fmt: skip


def columns(**values: ArrayLike) -> tuple[Array, ...]:
    """Columns (samples,), first a clock in equal steps; a RecordError for short, constant or not finite ones."""
    found = {name: np.asarray(value, dtype=np.float64) for name, value in values.items()}
    for name, column in found.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            raise RecordError(
                f"{name} must be finite: sample {bad[0]} (counted from 0) is {column[bad[0]]}, {len(bad)} in all; take "
                "a stretch of the record without them, or record it again"
            )
    times, *others = found
    if len(found[times]) < LEAST_SAMPLES:
        few = f"the record has {len(found[times])} samples, at least {LEAST_SAMPLES} are needed; record it longer"
        raise RecordError(few)
    clock.rate(found[times], "the record")
    for name in others:
        if np.ptp(found[name]) <= 1e-12 * np.abs(found[name]).max():
            raise RecordError(f"{name} is constant at {found[name][0]:.6g}; see that it is connected and excited")
    return tuple(found.values())


def probability(level: float) -> float:
    """Level of confidence; a ModelError where it is not between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise ModelError(f"the level is {level:g}; give a probability between 0 and 1, such as 0.95")
    return float(level)


def refuse_not_positive(**values: float) -> None:
    """Refuse settings that are not finite and above 0, by a ModelError."""
    for name, value in values.items():
        if not np.isfinite(value) or value <= 0.0:
            raise ModelError(f"{name} is {value!r}; give a finite number above 0")


def turns(values: Array, least: float) -> list[int]:
    """Samples at which a signal turns and comes back by `least`, the first and last sample included."""
    slopes = np.sign(np.diff(values))
    moving = np.flatnonzero(slopes)
    turned = moving[1:][slopes[moving[1:]] != slopes[moving[:-1]]]
    found, up = [0], 0
    for i in (*map(int, turned), len(values) - 1):
        change = values[i] - values[found[-1]]
        if up == 0:
            if abs(change) >= least:
                up = 1 if change > 0 else -1
                found.append(i)
        elif change * up > 0:
            found[-1] = i
        elif abs(change) >= least:
            up = -up
            found.append(i)
    return found


def part_of(force: Array, part: float) -> float:
    """Part of the range of a force, or more where its noise is larger.

    White noise of deviation s has second differences with a median size of 0.6745 sqrt(6) s.
    """
    noise = float(np.median(np.abs(np.diff(force, 2)))) / (0.6745 * np.sqrt(6.0))
    return float(max(part * np.ptp(force), NOISE_FACTOR * noise))


def directions(force: Array) -> Array:
    """1 where a force rises, -1 where it falls, 0 where it turns (samples,)."""
    found = np.zeros(len(force))
    at = turns(force, part_of(force, SWEPT))
    at[-1] = len(force) - 1
    for first, last in itertools.pairwise(at):
        found[first + 1 : last] = np.sign(force[last] - force[first])
    return found


def refuse_one_way(x: Array, direction: Array) -> None:
    """Refuse a record whose ways up and down do not both cover the travel, by a RecordError."""
    edges = np.linspace(x.min(), x.max(), 51)
    covered = [np.histogram(x[direction == sign], edges)[0] > 0 for sign in (1.0, -1.0)]
    part = float(np.mean(covered[0] & covered[1]))
    if part < COVERED:
        raise RecordError(
            f"the force goes both up and down over only {100 * part:.0f} % of the travel, so that friction cannot be "
            "distinguished from the spring; let the ramp go up and down over all of it, such as 0, +A, -A, 0"
        )
