"""Generated modules on disk, found again by the hash of what they were made from.

A module is written once: its source, what it says of itself (json), and the machine code of each function that was
ever called. What a module was made from, the versions of the libraries and the sources of this package that shape
it all enter the hash, so a stale module is never found.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs

from masking.codegen.files import write_once
from masking.codegen.native import NativeFunction
from masking.codegen.source import Module

PACKAGE = Path(__file__).parent.parent
_importing = threading.Lock()
# Sources of this package whose text shapes the generated code.
SHAPING = (
    *("declaration", "effects", "codegen", "numerics", "modelling", "rig", "control", "estimation", "discovery"),
    "analysis/stability",
)


def directory() -> Path:
    """Return the folder of generated modules: `$MASKING_CACHE`, or the user's cache folder."""
    chosen = os.environ.get("MASKING_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("masking")


def key(made_from: Mapping[str, object]) -> str:
    """Return the hash of what a module is made from (anything that json can write) and of what shapes it.

    The order of keys counts: that of parameters and coordinates is the order of the arrays.
    """
    text = json.dumps({"made_from": made_from, "shaped_by": _shaped_by()})
    return hashlib.sha256(text.encode()).hexdigest()[:24]


@dataclass(frozen=True)
class Generated:
    """A generated module on disk: its path without ending, and what it says of itself."""

    stem: Path
    meta: Mapping[str, Any]

    def module(self) -> ModuleType:
        """Import the module, and numba with it."""
        with _importing:  # of another thread, half a module would be seen
            return self._imported()

    def _imported(self) -> ModuleType:
        name = self.stem.name
        if name in sys.modules:
            return sys.modules[name]
        specification = importlib.util.spec_from_file_location(name, self.stem.with_suffix(".py"))
        if specification is None or specification.loader is None:
            raise ImportError(f"cannot import the generated module {self.stem}.py")
        module = importlib.util.module_from_spec(specification)
        sys.modules[name] = module  # numba looks functions up by the name of their module
        try:
            specification.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
        return module

    def function(self, name: str) -> NativeFunction:
        """Return a function of the module, compiled when it is first called."""
        described = self.meta["functions"][name]
        work = tuple(described["work"]) if described["work"] else None
        return NativeFunction(name, described["arguments"], described["results"], work, self.module, self.stem)


def exists(name: str) -> bool:
    """Tell whether the generated module of a key is on disk."""
    return _stem(name).with_suffix(".json").exists()


def load(name: str, build: Callable[[], Module]) -> Generated:
    """Return the generated module of a key; `build` makes it if it is not on disk yet."""
    stem = _stem(name)
    described = stem.with_suffix(".json")
    if not described.exists():
        made = build()
        write_once(stem.with_suffix(".py"), made.text().encode())
        write_once(described, json.dumps(made.meta).encode())  # last: where it is, all is
    return Generated(stem, json.loads(described.read_bytes()))


def _stem(name: str) -> Path:
    return directory() / f"masking_generated_{name}"


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
