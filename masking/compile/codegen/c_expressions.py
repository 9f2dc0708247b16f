"""Expressions of kernels in C99: what each is, and what of it is known when the C is written."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from types import ModuleType
from typing import Any

from masking.compile.codegen.kernel_source import Closure, Named
from masking.compile.codegen.printers import ATOM, PRODUCT, SUM, UNARY, number
from masking.compile.codegen.structs import is_struct

COMPARE, CHOICE = 0, -1
REAL, INT, BOOL, ARRAY, INTEGERS, TUPLE = "real", "int", "bool", "array", "integers", "tuple"
BINARY: dict[type[ast.operator], tuple[int, str, Callable[[Any, Any], Any]]] = {
    ast.Add: (SUM, "+", operator.add),
    ast.Sub: (SUM, "-", operator.sub),
    ast.Mult: (PRODUCT, "*", operator.mul),
    ast.Div: (PRODUCT, "/", operator.truediv),
    ast.FloorDiv: (PRODUCT, "/", operator.floordiv),
    ast.Mod: (PRODUCT, "%", operator.mod),
}
SIGNS: dict[type[ast.unaryop], tuple[str, Callable[[Any], Any]]]
SIGNS = {ast.USub: ("-", operator.neg), ast.Not: ("!", operator.not_)}
COMPARISONS: dict[type[ast.cmpop], tuple[str, Callable[[Any, Any], Any]]] = {
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}


@dataclass(frozen=True)
class Value:
    """What an expression of a kernel is."""

    kind: str  # of what it is
    text: str = ""  # in C; of an array, a pointer to its first element
    level: int = ATOM  # of the operation that is done last, as `printers` counts
    known: Any = None  # its value, where it is known when the C is written
    shape: tuple[int | None, ...] = ()  # of an array; None for a length that is not known
    root: str = ""  # the argument that an array is part of
    parts: tuple[Value, ...] = ()  # of a tuple
    fields: tuple[str, ...] = ()  # names of the parts of a named one

    @property
    def flat(self) -> tuple[Value, ...]:
        """Values that go to a function: itself, or the parts of a named tuple."""
        return tuple(one for part in self.parts for one in part.flat) if self.fields else (self,)

    def at_least(self, level: int) -> str:
        """Text, in brackets where an operation of this level takes it."""
        return self.text if self.level >= level else f"({self.text})"


@dataclass(frozen=True)
class Function:
    """A function in C: what it returns, which arguments it writes, and the text of its definition."""

    name: str
    returned: tuple[str, ...]
    written: tuple[bool, ...]
    text: str


Lookup = Callable[[object, Sequence[Value]], Function]


class CExpressions:
    """Expressions of one kernel in C, with numbers of the type `real`: `double` or `float`.

    `call` returns the C function of a callee, for its arguments.
    """

    def __init__(self, closure: Closure, arguments: Mapping[str, Value], real: str, call: Lookup) -> None:
        self.closure, self.real, self.call = closure, real, call
        self.suffix = "f" if real == "float" else ""
        self.values = dict(arguments)
        self.written: set[str] = set()
        self._table: dict[type[ast.expr], Callable[[Any], Value]] = {
            ast.Constant: lambda node: self._constant(node.value, node),
            ast.Name: self._name,
            ast.Attribute: lambda node: self._attribute(node, self.value(node.value), node.attr),
            ast.Tuple: lambda node: Value(TUPLE, parts=tuple(self.value(part) for part in node.elts)),
            ast.UnaryOp: lambda node: self._unary(node, self.value(node.operand)),
            ast.BinOp: lambda node: self._binary(node, self.value(node.left), self.value(node.right)),
            ast.Compare: lambda node: self._compare(node, self.value(node.left), self.value(node.comparators[0])),
            ast.IfExp: lambda node: self._choice(*(self.value(x) for x in (node.test, node.body, node.orelse))),
            ast.Call: lambda node: self._called(node, [self.value(a) for a in node.args]),
            ast.Subscript: lambda node: self._part(node, self.value(node.value)),
        }

    def value(self, node: ast.expr) -> Value:
        """Expression; raises a `TypeError` if it has no form in C."""
        if type(node) not in self._table:
            raise self.refusal(node, "no such expression")
        return self._table[type(node)](node)

    def target(self, node: ast.expr) -> Value:
        """Target of an assignment; the argument that it is part of counts as written."""
        found = self.value(node)
        if found.root:
            self.written.add(found.root)
        return found

    def refusal(self, node: ast.AST, why: str) -> TypeError:
        """Error of what has no form in C."""
        return TypeError(f"{self.closure.function.__qualname__}: '{ast.unparse(node)}' has no form in C: {why}")

    def _name(self, node: ast.Name) -> Value:
        known = self.values.get(node.id)
        return known if known is not None else self._constant(self.closure.names[node.id], node)

    def _constant(self, value: object, node: ast.AST) -> Value:
        if isinstance(value, bool):
            return Value(BOOL, str(int(value)), known=value)
        if isinstance(value, int):
            return Value(INT, str(value), ATOM if value >= 0 else UNARY, value)
        if isinstance(value, float) and math.isfinite(value):
            return Value(REAL, number(value, self.suffix), known=value)
        if isinstance(value, slice | ModuleType | Named) or callable(value):
            return Value("", known=value)
        raise self.refusal(node, f"a {type(value).__name__}")

    def _attribute(self, node: ast.expr, inner: Value, name: str) -> Value:
        if inner.kind == ARRAY and name == "size" and None not in inner.shape:
            return self._constant(math.prod(x for x in inner.shape if x is not None), node)
        if inner.kind == ARRAY and name == "shape" and None not in inner.shape:
            return Value(TUPLE, parts=tuple(self._constant(x, node) for x in inner.shape))
        if name in inner.fields:
            return inner.parts[inner.fields.index(name)]
        if inner.known is not None and not inner.kind:
            return self._constant(getattr(inner.known, name), node)
        raise self.refusal(node, "its length is not known")

    def _unary(self, node: ast.UnaryOp, inner: Value) -> Value:
        if type(node.op) not in SIGNS:
            raise self.refusal(node, "no such operation")
        sign, compute = SIGNS[type(node.op)]
        if inner.known is not None:
            return self._constant(compute(inner.known), node)
        return Value(inner.kind, f"{sign}{inner.at_least(UNARY)}", UNARY)

    def _binary(self, node: ast.BinOp, left: Value, right: Value) -> Value:
        if type(node.op) not in BINARY or not {left.kind, right.kind} <= {REAL, INT}:
            raise self.refusal(node, "no such operation")
        level, sign, compute = BINARY[type(node.op)]
        if left.known is not None and right.known is not None:
            return self._constant(compute(left.known, right.known), node)
        is_real = REAL in {left.kind, right.kind}
        if sign == "+" and not is_real and 0 in {left.known, right.known}:
            return right if left.known == 0 else left
        first = left.at_least(level)
        if isinstance(node.op, ast.Div) and not is_real:
            first, is_real = f"({self.real}){left.at_least(UNARY)}", True
        return Value(REAL if is_real else INT, f"{first} {sign} {right.at_least(level + 1)}", level)

    def _compare(self, node: ast.Compare, left: Value, right: Value) -> Value:
        sign, compute = COMPARISONS[type(node.ops[0])]
        if left.known is not None and right.known is not None:
            return self._constant(bool(compute(left.known, right.known)), node)
        return Value(BOOL, f"{left.at_least(SUM)} {sign} {right.at_least(SUM)}", COMPARE)

    def _choice(self, test: Value, body: Value, other: Value) -> Value:
        if test.known is not None:
            return body if test.known else other
        kind = REAL if REAL in {body.kind, other.kind} else body.kind
        return Value(kind, f"{test.at_least(SUM)} ? {body.at_least(SUM)} : {other.at_least(SUM)}", CHOICE)

    def both(self, node: ast.expr) -> Value:
        """Condition, which may be made of several."""
        if not isinstance(node, ast.BoolOp):
            return self.value(node)
        is_and, parts = isinstance(node.op, ast.And), [self.both(part) for part in node.values]
        if any(part.known is not None and bool(part.known) is not is_and for part in parts):
            return self._constant(not is_and, node)
        unknown = [part for part in parts if part.known is None]
        if len(unknown) < 2:
            return unknown[0] if unknown else self._constant(is_and, node)
        return Value(BOOL, (" && " if is_and else " || ").join(part.at_least(SUM) for part in unknown), CHOICE)

    def _part(self, node: ast.Subscript, array: Value) -> Value:
        """Element of an array, a row of a matrix, or a view."""
        index = node.slice
        if array.kind == TUPLE:
            place: int = self.value(index).known
            return array.parts[place]
        if isinstance(index, ast.Slice):
            first = self.value(index.lower) if index.lower is not None else self._constant(0, node)
            end = self.value(index.upper) if index.upper is not None else self._constant(array.shape[0], node)
            known = first.known is not None and end.known is not None
            return _view(array, first, (end.known - first.known if known else None, *array.shape[1:]))
        for part in index.elts if isinstance(index, ast.Tuple) else [index]:
            at = self.value(part)
            if at.kind != INT:
                raise self.refusal(node, "an index is a whole number")
            array = _view(array, at, array.shape[1:])
        if array.shape:
            return array
        base, plus, offset = array.text.partition(" + ")
        kind = INT if array.kind == INTEGERS else REAL
        return Value(kind, f"{base}[{offset if plus else 0}]", root=array.root)

    def _called(self, node: ast.Call, given: list[Value]) -> Value:
        if isinstance(node.func, ast.Attribute):
            return self._mathematics(node, node.func.attr, given)
        known = self.value(node.func).known
        if known in {min, max}:
            return reduce(partial(self._extreme, node, known), given)
        if known is abs:
            return Value(REAL, f"fabs{self.suffix}({given[0].text})")
        if is_struct(known):
            return Value(TUPLE, parts=tuple(given), fields=known._fields)
        found, passed = self.call(known, given), [one for value in given for one in value.flat]
        for value, is_written in zip(passed, found.written, strict=True):
            if is_written and value.root:
                self.written.add(value.root)
        text = f"{found.name}({', '.join(v.text for v in passed)})"
        if len(found.returned) > 1:
            return Value(TUPLE, text, parts=tuple(Value(kind) for kind in found.returned))
        return Value(found.returned[0] if found.returned else "", text)

    def _extreme(self, node: ast.Call, function: Callable[..., Any], a: Value, b: Value) -> Value:
        if a.known is not None and b.known is not None:
            return self._constant(function(a.known, b.known), node)
        name = "smaller" if function is min else "larger"
        is_whole = a.kind == b.kind == INT
        return Value(INT if is_whole else REAL, f"{name}{'_of_integers' if is_whole else ''}({a.text}, {b.text})")

    def _mathematics(self, node: ast.Call, name: str, given: list[Value]) -> Value:
        if name == "isfinite":
            return Value(BOOL, f"isfinite({given[0].text})")
        if name not in {"expm1", "sqrt", "floor"}:
            raise self.refusal(node, "no such function")
        text = f"{name}{self.suffix}({', '.join(v.text for v in given)})"
        return Value(INT, f"(int32_t){text}", UNARY) if name == "floor" else Value(REAL, text)


def _view(array: Value, first: Value, shape: tuple[int | None, ...]) -> Value:
    """Part of an array that begins at an index of its first axis."""
    width = math.prod(length or 0 for length in array.shape[1:])
    step = str(first.known * width) if first.known is not None else first.at_least(PRODUCT)
    step += f" * {width}" if first.known is None and width != 1 else ""
    base, _, offset = array.text.partition(" + ")
    if step == "0":
        text = array.text
    elif not offset:
        text = f"{base} + {step}"
    else:
        text = f"{base} + {int(offset) + int(step) if offset.isdigit() and step.isdigit() else f'{offset} + {step}'}"
    return Value(array.kind, text, SUM if text != base else ATOM, shape=shape, root=array.root)
