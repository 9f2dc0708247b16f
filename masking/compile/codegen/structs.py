"""Structs: named tuples of arrays and numbers that kernels take as one argument, and C functions field by field."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any


def is_struct(kind: object) -> bool:
    """Whether an object is a class of named tuples."""
    return isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields")


def signature(function: Any) -> dict[str, Any]:  # noqa: ANN401  (a plain function)
    """Annotations of a kernel by argument, and of what it returns: types as text, structs as classes."""
    kinds = {name: str(kind) for name, kind in inspect.get_annotations(function).items()}
    known = {name: function.__globals__.get(kind) for name, kind in kinds.items()}
    return {name: known[name] if is_struct(known[name]) else kind for name, kind in kinds.items()}


def fields(arguments: Mapping[str, Any]) -> dict[str, str]:
    """Types of arguments by their names, with `argument_field` for each field of a struct."""
    found = dict[str, str]()
    for name, kind in arguments.items():
        if isinstance(kind, str):
            found[name] = kind
        else:
            types = inspect.get_annotations(kind)
            found |= {f"{name}_{field}": types[field].__forward_arg__ for field in kind._fields}
    return found


def flat(text: str, arguments: Mapping[str, Any]) -> str:
    """Expression with `argument_field` in the place of each `argument.field` of a struct."""
    known = [name for name, kind in arguments.items() if not isinstance(kind, str)]
    return re.sub(rf"\b({'|'.join(known)})\.", r"\1_", text) if known else text


def definition(kind: Any) -> str:  # noqa: ANN401  (the class of a struct)
    """Statement that defines the class of a struct anew."""
    return f"{kind.__name__} = namedtuple({kind.__name__!r}, {kind._fields!r})"
