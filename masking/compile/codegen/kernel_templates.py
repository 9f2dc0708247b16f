"""Kernels compiled once for all models: what a factory closes over is linked, its whole numbers as well as functions.

A template is the text of a kernel and of all kernels that it calls, in which each function of the model is a symbol
that is linked later, and so is each whole number that a factory has closed over. Numba compiles it once; LLVM then
optimises it together with the functions of a model and the numbers as constants.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import FunctionType, ModuleType
from typing import Any

from masking.compile.codegen import machine_code, structs
from masking.compile.codegen.content_hashes import digest, source_of
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.kernel_source import Closure, Named, part_of
from masking.compile.codegen.llvm_text import Expressions

HEADER = '''"""Generated; do not edit."""

from __future__ import annotations

import math
from collections import namedtuple

import numba
import numpy as np
from numba import carray

'''
BUILTINS = {abs, max, min, range, int, float, bool, len, slice}
INLINED = "@inlined"
DECORATORS = "from masking.compile.numerics.compilation import compiled, inlined"


@dataclass(frozen=True)
class Template:
    """A kernel."""

    text: str  # of the template, Python
    sizes: tuple[int, ...]  # the whole numbers, in the order of their symbols
    uses: tuple[str, ...]  # names of the functions of the model that it calls
    content: str  # hash of the text and of all that it imports


def template(module: Module, name: str) -> Template:
    """Template of a kernel of a module, and what is linked to it."""
    printer = _Printer(module)
    closure = part_of(module, name)
    assert isinstance(closure, Closure)  # noqa: S101
    printer.add(Named(name), name)
    arguments = structs.signature(closure.function)
    arguments.pop("return", None)
    printer.structs |= {structs.definition(kind) for kind in arguments.values() if not isinstance(kind, str)}
    interface = machine_code.interface(name, arguments, module.meta["functions"][name]["results"])
    symbols = [size_symbol(i) for i in range(len(printer.sizes))]
    sizes = [f'size_{i} = numba.types.ExternalFunction("{one}", numba.i8())' for i, one in enumerate(symbols)]
    header = HEADER + "".join(f"{line}\n" for line in sorted(printer.imports))
    text = "\n\n".join([header, "\n".join([*sorted(printer.structs), *sizes]), *printer.texts, interface]) + "\n"
    content = digest(text, *(source_of(line.split()[1]) for line in sorted(printer.imports)))
    return Template(text, tuple(printer.sizes), tuple(printer.uses), content)


def size_symbol(index: int) -> str:
    """Symbol of a whole number in a template."""
    return f"masking_size_{index}"


@dataclass
class _Printer:
    """The text of kernels, each after those that it calls."""

    module: Module
    names: dict[object, str] = field(default_factory=dict)
    texts: list[str] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    uses: list[str] = field(default_factory=list)
    imports: set[str] = field(default_factory=lambda: {DECORATORS})
    structs: set[str] = field(default_factory=set)

    def add(self, callee: Any, wanted: str = "") -> str:  # noqa: ANN401
        """Name in the text of a function of the module, or of a kernel that others call."""
        if callee not in self.names and isinstance(callee, Named) and callee.name in self.module.links:
            self.names[callee] = f"linked_{callee.name}"
            types = self.module.links[callee.name]
            self.texts.append(machine_code.link(callee.name, types, returns=False, is_apart=True))
        if callee not in self.names:
            part = part_of(self.module, callee.name) if isinstance(callee, Named) else Closure.of(callee)
            if isinstance(part, Expressions):
                self.names[callee] = f"linked_{callee.name}"
                self.uses.append(callee.name)
                returns = part.returns is not None
                self.texts.append(machine_code.link(callee.name, part.types, returns=returns, is_apart=False))
            else:
                text = self._kernel(part, callee)
                self.names[callee] = wanted or f"kernel_{len(self.names)}_{part.tree.name}"
                is_inlined = getattr(callee, "targetoptions", {}).get("forceinline")
                decorator = INLINED if is_inlined else machine_code.DECORATOR
                self.texts.append(f"{decorator}\ndef {self.names[callee]}{text}")
        return self.names[callee]

    def size(self, value: int) -> str:
        self.sizes.append(value)
        return f"size_{len(self.sizes) - 1}()"

    def _kernel(self, closure: Closure, callee: Any) -> str:  # noqa: ANN401
        writer = _Written(closure, self)
        body = [writer.visit(statement) for statement in closure.body]
        text = "\n".join(ast.unparse(ast.fix_missing_locations(statement)) for statement in body)
        return "\n".join([f"({', '.join(closure.arguments)}):", *(f"    {line}" for line in text.splitlines())])


class _Written(ast.NodeTransformer):
    """Names from outside of a kernel, as numbers, as sizes that are linked, and as functions of the printed text."""

    def __init__(self, closure: Closure, printer: _Printer) -> None:
        self.closure, self.printer = closure, printer
        self.enclosed: Mapping[str, Any] = inspect.getclosurevars(closure.function).nonlocals
        self.known: dict[str, str] = {}

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        known = self.closure.names.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if isinstance(known, slice):
            return self._size(ast.unparse(node), getattr(known, node.attr))
        if isinstance(known, ModuleType) and known.__name__.startswith("masking."):
            return ast.Constant(getattr(known, node.attr))
        self.generic_visit(node)
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self.closure.names:
            return node
        known = self.closure.names[node.id]
        if structs.is_struct(known):
            self.printer.structs.add(structs.definition(known))
        if structs.is_struct(known) or isinstance(known, ModuleType) or (callable(known) and known in BUILTINS):
            return node
        if isinstance(known, int) and not isinstance(known, bool) and node.id in self.enclosed:
            return self._size(node.id, known)
        if isinstance(known, bool | int | float):
            return ast.Constant(known)
        if isinstance(known, FunctionType | Named) or hasattr(known, "py_func"):
            return ast.Name(self.printer.add(known), node.ctx)
        module = self.closure.function.__module__
        self.printer.imports.add(f"from {module} import {node.id}")
        return node

    def _size(self, name: str, value: int) -> ast.expr:
        if name not in self.known:
            self.known[name] = self.printer.size(value)
        return ast.parse(self.known[name], mode="eval").body
