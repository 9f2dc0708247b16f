"""From a tree of nodes to a declaration, with pydantic's errors reported in the file's own terms."""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from masking.display.characters import visible_line
from masking.errors import DeclarationError, Problem, nearest
from masking.model.declaration.fields import plain
from masking.model.declaration.schema import Declaration
from masking.model.declaration.strict_yaml import Node, Places

D = TypeVar("D", bound=Declaration)
MOST_LISTED = 100  # keys and values that the schema refuses, each with its remedy: nobody reads more


def read(
    kind: type[D],
    data: Mapping[str, Any],
    places: Places,
    files: Mapping[str, str],
    check: Callable[[D, bool, Collection[str]], list[Problem]],
    *,
    refused: Sequence[Problem] = (),
) -> D:
    """Make a declaration of plain data, read from `files` with their SHA-256, of which the reader `refused` some.

    `check` lists what is wrong beyond the schema; it gets the declaration, whether it is whole (one that is not has
    lost the entries that the schema refuses) and the names in sections whose keys are not known. A `DeclarationError`
    lists the problems in the order of the file, of keys and values the first `MOST_LISTED`.
    """
    problems: list[Problem] = []
    whole, errors = _validate(kind, data)
    declaration = whole
    if errors:
        problems = list(_translate(kind, errors[:MOST_LISTED], places))
        more = len(errors) - MOST_LISTED
        if more > 0:
            problems.append(Problem(problems[-1].place, "", f"{more} further problems are not listed"))
        declaration = _validate(kind, _repaired(data, errors))[0]
    if declaration is not None:
        declaration._places = places
        declaration._files.update(files)
        problems += check(declaration, whole is not None, _lost(data, errors))
    if declaration is None or problems or refused:
        known = {problem.place for problem in refused}
        raise DeclarationError(in_order([*refused, *(p for p in problems if p.place is None or p.place not in known)]))
    return declaration


def in_order(problems: Iterable[Problem]) -> list[Problem]:
    """Sort problems by file, line and column."""
    return sorted(problems, key=lambda one: (one.place is not None, astuple(one.place) if one.place else ()))


def _validate(kind: type[D], data: Mapping[str, Any]) -> tuple[D | None, list[ErrorDetails]]:
    try:
        return kind.model_validate(data), []
    except ValidationError as error:
        return None, error.errors(include_url=False)


def _repaired(data: Mapping[str, Any], errors: Iterable[ErrorDetails]) -> dict[str, Any]:
    """Leave away the keys that are not known and put 0 for the expressions that cannot be read."""
    copy = {key: dict(value) if isinstance(value, dict) else value for key, value in data.items()}
    for error in errors:
        *around, last = error["loc"]
        block: Any = copy
        for part in around:
            block = block.get(part) if isinstance(block, dict) else None
        if isinstance(block, dict) and error["type"] == "extra_forbidden":
            block.pop(last, None)
        elif isinstance(block, dict) and error["type"] == "expression" and last in block:
            block[last] = 0.0
    return copy


def _lost(data: Mapping[str, Any], errors: Iterable[ErrorDetails]) -> list[str]:
    """List the names in the sections whose keys are not known."""
    unknown = [error["loc"] for error in errors if error["type"] == "extra_forbidden" and len(error["loc"]) == 1]
    sections = [data[str(name)] for (name,) in unknown]
    return [str(name) for section in sections if isinstance(section, Mapping) for name in section]


def plain_mapping(node: Node) -> dict[str, Any]:
    """Give the plain data of a whole file, named after the file if it has no name; refuses what is no mapping."""
    if not isinstance(node.value, dict):
        raise DeclarationError(Problem(node.place, "", "the file is not a mapping", "write 'key: value' lines"))
    data: dict[str, Any] = plain(node)
    data.setdefault("name", visible_line(Path(node.place.file).stem))
    return data


def _translate(kind: type[Declaration], errors: Iterable[ErrorDetails], places: Places) -> Iterator[Problem]:
    for details in errors:
        location = [str(part) for part in details["loc"] if part != "[key]"]
        is_key = "[key]" in details["loc"]
        path, context = ".".join(location), details.get("ctx", {})
        place = (places.keys.get(path) if is_key else None) or places.around(path)
        match details["type"]:
            case "expression":
                problem: Problem = context["problem"]
                yield problem if problem.place else replace(problem, place=place, path=path)
            case "masking":
                yield Problem(place, path, context["message"], context["remedy"])
            case "extra_forbidden":
                place = places.keys.get(path, place)
                allowed = sorted(_keys_at(kind, details["loc"][:-1]))
                yield Problem(place, path, f"the key '{location[-1]}' is not known", nearest(location[-1], allowed))
            case "missing":
                yield Problem(place, path, f"the key '{location[-1]}' is missing")
            case "model_type" | "model_attributes_type" | "dict_type":
                remedy = "write 'key: value' lines or {key: value}"
                if details["input"] is None:
                    remedy = "indent the lines below it that belong to it, or write {key: value}"
                yield Problem(place, path, "must be a mapping", remedy)
            case "tuple_type" | "list_type":
                yield Problem(place, path, "must be a list", "write [a, b]")
            case "literal_error":
                yield Problem(place, path, f"must be {context['expected']}")
            case "too_long":
                yield Problem(place, path, f"has more than {context['max_length']} entries")
            case _:
                yield Problem(place, path, details["msg"])


def _keys_at(annotation: Any, location: tuple[int | str, ...]) -> set[str]:  # noqa: ANN401
    """Give the keys that are allowed in the block at a location, by following the annotations from a block."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _keys_at(get_args(annotation)[0], location)
    if origin in {Union, types.UnionType}:
        return set().union(*(_keys_at(option, location) for option in get_args(annotation)))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if not location:
            return set(annotation.model_fields)
        field = annotation.model_fields.get(str(location[0]))
        return _keys_at(field.annotation, location[1:]) if field else set()
    if origin in {dict, tuple} and location:
        return _keys_at(get_args(annotation)[-1 if origin is dict else 0], location[1:])
    return set()
