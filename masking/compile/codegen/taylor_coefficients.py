"""Taylor coefficients of a solution, as nodes of the graph that holds its derivatives.

For y' = f(t, y) the coefficients of y at a point follow from those of f by y_(k+1) = f_k / (k + 1), and those
of f from the coefficients of its parts by one recurrence for each elementary operation.

Source: Jorba and Zou (2005), A software package for the numerical integration of ODEs by means of high-order
Taylor methods, Experimental Mathematics 14(1), section 2 (recurrences) and 3.2 (step size).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import itemgetter
from typing import NamedTuple

from masking.compile.codegen.graph import NOT_ANALYTIC, Graph, Node
from masking.compile.codegen.printers import arguments, needed

# Operations whose recurrence needs the series of another.
PAIRS = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}
LINEAR = {"neg", "add", "sub"}


class Dynamics(NamedTuple):
    """Dynamics in a graph: symbols of the time and the states, and nodes of their derivatives and of the health."""

    graph: Graph
    time: Node
    states: Sequence[Node]
    derivatives: Sequence[Node]
    health: Node
    loads: Mapping[str, str]  # for each symbol text, the text that reads it from the arguments of a function


def is_analytic(graph: Graph, nodes: Sequence[Node]) -> bool:
    """Whether every varying part of `nodes` has a Taylor series (no sign, abs, min, max, where ...).

    A power whose exponent is a parameter counts as one that has none: its recurrence divides by the base, which may
    pass through zero where the parameter is an integer.
    """

    def is_open(node: Node) -> bool:
        name, *rest = graph.operations[node]
        return name in NOT_ANALYTIC or (name == "pow" and not graph.is_number(int(rest[1])))

    return not any(graph.varying[n] and is_open(n) for n in needed(graph, nodes))


def hides_a_switch(graph: Graph, nodes: Sequence[Node]) -> bool:
    """Whether `nodes` hold a tanh of something that varies: a switch that a series does not show from afar.

    Away from it every coefficient of tanh is exponentially small, so that a step would be taken across the switch.
    """
    return any(graph.varying[n] and graph.operations[n][0] == "tanh" for n in needed(graph, nodes))


def degree(graph: Graph, nodes: Sequence[Node]) -> int:
    """Largest number of varying factors in a product of `nodes`.

    Near zero a product of d factors shows in the series of a state from order d + 1 only.
    """
    found: dict[Node, int] = {}
    for node in needed(graph, nodes):
        degrees = [found[a] for a in arguments(graph, node)] or [1]
        found[node] = (sum(degrees) if graph.operations[node][0] == "mul" else max(degrees)) * graph.varying[node]
    return max((found[n] for n in nodes), default=0)


def cost(graph: Graph, nodes: Sequence[Node]) -> int:
    """Number of products of series that one order of `nodes` takes."""
    varying = (n for n in needed(graph, nodes) if graph.varying[n])
    return sum(graph.operations[n][0] not in {*LINEAR, "symbol"} and not _is_scaling(graph, n) for n in varying)


def coefficients(
    graph: Graph,
    states: Sequence[Node],
    derivatives: Sequence[Node],
    *,
    time: Node,
    order: int,
    mixed: Mixed | None = None,
) -> list[list[Node]]:
    """Taylor coefficients 0 ... `order` of each state, one row for each order, as new nodes of the graph.

    `states` and `time` are symbols, `derivatives` nodes of the graph, as `factored` gives them.
    """
    return _Unrolled(graph, dict(zip(states, derivatives, strict=True)), time, mixed).rows(order)


@dataclass(frozen=True)
class Mixed:
    """Precision of coefficients: those of `doubles` orders, 0 and 1 among them, are double, and all others single.

    A node `unit` is the unit of time that coefficients are in. In one that is like a step all are within the range of
    single precision, whose rounding a step makes smaller with each order. Sums are for code that keeps their order.
    """

    unit: Node
    doubles: int


def factored(graph: Graph, nodes: Sequence[Node]) -> list[Node]:
    """The same values, with factors that do not vary taken out of products, quotients and, where they are alike, sums.

    Each of these factors would cost a product in each order, and would hide that a product is a square.
    """
    one = graph.number(1.0)
    split: dict[Node, tuple[bool, Node, Node]] = {}  # whether it is negative, a factor that does not vary, and the rest

    def joined(node: Node) -> Node:
        is_negative, factor, rest = split[node]
        found = graph.mul(factor, rest)
        return graph.apply("neg", found) if is_negative else found

    for node in needed(graph, nodes):
        name, given = str(graph.operations[node][0]), arguments(graph, node)
        signs, factors, rests = zip(*(split[a] for a in given), strict=True) if given else ((), (), ())
        if not graph.varying[node]:
            is_negative = graph.is_negative(node)
            split[node] = (is_negative, graph.inner(node) if is_negative else node, one)
        elif name == "neg":
            split[node] = (not signs[0], factors[0], rests[0])
        elif name in {"mul", "div"}:
            split[node] = (signs[0] != signs[1], graph.apply(name, *factors), graph.apply(name, *rests))
        elif name in {"add", "sub"} and factors[0] == factors[1] and one not in rests:
            is_sum = (name == "add") == (signs[0] == signs[1])
            split[node] = (signs[0], factors[0], graph.apply("add" if is_sum else "sub", *rests))
        else:
            split[node] = (False, one, graph.apply(name, *map(joined, given)) if given else node)
    return [*map(joined, nodes)]


def with_common_factors(graph: Graph, nodes: Sequence[Node]) -> list[Node]:
    """The same values by fewer products of series: a b + a c is a (b + c).

    measured: a single run of pendula takes 15 % longer so, since LLVM then finds fewer like operations.
    """
    every, made = needed(graph, nodes), dict[Node, Node]()
    uses = Counter([*nodes, *(a for n in every for a in arguments(graph, n))])

    def parts(root: Node, inner: Collection[str]) -> list[tuple[bool, Node]]:
        """What a sum or a product is made of, with signs, through operations that nothing else needs."""
        found, pending = list[tuple[bool, Node]](), [(False, root)]
        while pending:
            is_negative, node = pending.pop()
            name, *given = graph.operations[node]
            if name in inner and (node == root or uses[node] == 1):
                signs = [is_negative != (name == "neg"), is_negative != (name == "sub")]
                pending += [*zip(signs, map(int, given), strict=False)][::-1]
            else:
                found.append((is_negative, node))
        return found

    def product(factors: Sequence[Node]) -> Node:
        kinds = ([f for f in sorted(factors) if graph.varying[f] is varies] for varies in (False, True))
        return graph.mul(*(reduce(graph.mul, kind, graph.number(1.0)) for kind in kinds))

    def total(terms: Sequence[tuple[bool, list[Node]]]) -> Node:
        """Sum of products of factors, with signs."""
        counts = Counter(f for _, factors in terms for f in {*factors} if graph.varying[f])
        factor, count = max(counts.items(), key=itemgetter(1), default=(0, 0))
        if count > 1:
            rest = [term for term in terms if factor not in term[1]]
            common = [(sign, [*factors]) for sign, factors in terms if factor in factors]
            for _, factors in common:
                factors.remove(factor)
            return total([(False, [factor, total(common)]), *rest])
        products = [(sign, product(factors)) for sign, factors in terms]
        minus = [node for sign, node in products if sign]
        return reduce(graph.sub, minus, graph.total([node for sign, node in products if not sign]))

    for node in every:
        name, given = str(graph.operations[node][0]), arguments(graph, node)
        made[node] = graph.apply(name, *(made[a] for a in given)) if given else node
        if name in {"add", "sub"} and graph.varying[node]:
            terms = [(sign, [made[f] for _, f in parts(term, {"mul"})]) for sign, term in parts(node, LINEAR)]
            if any(count > 1 for f, count in Counter(f for _, fs in terms for f in {*fs}).items() if graph.varying[f]):
                made[node] = total(terms)
    return [made[n] for n in nodes]


def _is_scaling(graph: Graph, node: Node) -> bool:
    """Whether a node multiplies or divides a series by something that does not vary."""
    name, *rest = graph.operations[node]
    if name == "mul":
        return not all(graph.varying[int(r)] for r in rest)
    return name == "div" and not graph.varying[int(rest[1])]


class Recurrences(ABC):
    """Coefficient k > 0 of an operation, from coefficients of what it is made from and lower ones of itself.

    Nodes are those of `graph`. `part` is 1/k.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.part = graph.number(1.0)
        self.rules: dict[str, Callable[..., Node]] = {
            "neg": lambda n, x: graph.apply("neg", self.at(x)),
            "add": lambda n, x, y: graph.add(self.at(x), self.at(y)),
            "sub": lambda n, x, y: graph.sub(self.at(x), self.at(y)),
            "mul": self._mul,
            "div": self._div,
            "pow": self._pow,
            "sqrt": self._sqrt,
            "exp": lambda n, x: self._integral(x, n),
            "log": lambda n, x: self._inverse(n, self.at(x), x),
            **dict.fromkeys(("sin", "sinh", "cosh", "tan", "tanh"), lambda n, x: self._integral(x, self.beside(n))),
            "cos": lambda n, x: graph.apply("neg", self._integral(x, self.beside(n))),
            **dict.fromkeys(("atan", "asin"), lambda n, x: self._inverse(n, self.at(x), self.beside(n))),
            "acos": lambda n, x: self._inverse(n, graph.apply("neg", self.at(x)), self.beside(n)),
        }

    @abstractmethod
    def at(self, x: Node) -> Node:
        """Coefficient k."""

    @abstractmethod
    def first(self, x: Node) -> Node:
        """Coefficient 0."""

    @abstractmethod
    def beside(self, n: Node) -> Node:
        """Companion of an operation."""

    @abstractmethod
    def total(self, x: Node, y: Node, ends: int, *, last: int = 0, weighted: bool = False) -> Node:
        """Sum over i from `ends` to k - `last` of x_i y_(k-i), each times i if weighted."""

    def _mul(self, n: Node, x: Node, y: Node) -> Node:
        if self.graph.varying[x] and self.graph.varying[y]:
            return self.total(x, y, 0)
        x, y = (y, x) if self.graph.varying[x] else (x, y)
        return self.graph.mul(self.first(x), self.at(y))

    def _div(self, n: Node, x: Node, y: Node) -> Node:
        if not self.graph.varying[y]:
            return self.graph.div(self.at(x), self.first(y))
        return self.graph.div(self.graph.sub(self.at(x), self.total(y, n, 1)), self.first(y))

    def _sqrt(self, n: Node, x: Node) -> Node:
        rest = self.graph.sub(self.at(x), self.total(n, n, 1, last=1))
        return self.graph.div(rest, self.graph.mul(self.graph.number(2.0), self.first(n)))

    def _pow(self, n: Node, x: Node, power: Node) -> Node:
        # c = x^b with constant b: k c_k x_0 = b sum_(0<i<=k) i x_i c_(k-i) - sum_(0<i<k) i c_i x_(k-i)
        graph = self.graph
        rest = self.total(n, x, 1, last=1, weighted=True)
        found = graph.sub(graph.mul(self.first(power), self.total(x, n, 1, weighted=True)), rest)
        return graph.div(graph.mul(found, self.part), self.first(x))

    def _integral(self, x: Node, y: Node) -> Node:
        """(1/k) sum_(0<i<=k) i x_i y_(k-i), of the integral of x' y."""
        return self.graph.mul(self.total(x, y, 1, weighted=True), self.part)

    def _inverse(self, n: Node, numerator: Node, y: Node) -> Node:
        """Of c' = x'/y: k c_k y_0 = k x_k - sum_(0<i<k) i c_i y_(k-i)."""
        rest = self.graph.mul(self.total(n, y, 1, last=1, weighted=True), self.part)
        return self.graph.div(self.graph.sub(numerator, rest), self.first(y))


def companion(graph: Graph, node: Node) -> Node | None:
    """What an operation's recurrence needs the series of: of sin, cos; of tan, 1 + y^2; of asin, sqrt(1 - x^2)."""
    name, *rest = graph.operations[node]
    one = graph.number(1.0)
    match name:
        case "sin" | "cos" | "sinh" | "cosh":
            return graph.apply(PAIRS[name], int(rest[0]))
        case "tan":
            return graph.add(one, graph.mul(node, node))
        case "tanh":
            return graph.sub(one, graph.mul(node, node))
        case "atan":
            return graph.add(one, graph.mul(int(rest[0]), int(rest[0])))
        case "asin" | "acos":
            return graph.apply("sqrt", graph.sub(one, graph.mul(int(rest[0]), int(rest[0]))))
    return None


def companions(graph: Graph, nodes: Sequence[Node]) -> dict[Node, Node]:
    """Companion of each varying operation that `nodes`, or these companions, are made from."""
    found = dict[Node, Node]()
    while True:
        open_nodes = [n for n in needed(graph, [*nodes, *found.values()]) if graph.varying[n] and n not in found]
        more = {n: beside for n in open_nodes if (beside := companion(graph, n)) is not None}
        if not more:
            return found
        found |= more


class _Unrolled(Recurrences):
    """Each coefficient as nodes of its own: `series[node][k]`."""

    def __init__(self, graph: Graph, rates: Mapping[Node, Node], time: Node, mixed: Mixed | None) -> None:
        super().__init__(graph)
        self.rates, self.companions = rates, companions(graph, [*rates.values()])
        every = needed(graph, [*rates.values(), *self.companions.values()])
        self.varying = [n for n in every if graph.varying[n] and graph.operations[n][0] != "symbol"]
        self.series: dict[Node, list[Node]] = {node: [node] for node in (*rates, *self.varying)}
        self.unit, self.doubles = (graph.number(1.0), 0) if mixed is None else (mixed.unit, mixed.doubles)
        self.is_in_order = mixed is not None
        self.series[time] = [time, self.unit]
        self.k, self.is_single = 0, False

    def rows(self, order: int) -> list[list[Node]]:
        graph, found = self.graph, [[*self.rates]]
        for self.k in range(order):
            if self.k + 1 == self.doubles:
                self.is_single = True
                self.series = {node: [*map(self.first, series)] for node, series in self.series.items()}
            self.part = graph.number(1.0 / self.k) if self.k else self.part
            for node in self.varying if self.k else ():
                name, *rest = graph.operations[node]
                self.series[node].append(self.rules[str(name)](node, *map(int, rest)))
            step = graph.mul(self.first(self.unit), graph.number(1.0 / (self.k + 1)))
            found.append([graph.mul(self.at(derivative), step) for derivative in self.rates.values()])
            for state, node in zip(self.rates, found[-1], strict=True):
                self.series[state].append(node)
        return found

    def at(self, x: Node) -> Node:
        return self._of(x, self.k)

    def first(self, x: Node) -> Node:
        return self.graph.apply("single", x) if self.is_single else x

    def beside(self, n: Node) -> Node:
        return self.companions[n]

    def _of(self, x: Node, k: int) -> Node:
        if not self.graph.varying[x]:
            return self.first(x) if k == 0 else self.graph.number(0.0)
        series = self.series[x]
        return series[k] if k < len(series) else self.graph.number(0.0)

    def total(self, x: Node, y: Node, ends: int, *, last: int = 0, weighted: bool = False) -> Node:
        graph, k = self.graph, self.k

        def term(i: int) -> Node:
            weight = self._of(x, i)
            if weighted and x in self.rates:  # of a state, i x_i is the coefficient before of its derivative
                weight = graph.mul(self.first(self.unit), self._of(self.rates[x], i - 1))
            elif weighted:
                weight = graph.mul(graph.number(i), weight)
            return graph.mul(weight, self._of(y, k - i))

        def total(indices: Sequence[int]) -> Node:
            if self.is_in_order:  # the latest coefficients last, so that nothing waits for them
                indices = sorted(indices, key=lambda i: abs(2 * i - k))
            return graph.total([term(i) for i in indices])

        if x != y or ends != last:
            return total(range(ends, k - last + 1))
        half = total(range(ends, (k + 1) // 2))
        twice = graph.add(half, half) if self.is_in_order else graph.mul(graph.number(2.0), half)
        return twice if k % 2 else graph.add(twice, term(k // 2))
