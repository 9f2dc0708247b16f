"""Functions of a generated module in C99: those that print nodes, and kernels with all that they call."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

from masking.compile.codegen import structs
from masking.compile.codegen.c_expressions import REAL, TUPLE, Function, Value
from masking.compile.codegen.c_kernels import Translation
from masking.compile.codegen.generated_module import Module, reads
from masking.compile.codegen.kernel_source import Closure, Named, part_of
from masking.compile.codegen.llvm_text import Expressions
from masking.compile.codegen.printers import c_language, statements

# The smaller and the larger of two numbers, the first where one of them is not a number, as Python and numba do.
EXTREMES = {
    "smaller": "static {real} smaller({real} a, {real} b)\n{{\n    return b < a ? b : a;\n}}",
    "larger": "static {real} larger({real} a, {real} b)\n{{\n    return b > a ? b : a;\n}}",
    "smaller_of_integers": (
        "static int32_t smaller_of_integers(int32_t a, int32_t b)\n{{\n    return b < a ? b : a;\n}}"
    ),
    "larger_of_integers": "static int32_t larger_of_integers(int32_t a, int32_t b)\n{{\n    return b > a ? b : a;\n}}",
}


class CFunctions:
    """Functions of a module in C, with numbers of the type `real`, each with all that it calls before it."""

    def __init__(self, module: Module, real: str) -> None:
        self.module, self.real = module, real
        self._made: dict[object, Function] = {}

    def add(self, name: str, arguments: Sequence[Value]) -> Function:
        """Function of the module for arguments of given kinds and shapes, the fields of structs one by one."""
        part, rest = part_of(self.module, name), list(arguments)
        if isinstance(part, Closure):
            annotated = structs.signature(part.function)
            arguments = [_taken(rest, annotated.get(argument)) for argument in part.arguments]
        return self._of(Named(name), arguments)

    def text(self) -> str:
        """Definitions of all functions that were added, each after those that it calls."""
        texts = list(dict.fromkeys(function.text for function in self._made.values()))
        called = "\n".join(texts)
        extremes = [text.format(real=self.real) for name, text in EXTREMES.items() if f"{name}(" in called]
        return "\n\n".join([*extremes, *texts])

    def _of(self, callee: object, arguments: Sequence[Value]) -> Function:
        if isinstance(callee, Named):
            part = part_of(self.module, callee.name)
            if isinstance(part, Expressions):
                if callee not in self._made:
                    self._made[callee] = self._expressions(callee.name, part)
                return self._made[callee]
            return self._kernel(part, callee.name, arguments)
        assert callable(callee)  # noqa: S101
        return self._kernel(Closure.of(callee), "", arguments)

    def _kernel(self, closure: Closure, name: str, arguments: Sequence[Value]) -> Function:
        key = (name or closure.function, tuple((one.kind, one.shape) for a in arguments for one in a.flat))
        if key not in self._made:
            base = name or closure.function.__name__
            found = self._translated(closure, arguments, base)
            others = {function.name: function for function in self._made.values()}
            count = 1
            while found.name in others and others[found.name].text != found.text:
                count += 1
                found = self._translated(closure, arguments, f"{base}_{count}")
            self._made[key] = found
        return self._made[key]

    def _translated(self, closure: Closure, arguments: Sequence[Value], name: str) -> Function:
        lookup: Callable[[Any, Sequence[Value]], Function] = self._of
        return Translation(closure, arguments, self.real, lookup).translate(name)

    def _expressions(self, name: str, part: Expressions) -> Function:
        language = c_language(self.real)
        pairs = list(part.results)
        if part.returns is not None:
            pairs.append((f"{language.declare}result", part.returns))
        lines = reads(part.graph, [node for _, node in pairs], part.loads, language)
        lines += statements(part.graph, pairs, language)
        lines += ["return result;"] if part.returns is not None else []
        targets = {target.partition("[")[0] for target, _ in part.results}
        text = "\n".join(lines)
        arguments, unused = [], []
        for argument, kind in part.types.items():
            const = "" if argument in targets or kind == "float" else "const "
            arguments.append(f"{const}{self.real} {'' if kind == 'float' else '*'}{argument}")
            if not re.search(rf"\b{argument}\b", text):
                unused.append(f"(void){argument};")
        returned = self.real if part.returns is not None else "void"
        body = [f"    {line}" for line in (*unused, *lines)]
        head = f"static {returned} {name}({', '.join(arguments)})"
        written = tuple(argument in targets for argument in part.types)
        return Function(name, (REAL,) if part.returns is not None else (), written, "\n".join([head, "{", *body, "}"]))


def _taken(values: list[Value], kind: Any) -> Value:  # noqa: ANN401
    """First of some values, or as many as the fields of a struct, which are taken away."""
    if not structs.is_struct(kind):
        return values.pop(0)
    return Value(TUPLE, parts=tuple(values.pop(0) for _ in kind._fields), fields=kind._fields)
