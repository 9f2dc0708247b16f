"""Derivatives of nodes with respect to symbols, as nodes of the same graph, by the chain rule in forward mode.

Source: Griewank and Walther, Evaluating Derivatives (2008), chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import Rules, function_of
from masking.compile.codegen.printers import needed

# For each operation the derivative with respect to each of its arguments, given the node itself and its arguments; None
# where it is zero wherever there is one.
Rule = Callable[[Graph, Node, tuple[Node, ...]], tuple[Node | None, ...]]


def _square(graph: Graph, x: Node) -> Node:
    return graph.mul(x, x)


def _one_less(graph: Graph, x: Node) -> Node:
    return graph.sub(graph.number(1.0), x)


def _inverse(graph: Graph, x: Node) -> Node:
    return graph.div(graph.number(1.0), x)


def _power(graph: Graph, node: Node, arguments: tuple[Node, ...]) -> tuple[Node, ...]:
    base, exponent = arguments
    lower = graph.apply("pow", base, graph.sub(exponent, graph.number(1.0)))
    return graph.mul(exponent, lower), graph.mul(node, graph.apply("log", base))


def _angle(graph: Graph, arguments: tuple[Node, ...]) -> tuple[Node, Node]:
    y, x = arguments
    size = graph.add(_square(graph, x), _square(graph, y))
    return graph.div(x, size), graph.apply("neg", graph.div(y, size))


RULES: dict[str, Rule] = {
    "neg": lambda g, _, a: (g.number(-1.0),),
    "add": lambda g, _, a: (g.number(1.0), g.number(1.0)),
    "sub": lambda g, _, a: (g.number(1.0), g.number(-1.0)),
    "mul": lambda g, _, a: (a[1], a[0]),
    "div": lambda g, n, a: (_inverse(g, a[1]), g.apply("neg", g.div(n, a[1]))),
    "pow": _power,
    "sqrt": lambda g, n, a: (g.div(g.number(0.5), n),),
    "exp": lambda g, n, a: (n,),
    "log": lambda g, _, a: (_inverse(g, a[0]),),
    "sin": lambda g, _, a: (g.apply("cos", a[0]),),
    "cos": lambda g, _, a: (g.apply("neg", g.apply("sin", a[0])),),
    "tan": lambda g, n, a: (g.add(g.number(1.0), _square(g, n)),),
    "asin": lambda g, _, a: (_inverse(g, g.apply("sqrt", _one_less(g, _square(g, a[0])))),),
    "acos": lambda g, _, a: (g.apply("neg", _inverse(g, g.apply("sqrt", _one_less(g, _square(g, a[0]))))),),
    "atan": lambda g, _, a: (_inverse(g, g.add(g.number(1.0), _square(g, a[0]))),),
    "sinh": lambda g, _, a: (g.apply("cosh", a[0]),),
    "cosh": lambda g, _, a: (g.apply("sinh", a[0]),),
    "tanh": lambda g, n, a: (_one_less(g, _square(g, n)),),
    "atan2": lambda g, _, a: _angle(g, a),
    "abs": lambda g, _, a: (g.apply("sign", a[0]),),
    "sign": lambda g, _, a: (None,),
    "floor": lambda g, _, a: (g.number(1.0),),  # that of its mean, x - 1/2: steps are seen from afar
    "heaviside": lambda g, _, a: (None,),
    "lt": lambda g, _, a: (None, None),
    "le": lambda g, _, a: (None, None),
}


# For each operation that is one of its arguments: the condition, what it is where that holds, and what where not. The
# derivative of what is not chosen does not count, even where it is not a number.
SWITCHES: dict[str, Callable[[Graph, tuple[Node, ...]], tuple[Node, Node, Node]]] = {
    "where": lambda g, a: (a[0], a[1], a[2]),
    "min": lambda g, a: (g.apply("lt", a[0], a[1]), a[0], a[1]),
    "max": lambda g, a: (g.apply("lt", a[0], a[1]), a[1], a[0]),
}


def derivatives(graph: Graph, nodes: Sequence[Node], symbols: Sequence[Node]) -> list[list[Node]]:
    """D node / d symbol for each node (rows) and symbol (columns), added to the graph; see `along`."""
    one, partial, users = graph.number(1.0), dict[Node, tuple[Node | None, ...]](), dict[Node, list[Node]]()
    for node in needed(graph, nodes):
        name, *given = graph.operations[node]
        for argument in given if name not in {"symbol", "number"} else ():
            users.setdefault(int(argument), []).append(node)
    columns = [_along(graph, nodes, {symbol: one}, _behind(symbol, users), partial) for symbol in symbols]
    return [list(row) for row in zip(*columns, strict=True)] if columns else [[] for _ in nodes]


def _behind(symbol: Node, users: Mapping[Node, Sequence[Node]]) -> list[Node]:
    """Nodes that depend on a symbol, in computable order, for those that use each node."""
    found, open_ones = set[Node](), [symbol]
    while open_ones:
        new = set(users.get(open_ones.pop(), ())) - found
        found |= new
        open_ones += new
    return sorted(found)


def along(graph: Graph, nodes: Sequence[Node], rates: Mapping[Node, Node]) -> list[Node]:
    """Rate of each node where other nodes change at given rates, added to the graph.

    At a switch, such as the corner of `abs` or the step of `sign`, it is that of one side. A stair (`floor`) counts as
    the line through it.
    """
    return _along(graph, nodes, rates, needed(graph, nodes), {})


def _along(
    graph: Graph,
    nodes: Sequence[Node],
    rates: Mapping[Node, Node],
    order: Sequence[Node],
    partial: dict[Node, tuple[Node | None, ...]],
) -> list[Node]:
    """Rates of nodes, as `along`; `order` are the nodes that they need, `partial` is filled with their derivatives."""
    zero, tangent = graph.number(0.0), dict(rates)
    for node in order:
        name, *given = graph.operations[node]
        if node in rates or name in {"symbol", "number"}:
            continue
        arguments = tuple(int(a) for a in given)
        if not any(a in tangent for a in arguments):
            continue
        if name in SWITCHES:
            condition, first, second = SWITCHES[str(name)](graph, arguments)
            total = graph.apply("where", condition, tangent.get(first, zero), tangent.get(second, zero))
        else:
            if node not in partial:
                partial[node] = RULES[str(name)](graph, node, arguments)
            pairs = zip(arguments, partial[node], strict=True)
            total = graph.total([graph.mul(by, tangent[a]) for a, by in pairs if by is not None and a in tangent])
        if not graph.is_number(total, 0.0):
            tangent[node] = total
    return [tangent.get(node, zero) for node in nodes]


def jacobian(
    graph: Graph, name: str, nodes: Sequence[Node], symbols: Sequence[Node], columns: Sequence[int]
) -> list[tuple[str, Node]]:
    """D node / d symbol, added to the graph, as entries `name[row, column]` of a matrix with columns of symbols."""
    rows = derivatives(graph, nodes, symbols)
    return [(f"{name}[{i}, {c}]", node) for i, row in enumerate(rows) for c, node in zip(columns, row, strict=True)]


def copied(
    graph: Graph, nodes: Sequence[Node], symbols: Sequence[Node], to: Graph, values: Sequence[Node]
) -> list[Node]:
    """Nodes of a graph in another one, in which its symbols are given nodes."""
    rules: Rules = {name: partial(to.apply, name) for name in (*RULES, *SWITCHES)}
    rules = {**rules, "number": to.number, "square": lambda x: to.mul(x, x)}
    return function_of(graph, nodes, {}, rules, "node", variables=symbols)(values)
