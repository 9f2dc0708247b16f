"""Variational equations: how a motion depends on where it begins, compiled together with it.

    y' = f(t, y),    W' = (df/dy) W

The columns of W are neighbouring motions, less the motion itself; from W(0) = I it is the matrix Phi of all of them.
The Jacobian follows from the equations by the chain rule. Source: Hairer, Norsett and Wanner (1993), Solving Ordinary
Differential Equations I, section I.14.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.codegen import module_store
from masking.compile.codegen.compiled_functions import Kernels
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.graph import Graph
from masking.compile.codegen.tangent import derivatives
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import runge_kutta
from masking.model.modelling.lowering import LoweredEquations
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Variational:
    """A model together with its variational equations, for all directions (columns of W) or as many as are given."""

    model: Model
    directions: int | None = None

    @property
    def size(self) -> int:
        """Number of states of the model."""
        return 2 * len(self.model.coordinates) + len(self.model.states)

    @property
    def columns(self) -> int:
        """Number of columns of W."""
        return self.size if self.directions is None else self.directions

    @cached_property
    def kernels(self) -> Kernels:
        """Compiled functions; from the cache on disk where they have been made before."""
        self.model.check_ordinary("a variational equation")
        made_from = {"variational": self.model.structure(), "directions": self.columns}
        return Kernels(module_store.load(module_store.key(made_from), self._build))

    def _build(self) -> Module:
        self.model.validate()
        if not self.size:
            raise ModelError(f"{self.model.name} has neither coordinates nor internal states: it does not move")
        lowered = LoweredEquations.of(self.model.equations, Graph())
        graph, s, size, columns = lowered.graph, self.model.equations.symbols, self.size, self.columns
        y = [lowered.symbols[x] for x in (*s.q, *s.v, *s.s)]
        rates = [*y[len(s.q) : 2 * len(s.q)], *lowered.accelerations, *lowered.rates]
        slopes = derivatives(graph, rates, y)
        w = [[graph.symbol(f"w{i}_{j}", varying=True) for j in range(columns)] for i in range(size)]
        flow = [
            graph.total([graph.mul(by, w[k][j]) for k, by in enumerate(slopes[i])])
            for i in range(size)
            for j in range(columns)
        ]
        at = {f"w{i}_{j}": f"y[{size + i * columns + j}]" for i in range(size) for j in range(columns)}
        names = [*self.model.coordinates, *(f"{c}'" for c in self.model.coordinates), *self.model.states]
        meta = {
            "kind": "variational",
            "coordinates": list(self.model.coordinates),
            "states": [*self.model.states, *(f"d{name}[{j}]" for name in names for j in range(columns))],
            "inputs": list(self.model.inputs),
            "method": "runge_kutta",
        }
        module = Module(f"{self.model.name}, with its variational equations", meta)
        nodes = [(f"dy[{i}]", node) for i, node in enumerate([*rates, *flow])]
        module.add("derivative(t: float, y, u, p, dy)", graph, nodes, lowered.joined() | at, returns=lowered.health)
        every = size * (1 + columns)
        module.add_factory("solve_runge_kutta", runge_kutta.runge_kutta, "derivative", every, work=(24, every))
        return module

    def along(
        self, span: tuple[float, float], state: Array, w: Array, *, u: Array | None = None, tolerance: float = 1e-12
    ) -> tuple[Array, Array]:
        """State y (size,) at the end of a time, and the directions as the motion has turned and stretched them.

        Those at its beginning are `state` and `w` (size, columns), in SI units or in the model's scales, as the first
        and the last time, `span`; inputs u (k,) are constant, `tolerance` is the local relative error of a step.

        Raises:
            IntegrationError: the integrator could not go on.
        """
        inputs = np.zeros(len(self.model.inputs)) if u is None else np.asarray(u, dtype=float)
        first = np.concatenate([np.asarray(state, dtype=float), np.ravel(w)])
        run = self.kernels.integrate(np.array(span), first, inputs, self.model.values(), tolerance=tolerance)
        last = run.states[-1]
        return last[: self.size].copy(), last[self.size :].reshape(self.size, self.columns).copy()

    def flow(
        self, state: Array, duration: float, tolerance: float = 1e-12, *, begin: float = 0.0
    ) -> tuple[Array, Array]:
        """State (size,) after a time, and its derivatives Phi (size, size) with respect to the first; see `along`."""
        return self.along((begin, begin + duration), state, np.eye(self.size), tolerance=tolerance)
