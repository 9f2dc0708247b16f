"""Functions and modules of generated Python, compiled by numba when first called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pprint import pformat

from masking.compile.graph import Graph, Node
from masking.compile.printers import needed, statements
from masking.compile.taylor import coefficients

# Contraction to fused multiply-add is the only liberty taken with floating point: NaN, infinity and the
# order of operations are kept, so that every path computes the same numbers to rounding.
DECORATOR = '@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})'

# measured: sums of products in a free order make Taylor coefficients 1.6 times faster; the solution's error is
# that of the order and tolerance, whatever the order of summation.
FREE_ORDER = '{"contract", "reassoc", "nsz", "arcp"}'

TAYLOR_ORDER = 14
# measured: beyond this number of products of series, straight-line code costs seconds to compile.
LARGEST_TAYLOR_COST = 40

HEADER = '''"""Generated from {title!r}; do not edit."""

import math

import numba
import numpy as np

from masking import integrate

META = {meta}
'''


@dataclass
class Module:
    """The source text of a generated module: what it was made from, and its functions in order."""

    title: str
    meta: Mapping[str, object]
    functions: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return the whole source."""
        head = HEADER.format(title=self.title, meta=pformat(dict(self.meta), width=110, sort_dicts=False))
        return "\n\n".join([head, *self.functions]) + "\n"

    def add(
        self,
        signature: str,
        graph: Graph,
        results: Sequence[tuple[str, Node]],
        loads: Mapping[str, str],
        returns: Node | None = None,
    ) -> None:
        """Add a function that computes nodes.

        Args:
            signature: name and arguments, such as `energy(t, q, v, p)`.
            graph: the graph that holds the nodes.
            results: assignable texts and the nodes they get.
            loads: for each symbol text, the text that reads it from the arguments.
            returns: the node whose value is returned, if any.
        """
        pairs = [*results, ("result", returns)] if returns is not None else list(results)
        body = _loads(graph, [node for _, node in pairs], loads) + statements(graph, pairs)
        if returns is not None:
            body.append("return result")
        self._function(signature, body)

    def add_coefficients(
        self,
        graph: Graph,
        states: Sequence[Node],
        derivatives: Sequence[Node],
        *,
        time: Node,
        health: Node,
        loads: Mapping[str, str],
        order: int = TAYLOR_ORDER,
    ) -> None:
        """Add `coefficients(t, y, u, p, c)`, which writes Taylor coefficients `c[k, i]` of order k of state i."""
        state_texts = {str(graph.operations[s][1]) for s in states}
        rest = {symbol: text for symbol, text in loads.items() if symbol not in state_texts}
        body = [f"y{i}_0 = y[{i}]" for i in range(len(states))]
        body += _loads(graph, list(derivatives), rest)
        body += coefficients(graph, states, derivatives, time, order)
        body += [f"c[{k}, {i}] = y{i}_{k}" for k in range(order + 1) for i in range(len(states))]
        text = [f"{graph.operations[s][1]} = y[{i}]" for i, s in enumerate(states)]
        names = {graph.operations[n][1] for n in needed(graph, [health]) if graph.operations[n][0] == "symbol"}
        body += [line for line in text if line.split(" = ")[0] in names]
        body += _loads(graph, [health], {k: v for k, v in rest.items() if f"{k} = {v}" not in body})
        body += statements(graph, [("health", health)])
        self._function("coefficients(t, y, u, p, c)", [*body, "return health"])
        self.functions[-1] = self.functions[-1].replace('{"contract"}', FREE_ORDER, 1)

    def add_text(self, text: str) -> None:
        """Add functions written out as text; each `@compiled` line becomes the decorator."""
        self.functions.append(text.strip().replace("@compiled", DECORATOR))

    def _function(self, signature: str, body: Sequence[str]) -> None:
        self.functions.append(
            "\n".join([DECORATOR, f"def {signature}:", *(f"    {line}" for line in body or ["pass"])])
        )


def _loads(graph: Graph, nodes: Sequence[Node], loads: Mapping[str, str]) -> list[str]:
    """Return the statements that read the symbols which `nodes` use."""
    used = {str(graph.operations[n][1]) for n in needed(graph, nodes) if graph.operations[n][0] == "symbol"}
    return [f"{symbol} = {text}" for symbol, text in loads.items() if symbol in used and symbol != text]
