"""Latent force: the force of a cause that a record shows at one place, before and after.

Latent forces of all coordinates are brought to one place by least squares, weighted with their deviations. They are
those of the model with the parameters that were found beside the causes: the force of a cause lies on them, as in a
plot of partial residuals. The residual after the causes is found the same way: they are taken out of the readings,
which are smoothed again.
Source: Larsen and McCleary (1972), Technometrics 14(3), 781-790, for partial residuals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.errors import IntegrationError
from masking.inference.discovery import compiled_laws
from masking.inference.discovery.augmented_model import AugmentedModel, EffectInstance
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.places import is_of_one
from masking.inference.discovery.problem import EstimationProblem
from masking.inference.discovery.search import SearchResult
from masking.inference.discovery.smoothing import Motion, smooth
from masking.inference.discovery.verdict import Verdict
from masking.inference.estimation.identification_data import Data
from masking.model.declaration.dimensions import dimension_in, displacement_dimension, is_plain, symbol_dimensions
from masking.model.declaration.expression import Expression
from masking.model.declaration.units import Dimension, coherent, describe

BINS = 24  # of a range, with equally many samples each
FEWEST = 30  # samples of a bin


@dataclass(frozen=True)
class LatentForce:
    """The latent force, command or reading at a place along the record."""

    place: str  # name of the element, coordinate, sensor or actuator
    where: str  # 'element', 'actuator' or 'sensor'
    x: Array  # displacement of an element, command of an actuator, or simulated reading of a sensor (m,)
    rate: Array  # of it (m,)
    before: Array  # the latent force, command or reading (m,)
    after: Array | None  # its residual with the causes (m,); None if no cause is known, or the residual cannot be found
    deviations: tuple[float, float]  # standard deviations of `before` and of `after`
    units: tuple[str, str, str]  # of `before`, `x` and `rate`
    known: tuple[bool, bool] = (True, True)  # whether displacement and rate are known

    @property
    def seen(self) -> list[tuple[Array, str]]:
        """Displacement and rate, as far as they are known, with their units; the first where neither is."""
        both = zip((self.x, self.rate), self.units[1:], self.known, strict=True)
        return [(x, unit) for x, unit, is_known in both if is_known] or [(self.x, self.units[1])]


@dataclass(frozen=True)
class Smoothed:
    """Latent forces along the record, of the model with the parameters that were found beside the causes."""

    before: Motion  # the motion with the latent forces without causes
    after: Motion | None  # with the causes taken out of the readings; None if none is known, or it cannot be found
    error: Array  # readings less the simulation without causes (m, sensors)


@dataclass(frozen=True, repr=False, kw_only=True)
class Explained:
    """A record with its explanation, the one that was chosen in the whole search: what latent forces are found of."""

    verdict: Verdict
    twin: Twin
    problem: EstimationProblem
    explanation: Explanation
    search: SearchResult

    @property
    def rig(self) -> AugmentedModel:
        """Rig with its places open."""
        return self.problem.rig

    @property
    def record(self) -> Data:
        """Record that was explained."""
        return self.problem.record

    @cached_property
    def smoothed(self) -> Smoothed:
        """Latent forces along the record, with the parameters found, before and after the causes."""
        chosen, base, problem = self.explanation.hypothesis, self.search.base.hypothesis, self.problem
        if self.explanation.kind == "none":
            motion = self.search.motion if chosen is base else smooth(problem, chosen.theta, chosen.start)
            return Smoothed(motion, None, chosen.residuals)
        try:
            if problem.interval:  # readings without causes would jump between shooting intervals
                before = smooth(problem, chosen.theta, chosen.start)
                return Smoothed(before, _without(self, before), base.residuals)
            without = problem.equations(chosen.theta, chosen.start).simulated
            cleaned = replace(self.record, readings=np.ascontiguousarray(chosen.residuals + without))
            records = (self.record, cleaned)
            before, after = (smooth(replace(problem, record=r), chosen.theta, chosen.start) for r in records)
        except IntegrationError:
            return Smoothed(self.search.motion, None, base.residuals)
        return Smoothed(before, after, self.record.readings - without)


def force_at(found: Explained, most: str) -> LatentForce:
    """Latent force at the place of the last cause, or at `most`, that of the largest one, if no cause explains it."""
    instances = found.explanation.hypothesis.instances
    if not instances or found.verdict == "unknown":
        return _force(found, "element", most)
    name = instances[-1].at or found.twin.actuators[int(np.argmax(found.record.commands.std(axis=0)))]  # the busiest
    return _sensor(found, name) if instances[-1].where == "sensor" else _force(found, instances[-1].where, name)


def binned(x: Array, force: Array) -> tuple[Array, Array, Array]:
    """Centres, means of a force and numbers of samples (b,) of bins of x (m,); those with few samples are left out."""
    low, high = np.quantile(x, [0.002, 0.998])
    edges = np.linspace(low, high if high > low else low + 1.0, BINS + 1)
    at = np.clip(np.searchsorted(edges, x) - 1, 0, BINS - 1)
    counts = np.bincount(at, minlength=BINS)
    enough = counts >= min(FEWEST, max(1, len(x) // (4 * BINS)))
    sums, places = np.bincount(at, force, BINS), np.bincount(at, x, BINS)
    return places[enough] / counts[enough], sums[enough] / counts[enough], counts[enough].astype(float)


def energies(found: Explained) -> dict[str, float]:
    """Share of each sensor in what is beyond noise in the record, by name."""
    m, sigma = len(found.record), found.problem.sigma
    beyond = np.maximum(found.search.base.hypothesis.squares / sigma**2 - m, 0.0)
    whole = float(beyond.sum()) or 1.0
    return dict(zip(found.twin.sensors, (float(part / whole) for part in beyond), strict=True))


def _force(found: Explained, where: str, name: str) -> LatentForce:
    rig, seen, known = found.rig, found.smoothed, (True, True)
    motion, left = seen.before, seen.after
    if where == "actuator":
        at = rig.twin.actuators.index(name)
        x = found.record.acting[:, at]
        rate = np.gradient(x) * found.record.rate
        column = rig.columns[2][at]
        unit = command_unit(found, name)
        units = (unit, unit, _per_second(unit))
    else:
        at = [place.name for place in rig.places].index(name)
        place = rig.places[at]
        known = place.element.displacement is not None, place.has_rate
        x, rate = motion.displacement[:, at], motion.rate[:, at]
        column = rig.columns[1][at]
        units = element_units(rig, name)
    by = directions(rig, found.explanation.hypothesis.theta, column)
    before, deviation = projected(motion, by)
    after, afterwards = (None, deviation) if left is None else projected(left, by)
    return LatentForce(name, where, x, rate, before, after, (deviation, afterwards), units, known)


def _sensor(found: Explained, name: str) -> LatentForce:
    at, base, after = found.twin.sensors.index(name), found.search.base.hypothesis, found.explanation.hypothesis
    x = (found.record.readings - after.residuals)[:, at]
    rate, sigma = np.gradient(x) * found.record.rate, float(found.problem.sigma[at])
    unit = found.twin.declaration.sensors[name].unit
    before, left = base.residuals[:, at], after.residuals[:, at]
    return LatentForce(name, "sensor", x, rate, before, left, (sigma, sigma), (unit, unit, _per_second(unit)))


def along(found: Explained, instance: EffectInstance, x: Array, rate: Array) -> Array:
    """Force or value of an effect along a motion of its place, displacement, command or reading and rate of it (m,)."""
    if instance.effect == compiled_laws.DELAY:
        t = np.arange(len(x)) / found.record.rate
        return np.asarray(np.interp(t - instance.values[0], t, x))
    return np.asarray(found.rig.along(instance, x, rate, found.problem.dt)[:, 0])


def _without(found: Explained, motion: Motion) -> Motion:
    forces = motion.forces.copy()
    for instance in found.explanation.hypothesis.instances:
        if instance.where == "sensor":
            continue
        for i in [found.rig.index(instance)] if instance.at else range(len(found.twin.actuators)):
            if instance.where == "actuator":
                x = found.record.acting[:, i]
                law, column = along(found, instance, x, np.zeros_like(x)) - x, found.rig.columns[2][i]
            else:
                law, column = along(found, instance, *motion.acted_on(instance.entry, i)), found.rig.columns[1][i]
            forces -= np.outer(law, directions(found.rig, found.explanation.hypothesis.theta, column))
    return replace(motion, forces=forces)


def projected(motion: Motion, by: Array) -> tuple[Array, float]:
    """Force at a place that is nearest to those on all coordinates (m,), and its standard deviation.

    `by` is what a unit at the place is on each degree (degrees,); see `directions`. Where no sensor shows the force at
    once, it is 0 with an infinite deviation.
    """
    weight = by / np.maximum(motion.deviation, 1e-150) ** 2
    norm = float(by @ weight)
    return (motion.forces @ weight / norm, norm**-0.5) if norm > 0.0 else (np.zeros(len(motion.forces)), np.inf)


def directions(rig: AugmentedModel, theta: Array, column: int) -> Array:
    """Forces on each degree of a unit in a column of the equations (degrees,)."""
    moved = rig.slopes(theta)[1][len(rig.coordinates) :]
    moved = np.vstack([moved, rig.direct(theta)]) if rig.twin.is_fed else moved
    ports = moved[:, [rig.columns[1][i] for i in rig.degree_places]]
    return decompositions.least_squares(ports, moved[:, column])


def command_unit(found: Explained, name: str) -> str:
    """Unit of the commands of an actuator."""
    return (found.twin.declaration.actuators or found.twin.base.inputs)[name].unit


def element_units(rig: AugmentedModel, name: str) -> tuple[str, str, str]:
    """SI units of force, displacement and rate of a place; '' in a model without units."""
    base = rig.twin.base
    element = next(place.element for place in rig.places if place.name == name)
    symbols = symbol_dimensions(base)
    if is_plain(base) or symbols is None:
        return "", "", ""
    declared = {n: x.unit for section in (base.coordinates, base.states, base.inputs) for n, x in section.items()}
    moved, rate = (_written(of, declared, symbols) for of in (element.displacement, element.rate))
    if not moved and rate:
        dimension = displacement_dimension(element, symbols)
        moved = rate.removesuffix("/s") if rate.endswith("/s") else describe(dimension) if dimension else ""
    force, moved, rate = coherent(element.unit), coherent(moved), coherent(rate)
    return force, moved, rate or _per_second(moved)


def _written(
    expression: Expression | None, declared: Mapping[str, str], symbols: Mapping[str, Dimension | None]
) -> str:
    """Unit of what an element follows, as it is declared where that is of one unit; '' of nothing."""
    if expression is None:
        return ""
    known = {declared[name] for name in expression.names & declared.keys()}
    if len(known) == 1 and is_of_one(expression, declared):
        return known.pop()
    dimension = dimension_in(expression, symbols)
    return "" if dimension is None else describe(dimension)


def _per_second(unit: str) -> str:
    return f"{unit}/s" if unit not in {"", "1"} else "1/s"
