"""Graph nodes printed as functions of LLVM code, without any liberty in floating point but what is asked for.

A function has one value of each node, or one in each of several lanes, which are computed side by side: there a value
is a vector, and an element of an array is a row of such. Values are in double precision but for what `single` rounds:
an operation on such and on numbers is in single precision, too.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from masking.compile.codegen import elementary
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.printers import arguments, needed

# Sums of products in a free order, and quotients by products with the inverse.
FREE = "contract reassoc nsz arcp"
KEPT = "contract nsz arcp"  # the same with sums in their order
FUSED = "contract"  # a product and a sum in one, rounded once
PAIR = ("sin", "cos")
OWN: Mapping[str, Callable[..., Any]] = {
    **dict.fromkeys(PAIR, elementary.sine_and_cosine),
    "exp": elementary.exponential,
    "log": elementary.logarithm,
    "rough_log2": elementary.rough_log2,
    "rough_exp2": elementary.rough_exp2,
    "tan": elementary.tangent,
    "sinh": elementary.hyperbolic_sine,
    "cosh": elementary.hyperbolic_cosine,
    "tanh": elementary.hyperbolic_tangent,
    "asin": elementary.arc_sine,
    "acos": elementary.arc_cosine,
    "atan": elementary.arc_tangent,
    "atan2": elementary.arc_tangent_of_two,
}
SINGLE, DOUBLE = "float", "double"
BLOCK = 800  # lines, after which results are surely written; measured, 400 or no end take 5 % longer
# Of a number: the whole number of its size, the bits of its fraction, what its exponent is stored with, and sqrt(1/2).
BITS = {
    SINGLE: ("i32", 23, 127, struct.unpack("<i", struct.pack("<f", 0.5**0.5))[0]),
    DOUBLE: ("i64", 52, 1023, struct.unpack("<q", struct.pack("<d", 0.5**0.5))[0]),
}
INFIX = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
COMPARED = {"lt": "olt", "le": "ole"}
INTRINSICS = {"abs": "fabs"} | {f: f for f in ("sqrt", "sin", "cos", "exp", "log", "floor", "pow")}
LIBRARY = ("tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "atan2")
AXES = {"Vector": 1, "Matrix": 2}
Results = Sequence[tuple[str, Node]]
ALIGNED = 8  # bytes of an element of an array


@dataclass(frozen=True)
class Expressions:
    """What `Module.add` is given; `types` are those of the arguments by their names."""

    types: Mapping[str, str]
    graph: Graph
    results: Results
    loads: Mapping[str, str]
    returns: Node | None


def parameters(types: Mapping[str, str]) -> list[str]:
    """Parameters of a function in LLVM, by types such as `float` or `Matrix`: an array is its address and its shape."""
    found = []
    for name, kind in types.items():
        axes = range(AXES.get(kind.removeprefix("Int"), 0))
        first = "ptr noalias" if axes else {"float": "double", "int": "i64"}[kind]
        found += [f"{first} %{name}", *(f"i64 %{name}.{axis}" for axis in axes)]
    return found


def function(symbol: str, made: Expressions, free: str = "", lanes: int = 1, singles: Container[str] = ()) -> str:
    """Definition of a function that computes nodes: it reads all that it needs, and then writes results.

    Elements of the arrays `singles` are in single precision.
    """
    body, returns = Body(made.types, free, lanes, singles), made.returns
    body.compute(made.graph, made.results, made.loads, [] if returns is None else [returns])
    body.lines.append("ret void" if returns is None else f"ret double {body.values[returns]}")
    body.lines += ["never:", "ret void"] if body.blocks else []
    return body.definition(symbol, "void" if returns is None else "double")


def choice(
    symbol: str,
    types: Mapping[str, str],
    zeros: Sequence[str],
    cases: Sequence[tuple[Graph, Results, Mapping[str, str]]],
) -> str:
    """Definition of a function that computes the nodes of one of several graphs, whose number is its first argument.

    `zeros` are elements of arrays that are 0 where the graph has no result for them, or where there is no such graph;
    `cases` has of each graph what `function` takes of it.
    """
    body = Body(types, "", 1)
    body.store((target, body.number(0.0)) for target in zeros)
    labels = " ".join(f"i64 {i}, label %case.{i}" for i in range(len(cases)))
    body.lines.append(f"switch i64 %{next(iter(types))}, label %none [{labels}]")
    for i, (graph, results, loads) in enumerate(cases):
        body.lines.append(f"case.{i}:")
        body.compute(graph, results, loads)
        body.lines.append("ret void")
    body.lines += ["none:", "ret void"]
    return body.definition(symbol, "void")


def entry(symbol: str, called: str, types: Mapping[str, str], *, returns: bool) -> str:
    """Definition of a C interface, which writes what a function returns through its last argument."""
    given = ", ".join(part.replace(" noalias", "") for part in parameters(types))
    call = [f"call void @{called}({given})"]
    if returns:
        call = [f"%.value = call double @{called}({given})", "store double %.value, ptr %.found"]
    return defined(f"void @{symbol}({', '.join([*parameters(types), 'ptr noalias %.found'])})", [*call, "ret void"])


def defined(head: str, lines: Iterable[str]) -> str:
    """Definition of a function: its type, name and parameters, and its lines."""
    return "\n".join([f"define {head} {{", *(f"  {line}" for line in lines), "}"])


def constant(symbol: str, value: int) -> str:
    """Definition of a function that returns a whole number."""
    return f"define i64 @{symbol}() alwaysinline {{\n  ret i64 {value}\n}}"


def definition(text: str, symbol: str) -> str:
    """Definition of one function in a text, behind those of its parts, which are named after it: `symbol.0`."""
    found = rf"^define [a-z]+ @{re.escape(symbol)}(?:\.\d+)?\(.*?^}}$"
    return "\n\n".join(re.findall(found, text, re.MULTILINE | re.DOTALL))


def declarations(text: str) -> str:
    """Declarations of all functions of mathematics that LLVM code calls."""
    called = sorted(set(re.findall(r"call [a-z ]*(double|<\d+ x (?:double|float)>) @([\w.]+)\(([^)]*)\)", text)))
    found = {name: f"declare {kind} @{name}({', '.join([kind] * given.count(kind))})" for kind, name, given in called}
    return "\n".join(text for name, text in found.items() if name.startswith("llvm.") or name in LIBRARY)


def number(value: float) -> str:
    """Constant, to the last bit."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


class Body:
    """The lines of a function on their way, and the values that they compute."""

    def __init__(self, types: Mapping[str, str], free: str, lanes: int, singles: Container[str] = ()) -> None:
        self.types, self.free, self.lanes, self.singles = types, f"{free} " if free else "", lanes, singles
        self.type, self.truth = self._of(DOUBLE), self._of("i1")  # `type` is that of the operation at hand
        self.lines, self.blocks = list[str](), list[str]()
        self.values: dict[Node, str] = {}
        self._types: dict[str, str] = {}  # of values that are not in double precision
        self._known: dict[tuple[str, ...], str] = {}  # functions of our own, by their names and arguments
        self._count = 0

    def compute(self, graph: Graph, results: Results, loads: Mapping[str, str], more: Sequence[Node] = ()) -> None:
        """Compute nodes of a graph, which are known afterwards, and then write the results; in lanes, each at once.

        measured: written at the end, the results of many lanes take a tenth of the time.
        """
        self.values, targets = {}, dict[Node, list[str]]()
        for target, node in results:
            targets.setdefault(node, []).append(target)
        for node in needed(graph, [*(node for _, node in results), *more]):
            name, *rest = graph.operations[node]
            if name == "symbol":
                self.values[node] = self.read(loads.get(str(rest[0]), str(rest[0])))
            elif name == "number":
                self.values[node] = self.number(float(rest[0]))
            else:
                self.values[node] = self.apply(str(name), [self.values[a] for a in arguments(graph, node)])
            if self.lanes > 1 and node in targets:
                self.store((target, self.values[node]) for target in targets[node])
                self._end_block()
        if self.lanes == 1:
            self.store((target, self.values[node]) for target, node in results)

    def store(self, values: Iterable[tuple[str, str]]) -> None:
        """Write values into elements of arrays."""
        for target, value in values:
            kind = self._stored(target)
            self.lines.append(f"store {kind} {self._as(kind, value)}, ptr {self.element(target)}, align {ALIGNED}")

    def _end_block(self) -> None:
        """End a long block of lines by a branch that LLVM cannot foresee: it writes results at the end of a block."""
        if len(self.lines) > (len(self.blocks) + 1) * BLOCK:
            self.blocks.append(f"next.{len(self.blocks)}")
            one = self.new('call i64 asm "", "=r,0"(i64 1)')
            go = self.new(f"icmp eq i64 {one}, 1")
            self.lines += [f"br i1 {go}, label %{self.blocks[-1]}, label %never", f"{self.blocks[-1]}:"]

    def definition(self, symbol: str, kind: str) -> str:
        """Definition of the function, which returns a type."""
        # What does not fit into registers lies where a vector does. measured: across two lines of the cache, by the
        # chance of the caller's stack, a run takes a third more. Inlined, the attribute is lost.
        aligned = f" noinline alignstack({8 * self.lanes})" if self.lanes > 1 else ""
        return defined(f"{kind} @{symbol}({', '.join(parameters(self.types))}){aligned}", self.lines)

    def new(self, text: str) -> str:
        """New name for what a line computes."""
        self._count += 1
        self.lines.append(f"%.{self._count} = {text}")
        return f"%.{self._count}"

    def read(self, text: str) -> str:
        """Argument, an element of an array, or a number."""
        if self.types.get(text) == "float":
            return f"%{text}"
        kind = self._stored(text)
        return self._typed(kind, self.new(f"load {kind}, ptr {self.element(text)}, align {ALIGNED}"))

    def number(self, value: float) -> str:
        """Constant of the type of the operation at hand, the same in all lanes."""
        if self.type != self._of(DOUBLE):
            (value,) = struct.unpack("<f", struct.pack("<f", value))
        kind = self.type.partition(" x ")[2].rstrip(">")
        made = number(value) if self.lanes == 1 else f"<{', '.join([f'{kind} {number(value)}'] * self.lanes)}>"
        return self._typed(self.type, made)

    def _of(self, kind: str) -> str:
        """Type of a value whose element in each lane has a type."""
        return kind if self.lanes == 1 else f"<{self.lanes} x {kind}>"

    def _stored(self, text: str) -> str:
        """Type of an element of an array."""
        return self._of(SINGLE if text.partition("[")[0] in self.singles else DOUBLE)

    def _typed(self, kind: str, value: str) -> str:
        """Value, whose type is noted."""
        if kind != self._of(DOUBLE):
            self._types[value] = kind
        return value

    def _as(self, kind: str, value: str) -> str:
        """Value in another precision."""
        before = self._types.get(value, self._of(DOUBLE))
        if before == kind:
            return value
        if (kind, value) not in self._known:
            name = "fptrunc" if kind == self._of(SINGLE) else "fpext"
            self._known[kind, value] = self._typed(kind, self.new(f"{name} {before} {value} to {kind}"))
        return self._known[kind, value]

    def element(self, text: str) -> str:
        """Address of an element, such as `y[3]` or `c[2, 0]`."""
        name, _, inner = text.rstrip("]").partition("[")
        first, *rest = (int(index) for index in inner.split(","))
        kind = self._stored(text)
        if not rest:
            return self.new(f"getelementptr {kind}, ptr %{name}, i64 {first}")
        row = self.new(f"mul i64 %{name}.1, {first}")
        return self.new(f"getelementptr {kind}, ptr %{name}, i64 {self.new(f'add i64 {row}, {rest[0]}')}")

    def apply(self, name: str, given: Sequence[str]) -> str:
        """Value of an operation on values."""
        if name in {"single", "double"}:
            return self._as(self._of(SINGLE if name == "single" else DOUBLE), given[0])
        first = int(name == "where")  # a truth has no precision
        varying = {self._types.get(x, self._of(DOUBLE)) for x in given[first:] if x.startswith("%")}
        before = self.type
        if varying:
            self.type = varying.pop() if len(varying) == 1 else self._of(DOUBLE)
        found = self._applied(name, [*given[:first], *(self._as(self.type, x) for x in given[first:])])
        if name not in COMPARED:
            self._typed(self.type, found)
        self.type = before
        return found

    def _applied(self, name: str, given: Sequence[str]) -> str:
        x, zero, one = given[0], self.number(0.0), self.number(1.0)
        match name:
            case "add" | "sub" | "mul" | "div":
                found = self.new(f"{INFIX[name]} {self.free}{self.type} {x}, {given[1]}")
            case "neg":
                found = self.new(f"fneg {self.free}{self.type} {x}")
            case "lt" | "le":
                found = self._is(COMPARED[name], *given)
            case "where":
                found = self._choice(*given)
            case "min" | "max":
                found = self._choice(self._is("olt" if name == "min" else "ogt", given[1], x), given[1], x)
            case "sign":  # 0 of both zeros, and no number of what is none
                middle = self._choice(self._is("oeq", x, zero), zero, x)
                below = self._choice(self._is("olt", x, zero), self.number(-1.0), middle)
                found = self._choice(self._is("ogt", x, zero), one, below)
            case "heaviside":
                below = self._choice(self._is("oeq", x, zero), self.number(0.5), zero)
                found = self._choice(self._is("ogt", x, zero), one, below)
            case "power_of_two" | "exponent" | "significand":
                found = self._bits(name, x)
            case _:
                found = self._call(name, given)
        return found

    def _call(self, name: str, given: Sequence[str]) -> str:
        """Value of a function of mathematics: LLVM's own takes lanes, one of the library each by itself."""
        if name in OWN and self.lanes > 1:
            return self._own(name, given)
        if name in INTRINSICS:
            size = f"f{32 if self.type == self._of(SINGLE) else 64}"
            kind = size if self.lanes == 1 else f"v{self.lanes}{size}"
            return self._called(f"llvm.{INTRINSICS[name]}.{kind}", self.type, given)
        if self.lanes == 1:
            return self._called(name, "double", given)
        found = "undef"
        for lane in range(self.lanes):
            parts = [self.new(f"extractelement {self.type} {x}, i64 {lane}") for x in given]
            value = self._called(name, "double", parts)
            found = self.new(f"insertelement {self.type} {found}, double {value}, i64 {lane}")
        return found

    def _own(self, name: str, given: Sequence[str]) -> str:
        """Value of a function of our own, whose operations keep their order."""
        if (name, *given) not in self._known:
            free, self.free = self.free, f"{FUSED} "
            found = OWN[name](lambda operation, *parts: self.apply(operation, parts), self.number, *given)
            names, values = (PAIR, found) if name in PAIR else ((name,), (found,))
            self._known |= {(one, *given): value for one, value in zip(names, values, strict=True)}
            self.free = free
        return self._known[name, *given]

    def _bits(self, name: str, x: str) -> str:
        """2^x of a whole number x; or the exponent of x, or its significand in [sqrt(1/2), sqrt(2))."""
        element, fraction, bias, root_half = BITS[SINGLE if self.type == self._of(SINGLE) else DOUBLE]
        whole = self._of(element)

        def constant(value: int) -> str:
            return f"{value}" if self.lanes == 1 else f"<{', '.join([f'{element} {value}'] * self.lanes)}>"

        if name == "power_of_two":
            raised = self.new(f"add {whole} {self.new(f'fptosi {self.type} {x} to {whole}')}, {constant(bias)}")
            shifted = self.new(f"shl {whole} {raised}, {constant(fraction)}")
            return self.new(f"bitcast {whole} {shifted} to {self.type}")
        bits = self.new(f"bitcast {self.type} {x} to {whole}")
        above = self.new(f"sub {whole} {bits}, {constant(root_half)}")
        if name == "exponent":
            return self.new(f"sitofp {whole} {self.new(f'ashr {whole} {above}, {constant(fraction)}')} to {self.type}")
        power = self.new(f"and {whole} {above}, {constant(-(2**fraction))}")
        return self.new(f"bitcast {whole} {self.new(f'sub {whole} {bits}, {power}')} to {self.type}")

    def _called(self, name: str, kind: str, given: Sequence[str]) -> str:
        return self.new(f"call {self.free}{kind} @{name}({', '.join(f'{kind} {x}' for x in given)})")

    def _is(self, relation: str, a: str, b: str) -> str:
        return self.new(f"fcmp {relation} {self.type} {a}, {b}")

    def _choice(self, condition: str, a: str, b: str) -> str:
        return self.new(f"select {self.truth} {condition}, {self.type} {a}, {self.type} {b}")
