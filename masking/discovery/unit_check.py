"""Unit check: channels whose unit is probably another than declared, before anything is searched.

If the model as declared follows hardly anything of a record, and nearly all of it where a channel is converted from
another usual unit of its dimension, that unit is suspected. Nothing is fitted but the initial state.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from masking.declaration.units import dimension_of, factor_of
from masking.discovery import fitting
from masking.discovery.problem import EstimationProblem
from masking.errors import IntegrationError
from masking.estimation.data import Data

CLOCK, SECOND = "t", "s"
USUAL = (
    *("mm", "cm", "um", "m", "mm/s", "m/s", "km/h", "mm/s**2", "m/s**2", "standard_gravity", "deg", "rad", "deg/s"),
    *("rpm", "rad/s", "N", "kN", "mN", "kgf", "N*m", "N*mm", "V", "mV", "kV", "A", "mA", "Pa", "kPa", "bar"),
)
TIMES = ("ms", "us")
SAMPLES = 4000  # of the record that are simulated
STEPS = 64  # of integration between samples at most


@dataclass(frozen=True)
class UnitDoubt:
    """A unit that is probably another than declared.

    Args:
        names: the channels; `t` is the clock.
        kind: 'sensor', 'actuator' or 'clock'.
        unit: what they are probably in.
        declared: what they are declared in.
        error: largest relative error of a sensor with the model as declared, in the declared and in the other unit.
    """

    names: tuple[str, ...]
    kind: str
    unit: str
    declared: str
    error: tuple[float, float] = (np.inf, np.inf)

    def as_dict(self) -> dict[str, Any]:
        """Return the doubt as JSON can hold it."""
        return {"channels": [*self.names], "unit": self.unit, "declared": self.declared}

    @property
    def factor(self) -> float:
        """Return how many declared units one of the other is."""
        return factor_of(self.unit) / factor_of(self.declared)

    def converted(self, problem: EstimationProblem) -> EstimationProblem:
        """Return a problem with the channels in the declared unit."""
        twin, sigma = problem.rig.twin, problem.sigma.copy()
        if self.kind == "sensor":
            sigma[[twin.sensors.index(name) for name in self.names]] *= self.factor
        record = self.of(problem, problem.record)
        steps = min(max(1, twin.substeps(record.rate) // 2), STEPS) if self.kind == "clock" else problem.substeps
        return replace(problem, record=record, sigma=sigma, substeps=steps)

    def of(self, problem: EstimationProblem, record: Data) -> Data:
        """Return a record with the channels in the declared unit."""
        twin = problem.rig.twin
        if self.kind == "clock":
            return replace(record, rate=record.rate / self.factor)
        every = twin.sensors if self.kind == "sensor" else twin.actuators
        scale = np.where([name in self.names for name in every], self.factor, 1.0)
        if self.kind == "sensor":
            return replace(record, readings=record.readings * scale)
        return replace(record, commands=record.commands * scale)


def doubted(problem: EstimationProblem) -> UnitDoubt | None:
    """Return the unit that is probably another than declared; None where none is.

    Args:
        problem: the record and the rig, simulated whole.
    """
    part = problem.record.first(SAMPLES / problem.record.rate)
    few = replace(problem, record=part, substeps=min(problem.substeps, STEPS))
    before, rules = _error(few), problem.rules
    if before < rules.phase_loss:
        return None
    tried = [replace(one, error=(before, _error(one.converted(few)))) for one in _others(problem)]
    best = min(tried, key=lambda one: one.error[1], default=None)
    return best if best and best.error[1] < rules.unit_error * min(before, 1.0) else None


def _others(problem: EstimationProblem) -> Iterator[UnitDoubt]:
    """Give other units: of each channel, of all sensors or actuators of a unit, and of the clock."""
    twin, known = problem.rig.twin, problem.rig.twin.declaration
    ports = known.actuators or twin.base.inputs
    units = {"sensor": {name: known.sensors[name].unit for name in twin.sensors}}
    units["actuator"] = {name: ports[name].unit for name in twin.actuators}
    for kind, channels in units.items():
        alike = {unit: tuple(name for name in channels if channels[name] == unit) for unit in channels.values()}
        groups = {*((name,) for name in channels), *alike.values()}
        for names in sorted(groups, key=lambda group: (len(group), group)):
            for unit in _alternatives(channels[names[0]]):
                yield UnitDoubt(names, kind, unit, channels[names[0]])
    for unit in TIMES:
        yield UnitDoubt((CLOCK,), "clock", unit, SECOND)


def _alternatives(declared: str) -> list[str]:
    """Return the usual units of the dimension of a declared one, without those as large as it."""
    alike = [unit for unit in USUAL if dimension_of(unit) == dimension_of(declared)]
    return [unit for unit in alike if not np.isclose(factor_of(unit), factor_of(declared))]


def _error(problem: EstimationProblem) -> float:
    """Return the largest error of a sensor with the model as declared, of its variation; infinite if its motion is."""
    try:
        found = fitting.fit(problem, frozen=True)
    except IntegrationError:
        return np.inf
    size = np.maximum(problem.record.readings.var(axis=0), 1e-300) * len(problem.record)
    return float(np.sqrt((found.squares / size).max()))
