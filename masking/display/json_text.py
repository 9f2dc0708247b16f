"""JSON that every reader takes: of results, numpy values and paths too, and without the numbers that JSON lacks."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from masking.display.characters import json_escaped
from masking.errors import RecordError


class Result:
    """A frozen dataclass that JSON can hold: its fields by their names, in the order of their declaration.

    A class that shows less, more (a property) or another order lists the names of attributes in `json_names`; one whose
    JSON has another shape has its own `as_dict`.
    """

    json_names: ClassVar[tuple[str, ...]] = ()

    def as_dict(self) -> dict[str, Any]:
        """The result as a tree of mappings, lists, text and numbers, as `json_text` writes it."""
        return {name: plain(getattr(self, name), (name,)) for name in _names(self)}


def json_text(content: Any) -> str:  # noqa: ANN401  # a tree of values
    """JSON of a tree of values; numbers that are not finite are written as text, and control characters as escapes.

    The tree is one of results, mappings, sequences, text, numbers, numpy values and paths; a `RecordError` says where
    it holds something else.
    """
    return json_escaped(json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=False)) + "\n"


def plain(value: Any, path: Iterable[str] = ()) -> Any:  # noqa: ANN401  # a tree of values
    """A tree of values, as that of `json_text`, as JSON can hold it: results as mappings, arrays as lists.

    Named tuples are mappings, complex numbers lists; `path` is that of keys that lead to the tree, for the message.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    elif hasattr(value, "as_dict"):
        value = value.as_dict()
    elif hasattr(value, "_asdict"):  # a named tuple
        value = value._asdict()
    if isinstance(value, complex):
        value = [value.real, value.imag]
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case Mapping():
            return {str(key): plain(item, (*path, str(key))) for key, item in value.items()}
        case list() | tuple():
            return [plain(item, (*path, str(index))) for index, item in enumerate(value)]
        case Path():
            return str(value)
        case _ if is_dataclass(value):
            return {name: plain(getattr(value, name), (*path, name)) for name in _names(value)}
    kind = type(value).__name__
    raise RecordError(f"'{'.'.join(path)}' is of type {kind}, which JSON cannot hold")


def _names(value: Any) -> tuple[str, ...]:  # noqa: ANN401  # a dataclass
    return getattr(value, "json_names", ()) or tuple(field.name for field in fields(value))
