"""Sensitivity: simulated readings of a twin under recorded commands, and their derivatives by its parameters.

Sensors that round are simulated without rounding: rounded readings most likely lie near these values. Readings are
simulated from an initial state, with their derivatives by chosen parameters and by that state. The chain rule gives the
derivatives from the equations, and they are compiled together. The normal equations, which a least-squares fit needs,
are accumulated sample by sample, so that derivatives take no memory; see `numerics.motion_sensitivities`.
Source: Ljung, System Identification (1999), section 10.3; Hairer, Norsett and Wanner (1993), section I.14.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from masking.compile.codegen import column_step, module_store
from masking.compile.codegen.compiled_functions import Kernels, linked
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.llvm_text import Results
from masking.compile.codegen.tangent import derivatives, jacobian
from masking.compile.numerics.arrays import Array, IntMatrix
from masking.compile.numerics.kernel_arguments import Readings, Shooting, Steps, Sums, TwinArrays
from masking.compile.numerics.rig_sizes import COLUMN_ROWS, RigSizes, whole_lanes
from masking.control.rig.twin import LoweredTwin, Twin
from masking.errors import IntegrationError, ModelError, nearest
from masking.inference.estimation.identification_data import Data, is_first_order
from masking.lab.records.record_form import Hold
from masking.lazy_imports import motion_sensitivities

# Functions of a twin: its equations and its readings, alone and with derivatives by state and parameter array.
RATES, SLOPES = "rates(t: float, y, u, p, dy)", "slopes(t: float, y, u, p, dy, jy: Matrix, jp: Matrix)"
SENSED = "sensed(t: float, y, u, p, noise, s, jy: Matrix, jp: Matrix)"
SIGNATURES = RATES, SLOPES, SENSED

_STEP = 1e-6  # relative, of the differences that tell how the parameters depend on each other


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of a record for parameters and initial state, the columns in this order."""

    matrix: Array  # J^T W J (k + states, k + states) for the derivatives J of the readings
    gradient: Array  # J^T W r (k + states,) for the residuals r, measured less simulated
    squares: Array  # sum of squared residuals of each sensor (sensors,)
    simulated: Array  # what the sensors would read (m, sensors)
    end: Array  # the state at the end of the record (states,)


@dataclass(frozen=True)
class Sensitivity:
    """A twin with the parameters that may change."""

    twin: Twin  # the rig
    # parameters of its model, those of the effects in its elements included (`friction1_fc`), and of effects in its
    # sensors and actuators (`offset_s1_e0`)
    names: tuple[str, ...]
    # parameters that others of the same twin may change, whose derivatives are compiled too, so that all have the same
    # functions
    shared: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise ModelError(f"parameters are named twice: {', '.join(twice)}")
        for name in self._compiled:
            if name not in self.twin.parameter_names:
                remedy = nearest(name, self.twin.parameter_names)
                raise ModelError(f"{self.twin.declaration.name} has no parameter '{name}'; {remedy}")

    @property
    def _compiled(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.names, *self.shared)))

    def twin_at(self, theta: Array) -> Twin:
        """Twin with values (k,) of the parameters, in the units in which they are declared."""
        return self.twin.with_parameters(dict(zip(self.names, map(float, theta), strict=True)))

    @cached_property
    def _unrounded(self) -> Twin:
        return self.twin.unrounded()

    def start(self) -> Array:
        """Values of the parameters (k,) that the twin declares, in declared units."""
        return np.array([self.twin.parameter_value(name) for name in self.names])

    def bounds(self) -> tuple[Array, Array]:
        """Least and the largest allowed value of each parameter (k,), in declared units."""
        pairs = [self.twin.parameter_bounds(name) for name in self.names]
        low = np.array([-np.inf if a is None else a for a, _ in pairs])
        return low, np.array([np.inf if b is None else b for _, b in pairs])

    def parameters(self, theta: Array) -> Array:
        """Twin's parameter array for values (k,) of the parameters, with sensors that do not round."""
        return self._unrounded.with_parameters(dict(zip(self.names, map(float, theta), strict=True))).values()

    @cached_property
    def dead_times(self) -> dict[int, int]:
        """Number of the actuator of each parameter that is a dead time, by the number of the parameter."""
        found = {f"{e.label}_{e.entry.grows_with}": e.at for e in self.twin.dead_times}
        return {i: self.twin.actuators.index(found[name]) for i, name in enumerate(self.names) if name in found}

    def later(self, theta: Array, record: Data) -> Data:
        """Record whose commands are as late as dead times (k,) say, in the place of the twin's own."""
        late = record.late.copy()
        for i, actuator in self.dead_times.items():
            late[actuator] += record.rate * (theta[i] - self.twin.parameter_value(self.names[i]))
        return replace(record, late=late) if self.dead_times else record

    def basis(self, theta: Array) -> tuple[Array, Array]:
        """Twin's parameter array, and how its entries depend on the parameters (affected, k)."""
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
        """Indices in the twin's parameter array of all that depend on the parameters and shared ones."""
        if self.shared:
            return Sensitivity(self.twin, self._compiled).affected
        theta, touched, bounds = self.start(), set[int](), self.bounds()
        before = self.parameters(theta)
        for i in range(len(theta)):
            for changed in _beside(theta, i, bounds):
                touched |= set(np.flatnonzero(self.parameters(changed) != before).tolist())
        return tuple(sorted(touched))

    @property
    def columns(self) -> list[str]:
        """What the compiled derivatives are by: affected entries of the parameter array, and commands that are late."""
        late = len(self.twin.actuators) if self.twin.dead_times else 0
        return [*(f"p[{i}]" for i in self.affected), *(f"u[{i}]" for i in range(late))]

    @property
    def states(self) -> int:
        """Length of the twin's state."""
        return len(self.twin.state_names)

    @cached_property
    def kernels(self) -> Kernels:
        """Normal equations, linked to the twin's."""
        return accumulation(self.equations, self.sizes, max(self.states + len(self._compiled), *self.widths))

    @cached_property
    def equations(self) -> Kernels:
        """Compiled equations and readings of the twin, and their derivatives."""
        key = module_store.key({"sensitivity": [self.twin.structure(), list(self.affected)]})
        return Kernels(module_store.load(key, self._build))

    def _build(self) -> Module:
        name = self.twin.declaration.name
        module = Module(f"{name}, with derivatives", {"kind": "sensitivity", **self.twin.state_kinds})
        add_slopes(module, LoweredTwin(self.twin), self.columns)
        return module

    @property
    def sizes(self) -> RigSizes:
        """Sizes of the work space of kernels."""
        return RigSizes(self.states, len(self.twin.model.coordinates), len(self.twin.sensors))

    @property
    def widths(self) -> tuple[int, ...]:
        """Lengths of state, of columns of derivatives, and of readings that are added at once."""
        return self.states, len(self.affected) + len(self.twin.actuators), self.sizes.added_rows

    def simulate(
        self, theta: Array, start: Array, commands: Array, *, rate: float, substeps: int, hold: Hold = "zero-order"
    ) -> Array:
        """Simulated readings (m, sensors) without noise.

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
        nothing = np.zeros((len(commands), len(self.twin.sensors)))
        record = Data("simulated", rate, commands, nothing, hold=hold)
        return self.normal_equations(self.basis(theta), start, record, np.ones(nothing.shape[1]), substeps).simulated

    def sensed(self, state: Array, commands: Array | None = None, theta: Array | None = None) -> tuple[Array, Array]:
        """Readings in a state of the twin (sensors,), and their derivatives by it (sensors, states).

        Sensors may read commands (actuators,) at once; these are 0 by default, and parameters (k,) as declared.
        """
        sensors, width = len(self.twin.sensors), max(1, len(self.columns))
        given = np.zeros(len(self.twin.actuators)) if commands is None else np.array(commands, dtype=float)
        read, jy, jp = np.empty(sensors), np.zeros((sensors, self.states)), np.zeros((sensors, width))
        p = self.parameters(self.start() if theta is None else theta)
        self.equations.sensed(0.0, state, given, p, np.zeros(sensors), read, jy, jp)
        return read, jy

    def normal_equations(
        self, basis: tuple[Array, Array], start: Array, record: Data, weights: Array, substeps: int
    ) -> NormalEquations:
        """Normal equations at values of the parameters and of the initial state.

        Args:
            basis: what `basis` returns for values of the parameters.
            start: the twin's state (states,) at the first sample.
            record: commands, which are constant after the last sample, and readings.
            weights: of squared residuals of each sensor (sensors,): 1 / variance.
            substeps: integration steps between samples.

        Raises:
            IntegrationError: the motion is no longer finite.
        """
        (p, columns), count, states = basis, len(record), self.states
        size, affected = len(self.names) + states, len(columns)
        matrix, gradient, squares = np.zeros((size, whole_lanes(size))), np.zeros(size), np.zeros(len(weights))
        y, simulated = np.empty(states), np.empty((count, len(squares)))
        derivatives = np.zeros((COLUMN_ROWS * states, whole_lanes(size)))
        steps = Steps(count, 1.0 / record.rate, substeps, is_first_order(record.hold))
        shooting = Shooting(len(self.names), np.arange(states), np.array([start], dtype=float), y, derivatives)
        late_columns = np.full(len(self.twin.actuators), -1)
        late_columns[[*self.dead_times.values()]] = [*self.dead_times]
        delayed = record.late, affected, late_columns, np.empty(len(late_columns))
        arrays = TwinArrays(p, *terms(self.equations, columns), self.sizes.coordinates, *delayed)
        readings = Readings(record.commands, record.counted(), np.ascontiguousarray(weights, dtype=float))
        sums = Sums(matrix, gradient, squares, simulated)
        if self.kernels.normal(steps, max(count, 1), shooting, arrays, readings, sums):
            raise IntegrationError("the simulated motion is no longer finite")
        return NormalEquations(symmetric(matrix), gradient, squares, simulated, y)


def accumulation(equations: Kernels, sizes: RigSizes, width: int) -> Kernels:
    """Kernel `normal`, see `motion_sensitivities.normal_equations`, for equations made from `with_derivatives`.

    `width` is the length of the longest rows that it works with.
    """

    def factories() -> dict[str, tuple[Any, ...]]:
        return {"normal": (motion_sensitivities.normal_equations, "slopes", "sensed", "carry")}

    links = {**equations.by_signature(SLOPES, SENSED), **column_step.link(sizes.states, sizes.coordinates)}
    return linked("normal equations", factories, links, (sizes.work_rows, whole_lanes(width)))


def symmetric(lower: Array) -> Array:
    """Symmetric matrix (n, n) of its lower triangle (n, n or more), as kernels write it."""
    square = np.tril(lower[:, : len(lower)])
    return np.asarray(square + np.tril(square, -1).T)


def terms(equations: Kernels, basis: Array) -> tuple[IntMatrix, Array, IntMatrix, Array]:
    """Terms of (df/dp) B in rates and in readings with their values of B (affected, k), as `variational` takes them."""
    found = list[Any]()
    for pairs in equations.meta["depends"]:
        rows, entries = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        is_known = entries < len(basis)  # no parameter is a command
        rows, entries = rows[is_known], entries[is_known]
        at, columns = np.nonzero(basis[entries])
        found += [np.array([rows[at], entries[at], columns], dtype=np.int64), basis[entries[at], columns]]
    moved, moved_by, read, read_by = found
    return moved, moved_by, read, read_by


class Lowered(Protocol):
    """Rates of a state and readings as nodes of a graph, by the texts that they are assigned to; see `LoweredTwin`."""

    graph: Graph
    loads: dict[str, str]  # what reads each symbol, by its text
    derivatives: list[tuple[str, Node]]  # rates of the state
    readings: list[tuple[str, Node]]


def with_derivatives(
    lowered: Lowered, columns: Sequence[str]
) -> tuple[list[list[tuple[int, int]]], dict[str, Results]]:
    """Equations of a twin and its readings with derivatives by the state and by what `columns` read, as `p[3]`, `u[0]`.

    Derivatives that are 0 everywhere are left out. Returns the row and the column of the others by columns, of rates
    and of readings, and the results of `slopes` and `sensed`.
    """
    graph, by_text = lowered.graph, {text: name for name, text in lowered.loads.items()}
    at = [i for i in range(len(lowered.derivatives)) if f"y[{i}]" in by_text]
    y = [graph.symbol(by_text[f"y[{i}]"], varying=True) for i in at]
    given = [graph.symbol(by_text.get(text, f"unused_{i}"), varying=False) for i, text in enumerate(columns)]
    depends, made = list[list[tuple[int, int]]](), dict[str, Results]()
    for signature, results in ((SLOPES, lowered.derivatives), (SENSED, lowered.readings)):
        nodes = [node for _, node in results]
        found = {
            (i, m): node
            for i, row in enumerate(derivatives(graph, nodes, given))
            for m, node in enumerate(row)
            if not graph.is_number(node, 0.0)
        }
        depends.append([*found])
        by_state = [(x, node) for x, node in jacobian(graph, "jy", nodes, y, at) if not graph.is_number(node, 0.0)]
        made[signature] = [*results, *by_state, *((f"jp[{i}, {m}]", node) for (i, m), node in found.items())]
    return depends, made


def add_slopes(module: Module, lowered: Lowered, columns: Sequence[str]) -> None:
    """Add the equations of a twin as `rates`, and those and its readings `with_derivatives`.

    `depends` of the module's `meta` says which derivatives there are.
    """
    module.meta["depends"], made = with_derivatives(lowered, columns)
    for signature, results in {RATES: lowered.derivatives, **made}.items():
        module.add(signature, lowered.graph, results, lowered.loads)


def _beside(theta: Array, i: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
    """Values with one of them a little smaller and a little larger, neither beyond its bounds."""
    step = _STEP * (abs(theta[i]) or 1.0)
    low, high = bounds
    behind, ahead = theta.copy(), theta.copy()
    behind[i] = max(theta[i] - step, min(low[i], theta[i]))
    ahead[i] = min(theta[i] + step, max(high[i], theta[i]))
    return behind, ahead
