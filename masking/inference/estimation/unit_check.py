"""Unit check: channels and clocks of a record whose unit or sign is probably another than declared.

If the model as declared follows hardly anything of a record, and nearly all of it where a channel is converted from
another usual unit of its dimension, or has the other sign, that is suspected. Nothing is fitted but the initial state.
A clock by which the model would move for periods between samples is suspected where readings and simulation are alike
in ms, us or ns. Units that are said in the file, or in a map, are not doubted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError, RecordError
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.sensitivity import NormalEquations, Sensitivity
from masking.inference.estimation.simulation import guesses, nearest
from masking.lab.records.time_base import CLOCK
from masking.model.declaration.quantities import percent
from masking.model.declaration.units import dimension_of, factor_of

SECOND = "s"
REVERSED = -1.0  # factor of a channel with the other sign
AND = " and "  # between several units
USUAL = (
    *("mm", "cm", "um", "m", "mm/s", "m/s", "km/h", "mm/s**2", "m/s**2", "standard_gravity", "deg", "rad", "deg/s"),
    *("rpm", "rad/s", "N", "kN", "mN", "kgf", "N*m", "N*mm", "V", "mV", "kV", "A", "mA", "Pa", "kPa", "bar"),
)
TIMES = ("ms", "us", "ns")
LOST = 0.5  # error from which a model follows hardly anything: a phase of 29 degrees, 2 sin(phase/2)
# Part of that error that another unit may leave: the least factors between usual units, 1.6 to 3.6, leave 38 % and more
ENOUGH = 0.4
SAMPLES = 2000  # of the record that are simulated
SLOW = 1000  # steps of integration between samples, some periods of the fastest motion, from which a clock is doubted
STEPS = 64  # of integration between samples at most
FINER = (4, 16)  # times as many
FAR = 3.0  # times what is declared, from which a size or a parameter is far off: the least factor between usual units
ALIKE = 0.05  # relative difference of errors or sizes from which two units do the same for a record
MANY = 10.0  # error from which it is not given as a number

# Residuals (m, sensors) of a model as declared, simulated along a record from a fitted initial state; None where its
# motion is not finite.
Residuals = Callable[[Data], Array | None]
# Error and difference in size of such a simulation, see `_compared`.
Compare = Callable[[Data], tuple[float, float]]


@dataclass(frozen=True)
class UnitDoubt:
    """A unit or a sign that is probably another than declared."""

    names: tuple[str, ...]  # the channels; `t` is the clock
    kind: str  # 'sensor', 'actuator' or 'clock'
    unit: str  # what they are probably in, and `declared`: what they are declared in; of several units, each once
    declared: str
    factor: float  # how many declared units one of the other is; -1 where the sign is probably reversed
    # largest error of a sensor, in parts of its spread, with the model as declared, in the declared and the other unit
    error: tuple[float, float] = (np.inf, np.inf)
    alike: tuple[UnitDoubt, ...] = ()  # other channels and units that would do the same
    # gains (effect, place) and parameters (name, '') that are far off in the declared unit, and how many times what is
    # declared they are there
    otherwise: tuple[tuple[tuple[str, str], float], ...] = ()

    @property
    def is_sign(self) -> bool:
        """Whether the sign is probably another than declared, and not the unit."""
        return self.factor < 0.0

    def of_declared(self, unit: str) -> str:
        """Probable unit of the channels that are declared in a unit."""
        return dict(zip(self.declared.split(AND), self.unit.split(AND), strict=True))[unit]

    def of(self, twin: Twin, record: Data) -> Data:
        """Record with the channels in the declared unit."""
        if self.kind == "clock":
            return replace(record, rate=record.rate / self.factor).under(twin)
        every = twin.sensors if self.kind == "sensor" else twin.actuators
        scale = np.where([name in self.names for name in every], self.factor, 1.0)
        if self.kind == "sensor":
            return replace(record, readings=record.readings * scale)
        return replace(record, commands=record.commands * scale)

    def sentences(self, twin: Twin, sources: Mapping[str, tuple[str, str]], outcome: str = "") -> Iterator[str]:
        """What is suspected, with the repair and with what the model leaves; `outcome` ends the last sentence.

        `sources` are those of a record, see `Data`.
        """
        before, after = (percent(part) if part < MANY else "far more than all" for part in self.error)
        looks = "looks as if it" if len(self.names) == 1 else "look as if they"
        instead = "had its sign reversed" if self.is_sign else f"were in {self.unit}, not {self.declared}"
        yield f"{self._quoted} {looks} {instead}: {self._repair(twin, sources)}"
        if self.alike:
            yield f"This record does not tell that from {' or '.join(one._other for one in self.alike)}"
        yield f"The model as declared leaves {before} of the readings, and {after} of them so{outcome}"

    def note(self, twin: Twin, record: Data) -> str:
        """The same as one text."""
        return ". ".join(self.sentences(twin, record.sources))

    def stands(self, declared: Array, fitted: Array, error: float) -> bool:
        """Whether a fit does not settle it: it leaves too much, or values (k,) several times those declared (k,)."""
        known = declared != 0.0
        times = fitted[known] / declared[known]
        return not (((times > 1.0 / FAR) & (times < FAR)).all() and error < ENOUGH * min(self.error[0], 1.0))

    def _repair(self, twin: Twin, sources: Mapping[str, tuple[str, str]]) -> str:
        if self.is_sign:
            return "reverse it in the record or in the model"
        declared, pairs = _declared_units(twin, self.kind), list[str]()
        for name in self.names:
            column = sources.get(name, (name, ""))[0]
            pairs.append(f"{name}={column}:{self.of_declared(declared[name])}")
        return f'say so with --map "{",".join(pairs)}"'

    @property
    def _quoted(self) -> str:
        words = [f"'{name}'" for name in self.names]
        return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]

    @property
    def _other(self) -> str:
        return f"{self._quoted} {'with its sign reversed' if self.is_sign else f'in {self.unit}'}"

    def as_dict(self) -> dict[str, Any]:
        """Doubt as JSON can hold it."""
        return {
            "channels": [*self.names],
            "unit": self.unit,
            "declared": self.declared,
            "sign": -1 if self.is_sign else 1,
            "otherwise": [{"name": name, "on": on, "times": times} for (name, on), times in self.otherwise],
            "alike": [{"channels": [*x.names], "unit": x.unit, "sign": -1 if x.is_sign else 1} for x in self.alike],
        }


def checked(twin: Twin, record: Data, shared: Sequence[str] = ()) -> UnitDoubt | None:
    """Unit or sign that is probably another than declared, before anything is fitted or simulated whole; or None.

    Args:
        twin: the plant, as it is declared.
        record: commands and readings.
        shared: parameters that a fit has free: its compiled functions are then used.

    Raises:
        RecordError: the clock is probably in another unit; what is simulated, and for how long, depends on it.
    """
    doubt = doubted(twin, record, _as_declared(Sensitivity(twin, (), tuple(shared))))
    if doubt is not None and doubt.kind == "clock":
        column, _ = record.sources.get(CLOCK, (CLOCK, ""))
        said = f"{record.name}: {doubt.note(twin, record)}"
        raise RecordError(f'{said}. If it is in s, say so with --map "{CLOCK}={column}:{SECOND}"')
    return doubt


def _as_declared(sensing: Sensitivity) -> Residuals:
    """Residuals of a twin; what each sensor leaves counts in parts of its spread.

    Steps of integration are smaller where the motion is not finite: at rest nothing may be fast.
    """

    def residuals(record: Data) -> Array | None:
        theta, weights = sensing.start(), _spread(record.readings) ** -2.0
        least = min(sensing.twin.substeps(record.rate), STEPS)
        for steps in (least, *(by * least for by in FINER if by * least <= STEPS)):
            made = list[NormalEquations]()
            for start in guesses(sensing, record):
                with suppress(IntegrationError):
                    made.append(nearest(sensing, theta, record, weights, start, steps=steps)[1])
            if made:
                return record.residuals(min(made, key=lambda one: float(one.squares @ weights)).simulated)
        return None

    return residuals


def doubted(twin: Twin, record: Data, residuals: Residuals) -> UnitDoubt | None:
    """Unit or sign that is probably another than declared; None where none is."""
    compare = comparison(record, residuals)
    before, size = compare(record)
    if before < LOST:
        return None
    found = [*tried(twin, record, others(twin, record), compare, before)]
    best, least = best_of([(one, one.error[1]) for one, _ in found])
    if best and least < ENOUGH * min(before, 1.0):
        return best
    clocks = [pair for pair in found if pair[0].kind == "clock"]
    if not clocks or twin.substeps(record.rate) < SLOW:
        return None
    best, least = min(clocks, key=lambda pair: pair[1])
    return best if least < min(FAR, size) else None


def tried(
    twin: Twin, record: Data, every: Iterable[UnitDoubt], compare: Compare, before: float
) -> Iterator[tuple[UnitDoubt, float]]:
    """Other units with the errors as declared, `before`, and in each, and how far sizes are apart there."""
    for one in every:
        error, size = compare(one.of(twin, record))
        yield replace(one, error=(before, error)), size


def comparison(record: Data, residuals: Residuals) -> Compare:
    """Comparison of a record, in any units, with a simulation, in the part in which its readings spread most."""
    size, count = _spread(record.readings), max(1, round(len(record) / SAMPLES))
    ends = len(record) * np.arange(count + 1) // count
    parts = zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
    varied = {(a, b): float((_spread(record.readings[a:b]) / size).sum()) for a, b in parts}
    begin, end = max(varied, key=lambda span: varied[span])
    return lambda one: _compared(one.part(begin, end), residuals)


def best_of(found: Sequence[tuple[UnitDoubt, float]]) -> tuple[UnitDoubt | None, float]:
    """First unit whose value is the least, with those that are as good, and that value."""
    least = min((value for _, value in found), default=np.inf)
    near = [one for one, value in found if value <= (1.0 + ALIKE) * least]
    return (replace(near[0], alike=tuple(near[1:])) if near else None), least


def others(twin: Twin, record: Data) -> Iterator[UnitDoubt]:
    """Other signs and declared units: of each channel, and units of those alike, of all sensors, and of the clock.

    Units that are said for a column are not doubted.
    """
    said = {name for name, (_, unit) in record.sources.items() if unit}
    declared = {kind: _declared_units(twin, kind) for kind in ("sensor", "actuator", "clock")}
    for kind in ("sensor", "actuator"):
        yield from (UnitDoubt((name,), kind, unit, unit, REVERSED) for name, unit in declared[kind].items())
        channels = {name: unit for name, unit in declared[kind].items() if unit and name not in said}
        alike = {unit: tuple(name for name in channels if channels[name] == unit) for unit in channels.values()}
        groups = {*((name,) for name in channels), *alike.values()}
        groups |= {tuple(channels)} if kind == "sensor" and channels else set()
        for names in sorted(groups, key=lambda group: (len(group), group)):
            yield from _of_group(names, kind, [*dict.fromkeys(channels[name] for name in names)])
    for unit in () if CLOCK in said else TIMES:
        yield UnitDoubt((CLOCK,), "clock", unit, SECOND, factor_of(unit))


def _declared_units(twin: Twin, kind: str) -> dict[str, str]:
    """Declared units of the sensors, the actuators or the clock; "" where none is."""
    if kind == "clock":
        return {CLOCK: SECOND}
    known = twin.declaration
    ports = known.sensors if kind == "sensor" else known.actuators or twin.base.inputs
    names = twin.sensors if kind == "sensor" else twin.actuators
    return {name: ports[name].unit if "unit" in ports[name].model_fields_set else "" for name in names}


def _of_group(names: tuple[str, ...], kind: str, declared: Sequence[str]) -> Iterator[UnitDoubt]:
    """Other units of channels, all by one factor: usual ones of the dimension of each that is declared."""
    every = [{factor_of(one) / factor_of(unit): one for one in USUAL if _is_other(one, unit)} for unit in declared]
    for factor, first in every[0].items() if every else ():
        units = [first, *(one for of in every[1:] for by, one in of.items() if np.isclose(by, factor))]
        if len(units) == len(declared):
            yield UnitDoubt(names, kind, AND.join(units), AND.join(declared), factor)


def _is_other(unit: str, declared: str) -> bool:
    """Whether a unit has the dimension of a declared one, and is not as large."""
    return dimension_of(unit) == dimension_of(declared) and not np.isclose(factor_of(unit), factor_of(declared))


def _compared(record: Data, residuals: Residuals) -> tuple[float, float]:
    """Largest error of a sensor, in parts of its spread, and how many times simulation and readings are apart in size.

    That is how many times the simulation of a sensor spreads as much as its readings, or less, at most. Both are
    infinite where the motion is not finite.
    """
    left = residuals(record)
    if left is None:
        return np.inf, np.inf
    spread = _spread(record.readings)
    ratio = spread / _spread(record.readings - left)
    error = np.sqrt((left**2).mean(axis=0)) / spread
    return float(error.max()), float(np.maximum(ratio, 1.0 / ratio).max())


def _spread(readings: Array) -> Array:
    """Standard deviation of readings (m, sensors) about straight lines (sensors,).

    A model that does not answer at all, as in too fast a clock, goes in a straight line from its initial state.
    """
    t = np.arange(len(readings))
    lines = np.polynomial.polynomial.polyval(t, np.polynomial.polynomial.polyfit(t, readings, 1)).T
    return np.asarray(np.maximum((readings - lines).std(axis=0), 1e-300))
