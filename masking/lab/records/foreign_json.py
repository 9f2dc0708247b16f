"""JSON that another program, another version or somebody may have written, checked against what it must hold.

A shape is what pydantic takes for one: a dataclass, whose fields are the keys that are needed, or such as
`dict[str, float]`. Other keys stay as they are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from masking.errors import RecordError
from masking.lab.records import named_files
from masking.lazy_imports import pydantic

_WANTED: Final = {
    "bool_type": "true or false",
    "dataclass_type": "an object",
    "dict_type": "an object",
    "float_type": "a number",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "string_type": "a text",
}
_DEEP: Final = "it is nested too deep"
_SHOWN: Final = 40  # characters of what stands there


def load(path: str | Path, shape: Any) -> Any:  # noqa: ANN401
    """Content of a file of JSON; a RecordError where it cannot be read, is no JSON, or has not the shape."""
    try:
        return parsed(named_files.content(path), shape, str(path))
    except OSError as error:
        raise RecordError(f"{path} cannot be read: {error.strerror or error}") from error


def parsed(text: str | bytes, shape: Any, where: str) -> Any:  # noqa: ANN401
    """Content of a text of JSON; a RecordError, which begins with `where`, where it is none, or has not the shape."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = _DEEP if isinstance(error, RecursionError) else error
        raise RecordError(f"{where} is no JSON: {reason}") from error
    check(found, shape, where)
    return found


def check(found: object, shape: Any, where: str) -> None:  # noqa: ANN401
    """Refuse what JSON held where it has not the shape, by a RecordError with the keys that lead to what is wrong."""
    try:
        _adapter(shape).validate_json(json.dumps(found, allow_nan=False), strict=True)
    except pydantic.ValidationError as error:
        raise RecordError(f"{where}: {_said(error.errors(include_url=False)[0])}") from error
    except ValueError as error:
        raise RecordError(f"{where}: it holds a number that is not finite") from error
    except RecursionError as error:
        raise RecordError(f"{where}: {_DEEP}") from error


def _said(wrong: Mapping[str, Any]) -> str:
    if wrong["type"] == "json_invalid":
        return _DEEP
    *around, last = map(str, wrong["loc"] or ("the whole",))
    if wrong["type"] == "missing":
        at = f"{'.'.join(around)}: " if around else ""
        return f"{at}the key '{last}' is missing"
    given = json.dumps(wrong["input"])
    shown = given if len(given) <= _SHOWN else f"{given[:_SHOWN]}..."
    wanted = _WANTED.get(wrong["type"])
    return f"{'.'.join([*around, last])}: {f'must be {wanted}' if wanted else wrong['msg']}, not {shown}"


@cache
def _adapter(shape: Any) -> Any:  # noqa: ANN401
    return pydantic.TypeAdapter(shape)
