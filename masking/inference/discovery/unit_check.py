"""Unit check: channels whose unit or sign is probably another than declared, before a search and after it.

If the model as declared follows hardly anything of a record, and nearly all of it where a channel is converted from
another usual unit of its dimension, or has the other sign, that is suspected. Nothing is fitted but the initial state.
A clock by which the model would move for periods between samples is suspected where readings and simulation are alike
in ms.

A law that the model lacks may hide that. So a unit is suspected, too, where what was found needs a gain or a parameter
that is several times what is declared, or is unknown, and readings and simulation are of one size in another unit:
the record is searched in that one as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from masking.errors import IntegrationError
from masking.inference.discovery import fitting
from masking.inference.discovery.fitting import Hypothesis
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.verdict import Key
from masking.inference.estimation.identification_data import Data
from masking.model.declaration.units import dimension_of, factor_of
from masking.model.effects import GAINS_AND_ZEROS

CLOCK, SECOND = "t", "s"
REVERSED = -1.0  # factor of a channel with the other sign
AND = " and "  # between several units
USUAL = (
    *("mm", "cm", "um", "m", "mm/s", "m/s", "km/h", "mm/s**2", "m/s**2", "standard_gravity", "deg", "rad", "deg/s"),
    *("rpm", "rad/s", "N", "kN", "mN", "kgf", "N*m", "N*mm", "V", "mV", "kV", "A", "mA", "Pa", "kPa", "bar"),
)
TIMES = ("ms", "us")
SAMPLES = 4000  # of the record that are simulated
ROUNDS = 12  # of the fit of their initial state
SLOW = 500  # steps of integration between samples, some periods of the fastest motion, from which a clock is doubted
STEPS = 64  # of integration between samples at most
FAR = 3.0  # times what is declared, from which a gain or a parameter is far off: the least factor between usual units
DEVIATIONS = 3.0  # of its prior, from which a parameter is
GAINS = {name for name in GAINS_AND_ZEROS if name.endswith("gain")}
LIKE = 1.2  # times the factor between units, up to which a gain is like it: a law may be mistaken for the rest
NO_WORSE, MUCH_LESS = 1.05, 0.5  # times the error on unseen data as declared, in another unit that is taken
ALIKE = 0.05  # relative difference of errors or sizes from which two units do the same for a record


@dataclass(frozen=True)
class UnitDoubt:
    """A unit or a sign that is probably another than declared."""

    names: tuple[str, ...]  # the channels; `t` is the clock
    kind: str  # 'sensor', 'actuator' or 'clock'
    unit: str  # what they are probably in, and `declared`: what they are declared in; of several units, each once
    declared: str
    factor: float  # how many declared units one of the other is; -1 where the sign is probably reversed
    # largest relative error of a sensor with the model as declared, in the declared and in the other unit
    error: tuple[float, float] = (np.inf, np.inf)
    # gains (effect, place) and parameters (name, '') that are far off in the declared unit, and how many times what is
    # declared they are there
    otherwise: tuple[tuple[Key, float], ...] = ()
    alike: tuple[UnitDoubt, ...] = ()  # other channels and units that would do the same

    @property
    def is_sign(self) -> bool:
        """Whether the sign is probably another than declared, and not the unit."""
        return self.factor < 0.0

    @property
    def is_gain(self) -> bool:
        """Whether the record would need a gain of the one channel that is about the factor of its unit."""
        gains = {on: times for (_, on), times in self.otherwise if on and times}
        known = gains if self.kind == "actuator" else {on: 1.0 / times for on, times in gains.items()}
        by = known.get(self.names[0], 0.0) / self.factor if len(self.names) == 1 else 0.0
        return 1.0 / LIKE < by < LIKE

    def of_declared(self, unit: str) -> str:
        """Probable unit of the channels that are declared in a unit."""
        return dict(zip(self.declared.split(AND), self.unit.split(AND), strict=True))[unit]

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

    def converted(self, problem: EstimationProblem) -> EstimationProblem:
        """Problem with the channels in the declared unit."""
        twin, sigma = problem.rig.twin, problem.sigma.copy()
        if self.kind == "sensor":
            sigma[[twin.sensors.index(name) for name in self.names]] *= abs(self.factor)
        record = self.of(problem, problem.record)
        steps = min(max(1, twin.substeps(record.rate) // 2), STEPS) if self.kind == "clock" else problem.substeps
        return replace(problem, record=record, sigma=sigma, substeps=steps)

    def of(self, problem: EstimationProblem, record: Data) -> Data:
        """Record with the channels in the declared unit."""
        twin = problem.rig.twin
        if self.kind == "clock":
            return replace(record, rate=record.rate / self.factor)
        every = twin.sensors if self.kind == "sensor" else twin.actuators
        scale = np.where([name in self.names for name in every], self.factor, 1.0)
        if self.kind == "sensor":
            return replace(record, readings=record.readings * scale)
        return replace(record, commands=record.commands * scale)


def doubted(problem: EstimationProblem) -> UnitDoubt | None:
    """Unit that is probably another than declared; None where none is."""
    few, rules = _part(problem), problem.rules
    declared = _simulated(few)
    before = _error(declared, few)
    if before < rules.phase_loss:
        return None
    tried = [*_tried(few, _others(few), before)]
    best, least = _best([(one, one.error[1]) for one, _ in tried])
    if best and least < rules.unit_error * min(before, 1.0):
        return best
    if problem.substeps < SLOW:
        return None
    best, size = min((pair for pair in tried if pair[0].kind == "clock"), key=lambda pair: pair[1])
    return best if size < min(FAR, _apart(declared, few)) else None


def suspected(problem: EstimationProblem, found: Hypothesis) -> UnitDoubt | None:
    """Unit that makes readings and simulation one size, which they are not in the declared one; or None.

    A law may change the size of a motion by itself: a gain that is as large as a factor between units counts, too. What
    explains the record in the declared unit is known; the problem is simulated whole.
    """
    few, otherwise = _part(problem), far_off(problem, found)
    before = _simulated(few)
    others = (replace(one, otherwise=otherwise) for one in _others(few) if one.kind != "clock")
    tried = [*_tried(few, others, _error(before, few))]
    best, least = _best(tried)
    return best if best and FAR * least < _apart(before, few) else next((one for one, _ in tried if one.is_gain), None)


def _tried(few: EstimationProblem, others: Iterable[UnitDoubt], before: float) -> Iterator[tuple[UnitDoubt, float]]:
    """Other units with the errors as declared and in each, and how far simulation and readings are apart there."""
    for one in others:
        other = one.converted(few)
        after = _simulated(other)
        yield replace(one, error=(before, _error(after, other))), _apart(after, other)


def far_off(problem: EstimationProblem, found: Hypothesis) -> tuple[tuple[Key, float], ...]:
    """Gains (effect, place) and parameters (name, '') that are several times what is declared, and how many."""
    prior, names = problem.prior, problem.rig.names
    pairs = [((one.effect, one.at), 1.0 + one.values[0]) for one in found.instances if one.effect in GAINS]
    for name, value, mean, deviation in zip(names, found.theta, prior.mean, prior.deviation, strict=False):
        if mean and abs(value - mean) > DEVIATIONS * deviation:
            pairs.append(((name, ""), float(value / mean)))
    return tuple((key, times) for key, times in pairs if not 1.0 / FAR < times < FAR)


def _part(problem: EstimationProblem) -> EstimationProblem:
    part = problem.record.first(SAMPLES / problem.record.rate)
    return replace(problem, record=part, substeps=min(problem.substeps, STEPS))


def _best(tried: Sequence[tuple[UnitDoubt, float]]) -> tuple[UnitDoubt | None, float]:
    """First unit whose value is the least, with those that are as good, and that value."""
    least = min((value for _, value in tried), default=np.inf)
    near = [one for one, value in tried if value <= (1.0 + ALIKE) * least]
    return (replace(near[0], alike=tuple(near[1:])) if near else None), least


def _others(problem: EstimationProblem) -> Iterator[UnitDoubt]:
    """Other signs and declared units: of each channel, and units of those alike, of all sensors, and of the clock."""
    twin, known = problem.rig.twin, problem.rig.twin.declaration
    sensors = {name: known.sensors[name] for name in twin.sensors}
    actuators = {name: (known.actuators or twin.base.inputs)[name] for name in twin.actuators}
    for kind, ports in (("sensor", sensors), ("actuator", actuators)):
        yield from (UnitDoubt((name,), kind, port.unit, port.unit, REVERSED) for name, port in ports.items())
        channels = {name: port.unit for name, port in ports.items() if "unit" in port.model_fields_set}
        alike = {unit: tuple(name for name in channels if channels[name] == unit) for unit in channels.values()}
        groups = {*((name,) for name in channels), *alike.values()}
        groups |= {tuple(channels)} if kind == "sensor" and channels else set()
        for names in sorted(groups, key=lambda group: (len(group), group)):
            yield from _of_group(names, kind, [*dict.fromkeys(channels[name] for name in names)])
    for unit in TIMES:
        yield UnitDoubt((CLOCK,), "clock", unit, SECOND, factor_of(unit))


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


def _simulated(problem: EstimationProblem) -> Hypothesis | None:
    """Model as declared, its initial state fitted; None if its motion is not finite."""
    mean = problem.prior.mean
    try:
        begun = fitting.Begun((), mean, problem.first_states(mean))
    except IntegrationError:
        return None
    return fitting.solved(problem, begun, rounds=ROUNDS, frozen=True)


def _error(found: Hypothesis | None, problem: EstimationProblem) -> float:
    """Largest error of a sensor, of its variation; infinite if the motion is not finite."""
    if found is None:
        return np.inf
    size = np.maximum(problem.record.readings.var(axis=0), 1e-300) * len(problem.record)
    return float(np.sqrt((found.squares / size).max()))


def _apart(found: Hypothesis | None, problem: EstimationProblem) -> float:
    """How many times the simulation of a sensor varies as much as its readings, or less, at most."""
    if found is None:
        return np.inf
    readings = problem.record.readings
    ratio = np.maximum(readings.std(axis=0), 1e-300) / np.maximum((readings - found.residuals).std(axis=0), 1e-300)
    return float(np.maximum(ratio, 1.0 / ratio).max())
