"""Identification data: commands and readings of a record at one steady rate, refused where they hold no information."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig import channel_units
from masking.control.rig.twin import Twin
from masking.errors import ColumnError, ModelError, RecordError, nearest
from masking.lab.records import clock, column_units, readers, soundness, time_base
from masking.lab.records.noise_estimate import rounding_steps, white_noise
from masking.lab.records.record_form import Hold, InputHold, Names, TextForm
from masking.lab.records.recording import Recording
from masking.lab.records.soundness import Signals
from masking.lab.records.time_base import Resampling

NOT_LATE = np.zeros(())
_STILL = 4.0  # deviations of the noise: readings that vary by less do not move
_LITTLE = 0.01  # of a range
_LOUD = 1.1  # times their noise: readings that vary by more hold something else
_FEW = 1000  # readings: among fewer, motion may look like white noise
_SURELY = 6.0  # deviations of a correlation by chance: none of a million is as large
_LINES = (1.0 / 12.0, 1.0 / 90.0, 1.0 / 560.0)  # (asin(x/2)/(x/2))**2 = 1 + x**2/12 + x**4/90 + x**6/560 + ...


def is_first_order(hold: str) -> bool:
    """Whether inputs go in straight lines between samples (first-order hold); a ModelError where `hold` is neither."""
    if hold not in get_args(Hold):
        raise ModelError(_refusal(hold))
    return hold == "first-order"


def _hold(twin: Twin, hold: InputHold | None) -> InputHold:
    """Hold of the inputs of a record, by default that of the plant; a ModelError where it is not known."""
    if hold is not None and hold not in get_args(InputHold):
        raise ModelError(_refusal(hold))
    return hold or ("first-order" if twin.measured_actuators else "zero-order")


def _refusal(hold: str) -> str:
    return (
        f"hold is '{hold}': give 'zero-order' for commands that act until the next sample, 'first-order' for measured "
        "inputs, which go in straight lines between samples, or for a whole record 'band-limited' for inputs that "
        "were measured behind an anti-alias filter"
    )


@dataclass(frozen=True)
class Data:
    """Commands and readings of one record; a ModelError where `hold` is neither 'zero-order' nor 'first-order'.

    Source: Pintelon and Schoukens, System Identification (2012), section 13.2.
    """

    name: str  # of the record, for messages
    rate: float  # samples per second
    commands: Array  # of the actuators, in their units (m, actuators)
    readings: Array  # of the sensors, in their units (m, sensors)
    # samples after which a command of each actuator acts (actuators,), or one number for all
    late: Array = field(default_factory=lambda: NOT_LATE)
    # 'zero-order': each command acts until the next, as the output of a converter does. 'first-order': inputs go in
    # straight lines between samples, for inputs that were measured, not commanded. `band_limited` makes such lines of
    # inputs that were filtered before they were sampled
    hold: Hold = "zero-order"
    notes: tuple[str, ...] = ()  # how it was read, and what in it is doubtful
    # of each channel and of the clock `t`: its column in the file, and the unit that this or a map says, "" for none
    sources: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        is_first_order(self.hold)
        object.__setattr__(self, "commands", np.ascontiguousarray(self.commands, dtype=float))
        object.__setattr__(self, "late", np.full(self.commands.shape[1], self.late, dtype=float))

    @classmethod
    def of(cls, recording: Recording, twin: Twin, name: str = "the record", hold: InputHold | None = None) -> Data:
        """Data of a plant's actuators and sensors in a recording.

        An actuator V1 is read from the column `input.V1`, or else `V1`; a sensor s1 from `sensor.s1`, or else `s1`.
        Commands with a zero-order hold act after the delay of the plant; measured inputs act when they are measured.

        Args:
            recording: the columns.
            twin: the plant.
            name: of the record, for messages.
            hold: of the inputs between samples; by default 'first-order' for inputs that elements of the model follow,
                and 'zero-order' for all others.

        Raises:
            ModelError: `hold` is not known.
            RecordError: a column is missing or not finite, time is not steady, nothing moves, or it is too short.
        """
        hold = _hold(twin, hold)
        sources = {"t": _source(recording, "t")}
        commands = _columns(recording, "input", twin, name, sources)
        readings = _columns(recording, "sensor", twin, name, sources)
        turns = turns_of(twin)
        for sensor, values in zip(twin.sensors, readings.T, strict=True):
            values[:] = time_base.going_on(values, turns.get(sensor, 0.0))
        rate = clock.rate(np.asarray(recording.t, dtype=float), name)
        signals = Signals(
            name,
            recording.t,
            dict(zip(twin.actuators, commands.T, strict=True)),
            dict(zip(twin.sensors, readings.T, strict=True)),
            {sensor: declared.unit for sensor, declared in twin.declaration.sensors.items()},
            turns,
        )
        notes = (*recording.notes, *soundness.doubts(signals))
        if hold == "zero-order":
            found = cls(name, rate, commands, readings, twin.late(rate), notes=notes, sources=sources)
        else:
            found = cls(name, rate, commands, readings, hold="first-order", notes=notes, sources=sources)
        found.check(twin)
        return found.band_limited() if hold == "band-limited" else found

    @classmethod
    def read(
        cls,
        path: str | Path,
        twin: Twin,
        hold: InputHold | None = None,
        columns: Names | None = None,
        dt: float | None = None,
        *,
        form: TextForm = TextForm(),  # noqa: B008  (frozen)
        resample: float | str | None = None,
    ) -> Data:
        """Read what a file, or a part of one, holds of a plant's actuators and sensors; see `readers.read` and `of`.

        Args:
            path: of the record, such as `record.csv` or `record.csv@10:20`.
            twin: the plant.
            hold: of the inputs between samples, as for `of`.
            columns: of the file, by the names that they get.
            dt: time between samples in s, for a file without a clock.
            form: the lines above the numbers of a text, and its encoding.
            resample: samples per second, or text as "200 Hz", for channels on several clocks or one that is uneven.

        Raises:
            ModelError: `hold` is not known.
            RecordError: the record cannot be read, or has no information about the plant.
        """
        held = twin.actuators if _hold(twin, hold) == "zero-order" else ()
        turns = turns_of(twin)
        resampling = Resampling.of(
            resample,
            {one for name in held for one in (name, f"input.{name}")},
            {one: turn for name, turn in turns.items() for one in (name, f"sensor.{name}")},
        )
        wanted = (*twin.actuators, *twin.sensors)
        read = readers.read(path, columns, dt, wanted, form, resampling=resampling)
        return cls.of(read, twin, str(path), hold)

    def check(self, twin: Twin) -> None:
        """Refuse, by a RecordError, one that is not finite or moves nothing, with readings constant or noise alone."""
        for names, table in ((twin.actuators, self.commands), (twin.sensors, self.readings)):
            for column, values in zip(names, table.T, strict=True):
                wrong = np.flatnonzero(~np.isfinite(values))
                if len(wrong):
                    raise RecordError(
                        f"{self.name}: {column} is {values[wrong[0]]} at sample {wrong[0]}, and not finite at "
                        f"{len(wrong)} samples in all; cut these out, and give the parts as records of their own"
                    )
        if not self.moves or not (np.ptp(self.commands, axis=0).any() or self.answers):
            raise RecordError(
                f"{self.name}: nothing moves: the commands are constant, and the readings vary no more than their "
                "noise; excite the rig, or let it go from somewhere else than rest"
            )
        if not np.ptp(self.readings, axis=0).any():
            self.refuse_constant(twin)
        if not self.answers:
            raise RecordError(
                f"{self.name}: the commands change, but the readings are white noise, which follows none of them; "
                "check the cables, columns and gains, or excite the rig more strongly"
            )

    def refuse_constant(self, twin: Twin) -> None:
        """Refuse a record with a constant reading, by a RecordError."""
        for name, values in zip(twin.sensors, self.readings.T, strict=True):
            if not np.ptp(values):
                raise RecordError(
                    f"{self.name}: {name} reads {values[0]:g} throughout; check its cable and column, give a record "
                    "that moves it, or leave it out of the plant"
                )

    def under(self, twin: Twin) -> Data:
        """Record with the dead times of a twin, where its commands are held; measured inputs have none."""
        return replace(self, late=twin.late(self.rate)) if self.hold == "zero-order" else self

    @property
    def moves(self) -> bool:
        """Whether a command changes, or the readings vary by more than their noise."""
        far = 2.0 * _STILL * np.maximum(self.noise, 1e-300)
        return bool(np.ptp(self.commands, axis=0).any() or np.any(np.ptp(self.readings, axis=0) > far))

    @property
    def answers(self) -> bool:
        """Whether a reading is more than white noise, or follows a command or its square; a short one does."""
        if len(self) < _FEW or (self.readings.std(axis=0) > _LOUD * self.noise).any():
            return True
        commands = self.commands - self.commands.mean(axis=0)
        tables = np.hstack([commands, commands**2]), self.readings
        spectra = [np.fft.rfft(table - table.mean(axis=0), axis=0) for table in tables]
        power = [np.maximum((np.abs(spectrum) ** 2).sum(axis=0), 1e-300) for spectrum in spectra]
        cross = np.fft.irfft(spectra[0][:, :, None].conj() * spectra[1][:, None, :], len(self), axis=0)
        size = np.sqrt(np.outer(*power)) * 2.0 / len(self)  # correlations of white noise have variance 1/len
        return bool((np.abs(cross) > _SURELY / np.sqrt(len(self)) * size).any())

    def until_rest(self) -> Data:
        """Record up to where it comes to rest; all of it where it moves to its end.

        At rest, readings stay within noise or a few steps of their converter, and commands within a hundredth of their
        range, as those of a loop that holds a position.
        """
        last = slice(-math.ceil(len(self) / 10), None)
        far = np.maximum(2.0 * _STILL * self.noise, _STILL * rounding_steps(self.readings))
        moves = (np.abs(self.readings - np.median(self.readings[last], axis=0)) > far).any(axis=1)
        held = np.abs(self.commands - np.median(self.commands[last], axis=0))
        moves = np.asarray(moves | (held > _LITTLE * np.ptp(self.commands, axis=0)).any(axis=1))
        return self.first((np.flatnonzero(moves)[-1] + 1) / self.rate) if moves.any() else self

    @property
    def noise(self) -> Array:
        """Standard deviation of white noise in each reading (sensors,)."""
        return white_noise(self.readings)

    @property
    def acting(self) -> Array:
        """Commands that act at each sample (m, actuators); the first acts before the record, too.

        Held commands that act between samples are means over a sample.
        """
        if not self.late.any():
            return self.commands
        at = np.arange(len(self))[:, None] - self.late
        low = np.floor(at).astype(int)
        before, after = (np.take_along_axis(self.commands, np.clip(low + i, 0, len(self) - 1), 0) for i in (0, 1))
        return np.asarray(before + (at - low) * (after - before))

    def counted(self, late: Array = NOT_LATE) -> Array:
        """Readings (m, sensors), not a number where they come from commands before the record.

        Commands are later by `late` samples (actuators,) than those of the record.
        """
        counted = np.array(self.readings, dtype=float, order="C")
        counted[: math.ceil((self.late + late).max(initial=0.0))] = np.nan
        return counted

    def residuals(self, simulated: Array, late: Array = NOT_LATE) -> Array:
        """Measured less simulated (m, sensors), 0 for readings that are not counted."""
        left = self.counted(late) - simulated
        return np.where(np.isnan(left), 0.0, left)

    def __len__(self) -> int:
        return len(self.readings)

    def first(self, seconds: float) -> Data:
        """First part of the record."""
        count = round(seconds * self.rate)
        return replace(self, commands=self.commands[:count], readings=self.readings[:count])

    def first_order(self) -> Data:
        """Record with inputs that go in straight lines between samples, and act when they are measured."""
        return replace(self, hold="first-order", late=NOT_LATE)

    def band_limited(self) -> Data:
        """Record with a first-order hold that acts as band-limited inputs through its samples would.

        Straight lines between samples of a sine of frequency f weaken it by (sin(pi f/rate)/(pi f/rate))^2. Inputs that
        were filtered before they were sampled have nothing above half the rate: what they lose is given back by their
        differences of order 2, 4 and 6, within 1e-5 below a tenth of the rate and within 1 % below a quarter of it.
        Source: Pintelon and Schoukens, System Identification (2012), section 13.2, for band-limited inputs; Gradshteyn
        and Ryzhik, Table of Integrals, Series, and Products (2007), 1.645.2, for the series.
        """
        order = len(_LINES)
        differences = np.concatenate([self.commands[:1]] * order + [self.commands] + [self.commands[-1:]] * order)
        whole = self.commands.copy()
        for number, part in enumerate(_LINES, 1):
            differences = -np.diff(differences, n=2, axis=0)
            whole += part * differences[order - number : len(differences) - (order - number)]
        return replace(self, commands=whole, hold="first-order")

    def windows(self, seconds: float) -> list[Data]:
        """Record in pieces of about a given length, each long enough to be simulated by itself.

        The first has all readings that come from commands before the record.
        """
        count, unknown = max(1, round(len(self) / (seconds * self.rate))), math.ceil(self.late.max(initial=0.0))
        bounds = [0, *(end for i in range(1, count + 1) if (end := len(self) * i // count) > unknown or i == count)]
        return [self.part(a, b) for a, b in itertools.pairwise(bounds)]

    def part(self, begin: int, end: int) -> Data:
        """Samples from `begin` to before `end`, with the commands that act then.

        At the beginning of the record these are not known, and the readings that they make do not count.
        """
        whole = np.floor(self.late)
        if begin < whole.max(initial=0.0):
            return replace(self, commands=self.commands[begin:end], readings=self.readings[begin:end])
        acting = replace(self, late=whole).acting[begin:end]
        return replace(self, commands=acting, readings=self.readings[begin:end], late=self.late - whole)


def turns_of(twin: Twin) -> dict[str, float]:
    """Turns of the sensors of a plant whose readings wrap, by their names, in their units."""
    every = twin.declaration.sensors.items()
    return {n: s.wraps.value * twin.size(s.wraps.unit) / twin.size(s.unit) for n, s in every if s.wraps}


def _source(recording: Recording, column: str) -> tuple[str, str]:
    """Name of a column of a recording in its file, and the unit that is said of it, "" for none."""
    entry = (recording.manifest.get("columns") or {}).get(column) or {}
    return str(entry.get("column") or column), str(entry.get("unit") or "")


def _columns(recording: Recording, prefix: str, twin: Twin, where: str, sources: dict[str, tuple[str, str]]) -> Array:
    """Columns of the actuators or sensors of a plant in a recording, in the units that it declares (m, channels).

    Where they come from is added to the sources.
    """
    found = []
    names = twin.actuators if prefix == "input" else twin.sensors
    for name in names:
        column = next((c for c in (f"{prefix}.{name}", name) if c in recording.columns), None)
        if column is None:
            raise ColumnError(
                f"{where}: there is no column {prefix}.{name} or {name}; {nearest(name, list(recording.columns))}"
            )
        own, unit = sources[name] = _source(recording, column)
        hint = "" if own in {name, column} else column_units.hinted(own)
        try:
            found.append(recording[column] * channel_units.factor(twin, name, own, unit, hint))
        except RecordError as error:
            raise RecordError(f"{where}: {error}") from None
    return np.ascontiguousarray(np.array(found, dtype=float).reshape(len(names), len(recording.t)).T)
