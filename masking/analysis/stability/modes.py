"""Modes: eigenvalues, frequencies, damping and shapes of a system near a state, and how fast it synchronises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.intervals import Interval, enclose
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array, Complex
from masking.display.json_text import Result
from masking.display.printed_result import Printed
from masking.errors import ModelError, nearest
from masking.lazy_imports import control
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model

_STEP = 1e-3  # of the size of a state, for differences of order 6: their error is near 1e-12 of it
_STENCIL = ((1, 0.75), (2, -0.15), (3, 1.0 / 60.0))
_ROUNDING = 1e-14  # of the size of a matrix, what its entries and its decomposition err by
_NEUTRAL = 1e-9  # of the largest eigenvalue: below this a real part counts as 0


class Driven(Protocol):
    """Compiled dynamics with their own parameters: a closed loop."""

    @property
    def kernels(self) -> Kernels:
        """Compiled functions, `derivative(t, y, u, p, dy)` among them."""

    def values(self) -> Array:
        """Parameter array."""


@dataclass(frozen=True, repr=False)
class Mode(Printed, Result):
    """A motion e^(lambda t) of a linear system."""

    json_names = ("eigenvalue", "frequency", "damping", "shape")
    eigenvalue: complex  # lambda, in 1/s or per unit of time
    shape: dict[str, complex]  # complex amplitude of each coordinate, the largest is 1

    @property
    def frequency(self) -> float:
        """|Im lambda|, in rad/s or rad per unit of time; 0 where it does not oscillate."""
        return abs(self.eigenvalue.imag)

    @property
    def damping(self) -> float:
        """Damping ratio -Re lambda/|lambda|; negative for a mode that grows."""
        size = abs(self.eigenvalue)
        return -self.eigenvalue.real / size if size > 0.0 else 0.0

    def __str__(self) -> str:
        z = self.eigenvalue
        value = f"{_plain(z.real, 6):+.6f}" + (f" ± {self.frequency:.6f}i" if self.frequency else "")
        damping = f"damping {_plain(self.damping, 4):.4f}" if self.frequency else ""
        shape = ", ".join(
            f"{name} {abs(x):.3f}" + (f" at {phase(x):.2f} pi" if abs(x) > 1e-6 else "")
            for name, x in self.shape.items()
        )
        return f"{value:24} {damping:16} {shape}"


@dataclass(frozen=True, repr=False)
class Modes(Printed):
    """All modes, the slowest to decay first; of a pair of conjugates the one with positive frequency."""

    modes: tuple[Mode, ...]
    eigenvalues: Complex

    @property
    def is_stable(self) -> bool | None:
        """Whether all decay; None where some neither grow nor decay and none grows."""
        largest = float(np.max(self.eigenvalues.real, initial=-np.inf))
        slack = _NEUTRAL * float(np.max(np.abs(self.eigenvalues), initial=0.0))
        return None if abs(largest) <= slack else largest < 0.0

    @property
    def headline(self) -> str:
        """Number of modes, and whether they decay."""
        how = {True: "all decay", False: "some grow", None: "none grows, some do not decay"}[self.is_stable]
        return f"{len(self.modes)} modes: {how}"

    def __str__(self) -> str:
        return "\n".join(map(str, self.modes))


def phase(amplitude: complex) -> float:
    """Phase of a complex amplitude over pi, in (-1, 1], to two digits."""
    found = _plain(float(np.angle(amplitude)) / np.pi, 2)
    return 1.0 if found == -1.0 else found


def _plain(x: float, digits: int) -> float:
    """Round; what is 0 then has no sign."""
    return round(x, digits) + 0.0


def state_matrix(model: Model, at: Mapping[str, float] | None = None) -> Array:
    """Dy'/dy (2 n + k, 2 n + k) of a model without inputs, by the chain rule, exact but for rounding.

    Coordinates, velocities (`x1'`) and internal states are 0 where `at` does not give them.

    Raises:
        ModelError: there is no such state, or the equations hold the time.
    """
    model.check_ordinary("a linear system")
    size = len(model.coordinates) * 2 + len(model.states)
    return _slopes(model, dict(at or {}), 0.0).middle.reshape(size, size)


def is_smooth(model: Model, at: Mapping[str, float]) -> bool:
    """Whether no force has a kink at a state: enclosures of the slopes around it narrow as the box does."""
    try:
        wide, narrow = (_slopes(model, dict(at), reach) for reach in (1e-8, 1e-11))
    except ModelError:  # such as a root of what may be negative close by
        return False
    largest = float(np.max(np.abs(narrow.middle), initial=0.0))
    return bool(np.all((narrow.width <= 0.5 * wide.width) | (narrow.width <= _NEUTRAL * largest)))


def eigenvalues(matrix: Array, error: float = _ROUNDING) -> tuple[Complex, Array]:
    """Eigenvalues of a matrix (m, m), and how far its errors may have moved each (m,).

    The error is relative to the size of the matrix, by default that of rounding. An eigenvalue moves by |dA|/|y^H x|
    with left and right eigenvectors y, x of norm 1.
    Source: Golub and Van Loan, Matrix Computations (2013), section 7.2.2.
    """
    values, right = np.linalg.eig(matrix)
    try:
        left = np.linalg.inv(right)  # its rows are y^H/(y^H x)
    except np.linalg.LinAlgError:  # as few eigenvectors as a Jordan block has
        left = np.full_like(right, np.inf)
    size = float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0
    with np.errstate(over="ignore"):
        return values.astype(np.complex128), error * size * np.sqrt(np.sum(np.abs(left) ** 2, axis=1))


def _slopes(model: Model, given: dict[str, float], reach: float) -> Interval:
    """Dy'/dy (1, m^2) over a box around a state, a part of each wide, or of 1 where it is 0."""
    if not model.is_autonomous:
        raise ModelError(
            f"the equations of {model.name} hold the time: they have no constant matrix; for its motions there are "
            "masking.analysis.stability.transverse and masking.analysis.stability.lyapunov_exponent"
        )
    lowered = LoweredEquations.of(model.equations, Graph())
    graph, s = lowered.graph, model.equations.symbols
    states = (*s.q, *s.v, *s.s)
    names = [x.name for x in states]
    for name in given:
        if name not in names:
            raise ModelError(f"{model.name} has no state '{name}'; {nearest(name, names)}")
    nodes = [lowered.symbols[x] for x in states]
    rates = [*nodes[len(s.q) : 2 * len(s.q)], *lowered.accelerations, *lowered.rates]
    entries = [x for row in derivatives(graph, rates, nodes) for x in row]
    values = {lowered.symbols[x]: Interval.of(0.0) for x in (s.t, *s.u)}
    for x in states:
        at = given.get(x.name, 0.0)
        slack = reach * (abs(at) or 1.0)
        values[lowered.symbols[x]] = Interval.of(at - slack, at + slack)
    values |= {lowered.symbols[p]: Interval.of(x) for p, x in zip(s.p, model.values(), strict=True)}
    return Interval.stacked(enclose(graph, entries, values), 1)


def loop_matrix(loop: Driven, state: Array, lengths: Array) -> Array:
    """Dy'/dy of a closed loop at y (2 n + k,) of the rig in SI units, by central differences of order 6.

    The loop is nearly linear over the lengths of each state (2 n + k,).
    """
    size, p = len(state), loop.values()
    matrix, ahead, behind = np.zeros((size, size)), np.empty(size), np.empty(size)
    inputs = np.zeros(len(loop.kernels.meta["inputs"]))
    for j in range(size):
        step = _STEP * lengths[j]
        for k, weight in _STENCIL:
            for sign, rate in ((1.0, ahead), (-1.0, behind)):
                y = np.array(state, dtype=float)
                y[j] += sign * k * step
                loop.kernels.derivative(0.0, y, inputs, p, rate)
            matrix[:, j] += weight * (ahead - behind) / step
    return matrix


def modes(matrix: Array, coordinates: Sequence[str]) -> Modes:
    """Modes of y' = matrix y (m, m), of coordinates, velocities and internal states, such as `state_matrix` gives.

    `coordinates` are the names of the first states, whose amplitudes are the shape.
    """
    values, vectors = np.linalg.eig(np.asarray(matrix, dtype=float))
    order = np.lexsort((-values.imag, np.round(-values.real, 12)))
    found = []
    for i in order:
        if values[i].imag < 0.0:
            continue
        shape = vectors[: len(coordinates), i]
        largest = shape[np.argmax(np.abs(shape))]
        shape = shape / largest if largest != 0.0 else shape
        found.append(Mode(complex(values[i]), dict(zip(coordinates, map(complex, shape), strict=True))))
    return Modes(tuple(found), values[order])


def sum_matrix(matrix: Array, coordinates: Sequence[str], pair: tuple[str, str]) -> Array:
    """Matrix (2 n - 2, 2 n - 2) of the sum system: the sum of a pair of coordinates stands in the place of the first.

    It describes the sum by itself where the two are alike. Source: Rijlaarsdam (2008), (8.10)-(8.11).

    Raises:
        ModelError: the sum is not described by itself.
    """
    n, (first, second) = len(coordinates), (list(coordinates).index(c) for c in pair)
    kept = [i for i in range(n) if i != second]
    take, give = np.eye(n)[kept], np.eye(n)[:, kept]
    take[kept.index(first), second] = 1.0
    give[[first, second], kept.index(first)] = 0.5
    both = np.eye(2)
    wide, tall = np.kron(both, take), np.kron(both, give)
    found = wide @ matrix @ tall
    lost = wide @ matrix - found @ wide
    if np.max(np.abs(lost), initial=0.0) > 1e-9 * np.max(np.abs(matrix), initial=1.0):
        raise ModelError(
            f"{pair[0]} + {pair[1]} has no equation of its own: the two are not alike; look at the modes of the whole"
        )
    return np.asarray(found, dtype=float)


def upsilon(model: Model, at: Mapping[str, float] | None = None) -> float:
    """How long synchronisation takes, in s or units of time: 1/|Re| of the slowest eigenvalue of the sum system (8.13).

    It is infinite where the sum does not decay. The equilibrium is 0 where `at` does not give it.

    Raises:
        ModelError: there are not two oscillators, or their sum has no equation of its own.
    """
    values = np.linalg.eigvals(sum_matrix(state_matrix(model, at), model.coordinates, pair_of(model)))
    slowest = float(np.min(-values.real))
    return 1.0 / slowest if slowest > _NEUTRAL * float(np.max(np.abs(values))) else np.inf


def pair_of(model: Model) -> tuple[str, str]:
    """Two oscillators of a model; a ModelError where it has another number of them."""
    if len(model.oscillators) != 2:
        raise ModelError(
            f"{model.name} has the oscillators {', '.join(model.oscillators) or 'none'}; declare two, such as "
            "'oscillators: [x1, x2]'"
        )
    return model.oscillators[0], model.oscillators[1]


def sweep(model: Model, parameter: str, values: Array, measure: Callable[[Model], float] = upsilon) -> Array:
    """Measure of a model over values (m,) of a parameter in its declared unit, such as `upsilon` over z3 (Fig. 8.4)."""
    return np.array([measure(model.with_parameters(**{parameter: float(x)})) for x in values])


def frequency_response(model: Model, frequencies: Array, at: Mapping[str, float] | None = None) -> Complex:
    """Complex amplitudes (outputs, inputs, m) at frequencies (m,) near an equilibrium, through python-control.

    Frequencies are in rad/s, or in rad per unit of time; outputs are the coordinates where the model declares none; the
    equilibrium is 0 where `at` does not give it.

    Raises:
        ModelError: the model has no inputs, or a frequency is negative or no number.
    """
    if not model.inputs:
        raise ModelError(f"{model.name} has no inputs, and so no frequency response; declare 'inputs:'")
    asked = np.asarray(frequencies, dtype=float)
    wrong = asked[~(np.isfinite(asked) & (asked >= 0.0))]
    if len(wrong):
        raise ModelError(f"a frequency is {wrong[0]:g}; give finite ones that are not negative")
    system: Any = model.linearise(at)
    response = control.frequency_response(system, asked, squeeze=False)
    return np.asarray(response.complex, dtype=np.complex128)
