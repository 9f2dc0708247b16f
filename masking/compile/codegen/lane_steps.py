"""Steps of runs side by side, as nodes of a graph: how far the Taylor coefficients of a solution hold, and its states.

The rule is that of `masking.compile.numerics.taylor_integrator`. Where coefficients are in single precision, a step is
refused if their rounding alone might exceed the tolerance.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from functools import reduce

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import arguments, needed
from masking.compile.numerics.stop_codes import ALL_BUT_ROUNDING, MOST_STEPS, SINGULAR_PART, SMALLEST_STEP

# A rounding to single precision errs by 2^-24; terms of a sum go through several, and errors of many steps add up.
SINGLE_ROUNDING = 2.0**-20
SMALLEST_SINGLE = 2.0**-63  # whose square is far above the smallest number of single precision
LARGEST_GROWTH = 4.0  # in powers of two, of the length of a step over its unit: beyond, coefficients may vanish
# What a step depends on besides the coefficients: `due` is the time of the next sample, `first` the health at the
# start, `unit` that of the time in the coefficients, and `rounding` of the first that are single.
GIVEN = ("t", "end", "due", "unit", "tolerance", "log_tolerance", "health", "rounding", "first", "steps")


def rounding(graph: Graph, nodes: Sequence[Node]) -> Node:
    """Largest of nodes in single precision, had all terms of sums the same sign: their rounding is a part of that.

    Numbers that are rounded to single precision count as no smaller than `SMALLEST_SINGLE`, so that what is too small
    for it counts, too. Where one is too large for it, the result is infinite: also a divisor, which would hide it.
    """
    sizes, divisors = dict[Node, Node](), list[Node]()
    for node in needed(graph, nodes):
        name, given = str(graph.operations[node][0]), arguments(graph, node)
        if name == "number":
            sizes[node] = graph.number(abs(float(graph.operations[node][1])))
        elif name == "single":
            sizes[node] = graph.apply("max", graph.apply("abs", node), graph.number(SMALLEST_SINGLE))
        elif all(a in sizes for a in given) and given:
            parts = [sizes[a] for a in given]
            sizes[node] = graph.total(parts) if name in {"neg", "add", "sub"} else graph.apply(name, *parts)
            divisors += [graph.mul(part, graph.number(SMALLEST_SINGLE**2)) for part in parts[1:] if name == "div"]
    return _largest(graph, [*(sizes[node] for node in nodes), *divisors])


def held(graph: Graph, nodes: Sequence[Node]) -> tuple[list[Node], dict[str, Node]]:
    """The same values from symbols for what does not vary, each with the node that it stands for.

    They are `h[i]`, and `r[i]` where they are in single precision.
    """
    found, made, singles = dict[str, Node](), dict[Node, Node](), set[Node]()

    def ready(node: Node) -> Node:
        if node not in made and graph.is_number(node):
            return node
        if node not in made:
            name = "r" if node in singles else "h"
            text = f"{name}[{sum(one[0] == name for one in found)}]"
            found[text], made[node] = node, graph.symbol(text, varying=False)
        return made[node]

    for node in needed(graph, nodes):
        given = arguments(graph, node)
        if graph.operations[node][0] == "single" or {a for a in given if not graph.is_number(a)} & singles:
            singles.add(node)
        if graph.varying[node]:
            made[node] = graph.apply(str(graph.operations[node][0]), *map(ready, given)) if given else node
    return [*map(ready, nodes)], found


def step(graph: Graph, rows: Sequence[Sequence[Node]], given: Mapping[str, Node], doubles: int) -> list[Node]:
    """Next step, of coefficients 0 ... order, a row each, those from the order `doubles` on in single precision.

    It is what is added to the time, in the unit of coefficients, and the time then; 1 if the step needs a look, since
    there may be an obstacle or a sample is due, else 0; its length towards the end, if that does not shorten it, 0
    where the series is no number; and 1 where the error from rounding may exceed the tolerance, else 0.
    """
    apply, number, order = graph.apply, graph.number, len(rows) - 1
    is_mixed = doubles <= order

    def largest(k: int) -> Node:
        return _largest(graph, [apply("abs", node) for node in rows[k]])

    def logarithm(k: int, exponent: float) -> Node:
        """Of the length at which the largest term of an order is the tolerance to an exponent times the state."""
        if is_mixed:
            part = graph.mul(apply("single", given["log_tolerance"]), number(exponent / math.log(2.0)))
            ratio = graph.mul(apply("max", largest(k), number(SMALLEST_SINGLE)), inverse)
            found = graph.sub(part, apply("rough_log2", ratio))
        else:
            part = graph.mul(given["log_tolerance"], number(exponent))
            found = graph.add(apply("log", graph.div(state, largest(k))), part)
        return graph.mul(found, number(1.0 / k))

    t, state, unit = given["t"], apply("max", largest(0), number(SMALLEST_STEP)), number(1.0)
    is_rough, inverse = number(0.0), graph.div(number(1.0), apply("single", state))
    logarithms = [logarithm(k, 1.0) for k in (order, order - 1)]
    logarithms += [logarithm(k, k / order) for k in range(order // 2 + 2, order - 1, 2)]
    shortest = reduce(lambda a, b: apply("min", a, b), logarithms)
    total = graph.total([apply("abs", node) for row in rows[order - 1 :] for node in row])
    if is_mixed:
        bounded = apply("min", shortest, number(LARGEST_GROWTH))
        length, unit = apply("double", apply("rough_exp2", bounded)), given["unit"]
        error = reduce(graph.mul, [given["rounding"], number(SINGLE_ROUNDING), *[length] * doubles])
        is_precise = apply("lt", error, graph.mul(given["tolerance"], state))
        is_rough = apply("where", is_precise, is_rough, number(1.0))
        length = graph.mul(length, apply("abs", unit))
    else:
        length = apply("exp", shortest)
    remaining = graph.sub(given["end"], t)
    left, to_sample = apply("abs", remaining), apply("abs", graph.sub(given["due"], t))
    ahead = apply("where", apply("lt", remaining, number(0.0)), apply("neg", length), length)
    reached = graph.add(t, ahead)
    health, first = given["health"], given["first"]
    smallest = graph.mul(number(SMALLEST_STEP), apply("max", apply("abs", t), graph.mul(number(1e-3), left)))
    calm = [
        (total, number(sys.float_info.max)),
        (length, graph.mul(left, number(ALL_BUT_ROUNDING))),
        (length, to_sample),
        (smallest, length),
        (apply("abs", health), number(sys.float_info.max)),
        (graph.mul(graph.mul(first, first), number(SINGULAR_PART)), graph.mul(health, first)),
        (given["steps"], number(MOST_STEPS)),
        (is_rough, number(0.5)),
    ]
    looks = reduce(lambda found, pair: apply("where", apply("lt", *pair), found, number(1.0)), calm, number(0.0))
    ahead = apply("where", apply("lt", total, number(sys.float_info.max)), ahead, number(0.0))
    return [graph.div(graph.sub(reached, t), unit), reached, looks, ahead, is_rough]


def states(graph: Graph, rows: Sequence[Sequence[Node]], x: Node, doubles: int) -> list[Node]:
    """Sums of series at x, in the unit of coefficients, by Horner's rule; arguments as those of `step`."""
    *below, found = (list(row) for row in rows)
    for k, row in reversed([*enumerate(below)]):
        if k + 1 == doubles:
            found = [graph.apply("double", value) for value in found]
        at = graph.apply("single", x) if k >= doubles else x
        found = [graph.add(graph.mul(value, at), node) for value, node in zip(found, row, strict=True)]
    return found


def _largest(graph: Graph, nodes: Sequence[Node]) -> Node:
    return reduce(lambda a, b: graph.apply("max", a, b), nodes)
