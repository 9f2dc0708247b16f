"""Modules that load when they are first used: packages that take long, kernels that bring numba, and drawing.

`from masking.lazy_imports import sympy as sp` takes no time. What each name is stands in `lazy_imports.pyi`, which type
checkers read too.
"""

import ast
from pathlib import Path
from typing import Any

import lazy_loader as lazy

_WHERE = {
    alias.name: f"{node.module}.{alias.name}" if isinstance(node, ast.ImportFrom) else alias.name
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.Import | ast.ImportFrom)
    for alias in node.names
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  # a module
    if name not in _WHERE:
        raise AttributeError(f"no module is loaded late as {name}")
    return lazy.load(_WHERE[name], suppress_warning=True)
