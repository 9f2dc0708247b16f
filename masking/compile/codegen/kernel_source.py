"""Kernels as what they close over: the source of a function, and what each free name in it stands for."""

from __future__ import annotations

import ast
import inspect
import linecache
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import CodeType, FunctionType
from typing import Any

from masking.compile.codegen.generated_module import Made, Module, made_of
from masking.compile.codegen.llvm_text import Expressions


@dataclass(frozen=True)
class Named:
    """A function of a generated module, which its printed text calls by this name."""

    name: str


@dataclass(frozen=True)
class Closure:
    """A kernel."""

    function: FunctionType  # its Python function
    tree: ast.FunctionDef  # the definition, as it is written
    names: Mapping[str, Any]  # what its free names stand for: numbers, slices, modules, `Named`, and functions

    @classmethod
    def of(cls, function: Callable[..., Any]) -> Closure:
        """Function that is plain, or that numba has decorated."""
        plain: Any = getattr(function, "py_func", function)
        (tree,) = ast.parse(_source(plain.__code__)).body
        assert isinstance(tree, ast.FunctionDef)  # noqa: S101
        found = inspect.getclosurevars(plain)
        return cls(plain, tree, {**found.builtins, **found.globals, **found.nonlocals})

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments."""
        return tuple(a.arg for a in self.tree.args.args)

    @property
    def body(self) -> list[ast.stmt]:
        """Statements without the docstring."""
        return self.tree.body[1:] if ast.get_docstring(self.tree) is not None else self.tree.body


def part_of(module: Module, name: str) -> Expressions | Closure:
    """Function of a module: its expressions, or the kernel that its factory makes."""
    part = module.parts[name]
    if not isinstance(part, Made):
        return part
    return Closure.of(made_of(part, Named))


@cache
def _source(code: CodeType) -> str:
    """Source of a function; those that a factory makes have the same code.

    `inspect.getsource` looks at every module that is loaded, and so loads all that are waiting to be used.
    """
    lines = linecache.getlines(code.co_filename)[code.co_firstlineno - 1 :]
    return textwrap.dedent("".join(inspect.getblock(lines)))
