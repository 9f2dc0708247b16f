"""The kinds of values a declaration is made of, for pydantic: each reads a scalar with its place and refuses the rest.

A scalar comes from YAML as `Text` or `Real`, a plain str or float that also knows its node, so that an expression made
of it keeps its place. Plain str, int and float, as from JSON, are read the same way without places.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, PlainSerializer, PlainValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from masking.errors import DeclarationError
from masking.model.declaration.expression import Expression
from masking.model.declaration.operations import RESERVED
from masking.model.declaration.strict_yaml import Node

_RATE = re.compile(r"\s*(?P<number>[-+]?[0-9.]+(?:[eE][-+]?\d+)?)\s*(?P<unit>[A-Za-z]*)\s*")
_HERTZ = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
NAME_PATTERN = "[A-Za-z][A-Za-z0-9_]*"


class Block(BaseModel):
    """A mapping with fixed keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)


class Text(str):
    """A text that knows its node."""

    node: Node


class Real(float):
    """A number that knows its node."""

    node: Node


def plain(node: Node) -> Any:  # noqa: ANN401  (the shape is what the file says)
    """Turn nodes into dicts, lists and scalars, with scalars that know their nodes."""
    value = node.value
    if isinstance(value, dict):
        return {_scalar(Node(key, node.keys[key], child.path, key)): plain(child) for key, child in value.items()}
    if isinstance(value, list):
        return [plain(child) for child in value]
    if value is None or isinstance(value, bool):
        return value
    return _scalar(node)


def _scalar(node: Node) -> Text | Real:
    scalar: Text | Real = Text(node.value) if isinstance(node.value, str) else Real(node.value)  # type: ignore[arg-type]
    scalar.node = node
    return scalar


def _shown(value: object) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    return f"'{value}'" if isinstance(value, str) else repr(float(value) if isinstance(value, float) else value)


def refuse(message: str, remedy: str = "") -> PydanticCustomError:
    """Make the error that a field's validator raises."""
    return PydanticCustomError("masking", "{message}", {"message": message, "remedy": remedy})


def _read_text(value: object) -> str:
    """Read a text; a number is taken as written."""
    if isinstance(value, str):
        return str(value)
    if isinstance(value, Real):
        return value.node.text
    raise refuse(f"must be a text, not {_shown(value)}")


def _read_number(value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    raise refuse(f"must be a finite number, not {_shown(value)}")


def _number(wanted: str, holds: Callable[[float], bool], kind: Callable[[float], float] = float) -> PlainValidator:
    """Reader of a number of which something holds."""

    def read(value: object) -> float:
        number = _read_number(value)
        if holds(number):
            return kind(number)
        raise refuse(f"must be {wanted}, not {number:g}")

    return PlainValidator(read)


def _read_truth(value: object) -> bool:
    if isinstance(value, bool):
        return value
    raise refuse(f"must be true or false, not {_shown(value)}")


def _read_expression(value: object) -> Expression:
    """Read an expression, keeping the place of a scalar that has one."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise refuse(f"must be an expression, not {_shown(value)}")
    try:
        if isinstance(value, Text | Real):
            node = value.node
            return Expression(node.text, node.place, node.path, node.pieces)
        return Expression(value if isinstance(value, str) else repr(value))
    except DeclarationError as error:
        problem = error.problems[0]
        raise PydanticCustomError("expression", "{message}", {"message": problem.message, "problem": problem}) from None


def _read_value(value: object) -> float | Expression:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return _read_number(value) if is_number else _read_expression(value)


def _read_name(value: object) -> str:
    """Read a name that is free to use: of a coordinate, an input, a parameter, a definition or an output."""
    name = _read_text(value)
    if not re.fullmatch(NAME_PATTERN, name):
        remedy = "a name is made of ASCII letters, digits and _, and starts with a letter"
        raise refuse(f"'{name}' is not a name", remedy)
    if keyword.iskeyword(name) or name in RESERVED:
        what = "a Python keyword" if keyword.iskeyword(name) else "the time" if name == "t" else "built in"
        raise refuse(f"the name '{name}' is taken: it is {what}", "choose another")
    return name


def _read_rate(value: object) -> float:
    """Read a sampling rate such as '1 kHz' or '1 ms' into Hz."""
    match = _RATE.fullmatch(value) if isinstance(value, str) else None
    try:
        number = float(match["number"]) if match else math.nan
    except ValueError:
        number = math.nan
    if match is None or math.isnan(number):
        raise refuse(f"must be a rate, not {_shown(value)}", "write a number and a unit, such as '1 kHz'")
    if match["unit"] not in _HERTZ and match["unit"] not in _SECONDS:
        wrong = f"the unit '{match['unit']}' is not one of a rate"
        remedy = f"allowed: {', '.join([*_HERTZ, *_SECONDS])}"
        raise refuse(wrong if match["unit"] else f"the rate '{value}' has no unit", remedy)
    if not (number > 0.0 and math.isfinite(number)):
        raise refuse(f"the rate must be greater than 0 and finite, not {number:g}")
    return number * _HERTZ[match["unit"]] if match["unit"] in _HERTZ else 1.0 / (number * _SECONDS[match["unit"]])


def _written(value: float | Expression) -> float | str:
    return value.text if isinstance(value, Expression) else value


_TEXT_OR_NUMBER = WithJsonSchema({"type": ["string", "number"]})

TextField = Annotated[str, PlainValidator(_read_text), WithJsonSchema({"type": "string"})]
Number = Annotated[float, PlainValidator(_read_number), WithJsonSchema({"type": "number"})]
_POSITIVE, _NOT_NEGATIVE = _number("greater than 0", lambda x: x > 0.0), _number("0 or more", lambda x: x >= 0.0)
_NATURAL = _number("an integer of at least 0", lambda x: x >= 0.0 and x == int(x), int)
Positive = Annotated[float, _POSITIVE, WithJsonSchema({"type": "number", "exclusiveMinimum": 0})]
NotNegative = Annotated[float, _NOT_NEGATIVE, WithJsonSchema({"type": "number", "minimum": 0})]
Truth = Annotated[bool, PlainValidator(_read_truth), WithJsonSchema({"type": "boolean"})]
Natural = Annotated[int, _NATURAL, WithJsonSchema({"type": "integer", "minimum": 0})]
Name = Annotated[str, PlainValidator(_read_name), WithJsonSchema({"type": "string", "pattern": f"^{NAME_PATTERN}$"})]
Formula = Annotated[Expression, PlainValidator(_read_expression), PlainSerializer(_written), _TEXT_OR_NUMBER]
Value = Annotated[float | Expression, PlainValidator(_read_value), PlainSerializer(_written), _TEXT_OR_NUMBER]
_RATES = WithJsonSchema({"type": "string", "examples": ["1 kHz", "1 ms"]})
Rate = Annotated[float, PlainValidator(_read_rate), PlainSerializer(lambda hertz: f"{hertz!r} Hz"), _RATES]
ControllerRate = Annotated[
    float | None,
    PlainValidator(lambda value: None if value is None or value == "continuous" else _read_rate(value)),
    PlainSerializer(lambda hertz: "continuous" if hertz is None else f"{hertz!r} Hz"),
    WithJsonSchema({"type": "string", "examples": ["continuous", "1 kHz"]}),
]
