"""Zero dynamics: how the passive coordinates of a rig move while its virtual coordinates move as they are wanted.

With a = a0(q, v) + B(q) u and eta = T(q), inputs that hold eta satisfy J B u = -J a0 - J' v. What remains of the rig's
motion is that of its passive coordinates. Small motions x of them are followed about the rest nearest to zero, where
x' = A x, and along the wanted motion: over each of its periods x becomes Phi x, and grows or shrinks by the eigenvalues
of Phi, the Floquet multipliers. Where they grow, the rig cannot be masked for long, however well the virtual
coordinates follow.
Source: Isidori (1995), Nonlinear Control Systems, section 4.3; Spong (1994), partial feedback linearisation; Nayfeh and
Mook (1979), Nonlinear Oscillations, section 5.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from masking.analysis.stability import modes
from masking.compile.numerics.arrays import Array, Complex
from masking.compile.numerics.newton import STEP, Root, equilibrium, jacobian, root
from masking.control.blocks import Transform
from masking.display.json_text import plain
from masking.errors import ModelError, RootError
from masking.model.modelling.model import Model

MARGINAL: Final = 1e-6  # real part, relative to the largest eigenvalue, up to which motion neither decays nor grows
_DIFFERENCES: Final = 1e-8  # of the size of Phi: what slopes by differences of motions are off by
_CONVERGED: Final = 1e-12


@dataclass(frozen=True)
class ZeroDynamics:
    """Small motions of the passive coordinates about their rest, or along a wanted motion."""

    names: tuple[str, ...]  # of the passive coordinates
    rest: Array  # where they rest (m,), SI units; empty (0,) along a motion
    # of small motions of coordinates, rates and internal states, each in units of its size (r, r): A of x' = A x, per
    # second; Phi of x after one period; or a diagonal matrix of mean growths over a run, per second
    matrix: Array
    about: str = "at rest"  # which motion they are small motions about
    period: float | None = None  # of the wanted motion, s; None about rest and over a run
    spread: float = 0.0  # by how much mean growths over a run are uncertain, 1/s

    @cached_property
    def _values(self) -> tuple[Complex, Array]:
        """Eigenvalues of the matrix, and how far differences may have moved each (r,)."""
        return modes.eigenvalues(self.matrix, _DIFFERENCES)

    @property
    def multipliers(self) -> Complex | None:
        """Floquet multipliers (r,): the factors of a period; None where there is none."""
        return None if self.period is None else self._values[0]

    @cached_property
    def eigenvalues(self) -> Complex:
        """Growth and frequency of each small motion (r,), 1/s; of a period, log(multiplier)/period."""
        with np.errstate(divide="ignore"):
            values = self._values[0]
            return values if self.period is None else np.asarray(np.log(values) / self.period, dtype=np.complex128)

    @cached_property
    def _is_neutral(self) -> NDArray[np.bool_]:
        """Which small motions neither decay nor grow, as far as is known (r,)."""
        values, errors = self._values
        if self.period is None:
            slack = max(MARGINAL * float(np.abs(values).max(initial=0.0)), self.spread)
            return np.asarray(np.abs(values.real) <= slack)
        return np.asarray(np.abs(np.abs(values) - 1.0) <= np.maximum(errors, MARGINAL))

    @property
    def _is_growing(self) -> bool:
        return bool(np.any((self.eigenvalues.real > 0.0) & ~self._is_neutral))

    @property
    def drifts(self) -> bool:
        """Whether a small motion grows in proportion to the time: an eigenvalue counts more often than its vectors."""
        (values, errors), size = self._values, MARGINAL * float(np.linalg.norm(self.matrix, 2))
        for value, error in zip(values[self._is_neutral], errors[self._is_neutral], strict=True):
            vectors = np.linalg.svd(self.matrix - value * np.eye(len(values)), compute_uv=False) <= size
            if np.sum(np.abs(values - value) <= max(size, error)) > np.sum(vectors):
                return True
        return False

    @property
    def verdict(self) -> Literal["stable", "marginal", "unstable"]:
        """Whether a small motion decays, goes on, or grows."""
        if self._is_growing:
            return "unstable"
        if np.any(self._is_neutral):
            return "unstable" if self.drifts else "marginal"
        return "stable"

    @property
    def slowest(self) -> complex:
        """Eigenvalue that says most: that with the largest real part, above the real axis."""
        return complex(max(self.eigenvalues, key=lambda x: (round(x.real, 12), x.imag)))

    @property
    def how(self) -> str:
        """How a small motion decays, goes on or grows, in words."""
        if self.verdict == "unstable" and not self._is_growing:
            return "drifts away in proportion to the time"
        if self.period is not None:
            return self._by_period
        if not len(self.rest):
            if self.verdict == "marginal":
                return f"decays or grows by less than exp({self.spread:.2g} t), t in s"
            return f"{'grows' if self._is_growing else 'decays'} like exp({self.slowest.real:.3g} t), t in s"
        return self._at_rest

    @property
    def _at_rest(self) -> str:
        at, verdict, frequency = self.slowest, self.verdict, abs(self.slowest)
        if verdict == "unstable":
            return f"grows like exp({at.real:.3g} t), t in s"
        if at.imag == 0.0:
            return f"decays in {-1.0 / at.real:.3g} s" if verdict == "stable" else "neither returns nor grows"
        if verdict == "marginal":
            return f"oscillates undamped at {frequency:.4g} rad/s"
        return f"{frequency:.4g} rad/s, damping ratio {-at.real / frequency:.3g}"

    @property
    def _by_period(self) -> str:
        at, period = self.slowest, self.period or math.inf
        if self.verdict == "marginal":
            least = max(MARGINAL, float(self._values[1][self._is_neutral].max()))
            return f"decays or grows by less than {least:.2g} of itself each period"
        words = f"to {math.exp(at.real * period):.4g} of itself each period, like exp({at.real:.3g} t), t in s"
        if self.verdict == "stable":
            return f"decays {words}"
        is_half = abs(at.imag * period - math.pi) <= MARGINAL  # a negative multiplier: it turns once in two periods
        return f"grows {words}" + (", at half the frequency of the motion" if is_half else "")

    def __str__(self) -> str:
        return f"{', '.join(self.names)} passive, zero dynamics {self.verdict} {self.about}: {self.how}"

    def as_dict(self) -> dict[str, Any]:
        """Everything as JSON can hold it."""
        rest = dict(zip(self.names, self.rest, strict=True)) if len(self.rest) else None
        own = {"coordinates": self.names, "about": self.about, "rest": rest, "period": self.period}
        numbers = {"multipliers": self.multipliers, "eigenvalues": self.eigenvalues, "words": str(self)}
        known = {**own, "verdict": self.verdict, "how": self.how, **numbers}
        tree: dict[str, Any] = plain({name: one for name, one in known.items() if one is not None})
        return tree


@dataclass(frozen=True)
class Held:
    """A rig whose virtual coordinates are held."""

    plant: Model  # the model of the rig, SI units
    transform: Transform  # from rig to virtual coordinates
    parameters: Mapping[str, float]  # values of the transform's own parameters
    lengths: Array  # size in SI units of one unit of each rig coordinate as the transform sees it (n,)
    eta: Array  # virtual coordinates that are held (k,)

    @property
    def passive(self) -> list[int]:
        """Indices of the passive coordinates."""
        return list(self.transform.passive)

    @cached_property
    def _symbolic(self) -> tuple[Any, Any]:
        known = {s: self.parameters[s.name] for s in self.transform.parameter_symbols}
        return self.transform.expressions.subs(known), self.transform.jacobian.subs(known)

    def mapped(self, q: Array) -> tuple[Array, Array]:
        """Eta (k,) and its Jacobian (k, n) by rig coordinates q (n,) in SI units."""
        symbols = self.transform.rig.equations.symbols.q
        at = dict(zip(symbols, map(float, q / self.lengths), strict=True))
        eta, jacobian = (np.array(m.subs(at).evalf().tolist(), dtype=float) for m in self._symbolic)
        return eta.ravel(), jacobian / self.lengths

    def placed(self, z: Array) -> Root:
        """Rig coordinates (n,) at passive ones z (m,), with the slope [J; passive] there (n, n), if there are any."""
        n = len(self.lengths)
        start = np.zeros(n)
        start[self.passive] = z

        def system(q: Array) -> tuple[Array, Array]:
            eta, slope = self.mapped(q)
            rows = np.concatenate([slope, np.eye(n)[self.passive]])
            return np.concatenate([eta - self.eta, q[self.passive] - z]), rows

        try:
            return root(system, start, error=_CONVERGED * (1.0 + np.abs(self.eta).max(initial=0.0)))
        except RootError as error:
            where = f"no rig position gives {self.eta} beside the passive coordinates {z}"
            raise ModelError(f"transform: {where}") from error

    def accelerations(self, z: Array, rates: Array) -> Array:
        """Accelerations of passive coordinates z (m,) with rates (m,), but for what is even in the rates."""
        plant, n = self.plant.affine, len(self.lengths)
        q, slope = self.placed(z)
        rows = slope[: len(self.eta)]
        v = np.linalg.lstsq(slope, np.concatenate([np.zeros(len(self.eta)), rates]), rcond=None)[0]
        internal = plant.first_internal
        p, out = plant.values(), np.empty(2 * n + len(internal))

        def rig(u: Array) -> Array:
            plant.kernels.derivative(0.0, np.concatenate([q, v, internal]), u, p, out)
            return out[n : 2 * n].copy()

        inputs = np.eye(len(plant.inputs))
        free = rig(np.zeros(len(inputs)))
        driven = np.array([rig(u) - free for u in inputs]).T
        u = np.linalg.lstsq(rows @ driven, -rows @ free, rcond=None)[0]
        return np.asarray((free + driven @ u)[self.passive], dtype=np.float64)

    def zero_dynamics(self) -> ZeroDynamics:
        """Zero dynamics about the rest that is nearest to zero; a ModelError where there is none.

        Damping is that of velocities at which the rig passes rest in oscillations of a unit of length, as for an
        observer: dry friction has no slope at rest.
        """
        lengths, m = self.plant.lengths[self.passive], len(self.passive)
        still = np.zeros(m)
        names = tuple(self.plant.coordinates[i] for i in self.passive)
        try:
            rest = equilibrium(lambda z: self.accelerations(z, still), lengths)
        except RootError as error:
            raise ModelError(
                f"{', '.join(names)}: passive, and without a rest near zero while the virtual coordinates are held; "
                f"say where the run begins, such as 'initial: {{{names[0]}: 0}}'"
            ) from error
        stiffness = jacobian(lambda z: self.accelerations(z, still), rest, STEP * lengths)
        fastest = float(np.sqrt(np.abs(np.linalg.eigvals(stiffness)).max())) or 1.0
        damping = jacobian(lambda rates: self.accelerations(rest, rates), still, fastest * lengths)
        matrix = np.block([[np.zeros((m, m)), np.eye(m)], [stiffness, damping]])
        sizes = np.concatenate([lengths, rates_of(stiffness, lengths, fastest)])
        return ZeroDynamics(names, rest, matrix * sizes / sizes[:, None])


def rates_of(stiffness: Array, lengths: Array, slowest: float) -> Array:
    """Rates (m,) at which coordinates pass rest, each in oscillations by its length under its own stiffness.

    Where a coordinate has none, as if it oscillated at `slowest`, in rad/s.
    """
    frequencies = np.sqrt(np.abs(np.diag(stiffness)))
    return np.asarray(np.where(frequencies > 0.0, frequencies, slowest) * lengths)
