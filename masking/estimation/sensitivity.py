"""Sensitivity: what the sensors of a twin would read under recorded commands, and how that depends on its parameters.

Sensors that round are simulated as they are before that, which is what rounded readings are most likely near.
Sensors are simulated from an initial state, together with their derivatives with respect to chosen parameters and the
initial state, which follow from the equations by the chain rule and are compiled with them. What a least-squares fit
needs of them, the normal equations, is summed up on the way, so that derivatives take no memory.
Source: Ljung, System Identification (1999), section 10.3; Hairer, Norsett and Wanner (1993), section I.14.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.codegen import store
from masking.codegen.kernels import Kernels
from masking.codegen.source import Module
from masking.codegen.tangent import derivatives
from masking.errors import IntegrationError, ModelError, nearest
from masking.estimation.data import is_first_order
from masking.numerics.arrays import Array
from masking.records.hold import Hold
from masking.rig.twin import LoweredTwin, Twin

_STEP = 1e-6  # relative, of the differences that tell how the parameters depend on each other


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of a record for parameters and initial state, the columns in this order.

    Args:
        matrix: J^T W J (k + states, k + states) for the derivatives J of the readings.
        gradient: J^T W r (k + states,) for the residuals r, measured less simulated.
        squares: sum of squared residuals of each sensor (sensors,).
        simulated: what the sensors would read (m, sensors).
        end: the state at the end of the record (states,).
    """

    matrix: Array
    gradient: Array
    squares: Array
    simulated: Array
    end: Array


@dataclass(frozen=True)
class Sensitivity:
    """A twin with the parameters that may change.

    Args:
        twin: the rig.
        names: parameters of its model, those of the effects in its elements included (`friction1_fc`), and of effects
            in its sensors and actuators (`offset_s1_e0`).
        shared: parameters that others of the same twin may change, whose derivatives are compiled too, so that all
            have the same functions.
    """

    twin: Twin
    names: tuple[str, ...]
    shared: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ModelError(f"parameters are named twice: {', '.join(twice)}")
        for name in self._compiled:
            if name not in self.twin.parameter_names:
                mend = nearest(name, self.twin.parameter_names)
                raise ModelError(f"{self.twin.declaration.name} has no parameter '{name}'; {mend}")

    @property
    def _compiled(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.names, *self.shared)))

    def twin_at(self, theta: Array) -> Twin:
        """Return the twin with values (k,) of the parameters, in the units in which they are declared."""
        return self.twin.with_parameters(dict(zip(self.names, map(float, theta), strict=True)))

    @cached_property
    def _unrounded(self) -> Twin:
        return self.twin.unrounded()

    def start(self) -> Array:
        """Return the values of the parameters (k,) that the twin declares, in declared units."""
        return np.array([self.twin.parameter_value(name) for name in self.names])

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the largest allowed value of each parameter (k,), in declared units."""
        pairs = [self.twin.parameter_bounds(name) for name in self.names]
        low = np.array([-np.inf if a is None else a for a, _ in pairs])
        return low, np.array([np.inf if b is None else b for _, b in pairs])

    def parameters(self, theta: Array) -> Array:
        """Return the twin's parameter array for values (k,) of the parameters, with sensors that do not round."""
        return self._unrounded.with_parameters(dict(zip(self.names, map(float, theta), strict=True))).values()

    def basis(self, theta: Array) -> tuple[Array, Array]:
        """Return the twin's parameter array, and how its entries depend on the parameters (affected, k)."""
        p, bounds = self.parameters(theta), self.bounds()
        columns = []
        for i in range(len(theta)):
            behind, ahead = _beside(theta, i, bounds)
            apart = float(ahead[i] - behind[i]) or 1.0  # a parameter between bounds that are one changes nothing
            columns.append((self.parameters(ahead) - self.parameters(behind)) / apart)
        found = np.array(columns).T if columns else np.zeros((len(p), 0))
        return p, np.ascontiguousarray(found[list(self.affected)])

    @cached_property
    def affected(self) -> tuple[int, ...]:
        """Return the indices in the twin's parameter array of all that depend on the parameters and shared ones."""
        if self.shared:
            return Sensitivity(self.twin, self._compiled).affected
        theta, touched, bounds = self.start(), set[int](), self.bounds()
        before = self.parameters(theta)
        for i in range(len(theta)):
            for changed in _beside(theta, i, bounds):
                touched |= set(np.flatnonzero(self.parameters(changed) != before).tolist())
        return tuple(sorted(touched))

    @property
    def states(self) -> int:
        """Return the length of the twin's state."""
        return len(self.twin.state_names)

    @cached_property
    def kernels(self) -> Kernels:
        """Return the compiled functions; from the cache on disk where they have been made before."""
        made_from = {
            "sensitivity": self.twin.structure(),
            "affected": list(self.affected),
            "count": len(self._compiled),
        }
        key = store.key(made_from)
        return Kernels(store.load(key, self._build))

    def _build(self) -> Module:
        module = Module(
            f"{self.twin.declaration.name}, with derivatives", {"kind": "sensitivity", **self.twin.state_kinds}
        )
        lowered = LoweredTwin(self.twin)
        graph, loads = lowered.graph, lowered.loads
        by_text = {text: name for name, text in loads.items()}
        y = [graph.symbol(by_text[f"y[{i}]"], varying=True) for i in range(self.states) if f"y[{i}]" in by_text]
        at = [i for i in range(self.states) if f"y[{i}]" in by_text]
        p = [graph.symbol(by_text.get(f"p[{i}]", f"unused_{i}"), varying=False) for i in self.affected]
        rates = [node for _, node in lowered.derivatives]
        readings = [node for _, node in lowered.readings]

        def jacobian(name: str, nodes: list[int], symbols: list[int], columns: Sequence[int]) -> list[tuple[str, int]]:
            rows = derivatives(graph, nodes, symbols)
            return [
                (f"{name}[{i}, {column}]", node)
                for i, row in enumerate(rows)
                for column, node in zip(columns, row, strict=True)
            ]

        columns = range(len(p))
        slopes = [*lowered.derivatives, *jacobian("jy", rates, y, at), *jacobian("jp", rates, p, columns)]
        module.add("slopes(t, y, u, p, dy, jy, jp)", graph, slopes, loads)
        sensed = [*lowered.readings, *jacobian("jy", readings, y, at), *jacobian("jp", readings, p, columns)]
        module.add("sensed(t, y, u, p, noise, s, jy, jp)", graph, sensed, loads)
        self.twin.add_to(module)
        width = max(self.states, len(readings), len(self.twin.actuators))
        module.add_kernel(SIMULATE.format(states=self.states), "", (8, width))
        sizes = {"states": self.states, "coordinates": len(self.twin.model.coordinates)}
        text = NORMAL.format(**sizes, affected=len(p), sensors=len(readings))
        width = max(self.states + len(self._compiled), len(p), len(readings), len(self.twin.actuators))
        module.add_kernel(text, "i", (7 * self.states + 2 * len(readings) + 10, width))
        return module

    def simulate(
        self, theta: Array, start: Array, commands: Array, *, rate: float, substeps: int, hold: Hold = "zero-order"
    ) -> Array:
        """Return what the sensors would read (m, sensors) without noise.

        Args:
            theta: values of the parameters (k,), in declared units.
            start: the twin's state (states,) at the first sample.
            commands: of the actuators at each sample (m, actuators).
            rate: samples per second.
            substeps: integration steps between samples.
            hold: of the commands between samples.

        Raises:
            IntegrationError: the motion is no longer finite.
            ModelError: `hold` is not known.
        """
        readings, y = np.empty((len(commands), len(self.twin.sensors))), np.array(start, dtype=float)
        given = np.ascontiguousarray(commands, dtype=float)
        self.kernels.simulate(
            len(given), 1.0 / rate, substeps, is_first_order(hold), y, self.parameters(theta), given, readings
        )
        if not np.isfinite(readings).all():
            raise IntegrationError("the simulated motion is no longer finite")
        return readings

    def sensed(self, state: Array, commands: Array | None = None) -> tuple[Array, Array]:
        """Return what the sensors read in a state (sensors,) of the twin, and its derivatives (sensors, states).

        Args:
            state: of the twin (states,).
            commands: of the actuators (actuators,), which sensors may read at once; 0 where none are given.
        """
        sensors, affected = len(self.twin.sensors), len(self.affected)
        given = np.zeros(len(self.twin.actuators)) if commands is None else np.array(commands, dtype=float)
        read, jy, jp = np.empty(sensors), np.zeros((sensors, self.states)), np.zeros((sensors, max(1, affected)))
        self.kernels.sensed(0.0, state, given, self.parameters(self.start()), np.zeros(sensors), read, jy, jp)
        return read, jy

    def normal_equations(
        self,
        basis: tuple[Array, Array],
        start: Array,
        commands: Array,
        readings: Array,
        weights: Array,
        *,
        rate: float,
        substeps: int,
        hold: Hold = "zero-order",
    ) -> NormalEquations:
        """Return the normal equations at values of the parameters and of the initial state.

        Args:
            basis: what `basis` returns for values of the parameters.
            start: the twin's state (states,) at the first sample.
            commands: of the actuators at each sample (m, actuators).
            readings: of the sensors (m, sensors).
            weights: of squared residuals of each sensor (sensors,): 1 / variance.
            rate: samples per second.
            substeps: integration steps between samples.
            hold: of the commands between samples; after the last they are constant.

        Raises:
            IntegrationError: the motion is no longer finite.
            ModelError: `hold` is not known.
        """
        p, columns = basis
        k = len(self.names)
        size = k + self.states
        matrix, gradient, squares = np.zeros((size, size)), np.zeros(size), np.zeros(len(self.twin.sensors))
        y, simulated = np.array(start, dtype=float), np.empty((len(commands), len(squares)))
        sens = np.hstack([np.zeros((self.states, k)), np.eye(self.states)])
        status = self.kernels.normal(
            len(commands), 1.0 / rate, substeps, is_first_order(hold), y, sens, p, columns,
            np.ascontiguousarray(commands, dtype=float), np.ascontiguousarray(readings, dtype=float),
            np.ascontiguousarray(weights, dtype=float), matrix, gradient, squares, simulated,
        )  # fmt: skip
        if status:
            raise IntegrationError("the simulated motion is no longer finite")
        matrix += np.tril(matrix, -1).T
        return NormalEquations(matrix, gradient, squares, simulated, y)


# `_between` writes the command at a sample, and its change over half an integration step, the time between the stages
# of a step; `_follow` and `_move` leave the command at the end of their step in `u`.
SIMULATE = """
@compiled
def _between(commands, index, substeps, straight, u, rise):
    for j in range(commands.shape[1]):
        u[j], rise[j] = commands[index, j], 0.0
        if straight != 0 and index + 1 < commands.shape[0]:
            rise[j] = (commands[index + 1, j] - commands[index, j]) / (2 * substeps)


@compiled
def _follow(t, y, u, rise, p, h, work):
    state = work[4]
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        for i in range({states}):
            state[i] = y[i] + (c * h * work[stage - 1, i] if stage > 0 else 0.0)
        if stage == 1 or stage == 3:
            for j in range(u.shape[0]):
                u[j] += rise[j]
        twin_derivative(t + c * h, state, u, p, work[stage])
    for i in range({states}):
        y[i] += h / 6.0 * (work[0, i] + 2.0 * (work[1, i] + work[2, i]) + work[3, i])


@compiled
def simulate(count, dt, substeps, straight, y, p, commands, readings, work):
    noise, channels, h = work[5][: readings.shape[1]], commands.shape[1], dt / substeps
    u, rise = work[6][:channels], work[7][:channels]
    noise[:] = 0.0
    for index in range(count):
        t = index * dt
        sense_under(t, y, commands[index], p, noise, readings[index])
        if straight == 0:
            advance(t, y, commands[index], p, dt, substeps, work)
            continue
        _between(commands, index, substeps, straight, u, rise)
        for step in range(substeps):
            _follow(t + step * h, y, u, rise, p, h, work)
"""
NORMAL = """
@compiled
def _move(t, y, sens, u, rise, p, basis, h, work):
    n, coordinates, affected, k, width = {states}, {coordinates}, {affected}, basis.shape[1], sens.shape[1]
    ks, ss, jy, jp = work[: 4 * n], work[4 * n : 5 * n], work[5 * n : 6 * n], work[6 * n : 7 * n]
    ky, state = work[7 * n : 7 * n + 4], work[7 * n + 4]
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        for i in range(n):
            state[i] = y[i] + (c * h * ky[stage - 1, i] if stage > 0 else 0.0)
            for j in range(width):
                ss[i, j] = sens[i, j] + (c * h * ks[(stage - 1) * n + i, j] if stage > 0 else 0.0)
        if stage == 1 or stage == 3:
            for j in range(u.shape[0]):
                u[j] += rise[j]
        slopes(t + c * h, state, u, p, ky[stage], jy, jp)
        for i in range(coordinates):
            for j in range(width):
                ks[stage * n + i, j] = ss[coordinates + i, j]
        for i in range(coordinates, n):
            row = stage * n + i
            for j in range(width):
                ks[row, j] = 0.0
            for l in range(n):
                by = jy[i, l]
                if by != 0.0:
                    for j in range(width):
                        ks[row, j] += by * ss[l, j]
            for l in range(affected):
                by = jp[i, l]
                if by != 0.0:
                    for j in range(k):
                        ks[row, j] += by * basis[l, j]
    for i in range(n):
        y[i] += h / 6.0 * (ky[0, i] + 2.0 * (ky[1, i] + ky[2, i]) + ky[3, i])
        for j in range(width):
            sens[i, j] += h / 6.0 * (ks[i, j] + 2.0 * (ks[n + i, j] + ks[2 * n + i, j]) + ks[3 * n + i, j])


@compiled
def normal(
    count, dt, substeps, straight, y, sens, p, basis, commands, readings, weights, matrix, gradient, squares,
    simulated, work
):
    n, affected, sensors, k, width = {states}, {affected}, {sensors}, basis.shape[1], sens.shape[1]
    top = 7 * n + 5
    jy, jp = work[top : top + sensors], work[top + sensors : top + 2 * sensors]
    top += 2 * sensors
    noise, s, row = work[top][:sensors], work[top + 1][:sensors], work[top + 2]
    u, rise = work[top + 3][: commands.shape[1]], work[top + 4][: commands.shape[1]]
    h = dt / substeps
    work[:] = 0.0
    for index in range(count):
        t = index * dt
        sensed(t, y, commands[index], p, noise, s, jy, jp)
        for o in range(sensors):
            residual = readings[index, o] - s[o]
            if not math.isfinite(residual):
                return 1
            simulated[index, o] = s[o]
            squares[o] += residual * residual
            for j in range(width):
                total = 0.0
                for l in range(n):
                    total += jy[o, l] * sens[l, j]
                row[j] = total
            for j in range(k):
                total = 0.0
                for l in range(affected):
                    total += jp[o, l] * basis[l, j]
                row[j] += total
            for i in range(width):
                weighted = weights[o] * row[i]
                gradient[i] += weighted * residual
                for j in range(i + 1):
                    matrix[i, j] += weighted * row[j]
        _between(commands, index, substeps, straight, u, rise)
        for step in range(substeps):
            _move(t + step * h, y, sens, u, rise, p, basis, h, work)
    return 0
"""


def _beside(theta: Array, i: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return values with one of them a little smaller and a little larger, neither beyond its bounds."""
    step = _STEP * (abs(theta[i]) or 1.0)
    low, high = bounds
    behind, ahead = theta.copy(), theta.copy()
    behind[i] = max(theta[i] - step, min(low[i], theta[i]))
    ahead[i] = min(theta[i] + step, max(high[i], theta[i]))
    return behind, ahead
