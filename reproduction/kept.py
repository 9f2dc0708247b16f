"""Entries kept on disk: each is found again by the hash of what it was made from.

The hash covers the sources of the package but for the command line, the packaged declarations, and the versions of the
libraries that compute. What has changed is never found.
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
from masking.codegen import store
from masking.codegen.files import write_whole
from masking.declaration import catalogue
from reproduction.entry import Entry, Value

SOURCES = (Path(masking.__file__).parent, Path(__file__).parent)
WRITING = {"document.py", "contents.py", "kept.py"}  # of this package: they compute nothing


def kept(number: str, make: Callable[[], Entry]) -> Entry:
    """Return an entry from disk, or make it and keep it.

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


def is_kept(number: str, make: Callable[[], Entry]) -> bool:
    """Tell whether an entry is on disk."""
    return _path(number, make).exists()


def _path(number: str, make: Callable[[], Entry]) -> Path:
    key = store.key({"entry": number, "made_by": make.__qualname__, "made_from": _sources()})
    return store.directory() / "thesis" / f"{key}.json"


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
    told = asdict(entry) | {"picture": base64.b64encode(entry.picture).decode()}
    return json.dumps(told)


def _read(text: str) -> Entry:
    told = json.loads(text)
    values = tuple(Value(**value) for value in told.pop("values"))
    words, picture = tuple(told.pop("words")), base64.b64decode(told.pop("picture"))
    return Entry(**told, values=values, words=words, picture=picture)
