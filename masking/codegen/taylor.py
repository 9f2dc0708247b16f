"""Taylor coefficients of a solution, printed as straight-line code.

For y' = f(t, y) the coefficients of y at a point follow from those of f by y_(k+1) = f_k / (k + 1), and those
of f from the coefficients of its parts by one recurrence for each elementary operation.

Source: Jorba and Zou (2005), A software package for the numerical integration of ODEs by means of high-order
Taylor methods, Experimental Mathematics 14(1), section 2 (recurrences) and 3.2 (step size).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from masking.codegen.graph import NOT_ANALYTIC, Graph, Node
from masking.codegen.printers import arguments, needed, number, statements

# Operations whose recurrence needs a companion series: sin with cos, sinh with cosh, tanh and tan with 1 -+ y^2.
COMPANION = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}
LINEAR = {"neg", "add", "sub"}


def is_analytic(graph: Graph, nodes: Sequence[Node]) -> bool:
    """Tell whether every varying part of `nodes` has a Taylor series (no sign, abs, min, max, where ...).

    A power whose exponent is a parameter counts as one that has none: its recurrence divides by the base, which may
    pass through zero where the parameter is an integer.
    """

    def is_open(node: Node) -> bool:
        name, *rest = graph.operations[node]
        return name in NOT_ANALYTIC or (name == "pow" and not graph.is_number(int(rest[1])))

    return not any(graph.varying[n] and is_open(n) for n in needed(graph, nodes))


def hides_a_switch(graph: Graph, nodes: Sequence[Node]) -> bool:
    """Tell whether `nodes` hold a tanh of something that varies: a switch that a series does not show from afar.

    Away from it every coefficient of tanh is exponentially small, so that a step would be taken across the switch.
    """
    return any(graph.varying[n] and graph.operations[n][0] == "tanh" for n in needed(graph, nodes))


def degree(graph: Graph, nodes: Sequence[Node]) -> int:
    """Return the largest number of varying factors in a product of `nodes`.

    Near zero a product of d factors shows in the series of a state from order d + 1 only.
    """
    found: dict[Node, int] = {}
    for node in needed(graph, nodes):
        degrees = [found[a] for a in arguments(graph, node)] or [1]
        found[node] = (sum(degrees) if graph.operations[node][0] == "mul" else max(degrees)) * graph.varying[node]
    return max((found[n] for n in nodes), default=0)


def cost(graph: Graph, nodes: Sequence[Node]) -> int:
    """Return the number of products of series that one order of `nodes` takes."""
    return sum(
        1
        for n in needed(graph, nodes)
        if graph.varying[n] and graph.operations[n][0] not in {*LINEAR, "symbol"} and not _is_scaling(graph, n)
    )


def coefficients(
    graph: Graph, states: Sequence[Node], derivatives: Sequence[Node], time: Node, order: int
) -> list[str]:
    """Return statements that compute the Taylor coefficients 1 ... `order` of each state.

    The statements read the state symbols' order 0 from the names `y0_0, y1_0, ...` and write
    `y0_1 ... y0_order, y1_1 ...`; the constant parts and the time are read by their own names.

    Args:
        graph: the graph that holds all nodes.
        states: the symbols of the n states.
        derivatives: the nodes of their n derivatives.
        time: the symbol of the time.
        order: highest order.
    """
    return _Series(graph, states, derivatives, time).write(order)


def _is_scaling(graph: Graph, node: Node) -> bool:
    """Tell whether a node multiplies or divides a series by something that does not vary."""
    name, *rest = graph.operations[node]
    if name == "mul":
        return not all(graph.varying[int(r)] for r in rest)
    return name == "div" and not graph.varying[int(rest[1])]


class _Series:
    def __init__(self, graph: Graph, states: Sequence[Node], derivatives: Sequence[Node], time: Node) -> None:
        self.graph = graph
        self.derivatives = list(derivatives)
        self.time = time
        self.state_of = {node: i for i, node in enumerate(states)}
        order = needed(graph, self.derivatives)
        self.varying = [n for n in order if graph.varying[n]]
        self.constant: dict[Node, str] = {}
        self.companion = self._companions()
        self.rules: dict[str, Callable[..., str]] = {
            "neg": lambda n, k, a: f"-{self.at(a, k)}",
            "add": self._add,
            "sub": self._sub,
            "mul": self._mul,
            "div": self._div,
            "pow": self._pow,
            "sqrt": self._sqrt,
            "exp": lambda n, k, a: self._integral(k, a, n),
            "log": self._log,
            **dict.fromkeys(
                ("sin", "sinh", "cosh", "tan", "tanh"), lambda n, k, a: self._integral(k, a, self.companion[n])
            ),
            "cos": lambda n, k, a: "-" + self._integral(k, a, self.companion[n]),
            "atan": self._inverse,
            "asin": self._inverse,
            "acos": lambda n, k, a: self._inverse(n, k, a, sign="-"),
        }

    def _companions(self) -> dict[Node, Node | str]:
        """Return, for each sin, cos, ... of the graph, the node (or the name) of the series that goes with it."""
        by_operation = {self.graph.operations[n]: n for n in self.varying}
        return {
            n: by_operation.get(
                (COMPANION.get(str(self.graph.operations[n][0]), ""), *self.graph.operations[n][1:]), f"b{n}"
            )
            for n in self.varying
        }

    def write(self, order: int) -> list[str]:
        lines = self._constants()
        for k in range(order):
            for node in self.varying:
                name = self.graph.operations[node][0]
                if name == "symbol":
                    continue
                if k == 0:
                    lines += self._first(node)
                else:
                    lines += self._next(node, k)
            for i, derivative in enumerate(self.derivatives):
                value = self.at(derivative, k)
                lines.append(f"y{i}_{k + 1} = {value}" + (f" * {1.0 / (k + 1)!r}" if k else ""))
        return lines

    def at(self, node: Node | str, k: int) -> str:
        """Return the text of coefficient k of a node (or of a companion series, given by name)."""
        if isinstance(node, str):
            return f"{node}_{k}"
        if node in self.state_of:
            return f"y{self.state_of[node]}_{k}"
        if node == self.time:
            return str(self.graph.operations[node][1]) if k == 0 else "1.0" if k == 1 else "0.0"
        if not self.graph.varying[node]:
            return self.constant[node] if k == 0 else "0.0"
        return f"a{node}_{k}"

    def _constants(self) -> list[str]:
        used: list[Node] = []
        for node in self.varying:
            name, *rest = self.graph.operations[node]
            if name != "symbol":
                used += [int(r) for r in rest if not self.graph.varying[int(r)]]
        used += [d for d in self.derivatives if not self.graph.varying[d]]
        results = []
        for node in sorted(set(used)):
            name, *rest = self.graph.operations[node]
            if name == "number":
                self.constant[node] = number(float(rest[0]))
            else:
                self.constant[node] = f"k{node}"
                results.append((f"k{node}", node))
        return statements(self.graph, results)

    def _first(self, node: Node) -> list[str]:
        name, *rest = self.graph.operations[node]
        a = [self.at(int(r), 0) for r in rest]
        here = f"a{node}_0"
        infix = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**"}
        if name in infix:
            return [f"{here} = {a[0]} {infix[str(name)]} {a[1]}"]
        if name == "neg":
            return [f"{here} = -{a[0]}"]
        lines = [f"{here} = math.{name}({a[0]})"]
        if name in COMPANION and isinstance(self.companion[node], str):
            lines.append(f"b{node}_0 = math.{COMPANION[str(name)]}({a[0]})")
        elif name == "tan":
            lines.append(f"b{node}_0 = 1.0 + {here} * {here}")
        elif name == "tanh":
            lines.append(f"b{node}_0 = 1.0 - {here} * {here}")
        elif name == "atan":
            lines.append(f"b{node}_0 = 1.0 + {a[0]} * {a[0]}")
        elif name in {"asin", "acos"}:
            lines.append(f"b{node}_0 = math.sqrt(1.0 - {a[0]} * {a[0]})")
        return lines

    def _next(self, node: Node, k: int) -> list[str]:
        name, *rest = self.graph.operations[node]
        lines = [f"a{node}_{k} = {self.rules[str(name)](node, k, *map(int, rest))}"]
        a = int(rest[0])
        if name in COMPANION and not isinstance(self.companion[node], str):
            return lines
        if name in {"sin", "cos"}:
            sign = "-" if name == "sin" else ""
            lines.append(f"b{node}_{k} = {sign}{self._integral(k, a, node)}")
        elif name in {"sinh", "cosh"}:
            lines.append(f"b{node}_{k} = {self._integral(k, a, node)}")
        elif name in {"tan", "tanh"}:
            sign = "" if name == "tan" else "-"
            lines.append(f"b{node}_{k} = {sign}({self._square(node, k)})")
        elif name == "atan":
            lines.append(f"b{node}_{k} = {self._square(a, k)}")
        elif name in {"asin", "acos"}:
            # b = sqrt(1 - a^2): b_k = (-(a^2)_k - sum_(0<i<k) b_i b_(k-i)) / (2 b_0)
            inner = self._middle_square(f"b{node}", k)
            lines.append(f"b{node}_{k} = (-({self._square(a, k)}){' - ' + inner if inner else ''}) / (2.0 * b{node}_0)")
        return lines

    def _add(self, node: Node, k: int, a: Node, b: Node) -> str:
        return self._sum_of([self.at(a, k), self.at(b, k)])

    def _sub(self, node: Node, k: int, a: Node, b: Node) -> str:
        left, right = self.at(a, k), self.at(b, k)
        if right == "0.0":
            return left
        return f"-{right}" if left == "0.0" else f"{left} - {right}"

    def _mul(self, node: Node, k: int, a: Node, b: Node) -> str:
        if not self.graph.varying[a]:
            return f"{self.at(a, 0)} * {self.at(b, k)}"
        if not self.graph.varying[b]:
            return f"{self.at(b, 0)} * {self.at(a, k)}"
        return self._square(a, k) if a == b else self._product(a, b, range(k + 1), k)

    def _div(self, node: Node, k: int, a: Node, b: Node) -> str:
        if not self.graph.varying[b]:
            return f"{self.at(a, k)} / {self.at(b, 0)}"
        return f"({self.at(a, k)} - ({self._product(b, node, range(1, k + 1), k)})) / {self.at(b, 0)}"

    def _sqrt(self, node: Node, k: int, a: Node) -> str:
        inner = self._middle_square(node, k)
        return f"({self.at(a, k)}{' - ' + inner if inner else ''}) / (2.0 * {self.at(node, 0)})"

    def _pow(self, node: Node, k: int, a: Node, b: Node) -> str:
        # c = a^b with constant b: c_k = sum_(0<=i<k) (k b - i (b + 1)) a_(k-i) c_i / (k a_0)
        power = self.constant[b]
        terms = [
            f"({float(k)!r} * {power} - {float(i)!r} * ({power} + 1.0)) * {self.at(a, k - i)} * {self.at(node, i)}"
            for i in range(k)
        ]
        return f"({self._sum_of(terms)}) / ({float(k)!r} * {self.at(a, 0)})"

    def _log(self, node: Node, k: int, a: Node) -> str:
        terms = [f"{float(i)!r} * {self.at(node, i)} * {self.at(a, k - i)}" for i in range(1, k)]
        inner = f" - ({self._sum_of(terms)}) * {1.0 / k!r}" if terms else ""
        return f"({self.at(a, k)}{inner}) / {self.at(a, 0)}"

    def _inverse(self, node: Node, k: int, a: Node, sign: str = "") -> str:
        # c' = +-a' / b: k c_k b_0 = +-k a_k - sum_(0<i<k) i c_i b_(k-i)
        terms = [f"{float(i)!r} * {self.at(node, i)} * b{node}_{k - i}" for i in range(1, k)]
        inner = f" - ({self._sum_of(terms)}) * {1.0 / k!r}" if terms else ""
        return f"({sign}{self.at(a, k)}{inner}) / b{node}_0"

    def _integral(self, k: int, a: Node, b: Node | str) -> str:
        """Return the text of (1/k) sum_(0<i<=k) i a_i b_(k-i), the k-th coefficient of the integral of a' b."""
        terms = []
        for i in range(1, k + 1):
            if self.at(a, i) != "0.0":
                weight = "" if i == 1 else f"{float(i)!r} * "
                terms.append(f"{weight}{self.at(a, i)} * {self.at(b, k - i)}")
        return f"({self._sum_of(terms)}) * {1.0 / k!r}"

    def _product(self, a: Node, b: Node, indices: range, k: int) -> str:
        return self._sum_of([f"{self.at(a, i)} * {self.at(b, k - i)}" for i in indices])

    def _square(self, a: Node | str, k: int) -> str:
        terms = [f"{self.at(a, i)} * {self.at(a, k - i)}" for i in range((k + 1) // 2)]
        twice = f"2.0 * ({self._sum_of(terms)})" if terms else ""
        middle = f"{self.at(a, k // 2)} * {self.at(a, k // 2)}" if k % 2 == 0 else ""
        return " + ".join(part for part in (twice, middle) if part)

    def _middle_square(self, a: Node | str, k: int) -> str:
        """Return the text of sum_(0<i<k) a_i a_(k-i), or nothing where the sum is empty."""
        terms = [f"{self.at(a, i)} * {self.at(a, k - i)}" for i in range(1, k)]
        return f"({self._sum_of(terms)})" if terms else ""

    @staticmethod
    def _sum_of(terms: list[str]) -> str:
        kept = [t for t in terms if t != "0.0" and not t.startswith("0.0 *") and not t.endswith("* 0.0")]
        return " + ".join(kept) if kept else "0.0"
