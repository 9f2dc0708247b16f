"""Localisation of the model error: coordinate, element, displacement, speed and time, and the side of the rig.

The latent forces are those that a Kalman smoother finds along the record, with the causes left out and with them.
Forces of different coordinates are compared in units of their deviations. An error on the side of the actuators shows
as a force that follows a command, one on the side of the sensors as a residual that follows the reading itself.
Source: see `smoothing`, `force_decomposition`, `harmonics` and `masking.inference.estimation.whiteness`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.display.json_text import plain
from masking.inference.discovery import latent_force
from masking.inference.discovery.force_decomposition import SEEN, ForceDecomposition, decompose, followed
from masking.inference.discovery.harmonics import Harmonics, Periods, cycle
from masking.inference.discovery.latent_force import Explained
from masking.inference.discovery.smoothing import Motion
from masking.inference.estimation.whiteness import Whiteness


@dataclass(frozen=True)
class LocatedForce:
    """The latent force at a place."""

    name: str  # of the place
    share: float  # of all latent forces, the part that a force at this place alone would make
    decomposition: ForceDecomposition  # of that force, in the place's units
    harmonics: Harmonics | None  # of it; None if the commands are not periodic, or there is no such force
    units: tuple[str, str, str]  # of force, displacement and rate
    frequency: float | None = None  # of the motion in Hz; None if it has not one alone

    @property
    def explained(self) -> float:
        """Share of all latent forces that follows displacement and rate of this place."""
        parts = self.decomposition.parts
        return 0.0 if parts is None else self.share * (1.0 - parts.neither)

    @property
    def signal_to_noise(self) -> float:
        """Root mean square of the force, in its deviations."""
        return self.decomposition.size / max(self.decomposition.deviation, 1e-300)

    def as_dict(self) -> dict[str, Any]:
        """Place as JSON can hold it."""
        return {
            "share": self.share,
            "explained": self.explained,
            **self.decomposition.as_dict(),
            "harmonics": plain(self.harmonics),
            "frequency": self.frequency,
            "loss_per_cycle": self.frequency and self.decomposition.loss / self.frequency,
            "units": dict(zip(("force", "displacement", "rate"), self.units, strict=True)),
        }


@dataclass(frozen=True)
class LatentForces:
    """The latent forces along the record, by coordinate, place, actuator and sensor."""

    # share of each coordinate, or state or output that forces act on, in the energy of the latent forces beyond their
    # deviations; sum 1, or all 0 if there are none
    coordinates: Mapping[str, float]
    # each place; a force between two coordinates is nearly one on either of them, so that shares overlap
    places: tuple[LocatedForce, ...]
    actuators: Mapping[str, float]  # share of all latent forces that a function of the command of each would make
    sensors: Mapping[str, float]  # part of each residual beyond noise that is a function of what the sensor should read

    @property
    def best(self) -> LocatedForce:
        """Place whose displacement and rate explain most of the latent forces, or that has most of them."""
        return max(self.places, key=lambda place: (round(place.explained, 2), place.share, place.signal_to_noise))

    def as_dict(self) -> dict[str, Any]:
        """Latent forces as JSON can hold them."""
        return dict(plain({**vars(self), "places": {place.name: place for place in self.places}}))


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
    seen, periods = found.smoothed, Periods.of(found.record.commands, found.record.rate)
    residuals = found.explanation.hypothesis.residuals
    left = None if seen.after is None else _latent_forces(found, seen.after, residuals, periods, names)
    return Localisation(_latent_forces(found, seen.before, seen.error, periods, names), left, whiteness)


def _latent_forces(
    found: Explained, motion: Motion, error: Array, periods: Periods | None, names: Collection[str]
) -> LatentForces:
    """Latent forces along a motion whose readings differ by an error (m, sensors) from the simulation."""
    rig, theta, repeats = found.rig, found.explanation.hypothesis.theta, None if periods is None else periods.length
    ratios = (motion.forces**2).mean(axis=0) / np.maximum(motion.deviation, 1e-150) ** 2
    energies = np.where(ratios > SEEN, ratios - 1.0, 0.0)
    whole = float(energies.sum())

    def share(force: Array, deviation: float) -> float:
        return min(max(float((force**2).mean()) / deviation**2 - 1.0, 0.0) / whole, 1.0) if whole else 0.0

    at = [latent_force.projected(motion, latent_force.directions(rig, theta, column)) for column in rig.columns[1]]
    places = []
    for place, x, rate, (force, deviation) in zip(rig.places, motion.displacement.T, motion.rate.T, at, strict=True):
        if place.name not in names:
            continue
        drawn = decompose(x, rate, force, deviation, repeats)
        harmonics = None if periods is None or drawn.parts is None else periods.harmonics(force)
        units = latent_force.element_units(rig, place.name)
        frequency = cycle(rate, found.record.rate)
        places.append(LocatedForce(place.name, share(force, deviation), drawn, harmonics, units, frequency))
    actuators = {}
    for name, command, column in zip(found.twin.actuators, found.record.acting.T, rig.columns[2], strict=True):
        force, deviation = latent_force.projected(motion, latent_force.directions(rig, theta, column))
        energy = float((force**2).mean()) - deviation**2
        part = min(followed(command, force, repeats) / energy, 1.0) if energy > 0.0 else 0.0
        actuators[name] = share(force, deviation) * part
    sensors = {}
    simulated = (found.record.readings - error).T
    for name, reading, residual, sigma in zip(found.twin.sensors, simulated, error.T, found.problem.sigma, strict=True):
        power = float((residual**2).mean())
        is_seen = power > found.problem.rules.noise_floor * sigma**2
        sensors[name] = min(followed(reading, residual, repeats) / (power - float(sigma) ** 2), 1.0) if is_seen else 0.0
    shares = (float(energy / whole) if whole else 0.0 for energy in energies)
    return LatentForces(dict(zip(rig.degrees, shares, strict=True)), tuple(places), actuators, sensors)
