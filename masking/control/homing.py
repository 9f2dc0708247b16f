"""Homing: how the rig is brought from where it stands to its initial state, before the release.

A reference moves from the one to the other and then stands still; for inputs that act through dynamics of their own, it
then moves on so that the rig passes the initial state at the release with the accelerations that are wanted there. All
paths are the polynomials of least order that are as smooth as the rig can follow (two-point Hermite interpolation).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from numpy.polynomial import Polynomial

from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.tangent import along

# The reference reaches its end at this part of the homing phase; the rest is for settling.
MOVING_PART = 0.7
# Decay of a deviation from the reference over the whole homing phase, as an exponent.
SETTLING = 60.0
# It is no faster than this part of the bandwidth with which actuators are followed: their lag would let it grow.
SETTLING_PART = 0.25


class Ends(NamedTuple):
    """Virtual coordinates (k,) where homing begins, and those where it ends with their derivatives (orders, k)."""

    start: list[Node]
    end: Sequence[list[Node]]


@dataclass(frozen=True)
class Homing:
    """How the rig is brought from where it stands to its initial state: along a smooth reference, critically damped.

    Before the release, at `since` < 0, the rig's accelerations are those of q'' = r'' - 2 a (q' - r') - a^2 (q - r)
    for the reference r.
    """

    since: Node  # node of the time since the release
    start: list[Node]  # nodes of the coordinates (n,) where the rig stands
    end: list[Node]  # nodes of the coordinates (n,) of its initial state
    time: Node  # node of the length of the homing phase, s
    bandwidth: Node | None = None  # node of that with which wanted accelerations are approached, if they are

    def accelerations(self, graph: Graph, t: Node, q: Sequence[Node], v: Sequence[Node]) -> list[Node]:
        """Accelerations of homing of the rig's coordinates (n,), by these and their velocities."""
        number, mul = graph.number, graph.mul
        one = number(1.0)
        moving, x = mul(number(MOVING_PART), self.time), self._moved(graph, t)
        rest = graph.sub(one, x)  # all derivatives of the path vanish with x and with 1 - x
        path = _hermite(graph, x, 2, 0)
        speed = graph.div(mul(number(30.0), mul(mul(x, x), mul(rest, rest))), moving)
        bend = mul(number(60.0), mul(mul(x, rest), graph.sub(rest, x)))
        bend = graph.div(bend, mul(moving, moving))
        a = graph.div(number(SETTLING), self.time)
        accelerations = []
        for x, rate, start, end in zip(q, v, self.start, self.end, strict=True):
            way = graph.sub(end, start)
            behind = graph.sub(graph.add(start, mul(way, path)), x)
            slower = graph.sub(mul(way, speed), rate)
            accelerations.append(graph.add(mul(way, bend), self._pull(graph, a, behind, slower)))
        return accelerations

    def derivatives(
        self, graph: Graph, t: Node, jets: Sequence[list[Node]], ends: Ends, wanted: Sequence[Sequence[Node]]
    ) -> list[list[Node]]:
        """Wanted accelerations and their derivatives (orders, k), replaced before the release by those of homing.

        The virtual coordinates follow a reference that at the release has the derivatives that are wanted there, and
        changes its own up to the last of them without a jump: what the dynamics of the actuators allow. `jets` are eta
        and its rate.
        """
        number, mul, add = graph.number, graph.mul, graph.add
        last, order = mul(number(1.0 - MOVING_PART), self.time), len(ends.end) - 1
        path = _hermite(graph, self._moved(graph, t), order, 0)
        s = graph.apply("max", number(0.0), graph.div(add(t, last), last))
        reference = [
            add(start, mul(graph.sub(end, start), path)) for start, end in zip(ends.start, ends.end[0], strict=True)
        ]
        size = last
        for k, row in enumerate(ends.end[2:], 2):
            size = mul(size, last)
            swing = mul(size, _hermite(graph, s, order, k))
            reference = [add(x, mul(rate, swing)) for x, rate in zip(reference, row, strict=True)]
        paths, known, found = [reference], [*jets], list[list[Node]]()
        while len(paths) < len(wanted) + 2:
            paths.append(along(graph, paths[-1], {t: number(1.0)}))
        a = graph.div(number(SETTLING), self.time)
        a = graph.apply("min", a, mul(number(SETTLING_PART), self.bandwidth)) if self.bandwidth is not None else a
        for k, later in enumerate(wanted):
            rows = zip(paths[k + 2], *paths[k : k + 2], *known[k : k + 2], strict=True)
            known.append(
                [add(e2, self._pull(graph, a, graph.sub(e0, n0), graph.sub(e1, n1))) for e2, e0, e1, n0, n1 in rows]
            )
            found.append(self.before(graph, known[-1], later))
        return found

    def before(self, graph: Graph, homing: Sequence[Node], wanted: Sequence[Node]) -> list[Node]:
        """What is wanted (k,), replaced before the release."""
        is_before = graph.apply("lt", self.since, graph.number(0.0))
        return [graph.apply("where", is_before, h, w) for h, w in zip(homing, wanted, strict=True)]

    @staticmethod
    def _pull(graph: Graph, a: Node, behind: Node, slower: Node) -> Node:
        return graph.add(graph.mul(graph.mul(a, a), behind), graph.mul(graph.mul(graph.number(2.0), a), slower))

    def _moved(self, graph: Graph, t: Node) -> Node:
        """Part of the moving part of the homing phase that is over."""
        moving = graph.mul(graph.number(MOVING_PART), self.time)
        part = graph.apply("max", graph.number(0.0), graph.div(graph.add(t, self.time), moving))
        return graph.apply("min", graph.number(1.0), part)


def _hermite(graph: Graph, x: Node, order: int, k: int) -> Node:
    """Polynomial of x whose derivatives up to an order are 0 at x = 0 and at x = 1, but the k-th, which is 1 there."""
    rest = Polynomial([1.0, -1.0])
    series = sum((math.comb(order + i, i) * rest**i for i in range(order - k + 1)), Polynomial([0.0]))
    first, *others = ((-rest) ** k / math.factorial(k) * series).coef[::-1]
    value = graph.number(first)
    for coefficient in others:
        value = graph.add(graph.number(coefficient), graph.mul(x, value))
    power = x
    for _ in range(order):
        power = graph.mul(x, power)
    return graph.mul(power, value)
