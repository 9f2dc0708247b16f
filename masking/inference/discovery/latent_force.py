"""Latent forces: the force of a cause that a record shows at one place, before and after, and where they are.

Latent forces of all coordinates are brought to one place by least squares, weighted with their deviations. They are
those of the model with the parameters that were found beside the causes: the force of a cause lies on them, as in a
plot of partial residuals. The residual after the causes is found the same way: they are taken out of the readings,
which are smoothed again.

They localise the model error: coordinate, element, displacement, speed and time, and the side of the rig. Forces of
different coordinates are compared in units of their deviations. An error on the side of the actuators shows as a force
that follows a command, one on the side of the sensors as a residual that follows the reading itself.
Source: Larsen and McCleary (1972), Technometrics 14(3), 781-790, for partial residuals; see `smoothing`,
`force_decomposition` and `masking.inference.estimation.whiteness`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from masking.compile.numerics import decompositions
from masking.compile.numerics.arrays import Array
from masking.control.rig.twin import Twin
from masking.display.json_text import Result, plain
from masking.errors import IntegrationError
from masking.inference.discovery import force_decomposition as forces
from masking.inference.discovery.augmented_model import AugmentedModel
from masking.inference.discovery.estimation_problem import EstimationProblem
from masking.inference.discovery.explanation import Explanation
from masking.inference.discovery.force_decomposition import ENDS, SEEN, ForceDecomposition, Harmonics
from masking.inference.discovery.motion_features import MotionFeatures, Thinning
from masking.inference.discovery.places import is_of_one
from masking.inference.discovery.search import SearchResult
from masking.inference.discovery.smoothing import Motion, smooth
from masking.inference.discovery.verdict import Verdict
from masking.inference.estimation.identification_data import Data
from masking.inference.estimation.whiteness import Whiteness
from masking.model.declaration.dimensions import dimension_in, is_plain, symbol_dimensions
from masking.model.declaration.units import coherent, combined, describe

BINS = 24  # of a range, with equally many samples each
FEWEST = 30  # samples of a bin


class Units(NamedTuple):
    """Units of what acts at a place, of the displacement, command or reading that it follows, and of the rate of it."""

    force: str
    displacement: str
    rate: str


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
    units: Units  # of `before`, `x` and `rate`
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
    chosen, record = found.explanation.hypothesis, found.record
    if not chosen.instances or found.verdict == "unknown":
        return _of_element(found, most)
    where = chosen.instances[-1].where
    name = chosen.instances[-1].at or found.twin.actuators[int(np.argmax(record.commands.std(axis=0)))]  # the busiest
    if where == "element":
        return _of_element(found, name)
    at = getattr(found.twin, f"{where}s").index(name)
    if where == "actuator":
        x = record.acting[:, at]
        before, after, deviations = _forces(found, found.rig.columns[2][at])
    else:
        before, after = found.search.base.hypothesis.residuals[:, at], chosen.residuals[:, at]
        x, deviations = record.readings[:, at] - after, (float(found.problem.sigma[at]),) * 2
    rate, unit = np.gradient(x) * record.rate, channel_unit(found, name, where)
    return LatentForce(name, where, x, rate, before, after, deviations, Units(unit, unit, _per_second(unit)))


def _of_element(found: Explained, name: str) -> LatentForce:
    at = [place.name for place in found.rig.places].index(name)
    place, motion = found.rig.places[at], found.smoothed.before
    x, rate, units = motion.displacement[:, at], motion.rate[:, at], element_units(found.rig, name)
    before, after, deviations = _forces(found, found.rig.columns[1][at])
    known = place.element.displacement is not None, place.has_rate
    return LatentForce(name, "element", x, rate, before, after, deviations, units, known)


def _forces(found: Explained, column: int) -> tuple[Array, Array | None, tuple[float, float]]:
    """Forces (m,) before and after the causes in a column of the equations, and their deviations."""
    by, seen = directions(found.rig, found.explanation.hypothesis.theta, column), found.smoothed
    before, deviation = projected(seen.before, by)
    after, afterwards = (None, deviation) if seen.after is None else projected(seen.after, by)
    return before, after, (deviation, afterwards)


def binned(x: Array, force: Array) -> tuple[Array, Array, Array]:
    """Centres, means of a force and numbers of samples (b,) of bins of x (m,); those with few samples are left out."""
    inside = np.clip(x, *np.quantile(x, ENDS))
    counts, places, sums = (np.histogram(inside, BINS, weights=of)[0] for of in (np.ones_like(x), x, force))
    enough = counts >= min(FEWEST, max(1, len(x) // (4 * BINS)))
    return places[enough] / counts[enough], sums[enough] / counts[enough], counts[enough]


def energies(found: Explained) -> dict[str, float]:
    """Share of each sensor in what is beyond noise in the record, by name."""
    m, sigma = len(found.record), found.problem.sigma
    beyond = np.maximum(found.search.base.hypothesis.squares / sigma**2 - m, 0.0)
    whole = float(beyond.sum()) or 1.0
    return dict(zip(found.twin.sensors, (float(part / whole) for part in beyond), strict=True))


def features(found: Explained, motion: Motion) -> MotionFeatures:
    """What effects do along a smoothed motion, in each sample; those of sensors, to the readings as explained."""
    simulated = found.record.readings - found.explanation.hypothesis.residuals
    return MotionFeatures(found.rig, found.record, motion, simulated, Thinning(1, 1))


def _without(found: Explained, motion: Motion) -> Motion:
    forces, known = motion.forces.copy(), features(found, motion)
    for instance in found.explanation.hypothesis.instances:
        if instance.where != "sensor":
            for signal, column in zip(*(part.T for part in known.signal(instance)), strict=True):
                forces -= np.outer(signal, directions(found.rig, found.explanation.hypothesis.theta, int(column)))
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


def channel_unit(found: Explained, name: str, kind: str) -> str:
    """Declared unit of a channel, of kind 'sensor' or 'actuator'."""
    declared = found.twin.declaration
    return (declared.sensors if kind == "sensor" else declared.actuators or found.twin.base.inputs)[name].unit


def element_units(rig: AugmentedModel, name: str) -> Units:
    """SI units of force, displacement and rate of a place; '' in a model without units.

    That of what the element follows is as it is declared where that is of one unit.
    """
    base, symbols = rig.twin.base, symbol_dimensions(rig.twin.base)
    element = next(place.element for place in rig.places if place.name == name)
    if is_plain(base) or symbols is None:
        return Units("", "", "")
    declared = {n: x.unit for section in (base.coordinates, base.states, base.inputs) for n, x in section.items()}

    follows = element.rate if element.displacement is None else element.displacement
    known = set() if follows is None else {declared[n] for n in follows.names & declared.keys()}
    if len(known) == 1 and is_of_one(follows, declared):
        moved = known.pop()
    else:
        dimension = None if follows is None else dimension_in(follows, symbols)
        moved = "" if dimension is None else describe(dimension)
    if moved and element.displacement is None:
        moved = combined("V*s", {"V": moved})
    return Units(*map(coherent, (element.unit, moved, _per_second(moved))))


def _per_second(unit: str) -> str:
    return combined("U/s", {"U": unit})


@dataclass(frozen=True)
class LocatedForce:
    """The latent force at a place."""

    name: str  # of the place
    share: float  # of all latent forces, the part that a force at this place alone would make
    decomposition: ForceDecomposition  # of that force, in the place's units
    harmonics: Harmonics | None  # of it; None if the commands are not periodic, or there is no such force
    units: Units
    frequency: float | None = None  # of the motion in Hz; None if it has not one alone

    @property
    def explained(self) -> float:
        """Share of all latent forces that follows displacement and rate of this place."""
        energy = self.decomposition.energy
        return 0.0 if energy is None else self.share * (1.0 - energy.neither)

    @property
    def loss_per_cycle(self) -> float | None:
        """Energy that it takes out of the motion in a cycle; None of a motion without one frequency."""
        return self.decomposition.loss / self.frequency if self.frequency else None

    def as_dict(self) -> dict[str, Any]:
        """Place as JSON can hold it."""
        shares = {"share": self.share, "explained": self.explained}
        names = ("harmonics", "frequency", "loss_per_cycle", "units")
        return shares | self.decomposition.as_dict() | {name: plain(getattr(self, name)) for name in names}


@dataclass(frozen=True)
class LatentForces(Result):
    """The latent forces along the record, by coordinate, place, actuator and sensor."""

    # share of each coordinate, or state or output that forces act on, in the energy of the latent forces beyond their
    # deviations; sum 1, or all 0 if there are none
    coordinates: Mapping[str, float]
    # by name; a force between two coordinates is nearly one on either of them, so that shares overlap
    places: Mapping[str, LocatedForce]
    actuators: Mapping[str, float]  # share of all latent forces that a function of the command of each would make
    sensors: Mapping[str, float]  # part of each residual beyond noise that is a function of what the sensor should read

    @property
    def best(self) -> LocatedForce:
        """Place whose displacement and rate explain most of the latent forces, or that has most of them."""

        def rank(place: LocatedForce) -> tuple[float, float, float]:
            force = place.decomposition
            return round(place.explained, 2), place.share, force.rms / max(force.deviation, 1e-300)

        return max(self.places.values(), key=rank)


class ResidualWhiteness(NamedTuple):
    """Whiteness of the residual of a sensor without causes, and with these; None where none is known."""

    before: Whiteness
    after: Whiteness | None


@dataclass(frozen=True)
class Localisation:
    """Where the error of a model is: latent forces with the parameters that were found, but without the causes.

    The residual is with the causes, None where none is known; the whiteness is that of the validation residuals.
    """

    latent: LatentForces
    residual: LatentForces | None
    whiteness: Mapping[str, ResidualWhiteness]

    def as_dict(self) -> dict[str, Any]:
        """Localisation as JSON can hold it."""
        return dict(plain({"latent_force": self.latent, "residual_force": self.residual, "whiteness": self.whiteness}))


def localise(found: Explained, whiteness: Mapping[str, ResidualWhiteness], names: Collection[str]) -> Localisation:
    """Localise the model error of a record, at the places that have names: further places are none of their own."""
    seen, residuals = found.smoothed, found.explanation.hypothesis.residuals
    left = None if seen.after is None else _latent_forces(found, seen.after, residuals, names)
    return Localisation(_latent_forces(found, seen.before, seen.error, names), left, whiteness)


def _latent_forces(found: Explained, motion: Motion, error: Array, names: Collection[str]) -> LatentForces:
    """Latent forces along a motion whose readings differ by an error (m, sensors) from the simulation."""
    rig, record, theta = found.rig, found.record, found.explanation.hypothesis.theta
    repeats = forces.period(record.commands)
    ratios = (motion.forces**2).mean(axis=0) / np.maximum(motion.deviation, 1e-150) ** 2
    energies = np.where(ratios > SEEN, ratios - 1.0, 0.0)
    whole = float(energies.sum()) or math.inf

    def at(column: int) -> tuple[Array, float, float]:
        """Force (m,) in a column of the equations, its deviation, and its share of all latent forces."""
        force, deviation = projected(motion, directions(rig, theta, column))
        return force, deviation, min(max(float((force**2).mean()) / deviation**2 - 1.0, 0.0) / whole, 1.0)

    def follows(x: Array, values: Array, deviation: float, least: float = 1.0) -> float:
        """Part of the mean square of values (m,) beyond their deviation that is a function of x (m,)."""
        power = float((values**2).mean())
        seen = power > least * deviation**2
        return min(forces.followed(x, values, repeats) / (power - deviation**2), 1.0) if seen else 0.0

    places = {}
    moving = zip(rig.places, motion.displacement.T, motion.rate.T, rig.columns[1], strict=False)
    for place, x, rate, column in moving:
        if place.name in names:
            force, deviation, share = at(column)
            drawn = forces.decompose(x, rate, force, deviation, repeats)
            others = (
                forces.harmonics(record.commands, force, repeats, record.rate) if repeats and drawn.energy else None
            )
            units = element_units(rig, place.name)
            places[place.name] = LocatedForce(place.name, share, drawn, others, units, forces.cycle(rate, record.rate))
    actuators = {}
    for name, command, column in zip(found.twin.actuators, record.acting.T, rig.columns[2], strict=True):
        force, deviation, share = at(column)
        actuators[name] = share * follows(command, force, deviation)
    sensors, simulated, least = {}, (record.readings - error).T, found.problem.rules.noise_floor
    for name, read, left, sigma in zip(found.twin.sensors, simulated, error.T, found.problem.sigma, strict=True):
        sensors[name] = follows(read, left, float(sigma), least)
    shares = dict(zip(rig.degrees, (energies / whole).tolist(), strict=True))
    return LatentForces(shares, places, actuators, sensors)
