"""Modules of generated functions, compiled when first called: by LLVM what prints nodes, and by numba kernels.

A module is made of two kinds of functions. Both say the types of their arguments in their signature: `float`, `int`,
`Vector` and `Matrix` (C-contiguous arrays of float64), `IntVector` and `IntMatrix` (of int64).

* Expressions: `Module.add("energy(t: float, q, v, p)", graph, ...)` prints graph nodes; what has no type is a `Vector`.
* Kernels: plain functions that a factory closes over sizes and over functions of the module, such as
  `numerics.sampled_loop.transforms`. `Module.add_factory("transforms", sampled_loop.transforms, "transform",
  2)` adds what it returns; text names a function of the module, all else is written as it is. The factory lives in a
  module that takes `compiled` from `numerics.compilation` and postpones annotations (`from __future__`); import
  it from `masking.lazy_imports`, so that numba is not imported where nothing is compiled. With `work=(rows, width)` the
  last argument is work space that callers need not give. With `exported=False` only other functions of the module call
  it, and its arguments need no types.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

from masking.compile.codegen import lane_steps, llvm_text, machine_code, structs, taylor_loops
from masking.compile.codegen.graph import Graph, Node
from masking.compile.codegen.llvm_text import Expressions, Results
from masking.compile.codegen.printers import Language, needed
from masking.compile.codegen.taylor_coefficients import Dynamics, Mixed, coefficients, factored, with_common_factors
from masking.compile.codegen.taylor_loops import Loops
from masking.compile.numerics.rig_sizes import LANES

# Endings of the names of functions, and the tolerances from which on they suffice.
LOOSE, COARSE = "_loose", "_coarse"
FROM: Mapping[str, float] = {COARSE: 1e-7, LOOSE: 1e-9, "": 0.0}
SINGLE_PART = 1.0 / 200.0  # of the tolerance: measured, the rounding of hundreds of steps then stays below their errors
# measured: the work of a step grows with the square of the order, so that dynamics of many products want a lower order.
# Duffing oscillators (4 products) are fastest at 18 from errors of 1e-6 to 1e-12, where 14 takes 5 to 17 % longer;
# pendula (15) at 10 for errors from 1e-9 on, and at 12 for smaller ones.
TAYLOR_ORDERS = ({"": 18}, {"": 12, LOOSE: 10})
MOST_PRODUCTS_OF_HIGH_ORDER = 8
# measured: beyond this number of products of series, straight-line code costs seconds to compile, and code in loops is
# nearly as fast or faster: 40 Duffing oscillators, or 8 pendula on a beam.
LARGEST_TAYLOR_COST = 40
# measured: below this number of like operations at once, loops take longer than the Runge-Kutta method: a pendulum of 4
# links has 1.3 and takes 1.5 times as long, 5 pendula on a beam have 2 and take 0.7 of the time.
LEAST_SIDE_BY_SIDE = 1.6


def taylor_orders(products: int) -> Mapping[str, int]:
    """Orders of the Taylor series for dynamics with this number of products of series.

    They are by the ending of the names of their functions: `LOOSE` for tolerances from `FROM[LOOSE]` on.
    """
    return TAYLOR_ORDERS[products > MOST_PRODUCTS_OF_HIGH_ORDER]


class LaneOrder(NamedTuple):
    """Taylor series of runs side by side: the ending of the names of their functions, and what these are made for."""

    ending: str
    order: int
    doubles: int  # number of orders in double precision, from 0 on; those above are in single precision
    lanes: int


def lane_orders(products: int) -> Iterator[LaneOrder]:
    """Orders for dynamics with this number of products of series, as `taylor_orders` gives them.

    From a tolerance on, terms of higher orders are so small that their rounding to single precision does not count.
    """
    orders = taylor_orders(products)
    yield LaneOrder("", orders[""], orders[""] + 1, LANES)
    order = orders.get(LOOSE, orders[""])
    for ending in (LOOSE, COARSE):
        doubles = math.ceil(order * (1.0 + math.log(2.0**24 * SINGLE_PART) / math.log(FROM[ending])))
        yield LaneOrder(ending, order, doubles, 2 * LANES)


@dataclass(frozen=True)
class Made:
    """Arguments of `Module.add_factory`: text in `given`, or in a named tuple of it, names a function of the module."""

    factory: Callable[..., Any]
    given: tuple[object, ...]


@dataclass
class Module:
    """A generated module: what it was made from, what it says of itself, and the text of its functions.

    `definitions` are LLVM code, by name, of what prints nodes. `meta["functions"]` holds for each exported function the
    types of its arguments and results and the shape of its work space, as `machine_code` reads them; `parts` holds what
    functions were made of, for other printers, `choices` the cases of those that choose, and `links` the types of the
    arguments of functions that are machine code of their own.
    """

    title: str
    meta: dict[str, Any]
    definitions: dict[str, str] = field(default_factory=dict)
    parts: dict[str, Expressions | Made] = field(default_factory=dict)
    choices: dict[str, Sequence[Expressions]] = field(default_factory=dict)
    links: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def text(self) -> str:
        """LLVM code of what prints nodes."""
        return "\n\n".join([f"; Generated from {self.title!a}; do not edit.", *self.definitions.values()]) + "\n"

    def add(
        self,
        signature: str,
        graph: Graph,
        results: Results,
        loads: Mapping[str, str],
        returns: Node | None = None,
        *,
        free: str = "",
        lanes: int = 1,
        singles: Container[str] = (),
    ) -> None:
        """Add a function that computes nodes.

        Args:
            signature: name and arguments, such as `energy(t: float, q, v, p)`; what has no type is a `Vector`.
            graph: the graph that holds the nodes.
            results: assignable texts and the nodes they get.
            loads: for each symbol text, the text that reads it from the arguments.
            returns: the node whose value is returned, if any.
            free: the liberties that are taken with floating point.
            lanes: number of values side by side; of more than one each argument is a `Matrix` with as many columns,
                whose rows are its elements, and nothing is returned.
            singles: arguments whose elements are in single precision.
        """
        name, types = _read(signature)
        made = self.parts[name] = Expressions(types, graph, results, loads, returns)
        whole = [f"{one}.shape[1] == {lanes}" for one in types] if lanes > 1 else []
        self._export(name, types, "None" if returns is None else "float", requires=whole)
        self.definitions[name] = llvm_text.function(machine_code.symbol(name), made, free, lanes, singles)

    def add_choice(
        self, signature: str, zeros: Sequence[str], cases: Sequence[tuple[Graph, Results, Mapping[str, str]]]
    ) -> None:
        """Add a function that computes the nodes of one of several graphs, whose number is its first argument.

        `zeros` are assignable texts that are 0 where a graph has no result for them; `cases` has of each graph what
        `add` takes of it.
        """
        name, types = _read(signature)
        number, *others = types
        conditions = [f"len({one}) >= linked.case('{one}', {number})" for one in others if types[one] == "Vector"]
        self._export(name, types, "None", requires=conditions)
        none = [(target, 0) for target in zeros]
        self.choices[name] = [Expressions(types, graph, [*none, *made], loads, None) for graph, made, loads in cases]
        self.definitions[name] = llvm_text.choice(machine_code.symbol(name), types, zeros, cases)

    def add_coefficients(self, dynamics: Dynamics, orders: Mapping[str, int]) -> None:
        """Add `coefficients(t, y, u, p, c)`, which writes Taylor coefficients `c[k, i]` up to an order k of state i.

        `orders` are by the ending of the names of the functions, which all stand for the same series.
        """
        graph, time, states, derivatives, health, loads = dynamics
        every = coefficients(graph, states, factored(graph, derivatives), time=time, order=max(orders.values()))
        # measured: sums of products in a free order make Taylor coefficients 1.6 times faster; the solution's error is
        # that of the order and tolerance, whatever the order of summation.
        free = llvm_text.FREE
        for ending, order in orders.items():
            rows = every[: order + 1]
            results = [(f"c[{k}, {i}]", node) for k, row in enumerate(rows) for i, node in enumerate(row)]
            self.add(f"coefficients{ending}(t: float, y, u, p, c: Matrix)", graph, results, loads, health, free=free)

    def add_lanes(self, dynamics: Dynamics, made: LaneOrder) -> int:
        """Add what steps of several runs side by side take, a column each; return the number of rows that do not vary.

        * `lane_held(u, p, h, r)` writes what does not vary, in double precision and in single;
        * `lane_coefficients(given, y, h, r, c, s)` Taylor coefficients of state i of the orders k that are double,
          c[k n + i], and of those above, s[(k - doubles) n + i]; and the health and the rounding of `given`, whose rows
          are those of `lane_steps.GIVEN`;
        * `lane_step(given, c, s, found)` what `lane_steps.step` gives, a row each;
        * `lane_states(x, c, s, y)` the states at times x from there, in the unit of coefficients;
        * `lane_advance(found, given, c, s, y)` the states after the step, and what is other in `given`.
        """
        graph, time, states, derivatives, health, loads = dynamics
        order, doubles, size = made.order, made.doubles, len(states)
        rows_of = {name: f"given[{i}]" for i, name in enumerate(lane_steps.GIVEN)}
        read = {**loads, **rows_of, str(graph.operations[time][1]): rows_of["t"]}

        def add(name: str, arguments: str, one: Graph, found: Results, free: str = llvm_text.FUSED) -> None:
            signature = in_lanes(f"lane_{name}{made.ending}", *arguments.split())
            self.add(signature, one, found, read, free=free, lanes=made.lanes, singles={"s", "r"})

        *derivatives, health = with_common_factors(graph, factored(graph, [*derivatives, health]))
        is_mixed = doubles <= order
        mixed = Mixed(graph.symbol("unit", varying=True) if is_mixed else graph.number(1.0), doubles)
        rows = coefficients(graph, states, derivatives, time=time, order=order, mixed=mixed)
        names = [f"c[{i}]" for i in range(doubles * size)] + [f"s[{i}]" for i in range((order + 1 - doubles) * size)]
        results = dict(zip([*names, rows_of["health"]], [*chain(*rows), health], strict=True))
        if is_mixed:
            results[rows_of["rounding"]] = lane_steps.rounding(graph, rows[doubles])
        nodes, held = lane_steps.held(graph, [*results.values()])
        add("held", "u p h r", graph, [*held.items()])
        # measured: in a free order, several sums of products become one, in which each product waits for another.
        add("coefficients", "given y h r c s", graph, [*zip(results, nodes, strict=True)], llvm_text.KEPT)
        steps = Graph()
        given = {name: steps.symbol(name, varying=True) for name in lane_steps.GIVEN}
        flat = [steps.symbol(name, varying=True) for name in names]
        rows = [flat[k * size : (k + 1) * size] for k in range(order + 1)]
        found = lane_steps.step(steps, rows, given, doubles)
        add("step", "given c s found", steps, [(f"found[{i}]", node) for i, node in enumerate(found)], "")
        for name, arguments, x in (("states", "x c s y", "x[0]"), ("advance", "found given c s y", "found[0]")):
            after = lane_steps.states(steps, rows, steps.symbol(x, varying=True), doubles)
            written = [(f"y[{i}]", node) for i, node in enumerate(after)]
            if name == "advance":
                reached, unit = (steps.symbol(f"found[{i}]", varying=True) for i in (1, 3))
                count = steps.add(given["steps"], steps.number(1.0))
                written += [(rows_of["t"], reached), (rows_of["unit"], unit), (rows_of["steps"], count)]
            add(name, arguments, steps, written)
        return len(held)

    def add_coefficients_in_loops(self, loops: Loops, loads: Mapping[str, str], orders: Mapping[str, int]) -> None:
        """Add `coefficients` as `add_coefficients` does, but in loops; `c` has `loops.width` columns."""
        for ending, order in orders.items():
            name, types = _read(f"coefficients{ending}(t: float, y, u, p, c: Matrix)")
            results = [(f"y[{loops.size - 1}]", loops.time), (f"c[{order}, {loops.width - 1}]", loops.time)]
            results += [(f"c[0, {loops.places[node]}]", node) for node in loops.given]
            self.parts[name] = Expressions(types, loops.graph, results, loads, loops.time)
            self._export(name, types, "float")
            self.definitions[name] = taylor_loops.function(machine_code.symbol(name), loops, types, loads, order)

    def add_factory(
        self,
        name: str,
        factory: Callable[..., Any],
        *given: object,
        work: tuple[int, int] | None = None,
        exported: bool = True,
    ) -> None:
        """Add the function that a factory returns.

        Args:
            name: of the function in this module.
            factory: returns the function, decorated by `compiled`, or is it.
            given: arguments of the factory; text names a function of this module, all else is written as it is.
            work: the shape of the work space, which is the last argument of the function.
            exported: whether the function is called from outside of the module.
        """
        made = self.parts[name] = Made(factory, given)
        if exported:
            kernel = made_of(made, lambda text: None).py_func
            types = structs.signature(kernel)
            self._export(name, types, types.pop("return", "None"), work, getattr(kernel, "requires", ()))

    def add_link(self, signature: str) -> None:
        """Add a function that is machine code of its own: those that call it do not depend on what it is made of.

        Its signature is as for `add`, with arrays that are not empty, and it returns nothing. Its machine code is that
        of the function of this name in the `links` of `module_store.load`.
        """
        name, types = _read(signature)
        self.links[name] = types

    def _export(
        self,
        name: str,
        arguments: Mapping[str, Any],
        returned: str,
        work: tuple[int, int] | None = None,
        requires: Sequence[str] = (),
    ) -> None:
        """Describe a function in `meta`."""
        for argument, kind in structs.fields(arguments).items():
            if kind not in machine_code.C_TYPES:
                raise TypeError(f"{name}: {argument} is of the type '{kind}'; give {', '.join(machine_code.C_TYPES)}")
        results = [] if returned == "None" else re.findall(r"float|int", returned)
        flat, conditions = structs.fields(arguments), [structs.flat(text, arguments) for text in requires]
        described = {"arguments": flat, "results": results, "work": work, "requires": conditions}
        self.meta.setdefault("functions", {})[name] = described


def made_of(part: Made, named: Callable[[str], object]) -> Any:  # noqa: ANN401  (numba has no types)
    """Kernel that a factory makes of what it was given, with `named(text)` in place of each function of the module.

    What is a kernel itself is that.
    """

    def filled(value: Any) -> Any:  # noqa: ANN401
        if structs.is_struct(type(value)):
            return type(value)(*map(filled, value))
        return named(value) if isinstance(value, str) else value

    return part.factory if hasattr(part.factory, "py_func") else part.factory(*map(filled, part.given))


def in_lanes(name: str, *arguments: str) -> str:
    """Signature of a function in lanes."""
    return f"{name}({', '.join(f'{argument}: Matrix' for argument in arguments)})"


def _read(signature: str) -> tuple[str, dict[str, str]]:
    """Name of a function and the types of its arguments by their names."""
    (function,) = ast.parse(f"def {signature}: pass").body
    assert isinstance(function, ast.FunctionDef)  # noqa: S101
    types = {a.arg: ast.unparse(a.annotation) if a.annotation else "Vector" for a in function.args.args}
    return function.name, types


def reads(graph: Graph, nodes: Sequence[Node], loads: Mapping[str, str], language: Language) -> list[str]:
    """Statements that read the symbols which nodes use, each by the text that `loads` has for it."""
    used = {str(graph.operations[n][1]) for n in needed(graph, nodes) if graph.operations[n][0] == "symbol"}
    read = [(symbol, text) for symbol, text in loads.items() if symbol in used and symbol != text]
    return [f"{language.declare}{symbol} = {text}{language.end}" for symbol, text in read]
