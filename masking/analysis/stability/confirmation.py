"""Confirmation: the final boxes of interval proofs, enclosed again by mpmath's intervals with 100 bits.

A second implementation beside `intervals`, slower by far: what it does not confirm is not proved.
Source: Johansson et al., mpmath, interval arithmetic (`mpmath.iv`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from mpmath.ctx_iv import MPIntervalContext

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.graph_values import values_of
from masking.compile.codegen.intervals import Interval
from masking.errors import ModelError

_REACH = 1e-12  # of a root, the least half side of the box in which it is confirmed
_WIDER = 6  # times that this is made ten times larger

_iv: Any = MPIntervalContext()
_iv.prec = 100


def enclosed_again(graph: Graph, nodes: Sequence[Node], given: Mapping[Node, Interval]) -> list[Any]:
    """Enclosures of nodes of a graph over one box, as mpmath's intervals, ends `a` and `b`; a ModelError for none."""
    known = {node: _iv.mpf([float(x.low), float(x.high)]) for node, x in given.items()}
    return values_of(graph, nodes, known, _RULES, "enclosure by mpmath")


def has_root(
    graph: Graph,
    forces: Sequence[Node],
    slopes: Sequence[Node],
    at: Sequence[Node],
    *,
    given: Mapping[Node, Interval],
    box: Interval,
) -> bool:
    """Whether Krawczyk's operator maps a box around another (n,), which holds a root, into its inside.

    The forces (n,) vanish at the root; slopes (n^2,) are their derivatives by the coordinates `at` (n,), row by row.
    """
    n, middle = len(at), box.middle
    size = float(np.max(np.abs([box.low, box.high]), initial=0.0))
    reach = max(_REACH * max(size, 1e-3), float(np.max(box.width, initial=0.0)))
    for _ in range(_WIDER):
        around = dict(zip(at, (Interval.of(x - reach, x + reach) for x in middle), strict=True))
        point = dict(zip(at, (Interval.of(x) for x in middle), strict=True))
        try:
            j = enclosed_again(graph, slopes, {**given, **around})
            f = enclosed_again(graph, forces, {**given, **point})
            y = np.linalg.inv(np.array([float(x.mid) for x in j]).reshape(n, n))
        except (ModelError, np.linalg.LinAlgError, ArithmeticError, ValueError):
            return False
        spread = _iv.mpf([-reach, reach])
        inside = []
        for i in range(n):
            by = [_iv.mpf(float(x)) for x in y[i]]
            image = -sum(by[k] * f[k] for k in range(n))
            image += sum(((i == k) - sum(by[p] * j[p * n + k] for p in range(n))) * spread for k in range(n))
            inside.append(image.a > -reach and image.b < reach)
        if all(inside):
            return True
        reach *= 10.0
    return False


def _number(value: float) -> Any:  # noqa: ANN401  # mpmath has no types
    slack = 0.0 if value.is_integer() else 8.0 * float(np.spacing(abs(value)))
    return _iv.mpf(value) + _iv.mpf([-slack, slack])


def _sinh(x: Any) -> Any:  # noqa: ANN401  # mpmath has no types
    low, high = _iv.mpf(x.a), _iv.mpf(x.b)
    ends = (_iv.exp(low) - _iv.exp(-low)) / 2, (_iv.exp(high) - _iv.exp(-high)) / 2
    return _iv.mpf([ends[0].a, ends[1].b])


_RULES: dict[str, Callable[..., Any]] = {
    "number": _number,
    "square": lambda x: x**2,
    "neg": lambda x: -x,
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "sqrt": _iv.sqrt,
    "pow": lambda x, y: _iv.exp(y * _iv.log(x)),
    "exp": _iv.exp,
    "log": _iv.log,
    "sin": _iv.sin,
    "cos": _iv.cos,
    "tan": lambda x: _iv.sin(x) / _iv.cos(x),
    "atan": lambda x: _iv.atan2(x, _iv.mpf(1)),
    "sinh": _sinh,
    "cosh": lambda x: 1 + 2 * _sinh(x / 2) ** 2,
    "tanh": lambda x: 1 - 2 / (_iv.exp(2 * x) + 1),
    "abs": abs,
    "sign": lambda x: _iv.mpf([(x.a > 0) - (x.a < 0), (x.b > 0) - (x.b < 0)]),
    "lt": lambda x, y: _iv.mpf([int(x.b < y.a), int(x.a < y.b)]),
    "le": lambda x, y: _iv.mpf([int(x.b <= y.a), int(x.a <= y.b)]),
    "where": lambda c, x, y: x if c.a > 0 else y if c.b < 1 else _iv.mpf([min(x.a, y.a), max(x.b, y.b)]),
    "min": lambda x, y: _iv.mpf([min(x.a, y.a), min(x.b, y.b)]),
    "max": lambda x, y: _iv.mpf([max(x.a, y.a), max(x.b, y.b)]),
}
