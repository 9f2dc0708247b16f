"""Variational equations: how a motion depends on where it begins, compiled together with it.

    y' = f(t, y),    Phi' = (df/dy) Phi,    Phi(0) = I

The Jacobian follows from the equations by the chain rule. Source: Hairer, Norsett and Wanner (1993), Solving Ordinary
Differential Equations I, section I.14.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile import store
from masking.compile.graph import Graph
from masking.compile.source import Module
from masking.compile.tangent import derivatives
from masking.kernels import Array, Kernels
from masking.lowering import SOLVE_RUNGE_KUTTA, LoweredEquations
from masking.model import Model


@dataclass(frozen=True)
class Variational:
    """A model together with its variational equations; inputs are 0."""

    model: Model

    @property
    def size(self) -> int:
        """Return the number of states of the model."""
        return 2 * len(self.model.coordinates) + len(self.model.states)

    @cached_property
    def kernels(self) -> Kernels:
        """Return the compiled functions; from the cache on disk where they have been made before."""
        return Kernels(store.load(store.key({"variational": self.model.structure()}), self._build))

    def _build(self) -> Module:
        self.model.validate()
        lowered = LoweredEquations.of(self.model.equations, Graph())
        graph, s, size = lowered.graph, self.model.equations.symbols, self.size
        y = [lowered.symbols[x] for x in (*s.q, *s.v, *s.s)]
        rates = [*y[len(s.q) : 2 * len(s.q)], *lowered.accelerations, *lowered.rates]
        slopes = derivatives(graph, rates, y)
        phi = [[graph.symbol(f"w{i}_{j}", varying=True) for j in range(size)] for i in range(size)]
        flow = [
            graph.total([graph.mul(by, phi[k][j]) for k, by in enumerate(slopes[i])])
            for i in range(size)
            for j in range(size)
        ]
        loads = lowered.joined() | {f"w{i}_{j}": f"y[{size + i * size + j}]" for i in range(size) for j in range(size)}
        names = [*self.model.coordinates, *(f"{c}'" for c in self.model.coordinates), *self.model.states]
        meta = {
            "kind": "variational",
            "coordinates": list(self.model.coordinates),
            "states": [*self.model.states, *(f"d{a}/d{b}" for a in names for b in names)],
            "inputs": list(self.model.inputs),
            "method": "runge_kutta",
        }
        module = Module(f"{self.model.name}, with its variational equations", meta)
        nodes = [(f"dy[{i}]", node) for i, node in enumerate([*rates, *flow])]
        module.add("derivative(t, y, u, p, dy)", graph, nodes, loads, returns=lowered.health)
        module.add_kernel(SOLVE_RUNGE_KUTTA.format(size=size + size * size), "idi", (24, size + size * size))
        return module

    def flow(self, state: Array, duration: float, tolerance: float = 1e-12) -> tuple[Array, Array]:
        """Return the state after a time, and its derivatives with respect to the first one, Phi.

        Args:
            state: y (size,), in SI units or in the model's scales.
            duration: in the same.
            tolerance: local relative error of a step.

        Returns:
            y (size,) and Phi (size, size).

        Raises:
            IntegrationError: the integrator could not go on.
        """
        begin = np.concatenate([np.asarray(state, dtype=float), np.eye(self.size).ravel()])
        u = np.zeros(len(self.model.inputs))
        run = self.kernels.integrate(np.array([0.0, duration]), begin, u, self.model.values(), tolerance=tolerance)
        end = run.states[-1]
        return end[: self.size].copy(), end[self.size :].reshape(self.size, self.size).copy()
