"""Cache of entries on disk, keyed by a hash of what each was computed from.

The hash covers the sources of the package except the command line, the packaged declarations, and the versions of the
libraries that compute; an entry that would come out differently is therefore never found.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import masking
from masking.compile.codegen import module_store
from masking.compile.codegen.trusted_files import write_whole
from masking.model.declaration import catalogue
from reproduction.comparison import Entry, Value

SOURCES = (Path(masking.__file__).parent, Path(__file__).parent)
WRITING = {"document.py", "contents.py", "cache.py"}  # of this package: they compute nothing


def cached(number: str, make: Callable[[], Entry]) -> Entry:
    """Return an entry from disk, or make and store it.

    Args:
        number: of the entry.
        make: it.
    """
    path = _path(number, make)
    if path.exists():
        return _read(path.read_text(encoding="utf-8"))
    made = make()
    write_whole(path, _written(made).encode())
    return made


def is_cached(number: str, make: Callable[[], Entry]) -> bool:
    """Tell whether an entry is on disk."""
    return _path(number, make).exists()


def _path(number: str, make: Callable[[], Entry]) -> Path:
    key = module_store.key({"entry": number, "made_by": make.__qualname__, "made_from": _sources()})
    return module_store.directory() / "thesis" / f"{key}.json"


@functools.cache
def _sources() -> str:
    """Return the hash of the package's sources and of its declarations."""
    digest = hashlib.sha256()
    files = [f for top in SOURCES for f in sorted(top.rglob("*.py")) if f.relative_to(top).parts[0] != "cli"]
    files = [f for f in files if f.parent.name != "reproduction" or f.name not in WRITING]
    files += [catalogue.find(kind, name) for kind in ("model", "plant", "experiment") for name in catalogue.names(kind)]
    for file in files:
        digest.update(file.name.encode() + file.read_bytes())
    return digest.hexdigest()


def _written(entry: Entry) -> str:
    content = asdict(entry) | {"picture": base64.b64encode(entry.picture).decode()}
    return json.dumps(content)


def _read(text: str) -> Entry:
    content = json.loads(text)
    values = tuple(Value(**value) for value in content.pop("values"))
    words, picture = tuple(content.pop("words")), base64.b64decode(content.pop("picture"))
    return Entry(**content, values=values, words=words, picture=picture)
