"""Generated modules on disk, found again by the hash of what they were made from.

A module is written once and imported ever after; numba keeps the machine code beside it. What a module was
made from, the versions of the libraries and the sources of this package that shape it all enter the hash, so a
stale module is never found.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType

import platformdirs

PACKAGE = Path(__file__).parent.parent
# Sources of this package whose text shapes the generated code.
SHAPING = (
    *("integrate.py", "dop853.py", "linear.py", "equations.py", "lowering.py", "scales.py"),
    *("model.py", "blocks.py", "controller.py", "loop.py", "compile"),
    *("declaration/expression.py", "declaration/operations.py", "declaration/syntax.py", "declaration/units.py"),
)


def directory() -> Path:
    """Return the folder of generated modules: `$MASKING_CACHE`, or the user's cache folder."""
    chosen = os.environ.get("MASKING_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("masking")


def key(made_from: Mapping[str, object]) -> str:
    """Return the hash of what a module is made from (anything that json can write) and of what shapes it."""
    text = json.dumps({"made_from": made_from, "shaped_by": _shaped_by()}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def path(name: str) -> Path:
    """Return where the generated module of a key is kept."""
    return directory() / f"masking_generated_{name}.py"


def load(name: str, build: Callable[[], str]) -> ModuleType:
    """Return the generated module of a key; `build` writes its source if it is not on disk yet."""
    full_name = path(name).stem
    if full_name in sys.modules:
        return sys.modules[full_name]
    file = path(name)
    if not file.exists():
        _write(file, build())
    specification = importlib.util.spec_from_file_location(full_name, file)
    if specification is None or specification.loader is None:
        raise ImportError(f"cannot import the generated module {file}")
    module = importlib.util.module_from_spec(specification)
    sys.modules[full_name] = module  # numba looks functions up by the name of their module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[full_name]
        raise
    return module


def _write(target: Path, text: str) -> None:
    """Write a file whole or not at all; the first of several processes wins, so that machine code stays valid."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=target.parent, suffix=".tmp", delete=False, encoding="utf-8") as file:
        file.write(text)
    try:
        os.link(file.name, target)
    except FileExistsError:
        pass
    finally:
        Path(file.name).unlink()


@cache
def _shaped_by() -> dict[str, str]:
    digest = hashlib.sha256()
    for entry in SHAPING:
        path = PACKAGE / entry
        for file in sorted(path.glob("*.py")) if path.is_dir() else [path]:
            if file.exists():
                digest.update(file.read_bytes())
    versions = {name: importlib.metadata.version(name) for name in ("numba", "sympy", "numpy")}
    return {**versions, "python": sys.version, "sources": digest.hexdigest()}
