"""A model's equations lowered into a graph, and printed as a module of compiled functions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from masking.compile.graph import Graph, Node
from masking.compile.source import LARGEST_TAYLOR_COST, Module, taylor_order
from masking.compile.taylor import cost, degree, is_analytic
from masking.equations import Equations
from masking.linear import solve
from masking.scales import Units

if TYPE_CHECKING:
    import sympy as sp


@dataclass
class LoweredEquations:
    """The symbols of a model as nodes, and its accelerations computed from them.

    `loads` tells for each symbol's text how the state-space functions read it from their arguments.
    """

    equations: Equations
    graph: Graph
    symbols: dict[sp.Symbol, Node]
    accelerations: list[Node]
    health: Node

    @classmethod
    def of(
        cls,
        equations: Equations,
        graph: Graph,
        prefix: str = "",
        known: Mapping[sp.Symbol, Node] | None = None,
    ) -> LoweredEquations:
        """Lower a model's equations into a graph.

        Args:
            equations: the equations.
            graph: the graph to add to.
            prefix: put before the text of each new symbol, so that several models share a graph.
            known: nodes that stand for symbols of the model; the others become new symbols.
        """
        s = equations.symbols
        nodes = dict(known or {})
        kinds = [("", (s.t,), True), ("q_", s.q, True), ("v_", s.v, True), ("u_", s.u, False), ("p_", s.p, False)]
        for kind, symbols, varying in kinds:
            for symbol in symbols:
                if symbol not in nodes:
                    text = kind + prefix + symbol.name.rstrip("'")
                    nodes[symbol] = graph.symbol(text, varying=varying)
        if equations.coordinates:
            mass = [[graph.lower(e, nodes) for e in row] for row in equations.mass.tolist()]
            force = [[graph.lower(e, nodes) for e in row] for row in equations.force.tolist()]
            solution, health = solve(graph, mass, force)
        else:
            solution, health = [], graph.number(1.0)
        accelerations = [row[0] for row in solution]
        nodes.update(zip(s.a, accelerations, strict=True))
        return cls(equations, graph, nodes, accelerations, health)

    def lower(self, expression: sp.Expr) -> Node:
        """Return the node of an expression in symbols of the model, accelerations included."""
        return self.graph.lower(expression, self.symbols)

    def loads(self, q: str, v: str, u: str = "u", p: str = "p", offset: int = 0) -> dict[str, str]:
        """Return how each symbol is read: `q` and `v` are texts with `{i}` for the index of a coordinate."""
        texts = {}
        s = self.equations.symbols
        for symbols, pattern in ((s.q, q), (s.v, v), (s.u, u + "[{i}]"), (s.p, p + "[{i}]")):
            for i, symbol in enumerate(symbols):
                operation = self.graph.operations[self.symbols[symbol]]
                if operation[0] == "symbol":
                    index = i + offset if symbols is s.p else i
                    texts[str(operation[1])] = pattern.format(i=index)
        return texts


def module(equations: Equations) -> Module:
    """Return the generated module of a model."""
    lowered = LoweredEquations.of(equations, Graph())
    graph, n = lowered.graph, len(equations.coordinates)
    time = lowered.symbols[equations.symbols.t]
    states = [lowered.symbols[x] for x in (*equations.symbols.q, *equations.symbols.v)]
    derivatives = [*states[n:], *lowered.accelerations]
    products = cost(graph, derivatives)
    order = taylor_order(products)
    use_taylor = (
        n > 0
        and is_analytic(graph, [*derivatives, lowered.health])
        and products <= LARGEST_TAYLOR_COST
        and degree(graph, derivatives) < order
    )
    energy = equations.energy
    outputs = {name: equations.symbolic(output.expression) for name, output in equations.declaration.outputs.items()}
    meta = {
        "kind": "model",
        "coordinates": list(equations.coordinates),
        "inputs": list(equations.declaration.inputs),
        "parameters": list(equations.declaration.parameters),
        "outputs": list(outputs),
        "method": "taylor" if use_taylor else "runge_kutta",
        "has_energy": energy is not None,
        "units": Units.of(equations.declaration).to_meta(),
    }
    module = Module(equations.name, meta)
    split = lowered.loads("q[{i}]", "v[{i}]")
    joined = {
        **lowered.loads("y[{i}]", "y[{i}]"),
        **{f"v_{c}": f"y[{n + i}]" for i, c in enumerate(equations.coordinates)},
    }
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
        module.add_coefficients(graph, states, derivatives, time=time, health=lowered.health, loads=joined, order=order)
        module.add_kernel(SOLVE_TAYLOR.format(order=order, size=2 * n), "idi", (order + 1, 2 * n))
    module.add_kernel(SOLVE_RUNGE_KUTTA.format(size=2 * n), "idi", (24, 2 * n))
    return module


SOLVE_TAYLOR = """
_taylor = integrate.taylor(coefficients, {order}, {size})


@compiled
def solve_taylor(t, y, times, u, p, tolerance, fixed_step, states, work):
    return _taylor(t, y, times, u, p, tolerance, fixed_step, states, work)
"""
SOLVE_RUNGE_KUTTA = """
_runge_kutta = integrate.runge_kutta(derivative, {size})


@compiled
def solve_runge_kutta(t, y, times, u, p, tolerance, fixed_step, states, work):
    return _runge_kutta(t, y, times, u, p, tolerance, fixed_step, states, work)
"""
