"""Blocks L and G of masking: inputs that cancel the rig's own dynamics, and that accelerate it.

Source: Rijlaarsdam (2008), chapter 6, (6.1) and (6.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.linear_systems import health, solve
from masking.control.transform import dot
from masking.lazy_imports import sympy as sp
from masking.model.modelling.model import Model

# What to do about a matrix W = J B that becomes singular on the way.
INVERTIBLE = "choose a transform that is invertible, and that the actuators can follow, over the whole motion"


@dataclass(frozen=True)
class Cancellation:
    """L and G from one model of the rig: the input that cancels its dynamics, and that which accelerates it.

    The rig is a = a0(t, q, v) + B(t, q) u. L solves B L = -a0 (6.1), and G is the inverse of B (6.3).
    """

    model: Model  # affine in its inputs

    def lower(
        self, graph: Graph, time: Node, q: Sequence[Node], v: Sequence[Node], p: Sequence[Node]
    ) -> tuple[list[Node], list[list[Node]], Node]:
        """Lower a0 (n,), B (n, k) and the health of the mass matrix; `v` holds the internal states at its end."""
        s = self.model.equations.symbols
        known = dict(zip((s.t, *s.q, *s.v, *s.s, *s.p), (time, *q, *v, *p), strict=True))
        free = self.model.equations.force.xreplace(dict.fromkeys(s.u, sp.Integer(0)))
        entries = graph.rows(free.row_join(self.model.equations.input_force), known)
        solution, divisors = solve(graph, graph.rows(self.model.equations.mass, known), entries)
        return [row[0] for row in solution], [row[1:] for row in solution], health(graph, divisors)


def decouple(
    graph: Graph, matrix: list[list[Node]], cancel: Sequence[Node], drive: Sequence[Node]
) -> tuple[list[Node], list[Node], Node]:
    """Inputs that give two virtual accelerations, and the health of what had to be inverted.

    Solves W u = r, with W (k, inputs), for r = `cancel` and r = `drive` (k,); where there are more inputs than
    coordinates, u is the solution of least norm, u = W^T (W W^T)^-1 r.
    """
    right = [[c, d] for c, d in zip(cancel, drive, strict=True)]
    inputs = len(matrix[0])
    if inputs == len(matrix):
        solution, divisors = solve(graph, matrix, right)
    else:
        square = [[dot(graph, a, b) for b in matrix] for a in matrix]
        part, divisors = solve(graph, square, right)
        columns = [[row[i] for row in matrix] for i in range(inputs)]
        solution = [[dot(graph, column, [z[k] for z in part]) for k in (0, 1)] for column in columns]
    return [x[0] for x in solution], [x[1] for x in solution], health(graph, divisors)
