"""Functions and modules of generated Python, compiled by numba when first called."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from masking.codegen import native
from masking.codegen.graph import Graph, Node
from masking.codegen.printers import needed, statements
from masking.codegen.taylor import coefficients

# No liberty is taken with floating point: NaN, infinity and the order of operations are kept, so that every path
# computes the same numbers. measured: fused multiply-add makes the sampled loop slower, not faster.
DECORATOR = '@numba.njit(nogil=True, error_model="numpy")'
# measured: sums of products in a free order make Taylor coefficients 1.6 times faster; the solution's error is
# that of the order and tolerance, whatever the order of summation.
FREE_DECORATOR = '@numba.njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})'

# measured: the work of a step grows with the square of the order, so that dynamics of many products want a lower
# order: Duffing oscillators (4 products) are fastest at 14 from errors of 1e-6 to 1e-12, pendula (15) at 12.
TAYLOR_ORDERS = (14, 12)
MOST_PRODUCTS_OF_HIGH_ORDER = 8
# measured: beyond this number of products of series, straight-line code costs seconds to compile.
LARGEST_TAYLOR_COST = 40

HEADER = '''"""Generated from {title!r}; do not edit."""

import math

import numba
import numpy as np
from numba import carray

from masking.numerics import integrators, sampled_loop
'''


def taylor_order(products: int) -> int:
    """Return the order of the Taylor series for dynamics with this number of products of series."""
    return TAYLOR_ORDERS[products > MOST_PRODUCTS_OF_HIGH_ORDER]


@dataclass
class Module:
    """A generated module: what it was made from, what it says of itself, and the text of its functions.

    `meta["functions"]` holds for each function the names of its arguments, the kinds of its results and the shape of
    its work space, as `native` reads them.
    """

    title: str
    meta: dict[str, Any]
    functions: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return the whole source."""
        return "\n\n".join([HEADER.format(title=self.title), *self.functions]) + "\n"

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
        order: int,
    ) -> None:
        """Add `coefficients(t, y, u, p, c)`, which writes Taylor coefficients `c[k, i]` of order k of state i."""
        body = [f"y{i}_0 = y[{i}]" for i in range(len(states))]
        body += _loads(graph, [*derivatives, health], loads)
        body += coefficients(graph, states, derivatives, time, order)
        body += [f"c[{k}, {i}] = y{i}_{k}" for k in range(order + 1) for i in range(len(states))]
        body += statements(graph, [("health", health)])
        self._function("coefficients(t, y, u, p, c)", [*body, "return health"], FREE_DECORATOR)

    def add_kernel(self, text: str, results: str, work: tuple[int, int] | None = None) -> None:
        """Add a function written out as text, in which the line `@compiled` stands for the decorator.

        Args:
            text: the source; its last function is the one that is called from outside.
            results: the kinds of its results, such as 'idi'.
            work: the shape of its work space.
        """
        self.functions.append(text.strip().replace("@compiled", DECORATOR))
        self._export(re.findall(r"^def (\w+\(.*?\)):$", text, re.MULTILINE | re.DOTALL)[-1], results, work)

    def _function(self, signature: str, body: Sequence[str], decorator: str = DECORATOR) -> None:
        self.functions.append(
            "\n".join([decorator, f"def {signature}:", *(f"    {line}" for line in body or ["pass"])])
        )
        self._export(signature, "d" if body and body[-1].startswith("return") else "")

    def _export(self, signature: str, results: str, work: tuple[int, int] | None = None) -> None:
        """Add the C interface of a function, and tell of it in `meta`."""
        name, _, rest = signature.rstrip(")").partition("(")
        arguments = [part.strip() for part in rest.split(",") if part.strip()]
        self.functions.append(native.interface(name, arguments, results))
        self.meta.setdefault("functions", {})[name] = {"arguments": arguments, "results": results, "work": work}


def _loads(graph: Graph, nodes: Sequence[Node], loads: Mapping[str, str]) -> list[str]:
    """Return the statements that read the symbols which `nodes` use."""
    used = {str(graph.operations[n][1]) for n in needed(graph, nodes) if graph.operations[n][0] == "symbol"}
    return [f"{symbol} = {text}" for symbol, text in loads.items() if symbol in used and symbol != text]
