"""Values of expressions on a graph, by rules for one kind of numbers: floats, intervals, those of mpmath."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import needed
from masking.errors import ModelError

Rules = Mapping[str, Callable[..., Any]]


def values_of(graph: Graph, nodes: Sequence[Node], known: Mapping[Node, Any], rules: Rules, kind: str) -> list[Any]:
    """Values of nodes of a graph, from those of symbols, which are known.

    Of the rules, by operation, `number` takes a float, and `square` the factor of a product with itself. The kind of
    the values is for messages.

    Raises:
        ModelError: an operation has no rule, or a symbol no value.
    """
    found: dict[Node, Any] = {}
    for node in needed(graph, nodes):
        name, *arguments = graph.operations[node]
        if node in known:
            found[node] = known[node]
        elif name == "number":
            found[node] = rules["number"](float(arguments[0]))
        elif name not in rules:
            what = f"the symbol {arguments[0]}" if name == "symbol" else f"the operation '{name}'"
            raise ModelError(f"{what} has no {kind}")
        else:
            is_square = name == "mul" and arguments[0] == arguments[1]
            inner = [found[int(a)] for a in arguments]
            found[node] = rules["square"](inner[0]) if is_square else rules[str(name)](*inner)
    return [found[node] for node in nodes]
