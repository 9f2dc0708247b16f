"""JSON that every reader takes: of numpy values and paths too, and without the numbers that JSON lacks."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from masking.errors import RecordError


def json_text(content: Any) -> str:  # noqa: ANN401  # a tree of values
    """JSON of a tree of values; numbers that are not finite are written as text.

    Args:
        content: mappings, sequences, text, numbers, numpy values and paths.

    Raises:
        RecordError: it holds something else; says where.
    """
    return json.dumps(_plain(content, ()), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: Any, path: Iterable[str]) -> Any:  # noqa: ANN401  # a tree of JSON values
    """Turn numpy values, tuples and the numbers that JSON lacks into what JSON can hold."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else str(value)
        case Mapping():
            return {str(key): _plain(item, (*path, str(key))) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item, (*path, str(index))) for index, item in enumerate(value)]
        case Path():
            return str(value)
    kind = type(value).__name__
    raise RecordError(f"'{'.'.join(path)}' is a {kind}, which JSON cannot hold")
