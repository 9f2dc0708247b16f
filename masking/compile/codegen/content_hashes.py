"""Hashes of all that shapes machine code: generated text, sources of this package, versions, and the processor.

Two hashes find what was made before. The key of a module covers what it was declared from and every source of this
package: an edit anywhere prints the module anew. The content of a function covers its generated text and the sources of
the kernels in it: text that an edit leaves as it was is not compiled again. Files of machine code are named by the
versions of what compiles it, too.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import sys
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[2]
DIGITS = 32  # of a hash
COMPILERS = ("llvmlite", "numba", "numpy", "scipy")


def digest(*parts: str) -> str:
    """Short hash of texts, in their order."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:DIGITS]


@cache
def versions() -> str:
    """Versions of Python and of the packages that turn text into machine code."""
    return " ".join([sys.version, *(f"{name} {importlib.metadata.version(name)}" for name in COMPILERS)])


@cache
def sources() -> str:
    """Hash of every source file of this package, with the versions of all that prints and compiles."""
    every = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        every.update(f"{file.relative_to(PACKAGE).as_posix()}\0".encode() + file.read_bytes() + b"\0")
    return digest(every.hexdigest(), versions(), importlib.metadata.version("sympy"))


@cache
def source_of(name: str) -> str:
    """Hash of a module of this package and of all that it imports of it; nothing if there is no such one."""
    every, stack = dict[str, str](), [name]
    while stack:
        one = stack.pop()
        path = PACKAGE.parent.joinpath(*one.split("."))
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if one in every or not file.exists():
            continue
        every[one] = file.read_text(encoding="utf-8")
        imports = (n for node in ast.walk(ast.parse(every[one])) for n in _imported(node))
        stack.extend(n for n in imports if n.startswith(f"{PACKAGE.name}."))
    return digest(*(f"{one}\0{every[one]}" for one in sorted(every))) if every else ""


def _imported(node: ast.AST) -> list[str]:
    """Imports of a statement: modules, and names in them that may be modules."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.module:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return []
