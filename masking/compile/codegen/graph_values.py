"""Values of expressions on a graph, by rules for one kind of numbers: floats, arrays, intervals, those of mpmath."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import needed
from masking.errors import ModelError

Rules = Mapping[str, Callable[..., Any]]


def values_of(graph: Graph, nodes: Sequence[Node], known: Mapping[Node, Any], rules: Rules, kind: str) -> list[Any]:
    """Values of nodes of a graph, from those of symbols, which are known; as `function_of` for the rest."""
    return function_of(graph, nodes, known, rules, kind, variables=())(())


def function_of(
    graph: Graph, nodes: Sequence[Node], held: Mapping[Node, Any], rules: Rules, kind: str, *, variables: Sequence[Node]
) -> Callable[[Iterable[Any]], list[Any]]:
    """Function that gives the values of nodes of a graph for those of some variables; all else is computed once.

    Of the rules, by operation, `number` takes a float, and `square` the factor of a product with itself. The kind of
    the values is for messages.

    Raises:
        ModelError: an operation has no rule, or a symbol no value.
    """
    found, varying, steps = dict(held), set(variables), list[tuple[Node, Callable[..., Any], list[Node]]]()
    for node in needed(graph, nodes):
        name, *arguments = graph.operations[node]
        if node in varying or node in found:
            continue
        if name == "number":
            found[node] = rules["number"](float(arguments[0]))
            continue
        if name not in rules:
            what = f"the symbol {arguments[0]}" if name == "symbol" else f"the operation '{name}'"
            raise ModelError(f"{what} has no {kind}")
        inner, rule = [int(a) for a in arguments], rules[str(name)]
        if name == "mul" and inner[0] == inner[1]:
            inner, rule = inner[:1], rules["square"]
        if varying.isdisjoint(inner):
            found[node] = rule(*(found[a] for a in inner))
        else:
            varying.add(node)
            steps.append((node, rule, inner))

    def values(given: Iterable[Any]) -> list[Any]:
        here = found | dict(zip(variables, given, strict=True))
        for node, rule, inner in steps:
            here[node] = rule(*[here[a] for a in inner])
        return [here[node] for node in nodes]

    return values


# Rules for arrays in floating point.
_SAME_NAME = ("sqrt", "exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "abs", "sign", "floor", "where")
ARRAYS: Rules = {name: getattr(np, name) for name in _SAME_NAME} | {
    "number": float,
    "square": lambda x: x * x,
    "neg": np.negative,
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "pow": np.power,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "min": np.minimum,
    "max": np.maximum,
    "lt": np.less,
    "le": np.less_equal,
    "heaviside": lambda x: np.heaviside(x, 0.5),
}
