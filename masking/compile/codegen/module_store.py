"""Generated modules on disk, found again by the hash of what they were made from.

`modules/` holds for each key what the module says of itself and which text and objects are its own; `texts/` the
printed modules, named by their hash; `kernels/` what numba made of each kernel, as LLVM bitcode, and `objects/` the
machine code of each function that was ever called, both named by the hash of their content. A file that does not hold
what its name says, or that another user could have written, is made anew. A wheel brings the kernels of the packaged
experiments along.
"""

from __future__ import annotations

import contextlib
import importlib.abc
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import platformdirs

from masking.compile.codegen import llvm_text, machine_code, trusted_files
from masking.compile.codegen.argument_conditions import Needed
from masking.compile.codegen.argument_sizes import least_sizes, sizes_of_cases
from masking.compile.codegen.content_hashes import PACKAGE, digest, sources
from masking.compile.codegen.generated_module import Module
from masking.compile.codegen.kernel_templates import size_symbol, template
from masking.compile.codegen.machine_code import NativeFunction

KEPT = 60 * 86400.0  # seconds that a file is kept without being used
BROUGHT = PACKAGE / "shipped" / "kernels"
_importing = threading.Lock()


def directory() -> Path:
    """Folder of generated modules: `$MASKING_CACHE`, or the user's cache folder."""
    chosen = os.environ.get("MASKING_CACHE")
    return Path(chosen) if chosen else platformdirs.user_cache_path("masking")


def key(made_from: Mapping[str, object]) -> str:
    """Hash of what a module is made from (anything that json can write) and of what prints it.

    The order of keys counts: that of parameters and coordinates is the order of the arrays.
    """
    return digest(json.dumps(made_from), sources())


@dataclass(frozen=True)
class Generated:
    """A generated module on disk."""

    path: Path  # of its text
    text: str = field(repr=False)  # Python, as it is executed; never read again from the disk
    meta: Mapping[str, Any]  # what it says of itself
    objects: Mapping[str, str] = field(repr=False)  # the content hash of each function
    # of each function that numba compiles, the hashes of its text and content, its whole numbers, and the functions of
    # the module that it calls
    kernels: Mapping[str, Any] = field(repr=False)
    # functions of other modules that it calls, by the names that it has for them
    links: Mapping[str, NativeFunction] = field(default_factory=dict, repr=False)
    work: tuple[int, int] | None = None  # the shape of the work space of functions that do not say it

    def function(self, name: str) -> NativeFunction:
        """Function of the module, compiled when it is first called."""
        described = self.meta["functions"][name]
        types = described["arguments"], described["results"]
        work = tuple(described["work"]) if described["work"] else self.work if "work" in types[0] else None
        stem = self.path.parent.parent / "objects" / self.objects[name]
        needed = Needed(described.get("least", {}), described["requires"], described.get("cases", {}))
        return NativeFunction(name, *types, work, partial(self._assembled, name), stem, needed, self.links)

    def _assembled(self, name: str) -> Any:  # noqa: ANN401  (llvmlite has no types)
        """LLVM code of a function behind its C interface, not optimised yet."""
        described = self.meta["functions"][name]
        if name not in self.kernels:
            symbol = machine_code.symbol(name)
            returns = bool(described["results"])
            parts = [llvm_text.definition(self.text, symbol)]
            parts.append(llvm_text.entry(machine_code.ENTRY, symbol, described["arguments"], returns=returns))
            return machine_code.parsed("\n\n".join([llvm_text.declarations(parts[0]), *parts]))
        kernel = self.kernels[name]
        parts = [llvm_text.definition(self.text, machine_code.symbol(one)) for one in kernel["uses"]]
        parts += [llvm_text.constant(size_symbol(i), size) for i, size in enumerate(kernel["sizes"])]
        declared = llvm_text.declarations("\n".join(parts))
        return machine_code.linked_template(self.bitcode(name), "\n\n".join([declared, *parts]))

    def bitcode(self, name: str) -> bytes:
        """Kernel as LLVM bitcode, from the disk or from the wheel; numba makes it if it is in neither."""
        kernel = self.kernels[name]
        path = self.path.parent.parent / "kernels" / f"{kernel['content']}.{machine_code.processor()}.bc"
        found = trusted_files.find(path) or machine_code.readable(BROUGHT / bitcode_name(kernel["content"]))
        if found is None:
            text_path = _text_path(kernel["text"])
            if (text := trusted_files.find(text_path)) is None:
                raise ImportError(f"the generated text {text_path} is no longer there; start again")
            symbols = [*map(machine_code.symbol, [*kernel["uses"], *self.links])]
            symbols += map(size_symbol, range(len(kernel["sizes"])))
            arguments = self.meta["functions"][name]["arguments"].values()
            with machine_code.lightly_optimised():
                interface = getattr(_imported(text_path, text.decode()), f"{name}_c")
                found = machine_code.template_bitcode(machine_code.compiled_by_numba(interface, arguments, symbols))
            trusted_files.keep(path, found)
        return found


def bitcode_name(content: str) -> str:
    """Name of the file of a kernel in a wheel: bitcode is for a system, and for any processor of its kind."""
    return f"{content}.{machine_code.system()}.bc"


def _imported(path: Path, text: str) -> ModuleType:
    """Module of a text that was checked when it was read; numba is imported with it."""
    name = path.stem
    with _importing:  # of another thread, half a module would be seen
        if name not in sys.modules:
            module = sys.modules[name] = ModuleType(name)  # numba looks functions up by the name of their module
            try:
                _Checked(path, text).exec_module(module)
            except BaseException:
                del sys.modules[name]
                raise
        return sys.modules[name]


@dataclass(frozen=True)
class _Checked(importlib.abc.ExecutionLoader):
    """Executes a text that was checked when it was read, and no compiled Python that lies beside it."""

    path: Path
    text: str

    def get_source(self, fullname: str) -> str:
        return self.text

    def get_filename(self, fullname: str) -> str:
        return str(self.path)


def exists(name: str) -> bool:
    """Whether the generated module of a key is on disk."""
    return _read(name) is not None


def kept() -> Iterator[Generated]:
    """Modules that are on disk."""
    for file in (directory() / "modules").glob("*.json"):
        if (found := _read(file.stem)) is not None:
            yield found


def load(
    name: str,
    build: Callable[[], Module],
    links: Mapping[str, NativeFunction] | None = None,
    work: tuple[int, int] | None = None,
) -> Generated:
    """Generated module of a key; `build` makes it if it is not on disk yet, or not as it was written.

    `links` are functions of other modules, by the names that `Module.add_link` gives them; `work` is the shape of the
    work space of functions that do not say it.
    """
    found = _read(name) or _made(name, build)
    return replace(found, links=links or {}, work=work)


def _made(name: str, build: Callable[[], Module]) -> Generated:
    made = build()
    _forget(directory())
    text = made.text()
    objects, kernels, templates = described(made)
    for function, sizes in least_sizes(made).items():
        made.meta["functions"][function]["least"] = sizes
    for function in made.choices:
        sizes, cases = sizes_of_cases(made, function)
        made.meta["functions"][function] |= {"least": sizes, "cases": cases}
    for one in (*templates, text):
        if trusted_files.find(_text_path(digest(one))) is None:  # those of templates are the same for many models
            trusted_files.keep(_text_path(digest(one)), one.encode())
    content = json.dumps({"text": digest(text), "meta": made.meta, "objects": objects, "kernels": kernels})
    trusted_files.keep(_path(name), content.encode())  # last: if it is there, all is
    return _generated(content, text)


def described(made: Module) -> tuple[dict[str, str], dict[str, Any], list[str]]:
    """Content hashes of a module's functions, what is linked to its kernels, and the texts of templates."""
    objects, kernels, texts = dict[str, str](), dict[str, Any](), list[str]()
    for name in made.meta.get("functions", ()):
        if name in made.definitions:
            objects[name] = digest(name, made.definitions[name])
            continue
        one = template(made, name)
        kernels[name] = {"text": digest(one.text), "content": one.content, "sizes": one.sizes, "uses": one.uses}
        objects[name] = digest(one.content, repr(one.sizes), *(made.definitions[use] for use in one.uses))
        texts.append(one.text)
    return objects, kernels, texts


@cache
def _forget(folder: Path) -> None:
    """Remove what was not used for long, once in a process; what is wanted again is made again."""
    oldest = time.time() - KEPT
    for part in ("modules", "texts", "objects", "kernels"):
        for file in (folder / part).glob("*"):
            with contextlib.suppress(OSError):  # another process was first, or it is not this user's
                if max(file.stat().st_atime, file.stat().st_mtime) < oldest:
                    file.unlink()


def _read(name: str) -> Generated | None:
    described = trusted_files.find(_path(name))
    text = trusted_files.find(_text_path(json.loads(described)["text"])) if described else None
    return _generated(described, text.decode()) if described and text else None


def _generated(described: str | bytes, text: str) -> Generated:
    found = json.loads(described)
    return Generated(_text_path(found["text"]), text, found["meta"], found["objects"], found["kernels"])


def _path(name: str) -> Path:
    return directory() / "modules" / f"{name}.json"


def _text_path(content: str) -> Path:
    return directory() / "texts" / f"masking_generated_{content}.txt"
