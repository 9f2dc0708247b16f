"""The JSON Schema of each kind of declaration, for editors."""

from __future__ import annotations

from typing import Any

from masking.errors import DeclarationError, Problem, nearest
from masking.model.declaration.catalogue import Kind
from masking.model.declaration.schema import KINDS

# It is read before the rest (`masking.model.declaration.repetition`).
REPEAT = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}


def json_schema(kind: Kind) -> dict[str, Any]:
    """JSON Schema of a kind of declaration, for editors.

    Args:
        kind: one of `KINDS`.

    Raises:
        DeclarationError: there is no such kind.
    """
    if kind not in KINDS:
        raise DeclarationError(Problem(None, "", f"there is no kind of declaration '{kind}'", nearest(kind, KINDS)))
    schema = KINDS[kind].model_json_schema(ref_template="#/$defs/{model}")
    schema["properties"]["repeat"] = REPEAT
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
