"""Taylor coefficients in loops over orders and over like operations, for dynamics of many products.

Written out, the coefficients of n products up to order k take n k^2 / 2 operations of code. Here one function computes
one coefficient of a run of like operations, such as the sines of N pendula, several side by side; code grows with the
number of runs. Runs are found in the graph, whatever made it: operations of the same name whose arguments are as far
from the states, and lie one behind the other or are the same for all.

All series lie in the rows of `c`: `c[k, i]` is coefficient k of state i, and of other nodes behind the states.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

from masking.compile.codegen import llvm_text
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import arguments, needed
from masking.compile.codegen.taylor_coefficients import Dynamics, Recurrences, companions, factored
from masking.compile.numerics.rig_sizes import LANES

SUMS, SWAPPED = {"add", "sub", "neg"}, {"add", "mul"}
LARGEST_CHAIN = 4  # terms of a sum; one of more is a tree, whose halves are runs
# Operations that need no lower coefficient of themselves are computed together with what they are part of, up to this
# number of operands. measured: what is stored and read again takes half the time of linear dynamics.
MOST_OPERANDS = 8
RATE = "rate"
Places = tuple[int, ...]


@dataclass(frozen=True, order=True)
class Kind:
    """What a function computes that is called for a run: operations on operands, nested, the first of them the name.

    A number in `text` is that of an operand; what the recurrence of the outermost operation needs besides is the last.
    """

    text: str  # nested tuples
    varying: tuple[bool, ...]  # of each operand
    has_series: bool  # whether more than its coefficient 0 is wanted


@dataclass(frozen=True)
class Run:
    """Like operations, whose series lie from `first` on; of element i operand j lies at `begins[j] + i strides[j]`."""

    kind: Kind
    first: int
    count: int
    begins: Places
    strides: Places

    @property
    def lanes(self) -> int:
        """Number of elements that are computed side by side."""
        return min(LANES, 1 << (self.count.bit_length() - 1))

    @property
    def blocks(self) -> int:
        """Number of times that as many are: the last may take some elements again, to the same result."""
        return -(-self.count // self.lanes)


@dataclass(frozen=True)
class Loops:
    """Derivatives as runs, in computable order."""

    graph: Graph
    size: int  # number of states, whose series are the first
    given: Sequence[Node]  # the time and what does not vary, whose series follow
    time: Node
    health: int  # where this lies
    places: Mapping[Node, int]
    runs: Sequence[Run]
    rates: Sequence[Run]  # from derivatives to the states

    @classmethod
    def of(cls, dynamics: Dynamics) -> Loops:
        """Find the runs."""
        graph, time, states, derivatives, health, _ = dynamics
        *derivatives, health = _balanced(graph, [*factored(graph, derivatives), health])
        beside = companions(graph, derivatives)
        series = {*needed(graph, [*derivatives, *beside.values()])}
        every = needed(graph, [*series, health])
        used = {*derivatives, health, *(a for n in every if graph.varying[n] for a in arguments(graph, n))}
        fixed = sorted((n for n in used if not graph.varying[n]), key=lambda n: (_like(graph, n), n))
        places = {node: place for place, node in enumerate([*states, time, *fixed])}
        varying = [n for n in every if graph.varying[n] and n not in places]
        layout = _Layout(graph, beside, series, places)
        layout.join(varying, derivatives, health)
        runs = [
            run for level in layout.levels(varying) for run in _cut((places[n], *layout.described(n)) for n in level)
        ]
        rates = _cut((place, *layout.described(node, is_rate=True)) for place, node in enumerate(derivatives))
        return cls(graph, len(states), [time, *fixed], time, places[health], places, runs, [*rates])

    @property
    def width(self) -> int:
        """Number of series."""
        return len(self.places)

    @property
    def side_by_side(self) -> float:
        """Mean number of elements that are computed at once."""
        return sum(run.count for run in self.runs) / sum(run.blocks for run in self.runs)


@dataclass(frozen=True)
class _Layout:
    """Places of series; those of like operations lie one behind the other in the order of their operands."""

    graph: Graph
    beside: Mapping[Node, Node]
    series: set[Node]
    places: dict[Node, int]
    joined: dict[Node, int] = field(default_factory=dict)  # nodes without a series of their own: number of operands

    def join(self, nodes: Sequence[Node], derivatives: Sequence[Node], health: Node) -> None:
        """Find what is computed together with the only operation that it is part of, one of its order."""
        graph, uses = self.graph, Counter([*derivatives, health, health])
        lower = set[Node]()  # nodes whose lower coefficients an operation needs
        for node in nodes:
            given = arguments(graph, node)
            uses.update(given)
            if not self._is_linear(node):
                lower.update(given)
        lower.update(self.beside.values())
        for node in nodes:
            size = sum(self.joined.get(a, 1) for a in arguments(graph, node))
            is_open = self._is_linear(node) or graph.operations[node][0] == "mul"
            if is_open and uses[node] == 1 and node not in lower and size <= MOST_OPERANDS:
                self.joined[node] = size

    def _is_linear(self, node: Node) -> bool:
        name, *rest = self.graph.operations[node]
        fixed = [not self.graph.varying[int(r)] for r in rest]
        return name in SUMS or (name == "mul" and any(fixed)) or (name == "div" and fixed[1])

    def levels(self, nodes: Iterable[Node]) -> list[list[Node]]:
        """Nodes of the same distance from what is given, in the order of the places that they get."""
        distance, levels = dict[Node, int](), dict[int, list[Node]]()
        for node in nodes:
            own = node not in self.joined
            distance[node] = own + max(distance.get(a, 0) for a in arguments(self.graph, node))
            if own:
                levels.setdefault(distance[node], []).append(node)
        for _, level in sorted(levels.items()):
            level.sort(key=self.described)
            self.places.update({node: len(self.places) + i for i, node in enumerate(level)})
        return [level for _, level in sorted(levels.items())]

    def described(self, node: Node, *, is_rate: bool = False) -> tuple[Kind, Places]:
        """What a node is, and the places of its operands as far as these have one."""
        shape, leaves = self._shape(node) if node not in self.places or not is_rate else ("{}", [node])
        leaves += [self.beside[node]] if node in self.beside and not is_rate else []
        distinct = list(dict.fromkeys(leaves))
        text = shape.format(*map(distinct.index, leaves))
        text = f"('{RATE}', {text})" if is_rate else text
        varying = tuple(self.graph.varying[a] for a in distinct)
        return Kind(text, varying, node in self.series), tuple(self.places.get(a, 0) for a in distinct)

    def _shape(self, node: Node) -> tuple[str, list[Node]]:
        """Text of an operation, with an empty pair of braces for each operand, and the operands."""
        name = str(self.graph.operations[node][0])
        parts = [self._shape(a) if a in self.joined else ("{}", [a]) for a in arguments(self.graph, node)]
        if name in SWAPPED:
            parts.sort(key=lambda part: (part[0], [(self.graph.varying[a], self.places.get(a, 0)) for a in part[1]]))
        return f"('{name}', {', '.join(shape for shape, _ in parts)})", [a for _, leaves in parts for a in leaves]


def _like(graph: Graph, node: Node) -> tuple[str, ...]:
    """What is the same of like operations: their names, and what their arguments are."""
    given = arguments(graph, node)
    kinds = sorted(f"{graph.operations[a][0]} {graph.varying[a]}" for a in given)
    return str(graph.operations[node][0]), str(len({*given})), *kinds


def _cut(entries: Iterable[tuple[int, Kind, Places]]) -> Iterator[Run]:
    """Runs of entries, each the place of a series, what it is, and the places of its operands."""
    for kind, alike in groupby(entries, itemgetter(1)):
        run, strides = list[tuple[int, Places]](), Places()
        for place, _, operands in alike:
            steps = tuple(b - a for a, b in zip(run[-1][1], operands, strict=True)) if run else ()
            if run and (place != run[-1][0] + 1 or not {*steps} <= {0, 1} or (len(run) > 1 and steps != strides)):
                yield Run(kind, run[0][0], len(run), run[0][1], strides)
                run, steps = [], ()
            run.append((place, operands))
            strides = steps or (0,) * len(operands)
        if run:
            yield Run(kind, run[0][0], len(run), run[0][1], strides)


def _balanced(graph: Graph, nodes: Sequence[Node]) -> list[Node]:
    """The same values, with long sums as trees of like terms, each the sum of halves that lie one behind the other."""
    every, made = needed(graph, nodes), dict[Node, Node]()
    uses = Counter([*nodes, *(a for n in every for a in arguments(graph, n))])
    sums = {n for n in every if graph.operations[n][0] in SUMS}
    inner = {a for n in sums for a in arguments(graph, n) if a in sums and uses[a] == 1}

    def terms(root: Node) -> dict[tuple[bool, tuple[str, ...]], list[Node]]:
        found, pending = dict[tuple[bool, tuple[str, ...]], list[Node]](), [(root, False)]
        while pending:
            node, is_negative = pending.pop()
            if node == root or node in inner:
                name, *given = graph.operations[node]
                signs = [is_negative != (name == "neg"), is_negative != (name == "sub")]
                pending += zip(map(int, given), signs, strict=False)
            else:
                found.setdefault((is_negative, _like(graph, made[node])), []).append(made[node])
        return found

    def tree(alike: list[Node]) -> Node:
        alike = sorted(alike)
        while len(alike) > 1:
            half = len(alike) // 2
            pairs = zip(alike[:half], alike[half : 2 * half], strict=True)
            alike = [*(graph.add(a, b) for a, b in pairs), *alike[2 * half :]]
        return alike[0]

    for node in every:
        name, given = str(graph.operations[node][0]), arguments(graph, node)
        parts = terms(node) if node in sums and node not in inner else {}
        if sum(map(len, parts.values())) > LARGEST_CHAIN:
            plus, minus = ([tree(x) for (sign, _), x in sorted(parts.items()) if sign is s] for s in (False, True))
            made[node] = reduce(graph.sub, minus, graph.total(plus))
        else:
            made[node] = graph.apply(name, *(made[a] for a in given)) if given else node
    return [made[n] for n in nodes]


def function(symbol: str, loops: Loops, types: Mapping[str, str], loads: Mapping[str, str], order: int) -> str:
    """Definition of `coefficients(t, y, u, p, c) -> health`, which writes `c[k, i]` up to an order k, and its parts.

    `types` are those of the arguments, and `loads` says how symbols but the states are read from them.
    """
    body, parts = llvm_text.Body(types, llvm_text.FREE, 1), dict[tuple[object, ...], tuple[str, str]]()
    graph = loops.graph
    results = [(f"c[0, {loops.places[node]}]", node) for node in loops.given]
    for k in range(1, order + 1):
        results.append((f"c[{k}, {loops.places[loops.time]}]", graph.number(float(k == 1))))
    body.lines += ["begin:", "br label %copy", "copy:", "%i = phi i64 [ 0, %begin ], [ %i.next, %copy ]"]
    body.lines += ["%from = getelementptr double, ptr %y, i64 %i", "%to = getelementptr double, ptr %c, i64 %i"]
    body.lines += [f"%state = load double, ptr %from, align {llvm_text.ALIGNED}"]
    body.lines += [f"store double %state, ptr %to, align {llvm_text.ALIGNED}", "%i.next = add i64 %i, 1"]
    body.lines += [
        f"%i.more = icmp slt i64 %i.next, {loops.size}",
        "br i1 %i.more, label %copy, label %given",
        "given:",
    ]
    body.compute(graph, results, loads)

    def call(runs: Iterable[Run], k: str) -> None:
        for run in runs:
            key = run.kind, run.strides, run.lanes, run.blocks > 1, k == "0"
            if key not in parts:
                name = f"{symbol}.{len(parts)}"
                parts[key] = name, _Part(run, is_first=k == "0").definition(name)
            given = ", ".join(f"i64 {x}" for x in ("%c.1", k, run.count, run.first, *run.begins))
            body.lines.append(f"call void @{parts[key][0]}(ptr %c, {given})")

    call([*loops.runs, *loops.rates], "0")
    body.lines += ["br label %order", "order:", "%k = phi i64 [ 1, %given ], [ %next, %order ]"]
    call([*(run for run in loops.runs if run.kind.has_series), *loops.rates], "%k")
    body.lines += ["%next = add i64 %k, 1", f"%more = icmp slt i64 %next, {order}"]
    body.lines += ["br i1 %more, label %order, label %last", "last:"]
    body.lines.append(f"ret double {body.read(f'c[0, {loops.health}]')}")
    return "\n\n".join([*(text for _, text in parts.values()), body.definition(symbol, "double")])


class _Sum(NamedTuple):
    """A sum of products of coefficients of two operands, see `Recurrences.total`."""

    x: str
    y: str
    ends: int
    last: int
    weighted: bool


class _Part(Recurrences):
    """A function that computes one coefficient of the elements of a run, in blocks."""

    def __init__(self, run: Run, *, is_first: bool) -> None:
        super().__init__(Graph())
        self.lanes, self.is_long, self.is_first = run.lanes, run.blocks > 1, is_first
        self.expression = ast.literal_eval(run.kind.text)
        self.is_rate = self.expression[0] == RATE
        self.part, self.own = self._symbol("part"), self._symbol("n")
        self.operands = [self.graph.symbol(f"x{i}", varying=one) for i, one in enumerate(run.kind.varying)]
        self.strides = {"n": 1} | {f"x{i}": stride for i, stride in enumerate(run.strides)}
        self.inner: dict[Node, Node] = {}  # coefficients of parts that have no series
        self.sums: dict[str, _Sum] = {}
        self.body = llvm_text.Body({}, llvm_text.FREE, self.lanes)

    def _symbol(self, text: str) -> Node:
        return self.graph.symbol(text, varying=True)

    def _of(self, x: Node, ending: str) -> Node:
        return self._symbol(f"{self.graph.operations[x][1]}.{ending}")

    def at(self, x: Node) -> Node:
        if x in self.inner:
            return self.inner[x]
        return self._of(x, "at") if self.graph.varying[x] else self.graph.number(0.0)

    def first(self, x: Node) -> Node:
        return self._of(x, "first")

    def beside(self, n: Node) -> Node:
        return self.operands[-1]

    def total(self, x: Node, y: Node, ends: int, *, last: int = 0, weighted: bool = False) -> Node:
        name = f"sum{len(self.sums)}"
        one, two = (str(self.graph.operations[z][1]) for z in (x, y))
        self.sums[name] = _Sum(one, two, ends, last, weighted)
        return self._symbol(name)

    def _coefficient(self, expression: Any) -> Node:  # noqa: ANN401  (nested tuples)
        """Coefficient of an expression."""
        if isinstance(expression, int):
            x = self.operands[expression]
            return self.first(x) if self.is_first else self.at(x)
        name, *given = expression
        if self.is_first:
            return self.graph.apply(name, *map(self._coefficient, given))
        nodes = [self.operands[x] if isinstance(x, int) else self._inner(x) for x in given]
        return self.rules[name](self.own, *nodes)

    def _inner(self, expression: Any) -> Node:  # noqa: ANN401
        found = self._symbol(f"inner{len(self.inner)}")
        self.inner[found] = self.graph.number(0.0)  # takes its number
        self.inner[found] = self._coefficient(expression)
        return found

    def definition(self, symbol: str) -> str:
        body, new = self.body, self.body.new
        result = self._coefficient(self.expression[1] if self.is_rate else self.expression)
        result = self.graph.mul(result, self.part) if self.is_rate else result
        body.lines += ["begin:", "%row = mul i64 %k, %width", f"%to.k = add i64 %k, {int(self.is_rate)}"]
        body.lines += ["%to.row = mul i64 %to.k, %width", "%order = sitofp i64 %to.k to double"]
        known = {"part": self._everywhere(new(f"fdiv double {llvm_text.number(1.0)}, %order"))}
        # The number of elements is hidden from LLVM, which else writes all blocks out.
        count = new('call i64 asm "", "=r,0"(i64 %count)') if self.is_long else f"{self.lanes}"
        last = new(f"sub i64 {count}, {self.lanes}")
        body.lines += ["br label %block", "block:"]
        body.lines += ["%i = phi i64 [ 0, %begin ], [ %i.next, %store ]"]
        body.lines += [f"%{x}.i = add i64 %{x}, {'%i' if stride else 0}" for x, stride in self.strides.items()]
        for name, made in self.sums.items():
            known[name] = self._sum(name, made)
        for node in needed(self.graph, [result]):
            operation, text = self.graph.operations[node][0], str(self.graph.operations[node][1])
            if operation == "symbol" and text not in known:
                x, _, ending = text.partition(".")
                known[text] = self._load(x, {"at": "%row", "first": "0"}[ending])
        body.types = {value.removeprefix("%"): "float" for value in known.values()}
        body.compute(self.graph, [], {text: value.removeprefix("%") for text, value in known.items()}, [result])
        address = new(f"getelementptr double, ptr %c, i64 {new('add i64 %to.row, %n.i')}")
        body.lines += ["br label %store", "store:"]
        body.lines.append(f"store {body.type} {body.values[result]}, ptr {address}, align {llvm_text.ALIGNED}")
        body.lines += [f"%i.behind = add i64 %i, {self.lanes}", f"%is.inside = icmp slt i64 %i.behind, {last}"]
        body.lines += [f"%i.next = select i1 %is.inside, i64 %i.behind, i64 {last}", f"%more = icmp slt i64 %i, {last}"]
        body.lines += ["br i1 %more, label %block, label %end", "end:", "ret void"]
        given = ", ".join(f"i64 %{x}" for x in ("width", "k", "count", *self.strides))
        return llvm_text.defined(f"void @{symbol}(ptr noalias %c, {given}) noinline", body.lines)

    def _everywhere(self, value: str) -> str:
        """Number in all lanes."""
        kind, new = self.body.type, self.body.new
        if self.lanes == 1:
            return value
        one = new(f"insertelement {kind} poison, double {value}, i64 0")
        return new(f"shufflevector {kind} {one}, {kind} poison, <{self.lanes} x i32> zeroinitializer")

    def _load(self, x: str, row: str) -> str:
        new = self.body.new
        address = new(f"getelementptr double, ptr %c, i64 {new(f'add i64 {row}, %{x}.i')}")
        if self.strides[x]:
            return new(f"load {self.body.type}, ptr {address}, align {llvm_text.ALIGNED}")
        return self._everywhere(new(f"load double, ptr {address}, align {llvm_text.ALIGNED}"))

    def _sum(self, name: str, made: _Sum) -> str:
        """Loop over the products of a sum; those of a square are the same from both ends."""
        body, new, apply = self.body, self.body.new, self.body.apply
        x, y, ends, last, weighted = made
        halved = x == y and ends == last and not weighted
        behind = new(f"add i64 %k, {1 - last * (not halved)}")
        behind = new(f"lshr i64 {behind}, 1") if halved else behind
        begin = f"{[*self.sums][[*self.sums].index(name) - 1]}.end" if name != "sum0" else "block"
        body.lines += [f"br label %{name}.head", f"{name}.head:"]
        body.lines += [f"%{name}.j = phi i64 [ {ends}, %{begin} ], [ %{name}.next, %{name}.body ]"]
        body.lines += [f"%{name} = phi {body.type} [ {body.number(0.0)}, %{begin} ], [ %{name}.new, %{name}.body ]"]
        body.lines += [f"%{name}.more = icmp slt i64 %{name}.j, {behind}"]
        body.lines += [f"br i1 %{name}.more, label %{name}.body, label %{name}.end", f"{name}.body:"]
        one = self._load(x, new(f"mul i64 %{name}.j, %width"))
        if weighted:
            one = apply("mul", [one, self._everywhere(new(f"sitofp i64 %{name}.j to double"))])
        two = self._load(y, new(f"mul i64 {new(f'sub i64 %k, %{name}.j')}, %width"))
        body.lines += [f"%{name}.new = fadd {body.free}{body.type} %{name}, {apply('mul', [one, two])}"]
        body.lines += [f"%{name}.next = add i64 %{name}.j, 1", f"br label %{name}.head", f"{name}.end:"]
        if not halved:
            return f"%{name}"
        is_odd = new("and i64 %k, 1")
        is_even = new(f"sitofp i64 {new(f'sub i64 1, {is_odd}')} to double")
        middle = self._load(x, new(f"mul i64 {new('lshr i64 %k, 1')}, %width"))
        square = apply("mul", [self._everywhere(is_even), apply("mul", [middle, middle])])
        return apply("add", [apply("add", [f"%{name}", f"%{name}"]), square])
