"""Block T of masking: virtual coordinates as functions of the rig's, with their Jacobian and its rate.

Rig coordinates enter measured in the rig's scales where both systems are dimensionless, in SI units otherwise.
Source: Rijlaarsdam (2008), chapter 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.numerics.arrays import Array
from masking.errors import ModelError
from masking.lazy_imports import sympy as sp
from masking.model.declaration import driven_coordinates, schema
from masking.model.modelling.gradient import jacobian, rate
from masking.model.modelling.model import Model


@dataclass(frozen=True)
class Transform:
    """T: virtual coordinates as smooth functions of rig coordinates."""

    rig: Model  # the model of the rig
    virtual: Model  # the model whose coordinates are computed
    declaration: schema.Transform  # identity, a matrix, or one expression for each virtual coordinate

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the transform's own parameters."""
        return tuple(self.declaration.parameters)

    @cached_property
    def parameter_symbols(self) -> tuple[sp.Symbol, ...]:
        """Symbols of the transform's own parameters."""
        return tuple(sp.Symbol(name, real=True) for name in self.parameters)

    @cached_property
    def expressions(self) -> sp.ImmutableMatrix:
        """Eta = T(q) as a column (k, 1) in the rig's coordinate symbols.

        A ModelError where the identity finds neither the names of the virtual coordinates in the rig nor as many.
        """
        q = self.rig.equations.symbols.q
        matrix, expressions = self.declaration.matrix, self.declaration.expressions
        if matrix is None and expressions is None:
            return sp.ImmutableMatrix([q[i] for i in self._selected])
        known = {s.name: s for s in (*q, *self.parameter_symbols)}
        if expressions is not None:
            return sp.ImmutableMatrix([expressions[c].to_sympy(known) for c in self.virtual.coordinates])
        rows = [[e.to_sympy(known) for e in row] for row in matrix or ()]
        return sp.ImmutableMatrix(sp.Matrix(rows) * sp.Matrix(q))

    @property
    def _selected(self) -> tuple[int, ...]:
        """Indices of the rig coordinates that the identity takes."""
        chosen = driven_coordinates.selected(self.rig.coordinates, self.virtual.coordinates)
        if chosen is None:
            raise ModelError(
                "transform: identity takes rig coordinates by the names of the virtual ones, or all in order; "
                f"{self.virtual.name} has {', '.join(self.virtual.coordinates)}, {self.rig.name} has "
                f"{', '.join(self.rig.coordinates)}; declare a matrix or expressions"
            )
        return chosen

    def slope(self, parameters: Mapping[str, float]) -> Array:
        """J at zero coordinates (k, n), for values of T's own parameters; without sympy where T is linear."""
        matrix, expressions = self.declaration.matrix, self.declaration.expressions
        if expressions is not None:
            known = dict.fromkeys(self.rig.equations.symbols.q, 0)
            known |= {symbol: parameters[symbol.name] for symbol in self.parameter_symbols}
            return np.array(self.jacobian.subs(known).evalf().tolist(), dtype=float)
        if matrix is None:
            return np.eye(len(self.rig.coordinates))[list(self._selected)]
        return np.array([[entry.evaluate(parameters) for entry in row] for row in matrix], dtype=float)

    @cached_property
    def passive(self) -> tuple[int, ...]:
        """Indices of the n - k rig coordinates that no virtual one stands for.

        They are those that the transform does not name, and of those that it names the last ones that are needed.
        """
        coordinates, virtual = self.rig.coordinates, self.virtual.coordinates
        names = driven_coordinates.passive(self.declaration, coordinates, virtual)
        return tuple(i for i, name in enumerate(coordinates) if name in names)

    @cached_property
    def jacobian(self) -> sp.ImmutableMatrix:
        """J = dT/dq (k, n)."""
        return sp.ImmutableMatrix(jacobian(self.expressions, self.rig.equations.symbols.q))

    @cached_property
    def bias(self) -> sp.ImmutableMatrix:
        """(dJ/dt) v (k, 1), the virtual acceleration at zero rig acceleration."""
        s, slopes = self.rig.equations.symbols, self.jacobian.tolist()
        rows = [sp.Add(*(rate(j, s.q, s.v) * v for j, v in zip(row, s.v, strict=True) if j != 0)) for row in slopes]
        return sp.ImmutableMatrix(len(rows), 1, rows)

    def lower(self, graph: Graph, q: Sequence[Node], v: Sequence[Node], p: Sequence[Node]) -> MappedCoordinates:
        """Lower eta, its rate, J and (dJ/dt) v for given nodes of rig coordinates, velocities and parameters."""
        s = self.rig.equations.symbols
        known = dict(zip((*s.q, *s.v, *self.parameter_symbols), (*q, *v, *p), strict=True))
        jacobian, eta = graph.rows(self.jacobian, known), graph.lowered(self.expressions, known)
        moving = [dot(graph, row, v) for row in jacobian]
        return MappedCoordinates(eta, moving, jacobian, graph.lowered(self.bias, known))


@dataclass(frozen=True)
class MappedCoordinates:
    """Nodes of T at one state: eta (k,), d eta/dt (k,), J (k, n) and (dJ/dt) v (k,)."""

    eta: list[Node]
    rate: list[Node]
    jacobian: list[list[Node]]
    bias: list[Node]


def product(graph: Graph, a: Sequence[Sequence[Node]], b: Sequence[Sequence[Node]]) -> list[list[Node]]:
    """Nodes of the product of two matrices of nodes, without work for zeros of the first."""
    found = []
    for row in a:
        filled = [(x, other) for x, other in zip(row, b, strict=True) if not graph.is_number(x, 0.0)]
        found.append([graph.total([graph.mul(x, other[j]) for x, other in filled]) for j in range(len(b[0]))])
    return found


def dot(graph: Graph, a: Sequence[Node], b: Sequence[Node]) -> Node:
    """Node of the scalar product of two rows of nodes."""
    return graph.total([graph.mul(x, y) for x, y in zip(a, b, strict=True)])
