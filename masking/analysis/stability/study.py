"""Study of stability: equilibria of a model, its modes there, how fast it synchronises, what its energy proves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from masking.analysis.stability.energy_certificate import Certificate, certificate
from masking.analysis.stability.equilibria import Box, Equilibria, Equilibrium, check_box, equilibria
from masking.analysis.stability.lyapunov_exponent import Exponent
from masking.analysis.stability.modes import Driven, Modes, loop_matrix, modes, state_matrix, upsilon
from masking.compile.numerics.arrays import Array, Complex
from masking.display.json_text import plain
from masking.display.printed_result import Printed
from masking.errors import ModelError
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class LoopModes:
    """Eigenvalues of a closed loop where the virtual system is at an equilibrium, per unit of virtual time."""

    eigenvalues: Complex  # of the loop, the slowest to decay first
    distance: float  # from the virtual system's eigenvalues to the nearest of these, at most


@dataclass(frozen=True, repr=False)
class Stability(Printed):
    """What is known of the stability of a model."""

    name: str  # of the model
    coordinates: tuple[str, ...]  # its coordinates
    rest: Equilibria | None  # its equilibria; None where they cannot be looked for, and `reason` then says why
    modes: tuple[Modes, ...]  # at each of the equilibria
    # 1/|Re| of the slowest eigenvalue of the sum of two oscillators that are alike (8.13), at the first equilibrium in
    # which they rest at 0; None where there is no such sum
    upsilon: float | None
    certificate: Certificate  # what the energy proves
    loop: LoopModes | None = None  # eigenvalues of the closed loop of an experiment; None for a model
    reason: str = ""  # why there is less than that
    exponent: Exponent | None = None  # Lyapunov exponent of the motion from the initial state; None where not asked for

    @property
    def points(self) -> tuple[tuple[Equilibrium, Modes], ...]:
        """Each equilibrium with its modes."""
        return tuple(zip(self.rest.points if self.rest else (), self.modes, strict=True))

    @property
    def headline(self) -> str:
        """Name of the model, and what its energy proves."""
        return f"{self.name}: {self.certificate.headline}"

    def __str__(self) -> str:
        lines = [self.name, ""]
        lines += [f"equilibria: {self.rest}" if self.rest else f"equilibria: {self.reason}"]
        for point, found in self.points:
            lines.append(f"  {point.words}: {point.verdict}" + " (proved)" * point.is_unstable)
            lines += [f"    {mode}" for mode in found.modes]
        if self.upsilon is not None:
            lines.append(f"upsilon = {self.upsilon:.4g}, 1/|Re| of the slowest eigenvalue of the sum (8.13)")
        if self.exponent is not None:
            lines.append(f"motion from the initial state: {self.exponent}")
        if self.loop is not None:
            lines.append(f"closed loop: its eigenvalues are the virtual system's within {self.loop.distance:.1e}")
        return "\n".join([*lines, "", "energy certificate", str(self.certificate)])

    def as_dict(self) -> dict[str, Any]:
        """Study as JSON can hold it."""
        return dict(plain({
            "name": self.name,
            "equilibria": self.rest and {
                "sentence": str(self.rest),
                "is_complete": self.rest.is_complete,
                "is_global": self.rest.is_global,
                "along": [{n: x / self.rest.shown[n].size for n, x in one.items()} for one in self.rest.along],
                "units": {name: self.rest.shown[name].unit for name in self.coordinates},
                "box": {n: [x / self.rest.shown[n].size for x in sides] for n, sides in self.rest.box.items()},
                "points": [{
                    "position": {n: x / point.shown[n].size for n, x in point.position.items()},
                    "radius": point.radius,
                    "verdict": point.verdict,
                    "is_proved_unstable": point.is_unstable,
                    "eigenvalues": found.eigenvalues,
                    "modes": found.modes,
                } for point, found in self.points],
            },
            "reason": self.reason,
            "upsilon": self.upsilon if self.upsilon is None or math.isfinite(self.upsilon) else None,
            "exponent": self.exponent,
            "certificate": self.certificate,
            "loop": self.loop,
        }))  # fmt: skip


def study(model: Model, box: Box | None = None) -> Stability:
    """Work out what is known of the stability of a model.

    Args:
        model: in SI units or in its scales; inputs are 0.
        box: least and largest value of coordinates, between which equilibria are looked for, and of coordinates and
            velocities (`x1'`), for what the energy does not prove everywhere, in the declared units, or in the scales;
            see `equilibria` and `dissipation`.

    Raises:
        ModelError: the box names what is no coordinate or velocity, or has no inside.
    """
    check_box(model, box or {})
    box = {n: (low * model.shown[n].size, high * model.shown[n].size) for n, (low, high) in (box or {}).items()}
    places = {name: sides for name, sides in box.items() if name in model.coordinates}
    rest, reason = None, ""
    try:
        rest = equilibria(model, places)
    except ModelError as error:
        if places:
            raise
        reason = str(error)
    found = [modes(state_matrix(model, p.position), model.coordinates) for p in (rest.points if rest else ())]
    proof = certificate(model, box)
    return Stability(model.name, model.coordinates, rest, tuple(found), _upsilon(model, rest), proof, reason=reason)


def loop_modes(loop: Driven, state: Array, lengths: Array, time_scale: float, virtual: Complex) -> LoopModes:
    """Eigenvalues of a `ClosedLoop` per unit of virtual time, which is `time_scale` in s.

    The state of the rig (2 n + k,), in SI units as the lengths, a size of each, is that which the loop's transform maps
    to the virtual equilibrium; `virtual` are the eigenvalues of the virtual system there.
    """
    values = np.linalg.eigvals(loop_matrix(loop, state, lengths)).astype(np.complex128) * time_scale
    values = values[np.lexsort((-values.imag, np.round(-values.real, 9)))]
    distance = max((float(np.min(np.abs(values - x))) for x in virtual), default=0.0)
    return LoopModes(values, distance)


def _upsilon(model: Model, rest: Equilibria | None) -> float | None:
    """Upsilon at the equilibrium at 0; None where there is none, or no sum with an equation of its own."""
    if rest is None or not any(not any(point.position.values()) for point in rest.points):
        return None
    try:
        return upsilon(model)
    except ModelError:
        return None
