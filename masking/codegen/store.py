"""Generated modules on disk, found again by the hash of what they were made from.

`modules/` holds for each key what the module says of itself and which text and objects are its own; `texts/` the
printed modules, named by their hash; `objects/` the machine code of each function that was ever called, named by the
hash of its content. A file that does not hold what its name says, or that another user could have written, is
made anew.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.util
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs

from masking.codegen import files
from masking.codegen.content import contents, digest, sources
from masking.codegen.native import NativeFunction
from masking.codegen.source import Module

KEPT = 60 * 86400.0  # seconds that a file is kept without being used
_importing = threading.Lock()


def directory() -> Path:
    """Return the folder of generated modules: `$MASKING_CACHE`, or the user's cache folder."""
    chosen = os.environ.get("MASKING_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("masking")


def key(made_from: Mapping[str, object]) -> str:
    """Return the hash of what a module is made from (anything that json can write) and of what prints it.

    The order of keys counts: that of parameters and coordinates is the order of the arrays.
    """
    return digest(json.dumps(made_from), sources())


@dataclass(frozen=True)
class Generated:
    """A generated module on disk.

    Args:
        path: of its text.
        text: Python, as it is executed; never read again from the disk.
        meta: what it says of itself.
        objects: the content hash of each function.
        links: functions of other modules that it calls, by the names that it has for them.
        work: the shape of the work space of functions that do not say it.
    """

    path: Path
    text: str = field(repr=False)
    meta: Mapping[str, Any]
    objects: Mapping[str, str] = field(repr=False)
    links: Mapping[str, NativeFunction] = field(default_factory=dict, repr=False)
    work: tuple[int, int] | None = None

    def module(self) -> ModuleType:
        """Import the module, and numba with it."""
        with _importing:  # of another thread, half a module would be seen
            return self._imported()

    def _imported(self) -> ModuleType:
        name = self.path.stem
        if name in sys.modules:
            return sys.modules[name]
        loader = _Checked(self.path, self.text)
        specification = importlib.util.spec_from_loader(name, loader)
        if specification is None:
            raise ImportError(f"cannot import the generated module {self.path}")
        module = importlib.util.module_from_spec(specification)
        sys.modules[name] = module  # numba looks functions up by the name of their module
        try:
            loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
        return module

    def function(self, name: str) -> NativeFunction:
        """Return a function of the module, compiled when it is first called."""
        described = self.meta["functions"][name]
        types = described["arguments"], described["results"]
        work = tuple(described["work"]) if described["work"] else self.work if "work" in types[0] else None
        stem = self.path.parent.parent / "objects" / self.objects[name]
        return NativeFunction(name, *types, work, self.module, stem, self.links)


@dataclass(frozen=True)
class _Checked(importlib.abc.ExecutionLoader):
    """Imports a text that was checked when it was read, and no compiled Python that lies beside it."""

    path: Path
    text: str

    def get_source(self, fullname: str) -> str:
        """Return the text."""
        return self.text

    def get_filename(self, fullname: str) -> str:
        """Return the path of the text, for tracebacks."""
        return str(self.path)


def exists(name: str) -> bool:
    """Tell whether the generated module of a key is on disk."""
    return _read(name) is not None


def load(
    name: str,
    build: Callable[[], Module],
    links: Mapping[str, NativeFunction] | None = None,
    work: tuple[int, int] | None = None,
) -> Generated:
    """Return the generated module of a key; `build` makes it if it is not on disk yet, or not as it was written.

    Args:
        name: the key.
        build: prints the module.
        links: functions of other modules, by the names that `Module.add_link` gives them.
        work: the shape of the work space of functions that do not say it.
    """
    found = _read(name) or _made(name, build)
    return replace(found, links=links or {}, work=work)


def _made(name: str, build: Callable[[], Module]) -> Generated:
    made = build()
    _forget(directory())
    text = made.text()
    objects = contents(text, made.meta.get("functions", ()))
    files.keep(_text_path(digest(text)), text.encode())
    described = json.dumps({"text": digest(text), "meta": made.meta, "objects": objects})
    files.keep(_path(name), described.encode())  # last: if it is there, all is
    return _generated(described, text)


@cache
def _forget(folder: Path) -> None:
    """Remove what was not used for long, once in a process; what is wanted again is made again."""
    oldest = time.time() - KEPT
    for part in ("modules", "texts", "objects"):
        for file in (folder / part).glob("*"):
            with contextlib.suppress(OSError):  # another process was first, or it is not this user's
                if max(file.stat().st_atime, file.stat().st_mtime) < oldest:
                    file.unlink()


def _read(name: str) -> Generated | None:
    described = files.find(_path(name))
    text = files.find(_text_path(json.loads(described)["text"])) if described else None
    return _generated(described, text.decode()) if described and text else None


def _generated(described: str | bytes, text: str) -> Generated:
    found = json.loads(described)
    return Generated(_text_path(found["text"]), text, found["meta"], found["objects"])


def _path(name: str) -> Path:
    return directory() / "modules" / f"{name}.json"


def _text_path(content: str) -> Path:
    return directory() / "texts" / f"masking_generated_{content}.txt"
