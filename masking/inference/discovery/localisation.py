"""Localisation of the model error: coordinate, element, displacement, speed and time, and the side of the rig.

The latent forces are those that a Kalman smoother finds along the record, with the causes left out and with them.
Forces of different coordinates are compared in units of their deviations. An error on the side of the actuators shows
as a force that follows a command, one on the side of the sensors as a residual that follows the reading itself.
Source: see `smoothing`, `force_decomposition` and `masking.inference.estimation.whiteness`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import Result, plain
from masking.inference.discovery import force_decomposition as forces
from masking.inference.discovery import latent_force
from masking.inference.discovery.force_decomposition import SEEN, ForceDecomposition, Harmonics
from masking.inference.discovery.latent_force import Explained, Units
from masking.inference.discovery.smoothing import Motion
from masking.inference.estimation.whiteness import Whiteness


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
        force, deviation = latent_force.projected(motion, latent_force.directions(rig, theta, column))
        return force, deviation, min(max(float((force**2).mean()) / deviation**2 - 1.0, 0.0) / whole, 1.0)

    def follows(x: Array, values: Array, deviation: float, least: float = 1.0) -> float:
        """Part of the mean square of values (m,) beyond their deviation that is a function of x (m,)."""
        power = float((values**2).mean())
        seen = power > least * deviation**2
        return min(forces.followed(x, values, repeats) / (power - deviation**2), 1.0) if seen else 0.0

    places = {}
    moving = zip(rig.places, motion.displacement.T, motion.rate.T, rig.columns[1], strict=True)
    for place, x, rate, column in moving:
        if place.name in names:
            force, deviation, share = at(column)
            drawn = forces.decompose(x, rate, force, deviation, repeats)
            others = (
                forces.harmonics(record.commands, force, repeats, record.rate) if repeats and drawn.energy else None
            )
            units = latent_force.element_units(rig, place.name)
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
