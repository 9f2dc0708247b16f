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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from masking.analysis.stability import modes
from masking.compile.codegen.graph import Node
from masking.compile.codegen.graph_values import ARRAYS, function_of
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array, Complex
from masking.compile.numerics.newton import STEP, equilibrium, jacobian, root
from masking.control.relative_degree import Derivatives, remainder
from masking.control.transform import Transform
from masking.display.json_text import plain
from masking.display.printed_result import Printed
from masking.errors import ModelError, RootError
from masking.model.modelling.model import Model

MARGINAL: Final = 1e-6  # real part, relative to the largest eigenvalue, up to which motion neither decays nor grows
_DIFFERENCES: Final = 1e-8  # of the size of Phi: what slopes by differences of motions are off by
_CONVERGED: Final = 1e-12


@dataclass(frozen=True, repr=False)
class ZeroDynamics(Printed):
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
    """A rig whose virtual coordinates are held, with all of their derivatives that its inputs do not change at once."""

    plant: Model  # the model of the rig, SI units
    transform: Transform  # from rig to virtual coordinates
    parameters: Mapping[str, float]  # values of the transform's own parameters
    lengths: Array  # size in SI units of one unit of each rig coordinate as the transform sees it (n,)
    eta: Array  # virtual coordinates that are held (k,)
    degrees: tuple[int, ...]  # derivative of each of them in which an input appears first (k,)
    places: tuple[int, ...]  # of the states [q, v, s] that they do not determine (r,), in order

    @classmethod
    def direct(
        cls, plant: Model, transform: Transform, parameters: Mapping[str, float], lengths: Array, eta: Array
    ) -> Held:
        """Rig whose inputs change accelerations at once."""
        degrees = (2,) * len(eta)
        return cls(plant, transform, parameters, lengths, eta, degrees, remainder(plant, transform, degrees))

    @property
    def passive(self) -> list[int]:
        """Indices of the coordinates that are not determined."""
        return [i for i in self.places if i < len(self.lengths)]

    @cached_property
    def _begun(self) -> Array:
        """State where a search begins: at rest at the declared place, with internal states as declared."""
        return np.concatenate([self.plant.first_place, np.zeros(len(self.lengths)), self.plant.first_internal])

    @cached_property
    def _functions(self) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
        """Functions of a state (s,): what is held, with its slopes by the state (k', 1 + s); and what inputs hold.

        The latter are the derivatives in which inputs appear, and their slopes by the inputs (k, 1 + inputs).
        """
        known = Derivatives(self.plant.affine, self.transform)
        held = known.determined(self.degrees)
        slopes = derivatives(known.graph, held, known.states)
        last = [(known.of_order(degree)[i], *known.by_inputs(degree)[i]) for i, degree in enumerate(self.degrees)]
        own = [self.parameters[name] for name in self.transform.parameters]
        others = [0.0, *self.plant.values(), *own, *self.lengths, *np.zeros(2 * len(self.lengths))]
        symbols = [node for node in known.symbols if node not in {*known.states}]
        constant = dict(zip(symbols, map(np.float64, others), strict=True))

        def made(rows: Sequence[Sequence[Node]]) -> Callable[[Array], Array]:
            nodes = [x for row in rows for x in row]
            function = function_of(known.graph, nodes, constant, ARRAYS, "value", variables=known.states)
            return lambda x: np.array(function(x), dtype=float).reshape(len(rows), -1)

        return made([(one, *row) for one, row in zip(held, slopes, strict=True)]), made(last)

    def state(self, free: Array) -> Array:
        """State [q, v, s] of the rig in which the states that are not determined have some values (r,)."""
        start, wanted = self._begun.copy(), np.zeros(sum(self.degrees))
        start[list(self.places)] = free
        wanted[np.cumsum([0, *self.degrees[:-1]])] = self.eta
        # of a rig whose inputs act at once, internal states are as declared
        inside = range(2 * len(self.lengths), len(start)) if len(wanted) + len(free) < len(start) else ()
        kept = [*self.places, *inside]
        sizes = np.concatenate([np.tile(self.plant.lengths, 2), np.ones(len(start) - 2 * len(self.lengths))])

        def system(x: Array) -> tuple[Array, Array]:
            known = self._functions[0](x)
            value = np.concatenate([known[:, 0] - wanted, x[kept] - start[kept]])
            rows = np.concatenate([known[:, 1:], np.eye(len(x))[kept]])
            scale = np.maximum(np.abs(rows) @ np.maximum(np.abs(x), sizes), 1e-300)  # rows are of any unit
            return value / scale, rows / scale[:, None]

        try:
            return root(system, start, error=_CONVERGED).at
        except RootError as error:
            remedy = "; give its internal states another initial value" if self.plant.states else ""
            raise ModelError(
                f"{self.plant.name}: no state near its initial one holds the virtual coordinates at {self.eta.tolist()}"
                f"{remedy}"
            ) from error

    def rates(self, free: Array) -> Array:
        """Rates of the states that are not determined (r,), at some values of them (r,)."""
        x, plant = self.state(free), self.plant.affine
        last, out = self._functions[1](x), np.empty(len(x))
        u = np.linalg.lstsq(last[:, 1:], -last[:, 0], rcond=None)[0]
        plant.kernels.derivative(0.0, x, u, plant.values(), out)
        return out[list(self.places)]

    def zero_dynamics(self) -> ZeroDynamics:
        """Zero dynamics about the rest that is nearest to zero; a ModelError where there is none.

        Damping is that of velocities at which the rig passes rest in oscillations of a unit of length, as for an
        observer: dry friction has no slope at rest.
        """
        n, places = len(self.lengths), np.array(self.places, dtype=int)
        swinging = [i for i in self.passive if n + i in self.places]  # coordinates with velocities of their own
        moving = np.isin(places, [n + i for i in swinging])
        pulled = ~np.isin(places, swinging)  # rates of all others are 0 at rest by their own
        names = tuple(self.plant.state_names[i] for i in places[~moving])
        own = np.concatenate([self.plant.lengths, self.plant.lengths, np.ones(len(self._begun) - 2 * n)])
        lengths, still = self.plant.lengths[swinging], np.zeros(len(swinging))

        def rates(others: Array, velocities: Array) -> Array:
            free = np.empty(len(places))
            free[~moving], free[moving] = others, velocities
            return self.rates(free)

        try:
            rest = equilibrium(lambda z: rates(z, still)[pulled], own[places[~moving]])
        except RootError as error:
            raise ModelError(
                f"{', '.join(names)}: passive, and without a rest near zero while the virtual coordinates are held; "
                f"say where the run begins, such as 'initial: {{{names[0]}: 0}}'"
            ) from error
        by_place = jacobian(lambda z: rates(z, still), rest, STEP * own[places[~moving]])
        stiffness = by_place[moving][:, np.isin(places[~moving], swinging)]
        fastest = float(np.sqrt(np.abs(np.linalg.eigvals(stiffness)).max(initial=0.0))) or 1.0
        matrix = np.empty((len(places),) * 2)
        matrix[:, ~moving], matrix[:, moving] = by_place, jacobian(lambda v: rates(rest, v), still, fastest * lengths)
        matrix[np.ix_(~pulled, ~moving)], matrix[np.ix_(~pulled, moving)] = 0.0, np.eye(len(swinging))
        sizes = own[places]
        sizes[moving] = rates_of(stiffness, lengths, fastest)
        return ZeroDynamics(names, rest, matrix * sizes / sizes[:, None])


def rates_of(stiffness: Array, lengths: Array, slowest: float) -> Array:
    """Rates (m,) at which coordinates pass rest, each in oscillations by its length under its own stiffness.

    Where a coordinate has none, as if it oscillated at `slowest`, in rad/s.
    """
    frequencies = np.sqrt(np.abs(np.diag(stiffness)))
    return np.asarray(np.where(frequencies > 0.0, frequencies, slowest) * lengths)
