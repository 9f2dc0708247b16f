"""Shorthand: the short ways of writing a block of a declaration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

# The field of an entry of a model that a bare scalar stands for.
SHORT = dict.fromkeys(("coordinates", "states", "inputs"), "meaning") | {"parameters": "value", "outputs": "expression"}
_JSON_TYPES = {str: "string", bool: "boolean", int: "number", float: "number"}


@dataclass(frozen=True)
class Short:
    """Lets a block be written as a bare scalar, which stands for a mapping that holds it under `key`."""

    key: str
    kinds: tuple[type, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:  # noqa: ANN401
        """Widen the scalar before the block is read."""
        return core_schema.no_info_before_validator_function(self.widen, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Editors both ways of writing."""
        names = sorted({_JSON_TYPES[kind] for kind in self.kinds})
        return {"anyOf": [{"type": names}, handler(schema)]}

    def widen(self, value: object) -> object:
        """Give the full form of a bare scalar, and anything else as it is."""
        return {self.key: value} if isinstance(value, self.kinds) and not isinstance(value, bool) else value
