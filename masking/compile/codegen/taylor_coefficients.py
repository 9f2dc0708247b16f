"""Taylor coefficients of a solution, as nodes of the graph that holds its derivatives.

For y' = f(t, y) the coefficients of y at a point follow from those of f by y_(k+1) = f_k / (k + 1), and those
of f from the coefficients of its parts by one recurrence for each elementary operation.

Source: Jorba and Zou (2005), A software package for the numerical integration of ODEs by means of high-order
Taylor methods, Experimental Mathematics 14(1), section 2 (recurrences) and 3.2 (step size).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

from masking.compile.codegen.graph import NOT_ANALYTIC, Graph, Node
from masking.compile.codegen.printers import arguments, needed

# Operations whose recurrence needs a companion series: sin with cos, sinh with cosh, tanh and tan with 1 -+ y^2.
COMPANION = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}
SMALLEST_STATE = 1e-14  # that steps are measured by
LINEAR = {"neg", "add", "sub"}


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
    graph: Graph, states: Sequence[Node], derivatives: Sequence[Node], time: Node, order: int
) -> list[list[Node]]:
    """Taylor coefficients 0 ... `order` of each state, one row for each order, as new nodes of the graph.

    `states` and `time` are symbols, `derivatives` nodes of the graph.
    """
    return _Series(graph, states, factored(graph, derivatives), time).rows(order)


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


def step_terms(graph: Graph, rows: Sequence[Sequence[Node]], tolerance: Node) -> list[Node]:
    """Terms that the length of a step follows from by the rule of `masking.compile.numerics.taylor_integrator`.

    Of the Taylor coefficients 0 ... order of the states, a row each, it is the sum of the sizes of the last two terms
    of all states, which is finite where the series is one; the largest state; the length at which the larger of these
    terms are the tolerance times that; and the largest term of each second order from half the highest on, at most
    these two excepted.
    """
    order = len(rows) - 1

    def largest(k: int, least: float = 0.0) -> Node:
        sizes = [graph.apply("abs", node) for node in rows[k]]
        return reduce(lambda a, b: graph.apply("max", a, b), [graph.number(least), *sizes] if least else sizes)

    def logarithm(k: int) -> Node:
        ratio = graph.div(graph.mul(tolerance, state), largest(k))
        return graph.mul(graph.apply("log", ratio), graph.number(1.0 / k))

    total, state = graph.number(0.0), largest(0, SMALLEST_STATE)
    for last, before in zip(rows[order], rows[order - 1], strict=True):
        total = graph.add(total, graph.add(graph.apply("abs", last), graph.apply("abs", before)))
    length = graph.apply("exp", graph.apply("min", logarithm(order), logarithm(order - 1)))
    return [total, state, length, *(largest(k) for k in range(order // 2 + 2, order - 1, 2))]


def polynomials(graph: Graph, rows: Sequence[Sequence[Node]], x: Node) -> list[Node]:
    """Sums of series at x by Horner's rule; arguments as those of `step_terms`."""
    *below, found = (list(row) for row in rows)
    for row in reversed(below):
        found = [graph.add(graph.mul(value, x), node) for value, node in zip(found, row, strict=True)]
    return found


def _is_scaling(graph: Graph, node: Node) -> bool:
    """Whether a node multiplies or divides a series by something that does not vary."""
    name, *rest = graph.operations[node]
    if name == "mul":
        return not all(graph.varying[int(r)] for r in rest)
    return name == "div" and not graph.varying[int(rest[1])]


class _Series:
    """The series of each varying node, `a[node]`, and of what goes with it in its recurrence, `b[node]`."""

    def __init__(self, graph: Graph, states: Sequence[Node], derivatives: Sequence[Node], time: Node) -> None:
        self.graph = graph
        self.derivatives = list(derivatives)
        self.rates = dict(zip(states, derivatives, strict=True))
        self.varying = [n for n in needed(graph, self.derivatives) if graph.varying[n]]
        self.zero = graph.number(0.0)
        self.a: dict[Node, list[Node]] = {node: [node] for node in states}
        self.a[time] = [time, graph.number(1.0)]
        self.b: dict[Node, list[Node]] = {}
        self.rules: dict[str, Callable[..., Node]] = {
            "neg": lambda n, k, x: graph.apply("neg", self.at(x, k)),
            "add": lambda n, k, x, y: graph.add(self.at(x, k), self.at(y, k)),
            "sub": lambda n, k, x, y: graph.sub(self.at(x, k), self.at(y, k)),
            "mul": self._mul,
            "div": self._div,
            "pow": self._pow,
            "sqrt": lambda n, k, x: self._root(self.a[n], self.at(x, k), k),
            "exp": lambda n, k, x: self._integral(k, x, self.a[n]),
            "log": self._log,
            **dict.fromkeys(("sin", "sinh", "cosh", "tan", "tanh"), lambda n, k, x: self._integral(k, x, self.b[n])),
            "cos": lambda n, k, x: graph.apply("neg", self._integral(k, x, self.b[n])),
            "atan": lambda n, k, x: self._inverse(n, k, self.at(x, k)),
            "asin": lambda n, k, x: self._inverse(n, k, self.at(x, k)),
            "acos": lambda n, k, x: self._inverse(n, k, graph.apply("neg", self.at(x, k))),
        }

    def rows(self, order: int) -> list[list[Node]]:
        graph = self.graph
        states = list(self.a)[:-1]
        for k in range(order):
            for node in self.varying:
                name, *rest = graph.operations[node]
                if name != "symbol":
                    inner = [int(r) for r in rest]
                    self.a.setdefault(node, []).append(self.rules[str(name)](node, k, *inner) if k else node)
                    self._follow(node, str(name), inner[0], k)
            for state, derivative in zip(states, self.derivatives, strict=True):
                self.a[state].append(graph.mul(self.at(derivative, k), graph.number(1.0 / (k + 1))))
        return [[self.a[state][k] for state in states] for k in range(order + 1)]

    def at(self, node: Node, k: int) -> Node:
        """Coefficient k of a node."""
        if not self.graph.varying[node]:
            return node if k == 0 else self.zero
        series = self.a[node]
        return series[k] if k < len(series) else self.zero

    def _follow(self, node: Node, name: str, x: Node, k: int) -> None:
        """Add coefficient k of what goes with a node: of sin, cos; of tan, 1 + y^2; of asin, sqrt(1 - x^2)."""
        graph, series = self.graph, self.b.setdefault(node, [])
        one = graph.number(1.0)
        if name in COMPANION and k == 0:
            series.append(graph.apply(COMPANION[name], x))
        elif name in COMPANION:
            found = self._integral(k, x, self.a[node])
            series.append(graph.apply("neg", found) if name == "sin" else found)
        elif name in {"tan", "atan", "tanh"}:
            square = self._square([self.at(x if name == "atan" else node, i) for i in range(k + 1)], k)
            signed = graph.apply("neg", square) if name == "tanh" else square
            series.append(signed if k else graph.add(one, signed))
        elif name in {"asin", "acos"}:
            inner = graph.apply("neg", self._square([self.at(x, i) for i in range(k + 1)], k))
            series.append(self._root(series, inner, k) if k else graph.apply("sqrt", graph.add(one, inner)))

    def _mul(self, node: Node, k: int, x: Node, y: Node) -> Node:
        if not self.graph.varying[x] or not self.graph.varying[y]:
            x, y = (y, x) if self.graph.varying[x] else (x, y)
            return self.graph.mul(x, self.at(y, k))
        one, two = ([self.at(z, i) for i in range(k + 1)] for z in (x, y))
        return self._square(one, k) if x == y else self._product(one, two, range(k + 1), k)

    def _div(self, node: Node, k: int, x: Node, y: Node) -> Node:
        if not self.graph.varying[y]:
            return self.graph.div(self.at(x, k), y)
        below = [self.at(y, i) for i in range(k + 1)]
        rest = self._product(below, self.a[node], range(1, k + 1), k)
        return self.graph.div(self.graph.sub(self.at(x, k), rest), below[0])

    def _root(self, series: list[Node], inner: Node, k: int) -> Node:
        """C_k of c = sqrt(x): (x_k - sum_(0<i<k) c_i c_(k-i)) / (2 c_0)."""
        rest = self._product(series, series, range(1, k), k)
        twice = self.graph.mul(self.graph.number(2.0), series[0])
        return self.graph.div(self.graph.sub(inner, rest), twice)

    def _pow(self, node: Node, k: int, x: Node, power: Node) -> Node:
        # c = x^b with constant b: c_k = sum_(0<=i<k) (k b - i (b + 1)) x_(k-i) c_i / (k x_0)
        graph, terms = self.graph, []
        for i in range(k):
            more = graph.mul(graph.number(i), graph.add(power, graph.number(1.0)))
            weight = graph.sub(graph.mul(graph.number(k), power), more)
            terms.append(graph.mul(graph.mul(weight, self.at(x, k - i)), self.a[node][i]))
        return graph.div(graph.total(terms), graph.mul(graph.number(k), self.at(x, 0)))

    def _inverse(self, node: Node, k: int, numerator: Node) -> Node:
        # c' = +-x' / b: k c_k b_0 = +-k x_k - sum_(0<i<k) i c_i b_(k-i)
        terms = [self._weighted(i, self.a[node][i], self.b[node][k - i]) for i in range(1, k)]
        rest = self.graph.mul(self.graph.total(terms), self.graph.number(1.0 / k))
        return self.graph.div(self.graph.sub(numerator, rest), self.b[node][0])

    def _log(self, node: Node, k: int, x: Node) -> Node:
        terms = [self._weighted(i, self.a[node][i], self.at(x, k - i)) for i in range(1, k)]
        rest = self.graph.mul(self.graph.total(terms), self.graph.number(1.0 / k))
        return self.graph.div(self.graph.sub(self.at(x, k), rest), self.at(x, 0))

    def _integral(self, k: int, x: Node, series: list[Node]) -> Node:
        """(1/k) sum_(0<i<=k) i x_i b_(k-i), the k-th coefficient of the integral of x' b."""
        if x in self.rates:  # of a state, i x_i is the coefficient before of its derivative
            terms = [self.graph.mul(self.at(self.rates[x], i - 1), series[k - i]) for i in range(1, k + 1)]
        else:
            terms = [self._weighted(i, self.at(x, i), series[k - i]) for i in range(1, k + 1)]
        return self.graph.mul(self.graph.total(terms), self.graph.number(1.0 / k))

    def _weighted(self, i: int, x: Node, y: Node) -> Node:
        return self.graph.mul(self.graph.mul(self.graph.number(i), x), y)

    def _product(self, x: list[Node], y: list[Node], indices: range, k: int) -> Node:
        return self.graph.total([self.graph.mul(x[i], y[k - i]) for i in indices])

    def _square(self, x: list[Node], k: int) -> Node:
        graph = self.graph
        twice = graph.mul(graph.number(2.0), graph.total([graph.mul(x[i], x[k - i]) for i in range((k + 1) // 2)]))
        return twice if k % 2 else graph.add(twice, graph.mul(x[k // 2], x[k // 2]))
