"""Instants that compiled dynamics are integrated to: where an expression of the time alone switches, or has a pulse.

A step of an integrator sees what lies at its stages; at rest it would jump over a pulse. What depends on the time and
on constants alone is enclosed by intervals: an instant is overlooked only where the enclosure proves that there is
none. At a switch the last number before it and the first behind it bound a gap of some units in the last place, over
which the state is carried, so that no stage sees both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from masking.compile.codegen.graph import NOT_ANALYTIC, Graph, Node
from masking.compile.codegen.graph_values import values_of
from masking.compile.codegen.intervals import RULES, Interval, growing
from masking.compile.codegen.printers import arguments, needed
from masking.compile.numerics.arrays import Array
from masking.errors import IntegrationError

SWITCHING = [name for name in NOT_ANALYTIC if name != "where"]  # where a condition does, which is a node of its own
IN_PIECES = [name for name in NOT_ANALYTIC if name != "atan2"]  # polynomials of polynomials, between switches
TIME: Node = 0  # in the graph of `TimeSwitches`
CONSTANT = ("u[", "p[")  # beginnings of the texts that read inputs and parameters
MOST_PARTS = 400_000  # of a span in which something may switch
RESOLUTION = 4.0  # spacings of numbers: the width of a part that is not divided any more
RESOLVED = 1e-16  # the same near the time 0, as a part of the span
TINY, ROUNDING = 1e-300, 1e-12  # what rounding may make of nothing; of an enclosure, as a part of it
MOST_PULSES = 512  # parts of a span in which a pulse may hide
NARROW = 1e-9  # part of a span below which no pulse is looked for
LOOKS = np.modf(np.arange(1, 13) * 0.6180339887498949)[0]  # points of a part at which one looks: never a period
HALF = (0.25, 0.75)  # what is seen is the middle half of what one looks at: an integrator has as many stages
SEEN = 4.0  # how much wider an enclosure may be than what is seen
SMALL = 1e-4  # part of what is seen over the whole span that need not be seen
NO_INSTANTS: Array = np.empty((0, 2))


@dataclass(frozen=True, eq=False)
class TimeSwitches:
    """Expressions of the time alone in some dynamics.

    `graph` has them, with the time as its first node; `switches` change their sign where an operation switches,
    `pulses` are terms that may rise and fall between two looks. `reads` has for each further symbol its array, "u" or
    "p", and its index there.
    """

    graph: Graph
    switches: tuple[Node, ...]
    pulses: tuple[Node, ...]
    reads: Mapping[Node, tuple[str, int]]

    @classmethod
    def of(cls, graph: Graph, nodes: Sequence[Node], time: Node, loads: Mapping[str, str]) -> TimeSwitches:
        """Of the dynamics that nodes are; `loads` says how the text of each symbol that is constant is read."""
        kept, order = _Kept(graph, time, loads), needed(graph, nodes)
        timed = [node for node in order if kept.is_timed(node)]
        switching = [node for node in timed if graph.operations[node][0] in SWITCHING]
        seen = {a for n in order if not kept.is_timed(n) for a in arguments(graph, n)} | {*nodes}
        hiding = kept.hiding(node for node in timed if node in seen)
        for node in needed(graph, [*hiding, *(a for n in switching for a in arguments(graph, n))]):
            kept.copied(node)  # in computable order, so that nothing is copied deeply
        switches = [one for node in switching for one in kept.switch(node)]
        return cls(kept.graph, tuple(switches), tuple(map(kept.copied, hiding)), kept.reads)

    def to_meta(self) -> dict[str, Any] | None:
        """What `from_meta` takes, for json; None where there is neither a switch nor a pulse."""
        if not (self.switches or self.pulses):
            return None
        reads = [[node, *where] for node, where in self.reads.items()]
        operations = [list(operation) for operation in self.graph.operations]
        return {"operations": operations, "switches": self.switches, "pulses": self.pulses, "reads": reads}

    @classmethod
    def from_meta(cls, meta: Mapping[str, Any]) -> TimeSwitches:
        """Expressions that `to_meta` wrote."""
        operations = [tuple(operation) for operation in meta["operations"]]
        graph = Graph(operations, [True] * len(operations))
        reads = {int(node): (str(array), int(index)) for node, array, index in meta["reads"]}
        return cls(graph, tuple(meta["switches"]), tuple(meta["pulses"]), reads)

    def instants(self, begin: float, end: float, u: Array, p: Array, delays: Iterable[float] = ()) -> Array:
        """Last time before and first time behind each instant (b, 2), increasing, between a begin and an end.

        `u` are inputs, `p` parameters; what is seen once more after delays counts then too. The two times are one where
        nothing switches.

        Raises:
            IntegrationError: there are too many switches.
        """
        given = tuple(float({"u": u, "p": p}[array][index]) for array, index in self.reads.values())
        found = _instants(self, begin, end, given)
        again = [found + delay + np.spacing(end) * np.array([-RESOLUTION, RESOLUTION]) for delay in delays]
        found = np.concatenate([found, *again])
        low, high = found[found[:, 0] < end].T
        order = np.argsort(low, kind="stable")
        return _joined(low[order], high[order])

    def may_be(self, begin: float, end: float, u: Array, p: Array) -> NDArray[np.bool_]:
        """Runs (runs,) in which there may be instants, of parameters (runs, k); times and inputs as for `instants`."""
        given = [p[:, [index]] if array == "p" else np.array([[u[index]]]) for array, index in self.reads.values()]
        low, high = np.full(len(p), begin), np.full(len(p), end)
        seen = _Seen(self, dict(zip(self.reads, map(Interval.of, given), strict=True)))
        return seen.may_switch(low, high) | seen.may_hide(low, high, np.zeros((len(self.pulses), 1)))[0]


@dataclass(frozen=True)
class Spans:
    """Times of an integration in spans between instants.

    `grid` has the times and the ends of the spans, with the number in it at which each span begins, and the time then;
    `rows` are the numbers of the times in it. What lies in the gap of an instant is as it was before.
    """

    grid: Array
    begins: Mapping[int, float]
    rows: slice | NDArray[np.intp]

    @classmethod
    def of(cls, times: Array, instants: Array) -> Spans:
        """Spans of times (m,) in order, forwards or backwards, between instants (b, 2)."""
        if not len(instants):
            return cls(times, {}, slice(None))
        sign = 1.0 if times[-1] >= times[0] else -1.0
        low, high = (instants if sign > 0.0 else -instants[::-1, ::-1]).T
        at = sign * times
        gap = np.maximum(np.searchsorted(low, at) - 1, 0)
        at = np.where((low[gap] < at) & (at < high[gap]), low[gap], at)
        places = np.searchsorted(at, low, side="right")
        begins = {int(place) + k + 1: float(sign * t) for k, (place, t) in enumerate(zip(places, high, strict=True))}
        rows = np.arange(len(at)) + np.searchsorted(places, np.arange(len(at)), side="right")
        return cls(sign * np.insert(at, places, low), begins, rows)

    def ranges(self, count: int) -> Iterator[tuple[int, int]]:
        """Ranges of the grid, first and one after last: the spans, and about as many pieces as are wanted."""
        size = len(self.grid)
        count = max(1, min(count, size))
        return pairwise(sorted({0, size, *self.begins, *[size * i // count for i in range(1, count)]}))


class _Kept:
    """The part of a graph that depends on the time alone, copied into a graph of its own as it is asked for."""

    def __init__(self, graph: Graph, time: Node, loads: Mapping[str, str]) -> None:
        self.source, self.loads, self.graph = graph, loads, Graph()
        self.copies: dict[Node, Node] = {time: self.graph.symbol("t", varying=True)}
        self.reads: dict[Node, tuple[str, int]] = {}
        self._degree: dict[Node, float] = {time: 1.0}

    def degree(self, node: Node) -> float:
        """Degree of a node, which is a polynomial of the time between switches: infinite where it is not.

        NaN where it depends on anything else.
        """
        if node not in self._degree:
            name, inner = str(self.source.operations[node][0]), [self.degree(a) for a in arguments(self.source, node)]
            if name in {"number", "symbol"}:
                is_known = name == "number" or self.loads.get(str(self.source.operations[node][1]), "")[:2] in CONSTANT
                found = 0.0 if is_known else np.nan
            elif name in {"add", "sub", "neg", *IN_PIECES}:
                found = max(inner)
            elif name == "mul" or (name == "div" and inner[1] == 0.0):
                found = sum(inner)
            else:
                found = np.inf if any(inner) else 0.0
            self._degree[node] = np.nan if np.isnan(inner).any() else found
        return self._degree[node]

    def is_timed(self, node: Node) -> bool:
        return self.degree(node) > 0.0

    def hiding(self, nodes: Iterable[Node]) -> list[Node]:
        """Terms of nodes in which a pulse may be: neither polynomials between switches, nor harmonic."""
        found, stack = set[Node](), list(nodes)
        while stack:
            node = stack.pop()
            name, inner = str(self.source.operations[node][0]), arguments(self.source, node)
            degrees = [self.degree(a) for a in inner]
            if not self.is_timed(node) or np.isfinite(self.degree(node)):
                continue
            is_scaled = (name == "mul" and 0.0 in degrees) or (name == "div" and degrees[1] == 0.0)
            if name in {"add", "sub", "neg"} or is_scaled:
                stack += inner
            elif name not in {"sin", "cos"} or degrees[0] > 1.0:
                found.add(node)
        return sorted(found)

    def copied(self, node: Node) -> Node:
        if node not in self.copies:
            name, *rest = self.source.operations[node]
            if name == "symbol":
                array, _, index = self.loads[str(rest[0])].rstrip("]").partition("[")
                found = self.graph.symbol(str(rest[0]), varying=False)
                self.reads[found] = (array, int(index))
            elif name == "number":
                found = self.graph.number(float(rest[0]))
            else:
                found = self.graph.apply(str(name), *(self.copied(a) for a in arguments(self.source, node)))
            self.copies[node] = found
        return self.copies[node]

    def switch(self, node: Node) -> list[Node]:
        """Nodes that change sign where an operation switches."""
        first, *rest = map(self.copied, arguments(self.source, node))
        match self.source.operations[node][0]:
            case "min" | "max" | "lt" | "le":
                return [self.graph.sub(first, rest[0])]
            case "floor":
                return [self.graph.apply("sin", self.graph.mul(self.graph.number(np.pi), first))]
            case _:
                return [first, *rest]


@lru_cache(maxsize=256)
def _instants(of: TimeSwitches, begin: float, end: float, given: tuple[float, ...]) -> Array:
    seen = _Seen(of, {node: Interval.of(value) for node, value in zip(of.reads, given, strict=True)})
    gaps = _gaps(seen, begin, end)
    edges = [begin, *gaps.ravel(), end]
    between = [_ends_of_parts(seen, a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if a < b]
    found = np.concatenate([gaps, *(np.column_stack([x, x]) for x in between)])
    return np.asarray(found[np.argsort(found[:, 0], kind="stable")])


@dataclass(frozen=True)
class _Seen:
    """What is known of expressions of the time over intervals of it; the constants are one for all, or (n, 1)."""

    of: TimeSwitches
    constants: Mapping[Node, Interval]

    def may_switch(self, low: Array, high: Array) -> NDArray[np.bool_]:
        """Intervals (n,) in which a switch may be zero, and is not throughout."""
        found = self._enclosed(self.of.switches, low[:, None], high[:, None])
        may = [x.contains_zero() & (np.maximum(-x.low, x.high) > TINY) for x in found]
        return np.any(may, axis=0)[:, 0] if may else np.zeros(len(low), dtype=bool)

    def may_hide(self, low: Array, high: Array, scale: Array) -> tuple[NDArray[np.bool_], Array]:
        """Intervals (n,) in which a pulse may be that is not seen at a few points, and the scale (pulses, 1) of all."""
        if not self.of.pulses:
            return np.zeros(len(low), dtype=bool), scale
        enclosed = self._enclosed(self.of.pulses, low[:, None], high[:, None])
        width = np.array([x.width - ROUNDING * np.maximum(-x.low, x.high) for x in enclosed])[..., 0]
        points = low[:, None] + LOOKS * (high - low)[:, None]
        looked = [x.low for x in self._enclosed(self.of.pulses, points, points)]
        seen = np.array([np.subtract(*np.quantile(x, HALF[::-1], axis=1)) for x in looked])
        scale = np.maximum(scale, np.max(seen, axis=1, keepdims=True, initial=0.0, where=np.isfinite(seen)))
        return np.any(width > SEEN * seen + SMALL * scale + TINY, axis=0), scale

    def _enclosed(self, nodes: Sequence[Node], low: Array, high: Array) -> list[Interval]:
        known = {**self.constants, TIME: Interval(low, high)}
        with np.errstate(all="ignore"):
            found = values_of(self.of.graph, nodes, known, _RULES, "enclosure by intervals")
        return [Interval(*(np.broadcast_to(end, low.shape) for end in (x.low, x.high))) for x in found]


def _gaps(seen: _Seen, begin: float, end: float) -> Array:
    """Gaps (b, 2) between a begin and an end that hold all switches: parts that are divided while one may be there."""
    low, high = np.array([begin]), np.array([end])
    while len(low) <= MOST_PARTS:
        may = seen.may_switch(low, high)
        low, high = low[may], high[may]
        least = np.maximum(RESOLUTION * np.spacing(np.maximum(abs(low), abs(high))), RESOLVED * (end - begin))
        wide = high - low > least
        if not wide.any():
            return _joined(low, high)
        low, high = _halved(low, high, wide)
    raise IntegrationError(
        f"terms switch with time more often than {MOST_PARTS} times between t = {begin:g} and {end:g}; integrate a "
        "shorter time, or write the mean of what switches"
    )


def _ends_of_parts(seen: _Seen, begin: float, end: float) -> Array:
    """Ends (b,) of parts between a begin and an end, which are divided while a pulse may hide in them."""
    low, high, scale, ends = np.array([begin]), np.array([end]), np.zeros((len(seen.of.pulses), 1)), list[Array]()
    while len(low):
        may, scale = seen.may_hide(low, high, scale)
        may &= (high - low > NARROW * (end - begin)) & (len(low) <= MOST_PULSES)
        ends.append(high[~may])
        low, high = _halved(low[may], high[may], np.ones(int(may.sum()), dtype=bool))
    found = np.unique(np.concatenate(ends))
    return found[found < end]


def _joined(low: Array, high: Array) -> Array:
    """Intervals (b, 2) of others in the order of their low ends, those that touch in one."""
    if not len(low):
        return NO_INSTANTS
    high = np.maximum.accumulate(high)
    last = np.append(high[:-1] < low[1:], True)
    return np.column_stack([low[np.roll(last, 1)], high[last]])


def _halved(low: Array, high: Array, divide: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Intervals in order, with halves in place of those that are divided."""
    middle = 0.5 * (low + high)
    ends = np.stack([low, np.where(divide, middle, high), middle, high], axis=1).reshape(-1, 2, 2)
    kept = np.stack([np.ones_like(divide), divide], axis=1)
    return ends[kept][:, 0], ends[kept][:, 1]


def _within(x: Interval, low: float, high: float) -> Interval:
    """Intervals cut to where a function has values."""
    return Interval(np.clip(x.low, low, high), np.clip(x.high, low, high))


def _logarithm(x: Interval) -> Interval:
    return growing(np.log)(_within(x, 0.0, np.inf))


def _arc_sine(x: Interval) -> Interval:
    return growing(np.arcsin)(_within(x, -1.0, 1.0))


_RULES: dict[str, Callable[..., Interval]] = {
    **RULES,
    "sqrt": lambda x: growing(np.sqrt)(_within(x, 0.0, np.inf)),
    "log": _logarithm,
    "pow": lambda x, power: growing(np.exp)(power * _logarithm(x)),
    "asin": _arc_sine,
    "acos": lambda x: Interval.of(0.5 * np.pi) - _arc_sine(x),
    "atan2": lambda y, x: Interval.of(-np.pi, np.pi),
    "floor": lambda x: Interval(np.floor(x.low), np.floor(x.high)),
    "heaviside": lambda x: Interval(np.heaviside(x.low, 0.5), np.heaviside(x.high, 0.5)),
}
