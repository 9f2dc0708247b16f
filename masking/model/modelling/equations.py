"""Equations of motion M(t, q, v, p) a = f(t, q, v, u, p), derived symbolically from a declaration.

A declaration states them explicitly, implicitly (accelerations on both sides) or by a Lagrangian with Rayleigh's
dissipation and generalised forces.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from masking.compile.codegen.linear_systems import solve
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.lazy_imports import typeset
from masking.model.declaration import schema
from masking.model.declaration.couplings import driven_outputs, motion_rate
from masking.model.declaration.expression import Expression
from masking.model.declaration.model_checks import equation_of
from masking.model.declaration.operations import delay_function
from masking.model.modelling.gradient import gradient, jacobian, rate

_PART = 1e-9  # of a combination of equations: a smaller one is none of it


@dataclass(frozen=True)
class Symbols:
    """The symbols of a model: time, per coordinate its value, velocity and acceleration, inputs, parameters, states.

    The state vector is y = [q, v, s]: coordinates, velocities, internal states. Every function that takes q and v
    apart keeps the arguments (t, q, v, u, p): its `v` holds the n velocities and then the internal states, s[i] at
    v[n + i].
    """

    t: sp.Symbol
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    a: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]
    s: tuple[sp.Symbol, ...] = ()

    @property
    def by_name(self) -> dict[str, sp.Symbol]:
        """Every symbol by the name that declarations use, such as x1, x1' and x1''."""
        return {s.name: s for s in (self.t, *self.q, *self.v, *self.a, *self.u, *self.p, *self.s)}


@dataclass(frozen=True)
class Lag:
    """A delayed expression: the symbol that stands for it, what is delayed, and by how long."""

    symbol: sp.Symbol
    value: sp.Expr
    time: sp.Expr


@dataclass(frozen=True)
class Events:
    """The events of a model."""

    names: tuple[str, ...]  # of the events
    conditions: tuple[sp.Expr, ...]  # an event is where its condition crosses zero upwards
    values: tuple[sp.Expr, ...]  # what jumps, afterwards
    # for each value, the index of its event and that of the state in y = [q, v, s]
    targets: tuple[tuple[int, int], ...]


@dataclass(frozen=True, repr=False)
class Equations:
    """The equations of a declared model in sympy; each part is derived when first asked for."""

    declaration: schema.ModelDeclaration
    _lags: dict[sp.Expr, Lag] = field(default_factory=dict, compare=False)

    def __repr__(self) -> str:
        return f"<Equations of {self.name} in {', '.join(self.coordinates or self.declaration.states)}>"

    def __str__(self) -> str:
        return "\n".join(f"{left} = {right}" for left, right in self.pairs)

    def _repr_latex_(self) -> str:
        return typeset.latex(self.pairs)

    @property
    def pairs(self) -> list[tuple[sp.Expr, sp.Expr]]:
        """Both sides of each equation: of motion, of internal states, of outputs, and of the energy E, if any."""
        d = self.declaration
        left = [*(self.mass * sp.Matrix(self.symbols.a)), *(sp.Symbol(f"{name}'") for name in d.states)]
        found = [*zip(left, map(self.written, [*self.force, *self.rates]), strict=True)]
        found += [(sp.Symbol(name), self.output(name)) for name in d.outputs]
        return found if self.energy is None else [*found, (sp.Symbol("E"), self.energy)]

    @property
    def name(self) -> str:
        """Model's name, for messages."""
        return self.declaration.name

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(self.declaration.coordinates)

    @cached_property
    def symbols(self) -> Symbols:
        """Sympy symbols; all are real."""

        def make(names: Iterable[str], primes: str = "") -> tuple[sp.Symbol, ...]:
            return tuple(sp.Symbol(name + primes, real=True) for name in names)

        q, v, a = (make(self.coordinates, primes) for primes in ("", "'", "''"))
        d = self.declaration
        return Symbols(sp.Symbol("t", real=True), q, v, a, make(d.inputs), make(d.parameters), make(d.states))

    @cached_property
    def definitions(self) -> dict[str, sp.Expr]:
        """Named sub-expressions, each in symbols of the model."""
        found: dict[str, sp.Expr] = {}
        pending = dict(self.declaration.definitions)
        while pending:  # the declaration has been checked for cycles
            for name, expression in list(pending.items()):
                if not expression.names & pending.keys():
                    found[name] = self._without_delays(expression.to_sympy(self.symbols.by_name | found))
                    del pending[name]
        return found

    def symbolic(self, expression: Expression, more: Mapping[str, sp.Symbol] = MappingProxyType({})) -> sp.Expr:
        """Declared expression in symbols of the model, and `more` by their names."""
        return self._without_delays(expression.to_sympy({**self.symbols.by_name, **self.definitions, **more}))

    def _without_delays(self, expression: sp.Expr) -> sp.Expr:
        """Expression with a symbol in place of each of its delayed expressions, which `lags` then has."""
        function = delay_function()
        delayed = sorted(expression.atoms(function), key=str) if expression.has(function) else []
        s = self.symbols
        for one in delayed:
            value, time = one.args
            if value.free_symbols - {s.t, *s.q, *s.v, *s.s, *s.p} or value.has(function):
                raise ModelError(
                    f"{self.name}: delay({value}, {time}): what is delayed is made of coordinates, velocities, "
                    "internal states, parameters and time, without inputs, accelerations and further delays"
                )
            if time.free_symbols - set(s.p) or time.is_nonpositive:
                raise ModelError(
                    f"{self.name}: delay({value}, {time}): a delay is a positive number, made of parameters alone"
                )
            if one not in self._lags:
                self._lags[one] = Lag(sp.Symbol(f"delay__{len(self._lags)}", real=True), value, time)
        return expression.xreplace({one: self._lags[one].symbol for one in delayed})

    @cached_property
    def lags(self) -> tuple[Lag, ...]:
        """Delayed expressions of the equations of motion and of the internal states."""
        _ = self.mass, self.rates, self.energy, [self.output(name) for name in self.declaration.outputs]
        return tuple(self._lags.values())

    def written(self, expression: sp.Expr) -> sp.Expr:
        """Expression with its delays as they are written, to be shown."""
        delay = delay_function()
        return expression.xreplace({lag.symbol: delay(lag.value, lag.time) for lag in self.lags})

    @cached_property
    def laws(self) -> dict[str, sp.Expr]:
        """Force that each element with a law of its own makes, in symbols of the model."""
        found, names = {}, self.symbols.by_name | self.definitions
        for name, element in self.declaration.elements.items():
            if element.force is not None:
                moved = {"d": element.displacement, "d_rate": motion_rate(self.declaration, element)}
                motion = {key: self.symbolic(x) for key, x in moved.items() if x is not None}
                found[name] = self._without_delays(element.force.to_sympy(names | motion))
        return found

    def acting(self, name: str) -> sp.Expr:
        """Return what elements by their own laws add to the equation of a coordinate or state, or to an output."""
        elements = self.declaration.elements
        acts = [(law, elements[e].acts[name]) for e, law in self.laws.items() if name in elements[e].acts]
        return sum((law * self.symbolic(factor) for law, factor in acts), start=sp.Integer(0))

    def output(self, name: str) -> sp.Expr:
        """Output in symbols of the model, with the elements that act on it."""
        found = self.symbolic(self.declaration.outputs[name].expression)
        return found + self.acting(name) if name in driven_outputs(self.declaration) else found

    def measured(self, expression: Expression) -> sp.Expr:
        """Return what a sensor measures in symbols of the model: outputs may stand in it by their names."""
        known = self.symbols.by_name | self.definitions
        held = [name for name in self.declaration.outputs if name in expression.names and name not in known]
        return expression.to_sympy(known | {name: self.output(name) for name in held})

    @cached_property
    def _system(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        if self.declaration.lagrangian is not None:
            return self._euler_lagrange(self.symbolic(self.declaration.lagrangian))
        return self._collect_accelerations()

    @property
    def mass(self) -> sp.ImmutableMatrix:
        """M (n, n) of M a = f."""
        return self._system[0]

    @property
    def force(self) -> sp.ImmutableMatrix:
        """F (n, 1) of M a = f."""
        return self._system[1]

    @cached_property
    def accelerations(self) -> tuple[sp.Expr, ...]:
        """Accelerations as explicit expressions of time, state, inputs and parameters."""
        if not self.coordinates:
            return ()
        algebra = _Symbolic(frozenset((self.symbols.t, *self.symbols.q, *self.symbols.v, *self.symbols.s)))
        solution, _ = solve(algebra, self.mass.tolist(), self.force.tolist())
        return tuple(row[0] for row in solution)

    @cached_property
    def rates(self) -> tuple[sp.Expr, ...]:
        """Rates of the internal states as expressions of time, state, inputs and parameters."""
        return tuple(self._rate(name, *sides) for name, sides in self.declaration.rates.items())

    def _rate(self, name: str, left: Expression, right: Expression) -> sp.Expr:
        """Rate of an internal state, for which its equation, linear in it, is solved."""
        factor, rest = self._in_rate(name, left, {})
        return (self.symbolic(right) + self.acting(name) - rest) / factor

    def _in_rate(self, name: str, left: Expression, values: Mapping[sp.Symbol, float]) -> tuple[sp.Expr, sp.Expr]:
        """Factor of a rate on the left side of its equation, refused where it is 0 at some values, and the rest."""
        own = sp.Symbol(f"{name}'", real=True)
        side = self.symbolic(left, {own.name: own})
        factor = gradient(side, [own])[0]
        if not factor.free_symbols <= {*self.symbols.p} or factor.xreplace(values) == 0:
            message = f"the factor of {own} is {factor}: it is 0, or may become 0"
            remedy = (
                f"give it parameters alone, with values other than 0, or write {own}: ... and divide the right side"
            )
            problem = left.problem(left.first(own.name), message, remedy)
            raise ModelError(f"{self.name}: {message}; {remedy}", problem)
        return factor, side.xreplace({own: sp.Integer(0)})

    def check_rates(self, values: Mapping[sp.Symbol, float]) -> None:
        """Refuse rates that are not determined at some values of the parameters, with a `ModelError`."""
        for name, (left, _) in self.declaration.rates.items():
            self._in_rate(name, left, values)

    @cached_property
    def events(self) -> Events:
        """Events; none where none are declared."""
        declared, s = self.declaration.events, self.symbols
        states = [symbol.name for symbol in (*s.q, *s.v, *s.s)]
        conditions = tuple(self.symbolic(event.when) for event in declared.values())
        jumps = [(i, states.index(n), x) for i, e in enumerate(declared.values()) for n, x in e.jumps.items()]
        values = tuple(self.symbolic(value) for _, _, value in jumps)
        return Events(tuple(declared), conditions, values, tuple((event, state) for event, state, _ in jumps))

    @cached_property
    def energy(self) -> sp.Expr | None:
        """Energy: as declared, or v dL/dv - L of a Lagrangian; None where neither is given."""
        if self.declaration.energy is not None:
            return self.symbolic(self.declaration.energy)
        if self.declaration.lagrangian is None:
            return None
        lagrangian = self.symbolic(self.declaration.lagrangian)
        momenta = gradient(lagrangian, self.symbols.v)
        return sp.Add(*(v * p for v, p in zip(self.symbols.v, momenta, strict=True))) - lagrangian

    @property
    def input_force(self) -> sp.ImmutableMatrix:
        """Df/du (n, k)."""
        return sp.ImmutableMatrix(jacobian(self.force, self.symbols.u))

    def _collect_accelerations(self) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        residuals: list[sp.Expr] = []
        pure: dict[int, int] = {}
        own = {equation_of(self.declaration, name): name for name in self.coordinates}
        for left, right in self.declaration.motion.items():
            side = self.symbolic(left)
            if side in self.symbols.a:
                pure[self.symbols.a.index(side)] = len(residuals)
            force = self.acting(own[left]) if left in own else sp.Integer(0)
            residuals.append(side - self.symbolic(right) - force)
        others = [i for i in range(len(residuals)) if i not in pure.values()]
        order = [pure[i] if i in pure else others.pop(0) for i in range(len(self.coordinates))]
        mass = jacobian([residuals[i] for i in order], self.symbols.a)
        self._check_linear(mass)
        at_rest = dict.fromkeys(self.symbols.a, sp.Integer(0))
        force = [-residuals[i].xreplace(at_rest) for i in order]
        return sp.ImmutableMatrix(mass), sp.ImmutableMatrix(len(force), 1, force)

    def _check_linear(self, mass: sp.Matrix) -> None:
        """Refuse equations that are not linear in the accelerations."""
        if not (bad := mass.free_symbols & set(self.symbols.a)):
            return
        names = ", ".join(sorted(symbol.name for symbol in bad))
        message = f"{self.name}: the equations are not linear in {names}"
        remedy = (
            "accelerations may appear on both sides, but only to the first power; write an equation that is solved for "
            f"{names}, and the square of a speed as {names.partition(',')[0][:-1]}**2"
        )
        for side in (side for sides in self.declaration.motion.items() for side in sides):
            inside = {
                s for s in self.symbols.a if not jacobian([self.symbolic(side)], [s]).free_symbols.isdisjoint(bad)
            }
            if step := next((side.first(s.name) for s in inside if s.name in side.symbols), None):
                problem = side.problem(step, f"this is not linear in {step.value}", remedy)
                raise ModelError(f"{message}; {remedy}", problem)
        raise ModelError(f"{message}; {remedy}")

    def singular(self, values: Mapping[sp.Symbol, float]) -> ModelError:
        """Error of a mass matrix that is singular at some values: a mass that is 0, or equations that say the same."""
        zero = [p.name for p in self.symbols.p if p in self.mass.free_symbols and values[p] == 0.0]
        crowd, names = ([], []) if zero or not self.declaration.motion else self._dependent(values)
        if len(crowd) < 2:
            stated = f" ({', '.join(f'{name} = 0' for name in zero)})" if zero else ""
            return ModelError(
                f"{self.name}: the matrix of the accelerations is singular at the declared values; look for a mass "
                f"that is 0{stated}, and give it a value above 0 and bounds such as [1e-6, null]"
            )
        given = " and ".join(f"'{left.text}'" for left in crowd)
        message = f"{given} hold the same combination of {' and '.join(names)}, and do not determine each of them"
        remedy = "write equations of which none follows from the others: each body has one of its own"
        return ModelError(
            f"{self.name}: {message}; {remedy}", crowd[-1].problem((0, len(crowd[-1].text)), message, remedy)
        )

    def _dependent(self, values: Mapping[sp.Symbol, float]) -> tuple[list[Expression], list[str]]:
        """Left sides of equations whose accelerations are those of others at some values, and these accelerations."""
        motion = list(self.declaration.motion.items())
        rows = jacobian([self.symbolic(left) - self.symbolic(right) for left, right in motion], self.symbols.a)
        matrix = np.array(rows.subs(values).evalf().tolist(), dtype=float)
        matrix /= np.maximum(np.abs(matrix).max(axis=1, keepdims=True), 1e-300)
        left_vectors, _, right_vectors = np.linalg.svd(matrix)
        crowd = [left for (left, _), x in zip(motion, left_vectors[:, -1], strict=True) if abs(x) > _PART]
        return crowd, [a.name for a, x in zip(self.symbols.a, right_vectors[-1], strict=True) if abs(x) > _PART]

    def _euler_lagrange(self, lagrangian: sp.Expr) -> tuple[sp.ImmutableMatrix, sp.ImmutableMatrix]:
        """M and f of d/dt dL/dv - dL/dq = Q - dR/dv, with Rayleigh's dissipation R and forces Q.

        Forces may hold accelerations to the first power, as those of an added mass do.
        """
        s, declaration = self.symbols, self.declaration
        dissipation = self.symbolic(declaration.dissipation) if declaration.dissipation is not None else sp.Integer(0)
        momenta = gradient(lagrangian, s.v)
        mass = jacobian(momenta, s.v)
        damping, slopes = gradient(dissipation, s.v), gradient(lagrangian, s.q)
        applied = [
            (self.symbolic(declaration.forces[name]) if name in declaration.forces else 0) + self.acting(name)
            for name in self.coordinates
        ]
        inertia = -jacobian(applied, s.a)
        at_rest = dict.fromkeys(s.a, sp.Integer(0))
        moving, rates = (*s.q, s.t, *s.s), (*s.v, sp.Integer(1), *self.rates)
        force = [
            given.xreplace(at_rest) - damping[i] + slopes[i] - rate(momenta[i], moving, rates)
            for i, given in enumerate(applied)
        ]
        if any(mass[i, i] == 0 for i in range(len(s.q))):
            massless = self.coordinates[[mass[i, i] for i in range(len(s.q))].index(0)]
            raise ModelError(
                f"{self.name}: the Lagrangian has no kinetic energy in {massless}'; give {massless} a mass"
            )
        self._check_linear(inertia)
        return sp.ImmutableMatrix(mass + inertia), sp.ImmutableMatrix(len(force), 1, force)


class _Symbolic:
    """Sympy expressions as an algebra for solving linear systems."""

    def __init__(self, varying: frozenset[sp.Symbol]) -> None:
        self.varying = varying

    def number(self, value: float) -> sp.Expr:
        return sp.nsimplify(value)

    def is_number(self, x: sp.Expr, value: float | None = None) -> bool:
        return bool(x.is_number and (value is None or x == sp.nsimplify(value)))  # sympy holds 0 and 0.0 apart

    def varies(self, x: sp.Expr) -> bool:
        return bool(x.free_symbols & self.varying)

    add, sub = staticmethod(operator.add), staticmethod(operator.sub)
    mul, div = staticmethod(operator.mul), staticmethod(operator.truediv)
