"""A kernel translated from the source of its Python into C99, for arguments of known shape.

Kernels are written in a small part of Python: numbers, arrays of known shape and views of them, `for` over `range`,
`if`, calls of kernels and of `math`. Sizes that are known when the C is written are written as numbers, and branches
that they decide are left out. The order of operations is that of the source.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from masking.compile.codegen.c_expressions import (
    ARRAY,
    BINARY,
    BOOL,
    INT,
    INTEGERS,
    REAL,
    TUPLE,
    CExpressions,
    Function,
    Lookup,
    Value,
)
from masking.compile.codegen.kernel_source import Closure
from masking.compile.codegen.printers import SUM

C_TYPES = {INT: "int32_t", BOOL: "int"}


class Translation:
    """One kernel on its way into C, for arguments of known kinds and shapes; see `CExpressions`."""

    def __init__(self, closure: Closure, arguments: Sequence[Value], real: str, call: Lookup) -> None:
        self.closure, self.real = closure, real
        self.returned: tuple[str, ...] = ()
        self.lines: list[_Line] = []
        named = {name: _argument(name, v) for name, v in zip(closure.arguments, arguments, strict=True)}
        self.arguments = {value.text: value for argument in named.values() for value in argument.flat}
        self.inner = CExpressions(closure, named, real, call)
        self.values, self.written = self.inner.values, self.inner.written
        names = (node for node in ast.walk(closure.tree) if isinstance(node, ast.Name))
        self.counts = Counter(node.id for node in names if isinstance(node.ctx, ast.Store))

    def translate(self, name: str) -> Function:
        """Function under a name in C."""
        self._block(self.closure.body, 1)
        lines = self._kept()
        text = "\n".join(lines)
        parameters = [self._declared(value) for value in self.arguments.values()]
        many = len(self.returned) > 1
        parameters += [f"{self._c_type(kind)} *result{i}" for i, kind in enumerate(self.returned)] if many else []
        returned = self._c_type(self.returned[0]) if len(self.returned) == 1 else "void"
        unused = [f"    (void){a};" for a in self.arguments if not re.search(rf"\b{a}\b", text)]
        head = f"static {returned} {name}({', '.join(parameters) or 'void'})"
        written = tuple(a in self.written for a in self.arguments)
        return Function(name, self.returned, written, "\n".join([head, "{", *unused, *lines, "}"]))

    def _kept(self) -> list[str]:
        """Lines without declarations that nothing uses."""
        kept: list[str] = []
        used: set[str] = set()
        for line in reversed(self.lines):
            if line.declares and line.declares not in used:
                continue
            text = line.text
            if line.root is not None:
                text = text.replace("CONST ", "" if line.root in self.written else "const ")
            used |= set(re.findall(r"[A-Za-z_]\w*", text.partition("=")[2] if line.declares else text))
            kept.append(text)
        return kept[::-1]

    def _declared(self, value: Value) -> str:
        if value.kind in {ARRAY, INTEGERS}:
            const = "" if value.root in self.written else "const "
            return f"{const}{self.real if value.kind == ARRAY else 'int32_t'} *{value.text}"
        return f"{self._c_type(value.kind)} {value.text}"

    def _c_type(self, kind: str) -> str:
        return C_TYPES.get(kind, self.real)

    # Statements

    def _block(self, body: Sequence[ast.stmt], depth: int) -> None:
        for statement in body:
            self._statement(statement, depth)

    def _write(self, text: str, depth: int, declares: str = "", root: str | None = None) -> None:
        self.lines.append(_Line("    " * depth + text, declares, root))

    def _statement(self, node: ast.stmt, depth: int) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                self._assign(targets, value, depth)
            case ast.AugAssign(target=target, op=op, value=value):
                into, given = self.inner.target(target), self.inner.value(value)
                self._write(f"{into.text} {BINARY[type(op)][1]}= {given.text};", depth)
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=args), body=body):
                self._for(name, [self.inner.value(a) for a in args], body, depth)
            case ast.If(test=test, body=body, orelse=other):
                self._if(self.inner.both(test), body, other, depth)
            case ast.Expr(value=ast.Call() as call):
                self._write(f"{self.inner.value(call).text};", depth)
            case ast.Return(value=None):
                self._write("return;", depth)
            case ast.Return(value=value) if value is not None:
                self._return(self.inner.value(value), depth)
            case ast.Pass():
                pass
            case _:
                raise self.inner.refusal(node, "no such statement")

    def _assign(self, targets: Sequence[ast.expr], value: ast.expr, depth: int) -> None:
        given = self.inner.value(value)
        if len(targets) > 1:  # a = b = 0.0, from the last to the first
            for target in reversed(targets):
                self._store(target, given, depth)
                given = self.inner.value(target)
        elif isinstance(targets[0], ast.Tuple) and given.kind == TUPLE and given.text:
            self._store_results(targets[0].elts, given, depth)
        elif isinstance(targets[0], ast.Tuple):
            for target, part in zip(targets[0].elts, given.parts, strict=True):
                self._store(target, part, depth)
        else:
            self._store(targets[0], given, depth)

    def _store(self, target: ast.expr, given: Value, depth: int) -> None:
        if not isinstance(target, ast.Name):
            self._write(f"{self.inner.target(target).text} = {given.text};", depth)
            return
        name = target.id
        if given.fields or (self.counts[name] == 1 and given.known is not None and given.kind != REAL):
            self.values[name] = given
        elif given.kind in {ARRAY, INTEGERS}:
            c_type = self.real if given.kind == ARRAY else "int32_t"
            self.values[name] = Value(given.kind, name, shape=given.shape, root=given.root)
            self._write(f"CONST {c_type} *{name} = {given.text};", depth, name, given.root)
        elif name in self.values:
            self._write(f"{name} = {given.text};", depth)
        else:
            self._new(name, given, depth)

    def _new(self, name: str, given: Value, depth: int) -> None:
        """Declare a number: at its first value, or at the top if that stands in a block and it is used outside."""
        self.values[name] = Value(given.kind, name)
        if depth > 1 and self._is_seen_outside(name):
            self.lines.insert(0, _Line(f"    {self._c_type(given.kind)} {name} = 0;"))
            self._write(f"{name} = {given.text};", depth)
        else:
            declares = name if self.counts[name] == 1 else ""
            self._write(f"{self._c_type(given.kind)} {name} = {given.text};", depth, declares)

    def _is_seen_outside(self, name: str) -> bool:
        """Whether a name is used outside of the innermost block that first gives it a value."""
        uses = [n for n in ast.walk(self.closure.tree) if isinstance(n, ast.Name) and n.id == name]
        first = min((n for n in uses if isinstance(n.ctx, ast.Store)), key=lambda n: (n.lineno, n.col_offset))
        blocks = [
            part
            for node in ast.walk(self.closure.tree)
            if isinstance(node, ast.If | ast.For)
            for part in (node.body, node.orelse)
            if part and part[0].lineno <= first.lineno <= (part[-1].end_lineno or 0)
        ]
        block = min(blocks, key=lambda part: (part[-1].end_lineno or 0) - part[0].lineno)
        return any(not block[0].lineno <= n.lineno <= (block[-1].end_lineno or 0) for n in uses)

    def _store_results(self, targets: Sequence[ast.expr], given: Value, depth: int) -> None:
        """Store what a function of several results gives, through pointers."""
        pointers = []
        for target, part in zip(targets, given.parts, strict=True):
            if isinstance(target, ast.Name) and target.id not in self.values:
                self.values[target.id] = Value(part.kind, target.id)
                self._write(f"{self._c_type(part.kind)} {target.id};", depth)
            pointers.append(f"&{self.inner.target(target).text}")
        self._write(f"{given.text[:-1]}, {', '.join(pointers)});", depth)

    def _for(self, name: str, limits: Sequence[Value], body: Sequence[ast.stmt], depth: int) -> None:
        first, end = (Value(INT, "0", known=0), limits[0]) if len(limits) == 1 else limits[:2]
        if end.known is not None and first.known is not None and end.known <= first.known:
            return
        i = name if name != "_" else "repeated"
        self.values[name] = Value(INT, i)
        self._write(f"for (int32_t {i} = {first.text}; {i} < {end.at_least(SUM)}; {i}++) {{", depth)
        self._block(body, depth + 1)
        self._write("}", depth)

    def _if(self, test: Value, body: Sequence[ast.stmt], other: Sequence[ast.stmt], depth: int) -> None:
        if test.known is not None:
            self._block(body if test.known else other, depth)
            return
        self._write(f"if ({test.text}) {{", depth)
        self._block(body, depth + 1)
        if other:
            self._write("} else {", depth)
            self._block(other, depth + 1)
        self._write("}", depth)

    def _return(self, value: Value, depth: int) -> None:
        if value.kind == TUPLE:
            self.returned = tuple(part.kind for part in value.parts)
            for i, part in enumerate(value.parts):
                self._write(f"*result{i} = {part.text};", depth)
            return
        self.returned = (value.kind if value.kind != BOOL else INT,)
        self._write(f"return {value.text};", depth)


def _argument(name: str, value: Value) -> Value:
    """Argument of a kernel, whose parts, if it is a named tuple, are arguments of the C function."""
    if not value.fields:
        return Value(value.kind, name, shape=value.shape, root=name)
    parts = [_argument(f"{name}_{field}", part) for field, part in zip(value.fields, value.parts, strict=True)]
    return replace(value, parts=tuple(parts))


@dataclass(frozen=True)
class _Line:
    """A line of C: the name that it declares, if it may be left out, and the argument that it points into."""

    text: str
    declares: str = ""
    root: str | None = None
