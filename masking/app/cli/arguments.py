"""Arguments of a verb, made from the signature and the docstring of the function that does it.

A parameter without a default is an argument by position, or an option that is required if it is a keyword; any other
is an option. Its type says how it is written: a flag, one of some words, a number, names with commas between them, or
text. Callbacks are no arguments.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin

from masking.app.workflows.settings_keywords import Parameter
from masking.errors import DeclarationError, Problem, RecordError

# Options that have another name than the parameter.
_NAMES: Final = {"changes": "set", "validation": "validate", "inputs": "input", "sensors": "sensor"}


def add(
    sub: argparse.ArgumentParser,
    parameters: Mapping[str, Parameter],
    metavars: Mapping[str, str],
    defaults: Mapping[str, object],
) -> None:
    """Add the arguments of a verb to its parser, which keeps only what is written.

    `metavars` are placeholders in place of the names of parameters; `defaults`, of options that are parameters without.
    """
    for name, parameter in parameters.items():
        kinds = _kinds(parameter)
        if not kinds:
            continue
        settings = {"help": _help(parameter, defaults.get(name, parameter.default)), **_form(parameter, kinds[0])}
        settings |= {"metavar": metavars[name]} if name in metavars else {}
        if is_positional(parameter):
            settings |= {"nargs": "*" if kinds[0] is int else "+"} if parameter.is_repeated else {}
            sub.add_argument(name, **settings)
            continue
        is_required = parameter.is_required and name not in defaults
        option = f"--{_NAMES.get(name, name).replace('_', '-')}"
        sub.add_argument(option, dest=name, required=is_required, **settings)
        if name == "columns":
            text = "rename columns: NAME=COLUMN, with commas; in groups, structures or matrices V1=GROUP/COLUMN"
            sub.add_argument("--map", metavar="t=time,V1=u", help=text)


def is_positional(parameter: Parameter) -> bool:
    """Whether an argument is known by its position."""
    is_keyword = parameter.kind is inspect.Parameter.KEYWORD_ONLY
    return not is_keyword and parameter.is_required and parameter.name != "out"


def value(parameter: Parameter, written: Any) -> Any:  # noqa: ANN401  # as the type of the parameter says
    """Value of a parameter from what is written for it."""
    kind = _kinds(parameter)[0]
    if parameter.name == "columns":
        return words(written)
    if get_origin(kind) is Mapping:
        return dict(written)
    if get_origin(kind) is Sequence and not parameter.is_repeated and not _are_files(kind):
        return tuple(word for text in written for word in words(text))
    return written


def columns(written: Mapping[str, Any]) -> dict[str, Any]:
    """Columns by the names that they get, of `--map`; nothing where that is not written.

    Raises a `RecordError` where `--columns` is written, too, or a part has no equals sign.
    """
    if "map" not in written:
        return {}
    if "columns" in written:
        raise RecordError("--map renames columns and --columns names those that have no names; give one of them")
    from masking.lab.records import readers

    return {"columns": readers.mapping(written["map"])}


def words(text: str) -> tuple[str, ...]:
    """Words of a text with commas between them."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _reader(option: str, wrong: str, example: str, read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Reader that says what is wrong, and how it is written instead."""

    def reader(text: str) -> Any:  # noqa: ANN401
        try:
            return read(text)
        except ValueError:
            problem = Problem(None, option, wrong.format(text), f"write it as in {option} {example}")
            raise DeclarationError(problem) from None

    return reader


def _part(text: str) -> tuple[int, int]:
    k, n = map(int, text.split("/"))
    return k, n


def bounds(text: str) -> tuple[float, float]:
    """Read LOW:HIGH."""
    low, high = map(float, text.split(":"))
    return low, high


def _repeated(metavar: str, option: str, wrong: str, example: str, read: Callable[[str], Any]) -> dict[str, Any]:
    """How NAME=VALUE is written, any number of times."""

    def named(text: str) -> tuple[str, Any]:
        name, _, rest = text.partition("=")
        if not rest:
            raise ValueError(text)
        return name.strip(), read(rest.strip())

    return {"metavar": metavar, "type": _reader(option, wrong, example, named), "action": "append"}


# How arguments are written whose type does not say it, by their parameters.
_FORMS: Final[dict[str, dict[str, Any]]] = {
    "changes": _repeated("NAME=VALUE", "--set", "'{}' is not a change of a parameter", "w3=0.6", float),
    "box": _repeated("NAME=LOW:HIGH", "--box", "'{}' cannot be read", "x1=-2:2", bounds),
    "over": _repeated("NAME=VALUES", "--over", "'{}' does not say what varies and how", "mu1=0.01:0.2:50", str),
    "part": {"metavar": "K/N", "type": _reader("--part", "'{}' is no part", "1/4", _part)},
    "rates": {"metavar": "LOW:HIGH", "type": bounds},
    "columns": {"metavar": "t,V1,s1", "help": "names of the columns of a text without a line of names, in order"},
    "resample": {"metavar": "HZ"},
    "page": {"metavar": "PORT", "type": int, "nargs": "?", "const": 0},
    "out": {"metavar": "DIR"},
}


def _form(parameter: Parameter, kind: Any) -> dict[str, Any]:  # noqa: ANN401  # a type
    """How an argument is written, as `add_argument` takes it."""
    if parameter.name in _FORMS:
        return _FORMS[parameter.name]
    if kind is bool:
        return {"action": "store_true" if parameter.default is False else argparse.BooleanOptionalAction}
    if get_origin(kind) is Literal:
        return {"choices": get_args(kind)}
    if kind in (int, float):
        return {"type": kind, "metavar": "N" if kind is int else "NUMBER"}
    if get_origin(kind) is Sequence:
        return {"action": "append", "metavar": parameter.name.upper() if _are_files(kind) else "A,B"}
    return {"metavar": parameter.name.upper()}


def _kinds(parameter: Parameter) -> list[Any]:
    """Types of a parameter besides None; none of a callback, nor of an object that no text stands for."""
    is_union = get_origin(parameter.type) in (Union, UnionType)
    kinds = [kind for kind in (get_args(parameter.type) if is_union else (parameter.type,)) if kind is not NoneType]
    is_written = kinds[0] in (bool, int, float, str) or get_origin(kinds[0]) in (Literal, Sequence, Mapping, tuple)
    return kinds if is_written else []


def _are_files(kind: Any) -> bool:  # noqa: ANN401  # a type
    """Whether a sequence is one of files, whose names may have commas."""
    return Path in get_args(get_args(kind)[0])


def _help(parameter: Parameter, default: object) -> str:
    text = parameter.text.rstrip(".").replace("`", "'").replace("%", "%%")
    if parameter.name == "out" and isinstance(default, str):
        folder = default.replace("{", "").replace("}", "")
        return f"{text.partition('; by default')[0]} (default: {folder})"
    if isinstance(default, str | int | float) and not isinstance(default, bool) and "default" not in text:
        return f"{text} (default: {default})"
    return text
