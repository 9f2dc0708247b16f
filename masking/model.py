"""Model: equations of motion, symbolic when looked at and compiled when run.

A model is M(t, q, v, p) a = f(t, q, v, u, p) for coordinates q, velocities v, accelerations a, inputs u and
parameters p. It is declared by its equations, explicit or implicit in the accelerations, or by a Lagrangian.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import lazy_loader as lazy
import numpy as np

from masking.compile import store
from masking.compile.graph import Graph, Node
from masking.compile.source import LARGEST_TAYLOR_COST, TAYLOR_ORDER, Module
from masking.compile.taylor import cost, is_analytic
from masking.declaration.expression import Expression
from masking.declaration import schema
from masking.errors import ModelError
from masking.kernels import Kernels, Trajectory
from masking.linear import solve
from masking.scales import Units

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy.load("sympy")


@dataclass(frozen=True)
class Symbols:
    """The symbols of a model: time, and per coordinate its value, velocity and acceleration."""

    t: sp.Symbol
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    a: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]

    @property
    def by_name(self) -> dict[str, sp.Symbol]:
        """Return every symbol by the name that declarations use, such as x1, x1' and x1''."""
        return {s.name: s for s in (self.t, *self.q, *self.v, *self.a, *self.u, *self.p)}


@dataclass(frozen=True)
class Model:
    """A declared system: what moves, by which equations, with which values.

    Args:
        declaration: the content of a model file.
        overrides: parameter values that replace the declared ones, in the declared units.
        is_dimensionless: whether values are measured in the declared scales instead of SI units. The equations
            are the same in both, since they are dimensionally homogeneous.
    """

    declaration: schema.ModelDeclaration
    overrides: Mapping[str, float] = field(default_factory=dict)
    is_dimensionless: bool = False

    @property
    def name(self) -> str:
        """Return the name for people."""
        return self.declaration.name

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the names of the coordinates, in declared order."""
        return tuple(self.declaration.coordinates)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs."""
        return tuple(self.declaration.inputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters; the order of every parameter array."""
        return tuple(self.declaration.parameters)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the names of the outputs."""
        return tuple(self.declaration.outputs)

    @property
    def oscillators(self) -> tuple[str, ...]:
        """Return the coordinates whose oscillations are compared with each other."""
        return tuple(self.declaration.oscillators or self.declaration.coordinates)

    def with_parameters(self, **values: float) -> Model:
        """Return the model with other parameter values, in the declared units; nothing is recompiled."""
        changed = replace(self, overrides={**self.overrides, **values})
        changed.values()
        return changed

    def dimensionless(self) -> Model:
        """Return the model with every value measured in the declared scales.

        Raises:
            ModelError: the model declares no scales, or they cannot express a unit that it uses.
        """
        if self.declaration.scales:
            return replace(self, is_dimensionless=True)
        if self.units.is_plain:
            return self
        raise ModelError(
            f"{self.name} has units but no scales: declare scales, such as "
            "'scales: {time: {value: 1/w1, unit: s}, length: {value: l, unit: m}}'"
        )

    def values(self) -> np.ndarray:
        """Return the parameter array (len(parameters),) in SI units, or in the declared scales."""
        return np.array(list(self.parameter_values().values()), dtype=float)

    def parameter_values(self) -> dict[str, float]:
        """Return the parameters by name, in SI units, or in the declared scales."""
        return self.units.parameter_values(self.overrides, dimensionless=self.is_dimensionless)

    def value(self, parameter: str) -> float:
        """Return one parameter, in SI units, or in the declared scales."""
        return self.parameter_values()[parameter]

    @cached_property
    def units(self) -> Units:
        """Return how the quantities of the model convert to SI units and to its scales."""
        return Units.from_meta(self.declaration, self.kernels.meta["units"])

    def structure(self) -> dict[str, object]:
        """Return all that the compiled functions depend on: the equations, but no values."""
        d = self.declaration
        return {
            **{kind: {n: x.unit for n, x in getattr(d, kind).items()} for kind in ("coordinates", "inputs", "parameters")},
            "definitions": _texts(d.definitions),
            "equations": [[left.text, right.text] for left, right in d.equations.items()],
            "lagrangian": _text(d.lagrangian),
            "dissipation": _text(d.dissipation),
            "forces": _texts(d.forces),
            "outputs": {n: o.expression.text for n, o in d.outputs.items()},
            "energy": _text(d.energy),
            "scales": {n: s.unit for n, s in d.scales.items()},
        }

    # --- symbolic -------------------------------------------------------------------------------------------

    @cached_property
    def symbols(self) -> Symbols:
        """Return the sympy symbols; all are real."""

        def make(names: Sequence[str], primes: str = "") -> tuple[sp.Symbol, ...]:
            return tuple(sp.Symbol(name + primes, real=True) for name in names)

        return Symbols(
            sp.Symbol("t", real=True),
            make(self.coordinates),
            make(self.coordinates, "'"),
            make(self.coordinates, "''"),
            make(self.inputs),
            make(self.parameters),
        )

    @cached_property
    def definitions(self) -> dict[str, sp.Expr]:
        """Return the named sub-expressions, each in symbols of the model."""
        found: dict[str, sp.Expr] = {}
        pending = dict(self.declaration.definitions)
        while pending:  # the declaration has been checked for cycles
            for name, expression in list(pending.items()):
                if not expression.names & pending.keys():
                    found[name] = expression.to_sympy(self.symbols.by_name | found)
                    del pending[name]
        return found

    def symbolic(self, expression: Expression) -> sp.Expr:
        """Return a declared expression in symbols of the model."""
        return expression.to_sympy(self.symbols.by_name | self.definitions)

    @cached_property
    def _system(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        if self.declaration.lagrangian is not None:
            return self._euler_lagrange()
        return self._collect_accelerations()

    @property
    def mass(self) -> sp.ImmutableMatrix:
        """Return M (n, n) of M a = f."""
        return self._system[0]

    @property
    def force(self) -> sp.ImmutableMatrix:
        """Return f (n, 1) of M a = f."""
        return self._system[1]

    @cached_property
    def accelerations(self) -> tuple[sp.Expr, ...]:
        """Return the accelerations as explicit expressions of time, state, inputs and parameters."""
        if not self.coordinates:
            return ()
        algebra = _Symbolic(frozenset((self.symbols.t, *self.symbols.q, *self.symbols.v)))
        solution, _ = solve(algebra, self.mass.tolist(), self.force.tolist())
        return tuple(row[0] for row in solution)

    @cached_property
    def energy(self) -> sp.Expr | None:
        """Return the energy: as declared, or v dL/dv - L of a Lagrangian; None where neither is given."""
        if self.declaration.energy is not None:
            return self.symbolic(self.declaration.energy)
        if self.declaration.lagrangian is None:
            return None
        lagrangian = self.symbolic(self.declaration.lagrangian)
        return sum(v * sp.diff(lagrangian, v) for v in self.symbols.v) - lagrangian

    @property
    def input_force(self) -> sp.ImmutableMatrix:
        """Return df/du (n, k).

        Raises:
            ModelError: an acceleration is not affine in the inputs.
        """
        jacobian = self.force.jacobian(self.symbols.u) if self.inputs else sp.zeros(len(self.coordinates), 0)
        for i, coordinate in enumerate(self.coordinates):
            bad = jacobian[i, :].free_symbols & set(self.symbols.u)
            if bad:
                names = ", ".join(sorted(s.name for s in bad))
                raise ModelError(
                    f"{self.name}: the acceleration of {coordinate} is not affine in {names}; masking needs "
                    "equations in which each input appears to the first power, times anything but an input"
                )
        return jacobian

    def _collect_accelerations(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        residuals: list[sp.Expr] = []
        pure: dict[int, int] = {}
        for left, right in self.declaration.equations.items():
            side = self.symbolic(left)
            if side in self.symbols.a:
                pure[self.symbols.a.index(side)] = len(residuals)
            residuals.append(side - self.symbolic(right))
        others = [i for i in range(len(residuals)) if i not in pure.values()]
        order = [pure[i] if i in pure else others.pop(0) for i in range(len(self.coordinates))]
        residual = sp.Matrix([residuals[i] for i in order])
        zero = dict.fromkeys(self.symbols.a, 0)
        mass = residual.jacobian(self.symbols.a) if self.coordinates else sp.zeros(0, 0)
        if mass.free_symbols & set(self.symbols.a):
            names = ", ".join(sorted(s.name for s in mass.free_symbols & set(self.symbols.a)))
            raise ModelError(
                f"{self.name}: the equations are not linear in {names}; accelerations may appear on both sides, "
                "but only to the first power"
            )
        return sp.ImmutableMatrix(mass), sp.ImmutableMatrix(-residual.subs(zero))

    def _euler_lagrange(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        """Return M and f of d/dt dL/dv - dL/dq = Q - dR/dv, with Rayleigh's dissipation R and forces Q."""
        s, declaration = self.symbols, self.declaration
        lagrangian = self.symbolic(declaration.lagrangian)
        dissipation = self.symbolic(declaration.dissipation) if declaration.dissipation is not None else sp.Integer(0)
        mass, force = sp.zeros(len(s.q), len(s.q)), sp.zeros(len(s.q), 1)
        for i, name in enumerate(self.coordinates):
            momentum = sp.diff(lagrangian, s.v[i])
            for j in range(len(s.q)):
                mass[i, j] = sp.diff(momentum, s.v[j])
            applied = self.symbolic(declaration.forces[name]) if name in declaration.forces else 0
            gyroscopic = sum(sp.diff(momentum, q) * v for q, v in zip(s.q, s.v, strict=True)) + sp.diff(momentum, s.t)
            force[i] = applied - sp.diff(dissipation, s.v[i]) + sp.diff(lagrangian, s.q[i]) - gyroscopic
        if any(mass[i, i] == 0 for i in range(len(s.q))):
            massless = self.coordinates[[mass[i, i] for i in range(len(s.q))].index(0)]
            raise ModelError(f"{self.name}: the Lagrangian has no kinetic energy in {massless}'; give {massless} a mass")
        return sp.ImmutableMatrix(mass), sp.ImmutableMatrix(force)

    # --- compiled -------------------------------------------------------------------------------------------

    @cached_property
    def kernels(self) -> Kernels:
        """Return the compiled functions; from the cache on disk where they have been made before."""
        name = store.key({"model": self.structure()})
        return Kernels(store.load(name, self._source))

    def simulate(
        self,
        times: np.ndarray,
        initial: Mapping[str, float] | None = None,
        inputs: Sequence[float] | None = None,
        tolerance: float = 1e-10,
    ) -> Trajectory:
        """Integrate the model by itself, with constant inputs.

        Args:
            times: monotone times (m,), in seconds, or in units of the time scale.
            initial: values of coordinates (`x1`) and velocities (`x1'`) at the first time, in the declared
                units; what is not given is taken from the declaration.
            inputs: constant inputs (k,); zero where not given.
            tolerance: local relative error.

        Returns:
            states (m, 2 n) and their times.
        """
        state = self.initial_state(initial or {})
        u = np.zeros(len(self.inputs)) if inputs is None else np.asarray(inputs, dtype=float)
        return self.kernels.integrate(np.asarray(times, dtype=float), state, u, self.values(), tolerance=tolerance)

    def initial_state(self, given: Mapping[str, float]) -> np.ndarray:
        """Return the state (2 n,) of given and declared initial values, in SI units or in the declared scales.

        Args:
            given: values by the name of a coordinate (`x1`) or velocity (`x1'`), in the declared units.

        Raises:
            ModelError: a coordinate has no initial value, or a name is no coordinate.
        """
        names = [*self.coordinates, *(f"{c}'" for c in self.coordinates)]
        unknown = [name for name in given if name not in names]
        if unknown:
            raise ModelError(f"initial value of '{unknown[0]}': {self.name} has the states {', '.join(names)}")
        overrides, units = self.overrides, self.units
        second = units.size("s", overrides) if self.is_dimensionless and not units.is_plain else 1.0
        positions, velocities = [], []
        for name, coordinate in self.declaration.coordinates.items():
            value = given.get(name, coordinate.initial)
            if value is None:
                raise ModelError(f"no initial value of {name}: give one, such as 'initial: {{{name}: 0}}'")
            size = units.conversions[coordinate.unit].factor
            if self.is_dimensionless:
                size /= units.size(coordinate.unit, overrides)
            positions.append(value * size)
            velocities.append(given.get(f"{name}'", coordinate.initial_velocity) * size * second)
        return np.array([*positions, *velocities], dtype=float)

    def graph(self, prefix: str = "") -> ModelGraph:
        """Return the equations as a graph of elementary operations, ready to be printed."""
        return ModelGraph.of(self, Graph(), prefix)

    def _source(self) -> str:
        return _module(self).text()


def _text(expression: Expression | None) -> str | None:
    return None if expression is None else expression.text


def _texts(expressions: Mapping[str, Expression]) -> dict[str, str]:
    return {name: expression.text for name, expression in expressions.items()}


class _Symbolic:
    """Sympy expressions as an algebra for solving linear systems."""

    def __init__(self, varying: frozenset[sp.Symbol]) -> None:
        self.varying = varying

    def number(self, value: float) -> sp.Expr:
        return sp.nsimplify(value)

    def is_number(self, x: sp.Expr, value: float | None = None) -> bool:
        return bool(x.is_number and (value is None or x == value))

    def varies(self, x: sp.Expr) -> bool:
        return bool(x.free_symbols & self.varying)

    def add(self, a: sp.Expr, b: sp.Expr) -> sp.Expr:
        return a + b

    def sub(self, a: sp.Expr, b: sp.Expr) -> sp.Expr:
        return a - b

    def mul(self, a: sp.Expr, b: sp.Expr) -> sp.Expr:
        return a * b

    def div(self, a: sp.Expr, b: sp.Expr) -> sp.Expr:
        return a / b


@dataclass
class ModelGraph:
    """The symbols of a model as nodes, and its accelerations computed from them.

    `loads` tells for each symbol's text how the state-space functions read it from their arguments.
    """

    model: Model
    graph: Graph
    symbols: dict[sp.Symbol, Node]
    accelerations: list[Node]
    health: Node

    @classmethod
    def of(
        cls,
        model: Model,
        graph: Graph,
        prefix: str = "",
        known: Mapping[sp.Symbol, Node] | None = None,
    ) -> ModelGraph:
        """Lower a model's equations into a graph.

        Args:
            model: the model.
            graph: the graph to add to.
            prefix: put before the text of each new symbol, so that several models share a graph.
            known: nodes that stand for symbols of the model; the others become new symbols.
        """
        s = model.symbols
        nodes = dict(known or {})
        kinds = [("", (s.t,), True), ("q_", s.q, True), ("v_", s.v, True), ("u_", s.u, False), ("p_", s.p, False)]
        for kind, symbols, varying in kinds:
            for symbol in symbols:
                if symbol not in nodes:
                    text = kind + prefix + symbol.name.rstrip("'")
                    nodes[symbol] = graph.symbol(text, varying=varying)
        if model.coordinates:
            mass = [[graph.lower(e, nodes) for e in row] for row in model.mass.tolist()]
            force = [[graph.lower(e, nodes) for e in row] for row in model.force.tolist()]
            solution, health = solve(graph, mass, force)
        else:
            solution, health = [], graph.number(1.0)
        accelerations = [row[0] for row in solution]
        nodes.update(zip(s.a, accelerations, strict=True))
        return cls(model, graph, nodes, accelerations, health)

    def lower(self, expression: sp.Expr) -> Node:
        """Return the node of an expression in symbols of the model, accelerations included."""
        return self.graph.lower(expression, self.symbols)

    def loads(self, q: str, v: str, u: str = "u", p: str = "p", offset: int = 0) -> dict[str, str]:
        """Return how each symbol is read: `q` and `v` are texts with `{i}` for the index of a coordinate."""
        texts = {}
        s = self.model.symbols
        for symbols, pattern in ((s.q, q), (s.v, v), (s.u, u + "[{i}]"), (s.p, p + "[{i}]")):
            for i, symbol in enumerate(symbols):
                operation = self.graph.operations[self.symbols[symbol]]
                if operation[0] == "symbol":
                    index = i + offset if symbols is s.p else i
                    texts[str(operation[1])] = pattern.format(i=index)
        return texts


def _module(model: Model) -> Module:
    """Return the generated module of a model."""
    lowered = model.graph()
    graph, n = lowered.graph, len(model.coordinates)
    time = lowered.symbols[model.symbols.t]
    states = [lowered.symbols[x] for x in (*model.symbols.q, *model.symbols.v)]
    derivatives = [*states[n:], *lowered.accelerations]
    analytic = is_analytic(graph, [*derivatives, lowered.health])
    use_taylor = n > 0 and analytic and cost(graph, derivatives) <= LARGEST_TAYLOR_COST
    energy = model.energy
    outputs = {name: model.symbolic(output.expression) for name, output in model.declaration.outputs.items()}
    meta = {
        "kind": "model",
        "coordinates": list(model.coordinates),
        "inputs": list(model.inputs),
        "parameters": list(model.parameters),
        "outputs": list(outputs),
        "method": "taylor" if use_taylor else "runge_kutta",
        "has_energy": energy is not None,
        "units": Units.of(model.declaration).to_meta(),
    }
    module = Module(model.name, meta)
    split = lowered.loads("q[{i}]", "v[{i}]")
    joined = {**lowered.loads("y[{i}]", "y[{i}]"), **{f"v_{c}": f"y[{n + i}]" for i, c in enumerate(model.coordinates)}}
    results = [(f"out[{i}]", a) for i, a in enumerate(lowered.accelerations)]
    module.add("accelerations(t, q, v, u, p, out)", graph, results, split, returns=lowered.health)
    module.add(
        "derivative(t, y, u, p, dy)",
        graph,
        [(f"dy[{i}]", d) for i, d in enumerate(derivatives)],
        joined,
        returns=lowered.health,
    )
    lowered_outputs = [(f"out[{i}]", lowered.lower(e)) for i, e in enumerate(outputs.values())]
    module.add("outputs(t, q, v, u, p, out)", graph, lowered_outputs, split)
    if energy is not None:
        module.add("energy(t, q, v, p)", graph, [], split, returns=lowered.lower(energy))
    if use_taylor:
        module.add_coefficients(graph, states, derivatives, time, lowered.health, joined)
        module.add_text(SOLVE_TAYLOR.format(order=TAYLOR_ORDER, size=2 * n))
    module.add_text(SOLVE_RUNGE_KUTTA.format(size=2 * n))
    return module


SOLVE_TAYLOR = """
_taylor = integrate.taylor(coefficients, {order}, {size})


@compiled
def solve_taylor(t, y, times, u, p, tolerance, fixed_step, out):
    return _taylor(t, y, times, u, p, tolerance, fixed_step, out)
"""
SOLVE_RUNGE_KUTTA = """
_runge_kutta = integrate.runge_kutta(derivative, {size})


@compiled
def solve_runge_kutta(t, y, times, u, p, tolerance, fixed_step, out):
    return _runge_kutta(t, y, times, u, p, tolerance, fixed_step, out)
"""
