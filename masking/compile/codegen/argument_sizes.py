"""Least sizes of the arrays that a generated function reads and writes, from its own text.

Machine code does not look at sizes: an array that is too short would be read and written beyond its end, so that
`machine_code` refuses it. Elements of expressions are in their text. A kernel's are those that it indexes by whole
numbers which its factory has closed over, in the loops over these too, and what the functions need that it calls, also
where a run decides whether it happens. What indices need that a run decides is declared: `argument_conditions`.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

from masking.compile.codegen import structs
from masking.compile.codegen.c_expressions import COMPARISONS
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.kernel_source import Closure, Named, part_of
from masking.compile.codegen.llvm_text import Expressions
from masking.compile.codegen.printers import needed

Sizes = dict[str, list[int]]
Range = tuple[int, int]  # least and greatest value of an index
_ELEMENT = re.compile(r"^(\w+)\[(\d+)(?:, (\d+))?\]$")


def least_sizes(module: Module) -> dict[str, Sizes]:
    """Least size of each axis of the arrays that the exported functions of a module take, by function and argument."""
    reader = _Reader(module)
    return {name: reader.of(Named(name)) for name in module.meta.get("functions", ()) if name in module.parts}


def sizes_of_cases(module: Module, name: str) -> tuple[Sizes, dict[str, list[int]]]:
    """Least sizes of a function that chooses: those of all its cases, and of each vector where these differ."""
    cases = [_of_expressions(case) for case in module.choices[name]]
    every = {argument: [case.get(argument, [0]) for case in cases] for argument in {a for case in cases for a in case}}
    same = {argument: sizes[0] for argument, sizes in every.items() if all(one == sizes[0] for one in sizes)}
    return same, {argument: [one[0] for one in sizes] for argument, sizes in every.items() if argument not in same}


@dataclass
class _Reader:
    """Sizes of the functions of a module and of the kernels that they call, each read once."""

    module: Module
    known: dict[object, Sizes] = field(default_factory=dict)
    parts: dict[object, Expressions | Closure] = field(default_factory=dict)

    def of(self, callee: Any) -> Sizes:  # noqa: ANN401  (a function of numba, or one of a module by its name)
        if callee not in self.known:
            self.known[callee] = {}  # of one that calls itself
            part = self.part(callee)
            self.known[callee] = _of_expressions(part) if isinstance(part, Expressions) else _Kernel(part, self).read()
        return self.known[callee]

    def part(self, callee: Any) -> Expressions | Closure:  # noqa: ANN401
        if callee not in self.parts:
            own = isinstance(callee, Named)
            self.parts[callee] = part_of(self.module, callee.name) if own else Closure.of(callee)
        return self.parts[callee]

    def arguments(self, callee: Any) -> Sequence[str]:  # noqa: ANN401
        part = self.part(callee)
        return tuple(part.types) if isinstance(part, Expressions) else part.arguments


def _of_expressions(part: Expressions) -> Sizes:
    nodes = [*(node for _, node in part.results), *([] if part.returns is None else [part.returns])]
    operations = (part.graph.operations[node] for node in needed(part.graph, nodes))
    symbols, found = (str(operation[1]) for operation in operations if operation[0] == "symbol"), Sizes()
    for text in (*(target for target, _ in part.results), *(part.loads.get(symbol, symbol) for symbol in symbols)):
        if element := _ELEMENT.match(text):
            _need(found, element[1], [int(index) + 1 for index in element.groups()[1:] if index])
    return found


def _need(sizes: Sizes, name: str, wanted: Iterable[int]) -> None:
    """Note that an array has at least some sizes; 0 asks for nothing."""
    before, wanted = sizes.get(name, []), list(wanted)
    longest = max(len(before), len(wanted))
    padded = [[*one, *[0] * (longest - len(one))] for one in (before, wanted)]
    if any(padded[1]):
        sizes[name] = [max(pair) for pair in zip(*padded, strict=True)]


class _Kernel:
    """Reads one kernel."""

    def __init__(self, closure: Closure, reader: _Reader) -> None:
        self.closure, self.reader, self.sizes = closure, reader, Sizes()
        kinds = structs.signature(closure.function)
        self.structs = {name: kinds[name] for name in closure.arguments if structs.is_struct(kinds.get(name))}
        # Arguments by the names that they have inside, and fields of structs as the C interface calls them.
        self.arrays = {name: name for name in closure.arguments if name not in self.structs}
        self.numbers: dict[str, Range] = {}
        stored = [n.id for n in ast.walk(closure.tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        self.stored = Counter([*stored, *closure.arguments])

    def read(self) -> Sizes:
        self.block(self.closure.body)
        return self.sizes

    def block(self, statements: Iterable[ast.stmt]) -> None:
        for statement in statements:
            match statement:
                case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=given)):
                    self.loop(name, [self.number(one) for one in given], statement.body)
                case ast.For() | ast.While():
                    self.block(statement.body)
                case ast.If(test=test, body=body, orelse=other):
                    self.visit(test)
                    decided = self.number(test)
                    if decided is None:
                        self.block(body)
                        self.forget(statement)
                        self.block(other)
                        self.forget(statement)
                    else:
                        self.block(body if decided else other)
                case ast.Assign(targets=[target], value=value):
                    self.visit(value)
                    self.visit(target)
                    self.name(target, value)
                case _:
                    self.visit(statement)

    def forget(self, stored: ast.AST) -> None:
        """Names that may stand for something else after a statement are not known any more."""
        for node in ast.walk(stored):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                self.arrays.pop(node.id, None)
                self.numbers.pop(node.id, None)

    def loop(self, name: str, given: Sequence[int | None], body: Sequence[ast.stmt]) -> None:
        """Read a loop over a range, whose index is known where the ends of the range are."""
        self.numbers.pop(name, None)
        known = [one for one in given if one is not None]
        if len(known) == len(given):
            indices = range(*known)
            if not indices:
                return
            self.numbers[name] = min(indices), max(indices)
        self.block(body)
        self.numbers.pop(name, None)

    def name(self, target: ast.expr, value: ast.expr) -> None:
        """Note what a name stands for after an assignment, if that is known."""
        if isinstance(target, ast.Tuple):
            self.forget(target)
            if isinstance(value, ast.Name) and value.id in self.structs:
                for part, one in zip(target.elts, self.structs[value.id]._fields, strict=True):
                    if isinstance(part, ast.Name):
                        self.arrays[part.id] = f"{value.id}_{one}"
        if isinstance(target, ast.Name):
            array, number = self.array(value), self.value(value)
            self.arrays.pop(target.id, None)
            self.numbers.pop(target.id, None)
            if array is not None:
                self.arrays[target.id] = array
            elif number is not None and self.stored[target.id] == 1:
                self.numbers[target.id] = number

    def visit(self, node: ast.AST) -> None:
        """Note what an expression indexes and calls."""
        match node:
            case ast.IfExp(test=test, body=body, orelse=other):
                self.visit(test)
                if (decided := self.number(test)) is not None:
                    self.visit(body if decided else other)
                    return
            case ast.Subscript(value=value, slice=index):
                if (array := self.array(value)) is not None:
                    _need(self.sizes, array, map(self.reach, _parts(index)))
            case ast.Call(func=ast.Name(id=name), args=given) if name in self.closure.names:
                self.call(self.closure.names[name], given)
        for child in ast.iter_child_nodes(node):
            self.visit(child)

    def call(self, callee: Any, given: Sequence[ast.expr]) -> None:  # noqa: ANN401
        """Note what a function needs of the arrays that are passed on to it."""
        linked = isinstance(callee, Named) and callee.name not in self.reader.module.parts  # machine code of its own
        if linked or not (isinstance(callee, Named) or hasattr(callee, "py_func")):
            return
        needs = self.reader.of(callee)
        for inner, value in zip(self.reader.arguments(callee), given, strict=False):
            if isinstance(value, ast.Name) and value.id in self.structs:
                for one in self.structs[value.id]._fields:
                    _need(self.sizes, f"{value.id}_{one}", needs.get(f"{inner}_{one}", []))
            elif inner in needs:
                self.passed(value, needs[inner])

    def passed(self, value: ast.expr, needs: Sequence[int]) -> None:
        """Note what is needed of an array that is passed on, whole or in part."""
        if isinstance(value, ast.Subscript):
            array, indices, left = self.array(value.value), _parts(value.slice), [*needs]
            needs = []
            for index in indices:
                if isinstance(index, ast.Slice) and left:
                    first = (0, 0) if index.lower is None else self.value(index.lower)
                    needs.append(first[0] + left[0] if first is not None and index.upper is None else 0)
                    left = left[1:]
                else:
                    needs.append(0)
            needs += left
        else:
            array = self.array(value)
        if array is not None:
            _need(self.sizes, array, needs)

    def array(self, node: ast.expr) -> str | None:
        """Argument of the kernel that an expression is, as a whole."""
        match node:
            case ast.Name(id=name):
                return self.arrays.get(name)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if name in self.structs:
                return f"{name}_{attribute}"
        return None

    def reach(self, index: ast.expr) -> int:
        """Elements that an axis has at least, if this index of it is there; 0 where that is not known."""
        if isinstance(index, ast.Slice):
            ends = [self.value(one) for one in (index.lower, index.upper) if one is not None]
            return max((end[0] for end in ends if end is not None), default=0)
        found = self.value(index)
        return 0 if found is None or found[1] < 0 else found[1] + 1

    def number(self, node: ast.expr) -> int | None:
        """A whole number or a condition that is the same in every run; None where it is not."""
        found = self.value(node)
        return None if found is None or found[0] != found[1] else found[0]

    def value(self, node: ast.expr) -> Range | None:  # noqa: PLR0911  # one for each kind of expression
        """Least and greatest value of a whole number or a condition; None where a run decides it."""
        match node:
            case ast.Constant(value=bool() | int() as constant):
                return int(constant), int(constant)
            case ast.Name(id=name) if name in self.numbers:
                return self.numbers[name]
            case ast.Name(id=name) if name not in self.stored:
                return _number(self.closure.names.get(name))
            case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                known = self.closure.names.get(name)
                return _number(getattr(known, attribute, None)) if isinstance(known, ModuleType | slice) else None
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult() as operation, right=right):
                return _combined(operation, self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[operation], comparators=[right]):
                x, y, known = self.number(left), self.number(right), COMPARISONS.get(type(operation))
                return None if x is None or y is None or known is None else _number(known[1](x, y))
            case ast.IfExp(test=test, body=body, orelse=other) if (decided := self.number(test)) is not None:
                return self.value(body if decided else other)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                found = self.number(operand)
                return None if found is None else _number(not found)
        return None


def _parts(index: ast.expr) -> list[ast.expr]:
    return index.elts if isinstance(index, ast.Tuple) else [index]


def _number(known: object) -> Range | None:
    return (int(known), int(known)) if isinstance(known, bool | int) else None


def _combined(operation: ast.operator, left: Range | None, right: Range | None) -> Range | None:
    if left is None or right is None:
        return None
    if isinstance(operation, ast.Sub):
        right = -right[1], -right[0]
    if isinstance(operation, ast.Mult):
        products = [x * y for x in left for y in right]
        return min(products), max(products)
    return left[0] + right[0], left[1] + right[1]
