"""A model's equations lowered into a graph, and printed as a module of compiled functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from masking.compile.codegen import chattering
from masking.compile.codegen.generated_module import (
    LARGEST_TAYLOR_COST,
    LEAST_SIDE_BY_SIDE,
    Module,
    lane_orders,
    taylor_orders,
)
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.linear_systems import health, solve
from masking.compile.codegen.taylor_coefficients import Dynamics, cost, degree, hides_a_switch, is_analytic
from masking.compile.codegen.taylor_loops import Loops
from masking.compile.codegen.time_switches import TimeSwitches
from masking.compile.numerics.controller_sizes import lane_work
from masking.lazy_imports import delayed, events, lanes, runge_kutta, taylor_integrator
from masking.lazy_imports import sympy as sp
from masking.model.modelling.affine_equations import curved
from masking.model.modelling.equations import Equations
from masking.model.modelling.scales import Units


@dataclass
class LoweredEquations:
    """The symbols of a model as nodes, and its accelerations and the rates of its internal states.

    Of delayed expressions, `lagged` is what they are now, and `delays` is by how long they are delayed. Of events,
    `conditions` are the conditions, and then the values that jump.

    `loads` and `joined` tell for each symbol's text how a function reads it from its arguments: q and v apart, where
    the internal states follow the velocities in v, or one state vector y = [q, v, s].
    """

    equations: Equations
    graph: Graph
    symbols: dict[sp.Symbol, Node]
    accelerations: list[Node]
    health: Node
    rates: list[Node] = field(default_factory=list)
    lagged: list[Node] = field(default_factory=list)
    delays: list[Node] = field(default_factory=list)
    conditions: list[Node] = field(default_factory=list)

    @classmethod
    def of(
        cls, equations: Equations, graph: Graph, prefix: str = "", known: Mapping[sp.Symbol, Node] | None = None
    ) -> LoweredEquations:
        """Lower a model's equations into a graph.

        `prefix` is put before the text of each new symbol, so that several models share a graph; `known` are nodes that
        stand for symbols of the model, and the others become new symbols.
        """
        s = equations.symbols
        nodes = dict(known or {})
        kinds = [("", (s.t,), True), ("q_", s.q, True), ("v_", s.v, True), ("u_", s.u, False), ("p_", s.p, False)]
        kinds += [("s_", s.s, True), ("w_", tuple(lag.symbol for lag in equations.lags), True)]
        for kind, symbols, varying in kinds:
            for symbol in symbols:
                if symbol not in nodes:
                    text = kind + prefix + symbol.name.rstrip("'")
                    nodes[symbol] = graph.symbol(text, varying=varying)
        if equations.coordinates:
            solution, divisors = solve(graph, graph.rows(equations.mass, nodes), graph.rows(equations.force, nodes))
        else:
            solution, divisors = [], []
        accelerations = [row[0] for row in solution]
        nodes.update(zip(s.a, accelerations, strict=True))
        rates = graph.lowered(equations.rates, nodes)
        lagged = graph.lowered((lag.value for lag in equations.lags), nodes)
        delays = graph.lowered((lag.time for lag in equations.lags), nodes)
        conditions = graph.lowered((*equations.events.conditions, *equations.events.values), nodes)
        return cls(equations, graph, nodes, accelerations, health(graph, divisors), rates, lagged, delays, conditions)

    def lower(self, expression: sp.Expr) -> Node:
        """Node of an expression in symbols of the model, accelerations included."""
        return self.graph.lower(expression, self.symbols)

    def loads(self, q: str, v: str, offset: int = 0, first: int = 0) -> dict[str, str]:
        """How each symbol is read from `u`, `p` and texts of q and v with `{i}` for an index.

        The first parameter has the index `offset`, the first velocity the index `first`.
        """
        s, texts = self.equations.symbols, dict[str, str]()
        behind = (*s.v, *s.s, *(lag.symbol for lag in self.equations.lags))
        parts = ((s.q, q, 0), (behind, v, first), (s.u, "u[{i}]", 0), (s.p, "p[{i}]", offset))
        for symbols, pattern, begin in parts:
            for i, symbol in enumerate(symbols, begin):
                operation = self.graph.operations[self.symbols[symbol]]
                if operation[0] == "symbol":
                    texts[str(operation[1])] = pattern.format(i=i)
        return texts

    def joined(self, offset: int = 0) -> dict[str, str]:
        """How each symbol is read from the state vector `y` = [q, v, s] and what is delayed behind; else as `loads`."""
        return self.loads("y[{i}]", "y[{i}]", offset, len(self.equations.symbols.q))


def module(equations: Equations) -> Module:
    """Generated module of a model."""
    lowered = LoweredEquations.of(equations, Graph())
    graph, n = lowered.graph, len(equations.coordinates)
    s = equations.symbols
    time = lowered.symbols[s.t]
    states = [lowered.symbols[x] for x in (*s.q, *s.v, *s.s)]
    derivatives = [*states[n : 2 * n], *lowered.accelerations, *lowered.rates]
    size, lags, inputs = len(states), len(lowered.lagged), len(s.u)
    products = cost(graph, derivatives)
    orders = taylor_orders(products)
    is_smooth = is_analytic(graph, derivatives)
    use_taylor = (
        size > 0
        and not lags
        and not lowered.conditions
        and is_smooth
        and not hides_a_switch(graph, derivatives)
        and degree(graph, derivatives) < min(orders.values())
    )
    joined, loops = lowered.joined(), None
    dynamics = Dynamics(graph, time, states, derivatives, lowered.health, joined)
    if use_taylor and products > LARGEST_TAYLOR_COST:
        loops = Loops.of(dynamics)
        use_taylor = loops.side_by_side >= LEAST_SIDE_BY_SIDE
    energy = equations.energy
    outputs = {name: equations.output(name) for name in equations.declaration.outputs}
    meta = {
        "kind": "model",
        "coordinates": list(equations.coordinates),
        "states": list(equations.declaration.states),
        "inputs": list(equations.declaration.inputs),
        "parameters": list(equations.declaration.parameters),
        "outputs": list(outputs),
        "curved": list(curved(equations)),
        "method": "taylor" if use_taylor else "runge_kutta",
        "has_energy": energy is not None,
        "lags": lags,
        "has_corners": not is_smooth,
        "events": list(equations.events.names),
        "targets": list(equations.events.targets),
        "units": Units.of(equations.declaration).to_meta(),
    }
    module = Module(equations.name, meta)
    split = lowered.loads("q[{i}]", "v[{i}]")
    results = [(f"out[{i}]", a) for i, a in enumerate(lowered.accelerations)]
    module.add("accelerations(t: float, q, v, u, p, out)", graph, results, split, returns=lowered.health)
    slopes = [(f"dy[{i}]", d) for i, d in enumerate(derivatives)]
    module.add("derivative(t: float, y, u, p, dy)", graph, slopes, joined, returns=lowered.health)
    lowered_outputs = [(f"out[{i}]", lowered.lower(e)) for i, e in enumerate(outputs.values())]
    module.add("outputs(t: float, q, v, u, p, out)", graph, lowered_outputs, split)
    if energy is not None:
        module.add("energy(t: float, q, v, p)", graph, [], split, returns=lowered.lower(energy))
    if use_taylor:
        if loops is not None:
            module.add_coefficients_in_loops(loops, joined, orders)
        else:
            module.add_coefficients(dynamics, orders)
        for ending, order in orders.items():
            made = (taylor_integrator.taylor, f"coefficients{ending}", order, size)
            width = size if loops is None else loops.width
            module.add_factory(f"solve_taylor{ending}", *made, work=(order + 1, width))
        for one in lane_orders(products) if loops is None else ():
            held = module.add_lanes(dynamics, one)
            counts = (one.doubles, one.order + 1 - one.doubles, size, inputs, len(s.p), held, one.lanes)
            linked = [f"lane_{name}{one.ending}" for name in ("held", "coefficients", "step", "states", "advance")]
            module.add_factory(f"solve_in_lanes{one.ending}", lanes.taylor, *linked, *counts, work=lane_work(*counts))
    added = Added(time, derivatives, lowered.lagged, lowered.delays, lowered.conditions, equations.events.targets)
    add_runge_kutta(module, graph, added, joined, (size, inputs))
    return module


@dataclass(frozen=True)
class Added:
    """Nodes of the time and of derivatives, and what stands beside these: nodes of delays and of events."""

    time: Node
    derivatives: Sequence[Node]
    lagged: Sequence[Node]  # what the delayed expressions are now
    delays: Sequence[Node]  # by how long they are delayed
    conditions: Sequence[Node]  # conditions of events, and values that jump
    targets: tuple[tuple[int, int], ...]  # for each of these, the index of its event and that of the state

    @property
    def events(self) -> int:
        """Number of events."""
        return len(self.conditions) - len(self.targets)


def add_runge_kutta(
    module: Module, graph: Graph, added: Added, loads: Mapping[str, str], sizes: tuple[int, int]
) -> None:
    """Add `solve_runge_kutta` to a module with `derivative`, and what it needs for switches, delays and events.

    `loads` says how symbols are read from the state vector; `sizes` are the numbers of integrated states and of inputs.
    """
    size, inputs = sizes

    def add(signature: str, nodes: Sequence[Node]) -> None:
        module.add(signature, graph, [(f"w[{i}]", node) for i, node in enumerate(nodes)], loads)

    every, jumping = (
        [*added.derivatives, *added.lagged, *added.conditions],
        chattering.switches(graph, added.derivatives),
    )
    module.meta["time_switches"] = TimeSwitches.of(graph, every, added.time, loads).to_meta()
    module.meta["switches"] = [text for _, text in jumping]
    if jumping:
        add("switching(t: float, y, u, p, w)", [node for node, _ in jumping])
    if added.conditions:
        add("conditions(t: float, y, p, w)", added.conditions)
        module.add_factory("jump", events.jumps, "conditions", added.events, added.targets, events.AT_ONCE)
        given = ("derivative", "conditions", size, added.events, inputs)
        shape = events.work_shape(size, len(added.conditions), inputs)
        module.add_factory("solve_runge_kutta", events.runge_kutta, *given, work=shape)
        return
    if not added.lagged:
        module.add_factory("solve_runge_kutta", runge_kutta.runge_kutta, "derivative", size, work=(24, size))
        return
    add("lagged(t: float, y, p, w)", added.lagged)
    add("delays(p, w)", added.delays)
    counts = (size, len(added.lagged), inputs)
    made = (delayed.runge_kutta, "derivative", "lagged", "delays", *counts)
    module.add_factory("solve_runge_kutta", *made, work=delayed.history_shape(*counts))
