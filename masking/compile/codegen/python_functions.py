"""Functions of a generated module as plain Python: those that print nodes, and kernels with all that they call."""

from __future__ import annotations

import ast
from typing import Any

from masking.compile.codegen.closures import Closure, Named, part_of
from masking.compile.codegen.printers import statements
from masking.compile.codegen.source import Expressions, Module, reads

KEPT = ("abs", "math", "max", "min", "range")  # names that mean the same in the printed text


class PythonFunctions:
    """Functions of a module in Python without numba, each with all that it calls before it."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self._names: dict[object, str] = {}
        self._texts: list[str] = []

    def add(self, name: str) -> str:
        """Name in the text of a function of the module, and keep it."""
        return self._of(Named(name))

    def text(self) -> str:
        """Definitions of all functions that were added, each after those that it calls."""
        return "\n\n\n".join(self._texts)

    def _of(self, callee: Any) -> str:  # noqa: ANN401
        if callee not in self._names:
            part = part_of(self.module, callee.name) if isinstance(callee, Named) else Closure.of(callee)
            base = callee.name if isinstance(callee, Named) else part.tree.name  # type: ignore[union-attr]
            text = self._expressions(part) if isinstance(part, Expressions) else self._kernel(part)
            name, count = f"_{base}", 1
            while name in self._names.values():
                count += 1
                name = f"_{base}_{count}"
            self._names[callee] = name
            self._texts.append(f"def {name}{text}")
        return self._names[callee]

    def _expressions(self, part: Expressions) -> str:
        pairs = [*part.results, *([("result", part.returns)] if part.returns is not None else [])]
        lines = reads(part.graph, [node for _, node in pairs], part.loads) + statements(part.graph, pairs)
        lines += ["return result"] if part.returns is not None else []
        return "\n".join([f"({', '.join(part.types)}):", *(f"    {line}" for line in lines or ["pass"])])

    def _kernel(self, closure: Closure) -> str:
        body = [_Written(closure, self).visit(statement) for statement in closure.body]
        text = "\n".join(ast.unparse(ast.fix_missing_locations(statement)) for statement in body)
        return "\n".join([f"({', '.join(closure.arguments)}):", *(f"    {line}" for line in text.splitlines())])


class _Written(ast.NodeTransformer):
    """Names from outside of a kernel, written as numbers and as functions of the printed text."""

    def __init__(self, closure: Closure, functions: PythonFunctions) -> None:
        self.closure, self.functions = closure, functions

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        known = self.closure.names.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if isinstance(known, slice):
            return ast.Constant(getattr(known, node.attr))
        self.generic_visit(node)
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self.closure.names or node.id in KEPT:
            return node
        known = self.closure.names[node.id]
        if isinstance(known, bool | int | float):
            return ast.Constant(known)
        return ast.Name(self.functions._of(known), node.ctx)
