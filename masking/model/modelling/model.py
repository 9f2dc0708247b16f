"""Model: equations of motion, symbolic when looked at and compiled when run.

A model is M(t, q, v, s, p) a = f(t, q, v, s, u, p) for coordinates q, velocities v, accelerations a, inputs u and
parameters p. It is declared by its equations, explicit or implicit in the accelerations, or by a Lagrangian. Internal
states s, such as that of a friction, have equations ds/dt = g(t, q, v, s, u, p) of their own; most models have none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from masking.compile.codegen.compiled_functions import Compiled
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.trajectory import Trajectory
from masking.display import fragments, symbols
from masking.errors import DeclarationError, ModelError
from masking.lazy_imports import control, typeset
from masking.lazy_imports import sympy as sp
from masking.model.declaration import registry, schema
from masking.model.declaration.catalogue import Reference
from masking.model.declaration.couplings import motions
from masking.model.declaration.dimensions import check_dimensions, check_scales
from masking.model.declaration.units import pretty
from masking.model.effects import Effect, Setting, attach, with_own
from masking.model.modelling import ensembles, input_series
from masking.model.modelling.affine_equations import AffineEquations
from masking.model.modelling.equations import Equations
from masking.model.modelling.lowering import module
from masking.model.modelling.scales import Shown, Units


def load_model(name_or_path: str | Path, counts: Mapping[str, int] | None = None) -> Model:
    """Declared model.

    Args:
        name_or_path: a name that `masking list` shows, or a YAML file.
        counts: that replace those which the file declares under `repeat`, such as `{"N": 100}`.

    Raises:
        DeclarationError: there is no such model, or its declaration is wrong; lists every problem with its place.
    """
    return Model(registry.load_model(name_or_path, Reference(counts=counts or {})))


@dataclass(frozen=True)
class Model(Compiled):
    """A declared system: what moves, by which equations, with which values.

    Args:
        declaration: the content of a model file.
        overrides: parameter values that replace the declared ones, in the declared units.
        is_dimensionless: whether values are measured in the declared scales instead of SI units. The equations
            are the same in both, since they are dimensionally homogeneous.
        is_affine: whether an input that acts nonlinearly stands for what it does; see `affine`.
    """

    declaration: schema.ModelDeclaration
    overrides: Mapping[str, float] = field(default_factory=dict)
    is_dimensionless: bool = False
    is_affine: bool = False

    def __post_init__(self) -> None:
        if self.declaration.effects:
            object.__setattr__(self, "declaration", with_own(self.declaration))

    def __repr__(self) -> str:
        return f"<Model {self.name}: {self._size_in_words}>"

    def _repr_html_(self) -> str:
        d, parts = self.declaration, [typeset.equations(self.equations.pairs)]
        units = Units.of(d)  # without compiling the model
        values = units.parameter_values(self.overrides, dimensionless=False)
        shown = {name: f"{values[name] / units.conversions[p.unit].factor:.6g}" for name, p in d.parameters.items()}
        rows = [(symbols.markup(name), shown[name], pretty(p.unit), p.meaning) for name, p in d.parameters.items()]
        parts.append(fragments.table(("parameter", "value", "unit", "meaning"), rows, numbers=(1,)))
        if d.events:
            said = [(name, event.when.text, event.written, event.meaning) for name, event in d.events.items()]
            parts.append(fragments.table(("event", "where this crosses zero upwards", "jumps", "meaning"), said))
        return fragments.card(self.name, self._size_in_words, *parts)

    @property
    def _size_in_words(self) -> str:
        kinds = {"coordinates": self.coordinates, "states": self.states, "inputs": self.inputs}
        kinds |= {"events": tuple(self.declaration.events)}
        named = [f"{kind} {', '.join(names)}" for kind, names in kinds.items() if names]
        return "; ".join([*named, f"{len(self.parameters)} parameters"])

    @property
    def name(self) -> str:
        """Name for people."""
        return self.declaration.name

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, in declared order."""
        return tuple(self.declaration.coordinates)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the internal states, which follow coordinates and velocities in the state vector."""
        return tuple(self.declaration.states)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.declaration.inputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters; the order of every parameter array."""
        return tuple(self.declaration.parameters)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.declaration.outputs)

    @cached_property
    def remembered(self) -> tuple[str, ...]:
        """Names of the internal states, and then one for each delayed expression."""
        return (*self.states, *(f"delayed_{i + 1}" for i in range(self.kernels.meta["lags"])))

    def delays(self) -> np.ndarray:
        """Delays, in seconds or in units of the time scale; a `ModelError` says that one is not positive."""
        found = np.zeros(self.kernels.meta["lags"])
        if len(found):
            self.kernels.delays(self.values(), found)
            if not found.min() > 0.0:
                raise ModelError(
                    f"{self.name}: a delay is {found.min():g}; give its parameters values that make it positive"
                )
        return found

    def check_ordinary(self, what: str) -> None:
        """Refuse a model with delays or events for what knows none."""
        self.check_no_delays(what)
        if self.declaration.events:
            raise ModelError(
                f"{self.name} has events, which {what} does not take: its states jump; simulate it, or mask it as a "
                "virtual system"
            )

    def check_no_delays(self, what: str) -> None:
        """Refuse a model with delays for what knows none."""
        if self.kernels.meta["lags"]:
            raise ModelError(
                f"{self.name} has delays, which {what} does not take: its state is a piece of the past; simulate it, "
                "or mask it as a virtual system"
            )

    @property
    def oscillators(self) -> tuple[str, ...]:
        """Coordinates whose oscillations are compared with each other."""
        return tuple(self.declaration.oscillators or self.declaration.coordinates)

    @property
    def is_autonomous(self) -> bool:
        """Whether its equations are without the time."""
        e = self.equations
        return not any(e.symbols.t in x.free_symbols for x in (*e.mass, *e.force, *e.rates))

    def declared_as(self, declaration: schema.ModelDeclaration) -> Model:
        """Model with another declaration, and the same values and units."""
        return replace(self, declaration=declaration)

    @cached_property
    def affine(self) -> Model:
        """Model in which each input appears to the first power: one that acts nonlinearly stands for what it does."""
        return replace(self, is_affine=True) if self.kernels.meta["curved"] else self

    def with_parameters(self, /, **values: float) -> Model:
        """Model with other parameter values, in the declared units; nothing is recompiled."""
        changed = replace(self, overrides={**self.overrides, **values})
        vars(changed).update(kernels=self.kernels, units=self.units)  # neither depends on values
        changed.values()
        return changed

    def attach(self, effect: str | Effect, at: str, *, label: str | None = None, **parameters: Setting) -> Model:
        """Model with a physical effect in one of its elements.

        Args:
            effect: a name of `effects.EFFECTS`, such as `dry_friction`, or an own effect of `effects.load`.
            at: the element that it sits in.
            label: stands before the names of its parameters and states; by default `<at>_<effect>`. The parameter
                `<label>_on` switches it.
            parameters: its values: numbers in coherent SI units, expressions over the model's parameters, or either
                with a unit, `{"value": 5.8, "unit": "mm"}`.

        Raises:
            DeclarationError: there is no such effect, element or parameter, or a value is missing.
        """
        return replace(self, declaration=attach(self.declaration, effect, at, label, parameters))

    def dimensionless(self) -> Model:
        """Model with every value measured in the declared scales.

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
        """Parameter array (len(parameters),) in SI units, or in the declared scales."""
        return np.array(list(self._values.values()), dtype=float)

    def parameter_values(self) -> dict[str, float]:
        """Parameters by name, in SI units, or in the declared scales."""
        return dict(self._values)

    @cached_property
    def _values(self) -> dict[str, float]:
        return self.units.parameter_values(self.overrides, dimensionless=self.is_dimensionless)

    def exact_values(self) -> dict[str, sp.Expr]:
        """Parameters by name as the decimals that are written, in the same units as `parameter_values`."""
        return self.units.exact_values(self.overrides, dimensionless=self.is_dimensionless)

    def value(self, parameter: str) -> float:
        """Return one parameter, in SI units or in the declared scales; a `DeclarationError` says that there is none."""
        self.units.check_names([parameter])
        return self._values[parameter]

    @cached_property
    def units(self) -> Units:
        """How the quantities of the model convert to SI units and to its scales."""
        return Units.from_meta(self.declaration, self.kernels.meta["units"])

    def structure(self) -> dict[str, object]:
        """All that the compiled functions depend on: the equations, but no values."""
        d = self.declaration
        with_units = ("coordinates", "states", "inputs", "parameters")
        return {
            **{kind: {n: x.unit for n, x in getattr(d, kind).items()} for kind in with_units},
            **{kind: {n: x.text for n, x in getattr(d, kind).items()} for kind in ("definitions", "forces")},
            "equations": [[left.text, right.text] for left, right in d.equations.items()],
            **{kind: getattr(getattr(d, kind), "text", None) for kind in ("lagrangian", "dissipation", "energy")},
            "outputs": {n: o.expression.text for n, o in d.outputs.items()},
            **({"events": {n: {p: x.text for p, x in e.formulas} for n, e in d.events.items()}} if d.events else {}),
            "laws": {
                n: [e.force.text, *(x.text for x in motions(e)), *((on, x.text) for on, x in e.acts.items())]
                for n, e in d.elements.items()
                if e.force is not None
            },
            "scales": {n: s.unit for n, s in d.scales.items()},
            **({"inputs_are": "what they do"} if self.is_affine else {}),
        }

    @cached_property
    def equations(self) -> Equations:
        """Equations of motion in sympy."""
        return AffineEquations(self.declaration) if self.is_affine else Equations(self.declaration)

    @property
    def _made_from(self) -> Mapping[str, object]:
        return {"model": self.structure()}

    def simulate(
        self,
        times: np.ndarray,
        initial: Mapping[str, float] | None = None,
        inputs: input_series.Inputs = None,
        tolerance: float = 1e-10,
        ensemble: Mapping[str, Sequence[float] | np.ndarray] | None = None,
    ) -> Trajectory:
        """Integrate the model by itself, once or for each run of an ensemble.

            model.simulate(times, {"x": 0.1}, {"F": Series([0, 1, 2], [0, 0.5, 0], "cubic"), "G": 0.1})
            model.simulate(times, ensemble={"z3": np.linspace(0.1, 0.4, 1000)})["x1"]  # (1000, m)

        Args:
            times: monotone times (m,), in seconds, or in units of the time scale.
            initial: values of coordinates (`x1`), velocities (`x1'`) and internal states at the first time, in the
                declared units; what is not given is as declared, or 0 where nothing is.
            inputs: constant inputs (k,), in SI units or in the declared scales; or each by its name: a number, a
                `Series`, or values at the times (m,), with straight lines between. By default all are zero.
            tolerance: local relative error.
            ensemble: values of each run (runs,), of parameters and initial states by name, in the declared units.

        Returns:
            states (m, 2 n + k), the k internal states last, behind them what delayed expressions were, and their times;
            with an ensemble (runs, m, 2 n + k), and in `errors` which runs could not go on.

        Raises:
            ModelError: the times are none, or inputs by name are not those of the model.
            IntegrationError: the integrator could not go on.
        """
        if ensemble is not None:
            found = ensembles.simulate(self, times, ensemble, initial=initial or {}, inputs=inputs, tolerance=tolerance)
        elif isinstance(inputs, Mapping):
            found = input_series.driven(self, times, initial or {}, inputs, tolerance)
        else:
            times, _ = input_series.row_of_times(times), self.delays()
            u = np.zeros(len(self.inputs)) if inputs is None else np.asarray(inputs, dtype=float)
            state = self.initial_state(initial or {})
            found = self.kernels.integrate(times, state, u, self.values(), tolerance=tolerance)
        return replace(found, units=self.units.computed[self.is_dimensionless])

    def initial_state(self, given: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """State (2 n + k,) of given and declared initial values, else 0, in SI units or in the declared scales.

        Args:
            given: values by the name of a coordinate (`x1`), velocity (`x1'`) or internal state, in the declared
                units; those of several runs (runs,) give states (runs, 2 n + k).

        Raises:
            ModelError: a name is no state.
        """
        return self._begun(given) if given else self._declared_state.copy()

    @cached_property
    def _declared_state(self) -> np.ndarray:
        return self._begun({})

    def _begun(self, given: Mapping[str, float | np.ndarray]) -> np.ndarray:
        unknown = [name for name in given if name not in self.state_names]
        if unknown:
            raise ModelError(
                f"initial value of '{unknown[0]}': {self.name} has the states {', '.join(self.state_names)}"
            )
        second = self.units.size("s", self.overrides) if self.is_dimensionless and not self.units.is_plain else 1.0
        positions, velocities = [], []
        for name, coordinate in self.declaration.coordinates.items():
            size = self._size(coordinate.unit)
            positions.append(given.get(name, coordinate.initial or 0.0) * size)
            velocities.append(given.get(f"{name}'", coordinate.initial_velocity) * size * second)
        states = zip(self.declaration.states.items(), self.first_internal, strict=True)
        internal = [given[n] * self._size(z.unit) if n in given else first for (n, z), first in states]
        parts = [*positions, *velocities, *internal]
        return np.array(np.broadcast_arrays(*parts) if any(map(np.ndim, parts)) else parts, dtype=float).T

    @property
    def first_internal(self) -> np.ndarray:
        """Declared initial values of the internal states, in SI units or in the declared scales (k,)."""
        return np.array([z.initial * self._size(z.unit) for z in self.declaration.states.values()])

    @property
    def first_place(self) -> np.ndarray:
        """Declared initial coordinates, 0 where none is declared, in SI units or in the declared scales (n,)."""
        return np.array([(c.initial or 0.0) * self._size(c.unit) for c in self.declaration.coordinates.values()])

    @property
    def lengths(self) -> np.ndarray:
        """Size of each coordinate, in SI units (n,): that of the scales, else 1."""
        return np.array([self.units.size(c.unit, self.overrides) for c in self.declaration.coordinates.values()])

    def _size(self, unit: str) -> float:
        """Size of a declared unit in SI units, or in the declared scales."""
        size = self.units.conversions[unit].factor
        return size / self.units.size(unit, self.overrides) if self.is_dimensionless else size

    @cached_property
    def shown(self) -> dict[str, Shown]:
        """How each state is shown, by its name as `state_names` has it: divided by the size, it is in the unit."""
        d, found = self.declaration, dict[str, Shown]()
        for is_rate, prime in ((False, ""), (True, "'")):
            found |= {f"{n}{prime}": self.shown_in(c.unit, is_rate=is_rate) for n, c in d.coordinates.items()}
        return found | {n: self.shown_in(z.unit) for n, z in d.states.items()}

    def shown_in(self, unit: str, *, is_rate: bool = False) -> Shown:
        """How what is declared in a unit is shown; as `Units.shown`."""
        return self.units.shown(unit, dimensionless=self.is_dimensionless, is_rate=is_rate)

    def validate(self) -> None:
        """Refuse what can be refused without running: units, equations that cannot be made explicit, values.

        Raises:
            DeclarationError: a declared unit or value is wrong.
            ModelError: the equations cannot be made explicit, or the scales cannot express a unit.
        """
        self._check_units()
        _ = self.kernels  # which are made of explicit equations alone
        self.check_mass()
        if self.declaration.scales:
            self.dimensionless().values()

    def check_mass(self) -> None:
        """Refuse rates or a mass matrix that are singular, or one not positive definite where energy says it must be.

        Raises:
            ModelError: it is, at the declared values and initial coordinates.
        """
        e, s, values = self.equations, self.equations.symbols, self.values()
        e.check_rates(dict(zip(s.p, values, strict=True)))
        if not self.coordinates:
            return
        rest = {c: d.initial or 0.0 for c, d in self.declaration.coordinates.items()}
        point = {q: rest[q.name] for q in s.q} | dict.fromkeys((s.t, *s.v), 0.0) | dict(zip(s.p, values, strict=True))
        point |= {z: self.declaration.states[z.name].initial for z in s.s}
        held = {symbol: sp.Float(point[symbol]) for symbol in e.mass.free_symbols}
        matrix = np.array(e.mass.xreplace(held).evalf().tolist(), dtype=float)
        if np.linalg.matrix_rank(matrix) < len(matrix):
            raise e.singular(point)
        if self.declaration.lagrangian is not None and np.min(np.linalg.eigvalsh(matrix)) <= 0.0:
            raise ModelError(
                f"{self.name}: the kinetic energy is not positive at the declared values: the mass matrix has the "
                f"eigenvalues {', '.join(f'{x:.3g}' for x in np.linalg.eigvalsh(matrix))}; look for a negative mass"
            )

    def linearise(
        self, at: Mapping[str, float] | None = None, inputs: Mapping[str, float] | None = None
    ) -> control.StateSpace:
        """Linear time-invariant system around a state, by symbolic differentiation.

        The states are the coordinates, the velocities, then the internal states; the outputs are the declared
        outputs, or the coordinates where none are declared. Derivatives are exact; away from an equilibrium the
        constant part is left out.

        Args:
            at: values of coordinates, velocities and internal states, in SI units or in the declared scales; 0
                where not given.
            inputs: values of inputs; 0 where not given.

        Raises:
            ModelError: the model has one output and no inputs, which python-control cannot hold.
        """
        self.check_ordinary("a linear system")
        e, s = self.equations, self.equations.symbols
        if not s.u and len(self.outputs or self.coordinates) == 1:
            raise ModelError(
                f"{self.name} has no inputs and one output, which python-control cannot hold; declare 'inputs:', or "
                "take masking.analysis.stability.modes.state_matrix"
            )
        states = (*s.q, *s.v, *s.s)
        point = {symbol: (at or {}).get(symbol.name, 0.0) for symbol in states} | {s.t: 0.0}
        point |= {u: (inputs or {}).get(u.name, 0.0) for u in s.u} | dict(zip(s.p, self.values(), strict=True))
        explicit = dict(zip(s.a, e.accelerations, strict=True))
        rates = sp.Matrix([*s.v, *e.accelerations, *e.rates])
        seen = [e.symbolic(o.expression).subs(explicit) for o in self.declaration.outputs.values()] or list(s.q)

        def number(expressions: sp.Matrix, symbols: Sequence[sp.Symbol]) -> np.ndarray:
            jacobian = expressions.jacobian(symbols) if symbols else sp.zeros(len(expressions), 0)
            for unevaluated in jacobian.atoms(sp.Derivative):  # of floor, which is flat between its steps
                jacobian = jacobian.subs(unevaluated, 0).doit()
            values = jacobian.subs(point).evalf().tolist()
            return np.array(values, dtype=float).reshape(len(expressions), len(symbols))

        matrices = [number(m, w) for m in (rates, sp.Matrix(seen)) for w in (states, s.u)]
        names = {"states": self.state_names, "inputs": [*self.inputs], "outputs": [*(self.outputs or self.coordinates)]}
        return control.ss(*matrices, **names, remove_useless_states=False)

    def to_control(self) -> control.NonlinearIOSystem:
        """Model as a nonlinear input/output system of python-control.

        States, inputs and outputs are those of `linearise`; parameters are the model's, by name.
        """
        self.check_ordinary("python-control")
        kernels, n, values = self.kernels, len(self.coordinates), self.parameter_values()
        outputs = [*(self.outputs or self.coordinates)]

        def array(params: Mapping[str, float]) -> np.ndarray:
            return np.array([params.get(name, value) for name, value in values.items()], dtype=float)

        def update(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
            rate = np.empty(len(x))
            kernels.derivative(float(t), np.array(x, float), np.array(u, float), array(params), rate)
            return rate

        def output(t: float, x: np.ndarray, u: np.ndarray, params: Mapping[str, float]) -> np.ndarray:
            if not self.outputs:
                return np.array(x[:n], float)
            found = np.empty(len(outputs))
            q, v, inputs = (np.array(part, float) for part in (x[:n], x[n:], u))
            kernels.outputs(float(t), q, v, inputs, array(params), found)
            return found

        names = {"states": self.state_names, "inputs": [*self.inputs], "outputs": outputs, "name": self.name}
        return control.nlsys(update, output, params=values, **names)

    @property
    def state_names(self) -> list[str]:
        """Names of the states: coordinates, velocities (`x1'`), internal states."""
        return [*self.coordinates, *(f"{c}'" for c in self.coordinates), *self.states]

    def _check_units(self) -> None:
        problems = [*check_dimensions(self.declaration), *check_scales(self.declaration)]
        if problems:
            raise DeclarationError(problems)

    def _build(self) -> Module:
        self._check_units()
        return module(self.equations)
